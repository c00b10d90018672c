r"""Ball that falls on the ground and bounces

$$ \ddot h = -g, \qquad v^+ = -e\,v^- \text{ at } h = 0 $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record, replace
from fmukit.si import Acceleration, Length, Ratio, Velocity

EXPERIMENT = Experiment(stop=1.2, step=0.01)


@record
class Parameters:
    g: Acceleration = real(9.81, "Gravity", positive=True)
    e: Ratio = real(0.7, "Coefficient of restitution", min=0.0, max=1.0)


@record
class State:
    h: Length = real(1.0, "Height of the ball")
    v: Velocity = real(0.0, "Velocity of the ball, upwards")


def derivatives(p: Parameters, t: float, x: State, u: tuple[()]) -> State:
    return State(h=x.v, v=-p.g)


def event_indicators(p: Parameters, t: float, x: State, u: tuple[()]) -> tuple[float]:
    return (x.h if x.v < 0.0 else 1.0,)


def event_update(p: Parameters, t: float, x: State, u: tuple[()], which: int) -> State:
    return replace(x, h=0.0, v=-p.e * x.v)
