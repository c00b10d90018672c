"""What rows tell: values between them with the error their spacing leaves, and orders of an angle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cosim import Result

from .figure import Figure

Samples = NDArray[np.float64]
HIGHEST = 8
AROUND = 6
ROUNDING = 1e-12


class Measured(NamedTuple):
    """A value that rows tell, and what they leave open of it; nan for what does not happen."""

    value: float
    error: float

    def figure(self, unit: str, meaning: str) -> Figure:
        """The value as a figure, which is refused for what does not happen."""
        if math.isnan(self.value):
            return Figure.refused(unit, "it does not happen while the run lasts", meaning)
        return Figure(self.value, unit, self.error, meaning)


class Peak(NamedTuple):
    """The largest value, its error, and the time where it stands."""

    value: float
    error: float
    at: Measured

    def figure(self, unit: str, meaning: str) -> Figure:
        """The value as a figure."""
        return Measured(self.value, self.error).figure(unit, meaning)


def measured(tell: Callable[..., float], *columns: Samples) -> Measured:
    """What `tell` makes of columns of shape (n,): its error is how much every second row, of either
    half, would change it. The first and the last row stand in both halves.
    """
    value = float(tell(*columns))
    others = [float(tell(*(x[half] for x in columns))) for half in _halves(len(columns[0]))]
    return _away(value, others)


def over_rows(tell: Callable[[Result], Mapping[str, float]], result: Result) -> dict[str, Measured]:
    """What `tell` makes of a result, by name, with the same error."""
    whole, columns = tell(result), result.columns
    others = []
    for half in _halves(len(result.data)):
        rows = result.data[half]
        others.append(tell(Result(columns, result.units, result.provenance, partial(_same, rows))))
    return {name: _away(value, [other[name] for other in others]) for name, value in whole.items()}


def _same(rows: Samples) -> Samples:
    return rows


def _halves(rows: int) -> list[NDArray[np.int64]]:
    return [np.unique([0, *range(first, rows, 2), rows - 1]) for first in (0, 1)]


def _away(value: float, others: Sequence[float]) -> Measured:
    away = max(abs(value - other) for other in others)
    return Measured(value, max(away, ROUNDING * abs(value)))


def largest(t: Samples, x: Samples) -> Peak:
    """The largest value of x and its time, on the spline through the rows around it."""
    value = measured(lambda t, x: _top(t, x)[0], t, x)
    at = measured(lambda t, x: _top(t, x)[1], t, x)
    return Peak(*value, at)


def smallest(t: Samples, x: Samples) -> Peak:
    """The least value of x and its time, on the spline through the rows around it."""
    found = largest(t, -x)
    return found._replace(value=-found.value)


def _top(t: Samples, x: Samples) -> tuple[float, float]:
    top = int(np.argmax(x))
    if not 0 < top < len(x) - 1:
        return float(x[top]), float(t[top])
    near = slice(max(0, top - AROUND), top + AROUND + 1)
    curve = CubicSpline(t[near], x[near])
    times = curve.derivative().roots(extrapolate=False)
    at = times[np.argmax(curve(times))]
    return float(curve(at)), float(at)


def crossings(t: Samples, x: Samples, level: float) -> list[Measured]:
    """The times at which x passes a level, on the spline through its rows."""
    times = _passed(t, x, level)
    found = []
    for k, time in enumerate(times):
        others = [_passed(t[half::2], x[half::2], level) for half in (0, 1)]
        away = max(abs(o - time).min() if len(o) else math.inf for o in others)
        gap = min(abs(np.delete(times, k) - time), default=math.inf)
        spacing = float(np.diff(t).max())
        error = away if away < min(gap, 4 * spacing) else spacing
        found.append(Measured(float(time), max(float(error), ROUNDING * abs(float(time)))))
    return found


def crossing(t: Samples, x: Samples, level: float, which: int = 0) -> Measured:
    """One of these times: the first, or which = 1, 2, .. after it, -1 for the last; nan where x does
    not pass the level so often.
    """
    found = crossings(t, x, level)
    return found[which] if -len(found) <= which < len(found) else Measured(math.nan, math.nan)


def _passed(t: Samples, x: Samples, level: float) -> Samples:
    return np.asarray(CubicSpline(t, x).solve(level, extrapolate=False))


def integral(t: Samples, x: Samples) -> Measured:
    """Of x over t, on the spline through its rows."""
    return measured(lambda t, x: float(CubicSpline(t, x).integrate(t[0], t[-1])), t, x)


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


def mean_speed(t: Samples, phi: Samples, count: int) -> float:
    """Time mean of the speed over the last `count` whole revolutions [rad/s]."""
    angle = 2 * math.pi * count
    began = float(CubicSpline(phi, t)(phi[-1] - angle))
    return float(angle / (t[-1] - began))
