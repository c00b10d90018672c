"""Compare a result with another or with a measurement: does it stay in a band around the reference?

The band is that of the FMI cross-check. A rectangle, twice as wide as the tolerance in time and twice as
high as that in value, is moved along the reference, which is interpolated linearly between its rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..describe import table
from ..errors import SetupError
from ..result import Result, Rows
from ..rounding import unit_suffix
from ..series import Reading, Series, rising_times
from ..units import in_unit, multiples

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Source = Result | pd.DataFrame | Path | str

#: Half the height of a band over the range of the reference, and half its width over the duration.
#: Convention of the FMI cross-check.
SHARE = 0.002
ERROR = "_error"
#: Times at which a band is drawn. Chosen: more than the dots across a figure.
PLOT_POINTS = 2000


@dataclass(frozen=True)
class ToleranceBand:
    """Where a column may be: within `width` [s] and `height` of the reference, plus its error there."""

    t: Rows
    y: Rows
    error: Rows
    width: float
    height: float

    def around(self, t: Rows) -> tuple[Rows, Rows]:
        """The least and the largest value of the reference within its width around times t [s].

        Beyond its ends the reference is extended in a straight line, over the width.
        """
        ends = self.t[[0, -1]]
        inner = np.interp(ends + np.array([self.width, -self.width]), self.t, self.y)
        outer = 2.0 * self.y[[0, -1]] - inner
        extended_t = np.concatenate([ends[:1] - self.width, self.t, ends[1:] + self.width])
        extended_y = np.concatenate([outer[:1], self.y, outer[1:]])
        i = np.searchsorted(extended_t, t - self.width, "left")
        j = np.searchsorted(extended_t, t + self.width, "right")
        rims = [np.interp(t + side * self.width, extended_t, extended_y) for side in (-1.0, 1.0)]
        bounds_of_window = np.stack([i, j], axis=1).ravel()
        low, high = (
            np.where(
                i < j,
                pick.reduceat(np.append(extended_y, extended_y[-1]), bounds_of_window)[::2],
                rims[0],
            )
            for pick in (np.minimum, np.maximum)
        )
        return np.minimum.reduce([low, *rims]), np.maximum.reduce([high, *rims])

    def room(self, t: Rows) -> Rows:
        """How far beyond these values the column may be."""
        return np.asarray(self.height + np.interp(t, self.t, self.error), float)


@dataclass(frozen=True)
class Deviation:
    """How far a column is from its reference, in the reference's unit.

    `deviation` is the distance to the nearest value that the reference takes within the tolerance in
    time. It is given at the `time` [s] at which it exceeds the `allowed` deviation most or, if it never
    does, comes closest to it. `outside` marks the rows (t [s], y) that exceed it.
    """

    name: str
    reference: str
    unit: str
    deviation: float
    time: float
    allowed: float
    t: Rows = field(repr=False)
    y: Rows = field(repr=False)
    outside: NDArray[np.bool_] = field(repr=False)
    band: ToleranceBand = field(repr=False)

    @property
    def passed(self) -> bool:
        """Whether no row is outside."""
        return not self.outside.any()


@dataclass(frozen=True)
class Comparison:
    """All compared columns, from `start` to `stop` [s] in bands of `width` [s] to either side."""

    columns: tuple[Deviation, ...]
    start: float
    stop: float
    width: float
    notes: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether all columns stay in their bands."""
        return all(column.passed for column in self.columns)

    def __getitem__(self, name: str) -> Deviation:
        """The column of this name.

        Raises
        ------
        KeyError
            For a column that was not compared.
        """
        for column in self.columns:
            if column.name == name:
                return column
        raise KeyError(f"{name} was not compared, only {', '.join(c.name for c in self.columns)}")

    def text(self) -> str:
        """What was compared, a line for each column, and the verdict."""
        first = (
            f"from {self.start:g} to {self.stop:g} s, bands of {self.width:.3g} s to either side"
        )
        outside = [column.name for column in self.columns if not column.passed]
        last = f"outside: {', '.join(outside)}" if outside else "every column stays in its band"
        return "\n".join([first, *self.notes, *table([_line(c) for c in self.columns]), last])

    def plot(self, path: Path | str | None = None) -> Figure:
        """A panel per column: both curves, the band and the rows outside; `path` also writes a file."""
        from ..picture import Picture

        number = len(self.columns)
        figure = Picture(figsize=(9, 1.0 + 2.2 * number), layout="constrained")
        axes = figure.subplots(number, sharex=True, squeeze=False)[:, 0]
        for axis, column in zip(axes, self.columns):
            _draw(axis, column, np.linspace(self.start, self.stop, PLOT_POINTS))
        axes[-1].set_xlabel("time / s")
        if path is not None:
            figure.savefig(path, dpi=150)
        return figure


def compare(
    result: Source,
    reference: Source,
    *,
    columns: Mapping[str, str] | Sequence[str] | None = None,
    value: float = SHARE,
    time: float | None = None,
    errors: Mapping[str, str | float] | None = None,
    gap: float = np.inf,
) -> Comparison:
    """Check for each column whether the result stays in a band around the reference.

    The rows of both need not be at the same times; they are compared at the rows of the result. Units come
    from a result, from the JSON next to a file, or from headings, "speed [rpm]". A column without a unit
    fits every unit.

    Parameters
    ----------
    result : Result, DataFrame or path
        What is compared: a result, a pandas frame or a file (.csv or .parquet) whose first column is the time.
    reference : Result, DataFrame or path
        What it is compared with, of the same kinds.
    columns : mapping or sequence of str, optional
        Names, or columns of the result mapped to those of the reference, with a factor, an offset and a
        unit where needed: "n:rpm", "M * 0.73:N.m". By default, all names that both have.
    value : float
        Half the height of the band, over the range of the reference, or over its value if it is constant.
    time : float, optional
        Half the width of the band [s], by default 0.2 % of the time that both cover.
    errors : mapping, optional
        Errors that add to the height, as those in a column NAME_error of either do: by the result's names,
        in the reference's unit or as "7.3 rpm".
    gap : float
        Nothing is compared between rows of the reference that are further apart than this [s].

    Returns
    -------
    Comparison
        The deviation of each column, in the reference's unit.

    Raises
    ------
    SetupError
        If there is nothing to compare, for units of different quantities, and for values that are not
        finite numbers.

    Examples
    --------
    >>> import pandas as pd
    >>> reference = pd.DataFrame({"time": [0.0, 1.0, 2.0], "x": [0.0, 1.0, 2.0]})
    >>> compare(reference.assign(x=reference["x"] + 0.001), reference).passed
    True
    """
    ours, theirs = _read(result, "the result"), _read(reference, "the reference")
    start = float(max(ours.time[0], theirs.time[0]))
    stop = float(min(ours.time[-1], theirs.time[-1]))
    width = max(0.0, SHARE * (stop - start)) if time is None else time
    for word, number in (("value", value), ("time", width)):
        if not 0.0 <= number < np.inf:
            raise SetupError(
                f"the tolerance in {word} = {number!r} must be a finite number of at least 0"
            )
    if not gap > 0.0:
        raise SetupError(f"gap = {gap!r} s must be above 0")
    shared = (ours.time >= start) & (ours.time <= stop)
    in_gap = theirs.in_gap(ours.time, gap)
    if np.count_nonzero(shared & ~in_gap) <= 1:
        raise SetupError(f"{ours} and {theirs} have fewer than two rows to compare")
    pairs = _pairs(ours, theirs, columns)
    stated_errors = dict(errors or {})
    if unmatched := [name for name in stated_errors if name not in pairs]:
        raise SetupError(f"error of {unmatched[0]}: only {', '.join(pairs)} are compared")
    deviations = []
    for name, other in pairs.items():
        unit = theirs.unit(other) or ours.unit(name)
        y, error = theirs.column(other, unit)
        height = value * (float(np.ptp(y)) or abs(float(y[0]))) + _error(name, stated_errors, unit)
        rows = (ours.time, *ours.column(name, unit))
        t, measured, row_error = (values[shared & ~in_gap] for values in rows)
        band = ToleranceBand(theirs.time, y, error, width, height)
        low, high = band.around(t)
        distance = np.maximum(0.0, np.maximum(measured - high, low - measured))
        allowed = band.room(t) + row_error
        k, outside = int(np.argmax(distance - allowed)), distance > allowed
        worst = float(distance[k]), float(t[k]), float(allowed[k])
        deviations.append(Deviation(name, other, unit, *worst, t, measured, outside, band))
    notes = [*_notes(ours, theirs, pairs)]
    if gaps := np.count_nonzero(shared & in_gap):
        notes.append(f"{gaps} rows are not compared: they lie in gaps of {theirs.label}")
    return Comparison(tuple(deviations), start, stop, width, tuple(notes))


@dataclass(frozen=True)
class _Record:
    """A table on one side of a comparison, and how its columns are read."""

    series: Series
    readings: dict[str, Reading] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """What messages call it."""
        return self.series.label

    @property
    def names(self) -> list[str]:
        """Its columns but the first, the time."""
        return self.series.names[1:]

    @cached_property
    def time(self) -> Rows:
        """Its times [s], which do not fall."""
        times = self.series.scaled(Reading(self.series.names[0]), "s")
        return rising_times(times, self.label)

    def __str__(self) -> str:
        return f"{self.label} from {self.time[0]:g} to {self.time[-1]:g} s"

    def take_reading(self, text: str) -> str:
        """The column of "M", or of "M * 0.73 + 5:N.m", which scales it and gives it a unit."""
        reading = Reading.read(text, self.names, self.label)
        self.readings[reading.name] = reading
        return reading.name

    def unit(self, name: str) -> str:
        """The unit of a column."""
        stated = self.readings.get(name, Reading(name)).unit
        return self.series.column(name).unit if stated is None else stated

    def column(self, name: str, unit: str) -> tuple[Rows, Rows]:
        """Values and their errors in a unit; raises SetupError for values that are not finite."""
        reading = self.readings.get(name, Reading(name))
        values = self.series.scaled(reading, unit)
        if name + ERROR not in self.names:
            return values, np.zeros(len(values))
        stated = self.series.column(name + ERROR).unit or self.unit(name)
        error = reading._replace(name=name + ERROR, offset=0.0, unit=stated)
        return values, np.abs(self.series.scaled(error, unit))

    def in_gap(self, t: Rows, gap: float) -> NDArray[np.bool_]:
        """Which times lie between rows further apart than a gap [s]."""
        upper = np.clip(np.searchsorted(self.time, t, "left"), 1, len(self.time) - 1)
        coincides = np.isin(t, self.time)
        return (self.time[upper] - self.time[upper - 1] > gap) & ~coincides


def _read(source: Source, label: str) -> _Record:
    """Read a record from a result, a frame or a file."""
    import pandas as pd

    if isinstance(source, Result):
        series = Series(source.columns, source.load, label=label)
    elif isinstance(source, pd.DataFrame):
        series = Series.of(source, label)
    else:
        series = Series.read(source)
    record = _Record(series)
    if not record.names or not len(record.time):
        raise SetupError(f"{series.label} has no rows with a time and values")
    return record


def _pairs(
    ours: _Record, theirs: _Record, columns: Mapping[str, str] | Sequence[str] | None
) -> dict[str, str]:
    """Columns of the reference by those of the result."""
    if columns is None:
        both = [n for n in ours.names if n in theirs.names]
        pairs = {n: n for n in both if n.removesuffix(ERROR) not in both or not n.endswith(ERROR)}
    elif isinstance(columns, Mapping):
        pairs = {
            ours.take_reading(name): theirs.take_reading(other) for name, other in columns.items()
        }
    else:
        pairs = {ours.take_reading(name): theirs.take_reading(name) for name in columns}
    for other in pairs.values():
        if list(pairs.values()).count(other) > 1:
            raise SetupError(f"column {other!r} of {theirs.label} is mapped twice")
    if not pairs:
        raise SetupError(
            f"no column in common: {ours.label} has {', '.join(ours.names)}, "
            f"{theirs.label} has {', '.join(theirs.names)}"
        )
    return pairs


def _error(name: str, stated_errors: Mapping[str, str | float], unit: str) -> float:
    """The error of a column in this unit."""
    stated = stated_errors.get(name, 0.0)
    error = in_unit(stated, unit) if isinstance(stated, str) else float(stated)
    if not 0.0 <= error < np.inf:
        raise SetupError(
            f"error of {name} = {stated!r} must be at least 0, in {' or '.join(multiples(unit))}"
        )
    return error


def _notes(ours: _Record, theirs: _Record, pairs: Mapping[str, str]) -> Iterator[str]:
    """What the comparison leaves out."""
    spans = [(record.time[0], record.time[-1]) for record in (ours, theirs)]
    if spans[0] != spans[1]:
        yield f"{ours}, {theirs}"
    for record, used in ((ours, pairs.keys()), (theirs, pairs.values())):
        rest = [n for n in record.names if n not in used and n.removesuffix(ERROR) not in used]
        if rest:
            yield f"not compared in {record.label}: {', '.join(rest)}"


def _line(column: Deviation) -> tuple[str, ...]:
    """A row of the text."""
    unit = unit_suffix(column.unit)
    name = column.name if column.name == column.reference else f"{column.name} = {column.reference}"
    verdict = "pass"
    if not column.passed:
        t = column.t[column.outside]
        verdict = f"FAIL: {len(t)} of {len(column.t)} rows outside, {t[0]:.6g} to {t[-1]:.6g} s"
    distance = f"{column.deviation:.4g}{unit} at {column.time:.6g} s"
    return name, distance, f"allowed {column.allowed:.4g}{unit}", verdict


def _draw(axis: Axes, column: Deviation, t: Rows) -> None:
    low, high = column.band.around(t)
    room = column.band.room(t)
    axis.fill_between(t, low - room, high + room, color="0.85", label="band", linewidth=0)
    axis.plot(column.band.t, column.band.y, color="0.4", linewidth=1, label=column.reference)
    axis.plot(column.t, column.y, color="C0", linewidth=1, label=column.name)
    if not column.passed:
        where = column.outside
        axis.plot(column.t[where], column.y[where], ".", color="C3", markersize=3, label="outside")
    axis.set_xlim(t[0], t[-1])
    axis.set_ylabel(column.unit or "1")
    axis.grid(alpha=0.3)
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
