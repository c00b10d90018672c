"""A value and its error as texts: the one way in which both are written."""

from __future__ import annotations

import math

#: Significant digits of an error, by the Guide to the Expression of Uncertainty in Measurement (7.2.6).
ERROR_DIGITS = 2
#: Most significant digits of a value. Derived: rounding is counted as 1e-10 of a result, a unit of the eleventh.
MOST_DIGITS = 11
#: The power of ten of the last digit below which numbers are written with an exponent: 0.0000001 can be counted.
LEAST_POWER = -7
#: The power of ten from which on they are not: 0.01 has fewer zeros than an exponent has signs.
SMALL_POWER = -2
#: An error that exceeds a whole number of units by this share of a unit is not rounded up: that is rounding itself.
ROUNDING_SHARE = 1e-9


def rounded(value: float, error: float, digits: int = MOST_DIGITS) -> tuple[str, str]:
    """A value and its error as texts, the error rounded up to two digits.

    The value has the digits that the error reaches, and no more than so many significant `digits`. The error
    that is written covers the rounding of the value, too. It is "?" if the error is not finite.

    Parameters
    ----------
    value, error : float
        In the same unit; the error is not negative.
    digits : int
        The most significant digits of the value.

    Examples
    --------
    >>> rounded(40.12345, 0.0213)
    ('40.123', '0.022')
    >>> rounded(3.2e-9, 1e-11)
    ('3.200e-09', '1.0e-11')
    """
    if not (math.isfinite(error) and math.isfinite(value)):
        return f"{value:.6g}", "?"
    of_value = math.floor(math.log10(abs(value))) + 1 - digits if value else None
    if error > 0.0:
        digit = math.floor(math.log10(error)) - (ERROR_DIGITS - 1)
        digit = digit if of_value is None else max(digit, of_value)
    else:
        digit = 0 if of_value is None else min(of_value, 0)
        if value == round(value) and abs(value) < 10.0**digits:
            return f"{value:.0f}", "0"
    units = _units(value, error, digit)
    if units >= 10**ERROR_DIGITS:
        digit += 1
        units = _units(value, error, digit)
    if digit > 0:
        return f"{round(value / 10.0**digit) * 10**digit:.0f}", f"{units * 10**digit:.0f}"
    power = math.floor(math.log10(max(abs(value), error)))
    if digit >= LEAST_POWER or power >= SMALL_POWER:
        return f"{value:z.{-digit}f}", f"{units * 10.0**digit:.{-digit}f}"
    decimals = len(str(units)) - 1
    return f"{value:.{max(power - digit, 0)}e}", f"{units * 10.0**digit:.{decimals}e}"


def with_error(
    value: float, error: float, unit: str = "", sign: str = "+-", digits: int = MOST_DIGITS
) -> str:
    """A value, its error and its unit as a text, or a bound where the error leaves no digit of the value.

    What is smaller than its error is not measured but bounded (Currie, Analytical Chemistry 40, 1968).

    Examples
    --------
    >>> with_error(40.12345, 0.0213, "rad/s")
    '40.123 +- 0.022 rad/s'
    >>> with_error(200.0, 230.0, "N.m")
    'below 430 N.m in size'
    """
    unit = unit_suffix(unit)
    if not has_digit(value, error) and math.isfinite(error):
        return f"below {rounded(0.0, abs(value) + error)[1]}{unit} in size"
    number, of_number = rounded(value, error, digits)
    return f"{number} {sign} {of_number}{unit}"


def unit_suffix(unit: str) -> str:
    """A unit as it follows its number, after a space; "" for none and for 1."""
    return "" if unit in ("", "1") else f" {unit}"


def has_digit(value: float, error: float) -> bool:
    """Whether an error leaves a digit of a value; else only a bound of its size is known."""
    return not (error > 0.0 and error >= abs(value))


def _units(value: float, error: float, digit: int) -> int:
    """The error with that of rounding the value, in units of the digit 10**digit, rounded up."""
    unit = 10.0**digit
    share = (error + abs(value - round(value / unit) * unit)) / unit
    return max(1, math.ceil(share - ROUNDING_SHARE))
