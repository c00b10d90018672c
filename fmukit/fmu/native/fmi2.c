/* FMI 2.0 over one array of values; the generated file of a component includes this. An instance is
   for co-simulation or for model exchange.

   The rules and messages are those of fmukit/fmu/python/instance.py. All values, Integers and Booleans
   too, are doubles at the index of their value reference; the parameters come first. */

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

/* A length for arrays that may have no elements, which C does not allow. */
#define ARRAY_LENGTH(n) ((n) + !(n))

/* Numbers of an input trajectory: start, end, duration, degree, coefficients. */
#define TRAJECTORY_SIZE (2 * INPUTS + 2 + (HIGHEST_DEGREE - 1) * INPUTS)

#ifdef FMI3 /* which is built of these functions: fmi3.c */
#define API(name) name
#ifdef __GNUC__
#define EXPORT __attribute__((unused)) static
#else
#define EXPORT static
#endif
#elif defined(FMI2_FUNCTION_PREFIX)
#define PASTED(a, b) a##b
#define PASTE(a, b) PASTED(a, b)
#define API(name) PASTE(FMI2_FUNCTION_PREFIX, name)
#define EXPORT
#else
#define API(name) name
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#endif

#ifdef __GNUC__
#define INLINE static inline __attribute__((always_inline))
#define NOINLINE __attribute__((noinline)) /* so that the short way beside it needs no registers */
#define COLD __attribute__((cold, noinline))
#define UNLIKELY(condition) __builtin_expect(condition, 0)
#else
#define INLINE static inline
#define NOINLINE
#define COLD
#define UNLIKELY(condition) (condition)
#endif

#ifndef FMI3
enum { FORMATS = 1, EVENTS_IN_STEPS = 0 };
#define UPDATE "newDiscreteStates"
#define RATES "getDerivatives"
#endif

enum { TEXT_SIZE = 4096, NOTE_RESERVE = 64, NUMBER_SIZE = 32, LIMBS = 36 };
enum { COSIMULATION, EXCHANGE, EITHER };
enum { INSTANTIATED, INITIALIZING, STEPPING, AT_EVENT, INTEGRATING, TERMINATED, FAILED };

static const char *const KINDS[] = {"co-simulation", "model exchange"};
static const char *const PHASES[] = {
    "before initialisation", "in initialisation mode", "after initialisation", "in event mode",
    "in continuous-time mode", "after terminate", "after a failure (reset the instance first)",
};

typedef struct {
    const char *name, *unit, *kind, *causality, *variability;
    int settable_before_start;
    double start, least, most;
} Variable;

typedef struct {
    int index; /* among the states */
    double nominal;
} Continuous;

/* A natural number: 36 pieces of 32 bits have room for ten times the largest double, and for ten times
   what the smallest one takes over a common denominator. */
typedef struct {
    uint32_t limbs[LIMBS];
} Big;

/* What an equation reports: why it has no value, and sentences for the log. Where it has no value for
   a state that an integrator tries, that state is discarded. */
typedef struct {
    int failed, discarded, dropped;
    const char *why; /* the reason, where it is one without numbers */
    size_t reason_length, notes_length;
    char reason[TEXT_SIZE], notes[TEXT_SIZE];
} Context;

/* Everything that evolves. */
typedef struct {
    double values[VARIABLES], before[ARRAY_LENGTH(INPUTS)], end[ARRAY_LENGTH(INPUTS)], slopes[ARRAY_LENGTH(INPUTS)];
    double rates[HIGHEST_DEGREE][ARRAY_LENGTH(INPUTS)];
    double time, past, stale, unchecked, phase, driven, kind, events;
} State;

typedef struct {
    size_t size; /* of the bytes of a state that is not sound */
    int sound;
    State state;
    unsigned char bytes[];
} Saved;

typedef struct {
    Context context;
    State state;
    fmi2CallbackLogger logger;
    fmi2CallbackAllocateMemory allocate;
    fmi2CallbackFreeMemory release;
    fmi2ComponentEnvironment environment;
    int logging, kind;
    char name[];
} Instance;

static const Variable variables[VARIABLES];
static const Continuous continuous[ARRAY_LENGTH(DERIVATIVES)];
static void model_check(Context *c, const double *p);
static void model_check_start(Context *c, const double *p);
static void model_begin(Context *c, const double *p, double t, const double *x, const double *now,
                        double *result);
static void model_input_trajectory(Context *c, double hold, const double *before, const double *now,
                         double past, double h, double *result);
static void model_step(Context *c, const double *p, double t, const double *x,
                       const double *before, const double *now, const double *inputs,
                       double *result);
static void model_outputs(Context *c, const double *p, double t, const double *x, const double *u,
                          double *result);
static void model_initial(Context *c, const double *p, double t, const double *x, const double *u,
                          double *result);
static void model_directional(Context *c, const double *p, double t, const double *x,
                              const double *u, const double *d_p, double d_t, const double *d_x,
                              const double *d_u, double *result);
static void model_derivatives(Context *c, const double *p, double t, const double *x,
                              const double *u, double *result);
static void model_event_indicators(Context *c, const double *p, double t, const double *x, const double *u,
                         double *result);
static void model_event(Context *c, const double *p, double t, const double *x,
                        const double *before, const double *now, double which, double *result);
static void model_tangents(Context *c, const double *p, double t, const double *x, const double *u,
                           const double *d_p, double d_t, const double *d_x, const double *d_u,
                           double *result);

INLINE int is_finite(double value) { return fabs(value) <= DBL_MAX; }

#include "fmi2_context.c"
#include "fmi2_instance.c"

/* Get and set values of any kind; a Boolean and an Integer are stored alike. */
NOINLINE static fmi2Status get(Instance *i, const char *kind, const fmi2ValueReference vr[],
                            size_t n, void *values) {
    fmi2Real *reals = values;
    fmi2Integer *integers = values;
    if (!i) return fmi2Error;
    if (!require_type_and_refresh(i, kind, vr, n)) return finish(i);
    for (size_t k = 0; k < n; k++) {
        if (*kind == 'R')
            reals[k] = i->state.values[vr[k]];
        else
            integers[k] = (fmi2Integer)i->state.values[vr[k]];
    }
    return finish(i);
}

NOINLINE static fmi2Status set(Instance *i, const char *kind, const fmi2ValueReference vr[],
                            size_t n, const void *values) {
    const fmi2Real *reals = values;
    const fmi2Integer *integers = values;
    if (!i) return fmi2Error;
    for (size_t k = 0; k < n; k++) {
        double value = *kind == 'R' ? reals[k] : *kind == 'B' ? integers[k] != 0 : integers[k];
        if (!may_set(i, kind, vr[k], value)) break;
        i->state.values[vr[k]] = value;
        if (i->state.phase > INITIALIZING && is_tunable(vr[k])) i->state.stale = i->state.unchecked = 1.0;
    }
    if (i->state.phase != STEPPING) i->state.stale = 1.0;
    return finish(i);
}

#define GET(Kind)                                                                              \
    EXPORT fmi2Status API(fmi2Get##Kind)(fmi2Component component, const fmi2ValueReference vr[],      \
                                  size_t n, fmi2##Kind value[]) {                              \
        Instance *i = component;                                                               \
        size_t k = 0;                                                                          \
        for (; i && k < n && is_up_to_date(&i->state, #Kind, vr[k]); k++)                            \
            value[k] = (fmi2##Kind)i->state.values[vr[k]];                                     \
        return i && k == n ? fmi2OK : get(i, #Kind, vr, n, value);                             \
    }

#define SET(Kind, stored)                                                                      \
    EXPORT fmi2Status API(fmi2Set##Kind)(fmi2Component component, const fmi2ValueReference vr[],      \
                                  size_t n, const fmi2##Kind value[]) {                        \
        Instance *i = component;                                                               \
        size_t k = 0;                                                                          \
        for (; i && k < n && is_plain_input(&i->state, #Kind, vr[k], stored); k++)                   \
            i->state.values[vr[k]] = stored;                                                   \
        return i && k == n ? fmi2OK : set(i, #Kind, vr, n, value);                             \
    }

GET(Real)
GET(Integer)
GET(Boolean)
SET(Real, value[k])
SET(Integer, value[k])
SET(Boolean, value[k] ? 1.0 : 0.0)

/* There are no Strings. */
EXPORT fmi2Status API(fmi2GetString)(fmi2Component component, const fmi2ValueReference vr[], size_t n,
                              fmi2String value[]) {
    Instance *i = component;
    (void)value;
    if (!i) return fmi2Error;
    require_type_and_refresh(i, "String", vr, n);
    return finish(i);
}

EXPORT fmi2Status API(fmi2SetString)(fmi2Component component, const fmi2ValueReference vr[], size_t n,
                              const fmi2String value[]) {
    Instance *i = component;
    (void)value;
    if (!i) return fmi2Error;
    if (n) variable(&i->context, "String", vr[0]);
    return finish(i);
}

EXPORT const char *API(fmi2GetTypesPlatform)(void) { return fmi2TypesPlatform; }

EXPORT const char *API(fmi2GetVersion)(void) { return "2.0"; }

EXPORT fmi2Status API(fmi2SetDebugLogging)(fmi2Component component, fmi2Boolean on, size_t n,
                                    const fmi2String categories[]) {
    Instance *i = component;
    if (!i) return fmi2Error;
    i->logging = on && !n;
    for (size_t k = 0; on && k < n; k++)
        if (!strcmp(categories[k], "logStatusWarning") || !strcmp(categories[k], "logAll"))
            i->logging = 1;
    return fmi2OK;
}

EXPORT fmi2Component API(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid,
                                   fmi2String resources, const fmi2CallbackFunctions *functions,
                                   fmi2Boolean visible, fmi2Boolean logging) {
    char text[TEXT_SIZE];
    size_t length = 0;
    const char *instance_name = name ? name : "";
    Instance *i;
    (void)resources, (void)visible;
    if (!functions || !functions->allocateMemory || !functions->freeMemory) return NULL;
    if (!*instance_name)
        append_text(text, &length, "an instance must have a name");
    else if (type != fmi2CoSimulation && !MODEL_EXCHANGE)
        append_text(text, &length, IDENTIFIER " is for co-simulation, not for model exchange");
    else if (!guid || strcmp(guid, GUID)) {
        append_text(text, &length, "guid ");
        append_text(text, &length, guid ? guid : "");
        append_text(text, &length, " is not that of this build, " GUID);
    } else if (!(i = functions->allocateMemory(1, sizeof *i + strlen(instance_name) + 1))) {
        append_text(text, &length, "no memory for an instance");
    } else {
        strcpy(i->name, instance_name);
        i->logger = functions->logger;
        i->allocate = functions->allocateMemory;
        i->release = functions->freeMemory;
        i->environment = functions->componentEnvironment;
        i->logging = logging;
        i->kind = type == fmi2CoSimulation ? COSIMULATION : EXCHANGE;
        reset_instance(i);
        return i;
    }
    log_message(functions->logger, functions->componentEnvironment, instance_name, fmi2Error, "logStatusError",
         text);
    return NULL;
}

EXPORT void API(fmi2FreeInstance)(fmi2Component component) {
    Instance *i = component;
    if (i) i->release(i);
}

EXPORT fmi2Status API(fmi2SetupExperiment)(fmi2Component component, fmi2Boolean tolerance_defined,
                                    fmi2Real tolerance, fmi2Real start, fmi2Boolean stop_defined,
                                    fmi2Real stop) {
    Instance *i = component;
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    if (!i) return fmi2Error;
    if (allowed(i, "setupExperiment", EITHER, INSTANTIATED, INSTANTIATED)) {
        if (is_finite(start))
            i->state.time = start;
        else
            fail(&i->context, "start time = %r s must be a finite number", start);
    }
    return finish(i);
}

EXPORT fmi2Status API(fmi2EnterInitializationMode)(fmi2Component component) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (allowed(i, "enterInitializationMode", EITHER, INSTANTIATED, INSTANTIATED))
        i->state.phase = INITIALIZING;
    return finish(i);
}

EXPORT fmi2Status API(fmi2ExitInitializationMode)(fmi2Component component) {
    Instance *i = component;
    State *s;
    double *x, *now, result[ARRAY_LENGTH(STATES)];
    if (!i) return fmi2Error;
    s = &i->state, x = values_from(i, FIRST_STATE), now = values_from(i, FIRST_INPUT);
    if (allowed(i, "exitInitializationMode", EITHER, INITIALIZING, INITIALIZING)) refresh(i);
    if (!i->context.failed) {
        model_check_start(&i->context, s->values);
        model_check(&i->context, s->values);
        model_begin(&i->context, s->values, s->time, x, now, result);
    }
    if (!i->context.failed) {
        memcpy(x, result, STATES * sizeof *x);
        memcpy(s->before, now, INPUTS * sizeof *now);
        s->phase = i->kind == EXCHANGE ? AT_EVENT : STEPPING;
        s->stale = 1.0;
    }
    return finish(i);
}

EXPORT fmi2Status API(fmi2Terminate)(fmi2Component component) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (allowed(i, "terminate", EITHER, STEPPING, INTEGRATING)) i->state.phase = TERMINATED;
    return finish(i);
}

EXPORT fmi2Status API(fmi2Reset)(fmi2Component component) {
    Instance *i = component;
    if (!i) return fmi2Error;
    reset_instance(i);
    return fmi2OK;
}

/* The inputs over the next step as fmukit/runtime/hybrid.py describes them, and their slopes at its end. The
   polynomial of the derivatives given, a_n s^n, is the line between its ends and s (s - h) times
   the sum of a_n h^(n-2-j) s^j over n >= 2 and j <= n - 2. */
static void input_trajectory(Instance *i, double h, double *inputs, double *slopes) {
    State *s = &i->state;
    double *now = values_from(i, FIRST_INPUT), *coefficients = inputs + 2 * INPUTS + 2;
    if (s->driven == 0.0) {
        model_input_trajectory(&i->context, s->values[INPUT_HOLD], s->before, now, s->past, h, inputs);
        for (int k = 0; k < INPUTS; k++) slopes[k] = (inputs[INPUTS + k] - inputs[k]) / h;
        return;
    }
    memset(inputs, 0, TRAJECTORY_SIZE * sizeof *inputs);
    for (int k = 0; k < INPUTS; k++) {
        double a[HIGHEST_DEGREE + 1] = {now[k]}, factorial = 1.0;
        inputs[k] = inputs[INPUTS + k] = now[k];
        slopes[k] = 0.0;
        for (int n = 1; n <= (int)s->driven; n++) {
            a[n] = s->rates[n - 1][k] / (factorial *= n);
            if (a[n] != 0.0) inputs[INPUTS + k] += a[n] * pow(h, n);
            slopes[k] += n * a[n] * pow(h, n - 1);
        }
        for (int j = 0; j <= (int)s->driven - 2; j++)
            for (int n = j + 2; n <= (int)s->driven; n++)
                coefficients[j * INPUTS + k] += a[n] * pow(h, n - 2 - j);
    }
    inputs[2 * INPUTS] = h;
    inputs[2 * INPUTS + 1] = s->driven;
}

/* Say in the reason of a failure when and where it was. */
COLD static void add_context_to_reason(Instance *i, const char *what, double t) {
    char reason[TEXT_SIZE];
    strcpy(reason, i->context.why ? i->context.why : i->context.reason);
    i->context.reason_length = 0;
    i->context.why = NULL;
    append(&i->context, "%s t = %r s: %s", what, t, reason);
    for (int k = 0; k < INPUTS + STATES; k++) {
        const Variable *v = &variables[FIRST_INPUT + k];
        append(&i->context, "%s%s = %v", k ? ", " : "; ", v->name, v,
               i->state.values[FIRST_INPUT + k]);
    }
}

/* Whether a step of h from t is in order. */
static int may_step(Instance *i, double t, double h) {
    const double time = i->state.time;
    if (!allowed(i, "doStep", COSIMULATION, STEPPING, STEPPING)) return 0;
    if (!(h > 0.0 && h <= DBL_MAX))
        fail(&i->context, "communication step = %r s must be a finite number above 0", h);
    else if (!(fabs(t - time) <= 1e-3 * h + 1e-9 * fabs(time)))
        fail(&i->context, "communication point = %r s must be %r s, no jump", t, time);
    return check_changed_parameters(i);
}

EXPORT fmi2Status API(fmi2DoStep)(fmi2Component component, fmi2Real t, fmi2Real h, fmi2Boolean final) {
    Instance *i = component;
    Context *c;
    State *s;
    double *x, *now, inputs[TRAJECTORY_SIZE], slopes[ARRAY_LENGTH(INPUTS)], result[ARRAY_LENGTH(STATES)];
    (void)final;
    if (!i) return fmi2Error;
    c = &i->context, s = &i->state, x = values_from(i, FIRST_STATE), now = values_from(i, FIRST_INPUT);
    if (!may_step(i, t, h)) return finish(i);
    input_trajectory(i, h, inputs, slopes);
    model_step(c, s->values, t, x, s->before, now, inputs, result);
    for (int k = 0; k < STATES; k++) check_finite(c, &variables[FIRST_STATE + k], result[k]);
    if (c->failed) {
        add_context_to_reason(i, "step from", t);
        return finish(i);
    }
    memcpy(s->slopes, slopes, INPUTS * sizeof *slopes);
    memcpy(x, result, STATES * sizeof *x);
    memcpy(s->before, now, INPUTS * sizeof *now);
    memcpy(s->end, inputs + INPUTS, INPUTS * sizeof *inputs);
    s->time = t + h, s->past = h, s->stale = 1.0, s->driven = 0.0;
    return finish(i);
}

static int require_order(Context *c, const fmi2Integer order[], size_t n, int highest) {
    for (size_t k = 0; k < n; k++)
        if (order[k] < 1 || order[k] > highest)
            fail(c, "derivatives are of order 1 to %d, not %d", (double)highest, (double)order[k]);
    return !c->failed;
}

/* Derivatives of the inputs over the next step; where some are given, the others are 0. */
EXPORT fmi2Status API(fmi2SetRealInputDerivatives)(fmi2Component component,
                                            const fmi2ValueReference vr[], size_t n,
                                            const fmi2Integer order[], const fmi2Real value[]) {
    Instance *i = component;
    State *s;
    if (!i) return fmi2Error;
    s = &i->state;
    if (i->kind == EXCHANGE)
        refuse_call(i, "setRealInputDerivatives", COSIMULATION, INSTANTIATED, STEPPING);
    if (!require_order(&i->context, order, n, HIGHEST_DEGREE)) return finish(i);
    for (size_t k = 0; k < n; k++) {
        const Variable *v = variable(&i->context, "Real", vr[k]);
        if (!v) return finish(i);
        if (!is_input(vr[k]) || s->phase > STEPPING) {
            fail(&i->context, "the derivative of %s cannot be set: %s %s, %s", v->name,
                 v->variability, v->causality, PHASES[(int)s->phase]);
            return finish(i);
        }
        derivative(&i->context, v, value[k]);
        if (i->context.failed) return finish(i);
        if (s->driven == 0.0) memset(s->rates, 0, sizeof s->rates);
        if (s->driven < order[k]) s->driven = order[k];
        s->rates[order[k] - 1][vr[k] - FIRST_INPUT] = value[k];
    }
    return finish(i);
}

EXPORT fmi2Status API(fmi2GetRealOutputDerivatives)(fmi2Component component,
                                             const fmi2ValueReference vr[], size_t n,
                                             const fmi2Integer order[], fmi2Real value[]) {
    Instance *i = component;
    State *s;
    double d[VARIABLES] = {0}, dx[ARRAY_LENGTH(DERIVATIVES)], result[ARRAY_LENGTH(VARIABLES - FIRST_STATE)];
    if (!i) return fmi2Error;
    s = &i->state;
    if (!allowed(i, "getRealOutputDerivatives", COSIMULATION, STEPPING, STEPPING) ||
        !require_order(&i->context, order, n, 1))
        return finish(i);
    model_derivatives(&i->context, s->values, s->time, values_from(i, FIRST_STATE), s->end, dx);
    for (int k = 0; k < DERIVATIVES; k++) d[FIRST_STATE + continuous[k].index] = dx[k];
    model_tangents(&i->context, s->values, s->time, values_from(i, FIRST_STATE), s->end, d, 1.0,
                   d + FIRST_STATE, s->slopes, result);
    for (size_t k = 0; k < n && !i->context.failed; k++) {
        const Variable *v = variable(&i->context, "Real", vr[k]);
        if (v && strcmp(v->causality, "output"))
            fail(&i->context, "%s is not an output", v->name);
        else if (v)
            value[k] = derivative(&i->context, v, result[vr[k] - FIRST_STATE]);
    }
    return finish(i);
}

EXPORT fmi2Status API(fmi2GetDirectionalDerivative)(fmi2Component component,
                                             const fmi2ValueReference unknown[], size_t n_unknown,
                                             const fmi2ValueReference knowns[], size_t n_knowns,
                                             const fmi2Real seed[], fmi2Real sensitivity[]) {
    Instance *i = component;
    Context *c;
    State *s;
    double d[VARIABLES] = {0}, result[ARRAY_LENGTH(VARIABLES - FIRST_STATE)];
    if (!i) return fmi2Error;
    c = &i->context, s = &i->state;
    if (!allowed(i, "getDirectionalDerivative", EITHER, INITIALIZING, INTEGRATING))
        return finish(i);
    refresh_initial(i);
    for (size_t k = 0; k < n_knowns && !c->failed; k++) {
        const Variable *v = variable(c, "Real", knowns[k]);
        if (v && !(s->phase == INITIALIZING ? v->settable_before_start
                   : is_input(knowns[k]) || (i->kind == EXCHANGE && is_integrated(knowns[k]))))
            fail(c, "there is no derivative by %s %s", v->name, PHASES[(int)s->phase]);
        else if (v)
            d[knowns[k]] += seed[k];
    }
    if (!c->failed && (i->kind == COSIMULATION || s->phase == INITIALIZING))
        model_directional(c, s->values, s->time, values_from(i, FIRST_STATE), s->end, d, 0.0,
                          d + FIRST_STATE, d + FIRST_INPUT, result);
    else if (!c->failed)
        model_tangents(c, s->values, s->time, values_from(i, FIRST_STATE), current_inputs(i), d, 0.0,
                       d + FIRST_STATE, d + FIRST_INPUT, result);
    mark_discardable(i);
    for (size_t k = 0; k < n_unknown && !c->failed; k++) {
        const Variable *v = variable(c, "Real", unknown[k]);
        if (v && unknown[k] < FIRST_STATE)
            fail(c, "%s is not an output", v->name);
        else if (v)
            sensitivity[k] = derivative(c, v, result[unknown[k] - FIRST_STATE]);
    }
    return finish(i);
}

/* Model exchange. */

EXPORT fmi2Status API(fmi2EnterEventMode)(fmi2Component component) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (allowed(i, "enterEventMode", EXCHANGE, AT_EVENT, INTEGRATING))
        i->state.phase = AT_EVENT, i->state.events = 0.0;
    return finish(i);
}

/* Apply new inputs, or the event of the first indicator that is negative. */
static void update(Instance *i, fmi2EventInfo *info) {
    Context *c = &i->context;
    State *s = &i->state;
    double *x = values_from(i, FIRST_STATE), *now = values_from(i, FIRST_INPUT), result[ARRAY_LENGTH(STATES)];
    const int is_new = memcmp(s->before, now, INPUTS * sizeof *now) != 0;
    const int which = is_new ? -1 : first_negative_indicator(i);
    if (!c->failed && (is_new || which >= 0)) {
        if (++s->events > MOST_EVENTS)
            fail(c, "more than %d events, the last at %r s", (double)MOST_EVENTS, s->time);
        model_event(c, s->values, s->time, x, s->before, now, which, result);
        for (int k = 0; k < STATES; k++) check_finite(c, &variables[FIRST_STATE + k], result[k]);
        for (int k = 0; k < DERIVATIVES && !c->failed; k++)
            if (result[continuous[k].index] != x[continuous[k].index])
                info->valuesOfContinuousStatesChanged = fmi2True;
        if (!c->failed) memcpy(x, result, STATES * sizeof *x);
        memcpy(s->before, now, INPUTS * sizeof *now);
        s->stale = 1.0;
        info->newDiscreteStatesNeeded = first_negative_indicator(i) >= 0;
    }
    if (c->failed) add_context_to_reason(i, "event at", s->time);
}

EXPORT fmi2Status API(fmi2NewDiscreteStates)(fmi2Component component, fmi2EventInfo *info) {
    Instance *i = component;
    if (!i || !info) return fmi2Error;
    memset(info, 0, sizeof *info);
    if (allowed(i, UPDATE, EVENTS_IN_STEPS ? EITHER : EXCHANGE, AT_EVENT, AT_EVENT)) update(i, info);
    return finish(i);
}

EXPORT fmi2Status API(fmi2EnterContinuousTimeMode)(fmi2Component component) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (allowed(i, "enterContinuousTimeMode", EXCHANGE, AT_EVENT, AT_EVENT))
        i->state.phase = INTEGRATING;
    return finish(i);
}

/* A negative indicator is an event that the importer has missed. */
EXPORT fmi2Status API(fmi2CompletedIntegratorStep)(fmi2Component component, fmi2Boolean final,
                                            fmi2Boolean *event, fmi2Boolean *terminate) {
    Instance *i = component;
    (void)final;
    if (!i || !event || !terminate) return fmi2Error;
    *event = *terminate = fmi2False;
    if (allowed(i, "completedIntegratorStep", EXCHANGE, INTEGRATING, INTEGRATING))
        *event = first_negative_indicator(i) >= 0;
    return finish(i);
}

EXPORT fmi2Status API(fmi2SetTime)(fmi2Component component, fmi2Real time) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (!allowed(i, "setTime", EXCHANGE, AT_EVENT, INTEGRATING)) return finish(i);
    if (!is_finite(time)) fail(&i->context, "time = %r s must be a finite number", time);
    mark_discardable(i);
    if (!i->context.failed) i->state.time = time, i->state.stale = 1.0;
    return finish(i);
}

static int require_length(Instance *i, const char *call, size_t n, size_t count) {
    if (n != count)
        fail(&i->context, "%s takes all %d values at once, not %d", call, (double)count, (double)n);
    return !i->context.failed;
}

EXPORT fmi2Status API(fmi2SetContinuousStates)(fmi2Component component, const fmi2Real x[],
                                        size_t n) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (!allowed(i, "setContinuousStates", EXCHANGE, AT_EVENT, INTEGRATING) ||
        !require_length(i, "setContinuousStates", n, DERIVATIVES))
        return finish(i);
    for (size_t k = 0; k < n; k++)
        check_finite(&i->context, &variables[FIRST_STATE + continuous[k].index], x[k]);
    mark_discardable(i);
    for (size_t k = 0; k < n && !i->context.failed; k++)
        values_from(i, FIRST_STATE)[continuous[k].index] = x[k];
    i->state.stale = 1.0;
    return finish(i);
}

/* Getters of all there are. */
#define GET_ALL(Name, name, count, first, what)                                                \
    EXPORT fmi2Status API(fmi2Get##Name)(fmi2Component component, fmi2Real value[], size_t n) { \
        Instance *i = component;                                                               \
        if (!i) return fmi2Error;                                                              \
        if (allowed(i, name, EXCHANGE, first, TERMINATED) && require_length(i, name, n, count))     \
            what;                                                                              \
        return finish(i);                                                                      \
    }

/* An importer looks for a change of sign; an indicator at zero has not triggered. */
static void get_event_indicators(Instance *i, double *value) {
    event_indicators(i, value);
    for (int k = 0; k < INDICATORS; k++)
        if (value[k] == 0.0) value[k] = DBL_MIN;
}

static void continuous_states(Instance *i, double *value) {
    refresh_initial(i);
    for (int k = 0; k < DERIVATIVES; k++) value[k] = values_from(i, FIRST_STATE)[continuous[k].index];
}

static void nominals(double *value) {
    for (int k = 0; k < DERIVATIVES; k++) value[k] = continuous[k].nominal;
}

GET_ALL(Derivatives, RATES, DERIVATIVES, INITIALIZING, compute_derivatives(i, value))
GET_ALL(EventIndicators, "getEventIndicators", INDICATORS, INITIALIZING, get_event_indicators(i, value))
GET_ALL(ContinuousStates, "getContinuousStates", DERIVATIVES, INITIALIZING, continuous_states(i, value))
GET_ALL(NominalsOfContinuousStates, "getNominalsOfContinuousStates", DERIVATIVES, INSTANTIATED, nominals(value))

#include "fmi2_state.c"

/* No step runs asynchronously, so that there is no status but one. */

EXPORT fmi2Status API(fmi2CancelStep)(fmi2Component component) {
    Instance *i = component;
    if (!i) return fmi2Error;
    log_message(i->logger, i->environment, i->name, fmi2Error, "logStatusError",
         "cancelStep is not allowed: no step is under way");
    return fmi2Error;
}

EXPORT fmi2Status API(fmi2GetRealStatus)(fmi2Component component, const fmi2StatusKind kind,
                                  fmi2Real *value) {
    Instance *i = component;
    if (!i || kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = i->state.time;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2GetBooleanStatus)(fmi2Component component, const fmi2StatusKind kind,
                                     fmi2Boolean *value) {
    if (!component || kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2GetStatus)(fmi2Component component, const fmi2StatusKind kind,
                              fmi2Status *value) {
    (void)component, (void)kind, (void)value;
    return fmi2Discard;
}

EXPORT fmi2Status API(fmi2GetIntegerStatus)(fmi2Component component, const fmi2StatusKind kind,
                                     fmi2Integer *value) {
    (void)component, (void)kind, (void)value;
    return fmi2Discard;
}

EXPORT fmi2Status API(fmi2GetStringStatus)(fmi2Component component, const fmi2StatusKind kind,
                                    fmi2String *value) {
    (void)component, (void)kind, (void)value;
    return fmi2Discard;
}
