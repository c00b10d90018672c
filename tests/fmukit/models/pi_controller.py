r"""Speed controller that limits its torque and stops integrating where it does

$$ \tau = \mathrm{limit}(k\,e + x), \qquad \dot x = \frac{k}{T}\,e, \qquad e = w_s - w $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import AngularVelocity, RotationalDamping, Time, Torque

EXPERIMENT = Experiment(stop=2.0, step=0.01)


@record
class Parameters:
    k: RotationalDamping = real(2.0, "Gain", positive=True)
    T: Time = real(0.5, "Time of integration", positive=True)
    limit: Torque = real(30.0, "Limit of the torque either way", positive=True)


@record
class Inputs:
    w_s: AngularVelocity = real(10.0, "Speed wanted")
    w: AngularVelocity = real(5.0, "Speed of the shaft")


@record
class State:
    x: Torque = real(0.0, "Integral part of the torque")


@record
class Outputs:
    tau: Torque = real(0.0, "Torque, in the sense of +w", feedthrough=("w_s", "w"))


def limited(c: float, short: float) -> float:
    return min(max(c, -short), short)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    e = u.w_s - u.w
    wanted = p.k * e + x.x
    return State(x=p.k / p.T * e if limited(wanted, p.limit) == wanted else 0.0)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    return Outputs(tau=limited(p.k * (u.w_s - u.w) + x.x, p.limit))
