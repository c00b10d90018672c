/* What an equation has to tell, and the arithmetic that it calls. */

/* Texts as Python writes them: %r a Real, %d an Integer, %b a Boolean, %v a Variable with its
   value and unit, %s a text. */

static void append_text(char *text, size_t *length, const char *more) {
    size_t n = strlen(more), room = TEXT_SIZE - 1 - *length;
    if (n > room) n = room;
    memcpy(text + *length, more, n);
    text[*length += n] = '\0';
}

static void format_real(double value, char *text) {
    char digits[NUMBER_SIZE], *at = text;
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
    for (int position = exponent < 0 ? exponent : 0; position < count || position <= exponent + 1; position++) {
        *at++ = position >= 0 && position < count ? digits[position] : '0';
        if ((exponent < 0 && position == exponent) || (exponent >= 0 && position == exponent)) *at++ = '.';
    }
    *at = '\0';
}

static void append_value(char *text, size_t *length, const char *kind, double value) {
    char store_count[NUMBER_SIZE];
    if (!strcmp(kind, "Real"))
        format_real(value, store_count);
    else if (!strcmp(kind, "Boolean"))
        strcpy(store_count, value != 0.0 ? "True" : "False");
    else
        snprintf(store_count, sizeof store_count, "%.0f", value);
    append_text(text, length, store_count);
}

static void append_form(char *text, size_t *length, const char *form, va_list values) {
    char letter[2] = "";
    for (; *form; form++) {
        if (*form != '%' || *++form == '%') {
            letter[0] = *form;
            append_text(text, length, letter);
        } else if (*form == 's') {
            append_text(text, length, va_arg(values, const char *));
        } else if (*form == 'v') {
            const Variable *v = va_arg(values, const Variable *);
            append_value(text, length, v->kind, va_arg(values, double));
            if (*v->unit && strcmp(v->unit, "1")) append_text(text, length, " "), append_text(text, length, v->unit);
        } else {
            const char *kind = *form == 'r' ? "Real" : *form == 'b' ? "Boolean" : "Integer";
            append_value(text, length, kind, va_arg(values, double));
        }
    }
}

static void append(Context *c, const char *form, ...) {
    va_list values;
    va_start(values, form);
    append_form(c->reason, &c->reason_length, form, values);
    va_end(values);
}

/* The first failure counts; what is computed after it is of no use. */
COLD static void fail(Context *c, const char *form, ...) {
    va_list values;
    if (c->failed) return;
    c->failed = 1;
    va_start(values, form);
    append_form(c->reason, &c->reason_length, form, values);
    va_end(values);
}

/* The same in words alone. As this is no call, what is computed stays in registers. */
INLINE void fail_constant(Context *c, const char *why) {
    if (!c->failed) c->failed = 1, c->why = why;
}

static inline void note(Context *c, const char *form, ...) {
    size_t before = c->notes_length;
    va_list values;
    if (c->failed) return;
    va_start(values, form);
    append_form(c->notes, &c->notes_length, form, values);
    va_end(values);
    append_text(c->notes, &c->notes_length, "\n");
    if (c->notes_length < TEXT_SIZE - NOTE_RESERVE && !c->dropped) return;
    c->notes[c->notes_length = before] = '\0';
    c->dropped++;
}

/* Mark results as undefined. */
static inline void fill_nan(double *values, int count) {
    while (count--) *values++ = NAN;
}

static inline void clear_context(Context *c) {
    c->failed = c->discarded = 0;
    c->why = NULL;
    c->reason[c->reason_length = 0] = '\0';
}

static inline int clear_failure(Context *c) {
    if (!c->failed) return 0;
    clear_context(c);
    return 1;
}

/* Arithmetic that Python refuses. The functions of libm are called through pointers, because
   compilers replace some by others that round otherwise. The list is made from the table of operations
   (fmukit/trace/ops.py). */

#define LIBM(name) static double (*const volatile libm_##name)(double) = name;
#define LIBM_2(name) static double (*const volatile libm_##name)(double, double) = name;
LIBM_FUNCTIONS(LIBM)
LIBM_FUNCTIONS_2(LIBM_2)

INLINE double checked(Context *c, double x, double value) {
    if (UNLIKELY(!is_finite(value))) {
        if (isnan(value) && !isnan(x)) fail_constant(c, "math domain error");
        if (isinf(value) && is_finite(x)) fail_constant(c, "math range error");
    }
    return value;
}

INLINE double defined(Context *c, double x, double value) {
    if (UNLIKELY(!is_finite(value)) && !isnan(x) && (isnan(value) || is_finite(x)))
        fail_constant(c, "math domain error");
    return value;
}

static inline double checked_integer(Context *c, double x, double value) {
    if (isnan(x)) fail_constant(c, "cannot convert float NaN to integer");
    if (isinf(x)) fail_constant(c, "cannot convert float infinity to integer");
    return value;
}

INLINE double quotient(Context *c, double a, double b) {
    if (UNLIKELY(b == 0.0)) fail_constant(c, "float division by zero");
    return a / b;
}

static inline double power(Context *c, double base, double exponent) {
    double value = libm_pow(base, exponent);
    if (!is_finite(value) && is_finite(base)) {
        if (base == 0.0)
            fail_constant(c, "0.0 cannot be raised to a negative power");
        else
            fail_constant(c, isnan(value) ? "math domain error"
                                     : "(34, 'Numerical result out of range')");
    }
    return value;
}

static inline double modulo(Context *c, double a, double b) {
    double residue = libm_fmod(a, b);
    if (b == 0.0) fail_constant(c, "float modulo");
    if (residue == 0.0) return copysign(0.0, b);
    return (b < 0.0) != (residue < 0.0) ? residue + b : residue;
}

static inline double floor_quotient(Context *c, double a, double b) {
    double residue = libm_fmod(a, b), count = (a - residue) / b, floor_of;
    if (b == 0.0) fail_constant(c, "float floor division by zero");
    if (residue != 0.0 && (b < 0.0) != (residue < 0.0)) count -= 1.0;
    if (count == 0.0) return copysign(0.0, a / b);
    floor_of = floor(count);
    return count - floor_of > 0.5 ? floor_of + 1.0 : floor_of;
}

static inline double math_fmod(Context *c, double a, double b) {
    double residue = libm_fmod(a, b);
    if (isnan(residue) && !isnan(a) && !isnan(b)) fail_constant(c, "math domain error");
    return residue;
}

static inline double math_pow(Context *c, double base, double exponent) {
    double value = libm_pow(base, exponent);
    if (!is_finite(value) && is_finite(base) && is_finite(exponent))
        fail_constant(c, isnan(value) || base == 0.0 ? "math domain error" : "math range error");
    return value;
}
