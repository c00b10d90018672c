r"""Chassis of a quarter car.

$$ m\,\ddot z = c\,(z_w - z) + d\,(\dot z_w - \dot z) $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import Length, Mass, TranslationalDamping, TranslationalStiffness, Velocity

EXPERIMENT = Experiment(stop=4.0, step=0.01)


@record
class Parameters:
    m: Mass = real(400.0, "Mass of the chassis", positive=True)
    c: TranslationalStiffness = real(15e3, "Stiffness of its spring", min=0.0)
    d: TranslationalDamping = real(1e3, "Damping of its damper", min=0.0)


@record
class Inputs:
    z_w: Length = real(0.0, "Height of the wheel")
    v_w: Velocity = real(0.0, "Speed of the wheel, upwards")


@record
class State:
    z: Length = real(0.0, "Height of the chassis", nominal=0.1)
    v: Velocity = real(0.0, "Speed of the chassis, upwards")


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(z=x.v, v=(p.c * (u.z_w - x.z) + p.d * (u.v_w - x.v)) / p.m)
