"""Carry a component over one communication step: its own exact update, or the integrator.

A hybrid component adds to its equations

    guard(p, t, x, u) -> tuple       each positive; an event is where one falls below zero
    jump(p, t, x, u, which) -> State the state just after guard number `which` fell
    sample(p, t, x, before, now)     the state just after a communication point that brings new
                                     inputs (before = None when initialisation ends)
    settle(p, x)                     the state x with all that follows from the rest of it; at the
                                     start and at the end of every communication step
    notes(p, t, old, new, u)         sentences for the log on the change from old to new
    LONGEST_STEP                     sub-step [s] within which no guard falls and rises again

of which any may be missing. Fields of State that are not Real, or are declared `held`, keep their
value between events.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

from . import ode
from .interface import InputHold
from .record import declarations

TOLERANCE = 1e-11
MOST_EVENTS = 1000

Note = Callable[[str], None]


def silent(sentence: str) -> None:
    """Take a sentence and say nothing."""


class Course(NamedTuple):
    """Inputs over a step of h seconds: Reals run on a line from `start` to `end`."""

    start: Any
    end: Any
    h: float

    def at(self, s: float) -> Any:
        """The inputs s seconds after the beginning."""
        if self.start == self.end:
            return self.end
        share = s / self.h
        return self.end._make(
            a + (b - a) * share if type(b) is float else b for a, b in zip(self.start, self.end)
        )


def course(hold: int, before: Any, now: Any, past: float, h: float) -> Course:
    """The inputs over the next h seconds, those set `before` having been set `past` seconds ago.

    Without a past (past = 0) there is no line to follow: extrapolation holds the value.
    """
    if hold == InputHold.interpolate:
        return Course(before, now, h)
    if hold == InputHold.extrapolate and past > 0.0 and before != now:
        return Course(now, Course(before, now, past).at(past + h), h)
    return Course(now, now, h)


def advance(
    model: ModuleType,
    p: Any,
    t: float,
    x: Any,
    inputs: Course,
    note: Note = silent,
) -> Any:
    """The state at the end of a step that begins at t with state x.

    A component with a closed solution gives it in `exact(p, x, u0, u1, h)`, None where it has none.
    `note` takes what a hybrid component has to say about its events.
    """
    if hasattr(model, "exact"):
        end = model.exact(p, x, inputs.start, inputs.end, inputs.h)
        if end is not None:
            return end
    if hasattr(model, "guard"):
        for s, old, new in events(model, p, t, x, inputs):
            announce(model, p, t + s, old, new, inputs.at(s), note)
        return settle(model, p, new)
    places, _ = continuous(model.State)
    flow = slopes(model, p, t, x, inputs)
    return state(x, places, ode.integrate(flow, pick(x, places), inputs.h, tolerances(model.State)))


def sample(
    model: ModuleType,
    p: Any,
    t: float,
    x: Any,
    before: Any,
    now: Any,
    note: Note = silent,
) -> Any:
    """The state just after the communication point t that brought the inputs `now`."""
    if not hasattr(model, "sample"):
        return x
    new = model.sample(p, t, x, before, now)
    announce(model, p, t, x, new, now, note)
    return new


def settle(model: ModuleType, p: Any, x: Any) -> Any:
    """The state x with what the component makes of it from its own other fields."""
    return model.settle(p, x) if hasattr(model, "settle") else x


def announce(model: ModuleType, p: Any, t: float, old: Any, new: Any, u: Any, note: Note) -> None:
    """Hand on what the component says about a change of state."""
    if hasattr(model, "notes"):
        for sentence in model.notes(p, t, old, new, u):
            note(sentence)


def events(
    model: ModuleType, p: Any, t: float, x: Any, inputs: Course
) -> Iterator[tuple[float, Any, Any]]:
    """The events of a step: time since its beginning, state before and after; last the step's end.

    Raises ArithmeticError for a system that chatters.
    """
    places, _ = continuous(model.State)
    tolerance, longest = tolerances(model.State), getattr(model, "LONGEST_STEP", math.inf)
    s = 0.0
    for _ in range(MOST_EVENTS):
        which = fallen(model, p, t, s, x, inputs)
        if which is None:
            flow = slopes(model, p, t, x, inputs)
            for step in ode.walk(flow, s, pick(x, places), inputs.h, tolerance, longest):
                after = state(x, places, step.end)
                if fallen(model, p, t, step.s + step.h, after, inputs) is not None:
                    s, x = locate(model, p, t, x, step, inputs)
                    which = fallen(model, p, t, s, x, inputs)
                    break
            else:
                yield inputs.h, after, after
                return
        new = model.jump(p, t + s, x, inputs.at(s), which)
        yield s, x, new
        x = new
    raise ArithmeticError(f"more than {MOST_EVENTS} events, the last at {t + s!r} s")


def fallen(model: ModuleType, p: Any, t: float, s: float, x: Any, inputs: Course) -> int | None:
    """The first guard that is below zero."""
    for which, value in enumerate(model.guard(p, t + s, x, inputs.at(s))):
        if value < 0.0:
            return which
    return None


def locate(
    model: ModuleType, p: Any, t: float, x: Any, step: ode.SubStep, inputs: Course
) -> tuple[float, Any]:
    """The first instant at which a guard is below zero, to the last bit of the time."""
    places, _ = continuous(model.State)
    tolerance, flow = tolerances(model.State), slopes(model, p, t, x, inputs)

    def there(h: float) -> Any:
        return state(x, places, ode.attempt(flow, step.s, step.x, step.slope, h, tolerance)[0])

    before, after, end = 0.0, step.h, state(x, places, step.end)
    while True:
        middle = (before + after) / 2
        if middle in (before, after) or step.s + before == step.s + after:
            return step.s + after, end
        candidate = there(middle)
        if fallen(model, p, t, step.s + middle, candidate, inputs) is None:
            before = middle
        else:
            after, end = middle, candidate


def slopes(model: ModuleType, p: Any, t: float, x: Any, inputs: Course) -> ode.RightHandSide:
    """The right-hand side of the continuous states, the others as they are in x."""
    places, whole = continuous(model.State)
    derivatives, make, held = model.derivatives, model.State._make, inputs.start == inputs.end
    u = inputs.end
    if whole and held:
        return lambda s, y: derivatives(p, t + s, make(y), u)
    return lambda s, y: pick(derivatives(p, t + s, state(x, places, y), inputs.at(s)), places)


def state(x: Any, places: tuple[int, ...], y: ode.Vector) -> Any:
    """The state x with the continuous ones replaced."""
    values = list(x)
    for place, value in zip(places, y):
        values[place] = value
    return x._make(values)


def pick(x: Any, places: tuple[int, ...]) -> list[float]:
    """The continuous states of x."""
    return [x[place] for place in places]


@cache
def continuous(cls: Any) -> tuple[tuple[int, ...], bool]:
    """Where the continuous states are in a State, and whether they are all of it."""
    fields = [d for _, d in declarations(cls)]
    places = tuple(i for i, d in enumerate(fields) if d.kind == "Real" and not d.held)
    return places, len(places) == len(fields)


@cache
def tolerances(cls: Any) -> list[float]:
    """The error of each continuous state that a sub-step may make: a share of its nominal."""
    fields = [d for _, d in declarations(cls)]
    return [TOLERANCE * (fields[i].nominal or 1.0) for i in continuous(cls)[0]]
