/* FMI 2.0 over one array of values; the generated file of a component includes this. An instance is
   for co-simulation or for model exchange.

   The rules and messages are those of fmukit/fmu/python/instance.py. All values, Integers and Booleans
   too, are doubles at the index of their value reference; the parameters come first. */

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

/* A length for arrays that may have no elements, which C does not allow. */
#define SOME(n) ((n) + !(n))

/* Numbers of a course of the inputs: start, end, length, degree, bends. */
#define COURSE (2 * INPUTS + 2 + (HIGHEST_DEGREE - 1) * INPUTS)

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
#define APART __attribute__((noinline)) /* so that the short way beside it needs no registers */
#define SELDOM __attribute__((cold, noinline))
#define RARE(condition) __builtin_expect(condition, 0)
#else
#define INLINE static inline
#define APART
#define SELDOM
#define RARE(condition) (condition)
#endif

#ifndef FMI3
enum { FORMATS = 1, EVENTS_IN_STEPS = 0 };
#define UPDATE "newDiscreteStates"
#define RATES "getDerivatives"
#endif

enum { TEXT = 4096, ROOM = 64, NUMBER = 32 };
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
    double start, most;
} Variable;

typedef struct {
    int place; /* among the states */
    double nominal;
} Continuous;

/* What an equation has to tell: why it has no value, and sentences for the log. Where it has none
   for what an integrator tries, that is discarded. */
typedef struct {
    int failed, discarded, dropped;
    const char *why; /* the reason, where it is one without numbers */
    size_t reason_length, notes_length;
    char reason[TEXT], notes[TEXT];
} Context;

/* Everything that evolves. */
typedef struct {
    double values[VARIABLES], before[SOME(INPUTS)], end[SOME(INPUTS)], slopes[SOME(INPUTS)];
    double rates[HIGHEST_DEGREE][SOME(INPUTS)];
    double time, past, stale, phase, driven, kind, events;
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
static const Continuous continuous[SOME(DERIVATIVES)];
static void model_check(Context *c, const double *p);
static void model_begin(Context *c, const double *p, double t, const double *x, const double *now,
                        double *result);
static void model_course(Context *c, double hold, const double *before, const double *now,
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
static void model_guards(Context *c, const double *p, double t, const double *x, const double *u,
                         double *result);
static void model_event(Context *c, const double *p, double t, const double *x,
                        const double *before, const double *now, double which, double *result);
static void model_tangents(Context *c, const double *p, double t, const double *x, const double *u,
                           const double *d_p, double d_t, const double *d_x, const double *d_u,
                           double *result);

INLINE int is_finite(double value) { return fabs(value) <= DBL_MAX; }

/* Texts as Python writes them: %r a Real, %d an Integer, %b a Boolean, %v a Variable with its
   value and unit, %s a text. */

static void put(char *text, size_t *length, const char *more) {
    size_t n = strlen(more), room = TEXT - 1 - *length;
    if (n > room) n = room;
    memcpy(text + *length, more, n);
    text[*length += n] = '\0';
}

static void represent(double value, char *text) {
    char digits[NUMBER], *at = text;
    int precision = 1, exponent, count;
    if (!is_finite(value)) {
        strcpy(text, isnan(value) ? "nan" : value > 0 ? "inf" : "-inf");
        return;
    }
    do
        snprintf(digits, sizeof digits, "%.*e", precision - 1, value);
    while (precision++ < 17 && strtod(digits, NULL) != value);
    if (digits[0] == '-') *at++ = '-';
    memmove(digits, digits + (digits[0] == '-'), strlen(digits) + (digits[0] != '-'));
    exponent = atoi(strchr(digits, 'e') + 1);
    count = 1;
    for (char *d = digits + 1; *d != 'e'; d++)
        if (*d >= '0' && *d <= '9') digits[count++] = *d;
    while (count > 1 && digits[count - 1] == '0') count--;
    if (exponent < -4 || exponent >= 16) {
        *at++ = digits[0];
        if (count > 1) *at++ = '.';
        for (int i = 1; i < count; i++) *at++ = digits[i];
        sprintf(at, "e%c%02d", exponent < 0 ? '-' : '+', abs(exponent));
        return;
    }
    for (int place = exponent < 0 ? exponent : 0; place < count || place <= exponent + 1; place++) {
        *at++ = place >= 0 && place < count ? digits[place] : '0';
        if ((exponent < 0 && place == exponent) || (exponent >= 0 && place == exponent)) *at++ = '.';
    }
    *at = '\0';
}

static void put_value(char *text, size_t *length, const char *kind, double value) {
    char number[NUMBER];
    if (!strcmp(kind, "Real"))
        represent(value, number);
    else if (!strcmp(kind, "Boolean"))
        strcpy(number, value != 0.0 ? "True" : "False");
    else
        snprintf(number, sizeof number, "%.0f", value);
    put(text, length, number);
}

static void put_form(char *text, size_t *length, const char *form, va_list values) {
    char letter[2] = "";
    for (; *form; form++) {
        if (*form != '%' || *++form == '%') {
            letter[0] = *form;
            put(text, length, letter);
        } else if (*form == 's') {
            put(text, length, va_arg(values, const char *));
        } else if (*form == 'v') {
            const Variable *v = va_arg(values, const Variable *);
            put_value(text, length, v->kind, va_arg(values, double));
            if (*v->unit && strcmp(v->unit, "1")) put(text, length, " "), put(text, length, v->unit);
        } else {
            const char *kind = *form == 'r' ? "Real" : *form == 'b' ? "Boolean" : "Integer";
            put_value(text, length, kind, va_arg(values, double));
        }
    }
}

static void append(Context *c, const char *form, ...) {
    va_list values;
    va_start(values, form);
    put_form(c->reason, &c->reason_length, form, values);
    va_end(values);
}

/* The first failure counts; what is computed after it is of no use. */
SELDOM static void fail(Context *c, const char *form, ...) {
    va_list values;
    if (c->failed) return;
    c->failed = 1;
    va_start(values, form);
    put_form(c->reason, &c->reason_length, form, values);
    va_end(values);
}

/* The same in words alone. As this is no call, what is computed stays in registers. */
INLINE void no_value(Context *c, const char *why) {
    if (!c->failed) c->failed = 1, c->why = why;
}

static inline void note(Context *c, const char *form, ...) {
    size_t before = c->notes_length;
    va_list values;
    if (c->failed) return;
    va_start(values, form);
    put_form(c->notes, &c->notes_length, form, values);
    va_end(values);
    put(c->notes, &c->notes_length, "\n");
    if (c->notes_length < TEXT - ROOM && !c->dropped) return;
    c->notes[c->notes_length = before] = '\0';
    c->dropped++;
}

/* What has no value. */
static inline void spoil(double *values, int count) {
    while (count--) *values++ = NAN;
}

static inline void clear(Context *c) {
    c->failed = c->discarded = 0;
    c->why = NULL;
    c->reason[c->reason_length = 0] = '\0';
}

static inline int forget(Context *c) {
    if (!c->failed) return 0;
    clear(c);
    return 1;
}

/* Arithmetic that Python refuses. The functions of libm are called through pointers, because
   compilers replace some by others that round otherwise. */

#define LIBM(name) static double (*const volatile libm_##name)(double) = name;
LIBM(sin) LIBM(cos) LIBM(tan) LIBM(asin) LIBM(acos) LIBM(atan) LIBM(sinh) LIBM(cosh) LIBM(tanh)
LIBM(asinh) LIBM(acosh) LIBM(atanh) LIBM(exp) LIBM(expm1) LIBM(log) LIBM(log10) LIBM(log2)
LIBM(log1p) LIBM(erf) LIBM(erfc)
static double (*const volatile libm_pow)(double, double) = pow;
static double (*const volatile libm_atan2)(double, double) = atan2;
static double (*const volatile libm_fmod)(double, double) = fmod;

INLINE double checked(Context *c, double x, double value) {
    if (RARE(!is_finite(value))) {
        if (isnan(value) && !isnan(x)) no_value(c, "math domain error");
        if (isinf(value) && is_finite(x)) no_value(c, "math range error");
    }
    return value;
}

INLINE double defined(Context *c, double x, double value) {
    if (RARE(!is_finite(value)) && !isnan(x) && (isnan(value) || is_finite(x)))
        no_value(c, "math domain error");
    return value;
}

static inline double whole(Context *c, double x, double value) {
    if (isnan(x)) no_value(c, "cannot convert float NaN to integer");
    if (isinf(x)) no_value(c, "cannot convert float infinity to integer");
    return value;
}

INLINE double quotient(Context *c, double a, double b) {
    if (RARE(b == 0.0)) no_value(c, "float division by zero");
    return a / b;
}

static inline double power(Context *c, double base, double exponent) {
    double value = libm_pow(base, exponent);
    if (!is_finite(value) && is_finite(base)) {
        if (base == 0.0)
            no_value(c, "0.0 cannot be raised to a negative power");
        else
            no_value(c, isnan(value) ? "math domain error"
                                     : "(34, 'Numerical result out of range')");
    }
    return value;
}

static inline double modulo(Context *c, double a, double b) {
    double rest = libm_fmod(a, b);
    if (b == 0.0) no_value(c, "float modulo");
    if (rest == 0.0) return copysign(0.0, b);
    return (b < 0.0) != (rest < 0.0) ? rest + b : rest;
}

static inline double floored(Context *c, double a, double b) {
    double rest = libm_fmod(a, b), count = (a - rest) / b, floor_of;
    if (b == 0.0) no_value(c, "float floor division by zero");
    if (rest != 0.0 && (b < 0.0) != (rest < 0.0)) count -= 1.0;
    if (count == 0.0) return copysign(0.0, a / b);
    floor_of = floor(count);
    return count - floor_of > 0.5 ? floor_of + 1.0 : floor_of;
}

static inline double math_fmod(Context *c, double a, double b) {
    double rest = libm_fmod(a, b);
    if (isnan(rest) && !isnan(a) && !isnan(b)) no_value(c, "math domain error");
    return rest;
}

static inline double math_pow(Context *c, double base, double exponent) {
    double value = libm_pow(base, exponent);
    if (!is_finite(value) && is_finite(base) && is_finite(exponent))
        no_value(c, isnan(value) || base == 0.0 ? "math domain error" : "math range error");
    return value;
}

/* Instances. */

static double *part(Instance *i, int first) { return i->state.values + first; }

static void restart(Instance *i) {
    memset(&i->state, 0, sizeof i->state);
    memset(&i->context, 0, sizeof i->context);
    for (int k = 0; k < VARIABLES; k++) i->state.values[k] = variables[k].start;
    memcpy(i->state.before, part(i, FIRST_INPUT), INPUTS * sizeof(double));
    memcpy(i->state.end, part(i, FIRST_INPUT), INPUTS * sizeof(double));
    i->state.stale = 1.0;
    i->state.phase = INSTANTIATED;
    i->state.kind = i->kind;
}

/* Hosts take a message as a printf format. */
static void tell(fmi2CallbackLogger logger, fmi2ComponentEnvironment environment, const char *name,
                 fmi2Status status, const char *category, const char *message) {
    char text[2 * TEXT + 1], *at = text;
    if (!logger) return;
    for (; *message && at < text + sizeof text - 2; message++) {
        if (FORMATS && *message == '%') *at++ = '%';
        *at++ = *message;
    }
    *at = '\0';
    logger(environment, name, status, category, text);
}

/* Hand on the notes of a call, or its failure with the notes before it. */
static fmi2Status told(Instance *i) {
    Context *c = &i->context;
    fmi2Status status = fmi2OK;
    char text[TEXT];
    size_t length = 0;
    if (c->dropped) {
        put_value(c->notes, &c->notes_length, "Integer", (double)c->dropped);
        put(c->notes, &c->notes_length, " more messages are left out\n");
    }
    if (c->failed) {
        put(text, &length, i->name);
        put(text, &length, ": ");
        for (char *end, *line = c->notes; *line && length < TEXT / 2; line = end + 1) {
            *(end = strchr(line, '\n')) = '\0';
            put(text, &length, i->name), put(text, &length, ": ");
            put(text, &length, line), put(text, &length, "; ");
        }
        put(text, &length, c->why ? c->why : c->reason);
    }
    if (c->failed && c->discarded) {
        status = fmi2Discard;
        if (i->logging)
            tell(i->logger, i->environment, i->name, status, "logStatusWarning", text);
    } else if (c->failed) {
        for (int k = FIRST_STATE; k < VARIABLES; k++)
            if (!strcmp(variables[k].kind, "Real")) i->state.values[k] = NAN;
        i->state.stale = 0.0;
        i->state.phase = FAILED;
        status = fmi2Error;
        tell(i->logger, i->environment, i->name, status, "logStatusError", text);
    } else {
        for (char *end, *line = c->notes; i->logging && *line; line = end + 1) {
            if (!(end = strchr(line, '\n'))) break;
            *end = '\0';
            length = 0;
            put(text, &length, i->name), put(text, &length, ": "), put(text, &length, line);
            tell(i->logger, i->environment, i->name, fmi2Warning, "logStatusWarning", text);
        }
    }
    c->notes[c->notes_length = c->dropped = 0] = '\0';
    clear(c);
    return status;
}

/* End a call. */
INLINE fmi2Status finish(Instance *i) {
    return i->context.failed || i->context.notes_length ? told(i) : fmi2OK;
}

/* The kind of instance that has this phase. */
static int kind_of(int phase) {
    if (phase == STEPPING) return COSIMULATION;
    return phase == INTEGRATING || (phase == AT_EVENT && !EVENTS_IN_STEPS) ? EXCHANGE : EITHER;
}

static void refuse(Instance *i, const char *call, int kind, int first, int last) {
    Context *c = &i->context;
    const char *between = ", only ";
    if (kind != EITHER && kind != i->kind) {
        fail(c, "%s is for %s, but this instance is for %s", call, KINDS[kind], KINDS[i->kind]);
        return;
    }
    fail(c, "%s is not allowed %s", call, PHASES[(int)i->state.phase]);
    for (int phase = first; phase <= last; phase++)
        if (kind_of(phase) == EITHER || kind_of(phase) == i->kind)
            append(c, "%s%s", between, PHASES[phase]), between = " or ";
}

/* Whether a call is in order: for this kind of instance, in the phases from the first to the last. */
INLINE int allowed(Instance *i, const char *call, int kind, int first, int last) {
    const double phase = i->state.phase;
    if (phase >= first && phase <= last && (kind == EITHER || kind == i->kind)) return 1;
    refuse(i, call, kind, first, last);
    return 0;
}

INLINE void check_finite(Context *c, const Variable *v, double value) {
    if (!is_finite(value) && !strcmp(v->kind, "Real"))
        fail(c, "%s = %v must be a finite number", v->name, v, value);
}

/* The inputs of this instant; after a step, those at its end. */
static const double *present(Instance *i) {
    const int stepping = i->kind == COSIMULATION && i->state.phase != AT_EVENT;
    return stepping ? i->state.end : part(i, FIRST_INPUT);
}

/* What an integrator tries may fail. */
static void evaluated(Instance *i) {
    i->context.discarded = i->context.failed && i->state.phase == INTEGRATING;
}

/* Calculate the outputs from the state and the inputs of this instant. */
static void refresh(Instance *i) {
    Context *c = &i->context;
    State *s = &i->state;
    double *x = part(i, FIRST_STATE), result[SOME(STATES + OUTPUTS)];
    if (s->phase == INITIALIZING) {
        model_check(c, s->values);
        c->notes[c->notes_length = c->dropped = 0] = '\0';
        if (c->failed) return;
        memcpy(s->end, part(i, FIRST_INPUT), INPUTS * sizeof(double));
        model_initial(c, s->values, s->time, x, s->end, result);
        if (!c->failed) memcpy(x, result, STATES * sizeof *x);
    } else {
        model_outputs(c, s->values, s->time, x, present(i), result + STATES);
    }
    for (int k = 0; k < OUTPUTS; k++) check_finite(c, &variables[FIRST_OUTPUT + k], result[STATES + k]);
    evaluated(i);
    if (c->failed) return;
    memcpy(part(i, FIRST_OUTPUT), result + STATES, OUTPUTS * sizeof *result);
    s->stale = 0.0;
}

/* During initialisation, bring what has been set up to date. */
static int settled(Instance *i) {
    if (i->state.phase == INITIALIZING && i->state.stale != 0.0) refresh(i);
    return !i->context.failed;
}

/* The derivatives of the continuous states at this instant. */
static void derive(Instance *i, double *result) {
    Context *c = &i->context;
    State *s = &i->state;
    if (!settled(i)) return;
    model_derivatives(c, s->values, s->time, part(i, FIRST_STATE), present(i), result);
    for (int k = 0; k < DERIVATIVES; k++)
        check_finite(c, &variables[FIRST_DERIVATIVE + k], result[k]);
    evaluated(i);
}

/* The guards at this instant; an event is where one falls below zero. */
static void guards(Instance *i, double *result) {
    State *s = &i->state;
    if (!settled(i)) return;
    model_guards(&i->context, s->values, s->time, part(i, FIRST_STATE), present(i), result);
    evaluated(i);
}

/* The first guard that is below zero, -1 if none is. */
static int fallen(Instance *i) {
    double values[SOME(INDICATORS)];
    guards(i, values);
    for (int k = 0; k < INDICATORS && !i->context.failed; k++)
        if (values[k] < 0.0) return k;
    return -1;
}

/* The types differ in their first letters; an Enumeration is got and set as an Integer. */
INLINE int is_of(const Variable *v, const char *kind) {
    return *v->kind == *kind || (*v->kind == 'E' && *kind == 'I');
}

/* The variable of this reference; refuses what is unknown or of another type. */
INLINE const Variable *variable(Context *c, const char *kind, fmi2ValueReference reference) {
    if (reference >= VARIABLES)
        fail(c, "value reference %d is unknown", (double)reference);
    else if (!is_of(&variables[reference], kind))
        fail(c, "%s is of type %s, not %s", variables[reference].name, variables[reference].kind,
             kind);
    return c->failed ? NULL : &variables[reference];
}

INLINE int is_input(fmi2ValueReference reference) {
    return reference >= FIRST_INPUT && reference < FIRST_INPUT + INPUTS;
}

INLINE int is_integrated(fmi2ValueReference reference) {
    return reference >= FIRST_STATE && reference < FIRST_STATE + STATES &&
           *variables[reference].variability == 'c';
}

/* Whether a value may be read as it stands. */
INLINE int at_hand(const State *s, const char *kind, fmi2ValueReference reference) {
    return reference < FIRST_DERIVATIVE && is_of(&variables[reference], kind) &&
           (s->stale == 0.0 || (*kind == 'R' && s->phase == STEPPING &&
                                variables[reference].settable_before_start));
}

/* Refuse references that are not of this type; bring the outputs up to date. */
static int prepared(Instance *i, const char *kind, const fmi2ValueReference vr[], size_t n) {
    const int begun = i->state.phase != INITIALIZING; /* until then the state is to be settled */
    int held = !strcmp(kind, "Real"), derived = 0;
    for (size_t k = 0; k < n; k++) {
        if (!variable(&i->context, kind, vr[k])) return 0;
        held &= vr[k] < FIRST_STATE || (begun && variables[vr[k]].settable_before_start);
        derived |= vr[k] >= FIRST_DERIVATIVE;
    }
    if (!held && i->state.stale != 0.0 && i->state.phase != INSTANTIATED) refresh(i);
    if (derived && i->state.phase != INSTANTIATED && i->state.phase != FAILED)
        derive(i, part(i, FIRST_DERIVATIVE));
    return !i->context.failed;
}

/* Whether a value is one to set: most are inputs between steps. */
INLINE int expected(const State *s, const char *kind, fmi2ValueReference reference, double value) {
    return s->phase == STEPPING && is_input(reference) && is_of(&variables[reference], kind) &&
           is_finite(value);
}

static int may_set(Instance *i, const char *kind, fmi2ValueReference reference, double value) {
    Context *c = &i->context;
    const Variable *v = variable(c, kind, reference);
    int phase = (int)i->state.phase;
    if (!v) return 0;
    check_finite(c, v, value);
    if (c->failed) return 0;
    if (phase <= INITIALIZING ? v->settable_before_start
                              : phase <= INTEGRATING && is_input(reference))
        return 1;
    fail(c, "%s = %v cannot be set: %s %s, %s", v->name, v, value, v->variability, v->causality,
         PHASES[phase]);
    return 0;
}

/* Get and set values of any kind; a Boolean and an Integer are stored alike. */
APART static fmi2Status get(Instance *i, const char *kind, const fmi2ValueReference vr[],
                            size_t n, void *values) {
    fmi2Real *reals = values;
    fmi2Integer *integers = values;
    if (!i) return fmi2Error;
    if (!prepared(i, kind, vr, n)) return finish(i);
    for (size_t k = 0; k < n; k++) {
        if (*kind == 'R')
            reals[k] = i->state.values[vr[k]];
        else
            integers[k] = (fmi2Integer)i->state.values[vr[k]];
    }
    return finish(i);
}

APART static fmi2Status set(Instance *i, const char *kind, const fmi2ValueReference vr[],
                            size_t n, const void *values) {
    const fmi2Real *reals = values;
    const fmi2Integer *integers = values;
    if (!i) return fmi2Error;
    for (size_t k = 0; k < n; k++) {
        double value = *kind == 'R' ? reals[k] : *kind == 'B' ? integers[k] != 0 : integers[k];
        if (!may_set(i, kind, vr[k], value)) break;
        i->state.values[vr[k]] = value;
    }
    if (i->state.phase != STEPPING) i->state.stale = 1.0;
    return finish(i);
}

#define GET(Kind)                                                                              \
    EXPORT fmi2Status API(fmi2Get##Kind)(fmi2Component component, const fmi2ValueReference vr[],      \
                                  size_t n, fmi2##Kind value[]) {                              \
        Instance *i = component;                                                               \
        size_t k = 0;                                                                          \
        for (; i && k < n && at_hand(&i->state, #Kind, vr[k]); k++)                            \
            value[k] = (fmi2##Kind)i->state.values[vr[k]];                                     \
        return i && k == n ? fmi2OK : get(i, #Kind, vr, n, value);                             \
    }

#define SET(Kind, stored)                                                                      \
    EXPORT fmi2Status API(fmi2Set##Kind)(fmi2Component component, const fmi2ValueReference vr[],      \
                                  size_t n, const fmi2##Kind value[]) {                        \
        Instance *i = component;                                                               \
        size_t k = 0;                                                                          \
        for (; i && k < n && expected(&i->state, #Kind, vr[k], stored); k++)                   \
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
    prepared(i, "String", vr, n);
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
    char text[TEXT];
    size_t length = 0;
    const char *known = name ? name : "";
    Instance *i;
    (void)resources, (void)visible;
    if (!functions || !functions->allocateMemory || !functions->freeMemory) return NULL;
    if (!*known)
        put(text, &length, "an instance must have a name");
    else if (type != fmi2CoSimulation && !MODEL_EXCHANGE)
        put(text, &length, IDENTIFIER " is for co-simulation, not for model exchange");
    else if (!guid || strcmp(guid, GUID)) {
        put(text, &length, "guid ");
        put(text, &length, guid ? guid : "");
        put(text, &length, " is not that of this build, " GUID);
    } else if (!(i = functions->allocateMemory(1, sizeof *i + strlen(known) + 1))) {
        put(text, &length, "no memory for an instance");
    } else {
        strcpy(i->name, known);
        i->logger = functions->logger;
        i->allocate = functions->allocateMemory;
        i->release = functions->freeMemory;
        i->environment = functions->componentEnvironment;
        i->logging = logging;
        i->kind = type == fmi2CoSimulation ? COSIMULATION : EXCHANGE;
        restart(i);
        return i;
    }
    tell(functions->logger, functions->componentEnvironment, known, fmi2Error, "logStatusError",
         text);
    return NULL;
}

EXPORT void API(fmi2FreeInstance)(fmi2Component component) {
    Instance *i = component;
    if (i) i->release(i);
}

EXPORT fmi2Status API(fmi2SetupExperiment)(fmi2Component component, fmi2Boolean tolerance_given,
                                    fmi2Real tolerance, fmi2Real start, fmi2Boolean stop_given,
                                    fmi2Real stop) {
    Instance *i = component;
    (void)tolerance_given, (void)tolerance, (void)stop_given, (void)stop;
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
    double *x, *now, result[SOME(STATES)];
    if (!i) return fmi2Error;
    s = &i->state, x = part(i, FIRST_STATE), now = part(i, FIRST_INPUT);
    if (allowed(i, "exitInitializationMode", EITHER, INITIALIZING, INITIALIZING)) refresh(i);
    if (!i->context.failed) {
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
    restart(i);
    return fmi2OK;
}

/* The inputs over the next step as fmukit/step/hybrid.py describes them, and their slopes at its end. The
   polynomial of the derivatives given, a_n s^n, is the line between its ends and s (s - h) times
   the sum of a_n h^(n-2-j) s^j over n >= 2 and j <= n - 2. */
static void course(Instance *i, double h, double *inputs, double *slopes) {
    State *s = &i->state;
    double *now = part(i, FIRST_INPUT), *bends = inputs + 2 * INPUTS + 2;
    if (s->driven == 0.0) {
        model_course(&i->context, s->values[INPUT_HOLD], s->before, now, s->past, h, inputs);
        for (int k = 0; k < INPUTS; k++) slopes[k] = (inputs[INPUTS + k] - inputs[k]) / h;
        return;
    }
    memset(inputs, 0, COURSE * sizeof *inputs);
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
                bends[j * INPUTS + k] += a[n] * pow(h, n - 2 - j);
    }
    inputs[2 * INPUTS] = h;
    inputs[2 * INPUTS + 1] = s->driven;
}

/* Say in the reason of a failure when and where it was. */
SELDOM static void explain(Instance *i, const char *what, double t) {
    char reason[TEXT];
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
static int ready(Instance *i, double t, double h) {
    const double time = i->state.time;
    if (!allowed(i, "doStep", COSIMULATION, STEPPING, STEPPING)) return 0;
    if (!(h > 0.0 && h <= DBL_MAX))
        fail(&i->context, "communication step = %r s must be a finite number above 0", h);
    else if (!(fabs(t - time) <= 1e-3 * h + 1e-9 * fabs(time)))
        fail(&i->context, "communication point = %r s must be %r s, no jump", t, time);
    return !i->context.failed;
}

EXPORT fmi2Status API(fmi2DoStep)(fmi2Component component, fmi2Real t, fmi2Real h, fmi2Boolean final) {
    Instance *i = component;
    Context *c;
    State *s;
    double *x, *now, inputs[COURSE], slopes[SOME(INPUTS)], result[SOME(STATES)];
    (void)final;
    if (!i) return fmi2Error;
    c = &i->context, s = &i->state, x = part(i, FIRST_STATE), now = part(i, FIRST_INPUT);
    if (!ready(i, t, h)) return finish(i);
    course(i, h, inputs, slopes);
    model_step(c, s->values, t, x, s->before, now, inputs, result);
    for (int k = 0; k < STATES; k++) check_finite(c, &variables[FIRST_STATE + k], result[k]);
    if (c->failed) {
        explain(i, "step from", t);
        return finish(i);
    }
    memcpy(s->slopes, slopes, INPUTS * sizeof *slopes);
    memcpy(x, result, STATES * sizeof *x);
    memcpy(s->before, now, INPUTS * sizeof *now);
    memcpy(s->end, inputs + INPUTS, INPUTS * sizeof *inputs);
    s->time = t + h, s->past = h, s->stale = 1.0, s->driven = 0.0;
    return finish(i);
}

static int of_order(Context *c, const fmi2Integer order[], size_t n, int highest) {
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
        refuse(i, "setRealInputDerivatives", COSIMULATION, INSTANTIATED, STEPPING);
    if (!of_order(&i->context, order, n, HIGHEST_DEGREE)) return finish(i);
    for (size_t k = 0; k < n; k++) {
        const Variable *v = variable(&i->context, "Real", vr[k]);
        if (!v) return finish(i);
        if (!is_input(vr[k]) || s->phase > STEPPING) {
            fail(&i->context, "the derivative of %s cannot be set: %s %s, %s", v->name,
                 v->variability, v->causality, PHASES[(int)s->phase]);
            return finish(i);
        }
        if (!is_finite(value[k])) {
            fail(&i->context, "the derivative of %s = %r must be a finite number", v->name,
                 value[k]);
            return finish(i);
        }
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
    double d[VARIABLES] = {0}, dx[SOME(DERIVATIVES)], result[SOME(VARIABLES - FIRST_STATE)];
    if (!i) return fmi2Error;
    s = &i->state;
    if (!allowed(i, "getRealOutputDerivatives", COSIMULATION, STEPPING, STEPPING) ||
        !of_order(&i->context, order, n, 1))
        return finish(i);
    model_derivatives(&i->context, s->values, s->time, part(i, FIRST_STATE), s->end, dx);
    for (int k = 0; k < DERIVATIVES; k++) d[FIRST_STATE + continuous[k].place] = dx[k];
    model_tangents(&i->context, s->values, s->time, part(i, FIRST_STATE), s->end, d, 1.0,
                   d + FIRST_STATE, s->slopes, result);
    for (size_t k = 0; k < n && !i->context.failed; k++) {
        const Variable *v = variable(&i->context, "Real", vr[k]);
        if (v && strcmp(v->causality, "output"))
            fail(&i->context, "%s is no output", v->name);
        else if (v)
            value[k] = result[vr[k] - FIRST_STATE];
    }
    return finish(i);
}

EXPORT fmi2Status API(fmi2GetDirectionalDerivative)(fmi2Component component,
                                             const fmi2ValueReference unknown[], size_t n_unknown,
                                             const fmi2ValueReference known[], size_t n_known,
                                             const fmi2Real d_known[], fmi2Real d_unknown[]) {
    Instance *i = component;
    Context *c;
    State *s;
    double d[VARIABLES] = {0}, result[SOME(VARIABLES - FIRST_STATE)];
    if (!i) return fmi2Error;
    c = &i->context, s = &i->state;
    if (!allowed(i, "getDirectionalDerivative", EITHER, INITIALIZING, INTEGRATING))
        return finish(i);
    settled(i);
    for (size_t k = 0; k < n_known && !c->failed; k++) {
        const Variable *v = variable(c, "Real", known[k]);
        if (v && !(s->phase == INITIALIZING ? v->settable_before_start
                   : is_input(known[k]) || (i->kind == EXCHANGE && is_integrated(known[k]))))
            fail(c, "%s is not known in its own right %s", v->name, PHASES[(int)s->phase]);
        else if (v)
            d[known[k]] += d_known[k];
    }
    if (!c->failed && (i->kind == COSIMULATION || s->phase == INITIALIZING))
        model_directional(c, s->values, s->time, part(i, FIRST_STATE), s->end, d, 0.0,
                          d + FIRST_STATE, d + FIRST_INPUT, result);
    else if (!c->failed)
        model_tangents(c, s->values, s->time, part(i, FIRST_STATE), present(i), d, 0.0,
                       d + FIRST_STATE, d + FIRST_INPUT, result);
    evaluated(i);
    for (size_t k = 0; k < n_unknown && !c->failed; k++) {
        const Variable *v = variable(c, "Real", unknown[k]);
        if (v && unknown[k] < FIRST_STATE)
            fail(c, "%s is no output", v->name);
        else if (v)
            d_unknown[k] = result[unknown[k] - FIRST_STATE];
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

/* What new inputs bring about, or the first guard that has fallen. */
static void update(Instance *i, fmi2EventInfo *info) {
    Context *c = &i->context;
    State *s = &i->state;
    double *x = part(i, FIRST_STATE), *now = part(i, FIRST_INPUT), result[SOME(STATES)];
    const int is_new = memcmp(s->before, now, INPUTS * sizeof *now) != 0;
    const int which = is_new ? -1 : fallen(i);
    if (!c->failed && (is_new || which >= 0)) {
        if (++s->events > MOST_EVENTS)
            fail(c, "more than %d events, the last at %r s", (double)MOST_EVENTS, s->time);
        model_event(c, s->values, s->time, x, s->before, now, which, result);
        for (int k = 0; k < STATES; k++) check_finite(c, &variables[FIRST_STATE + k], result[k]);
        for (int k = 0; k < DERIVATIVES && !c->failed; k++)
            if (result[continuous[k].place] != x[continuous[k].place])
                info->valuesOfContinuousStatesChanged = fmi2True;
        if (!c->failed) memcpy(x, result, STATES * sizeof *x);
        memcpy(s->before, now, INPUTS * sizeof *now);
        s->stale = 1.0;
        info->newDiscreteStatesNeeded = fallen(i) >= 0;
    }
    if (c->failed) explain(i, "event at", s->time);
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

/* A guard that is below zero is an event that the importer has not seen. */
EXPORT fmi2Status API(fmi2CompletedIntegratorStep)(fmi2Component component, fmi2Boolean final,
                                            fmi2Boolean *event, fmi2Boolean *terminate) {
    Instance *i = component;
    (void)final;
    if (!i || !event || !terminate) return fmi2Error;
    *event = *terminate = fmi2False;
    if (allowed(i, "completedIntegratorStep", EXCHANGE, INTEGRATING, INTEGRATING))
        *event = fallen(i) >= 0;
    return finish(i);
}

EXPORT fmi2Status API(fmi2SetTime)(fmi2Component component, fmi2Real time) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (!allowed(i, "setTime", EXCHANGE, AT_EVENT, INTEGRATING)) return finish(i);
    if (!is_finite(time)) fail(&i->context, "time = %r s must be a finite number", time);
    evaluated(i);
    if (!i->context.failed) i->state.time = time, i->state.stale = 1.0;
    return finish(i);
}

static int of_length(Instance *i, const char *call, size_t n, size_t count) {
    if (n != count)
        fail(&i->context, "%s is for all %d at once, not for %d", call, (double)count, (double)n);
    return !i->context.failed;
}

EXPORT fmi2Status API(fmi2SetContinuousStates)(fmi2Component component, const fmi2Real x[],
                                        size_t n) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (!allowed(i, "setContinuousStates", EXCHANGE, AT_EVENT, INTEGRATING) ||
        !of_length(i, "setContinuousStates", n, DERIVATIVES))
        return finish(i);
    for (size_t k = 0; k < n; k++)
        check_finite(&i->context, &variables[FIRST_STATE + continuous[k].place], x[k]);
    evaluated(i);
    for (size_t k = 0; k < n && !i->context.failed; k++)
        part(i, FIRST_STATE)[continuous[k].place] = x[k];
    i->state.stale = 1.0;
    return finish(i);
}

/* Getters of all there are. */
#define GET_ALL(Name, name, count, first, what)                                                \
    EXPORT fmi2Status API(fmi2Get##Name)(fmi2Component component, fmi2Real value[], size_t n) { \
        Instance *i = component;                                                               \
        if (!i) return fmi2Error;                                                              \
        if (allowed(i, name, EXCHANGE, first, TERMINATED) && of_length(i, name, n, count))     \
            what;                                                                              \
        return finish(i);                                                                      \
    }

/* An importer looks for a change of sign, and a guard at zero has not fallen. */
static void indicate(Instance *i, double *value) {
    guards(i, value);
    for (int k = 0; k < INDICATORS; k++)
        if (value[k] == 0.0) value[k] = DBL_MIN;
}

static void continuous_states(Instance *i, double *value) {
    settled(i);
    for (int k = 0; k < DERIVATIVES; k++) value[k] = part(i, FIRST_STATE)[continuous[k].place];
}

static void nominals(double *value) {
    for (int k = 0; k < DERIVATIVES; k++) value[k] = continuous[k].nominal;
}

GET_ALL(Derivatives, RATES, DERIVATIVES, INITIALIZING, derive(i, value))
GET_ALL(EventIndicators, "getEventIndicators", INDICATORS, INITIALIZING, indicate(i, value))
GET_ALL(ContinuousStates, "getContinuousStates", DERIVATIVES, INITIALIZING, continuous_states(i, value))
GET_ALL(NominalsOfContinuousStates, "getNominalsOfContinuousStates", DERIVATIVES, INSTANTIATED, nominals(value))

/* The state of an instance; as bytes: the guid, the state and a checksum. */

enum { BYTES = sizeof GUID + sizeof(State) + 4 };

static unsigned long checksum(const unsigned char *bytes, size_t n) {
    unsigned long sum = 0xFFFFFFFFul;
    while (n--) {
        sum ^= *bytes++;
        for (int bit = 0; bit < 8; bit++) sum = sum >> 1 ^ (sum & 1 ? 0xEDB88320ul : 0);
    }
    return sum ^ 0xFFFFFFFFul;
}

static int among(double value, double least, double most) {
    return value >= least && value <= most && value == floor(value);
}

/* Whether an instance can have this state: who knows the checksum can write any bytes. */
static int possible(const State *s) {
    if (!among(s->phase, INSTANTIATED, FAILED) || !among(s->driven, 0.0, HIGHEST_DEGREE)) return 0;
    if (!among(s->kind, COSIMULATION, MODEL_EXCHANGE) || !among(s->events, 0.0, MOST_EVENTS)) return 0;
    if (kind_of((int)s->phase) != EITHER && kind_of((int)s->phase) != s->kind) return 0;
    if (!(is_finite(s->time) && is_finite(s->past))) return 0;
    for (int k = 0; k < VARIABLES; k++) {
        const Variable *v = &variables[k];
        const double least = *v->kind == 'B' || *v->kind == 'E' ? 0.0 : -v->most;
        if (!(s->values[k] >= least && s->values[k] <= v->most)) return 0;
        if (*v->kind != 'R' && s->values[k] != floor(s->values[k])) return 0;
    }
    return 1;
}

static Saved *saved(Instance *i, size_t more) {
    Saved *state = i->allocate(1, sizeof *state + more);
    if (!state) fail(&i->context, "no memory for an FMU state");
    return state;
}

EXPORT fmi2Status API(fmi2GetFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    Instance *i = component;
    Saved *kept;
    if (!i || !state) return fmi2Error;
    kept = *state ? *state : saved(i, 0);
    if (!kept) return finish(i);
    kept->sound = 1;
    kept->state = i->state;
    *state = kept;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2SetFMUstate)(fmi2Component component, fmi2FMUstate state) {
    Instance *i = component;
    Saved *kept = state;
    if (!i) return fmi2Error;
    if (kept && kept->sound && kept->state.kind != i->kind)
        fail(&i->context, "FMU state is of an instance for %s, but this one is for %s",
             KINDS[(int)kept->state.kind], KINDS[i->kind]);
    else if (kept && kept->sound)
        i->state = kept->state;
    else
        fail(&i->context, "FMU state is damaged or not of this build " GUID ": %d bytes",
             kept ? (double)kept->size : 0.0);
    return finish(i);
}

EXPORT fmi2Status API(fmi2FreeFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (state && *state) i->release(*state), *state = NULL;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2SerializedFMUstateSize)(fmi2Component component, fmi2FMUstate state,
                                           size_t *size) {
    Saved *kept = state;
    if (!component || !kept) return fmi2Error;
    *size = kept->sound ? BYTES : kept->size;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2SerializeFMUstate)(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[],
                                      size_t size) {
    Instance *i = component;
    Saved *kept = state;
    unsigned char *at = (unsigned char *)bytes;
    if (!i || !kept) return fmi2Error;
    if (size < (kept->sound ? BYTES : kept->size)) {
        fail(&i->context, "%d bytes are too few for an FMU state", (double)size);
    } else if (kept->sound) {
        unsigned long sum;
        memcpy(at, GUID, sizeof GUID);
        memcpy(at + sizeof GUID, &kept->state, sizeof kept->state);
        sum = checksum(at, BYTES - 4);
        for (int k = 0; k < 4; k++) at[BYTES - 4 + k] = (unsigned char)(sum >> 8 * k);
    } else {
        memcpy(at, kept->bytes, kept->size);
    }
    return finish(i);
}

EXPORT fmi2Status API(fmi2DeSerializeFMUstate)(fmi2Component component, const fmi2Byte bytes[],
                                        size_t size, fmi2FMUstate *state) {
    Instance *i = component;
    const unsigned char *at = (const unsigned char *)bytes;
    Saved *kept;
    if (!i || !state) return fmi2Error;
    if (*state) i->release(*state), *state = NULL;
    if (!(kept = saved(i, size))) return finish(i);
    kept->sound = 0;
    kept->size = size;
    if (size) memcpy(kept->bytes, bytes, size);
    if (size == BYTES && !memcmp(at, GUID, sizeof GUID)) {
        unsigned long sum = checksum(at, BYTES - 4);
        kept->sound = 1;
        for (int k = 0; k < 4; k++)
            if (at[BYTES - 4 + k] != (unsigned char)(sum >> 8 * k)) kept->sound = 0;
        memcpy(&kept->state, at + sizeof GUID, sizeof kept->state);
        kept->sound = kept->sound && possible(&kept->state);
    }
    *state = kept;
    return fmi2OK;
}

/* No step runs asynchronously, so that there is no status but one. */

EXPORT fmi2Status API(fmi2CancelStep)(fmi2Component component) {
    Instance *i = component;
    if (!i) return fmi2Error;
    tell(i->logger, i->environment, i->name, fmi2Error, "logStatusError",
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
