r"""Wheel of a quarter car that drives onto a step.

$$ m\,\ddot z = k\,(h - z) - c\,(z - z_c) - d\,(\dot z - \dot z_c) $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import Length, Mass, TranslationalDamping, TranslationalStiffness, Velocity

EXPERIMENT = Experiment(stop=4.0, step=0.01)


@record
class Parameters:
    m: Mass = real(40.0, "Mass of the wheel", positive=True)
    k: TranslationalStiffness = real(150e3, "Stiffness of its tyre", min=0.0)
    h: Length = real(0.1, "Height of the step of the road")
    c: TranslationalStiffness = real(15e3, "Stiffness of the spring of the chassis", min=0.0)
    d: TranslationalDamping = real(1e3, "Damping of the damper of the chassis", min=0.0)


@record
class Inputs:
    z_c: Length = real(0.0, "Height of the chassis")
    v_c: Velocity = real(0.0, "Speed of the chassis, upwards")


@record
class State:
    z: Length = real(0.0, "Height of the wheel", nominal=0.1)
    v: Velocity = real(0.0, "Speed of the wheel, upwards")


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    force = p.c * (u.z_c - x.z) + p.d * (u.v_c - x.v)
    return State(z=x.v, v=(p.k * (p.h - x.z) + force) / p.m)
