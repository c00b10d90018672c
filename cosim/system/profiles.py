"""What inputs and tunable parameters follow over time, checked and in their own units."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import wraps

from ..errors import SetupError
from .description import Value, declared_start
from .inputs import FunctionInput, Table, parse_change
from .ports import Catalog, Port, conversion_to, is_continuous_input
from .start_values import checked_start, value_of_text
from .wires import Name


def checked_profile(
    catalog: Catalog, name: Name, profile: Table | Callable[[float], float]
) -> tuple[Port, Table | FunctionInput]:
    """A table in the unit of its input, or a function; raises SetupError for what does not fit."""
    port = catalog.port(name)
    causality = str(port.variable.causality)
    parameter = causality == "parameter"
    if causality != "input" and not (parameter and port.variable.variability == "tunable"):
        kind = "is a parameter that is not tunable" if parameter else f"has causality {causality}"
        raise SetupError(f"{port} {kind} and cannot change over time")
    moving = is_continuous_input(port)
    if not isinstance(profile, Table):
        if not moving:
            raise SetupError(f"{port} cannot follow a function of time; only a Real input can")
        return port, FunctionInput(_numbers_of(port, profile))
    if not (moving or profile.held):
        raise SetupError(f"{port} cannot be interpolated and can only follow a table that is held")
    factor, offset = conversion_to(catalog, port, profile.unit, "follow a table")
    if (factor, offset) != (1.0, 0.0):
        profile = profile.mapped(lambda value: factor * value + offset)
    extremes = set(profile.values)
    if moving:
        extremes = {min(extremes), max(extremes), *filter(math.isnan, extremes)}
    fitting = {value: checked_start(catalog, port, value)[1] for value in extremes}
    return port, profile.mapped(float if moving else fitting.__getitem__)


def _numbers_of(port: Port, function: Callable[[float], float]) -> Callable[[float], float]:
    """A function of time that raises SetupError, with the name of its input, where it gives no number."""

    @wraps(function)
    def number(t: float) -> float:
        value = function(t)
        if not isinstance(value, float):
            try:
                value = math.nan if isinstance(value, str | bytes) else float(value)
            except (TypeError, ValueError):
                value = math.nan
            if math.isnan(value):
                raise SetupError(
                    f"input {port.name}: its function gives {function(t)!r} at t = {t!r} s; "
                    "it must give a number"
                )
        return value

    return number


def profiles_of_changes(
    catalog: Catalog, start: Sequence[tuple[Port, Value]]
) -> Iterator[tuple[Port, Table | FunctionInput]]:
    """The changes of each variable as a table that begins with its start value."""
    steps: dict[str, list[tuple[float, Value]]] = {}
    for time, name, text in map(parse_change, catalog.system.changes):
        port = catalog.port(name)
        steps.setdefault(port.name, []).append((time, value_of_text(catalog, port, text)))
    starts = {port.name: value for port, value in start} if steps else {}
    for name, rows in steps.items():
        port = catalog.port(name)
        before = starts.get(name, declared_start(port.variable))
        is_profile = name in catalog.system.inputs
        if is_profile or before is None:
            why = "also follows a table" if is_profile else "has no start value"
            raise SetupError(f"{port} cannot change: it {why}")
        fitting = [(time, checked_start(catalog, port, value)[1]) for time, value in rows]
        times, values = zip(*sorted(fitting, key=lambda row: row[0]))
        table = Table(times, values, held=True)
        yield checked_profile(catalog, name, table.after(before))
