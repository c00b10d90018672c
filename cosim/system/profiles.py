"""What inputs and tunable parameters follow over time, checked and in their own units."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import wraps

from ..errors import SetupError
from ..series import Kind, Series
from ..table_file import is_empty
from .description import Value, declared_start
from .inputs import FunctionInput, TableInput, parse_change
from .ports import FOLLOW_A_TABLE, Catalog, Port, conversion_to, is_continuous_input
from .start_values import checked_start, literal, value_of_text
from .wires import Name


def checked_profile(
    catalog: Catalog, name: Name, profile: Series | Callable[[float], float]
) -> tuple[Port, TableInput | FunctionInput]:
    """A table in the unit of its input, or a function; raises SetupError for what does not fit."""
    port = _changing(catalog, name)
    if not isinstance(profile, Series):
        if not is_continuous_input(port):
            raise SetupError(f"{port} cannot follow a function of time; only a Real input can")
        return port, FunctionInput(_numbers_of(port, profile))
    column = profile.signal
    factor, offset = conversion_to(catalog, port, column.unit, FOLLOW_A_TABLE)
    try:
        times, values = profile.t.tolist(), _parsed_cells(port, profile)
        if not times:
            raise SetupError(f"{profile.label} has no rows")
    except SetupError as error:
        raise SetupError(f"{port.name}: {error}") from error
    if (factor, offset) != (1.0, 0.0):
        values = [x if isinstance(x, str) else factor * x + offset for x in values]
    is_held = column.kind.is_held and (port.type, column.kind) != ("Real", Kind.TEXT)
    values = _fitting(catalog, port, values, is_held=is_held)
    return port, TableInput(times, values, held=is_held, source=column.source)


def _changing(catalog: Catalog, name: Name) -> Port:
    """The port of this name; raises SetupError if it cannot change over time."""
    port = catalog.port(name)
    causality = str(port.variable.causality)
    parameter = causality == "parameter"
    if causality != "input" and not (parameter and port.variable.variability == "tunable"):
        kind = "is a parameter that is not tunable" if parameter else f"has causality {causality}"
        raise SetupError(f"{port} {kind} and cannot change over time")
    return port


def _fitting(
    catalog: Catalog, port: Port, values: Sequence[Value], *, is_held: bool
) -> list[Value]:
    """Values in the type of a port; raises SetupError for those that it cannot have or come to."""
    moving = is_continuous_input(port)
    if not (moving or is_held):
        raise SetupError(f"{port} cannot be interpolated and can only follow a table that is held")
    numbers = [value for value in values if not isinstance(value, str)]
    some = {min(values), max(values)} if moving and len(numbers) == len(values) else set(values)
    fitting = {value: checked_start(catalog, port, value)[1] for value in some}
    return [float(value) for value in values] if moving else [fitting[value] for value in values]


def _parsed_cells(port: Port, table: Series) -> list[Value]:
    """The values of a table for a port, of which texts may be truth values and numbers; raises SetupError."""
    if port.type == "Real" and table.signal.kind is not Kind.BOOLEAN:
        return list(table.numbers().tolist())
    cells = ["" if is_empty(cell) else cell for cell in table[table.signal.name].tolist()]
    if port.type in ("String", "Binary"):
        return cells
    return [literal(cell) if isinstance(cell, str) else cell for cell in cells]


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


def change_profiles(
    catalog: Catalog, start: Sequence[tuple[Port, Value]]
) -> Iterator[tuple[Port, TableInput]]:
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
        times, values = zip((-math.inf, before), *sorted(rows, key=lambda row: row[0]))
        fitting = _fitting(catalog, _changing(catalog, name), values, is_held=True)
        yield port, TableInput(times, fitting, held=True)
