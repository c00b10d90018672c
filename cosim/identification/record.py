"""A record: measured columns of a file, in the units of variables, each with its noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import SetupError
from ..series import TIME, Column, Reading, Series, rising_times
from ..system import Network, Port, conversion_to
from .noise import Noise, Samples, estimate_noise

#: Largest measured number. Chosen: its square, for chi2, is still far from the largest double.
LARGEST_NUMBER = 1e30


@dataclass(frozen=True)
class Measurement:
    """What was measured of a variable: times [s], values in its unit, both of shape (n,), and the noise."""

    port: Port
    times: Samples
    values: Samples
    noise: Noise


def measured(
    path: Path | str, columns: Mapping[str, str], *, time: str | None = "time", gaps: bool = False
) -> dict[str, Series]:
    """Read columns of a file, see `Series.read`, by the variables that they measure.

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
    series, taken = Series.read(path), dict[str, str]()
    if not len(series[series.names[0]]):
        raise SetupError(f"{path} has no rows below its header")

    def column(variable: str, text: str, unit: str, *, gaps: bool) -> tuple[Samples, Reading]:
        """The values of a column in a unit, or in its own."""
        reading = Reading.read(text, series.names, str(path))
        if reading.name in taken:
            raise SetupError(
                f"{path}, column {reading.name}: it is mapped twice, to {taken[reading.name]} and {variable}"
            )
        taken[reading.name] = variable
        values = series.scaled(reading, unit, gaps=gaps)
        if (large := np.abs(values) >= LARGEST_NUMBER).any():
            row = int(np.argmax(large))
            raise SetupError(
                f"{path}, row {row + 2}, column {reading.name}: {values[row]:g} is not below {LARGEST_NUMBER:g}"
            )
        return values, reading

    times = np.arange(float(len(series[series.names[0]])))
    if time is not None:
        times, _ = column("time", time, "s", gaps=False)
        rising_times(times, str(path), strictly=True)
    tables = {}
    for variable, text in columns.items():
        values, reading = column(variable, text, "", gaps=gaps)
        unit = series.column(reading.name).unit if reading.unit is None else reading.unit
        label = f"{Path(path).name}, column {reading.name}"
        columns_of = TIME, Column(reading.name, unit, source=label)
        tables[variable] = Series(columns_of, [times, values].__getitem__, label=label)
    return tables


def measured_columns(
    network: Network, record: Mapping[str, Series], noise: Mapping[str, float]
) -> list[Measurement]:
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
    network: Network, port: Port, table: Series, noise: Mapping[str, float]
) -> Measurement:
    """The column of a variable, without the rows that are gaps."""
    column = table.signal
    source = column.source or f"the record of {port.name}"
    if port.variable.causality != "output" or port.type != "Real":
        raise SetupError(
            f"{source}: {port} is not a Real output, so nothing can be compared with it"
        )
    factor, offset = conversion_to(network, port, column.unit, "be compared with a column")
    times, values = table.t, factor * table.numbers(gaps=True) + offset
    is_number = np.isfinite(values)
    times, values = times[is_number], values[is_number]
    if len(times) <= 1 or not (np.diff(times) > 0.0).all():
        raise SetupError(f"{source}: its times must rise, and there must be two rows at least")
    if np.ptp(values) == 0.0:
        raise SetupError(
            f"{source}: it is {float(values[0])!r} in all rows and carries no information"
        )
    if port.name in noise:
        return Measurement(port, times, values, Noise(noise[port.name], "as given", is_stated=True))
    return Measurement(port, times, values, estimate_noise(times, values, source))
