/* Fixed-step runs over wires of numbers, without an interpreter between the calls into the FMUs.

   A program is a list of operations that the master has laid out; the arithmetic and its order are
   those of the operations in Python, so that both give the same bits. */

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { COPY, SCALE, ADD, FEED, EXCHANGE, EXCHANGE3, ENTER, STEP, STEP3, BOOK, WATCH, NOT_FINITE = INT_MIN };

/* The status where an event is due by the end of the step. */
enum { DUE = -2 };

typedef int (*exchange)(void *component, const unsigned *references, size_t count, void *cells);
typedef int (*exchange3)(void *component, const unsigned *references, size_t count, void *cells,
                         size_t values);
typedef int (*do_step)(void *component, double time, double size, int forward);
typedef int (*do_step3)(void *component, double time, double size, bool forward, bool *event,
                        bool *ended, bool *early, double *reached);
typedef int (*finish)(double time, double size, int stepped);

/* What a step of FMI 3.0 has told. */
typedef struct {
    double reached;
    bool event, ended, early;
} answer;

/* Done at t + at * h of a step from t by h, for a turn of size * h. `checked` is the number of cells
   that must be finite after it. */
typedef struct {
    int code, count, checked, forward, values;
    void *function, *component, *references, *cells;
    const void *source;
    const double *first, *last;
    double at, size, factor, offset;
} operation;

typedef struct {
    const void *cell;
    int type;
} column;

/* A cell as a number; its type is the letter by which ctypes calls it. */
static double number(const column *c)
{
    switch (c->type) {
    case 'd': return *(const double *)c->cell;
    case 'i': return *(const int *)c->cell;
    case '?': return *(const bool *)c->cell;
    case 'b': return *(const int8_t *)c->cell;
    case 'B': return *(const uint8_t *)c->cell;
    case 'h': return *(const int16_t *)c->cell;
    case 'H': return *(const uint16_t *)c->cell;
    case 'I': return *(const unsigned *)c->cell;
    case 'l': return (double)*(const long *)c->cell;
    case 'L': return (double)*(const unsigned long *)c->cell;
    case 'q': return (double)*(const long long *)c->cell;
    default: return (double)*(const unsigned long long *)c->cell;
    }
}

/* A step of an FMU of FMI 3.0. What comes of an event, in it or due by the time `first`, is Python's. */
static int step3(const operation *op, double t, double h)
{
    answer *a = op->cells;
    finish ask = (finish)op->source;
    if (t + h > *op->first - 1e-9 * h) return ask(t, h, 0);
    int status = ((do_step3)op->function)(op->component, t, h, op->forward, &a->event, &a->ended,
                                          &a->early, &a->reached);
    if (status > 1 || status < 0 || !(a->event || a->ended || a->early)) return status;
    int after = ask(t, h, 1);
    return after ? after : status;
}

/* The number before a positive one. */
static double below(double x)
{
    int64_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits--;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* The pieces of a step. `last` are the stop, and from when on a piece ends exactly there. */
static int steps(const operation *op, double t, double h)
{
    double piece = op->count == 1 ? op->size * h : op->size * h / op->count, stop = op->last[0];
    int warned = 0;
    for (int k = 0; k < op->count; k++) {
        double begin = t + op->at * h + k * piece;
        if (begin + piece >= op->last[1] && begin + piece != stop) {
            piece = stop - begin;
            while (begin + piece > stop) piece = below(piece);
        }
        int status = op->code == STEP3
                         ? step3(op, begin, piece)
                         : ((do_step)op->function)(op->component, begin, piece, op->forward);
        if (status > 1 || status < 0) return status;
        warned |= status;
    }
    return warned;
}

/* 0, or the status of a call. The step is number n of those whose inputs over time are laid out. */
static int run(const operation *op, double t, double h, long long n)
{
    double *cells = op->cells;
    const double *source = op->source;
    double size = op->size * h;
    switch (op->code) {
    case COPY:
        if (op->count == sizeof *cells)
            *cells = *source;
        else
            memcpy(cells, source, op->count);
        return 0;
    case SCALE:
        *cells = op->factor * *source + op->offset;
        return 0;
    case ADD:
        *cells += op->factor * *source + op->offset;
        return 0;
    case FEED:
        *cells = source[n];
        return 0;
    case EXCHANGE3:
        return ((exchange3)op->function)(op->component, op->references, op->count, cells, op->values);
    case EXCHANGE:
        return ((exchange)op->function)(op->component, op->references, op->count, cells);
    case ENTER:
        return memcmp(cells, source, op->count) ? ((finish)op->function)(t + op->at * h, size, 0) : 0;
    case STEP:
    case STEP3:
        return steps(op, t, h);
    case WATCH:
        return t + h > *op->first - 1e-9 * h ? DUE : 0;
    default: {
        enum { ENERGY, EXCHANGED, BEFORE };
        double before = cells[BEFORE] * *op->first;
        double work = size * 0.5 * (before + *source * *op->last) * op->factor;
        cells[ENERGY] += work;
        cells[EXCHANGED] += fabs(work);
        cells[BEFORE] = *source;
        return 0;
    }
    }
}

static int finite_cells(const operation *op)
{
    for (int i = 0; i < op->checked; i++)
        if (!(fabs(((const double *)op->cells)[i]) <= DBL_MAX)) return 0;
    return 1;
}

/* Steps number first + 1 to last of size h from start on; step number `count` ends at the stop. After
   every `every`-th step, and at the stop, the operations from row_begin on are done too and a row of
   the columns goes to rows. Returns the number of rows. `report` is the last step that was completed,
   and of the operation that stopped it the index, or -1, and the status; `warned` of each operation
   the first step in which it returned a warning. */
int take_steps(const operation *program, long long *warned, int length, int row_begin,
               const column *columns, int width, double start, double h, long long first,
               long long last, long long every, long long count, double stop, double *rows,
               long long *report)
{
    int taken = 0;
    long long row = first + every - first % every;
    for (long long n = first + 1; n <= last; n++) {
        double t = start + (double)(n - 1) * h;
        double size = n < count || t + h == stop ? h : stop - t;
        const operation *end = program + (n == row || n == count ? length : row_begin);
        for (const operation *op = program; op < end; op++) {
            int status = run(op, t, size, n - first - 1);
            if (!status && (!op->checked || finite_cells(op))) continue;
            long long i = op - program;
            int done = (status == 0 || status == 1);
            if (status == 1 && !warned[i]) warned[i] = n;
            if (!done || !finite_cells(op)) {
                report[0] = n - 1, report[1] = i, report[2] = done ? NOT_FINITE : status;
                return taken;
            }
        }
        if (n == row || n == count) {
            if (n == row) row += every;
            *rows++ = n < count ? start + (double)n * h : stop;
            for (int i = 0; i < width; i++)
                *rows++ = number(&columns[i]);
            taken++;
        }
    }
    report[0] = last, report[1] = -1;
    return taken;
}
