r"""Elastic shaft with damping and backlash, between the ends of two other shafts.

The twist is the angle by which end a is ahead of end b:

$$ \dot\varphi = \omega_a - \omega_b $$

The backlash $b$ is centred at zero twist. Beyond it the flanks are pressed together by $\delta$;
within it there is no torque:

$$ \delta = |\varphi| - \tfrac12 b, \qquad
   T = 0 \quad (\delta \le 0), \qquad
   T = \operatorname{sgn}(\varphi)\,c\,\delta + \tau_d \quad (\delta > 0) $$

The damping acts only in contact. It is limited to the torque of the spring, so that the flanks
never pull on each other and $T$ is continuous where they meet and part:

$$ \tau_d = \min\left(\max(d\,\dot\varphi, -c\,\delta), c\,\delta\right) $$

A shaft without backlash ($b = 0$) has no flanks that could part:
$T = c\,\varphi + d\,\dot\varphi$. The torques of the shaft on its two ends add up to zero:

$$ \tau_a = -T, \qquad \tau_b = T $$

Assumptions: a massless shaft; one stiffness and one damping for the twist of the shaft and the
compression of the flanks; no friction within the backlash; an impact of the flanks is a contact of
finite stiffness.

The defaults twist the shaft at 1 rad/s from one flank through the backlash to the other.
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
    c: RotationalStiffness = real(1000.0, "Stiffness of the shaft", positive=True)
    d: RotationalDamping = real(5.0, "Damping of the shaft, only in contact", min=0.0, tunable=True)
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
        0.0, "Torque on the part at end a, in the sense of +w_a", feedthrough=("w_a", "w_b")
    )
    tau_b: Torque = real(
        0.0, "Torque on the part at end b, in the sense of +w_b", feedthrough=("w_a", "w_b")
    )
    E_pot: Energy = real(0.0, "Elastic energy")
    P_loss: Power = real(0.0, "Power lost in the damping", feedthrough=("w_a", "w_b"))


def spring_and_damping_torque(p: Parameters, x: State, u: Inputs) -> tuple[float, float]:
    """Torques of spring and damping, positive if they oppose a growing twist."""
    damping = p.d * (u.w_a - u.w_b)
    if p.b == 0.0:
        return p.c * x.twist, damping
    pressed = p.c * max(abs(x.twist) - p.b / 2, 0.0)
    return pressed if x.twist > 0.0 else -pressed, min(max(damping, -pressed), pressed)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(twist=u.w_a - u.w_b)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    spring, damping = spring_and_damping_torque(p, x, u)
    return Outputs(
        tau_a=-(spring + damping),
        tau_b=spring + damping,
        E_pot=spring * spring / (2 * p.c),
        P_loss=damping * (u.w_a - u.w_b),
    )
