/* x' = a x + b u, y = x, z = x + d u, and on request what goes wrong in FMUs of others.
   Names and causalities of the variables come as macros from the table in __init__.py. */

#ifdef __SSE2__
#include <xmmintrin.h>
#endif
#include <fenv.h>
#include <locale.h>
#include <math.h>
#ifndef _WIN32
#include <pthread.h>
#include <unistd.h>
#define PAUSE() pause()
#else
#include <direct.h>
#define PAUSE()
#endif
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#pragma clang diagnostic ignored "-Wunused-parameter"

#define SIZE 1024
#define ORDERS 3
#define SLACK(time) (1e-9 * fmax(1.0, fabs(time)))
#define BIT(mode) (1 << (mode))
#define ANY (BIT(FATAL) - 1)
#define LOG(status, ...) \
    c->host->logger(c->host->componentEnvironment, c->name, status, "all", __VA_ARGS__)
#define END(next, status, ...) \
    return (LOG(status, __VA_ARGS__), c->m.talks ? LOG(fmi2OK, "that was %s", __func__) : (void)0, \
            c->m.mode = next, status)
#define FAIL(...) END(FAILED, fmi2Error, __VA_ARGS__)
#define REJECT(ref, what) FAIL("%s: %s, reference %u, %s", __func__, what, ref, MODES[c->m.mode])
#define REFS const fmi2ValueReference ref[], size_t n
#define ENTER(modes) \
    Foreign *c = p; \
    if (c->m.mode == FATAL) return (note(c, "used after fatal"), fmi2Fatal); \
    if (!(BIT(c->m.mode) & (modes))) { \
        note(c, "refused"); \
        FAIL("%s while %s", __func__, MODES[c->m.mode]); \
    }
#define BLOCK(Type, Cell) \
    union { struct { Cell Type##_NAMES; }; Cell Type[sizeof (char[]){Type##_CAUSALITIES}]; }

typedef char Text[SIZE];
enum { OUTPUT, CAPABILITY, IDENTITY, PARAMETER, TUNABLE, INPUT };
enum { INSTANTIATED, INITIALIZING, STEPPING, DISCARDED, FAILED, TERMINATED, FATAL };
static const char *const MODES[] = {"instantiated", "initializing", "stepping",
                                    "discarded",    "failed",       "terminated"};
static int instances;
typedef struct {
    BLOCK(Real, fmi2Real);
    BLOCK(Integer, fmi2Integer);
    BLOCK(Boolean, fmi2Boolean);
    BLOCK(String, Text);
    int mode, dirty, u_is_set, ended;
    double x, time, first_step, du[ORDERS], dy[ORDERS], dz[ORDERS];
} Model;
typedef struct {
    Model m, start;
    Text name;
    const fmi2CallbackFunctions *host;
    double promise;
    int resets;
} Foreign;
static int later(double a, double b) { return a - b > SLACK(a); }
static void note(const Foreign *c, const char *event) {
    FILE *diary = *c->m.diary ? fopen(c->m.diary, "a") : NULL;
    if (diary) fprintf(diary, "%s %s\n", event, c->name), fclose(diary);
}

/* Exact for an input u + du[1] s + du[2] s^2/2, 0 < s < h. */
static void advance(Model *m, double h) {
    double z = m->a * h, series = 1.0;
    for (int n = 20; n > 3; n--) series = 1.0 + z / n * series;
    double phi3 = fabs(z) < 1.0 ? series / 6.0 : (expm1(z) - z - z * z / 2.0) / (z * z * z);
    double phi2 = 0.5 + z * phi3, phi1 = 1.0 + z * phi2;
    double mean = m->u * phi1 + h * (m->du[1] * phi2 + h * m->du[2] * phi3);
    m->x = m->x * exp(z) + m->b * h * mean;
    m->u += h * (m->du[1] + h / 2.0 * m->du[2]);
    m->du[1] += h * m->du[2];
    m->time += h;
}
static void show(Model *m) {
    m->y = later(m->nan_at, m->time) ? m->x : NAN;
    m->z = m->x + m->d * m->u;
    m->dy[1] = m->a * m->x + m->b * m->u, m->dy[2] = m->a * m->dy[1] + m->b * m->du[1];
    for (int n = 1; n < ORDERS; n++) m->dz[n] = m->dy[n] + m->d * m->du[n];
    m->integer_out = m->integer_in, m->boolean_out = m->boolean_in;
    m->enumeration_out = m->enumeration_in;
    strcpy(m->string_out, m->string_in);
    if (m->counts && m->first_step) {
        int n = m->integer_out = (int)lround((m->time - m->start_time) / m->first_step);
        m->boolean_out = n % 2, m->enumeration_out = (int[]){1, 2, 5}[n % 3];
        sprintf(m->string_out, "%d", n);
    }
    m->spelled = atoi(m->string_out);
}
static void look(Model *m) {
    if (m->mode == INITIALIZING) m->x = m->x0, show(m);
    if (m->mode == STEPPING && m->fresh) m->z = m->x + m->d * m->u;
}

/* What happens in the call that brings the time from `from` to `to`. */
static fmi2Status reach(Foreign *c, double from, double to) {
#define NOW(at) (later(c->m.at, from) && !later(c->m.at, to))
    if (NOW(crash_at)) *(volatile int *)NULL = 0;
    if (NOW(exit_at)) exit(3);
    if (NOW(hang_at)) for (note(c, "hangs");;) PAUSE();
    if (NOW(meddle_at) && !chdir("/")) setlocale(LC_ALL, "C"), signal(SIGINT, SIG_IGN);
    if (NOW(round_at)) fesetround(FE_UPWARD);
#ifdef __SSE2__
    if (NOW(flush_at)) _mm_setcsr(_mm_getcsr() | 0x8040); /* FTZ and DAZ */
#endif
    if (NOW(fatal_at)) END(FATAL, fmi2Fatal, "%s broke down at t = %g s", c->name, c->m.fatal_at);
    if (NOW(error_at)) FAIL("error at t = %g s, step %d", c->m.error_at, c->m.steps);
    if (NOW(warn_at)) END(c->m.mode, fmi2Warning, "t = %g s in %s", c->m.warn_at, c->name);
    return fmi2OK;
}

#ifndef _WIN32
static void *talk(void *p) {
    const Foreign *c = p;
    return LOG(fmi2Warning, "%s works in a thread of its own", c->name), NULL;
}
static void chat(Foreign *c) {
    pthread_t thread;
    pthread_create(&thread, NULL, talk, c), pthread_join(thread, NULL);
}
#else
static void chat(Foreign *c) {}
#endif

/* Replace the model by a saved one; what is counted goes on. */
static void restore(Foreign *c, const Model *saved) {
    Model old = c->m;
    c->m = *saved;
    c->m.steps = old.steps, c->m.restores = old.restores;
    c->m.live_states = old.live_states, c->m.gets_after_set = old.gets_after_set;
}

static FILE *resource(const char *uri, const char *name) {
    char path[2 * SIZE], *end = path;
    if (strncmp(uri, "file:", 5) || strlen(uri) > SIZE) return NULL;
    for (uri += strncmp(uri, "file:///", 8) ? 5 : 7; *uri; end++) {
        unsigned code = *uri++;
        if (code == '%' && sscanf(uri, "%2x", &code) == 1) uri += 2;
        *end = (char)code;
    }
    sprintf(end, "/%s", name);
    return fopen(path, "r");
}

static int load(Model *m, const char *uri) {
    FILE *start = resource(uri, "start.txt"), *token = resource(uri, "token.txt");
    Text kind, text;
    unsigned ref;
    if (!start || !token || !fgets(m->token, SIZE, token)) return 0;
    while (fscanf(start, "%1s %u %1023[^\n]", kind, &ref, text) == 3) {
        if (*kind == 'R') m->Real[ref] = atof(text);
        if (*kind == 'I') m->Integer[ref] = atoi(text);
        if (*kind == 'B') m->Boolean[ref] = atoi(text);
        if (*kind == 'S') strcpy(m->String[ref], text);
    }
    return fclose(token), fclose(start), 1;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *host, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Foreign *c = host->allocateMemory(1, sizeof *c);
    c->host = host, c->promise = -INFINITY;
    snprintf(c->name, SIZE, "%s", name);
    if (!load(&c->m, location)) LOG(fmi2Error, "%s finds no resources at %s", name, location);
    else if (strcmp(guid, c->m.guid)) LOG(fmi2Error, "the GUID %s is not %s", guid, c->m.guid);
    else if (type != fmi2CoSimulation) LOG(fmi2Error, "type %d is not co-simulation", (int)type);
    else if (instances && c->m.canBeInstantiatedOnlyOncePerProcess)
        LOG(fmi2Error, "%s must wait: instances alive = %d", name, instances);
    else return c->start = c->m, instances++, c;
    return host->freeMemory(c), NULL;
}

void fmi2FreeInstance(fmi2Component p) {
    Foreign *c = p;
    if (c->m.mode == FATAL) note(c, "used after fatal");
    if (c->m.live_states) note(c, "leaked states");
    if (c->m.hang_at_end && c->m.mode == TERMINATED) for (;;) PAUSE();
    note(c, "freed");
    instances--, c->host->freeMemory(c);
}

#define CALL(name, parameters, modes, ...) \
    fmi2Status fmi2##name parameters { ENTER(modes); return __VA_ARGS__, fmi2OK; }
CALL(SetupExperiment, (fmi2Component p, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                       fmi2Real start, fmi2Boolean stops, fmi2Real stop), BIT(INSTANTIATED),
     c->m.forgets ? restore(c, &c->start) : (void)0,
     c->m.tolerance_defined = tolerance_defined, c->m.tolerance = tolerance,
     c->m.stop_time_defined = stops, c->m.stop_time = stop, c->m.start_time = c->m.time = start)
fmi2Status fmi2EnterInitializationMode(fmi2Component p) {
    ENTER(BIT(INSTANTIATED));
    if (c->m.needs_stop && !c->m.stop_time_defined) FAIL("a stop time is needed");
    return c->m.mode = INITIALIZING, fmi2OK;
}
CALL(Terminate, (fmi2Component p), BIT(STEPPING) | BIT(DISCARDED),
     c->m.crash_at_end && (*(volatile int *)NULL = 0), c->m.mode = TERMINATED, note(c, "terminated"))
CALL(Reset, (fmi2Component p), ANY, restore(c, &c->start), c->promise = -INFINITY, c->resets++)
#define SAVES (c->m.canGetAndSetFMUstate ? ANY : 0)
CALL(GetFMUstate, (fmi2Component p, fmi2FMUstate *state), SAVES,
     *state || (c->m.live_states++, *state = c->host->allocateMemory(1, sizeof(Model))),
     memcpy(*state, &c->m, sizeof(Model)))
CALL(FreeFMUstate, (fmi2Component p, fmi2FMUstate *state), SAVES,
     c->m.live_states -= *state != NULL, c->host->freeMemory(*state), *state = NULL)

fmi2Status fmi2SetFMUstate(fmi2Component p, fmi2FMUstate state) {
    ENTER(SAVES);
    const Model *saved = state;
    if (c->m.commits && later(c->promise, saved->time))
        FAIL("return to t = %g s, but before %g s was excluded", saved->time, c->promise);
    return restore(c, saved), c->m.restores++, fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component p) {
    ENTER(BIT(INITIALIZING));
    if (c->m.needs_input && !c->m.u_is_set) FAIL("%s: u was not set while initializing", c->name);
    if (c->m.overrules) c->m.x0 = c->start.x0;
    if (c->m.wears && c->resets > 1) c->m.x0 += 1.0;
    look(&c->m);
    fmi2Status status = reach(c, -INFINITY, c->m.time);
    if (status <= fmi2Warning) c->m.mode = STEPPING;
    return status;
}

#define ASSIGN(cell, value) cell = value
#define COPY(cell, value) snprintf(cell, SIZE, "%s", value)
#define ACCESS(Type, PUT) \
    static const char Type##_CAUSALITY[] = {Type##_CAUSALITIES}; \
    fmi2Status fmi2Get##Type(fmi2Component p, REFS, fmi2##Type value[]) { \
        ENTER(ANY & ~BIT(INSTANTIATED)); \
        int output = 0; \
        look(&c->m); \
        for (size_t i = 0; i < n; i++) { \
            if (ref[i] >= sizeof Type##_CAUSALITY) REJECT(ref[i], "no such variable"); \
            output |= Type##_CAUSALITY[ref[i]] == OUTPUT; \
            value[i] = c->m.Type[ref[i]]; \
        } \
        return c->m.gets_after_set += output && c->m.dirty, fmi2OK; \
    } \
    fmi2Status fmi2Set##Type(fmi2Component p, REFS, const fmi2##Type value[]) { \
        ENTER(BIT(INSTANTIATED) | BIT(INITIALIZING) | BIT(STEPPING)); \
        for (size_t i = 0; i < n; i++) { \
            if (ref[i] >= sizeof Type##_CAUSALITY) REJECT(ref[i], "no such variable"); \
            if (Type##_CAUSALITY[ref[i]] < (c->m.mode < STEPPING ? PARAMETER : TUNABLE)) \
                REJECT(ref[i], "cannot be set"); \
            PUT(c->m.Type[ref[i]], value[i]); \
            c->m.u_is_set |= c->m.mode == INITIALIZING && (void *)&c->m.Type[ref[i]] == &c->m.u; \
        } \
        return c->m.dirty = c->m.mode >= STEPPING, fmi2OK; \
    }
ACCESS(Real, ASSIGN)
ACCESS(Integer, ASSIGN)
ACCESS(Boolean, ASSIGN)
ACCESS(String, COPY)
#define REAL(name) (fmi2ValueReference)(&c->m.name - c->m.Real)

fmi2Status fmi2SetRealInputDerivatives(fmi2Component p, REFS, const fmi2Integer order[],
                                       const fmi2Real value[]) {
    ENTER(BIT(INITIALIZING) | BIT(STEPPING));
    if (!c->m.canInterpolateInputs) FAIL("inputs are not interpolated");
    for (size_t i = 0; i < n; i++) {
        if (ref[i] != REAL(u)) REJECT(ref[i], "no Real input");
        if (order[i] < 1 || order[i] >= ORDERS) FAIL("u has no derivative of order %d", order[i]);
        c->m.du[order[i]] = value[i];
    }
    return c->m.dirty = c->m.mode >= STEPPING, fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component p, REFS, const fmi2Integer order[],
                                        fmi2Real value[]) {
    ENTER(BIT(STEPPING) | BIT(DISCARDED));
    for (size_t i = 0; i < n; i++) {
        if (ref[i] != REAL(y) && ref[i] != REAL(z)) REJECT(ref[i], "no derivatives");
        if (order[i] < 1 || order[i] > c->m.maxOutputDerivativeOrder)
            FAIL("derivative of order %d, at most %d", order[i], c->m.maxOutputDerivativeOrder);
        value[i] = ref[i] == REAL(y) ? c->m.dy[order[i]] : c->m.dz[order[i]];
    }
    return c->m.gets_after_set += c->m.dirty, fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component p, fmi2Real t, fmi2Real h, fmi2Boolean final) {
    ENTER(BIT(STEPPING));
    Model *m = &c->m;
    double size = h;
    m->mode = STEPPING, m->steps++;
    if (!(h > 0.0)) FAIL("the step size h = %g s must be above 0", h);
    if (!(fabs(t - m->time) <= SLACK(t))) FAIL("step from t = %g s, not %g s", t, m->time);
    if (m->stop_time_defined && (m->punctual ? t + h > m->stop_time : later(t + h, m->stop_time)))
        FAIL("step to t = %g s, beyond the stop time %g s", t + h, m->stop_time);
    if (m->first_step == 0.0) m->first_step = h;
    if (!m->canHandleVariableCommunicationStepSize && fabs(h / m->first_step - 1.0) > 1e-9)
        FAIL("the step size h = %.12g s differs from the first one, %.12g s", h, m->first_step);
    if (final) c->promise = t;
    m->time = t;
    if (h > m->longest_step * (1.0 + 1e-9)) size = m->stubborn ? 0.0 : m->longest_step;
    if (later(m->pause_at, t) && later(t + size, m->pause_at)) size = m->pause_at - t;
    if (later(t + size, m->end_at)) size = fmax(m->end_at - t, 0.0);
    m->ended = !later(m->end_at, t + size);
    fmi2Status status = reach(c, t, t + size);
    if (status > fmi2Warning) return status;
    if (m->chats) chat(c);
    if (m->commits && !final) m->time += size, m->dirty = 0;
    else if (size > 0.0) {
        int ahead = m->runs_ahead && m->stop_time_defined;
        advance(m, !ahead ? size : m->steps == 1 ? m->stop_time - t : 0.0);
        m->time = t + size, show(m);
        if (size > m->nan_above) m->y = NAN;
        m->du[1] = m->du[2] = 0.0, m->dirty = 0, m->last_step = size;
    }
    if (size == h) return status;
    END(DISCARDED, fmi2Discard, "step %d ends at t = %g s, not at %g s", m->steps, m->time, t + h);
}

#define STATUS_OF(Type, offered, field) \
    fmi2Status fmi2Get##Type##Status(fmi2Component p, const fmi2StatusKind kind, fmi2##Type *to) { \
        return *to = ((Foreign *)p)->m.field, kind == offered ? fmi2OK : fmi2Discard; \
    }
STATUS_OF(Real, fmi2LastSuccessfulTime, time)
STATUS_OF(Boolean, fmi2Terminated, ended)
#define NEVER(status, call, ...) fmi2Status call(fmi2Component p, __VA_ARGS__) { return status; }
NEVER(fmi2Discard, fmi2GetStatus, const fmi2StatusKind k, fmi2Status *value)
NEVER(fmi2Discard, fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
NEVER(fmi2Discard, fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
NEVER(fmi2Error, fmi2GetDirectionalDerivative, REFS, const fmi2ValueReference inputs[],
      size_t knowns, const fmi2Real seed[], fmi2Real value[])
NEVER(fmi2Error, fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
NEVER(fmi2Error, fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
NEVER(fmi2Error, fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
NEVER(fmi2OK, fmi2SetDebugLogging, fmi2Boolean on, size_t n, const fmi2String categories[])
fmi2Status fmi2CancelStep(fmi2Component p) { return fmi2Error; }
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
