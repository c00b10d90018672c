"""Values read from rows: between them, with the error their spacing leaves, and orders of an angle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import Result, metrics
from cosim.series import Column

from .figure import Figure

Samples = NDArray[np.float64]
#: Orders that are fitted together by default; a convention.
HIGHEST = 8
#: Smallest error of a value over its size, some thousand roundings of double precision.
ROUNDING = 1e-12
#: Largest distance of a root from its level, over that of the rows; SciPy's piecewise roots are far closer.
ON_LEVEL = 1e-9


class Measured(NamedTuple):
    """A value read from rows and its error.

    The value is nan for what does not happen, with an infinite error where that is not certain.
    """

    value: float
    error: float

    def figure(self, unit: str, meaning: str) -> Figure:
        """The value as a figure, which is refused for what does not or may not happen."""
        if self.error == math.inf:
            return Figure.undetermined(
                unit, "the signal only touches the level, within its error", meaning
            )
        if math.isnan(self.value):
            return Figure.undetermined(unit, "it does not happen during the run", meaning)
        return Figure(self.value, unit, self.error, meaning)


class Peak(NamedTuple):
    """The largest value, its error, and its time."""

    value: float
    error: float
    at: Measured

    def figure(self, unit: str, meaning: str) -> Figure:
        """The value as a figure."""
        return Measured(self.value, self.error).figure(unit, meaning)


def measured(quantity: Callable[..., float], *columns: Samples) -> Measured:
    """Return the `quantity` of columns of shape (n,), with its error.

    The error is how much it would change with every second row alone, of either half. The first and the
    last row are in both halves.
    """
    value = float(quantity(*columns))
    half_values = [
        float(quantity(*(x[half] for x in columns))) for half in _halves(len(columns[0]))
    ]
    return _largest_change(value, half_values)


def with_row_errors(
    quantity: Callable[[Result], Mapping[str, Figure]], result: Result
) -> dict[str, Figure]:
    """The figures that `tell` returns for a result, by name, with the same error; refused ones stay so."""
    all_rows = quantity(result)
    half_values = [
        quantity(with_rows(result, result.data[half])) for half in _halves(len(result.data))
    ]
    return {
        name: figure
        if figure.error is None
        else figure._replace(
            error=_largest_change(figure.value, [x[name].value for x in half_values]).error
        )
        for name, figure in all_rows.items()
    }


def with_rows(result: Result, rows: Samples) -> Result:
    """The result with these rows instead, of shape (n, columns)."""
    return Result(result.columns, result.provenance, rows.T.__getitem__, breaks=result.breaks)


def extended(result: Result, unit: str, more: Mapping[str, Samples]) -> Result:
    """The result with more columns, which are all in that unit."""
    data = np.column_stack([result.data, *more.values()])
    columns = [*result.columns, *(Column(name, unit) for name in more)]
    return Result(columns, result.provenance, data.T.__getitem__, breaks=result.breaks)


def _halves(rows: int) -> list[NDArray[np.int64]]:
    return [np.unique([0, *range(first, rows, 2), rows - 1]) for first in (0, 1)]


def _largest_change(value: float, half_values: Sequence[float]) -> Measured:
    change = max(abs(value - other) for other in half_values)
    return Measured(value, max(change, ROUNDING * abs(value)))


def largest(t: Samples, x: Samples) -> Peak:
    """Return the largest value of x and its time, on the spline through its rows.

    The spline rises no further above the rows than at a smooth peak.
    """
    return Peak(*measured(metrics.largest, t, x), measured(metrics.time_of_largest, t, x))


def smallest(t: Samples, x: Samples) -> Peak:
    """The least value of x and its time, on the spline through the rows around it."""
    peak = largest(t, -x)
    return peak._replace(value=-peak.value)


def since(t: Samples, x: Samples, begin: float) -> tuple[Samples, Samples]:
    """The rows from a time on, the first of them on the spline through all."""
    after = t > begin
    first = float(metrics.spline(t, x)(begin))
    return np.concatenate([[begin], t[after]]), np.concatenate([[first], x[after]])


def crossing(t: Samples, x: Samples, level: float, which: int = 0) -> Measured:
    """Return when x passes a level, on the spline through its rows.

    That is the first time, or with which = 1, 2, .. a later one, and with -1 the last one; nan where x
    does not pass it that often.

    The error is infinite where x turns so near to the level before that (after it for which < 0) that
    its rows do not tell on which side, and so which time it is. Other errors of x are not known here:
    `clearance` says how large they may be.
    """
    times = crossing_times(t, x, level)
    time = Measured(math.nan, math.nan)
    if -len(times) <= which < len(times):
        time = _crossing(t, x, level, times, which % len(times))
    near = clearance(t, x, level, which)
    return time._replace(error=math.inf) if near.value <= near.error else time


def clearance(t: Samples, x: Samples, level: float, which: int = 0) -> Measured:
    """Return how far from a level x turns back, at the nearest turn that decides when it passes the level.

    These are the turns before the next time after the one sought, or for which < 0 after the time before it. An
    error of x beyond that may make another time the one that is sought. It is nan where nothing turns there.
    """
    times = crossing_times(t, x, level)
    begin, end = t[0], t[-1]
    if -len(times) <= which < len(times):
        k = which % len(times)
        bounds = np.concatenate([t[:1], times, t[-1:]])
        begin, end = (bounds[k], end) if which < 0 else (begin, bounds[k + 2])
    curve = metrics.spline(t, x)
    turns = curve.derivative().roots(extrapolate=False)
    turns = turns[(begin < turns) & (turns < end)]
    if not len(turns):
        return Measured(math.nan, math.nan)
    nearest = turns[np.argmin(np.abs(curve(turns) - level))]
    halves = [metrics.spline(t[half], x[half])(nearest) for half in _halves(len(t))]
    distance = _largest_change(float(curve(nearest)), [float(value) for value in halves])
    return Measured(abs(distance.value - level), distance.error)


def passed_for_certain(passing: Figure, clearance: Figure | None) -> Figure:
    """Return the time of a crossing, refused where x comes nearer to the level than its error is.

    Parameters
    ----------
    passing : Figure
        The time.
    clearance : Figure or None
        What `clearance` gives, with the error of x; None where nothing turns.
    """
    if clearance is None or (clearance.error is not None and clearance.value > clearance.error):
        return passing
    return Measured(math.nan, math.inf).figure(passing.unit, passing.meaning)


def _crossing(t: Samples, x: Samples, level: float, times: Samples, k: int) -> Measured:
    """One of the times that `passes` tells, with the error that the rows' spacing leaves."""
    time = float(times[k])
    half_values = [crossing_times(t[half::2], x[half::2], level) for half in (0, 1)]
    change = max(abs(o - time).min() if len(o) else math.inf for o in half_values)
    gap = min(abs(np.delete(times, k) - time), default=math.inf)
    spacing = float(np.diff(t).max())
    error = change if change < min(gap, 4 * spacing) else spacing
    return Measured(time, max(float(error), ROUNDING * abs(time)))


def crossing_times(t: Samples, x: Samples, level: float) -> Samples:
    """The times alone, without those that SciPy finds by mistake where x hardly moves, from rest."""
    curve = metrics.spline(t, x)
    times = curve.solve(level, extrapolate=False)
    return np.asarray(times[abs(curve(times) - level) <= ON_LEVEL * abs(x - level).max()])


def integral(t: Samples, x: Samples) -> Measured:
    """Of x over t, on the spline through its rows."""
    return measured(lambda t, x: float(metrics.spline(t, x).integrate(t[0], t[-1])), t, x)


def last_revolutions(phi: Samples, count: int) -> NDArray[np.bool_]:
    """The samples of the last `count` whole revolutions."""
    return np.asarray(phi >= phi[-1] - 2 * math.pi * count)


def harmonics(phi: Samples, x: Samples, highest: int = HIGHEST) -> NDArray[np.complex128]:
    """Complex amplitudes of the orders 1..highest, X = Im(X_hat exp(i k phi)), fitted together.

    phi [rad] has shape (n,), x too, or (n, columns), which gives (highest, columns); needs more than
    2 * highest samples per revolution. Over whole revolutions the normal equations are nearly diagonal.
    """
    turned = np.repeat(np.exp(1j * phi)[:, None], highest, axis=1).cumprod(axis=1)
    design = np.hstack([np.ones((len(phi), 1)), turned.imag, turned.real])
    fit = np.linalg.solve(design.T @ design, design.T @ x)
    return np.asarray(fit[1 : highest + 1] + 1j * fit[highest + 1 :])


def order(phi: Samples, x: Samples, k: int) -> complex:
    """Complex amplitude of order k."""
    return complex(harmonics(phi, x)[k - 1])
