/* The part of __init__.py by FMI 3.0. Calls out of order, and steps beyond an event that was told, are errors. */

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#pragma clang diagnostic ignored "-Wunused-parameter"

enum { U = 1, D, X, Y, E, A, B, C, Q, G, PERIOD, FIRST, REALS };
enum { W = 40, N, TICK = 50 };
enum { STARTING, EVENT, STEPPING };
typedef struct {
    double r[REALS], t;
    int w, n, mode, active, events, early;
    int happened;
} Instance;
#define INSTANCE Instance *i = p
#define REQUIRE(is_allowed) if (!(is_allowed)) return fmi3Error
/* Two times are one if they differ by rounding only. */
#define NEAR 1e-11

static double due(const Instance *i) {
    return i->r[PERIOD] > 0.0 ? i->r[FIRST] + i->happened * i->r[PERIOD] : INFINITY;
}
static void sample(Instance *i) { i->r[Y] = i->r[Q] * i->r[Y] + i->r[G] * i->r[D] + i->w, i->n++; }

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String where, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference within[], size_t n,
    fmi3InstanceEnvironment host, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback look) {
    Instance *i = calloc(1, sizeof *i);
    return i->events = events, i->early = early, i;
}
void fmi3FreeInstance(fmi3Instance p) { free(p); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance p, fmi3Boolean tolerates, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop) {
    return ((Instance *)p)->t = start, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance p) {
    INSTANCE;
    return i->mode = i->events ? EVENT : STEPPING, fmi3OK;
}
fmi3Status fmi3EnterEventMode(fmi3Instance p) {
    INSTANCE;
    REQUIRE(i->events && i->mode == STEPPING);
    return i->mode = EVENT, fmi3OK;
}
fmi3Status fmi3EnterStepMode(fmi3Instance p) {
    INSTANCE;
    REQUIRE(i->mode == EVENT && due(i) > i->t + NEAR);
    return i->mode = STEPPING, fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance p) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance p) {
    INSTANCE;
    Instance fresh = {.events = i->events, .early = i->early};
    return *i = fresh, fmi3OK;
}
fmi3Status fmi3SetClock(fmi3Instance p, const fmi3ValueReference ref[], size_t n, const fmi3Clock on[]) {
    INSTANCE;
    REQUIRE(i->mode == EVENT && n == 1 && *ref == TICK);
    return i->active = *on, fmi3OK;
}
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance p, fmi3Boolean *again, fmi3Boolean *end,
                                    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *timed,
                                    fmi3Float64 *time) {
    INSTANCE;
    REQUIRE(i->mode == EVENT);
    *again = *end = *nominals = *values = false;
    if (i->active) sample(i);
    if (due(i) < i->t + NEAR) sample(i), i->happened++;
    i->active = 0;
    return *timed = isfinite(due(i)), *time = due(i), fmi3OK;
}
/* x' = a x + b u + c d, exactly, since u and d hold. */
fmi3Status fmi3DoStep(fmi3Instance p, fmi3Float64 t, fmi3Float64 h, fmi3Boolean final,
                      fmi3Boolean *event, fmi3Boolean *ended, fmi3Boolean *early, fmi3Float64 *last) {
    INSTANCE;
    double *r = i->r;
    REQUIRE(i->mode == STEPPING && fabs(t - i->t) < NEAR);
    *ended = *early = *event = false;
    if (i->events && due(i) < t + h + NEAR) {
        *event = true;
        if (due(i) < t + h - NEAR) {
            REQUIRE(i->early);
            *early = true, h = due(i) - t;
        }
    }
    double a = r[A], grown = a == 0.0 ? h : expm1(a * h) / a;
    r[X] += grown * (a * r[X] + r[B] * r[U] + r[C] * r[D]);
    return *last = i->t = t + h, fmi3OK;
}
fmi3Status fmi3GetFloat64(fmi3Instance p, const fmi3ValueReference ref[], size_t n, fmi3Float64 value[],
                          size_t count) {
    INSTANCE;
    i->r[E] = i->r[D];
    for (size_t k = 0; k < n; k++) value[k] = ref[k] ? i->r[ref[k]] : i->t;
    return n == count ? fmi3OK : fmi3Error;
}
fmi3Status fmi3SetFloat64(fmi3Instance p, const fmi3ValueReference ref[], size_t n,
                          const fmi3Float64 value[], size_t count) {
    INSTANCE;
    for (size_t k = 0; k < n; k++) {
        REQUIRE(ref[k] != D || !i->events || i->mode != STEPPING);
        i->r[ref[k]] = value[k];
    }
    return n == count ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetInt32(fmi3Instance p, const fmi3ValueReference ref[], size_t n, fmi3Int32 value[],
                        size_t count) {
    INSTANCE;
    for (size_t k = 0; k < n; k++) value[k] = ref[k] == W ? i->w : i->n;
    return n == count ? fmi3OK : fmi3Error;
}
fmi3Status fmi3SetInt32(fmi3Instance p, const fmi3ValueReference ref[], size_t n,
                        const fmi3Int32 value[], size_t count) {
    INSTANCE;
    REQUIRE(n == 1 && *ref == W && !(i->events && i->mode == STEPPING));
    return i->w = *value, fmi3OK;
}
fmi3Status fmi3GetFMUState(fmi3Instance p, fmi3FMUState *state) {
    if (!*state) *state = malloc(sizeof(Instance));
    return memcpy(*state, p, sizeof(Instance)), fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance p, fmi3FMUState state) {
    return memcpy(p, state, sizeof(Instance)), fmi3OK;
}
fmi3Status fmi3FreeFMUState(fmi3Instance p, fmi3FMUState *state) {
    return free(*state), *state = NULL, fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance p, fmi3FMUState state, size_t *size) {
    return *size = sizeof(Instance), fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance p, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    return memcpy(bytes, state, size), fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance p, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    if (!*state) *state = malloc(size);
    return memcpy(*state, bytes, size), fmi3OK;
}
