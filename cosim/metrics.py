"""Metrics: what a person asks of columns, as records that know their columns, and as functions of rows.

A record, such as `Largest("motor.tau")`, names its columns and a stretch of time and is a function of their curves;
`certify` states its error. The functions take times t [s] and values x, both of shape (rows,). Both look between
the rows, on a `DenseSolution`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from .dense import DenseSolution
from .errors import SetupError
from .series import Column, Kind

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline, PPoly

Rows = NDArray[np.float64]
Curve = DenseSolution
TURN = 2.0 * math.pi
#: Gauss points of each polynomial in the integral of a harmonic: derived, four are exact up to degree 7, so
#: that a cubic leaves degree 4 for the sine, whose next term is below (w h)^5 / 120.
GAUSS_POINTS = 4
#: Relative amount by which a stretch may fall short of whole periods and still have them. Derived: a frequency or a time
#: that is written with ten significant digits is off by up to 5e-10 of itself, and a product of two by twice that.
#: The part of a period that lacks then changes an amplitude by 2e-9 of the largest value at most.
PERIOD_ROUNDING = 1e-9
#: Distance from a level, over the largest one, within which a curve is on it. Derived: some thousand roundings.
ON_LEVEL = 1e-12
#: Orders of an angle among which the strongest is sought: those of which sixteen rows in a turn still show one each.
HIGHEST_ORDER = 8


@dataclass(frozen=True)
class TurnMean:
    """A column's mean over the last turn of an angle [rad], as a curve over time from the end of the first turn on.

    `Largest(TurnMean("load.w", over="load.phi"))` is the largest mean speed over a turn, which has no ripple of whole
    orders. Turns count since the angle last turned back.
    """

    column: str
    _: KW_ONLY
    over: str

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns whose curves it takes."""
        return (self.column, self.over)

    def __call__(self, curve: Curve, angle: Curve) -> Curve | None:
        """The curve of the means; None if there is no whole turn."""
        from scipy.interpolate import CubicSpline

        t, phi = angle.t, angle.x * np.sign(angle.x[-1] - angle.x[0])
        first = int(np.flatnonzero(np.diff(phi) <= 0.0).max(initial=-1)) + 1
        t, phi = t[first:], phi[first:]
        first_end = phi[0] + TURN
        if len(t) <= 1 or not phi[-1] > first_end:
            return None
        time_of = CubicSpline(phi, t)
        later = phi > first_end
        ends = np.concatenate([time_of([first_end]), t[later]])
        begun = time_of(np.concatenate([[first_end], phi[later]]) - TURN)
        means = (_integral_until(curve, ends) - _integral_until(curve, begun)) / (ends - begun)
        return Curve(ends, means)


@dataclass(frozen=True)
class Metric:
    """A number of a column from `begin` to `end` [s], by default of the whole run.

    Parameters
    ----------
    column
        The name of the column, or what makes a curve of several, `TurnMean`.
    begin, end
        The stretch of time [s].
    """

    column: str | TurnMean
    _: KW_ONLY
    begin: float = -math.inf
    end: float = math.inf
    #: Whether single times decide it, so that the error of the column at these is its own.
    is_local: ClassVar[bool] = False
    #: Whether it counts, and is right or wrong.
    is_count: ClassVar[bool] = False

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns whose curves it takes, in this order."""
        return (self.column,) if isinstance(self.column, str) else self.column.columns

    def __call__(self, *curves: Curve) -> float:
        """The number; nan if there is none, such as the time at which a level is passed."""
        curve = self.curve(*curves)
        return math.nan if curve is None else self.measure(curve)

    def curve(self, *curves: Curve) -> Curve | None:
        """What it looks at within its stretch; None if there is nothing."""
        curve = curves[0] if isinstance(self.column, str) else self.column(*curves)
        return None if curve is None else self.within(curve)

    def within(self, curve: Curve) -> Curve | None:
        """A curve within its stretch; None if there is nothing."""
        if not max(self.begin, curve.t[0]) < min(self.end, curve.t[-1]):
            return None
        if self.begin <= curve.t[0] and self.end >= curve.t[-1]:
            return curve
        return curve.between(self.begin, self.end)

    def measure(self, curve: Curve) -> float:
        """The number of a whole curve."""
        raise NotImplementedError

    def unit(self, of_column: str) -> str:
        """Its unit, from that of its column."""
        return of_column

    def times(self, *curves: Curve) -> tuple[float, ...]:
        """The times [s] at which the values alone decide it; none if all do, or their slopes."""
        return ()

    def scale(self, *curves: Curve) -> float:
        """The size that an error is compared with; 0 if that is the number itself."""
        return 0.0

    def doubt(self, curve: Curve, width: Curve) -> float:
        """How far the number may be off because something else is as good within the width of the curve's error."""
        return 0.0

    def lack(self, unit: str, *curves: Curve) -> str:
        """Why it has no number, with the unit of its column."""
        return "it has no value in its stretch of the run"

    def check(self, columns: Mapping[str, Column], start: float, stop: float) -> None:
        """Refuse columns that a run does not have, and a stretch outside it.

        Raises
        ------
        SetupError
            With the columns, or the times, to choose from.
        """
        for name in self.columns:
            if name not in columns:
                near = get_close_matches(name, columns, 1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise SetupError(
                    f"{self!r}: there is no column {name!r}{hint} The columns are {', '.join(columns)}"
                )
            if columns[name].kind is Kind.TEXT:
                raise SetupError(f"{self!r}: the column {name!r} is text and has no such number")
        if not max(self.begin, start) < min(self.end, stop):
            raise SetupError(
                f"{self!r}: its stretch must lie in the run, from {start:g} to {stop:g} s"
            )


@dataclass(frozen=True)
class PointValue(Metric):
    """A value of the column at one time."""

    is_local = True

    def scale(self, *curves: Curve) -> float:
        """The range of the column."""
        curve = self.curve(*curves)
        return 0.0 if curve is None else float(np.ptp(curve.x))


@dataclass(frozen=True)
class Last(PointValue):
    """The last value."""

    def times(self, *curves: Curve) -> tuple[float, ...]:
        """The end."""
        curve = self.curve(*curves)
        return () if curve is None else (float(curve.t[-1]),)

    def measure(self, curve: Curve) -> float:
        """The value of the last row."""
        return float(curve.x[-1])


@dataclass(frozen=True)
class Largest(PointValue):
    """The largest value."""

    def measure(self, curve: Curve) -> float:
        """The largest value, at or between rows."""
        return curve.largest().value

    def times(self, *curves: Curve) -> tuple[float, ...]:
        """The time of the peak."""
        curve = self.curve(*curves)
        return () if curve is None else (curve.largest().time,)


@dataclass(frozen=True)
class Smallest(PointValue):
    """The smallest value."""

    def measure(self, curve: Curve) -> float:
        """The smallest value, at or between rows."""
        return curve.smallest().value

    def times(self, *curves: Curve) -> tuple[float, ...]:
        """The time of the trough."""
        curve = self.curve(*curves)
        return () if curve is None else (curve.smallest().time,)


@dataclass(frozen=True)
class Swing(PointValue):
    """The largest value less the smallest."""

    def measure(self, curve: Curve) -> float:
        """The distance of the extremes, at or between rows."""
        return curve.largest().value - curve.smallest().value

    def times(self, *curves: Curve) -> tuple[float, ...]:
        """Those of the peak and of the trough."""
        curve = self.curve(*curves)
        return () if curve is None else (curve.largest().time, curve.smallest().time)


@dataclass(frozen=True)
class TimeOfLargest(Metric):
    """When the value is largest [s]."""

    def measure(self, curve: Curve) -> float:
        """The time of the largest value."""
        return curve.largest().time

    def unit(self, of_column: str) -> str:
        """Seconds."""
        return "s"

    def doubt(self, curve: Curve, width: Curve) -> float:
        """How far the furthest other peak is that may be the highest, or the end of a plateau."""
        curve, width = (self.within(c) or c for c in (curve, width))
        peak = curve.largest()
        times, values = curve.maxima()
        least = peak.value - float(width(np.array([peak.time]))[0])
        rivals = times[values + width(times) >= least]
        spacing = float(np.diff(curve.t).max())
        distances = np.abs(rivals - peak.time)
        return float(distances[distances > spacing].max(initial=-spacing)) + spacing


@dataclass(frozen=True)
class TimeOfSmallest(Metric):
    """When the value is smallest [s]."""

    def measure(self, curve: Curve) -> float:
        """The time of the smallest value."""
        return curve.smallest().time

    def unit(self, of_column: str) -> str:
        """Seconds."""
        return "s"

    def doubt(self, curve: Curve, width: Curve) -> float:
        """How far the furthest other trough is that may be the lowest, or the end of a flat one."""
        opposite = TimeOfLargest(self.column, begin=self.begin, end=self.end)
        return opposite.doubt(curve.with_values(-curve.x), width)


@dataclass(frozen=True, kw_only=True)
class Crossing(Metric):
    """When the column first passes a level, up or down [s].

    It has passed when it has been on both sides: a column that begins on the level passes it when it comes back.
    """

    level: float
    is_local = True

    def measure(self, curve: Curve) -> float:
        """The first time; nan if there is none."""
        return first_passing(curve, self.level)

    def unit(self, of_column: str) -> str:
        """Seconds."""
        return "s"

    def times(self, *curves: Curve) -> tuple[float, ...]:
        """The time itself."""
        return (self(*curves),)

    def lack(self, unit: str, *curves: Curve) -> str:
        """On which side of the level it stays, and how far it gets."""
        curve = self.curve(*curves)
        if curve is None:
            return super().lack(unit, *curves)
        high, low = curve.largest().value, curve.smallest().value
        level = f"{self.level:g} {unit}".rstrip()
        if high <= self.level:
            return f"stays below {level}, largest {high:.4g}"
        return f"stays above {level}, smallest {low:.4g}"


@dataclass(frozen=True)
class Integral(Metric):
    """The integral over time [unit of the column times s]."""

    def measure(self, curve: Curve) -> float:
        """The integral of the polynomials."""
        return curve.integral()

    def unit(self, of_column: str) -> str:
        """That of the column times seconds."""
        return f"{of_column}.s" if of_column not in ("", "1") else "s"


@dataclass(frozen=True)
class Mean(Metric):
    """The mean over time."""

    def measure(self, curve: Curve) -> float:
        """The integral over the time that it is taken over."""
        return curve.integral() / float(curve.t[-1] - curve.t[0])


@dataclass(frozen=True)
class Rms(Metric):
    """The square root of the mean of the square over time."""

    def measure(self, curve: Curve) -> float:
        """The root of the mean of a spline through the squares."""
        square = curve.with_values(np.square(curve.x))
        return math.sqrt(max(0.0, square.integral() / float(curve.t[-1] - curve.t[0])))


@dataclass(frozen=True, kw_only=True)
class Harmonic(Metric):
    """The amplitude of the component of a frequency [Hz], over the last whole periods of a stretch."""

    frequency: float

    def measure(self, curve: Curve) -> float:
        """Twice the absolute value of the Fourier coefficient; nan if there is not one whole period."""
        end = float(curve.t[-1])
        span = (end - float(curve.t[0])) * self.frequency * (1.0 + PERIOD_ROUNDING)
        if math.floor(span) < 1:
            return math.nan
        span = math.floor(span) / self.frequency
        part = curve.between(end - span, end)
        total = sum(
            complex(np.sum(weights * np.exp(-2j * math.pi * self.frequency * t) * p(t)))
            for p, t, weights in _gauss(part)
        )
        return 2.0 * abs(total) / span

    def scale(self, *curves: Curve) -> float:
        """The range of the column."""
        curve = self.curve(*curves)
        return 0.0 if curve is None else float(np.ptp(curve.x))

    def lack(self, unit: str, *curves: Curve) -> str:
        """There is not one whole period."""
        return f"the stretch has no whole period of {self.frequency:g} Hz"


@dataclass(frozen=True)
class LastTurn(Metric):
    """A metric over the last whole turns of an angle [rad], `LastTurn(Swing("load.w"), over="load.phi")`."""

    column: Metric  # type: ignore[assignment]
    _: KW_ONLY
    over: str
    turns: int = 1

    @property
    def is_local(self) -> bool:  # type: ignore[override]
        """As that of the metric."""
        return self.column.is_local

    @property
    def columns(self) -> tuple[str, ...]:
        """Those of the metric, and the angle."""
        return (*self.column.columns, self.over)

    def __call__(self, *curves: Curve) -> float:
        """The number; nan if there are fewer turns."""
        part = self._part(*curves)
        return math.nan if part is None else self.column(*part)

    def _part(self, *curves: Curve) -> list[Curve] | None:
        """The curves of the metric within the last turns; None if there are fewer."""
        angle = curves[-1]
        if not max(self.begin, angle.t[0]) < min(self.end, angle.t[-1]):
            return None
        angle = angle.between(self.begin, self.end)
        begin = last_turn(angle, self.turns)
        if math.isnan(begin):
            return None
        return [curve.between(begin, float(angle.t[-1])) for curve in curves[:-1]]

    def unit(self, of_column: str) -> str:
        """As that of the metric."""
        return self.column.unit(of_column)

    def times(self, *curves: Curve) -> tuple[float, ...]:
        """As those of the metric."""
        part = self._part(*curves)
        return () if part is None else self.column.times(*part)

    def scale(self, *curves: Curve) -> float:
        """As that of the metric."""
        part = self._part(*curves)
        return 0.0 if part is None else self.column.scale(*part)

    def lack(self, unit: str, *curves: Curve) -> str:
        """It does not turn that often."""
        part = self._part(*curves)
        if part is None:
            return f"{self.over} does not turn {self.turns} times"
        return self.column.lack(unit, *part)


@dataclass(frozen=True, kw_only=True)
class StrongestOrder(Metric):
    """The order of an angle [rad] with the largest amplitude, up to `highest`, over the last whole turn."""

    over: str
    highest: int = HIGHEST_ORDER
    is_count = True

    @property
    def columns(self) -> tuple[str, ...]:
        """The column and the angle."""
        return (*super().columns, self.over)

    def __call__(self, *curves: Curve) -> float:
        """The order; nan without a whole turn."""
        amplitudes = self.amplitudes(*curves)
        return math.nan if amplitudes is None else 1.0 + int(np.argmax(amplitudes))

    def amplitudes(self, *curves: Curve) -> Rows | None:
        """The amplitudes of the orders 1, 2, ... over the last whole turn; None without one."""
        curve, angle = super().curve(*curves[:-1]), curves[-1]
        if curve is None:
            return None
        angle = angle.between(float(curve.t[0]), float(curve.t[-1]))
        begin = last_turn(angle, 1)
        if math.isnan(begin):
            return None
        end = float(angle.t[-1])
        curve, angle = curve.between(begin, end), angle.between(begin, end)
        orders = np.arange(1, self.highest + 1)
        total = np.zeros(self.highest, dtype=complex)
        for p, t, weights in _gauss(angle):
            turned = np.exp(-1j * orders[:, None, None] * p(t))
            total += np.sum(weights * p(t, 1) * curve(t) * turned, axis=(1, 2))
        return np.abs(total) / math.pi

    def unit(self, of_column: str) -> str:
        """None: it is a count."""
        return ""

    def lack(self, unit: str, *curves: Curve) -> str:
        """It does not turn once."""
        return f"{self.over} does not turn once"


def last_turn(angle: Curve, turns: int) -> float:
    """When the last so many turns of an angle [rad] began [s]; nan if it turns less."""
    end = float(angle.x[-1])
    sense = math.copysign(1.0, end - float(angle.x[0]))
    times = passings(angle, end - sense * turns * TURN)
    return float(times[-1]) if len(times) else math.nan


def _gauss(curve: Curve) -> Sequence[tuple[PPoly, Rows, Rows]]:
    """The polynomials of a curve, each with Gauss points and weights [s] of its pieces, shape (points, pieces)."""
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    pieces = []
    for p in curve.polynomials():
        half = 0.5 * np.diff(p.x)
        pieces.append((p, (p.x[:-1] + half) + np.outer(nodes, half), np.outer(weights, half)))
    return pieces


def _integral_until(curve: Curve, times: Rows) -> Rows:
    """The integral of a curve from its first row to times [s]."""
    values, before = np.zeros(np.shape(times)), 0.0
    for p in curve.polynomials():
        antiderivative = p.antiderivative()
        inside = (times >= p.x[0]) & (times <= p.x[-1])
        values[inside] = before + antiderivative(times[inside])
        before += float(antiderivative(p.x[-1]))
    return values


def first_passing(curve: Curve, level: float) -> float:
    """The first time [s] at which a curve has been on both sides of a level; nan if there is none."""
    times = passings(curve, level, most=1)
    return float(times[0]) if len(times) else math.nan


def passings(curve: Curve, level: float, most: int | None = None) -> Rows:
    """The times [s] at which a curve changes the side of a level, at or between its rows, in order.

    Parameters
    ----------
    curve
        A column over time.
    level
        In its unit.
    most
        At most so many of them, the first ones; by default all.
    """
    found: list[float] = []
    side = 0.0
    tolerance = ON_LEVEL * float(np.abs(curve.x - level).max())
    for p in curve.polynomials():
        times, values = _turns(p)
        if p.x[-1] == curve.t[-1]:  # a value that holds until the last row jumps there
            times, values = np.append(times, curve.t[-1]), np.append(values, curve.x[-1])
        sides = np.where(np.abs(values - level) <= tolerance, 0.0, np.sign(values - level))
        known = np.flatnonzero(sides)
        if not len(known):
            continue
        changes = np.flatnonzero(np.diff(sides[known]))
        if side and sides[known[0]] != side:
            found.append(float(times[known[0]]))
        side = float(sides[known[-1]])
        for k in changes if most is None else changes[: most - len(found)]:
            first, last = known[k], known[k + 1]
            found.append(_passing(p, times[first : last + 1], values[first : last + 1], level))
        if most is not None and len(found) >= most:
            break
    return np.array(found[:most])


def _turns(p: PPoly) -> tuple[Rows, Rows]:
    """The times [s] and values at which pieces begin, turn and end, in order; between two of them they are monotonic."""
    a, b, c, d = p.c
    width = np.diff(p.x)
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - 3.0 * a * c)
        q = -(b + np.copysign(root, b))
        inner = np.stack([q / (3.0 * a), c / q])
    inner = np.where(np.isfinite(inner), np.clip(inner, 0.0, width), 0.0)
    at = np.concatenate([np.zeros((1, len(width))), np.sort(inner, axis=0), width[None]])
    values = ((a * at + b) * at + c) * at + d
    return (p.x[:-1] + at).T.ravel(), values.T.ravel()


def _passing(p: PPoly, times: Rows, values: Rows, level: float) -> float:
    """The time [s] of the level between the first of these points, on one side of it, and the last, on the other."""
    rises = values[-1] > values[0]
    k = int(np.argmax(values >= level if rises else values <= level))
    begin, end = float(times[k - 1]), float(times[k])
    if begin == end:
        return end
    from scipy.optimize import brentq

    piece = int(
        np.clip(np.searchsorted(p.x, 0.5 * (begin + end), side="right") - 1, 0, len(p.x) - 2)
    )
    a, b, c, d = p.c[:, piece]
    origin = float(p.x[piece])

    def above(s: float) -> float:
        return float(((a * s + b) * s + c) * s + d - level)

    low, high = begin - origin, end - origin
    if not above(low) * above(high) < 0.0:
        return begin if above(low) == 0.0 else end
    return origin + float(brentq(above, low, high, xtol=4.0 * math.ulp(max(abs(begin), abs(end)))))


def largest(t: Rows, x: Rows) -> float:
    """The largest value of x.

    Parameters
    ----------
    t : array_like
        Times of the rows [s].
    x : array_like
        Values at these times.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(largest(t, np.sin(2 * np.pi * t)), 6)
    1.0
    """
    return DenseSolution.from_rows(t, x).largest().value


def smallest(t: Rows, x: Rows) -> float:
    """The smallest value of x.

    Parameters
    ----------
    t : array_like
        Times of the rows [s].
    x : array_like
        Values at these times.
    """
    return DenseSolution.from_rows(t, x).smallest().value


def time_of_largest(t: Rows, x: Rows) -> float:
    """When x is largest [s].

    Parameters
    ----------
    t : array_like
        Times of the rows [s].
    x : array_like
        Values at these times.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(time_of_largest(t, np.sin(2 * np.pi * t)), 6)
    0.25
    """
    return DenseSolution.from_rows(t, x).largest().time


def time_of_smallest(t: Rows, x: Rows) -> float:
    """When x is smallest [s].

    Parameters
    ----------
    t : array_like
        Times of the rows [s].
    x : array_like
        Values at these times.
    """
    return DenseSolution.from_rows(t, x).smallest().time


def crossing(t: Rows, x: Rows, level: float) -> float:
    """When x first passes a level [s], up or down; nan if it never does.

    Parameters
    ----------
    t : array_like
        Times of the rows [s].
    x : array_like
        Values at these times.
    level : float
        In the unit of x.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(crossing(t, t**2, 0.25), 6)
    0.5
    """
    return first_passing(DenseSolution.from_rows(t, x), level)


def mean(t: Rows, x: Rows) -> float:
    """The mean of x over time.

    Parameters
    ----------
    t : array_like
        Times of the rows [s].
    x : array_like
        Values at these times.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(mean(t, t**2), 6)
    0.333333
    """
    return Mean("").measure(DenseSolution.from_rows(t, x))


def rms(t: Rows, x: Rows) -> float:
    """The square root of the mean of x squared over time.

    Parameters
    ----------
    t : array_like
        Times of the rows [s].
    x : array_like
        Values at these times.
    """
    return Rms("").measure(DenseSolution.from_rows(t, x))


def spline(t: Rows, x: Rows) -> CubicSpline:
    """Imported where it is needed, since that takes longer than most runs."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(t, x)
