r"""Unbalanced rotor on a spring mount, on which Sommerfeld saw a motor caught at resonance.

A rotor with an eccentric mass $m_u$ at the radius $r$ turns in a body that moves along one line and
is held to the foundation by a spring $c$ and a damper $d$. The angle $\varphi$ is measured from the
direction of $+x$. With the energies

$$ T = \tfrac12\,m\,\dot x^2 + \tfrac12\,J\,\dot\varphi^2
     + \tfrac12\,m_u\left[(\dot x - r\dot\varphi\sin\varphi)^2 + (r\dot\varphi\cos\varphi)^2\right],
   \qquad V = \tfrac12\,c\,x^2 $$

and $M = m + m_u$, $\theta = J + m_u r^2$, $U = m_u r$, Lagrange's equations are

$$ M\,\ddot x - U\,\ddot\varphi\sin\varphi = U\,\dot\varphi^2\cos\varphi - d\,\dot x - c\,x $$

$$ \theta\,\ddot\varphi - U\,\ddot x\sin\varphi = \tau - d_r\,\dot\varphi $$

Spring and damper exert on the foundation the force

$$ f = c\,x + d\,\dot x $$

Assumptions: one guided direction of motion; gravity without effect, as in a horizontal plane; a
spring that is linear at any displacement; a rigid foundation; a shaft that does not bend.

The defaults describe a 20 kg machine on a mount with a natural frequency of 50 rad/s, started by
0.6 N m. The rotor stays caught just below the resonance instead of reaching 120 rad/s, and the
torque goes into shaking the mount.
"""

from __future__ import annotations

from math import cos, sin

from fmukit import Experiment, real, record
from fmukit.si import (
    Angle,
    AngularAcceleration,
    AngularVelocity,
    Energy,
    Force,
    Inertia,
    Length,
    Mass,
    Power,
    RotationalDamping,
    Torque,
    TranslationalDamping,
    TranslationalStiffness,
    Velocity,
)

EXPERIMENT = Experiment(stop=10.0, step=5e-3)
FLANGES = {"flange": ("tau", "w", "phi")}


@record
class Rotor:
    J: Inertia = real(
        0.02, "Moment of inertia of all that turns, without the eccentric mass", positive=True
    )
    m: Mass = real(0.5, "Eccentric mass", min=0.0)
    r: Length = real(0.05, "Radius of the eccentric mass", min=0.0)
    d: RotationalDamping = real(0.005, "Viscous friction of the bearings", min=0.0, tunable=True)


@record
class Mount:
    m: Mass = real(19.5, "Mass carried by the mount, without the eccentric mass", positive=True)
    c: TranslationalStiffness = real(50000.0, "Stiffness of the mount", min=0.0)
    d: TranslationalDamping = real(80.0, "Damping of the mount", min=0.0, tunable=True)


@record
class Parameters:
    rotor: Rotor
    mount: Mount


@record
class Inputs:
    tau: Torque = real(0.6, "Torque of the motor on the rotor, in the sense of +phi")


@record
class State:
    phi: Angle = real(0.0, "Angle of the rotor, 0 where the unbalance points along +x", nominal=1.0)
    w: AngularVelocity = real(0.0, "Speed of the rotor", nominal=10.0)
    x: Length = real(0.0, "Displacement of the mount", nominal=1e-3)
    v: Velocity = real(0.0, "Velocity of the mount", nominal=0.1)


@record
class Outputs:
    a: AngularAcceleration = real(0.0, "Acceleration of the rotor", feedthrough=("tau",))
    f: Force = real(0.0, "Force on the foundation, along +x")
    E_kin: Energy = real(0.0, "Kinetic energy")
    E_pot: Energy = real(0.0, "Potential energy of the spring")
    P_loss: Power = real(0.0, "Power lost in the mount and the bearings")


def inertias(p: Parameters, phi: float) -> tuple[float, float, float]:
    """Entries of the inertia matrix: M, theta, and U sin(phi), which couples the two."""
    U = p.rotor.m * p.rotor.r
    return p.mount.m + p.rotor.m, p.rotor.J + U * p.rotor.r, U * sin(phi)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    M, theta, coupling = inertias(p, x.phi)
    pull = p.rotor.m * p.rotor.r * x.w * x.w * cos(x.phi)
    force, torque = pull - p.mount.d * x.v - p.mount.c * x.x, u.tau - p.rotor.d * x.w
    det = M * theta - coupling * coupling
    w, v = (M * torque + coupling * force) / det, (theta * force + coupling * torque) / det
    return State(phi=x.w, w=w, x=x.v, v=v)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    M, theta, coupling = inertias(p, x.phi)
    return Outputs(
        a=derivatives(p, t, x, u).w,
        f=p.mount.c * x.x + p.mount.d * x.v,
        E_kin=(M * x.v * x.v + theta * x.w * x.w) / 2 - coupling * x.v * x.w,
        E_pot=p.mount.c * x.x * x.x / 2,
        P_loss=p.mount.d * x.v * x.v + p.rotor.d * x.w * x.w,
    )
