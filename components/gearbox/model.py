r"""Gearbox between two shafts, with an efficiency that follows the direction of the power.

Shaft b turns $i$ times slower than shaft a, and the inertia $J$ of all that turns, counted at shaft
a, owns the speed of both:

$$ \dot\varphi_a = \omega_a, \qquad \omega_b = \frac{\omega_a}{i}, \qquad
   J\,\dot\omega_a = \tau_a + \tau - \mu\,|\tau|\,s, \qquad \tau = \frac{\tau_b}{i} $$

What the teeth lose is a share of the torque that they carry to or from shaft b. It changes with
the side from which the power comes, so that in both directions the efficiency is $\eta$:

$$ \mu = \frac1\eta - 1 \quad (\text{a drives b, } \tau\,\omega_a < 0), \qquad
   \mu = 1 - \eta \quad (\text{b drives a, } \tau\,\omega_a > 0), \qquad
   s = \min\left(\max\left(\frac{\omega_a}{\omega_0}, -1\right), 1\right) $$

$s$ is the direction of rotation; below the small speed $\omega_0$ it fades. The right-hand side is
thus continuous: a reversal of speed or torque needs no event and cannot chatter, and the loss
$\mu\,|\tau\,\omega_a\,s|$ is never negative.

Assumptions: rigid shafts and teeth, no backlash, no churning and no friction without load. Below
$\omega_0$ the friction of the teeth is viscous: a gearbox that ought to stick, as under a load that
it holds by its friction alone, creeps instead, slower than $\omega_0$.

The defaults are a 5:1 stage that slows a rising load down, stops and is driven back by it.
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
    i: Ratio = real(5.0, "Ratio w_a/w_b, below 0 where the shafts turn against each other")
    eta: Ratio = real(0.9, "Efficiency, the same in both directions", min=0.01, max=1.0)
    J: Inertia = real(0.01, "Moment of inertia of all that turns, at shaft a", positive=True)
    w_0: AngularVelocity = real(0.1, "Speed of shaft a below which losses fade", positive=True)


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
    """Refuse a ratio of 0; warn where the gearbox would lock itself."""
    if p.i == 0.0:
        raise ValueError("i = 0.0 must not be 0")
    if p.eta < 0.5:
        yield f"eta = {p.eta!r}: gears below 0.5 mostly lock when the load drives; this one does not"


def friction(p: Parameters, x: State, u: Inputs) -> float:
    """The torque at shaft a that the losses take, in the sense of +phi_a if it slows w_a > 0."""
    tau = u.tau_b / p.i
    share = 1.0 / p.eta - 1.0 if tau * x.w_a < 0.0 else 1.0 - p.eta
    return share * abs(tau) * min(max(x.w_a / p.w_0, -1.0), 1.0)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(phi_a=x.w_a, w_a=(u.tau_a + u.tau_b / p.i - friction(p, x, u)) / p.J)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    return Outputs(
        phi_b=x.phi_a / p.i,
        w_b=x.w_a / p.i,
        a_a=derivatives(p, t, x, u).w_a,
        E_kin=p.J * x.w_a * x.w_a / 2,
        P_loss=friction(p, x, u) * x.w_a,
    )
