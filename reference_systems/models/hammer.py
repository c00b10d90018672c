r"""Hammer that falls on an anvil and bounces.

$$ m\,\ddot z = f - m\,g, \qquad \dot z^+ = -e\,\dot z^- \text{ at } z = 0 $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record, replace
from fmukit.si import Acceleration, Force, Length, Mass, Ratio, Velocity

EXPERIMENT = Experiment(stop=0.3, step=1e-3)


@record
class Parameters:
    m: Mass = real(2.0, "Mass of the hammer", positive=True)
    g: Acceleration = real(9.81, "Gravity", min=0.0)
    e: Ratio = real(0.7, "Coefficient of restitution", min=0.0, max=1.0)


@record
class Inputs:
    f: Force = real(0.0, "Force of the spring on the hammer, upwards")


@record
class State:
    z: Length = real(0.05, "Height of the hammer above the anvil", nominal=0.1)
    v: Velocity = real(0.0, "Speed of the hammer, upwards")


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(z=x.v, v=u.f / p.m - p.g)


def event_indicators(p: Parameters, t: float, x: State, u: Inputs) -> tuple[float]:
    """Below zero where the hammer has met the anvil."""
    return (x.z if x.v < 0.0 else 1.0,)


def event_update(p: Parameters, t: float, x: State, u: Inputs, which: int) -> State:
    return replace(x, z=0.0, v=-p.e * x.v)
