r"""Elastic shaft with damping and backlash, between the ends of two other shafts.

The twist is the angle by which end a is ahead of end b:

$$ \dot\varphi = \omega_a - \omega_b $$

The play $b$ lies half on either side of the middle. Beyond it the flanks are pressed together by
$\delta$, and in the play there is no torque:

$$ \delta = |\varphi| - \tfrac12 b, \qquad
   T = 0 \quad (\delta \le 0), \qquad
   T = \operatorname{sgn}(\varphi)\,c\,\delta + \tau_d \quad (\delta > 0) $$

The damping acts in contact alone. It is limited to the torque of the spring, so that flanks never
pull at each other, and that $T$ is continuous where they meet and part:

$$ \tau_d = \min\left(\max(d\,\dot\varphi, -c\,\delta), c\,\delta\right) $$

A shaft without play ($b = 0$) has no flanks that could part: there $T = c\,\varphi + d\,\dot\varphi$.
What the shaft exerts on the two ends adds up to nothing:

$$ \tau_a = -T, \qquad \tau_b = T $$

Assumptions: a shaft without mass; flanks that are pressed together as the shaft is twisted, with
one stiffness and one damping; no friction in the play; an impact of the flanks is a contact of
finite stiffness.

The defaults twist the shaft at 1 rad/s from one flank through the play onto the other.
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import (
    Angle,
    AngularVelocity,
    Energy,
    Power,
    RotationalDamping,
    RotationalStiffness,
    Torque,
)

EXPERIMENT = Experiment(stop=0.1, step=1e-3)
FLANGES = {"flange_a": ("tau_a", "w_a"), "flange_b": ("tau_b", "w_b")}


@record
class Parameters:
    c: RotationalStiffness = real(1000.0, "Stiffness", positive=True)
    d: RotationalDamping = real(5.0, "Damping, in contact alone", min=0.0)
    b: Angle = real(0.02, "Backlash, from flank to flank", min=0.0)


@record
class Inputs:
    w_a: AngularVelocity = real(1.0, "Speed of end a")
    w_b: AngularVelocity = real(0.0, "Speed of end b")


@record
class State:
    twist: Angle = real(-0.03, "Angle by which end a is ahead of end b", nominal=0.01)


@record
class Outputs:
    tau_a: Torque = real(
        0.0, "Torque on what end a is fixed to, in the sense of +w_a", feedthrough=("w_a", "w_b")
    )
    tau_b: Torque = real(
        0.0, "Torque on what end b is fixed to, in the sense of +w_b", feedthrough=("w_a", "w_b")
    )
    E_pot: Energy = real(0.0, "Elastic energy")
    P_loss: Power = real(0.0, "Power lost in the damping", feedthrough=("w_a", "w_b"))


def torques(p: Parameters, x: State, u: Inputs) -> tuple[float, float]:
    """The torque of the spring and that of the damping, both positive against a growing twist."""
    damping = p.d * (u.w_a - u.w_b)
    if p.b == 0.0:
        return p.c * x.twist, damping
    pressed = p.c * max(abs(x.twist) - p.b / 2, 0.0)
    return pressed if x.twist > 0.0 else -pressed, min(max(damping, -pressed), pressed)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(twist=u.w_a - u.w_b)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    spring, damping = torques(p, x, u)
    return Outputs(
        tau_a=-(spring + damping),
        tau_b=spring + damping,
        E_pot=spring * spring / (2 * p.c),
        P_loss=damping * (u.w_a - u.w_b),
    )
