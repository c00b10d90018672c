"""Figures of a column, taken on a cubic spline through its rows.

t are times [s] and x values, both of shape (rows,). Of rows with the same time, the last one counts.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Rows = NDArray[np.float64]
FEWEST = 4
GAIN = 0.25


def largest(t: Rows, x: Rows) -> float:
    """The largest value of x."""
    return _top(t, x)[0]


def smallest(t: Rows, x: Rows) -> float:
    """The smallest value of x."""
    return -_top(t, -x)[0]


def time_of_largest(t: Rows, x: Rows) -> float:
    """When x is largest [s]."""
    return _top(t, x)[1]


def time_of_smallest(t: Rows, x: Rows) -> float:
    """When x is smallest [s]."""
    return _top(t, -x)[1]


def crossing(t: Rows, x: Rows, level: float) -> float:
    """When x first passes a level [s], up or down; NaN if it never does."""
    t, x = _distinct(t, x)
    above = x > level
    passed = np.flatnonzero(above[1:] != above[:-1])
    if not len(passed):
        return math.nan
    k = int(passed[0])
    if len(t) >= FEWEST:
        roots = spline(t, x - level).solve(extrapolate=False)
        inside = roots[(roots >= t[k]) & (roots <= t[k + 1])]
        if len(inside):
            return float(inside[0])
    return float(t[k] + (level - x[k]) / (x[k + 1] - x[k]) * (t[k + 1] - t[k]))


def mean(t: Rows, x: Rows) -> float:
    """The mean of x over time."""
    t, x = _distinct(t, x)
    if len(t) < FEWEST:
        return float(np.trapezoid(x, t) / (t[-1] - t[0]))
    return float(spline(t, x).integrate(t[0], t[-1]) / (t[-1] - t[0]))


def rms(t: Rows, x: Rows) -> float:
    """The square root of the mean of x squared over time."""
    return math.sqrt(max(0.0, mean(t, np.square(x))))


def spline(t: Rows, x: Rows) -> CubicSpline:
    """Imported where it is needed, since that takes longer than most runs."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(t, x)


def _distinct(t: Rows, x: Rows) -> tuple[Rows, Rows]:
    """The rows, the last one of each time."""
    last = np.append(np.diff(t) > 0.0, True)
    return t[last], x[last]


def _top(t: Rows, x: Rows) -> tuple[float, float]:
    """The largest value and its time.

    The spline may rise above the rows by no more than the curvature of a smooth peak allows, since it
    overshoots next to a jump.
    """
    t, x = _distinct(t, x)
    row = int(np.argmax(x))
    value, time = float(x[row]), float(t[row])
    if len(t) < FEWEST:
        return value, time
    a, b, c, _ = (curve := spline(t, x)).c
    higher = np.maximum(x[:-1], x[1:])
    beyond = np.concatenate([[-np.inf], x, [-np.inf]])
    lower = np.maximum(beyond[: len(higher)], beyond[3:])
    most = higher + GAIN * (higher - lower)
    for k in np.flatnonzero(most > value):
        roots = np.roots([3 * a[k], 2 * b[k], c[k]])
        for s in roots[np.isreal(roots)].real:
            if 0.0 < s < t[k + 1] - t[k]:
                peak = min(float(curve(t[k] + s)), float(most[k]))
                if peak > value:
                    value, time = peak, float(t[k] + s)
    return value, time
