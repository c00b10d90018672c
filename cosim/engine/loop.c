/* Fixed-step runs over Real wires, without an interpreter between the calls into the FMUs.

   A program is a list of operations that the master has laid out; the arithmetic and its order are
   those of the Python loop, so that both give the same bits. */

#include <math.h>
#include <stddef.h>

enum { COPY, SCALE, SET, GET, FINITE, STEP, BOOK, FEED };

typedef int (*exchange)(void *component, const unsigned *references, size_t count, void *cells);
typedef int (*do_step)(void *component, double time, double size, int forward);

typedef struct {
    int code, count, forward;
    void *function, *component, *references, *cells;
    double *target;
    const double *source, *first, *last;
    double a, b;
    double *energy, *exchanged, *before;
    long long warned;
} operation;

typedef struct {
    const void *cell;
    int real;
} column;

/* 0, or the status of the operation that failed; FINITE fails with -1. The step is number n of
   those whose inputs over time are laid out. */
static int run(const operation *op, double t, double h, long long n)
{
    switch (op->code) {
    case COPY:
        *op->target = *op->source;
        return 0;
    case SCALE:
        *op->target = op->a * *op->source + op->b;
        return 0;
    case FEED:
        *op->target = op->source[n];
        return 0;
    case SET:
    case GET:
        return ((exchange)op->function)(op->component, op->references, op->count, op->cells);
    case FINITE:
        for (int i = 0; i < op->count; i++)
            if (!isfinite(((const double *)op->cells)[i])) return -1;
        return 0;
    case STEP: {
        double size = op->b * h / op->count;
        int warned = 0;
        for (int k = 0; k < op->count; k++) {
            double begin = t + op->a * h + k * size;
            int status = ((do_step)op->function)(op->component, begin, size, op->forward);
            if (status > 1 || status < 0) return status;
            warned |= status;
        }
        return warned;
    }
    default: {
        double size = op->b * h;
        double work = size * 0.5 * (*op->before * *op->first + *op->source * *op->last) * op->a;
        *op->energy += work;
        *op->exchanged += fabs(work);
        *op->before = *op->source;
        return 0;
    }
    }
}

/* Steps number first + 1 to last of size h from start on; after every `every`-th step the operations
   from row_begin on are done too and a row of the columns goes to rows. Returns the number of rows;
   *done is the last step that was completed, *failed the index of the operation that stopped it or
   -1, *status why; `warned` of an operation the first step in which it returned a warning. */
int advance(operation *program, int length, int row_begin, const column *columns, int width,
            double start, double h, long long first, long long last, long long every, double *rows,
            long long *done, int *failed, int *status)
{
    int count = 0;
    *failed = -1;
    for (long long n = first + 1; n <= last; n++) {
        double t = start + (double)(n - 1) * h;
        int due = n % every == 0;
        for (int i = 0; i < (due ? length : row_begin); i++) {
            *status = run(&program[i], t, h, n - first - 1);
            if (*status == 1 && !program[i].warned) program[i].warned = n;
            if (*status > 1 || *status < 0) {
                *failed = i;
                *done = n - 1;
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
    *done = last;
    return count;
}
