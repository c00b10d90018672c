"""Events of hybrid components are found where closed solutions put them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import IntEnum
from types import SimpleNamespace
from typing import Any

import pytest

from fmukit.declare.model import DEFAULTS
from fmukit.declare.record import discrete, real, record, start
from fmukit.runtime import hybrid as motion
from fmukit.si import Length, Velocity


class Stage(IntEnum):
    """A block slides to the edge of a table, falls, and bounces"""

    slide = 0
    fall = 1


@record
class Parameters:
    rebound: Length = real(0.5, "Share of the speed kept at a bounce")


@record
class Inputs:
    push: Length = real(0.0, "Acceleration along the table")
    impulse: bool = discrete(False, "Start from rest")


@record
class State:
    x: Length = real(0.0, "Along the table")
    v: Velocity = real(0.0, "Speed along the table")
    y: Length = real(2.0, "Height")
    w: Velocity = real(0.0, "Vertical speed")
    stage: Stage = discrete(Stage.slide, "Stage")
    left: Length = real(0.0, "When the edge was reached", held=True)
    bounces: int = discrete(0, "Bounces")


def derivatives(p: Any, t: float, x: Any, u: Any) -> Any:
    falling = x.stage == Stage.fall
    return State(x.v, 0.0 if falling else u.push, x.w, -10.0 if falling else 0.0, 0, 0.0, 0)


def event_indicators(p: Any, t: float, x: Any, u: Any) -> tuple[float, ...]:
    return (1.0 - x.x,) if x.stage == Stage.slide else (x.y if x.w < 0.0 else 1.0,)


def event_update(p: Any, t: float, x: Any, u: Any, which: int) -> Any:
    if x.stage == Stage.slide:
        return x._replace(stage=Stage.fall, left=t)
    return x._replace(w=-p.rebound * x.w, bounces=x.bounces + 1)


def sample(p: Any, t: float, x: Any, before: Any, now: Any) -> Any:
    edge = now.impulse and not (before is not None and before.impulse)
    return x._replace(v=x.v + 0.5) if edge else x


def notes(p: Any, t: float, old: Any, new: Any, u: Any) -> Iterator[str]:
    if new.bounces > old.bounces:
        yield f"bounce {new.bounces}"


FUNCTIONS = {
    "derivatives": derivatives,
    "event_indicators": event_indicators,
    "event_update": event_update,
    "sample": sample,
    "notes": notes,
}
MODEL: Any = SimpleNamespace(**DEFAULTS | {"State": State} | FUNCTIONS)


@pytest.mark.parametrize("h", [1e-3, 0.07, 5.0])
def test_events_are_located_whatever_the_step(h: float) -> None:
    p, u, x = start(Parameters), Inputs(0.3, False), start(State)
    sentences: list[str] = []
    steps = math.ceil(4.4 / h - 1e-9)
    for n in range(steps):
        size = min(h, 4.4 - n * h)
        x = motion.advance(MODEL, p, n * h, x, motion.InputTrajectory(u, u, size), sentences.append)
    edge = math.sqrt(2 / 0.3)
    assert x.left == pytest.approx(edge, abs=1e-13)
    ground, fall = edge + math.sqrt(0.4), math.sqrt(0.4)
    bounces = [ground + 2 * fall * (1 - 0.5**k) for k in range(1, 30)]
    done = 1 + sum(time < 4.4 for time in bounces)
    assert (x.bounces, sentences) == (done, [f"bounce {k}" for k in range(1, done + 1)])
    since, speed = 4.4 - ([ground, *bounces][done - 1]), 10 * fall * 0.5**done
    assert x.y == pytest.approx(speed * since - 5 * since**2, abs=1e-11)
    assert x.x == pytest.approx(1.0 + math.sqrt(2 * 0.3) * (4.4 - edge), abs=1e-11)


def test_chatter_is_an_error_and_no_endless_loop() -> None:
    x = start(State)._replace(stage=Stage.fall)
    with pytest.raises(ArithmeticError, match="more than 1000 events"):
        motion.advance(
            MODEL,
            Parameters(0.5),
            0.0,
            x,
            motion.InputTrajectory(Inputs(0.0, False), Inputs(0.0, False), 9.0),
        )


def test_a_rising_edge_is_sampled_once() -> None:
    p, x, error, on = start(Parameters), start(State), Inputs(0.0, False), Inputs(0.0, True)
    for before, now, v in ((None, on, 0.5), (on, on, 0.5), (on, error, 0.5), (error, on, 1.0)):
        x = motion.sample(MODEL, p, 0.0, x, before, now)
        assert x.v == v


def test_only_reals_run_on_the_line_between_inputs() -> None:
    before, now = Inputs(1.0, False), Inputs(3.0, True)
    assert motion.input_trajectory(2, before, now, 0.1, 0.5).at(0.25) == Inputs(2.0, True)
    assert motion.input_trajectory(1, before, now, 0.5, 0.25).end == Inputs(4.0, True)
    assert motion.input_trajectory(1, before, now, 0.0, 0.25).end == now
    assert motion.input_trajectory(0, before, now, 0.5, 0.25).start == now
