"""Compare a result with another or with a measurement: does it stay in a band around the reference?

The band is that of the FMI cross-check. A rectangle, twice as wide as the tolerance in time and twice as
high as that in value, is moved along the reference, which is interpolated linearly between its rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..describe import table
from ..errors import SetupError
from ..result import Result, Rows
from ..rounding import unit_suffix
from ..series import Reading, Series
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
        from ..picture import panels

        t = np.linspace(self.start, self.stop, PLOT_POINTS)
        return panels([(c.unit, partial(_draw, column=c, t=t)) for c in self.columns], path)


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
        What is compared: a result, a pandas frame or a file (.csv or .parquet) with a column of times.
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
    start = float(max(ours.t[0], theirs.t[0]))
    stop = float(min(ours.t[-1], theirs.t[-1]))
    width = max(0.0, SHARE * (stop - start)) if time is None else time
    for word, number in (("value", value), ("time", width)):
        if not 0.0 <= number < np.inf:
            raise SetupError(
                f"the tolerance in {word} = {number!r} must be a finite number of at least 0"
            )
    if not gap > 0.0:
        raise SetupError(f"gap = {gap!r} s must be above 0")
    shared = (ours.t >= start) & (ours.t <= stop)
    in_gap = _in_gap(theirs, ours.t, gap)
    if np.count_nonzero(shared & ~in_gap) <= 1:
        raise SetupError(f"{_span(ours)} and {_span(theirs)} have fewer than two rows to compare")
    pairs = _pairs(ours, theirs, columns)
    stated_errors = dict(errors or {})
    if unmatched := [name for name in stated_errors if name not in pairs]:
        raise SetupError(f"error of {unmatched[0]}: only {', '.join(pairs)} are compared")
    deviations = []
    for name, (mine, other) in pairs.items():
        unit = theirs.unit_of(other) or ours.unit_of(mine)
        y, error = _with_errors(theirs, other, unit)
        height = value * (float(np.ptp(y)) or abs(float(y[0]))) + _error(name, stated_errors, unit)
        rows = (ours.t, *_with_errors(ours, mine, unit))
        t, measured, row_error = (values[shared & ~in_gap] for values in rows)
        band = ToleranceBand(theirs.t, y, error, width, height)
        low, high = band.around(t)
        distance = np.maximum(0.0, np.maximum(measured - high, low - measured))
        allowed = band.room(t) + row_error
        k, outside = int(np.argmax(distance - allowed)), distance > allowed
        worst = float(distance[k]), float(t[k]), float(allowed[k])
        deviations.append(Deviation(name, other.name, unit, *worst, t, measured, outside, band))
    notes = [*_notes(ours, theirs, pairs.values())]
    if gaps := np.count_nonzero(shared & in_gap):
        notes.append(f"{gaps} rows are not compared: they lie in gaps of {theirs.label}")
    return Comparison(tuple(deviations), start, stop, width, tuple(notes))


def _read(source: Source, label: str) -> Series:
    """Read a table from a result, a frame or a file."""
    series = Series.of_any(source, label)
    if not _values(series) or not len(series.t):
        raise SetupError(f"{series.label} has no rows with a time and values")
    return series


def _values(series: Series) -> list[str]:
    """The columns of a table but its times."""
    return [name for name in series.names if name != series.clock]


def _with_errors(series: Series, reading: Reading, unit: str) -> tuple[Rows, Rows]:
    """Values of a column and their errors in a unit; raises SetupError for values that are not finite."""
    values, name = series.scaled(reading, unit), reading.name + ERROR
    if name not in series.names:
        return values, np.zeros(len(values))
    stated = series.column(name).unit or series.unit_of(reading)
    error = reading._replace(name=name, offset=0.0, unit=stated)
    return values, np.abs(series.scaled(error, unit))


def _in_gap(series: Series, t: Rows, gap: float) -> NDArray[np.bool_]:
    """Which times lie between rows of a table that are further apart than a gap [s]."""
    upper = np.clip(np.searchsorted(series.t, t, "left"), 1, len(series.t) - 1)
    return (series.t[upper] - series.t[upper - 1] > gap) & ~np.isin(t, series.t)


def _pairs(
    ours: Series, theirs: Series, columns: Mapping[str, str] | Sequence[str] | None
) -> dict[str, tuple[Reading, Reading]]:
    """By the names of the result's columns, how these and those of the reference are read."""
    if columns is None:
        both = [name for name in _values(ours) if name in _values(theirs)]
        columns = [n for n in both if n.removesuffix(ERROR) not in both or not n.endswith(ERROR)]
        pairs = {name: (Reading(name), Reading(name)) for name in columns}
    else:
        texts = columns if isinstance(columns, Mapping) else dict(zip(columns, columns))
        mine, others = ours.readings({text: text for text in texts}), theirs.readings(texts)
        pairs = {mine[text].name: (mine[text], others[text]) for text in texts}
    if not pairs:
        raise SetupError(
            f"no column in common: {ours.label} has {', '.join(_values(ours))}, "
            f"{theirs.label} has {', '.join(_values(theirs))}"
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


def _span(series: Series) -> str:
    return f"{series.label} from {series.t[0]:g} to {series.t[-1]:g} s"


def _notes(ours: Series, theirs: Series, pairs: Iterable[tuple[Reading, Reading]]) -> Iterator[str]:
    """What the comparison leaves out."""
    if (ours.t[0], ours.t[-1]) != (theirs.t[0], theirs.t[-1]):
        yield f"{_span(ours)}, {_span(theirs)}"
    for series, used in zip((ours, theirs), zip(*pairs)):
        names = {name for reading in used for name in (reading.name, reading.name + ERROR)}
        if rest := [name for name in _values(series) if name not in names]:
            yield f"not compared in {series.label}: {', '.join(rest)}"


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
