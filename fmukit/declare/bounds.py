"""Refuse physically impossible values before the first step, giving name, value, unit and bound."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import IntEnum
from math import isfinite
from typing import Any

from .interface import Interface, Variable
from .record import Value


def format_value(value: Value, unit: str) -> str:
    """A value with its unit for messages; a ratio has no unit."""
    plain = value.value if isinstance(value, IntEnum) else value
    return repr(plain) if unit in ("", "1") else f"{plain!r} {unit}"


def require_finite(variable: Variable, value: Value) -> None:
    """Raise ValueError for NaN and infinity."""
    if variable.access_type == "Real" and not isfinite(value):  # type: ignore[arg-type]
        raise ValueError(
            f"{variable.name} = {format_value(value, variable.unit)} must be a finite number"
        )


def require_bounds(variable: Variable, value: Value) -> None:
    """Raise ValueError for a value outside its declared bounds or enumeration."""
    require_finite(variable, value)
    d = variable.declaration
    if d.items is not None:
        if all(value != item for item in d.items):
            allowed = ", ".join(f"{item.value} ({item.name})" for item in d.items)
            raise ValueError(f"{variable.name} = {value!r} must be one of {allowed}")
        return
    if d.positive and value <= 0.0:  # type: ignore[operator]
        limit = "> 0"
    elif d.min is not None and not d.positive and value < d.min:  # type: ignore[operator]
        limit = f"at least {format_value(d.min, variable.unit)}"
    elif d.max is not None and value > d.max:  # type: ignore[operator]
        limit = f"at most {format_value(d.max, variable.unit)}"
    else:
        return
    raise ValueError(f"{variable.name} = {format_value(value, variable.unit)} must be {limit}")


def check_parameters(
    interface: Interface, parameters: Any, values: Sequence[Value]
) -> Iterator[str]:
    """Check the parameters, before the start and where one changes; yield warnings, raise ValueError.

    `parameters` is the record passed to the component's own `check(p)`, which yields a sentence for
    each unusual value and raises ValueError for an impossible one.
    """
    for variable in interface.variables:
        if variable.causality == "parameter":
            require_bounds(variable, values[variable.reference])
    yield from interface.model.check(parameters)


def check_start(interface: Interface, values: Sequence[Value]) -> None:
    """Check the inputs and the states before the start; raises ValueError."""
    for variable in interface.variables:
        if variable.settable_before_start and variable.causality != "parameter":
            require_bounds(variable, values[variable.reference])
