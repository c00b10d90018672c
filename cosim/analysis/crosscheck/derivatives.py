"""The check of directional derivatives, against differences of values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

from ...system import declared_start
from ...system.description import Variable
from .dependencies import LONG_STEP_DIVISOR, MOST_INPUTS, SHORT_STEP_DIVISOR
from .subject import CheckFailed, Subject, bounded, nudged, reals, smooth
from .tolerances import AGREEMENT, NO_CHANGE

#: Change of a value while initialising, over its size. Chosen: rounding then adds 1e-12 of the output to a difference.
INITIAL_CHANGE = 1e-4
#: Change of an input after a step, over its size. Chosen: larger, since the FMU integrates.
INPUT_CHANGE = 1e-3


class Slope(NamedTuple):
    """A directional derivative: when, of what, by what; the FMU's value, and the one by differences.

    `low` and `high` are the slopes on either side, which differ at a kink, and `error` is how uncertain
    these are.
    """

    when: str
    unknown: Variable
    driver: Variable
    stated: float
    low: float
    high: float
    error: float


def derivatives(s: Subject) -> str:
    """Directional derivatives: while initialising by inputs and initial states, after a step by inputs."""
    s.needs("providesDirectionalDerivative")
    pairs = kinks = 0
    for slope in chain(s.in_process(lambda: list(_initial_slopes(s))), _later_slopes(s)):
        x, v = slope.unknown, slope.driver
        middle = (slope.low + slope.high) / 2.0
        resolution = NO_CHANGE * s.ranges.get(x.name, s.size(x)) / s.size(v)
        allowed = AGREEMENT * abs(middle) + 2.0 * slope.error + resolution
        kink = slope.high - slope.low > 2.0 * allowed
        error = max(slope.low - slope.stated, slope.stated - slope.high) if kink else (
            abs(slope.stated - middle)
        )  # fmt: skip
        if not error <= allowed:
            sides = f"{slope.low:.6g} and {slope.high:.6g}, on two sides of a kink"
            raise CheckFailed(
                f"the derivative of {x.name} by {v.name} {slope.when} is {slope.stated:.6g}; "
                f"differences give {sides if kink else f'{middle:.6g}'}"
            )
        pairs, kinks = pairs + 1, kinks + kink
    return f"{pairs} derivatives" + (f", {kinks} of them at a kink" if kinks else "")


def _initial_slopes(s: Subject) -> Iterator[Slope]:
    drivers = [v for v in s.description.modelVariables if s.is_settable(v) and smooth(v)]
    drivers = [v for v in drivers if v.causality != "parameter" and nudged(v) is not None]
    real = [u.variable for u in s.description.initialUnknowns if smooth(u.variable)]
    real = [v for v in real if v.name not in s.unsteady]
    with s.instance() as part:
        s.enter(part)
        for v in drivers if real else ():
            start = float(declared_start(v) or 0.0)
            stated, middle = part.session.slopes(real, v), reals(part, real)
            middles, sides = [], []
            for step in (INITIAL_CHANGE * s.size(v), 2.0 * INITIAL_CHANGE * s.size(v)):
                above, below = (bounded(v, start + change) for change in (step, -step))
                ends = []
                for value in (above, below):
                    part.set(v, value)
                    ends.append(reals(part, real))
                part.set(v, start)
                middles.append(
                    [(ends[0][x.name] - ends[1][x.name]) / (above - below) for x in real]
                )
                sides.append(_one_sided_slopes(real, middle, ends, (above - start, below - start)))
            for x, value, fine, coarse, slope_pair in zip(real, stated, *middles, sides[0]):
                low, high = sorted(slope_pair)
                yield Slope("while initialising", x, v, value, low, high, abs(fine - coarse))


def _one_sided_slopes(
    real: Sequence[Variable],
    middle: dict[str, float],
    ends: Sequence[dict[str, float]],
    distances: Sequence[float],
) -> list[list[float]]:
    """By variable, the slopes from its value in the middle to those at the ends that are away from it."""
    pairs = [(end, distance) for end, distance in zip(ends, distances) if distance]
    slopes = [[(end[x.name] - middle[x.name]) / distance for end, distance in pairs] for x in real]
    return [pair * 2 if len(pair) == 1 else pair for pair in slopes]


def _later_slopes(s: Subject) -> Iterator[Slope]:
    real = [v for v in s.outputs if v.name in s.ranges]
    for n in (1, s.steps // 2) if s.can.canHandleVariableCommunicationStepSize else ():
        u = s.inputs_at(n)
        for j, v in enumerate(s.inputs[:MOST_INPUTS]):
            fine, coarse = (
                s.slopes(n, u, j, s.h / d, INPUT_CHANGE)
                for d in (SHORT_STEP_DIVISOR, LONG_STEP_DIVISOR)
            )

            def work(n: int = n, u: list[float] = u, v: Variable = v) -> list[float]:
                with s.running(n) as part:
                    s.set_inputs(part, u)
                    part.advance(s.start + n * s.h, s.h / SHORT_STEP_DIVISOR)
                    return part.session.slopes(real, v)

            for x, value in zip(real, s.in_process(work)):
                middle, coarse_middle = sum(fine[x.name]) / 2, sum(coarse[x.name]) / 2
                low, high = sorted(fine[x.name])
                yield Slope(
                    f"after step {n + 1}", x, v, value, low, high, abs(middle - coarse_middle)
                )
