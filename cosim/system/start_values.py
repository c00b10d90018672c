"""Start values: whether a variable may have a value, and the value in the variable's type."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator
from contextlib import suppress

from ..errors import SetupError
from ..numbers import whole
from ..rounding import unit_suffix
from ..units import read_quantity
from .declarations import WIDTHS, describe_integer_type, fits
from .description import NUMERIC, Value, Variable, enumeration
from .ports import Catalog, Port, conversion_to

#: The types of FMI 2.0 that hold whole numbers, in words of FMI 3.0, of which an Enumeration has at least as many bits.
NATIVE_INTEGERS = {"Integer": "Int32", "Enumeration": "Int64"}
#: The largest finite number of 32 bits, by IEEE 754.
SINGLE = (2.0 - 2.0**-23) * 2.0**127


#: What a value of a type must be, in words.
KIND_WORDS = {
    "Real": "a finite number",
    "Integer": "a whole number",
    "Enumeration": "one of its items",
    "Boolean": "true or false",
}
#: Truth values as people and Python write them, beside the 0 and 1 of XML.
TRUTHS = {"true": True, "false": False, "True": True, "False": False}


def value_of_text(catalog: Catalog, port: Port, text: str) -> Value:
    """The one reader of values as texts: that of a Real in any unit that fits, "12mm", "0.9 MN/m", "420rpm".

    The command line, cells of tables, Python and studies read alike. Raises SetupError for a unit that does not fit;
    a text that is no value of its type is left as it is.
    """
    if port.type in ("String", "Binary"):
        return text
    quantity = read_quantity(text)
    if quantity and quantity.unit and port.type == "Real":
        factor, offset = conversion_to(catalog, port, quantity.unit, "be given")
        return factor * quantity.number + offset
    return literal(text)


def literal(text: str) -> Value:
    """A number or truth value where it is one, else the text."""
    if (text := text.strip()) in TRUTHS:
        return TRUTHS[text]
    with suppress(ValueError):
        return whole(text)
    quantity = read_quantity(text)
    return text if quantity is None or quantity.unit else quantity.number


def checked_start(catalog: Catalog, port: Port, value: Value) -> tuple[Port, Value]:
    """A start value in the type of its port; raises SetupError for one that it cannot have."""
    variable = port.variable
    if variable.causality == "structuralParameter" or port.type == "Clock":
        kind = "a clock" if port.type == "Clock" else "a structural parameter"
        raise SetupError(f"{port} is {kind} and cannot be given a start value")
    free = variable.causality in ("parameter", "input") or variable.initial in ("exact", "approx")
    if variable.variability == "constant" or not free:
        raise SetupError(
            f"{port} has causality {variable.causality} and cannot be given a start value"
        )
    if port.type not in ("String", "Binary"):
        return port, _checked_number(catalog, port, value)
    if not isinstance(value, str):
        raise SetupError(f"{port} = {value!r} must be of type {port.type}")
    if port.type == "String":
        return port, value
    try:
        return port, bytes.fromhex(value).hex()
    except ValueError:
        raise SetupError(f"{port} = {value!r} must be hexadecimal digits") from None


def _checked_number(catalog: Catalog, port: Port, value: Value) -> Value:
    """A number in the type of its port; raises SetupError for one that it cannot have, with what to write."""
    items = enumeration(port.variable)
    expected = f"one of {', '.join(items)}" if items else KIND_WORDS[port.type]
    if isinstance(value, str):
        value = items[value] if value in items else value_of_text(catalog, port, value)
    try:
        number = NUMERIC[port.type](value)
    except (TypeError, ValueError, OverflowError):
        raise SetupError(f"{port} = {value!r} must be {expected}") from None
    logical = isinstance(value, bool) and port.type != "Boolean"
    if isinstance(value, str) or logical or number != value:
        raise SetupError(f"{port} = {value!r} must be {expected}")
    limits = broken_limits(port.variable, number)
    if port.type == "Real" and not math.isfinite(number):
        limits = iter(["a finite number"])
    for limit in limits:
        raise SetupError(f"{port} = {value!r} must be {limit}{unit_suffix(port.unit)}")
    return ctypes.c_float(number).value if port.native == "Float32" else number


def broken_limits(variable: Variable, number: float) -> Iterator[str]:
    """What a number must be that a variable may have, as far as it is not: "at least 1.0", "one of 1 (low), 2 (high)"."""
    if variable.native == "Float32" and math.isinf(ctypes.c_float(number).value):
        yield f"a 32-bit floating-point number, at most {SINGLE:.7g}"
    if isinstance(number, float) and math.isnan(number):
        yield "a number"
        return
    if variable.type == "Boolean":
        if number not in (0, 1):
            yield "true or false"
        return
    native = NATIVE_INTEGERS.get(variable.native, variable.native)
    if native in WIDTHS and not fits(number, native):
        yield describe_integer_type(native)
    if variable.min is not None and not number >= (low := float(variable.min)):
        yield f"at least {low!r}"
    if variable.max is not None and not number <= (high := float(variable.max)):
        yield f"at most {high!r}"
    items = enumeration(variable)
    if items and number not in items.values():
        yield f"one of {', '.join(f'{n} ({item})' for item, n in items.items())}"
