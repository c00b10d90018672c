r"""Crank and rod that shake the trough of a vibrating conveyor.

A crank of radius $r$ moves a trough of mass $m$ through a rod of length $l$ against a spring $c$,
neutral at mid-stroke, and a viscous resistance $\alpha$. With the trough's position $x(\varphi)$
and $' = \mathrm{d}/\mathrm{d}\varphi$, the reduced inertia and the load torque are

$$ \theta = \theta_1 + m\,x'^2, \qquad M_c = c\,x\,x' + \alpha\,x'^2\,\omega $$

and the equation of motion follows from Lagrange's:

$$ \dot\varphi = \omega, \qquad
   \theta\,\dot\omega = \tau - M_c - \tfrac{1}{2}\,\theta'\,\omega^2,
   \quad \tfrac{1}{2}\,\theta' = m\,x'\,x'' $$

Rod much longer than the crank (`rod.finite = false`):

$$ x = r \sin\varphi, \quad x' = r \cos\varphi, \quad x'' = -r \sin\varphi $$

Exact slider-crank (`rod.finite = true`), with $R = \sqrt{l^2 - r^2\cos^2\varphi}$; the stroke
stays $\pm r$:

$$ x = r \sin\varphi + R - l, \quad x' = r\cos\varphi\,(1 + r\sin\varphi/R), \quad
   x'' = -r\sin\varphi + \frac{r^2\cos 2\varphi}{R} - \frac{r^4\sin^2\varphi\cos^2\varphi}{R^3} $$

The rod pushes the trough along $x$ with the force $m\,\ddot x + c\,x + \alpha\,\dot x$; its axial
force is $l/R$ times that.

Assumptions: rotating masses balanced; gravity and bearing friction neglected; the rod's mass
divided between its two ends and included in $\theta_1$ and $m$; no backlash, although at resonance
the torque may swing through zero.

The defaults describe a 200 kg conveyor with a stroke of 10 mm either way, running at 40 rad/s.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, sin, sqrt

from fmukit import Experiment, discrete, real, record
from fmukit.runtime import direction
from fmukit.runtime.jet import Jet
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
    Torque,
    TranslationalDamping,
    TranslationalStiffness,
    Velocity,
)

EXPERIMENT = Experiment(stop=1.0, step=1e-3)
FLANGES = {"flange": ("tau", "w", "phi")}


@record
class Rotor:
    J: Inertia = real(
        0.49, "Moment of inertia of everything that turns with the crank", positive=True
    )


@record
class Crank:
    r: Length = real(0.010, "Radius of the crank", positive=True)


@record
class Rod:
    l: Length = real(0.4, "Length of the rod", positive=True)
    finite: bool = discrete(False, "Exact slider-crank instead of a rod much longer than the crank")


@record
class Trough:
    m: Mass = real(200.0, "Mass of the trough", positive=True)
    d: TranslationalDamping = real(
        4000.0,
        "Coefficient of the viscous resistance to the trough",
        min=0.0,
        tunable=True,
    )


@record
class Spring:
    c: TranslationalStiffness = real(720000.0, "Stiffness of the spring", min=0.0)


@record
class Parameters:
    rotor: Rotor
    crank: Crank
    rod: Rod
    trough: Trough
    spring: Spring


@record
class Inputs:
    tau: Torque = real(8.0, "Torque of the motor on the crank, in the sense of +phi")


@record
class State:
    phi: Angle = real(0.0, "Crank angle, 0 at mid-stroke on the way up", nominal=1.0)
    w: AngularVelocity = real(40.0, "Crank speed", nominal=10.0)


@record
class Outputs:
    a: AngularAcceleration = real(0.0, "Crank acceleration", feedthrough=("tau",))
    x: Length = real(0.0, "Position of the trough from mid-stroke")
    v: Velocity = real(0.0, "Velocity of the trough")
    tau_load: Torque = real(0.0, "Load torque on the crank at constant speed, against +phi")
    f_rod: Force = real(
        0.0, "Axial force of the rod, positive if it pushes the trough", feedthrough=("tau",)
    )
    E_kin: Energy = real(0.0, "Kinetic energy")
    E_pot: Energy = real(0.0, "Potential energy of the spring")
    P_loss: Power = real(0.0, "Power lost in the viscous resistance")


def check(p: Parameters) -> Iterator[str]:
    """Refuse a crank that the rod cannot follow; warn where r << l is a poor assumption."""
    r, l = p.crank.r, p.rod.l
    if r >= l and p.rod.finite:
        raise ValueError(f"crank.r = {r!r} m must be below rod.l = {l!r} m")
    if r > 0.2 * l and not p.rod.finite:
        yield f"crank.r = {r!r} m is not small compared with rod.l = {l!r} m: set rod.finite = true"


def step_constants(p: Parameters, x: State) -> direction.Direction:
    """The direction of the crank, from which it turns only a little within a step."""
    return direction.Direction(x.phi, sin(x.phi), cos(x.phi))


def trough_and_rod(p: Parameters, crank: direction.Direction) -> tuple[Jet, float]:
    """Position of the trough along the crank angle, and l/R of the rod."""
    r, l = p.crank.r, p.rod.l
    s, c = r * crank.sin, r * crank.cos
    if not p.rod.finite:
        return Jet(s, c, -s), 1.0
    R = sqrt(l * l - c * c)
    ddx = -s + (c * c - s * s) / R - (s * c) ** 2 / R**3
    return Jet(s + R - l, c * (1 + s / R), ddx), l / R


def inertia_and_load_torque(
    p: Parameters, x: State, crank: direction.Direction
) -> tuple[float, float]:
    """Reduced inertia theta, and load torque M_c + theta' w^2 / 2."""
    m, c, d = p.trough.m, p.spring.c, p.trough.d
    (position, dx, ddx), _ = trough_and_rod(p, crank)
    theta = p.rotor.J + m * dx * dx
    M_c = c * position * dx + d * dx * dx * x.w
    return theta, M_c + m * dx * ddx * x.w * x.w


def derivatives(
    p: Parameters, t: float, x: State, u: Inputs, crank: direction.Direction | None = None
) -> State:
    theta, tau_load = inertia_and_load_torque(
        p, x, direction.at_angle(x.phi, crank) if crank else step_constants(p, x)
    )
    return State(phi=x.w, w=(u.tau - tau_load) / theta)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    m, c, d = p.trough.m, p.spring.c, p.trough.d
    crank = step_constants(p, x)
    (position, dx, ddx), axial = trough_and_rod(p, crank)
    theta, tau_load = inertia_and_load_torque(p, x, crank)
    a = (u.tau - tau_load) / theta
    v = dx * x.w
    return Outputs(
        a=a,
        x=position,
        v=v,
        tau_load=tau_load,
        f_rod=axial * (m * (dx * a + ddx * x.w * x.w) + c * position + d * v),
        E_kin=theta * x.w * x.w / 2,
        E_pot=c * position * position / 2,
        P_loss=d * v * v,
    )
