"""Where a row of a map crosses 90 degrees of lag, and where its torque ripple is largest."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
FINE = 20


def curve(x: Real, inverse: Complex) -> CubicSpline[np.complex128]:
    """Load ripple over torque ripple along a row, shape (n,), as a curve between its points.

    Over the speed it is a parabola in first-order theory, so that few points carry it.
    """
    return CubicSpline(x, inverse)


def crossings(x: Real, inverse: Complex) -> list[float]:
    """Where the torque ripple lags the load ripple by 90 degrees."""
    along = curve(x, inverse)
    roots = CubicSpline(x, inverse.real).roots(extrapolate=False)
    return [float(root) for root in roots if complex(along(root)).imag > 0.0]


def peaks(x: Real, ripple: Callable[[float], float]) -> list[float]:
    """Where a ripple has its largest values between the ends of a row, the largest one first."""
    fine = np.interp(np.arange(0, len(x) - 1 + 0.5 / FINE, 1 / FINE), np.arange(len(x)), x)
    heights = np.array([ripple(float(at)) for at in fine])
    tops = 1 + np.flatnonzero((heights[1:-1] > heights[:-2]) & (heights[1:-1] >= heights[2:]))
    found = [
        minimize_scalar(
            lambda at: -ripple(float(at)),
            bounds=(fine[top - 1], fine[top + 1]),
            method="bounded",
            options={"xatol": 1e-9 * abs(fine[top])},
        ).x
        for top in sorted(tops, key=lambda top: -heights[top])
    ]
    return [float(at) for at in found]


def nearest(places: Sequence[float], to: float) -> float | None:
    """The place nearest to another; None if there is none."""
    return min(places, key=lambda place: abs(place - to), default=None)
