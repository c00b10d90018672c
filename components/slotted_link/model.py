r"""Crank pin in the slot of a link that moves a trough: a Scotch yoke or a swinging link.

The mechanism is defined by its position function, the trough's position $x(\varphi)$. With
$' = \mathrm{d}/\mathrm{d}\varphi$, the reduced inertia is

$$ \theta = \theta_1 + m\,x'^2 $$

The load resists with a force that depends on position, speed and acceleration of the trough. The
torque of this load on the crank is

$$ M_c(\varphi, \dot\varphi, \ddot\varphi) = x'\,(c\,x + d\,\dot x + m_L\,\ddot x), \qquad
   \dot x = x'\,\dot\varphi, \quad \ddot x = x'\,\ddot\varphi + x''\,\dot\varphi^2 $$

Lagrange's equation then has the acceleration on both sides and is solved for it:

$$ \dot\varphi = \omega, \qquad
   (\theta + m_L x'^2)\,\dot\omega
   = \tau - M_c(\varphi, \omega, 0) - \tfrac12\,\theta'\,\omega^2,
   \quad \tfrac12\,\theta' = m\,x'\,x'' $$

The link of a Scotch yoke slides along $x$ (`link.swings = false`):

$$ x = r\sin\varphi $$

A swinging link turns about a pivot at the distance $l$ below the crank's centre and moves the
trough through a block at the height of that centre (`link.swings = true`):

$$ x = \frac{r\sin\varphi}{1 + (r/l)\cos\varphi} $$

The crank pin pushes the flank of the slot with the force along $x$ that trough and load require. If
the link swings, the force is
$l\,\sqrt{l^2 + 2\,l\,r\cos\varphi + r^2}\,/\,(l + r\cos\varphi)^2$ times that.

Assumptions: rotating masses balanced; a massless link; gravity and friction in slots and bearings
neglected; no backlash.

The defaults describe the crank conveyor with a yoke in place of its rod, running at 40 rad/s; 20 of
its 200 kg are a load that moves with the trough.
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
    r: Length = real(0.010, "Radius of the crank pin", positive=True)


@record
class Link:
    l: Length = real(0.05, "Distance of the link's pivot from the crank's centre", positive=True)
    swings: bool = discrete(False, "Swinging link instead of a Scotch yoke")


@record
class Trough:
    m: Mass = real(180.0, "Mass of the trough", positive=True)
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
class Load:
    m: Mass = real(20.0, "Force of the load per acceleration of the trough", min=0.0)


@record
class Parameters:
    rotor: Rotor
    crank: Crank
    link: Link
    trough: Trough
    spring: Spring
    load: Load


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
    f_load: Force = real(
        0.0, "Force of spring, resistance and load on the trough, along -x", feedthrough=("tau",)
    )
    f_pin: Force = real(
        0.0, "Force of the pin on the slot, positive if it pushes the trough", feedthrough=("tau",)
    )
    E_kin: Energy = real(0.0, "Kinetic energy, including that of the load")
    E_pot: Energy = real(0.0, "Potential energy of the spring")
    P_loss: Power = real(0.0, "Power lost in the viscous resistance")


def check(p: Parameters) -> Iterator[str]:
    """Refuse a pin that would pass below the pivot."""
    if p.crank.r >= p.link.l and p.link.swings:
        raise ValueError(f"crank.r = {p.crank.r!r} m must be below link.l = {p.link.l!r} m")
    yield from ()


def step_constants(p: Parameters, x: State) -> direction.Direction:
    """The direction of the crank, from which it turns only a little within a step."""
    return direction.Direction(x.phi, sin(x.phi), cos(x.phi))


def position(p: Parameters, crank: direction.Direction) -> Jet:
    """The position of the trough over the crank angle; another mechanism has another function."""
    across, up = p.crank.r * crank.sin, p.crank.r * crank.cos
    x = Jet(across, up, -across)
    return x / (Jet(up, -across, -up) / p.link.l + 1.0) if p.link.swings else x


def resisting_force(p: Parameters, x: Jet, w: float, a: float) -> float:
    """Force of spring, viscous resistance and load against +x."""
    return (
        p.spring.c * x.value
        + p.trough.d * x.first * w
        + p.load.m * (x.first * a + x.second * w * w)
    )


def inertia_and_load_torque(p: Parameters, x: Jet, w: float) -> tuple[float, float]:
    """Reduced inertia including the load, and M_c + theta' w^2 / 2 at constant speed."""
    theta = p.rotor.J + (p.trough.m + p.load.m) * x.first * x.first
    return theta, x.first * (resisting_force(p, x, w, 0.0 * w * w) + p.trough.m * x.second * w * w)


def derivatives(
    p: Parameters, t: float, x: State, u: Inputs, crank: direction.Direction | None = None
) -> State:
    at = position(p, direction.at_angle(x.phi, crank) if crank else step_constants(p, x))
    theta, tau_load = inertia_and_load_torque(p, at, x.w)
    return State(phi=x.w, w=(u.tau - tau_load) / theta)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    crank = step_constants(p, x)
    at = position(p, crank)
    theta, tau_load = inertia_and_load_torque(p, at, x.w)
    a = (u.tau - tau_load) / theta
    v = at.first * x.w
    f_load = resisting_force(p, at, x.w, a)
    f_pin = f_load + p.trough.m * (at.first * a + at.second * x.w * x.w)
    if p.link.swings:
        l, across, up = p.link.l, p.crank.r * crank.sin, p.link.l + p.crank.r * crank.cos
        f_pin = f_pin * (l * sqrt(across * across + up * up) / (up * up))
    return Outputs(
        a=a,
        x=at.value,
        v=v,
        tau_load=tau_load,
        f_load=f_load,
        f_pin=f_pin,
        E_kin=theta * x.w * x.w / 2,
        E_pot=p.spring.c * at.value * at.value / 2,
        P_loss=p.trough.d * v * v,
    )
