/* Every function of an FMU in every phase of both kinds of instance, right and wrong:
   LIBRARY GUID VARIABLES STATES INDICATORS STEPS.
   Ends with 0 if all memory came back and the last run repeated the first to the bit. */

#include "fmi.h"

#define MOST 256
#define H 1e-3
static int variables, states, steps, messages, blocks;

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment;
    messages += strlen(instance) && strlen(category) && strlen(message) && status;
}

static void *allocate(size_t count, size_t size) {
    blocks++;
    return calloc(count, size);
}

static void *refuse(size_t count, size_t size) {
    (void)count, (void)size;
    return NULL;
}

static void release(void *block) {
    blocks -= block != NULL;
    free(block);
}

/* Get, and where it is allowed set to the same, every reference as every type. */
static void touch(fmi2Component unit) {
    const fmi2Integer orders[] = {1, 2};
    const fmi2Real unit_value = 1.0, wild[] = {NAN, INFINITY, -1e300};
    fmi2FMUstate before = NULL;
    fmi2GetFMUstate(unit, &before);
    for (fmi2ValueReference vr = 0; vr < (fmi2ValueReference)variables + 2; vr++) {
        fmi2Real real;
        fmi2Integer integer;
        fmi2Boolean boolean;
        fmi2String text = "text";
        if (fmi2GetReal(unit, &vr, 1, &real) == fmi2OK) fmi2SetReal(unit, &vr, 1, &real);
        fmi2SetFMUstate(unit, before);
        if (fmi2GetInteger(unit, &vr, 1, &integer) == fmi2OK) fmi2SetInteger(unit, &vr, 1, &integer);
        fmi2SetFMUstate(unit, before);
        if (fmi2GetBoolean(unit, &vr, 1, &boolean) == fmi2OK) fmi2SetBoolean(unit, &vr, 1, &boolean);
        fmi2SetFMUstate(unit, before);
        fmi2GetString(unit, &vr, 1, &text);
        fmi2SetFMUstate(unit, before);
        fmi2SetString(unit, &vr, 1, &text);
        for (int k = 0; k < 3; k++) {
            fmi2SetFMUstate(unit, before);
            fmi2SetReal(unit, &vr, 1, &wild[k]);
            fmi2SetFMUstate(unit, before);
            fmi2SetRealInputDerivatives(unit, &vr, 1, orders, &wild[k]);
        }
        for (int k = 0; k < 2; k++) {
            fmi2SetFMUstate(unit, before);
            fmi2GetRealOutputDerivatives(unit, &vr, 1, &orders[k], &real);
            fmi2SetFMUstate(unit, before);
            fmi2SetRealInputDerivatives(unit, &vr, 1, &orders[k], &unit_value);
        }
        for (fmi2ValueReference k = 0; k < 3; k++) {
            const fmi2ValueReference other = (7 * vr + 11 * k) % (variables + 2);
            fmi2SetFMUstate(unit, before);
            fmi2GetDirectionalDerivative(unit, &vr, 1, &other, 1, &unit_value, &real);
        }
        fmi2SetFMUstate(unit, before);
    }
    fmi2FreeFMUstate(unit, &before);
}

/* The calls of model exchange, with as many states and indicators as there may be. */
static void exchange(fmi2Component unit, int k) {
    fmi2Real numbers[MOST] = {0};
    fmi2EventInfo info;
    fmi2Boolean event, terminate;
    if (k == 0) fmi2EnterEventMode(unit), fmi2NewDiscreteStates(unit, &info);
    if (k == 1) fmi2EnterContinuousTimeMode(unit);
    if (k == 2) fmi2CompletedIntegratorStep(unit, fmi2True, &event, &terminate);
    if (k == 3) fmi2SetTime(unit, 0.1), fmi2SetTime(unit, NAN);
    for (size_t n = 0; n < 40; n++) {
        if (k == 4 && fmi2GetContinuousStates(unit, numbers, n) == fmi2OK)
            fmi2SetContinuousStates(unit, numbers, n);
        if (k == 5) fmi2GetDerivatives(unit, numbers, n);
        if (k == 6) fmi2GetEventIndicators(unit, numbers, n);
        if (k == 7) fmi2GetNominalsOfContinuousStates(unit, numbers, n);
        if (k == 8) fmi2SetContinuousStates(unit, numbers, n);
    }
}

/* Calls that are not for this phase, and those that never do anything. */
static void misuse(fmi2Component unit) {
    const fmi2String categories[] = {"logAll", "nonsense"};
    fmi2FMUstate before = NULL;
    fmi2Status status;
    fmi2Real real;
    fmi2Integer integer;
    fmi2Boolean boolean;
    fmi2String text;
    fmi2GetFMUstate(unit, &before);
    for (int k = 0; k < 9; k++) {
        exchange(unit, k);
        fmi2SetFMUstate(unit, before);
        const double bad[] = {0.0, -H, NAN, INFINITY, 1e300};
        if (k == 0) fmi2SetupExperiment(unit, fmi2False, 0.0, NAN, fmi2False, 0.0);
        if (k == 1) fmi2EnterInitializationMode(unit), fmi2EnterInitializationMode(unit);
        if (k == 2) fmi2ExitInitializationMode(unit), fmi2ExitInitializationMode(unit);
        if (k == 3) fmi2Terminate(unit), fmi2Terminate(unit);
        if (k >= 4) fmi2DoStep(unit, k == 8 ? 9.0 : 0.0, bad[k - 4], fmi2True);
        fmi2SetFMUstate(unit, before);
    }
    fmi2CancelStep(unit);
    for (int kind = fmi2DoStepStatus; kind <= fmi2Terminated; kind++) {
        fmi2GetStatus(unit, kind, &status);
        fmi2GetRealStatus(unit, kind, &real);
        fmi2GetIntegerStatus(unit, kind, &integer);
        fmi2GetBooleanStatus(unit, kind, &boolean);
        fmi2GetStringStatus(unit, kind, &text);
    }
    fmi2SetDebugLogging(unit, fmi2False, 0, NULL);
    fmi2SetDebugLogging(unit, fmi2True, 2, categories);
    fmi2SetFMUstate(unit, NULL);
    fmi2SetFMUstate(unit, before);
    fmi2FreeFMUstate(unit, &before);
}

/* Bytes that are, and bytes that are not, a state. */
static void serialise(fmi2Component unit) {
    fmi2FMUstate before = NULL, read = NULL;
    fmi2Byte *bytes;
    size_t size;
    fmi2GetFMUstate(unit, &before);
    fmi2GetFMUstate(unit, &before);
    fmi2SerializedFMUstateSize(unit, before, &size);
    bytes = malloc(size);
    fmi2SerializeFMUstate(unit, before, bytes, 1);
    fmi2SetFMUstate(unit, before);
    fmi2SerializeFMUstate(unit, before, bytes, size);
    for (size_t cut = 0; cut <= size; cut += size / 7 ? size / 7 : 1) {
        size_t again;
        fmi2DeSerializeFMUstate(unit, bytes, cut, &read);
        fmi2SerializedFMUstateSize(unit, read, &again);
        fmi2SerializeFMUstate(unit, read, bytes, again);
        fmi2SetFMUstate(unit, read);
        fmi2SetFMUstate(unit, before);
    }
    bytes[size / 2] ^= 1;
    fmi2DeSerializeFMUstate(unit, bytes, size, &read);
    fmi2SetFMUstate(unit, read);
    fmi2SetFMUstate(unit, before);
    fmi2FreeFMUstate(unit, &read);
    fmi2FreeFMUstate(unit, &read);
    fmi2FreeFMUstate(unit, &before);
    free(bytes);
}

/* From event mode one step of Euler, and back. */
static void turn(fmi2Component unit, double t) {
    fmi2Real x[MOST] = {0}, dx[MOST] = {0};
    fmi2Boolean event, terminate;
    fmi2EventInfo info = {0};
    const size_t n = states;
    do
        fmi2NewDiscreteStates(unit, &info);
    while (info.newDiscreteStatesNeeded);
    fmi2EnterContinuousTimeMode(unit);
    fmi2GetContinuousStates(unit, x, n);
    fmi2GetDerivatives(unit, dx, n);
    for (size_t k = 0; k < n; k++) x[k] += H * dx[k];
    fmi2SetTime(unit, t + H);
    fmi2SetContinuousStates(unit, x, n);
    fmi2CompletedIntegratorStep(unit, fmi2True, &event, &terminate);
    fmi2EnterEventMode(unit);
}

static void run(fmi2Component unit, fmi2Type kind, int thorough, double *end) {
    for (int phase = 0; phase < 4; phase++) {
        if (phase == 0) fmi2SetupExperiment(unit, fmi2True, 1e-6, 0.0, fmi2True, 1.0);
        if (phase == 1) fmi2EnterInitializationMode(unit);
        if (phase == 2) fmi2ExitInitializationMode(unit);
        for (int n = 0; phase == 2 && n < steps; n++)
            kind == fmi2CoSimulation ? fmi2DoStep(unit, n * H, H, fmi2True) : turn(unit, n * H);
        if (phase == 3) fmi2Terminate(unit);
        if (thorough) touch(unit), misuse(unit), serialise(unit);
    }
    for (fmi2ValueReference vr = 0; vr < (fmi2ValueReference)variables; vr++) {
        fmi2FMUstate state = NULL;
        fmi2GetFMUstate(unit, &state);
        if (fmi2GetReal(unit, &vr, 1, &end[vr]) != fmi2OK) end[vr] = 0.0;
        fmi2SetFMUstate(unit, state);
        fmi2FreeFMUstate(unit, &state);
    }
}

int main(int count, char **arguments) {
    const fmi2CallbackFunctions callbacks = {logger, allocate, release, NULL, NULL};
    const fmi2CallbackFunctions no_memory = {logger, refuse, release, NULL, NULL};
    const fmi2CallbackFunctions nothing = {NULL, NULL, NULL, NULL, NULL};
    double first[MOST] = {0}, again[MOST] = {0};
    fmi2Component unit;
    int different = 0;
    if (count != 7) return 2;
    load(arguments[1]);
    variables = atoi(arguments[3]), states = atoi(arguments[4]), steps = atoi(arguments[6]);
#define UNIT(name, type, guid, with) \
    fmi2Instantiate(name, type, guid, "file:///", with, fmi2False, fmi2True)
    if (UNIT("unit", fmi2CoSimulation, "{another}", &callbacks)) return 3;
    if (UNIT("unit", fmi2CoSimulation, NULL, &callbacks)) return 3;
    if (UNIT("", fmi2CoSimulation, arguments[2], &callbacks)) return 3;
    if (UNIT(NULL, fmi2CoSimulation, arguments[2], &callbacks)) return 3;
    if (UNIT("unit", fmi2CoSimulation, arguments[2], &no_memory)) return 3;
    if (UNIT("unit", fmi2CoSimulation, arguments[2], &nothing)) return 3;
    if (UNIT("unit", fmi2CoSimulation, arguments[2], NULL)) return 3;
    if (messages != 3) return 4;
    if (strcmp(fmi2GetVersion(), "2.0") || strcmp(fmi2GetTypesPlatform(), "default")) return 5;

    for (int kind = fmi2ModelExchange; kind <= fmi2CoSimulation; kind++) {
        unit = UNIT("100%s %n", kind, arguments[2], &callbacks);
        if (!unit) return 6;
        run(unit, kind, 0, first);
        fmi2Reset(unit);
        run(unit, kind, 1, again);
        fmi2FreeInstance(unit);
        different |= memcmp(first, again, sizeof first);
    }
    fmi2FreeInstance(NULL);
    dlclose(library);
    return blocks ? 7 : different ? 8 : 0;
}
