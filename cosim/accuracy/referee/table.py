"""A result that another master wrote: its times, its columns, and which variables they are.

Masters name their columns in their own ways: `model.root.motor.tau`, `motor::tau[REAL]`, `motor.tau [N.m]`
or `tau [3 real output]`. A column is a variable if their names, without such additions, are equal or if one ends
with the other; a name that fits two variables or two columns is left out.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SetupError
from ...result import Result
from ...series import TIME, Reading, Series
from ...system import Network, Port, conversion_to
from ...table_file import TIMES
from ...units import multiples

if TYPE_CHECKING:
    import pandas as pd

    Source = Result | pd.DataFrame | Path | str

Array = NDArray[np.float64]
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


def read_foreign(source: Source) -> Series:
    """Read what another master wrote: the time [s], and its columns but those that count steps.

    Parameters
    ----------
    source : Result, pandas frame or path
        A file as `Series.read` takes it. Rows without a time are left out, and of rows with the same time the last
        one counts.

    Raises
    ------
    SetupError
        If it cannot be read, has fewer than two rows, or has times that fall.
    """
    if isinstance(source, Result):
        whole = Series(source.columns, source.load, label="the result")
    elif isinstance(source, (str, Path)):
        whole = Series.read(source)
    else:
        whole = Series.of(source)
    clock = whole.clock
    unit = whole.column(clock).unit or "s"
    scale = multiples("s").get(unit)
    if scale is None:
        raise SetupError(f"{whole.label}: the time must be in a unit of time, not in {unit}")
    try:
        time = scale * whole.numbers(clock, finite=False)
        finite = np.isfinite(time)
        if not finite[: np.flatnonzero(finite).max(initial=0)].all():
            raise SetupError(
                f"{whole.label}: row {np.argmin(finite) + 1} below the heading has no time"
            )
        time = time[finite]
        if (falls := np.flatnonzero(np.diff(time) < 0.0)).size:
            before, after = time[falls[0] :][:2].tolist()
            raise SetupError(f"{whole.label}: time {after!r} s after {before!r} s must not fall")
        last = np.append(np.diff(time) > 0.0, True)
        if np.count_nonzero(last) <= 1 or len(whole.columns) <= 1:
            raise SetupError(f"{whole.label} needs two rows with a time and values")
    except SetupError as error:
        if clock.lower() in TIMES:
            raise
        reason = f"no column is called time, so that the first, {clock}, is taken for it"
        raise SetupError(f"{error}; {reason}") from error
    kept = [c for c in whole.columns if c.name != clock and c.name.lower() not in COUNTERS]

    def load(k: int) -> NDArray[Any]:
        values = whole[kept[k - 1].name][finite] if k else time
        selected: NDArray[Any] = values[last]
        return selected

    return Series([TIME, *kept], load, label=whole.label)


def match_columns(
    table: Series, network: Network, ports: Sequence[Port], columns: Mapping[str, str]
) -> list[MatchedColumn]:
    """The columns of a table as variables of a system.

    Parameters
    ----------
    table : Series
        The result of another master.
    network : Network
        The system, whose FMUs define units.
    ports : sequence of Port
        The variables that can be judged.
    columns : mapping of str to str
        Variables whose column is stated: "motor.tau": "M * 0.73:N.m", with a factor, an offset and a unit
        where needed.

    Raises
    ------
    SetupError
        For a variable or a column that does not exist, and for a unit that cannot be converted.
    """
    by_name = {port.name: port for port in ports}
    names = table.names[1:]
    matches: list[MatchedColumn] = []
    for variable, text in columns.items():
        port = network.port(variable)
        if port.name not in by_name:
            raise SetupError(f"{port} cannot be judged: it must be a numeric output")
        reading = Reading.read(text, names, table.label)
        numbers = table.numbers(reading.name, finite=False)
        values = reading.factor * numbers + reading.offset
        unit = table.column(reading.name).unit if reading.unit is None else reading.unit
        matches.append(_matched(network, port, reading.name, unit, values))
    taken = {match.port.name for match in matches}
    used = {match.column for match in matches}
    for port, column in _pairs(
        [port for port in ports if port.name not in taken],
        [name for name in names if name not in used],
        Path(table.label).stem,
    ):
        values = table.numbers(column, finite=False)
        matches.append(_matched(network, port, column, table.column(column).unit, values))
    order = list(by_name)
    return sorted(matches, key=lambda match: order.index(match.port.name))


def _matched(network: Network, port: Port, column: str, unit: str, values: Array) -> MatchedColumn:
    factor, offset = (
        (1.0, 0.0) if port.type != "Real" else conversion_to(network, port, unit, "be judged")
    )
    return MatchedColumn(port, column, unit, factor * values + offset)


def _pairs(ports: Sequence[Port], columns: Sequence[str], stem: str) -> list[tuple[Port, str]]:
    """Variables and columns whose names agree, from the strictest rule to the loosest."""
    rules = (
        lambda port, column: column == port.name,
        lambda port, column: _ends_with(_path(column), _path(port.name)),
        lambda port, column: _ends_with(_flat(column), _flat(port.name)),
        lambda port, column: (
            _path(column) == _path(port.variable.name) and stem.startswith(port.part)
        ),
        lambda port, column: _path(column) == _path(port.variable.name),
    )
    pairs: list[tuple[Port, str]] = []
    free_ports, free_columns = list(ports), list(columns)
    for agrees in rules:
        by_column: dict[str, list[Port]] = defaultdict(list)
        by_port: dict[str, list[str]] = defaultdict(list)
        for port in free_ports:
            for column in free_columns:
                if agrees(port, column):
                    by_column[column].append(port)
                    by_port[port.name].append(column)
        for column, candidates in by_column.items():
            if len(candidates) == 1 and len(by_port[candidates[0].name]) == 1:
                pairs.append((candidates[0], column))
        taken = {port.name for port, _ in pairs}
        used = {column for _, column in pairs}
        free_ports = [port for port in free_ports if port.name not in taken]
        free_columns = [column for column in free_columns if column not in used]
    return pairs


def _path(name: str) -> list[str]:
    """A name as its pieces, whatever separates them."""
    return re.split(r"::|[.:/|]", name.strip())


def _flat(name: str) -> list[str]:
    """A name as its words, for masters that replace every dot by an underscore."""
    return [word for word in re.split(r"[^A-Za-z0-9]+", name) if word]


def _ends_with(longer: Sequence[str], shorter: Sequence[str]) -> bool:
    """Whether a name ends with the pieces of another one."""
    return len(longer) >= len(shorter) and list(longer[-len(shorter) :]) == list(shorter)
