"""Integrate x' = f(s, x) over one communication step with the pair of Dormand and Prince, 5(4).

Every call starts from the whole interval and refines it only as far as the error asks, so that
nothing but x is remembered between calls and a repeated step repeats every bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

Vector = Sequence[float]
RightHandSide = Callable[[float, Vector], Vector]

SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0
MOST_SUBSTEPS = 1_000_000


class SubStep(NamedTuple):
    """An accepted sub-step: from x with this slope at s, over h seconds, to `end`."""

    s: float
    x: Vector
    slope: Vector
    h: float
    end: Vector


def integrate(f: RightHandSide, x: Vector, h: float, tolerance: Vector) -> Vector:
    """Carry x from s = 0 to s = h; raises what `walk` raises."""
    for step in walk(f, 0.0, x, h, tolerance):
        x = step.end
    return x


def walk(
    f: RightHandSide, s: float, x: Vector, stop: float, tolerance: Vector, longest: float = math.inf
) -> Iterator[SubStep]:
    """Carry x from s to `stop` in sub-steps whose error over the tolerance has a norm below 1.

    Raises ArithmeticError if the right-hand side is not finite, if no sub-step is small enough or
    if there are more than MOST_SUBSTEPS.
    """
    size, slope, whole = min(stop - s, longest), f(s, x), stop - s
    for _ in range(MOST_SUBSTEPS):
        if s >= stop:
            return
        last = s + size >= stop
        if last:
            size = stop - s
        try:
            end, end_slope, error = attempt(f, s, x, slope, size, tolerance)
        except (ArithmeticError, ValueError):
            end, end_slope, error = x, slope, math.inf
        if error <= 1.0:
            yield SubStep(s, x, slope, size, end)
            s, x, slope = stop if last else s + size, end, end_slope
        elif not size > 1e-9 * whole:
            raise ArithmeticError(f"no sub-step is small enough at {s!r} s of the step")
        change = SAFETY * error**-0.2 if error > 0.0 else GROW
        size *= min(GROW, max(SHRINK, change)) if math.isfinite(error) else SHRINK
        size = min(size, longest)
    raise ArithmeticError(f"more than {MOST_SUBSTEPS} sub-steps up to {s!r} s of the step")


def attempt(
    f: RightHandSide, s: float, x: Vector, k1: Vector, h: float, tolerance: Vector
) -> tuple[Vector, Vector, float]:
    """One step of order 5: the new x, its slope, and the error of order 4 over the tolerance."""
    k2 = f(s + h / 5, [y + h * a / 5 for y, a in zip(x, k1)])
    k3 = f(
        s + h * 3 / 10,
        [y + h * (3 / 40 * a + 9 / 40 * b) for y, a, b in zip(x, k1, k2)],
    )
    k4 = f(
        s + h * 4 / 5,
        [y + h * (44 / 45 * a - 56 / 15 * b + 32 / 9 * c) for y, a, b, c in zip(x, k1, k2, k3)],
    )
    k5 = f(
        s + h * 8 / 9,
        [
            y + h * (19372 / 6561 * a - 25360 / 2187 * b + 64448 / 6561 * c - 212 / 729 * d)
            for y, a, b, c, d in zip(x, k1, k2, k3, k4)
        ],
    )
    k6 = f(
        s + h,
        [
            y
            + h
            * (9017 / 3168 * a - 355 / 33 * b + 46732 / 5247 * c + 49 / 176 * d - 5103 / 18656 * e)
            for y, a, b, c, d, e in zip(x, k1, k2, k3, k4, k5)
        ],
    )
    new = [
        y + h * (35 / 384 * a + 500 / 1113 * c + 125 / 192 * d - 2187 / 6784 * e + 11 / 84 * g)
        for y, a, c, d, e, g in zip(x, k1, k3, k4, k5, k6)
    ]
    k7 = f(s + h, new)
    error = 0.0
    for a, c, d, e, g, i, allowed in zip(k1, k3, k4, k5, k6, k7, tolerance):
        defect = h * (
            71 / 57600 * a
            - 71 / 16695 * c
            + 71 / 1920 * d
            - 17253 / 339200 * e
            + 22 / 525 * g
            - i / 40
        )
        share = defect / allowed
        error += share * share
    return new, k7, math.sqrt(error)
