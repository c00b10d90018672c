"""Checks of steps and times: their sizes, steps that are discarded, start and stop times."""

from __future__ import annotations

import math
from typing import NamedTuple

from ...errors import FmuError, SimulationTerminated, StepDiscarded
from ...fmu.messages import DISCARD, STATUS, WARNING
from .subject import CheckFailed, NotOffered, Subject, differ, reals, smooth
from .tolerances import AGREEMENT, NO_CHANGE

#: Multiples of the step that are tried one after the other until a difference shows. Chosen: an order of 4 makes it
#: 4096 times larger from each to the next.
STEP_MULTIPLES = (1, 8, 64)
#: Two steps of half the size may differ from one step by this share of the change. Chosen: order 1 with a step of the
#: time constant differs by less.
LARGEST_DIFFERENCE = 0.3
#: The difference of two half steps must be below this share of that of the twofold step. Derived: order 1 makes it a
#: quarter, no order at all leaves it.
LARGEST_RATIO = 0.5


def step_sizes(s: Subject) -> str:
    """One step of 4 h against two of 2 h, and one of 2 h against two of h; longer ones to see an order."""
    s.needs("canHandleVariableCommunicationStepSize")
    for h in (s.h * multiple for multiple in STEP_MULTIPLES):
        try:
            differences, changes = step_halving(s, h)
        except FmuError:
            if h == s.h:
                raise
            break
        moving = [name for name in changes if changes[name][1] > NO_CHANGE]
        inconsistent = [
            x
            for x in moving
            if differences[x][1]
            > max(LARGEST_DIFFERENCE * changes[x][1], LARGEST_RATIO * differences[x][0])
        ]
        if h == s.h and inconsistent and 2 * len(inconsistent) >= len(moving):
            raise CheckFailed(
                f"{', '.join(inconsistent)}: one step and two of half the size differ by a third of the change "
                f"or more, for {4 * h:g} s and for {2 * h:g} s"
            )
        coarse, fine = (sum(differences[name][level] for name in moving) for level in (0, 1))
        if fine > NO_CHANGE:
            order = math.log2(coarse / fine) - 1.0
            return f"order {order:.1f}: {coarse:.2g} and {fine:.2g} of the range, {4 * h:g} and {2 * h:g} s"
    return f"no difference above {NO_CHANGE:g} of the range: exact, or smaller internal steps"


class StepHalving(NamedTuple):
    """One step against two of half its length, by Real output: for a step of 4 h, then for one of 2 h.

    Differences, and changes of the output over the one step, are in units of its range and summed over three points.
    """

    differences: dict[str, list[float]]
    changes: dict[str, list[float]]


def step_halving(s: Subject, h: float) -> StepHalving:
    """Compare one step with two of half its length."""
    differences, changes = ({name: [0.0, 0.0] for name in s.ranges} for _ in range(2))
    for n in (1, s.steps // 3, 2 * s.steps // 3):
        u = s.inputs_at(n)
        begin = s.after(n, u, [])
        for level, size in enumerate((4 * h, 2 * h)):
            single, double = s.after(n, u, [size]), s.after(n, u, [size / 2, size / 2])
            for name, span in s.ranges.items():
                differences[name][level] += abs(single[name] - double[name]) / span
                changes[name][level] += abs(single[name] - begin[name]) / span
    return StepHalving(differences, changes)


def discards(s: Subject) -> str:
    """A step over the whole experiment, which the FMU may discard."""
    s.needs("canHandleVariableCommunicationStepSize")
    t, h = s.start, s.stop - s.start
    if s.is_fmi3:
        return untouched(s, t, h)

    def long_step() -> tuple[int, float, bool]:
        with s.running() as part:
            if part.step_status(t, h) != DISCARD:
                raise NotOffered(f"a step of {h:g} s is not discarded")
            return part.last_success()

    answer, reached, ended = s.in_process(long_step)
    discarded = f"a step of {h:g} s is discarded"
    if answer > WARNING:
        raise CheckFailed(f"{discarded}, fmi2LastSuccessfulTime is not reported: {STATUS[answer]}")
    if not t <= reached < t + h:
        raise CheckFailed(
            f"fmi2LastSuccessfulTime is {reached!r} s after a step from {t!r} by {h!r} s"
        )
    if ended:
        return f"{discarded} at {reached:g} s, where the FMU wants to end"

    def short_step() -> None:
        with s.running() as part:
            part.advance(t, reached - t)

    if reached > t:
        s.in_process(short_step)
    return f"{discarded}, one to {reached:g} s is accepted"


def untouched(s: Subject, t: float, h: float) -> str:
    """In FMI 3.0, a discarded step leaves the FMU as it was."""
    step = f"a step of {h:g} s is"
    with s.running() as part:
        try:
            part.advance(t, h)
        except StepDiscarded:
            s.same(s.go(part, 0, s.steps), s.reference, f"after {step} discarded")
            return f"{step} discarded, {s.steps} rows after it bit for bit"
        except SimulationTerminated as reason:
            raise NotOffered(f"{step} not discarded: {reason}") from reason
        raise NotOffered(f"{step} not discarded")


def stop_time(s: Subject) -> str:
    """A defined stop time, far beyond the last step, does not change the rows before it."""
    stop = max(s.stop, s.start + 2 * s.steps * s.h)
    with s.instance() as part:
        part.enter_initialisation(s.tolerance, s.start, stop)
        s.set_inputs(part, s.inputs_at(0))
        part.leave_initialisation()
        rows = s.go(part, 0, s.steps)
    condition = f"with a stop time of {stop:g} s"
    worst = 0.0
    for v, values, expected in zip(s.observed, zip(*rows), zip(*s.reference)):
        if v.name in s.unsteady:
            continue
        real = v.type == "Real"
        span = (max(expected) - min(expected) or max(map(abs, expected)) or 1.0) if real else 0.0
        for k, (x, y) in enumerate(zip(values, expected), 1):
            if not differ(x, y):
                continue
            if not real or not abs(float(x) - float(y)) <= AGREEMENT * span:
                raise CheckFailed(
                    f"{v.name} after step {k} is {x!r} {condition}, {y!r} without one"
                )
            worst = max(worst, abs(float(x) - float(y)) / span)
    agree = f"within {worst:.2g} of the range" if worst else "bit for bit"
    return f"{s.steps} rows {condition} are those without one, {agree}"


def start_time(s: Subject) -> str:
    """The independent variable in a run from another start time."""
    variables = s.description.modelVariables
    clocks = [v for v in variables if v.causality == "independent" and smooth(v)]
    if not clocks:
        raise NotOffered("it has no independent variable, so nothing shows its time")
    first = s.start + max(1, s.steps // 3) * s.h
    with s.instance() as part:
        try:
            part.enter_initialisation(s.tolerance, first, None)
            s.set_inputs(part, s.inputs_at(0))
            part.leave_initialisation()
        except FmuError as reason:
            raise NotOffered(f"it does not start at {first:g} s: {reason}") from reason
        for k in range(3):
            t = first + k * s.h
            for name, value in reals(part, clocks).items():
                if not abs(value - t) <= NO_CHANGE * (abs(t) + s.h):
                    raise CheckFailed(
                        f"{name} is {value!r} after {k} steps of a run from {first!r} s, not {t!r}"
                    )
            s.set_inputs(part, s.inputs_at(k))
            part.advance(t, s.h)
    return f"{clocks[0].name} is right in a run from {first:g} s"
