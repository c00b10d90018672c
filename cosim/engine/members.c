/* One system again and again, with other start values each time, without an interpreter in between.

   Steps are those of loop.c. What is added here is how a member begins and how it ends at the stop;
   the calls, the arithmetic and their order are those of initialise.py, part.py and driver.py, so
   that a member has the bits of a run by itself. A member that comes to anything out of the ordinary
   is left to Python, which takes it from its beginning. */

#include "loop.c"

/* Of a member: it is done, it is done and an FMU has returned a warning, it is left to Python. */
enum { DONE, WARNED, LEFT };

/* An instance between two members; `update` and `enter_steps` are those of an FMU of FMI 3.0 with
   event mode, `due` the time of its next event. */
typedef struct {
    int version, has_tolerance, has_stop;
    void *component, *reset, *set_up, *initialise, *leave, *update, *enter_steps;
    double tolerance;
    double *due;
} instance;

/* How long a member runs: `count` steps of `h` to the stop, a row after each `every`-th, and for each
   input over time its means in these steps. */
typedef struct {
    double h, stop;
    long long count, every;
    const double **means;
} span;

/* What a cell is given before the start value with the same index is set: the value `number` of the
   member, or one that all members share if the number is beyond those. */
typedef struct {
    void *cell;
    int type, number;
} setting;

/* Cells that begin as others are; those of inputs that are Reals must stay finite. */
typedef struct {
    void *cells;
    const void *initial;
    int size, real;
} memory;

/* A part that listens to the others in initialisation mode. */
typedef struct {
    const operation *links, *exchanges;
    const memory *inputs;
    int n_links, n_exchanges, n_inputs;
} listener;

/* A side of a bond: its totals, and the output that it begins with. */
typedef struct {
    double *totals;
    const double *output;
} side;

typedef struct {
    const instance *instances;
    const operation *starts, *outputs;
    const setting *settings;
    const memory *initial, *entered;
    const listener *listeners;
    const side *sides;
    operation *program;
    const int *feeds;
    const column *columns;
    const double *shared;
    void *scratch;
    long long *warned;
    int n_instances, n_starts, n_outputs, n_initial, n_entered, n_listeners;
    int n_sides, n_feeds, length, row_begin, width, n_values, most_exchanges;
    double start;
} ensemble;

/* Where the work stands: the member, and the steps of it that are done, -1 before it has begun. */
typedef struct {
    long long member, steps;
} place;

typedef int (*call)(void *component);
typedef int (*set_up2)(void *component, int has_tolerance, double tolerance, double start,
                       int has_stop, double stop);
typedef int (*set_up3)(void *component, bool has_tolerance, double tolerance, double start,
                       bool has_stop, double stop);
typedef int (*update3)(void *component, bool *again, bool *end, bool *nominals, bool *states,
                       bool *timed, double *time);

#define DO(what) \
    do { \
        if (what) return LEFT; \
    } while (0)

static void put(const setting *s, double value)
{
    switch (s->type) {
    case 'd': *(double *)s->cell = value; break;
    case 'i': *(int *)s->cell = (int)value; break;
    case '?': *(bool *)s->cell = value != 0.0; break;
    case 'b': *(int8_t *)s->cell = (int8_t)value; break;
    case 'B': *(uint8_t *)s->cell = (uint8_t)value; break;
    case 'h': *(int16_t *)s->cell = (int16_t)value; break;
    case 'H': *(uint16_t *)s->cell = (uint16_t)value; break;
    case 'I': *(unsigned *)s->cell = (unsigned)value; break;
    case 'l': *(long *)s->cell = (long)value; break;
    case 'L': *(unsigned long *)s->cell = (unsigned long)value; break;
    case 'q': *(long long *)s->cell = (long long)value; break;
    default: *(unsigned long long *)s->cell = (unsigned long long)value;
    }
}

static int set_starts(const ensemble *e, const double *values)
{
    for (int k = 0; k < e->n_starts; k++) {
        int number = e->settings[k].number - e->n_values;
        put(&e->settings[k], number < 0 ? values[e->settings[k].number] : e->shared[number]);
        DO(run(&e->starts[k], e->start, 0.0, 0));
    }
    return DONE;
}

static int initialise(const ensemble *e, const span *s, const instance *p)
{
    if (p->version == 3) {
        *p->due = INFINITY;
        DO(((set_up3)p->initialise)(p->component, p->has_tolerance, p->tolerance, e->start,
                                    p->has_stop, s->stop));
        return DONE;
    }
    DO(((set_up2)p->set_up)(p->component, p->has_tolerance, p->tolerance, e->start, p->has_stop,
                            s->stop));
    DO(((call)p->initialise)(p->component));
    return DONE;
}

/* Out of initialisation mode. Events of the start are Python's. */
static int leave(const ensemble *e, const span *s, const instance *p)
{
    enum { MOST_AT_ONCE = 100 };
    DO(((call)p->leave)(p->component));
    if (!p->update) return DONE;
    bool again = true, ended, nominals, states, timed = false;
    double time = 0.0;
    for (int k = 0; again; k++) {
        if (k == MOST_AT_ONCE) return LEFT;
        DO(((update3)p->update)(p->component, &again, &ended, &nominals, &states, &timed, &time));
        if (ended) return LEFT;
    }
    *p->due = timed ? time : INFINITY;
    DO(((call)p->enter_steps)(p->component));
    return *p->due <= e->start + 1e-9 * (fabs(e->start) + s->h) ? LEFT : DONE;
}

/* Bring the values of the wires as far as they are finite; whether any has changed. */
static int listen(const listener *p, char *before)
{
    char *old = before;
    for (int b = 0; b < p->n_inputs; old += p->inputs[b++].size)
        memcpy(old, p->inputs[b].cells, p->inputs[b].size);
    for (int k = 0; k < p->n_links; k++) run(&p->links[k], 0.0, 0.0, 0);
    int changed = 0;
    old = before;
    for (int b = 0; b < p->n_inputs; old += p->inputs[b++].size) {
        if (!p->inputs[b].real) {
            changed |= memcmp(old, p->inputs[b].cells, p->inputs[b].size) != 0;
            continue;
        }
        double *cells = p->inputs[b].cells;
        for (int i = 0; i < p->inputs[b].size / (int)sizeof(double); i++) {
            double x;
            memcpy(&x, old + i * sizeof x, sizeof x);
            if (!(fabs(cells[i]) <= DBL_MAX)) cells[i] = x;
            changed |= cells[i] != x;
        }
    }
    return changed;
}

/* Start values that agree. What feeds back on itself is left to Newton's method in Python. */
static int settle(const ensemble *e)
{
    for (int k = 0; k < e->n_outputs; k++) DO(run(&e->outputs[k], e->start, 0.0, 0));
    int changed = 1;
    for (int n = 0; changed && n < e->most_exchanges; n++) {
        changed = 0;
        for (const listener *p = e->listeners; p < e->listeners + e->n_listeners; p++) {
            changed |= listen(p, e->scratch);
            for (int k = 0; k < p->n_exchanges; k++) DO(run(&p->exchanges[k], e->start, 0.0, 0));
        }
    }
    return changed ? LEFT : DONE;
}

static int read_finite(const operation *reads, int n)
{
    for (const operation *op = reads; op < reads + n; op++) {
        DO(run(op, 0.0, 0.0, 0));
        if (!finite_cells(op)) return LEFT;
    }
    return DONE;
}

static double *write_row(const ensemble *e, double t, double *rows)
{
    *rows++ = t;
    for (int i = 0; i < e->width; i++) *rows++ = number(&e->columns[i]);
    return rows;
}

/* From the reset of the instances to the row of the start. */
static int begin(const ensemble *e, const span *s, const double *values, double *rows)
{
    memset(e->warned, 0, e->length * sizeof *e->warned);
    for (int k = 0; k < e->n_instances; k++) DO(((call)e->instances[k].reset)(e->instances[k].component));
    DO(set_starts(e, values));
    for (int k = 0; k < e->n_instances; k++) DO(initialise(e, s, &e->instances[k]));
    for (const memory *m = e->initial; m < e->initial + e->n_initial; m++)
        memcpy(m->cells, m->initial, m->size);
    DO(settle(e));
    DO(read_finite(e->outputs, e->n_outputs));
    for (int k = 0; k < e->n_instances; k++) DO(leave(e, s, &e->instances[k]));
    for (const memory *m = e->entered; m < e->entered + e->n_entered; m++)
        memcpy(m->cells, m->initial, m->size);
    DO(read_finite(e->outputs, e->n_outputs));
    for (const side *p = e->sides; p < e->sides + e->n_sides; p++)
        p->totals[0] = p->totals[1] = 0.0, p->totals[2] = *p->output;
    DO(read_finite(e->program + e->row_begin, e->length - e->row_begin));
    write_row(e, e->start, rows);
    return DONE;
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

/* The pieces of the last step of a part, which end exactly at the stop. */
static int steps_to_stop(const operation *op, double t, double h, double stop, double nearly)
{
    double piece = op->size * h / op->count;
    int warned = 0;
    for (int k = 0; k < op->count; k++) {
        double begin = t + op->at * h + k * piece;
        if (begin + piece >= nearly && begin + piece != stop) {
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

/* The last step, as long as what is left, and the row of the stop. */
static int end(const ensemble *e, const span *s, double *rows)
{
    double t = e->start + (double)(s->count - 1) * s->h;
    double h = t + s->h == s->stop ? s->h : s->stop - t;
    int64_t bits;
    double size = fabs(s->stop);
    memcpy(&bits, &size, sizeof bits);
    bits++;
    memcpy(&size, &bits, sizeof size);
    double nearly = s->stop - 64.0 * (size - fabs(s->stop));
    for (int i = 0; i < e->length; i++) {
        const operation *op = e->program + i;
        int is_step = op->code == STEP || op->code == STEP3;
        int status = is_step ? steps_to_stop(op, t, h, s->stop, nearly) : run(op, t, h, s->count - 1);
        if (status == 1 && !e->warned[i]) e->warned[i] = s->count;
        if ((status != 0 && status != 1) || !finite_cells(op)) return LEFT;
    }
    write_row(e, s->stop, rows);
    for (int i = 0; i < e->length; i++)
        if (e->warned[i]) return WARNED;
    return DONE;
}

/* Members from p->member to last - 1, at most `most` steps; returns when they are used up, or after a
   member that is not just DONE. Of each member: rows, (most_rows, width + 1), counts of them, work
   over the sides of bonds, (n_sides, 2), status. */
void run_members(const ensemble *e, place *p, const span *spans, long long last, long long most,
                          const double *values, double *rows, long long most_rows,
                          long long *counts, double *work, int *status)
{
    for (; p->member < last && most > 0; p->member++, p->steps = -1) {
        long long m = p->member, report[3] = {0, -1, 0};
        const span *s = spans + m;
        double *own = rows + m * most_rows * (e->width + 1);
        if (p->steps < 0) {
            counts[m] = 0;
            status[m] = begin(e, s, values + m * e->n_values, own);
            if (!status[m]) p->steps = 0, counts[m] = 1;
            most--;
        }
        if (!status[m] && p->steps < s->count - 1) {
            long long to = p->steps + most < s->count - 1 ? p->steps + most : s->count - 1;
            for (int k = 0; k < e->n_feeds; k++)
                e->program[e->feeds[k]].source = s->means[k] + p->steps;
            counts[m] += take_steps(e->program, e->warned, e->length, e->row_begin, e->columns,
                                    e->width, e->start, s->h, p->steps, to, s->every,
                                    own + counts[m] * (e->width + 1), report);
            most -= to - p->steps;
            p->steps = report[0];
            if (report[1] >= 0) status[m] = LEFT;
            else if (to < s->count - 1) return;
        }
        if (!status[m]) {
            for (int k = 0; k < e->n_feeds; k++) e->program[e->feeds[k]].source = s->means[k];
            status[m] = end(e, s, own + counts[m] * (e->width + 1));
            counts[m] += status[m] < LEFT;
            most--;
        }
        for (int k = 0; k < e->n_sides; k++)
            memcpy(work + (m * e->n_sides + k) * 2, e->sides[k].totals, 2 * sizeof *work);
        if (status[m]) {
            p->member++, p->steps = -1;
            return;
        }
    }
}
