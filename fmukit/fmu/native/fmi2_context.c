/* What an equation has to tell, and the arithmetic that it calls. */

/* Texts as Python writes them: %r a Real, %d an Integer, %b a Boolean, %v a Variable with its
   value and unit, %s a text. */

static void append_text(char *text, size_t *length, const char *more) {
    size_t n = strlen(more), room = TEXT_SIZE - 1 - *length;
    if (n > room) n = room;
    memcpy(text + *length, more, n);
    text[*length += n] = '\0';
}

/* Natural numbers in LIMBS pieces of 32 bits, the lowest first. */

COLD static void big_multiply(Big *a, uint32_t factor) {
    uint64_t carry = 0;
    for (int k = 0; k < LIMBS; k++) {
        carry += (uint64_t)a->limbs[k] * factor;
        a->limbs[k] = (uint32_t)carry;
        carry >>= 32;
    }
}

COLD static void big_shift(Big *a, int bits) {
    for (; bits > 31; bits -= 31) big_multiply(a, UINT32_C(1) << 31);
    big_multiply(a, UINT32_C(1) << bits);
}

COLD static void big_subtract(Big *a, const Big *b) {
    uint64_t borrow = 0;
    for (int k = 0; k < LIMBS; k++) {
        borrow = (uint64_t)a->limbs[k] - b->limbs[k] - borrow;
        a->limbs[k] = (uint32_t)borrow;
        borrow = borrow >> 32 & 1;
    }
}

/* The sign of a + b - c. Pieces below one in which the sum is 2 or more cannot change it. */
COLD static int big_compare(const Big *a, const Big *b, const Big *c) {
    int64_t sum = 0;
    for (int k = LIMBS - 1; k >= 0 && sum > -2 && sum < 2; k--)
        sum = sum * (INT64_C(1) << 32) + a->limbs[k] + b->limbs[k] - c->limbs[k];
    return (sum > 0) - (sum < 0);
}

/* The digits of the shortest decimal that reads back as this positive number, of those the nearest, and
   the power of ten of the first digit. With integers alone, it is the same on every platform.

   The number is r / s; what lies less than low / s below it or high / s above it reads back as it. The
   algorithm is Steele and White's as in R. G. Burger and R. K. Dybvig, Printing floating-point numbers
   quickly and accurately, PLDI 1996. */
COLD static int shortest_decimal(double value, char *digits) {
    static const Big zero;
    Big r = {{0}}, s = {{1}}, low = {{1}}, high = {{1}}, ten_s;
    uint64_t bits, fraction;
    int exponent, leading, power, digit, is_even, is_boundary, is_low, is_high, half;
    memcpy(&bits, &value, sizeof bits);
    fraction = bits & ((UINT64_C(1) << 52) - 1), exponent = (int)(bits >> 52);
    is_even = !(fraction & 1);
    is_boundary = fraction == 0 && exponent > 1; /* the next number below is half as far */
    if (exponent) fraction |= UINT64_C(1) << 52;
    exponent += !exponent - 1075;
    r.limbs[0] = (uint32_t)fraction, r.limbs[1] = (uint32_t)(fraction >> 32);
    big_shift(&r, (exponent > 0 ? exponent : 0) + 1 + is_boundary);
    big_shift(&s, (exponent < 0 ? -exponent : 0) + 1 + is_boundary);
    big_shift(&low, exponent > 0 ? exponent : 0);
    big_shift(&high, (exponent > 0 ? exponent : 0) + is_boundary);
    for (leading = exponent - 1; fraction; fraction >>= 1) leading++; /* the power of two of the first bit */
    power = (int)floor(leading * 0.30102999566398120); /* log10(2): right or one too small */
    for (int k = 0; k < power; k++) big_multiply(&s, 10);
    for (int k = 0; k > power; k--) big_multiply(&r, 10), big_multiply(&low, 10), big_multiply(&high, 10);
    ten_s = s, big_multiply(&ten_s, 10);
    if (big_compare(&r, &high, &ten_s) > -is_even) s = ten_s, power++;
    for (;; big_multiply(&r, 10), big_multiply(&low, 10), big_multiply(&high, 10)) {
        for (digit = '0'; big_compare(&r, &zero, &s) >= 0; digit++) big_subtract(&r, &s);
        is_low = big_compare(&r, &zero, &low) < is_even;
        is_high = big_compare(&r, &high, &s) > -is_even;
        if (is_low || is_high) break;
        *digits++ = (char)digit;
    }
    half = big_compare(&r, &r, &s);
    if (is_high && (!is_low || half > 0 || (half == 0 && digit % 2))) digit++;
    *digits++ = (char)digit, *digits = '\0';
    return power;
}

COLD static void format_real(double value, char *text) {
    char digits[NUMBER_SIZE] = "0", *at = text;
    int exponent = 0, count;
    if (!is_finite(value)) {
        strcpy(text, isnan(value) ? "nan" : value > 0 ? "inf" : "-inf");
        return;
    }
    if (copysign(1.0, value) < 0.0) *at++ = '-';
    if (value != 0.0) exponent = shortest_decimal(fabs(value), digits);
    count = (int)strlen(digits);
    if (exponent < -4 || exponent >= 16) {
        const int size = exponent < 0 ? -exponent : exponent;
        *at++ = digits[0];
        if (count > 1) *at++ = '.';
        for (int i = 1; i < count; i++) *at++ = digits[i];
        *at++ = 'e', *at++ = exponent < 0 ? '-' : '+';
        if (size >= 100) *at++ = (char)('0' + size / 100);
        *at++ = (char)('0' + size / 10 % 10), *at++ = (char)('0' + size % 10), *at = '\0';
        return;
    }
    for (int position = exponent < 0 ? exponent : 0; position < count || position <= exponent + 1; position++) {
        *at++ = position >= 0 && position < count ? digits[position] : '0';
        if (position == exponent) *at++ = '.';
    }
    *at = '\0';
}

COLD static void format_integer(double value, char *text) {
    char digits[NUMBER_SIZE], *at = digits + sizeof digits - 1;
    uint64_t rest;
    if (!(fabs(value) < 18446744073709551616.0)) { /* 2^64 */
        format_real(value, text);
        return;
    }
    rest = (uint64_t)fabs(value);
    *at = '\0';
    do
        *--at = (char)('0' + rest % 10);
    while (rest /= 10);
    if (value <= -1.0) *--at = '-';
    strcpy(text, at);
}

static void append_value(char *text, size_t *length, const char *kind, double value) {
    char number[NUMBER_SIZE];
    if (!strcmp(kind, "Real"))
        format_real(value, number);
    else if (!strcmp(kind, "Boolean"))
        strcpy(number, value != 0.0 ? "True" : "False");
    else
        format_integer(value, number);
    append_text(text, length, number);
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
