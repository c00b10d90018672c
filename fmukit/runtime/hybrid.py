"""Carry a component over one communication step: its own exact update, or the integrator.

A component whose equations repeat costly work may do it once::

    prepare(p, x) -> Any             a fifth argument for `derivatives` throughout a step that begins
                                     with the state x

A hybrid component adds to its equations::

    guard(p, t, x, u) -> tuple       positive values; an event occurs where one falls below zero
    jump(p, t, x, u, which) -> State the state just after guard number `which` fell
    sample(p, t, x, before, now)     the state just after a communication point that brings new
                                     inputs (before = None when initialisation ends)
    settle(p, x)                     the state x with everything that follows from the rest of it; at
                                     the start and at the end of every communication step. What
                                     cannot be chosen at the start is declared with `follows=True`
    notes(p, t, old, new, u)         sentences for the log on the change from old to new
    LONGEST_STEP                     sub-step [s] within which no guard falls and rises again

Any of these may be missing. Fields of State that are not Real, or are declared `held`, keep their
value between events.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import inf
from types import ModuleType
from typing import Any, NamedTuple

from ..declare.interface import InputHold
from ..declare.record import declarations
from . import ode
from .flow import repeat

TOLERANCE = 1e-11
MOST_EVENTS = 1000
HIGHEST_DEGREE = 6

Note = Callable[[str], None]


def silent(sentence: str) -> None:
    """Take a sentence and ignore it."""


class Course(NamedTuple):
    """Inputs over a step of h seconds: Reals follow a line from `start` to `end`.

    With a degree above 1, s (s - h) (b_0 + b_1 s + ...) is added, with b in `bends`.
    """

    start: Any
    end: Any
    h: float
    degree: int = 1
    bends: tuple[Any, ...] = ()

    def at(self, s: float) -> Any:
        """The inputs s seconds after the beginning."""
        return along(self, s)


def along(inputs: Course, s: float) -> Any:
    """The inputs s seconds after the beginning of their course."""
    start, end, h, degree, bends = inputs
    if degree == 1 and start == end:
        return end
    share, places = s / h, continuous(end.__class__)
    line = [start[i] + (end[i] - start[i]) * share for i in places]
    if degree == 1:
        return state(end, places, line)
    bent = [0.0] * len(places)
    for bend in reversed(bends):
        bent = [b * s + bend[i] for b, i in zip(bent, places)]
    return state(end, places, [x + s * (s - h) * b for x, b in zip(line, bent)])


def course(hold: int, before: Any, now: Any, past: float, h: float) -> Course:
    """The inputs over the next h seconds, those set `before` having been set `past` seconds ago.

    Without a past (past = 0) there is no line to follow, and extrapolation holds the value.
    """
    if hold == InputHold.interpolate:
        return Course(before, now, h)
    if hold == InputHold.extrapolate and past > 0.0 and before != now:
        return Course(now, Course(before, now, past).at(past + h), h)
    return Course(now, now, h)


def step(
    model: ModuleType,
    p: Any,
    t: float,
    x: Any,
    before: Any,
    now: Any,
    inputs: Course,
    note: Note = silent,
) -> Any:
    """The state at the end of a communication step that begins at t with the inputs `now`."""
    return advance(model, p, t, sample(model, p, t, x, before, now, note), inputs, note)


def advance(
    model: ModuleType,
    p: Any,
    t: float,
    x: Any,
    inputs: Course,
    note: Note = silent,
) -> Any:
    """The state at the end of a step that begins at t with state x.

    A component with a closed solution for inputs on a line gives it in `exact(p, x, u0, u1, h)`,
    None where it has none.
    `note` takes the sentences of a hybrid component about its events.
    """
    if hasattr(model, "exact") and inputs.degree == 1:
        end = model.exact(p, x, inputs.start, inputs.end, inputs.h)
        if end is not None:
            return end

    return settle(model, p, travel(model, p, t, x, inputs, note))


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
) -> list[tuple[float, Any, Any]]:
    """The events of a step: time since its beginning, state before and after; last the step's end.

    Raises what `travel` raises.
    """
    seen: list[tuple[float, Any, Any]] = []
    end = travel(model, p, t, x, inputs, silent, lambda *event: seen.append(event))
    return [*seen, (inputs.h, end, end)]


def stop(s: float, before: Any, after: Any) -> None:
    """What `travel` takes to end at the first event."""


def reach(model: ModuleType, p: Any, t: float, x: Any, inputs: Course) -> tuple[float, float, Any]:
    """To the first event of a step, or its end: time since the beginning, guard or -1, state."""
    if hasattr(model, "exact") and inputs.degree == 1:
        end = model.exact(p, x, inputs.start, inputs.end, inputs.h)
        if end is not None:
            return inputs.h, -1.0, end
    at = travel(model, p, t, x, inputs, silent, stop)
    return at.walk.s, at.which, settle(model, p, at.x) if at.which < 0 else at.x


class Stage(NamedTuple):
    """On the way: the guard that has fallen or -1, the state, the walk from it, events so far."""

    which: int
    x: Any
    walk: ode.Walk
    events: int


def travel(
    model: ModuleType,
    p: Any,
    t: float,
    x: Any,
    inputs: Course,
    note: Note,
    happened: Callable[[float, Any, Any], None] | None = None,
) -> Any:
    """The state at the end of a step, through its events, which `happened` may record.

    With `happened` = `stop` it is the Stage of the first event, or of the end. Raises ArithmeticError for
    a system that chatters, and what `ode.substep` raises.
    """
    places, tolerance = continuous(model.State), tolerances(model.State)
    h, longest, hybrid = inputs.h, getattr(model, "LONGEST_STEP", inf), hasattr(model, "guard")
    known = (model.prepare(p, x),) if hasattr(model, "prepare") else ()

    def begin(s: float, x: Any) -> ode.Walk:
        y = pick(x, places)
        return ode.Walk(s, y, slope(model, p, t, x, inputs, s, y), smaller(h - s, longest), 0)

    def body(at: Stage) -> tuple[bool, Stage]:
        which, x, walk, events = at
        if hybrid and which >= 0:
            if happened is stop:
                return True, at
            if events >= MOST_EVENTS:
                raise ArithmeticError(
                    f"more than {MOST_EVENTS} events, the last at {t + walk.s!r} s"
                )
            new = model.jump(p, t + walk.s, x, inputs.at(walk.s), which)
            announce(model, p, t + walk.s, x, new, inputs.at(walk.s), note)
            if happened:
                happened(walk.s, x, new)
            which = fallen(model, p, t, walk.s, new, inputs)
            walk = begin(walk.s, new) if which < 0 else walk
            return which < 0 and walk.s >= h, Stage(which, new, walk, events + 1)

        def flow(s: float, y: ode.Vector) -> ode.Vector:
            return slope(model, p, t, x, inputs, s, y, known)

        good, size, further = ode.substep(flow, walk, h, tolerance, longest)
        if not good:
            return False, Stage(-1, x, further, events)
        after = state(x, places, further.x)
        if fallen(model, p, t, further.s, after, inputs) < 0:
            return further.s >= h, Stage(-1, after, further, events)
        s, x = locate(model, p, t, x, inputs, walk, size, after, known)
        return False, Stage(fallen(model, p, t, s, x, inputs), x, further._replace(s=s), events)

    which = fallen(model, p, t, 0.0, x, inputs)
    end = repeat(body, Stage(which, x, begin(0.0, x), 0))
    return end if happened is stop else end.x


def smaller(a: float, b: float) -> float:
    return min(a, b)


def fallen(model: ModuleType, p: Any, t: float, s: float, x: Any, inputs: Course) -> int:
    """The first guard that is below zero, -1 if none is."""
    if hasattr(model, "guard"):
        for which, value in enumerate(model.guard(p, t + s, x, inputs.at(s))):
            if value < 0.0:
                return which
    return -1


def locate(
    model: ModuleType,
    p: Any,
    t: float,
    x: Any,
    inputs: Course,
    walk: ode.Walk,
    size: float,
    end: Any,
    known: tuple[Any, ...],
) -> tuple[float, Any]:
    """The first instant at which a guard is below zero, to the last bit of the time."""
    places, tolerance = continuous(model.State), tolerances(model.State)

    def flow(s: float, y: ode.Vector) -> ode.Vector:
        return slope(model, p, t, x, inputs, s, y, known)

    def body(at: tuple[float, float, Any]) -> tuple[bool, tuple[float, float, Any]]:
        before, after, end = at
        middle = (before + after) / 2
        if middle in (before, after) or walk.s + before == walk.s + after:
            return True, at
        y, _, _ = ode.attempt(flow, walk.s, walk.x, walk.slope, middle, tolerance)
        candidate = state(x, places, y)
        if fallen(model, p, t, walk.s + middle, candidate, inputs) < 0:
            return False, (middle, after, end)
        return False, (before, middle, candidate)

    _, after, end = repeat(body, (0.0, size, end))
    return walk.s + after, end


def slope(
    model: ModuleType,
    p: Any,
    t: float,
    x: Any,
    inputs: Course,
    s: float,
    y: ode.Vector,
    known: tuple[Any, ...] = (),
) -> ode.Vector:
    """The right-hand side of the continuous states y, the others as they are in x."""
    places = continuous(model.State)
    return pick(model.derivatives(p, t + s, state(x, places, y), inputs.at(s), *known), places)


def state(x: Any, places: tuple[int, ...], y: ode.Vector) -> Any:
    """The state x with the continuous ones replaced."""
    if len(places) == len(x):
        return x._make(y)
    values = list(x)
    for place, value in zip(places, y):
        values[place] = value
    return x._make(values)


def pick(x: Any, places: tuple[int, ...]) -> ode.Vector:
    """The continuous states of x."""
    return [x[place] for place in places]


@cache
def continuous(cls: Any) -> tuple[int, ...]:
    """Where the Reals of a record are that change between events."""
    fields = enumerate(d for _, d in declarations(cls))
    return tuple(i for i, d in fields if d.kind == "Real" and not d.held)


@cache
def tolerances(cls: Any) -> list[float]:
    """The error of each continuous state that a sub-step may make: a share of its nominal."""
    fields = [d for _, d in declarations(cls)]
    return [TOLERANCE * (fields[i].nominal or 1.0) for i in continuous(cls)]
