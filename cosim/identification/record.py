"""A record: measured columns of a file, in the units of variables, each with its noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..errors import SetupError
from ..system import Network, Port, conversion_to
from ..system.inputs import COLUMN, Reading, Table, read_table
from ..units import multiples
from .noise import Noise, Samples, estimate_noise

#: units of a column of times, in seconds
SECONDS = {"": 1.0} | multiples("s")
#: Largest measured number. Chosen: its square, for chi2, is still far from the largest double.
LARGEST_NUMBER = 1e30


@dataclass(frozen=True)
class Column:
    """What was measured of a variable: times [s], values in its unit, both of shape (n,), and the noise."""

    port: Port
    times: Samples
    values: Samples
    noise: Noise

    @property
    def name(self) -> str:
        """The name of the variable, "part.variable"."""
        return self.port.name


def measured(
    path: Path | str, columns: Mapping[str, str], *, time: str | None = "time", gaps: bool = False
) -> dict[str, Table]:
    """Read columns of a CSV file by the variables that they measure.

    Parameters
    ----------
    path:
        The file, with a header.
    columns:
        By variable, the name of a column in the header, with a factor, an offset and a unit after it where needed:
        "n * 0.4:rpm", "n / 2.5:rpm". A header may have a unit too, "n [rpm]".
    time:
        The column of times, over which all others stand, in s unless it has another unit, "t:ms". None takes the
        row number, from 0.
    gaps:
        Whether cells may be empty or nan.

    Raises
    ------
    SetupError
        With file, row and column for times that do not rise, for a cell that is not a number, and for a column that
        is named twice.
    """
    header, *rows = read_table(path)
    heads = [match.groups() for match in map(COLUMN.fullmatch, header) if match]
    source = _Source(path, [name for name, _ in heads], [unit for _, unit in heads], rows)
    if not rows:
        raise SetupError(f"{path} has no rows below its header")
    times = np.arange(float(len(rows))) if time is None else source.times(time)
    tables = {}
    for variable, text in columns.items():
        values, index, unit = source.column(variable, text, gaps=gaps)
        label = f"{Path(path).name}, column {source.names[index]}"
        tables[variable] = Table(times.tolist(), values.tolist(), unit=unit, source=label)
    return tables


@dataclass(frozen=True)
class _Source:
    """The cells of a file, the names and units of its header, and which column serves which variable."""

    path: Path | str
    names: list[str]
    units: list[str | None]
    rows: list[list[str]]
    variables: dict[int, str] = field(default_factory=dict)

    def column(self, variable: str, text: str, *, gaps: bool) -> tuple[Samples, int, str]:
        """The values of a column for a variable, its place in the header and its unit."""
        name, factor, offset, unit = Reading.read(text, self.names, str(self.path))
        index = self.names.index(name)
        if index in self.variables:
            raise SetupError(
                f"{self.path}, column {name}: it is mapped twice, to {self.variables[index]} and {variable}"
            )
        self.variables[index] = variable
        return (
            factor * self.numbers(index, gaps=gaps) + offset,
            index,
            unit or self.units[index] or "",
        )

    def numbers(self, index: int, *, gaps: bool) -> Samples:
        """The numbers of a column, nan where a cell is empty."""
        values = np.full(len(self.rows), math.nan)
        for k, row in enumerate(self.rows):
            text = row[index].strip() if index < len(row) else ""
            cell = f"{self.path}, row {k + 2}, column {self.names[index]}"
            try:
                values[k] = float(text or "nan")
            except ValueError:
                raise SetupError(f"{cell}: {text!r} is not a number") from None
            if not abs(values[k]) < LARGEST_NUMBER and not (gaps and math.isnan(values[k])):
                raise SetupError(
                    f"{cell}: {text or 'an empty cell'!r} is not a finite number "
                    f"below {LARGEST_NUMBER:g}; gaps must be allowed, and a time cannot be one"
                )
        return values

    def times(self, text: str) -> Samples:
        """The column of times [s], which must rise."""
        values, index, unit = self.column("time", text, gaps=False)
        if unit not in SECONDS:
            choices = ", ".join(filter(None, SECONDS))
            raise SetupError(
                f"{self.path}, column {self.names[index]}: times are in {choices}, not in {unit!r}"
            )
        times = np.asarray(values * SECONDS[unit], float)
        for k, (previous, current) in enumerate(pairwise(times.tolist()), 3):
            if not previous < current:
                raise SetupError(
                    f"{self.path}, row {k}, column {self.names[index]}: times must rise, but "
                    f"{current!r} s follows {previous!r} s"
                )
        return times


def measured_columns(
    network: Network, record: Mapping[str, Table], noise: Mapping[str, float]
) -> list[Column]:
    """The columns of a record in the units of their variables, each with its noise, stated or estimated.

    Raises SetupError for a variable that is not a Real output, a unit that does not fit, times that do
    not rise, a column that never changes, and a noise that is neither given nor can be estimated.
    """
    if not record:
        raise SetupError("a record needs a column")
    for name, sigma in noise.items():
        if name not in record or not 0.0 < sigma < math.inf:
            raise SetupError(
                f"noise of {name} = {sigma!r} must be above 0 and belong to a measured column"
            )
    return [
        _measured_column(network, network.port(name), table, noise)
        for name, table in record.items()
    ]


def _measured_column(
    network: Network, port: Port, table: Table, noise: Mapping[str, float]
) -> Column:
    """The column of a variable, without the rows that are gaps."""
    source = table.source or f"the record of {port.name}"
    if port.variable.causality != "output" or port.type != "Real":
        raise SetupError(
            f"{source}: {port} is not a Real output, so nothing can be compared with it"
        )
    factor, offset = conversion_to(network, port, table.unit, "be compared with a column")
    times, values = np.array(table.times), factor * np.array(table.values, float) + offset
    is_number = np.isfinite(values)
    times, values = times[is_number], values[is_number]
    if len(times) <= 1 or not (np.diff(times) > 0.0).all():
        raise SetupError(f"{source}: its times must rise, and there must be two rows at least")
    if np.ptp(values) == 0.0:
        raise SetupError(
            f"{source}: it is {table.values[0]!r} in all rows and carries no information"
        )
    if port.name in noise:
        return Column(port, times, values, Noise(noise[port.name], "as given", is_stated=True))
    return Column(port, times, values, estimate_noise(times, values, source))
