/* The calls of FMI 2.0 that fuzz.c makes, as calls of FMI 3.0, and among them what only 3.0 has. */

#include "fmi.h"

#include <stdbool.h>
#include <stdint.h>

#include "fmi3FunctionTypes.h"

#define CALLS(X) \
    X(InstantiateModelExchange) X(InstantiateCoSimulation) X(FreeInstance) \
    X(EnterInitializationMode) X(ExitInitializationMode) X(EnterEventMode) X(EnterStepMode) \
    X(UpdateDiscreteStates) X(EnterContinuousTimeMode) X(CompletedIntegratorStep) X(Terminate) \
    X(Reset) X(SetTime) X(GetContinuousStates) X(SetContinuousStates) \
    X(GetContinuousStateDerivatives) X(GetNominalsOfContinuousStates) X(GetEventIndicators) \
    X(GetFloat64) X(SetFloat64) X(GetInt32) X(SetInt32) X(GetInt64) X(SetInt64) X(GetBoolean) \
    X(SetBoolean) X(GetString) X(SetString) X(GetFloat32) X(SetFloat32) X(GetBinary) X(GetClock) \
    X(GetOutputDerivatives) X(GetDirectionalDerivative) X(GetAdjointDerivative) \
    X(GetFMUState) X(SetFMUState) X(FreeFMUState) X(SerializedFMUStateSize) X(SerializeFMUState) \
    X(DeserializeFMUState) X(SetDebugLogging) X(EnterConfigurationMode) X(ExitConfigurationMode) \
    X(GetNumberOfContinuousStates) X(GetNumberOfEventIndicators) X(DoStep)
#define DECLARE3(name) static fmi3##name##TYPE *fmi3##name;
#define LOAD3(name) fmi3##name = (fmi3##name##TYPE *)need(dlsym(library, "fmi3" #name));
CALLS(DECLARE3)

static uint32_t any(uint32_t below);
static double number(void);

enum { MAX_VALUES = 8 }; /* values at once */
typedef struct {
    fmi3Instance unit;
    fmi2Type kind;
    int events;
} Unit3;
#define OF(component) ((Unit3 *)(component))->unit
#define SAME(name, name3, parameters, ...) \
    static fmi2Status name parameters { return (fmi2Status)name3(OF(c), __VA_ARGS__); }
#define WITHOUT_ARGUMENTS(name, name3) \
    static fmi2Status name(fmi2Component c) { return (fmi2Status)name3(OF(c)); }

static void on_log(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                 fmi3String message) {
    volatile size_t read = strlen(category) + strlen(message);
    (void)environment, (void)status, (void)read;
}

/* Within a step: get, do what is not allowed, and end the step at times. */
static void look(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean settable,
                 fmi3Boolean gettable, fmi3Boolean done, fmi3Boolean may_end, fmi3Boolean *end,
                 fmi3Float64 *at) {
    const fmi3ValueReference vr = any(8);
    fmi3FMUState state = NULL;
    fmi3Float64 value;
    fmi3Boolean event, terminate, early;
    Unit3 *u = environment;
    (void)settable, (void)gettable, (void)done, (void)may_end;
    fmi3GetFloat64(u->unit, &vr, 1, &value, 1);
    switch (any(9)) {
        case 0: fmi3SetFloat64(u->unit, &vr, 1, &value, 1); return;
        case 1: fmi3DoStep(u->unit, time, 1e-3, true, &event, &terminate, &early, &value); return;
        case 2: fmi3Reset(u->unit); return;
        case 3: fmi3GetFMUState(u->unit, &state); fmi3FreeFMUState(u->unit, &state); return;
        case 4: fmi3Terminate(u->unit); return;
        case 5: *end = true; *at = any(2) ? time : number(); return;
    }
}

static fmi2Component instantiate(fmi2String name, fmi2Type kind, fmi2String token,
                                 fmi2String resources, const fmi2CallbackFunctions *callbacks,
                                 fmi2Boolean visible, fmi2Boolean logging) {
    Unit3 *u = calloc(1, sizeof *u);
    (void)callbacks;
    u->kind = kind, u->events = any(2);
    u->unit = kind == fmi2ModelExchange
        ? fmi3InstantiateModelExchange(name, token, resources, visible, logging, u,
                                       any(9) ? on_log : NULL)
        : fmi3InstantiateCoSimulation(name, token, resources, visible, logging, u->events, any(2),
                                      NULL, 0, u, any(9) ? on_log : NULL, any(3) ? NULL : look);
    if (u->unit) return u;
    free(u);
    return NULL;
}

static void release_unit(fmi2Component c) {
    fmi3FreeInstance(OF(c));
    free(c);
}

static fmi2Status initialised(fmi2Component c);
static fmi2Boolean has_stop;
static double first;

static fmi2Status set_up(fmi2Component c, fmi2Boolean tolerance, fmi2Real value, fmi2Real start,
                         fmi2Boolean ends, fmi2Real stop) {
    (void)c, (void)tolerance, (void)value, (void)stop;
    first = start, has_stop = ends;
    return fmi2OK;
}

static fmi2Status enter(fmi2Component c) {
    const double start = first;
    const bool ends = has_stop;
    first = 0.0, has_stop = fmi2False;
    return (fmi2Status)fmi3EnterInitializationMode(OF(c), any(2), number(), start, ends, number());
}

static fmi2Status renewed(fmi2Component c, fmi2EventInfo *info) {
    fmi3Boolean needed = false, terminate, nominals, values, defined;
    fmi3Float64 next;
    fmi3Status status = fmi3UpdateDiscreteStates(OF(c), info ? &needed : NULL, &terminate, &nominals,
                                                 &values, &defined, &next);
    if (info) info->newDiscreteStatesNeeded = needed;
    return (fmi2Status)status;
}

/* From event mode to steps, if the instance was made for it; seldom in another order. */
static void go_on(fmi2Component c) {
    fmi2EventInfo info = {0};
    if (((Unit3 *)c)->kind == fmi2ModelExchange || (!((Unit3 *)c)->events && any(50))) return;
    for (int k = 0; k < 9 && any(20) && renewed(c, &info) == fmi2OK; k++)
        if (!info.newDiscreteStatesNeeded) break;
    fmi3EnterStepMode(OF(c));
}

static fmi2Status initialised(fmi2Component c) {
    fmi3Status status = fmi3ExitInitializationMode(OF(c));
    if (status == fmi3OK) go_on(c);
    return (fmi2Status)status;
}

/* To the end, through the events in between if the instance stops there. */
static fmi2Status stepped_to(fmi2Component c, double t, double h, fmi2Boolean last) {
    const double end = t + h;
    fmi3Boolean event, terminate, early = true;
    fmi3Status status = fmi3OK;
    for (int k = 0; k < 99 && early && status == fmi3OK; k++) {
        status = fmi3DoStep(OF(c), t, end - t, last, &event, &terminate, &early, &t);
        if (status != fmi3OK || !event) continue;
        if (((Unit3 *)c)->events && fmi3EnterEventMode(OF(c)) == fmi3OK) go_on(c);
    }
    return status == fmi3OK && early ? fmi2Discard : (fmi2Status)status;
}

static fmi2Status completed(fmi2Component c, fmi2Boolean last, fmi2Boolean *event, fmi2Boolean *end) {
    fmi3Boolean wants_event, ended;
    (void)event, (void)end;
    return (fmi2Status)fmi3CompletedIntegratorStep(OF(c), last, &wants_event, &ended);
}

/* With a wrong number of values at times. */
#define TYPED(name, Type, cell, constant) \
    static fmi2Status name(fmi2Component c, const fmi2ValueReference vr[], size_t n, \
                           constant cell values[]) { \
        return (fmi2Status)fmi3##Type(OF(c), vr, n, values, any(30) ? n : any(4)); \
    }
TYPED(get_real, GetFloat64, fmi2Real, )
TYPED(set_real, SetFloat64, fmi2Real, const)
TYPED(get_text, GetString, fmi2String, )
TYPED(set_text, SetString, fmi2String, const)

static fmi2Status get_integer(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                              fmi2Integer values[]) {
    fmi3Int64 wide[MAX_VALUES];
    return (fmi2Status)(any(3) ? fmi3GetInt32(OF(c), vr, n, values, n)
                               : fmi3GetInt64(OF(c), vr, n, wide, n));
}

static fmi2Status set_integer(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                              const fmi2Integer values[]) {
    fmi3Int64 wide[MAX_VALUES];
    for (size_t k = 0; k < n; k++) wide[k] = any(9) ? values[k] : INT64_MIN;
    return (fmi2Status)(any(3) ? fmi3SetInt32(OF(c), vr, n, values, n)
                               : fmi3SetInt64(OF(c), vr, n, wide, n));
}

static fmi2Status get_boolean(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                              fmi2Boolean values[]) {
    fmi3Boolean all[MAX_VALUES];
    (void)values;
    return (fmi2Status)fmi3GetBoolean(OF(c), vr, n, all, n);
}

static fmi2Status set_boolean(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                              const fmi2Boolean values[]) {
    fmi3Boolean all[MAX_VALUES];
    for (size_t k = 0; k < n; k++) all[k] = values[k] != 0;
    return (fmi2Status)fmi3SetBoolean(OF(c), vr, n, all, n);
}

/* In the place of derivatives of inputs, which FMI 3.0 has not: what an FMU need not have. */
static fmi2Status strange(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                          const fmi2Integer order[], const fmi2Real values[]) {
    fmi3Float32 narrow[MAX_VALUES] = {0};
    fmi3Float64 wide[MAX_VALUES] = {0};
    fmi3Binary blobs[MAX_VALUES] = {NULL};
    fmi3Clock clocks[MAX_VALUES];
    size_t sizes[MAX_VALUES] = {0}, count;
    (void)order;
    switch (any(9)) {
        case 0: fmi3GetFloat32(OF(c), vr, n, narrow, n); break;
        case 1: fmi3SetFloat32(OF(c), vr, n, narrow, n); break;
        case 2: fmi3GetBinary(OF(c), vr, n, sizes, blobs, n); break;
        case 3: fmi3GetClock(OF(c), vr, n, clocks); break;
        case 4: fmi3GetAdjointDerivative(OF(c), vr, n, vr, n, values, n, wide, n); break;
        case 5: fmi3EnterConfigurationMode(OF(c)); break;
        case 6: fmi3ExitConfigurationMode(OF(c)); break;
        case 7: fmi3GetNumberOfContinuousStates(OF(c), &count); break;
        default: fmi3GetNumberOfEventIndicators(OF(c), any(9) ? &count : NULL);
    }
    return fmi2OK;
}

static fmi2Status along(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                        const fmi2ValueReference inputs[], size_t m, const fmi2Real seed[],
                        fmi2Real result[]) {
    return (fmi2Status)fmi3GetDirectionalDerivative(OF(c), unknown, n, inputs, m, seed,
                                                    any(30) ? m : 1, result, any(30) ? n : 2);
}

WITHOUT_ARGUMENTS(terminate, fmi3Terminate)
WITHOUT_ARGUMENTS(reset, fmi3Reset)
WITHOUT_ARGUMENTS(enter_events, fmi3EnterEventMode)
WITHOUT_ARGUMENTS(enter_time, fmi3EnterContinuousTimeMode)
SAME(set_time, fmi3SetTime, (fmi2Component c, fmi2Real t), t)
SAME(get_states, fmi3GetContinuousStates, (fmi2Component c, fmi2Real x[], size_t n), x, n)
SAME(set_states, fmi3SetContinuousStates, (fmi2Component c, const fmi2Real x[], size_t n), x, n)
SAME(rates, fmi3GetContinuousStateDerivatives, (fmi2Component c, fmi2Real x[], size_t n), x, n)
SAME(nominals, fmi3GetNominalsOfContinuousStates, (fmi2Component c, fmi2Real x[], size_t n), x, n)
SAME(signs, fmi3GetEventIndicators, (fmi2Component c, fmi2Real z[], size_t n), z, n)
SAME(get_state, fmi3GetFMUState, (fmi2Component c, fmi2FMUstate *s), s)
SAME(set_state, fmi3SetFMUState, (fmi2Component c, fmi2FMUstate s), s)
SAME(free_state, fmi3FreeFMUState, (fmi2Component c, fmi2FMUstate *s), s)
SAME(state_size, fmi3SerializedFMUStateSize, (fmi2Component c, fmi2FMUstate s, size_t *n), s, n)
SAME(state_bytes, fmi3SerializeFMUState, (fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n), s,
     (fmi3Byte *)b, n)
SAME(read_state, fmi3DeserializeFMUState,
     (fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s), (const fmi3Byte *)b, n, s)
SAME(slopes, fmi3GetOutputDerivatives,
     (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer o[], fmi2Real v[]),
     vr, n, o, v, n)
SAME(set_logging, fmi3SetDebugLogging, (fmi2Component c, fmi2Boolean on, size_t n, const fmi2String k[]), on,
     n, k)

static void load(const char *path) {
    library = need(dlopen(path, RTLD_NOW | RTLD_LOCAL));
    CALLS(LOAD3)
    fmi2Instantiate = instantiate; fmi2FreeInstance = release_unit; fmi2SetupExperiment = set_up;
    fmi2EnterInitializationMode = enter; fmi2ExitInitializationMode = initialised;
    fmi2NewDiscreteStates = renewed; fmi2CompletedIntegratorStep = completed;
    fmi2DoStep = stepped_to; fmi2GetReal = get_real; fmi2SetReal = set_real;
    fmi2GetInteger = get_integer; fmi2SetInteger = set_integer; fmi2GetBoolean = get_boolean;
    fmi2SetBoolean = set_boolean; fmi2GetString = get_text; fmi2SetString = set_text;
    fmi2SetRealInputDerivatives = strange; fmi2GetRealOutputDerivatives = slopes;
    fmi2GetDirectionalDerivative = along; fmi2Terminate = terminate; fmi2Reset = reset;
    fmi2EnterEventMode = enter_events; fmi2EnterContinuousTimeMode = enter_time;
    fmi2SetTime = set_time; fmi2GetContinuousStates = get_states;
    fmi2SetContinuousStates = set_states; fmi2GetDerivatives = rates;
    fmi2GetNominalsOfContinuousStates = nominals; fmi2GetEventIndicators = signs;
    fmi2GetFMUstate = get_state; fmi2SetFMUstate = set_state; fmi2FreeFMUstate = free_state;
    fmi2SerializedFMUstateSize = state_size; fmi2SerializeFMUstate = state_bytes;
    fmi2DeSerializeFMUstate = read_state; fmi2SetDebugLogging = set_logging;
}
