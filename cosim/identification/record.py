"""A record: measured columns of a file, in the units of variables, each with its noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import SetupError
from ..series import TIME, Column, Series, rising_times
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
    series = Series.read(path)
    if not len(series.load(0)):
        raise SetupError(f"{path} has no rows below its header")
    clock = {} if time is None else {TIME.name: time}
    values = {}
    readings = series.readings(clock | dict(columns))
    for name, reading in readings.items():
        is_time = name in clock
        read = series.scaled(reading, TIME.unit if is_time else "", gaps=gaps and not is_time)
        if (large := np.abs(read) >= LARGEST_NUMBER).any():
            row = int(np.argmax(large))
            raise SetupError(
                f"{path}, row {row + 2}, column {reading.name}: {read[row]:g} is not below {LARGEST_NUMBER:g}"
            )
        values[name] = read
    times = np.arange(float(len(series.load(0))))
    if clock:
        times = rising_times(values[TIME.name], str(path), strictly=True)
    tables = {}
    for variable in columns:
        reading = readings[variable]
        label = f"{Path(path).name}, column {reading.name}"
        columns_of = TIME, Column(reading.name, series.unit_of(reading), source=label)
        tables[variable] = Series(columns_of, [times, values[variable]].__getitem__, label=label)
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
