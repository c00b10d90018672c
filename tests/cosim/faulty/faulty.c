/* x' = b u - a x, v' = x - v; y = x, z = v + c u + w^2, n counts steps. Exact for an input that is held.
   One fault is switched on by its name, which stands behind the guid. See __init__.py. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#pragma clang diagnostic ignored "-Wunused-parameter"
#ifndef VERSION
#define VERSION fmi2Version
#endif

enum { U, W, A, B, C, X0, Y, Z, COUNT, TIME, REALS };
#define FAULT(name) (!strcmp(i->fault, name))
/* Refuse a call in other phases than those from the first to the last. */
#define ONLY(first, last)                                                                  \
    do {                                                                                   \
        int wrong = ((Instance *)p)->s.phase < (first) || ((Instance *)p)->s.phase > (last);   \
        if (wrong && !strcmp(((Instance *)p)->fault, "crashes when called wrongly")) abort(); \
        if (wrong && strcmp(((Instance *)p)->fault, "takes wrong calls")) return fmi2Error; \
    } while (0)
#define LONGEST 2.0

typedef struct {
    double value[REALS], v, time, reached, clock, stop;
    int n, initialising, phase, stops; /* phase: 0 instantiated, 1 initialising, 2 stepping, 3 terminated */
} State;
typedef struct {
    State s;
    char fault[64];
} Instance;
static const double START[REALS] = {1.0, 0.5, 2.0, 1.0, 0.5, 1.0, 1.0, 0.0};
static double shared;
static State only;
static int lives;
static void *volatile leaked;

static void fresh(State *s) {
    memset(s, 0, sizeof *s);
    memcpy(s->value, START, sizeof START);
}

static void show(Instance *i) {
    double *r = i->s.value;
    if (i->s.initialising) {
        r[Y] = r[X0] + (FAULT("hidden start") ? 1e-3 * r[C] : 0.0);
        i->s.v = 0.0;
    }
    r[Z] = i->s.v + r[C] * r[U] + r[W] * r[W] + (FAULT("feels an input") ? 0.1 * r[W] * r[U] : 0.0);
    if (!strncmp(i->fault, "kink", 4)) r[Z] += fmax(r[W] - START[W], 0.0);
}

static void advance(Instance *i, double h) {
    double *r = i->s.value, a = r[A], rest = r[B] * r[U] / a, e = exp(-h), f = exp(-a * h);
    double distance = r[Y] - rest, *v = FAULT("shared state") ? &shared : &i->s.v;
    if (FAULT("shared state") && i->s.n == 0) shared = i->s.v;
    *v = rest + (*v - rest) * e + distance * (f - e) / (1.0 - a);
    i->s.v = *v;
    r[Y] = FAULT("one Euler step") ? r[Y] - h * a * distance : rest + distance * f;
    i->s.n++;
    show(i);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return VERSION; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *host, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Instance *i = calloc(1, sizeof *i);
    const char *fault = strchr(guid, ' ');
    strncpy(i->fault, fault ? fault + 1 : "", sizeof i->fault - 1);
    fresh(&i->s);
    if (FAULT("once") && lives++) abort();
    if (FAULT("other start")) i->s.value[B] = 1.5;
    return i;
}
void fmi2FreeInstance(fmi2Component p) {
    Instance *i = p;
    if (FAULT("leaks when freed")) leaked = memset(malloc(400000), 1, 400000);
    free(p);
}
fmi2Status fmi2SetupExperiment(fmi2Component p, fmi2Boolean has_tolerance, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean has_stop, fmi2Real stop) {
    Instance *i = p;
    ONLY(0, 0);
    i->s.time = start, i->s.stops = has_stop, i->s.stop = stop;
    i->s.clock = FAULT("ignores the start time") ? 0.0 : start;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component p) {
    ONLY(0, 0);
    ((Instance *)p)->s.initialising = ((Instance *)p)->s.phase = 1;
    return fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component p) {
    ONLY(1, 1);
    show(p);
    ((Instance *)p)->s.initialising = 0, ((Instance *)p)->s.phase = 2;
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component p) {
    Instance *i = p;
    ONLY(2, 2);
    if (FAULT("terminate refused")) return fmi2Error;
    return i->s.phase = 3, fmi2OK;
}
fmi2Status fmi2Reset(fmi2Component p) {
    Instance *i = p;
    double b = i->s.value[B];
    int n = i->s.n;
    for (volatile int on = 1; FAULT("hangs in reset") && on;) {}
    fresh(&i->s);
    if (FAULT("reset keeps a parameter")) i->s.value[B] = b;
    if (FAULT("reset keeps a count")) i->s.n = n;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component p, const fmi2ValueReference ref[], size_t n, fmi2Real value[]) {
    Instance *i = p;
    ONLY(1, 3);
    if (i->s.initialising) show(i);
    i->s.value[TIME] = i->s.clock;
    for (size_t k = 0; k < n; k++) {
        size_t index = k;
        if (FAULT("answers in another order"))  /* that of the references: the k-th smallest */
            for (index = 0; index < n; index++) {
                size_t less = 0;
                for (size_t j = 0; j < n; j++) less += ref[j] < ref[index];
                if (less == k) break;
            }
        value[k] = i->s.value[ref[index]];
        if (FAULT("getting moves") && ref[k] == Z && !i->s.initialising) i->s.v += 1e-9;
        if (FAULT("not finite") && ref[k] == Y && i->s.n > 20) value[k] = NAN;
    }
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component p, const fmi2ValueReference ref[], size_t n,
                       const fmi2Real value[]) {
    ONLY(0, 2);
    for (size_t k = 0; k < n; k++) {
        if (ref[k] > W) ONLY(0, ref[k] < Y ? 1 : -1);
        ((Instance *)p)->s.value[ref[k]] = value[k];
    }
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component p, const fmi2ValueReference ref[], size_t n,
                          fmi2Integer value[]) {
    for (size_t k = 0; k < n; k++) value[k] = ((Instance *)p)->s.n;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component p, fmi2Real t, fmi2Real h, fmi2Boolean final) {
    Instance *i = p;
    ONLY(2, 2);
    double size = h > LONGEST * (1 + 1e-9) ? LONGEST : h;
    if (FAULT("crashes") && i->s.n == 500) *(volatile int *)NULL = 0;
    if (FAULT("leaks")) leaked = memset(malloc(4096), 1, 4096);
    if (FAULT("one step size") && i->s.n && fabs(h - (i->s.time - i->s.reached)) > 1e-9)
        return fmi2Error;
    if (FAULT("not repeatable")) i->s.value[Y] += 1e-15 * (double)(rand() % 100);
    double far = FAULT("ignores the step size") ? 1e-3 : size;
    if (FAULT("runs to the stop time") && i->s.stops) far = i->s.n ? 0.0 : i->s.stop - t;
    advance(i, far);
    i->s.reached = t, i->s.time = t + size, i->s.clock += size;
    if (FAULT("fails") && i->s.n == 2) return fmi2Error;
    if (size < h) return i->s.reached = t + size, fmi2Discard;
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component p, fmi2FMUstate *state) {
    Instance *i = p;
    if (FAULT("one place for states")) return *state = &only, only = i->s, fmi2OK;
    if (!*state) *state = malloc(sizeof(State));
    return memcpy(*state, &i->s, sizeof(State)), fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component p, fmi2FMUstate state) {
    Instance *i = p;
    double v = i->s.v;
    i->s = *(State *)state;
    if (FAULT("state lacks a value")) i->s.v = v;
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component p, fmi2FMUstate *state) {
    Instance *i = p;
    if (FAULT("freeing a state crashes")) *(volatile int *)NULL = 0;
    if (!FAULT("one place for states")) free(*state);
    return *state = NULL, fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component p, fmi2FMUstate state, size_t *size) {
    return *size = sizeof(State), fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component p, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    return memcpy(bytes, state, size), fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component p, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *state) {
    Instance *i = p;
    State *s = *state = malloc(sizeof(State));
    memcpy(s, bytes, size);
    if (FAULT("bytes lack a value")) s->v = 0.0;
    return fmi2OK;
}

/* Of y and z by u, w and x0: after a step y stands still. */
fmi2Status fmi2GetDirectionalDerivative(fmi2Component p, const fmi2ValueReference unknown[], size_t n,
                                        const fmi2ValueReference inputs[], size_t m,
                                        const fmi2Real seed[], fmi2Real result[]) {
    Instance *i = p;
    ONLY(1, 3);
    double *r = i->s.value;
    for (size_t k = 0; k < n; k++) {
        result[k] = 0.0;
        for (size_t j = 0; j < m; j++) {
            double d = 0.0;
            if (unknown[k] == Y) d = inputs[j] == X0 && i->s.initialising;
            else if (inputs[j] == U) d = r[C];
            else if (inputs[j] == W) d = 2.0 * r[W];
            if (!strncmp(i->fault, "kink", 4) && inputs[j] == W && unknown[k] == Z)
                d += FAULT("kink, wrong") ? 3.0 : r[W] > START[W];
            if (FAULT("wrong sign") && inputs[j] == U) d = -d;
            if (FAULT("derivative of another point") && inputs[j] == W && !i->s.initialising)
                d = 2.0 * START[W] * (unknown[k] == Z);
            result[k] += d * seed[j];
        }
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component p, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *i = p;
    if (FAULT("does not tell its time")) return fmi2Discard;
    *value = i->s.reached + (FAULT("tells a wrong time") ? 1e3 : 0.0);
    return kind == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component p, const fmi2StatusKind kind, fmi2Boolean *value) {
    return *value = 0, kind == fmi2Terminated ? fmi2OK : fmi2Discard;
}
#define NEVER(call, ...) \
    fmi2Status call(fmi2Component p, __VA_ARGS__) { return fmi2Error; }
#define REFS const fmi2ValueReference ref[], size_t n
NEVER(fmi2GetStatus, const fmi2StatusKind k, fmi2Status *value)
NEVER(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
NEVER(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
NEVER(fmi2GetBoolean, REFS, fmi2Boolean value[])
NEVER(fmi2GetString, REFS, fmi2String value[])
NEVER(fmi2SetInteger, REFS, const fmi2Integer value[])
NEVER(fmi2SetBoolean, REFS, const fmi2Boolean value[])
NEVER(fmi2SetString, REFS, const fmi2String value[])
NEVER(fmi2SetRealInputDerivatives, REFS, const fmi2Integer order[], const fmi2Real value[])
NEVER(fmi2GetRealOutputDerivatives, REFS, const fmi2Integer order[], fmi2Real value[])
fmi2Status fmi2SetDebugLogging(fmi2Component p, fmi2Boolean on, size_t n, const fmi2String names[]) {
    return fmi2OK;
}
fmi2Status fmi2CancelStep(fmi2Component p) { return fmi2Error; }
