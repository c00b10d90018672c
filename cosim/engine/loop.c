/* Fixed-step runs over wires of numbers, without an interpreter between the calls into the FMUs.

   A program is a list of operations that the master has laid out; the arithmetic and its order are
   those of the operations in Python, so that both give the same bits. */

#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

enum { COPY, SCALE, FEED, SET, GET, STEP, BOOK, NOT_FINITE = INT_MIN };

typedef int (*exchange)(void *component, const unsigned *references, size_t count, void *cells);
typedef int (*do_step)(void *component, double time, double size, int forward);

/* Done at t + at * h of a step from t by h, for a turn of size * h. `checked` is the number of cells
   that must be finite after it. */
typedef struct {
    int code, count, checked, forward;
    void *function, *component, *references, *cells;
    const void *source;
    const double *first, *last;
    double at, size, factor, offset;
} operation;

typedef struct {
    const void *cell;
    int real;
} column;

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
    case FEED:
        *cells = source[n];
        return 0;
    case SET:
    case GET:
        return ((exchange)op->function)(op->component, op->references, op->count, cells);
    case STEP: {
        double piece = size / op->count;
        int warned = 0;
        for (int k = 0; k < op->count; k++) {
            double begin = t + op->at * h + k * piece;
            int status = ((do_step)op->function)(op->component, begin, piece, op->forward);
            if (status > 1 || status < 0) return status;
            warned |= status;
        }
        return warned;
    }
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
        if (!isfinite(((const double *)op->cells)[i])) return 0;
    return 1;
}

/* Steps number first + 1 to last of size h from start on; after every `every`-th step the operations
   from row_begin on are done too and a row of the columns goes to rows. Returns the number of rows.
   `report` is the last step that was completed, and of the operation that stopped it the index, or
   -1, and the status; `warned` of each operation the first step in which it returned a warning. */
int advance(const operation *program, long long *warned, int length, int row_begin,
            const column *columns, int width, double start, double h, long long first,
            long long last, long long every, double *rows, long long *report)
{
    int count = 0;
    for (long long n = first + 1; n <= last; n++) {
        double t = start + (double)(n - 1) * h;
        int due = n % every == 0;
        for (int i = 0; i < (due ? length : row_begin); i++) {
            int status = run(&program[i], t, h, n - first - 1);
            if (status == 1 && !warned[i]) warned[i] = n;
            int done = (status == 0 || status == 1);
            if (!done || !finite_cells(&program[i])) {
                report[0] = n - 1, report[1] = i, report[2] = done ? NOT_FINITE : status;
                return count;
            }
        }
        if (due) {
            *rows++ = start + (double)n * h;
            for (int i = 0; i < width; i++)
                *rows++ = columns[i].real ? *(const double *)columns[i].cell
                                          : (double)*(const int *)columns[i].cell;
            count++;
        }
    }
    report[0] = last, report[1] = -1;
    return count;
}
