/* Two states, x' = A x + B u or a swing that bounces, with resets that nobody is told; __init__.py says what. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#pragma clang diagnostic ignored "-Wunused-parameter"

enum { U1 = 1, U2, X1, X2, Z, S, A11, A12, A21, A22, B11, B12, B21, B22, C1, C2, D1, D2, FIRST, PERIOD, KEEP1,
       KEEP2, RISE, SWINGS, FLOOR, DX1, DX2, REALS };
typedef struct {
    double r[REALS], t, since;
    int happened;
} Instance;
#define INSTANCE Instance *i = p
#define FINE 2e-3 /* the longest step of the classical Runge-Kutta method, over the time of the fastest motion */

static Instance *fresh(Instance *i) {
    memset(i, 0, sizeof *i);
    i->r[FIRST] = 1e300, i->r[KEEP1] = i->r[KEEP2] = 1.0, i->r[FLOOR] = -1e300;
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
    INSTANCE;
    return i->t = i->since = start, fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component p) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component p) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component p) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component p) { return fresh(p), fmi2OK; }

/* (x, 1) -> exp(h M) (x, 1) by a Taylor series, scaled and squared. */
static void flow(const double *r, double h, const double x[2], double end[2]) {
    double m[3][3] = {{r[A11] * h, r[A12] * h, (r[B11] * r[U1] + r[B12] * r[U2]) * h},
                      {r[A21] * h, r[A22] * h, (r[B21] * r[U1] + r[B22] * r[U2]) * h}, {0, 0, 0}};
    double size = 0, e[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, term[3][3], next[3][3];
    for (int j = 0; j < 2; j++) size = fmax(size, fabs(m[j][0]) + fabs(m[j][1]));
    int halvings = size > 0.25 ? (int)ceil(log2(size / 0.25)) : 0;
    for (int j = 0; j < 9; j++) m[j / 3][j % 3] = ldexp(m[j / 3][j % 3], -halvings);
    memcpy(term, e, sizeof e);
#define TIMES(to, left, right)                                                                        \
    for (int j = 0; j < 3; j++)                                                                       \
        for (int k = 0; k < 3; k++) to[j][k] = left[j][0] * right[0][k] + left[j][1] * right[1][k] + left[j][2] * right[2][k]
    for (int n = 1; n <= 14; n++) {
        TIMES(next, term, m);
        for (int j = 0; j < 9; j++) term[j / 3][j % 3] = next[j / 3][j % 3] / n, e[j / 3][j % 3] += term[j / 3][j % 3];
    }
    for (; halvings > 0; halvings--) {
        TIMES(next, e, e);
        memcpy(e, next, sizeof e);
    }
    for (int j = 0; j < 2; j++) end[j] = e[j][0] * x[0] + e[j][1] * x[1] + e[j][2];
}
static void rates(const double *r, const double x[2], double dx[2]) {
    double drive1 = r[B11] * r[U1] + r[B12] * r[U2], drive2 = r[B21] * r[U1] + r[B22] * r[U2];
    double level = r[SWINGS] ? sin(x[0]) : x[0];
    dx[0] = r[A11] * x[0] + r[A12] * x[1] + drive1, dx[1] = r[A21] * level + r[A22] * x[1] + drive2;
}
static void swing(const double *r, double h, const double x[2], double end[2]) {
    double fastest = sqrt(fabs(r[A21] * r[A12])) + fabs(r[A11]) + fabs(r[A22]) + 1e-9, y[2] = {x[0], x[1]};
    int n = 1 + (int)(fabs(h) * fastest / FINE);
    for (int s = 0; s < n; s++) {
        double k[5][2] = {{0}}, shares[4] = {0, 0.5, 0.5, 1}, z[2];
        for (int m = 0; m < 4; m++) {
            for (int j = 0; j < 2; j++) z[j] = y[j] + shares[m] * h / n * k[m][j];
            rates(r, z, k[m + 1]);
        }
        for (int j = 0; j < 2; j++) y[j] += h / n / 6 * (k[1][j] + 2 * k[2][j] + 2 * k[3][j] + k[4][j]);
    }
    end[0] = y[0], end[1] = y[1];
}
static void move(Instance *i, double h) {
    double *r = i->r, end[2];
    (r[SWINGS] ? swing : flow)(r, h, r + X1, end);
    memcpy(r + X1, end, sizeof end), i->t += h;
}
/* The first passing of FLOOR downwards within h, or h. */
static double landing(const Instance *i, double h) {
    const double *r = i->r;
    if (r[FLOOR] < -1e299) return h;
    double low = 0, high, end[2], before = r[X1] - r[FLOOR], piece = h;
    while (piece > 0.02) piece /= 2;
    for (high = piece; high <= h * (1 + 1e-12); low = high, high += piece, before = end[0] - r[FLOOR]) {
        swing(r, high, r + X1, end);
        if (before >= -1e-13 && end[0] < r[FLOOR] && end[1] < 0 && !(low == 0 && before < 1e-12 && r[X2] <= 0)) {
            while (high - low > 1e-14) {
                double middle = 0.5 * (low + high);
                if (middle == low || middle == high) break;
                swing(r, middle, r + X1, end);
                *(end[0] >= r[FLOOR] ? &low : &high) = middle;
            }
            return high;
        }
    }
    return h;
}
fmi2Status fmi2DoStep(fmi2Component p, fmi2Real t, fmi2Real h, fmi2Boolean final) {
    INSTANCE;
    double *r = i->r, end = t + h;
    for (;;) {
        double due = r[FIRST] + i->happened * r[PERIOD];
        double until = due <= end ? due : end, lands = landing(i, until - i->t);
        if (i->t + lands < until) {
            move(i, lands), r[X1] = r[FLOOR], r[X2] = -r[KEEP2] * r[X2];
            continue;
        }
        move(i, until - i->t), i->t = until;
        if (due > end) break;
        r[X1] *= r[KEEP1], r[X2] *= r[KEEP2], i->since = due;
        if (r[PERIOD] <= 0.0) r[FIRST] = 1e300;
        else i->happened++;
    }
    return i->t = end, fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component p, const fmi2ValueReference ref[], size_t n, fmi2Real value[]) {
    INSTANCE;
    double *r = i->r;
    r[Z] = r[C1] * r[X1] + r[C2] * r[X2] + r[D1] * r[U1] + r[D2] * r[U2], r[S] = r[RISE] * (i->t - i->since);
    rates(r, r + X1, r + DX1);
    for (size_t k = 0; k < n; k++) value[k] = r[ref[k]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component p, const fmi2ValueReference ref[], size_t n, const fmi2Real value[]) {
    INSTANCE;
    for (size_t k = 0; k < n; k++) i->r[ref[k]] = value[k];
    return fmi2OK;
}
#define NONE(name, ...) fmi2Status fmi2##name(fmi2Component p, ##__VA_ARGS__) { return fmi2Error; }
NONE(CancelStep)
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
/* Model exchange, of what has no events. */
fmi2Status fmi2SetTime(fmi2Component p, fmi2Real t) { return ((Instance *)p)->t = t, fmi2OK; }
fmi2Status fmi2EnterEventMode(fmi2Component p) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component p, fmi2EventInfo *info) {
    return memset(info, 0, sizeof *info), fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component p) { return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component p, fmi2Boolean last, fmi2Boolean *event, fmi2Boolean *ends) {
    return *event = *ends = fmi2False, fmi2OK;
}
fmi2Status fmi2SetContinuousStates(fmi2Component p, const fmi2Real x[], size_t n) {
    return memcpy(((Instance *)p)->r + X1, x, n * sizeof *x), fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component p, fmi2Real x[], size_t n) {
    return memcpy(x, ((Instance *)p)->r + X1, n * sizeof *x), fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component p, fmi2Real dx[], size_t n) {
    INSTANCE;
    return rates(i->r, i->r + X1, dx), fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component p, fmi2Real x[], size_t n) { return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component p, fmi2Real x[], size_t n) {
    for (size_t k = 0; k < n; k++) x[k] = 1.0;
    return fmi2OK;
}
