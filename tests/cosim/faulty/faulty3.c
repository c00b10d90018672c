/* The same FMU, with the same faults, by FMI 3.0: a step that is discarded leaves it as it was. */

#include "faulty.c"
#include "fmi3Functions.h"
#define REFS3 const fmi3ValueReference ref[], size_t n
#ifndef VERSION3
#define VERSION3 fmi3Version
#endif

const char *fmi3GetVersion(void) { return VERSION3; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String where,
                                         fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
                                         fmi3Boolean early, const fmi3ValueReference outputs[], size_t n,
                                         fmi3InstanceEnvironment host, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    return fmi2Instantiate(name, fmi2CoSimulation, token, where, NULL, visible, logging);
}
void fmi3FreeInstance(fmi3Instance p) { fmi2FreeInstance(p); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance p, fmi3Boolean tolerates, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop) {
    fmi2SetupExperiment(p, tolerates, tolerance, start, stops, stop);
    return (fmi3Status)fmi2EnterInitializationMode(p);
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance p) {
    return (fmi3Status)fmi2ExitInitializationMode(p);
}
fmi3Status fmi3Terminate(fmi3Instance p) { return (fmi3Status)fmi2Terminate(p); }
fmi3Status fmi3Reset(fmi3Instance p) { return (fmi3Status)fmi2Reset(p); }
fmi3Status fmi3GetFloat64(fmi3Instance p, REFS3, fmi3Float64 value[], size_t values) {
    return (fmi3Status)fmi2GetReal(p, ref, n, value);
}
fmi3Status fmi3SetFloat64(fmi3Instance p, REFS3, const fmi3Float64 value[], size_t values) {
    return (fmi3Status)fmi2SetReal(p, ref, n, value);
}
fmi3Status fmi3GetInt32(fmi3Instance p, REFS3, fmi3Int32 value[], size_t values) {
    return (fmi3Status)fmi2GetInteger(p, ref, n, value);
}
fmi3Status fmi3DoStep(fmi3Instance p, fmi3Float64 t, fmi3Float64 h, fmi3Boolean final,
                      fmi3Boolean *event, fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *reached) {
    Instance *i = p;
    State before = i->s;
    fmi2Status status = fmi2DoStep(p, t, h, final);
    *event = *end = *early = false, *reached = t + h;
    if (status == fmi2Discard && !FAULT("moves in a discard")) i->s = before;
    return (fmi3Status)status;
}
fmi3Status fmi3GetFMUState(fmi3Instance p, fmi3FMUState *state) {
    return (fmi3Status)fmi2GetFMUstate(p, state);
}
fmi3Status fmi3SetFMUState(fmi3Instance p, fmi3FMUState state) {
    return (fmi3Status)fmi2SetFMUstate(p, state);
}
fmi3Status fmi3FreeFMUState(fmi3Instance p, fmi3FMUState *state) {
    return (fmi3Status)fmi2FreeFMUstate(p, state);
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance p, fmi3FMUState state, size_t *size) {
    return (fmi3Status)fmi2SerializedFMUstateSize(p, state, size);
}
fmi3Status fmi3SerializeFMUState(fmi3Instance p, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    return (fmi3Status)fmi2SerializeFMUstate(p, state, (fmi2Byte *)bytes, size);
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance p, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState *state) {
    return (fmi3Status)fmi2DeSerializeFMUstate(p, (const fmi2Byte *)bytes, size, state);
}
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance p, const fmi3ValueReference unknown[], size_t n,
                                        const fmi3ValueReference inputs[], size_t m,
                                        const fmi3Float64 seed[], size_t seeds, fmi3Float64 result[],
                                        size_t results) {
    return (fmi3Status)fmi2GetDirectionalDerivative(p, unknown, n, inputs, m, seed, result);
}
