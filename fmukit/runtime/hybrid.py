"""Carry a component over one communication step: its own exact update, or the integrator.

A hybrid component has events, and may change at communication points: `declare/model.py` says by which
functions, and which of them may be missing.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import cache
from typing import Any, NamedTuple

from ..declare.interface import InputHold
from ..declare.model import Model
from ..declare.record import declarations
from . import ode
from .flow import repeat

#: Largest error of a sub-step over the nominal value of a state: five digits below the 1e-6 that users ask of a result.
TOLERANCE = 1e-11
#: Limit of the events in a step: more are taken as chattering, which would never end.
MOST_EVENTS = 1000
#: A convention of this kit: highest derivative of an input that an FMU accepts; each one adds a value per input to its state.
HIGHEST_DEGREE = 6

Note = Callable[[str], None]


def ignore_sentence(sentence: str) -> None:
    """Ignore a sentence for the log."""


class InputTrajectory(NamedTuple):
    """Inputs over a step of h seconds: Reals follow a line from `start` to `end`.

    With a degree above 1, s (s - h) (b_0 + b_1 s + ...) is added, with b in `coefficients`.
    """

    start: Any
    end: Any
    h: float
    degree: int = 1
    coefficients: tuple[Any, ...] = ()

    def at(self, s: float) -> Any:
        """The inputs s seconds after the beginning."""
        return inputs_at(self, s)


def inputs_at(inputs: InputTrajectory, s: float) -> Any:
    """The inputs s seconds after the beginning of the step."""
    start, end, h, degree, coefficients = inputs
    if degree == 1 and start == end:
        return end
    fraction, indices = s / h, continuous_indices(end.__class__)
    line = [start[i] + (end[i] - start[i]) * fraction for i in indices]
    if degree == 1:
        return with_continuous(end, indices, line)
    curvature = [0.0] * len(indices)
    for coefficient in reversed(coefficients):
        curvature = [b * s + coefficient[i] for b, i in zip(curvature, indices)]
    return with_continuous(end, indices, [x + s * (s - h) * b for x, b in zip(line, curvature)])


def input_trajectory(hold: int, before: Any, now: Any, past: float, h: float) -> InputTrajectory:
    """The inputs over the next h seconds, where `before` was set `past` seconds ago.

    Without a past (past = 0) there is no line to follow, and extrapolation holds the value.
    """
    if hold == InputHold.interpolate:
        return InputTrajectory(before, now, h)
    if hold == InputHold.extrapolate and past > 0.0 and before != now:
        return InputTrajectory(now, InputTrajectory(before, now, past).at(past + h), h)
    return InputTrajectory(now, now, h)


def step(
    model: Model,
    p: Any,
    t: float,
    x: Any,
    before: Any,
    now: Any,
    inputs: InputTrajectory,
    note: Note = ignore_sentence,
) -> Any:
    """The state at the end of a communication step that begins at t with the inputs `now`."""
    return advance(model, p, t, sample(model, p, t, x, before, now, note), inputs, note)


def advance(
    model: Model,
    p: Any,
    t: float,
    x: Any,
    inputs: InputTrajectory,
    note: Note = ignore_sentence,
) -> Any:
    """The state at the end of a step that begins at t with state x.

    `note` takes the sentences of a hybrid component about its events.
    """
    if model.exact and inputs.degree == 1:
        end = model.exact(p, x, inputs.start, inputs.end, inputs.h)
        if end is not None:
            return end

    return model.complete_state(p, integrate_through_events(model, p, t, x, inputs, note))


def sample(
    model: Model,
    p: Any,
    t: float,
    x: Any,
    before: Any,
    now: Any,
    note: Note = ignore_sentence,
) -> Any:
    """The state just after the communication point t that brought the inputs `now`."""
    if not model.sample:
        return x
    new = model.sample(p, t, x, before, now)
    note_change(model, p, t, x, new, now, note)
    return new


def note_change(model: Model, p: Any, t: float, old: Any, new: Any, u: Any, note: Note) -> None:
    """Pass the sentences of the component about a change of state to `note`."""
    if note is ignore_sentence:
        return
    for sentence in model.notes(p, t, old, new, u):
        note(sentence)


class Until(Enum):
    """Where an integration ends."""

    FIRST_EVENT = "first event"


class EndOfRun(NamedTuple):
    """Time since the beginning of a step, the indicator of the event there, -1 at the step's end, and the state."""

    s: float
    which: float
    x: Any


def run_to_event(model: Model, p: Any, t: float, x: Any, inputs: InputTrajectory) -> EndOfRun:
    """Run to the first event of a step, before its update, or to the end of the step."""
    if model.exact and inputs.degree == 1:
        end = model.exact(p, x, inputs.start, inputs.end, inputs.h)
        if end is not None:
            return EndOfRun(inputs.h, -1.0, end)
    at = integrate_through_events(model, p, t, x, inputs, ignore_sentence, Until.FIRST_EVENT)
    x = model.complete_state(p, at.x) if at.which < 0 else at.x
    return EndOfRun(at.progress.s, at.which, x)


class HybridState(NamedTuple):
    """Within a step: the index of the event indicator below zero or -1, the state, the integration from it, events so far."""

    which: int
    x: Any
    progress: ode.IntegratorState
    events: int


def integrate_through_events(
    model: Model,
    p: Any,
    t: float,
    x: Any,
    inputs: InputTrajectory,
    note: Note,
    until: Until | None = None,
) -> Any:
    """The state at the end of a step, through its events.

    With Until.FIRST_EVENT it is the HybridState at the first event, or of the end. Raises ArithmeticError for
    a system that chatters, and what `ode.substep` raises.
    """
    indices, tolerance = continuous_indices(model.State), substep_tolerances(model.State)
    h, longest = inputs.h, model.LONGEST_STEP
    constants = (model.step_constants(p, x),) if model.step_constants else ()

    def begin(s: float, x: Any) -> ode.IntegratorState:
        y = continuous_values(x, indices)
        return ode.IntegratorState(
            s, y, slope(model, p, t, x, inputs, s, y), smaller(h - s, longest), 0
        )

    def body(at: HybridState) -> tuple[bool, HybridState]:
        which, x, progress, events = at
        if model.event_update and which >= 0:
            if until is Until.FIRST_EVENT:
                return True, at
            if events >= MOST_EVENTS:
                raise ArithmeticError(
                    f"more than {MOST_EVENTS} events, the last at {t + progress.s!r} s"
                )
            new = model.event_update(p, t + progress.s, x, inputs.at(progress.s), which)
            note_change(model, p, t + progress.s, x, new, inputs.at(progress.s), note)
            which = first_negative_indicator(model, p, t, progress.s, new, inputs)
            progress = begin(progress.s, new) if which < 0 else progress
            return which < 0 and progress.s >= h, HybridState(which, new, progress, events + 1)

        def flow(s: float, y: ode.Vector) -> ode.Vector:
            return slope(model, p, t, x, inputs, s, y, constants)

        succeeded, size, further = ode.substep(flow, progress, h, tolerance, longest)
        if not succeeded:
            return False, HybridState(-1, x, further, events)
        after = with_continuous(x, indices, further.x)
        if first_negative_indicator(model, p, t, further.s, after, inputs) < 0:
            return further.s >= h, HybridState(-1, after, further, events)
        s, x = locate_event(model, p, t, x, inputs, progress, size, after, constants)
        return False, HybridState(
            first_negative_indicator(model, p, t, s, x, inputs), x, further._replace(s=s), events
        )

    which = first_negative_indicator(model, p, t, 0.0, x, inputs)
    end = repeat(body, HybridState(which, x, begin(0.0, x), 0))
    return end if until is Until.FIRST_EVENT else end.x


def smaller(a: float, b: float) -> float:
    return min(a, b)


def first_negative_indicator(
    model: Model, p: Any, t: float, s: float, x: Any, inputs: InputTrajectory
) -> int:
    """The index of the first negative event indicator, -1 if none is negative."""
    if model.event_indicators:
        for which, value in enumerate(model.event_indicators(p, t + s, x, inputs.at(s))):
            if value < 0.0:
                return which
    return -1


def locate_event(
    model: Model,
    p: Any,
    t: float,
    x: Any,
    inputs: InputTrajectory,
    progress: ode.IntegratorState,
    size: float,
    end: Any,
    constants: tuple[Any, ...],
) -> tuple[float, Any]:
    """Bisect for the first instant with a negative event indicator, to the last bit of the time."""
    indices, tolerance = continuous_indices(model.State), substep_tolerances(model.State)

    def flow(s: float, y: ode.Vector) -> ode.Vector:
        return slope(model, p, t, x, inputs, s, y, constants)

    def body(at: tuple[float, float, Any]) -> tuple[bool, tuple[float, float, Any]]:
        before, after, end = at
        middle = (before + after) / 2
        if middle in (before, after) or progress.s + before == progress.s + after:
            return True, at
        y, _, _ = ode.attempt(flow, progress.s, progress.x, progress.slope, middle, tolerance)
        candidate = with_continuous(x, indices, y)
        if first_negative_indicator(model, p, t, progress.s + middle, candidate, inputs) < 0:
            return False, (middle, after, end)
        return False, (before, middle, candidate)

    _, after, end = repeat(body, (0.0, size, end))
    return progress.s + after, end


def slope(
    model: Model,
    p: Any,
    t: float,
    x: Any,
    inputs: InputTrajectory,
    s: float,
    y: ode.Vector,
    constants: tuple[Any, ...] = (),
) -> ode.Vector:
    """The right-hand side for the continuous states y, with the others taken from x."""
    indices = continuous_indices(model.State)
    return continuous_values(
        model.derivatives(p, t + s, with_continuous(x, indices, y), inputs.at(s), *constants),
        indices,
    )


def with_continuous(x: Any, indices: tuple[int, ...], y: ode.Vector) -> Any:
    """The state x with the continuous ones replaced."""
    if len(indices) == len(x):
        return x._make(y)
    values = list(x)
    for index, value in zip(indices, y):
        values[index] = value
    return x._make(values)


def continuous_values(x: Any, indices: tuple[int, ...]) -> ode.Vector:
    """The continuous states of x."""
    return [x[index] for index in indices]


@cache
def continuous_indices(cls: Any) -> tuple[int, ...]:
    """The indices of the Reals of a record that change between events."""
    fields = enumerate(d for _, d in declarations(cls))
    return tuple(i for i, d in fields if d.fmi_type == "Real" and not d.held)


@cache
def substep_tolerances(cls: Any) -> list[float]:
    """The error of each continuous state that a sub-step may make: a share of its nominal."""
    fields = [d for _, d in declarations(cls)]
    return [TOLERANCE * (fields[i].nominal or 1.0) for i in continuous_indices(cls)]
