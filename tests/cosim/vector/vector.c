/* z' = u2 - z, x1' = x2, x2' = k u1 - 4 x1, y = x + u / 2; x1 changes its sign at 0.5 s. See __init__.py. */

#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#pragma clang diagnostic ignored "-Wunused-parameter"

enum { TIME, Z, X, U, Y, K, DZ, DX };
enum { STARTING, EVENT, CONTINUOUS };
typedef struct {
    double t, x[3], u[2], k;
    int mode, turned;
} Instance;
#define INSTANCE Instance *i = p
#define REQUIRE(mode_) if (i->mode != (mode_)) return fmi3Error

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String where,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment host, fmi3LogMessageCallback log) {
    Instance *i = calloc(1, sizeof *i);
    return i->x[0] = 1.0, i->x[1] = 0.2, i->k = 1.0, i;
}
void fmi3FreeInstance(fmi3Instance p) { free(p); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance p, fmi3Boolean tolerates, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop) {
    return ((Instance *)p)->t = start, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance p) { return ((Instance *)p)->mode = EVENT, fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance p) {
    INSTANCE;
    REQUIRE(CONTINUOUS);
    return i->mode = EVENT, fmi3OK;
}
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance p) {
    INSTANCE;
    REQUIRE(EVENT);
    return i->mode = CONTINUOUS, fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance p) { return fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance p, fmi3Boolean *again, fmi3Boolean *end,
                                    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *timed,
                                    fmi3Float64 *time) {
    INSTANCE;
    REQUIRE(EVENT);
    *again = *end = *nominals = *values = false;
    if (!i->turned && i->t >= 0.5) i->x[1] = -i->x[1], i->turned = *values = true;
    return *timed = !i->turned, *time = 0.5, fmi3OK;
}
fmi3Status fmi3SetTime(fmi3Instance p, fmi3Float64 t) { return ((Instance *)p)->t = t, fmi3OK; }

static void rates(const Instance *i, double dx[3]) {
    dx[0] = i->u[1] - i->x[0], dx[1] = i->x[2], dx[2] = i->k * i->u[0] - 4.0 * i->x[1];
}
fmi3Status fmi3GetFloat64(fmi3Instance p, const fmi3ValueReference ref[], size_t n, fmi3Float64 value[],
                          size_t count) {
    INSTANCE;
    double dx[3], *end = value + count;
    rates(i, dx);
    for (size_t j = 0; j < n; j++) switch (ref[j]) {
        case TIME: *value++ = i->t; break;
        case Z: *value++ = i->x[0]; break;
        case K: *value++ = i->k; break;
        case DZ: *value++ = dx[0]; break;
        default:
            for (int e = 0; e < 2; e++)
                *value++ = ref[j] == X ? i->x[1 + e] : ref[j] == U ? i->u[e] : ref[j] == DX ? dx[1 + e]
                         : i->x[1 + e] + i->u[e] / 2.0;
        }
    return value == end ? fmi3OK : fmi3Error;
}
fmi3Status fmi3SetFloat64(fmi3Instance p, const fmi3ValueReference ref[], size_t n,
                          const fmi3Float64 value[], size_t count) {
    INSTANCE;
    const double *end = value + count;
    for (size_t j = 0; j < n; j++) {
        if (ref[j] == K && i->mode == CONTINUOUS) return fmi3Error;
        if (ref[j] == K) i->k = *value++;
        else if (ref[j] == Z) i->x[0] = *value++;
        else memcpy(ref[j] == X ? i->x + 1 : i->u, value, 2 * sizeof *value), value += 2;
    }
    return value == end ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetContinuousStates(fmi3Instance p, fmi3Float64 x[], size_t n) {
    return memcpy(x, ((Instance *)p)->x, n * sizeof *x), n == 3 ? fmi3OK : fmi3Error;
}
fmi3Status fmi3SetContinuousStates(fmi3Instance p, const fmi3Float64 x[], size_t n) {
    INSTANCE;
    REQUIRE(CONTINUOUS);
    return memcpy(i->x, x, n * sizeof *x), n == 3 ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance p, fmi3Float64 dx[], size_t n) {
    return rates(p, dx), n == 3 ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance p, fmi3Float64 x[], size_t n) {
    for (size_t j = 0; j < n; j++) x[j] = 1.0;
    return fmi3OK;
}
/* The model is linear: the rates and outputs of the seed alone. */
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance p, const fmi3ValueReference unknown[], size_t n,
                                        const fmi3ValueReference inputs[], size_t m,
                                        const fmi3Float64 seed[], size_t seeds, fmi3Float64 result[],
                                        size_t results) {
    Instance d = {.k = ((Instance *)p)->k};
    fmi3Status status = fmi3SetFloat64(&d, inputs, m, seed, seeds);
    return status == fmi3OK ? fmi3GetFloat64(&d, unknown, n, result, results) : status;
}
