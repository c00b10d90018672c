"""A result that another master wrote: its times, its columns, and which variables they are.

Masters name their columns in their own ways: `model.root.motor.tau`, `motor::tau[REAL]`, `motor.tau [N.m]`
or `tau [3 real output]`. A column is a variable if their names, without such additions, are equal or if one ends
with the other; a name that fits two variables or two columns is left out.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import SetupError
from ...result import Result
from ...series import TIME, Reading, Series, rising_times
from ...system import Network, Port, conversion_to
from ...table_file import TIMES
from ...units import multiples
from .solution import Array

if TYPE_CHECKING:
    import pandas as pd

    Source = Result | pd.DataFrame | Path | str

#: Columns that count steps instead of measuring something. A convention of Ecos and of libcosim.
COUNTERS = ("iterations", "stepcount")


@dataclass(frozen=True)
class MatchedColumn:
    """A column of a table as a variable of a system.

    `values` are in the unit of the variable. `stated_unit` is what the file says, "" if it says nothing.
    """

    port: Port
    column: str
    stated_unit: str
    values: Array


def read_foreign(source: Source) -> tuple[Series, int]:
    """Read what another master wrote: the time [s], and its columns but those that count steps.

    Besides, how many rows without a time there are at the end, which are left out, as a footer is. Of rows with the same
    time the last one counts, which is after a break. Raises SetupError if it cannot be read, has fewer than two rows, or has times that fall.
    """
    whole = Series.of_any(source, "the table" if not isinstance(source, Result) else "the result")
    clock, label = whole.clock, whole.label
    unit = whole.column(clock).unit or "s"
    if unit not in multiples("s"):
        raise SetupError(f"{label}: the time must be in a unit of time, not in {unit}")
    try:
        time = multiples("s")[unit] * whole.numbers(clock, finite=False)
        finite = np.isfinite(time)
        if not finite[: np.flatnonzero(finite).max(initial=0)].all():
            raise SetupError(f"{label}: row {np.argmin(finite) + 1} below the heading has no time")
        time = time[finite]
        rising_times(time, label)
        rows = np.append(np.diff(time) > 0.0, True)
        if np.count_nonzero(rows) <= 1 or len(whole.columns) <= 1:
            raise SetupError(f"{label} needs two rows with a time and values")
    except SetupError as error:
        if clock.lower() in TIMES:
            raise
        reason = f"no column is called time, so that the first, {clock}, is taken for it"
        raise SetupError(f"{error}; {reason}") from error
    jumps = time[1:][np.diff(time) == 0.0]
    kept = [c for c in whole.columns if c.name != clock and c.name.lower() not in COUNTERS]
    table = Series(
        [TIME, *kept],
        lambda k: (whole[kept[k - 1].name][finite] if k else time)[rows],
        breaks=np.column_stack([jumps, jumps]),
        label=label,
    )
    return table, int(np.count_nonzero(~finite))


def match_columns(
    table: Series, network: Network, ports: Sequence[Port], columns: Mapping[str, str]
) -> list[MatchedColumn]:
    """The columns of a table as those of these variables of a system that they are.

    `columns` has variables whose column is stated: "motor.tau": "M * 0.73:N.m", with a factor, an offset and a unit
    where needed. Raises SetupError for a variable or a column that does not exist, and for a unit that cannot be converted.
    """
    readings: dict[str, Reading] = {}
    names = [port.name for port in ports]
    for variable, text in columns.items():
        port = network.port(variable)
        if port.name not in names:
            raise SetupError(f"{port} cannot be judged: it must be a numeric output")
        readings[port.name] = Reading.read(text, table.names[1:], table.label)
    used = {reading.name for reading in readings.values()}
    free = [port for port in ports if port.name not in readings]
    others = [name for name in table.names[1:] if name not in used]
    for port, column in _unambiguous_pairs(free, others, Path(table.label).stem):
        readings[port.name] = Reading(column)
    matches = []
    for port in ports:
        if port.name in readings:
            reading = readings[port.name]
            unit = table.unit_of(reading)
            factor, offset = (
                conversion_to(network, port, unit, "be judged")
                if port.type == "Real"
                else (1.0, 0.0)
            )
            numbers = table.numbers(reading.name, finite=False)
            numbers = reading.factor * numbers + reading.offset
            matches.append(MatchedColumn(port, reading.name, unit, factor * numbers + offset))
    return matches


def _unambiguous_pairs(
    ports: Sequence[Port], columns: Sequence[str], stem: str
) -> list[tuple[Port, str]]:
    """Variables and columns whose names agree, from the strictest rule to the loosest."""
    rules: tuple[Callable[[Port, str], bool], ...] = (
        lambda port, column: column == port.name,
        lambda port, column: _ends_with(_pieces(column), _pieces(port.name)),
        lambda port, column: _ends_with(_words(column), _words(port.name)),
        lambda port, column: (
            _pieces(column) == _pieces(port.variable.name) and stem.startswith(port.part)
        ),
        lambda port, column: _pieces(column) == _pieces(port.variable.name),
    )
    pairs: list[tuple[Port, str]] = []
    free, unused = list(ports), list(columns)
    for agrees in rules:
        fit = [(port, column) for port in free for column in unused if agrees(port, column)]
        of_port = Counter(port.name for port, _ in fit)
        of_column = Counter(column for _, column in fit)
        clear = [(p, c) for p, c in fit if of_port[p.name] == of_column[c] == 1]
        pairs += clear
        free = [port for port in free if not any(port is p for p, _ in clear)]
        unused = [column for column in unused if column not in [c for _, c in clear]]
    return pairs


def _pieces(name: str) -> list[str]:
    """A name as its pieces, whatever separates them."""
    return re.split(r"::|[.:/|]", name.strip())


def _words(name: str) -> list[str]:
    """A name as its words, for masters that replace every dot by an underscore."""
    return [word for word in re.split(r"[^A-Za-z0-9]+", name) if word]


def _ends_with(longer: Sequence[str], shorter: Sequence[str]) -> bool:
    """Whether a name ends with the pieces of another one."""
    return len(longer) >= len(shorter) and list(longer[-len(shorter) :]) == list(shorter)
