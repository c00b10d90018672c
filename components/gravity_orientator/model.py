r"""Gravity orientator: an L-shaped catcher on a rotor turns a falling cup over.

A rotor turns about a vertical axis at the speed $\omega$. On it a cup with a hemispherical bottom
falls, open end down, along the outer wall of a chute. Its rim lands in the inner corner of an L-shaped
catcher, which swings down and turns the cup while its bottom slides on the wall. The cup then lies on
the tip of the catcher's hook, slips off, and turns on until it stands open end up. Each stage follows
from Lagrange's equations, in the radial plane and relative to the rotor. The impacts between the
stages are plastic.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator
from enum import IntEnum
from math import atan2, pi, tan

from fmukit import Experiment, discrete, real, record, replace, start
from fmukit.runtime.jet import Jet, acos, cos, sin, sqrt
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
#: Longest sub-step in s: the shortest stage of the default machine, turning, lasts 69 of them (t_turning = 0.0344 s).
LONGEST_STEP = 5e-4


class Stage(IntEnum):
    """Stage of the orientation."""

    falling = 0
    joint = 1
    turning = 2
    released = 3
    oriented = 4
    jammed = 5
    waiting = 6


class Reason(IntEnum):
    """Why the product does not move."""

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
    l: Length = real(0.043, "Distance of the cup's centre of mass from its rim", positive=True)
    m: Mass = real(0.040, "Mass of the cup", positive=True)
    J: Inertia = real(
        2.4e-5, "Moment of inertia of the cup about its centre of mass", positive=True
    )


@record
class Catcher:
    l: Length = real(0.180, "Length of the catcher's arm, pivot to inner corner", positive=True)
    h: Length = real(0.010, "Length of the catcher's hook", positive=True)
    m: Mass = real(0.016, "Mass of the catcher", positive=True)
    J: Inertia = real(2.2e-4, "Moment of inertia of the catcher about its pivot", positive=True)
    phi: Angle = real(pi / 6, "Angle of the catcher at its stop", positive=True, max=pi / 2)


@record
class Spring:
    c: TranslationalStiffness = real(
        14.0, "Stiffness of the catcher's spring, which acts at mid-arm", min=0.0
    )


@record
class Chute:
    R: Length = real(0.270, "Distance of the chute's wall from the rotor's axis", positive=True)
    H: Length = real(0.040, "Height of the fall in the chute", positive=True)
    mu: Ratio = real(0.35, "Friction coefficient between cup and wall", min=0.0, tunable=True)


@record
class Neglected:
    mu_side: Ratio = real(
        0.0, "Friction coefficient between cup and side walls", min=0.0, tunable=True
    )
    J_a: Inertia = real(
        1.3e-5,
        "Moment of inertia of the cup about its axis, for friction at the side walls",
        positive=True,
    )
    mu_catcher: Ratio = real(
        0.0, "Friction coefficient between cup and catcher", min=0.0, max=1.0, tunable=True
    )
    rim: Length = real(
        0.0, "Radius of the rim's edge, on which the cup turns in the catcher's corner", min=0.0
    )
    creep: Velocity = real(
        1e-3,
        "Speed far above which friction at side walls and catcher is Coulomb friction",
        positive=True,
    )
    anchored: bool = discrete(False, "The spring pulls towards a fixed point instead of vertically")
    length: Length = real(
        0.1, "Length of the anchored spring with the catcher at its stop", positive=True
    )


@record
class Parameters:
    cup: Cup
    catcher: Catcher
    spring: Spring
    chute: Chute
    neglected: Neglected
    g: Acceleration = real(9.81, "Gravity", positive=True)


@record
class Inputs:
    w: AngularVelocity = real(40 * pi / 30, "Speed of the rotor, in either sense")
    release: bool = discrete(True, "A rising edge, or true at the start, drops a product")


@record
class State:
    phi1: Angle = real(pi / 6, "Angle of the catcher", nominal=1.0)
    w1: AngularVelocity = real(0.0, "Speed of the catcher", nominal=10.0)
    phi2: Angle = real(1.5 * pi, "Angle of the product, from 3 pi/2 to 5 pi/2", nominal=1.0)
    w2: AngularVelocity = real(0.0, "Speed of the product", nominal=10.0)
    xc: Length = real(
        0.0,
        "Position of the product's centre of mass, outwards from the pivot",
        nominal=0.1,
        follows=True,
    )
    yc: Length = real(
        0.007, "Position of the product's centre of mass, down from the pivot", nominal=0.1
    )
    vxc: Velocity = real(
        0.0, "Velocity of the product's centre of mass, outwards", nominal=1.0, follows=True
    )
    vyc: Velocity = real(0.0, "Velocity of the product's centre of mass, down", nominal=1.0)
    stage: Stage = discrete(Stage.waiting, "Stage of the orientation")
    reason: Reason = discrete(Reason.none, "Why the product does not move")
    contact: bool = discrete(True, "The product slides on the wall")
    oriented: int = discrete(0, "Number of products oriented")
    jammed: int = discrete(0, "Number of products jammed")
    missed: int = discrete(0, "Number of rising edges of release with a product still under way")
    since: Time = real(0.0, "Time at which the present stage began", held=True)
    t_falling: Time = real(0.0, "Duration of stage falling, 0 until it is over", held=True)
    t_joint: Time = real(0.0, "Duration of stage joint, 0 until it is over", held=True)
    t_turning: Time = real(0.0, "Duration of stage turning, 0 until it is over", held=True)
    t_released: Time = real(0.0, "Duration of stage released, 0 until it is over", held=True)
    orientation_time: Time = real(
        0.0, "Orientation time of the last product, 0 if it jammed", held=True
    )
    S_x: Impulse = real(
        0.0, "Impulse on the catcher's corner as the product lands, outwards", held=True
    )
    S_y: Impulse = real(
        0.0, "Impulse on the catcher's corner as the product lands, down", held=True
    )
    S_k: Impulse = real(0.0, "Impulse on the wall as the product lands", held=True)
    P_B: Impulse = real(0.0, "Impulse on the hook as the product lies down on it", held=True)
    P_K: Impulse = real(0.0, "Impulse on the wall as the product lies down on the hook", held=True)


@record
class Outputs:
    v_s: Velocity = real(0.0, "Sliding speed of the product on the wall, down")
    N_K: Force = real(0.0, "Force of the wall on the product, a pull if < 0", feedthrough=("w",))
    N_B: Force = real(0.0, "Force of the hook on the product, a pull if < 0", feedthrough=("w",))
    E_kin: Energy = real(0.0, "Kinetic energy of catcher and product relative to the rotor")
    E_pot: Energy = real(0.0, "Potential energy of the product's weight and the spring")
    u_phi2: Ratio = real(0.0, "Transfer function d(phi2)/d(phi1) in stage joint, else 0")
    u_xc1: Length = real(0.0, "Transfer function d(xc)/d(phi1) in stages joint and turning, else 0")
    u_xc2: Length = real(0.0, "Transfer function d(xc)/d(phi2) in stage turning, else 0")
    u_yc1: Length = real(0.0, "Transfer function d(yc)/d(phi1) in stages joint and turning, else 0")
    u_yc2: Length = real(0.0, "Transfer function d(yc)/d(phi2) in stage turning, else 0")
    u_yK1: Length = real(
        0.0, "Derivative by phi1 of the wall contact's height in stages joint and turning, else 0"
    )
    u_yK2: Length = real(
        0.0, "Derivative by phi2 of the wall contact's height in stage turning, else 0"
    )


AFRESH = dict.fromkeys(
    ("t_falling", "t_joint", "t_turning", "t_released", "S_x", "S_y", "S_k", "P_B", "P_K"), 0.0
)
Guard = Callable[[Parameters, State, float], float]
Consequence = Callable[[Parameters, float, State], State]
REST: State = start(State, phi1=0.0, phi2=0.0, xc=0.0, yc=0.0)
Rates = namedtuple("Rates", "a1 a2 ax ay N_K N_B")  # accelerations; reactions of wall and hook
Joint = namedtuple("Joint", "phi2 x y path J half_dJ")  # jets along phi1; path', inertia
Turning = namedtuple("Turning", "x1 yc M11 M12 M22 z1 z2 x2 Y11 Y12 Y22")


def check(p: Parameters) -> Iterator[str]:
    """Refuse what cannot be assembled or cannot turn over; warn of a landing that would need a pull."""
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
    if p.neglected.mu_side > 0.0 and p.neglected.J_a >= 2 * cup.J:
        raise ValueError(
            f"neglected.J_a = {p.neglected.J_a!r} kg.m2 must be below 2 cup.J = {2 * cup.J!r} kg.m2"
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
            yield f"when the product lands, the {part} would have to pull it"


def bottom(p: Parameters) -> float:
    """Distance L - r of the bottom's centre from the pivot while it slides on the wall."""
    return p.catcher.l * cos(p.catcher.phi) + p.cup.d / 2


def flush(p: Parameters) -> float:
    """Angle of the catcher at which the cup's wall lies on the hook."""
    r, h, l1 = p.cup.d / 2, p.cup.h, p.catcher.l
    far = r + l1
    return atan2(h, far) + acos((r + l1 * cos(p.catcher.phi)) / sqrt(h * h + far * far))


def landing(p: Parameters) -> float:
    """Height of the product's centre of mass when its rim is in the corner of the catcher."""
    return p.catcher.l * sin(p.catcher.phi) - p.cup.l


def loads(p: Parameters, phi1: float, w: float) -> tuple[float, float, float]:
    """Torque Q_1 on the catcher, centrifugal force F_2 and friction F_f on the product."""
    half, phi10, R, d = p.catcher.l / 2, p.catcher.phi, p.chute.R, p.cup.d
    F_1 = p.catcher.m * w * w * (R - d - half * cos(phi10))
    F_2 = p.cup.m * w * w * (R - d / 2)
    spring = p.spring.c * half * (phi1 - phi10)
    pull = anchored(p, phi1)[0] if p.neglected.anchored else spring * cos(phi1)
    return -half * (F_1 * sin(phi1) + pull), F_2, p.chute.mu * F_2


def anchored(p: Parameters, phi1: float) -> tuple[float, float]:
    """Pull of the spring across the arm, less the weight balanced at the stop, and their energy.

    The upper end of the spring is fixed above the middle of the arm at the stop.
    """
    half, phi10, weight, length = (
        p.catcher.l / 2,
        p.catcher.phi,
        p.catcher.m * p.g,
        p.neglected.length,
    )
    down = half * (sin(phi1) - sin(phi10))
    X, Y = half * (cos(phi10) - cos(phi1)), -length - down
    far = sqrt(X * X + Y * Y)
    stretch = far - length
    tension = weight + p.spring.c * stretch
    across = tension / far * (X * sin(phi1) - Y * cos(phi1)) - weight * cos(phi1)
    return across, p.spring.c / 2 * stretch * stretch + weight * (stretch - down)


def over_speed(p: Parameters, vx: float, vy: float) -> float:
    """Coulomb friction over normal force and the velocity that it opposes; a stuck contact creeps."""
    return 1 / sqrt(vx * vx + vy * vy + p.neglected.creep * p.neglected.creep)


def sides(p: Parameters, x: State, w: float) -> tuple[float, float, float]:
    """Force and moment on the product from friction at the side walls.

    Coriolis forces press the rim and the end of the cylinder against them.
    """
    h, l2, m, e, mu = p.cup.h, p.cup.l, p.cup.m, p.cup.h - p.cup.l, p.neglected.mu_side
    c2, s2 = cos(x.phi2), sin(x.phi2)
    F, S = 2 * m * w * x.vxc, -2 * w * x.w2 * s2 * (p.cup.J - p.neglected.J_a / 2)
    ux, uy = x.vxc - x.w2 * e * s2, x.vyc + x.w2 * e * c2
    vx, vy = x.vxc + x.w2 * l2 * s2, x.vyc - x.w2 * l2 * c2
    end = mu / h * abs(S + l2 * F) * over_speed(p, ux, uy)
    rim = mu / h * abs(e * F - S) * over_speed(p, vx, vy)
    turn = l2 * rim * (c2 * vy - s2 * vx) - e * end * (c2 * uy - s2 * ux)
    return -(end * ux + rim * vx), -(end * uy + rim * vy), turn


def share(k: float, tried: float, push: float, pushed: float) -> float:
    """Friction k N over the friction tried; the normal force N is `push` without it, `pushed` with it."""
    return k * push / (tried - k * (pushed - push)) if push > 0 * push else 0 * k * push / tried


def falling(p: Parameters, x: State, w: float) -> Rates:
    """The product falls along the wall, or is held by its friction."""
    _, F_2, F_f = loads(p, x.phi1, w)
    still = 0 * w * w
    ay = 0 * p.g if x.reason == Reason.held_in_chute else p.g - F_f / p.cup.m
    return Rates(still, still, 0 * p.g, ay, F_2, 0 * F_2)


def hinge(p: Parameters, phi1: float) -> Joint:
    """Stage joint along phi1: angle and centre of the product, path of the wall on it, inertia J."""
    h, l1, l2, r = p.cup.h, p.catcher.l, p.cup.l, p.cup.d / 2
    at = Jet(phi1, 1.0, 0.0)
    A = bottom(p) - l1 * cos(at)
    phi2 = 2 * pi - atan2(r, h) - acos(A / sqrt(h * h + r * r))
    x = bottom(p) - (h - l2) * cos(phi2)
    y = l1 * sin(at) + r * cos(phi2) + l2 * sin(phi2)
    path = y + (h - l2) * sin(phi2) + r * phi2
    J = p.catcher.J + p.cup.m * (x.rate**2 + y.rate**2) + p.cup.J * phi2.rate**2
    return Joint(phi2, x, y, path.first, J.value, J.first / 2)


def joint(p: Parameters, x: State, w: float) -> Rates:
    """J w1' + J' w1^2 / 2 = Q; the wall's reaction from the product's moments about the corner."""
    l1, J_2, m, at = p.catcher.l, p.cup.J, p.cup.m, hinge(p, x.phi1)
    Q_1, F_2, F_f = loads(p, x.phi1, w)
    fx, fy, turn = sides(p, x, w)
    Q = Q_1 + m * p.g * at.y.first + F_2 * at.x.first - F_f * at.path
    Q += fx * at.x.first + fy * at.y.first + turn * at.phi2.first
    c1, s1 = cos(x.phi1), sin(x.phi1)
    across, below = at.x.value - l1 * c1, at.y.value - l1 * s1

    def rates(M: float) -> tuple[float, ...]:
        """Rates with the moment M of friction in the corner; the last is the push of arm and hook."""
        a1 = (Q - M * (at.phi2.first - 1) - at.half_dJ * x.w1 * x.w1) / at.J
        a2, ax, ay = (q.first * a1 + q.second * x.w1 * x.w1 for q in (at.phi2, at.x, at.y))
        right, down = F_2 + fx - m * ax, m * (ay - p.g) + F_f - fy
        moment = J_2 * a2 + M - turn + across * down + below * right
        moment += (bottom(p) + p.cup.d / 2 - at.x.value) * F_f
        N_K = -moment * at.phi2.first / (l1 * s1)
        return a1, a2, ax, ay, N_K, (N_K - right) * (s1 - c1) - down * (c1 + s1)

    tried = m * p.g * l1
    *free, push = rates(0 * tried)
    *held, pushed = rates(tried)
    part = share(p.neglected.mu_catcher * p.neglected.rim, tried, push, pushed)
    a1, a2, ax, ay, N_K = (a + part * (b - a) for a, b in zip(free, held))
    return Rates(a1, a2, ax, ay, N_K, 0 * F_2)


def hook(p: Parameters, phi1: float, phi2: float) -> Turning:
    """Stage turning: tip on the cup, height, mass matrix; the centre's derivatives by phi1 and phi2."""
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
    """Accelerations from two torques in stage turning, or speeds from two momenta."""
    det = at.M11 * at.M22 - at.M12 * at.M12
    return (Q_1 * at.M22 - Q_2 * at.M12) / det, (Q_2 * at.M11 - Q_1 * at.M12) / det


def turning(p: Parameters, x: State, w: float) -> Rates:
    """M11 w1' + M12 w2' = Q_1 + ..., M12 w1' + M22 w2' = ..., and the balance of forces."""
    m, r, e, at = p.cup.m, p.cup.d / 2, p.cup.h - p.cup.l, hook(p, x.phi1, x.phi2)
    c2, s2 = cos(x.phi2), sin(x.phi2)
    Q_1, F_2, F_f = loads(p, x.phi1, w)
    ax = e * c2 * x.w2 * x.w2
    ay = at.Y11 * x.w1 * x.w1 + 2 * at.Y12 * x.w1 * x.w2 + at.Y22 * x.w2 * x.w2
    fx, fy, turn = sides(p, x, w)
    down = m * (p.g - ay) - F_f + fy
    Q_2 = at.z2 * down + at.x2 * (F_2 - m * ax) - F_f * (e * c2 + r) + at.x2 * fx + turn
    along, about = at.Y12 * c2, r + at.x1 * s2 / c2
    slip = along * x.w1 + about * x.w2

    def rates(F: float) -> tuple[float, ...]:
        """Rates with the friction F on the hook."""
        a1, a2 = solve(at, Q_1 + at.z1 * down - F * along, Q_2 - F * about)
        bx, by = ax + at.x2 * a2, ay + at.z1 * a1 + at.z2 * a2
        N_B = (m * (p.g - by) - F_f + fy - F * s2) / c2
        return a1, a2, bx, by, F_2 + fx + N_B * s2 - F * c2 - m * bx, N_B

    free, held = rates(0 * F_f), rates(m * p.g)
    k = p.neglected.mu_catcher * slip * over_speed(p, slip, 0 * slip)
    part = share(k, m * p.g, free[-1], held[-1])
    return Rates(*(a + part * (b - a) for a, b in zip(free, held)))


def surplus(p: Parameters, w: float) -> float:
    """Friction in the chute less the weight of the product."""
    return loads(p, p.catcher.phi, w)[2] - p.cup.m * p.g


def pressure(p: Parameters, x: State, w: float) -> float:
    """Force that presses a released product to the wall, less what its rotation takes."""
    fx, _, turn = sides(p, x, w)
    m, e, c2, s2 = p.cup.m, p.cup.h - p.cup.l, cos(x.phi2), sin(x.phi2)
    return loads(p, x.phi1, w)[1] - m * e * c2 * x.w2 * x.w2 + fx - m * e * s2 * turn / p.cup.J


def released(p: Parameters, x: State, w: float) -> Rates:
    """The product turns on at the wall, or flies; the catcher returns to its stop."""
    J_2, m, e, c2, s2 = p.cup.J, p.cup.m, p.cup.h - p.cup.l, cos(x.phi2), sin(x.phi2)
    Q_1, F_2, _ = loads(p, x.phi1, w)
    q = e * s2 - p.chute.mu * (e * c2 + p.cup.d / 2)
    N = J_2 * pressure(p, x, w) / (J_2 + q * m * e * s2) if x.contact else 0 * F_2
    a1 = 0 * w * w if x.phi1 == p.catcher.phi else Q_1 / p.catcher.J
    fx, fy, turn = sides(p, x, w)
    ax, ay = (F_2 - N + fx) / m, p.g - (p.chute.mu * N - fy) / m
    return Rates(a1, (q * N + turn) / J_2, ax, ay, N, 0 * F_2)


MECHANICS: dict[int, Callable[[Parameters, State, float], Rates]] = {
    Stage.falling: falling,
    Stage.joint: joint,
    Stage.turning: turning,
    Stage.released: released,
}


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    if x.stage not in MECHANICS:
        return REST
    a1, a2, ax, ay, *_ = MECHANICS[x.stage](p, x, u.w)
    return replace(x, phi1=x.w1, w1=a1, phi2=x.w2, w2=a2, xc=x.vxc, yc=x.vyc, vxc=ax, vyc=ay)


def exact(p: Parameters, x: State, u0: Inputs, u1: Inputs, h: float) -> State | None:
    """Nothing moves while no product is under way."""
    return None if is_moving(x) else x


def is_moving(x: State) -> bool:
    """Whether a product moves, or is held in the chute."""
    return x.stage in MECHANICS


def settle(p: Parameters, x: State) -> State:
    """The state with the dependent coordinates of its stage."""
    e, centre = p.cup.h - p.cup.l, bottom(p)
    match x.stage:
        case Stage.waiting:
            return ready(p, replace(x, yc=landing(p) - p.chute.H, vyc=0.0))
        case Stage.falling:
            return ready(p, x)
        case Stage.joint:
            phi2, xc, yc, *_ = hinge(p, x.phi1)
            x = replace(x, phi2=phi2.value, w2=phi2.first * x.w1, xc=xc.value, yc=yc.value)
            return replace(x, vxc=xc.first * x.w1, vyc=yc.first * x.w1)
        case Stage.turning:
            k, xc = hook(p, x.phi1, x.phi2), centre - e * cos(x.phi2)
            return replace(x, xc=xc, yc=k.yc, vxc=k.x2 * x.w2, vyc=k.z1 * x.w1 + k.z2 * x.w2)
        case Stage.released if x.contact:
            return replace(x, xc=centre - e * cos(x.phi2), vxc=e * sin(x.phi2) * x.w2)
    return x


def ready(p: Parameters, x: State) -> State:
    """The state with the catcher at its stop and the product upright at the wall."""
    return replace(x, phi1=p.catcher.phi, w1=0.0, phi2=1.5 * pi, w2=0.0, xc=bottom(p), vxc=0.0)


DURATIONS = {stage: f"t_{Stage(stage).name}" for stage in MECHANICS}


def over(x: State, t: float, stage: Stage, **changes: float) -> State:
    """The state x at the end of its stage and the beginning of the next."""
    duration = {DURATIONS[x.stage]: t - x.since}
    return replace(x, stage=stage, since=t, **duration, **changes)


def jam(reason: Reason) -> Consequence:
    """A consequence that makes the product stay where it is, for this reason."""

    def jammed(p: Parameters, t: float, x: State) -> State:
        x = replace(x, w1=0.0, w2=0.0, vxc=0.0, vyc=0.0, orientation_time=0.0)
        return over(x, t, Stage.jammed, reason=reason, jammed=x.jammed + 1)

    return jammed


def land(p: Parameters, t: float, x: State) -> State:
    """Plastic impact of the rim in the corner of the catcher."""
    l1, phi1, m, at = p.catcher.l, p.catcher.phi, p.cup.m, hinge(p, p.catcher.phi)
    w1 = m * x.vyc * at.y.first / at.J
    S_y = m * (x.vyc - at.y.first * w1)
    S_x = (l1 * cos(phi1) * S_y - p.catcher.J * w1) / (l1 * sin(phi1))
    S_k = -m * at.x.first * w1 - S_x
    return settle(p, over(x, t, Stage.joint, phi1=phi1, w1=w1, S_x=S_x, S_y=S_y, S_k=S_k))


def hold(p: Parameters, t: float, x: State) -> State:
    """The product comes to rest in the chute, or falls on."""
    held = x.reason == Reason.none
    return replace(x, vyc=0.0, reason=Reason.held_in_chute if held else Reason.none)


def lie_on_hook(p: Parameters, t: float, x: State) -> State:
    """Plastic impact of the cup's wall on the tip of the hook."""
    m, c2, s2, at = p.cup.m, cos(x.phi2), sin(x.phi2), hook(p, x.phi1, x.phi2)
    momentum = p.cup.J * x.w2 + m * (at.x2 * x.vxc + at.z2 * x.vyc)
    w1, w2 = solve(at, p.catcher.J * x.w1 + m * at.z1 * x.vyc, momentum)
    new = settle(p, over(x, t, Stage.turning, w1=w1, w2=w2))
    P_B = -m * (new.vyc - x.vyc) / c2
    new = replace(new, P_B=P_B, P_K=P_B * s2 - m * (new.vxc - x.vxc))
    By = p.catcher.l * sin(x.phi1) - p.catcher.h * cos(x.phi1)
    slips = By * w1 + (p.cup.d / 2 * c2 + at.x1 * s2) * w2 > 0.0
    return new if slips and w2 > w1 else jam(Reason.rim_stayed_at_hook_contact)(p, t, new)


def release(p: Parameters, t: float, x: State) -> State:
    """The tip leaves the end of the cup."""
    return over(x, t, Stage.released)


def leave_or_touch(p: Parameters, t: float, x: State) -> State:
    """The product flies off the wall, or meets it again in a plastic impact."""
    if x.contact:
        return replace(x, contact=False)
    m, x2 = p.cup.m, (p.cup.h - p.cup.l) * sin(x.phi2)
    w2 = (p.cup.J * x.w2 + m * x2 * x.vxc) / (p.cup.J + m * x2 * x2)
    return settle(p, replace(x, contact=True, w2=w2))


def come_to_stop(p: Parameters, t: float, x: State) -> State:
    """The catcher is back at its stop, without the product."""
    return replace(x, phi1=p.catcher.phi, w1=0.0)


def finish(p: Parameters, t: float, x: State) -> State:
    """The product stands open end up."""
    time = x.t_falling + x.t_joint + x.t_turning + (t - x.since)
    return over(x, t, Stage.oriented, oriented=x.oriented + 1, orientation_time=time)


def drive(p: Parameters, x: State, w: float) -> float:
    """Friction less weight of a product at rest, speed of a falling one."""
    return surplus(p, w) if x.reason == Reason.held_in_chute else x.vyc


def sliding(p: Parameters, x: State, w: float = 0.0) -> float:
    """Sliding speed of the product at the wall, down."""
    return x.vyc + x.w2 * ((p.cup.h - p.cup.l) * cos(x.phi2) + p.cup.d / 2)


def wall(p: Parameters, x: State, w: float) -> float:
    """Force that presses a released product to the wall; in flight the gap, 0 while it opens."""
    if x.contact:
        return pressure(p, x, w)
    e = p.cup.h - p.cup.l
    parting = e * sin(x.phi2) * x.w2 >= x.vxc
    return 0.0 if parting else bottom(p) - e * cos(x.phi2) - x.xc


EVENTS: dict[int, tuple[tuple[Guard, Consequence], ...]] = {
    # a guard that falls below zero, and its consequence
    Stage.falling: (
        (lambda p, x, w: landing(p) - x.yc, land),
        (drive, hold),
    ),
    Stage.joint: (
        (lambda p, x, w: flush(p) - x.phi1, lie_on_hook),
        (lambda p, x, w: x.w1, jam(Reason.catcher_stopped)),
    ),
    Stage.turning: (
        (lambda p, x, w: p.cup.h - hook(p, x.phi1, x.phi2).x1, release),
        (sliding, jam(Reason.sliding_stopped_in_turning)),
        (lambda p, x, w: x.w2, jam(Reason.turning_stopped)),
        (lambda p, x, w: x.phi1 - p.catcher.phi, jam(Reason.catcher_back_at_stop)),
    ),
    Stage.released: (
        (lambda p, x, w: 2.5 * pi - x.phi2, finish),
        (lambda p, x, w: x.w2, jam(Reason.rotation_stopped_after_release)),
        (
            lambda p, x, w: sliding(p, x) if x.contact else 0.0,
            jam(Reason.sliding_stopped_after_release),
        ),
        (wall, leave_or_touch),
        (lambda p, x, w: x.phi1 - p.catcher.phi, come_to_stop),
    ),
}


def event_indicators(p: Parameters, t: float, x: State, u: Inputs) -> tuple[float, ...]:
    return tuple([falls(p, x, u.w) for falls, _ in EVENTS.get(x.stage, ())])


def event_update(p: Parameters, t: float, x: State, u: Inputs, which: int) -> State:
    x = settle(p, x)
    *events, (_, last) = EVENTS[x.stage]
    for index, (_, consequence) in enumerate(events):
        if which == index:
            return consequence(p, t, x)
    return last(p, t, x)


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
        yield f"release at t = {t!r} s found a product under way; further ones are only counted"
    if new.jammed > old.jammed == 0:
        yield f"product jammed at t = {t!r} s, {Reason(new.reason).name}; further jams are only counted"


def transfer(p: Parameters, x: State) -> tuple[float, ...]:
    """Derivatives of phi2, xc, yc and the contact's height by phi1 and phi2, while the catcher leads."""
    none, lever = 0 * p.cup.d, (p.cup.h - p.cup.l) * cos(x.phi2)
    match x.stage:
        case Stage.joint:
            at = hinge(p, x.phi1)
            u, y = at.phi2.first, at.y.first
            return u, at.x.first, none, y, none, y + lever * u, none
        case Stage.turning:
            k = hook(p, x.phi1, x.phi2)
            return 0.0, none, k.x2, k.z1, k.z2, k.z1, k.z2 + lever
    return 0.0, none, none, none, none, none, none


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    phi10, half, N_K, N_B = p.catcher.phi, p.catcher.l / 2, 0.0, 0.0
    if x.stage in MECHANICS:
        *_, N_K, N_B = MECHANICS[x.stage](p, x, u.w)
    J_1, J_2, m, square = p.catcher.J, p.cup.J, p.cup.m, x.vxc * x.vxc + x.vyc * x.vyc
    spring = (x.phi1 - phi10) * sin(x.phi1) + cos(x.phi1) - cos(phi10)
    plain = p.spring.c * half * half * spring
    stored = anchored(p, x.phi1)[1] if p.neglected.anchored else plain
    u_phi2, u_xc1, u_xc2, u_yc1, u_yc2, u_yK1, u_yK2 = transfer(p, x)
    return Outputs(
        v_s=sliding(p, x),
        N_K=N_K,
        N_B=N_B,
        E_kin=(J_1 * x.w1 * x.w1 + J_2 * x.w2 * x.w2 + m * square) / 2,
        E_pot=m * p.g * (landing(p) - x.yc) + stored,
        u_phi2=u_phi2,
        u_xc1=u_xc1,
        u_xc2=u_xc2,
        u_yc1=u_yc1,
        u_yc2=u_yc2,
        u_yK1=u_yK1,
        u_yK2=u_yK2,
    )
