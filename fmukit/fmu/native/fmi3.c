/* FMI 3.0 from the functions of fmi2.c: the generated file of a component includes this instead.

   What FMI 3.0 has more: event mode and early return in co-simulation, and outputs within a step. The
   event indicators and time follow the other variables. */

#include <stdbool.h>

#include "fmi3FunctionTypes.h"

#define FMI3
enum { FORMATS = 0, EVENTS_IN_STEPS = 1 };
#define UPDATE "updateDiscreteStates"
#define RATES "getContinuousStateDerivatives"
#include "fmi2.c"

#ifdef _WIN32
#define EXPORT3 __declspec(dllexport)
#else
#define EXPORT3 __attribute__((visibility("default")))
#endif

enum { FIRST_INDICATOR = VARIABLES, TIME = VARIABLES + INDICATORS, INTERMEDIATE_POINTS = 8 };

typedef struct {
    Instance *core;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback on_intermediate_update;
    fmi3InstanceEnvironment environment;
    int has_events, returns_early, in_intermediate_update;
} Fmi3Instance;

/* From the state x at t to the first event, or to the end of the input trajectory: its time since t,
   the index of the event indicator below zero or -1, and the state. */
#if INDICATORS
static void model_run_to_event(Context *c, const double *p, double t, const double *x,
                        const double *inputs, double *result);
#endif

static void forward_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                    fmi2String category, fmi2String message, ...) {
    Fmi3Instance *u = environment;
    (void)name;
    if (u->log && !u->in_intermediate_update)
        u->log(u->environment, (fmi3Status)status, category, message);
}

static Fmi3Instance *instantiate(fmi3String name, fmi3String token, fmi2Type type, fmi3Boolean logging,
                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    const fmi2CallbackFunctions callbacks = {forward_message, calloc, free, NULL, NULL};
    fmi2CallbackFunctions with_instance = callbacks;
    Fmi3Instance *u = calloc(1, sizeof *u);
    if (!u) return NULL;
    with_instance.componentEnvironment = u;
    u->log = log, u->environment = environment;
    if (!(u->core = fmi2Instantiate(name, type, token, NULL, &with_instance, fmi2False, logging)))
        free(u), u = NULL;
    return u;
}

EXPORT3 fmi3Instance fmi3InstantiateModelExchange(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    (void)resources, (void)visible;
    return instantiate(name, token, fmi2ModelExchange, logging, environment, log);
}

EXPORT3 fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean has_events, fmi3Boolean returns_early,
    const fmi3ValueReference within[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback on_intermediate_update) {
    Fmi3Instance *u = instantiate(name, token, fmi2CoSimulation, logging, environment, log);
    (void)resources, (void)visible, (void)within, (void)n;
    if (u) u->on_intermediate_update = on_intermediate_update, u->has_events = has_events, u->returns_early = returns_early;
    return u;
}

EXPORT3 fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock;
    (void)unlock;
    if (log)
        log(environment, fmi3Error, "logStatusError",
            IDENTIFIER " is for co-simulation and model exchange, not for scheduled execution");
    return NULL;
}

EXPORT3 void fmi3FreeInstance(fmi3Instance instance) {
    Fmi3Instance *u = instance;
    if (!u) return;
    fmi2FreeInstance(u->core);
    free(u);
}

EXPORT3 const char *fmi3GetVersion(void) { return "3.0"; }

/* Within an intermediate update, the importer may only get values. */
static fmi3Status refuse_within_step(Fmi3Instance *u, const char *call) {
    char text[TEXT_SIZE];
    size_t length = 0;
    append_text(text, &length, u->core->name);
    append_text(text, &length, ": "), append_text(text, &length, call);
    append_text(text, &length, " is not allowed within a step");
    if (u->log) u->log(u->environment, fmi3Error, "logStatusError", text);
    return fmi3Error;
}

#define FORWARD(Name, call, parameters, action)                                                 \
    EXPORT3 fmi3Status fmi3##Name parameters {                                                   \
        Fmi3Instance *u = instance;                                                                     \
        if (!u) return fmi3Error;                                                               \
        if (u->in_intermediate_update) return refuse_within_step(u, call);                                             \
        return (fmi3Status)(action);                                                            \
    }

FORWARD(Terminate, "terminate", (fmi3Instance instance),
        fmi2Terminate(u->core))
FORWARD(Reset, "reset", (fmi3Instance instance), fmi2Reset(u->core))
FORWARD(EnterContinuousTimeMode, "enterContinuousTimeMode", (fmi3Instance instance),
        fmi2EnterContinuousTimeMode(u->core))
FORWARD(SetTime, "setTime", (fmi3Instance instance, fmi3Float64 time), fmi2SetTime(u->core, time))
FORWARD(SetContinuousStates, "setContinuousStates",
        (fmi3Instance instance, const fmi3Float64 x[], size_t n),
        fmi2SetContinuousStates(u->core, x, n))
FORWARD(GetContinuousStates, "getContinuousStates",
        (fmi3Instance instance, fmi3Float64 x[], size_t n), fmi2GetContinuousStates(u->core, x, n))
FORWARD(GetContinuousStateDerivatives, RATES, (fmi3Instance instance, fmi3Float64 dx[], size_t n),
        fmi2GetDerivatives(u->core, dx, n))
FORWARD(GetEventIndicators, "getEventIndicators",
        (fmi3Instance instance, fmi3Float64 z[], size_t n), fmi2GetEventIndicators(u->core, z, n))
FORWARD(GetNominalsOfContinuousStates, "getNominalsOfContinuousStates",
        (fmi3Instance instance, fmi3Float64 x[], size_t n),
        fmi2GetNominalsOfContinuousStates(u->core, x, n))
FORWARD(SetDebugLogging, "setDebugLogging",
        (fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[]),
        fmi2SetDebugLogging(u->core, on, n, categories))
FORWARD(GetFMUState, "getFMUState", (fmi3Instance instance, fmi3FMUState *state),
        fmi2GetFMUstate(u->core, state))
FORWARD(SetFMUState, "setFMUState", (fmi3Instance instance, fmi3FMUState state),
        fmi2SetFMUstate(u->core, state))
FORWARD(FreeFMUState, "freeFMUState", (fmi3Instance instance, fmi3FMUState *state),
        fmi2FreeFMUstate(u->core, state))
FORWARD(SerializedFMUStateSize, "serializedFMUStateSize",
        (fmi3Instance instance, fmi3FMUState state, size_t *size),
        fmi2SerializedFMUstateSize(u->core, state, size))
FORWARD(SerializeFMUState, "serializeFMUState",
        (fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size),
        fmi2SerializeFMUstate(u->core, state, (fmi2Byte *)bytes, size))
FORWARD(DeserializeFMUState, "deserializeFMUState",
        (fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state),
        fmi2DeSerializeFMUstate(u->core, (const fmi2Byte *)bytes, size, state))

static fmi2Status enter_initialization(Fmi3Instance *u, int tolerance_defined, double tolerance, double start, int stop_defined,
                        double stop) {
    fmi2Status status =
        fmi2SetupExperiment(u->core, tolerance_defined, tolerance, start, stop_defined, stop);
    return status <= fmi2Warning ? fmi2EnterInitializationMode(u->core) : status;
}

FORWARD(EnterInitializationMode, "enterInitializationMode",
        (fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
         fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop),
        enter_initialization(u, tolerance_defined, tolerance, start, stop_defined, stop))

static fmi2Status exit_initialization(Fmi3Instance *u) {
    fmi2Status status = fmi2ExitInitializationMode(u->core);
    if (status <= fmi2Warning && u->has_events) u->core->state.phase = AT_EVENT;
    return status;
}

FORWARD(ExitInitializationMode, "exitInitializationMode", (fmi3Instance instance), exit_initialization(u))

/* Event mode, of co-simulation too if the importer has asked for it. */

static fmi2Status enter_event_mode(Fmi3Instance *u) {
    Instance *i = u->core;
    if (i->kind == EXCHANGE) return fmi2EnterEventMode(i);
    if (!u->has_events)
        fail(&i->context, "enterEventMode is not allowed: the instance was made without event mode");
    else if (allowed(i, "enterEventMode", COSIMULATION, STEPPING, STEPPING))
        i->state.phase = AT_EVENT, i->state.stale = 1.0, i->state.events = 0.0;
    return finish(i);
}

FORWARD(EnterEventMode, "enterEventMode", (fmi3Instance instance), enter_event_mode(u))

static fmi2Status enter_step_mode(Instance *i) {
    if (allowed(i, "enterStepMode", COSIMULATION, AT_EVENT, AT_EVENT)) {
        memcpy(i->state.end, values_from(i, FIRST_INPUT), INPUTS * sizeof(double));
        i->state.phase = STEPPING;
    }
    return finish(i);
}

FORWARD(EnterStepMode, "enterStepMode", (fmi3Instance instance), enter_step_mode(u->core))

EXPORT3 fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *needed,
                                            fmi3Boolean *terminate, fmi3Boolean *nominals_changed,
                                            fmi3Boolean *values_changed, fmi3Boolean *time_defined,
                                            fmi3Float64 *time) {
    Fmi3Instance *u = instance;
    fmi2EventInfo info = {0};
    fmi2Status status;
    if (!u || !needed || !terminate || !nominals_changed || !values_changed || !time_defined || !time)
        return fmi3Error;
    if (u->in_intermediate_update) return refuse_within_step(u, UPDATE);
    status = fmi2NewDiscreteStates(u->core, &info);
    *needed = info.newDiscreteStatesNeeded, *values_changed = info.valuesOfContinuousStatesChanged;
    *terminate = *nominals_changed = *time_defined = false;
    *time = 0.0;
    return (fmi3Status)status;
}

EXPORT3 fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean final,
                                               fmi3Boolean *event, fmi3Boolean *terminate) {
    Fmi3Instance *u = instance;
    fmi2Boolean event_needed = fmi2False, ended = fmi2False;
    fmi2Status status;
    if (!u || !event || !terminate) return fmi3Error;
    status = fmi2CompletedIntegratorStep(u->core, final, &event_needed, &ended);
    *event = event_needed, *terminate = ended;
    return (fmi3Status)status;
}

/* Steps. */

#if INDICATORS
/* A step to its end or to its first event, which is left to event mode. */
static fmi2Status run_to_event(Instance *i, double t, double h, double *end, int *which) {
    Context *c = &i->context;
    State *s = &i->state;
    double inputs[TRAJECTORY_SIZE], slopes[ARRAY_LENGTH(INPUTS)], result[2 + STATES], fraction;
    double *x = values_from(i, FIRST_STATE), *now = values_from(i, FIRST_INPUT);
    if (!may_step(i, t, h)) return finish(i);
    input_trajectory(i, h, inputs, slopes);
    model_run_to_event(c, s->values, t, x, inputs, result);
    for (int k = 0; k < STATES; k++) check_finite(c, &variables[FIRST_STATE + k], result[2 + k]);
    if (c->failed) {
        add_context_to_reason(i, "step from", t);
        return finish(i);
    }
    *which = (int)result[1];
    *end = *which < 0 ? t + h : t + result[0];
    fraction = *which < 0 ? 1.0 : result[0] / h;
    for (int k = 0; k < INPUTS; k++) {
        const double from = inputs[k], to = inputs[INPUTS + k];
        s->end[k] = fraction == 1.0 || from == to ? to : from + (to - from) * fraction;
    }
    memcpy(s->slopes, slopes, INPUTS * sizeof *slopes);
    memcpy(x, result + 2, STATES * sizeof *x);
    memcpy(s->before, now, INPUTS * sizeof *now);
    s->time = *end, s->past = *end - t, s->stale = 1.0;
    return finish(i);
}
#endif

/* Run the intermediate updates of a step of h; whether the importer returns early, and where. */
static int run_intermediate_updates(Fmi3Instance *u, double t, double h, double *end) {
    Instance *i = u->core;
    const State before = i->state;
    for (int k = 1; k < INTERMEDIATE_POINTS; k++) {
        const double at = t + h * k / INTERMEDIATE_POINTS;
        fmi3Boolean wanted = false;
        fmi3Float64 time = at;
        u->in_intermediate_update = 1;
        if (fmi2DoStep(i, t, h * k / INTERMEDIATE_POINTS, fmi2True) <= fmi2Warning)
            u->on_intermediate_update(u->environment, at, false, true, true, u->returns_early, &wanted, &time);
        u->in_intermediate_update = 0;
        if (wanted && u->returns_early && i->state.phase == STEPPING) {
            *end = at;
            return 1;
        }
        i->state = before;
    }
    return 0;
}

EXPORT3 fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h,
                              fmi3Boolean final, fmi3Boolean *event, fmi3Boolean *terminate,
                              fmi3Boolean *early, fmi3Float64 *last) {
    Fmi3Instance *u = instance;
    fmi2Status status = fmi2OK;
    double end = t + h;
    int which = -1;
    (void)final;
    if (!u || !event || !terminate || !early || !last) return fmi3Error;
    *event = *terminate = *early = false;
    *last = u->core->state.time;
    if (u->in_intermediate_update) return refuse_within_step(u, "doStep");
#if INDICATORS
    if (u->has_events && u->returns_early) {
        const State before = u->core->state;
        status = run_to_event(u->core, t, h, &end, &which);
        if (status <= fmi2Warning && u->on_intermediate_update && end > t) {
            const State after = u->core->state;
            u->core->state = before;
            if (run_intermediate_updates(u, t, end - t, &end))
                which = -1;
            else
                u->core->state = after;
        }
        *event = which >= 0;
        *early = end < t + h;
        *last = u->core->state.time;
        return (fmi3Status)status;
    }
#endif
    if (u->on_intermediate_update && may_step(u->core, t, h) && run_intermediate_updates(u, t, h, &end))
        *early = true;
    else
        status = fmi2DoStep(u->core, t, h, fmi2True);
    *last = u->core->state.time;
    return (fmi3Status)status;
}

/* Values. An Integer is an Int32; an Enumeration is got and set as Int64. */

static const char *type_of(fmi3ValueReference reference) {
    const char *kind = reference < VARIABLES ? variables[reference].kind : "Real";
    return *kind == 'R' ? "Float64" : *kind == 'I' ? "Int32" : *kind == 'E' ? "Int64" : kind;
}

static int is_typed(Instance *i, const char *type, const fmi3ValueReference vr[], size_t n,
                    size_t values) {
    if (n != values)
        fail(&i->context, "%d values for %d variables", (double)values, (double)n);
    for (size_t k = 0; k < n && !i->context.failed; k++)
        if (vr[k] > TIME)
            fail(&i->context, "value reference %d is unknown", (double)vr[k]);
        else if (strcmp(type, type_of(vr[k])))
            fail(&i->context, "%s is of type %s, not %s",
                 vr[k] < VARIABLES ? variables[vr[k]].name : "time", type_of(vr[k]), type);
    return !i->context.failed;
}

static fmi2Status get_real(Instance *i, fmi3ValueReference reference, double *value) {
    double z[ARRAY_LENGTH(INDICATORS)];
    if (reference < VARIABLES) return fmi2GetReal(i, &reference, 1, value);
    if (reference == TIME) {
        *value = i->state.time;
        return fmi2OK;
    }
    get_event_indicators(i, z);
    *value = z[reference - FIRST_INDICATOR];
    return finish(i);
}

static fmi2Status set_real(Instance *i, fmi3ValueReference reference, double value) {
    if (reference < VARIABLES) return fmi2SetReal(i, &reference, 1, &value);
    fail(&i->context, "%s",
         reference == TIME ? "time can only be set by setTime" : "an event indicator cannot be set");
    return finish(i);
}

#define VALUES(Type, type, stored_type, get, set)                                                      \
    EXPORT3 fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference vr[],       \
                                     size_t n, fmi3##Type values[], size_t count) {             \
        Fmi3Instance *u = instance;                                                                     \
        fmi2Status status = fmi2OK;                                                             \
        if (!u) return fmi3Error;                                                               \
        if (!is_typed(u->core, type, vr, n, count)) return (fmi3Status)finish(u->core);         \
        for (size_t k = 0; k < n && status <= fmi2Warning; k++) {                               \
            stored_type value = 0;                                                                     \
            status = get(u->core, vr[k], &value);                                               \
            values[k] = (fmi3##Type)value;                                                      \
        }                                                                                       \
        return (fmi3Status)status;                                                              \
    }                                                                                           \
    EXPORT3 fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference vr[],       \
                                     size_t n, const fmi3##Type values[], size_t count) {       \
        Fmi3Instance *u = instance;                                                                     \
        fmi2Status status = fmi2OK;                                                             \
        if (!u) return fmi3Error;                                                               \
        if (u->in_intermediate_update) return refuse_within_step(u, "set" #Type);                                       \
        if (!is_typed(u->core, type, vr, n, count)) return (fmi3Status)finish(u->core);         \
        for (size_t k = 0; k < n && status <= fmi2Warning; k++)                                 \
            status = set(u->core, vr[k], values[k]);                                            \
        return (fmi3Status)status;                                                              \
    }

static fmi2Status get_integer(Instance *i, fmi3ValueReference reference, fmi2Integer *value) {
    return fmi2GetInteger(i, &reference, 1, value);
}

static fmi2Status set_integer(Instance *i, fmi3ValueReference reference, fmi3Int64 value) {
    const fmi2Integer narrow = (fmi2Integer)value;
    if (narrow == value) return fmi2SetInteger(i, &reference, 1, &narrow);
    fail(&i->context, "%s = %d is not one of its values", variables[reference].name, (double)value);
    return finish(i);
}

static fmi2Status get_boolean(Instance *i, fmi3ValueReference reference, fmi2Boolean *value) {
    return fmi2GetBoolean(i, &reference, 1, value);
}

static fmi2Status set_boolean(Instance *i, fmi3ValueReference reference, fmi2Boolean value) {
    return fmi2SetBoolean(i, &reference, 1, &value);
}

VALUES(Float64, "Float64", double, get_real, set_real)
VALUES(Int32, "Int32", fmi2Integer, get_integer, set_integer)
VALUES(Int64, "Int64", fmi2Integer, get_integer, set_integer)
VALUES(Boolean, "Boolean", fmi2Boolean, get_boolean, set_boolean)

/* There are no variables of other types. */
#define NO_VARIABLES(Name, type, ...)                                                                 \
    EXPORT3 fmi3Status fmi3##Name(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, \
                                  __VA_ARGS__) {                                                \
        Fmi3Instance *u = instance;                                                                     \
        if (!u) return fmi3Error;                                                               \
        is_typed(u->core, type, vr, n, n);                                                      \
        return (fmi3Status)finish(u->core);                                                     \
    }
#define NO_VARIABLES_OF_TYPE(Type)                                                                       \
    NO_VARIABLES(Get##Type, #Type, fmi3##Type values[], size_t count)                                 \
    NO_VARIABLES(Set##Type, #Type, const fmi3##Type values[], size_t count)

NO_VARIABLES_OF_TYPE(Float32)
NO_VARIABLES_OF_TYPE(Int8)
NO_VARIABLES_OF_TYPE(UInt8)
NO_VARIABLES_OF_TYPE(Int16)
NO_VARIABLES_OF_TYPE(UInt16)
NO_VARIABLES_OF_TYPE(UInt32)
NO_VARIABLES_OF_TYPE(UInt64)
NO_VARIABLES_OF_TYPE(String)
NO_VARIABLES(GetBinary, "Binary", size_t sizes[], fmi3Binary values[], size_t count)
NO_VARIABLES(SetBinary, "Binary", const size_t sizes[], const fmi3Binary values[], size_t count)
NO_VARIABLES(GetClock, "Clock", fmi3Clock values[])
NO_VARIABLES(SetClock, "Clock", const fmi3Clock values[])
NO_VARIABLES(GetIntervalDecimal, "Clock", fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
NO_VARIABLES(GetIntervalFraction, "Clock", fmi3UInt64 counters[], fmi3UInt64 resolutions[],
       fmi3IntervalQualifier qualifiers[])
NO_VARIABLES(GetShiftDecimal, "Clock", fmi3Float64 shifts[])
NO_VARIABLES(GetShiftFraction, "Clock", fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NO_VARIABLES(SetIntervalDecimal, "Clock", const fmi3Float64 intervals[])
NO_VARIABLES(SetIntervalFraction, "Clock", const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NO_VARIABLES(SetShiftDecimal, "Clock", const fmi3Float64 shifts[])
NO_VARIABLES(SetShiftFraction, "Clock", const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

/* Derivatives. */

EXPORT3 fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference vr[],
                                            size_t n, const fmi3Int32 orders[],
                                            fmi3Float64 values[], size_t count) {
    Fmi3Instance *u = instance;
    if (!u) return fmi3Error;
    if (!is_typed(u->core, "Float64", vr, n, count)) return (fmi3Status)finish(u->core);
    return (fmi3Status)fmi2GetRealOutputDerivatives(u->core, vr, n, (const fmi2Integer *)orders,
                                                    values);
}

EXPORT3 fmi3Status fmi3GetDirectionalDerivative(
    fmi3Instance instance, const fmi3ValueReference unknowns[], size_t n_unknowns,
    const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
    fmi3Float64 sensitivity[], size_t n_sensitivity) {
    Fmi3Instance *u = instance;
    if (!u) return fmi3Error;
    if (!is_typed(u->core, "Float64", unknowns, n_unknowns, n_sensitivity) ||
        !is_typed(u->core, "Float64", knowns, n_knowns, n_seed))
        return (fmi3Status)finish(u->core);
    return (fmi3Status)fmi2GetDirectionalDerivative(u->core, unknowns, n_unknowns, knowns, n_knowns,
                                                    seed, sensitivity);
}

/* What the description says that there is not. */

static fmi3Status report_missing(fmi3Instance instance, const char *call) {
    Fmi3Instance *u = instance;
    if (!u) return fmi3Error;
    if (u->log) u->log(u->environment, fmi3Error, "logStatusError", call);
    return fmi3Error;
}

#define NOT_PROVIDED(Name, ...)                                                                       \
    EXPORT3 fmi3Status fmi3##Name(__VA_ARGS__) { return report_missing(instance, #Name " is not provided"); }

NOT_PROVIDED(GetAdjointDerivative, fmi3Instance instance, const fmi3ValueReference unknowns[],
       size_t n_unknowns, const fmi3ValueReference knowns[], size_t n_knowns,
       const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity)
NOT_PROVIDED(GetNumberOfVariableDependencies, fmi3Instance instance, fmi3ValueReference reference,
       size_t *count)
NOT_PROVIDED(GetVariableDependencies, fmi3Instance instance, fmi3ValueReference dependent,
       size_t dependents[], fmi3ValueReference independents[], size_t elements[],
       fmi3DependencyKind kinds[], size_t count)
NOT_PROVIDED(EnterConfigurationMode, fmi3Instance instance)
NOT_PROVIDED(ExitConfigurationMode, fmi3Instance instance)
NOT_PROVIDED(EvaluateDiscreteStates, fmi3Instance instance)
NOT_PROVIDED(ActivateModelPartition, fmi3Instance instance, fmi3ValueReference clock, fmi3Float64 time)

static fmi3Status store_count(fmi3Instance instance, size_t *count, size_t value) {
    if (!instance || !count) return fmi3Error;
    *count = value;
    return fmi3OK;
}

EXPORT3 fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *count) {
    return store_count(instance, count, INDICATORS);
}

EXPORT3 fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *count) {
    return store_count(instance, count, DERIVATIVES);
}
