/* Random calls, legal and not, with random values: LIBRARY GUID VARIABLES STATES INDICATORS SEED
   CALLS. Ends with 0 if the FMU survives them all, some were steps that it did, and all memory comes
   back. */

#ifdef FMI3
#include "fmi3.h"
#else
#include "fmi.h"
#endif
#include <stdint.h>

enum { UNITS = 4, STATES = 6, MOST = 4, WIDEST = 64 };
typedef struct {
    fmi2Component unit;
    fmi2FMUstate states[STATES];
    fmi2Type kind;
    double time;
} Slot;
static Slot slots[UNITS];
static uint64_t seed;
static uint32_t continuous, indicators;
static int variables, blocks, scarce, stepped, integrated;

static uint32_t any(uint32_t below) { /* xorshift* */
    seed ^= seed >> 12, seed ^= seed << 25, seed ^= seed >> 27;
    return (uint32_t)((seed * 2685821657736338717ull) >> 33) % below;
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    volatile size_t read = strlen(instance) + strlen(category) + strlen(message);
    (void)environment, (void)status, (void)read;
}

static void *allocate(size_t count, size_t size) {
    if (scarce && any(3) == 0) return NULL;
    blocks++;
    return calloc(count, size);
}

static void release(void *block) {
    blocks -= block != NULL;
    free(block);
}

static double number(void) {
    static const double odd[] = {0.0, -0.0, 1.0, -1.0, 2.0, 1e-300, 1e300, -1e300, 5e-324, 1e9};
    switch (any(8)) {
        case 0: return NAN;
        case 1: return any(2) ? INFINITY : -INFINITY;
        case 2: case 3: return odd[any(sizeof odd / sizeof *odd)];
        default: return (any(20001) - 10000.0) / (1 << any(14));
    }
}

static fmi2Integer any_integer(void) {
    static const fmi2Integer odd[] = {0, 1, 2, 3, -1, 7, 2147483647, -2147483647 - 1};
    return odd[any(sizeof odd / sizeof *odd)];
}

static void initialise(fmi2Component unit) {
    fmi2SetupExperiment(unit, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    fmi2EnterInitializationMode(unit);
    fmi2ExitInitializationMode(unit);
}

static void begin(Slot *s, const char *guid) {
    static const fmi2CallbackFunctions callbacks = {logger, allocate, release, NULL, NULL};
    s->kind = (s - slots) % 2 ? fmi2CoSimulation : fmi2ModelExchange;
    s->unit = fmi2Instantiate("unit", s->kind, any(20) ? guid : "{another}", "file:///", &callbacks,
                              any(2), any(2));
    s->time = 0.0;
    if (s->unit && any(4)) initialise(s->unit);
}

static void end(Slot *s) {
    for (int k = 0; k < STATES; k++) fmi2FreeFMUstate(s->unit, &s->states[k]);
    fmi2FreeInstance(s->unit);
    s->unit = NULL;
}

static void again(Slot *s) {
    if (fmi2Reset(s->unit) != fmi2OK) return;
    s->time = 0.0;
    initialise(s->unit);
}

/* Events, a step of Euler or of nonsense, and the calls around it in any order. */
static void integrate(Slot *s) {
    fmi2Real x[WIDEST] = {0}, dx[WIDEST] = {0}, z[WIDEST];
    fmi2EventInfo info = {0};
    fmi2Boolean event, terminate;
    const double size = any(9) ? 1e-3 : number();
    const size_t n = any(9) ? continuous : any(WIDEST), nz = any(9) ? indicators : any(WIDEST);
    switch (any(12)) {
        case 0: fmi2EnterEventMode(s->unit); return;
        case 1: fmi2EnterContinuousTimeMode(s->unit); return;
        case 2: fmi2NewDiscreteStates(s->unit, any(9) ? &info : NULL); return;
        case 3: fmi2CompletedIntegratorStep(s->unit, any(2), &event, &terminate); return;
        case 4: fmi2SetTime(s->unit, number()); return;
        case 5: fmi2GetNominalsOfContinuousStates(s->unit, x, n); return;
        case 6:
            fmi2GetContinuousStates(s->unit, x, n);
            for (size_t k = 0; k < n; k++) if (any(3)) x[k] = number();
            fmi2SetContinuousStates(s->unit, x, n);
            return;
        case 7: fmi2GetEventIndicators(s->unit, z, nz); return;
        default:
            if (fmi2EnterEventMode(s->unit) == fmi2Error && any(2)) again(s);
            for (int k = 0; k < 9 && fmi2NewDiscreteStates(s->unit, &info) == fmi2OK; k++)
                if (!info.newDiscreteStatesNeeded) break;
            fmi2EnterContinuousTimeMode(s->unit);
            if (fmi2GetContinuousStates(s->unit, x, n) != fmi2OK) return;
            if (fmi2GetDerivatives(s->unit, dx, n) != fmi2OK) return;
            for (size_t k = 0; k < n; k++) x[k] += size * dx[k];
            fmi2SetTime(s->unit, s->time + size);
            if (fmi2SetContinuousStates(s->unit, x, n) != fmi2OK) return;
            fmi2GetEventIndicators(s->unit, z, nz);
            if (fmi2CompletedIntegratorStep(s->unit, any(2), &event, &terminate) == fmi2OK)
                s->time += size, integrated++;
    }
}

static void step(Slot *s) {
    const double sizes[] = {1e-3, 1e-2, 0.1, 1.0, 1e-9, 0.0, -1e-3};
    const double size = any(9) ? sizes[any(any(4) ? 3 : 7)] : number();
    fmi2Status status;
    if (size > 10.0) return; /* legal, and as long as it is */
    status = fmi2DoStep(s->unit, any(20) ? s->time : number(), size, any(2));
    if (status == fmi2OK) s->time += size, stepped++;
    if (status == fmi2Error && any(2)) again(s);
}

/* Write a number anywhere into the bytes of a state, and the sum that makes it look sound. */
static void forge(fmi2Byte *bytes, size_t size) {
    const double wrong = number();
    uint32_t sum = 0xFFFFFFFFu;
    size_t count = (size - 4) / sizeof wrong, begin = (size - 4) % sizeof wrong;
    begin += sizeof wrong * (any(2) ? any(count) : count - 1 - any(8));
    memcpy(bytes + begin, &wrong, sizeof wrong);
    for (size_t k = 0; k < size - 4; k++) {
        sum ^= (unsigned char)bytes[k];
        for (int bit = 0; bit < 8; bit++) sum = sum >> 1 ^ (sum & 1 ? 0xEDB88320u : 0);
    }
    sum ^= 0xFFFFFFFFu;
    for (int k = 0; k < 4; k++) bytes[size - 4 + k] = (fmi2Byte)(sum >> 8 * k);
}

static void keep(Slot *s) {
    fmi2FMUstate *state = &s->states[any(STATES)];
    fmi2FMUstate *other = &slots[any(UNITS)].states[any(STATES)];
    size_t size = 0;
    fmi2Byte *bytes;
    switch (any(6)) {
        case 0: case 1: fmi2GetFMUstate(s->unit, state); return;
        case 2: fmi2SetFMUstate(s->unit, *state); return;
        case 3: fmi2SetFMUstate(s->unit, *other); return;
        case 4: fmi2FreeFMUstate(s->unit, state); return;
        default:
            if (fmi2SerializedFMUstateSize(s->unit, *state, &size) != fmi2OK || !size) return;
            bytes = malloc(size);
            if (fmi2SerializeFMUstate(s->unit, *state, bytes, size) == fmi2OK) {
                if (any(2) && size > 128)
                    forge(bytes, size);
                else
                    for (int flips = any(3); flips > 0; flips--) bytes[any(size)] ^= 1 << any(8);
                fmi2DeSerializeFMUstate(s->unit, bytes, any(4) ? size : any(size), state);
                if (any(2)) fmi2SetFMUstate(s->unit, *state);
            }
            free(bytes);
    }
}

static void values(Slot *s) {
    fmi2ValueReference vr[MOST], other[MOST];
    fmi2Real real[MOST], more[MOST];
    fmi2Integer integer[MOST];
    fmi2Boolean boolean[MOST];
    fmi2String text[MOST];
    const size_t count = any(MOST + 1);
    for (int k = 0; k < MOST; k++) {
        vr[k] = any(30) ? any(variables + 1) : (fmi2ValueReference)any_integer();
        other[k] = any(variables + 1);
        real[k] = number(), more[k] = number(), integer[k] = any_integer(), boolean[k] = any(3);
        text[k] = any(5) ? "text" : "";
    }
    switch (any(10)) {
        case 0: fmi2GetReal(s->unit, vr, count, real); return;
        case 1:
            if (any(6) && fmi2GetReal(s->unit, vr, count, more) == fmi2OK)
                for (size_t k = 0; k < count; k++) real[k] = more[k] * (0.9 + any(200) / 1000.0);
            fmi2SetReal(s->unit, vr, count, real);
            return;
        case 2: fmi2GetInteger(s->unit, vr, count, integer); return;
        case 3: fmi2SetInteger(s->unit, vr, count, integer); return;
        case 4: fmi2GetBoolean(s->unit, vr, count, boolean); return;
        case 5: fmi2SetBoolean(s->unit, vr, count, boolean); return;
        case 6: any(2) ? fmi2GetString(s->unit, vr, count, text)
                       : fmi2SetString(s->unit, vr, count, text); return;
        case 7: fmi2SetRealInputDerivatives(s->unit, vr, count, integer, real); return;
        case 8: fmi2GetRealOutputDerivatives(s->unit, vr, count, integer, real); return;
        default: fmi2GetDirectionalDerivative(s->unit, vr, count, other, any(MOST + 1), more, real);
    }
}

static void phase(Slot *s) {
    switch (any(8) + (any(3) ? 8 : 0)) {
        case 0: fmi2SetupExperiment(s->unit, any(2), number(), any(3) ? 0.0 : number(), any(2), number());
            return;
        case 1: case 2: fmi2EnterInitializationMode(s->unit); return;
        case 3: case 4: fmi2ExitInitializationMode(s->unit); return;
        case 5: if (any(4) == 0) fmi2Terminate(s->unit); return;
        case 6: if (any(4) == 0 && fmi2Reset(s->unit) == fmi2OK) s->time = 0.0; return;
        default: fmi2SetDebugLogging(s->unit, any(2), 0, NULL);
    }
}

int main(int count, char **arguments) {
    if (count != 8) return 2;
    load(arguments[1]);
    variables = atoi(arguments[3]), continuous = atoi(arguments[4]), indicators = atoi(arguments[5]);
    seed = strtoull(arguments[6], NULL, 10) * 2654435761u + 88172645463325252ull;
    for (int calls = atoi(arguments[7]); calls > 0; calls--) {
        Slot *s = &slots[any(UNITS)];
        scarce = any(40) == 0;
        if (!s->unit) begin(s, arguments[2]);
        if (!s->unit) continue;
        switch (any(12)) {
            case 0: case 1: case 2:
                (s->kind == fmi2ModelExchange ? any(9) != 0 : any(40) == 0) ? integrate(s) : step(s);
                break;
            case 3: case 4: keep(s); break;
            case 5: case 6: phase(s); break;
            case 7: if (any(20) == 0) end(s); break;
            default: values(s);
        }
    }
    scarce = 0;
    for (int k = 0; k < UNITS; k++) if (slots[k].unit) end(&slots[k]);
    dlclose(library);
    return blocks ? 7 : stepped < 50 ? 8 : integrated < 20 ? 9 : 0;
}
