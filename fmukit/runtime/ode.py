"""Integrate x' = f(s, x) over one communication step with the pair of Dormand and Prince, 5(4).

Every call starts from the whole interval and refines it only as far as the error requires. Nothing but
x is kept between calls, so that a repeated step repeats every bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from math import inf
from operator import add
from typing import NamedTuple

from .flow import attempted

Vector = Sequence[float]
RightHandSide = Callable[[float, Vector], Vector]

STAGES = (
    (1 / 5, (1 / 5,)),
    (3 / 10, (3 / 40, 9 / 40)),
    (4 / 5, (44 / 45, -56 / 15, 32 / 9)),
    (8 / 9, (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729)),
    (1.0, (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656)),
    (1.0, (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)),
)
DEFECT = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
#: Convention of step-size control (Hairer, Norsett, Wanner, Solving ODEs I, II.4): factor that keeps the next step from failing.
SAFETY = 0.9
#: Convention (same source): least factor between successive steps.
SHRINK = 0.2
#: Convention (same source): largest factor between successive steps.
GROW = 5.0
#: Smallest sub-step over the rest of the step: below it, rounding of the time (2.2e-16) would reach 1e-7 of a sub-step.
SMALLEST_FRACTION = 1e-9
#: Limit of the sub-steps in a step, so that a stiff component fails with a message instead of hanging.
MOST_SUBSTEPS = 1_000_000


class IntegratorState(NamedTuple):
    """An integration under way: time s, state x and its slope, size of the next sub-step, sub-steps tried."""

    s: float
    x: Vector
    slope: Vector
    size: float
    tried: int


class Substep(NamedTuple):
    """Whether a sub-step succeeded, the size that was tried, and the integration to go on from."""

    succeeded: bool
    size: float
    further: IntegratorState


def substep(
    f: RightHandSide, at: IntegratorState, stop: float, tolerance: Vector, longest: float = inf
) -> Substep:
    """Try one sub-step towards `stop` whose error over the tolerance has a norm below 1.

    Raises ArithmeticError if no sub-step is small enough compared with the rest of the step, or after MOST_SUBSTEPS.
    """
    if at.tried >= MOST_SUBSTEPS:
        raise ArithmeticError(f"more than {MOST_SUBSTEPS} sub-steps up to {at.s!r} s of the step")
    h, end = clip_to_stop(at.s, at.size, stop)
    x, slope, error = attempted(
        lambda: attempt(f, at.s, at.x, at.slope, h, tolerance), (at.x, at.slope, inf)
    )
    tried = at.tried + 1
    if error <= 1.0 and end >= stop:
        return Substep(True, h, IntegratorState(end, x, slope, h, tried))
    size = next_size(h, error, longest)
    if error <= 1.0:
        return Substep(True, h, IntegratorState(end, x, slope, size, tried))
    if not h > SMALLEST_FRACTION * (stop - at.s):
        raise ArithmeticError(f"no sub-step is small enough at {at.s!r} s of the step")
    return Substep(False, h, IntegratorState(at.s, at.x, at.slope, size, tried))


def clip_to_stop(s: float, size: float, stop: float) -> tuple[float, float]:
    """The size of a sub-step that ends at `stop` at the latest, and where it ends."""
    return (stop - s, stop) if s + size >= stop else (size, s + size)


def next_size(h: float, error: float, longest: float) -> float:
    """The size of the next sub-step, after one of size h with this squared error."""
    if not error < inf:
        return min(h * SHRINK, longest)
    change = SAFETY * error**-0.1 if error > 0.0 else GROW
    return min(h * min(GROW, max(SHRINK, change)), longest)


def attempt(
    f: RightHandSide, s: float, x: Vector, k1: Vector, h: float, tolerance: Vector
) -> tuple[Vector, Vector, float]:
    """One step of order 5: the new x, its slope, and the error of order 4 over the tolerance, squared."""
    new, slopes = x, [k1]
    for node, weights in STAGES:
        new = [y + change for y, change in zip(x, weighted(h, weights, slopes))]
        slopes.append(f(s + h * node, new))
    error = 0.0
    for defect, allowed in zip(weighted(h, DEFECT, slopes), tolerance):
        ratio = defect * (1.0 / allowed)
        error += ratio * ratio
    return new, slopes[-1], error


def weighted(h: float, weights: Vector, slopes: Sequence[Vector]) -> Vector:
    """Weighted sum of slopes times h, the latest added last: the others need not wait for it."""
    used = [(h * weight, slope) for weight, slope in zip(weights, slopes) if weight]
    return [
        reduce(add, [factor * slope[index] for factor, slope in used])
        for index in range(len(slopes[0]))
    ]
