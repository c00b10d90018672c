/* The part of __init__.py by FMI 2.0, which has no events that a master could learn of. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#pragma clang diagnostic ignored "-Wunused-parameter"

enum { U = 1, D, X, E = 5, A, B, C, RESET_AT, KEPT, SWITCH_AT, Y, REALS };
typedef struct {
    double r[REALS], t;
} Instance;
#define INSTANCE Instance *i = p

static Instance *fresh(Instance *i) {
    memset(i, 0, sizeof *i);
    i->r[RESET_AT] = i->r[SWITCH_AT] = 1e300, i->r[KEPT] = 1.0;
    return i;
}
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *host, fmi2Boolean visible, fmi2Boolean logging) {
    return fresh(malloc(sizeof(Instance)));
}
void fmi2FreeInstance(fmi2Component p) { free(p); }
fmi2Status fmi2SetDebugLogging(fmi2Component p, fmi2Boolean on, size_t n, const fmi2String kinds[]) {
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component p, fmi2Boolean tolerates, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stops, fmi2Real stop) {
    return ((Instance *)p)->t = start, fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component p) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component p) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component p) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component p) { return fresh(p), fmi2OK; }

static void drift(Instance *i, double h) {
    double *r = i->r, a = r[A], grown = a == 0.0 ? h : expm1(a * h) / a;
    r[X] += grown * (a * r[X] + r[B] * r[U] + r[C] * r[D]), i->t += h;
}
/* At RESET_AT, which nobody is told, x keeps the share KEPT of its value. */
fmi2Status fmi2DoStep(fmi2Component p, fmi2Real t, fmi2Real h, fmi2Boolean final) {
    INSTANCE;
    double at = i->r[RESET_AT], end = t + h;
    if (i->t < at && at <= end) drift(i, at - i->t), i->r[X] *= i->r[KEPT];
    return drift(i, end - i->t), i->t = end, fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component p, const fmi2ValueReference ref[], size_t n, fmi2Real value[]) {
    INSTANCE;
    i->r[E] = i->r[D], i->r[Y] = i->t > i->r[SWITCH_AT];
    for (size_t k = 0; k < n; k++) value[k] = i->r[ref[k]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component p, const fmi2ValueReference ref[], size_t n, const fmi2Real value[]) {
    INSTANCE;
    for (size_t k = 0; k < n; k++) i->r[ref[k]] = value[k];
    return fmi2OK;
}
fmi2Status fmi2CancelStep(fmi2Component p) { return fmi2Error; }
#define NONE(name, ...) fmi2Status fmi2##name(fmi2Component p, __VA_ARGS__) { return fmi2Error; }
NONE(GetInteger, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
NONE(GetBoolean, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
NONE(GetString, const fmi2ValueReference r[], size_t n, fmi2String v[])
NONE(SetInteger, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
NONE(SetBoolean, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
NONE(SetString, const fmi2ValueReference r[], size_t n, const fmi2String v[])
NONE(SetRealInputDerivatives, const fmi2ValueReference r[], size_t n, const fmi2Integer o[], const fmi2Real v[])
NONE(GetRealOutputDerivatives, const fmi2ValueReference r[], size_t n, const fmi2Integer o[], fmi2Real v[])
NONE(GetStatus, const fmi2StatusKind k, fmi2Status *v)
NONE(GetRealStatus, const fmi2StatusKind k, fmi2Real *v)
NONE(GetIntegerStatus, const fmi2StatusKind k, fmi2Integer *v)
NONE(GetBooleanStatus, const fmi2StatusKind k, fmi2Boolean *v)
NONE(GetStringStatus, const fmi2StatusKind k, fmi2String *v)
NONE(GetDirectionalDerivative, const fmi2ValueReference a[], size_t n, const fmi2ValueReference b[], size_t m, const fmi2Real s[], fmi2Real v[])

fmi2Status fmi2GetFMUstate(fmi2Component p, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(Instance));
    return memcpy(*state, p, sizeof(Instance)), fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component p, fmi2FMUstate state) {
    return memcpy(p, state, sizeof(Instance)), fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component p, fmi2FMUstate *state) {
    return free(*state), *state = NULL, fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component p, fmi2FMUstate state, size_t *size) {
    return *size = sizeof(Instance), fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component p, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    return memcpy(bytes, state, size), fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component p, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    if (!*state) *state = malloc(size);
    return memcpy(*state, bytes, size), fmi2OK;
}
