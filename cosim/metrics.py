"""Metrics: what a person asks of a column, as functions of rows and as records that know their columns.

The functions take times t [s] and values x, both of shape (rows,). The records, such as `Largest("motor.tau")`,
name the column and a stretch of time; `certify` states their errors. Both look between the rows, on a
`DenseSolution`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .dense import DenseSolution

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Rows = NDArray[np.float64]
#: Gauss points of each polynomial in the integral of a harmonic: derived, four are exact up to degree 7, so
#: that a cubic leaves degree 4 for the sine, whose next term is below (w h)^5 / 120.
GAUSS_POINTS = 4
#: Relative amount by which a stretch may fall short of whole periods and still have them. Derived: a frequency or a time
#: that is written with ten significant digits is off by up to 5e-10 of itself, and a product of two by twice that.
#: The part of a period that lacks then changes an amplitude by 2e-9 of the largest value at most.
PERIOD_ROUNDING = 1e-9


@runtime_checkable
class Metric(Protocol):
    """A number that a column has, and what of it the error of the column may change at a stroke."""

    @property
    def column(self) -> str:
        """The column that it is taken from."""
        ...

    def value(self, solution: DenseSolution) -> float:
        """The number; nan if the column has none, such as the time at which it passes a level."""
        ...

    def times(self, solution: DenseSolution) -> tuple[float, ...]:
        """The times [s] at which the values alone decide the number; none if all do, or their slopes."""
        ...

    def scale(self, solution: DenseSolution) -> float:
        """The size that an error is compared with; 0 if that is the number itself."""
        ...

    def doubt(self, solution: DenseSolution, band: DenseSolution) -> float:
        """How far the number may be off because something else is as good within the band.

        Parameters
        ----------
        solution : DenseSolution
            The column.
        band : DenseSolution
            By how much each of its values may be wrong.
        """
        ...


@dataclass(frozen=True)
class ColumnMetric:
    """A metric of a column from `begin` to `end` [s], by default over the whole run."""

    column: str
    begin: float = -math.inf
    end: float = math.inf

    def value(self, solution: DenseSolution) -> float:
        """The number within the stretch of time."""
        return self.measure(self.stretch(solution))

    def stretch(self, solution: DenseSolution) -> DenseSolution:
        """The part of a solution that the metric looks at."""
        if self.begin <= solution.t[0] and self.end >= solution.t[-1]:
            return solution
        return solution.between(self.begin, self.end)

    def measure(self, solution: DenseSolution) -> float:
        """The number of a whole solution."""
        raise NotImplementedError

    def times(self, solution: DenseSolution) -> tuple[float, ...]:
        """None: all times decide the number."""
        return ()

    def scale(self, solution: DenseSolution) -> float:
        """The number itself."""
        return 0.0

    def doubt(self, solution: DenseSolution, band: DenseSolution) -> float:
        """Nothing: the number follows the solution evenly."""
        return 0.0


@dataclass(frozen=True)
class PointValue(ColumnMetric):
    """A value of the column at one time."""

    def scale(self, solution: DenseSolution) -> float:
        """The range of the column."""
        return float(np.ptp(self.stretch(solution).x))

    def _start_doubt(self, solution: DenseSolution, band: DenseSolution, sign: float) -> float:
        """By how much the extreme of the first interval's band exceeds the value."""
        if self.begin > solution.t[0]:
            return 0.0
        _, highest = solution.start_extreme(band.x, sign)
        return max(0.0, highest - sign * self.value(solution))


@dataclass(frozen=True)
class Last(PointValue):
    """The last value."""

    def times(self, solution: DenseSolution) -> tuple[float, ...]:
        """The end."""
        return (min(self.end, float(solution.t[-1])),)

    def measure(self, solution: DenseSolution) -> float:
        """The value of the last row."""
        return float(solution.x[-1])


@dataclass(frozen=True)
class Largest(PointValue):
    """The largest value."""

    def measure(self, solution: DenseSolution) -> float:
        """The largest value, at or between rows."""
        return solution.largest().value

    def doubt(self, solution: DenseSolution, band: DenseSolution) -> float:
        """How much higher the band is between the first two rows, if that is the highest of all."""
        return self._start_doubt(solution, band, 1.0)

    def times(self, solution: DenseSolution) -> tuple[float, ...]:
        """The time of the peak."""
        return (self.stretch(solution).largest().time,)


@dataclass(frozen=True)
class Smallest(PointValue):
    """The smallest value."""

    def measure(self, solution: DenseSolution) -> float:
        """The smallest value, at or between rows."""
        return -solution.with_values(-solution.x).largest().value

    def doubt(self, solution: DenseSolution, band: DenseSolution) -> float:
        """How much lower the band is between the first two rows, if that is the lowest of all."""
        return self._start_doubt(solution, band, -1.0)

    def times(self, solution: DenseSolution) -> tuple[float, ...]:
        """The time of the trough."""
        solution = self.stretch(solution)
        return (solution.with_values(-solution.x).largest().time,)


@dataclass(frozen=True)
class TimeOfLargest(ColumnMetric):
    """When the value is largest [s]."""

    def measure(self, solution: DenseSolution) -> float:
        """The time of the largest value."""
        return solution.largest().time

    def doubt(self, solution: DenseSolution, band: DenseSolution) -> float:
        """How far the furthest other peak is that may be the highest, or the end of a plateau."""
        solution, band = self.stretch(solution), self.stretch(band)
        peak = solution.largest()
        times, values = solution.maxima()
        least = peak.value - _at(band, peak.time)
        rivals = times[values + band(times) >= least]
        spacing = float(np.diff(solution.t).max())
        distances = np.abs(rivals - peak.time)
        return float(distances[distances > spacing].max(initial=-spacing)) + spacing


@dataclass(frozen=True)
class TimeOfSmallest(ColumnMetric):
    """When the value is smallest [s]."""

    def measure(self, solution: DenseSolution) -> float:
        """The time of the smallest value."""
        return solution.with_values(-solution.x).largest().time

    def doubt(self, solution: DenseSolution, band: DenseSolution) -> float:
        """How far the furthest other trough is that may be the lowest, or the end of a flat one."""
        opposite = TimeOfLargest(self.column, self.begin, self.end)
        return opposite.doubt(solution.with_values(-solution.x), band)


@dataclass(frozen=True)
class Crossing:
    """When a column first passes a level, up or down [s]."""

    column: str
    level: float
    begin: float = -math.inf
    end: float = math.inf

    def value(self, solution: DenseSolution) -> float:
        """The first time; nan if there is none."""
        return _first_crossing(self._stretch(solution), self.level)

    def times(self, solution: DenseSolution) -> tuple[float, ...]:
        """The time itself."""
        return (self.value(solution),)

    def scale(self, solution: DenseSolution) -> float:
        """The number itself."""
        return 0.0

    def _stretch(self, solution: DenseSolution) -> DenseSolution:
        return ColumnMetric(self.column, self.begin, self.end).stretch(solution)

    def doubt(self, solution: DenseSolution, band: DenseSolution) -> float:
        """How far the first turn before it is at which the column comes as near to the level as its band."""
        solution, band = self._stretch(solution), self._stretch(band)
        time = _first_crossing(solution, self.level)
        if math.isnan(time) or solution.is_discrete:
            return 0.0
        below = solution.x[0] <= self.level
        toward = solution if below else solution.with_values(-solution.x)
        times, values = toward.maxima()
        level = self.level if below else -self.level
        turns = (times < time) & (times > solution.t[0])
        near = times[turns][values[turns] + band(times[turns]) >= level]
        spacing = float(np.diff(solution.t).max())
        distances = time - near
        return float(distances[distances > spacing].max(initial=-spacing)) + spacing


@dataclass(frozen=True)
class Integral(ColumnMetric):
    """The integral over time [unit of the column times s]."""

    def measure(self, solution: DenseSolution) -> float:
        """The integral of the polynomials."""
        return solution.integral()


@dataclass(frozen=True)
class Mean(ColumnMetric):
    """The mean over time."""

    def measure(self, solution: DenseSolution) -> float:
        """The integral over the time that it is taken over."""
        return solution.integral() / float(solution.t[-1] - solution.t[0])


@dataclass(frozen=True)
class Rms(ColumnMetric):
    """The square root of the mean of the square over time."""

    def measure(self, solution: DenseSolution) -> float:
        """The root of the mean of a spline through the squares."""
        square = solution.with_values(np.square(solution.x))
        return math.sqrt(max(0.0, square.integral() / float(solution.t[-1] - solution.t[0])))


@dataclass(frozen=True)
class Harmonic:
    """The amplitude of the component of a frequency [Hz], over the last whole periods of a stretch."""

    column: str
    frequency: float
    begin: float = -math.inf
    end: float = math.inf

    def value(self, solution: DenseSolution) -> float:
        """Twice the absolute value of the Fourier coefficient; nan if there is not one whole period."""
        solution = ColumnMetric(self.column, self.begin, self.end).stretch(solution)
        end = float(solution.t[-1])
        periods = math.floor(
            (end - float(solution.t[0])) * self.frequency * (1.0 + PERIOD_ROUNDING)
        )
        if periods < 1:
            return math.nan
        span = periods / self.frequency
        part = solution.between(end - span, end)
        nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
        total = 0j
        for p in part.polynomials():
            half = 0.5 * np.diff(p.x)
            t = (p.x[:-1] + half) + np.outer(nodes, half)
            turned = np.exp(-2j * math.pi * self.frequency * t) * p(t)
            total += complex((weights @ turned) @ half)
        return 2.0 * abs(total) / span

    def times(self, solution: DenseSolution) -> tuple[float, ...]:
        """None: all times decide the number."""
        return ()

    def scale(self, solution: DenseSolution) -> float:
        """The range of the column."""
        return float(np.ptp(ColumnMetric(self.column, self.begin, self.end).stretch(solution).x))

    def doubt(self, solution: DenseSolution, band: DenseSolution) -> float:
        """Nothing: the number follows the solution evenly."""
        return 0.0


def _first_crossing(solution: DenseSolution, level: float) -> float:
    """The first time at which the rows have passed a level, on the polynomial between two of them."""
    above = solution.x > level
    passed = np.flatnonzero(above[1:] != above[:-1])
    if not len(passed):
        return math.nan
    k = int(passed[0])
    begin, end = float(solution.t[k]), float(solution.t[k + 1])
    for p in solution.polynomials():
        if p.x[0] <= begin and end <= p.x[-1] and end > begin:
            roots = _roots(p, begin, end, level)
            if len(roots):
                return float(roots[0])
    share = (level - solution.x[k]) / (solution.x[k + 1] - solution.x[k])
    return begin + float(share) * (end - begin)


def _roots(p: object, begin: float, end: float, level: float) -> Rows:
    """The times from begin to end [s] at which the polynomial there has the level."""
    from scipy.interpolate import PPoly

    assert isinstance(p, PPoly)
    k = int(np.searchsorted(p.x, begin, side="right")) - 1
    c = p.c[:, k : k + 1].copy()
    c[3] -= level
    roots = np.asarray(PPoly(c, np.array([begin, end])).roots(extrapolate=False))
    return roots[np.isfinite(roots)]


def _at(solution: DenseSolution, time: float) -> float:
    """The value at one time [s]."""
    return float(solution(np.array([time]))[0])


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
    return -DenseSolution.from_rows(t, -x).largest().value


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
    return DenseSolution.from_rows(t, -x).largest().time


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
    return _first_crossing(DenseSolution.from_rows(t, x), level)


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
