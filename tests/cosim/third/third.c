/* An FMU of FMI 3.0 with a sample of what FMI 3.0 has; __init__.py says what. It keeps to the order of
   calls that the standard demands: what is out of order is an error. */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"
#pragma clang diagnostic ignored "-Wunused-parameter"

enum { INSTANTIATED, STARTING, EVENT, STEPPING, DONE };
enum { SCALAR_IN, SCALAR_OUT, MANY_IN, MANY_OUT, KINDS, MANY = 4, CELLS = 10 };
static const int FIRST[KINDS] = {0, 1, 2, 6}, COUNT[KINDS] = {1, 1, MANY, MANY};
/* Float64, after the sample of each type. */
enum { H = 1000, V, E, U, Y, LAST, FAIL_AT, DISCARD_ABOVE, END_AT, HITS, REALS };
enum { BOUNCES = 1100, TICKS, EVENTS, INTS, CLOCK = 1200 };
#define G 9.81

#define TYPES(X) \
    X(Float32, 100) X(Int8, 300) X(UInt8, 400) X(Int16, 500) X(UInt16, 600) X(Int32, 700) \
    X(UInt32, 800) X(UInt64, 1700) X(Boolean, 1800) X(Float64, 200) X(Int64, 900)

typedef struct {
#define CELLS_OF(T, base) fmi3##T T[CELLS];
    TYPES(CELLS_OF)
    char text[64];
    uint8_t binary[64];
    size_t length;
    fmi3Int64 gear;
    double real[REALS - H], time, interval;
    int32_t count[INTS - BOUNCES];
    int phase, active, changed, lands;
} State;

typedef struct {
    State s;
    fmi3InstanceEnvironment host;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback look;
    bool events, early, updating;
} Instance;
#define R(name) i->s.real[name - H]
#define N(name) i->s.count[name - BOUNCES]

static fmi3Status fail(Instance *i, fmi3Status status, const char *why) {
    char text[128];
    snprintf(text, sizeof text, "%s at %g s", why, i->s.time);
    i->log(i->host, status, "all", text);
    return status;
}
#define ONLY(phases, call) \
    if (!((phases) >> i->s.phase & 1)) return fail(i, fmi3Error, call " out of order")
#define IN(phase) (1 << (phase))

static void fresh(Instance *i) {
    memset(&i->s, 0, sizeof i->s);
    R(H) = 1.0, R(E) = 0.5, R(FAIL_AT) = R(DISCARD_ABOVE) = R(END_AT) = 1e300;
    i->s.interval = 0.1, i->s.changed = 1;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference within[],
    size_t n, fmi3InstanceEnvironment host, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback look) {
    Instance *i = calloc(1, sizeof *i);
    i->host = host, i->log = log, i->look = look, i->events = events, i->early = early;
    fresh(i);
    if (!strcmp(token, "third")) return i;
    fail(i, fmi3Error, "the token is not known");
    free(i);
    return NULL;
}
void fmi3FreeInstance(fmi3Instance p) { free(p); }
const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3EnterInitializationMode(fmi3Instance p, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
    Instance *i = p;
    ONLY(IN(INSTANTIATED), "enterInitializationMode");
    return i->s.phase = STARTING, i->s.time = start, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance p) {
    Instance *i = p;
    ONLY(IN(STARTING), "exitInitializationMode");
    return i->s.phase = i->events ? EVENT : STEPPING, fmi3OK;
}
fmi3Status fmi3EnterEventMode(fmi3Instance p) {
    Instance *i = p;
    ONLY(i->events ? IN(STEPPING) : 0, "enterEventMode");
    return i->s.phase = EVENT, N(EVENTS)++, fmi3OK;
}
fmi3Status fmi3EnterStepMode(fmi3Instance p) {
    Instance *i = p;
    ONLY(IN(EVENT), "enterStepMode");
    if (i->s.lands) return fail(i, fmi3Error, "the landing was not handled");
    return i->s.phase = STEPPING, fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance p) {
    Instance *i = p;
    ONLY(IN(STEPPING) | IN(EVENT), "terminate");
    return i->s.phase = DONE, fmi3OK;
}
fmi3Status fmi3Reset(fmi3Instance p) { return fresh(p), fmi3OK; }

static void bounce(Instance *i) { R(H) = 0.0, R(V) = -R(E) * R(V), R(HITS) = ++N(BOUNCES), i->s.lands = 0; }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance p, fmi3Boolean *again, fmi3Boolean *ended,
                                    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *timed,
                                    fmi3Float64 *time) {
    Instance *i = p;
    ONLY(IN(EVENT), "updateDiscreteStates");
    *again = i->s.lands, *ended = *nominals = *timed = false, *values = i->s.lands, *time = 0.0;
    if (i->s.lands) bounce(i);
    i->s.changed = 0;
    if (i->s.active) {
        R(Y) = R(U), R(LAST) = i->s.time, N(TICKS)++;
        if (N(TICKS) == 5) i->s.interval = 0.25, i->s.changed = 1;
    }
    i->s.active = 0;
    return fmi3OK;
}
fmi3Status fmi3SetClock(fmi3Instance p, const fmi3ValueReference ref[], size_t n, const fmi3Clock on[]) {
    Instance *i = p;
    ONLY(IN(EVENT), "setClock");
    return i->s.active = n == 1 && *ref == CLOCK && *on, fmi3OK;
}
fmi3Status fmi3GetIntervalDecimal(fmi3Instance p, const fmi3ValueReference ref[], size_t n,
                                  fmi3Float64 interval[], fmi3IntervalQualifier qualifiers[]) {
    Instance *i = p;
    ONLY(IN(EVENT) | IN(STARTING), "getIntervalDecimal");
    *interval = i->s.interval;
    *qualifiers = i->s.changed ? fmi3IntervalChanged : fmi3IntervalUnchanged;
    return fmi3OK;
}

/* The ball falls for a time. */
static void fall(Instance *i, double h) {
    R(H) += R(V) * h - 0.5 * G * h * h, R(V) -= G * h, i->s.time += h;
}
static double landing(Instance *i) { return (R(V) + sqrt(R(V) * R(V) + 2.0 * G * R(H))) / G; }

static void show(Instance *i, double h) {
    const State before = i->s;
    for (int k = 1; i->look && k < 4; k++) {
        bool early_return = false;
        double time;
        fall(i, h * k / 4);
        i->updating = true;
        i->look(i->host, i->s.time, false, true, true, false, &early_return, &time);
        i->updating = false;
        i->s = before;
    }
}

fmi3Status fmi3DoStep(fmi3Instance p, fmi3Float64 t, fmi3Float64 h, fmi3Boolean final,
                      fmi3Boolean *event, fmi3Boolean *ended, fmi3Boolean *early, fmi3Float64 *last) {
    Instance *i = p;
    ONLY(IN(STEPPING), "doStep");
    *event = *early = false, *last = t;
    *ended = t + h > R(END_AT);
    if (fabs(t - i->s.time) > 1e-12) return fail(i, fmi3Error, "a step begins elsewhere");
    if (t + h > R(FAIL_AT)) return fail(i, fmi3Error, "this FMU refuses");
    if (h > R(DISCARD_ABOVE) * (1 + 1e-9)) return fail(i, fmi3Discard, "the step is too long");
    double end = t + h, lands;
    while ((lands = landing(i)) <= end - i->s.time && fabs(R(V)) + R(H) > 1e-9) {
        show(i, lands);
        fall(i, lands);
        if (i->events && i->early) {
            i->s.lands = 1;
            *event = true, *early = i->s.time < end, *last = i->s.time;
            return fmi3OK;
        }
        bounce(i);
    }
    show(i, end - i->s.time);
    fall(i, end - i->s.time);
    *last = i->s.time = end;
    return fmi3OK;
}

/* Values: outputs of the sample are its inputs. */
#define VALUES(T, base)                                                                             \
    static fmi3##T *T##_at(Instance *i, fmi3ValueReference ref, size_t *n) {                         \
        unsigned k = ref - base;                                                                     \
        *n = k < KINDS ? (size_t)COUNT[k] : 1;                                                       \
        if (k < KINDS) return &i->s.T[FIRST[k]];                                                     \
        return local_##T(i, ref);                                                                      \
    }                                                                                                \
    fmi3Status fmi3Get##T(fmi3Instance p, const fmi3ValueReference ref[], size_t n, fmi3##T value[], \
                          size_t values) {                                                           \
        Instance *i = p;                                                                             \
        size_t at = 0, m;                                                                            \
        i->s.T[1] = i->s.T[0], memcpy(&i->s.T[6], &i->s.T[2], MANY * sizeof *value);                 \
        for (size_t k = 0; k < n; k++, at += m) {                                                    \
            fmi3##T *cells = T##_at(i, ref[k], &m);                                                  \
            if (!cells || at + m > values) return fail(i, fmi3Error, "get" #T " of another type");   \
            memcpy(value + at, cells, m * sizeof *value);                                            \
        }                                                                                            \
        return at == values ? fmi3OK : fail(i, fmi3Error, "get" #T " of too few values");            \
    }                                                                                                \
    fmi3Status fmi3Set##T(fmi3Instance p, const fmi3ValueReference ref[], size_t n,                  \
                          const fmi3##T value[], size_t values) {                                    \
        Instance *i = p;                                                                             \
        size_t at = 0, m;                                                                            \
        if (i->updating) return fail(i, fmi3Error, "set" #T " within a step");                        \
        ONLY(IN(INSTANTIATED) | IN(STARTING) | IN(EVENT) | (i->events && !MOVES_##T ? 0 : IN(STEPPING)),     \
             "set" #T);                                                                              \
        for (size_t k = 0; k < n; k++, at += m) {                                                    \
            fmi3##T *cells = T##_at(i, ref[k], &m);                                                  \
            if (!cells || at + m > values) return fail(i, fmi3Error, "set" #T " of another type");   \
            memcpy(cells, value + at, m * sizeof *value);                                            \
        }                                                                                            \
        return at == values ? fmi3OK : fail(i, fmi3Error, "set" #T " of too few values");            \
    }

#define MOVES_Float32 1
#define MOVES_Float64 1
#define MOVES_Int8 0
#define MOVES_UInt8 0
#define MOVES_Int16 0
#define MOVES_UInt16 0
#define MOVES_Int32 0
#define MOVES_UInt32 0
#define MOVES_Int64 0
#define MOVES_UInt64 0
#define MOVES_Boolean 0
#define NONE(T) \
    static fmi3##T *local_##T(Instance *i, fmi3ValueReference ref) { return NULL; }
NONE(Float32) NONE(Int8) NONE(UInt8) NONE(Int16) NONE(UInt16) NONE(UInt32) NONE(UInt64) NONE(Boolean)
static fmi3Int64 *local_Int64(Instance *i, fmi3ValueReference ref) {
    return ref == 950 || ref == 951 ? &i->s.gear : NULL;
}
static fmi3Float64 *local_Float64(Instance *i, fmi3ValueReference ref) {
    return ref >= H && ref < REALS ? &i->s.real[ref - H] : NULL;
}
static fmi3Int32 *local_Int32(Instance *i, fmi3ValueReference ref) {
    return ref >= BOUNCES && ref < INTS ? &i->s.count[ref - BOUNCES] : NULL;
}
TYPES(VALUES)

fmi3Status fmi3GetString(fmi3Instance p, const fmi3ValueReference ref[], size_t n, fmi3String value[],
                         size_t values) {
    Instance *i = p;
    for (size_t k = 0; k < n; k++) value[k] = i->s.text;
    return fmi3OK;
}
fmi3Status fmi3SetString(fmi3Instance p, const fmi3ValueReference ref[], size_t n,
                         const fmi3String value[], size_t values) {
    Instance *i = p;
    ONLY(IN(INSTANTIATED) | IN(STARTING) | IN(EVENT) | (i->events ? 0 : IN(STEPPING)), "setString");
    strncpy(i->s.text, *value, sizeof i->s.text - 1);
    return fmi3OK;
}
fmi3Status fmi3GetBinary(fmi3Instance p, const fmi3ValueReference ref[], size_t n, size_t sizes[],
                         fmi3Binary value[], size_t values) {
    Instance *i = p;
    for (size_t k = 0; k < n; k++) value[k] = i->s.binary, sizes[k] = i->s.length;
    return fmi3OK;
}
fmi3Status fmi3SetBinary(fmi3Instance p, const fmi3ValueReference ref[], size_t n, const size_t sizes[],
                         const fmi3Binary value[], size_t values) {
    Instance *i = p;
    memcpy(i->s.binary, *value, i->s.length = *sizes < 64 ? *sizes : 64);
    return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance p, fmi3FMUState *state) {
    Instance *i = p;
    if (!*state) *state = malloc(sizeof(State));
    return memcpy(*state, &i->s, sizeof(State)), fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance p, fmi3FMUState state) {
    return memcpy(&((Instance *)p)->s, state, sizeof(State)), fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance p, fmi3FMUState state, size_t *size) {
    return *size = sizeof(State), fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance p, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    return memcpy(bytes, state, size), fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance p, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    if (!*state) *state = malloc(size);
    return memcpy(*state, bytes, size), fmi3OK;
}
fmi3Status fmi3FreeFMUState(fmi3Instance p, fmi3FMUState *state) {
    return free(*state), *state = NULL, fmi3OK;
}
