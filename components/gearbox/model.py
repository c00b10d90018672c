r"""Gearbox between two shafts, with losses that depend on the direction of the power flow.

Shaft b turns $i$ times slower than shaft a. The inertia $J$ of all rotating parts, reduced to shaft
a, determines the speed of both:

$$ \dot\varphi_a = \omega_a, \qquad \omega_b = \frac{\omega_a}{i}, \qquad
   J\,\dot\omega_a = \tau_a + \tau - \mu\,|\tau|\,s, \qquad \tau = \frac{\tau_b}{i} $$

The teeth lose a share of the torque that they transmit to or from shaft b. The share depends on the
side from which the power comes, so that the efficiency is $\eta$ in both directions:

$$ \mu = \frac1\eta - 1 \quad (\text{a drives b, } \tau\,\omega_a < 0), \qquad
   \mu = 1 - \eta \quad (\text{b drives a, } \tau\,\omega_a > 0), \qquad
   s = \min\left(\max\left(\frac{\omega_a}{\omega_0}, -1\right), 1\right) $$

$s$ is the direction of rotation, which fades out below the small speed $\omega_0$. The right-hand
side is thus continuous: a reversal of speed or torque needs no event and cannot chatter, and the
loss $\mu\,|\tau\,\omega_a\,s|$ is never negative.

Assumptions: rigid shafts and teeth, no backlash, no churning losses and no friction without load.
Below $\omega_0$ the friction of the teeth is viscous: a gearbox that should stick, because its
friction alone holds the load, creeps instead, more slowly than $\omega_0$.

The defaults describe a 5:1 stage with a rising load that slows down, stops and drives it back.
"""

from __future__ import annotations

from collections.abc import Iterator

from fmukit import Experiment, real, record
from fmukit.si import (
    Angle,
    AngularAcceleration,
    AngularVelocity,
    Energy,
    Inertia,
    Power,
    Ratio,
    Torque,
)

EXPERIMENT = Experiment(stop=2.0, step=1e-2)
FLANGES = {"flange_a": ("tau_a", "w_a", "phi_a"), "flange_b": ("tau_b", "w_b", "phi_b")}


@record
class Parameters:
    i: Ratio = real(5.0, "Ratio w_a/w_b, negative if the shafts turn in opposite senses")
    eta: Ratio = real(
        0.9,
        "Efficiency, the same in both directions of power flow",
        min=0.01,
        max=1.0,
        tunable=True,
    )
    J: Inertia = real(0.01, "Moment of inertia of all rotating parts, at shaft a", positive=True)
    w_0: AngularVelocity = real(
        0.1, "Speed of shaft a below which the losses fade out", positive=True
    )


@record
class Inputs:
    tau_a: Torque = real(2.0, "Torque on shaft a, in the sense of +phi_a")
    tau_b: Torque = real(-15.0, "Torque on shaft b, in the sense of +phi_b")


@record
class State:
    phi_a: Angle = real(0.0, "Angle of shaft a", nominal=10.0)
    w_a: AngularVelocity = real(100.0, "Speed of shaft a", nominal=10.0)


@record
class Outputs:
    phi_b: Angle = real(0.0, "Angle of shaft b")
    w_b: AngularVelocity = real(0.0, "Speed of shaft b")
    a_a: AngularAcceleration = real(0.0, "Acceleration of shaft a", feedthrough=("tau_a", "tau_b"))
    E_kin: Energy = real(0.0, "Kinetic energy")
    P_loss: Power = real(0.0, "Power lost in the teeth", feedthrough=("tau_b",))


def check(p: Parameters) -> Iterator[str]:
    """Refuse a ratio of 0; warn where a real gearbox would self-lock."""
    if p.i == 0.0:
        raise ValueError("i = 0.0 must not be 0")
    if p.eta < 0.5:
        yield f"eta = {p.eta!r}: most gears below 0.5 lock if the load drives; this one does not"


def friction_torque(p: Parameters, x: State, u: Inputs) -> float:
    """The torque lost in the teeth, at shaft a; positive if it slows down a positive w_a."""
    tau = u.tau_b / p.i
    share = 1.0 / p.eta - 1.0 if tau * x.w_a < 0.0 else 1.0 - p.eta
    return share * abs(tau) * min(max(x.w_a / p.w_0, -1.0), 1.0)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(phi_a=x.w_a, w_a=(u.tau_a + u.tau_b / p.i - friction_torque(p, x, u)) / p.J)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    return Outputs(
        phi_b=x.phi_a / p.i,
        w_b=x.w_a / p.i,
        a_a=derivatives(p, t, x, u).w_a,
        E_kin=p.J * x.w_a * x.w_a / 2,
        P_loss=friction_torque(p, x, u) * x.w_a,
    )
