r"""Mass on a spring with a switch that closes above its rest position

$$ m\,\ddot x = -k x - d\,\dot x + F + F_c s $$
"""

from __future__ import annotations

from fmukit import Experiment, discrete, real, record
from fmukit.si import Force, Length, Mass, TranslationalDamping, TranslationalStiffness, Velocity

EXPERIMENT = Experiment(stop=1.0, step=0.01)


@record
class Parameters:
    m: Mass = real(1.0, "Mass", positive=True)
    k: TranslationalStiffness = real(100.0, "Stiffness of the spring", positive=True)
    d: TranslationalDamping = real(1.0, "Damping", min=0.0)
    F_c: Force = real(0.0, "Force that the switch s of another mass adds")


@record
class Inputs:
    F: Force = real(0.0, "Force on the mass")
    closed: bool = discrete(False, "The switch of another mass")


@record
class State:
    x: Length = real(0.0, "Position of the mass")
    v: Velocity = real(0.0, "Velocity of the mass")


@record
class Outputs:
    f_coupled: Force = real(0.0, "Force on a coupled mass, proportional to the velocity")
    above: bool = discrete(False, "The mass is above its rest position")


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    force = u.F + (p.F_c if u.closed else 0.0)
    return State(x=x.v, v=(force - p.k * x.x - p.d * x.v) / p.m)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    return Outputs(f_coupled=-0.1 * p.d * x.v, above=x.x > 0.0)
