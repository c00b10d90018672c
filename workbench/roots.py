"""Roots and peaks of residuals that are dear to evaluate, and all roots of those that are cheap.

A dear residual takes a co-simulation for each value. Searches then go on side by side as the elements of arrays, and
all the values of a round are evaluated together. `secant` takes the steps of
`scipy.optimize.root_scalar(method="secant")`, and starts from slopes that an interpolant gives; `peaks`
finds the largest values of smooth functions on the polynomials through their Chebyshev nodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.optimize.elementwise import find_minimum

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
#: By how much less than what is accepted the tops with all step sizes fill, where their nodes are laid anew.
SPARE = 0.2
#: How far beyond the nodes a peak is looked for, over the half width, to know where to look next.
PEAK_REACH = 1.5
#: Lowest x at which a peak is looked for, over the center: a convention, all of x > 0 but for rounding.
LOWEST_SHARE = 1e-3
#: Tolerance of the place of a peak, over the half width: the closest that a minimum is told in double precision.
PEAK_TOLERANCE = 1e-8
#: By how much noise at the nodes may move the polynomial, over the noise. Derived: the Lebesgue constant of the
#: nodes, the largest sum of the sizes of their Lagrange polynomials, is 1.554.
NOISE_OF_VALUE = 1.56
#: By how much it may move its slope where a peak is accepted, over noise and half width. Derived: the largest sum
#: of the sizes of the slopes of the Lagrange polynomials within PEAK_INSIDE is 4.563.
NOISE_OF_SLOPE = 4.57
#: Rounding of a height's logarithm: derived, ten operations of relative error 2.2e-16.
HEIGHT_ROUNDING = 2.2e-15
#: Step of the differences that give the curvature of a height, over the half width. Derived: their error is of the
#: order of its square, and rounding adds a billionth.
CURVATURE_STEP = 1e-2
#: Points between which a top is bracketed, an eighth of the distance of the nodes apart.
TOP_GRID = 61
#: The reason of a search whose residual or function has no value.
NO_VALUE = "there is no value where the search wants one"


@dataclass(frozen=True)
class Estimates:
    """Roots, or places or heights of peaks, and their errors in the same unit; nan and a reason where there is none."""

    x: Array
    error: Array
    reasons: NDArray[np.object_]


class LocatedPeaks(NamedTuple):
    """Where the peaks of curves are, and how high."""

    places: Estimates
    heights: Estimates


def secant(residual: Callable[[Array], tuple[Array, Array]], x: Any, slope: Any) -> Estimates:
    """Return roots of dear residuals by the secant method, from first guesses and the slopes there, side by side.

    The error of each is that of its last step. For that, the step is multiplied with the relative change of
    the slope since the step before, which is of its size where the residual is curved; the noise over
    the slope is added.

    Parameters
    ----------
    residual : callable
        Takes x, nan where no value is wanted, and returns the residuals there, nan where there is none, and by how
        much they may be wrong.
    x, slope : ndarray
        First guesses, above 0, and the slopes of the residuals there.
    """
    x, slope = np.array(x, float), np.array(slope, float)
    before, last = np.full_like(x, np.nan), np.full_like(x, np.nan)
    found = Estimates(
        np.full_like(x, np.nan), np.full_like(x, np.nan), np.full(x.shape, "", object)
    )
    is_open = np.isfinite(x)
    for _ in range(MAX_ROUNDS):
        if not is_open.any():
            break
        value, noise = residual(np.where(is_open, x, np.nan))
        with np.errstate(all="ignore"):
            chord = np.where(np.isnan(last), slope, (value - last) / (x - before))
            bend = np.where(np.isnan(last), 1.0, np.minimum(1.0, np.abs(1.0 - slope / chord)))
            step = -value / chord
            error, unsure = np.abs(step) * bend, noise / np.abs(chord)
            done = is_open & (error <= np.maximum(ROOT_TOLERANCE * x, unsure))
        found.x[done], found.error[done] = (x + step)[done], (error + unsure)[done]
        before, last, slope, x = x, value, chord, x + step
        ends = {
            NO_VALUE: np.isnan(value),
            "the residual of the root search does not change": ~np.isfinite(step),
            "the root search ran down to zero": ~done & (x <= 0.0),
        }
        is_open &= ~done
        for reason, which in ends.items():
            found.reasons[is_open & which] = reason
            is_open &= ~which
    found.reasons[is_open] = f"the root search did not converge in {MAX_ROUNDS} rounds"
    return found


def peaks(
    function: Callable[[Array], tuple[NDArray[Any], Array]],
    height: Callable[[Array, NDArray[Any], NDArray[np.intp]], Array],
    center: Array,
    half_width: Array,
) -> LocatedPeaks:
    """Return places and heights of the largest heights, each from one fit through Chebyshev nodes, side by side.

    The polynomial misses about the next term a_n T_n of the series, n = PEAK_NODES, which vanishes at the
    nodes. The height is wrong by |a_n| at most. With s = (x - center) / half_width, T_n has a slope
    of up to n / sqrt(1 - s^2). That of the height's logarithm is wrong by as much, relative to the
    function, and the place by this over its curvature. Noise adds to both, and the place is not
    known more closely than rounding leaves the top flat (Brent, Algorithms for Minimization without
    Derivatives, 1973, chapter 5).

    Parameters
    ----------
    function : callable
        Takes nodes, shape (PEAK_NODES, n), nan where no value is wanted; returns values of smooth functions there,
        shape (steps, PEAK_NODES, n), nan where there is none, and by what share the heights may be wrong, shape (n,).
        The first step counts where another one has no value.
    height : callable
        The heights at x for the values of the smooth functions there, of elements with these numbers.
    center, half_width : ndarray, shape (n,)
        Where the nodes lie, x > 0.

    Returns
    -------
    LocatedPeaks
        Of shape (steps, n), with reasons of shape (n,).
    """
    center, half = np.array(center, float), np.array(half_width, float)
    which = np.arange(len(center))
    found: Array = np.full((4, 1, len(center)), np.nan)
    reasons = np.full(len(center), "", object)
    is_open = np.isfinite(center)
    angles = (2 * np.arange(PEAK_NODES) + 1) * math.pi / (2 * PEAK_NODES)
    to_series = 2.0 / PEAK_NODES * chebyshev.chebvander(-np.cos(angles), PEAK_NODES - 1).T
    to_series[0] /= 2.0
    for _ in range(MAX_ROUNDS):
        if not is_open.any():
            break
        nodes = center - half * np.cos(angles)[:, None]
        values, noise = function(np.where(is_open, nodes, np.nan))
        steps = len(values)
        found = np.broadcast_to(found, (4, steps, len(center))).copy()
        missing = np.isnan(values).any(1)
        lost = is_open & missing[0]
        reasons[lost] = NO_VALUE
        is_open &= ~lost
        k = which[is_open]
        filled = np.where(missing[:, None], values[0], values)[..., k]
        every, j = np.tile(k, steps), np.arange(steps * len(k))
        series = to_series @ np.concatenate([*filled], axis=1)
        fits = _ChebyshevFits(every, center[every], half[every], series, height)
        s = fits.tops()
        inner = np.flatnonzero((np.abs(s) <= PEAK_INSIDE).reshape(steps, -1).all(0))
        done = (j.reshape(steps, -1)[:, inner]).ravel()
        of_done = fits.places_and_heights(s[done], done, noise[every[done]])
        for one, values_ in zip(found, of_done):
            one[:, k[inner]] = np.where(missing[:, k[inner]], np.nan, values_.reshape(steps, -1))
        is_open[k[inner]] = False
        ends = s.reshape(steps, -1).min(0), s.reshape(steps, -1).max(0)
        center[k] += half[k] * (ends[0] + ends[1]) / 2.0
        half[k] *= np.maximum(1.0, (ends[1] - ends[0]) / (2.0 * PEAK_INSIDE - SPARE))
        low = is_open & (center <= half)
        reasons[low] = "the peak search ran down to zero"
        is_open &= ~low
    reasons[is_open] = f"the peak search did not converge in {MAX_ROUNDS} rounds"
    return LocatedPeaks(
        Estimates(found[0], found[2], reasons), Estimates(found[1], found[3], reasons)
    )


class _ChebyshevFits(NamedTuple):
    """Chebyshev series, shape (terms, n), around centers; `numbers` are those of the elements for `height`."""

    numbers: NDArray[np.intp]
    center: Array
    half: Array
    series: NDArray[Any]
    height: Callable[[Array, NDArray[Any], NDArray[np.intp]], Array]

    def log_height(self, s: Array, j: NDArray[np.intp], more: Any = 0.0) -> Array:
        """The logarithm of the heights of elements j at s, or with so much added to the smooth functions."""
        smooth = chebyshev.chebval(s, self.series[:, j], tensor=False) + more
        x = self.center[j] + self.half[j] * s
        return np.asarray(np.log(self.height(x, smooth, self.numbers[j])))

    def tops(self) -> Array:
        """Where heights are largest, s between the lowest one above 0 and PEAK_REACH."""
        which = np.arange(len(self.center))
        lowest = np.maximum(-PEAK_REACH, (LOWEST_SHARE - 1.0) * self.center / self.half)
        grid = lowest + (PEAK_REACH - lowest) * np.linspace(0.0, 1.0, TOP_GRID)[:, None]
        at = self.log_height(grid, which).argmax(0)
        tops = grid[at, which]
        inner = which[(at > 0) & (at < TOP_GRID - 1)]
        if len(inner):
            low, middle, high = (grid[at[inner] + d, inner] for d in (-1, 0, 1))

            def depth(s: Array, *numbers: Any) -> Array:
                return -self.log_height(s, numbers[0].astype(np.intp))

            tops[inner] = find_minimum(
                depth,
                (low, middle, high),
                args=(inner.astype(float),),
                tolerances={"xatol": PEAK_TOLERANCE, "xrtol": 0.0},
            ).x
        return np.asarray(tops)

    def places_and_heights(
        self, s: Array, j: NDArray[np.intp], noise: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Places and heights of elements j whose tops are at s, and their errors."""
        missed = bound_next_coefficients(self.series[:, j])
        changes = [
            (self.log_height(s, j, part) - self.log_height(s, j, -part)) / 2.0
            for part in (missed, 1j * missed)
        ]
        share = np.hypot(*changes)
        slope = PEAK_NODES * share / np.sqrt(1.0 - s**2) + NOISE_OF_SLOPE * noise
        left, top, right = (self.log_height(s + d * CURVATURE_STEP, j) for d in (-1, 0, 1))
        bend = np.abs(left - 2.0 * top + right) / CURVATURE_STEP**2
        curvature = np.maximum(bend, HEIGHT_ROUNDING)
        flat = np.sqrt(2.0 * HEIGHT_ROUNDING / curvature)
        place_error = self.half[j] * (slope / curvature + flat)
        height_error = np.exp(top) * (share + NOISE_OF_VALUE * noise)
        return self.center[j] + self.half[j] * s, np.exp(top), place_error, height_error


def bound_next_coefficients(coefficients: NDArray[Any]) -> Array:
    """Bound the size of the first coefficients that Chebyshev series of smooth functions leave out.

    Those of an analytic function are below 2 M / rho^k (Trefethen, Approximation Theory and Approximation
    Practice, 2013, theorem 8.1). The slowest fall between two known ones gives rho, at least 1. The last two each
    give the coefficient that they fall to; the larger one counts, since one may be small by chance.

    Parameters
    ----------
    coefficients : ndarray, shape (terms, n)
        Those of T_0, T_1, ...; the first, which is the mean, says nothing of the fall.
    """
    sizes = np.abs(coefficients[1:])
    with np.errstate(all="ignore"):
        fall = np.minimum(1.0, (sizes[1:] / sizes[:-1]).max(0))
        bound = np.maximum(sizes[-2] * fall**2, sizes[-1] * fall)
    return np.asarray(np.where(sizes.all(0), bound, sizes.max(0)))


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

    def root(low: float, high: float) -> float:
        xtol = 1e-12 * max(abs(low), abs(high))
        return float(brentq(lambda x: float(function(x)), low, high, xtol=xtol))

    return [root(*grid[k : k + 2].tolist()) for k in changes.tolist()]
