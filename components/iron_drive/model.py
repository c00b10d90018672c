r"""Cam drive of a sealing iron: cam, rocker, link, chain and the iron it lifts against dry friction.

A motor turns a cam through a reducer ($\omega_m = i_g\,\omega$, $M = i_g\,\tau$). The cam moves the
small arm of a rocker. The end of its large arm pulls, through a link and a chain over a sprocket, an
iron that hangs in a vertical guide and is loaded by its weight and by a spring. The friction of the
guide is $K$ times the load $W_0 - m_y\ddot H$. The energies give the equation of motion

$$ (J + K m_y H'^2)\,\dot\omega + \left(\tfrac12 J' + K m_y H'H''\right)\omega^2
   = M - \Pi' + K W_0 H' $$

With `follower.lifts` the follower leaves a cam that turns too fast, flies, and lands on it again.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator
from enum import IntEnum
from functools import lru_cache
from math import atan, pi, radians
from typing import Any

from fmukit import Experiment, discrete, real, record, repeat, replace
from fmukit.runtime.jet import Jet, acos, atan2, constant, cos, sin, sqrt
from fmukit.si import (
    Acceleration,
    Angle,
    AngularVelocity,
    Energy,
    Force,
    Impulse,
    Inertia,
    Length,
    LinearDensity,
    Mass,
    Ratio,
    RotationalDamping,
    Time,
    Torque,
    TranslationalStiffness,
    Velocity,
)

EXPERIMENT = Experiment(stop=1.0, step=1e-3)
FLANGES = {"flange": ("tau", "w")}
#: Longest sub-step in s: at 10 rad/s the cam turns by 1/175 of its rise (100 degrees) in it.
LONGEST_STEP = 1e-3
TAU = ("tau",)


class Wrap(IntEnum):
    """Where the run of the chain meets the sprocket."""

    top = 0
    tangent = 1


class Side(IntEnum):
    """Side of the iron on which the spring pulls."""

    below = 1
    above = -1


class OnInvalid(IntEnum):
    """What to do where the follower lifts off or the chain goes slack."""

    stop = 0
    warn = 1


class Motion(IntEnum):
    """Motion of the iron."""

    dwell = 0
    up = 1
    down = 2
    stuck = 3


@record
class Cam:
    R_b: Length = real(
        0.100, "Distance from the cam's axis to the roller, iron down", positive=True
    )
    h: Length = real(
        0.020, "Increase of the distance from the cam's axis to the roller, iron up", min=0.0
    )
    rise: Angle = real(radians(100.0), "Cam angle of the rise, iron going up", positive=True)
    top: Angle = real(radians(60.0), "Cam angle of the top dwell", min=0.0)
    ret: Angle = real(radians(80.0), "Cam angle of the return, iron going down", positive=True)
    J: Inertia = real(0.0125, "Moment of inertia of the cam", positive=True)
    m: Mass = real(2.5, "Mass of the cam", positive=True)
    r: Length = real(0.008, "Distance of the cam's centre of mass from its axis", min=0.0)
    gamma: Angle = real(0.6, "Angle of the cam's centre of mass at phi = 0")


@record
class Rocker:
    L: Length = real(0.150, "Distance between the axes of cam and rocker", positive=True)
    l: Length = real(0.090, "Length of the rocker's small arm, to the roller", positive=True)
    l_K: Length = real(0.280, "Length of the rocker's large arm, to the link", positive=True)
    alpha0: Angle = real(2.38, "Angle of the large arm with the small arm towards the cam's axis")
    J: Inertia = real(0.025, "Moment of inertia of the rocker about its axis", positive=True)
    m: Mass = real(1.2, "Mass of the rocker", positive=True)
    r: Length = real(0.090, "Distance of the rocker's centre of mass from its axis", min=0.0)
    gamma: Angle = real(0.10, "Angle of the rocker's centre of mass from the large arm")


@record
class Link:
    l: Length = real(0.200, "Length of the link", positive=True)
    m: Mass = real(0.25, "Mass of the link", positive=True)
    J: Inertia = real(
        0.25 * 0.2**2 / 12, "Moment of inertia of the link about its centre", positive=True
    )


@record
class Chain:
    l: Length = real(0.700, "Length of the chain", positive=True)
    rho: LinearDensity = real(0.70, "Mass of the chain per unit length", positive=True)


@record
class Sprocket:
    A: Length = real(0.280, "Height of the sprocket's axis above the rocker's", positive=True)
    C: Length = real(0.400, "Distance of the sprocket's axis left of the rocker's", positive=True)
    R: Length = real(0.0127 / (2 * sin(pi / 20)), "Pitch radius of the sprocket", positive=True)
    J: Inertia = real(6.0e-4, "Moment of inertia of the sprocket", positive=True)


@record
class Iron:
    m: Mass = real(4.0, "Mass of the iron", positive=True)


@record
class Spring:
    c: TranslationalStiffness = real(300.0, "Stiffness of the spring", min=0.0)
    e_0: Length = real(0.080, "Stretch of the spring with the iron down")
    m: Mass = real(0.15, "Mass of the spring", min=0.0)
    side: Side = discrete(Side.below, "Spring below (1) or above the iron (-1)")


@record
class Friction:
    K_down: Ratio = real(
        -0.0747, "Ratio of friction to load with the iron going down", tunable=True
    )
    K_up: Ratio = real(0.089, "Ratio of friction to load with the iron going up", tunable=True)


@record
class Reducer:
    i_g: Ratio = real(36.0, "Gear ratio, speed of the motor over speed of the cam", positive=True)
    J: Inertia = real(
        3.0e-4, "Moment of inertia of rotor and reducer, at the motor's shaft", positive=True
    )


@record
class Follower:
    lifts: bool = discrete(False, "The follower may lift off the cam, fly and land on it")
    e: Ratio = real(
        0.3,
        "Restitution of a landing: impulse of rebound over impulse of approach",
        min=0.0,
        max=1.0,
        tunable=True,
    )
    v: Velocity = real(
        1e-3,
        "Rebound speed below which the follower stays on the cam",
        positive=True,
        tunable=True,
    )


@record
class Joints:
    cam: RotationalDamping = real(0.0, "Viscous friction of the cam's shaft", min=0.0, tunable=True)
    rocker: RotationalDamping = real(
        0.0, "Viscous friction of the rocker's axis", min=0.0, tunable=True
    )
    link: RotationalDamping = real(
        0.0, "Viscous friction between rocker and link", min=0.0, tunable=True
    )
    sprocket: RotationalDamping = real(
        0.0, "Viscous friction of the sprocket's axis", min=0.0, tunable=True
    )


@record
class Parameters:
    wrap: Wrap = discrete(
        Wrap.top, "The chain meets the sprocket at its top (0) or tangentially (1)"
    )
    on_invalid: OnInvalid = discrete(
        OnInvalid.stop,
        "If the follower would have to pull or the chain to push: stop (0) or warn (1)",
        tunable=True,
    )
    g: Acceleration = real(9.80665, "Gravity", positive=True)
    reducer: Reducer
    cam: Cam
    rocker: Rocker
    link: Link
    chain: Chain
    sprocket: Sprocket
    iron: Iron
    spring: Spring
    friction: Friction
    follower: Follower
    joints: Joints


@record
class Inputs:
    tau: Torque = real(0.1, "Torque of the motor at its shaft, in the sense of +phi")


@record
class State:
    phi: Angle = real(-pi / 3, "Angle of the cam, 0 where the rise begins", nominal=1.0)
    w_cam: AngularVelocity = real(0.0, "Speed of the cam", nominal=1.0)
    E_friction: Energy = real(0.0, "Energy dissipated by friction in the guide", nominal=1.0)
    direction: int = discrete(
        0,
        "Sense of motion of the cam, in flight of the rocker: 1 along its angle, -1 against it, 0 stuck",
    )
    valid: bool = discrete(True, "Follower and chain are loaded, so the equations hold")
    gap: Angle = real(0.0, "Angle by which the rocker is off the cam", min=0.0, nominal=0.1)
    w_gap: AngularVelocity = real(
        0.0, "Rate of the angle by which the rocker is off the cam", nominal=1.0
    )
    E_joints: Energy = real(0.0, "Energy dissipated by friction in the joints", nominal=1.0)
    t_flight: Time = real(0.0, "Total time that the follower has been off the cam", nominal=1.0)
    E_landing: Energy = real(0.0, "Energy lost between cam and follower in landings", held=True)
    v_landing: Velocity = real(
        0.0, "Speed of the last landing, along the contact's normal", held=True
    )
    S_landing: Impulse = real(
        0.0, "Impulse of the cam on the follower at the last landing", held=True
    )
    landings: int = discrete(0, "Number of landings")
    flying: bool = discrete(False, "The follower is off the cam")


@record
class Outputs:
    w: AngularVelocity = real(0.0, "Speed of the motor's shaft")
    alpha: Angle = real(0.0, "Angle of the rocker's large arm")
    beta: Angle = real(0.0, "Angle of the link and of the chain's run to the sprocket")
    H: Length = real(0.0, "Hanging length of the chain")
    lift: Length = real(0.0, "Lift of the iron")
    v: Velocity = real(0.0, "Velocity of the iron, upwards")
    a: Acceleration = real(0.0, "Acceleration of the iron, upwards", feedthrough=TAU)
    tau_cam: Torque = real(
        0.0,
        "Torque at the cam: geared motor torque less the inertia torque of rotor and reducer",
        feedthrough=TAU,
    )
    T_iron: Force = real(0.0, "Pull of the chain on the iron", feedthrough=TAU)
    T_hang: Force = real(
        0.0, "Pull of the chain on the sprocket, on the iron's side", feedthrough=TAU
    )
    T_span: Force = real(
        0.0, "Pull of the chain on the sprocket, on the link's side", feedthrough=TAU
    )
    M_rocker: Torque = real(
        0.0, "Torque of the cam on the rocker, negative while they touch", feedthrough=TAU
    )
    N: Force = real(0.0, "Force between cam and follower", feedthrough=TAU)
    pressure: Angle = real(0.0, "Pressure angle between cam and follower, signed")
    E_kin: Energy = real(0.0, "Kinetic energy of the drive")
    E_pot: Energy = real(0.0, "Potential energy of the drive's weights and spring")
    motion: Motion = discrete(Motion.dwell, "Motion of the iron")
    top_dwell: bool = discrete(False, "The cam is in its top dwell")
    alpha_1: Ratio = real(0.0, "First derivative of alpha by phi, with the follower on the cam")
    alpha_2: Ratio = real(0.0, "Second derivative of alpha by phi, with the follower on the cam")
    beta_1: Ratio = real(0.0, "First derivative of beta by phi, with the follower on the cam")
    beta_2: Ratio = real(0.0, "Second derivative of beta by phi, with the follower on the cam")
    H_1: Length = real(
        0.0, "First derivative of H by phi, per radian, with the follower on the cam"
    )
    H_2: Length = real(
        0.0, "Second derivative of H by phi, per radian squared, with the follower on the cam"
    )
    A_1: Inertia = real(0.0, "Coefficient of the cam's acceleration in the equation of motion")
    B_1: Inertia = real(0.0, "Coefficient of the cam's squared speed in the equation of motion")
    C_1: Torque = real(0.0, "Torque of weights, spring and friction in the equation of motion")


def check(p: Parameters) -> Iterator[str]:
    """Refuse a mechanism that cannot close or turn; warn of a run too steep for `wrap = top`."""
    c, r, K = p.cam, p.rocker, p.friction
    if (turn := c.rise + c.top + c.ret) > 2 * pi * (1 + 1e-12):
        raise ValueError(
            f"cam angles exceed one revolution: cam.rise + cam.top + cam.ret = {turn!r} rad"
        )
    low, high = abs(r.L - r.l), r.L + r.l
    if not low < c.R_b <= c.R_b + c.h < high:
        raise ValueError(
            f"cam triangle cannot close: cam.R_b = {c.R_b!r} m must be > {low!r} m and, with "
            f"cam.h = {c.h!r} m added, < {high!r} m: difference and sum of rocker.L and rocker.l"
        )
    if not -1.0 < K.K_down <= 0.0 <= K.K_up:
        raise ValueError(
            "friction: -1 < K_down <= 0 <= K_up violated: "
            f"friction.K_down = {K.K_down!r}, friction.K_up = {K.K_up!r}"
        )
    turns(p)
    slope = pi - min(position(p, phi).beta.value for phi in (0.0, c.rise))
    if p.wrap == Wrap.top and slope > 0.25:
        yield f"the run to the sprocket rises by {slope!r} rad: wrap = top (0) is a poor assumption"


@lru_cache(maxsize=16)
def turns(p: Parameters) -> bool:
    """True; raises ValueError at the first obstacle in a turn in steps of half a degree."""

    def passed(step: int) -> tuple[bool, int]:
        passes(p, radians(step / 2))
        return step >= 719, step + 1

    repeat(passed, 0)
    return True


def passes(p: Parameters, phi: float) -> bool:
    """True; raises ValueError if something is in the way at this cam angle."""
    for free, otherwise in conditions(p, phi):
        if not free:
            raise ValueError(f"{otherwise} at phi = {phi!r} rad")
    return True


def conditions(p: Parameters, phi: float) -> Iterator[tuple[bool, str]]:
    """Conditions at this cam angle, each with what is in the way if it is false."""
    alpha, R = rocker(p, cam(p, phi)[2].value), p.sprocket.R
    X, Y = p.sprocket.C + p.rocker.l_K * cos(alpha), p.sprocket.A - p.rocker.l_K * sin(alpha)
    yield (
        X > 0.0,
        (
            "rocker end must stay on the far side of the sprocket: "
            f"sprocket.C + rocker.l_K cos(alpha) = {X!r} m"
        ),
    )
    if p.wrap == Wrap.tangent:
        free = sqrt(X * X + Y * Y) > R
        yield free, f"link reaches the sprocket: its end is within sprocket.R = {R!r} m of the axis"
    at = position(p, phi)
    n, l, H, e = at.n, p.link.l, at.H.value, at.e
    yield n > l, f"link reaches the sprocket: link.l = {l!r} m of a run of {n!r} m"
    yield (
        H > 0.0,
        f"chain too short: hanging part vanishes: H = {H!r} m with chain.l = {p.chain.l!r} m",
    )
    yield at.H_a > 0.0, f"dead centre: beta - alpha = {at.beta.value - alpha!r} rad"
    yield e >= 0.0, f"spring slack: stretch = {e!r} m with spring.e_0 = {p.spring.e_0!r} m"
    d = forces(p, at, 0.0, dynamics(p, at, 0.0, 0, at.Pi_1))
    pull = (1 + p.friction.K_down) * at.W_0
    taut = min(pull, pull + d.T_span - d.T_iron) > 0.0
    yield taut, f"chain slack at standstill: T_iron = {pull!r} N"


Position = namedtuple(  # all that the cam angle determines; alpha, beta and H are jets along it
    "Position",
    "slope top touch alpha n beta gamma H H_a H_aa lift e W_0 J_a J_aa J J_1 Pi Pi_a Pi_1 D_a D",
)
Dynamics = namedtuple("Dynamics", "eps K H_tt W")
Forces = namedtuple("Forces", "T_iron T_hang T_span M_rocker N")


def rise_profile(f: float, width: float) -> Jet:
    """Rise s along the angle f of a slope of this width; s', s'' and s''' vanish at both ends."""
    x = f / width
    square, both = x * x, x * (1 - x)
    s = square * square * (35 - 84 * x + 70 * square - 20 * square * x)
    s_1, s_2 = 140 * (both * both * both), 420 * (both * both) * (1 - 2 * x)
    return Jet(s, s_1 / width, s_2 / (width * width))


def cam(p: Parameters, phi: float) -> tuple[int, bool, Jet]:
    """Iron up (1), down (-1) or dwelling (0), whether at the top, and the distance R along phi."""
    c = p.cam
    f = phi % (2 * pi)
    if f < c.rise:
        return 1, False, c.R_b + c.h * rise_profile(f, c.rise)
    if f < c.rise + c.top:
        return 0, True, constant(c.R_b + c.h)
    if f < c.rise + c.top + c.ret:
        return -1, False, c.R_b + c.h - c.h * rise_profile(f - c.rise - c.top, c.ret)
    return 0, False, constant(c.R_b)


def rocker(p: Parameters, R: Any) -> Any:
    """Angle alpha of the large arm with the roller at the distance R."""
    L, l = p.rocker.L, p.rocker.l
    return p.rocker.alpha0 - acos((L * L + l * l - R * R) / (2 * L * l))


def contact(p: Parameters) -> tuple[float, float]:
    """How far above and beside the sprocket's axis the run ends."""
    R = p.sprocket.R
    return (R, 0 * R) if p.wrap == Wrap.top else (0 * R, R)


def run(p: Parameters, x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """Length n and angle beta of the run from x, y, angle gamma on the sprocket, hanging length H."""
    above, tangent_radius = contact(p)
    X, Y = p.sprocket.C + x, p.sprocket.A + above - y
    n = sqrt(X * X + Y * Y - tangent_radius * tangent_radius)
    beta = pi - atan2(Y, X) - atan2(tangent_radius, n)
    gamma = pi / 2 + 0 * beta if p.wrap == Wrap.top else 3 * pi / 2 - beta
    return n, beta, gamma, p.chain.l - (n - p.link.l) - p.sprocket.R * gamma


@lru_cache(maxsize=16)
def lowest(p: Parameters) -> float:
    """Hanging length H_b of the chain with the iron down."""
    alpha = rocker(p, p.cam.R_b)
    H: float = run(p, p.rocker.l_K * cos(alpha), p.rocker.l_K * sin(alpha))[-1]
    return H


def prepare(p: Parameters, x: State) -> float:
    """What all evaluations within a step have in common."""
    return lowest(p)


def position(p: Parameters, phi: float) -> Position:
    """The position at the cam angle phi, with the follower on the cam."""
    return placed(p, phi, 0.0, lowest(p))


def placed(p: Parameters, phi: float, gap: float, H_b: float) -> Position:
    """The position at a cam angle and a gap; H_b is the hanging length with the iron down."""
    g, r, T, rho, z, s = p.g, p.rocker, p.link, p.chain.rho, p.sprocket, p.spring
    slope, top, R = cam(p, phi)
    alpha = rocker(p, R) - gap
    x_K, y_K = r.l_K * cos(alpha.value), r.l_K * sin(alpha.value)
    y = Jet(y_K, x_K, -y_K)
    n, beta, gamma, H = run(p, Jet(x_K, -y_K, -x_K), y)

    moving = T.m + rho * p.chain.l + z.J / (z.R * z.R) + p.iron.m + s.m / 3
    turning = T.J + T.m * (n - T.l / 2) ** 2 + rho / 3 * (n - T.l) ** 3
    J_a = r.J + turning * beta.rate**2 + moving * H.rate**2

    lift, up = H_b - H, sin(beta)
    e = s.e_0 + s.side * lift
    chain = (n - T.l) * (y + up * ((n + T.l) / 2) - z.A) + z.R * z.R * (1 - cos(gamma)) - H**2 / 2
    level, hanging = (rho * p.chain.l + p.iron.m) * z.A, p.iron.m + s.m / 2
    centre = Jet(alpha.value + r.gamma, 1.0, 0.0)
    Pi = s.c / 2 * e**2 + g * (
        r.m * r.r * sin(centre) + T.m * (y + up * (T.l / 2)) + rho * chain - hanging * H + level
    )
    W_0 = hanging * g + s.side * s.c * e.value
    J = J_a.along(alpha) * alpha.rate**2 + p.reducer.J * p.reducer.i_g * p.reducer.i_g + p.cam.J
    Pi_1 = g * p.cam.m * p.cam.r * cos(phi + p.cam.gamma) + Pi.first * alpha.first
    joints, wound = p.joints, H.first / z.R
    D_a = joints.rocker + joints.link * (beta.first - 1) ** 2 + joints.sprocket * wound * wound
    return Position(
        slope, top, 1.0, alpha, n.value, beta.along(alpha), gamma.value, H.along(alpha), H.first,
        H.second, lift.value, e.value, W_0, J_a.value, J_a.first, J.value, J.first, Pi.value,
        Pi.first, Pi_1, D_a, joints.cam + D_a * alpha.first * alpha.first,
    )  # fmt: skip


def along_iron(p: Parameters, x: State, at: Position, M: float) -> tuple[Position, float, float]:
    """Position, speed and torque along the angle that the iron follows, in flight the rocker's."""
    if not x.flying:
        return at, x.w_cam, M
    along_rocker = at._replace(
        slope=-1, touch=0.0, alpha=Jet(at.alpha.value, 1.0, 0.0),
        H=Jet(at.H.value, at.H_a, at.H_aa), J=at.J_a, J_1=at.J_aa, Pi_1=at.Pi_a, D=at.D_a,
    )  # fmt: skip
    return along_rocker, at.alpha.first * x.w_cam - x.w_gap, 0 * M


def friction(p: Parameters, at: Position, direction: float) -> float:
    """Coefficient K with the cam turning in this direction."""
    up = at.slope * direction
    return p.friction.K_up if up > 0 else p.friction.K_down if up < 0 else 0.0


def thresholds(p: Parameters, at: Position, M: float) -> tuple[float, float]:
    """g_+ and g_-: the torque that is left to start forwards, and to start backwards."""
    rest, weight = M - at.Pi_1, at.W_0 * at.H.first
    return rest + friction(p, at, 1) * weight, rest + friction(p, at, -1) * weight


def sense(p: Parameters, at: Position, w: float, M: float) -> int:
    """Direction in which the cam moves or starts from rest; 0 where it sticks."""
    forwards, backwards = (w, w) if w else thresholds(p, at, M)
    return 1 if forwards > 0.0 else -1 if backwards < 0.0 else 0


def dynamics(p: Parameters, at: Position, w: float, direction: float, M: float) -> Dynamics:
    """Acceleration along the position, friction K, second derivative of H by time, load W."""
    m, H = p.iron.m, at.H
    if direction:
        K = friction(p, at, direction)
        A = at.J + K * m * H.first * H.first
        B = at.J_1 / 2 + K * m * H.first * H.second
        eps = (M - at.Pi_1 + K * at.W_0 * H.first - B * w * w - at.D * w) / A
    else:
        K = (at.Pi_1 - M) / (at.W_0 * H.first) if H.first else 0.0
        K, eps = min(max(K, p.friction.K_down), p.friction.K_up), 0.0
    H_tt = H.first * eps + H.second * w * w
    return Dynamics(eps, K, H_tt, at.W_0 - m * H_tt)


def slip(p: Parameters, alpha: Jet) -> tuple[float, float]:
    """Velocity of the cam under the follower over the cam's speed: across and along the small arm."""
    L, l, psi = p.rocker.L, p.rocker.l, p.rocker.alpha0 - alpha.value
    return L * sin(psi), l * (1 - alpha.first) - L * cos(psi)


def forces(p: Parameters, at: Position, w: float, d: Dynamics) -> Forces:
    """Forces of chain and follower, torque on the rocker."""
    rho, z, alpha = p.chain.rho, p.sprocket, at.alpha
    T_iron = (1 + d.K) * d.W - p.spring.m / 3 * d.H_tt
    T_hang = T_iron + rho * at.H.value * (p.g - d.H_tt)
    wrapped = z.J / (z.R * z.R) + rho * z.R * at.gamma
    T_span = T_hang + rho * p.g * z.R * sin(at.gamma) - wrapped * d.H_tt
    T_span = T_span - p.joints.sprocket / (z.R * z.R) * at.H.first * w
    alpha_t, alpha_tt = alpha.first * w, alpha.first * d.eps + alpha.second * w * w
    M_rocker = at.J_a * alpha_tt + at.J_aa * alpha_t * alpha_t / 2 + at.Pi_a
    M_rocker = (M_rocker - d.K * d.W * at.H_a + at.D_a * alpha_t) * at.touch
    across, along = slip(p, alpha)
    N = -M_rocker * sqrt(across * across + along * along) / (p.rocker.l * across)
    return Forces(T_iron, T_hang, T_span, M_rocker, N)


def lever(p: Parameters, alpha: Jet) -> float:
    """Lever arm of the contact's normal about the rocker's axis."""
    across, along = slip(p, alpha)
    return p.rocker.l * across / sqrt(across * across + along * along)


def shaft(p: Parameters) -> float:
    """Moment of inertia of cam, reducer and rotor at the cam's shaft."""
    return p.reducer.J * p.reducer.i_g * p.reducer.i_g + p.cam.J


def acceleration(p: Parameters, x: State, d: Dynamics, M: float) -> float:
    """Acceleration of the cam, which in flight is coupled only to the motor."""
    if not x.flying:
        eps: float = d.eps
        return eps
    weight = p.g * p.cam.m * p.cam.r * cos(x.phi + p.cam.gamma)
    return (M - weight - p.joints.cam * x.w_cam) / shaft(p)


def instant(
    p: Parameters, x: State, u: Inputs, H_b: float
) -> tuple[Position, Position, float, float, Dynamics]:
    """Position along the cam; position, speed and torque as the iron sees them, and its dynamics."""
    at = placed(p, x.phi, x.gap, H_b)
    iron_position, w, M = along_iron(p, x, at, p.reducer.i_g * u.tau)
    return at, iron_position, w, M, dynamics(p, iron_position, w, x.direction, M)


def derivatives(p: Parameters, t: float, x: State, u: Inputs, H_b: float | None = None) -> State:
    at, iron_position, w, _, d = instant(p, x, u, lowest(p) if H_b is None else H_b)
    eps = acceleration(p, x, d, p.reducer.i_g * u.tau)
    rocker_acceleration = iron_position.alpha.first * d.eps + iron_position.alpha.second * w * w
    gap_acceleration = (
        at.alpha.first * eps + at.alpha.second * x.w_cam * x.w_cam - rocker_acceleration
    )
    rate = iron_position.alpha.first * w
    heat = p.joints.cam * x.w_cam * x.w_cam + at.D_a * rate * rate
    loss = -d.K * d.W * iron_position.H.first * w
    return replace(
        x, phi=x.w_cam, w_cam=eps, E_friction=loss, gap=x.w_gap, w_gap=gap_acceleration, E_joints=heat,
        t_flight=1.0 if x.flying else 0.0,
    )  # fmt: skip


def invalid_reason(p: Parameters, x: State, at: Position, W: float, f: Forces) -> str:
    """A message on what has lost its load or its place; empty if nothing has."""
    where = f"at phi = {x.phi!r} rad, omega = {x.w_cam!r} rad/s"
    if f.N < 0.0 and not p.follower.lifts:
        return f"cam follower lifts off {where}: N = {f.N!r} N"
    if min(at.H.value, at.H_a) < 0.0:
        far = f"H = {at.H.value!r} m, beta - alpha = {at.beta.value - at.alpha.value!r} rad"
        return f"the follower flies too far {where}: {far}"
    slack = ", ".join(
        f"{name} = {pull!r} N"
        for name, pull in (("W", W), ("T_iron", f.T_iron), ("T_span", f.T_span))
        if pull < 0.0
    )
    return f"chain slack {where}: {slack}" if slack else ""


def with_validity(p: Parameters, x: State, u: Inputs) -> State:
    """The state with `valid` set from the forces; raises ValueError if the run is to stop."""
    _, iron_position, w, _, d = instant(p, x, u, lowest(p))
    reason = invalid_reason(p, x, iron_position, d.W, forces(p, iron_position, w, d))
    if reason and p.on_invalid == OnInvalid.stop:
        raise ValueError(reason)
    return replace(x, valid=not reason)


def directed(p: Parameters, x: State, u: Inputs) -> State:
    """The state with the direction in which the cam, in flight the rocker, moves or starts."""
    at = placed(p, x.phi, x.gap, lowest(p))
    return replace(x, direction=sense(p, *along_iron(p, x, at, p.reducer.i_g * u.tau)))


def sample(p: Parameters, t: float, x: State, before: Inputs | None, now: Inputs) -> State:
    """Set the direction of a start from rest; at the beginning also flight and validity."""
    if before is None:
        flying = x.gap > 0.0 or x.w_gap != 0.0
        if flying and not (p.follower.lifts and (x.gap > 0.0 or x.w_gap > 0.0)):
            raise ValueError(
                f"gap = {x.gap!r} rad, w_gap = {x.w_gap!r} rad/s: the follower can be off the cam "
                "only with follower.lifts, and cannot move into the cam"
            )
        x = replace(x, flying=flying)
        return with_validity(p, directed(p, x, now), now)
    return directed(p, x, now) if x.w_cam == 0.0 else x


def event_indicators(p: Parameters, t: float, x: State, u: Inputs) -> tuple[float, float, float]:
    """Below zero where the motion of the iron, the validity of the model or the contact changes.

    The first is that of what drives the iron, which leaves its direction or its rest; the second that
    of the model, which loses or regains validity; the third that of the follower, which leaves or
    meets the cam.
    """
    _, iron_position, w, M, d = instant(p, x, u, lowest(p))
    f = forces(p, iron_position, w, d)
    forwards, backwards = thresholds(p, iron_position, M)
    held = x.direction * w if x.direction else min(-forwards, backwards)
    margin = min(f.T_span, f.T_iron, d.W)
    separation, margin = (
        (x.gap if x.flying else f.N, min(margin, iron_position.H.value, iron_position.H_a))
        if p.follower.lifts
        else (1.0, min(margin, f.N))
    )
    return held, margin if x.valid else -margin, separation


def event_update(p: Parameters, t: float, x: State, u: Inputs, which: int) -> State:
    if which == 1:
        return with_validity(p, x, u)
    if which == 2:
        return directed(p, landed(p, x) if x.flying else replace(x, flying=True), u)
    return directed(p, stopped(p, x), u)


def stopped(p: Parameters, x: State) -> State:
    """The state with the cam, in flight the rocker, at rest."""
    if not x.flying:
        return replace(x, w_cam=0.0)
    return replace(x, w_gap=placed(p, x.phi, x.gap, lowest(p)).alpha.first * x.w_cam)


def landed(p: Parameters, x: State) -> State:
    """The state after the follower has met the cam: an impact with Poisson's restitution.

    The impulse acts on the rocker against alpha and, times alpha', on the cam's shaft. The friction of
    the guide takes its share, with K_down until the iron stands still and with K_up from then on.
    """
    at, J_c, K, approach = position(p, x.phi), shaft(p), p.friction, x.w_gap
    a_1, arm, load = at.alpha.first, lever(p, at.alpha), p.iron.m * at.H_a * at.H_a
    down, up = at.J_a + K.K_down * load, at.J_a + K.K_up * load
    yields_down, yields_up = a_1 * a_1 / J_c + 1 / down, a_1 * a_1 / J_c + 1 / up

    first = a_1 * x.w_cam - approach
    until_it_stands = max(first, 0 * first) * down
    first_impulse = min(-approach / yields_down, until_it_stands)
    stopping_impulse = first_impulse - (approach + first_impulse * yields_down) / yields_up
    total_impulse = stopping_impulse * (1 + p.follower.e)
    P_down = min(total_impulse, until_it_stands)
    parting = approach + P_down * yields_down + (total_impulse - P_down) * yields_up
    leaves = parting * arm >= p.follower.v
    P = total_impulse if leaves else stopping_impulse
    P_down, parting = min(P, until_it_stands), parting if leaves else 0 * parting
    between, P_up = approach + P_down * yields_down, P - P_down
    stands = first - P_down / down
    last = stands - P_up / up
    rubbed = K.K_up * (last * last - stands * stands) - K.K_down * (first * first - stands * stands)
    return replace(
        x,
        w_cam=x.w_cam + a_1 * P / J_c,
        gap=0 * x.gap,
        w_gap=parting,
        flying=leaves,
        landings=x.landings + 1,
        v_landing=-approach * arm,
        S_landing=P / arm,
        E_landing=x.E_landing - (P_down * (approach + between) + P_up * (between + parting)) / 2,
        E_friction=x.E_friction + load * rubbed / 2,
    )


def notes(p: Parameters, t: float, old: State, new: State, u: Inputs) -> Iterator[str]:
    if old.valid and not new.valid:
        _, iron_position, w, _, d = instant(p, new, u, lowest(p))
        reason = invalid_reason(p, new, iron_position, d.W, forces(p, iron_position, w, d))
        yield f"{reason}, t = {t!r} s; the results are not valid until all is loaded again"


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    i_g, tau, H_b = p.reducer.i_g, p.reducer.i_g * u.tau, lowest(p)
    on, at = placed(p, x.phi, 0 * x.gap, H_b), placed(p, x.phi, x.gap, H_b)
    iron_position, w, M = along_iron(p, x, at, tau)
    forward = x.direction if w == 0 else 1 if w > 0 else -1
    d = dynamics(p, iron_position, w, forward, M)
    up = iron_position.slope * forward
    moving = Motion.up if up > 0 else Motion.down if up < 0 else Motion.stuck
    eps = acceleration(p, x, d, tau)
    across, along = slip(p, on.alpha)
    K = friction(p, on, x.direction if x.w_cam == 0 else 1 if x.w_cam > 0 else -1)
    H, m = on.H, p.iron.m
    shaft_energy = shaft(p) * x.w_cam * x.w_cam / 2 if x.flying else 0 * on.J * w * w
    return Outputs(
        w=i_g * x.w_cam,
        alpha=at.alpha.value,
        beta=at.beta.value,
        H=at.H.value,
        lift=at.lift,
        v=-iron_position.H.first * w,
        a=-d.H_tt,
        tau_cam=tau - i_g * i_g * p.reducer.J * eps,
        **forces(p, iron_position, w, d)._asdict(),
        pressure=atan(along / across),
        E_kin=iron_position.J * w * w / 2 + shaft_energy,
        E_pot=at.Pi + p.g * p.cam.m * p.cam.r * sin(x.phi + p.cam.gamma),
        motion=moving if iron_position.slope else Motion.dwell,
        top_dwell=at.top,
        alpha_1=on.alpha.first,
        alpha_2=on.alpha.second,
        beta_1=on.beta.first,
        beta_2=on.beta.second,
        H_1=H.first,
        H_2=H.second,
        A_1=on.J + K * m * H.first * H.first,
        B_1=on.J_1 / 2 + K * m * H.first * H.second,
        C_1=K * on.W_0 * H.first - on.Pi_1,
    )
