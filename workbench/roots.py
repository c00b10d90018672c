"""Roots and peaks of residuals that are dear to evaluate, and all roots of those that are cheap.

A dear residual takes a co-simulation for each value. Several searches then go on side by side, and all the
values of a round are evaluated together. So a search here does not call its residual: it says where the
next values are wanted, and takes them. `SecantSearch` takes the steps of
`scipy.optimize.root_scalar(method="secant")`, and starts from a slope that an interpolant gives; `PeakSearch`
finds the largest value of a smooth function on the polynomial through its Chebyshev nodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize_scalar

Array = NDArray[np.float64]

#: Relative error at which a secant search ends. It is a convention, a hundredth of the median error that
#: coupling leaves of the speeds of a resonance (5e-6, benchmarks/resonance.py).
ROOT_TOLERANCE = 5e-8
#: Rounds before a search is given up; a secant search from an interpolant takes two or three.
MAX_ROUNDS = 8
#: Chebyshev nodes of a peak. Five leave 4e-9 of the speed within 0.25 rad/s of the torque peak of set A.
PEAK_NODES = 5
#: Share of the half width within which a peak must lie to be accepted: where the nodes surround it.
PEAK_INSIDE = 0.6
#: How far beyond the nodes a peak is looked for, over the half width, to know where to look next.
PEAK_REACH = 1.5


class NoRootError(Exception):
    """There is no such root, or the search does not reach it; says why in a sentence."""


class Root(NamedTuple):
    """A root or the place of a peak, and its error in the same unit."""

    x: float
    error: float


class Crossing(NamedTuple):
    """Where a curve passes through 0, and its slope there."""

    x: float
    slope: float


@dataclass
class SecantSearch:
    """A root of a residual, by the secant method from a first guess and the slope there.

    Attributes
    ----------
    x : float
        Where the residual is wanted next, above 0.
    slope : float
        Slope of the residual there: first that of an interpolant, then that of the last two values.
    """

    x: float
    slope: float
    _previous: tuple[float, float] | None = None
    _rounds: int = 0

    def update(self, residual: float, noise: float) -> Root | None:
        """Take the residual at x; return the root, or None if another value is wanted.

        The error is that of the last step. For that, the step is multiplied with the relative change of
        the slope since the step before, which is of its size where the residual is curved; the noise over
        the slope is added.

        Parameters
        ----------
        residual, noise : float
            The residual at x, and by how much it may be wrong.

        Raises
        ------
        NoRootError
            If the search leaves x > 0, or does not converge.
        """
        slope, curvature = self.slope, 1.0
        if self._previous is not None:
            x, value = self._previous
            slope = (residual - value) / (self.x - x)
            curvature = min(1.0, abs(1.0 - self.slope / slope)) if slope else 1.0
        if not (slope and math.isfinite(slope)):
            raise NoRootError("the residual of the root search does not change")
        step = -residual / slope
        error, unsure = abs(step) * curvature, noise / abs(slope)
        if error <= max(ROOT_TOLERANCE * self.x, unsure):
            return Root(self.x + step, error + unsure)
        self._previous, self.slope = (self.x, residual), slope
        self.x += step
        self._rounds += 1
        if self.x <= 0.0:
            raise NoRootError("the root search ran down to zero")
        if self._rounds >= MAX_ROUNDS:
            raise NoRootError(f"the root search did not converge in {MAX_ROUNDS} rounds")
        return None


@dataclass
class PeakSearch:
    """The largest height of a function, from values of a smooth one at Chebyshev nodes.

    Attributes
    ----------
    center, half_width : float
        Where the nodes lie, x > 0.
    height : callable
        The height at x, of shape (n,), for the values of the smooth function there.
    """

    center: float
    half_width: float
    height: Callable[[Any, Any], Any]
    _rounds: int = field(default=0)

    @property
    def nodes(self) -> list[float]:
        """Where values are wanted next."""
        angles = (2 * np.arange(PEAK_NODES) + 1) * math.pi / (2 * PEAK_NODES)
        return [float(x) for x in self.center - self.half_width * np.cos(angles)]

    def update(self, values: Sequence[complex], noise: float) -> tuple[Root, Root] | None:
        """Take the values at the nodes; return place and height of the peak, or None to go on.

        The errors are the changes without the last coefficient of the polynomial. The place has
        that of noise, too: the slope of the height's logarithm is wrong by about 2 noise / half_width.

        Parameters
        ----------
        values : sequence of complex
            The smooth function at the nodes.
        noise : float
            By what share the height may be wrong.

        Raises
        ------
        NoRootError
            If the search leaves x > 0, or does not converge.
        """
        ends = [self.center - self.half_width, self.center + self.half_width]
        fit = Chebyshev.fit(self.nodes, values, PEAK_NODES - 1, domain=ends)
        x, height = self._top(fit)
        if abs(x - self.center) <= PEAK_INSIDE * self.half_width:
            coarse_x, coarse_height = self._top(fit.truncate(PEAK_NODES - 1))
            unsure = 2.0 * noise / self.half_width / max(self._bend(fit, x), 1e-300)
            position = Root(x, abs(x - coarse_x) + unsure)
            return position, Root(height, abs(height - coarse_height) + noise * height)
        self.center = x
        self._rounds += 1
        if self.center <= self.half_width:
            raise NoRootError("the peak search ran down to zero")
        if self._rounds >= MAX_ROUNDS:
            raise NoRootError(f"the peak search did not converge in {MAX_ROUNDS} rounds")
        return None

    def _top(self, fit: Chebyshev) -> tuple[float, float]:
        """Where the height is largest on a fit, and the height."""
        reach = PEAK_REACH * self.half_width
        bounds = max(self.center - reach, 1e-3 * self.center), self.center + reach
        top = minimize_scalar(
            lambda x: -float(np.log(self.height(x, fit(x)))),
            bounds=bounds,
            method="bounded",
            options={"xatol": 1e-9 * self.center},
        )
        return float(top.x), math.exp(-float(top.fun))

    def _bend(self, fit: Chebyshev, x: float) -> float:
        """The second derivative of the height's logarithm at x, without its sign."""
        h = self.half_width / 4.0
        left, middle, right = (math.log(float(self.height(y, fit(y)))) for y in (x - h, x, x + h))
        return abs(left - 2.0 * middle + right) / h**2


def roots_between(function: Callable[[Any], Any], grid: Array) -> list[float]:
    """Return all roots of a cheap function that a grid tells apart, in order, by Brent's method.

    Parameters
    ----------
    function : callable
        Takes an array or a number.
    grid : ndarray, shape (n,)
        Rising; two roots between neighbours are not told apart.
    """
    values = np.asarray(function(grid))
    changes = np.flatnonzero((values[1:] > 0.0) != (values[:-1] > 0.0))
    return [
        float(brentq(lambda x: float(function(x)), grid[k], grid[k + 1], xtol=1e-12 * abs(grid[k])))
        for k in changes.tolist()
    ]


def falling_roots(x: Array, values: Array, derivative: bool = False) -> list[Crossing]:
    """Return where the spline through values falls through 0.

    Parameters
    ----------
    x, values : ndarray, shape (n,)
        The nodes of the spline.
    derivative : bool
        Take the roots of its derivative, which are its peaks.
    """
    spline = CubicSpline(x, values)
    curve = spline.derivative() if derivative else spline
    at, slope = curve.roots(extrapolate=False), curve.derivative()
    return [Crossing(float(root), float(slope(root))) for root in at if slope(root) < 0.0]


def bisect_flag(is_true: Callable[[float], bool], low: float, high: float, width: float) -> float:
    """Return the largest x, within a width, up to which a flag is true, by bisection.

    Parameters
    ----------
    is_true : callable
        True at `low`, false at `high`.
    low, high, width : float
        Ends of the bracket, and how narrow it becomes.
    """
    while high - low > width:
        middle = (low + high) / 2.0
        low, high = (middle, high) if is_true(middle) else (low, middle)
    return low
