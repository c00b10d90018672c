r"""Gravity orientator: an L-shaped catcher on a rotor turns a falling cup over

On a rotor with a vertical axis, speed $\omega$, a cup with a hemispherical bottom falls open end
down along the outer wall of a chute at radius $R$. Its rim lands in the inner corner $D$ of an
L-shaped catcher, which swings down and turns the cup while its bottom slides on the wall; the cup
then lies on the tip $B$ of the catcher's hook, slips off, and turns on until it stands open end up.

All motion is in the radial plane, relative to the rotor: $x$ outwards, $y$ down from the pivot of
the catcher, angles from $+x$ towards $+y$. $\varphi_1$ is the angle of the catcher, $\varphi_2$
that of the cup's axis from the rim to the bottom: $3\pi/2$ open end down, $5\pi/2$ open end up.
$c_i, s_i, \omega_i$ are cosine, sine and rate of $\varphi_i$; index 1 is the catcher (`catcher.l`
$= l_1$, `catcher.h` $= h_1$, `catcher.phi` $= \varphi_{10}$), index 2 the cup (`cup.l` $= l_2$),
whose radius is $r = d/2$; $e = h - l_2$. The wall is at $x = L = l_1\cos\varphi_{10} + d$.

**Forces.** Centrifugal forces at the cup's centre of mass and at the middle of the catcher's arm,
torque on the catcher, and friction that opposes the sliding at the wall:

$$ F_2 = m_2\omega^2(R - r), \quad
   F_1 = m_1\omega^2\left(R - d - \tfrac12 l_1\cos\varphi_{10}\right), \quad F_f = \mu F_2 $$

$$ Q_1 = -F_1\tfrac{l_1}{2}s_1 - c\,\tfrac{l_1^2}{4}(\varphi_1 - \varphi_{10})\,c_1 $$

**Falling** by $H$ along the wall. Where $\mu F_2 \ge m_2 g$ a cup at rest is held; it falls on
when the rotor slows down.

$$ \dot v_{yc} = g - \mu F_2/m_2 $$

**Landing** is plastic, with impulses $S_x, S_y$ at $D$ and $S_k$ at the wall:

$$ m_2v_{xc} = -S_x - S_k, \quad m_2(v_{yc} - v) = -S_y, \quad
   J_2\omega_2 = S_xl_2 + S_yr - S_ke, \quad J_1\omega_1 = (S_yc_1 - S_xs_1)\,l_1 $$

$$ v_{xc} = -\omega_1l_1s_1 + \omega_2l_2, \quad v_{yc} = \omega_1l_1c_1 + \omega_2r, \quad
   \omega_1l_1s_1 = \omega_2h $$

**Joint.** The rim turns in $D$, the bottom slides on the wall. With
$A = L - r - l_1c_1$ and $' = \mathrm{d}/\mathrm{d}\varphi_1$:

$$ \varphi_2 = 2\pi - \arctan\frac{r}{h} - \arccos\frac{A}{\sqrt{h^2 + r^2}}, \quad
   u = \varphi_2' = -\frac{l_1s_1}{hs_2 + rc_2}, \quad u' = -\frac{l_1c_1 + Au^2}{hs_2 + rc_2} $$

$$ x_c = L - r - ec_2, \quad y_c = l_1s_1 + rc_2 + l_2s_2, \quad
   J = J_1 + m_2(x_c'^2 + y_c'^2) + J_2u^2 $$

$$ J\,\dot\omega_1 + \tfrac12J'\omega_1^2
   = Q_1 + m_2gy_c' + F_2x_c' - F_f\,[l_1c_1 + (A + r)u] $$

It ends where the cup's wall lies on the hook, $\varphi_2 = \varphi_1 + 3\pi/2$. The plastic hook
contact keeps the momenta below, with the velocities before it on the right and $M_{ij}$, $z_i$,
$x_2$ of the next stage:

$$ M_{11}\omega_1 + M_{12}\omega_2 = J_1\omega_1^- + m_2z_1v_{yc}^-, \quad
   M_{12}\omega_1 + M_{22}\omega_2 = J_2\omega_2^- + m_2(x_2v_{xc}^- + z_2v_{yc}^-) $$

$$ P_B = -m_2(v_{yc} - v_{yc}^-)/c_2, \quad P_K = P_Bs_2 - m_2(v_{xc} - v_{xc}^-) $$

**Turning.** The cup slides on the tip $B = (l_1c_1 + h_1s_1,\; l_1s_1 - h_1c_1)$, without friction,
and on the wall. With $G = L - r - B_x$, $T = \tan\varphi_2$, $S = 1/c_2$ the tip is
$x_1 = (G + rs_2)/c_2$ from the end of the cylinder, and

$$ Y_1 = B_x + B_yT, \quad Y_2 = GS^2 + rST, \quad
   z_1 = Y_1, \quad z_2 = Y_2 - ec_2, \quad x_2 = es_2 $$

$$ a_y = (B_xT - B_y)\omega_1^2 + 2B_yS^2\omega_1\omega_2
   + [2GS^2T + rS(T^2 + S^2) + es_2]\,\omega_2^2, \quad a_x = ec_2\omega_2^2 $$

$$ M_{11} = J_1 + m_2z_1^2, \quad M_{12} = m_2z_1z_2, \quad M_{22} = J_2 + m_2(x_2^2 + z_2^2) $$

$$ M_{11}\dot\omega_1 + M_{12}\dot\omega_2 = Q_1 + m_2z_1(g - a_y) - F_fY_1 $$

$$ M_{12}\dot\omega_1 + M_{22}\dot\omega_2
   = m_2z_2(g - a_y) + x_2(F_2 - m_2a_x) - F_f(Y_2 + r) $$

**Released** at $x_1 = h$. The catcher returns to its stop, $J_1\dot\omega_1 = Q_1$, and stays. The
bottom slides on the wall with the friction of its true reaction, $q = es_2 - \mu(ec_2 + r)$,

$$ N = J_2\,\frac{F_2 - m_2ec_2\omega_2^2}{J_2 + q\,m_2es_2}, \quad \dot\omega_2 = \frac{qN}{J_2},
   \quad \dot v_{yc} = g - \frac{\mu N}{m_2} $$

until the wall would have to pull; then it flies, $N = 0$, $\dot v_{xc} = F_2/m_2$, and touches the
wall again plastically: $(J_2 + m_2x_2^2)\,\omega_2 = J_2\omega_2^- + m_2x_2v_{xc}^-$.

**End.** `oriented` at $\varphi_2 = 5\pi/2$: angles and velocities stay as they were at that instant.
`jammed`, at rest, with a `reason`: in joint $\omega_1$ falls to 0, later $\omega_2$ or the sliding
speed $v_s = v_{yc} + \omega_2(ec_2 + r)$; the catcher falls back to its stop with the cup on the
hook; or the hook contact does not lift the rim from $D$. The next rising edge of `release` drops
the next cup; one that comes too early is counted in `missed`. All times count from the
communication point that brought the edge.

$E_{\mathrm{kin}}$ is that of both bodies, relative to the rotor; $E_{\mathrm{pot}}$ is that of the
cup's weight, 0 where it lands, and of the spring, 0 at the stop. The centrifugal forces are not in
it. $N_K < 0$ or $N_B < 0$ shows where the model holds a contact that a real cup would lose.

Assumptions: constant centrifugal forces, no Coriolis and Euler forces; wall thickness 0; the wall
friction is $\mu F_2$, not $\mu$ times the true reaction, and wall and cup do not part before the
release; impacts without friction; the weight of the catcher is balanced; a stop holds it at
$\varphi_{10}$. After A. Astrakhantsev, E. Davydova and V. Preis, Dynamics of the process of
orienting a product in a gravity orientator with an L-shaped catcher, Tula 2009, with its signs
and closures corrected; hook contact, flight and jamming are additions.

How good this is: a simulation with every contact unilateral and the same friction gives an
orientation time up to 1 % away at 50 to 60 rpm, 1 to 3 % at 30 to 40 rpm; with Coulomb friction of
the true reaction it is up to 4 % shorter at 40 rpm and 10 % shorter at 60 rpm, and the limit of the
speed is higher. The first speed that jams with the defaults is 150.7, 126.4, 100.2, 77.8 and 62.1 rpm
for $\mu$ = 0.05, 0.1, 0.2, 0.35 and 0.5. No value of $\mu\,\omega^2(R - r)/g$ alone is the limit: it is
0.32 there for $\mu$ = 0.05, 0.59 for 0.35 and 0.54 for 0.5. A cup that
friction could lock at the wall, with $J_2 \le m_2e\,[\mu r + \tfrac12e(\sqrt{1 + \mu^2} - 1)]$, is
refused: $N$ would have no value.

The defaults are a drawn cup of 40 mm diameter and 40 g at 40 rpm, dropped at the start. They are
not those of the paper, which prints none but $\varphi_{10}$ and $\mu$.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from math import acos, atan2, cos, pi, sin, sqrt, tan
from typing import NamedTuple

from fmukit import Experiment, discrete, real, record, replace, start
from fmukit.si import (
    Acceleration,
    Angle,
    AngularVelocity,
    Energy,
    Force,
    Impulse,
    Inertia,
    Length,
    Mass,
    Ratio,
    Time,
    TranslationalStiffness,
    Velocity,
)

EXPERIMENT = Experiment(stop=0.3, step=1e-3)
LONGEST_STEP = 5e-4


class Stage(IntEnum):
    """Stage of the orientation"""

    falling = 0
    joint = 1
    turning = 2
    released = 3
    oriented = 4
    jammed = 5
    waiting = 6


class Reason(IntEnum):
    """Why the product does not move"""

    none = 0
    held_in_chute = 1
    catcher_stopped = 2
    rim_stayed_at_hook_contact = 3
    sliding_stopped_in_turning = 4
    turning_stopped = 5
    catcher_back_at_stop = 6
    rotation_stopped_after_release = 7
    sliding_stopped_after_release = 8


@record
class Cup:
    d: Length = real(0.040, "Diameter of the cup", positive=True)
    h: Length = real(0.048, "Height of the cup's cylindrical part", positive=True)
    l: Length = real(0.043, "Distance of the centre of mass from the rim", positive=True)
    m: Mass = real(0.040, "Mass of the cup", positive=True)
    J: Inertia = real(2.4e-5, "Moment of inertia about the centre of mass", positive=True)


@record
class Catcher:
    l: Length = real(0.180, "Length of the catcher's arm, pivot to inner corner", positive=True)
    h: Length = real(0.010, "Length of the catcher's hook", positive=True)
    m: Mass = real(0.016, "Mass of the catcher", positive=True)
    J: Inertia = real(2.2e-4, "Moment of inertia about the pivot", positive=True)
    phi: Angle = real(pi / 6, "Angle of the catcher at its stop", positive=True, max=pi / 2)


@record
class Spring:
    c: TranslationalStiffness = real(14.0, "Stiffness of the spring at mid-arm", min=0.0)


@record
class Chute:
    R: Length = real(0.270, "Radius of the wall from the rotor's axis", positive=True)
    H: Length = real(0.040, "Height of the fall", positive=True)
    mu: Ratio = real(0.35, "Friction between cup and wall", min=0.0)


@record
class Parameters:
    cup: Cup
    catcher: Catcher
    spring: Spring
    chute: Chute
    g: Acceleration = real(9.81, "Gravity", positive=True)


@record
class Inputs:
    w: AngularVelocity = real(40 * pi / 30, "Speed of the rotor, either sense")
    release: bool = discrete(True, "A rising edge, or true at the start, drops a product")


@record
class State:
    phi1: Angle = real(pi / 6, "Angle of the catcher", nominal=1.0)
    w1: AngularVelocity = real(0.0, "Speed of the catcher", nominal=10.0)
    phi2: Angle = real(1.5 * pi, "Angle of the product, from 3 pi/2 to 5 pi/2", nominal=1.0)
    w2: AngularVelocity = real(0.0, "Speed of the product", nominal=10.0)
    xc: Length = real(0.1758845726811989, "Centre of mass, outwards from the pivot", nominal=0.1)
    yc: Length = real(0.007, "Centre of mass, down from the pivot", nominal=0.1)
    vxc: Velocity = real(0.0, "Velocity of the centre of mass, outwards", nominal=1.0)
    vyc: Velocity = real(0.0, "Velocity of the centre of mass, down", nominal=1.0)
    stage: Stage = discrete(Stage.waiting, "Stage of the orientation")
    reason: Reason = discrete(Reason.none, "Why the product does not move")
    contact: bool = discrete(True, "The product slides on the wall")
    oriented: int = discrete(0, "Products oriented")
    jammed: int = discrete(0, "Products jammed")
    missed: int = discrete(0, "Edges of release that found a product under way")
    since: Time = real(0.0, "Time at which the stage began", held=True)
    t_falling: Time = real(0.0, "Duration of falling, 0 until it is over", held=True)
    t_joint: Time = real(0.0, "Duration of joint, 0 until it is over", held=True)
    t_turning: Time = real(0.0, "Duration of turning, 0 until it is over", held=True)
    t_released: Time = real(0.0, "Duration of released, 0 until it is over", held=True)
    orientation_time: Time = real(0.0, "That of the last product, 0 if it jammed", held=True)
    S_x: Impulse = real(0.0, "Impulse of the landing on the corner, outwards", held=True)
    S_y: Impulse = real(0.0, "Impulse of the landing on the corner, down", held=True)
    S_k: Impulse = real(0.0, "Impulse of the landing on the wall", held=True)
    P_B: Impulse = real(0.0, "Impulse of the hook contact on the hook", held=True)
    P_K: Impulse = real(0.0, "Impulse of the hook contact on the wall", held=True)


AFRESH = dict.fromkeys(
    ("t_falling", "t_joint", "t_turning", "t_released", "S_x", "S_y", "S_k", "P_B", "P_K"), 0.0
)
REST: State = start(State, phi1=0.0, phi2=0.0, xc=0.0, yc=0.0)


@record
class Outputs:
    v_s: Velocity = real(0.0, "Sliding speed of the product on the wall, down")
    N_K: Force = real(0.0, "Reaction of the wall; the model pulls if < 0", feedthrough=("w",))
    N_B: Force = real(0.0, "Reaction of the hook; the model pulls if < 0", feedthrough=("w",))
    E_kin: Energy = real(0.0, "Kinetic energy relative to the rotor")
    E_pot: Energy = real(0.0, "Potential energy of weight and spring")


class Rates(NamedTuple):
    """Accelerations of catcher and product, and the reactions of wall and hook."""

    a1: float
    a2: float
    ax: float
    ay: float
    N_K: float
    N_B: float


class Joint(NamedTuple):
    """Stage joint: height, reduced inertia; derivatives by phi1 of phi2, centre and wall path."""

    yc: float
    J: float
    u: float
    du: float
    ux: float
    dux: float
    uy: float
    duy: float
    uf: float


class Turning(NamedTuple):
    """Stage turning: tip on the cup, height, masses; derivatives by phi1 and phi2 of the centre."""

    x1: float
    yc: float
    M11: float
    M12: float
    M22: float
    z1: float
    z2: float
    x2: float
    Y11: float
    Y12: float
    Y22: float


def check(p: Parameters) -> Iterator[str]:
    """Refuse what cannot be assembled or cannot turn over; warn of a landing that would pull."""
    cup, catcher, phi, r, e = p.cup, p.catcher, p.catcher.phi, p.cup.d / 2, p.cup.h - p.cup.l
    for name, value, limit, most in (
        ("cup.l", cup.l, "cup.h + cup.d/2", cup.h + r),
        ("catcher.h", catcher.h, "cup.h", cup.h),
        ("catcher.h", catcher.h, "cup.d / sin(catcher.phi)", cup.d / sin(phi)),
    ):
        if value >= most:
            raise ValueError(f"{name} = {value!r} m must be below {limit} = {most!r} m")
    for name, value, limit, least in (
        ("chute.R", p.chute.R, "catcher.l cos(catcher.phi) + cup.d", bottom(p) + r),
        ("cup.h", cup.h, "cup.d/2 tan(catcher.phi/2)", r * tan(phi / 2)),
    ):
        if value <= least:
            raise ValueError(f"{name} = {value!r} m must be above {limit} = {least!r} m")
    if flush(p) >= atan2(cup.h, r):
        raise ValueError(
            f"catcher.l = {catcher.l!r} m must be longer, or cup.h = {cup.h!r} m greater: the cup "
            f"would lie on the hook at phi1 = {flush(p)!r} rad, which must be below its dead centre "
            f"at {atan2(cup.h, r)!r} rad"
        )
    mu = p.chute.mu
    least = cup.m * e * (mu * r + e / 2 * (sqrt(1 + mu * mu) - 1))
    if e > 0.0 and least >= cup.J:
        raise ValueError(
            f"cup.J = {cup.J!r} kg.m2 must be above {least!r} kg.m2, or the wall with its friction "
            f"chute.mu = {mu!r} could lock the cup after its release"
        )
    x = land(p, 0.0, start(State, stage=Stage.falling, vyc=1.0))
    arm, tip = x.S_y * cos(phi) - x.S_x * sin(phi), x.S_x * cos(phi) + x.S_y * sin(phi)
    for part, push in (("wall", x.S_k), ("arm", arm), ("hook", tip)):
        if push < 0.0:
            yield f"when the product lands the {part} would have to pull at it"


def bottom(p: Parameters) -> float:
    """Distance L - r of the bottom's centre from the pivot while it slides on the wall."""
    return p.catcher.l * cos(p.catcher.phi) + p.cup.d / 2


def flush(p: Parameters) -> float:
    """Angle of the catcher at which the cup's wall lies on the hook."""
    r, h, l1 = p.cup.d / 2, p.cup.h, p.catcher.l
    return atan2(h, r + l1) + acos((r + l1 * cos(p.catcher.phi)) / sqrt(h * h + (r + l1) ** 2))


def closure(p: Parameters, phi1: float) -> float:
    """Angle of a product whose rim is in the corner and whose bottom is on the wall."""
    r, h = p.cup.d / 2, p.cup.h
    A = bottom(p) - p.catcher.l * cos(phi1)
    return 2 * pi - atan2(r, h) - acos(A / sqrt(h * h + r * r))


def landing(p: Parameters) -> float:
    """Height of the product's centre of mass when its rim is in the corner of the catcher."""
    return p.catcher.l * sin(p.catcher.phi) - p.cup.l


def loads(p: Parameters, phi1: float, w: float) -> tuple[float, float, float]:
    """Torque Q_1 on the catcher, centrifugal force F_2 and friction F_f on the product."""
    half, phi10, R, d = p.catcher.l / 2, p.catcher.phi, p.chute.R, p.cup.d
    F_1 = p.catcher.m * w * w * (R - d - half * cos(phi10))
    F_2 = p.cup.m * w * w * (R - d / 2)
    spring = p.spring.c * half * (phi1 - phi10)
    return -half * (F_1 * sin(phi1) + spring * cos(phi1)), F_2, p.chute.mu * F_2


def sliding(p: Parameters, x: State) -> float:
    """Sliding speed of the product at the wall, down."""
    return x.vyc + x.w2 * ((p.cup.h - p.cup.l) * cos(x.phi2) + p.cup.d / 2)


def surplus(p: Parameters, w: float) -> float:
    """Friction in the chute less the weight of the product."""
    return loads(p, p.catcher.phi, w)[2] - p.cup.m * p.g


def pressure(p: Parameters, x: State, w: float) -> float:
    """What presses a released product to the wall, less what its turning takes."""
    return loads(p, x.phi1, w)[1] - p.cup.m * (p.cup.h - p.cup.l) * cos(x.phi2) * x.w2 * x.w2


def falling(p: Parameters, x: State, w: float) -> Rates:
    _, F_2, F_f = loads(p, x.phi1, w)
    still = 0 * w * w
    ay = 0 * p.g if x.reason == Reason.held_in_chute else p.g - F_f / p.cup.m
    return Rates(still, still, 0 * p.g, ay, F_2, 0 * F_2)


def hinge(p: Parameters, phi1: float, phi2: float) -> Joint:
    h, l1, l2, r = p.cup.h, p.catcher.l, p.cup.l, p.cup.d / 2
    c1, s1, c2, s2 = cos(phi1), sin(phi1), cos(phi2), sin(phi2)
    A, D = bottom(p) - l1 * c1, -(h * s2 + r * c2)
    u = l1 * s1 / D
    du = (l1 * c1 + A * u * u) / D
    ux, dux = (h - l2) * s2 * u, (h - l2) * (c2 * u * u + s2 * du)
    x, y = l2 * c2 - r * s2, l2 * s2 + r * c2
    uy, duy = l1 * c1 + x * u, -l1 * s1 - y * u * u + x * du
    J = p.catcher.J + p.cup.m * (ux * ux + uy * uy) + p.cup.J * u * u
    return Joint(l1 * s1 + y, J, u, du, ux, dux, uy, duy, l1 * c1 + (A + r) * u)


def joint(p: Parameters, x: State, w: float) -> Rates:
    J_2, m, l2, r, at = p.cup.J, p.cup.m, p.cup.l, p.cup.d / 2, hinge(p, x.phi1, x.phi2)
    Q_1, F_2, F_f = loads(p, x.phi1, w)
    Q = Q_1 + m * p.g * at.uy + F_2 * at.ux - F_f * at.uf
    half_dJ = m * (at.ux * at.dux + at.uy * at.duy) + J_2 * at.u * at.du
    square = x.w1 * x.w1
    a1 = (Q - half_dJ * square) / at.J
    a2, ax, ay = (
        at.u * a1 + at.du * square,
        at.ux * a1 + at.dux * square,
        at.uy * a1 + at.duy * square,
    )

    c2, s2, e = cos(x.phi2), sin(x.phi2), p.cup.h - l2
    about_corner = J_2 * a2 + (l2 * c2 - r * s2) * (m * (ay - p.g) + F_f)
    about_corner += (l2 * s2 + r * c2) * (F_2 - m * ax) + (e * c2 + r) * F_f
    return Rates(a1, a2, ax, ay, about_corner / (p.cup.h * s2 + r * c2), 0 * F_2)


def hook(p: Parameters, phi1: float, phi2: float) -> Turning:
    l1, h1, m, r, e = p.catcher.l, p.catcher.h, p.cup.m, p.cup.d / 2, p.cup.h - p.cup.l
    c1, s1, s2, T, S = cos(phi1), sin(phi1), sin(phi2), tan(phi2), 1 / cos(phi2)
    Bx, By = l1 * c1 + h1 * s1, l1 * s1 - h1 * c1
    G = bottom(p) - Bx
    z1, z2, x2 = Bx + By * T, G * S * S + r * S * T - e / S, e * s2
    Y22 = 2 * G * S * S * T + r * S * (T * T + S * S) + e * s2
    M11, M12, M22 = p.catcher.J + m * z1 * z1, m * z1 * z2, p.cup.J + m * (x2 * x2 + z2 * z2)
    x1, yc = (G + r * s2) * S, By + G * T + r * S - e * s2
    return Turning(x1, yc, M11, M12, M22, z1, z2, x2, Bx * T - By, By * S * S, Y22)


def solve(at: Turning, Q_1: float, Q_2: float) -> tuple[float, float]:
    """What the masses of stage turning make of two torques, or of two momenta."""
    det = at.M11 * at.M22 - at.M12 * at.M12
    return (Q_1 * at.M22 - Q_2 * at.M12) / det, (Q_2 * at.M11 - Q_1 * at.M12) / det


def turning(p: Parameters, x: State, w: float) -> Rates:
    m, r, e, at = p.cup.m, p.cup.d / 2, p.cup.h - p.cup.l, hook(p, x.phi1, x.phi2)
    c2, s2 = cos(x.phi2), sin(x.phi2)
    Q_1, F_2, F_f = loads(p, x.phi1, w)
    ax = e * c2 * x.w2 * x.w2
    ay = at.Y11 * x.w1 * x.w1 + 2 * at.Y12 * x.w1 * x.w2 + at.Y22 * x.w2 * x.w2
    down = m * (p.g - ay) - F_f
    a1, a2 = solve(
        at, Q_1 + at.z1 * down, at.z2 * down + at.x2 * (F_2 - m * ax) - F_f * (e * c2 + r)
    )
    ax, ay = ax + at.x2 * a2, ay + at.z1 * a1 + at.z2 * a2
    N_B = (m * (p.g - ay) - F_f) / c2
    return Rates(a1, a2, ax, ay, F_2 + N_B * s2 - m * ax, N_B)


def released(p: Parameters, x: State, w: float) -> Rates:
    J_2, m, e, c2, s2 = p.cup.J, p.cup.m, p.cup.h - p.cup.l, cos(x.phi2), sin(x.phi2)
    Q_1, F_2, _ = loads(p, x.phi1, w)
    q = e * s2 - p.chute.mu * (e * c2 + p.cup.d / 2)
    N = J_2 * pressure(p, x, w) / (J_2 + q * m * e * s2) if x.contact else 0 * F_2
    a1 = 0 * w * w if x.phi1 == p.catcher.phi else Q_1 / p.catcher.J
    return Rates(a1, q * N / J_2, (F_2 - N) / m, p.g - p.chute.mu * N / m, N, 0 * F_2)


MECHANICS = {
    Stage.falling: falling,
    Stage.joint: joint,
    Stage.turning: turning,
    Stage.released: released,
}


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    if x.stage not in MECHANICS:
        return REST
    if x.stage == Stage.joint:
        x = replace(x, phi2=closure(p, x.phi1))
    a1, a2, ax, ay, *_ = MECHANICS[x.stage](p, x, u.w)
    return replace(x, phi1=x.w1, w1=a1, phi2=x.w2, w2=a2, xc=x.vxc, yc=x.vyc, vxc=ax, vyc=ay)


def exact(p: Parameters, x: State, u0: Inputs, u1: Inputs, h: float) -> State | None:
    """Nothing moves while no product is under way."""
    return None if under_way(x) else x


def under_way(x: State) -> bool:
    """Whether a product moves, or is held in the chute."""
    return x.stage in MECHANICS


def settle(p: Parameters, x: State) -> State:
    """The state with what its stage makes of the independent coordinates."""
    e, centre = p.cup.h - p.cup.l, bottom(p)
    match x.stage:
        case Stage.waiting:
            return ready(p, replace(x, yc=landing(p) - p.chute.H, vyc=0.0))
        case Stage.falling:
            return ready(p, x)
        case Stage.joint:
            phi2 = closure(p, x.phi1)
            j, xc = hinge(p, x.phi1, phi2), centre - e * cos(phi2)
            x = replace(x, phi2=phi2, w2=j.u * x.w1, xc=xc, yc=j.yc)
            return replace(x, vxc=j.ux * x.w1, vyc=j.uy * x.w1)
        case Stage.turning:
            k, xc = hook(p, x.phi1, x.phi2), centre - e * cos(x.phi2)
            return replace(x, xc=xc, yc=k.yc, vxc=k.x2 * x.w2, vyc=k.z1 * x.w1 + k.z2 * x.w2)
        case Stage.released if x.contact:
            return replace(x, xc=centre - e * cos(x.phi2), vxc=e * sin(x.phi2) * x.w2)
    return x


def ready(p: Parameters, x: State) -> State:
    """The state with the catcher at its stop and the product upright at the wall."""
    return replace(x, phi1=p.catcher.phi, w1=0.0, phi2=1.5 * pi, w2=0.0, xc=bottom(p), vxc=0.0)


def guard(p: Parameters, t: float, x: State, u: Inputs) -> tuple[float, ...]:
    back, upright = x.phi1 - p.catcher.phi, 2.5 * pi - x.phi2
    match x.stage:
        case Stage.falling:
            held = x.reason == Reason.held_in_chute
            return landing(p) - x.yc, surplus(p, u.w) if held else x.vyc
        case Stage.joint:
            return flush(p) - x.phi1, x.w1
        case Stage.turning:
            return p.cup.h - hook(p, x.phi1, x.phi2).x1, sliding(p, x), x.w2, back
        case Stage.released if x.contact:
            return upright, x.w2, sliding(p, x), pressure(p, x, u.w), back
        case Stage.released:
            e = p.cup.h - p.cup.l
            parting = e * sin(x.phi2) * x.w2 >= x.vxc
            gap = 0.0 if parting else bottom(p) - e * cos(x.phi2) - x.xc
            return upright, x.w2, 0.0, gap, back
    return ()


def jump(p: Parameters, t: float, x: State, u: Inputs, which: int) -> State:
    x = settle(p, x)
    match x.stage, which:
        case Stage.falling, 0:
            return land(p, t, x)
        case Stage.falling, _:
            moved = x.reason == Reason.none
            return replace(x, vyc=0.0, reason=Reason.held_in_chute if moved else Reason.none)
        case Stage.joint, 0:
            return lie_on_hook(p, t, x)
        case Stage.turning, 0:
            return over(x, t, Stage.released)
        case Stage.released, 0:
            time = x.t_falling + x.t_joint + x.t_turning + (t - x.since)
            return over(x, t, Stage.oriented, oriented=x.oriented + 1, orientation_time=time)
        case Stage.released, 3:
            return replace(x, contact=False) if x.contact else touch(p, x)
        case Stage.released, 4:
            return replace(x, phi1=p.catcher.phi, w1=0.0)
    return jam(x, t, JAMS[x.stage] + which)


JAMS = {
    Stage.joint: Reason.catcher_stopped - 1,
    Stage.turning: Reason.sliding_stopped_in_turning - 1,
    Stage.released: Reason.rotation_stopped_after_release - 1,
}


DURATIONS = {stage: f"t_{stage.name}" for stage in MECHANICS}


def over(x: State, t: float, stage: Stage, **changes: float) -> State:
    """The state x at the end of its stage and the beginning of the next."""
    duration = {DURATIONS[x.stage]: t - x.since}
    return replace(x, stage=stage, since=t, **duration, **changes)


def jam(x: State, t: float, reason: int) -> State:
    x = replace(x, w1=0.0, w2=0.0, vxc=0.0, vyc=0.0, orientation_time=0.0)
    return over(x, t, Stage.jammed, reason=reason, jammed=x.jammed + 1)


def land(p: Parameters, t: float, x: State) -> State:
    """Plastic impact of the rim in the corner of the catcher."""
    l1, phi1, m, at = p.catcher.l, p.catcher.phi, p.cup.m, hinge(p, p.catcher.phi, 1.5 * pi)
    w1 = m * x.vyc * at.uy / at.J
    S_y = m * (x.vyc - at.uy * w1)
    S_x = (l1 * cos(phi1) * S_y - p.catcher.J * w1) / (l1 * sin(phi1))
    x = over(x, t, Stage.joint, phi1=phi1, w1=w1, S_x=S_x, S_y=S_y, S_k=-m * at.ux * w1 - S_x)
    return settle(p, x)


def lie_on_hook(p: Parameters, t: float, x: State) -> State:
    """Plastic impact of the cup's wall on the tip of the hook."""
    m, c2, s2, at = p.cup.m, cos(x.phi2), sin(x.phi2), hook(p, x.phi1, x.phi2)
    w1, w2 = solve(
        at,
        p.catcher.J * x.w1 + m * at.z1 * x.vyc,
        p.cup.J * x.w2 + m * (at.x2 * x.vxc + at.z2 * x.vyc),
    )
    new = settle(p, over(x, t, Stage.turning, w1=w1, w2=w2))
    P_B = -m * (new.vyc - x.vyc) / c2
    new = replace(new, P_B=P_B, P_K=P_B * s2 - m * (new.vxc - x.vxc))
    By = p.catcher.l * sin(x.phi1) - p.catcher.h * cos(x.phi1)
    slips = By * w1 + (p.cup.d / 2 * c2 + at.x1 * s2) * w2 > 0.0
    return new if slips and w2 > w1 else jam(new, t, Reason.rim_stayed_at_hook_contact)


def touch(p: Parameters, x: State) -> State:
    """Plastic impact of the flying product on the wall."""
    m, x2 = p.cup.m, (p.cup.h - p.cup.l) * sin(x.phi2)
    w2 = (p.cup.J * x.w2 + m * x2 * x.vxc) / (p.cup.J + m * x2 * x2)
    return settle(p, replace(x, contact=True, w2=w2))


def sample(p: Parameters, t: float, x: State, before: Inputs | None, now: Inputs) -> State:
    """Drop the next product on a rising edge of `release`."""
    if not now.release or (before is not None and before.release):
        return x
    if x.stage in MECHANICS:
        return replace(x, missed=x.missed + 1)
    x = settle(p, replace(x, stage=Stage.waiting, contact=True, since=t, **AFRESH))
    held = surplus(p, now.w) >= 0.0
    return replace(x, stage=Stage.falling, reason=Reason.held_in_chute if held else Reason.none)


def notes(p: Parameters, t: float, old: State, new: State, u: Inputs) -> Iterator[str]:
    if new.missed > old.missed == 0:
        yield f"release at t = {t!r} s found a product under way; later ones are only counted"
    if new.jammed > old.jammed == 0:
        yield f"product jammed at t = {t!r} s, {Reason(new.reason).name}; later ones are only counted"


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    phi10, half, N_K, N_B = p.catcher.phi, p.catcher.l / 2, 0.0, 0.0
    if x.stage in MECHANICS:
        *_, N_K, N_B = MECHANICS[x.stage](p, x, u.w)
    J_1, J_2, m, square = p.catcher.J, p.cup.J, p.cup.m, x.vxc * x.vxc + x.vyc * x.vyc
    spring = (x.phi1 - phi10) * sin(x.phi1) + cos(x.phi1) - cos(phi10)
    return Outputs(
        v_s=sliding(p, x),
        N_K=N_K,
        N_B=N_B,
        E_kin=(J_1 * x.w1 * x.w1 + J_2 * x.w2 * x.w2 + m * square) / 2,
        E_pot=m * p.g * (landing(p) - x.yc) + p.spring.c * half * half * spring,
    )
