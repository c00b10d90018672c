"""Start values: whether a variable may have a value, and the value in the variable's type."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator

from ..errors import SetupError
from .arrays import WIDTHS
from .description import NUMERIC, Value, enumeration
from .ports import Port


def checked_start(port: Port, value: Value) -> tuple[Port, Value]:
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
    if port.type in ("String", "Binary"):
        if not isinstance(value, str):
            raise SetupError(f"{port} = {value!r} must be of type {port.type}")
        if port.type == "Binary":
            try:
                value = bytes.fromhex(value).hex()
            except ValueError:
                raise SetupError(f"{port} = {value!r} must be hexadecimal digits") from None
        return port, value
    items = enumeration(port.variable)
    try:
        value = items.get(value, value) if isinstance(value, str) else value
        number = NUMERIC[port.type](value)
    except (TypeError, ValueError):
        expected = f"one of {', '.join(items)}" if items else f"of type {port.type}"
        raise SetupError(f"{port} = {value!r} must be {expected}") from None
    logical = isinstance(value, bool) and port.type != "Boolean"
    if isinstance(value, str) or logical or number != value:
        expected = f"of type {port.type}" if logical or port.type != "Real" else "a finite number"
        raise SetupError(f"{port} = {value!r} must be {expected}")
    if not math.isfinite(number):
        raise SetupError(f"{port} = {value!r} must be a finite number")
    for limit in _broken_limits(port, number):
        unit = "" if port.unit in ("", "1") else f" {port.unit}"
        raise SetupError(f"{port} = {value!r} must be {limit}{unit}")
    if items and number not in items.values():
        choices = ", ".join(f"{n} ({item})" for item, n in items.items())
        raise SetupError(f"{port} = {value!r} must be one of {choices}")
    return port, ctypes.c_float(number).value if port.native == "Float32" else number


def _broken_limits(port: Port, number: float) -> Iterator[str]:
    """The limits of a port that a number does not keep."""
    if port.type == "Boolean":
        if number not in (0, 1):
            yield "true or false"
        return
    if port.type == "Integer":
        bits, signed = WIDTHS.get(port.native, (32, True))
        lowest, highest = (-(2 ** (bits - 1)), 2 ** (bits - 1)) if signed else (0, 2**bits)
        if not lowest <= number < highest:
            article = "an" if str(bits).startswith("8") else "a"
            yield f"{article} {bits}-bit {'' if signed else 'unsigned '}integer"
    if port.variable.min is not None and not number >= (low := float(port.variable.min)):
        yield f"at least {low!r}"
    if port.variable.max is not None and not number <= (high := float(port.variable.max)):
        yield f"at most {high!r}"
