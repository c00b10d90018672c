/* What an equation has to tell, and the arithmetic that it calls. */

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
