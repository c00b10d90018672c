r"""Cam drive of a sealing iron: cam, rocker, link, chain and the iron it lifts against dry friction

A motor turns a cam through a reducer ($\omega_m = i_g\,\omega$, $M = i_g\,\tau$). The cam moves the
small arm of a rocker; the end of its large arm pulls, through a link and a chain over a sprocket, an
iron that hangs in a vertical guide, loaded by its weight and by a spring. From the energies, with the
friction $K$ of the guide, which is proportional to the load $W_0 - m_y\ddot H$,

$$ (J + K m_y H'^2)\,\dot\omega + \left(\tfrac12 J' + K m_y H'H''\right)\omega^2
   = M - \Pi' + K W_0 H' $$
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator
from enum import IntEnum
from functools import lru_cache
from math import atan, pi, radians
from typing import Any

from fmukit import Experiment, discrete, real, record, repeat, replace
from fmukit.si import (
    Acceleration,
    Angle,
    AngularVelocity,
    Energy,
    Force,
    Inertia,
    Length,
    LinearDensity,
    Mass,
    Ratio,
    Torque,
    TranslationalStiffness,
    Velocity,
)
from fmukit.step.jet import Jet, acos, atan2, constant, cos, sin, sqrt

EXPERIMENT = Experiment(stop=1.0, step=1e-3)
FLANGES = {"flange": ("tau", "w")}
LONGEST_STEP = 1e-3
TAU = ("tau",)


class Wrap(IntEnum):
    """Where the run of the chain meets the sprocket"""

    top = 0
    tangent = 1


class Side(IntEnum):
    """Side of the iron on which the spring pulls"""

    below = 1
    above = -1


class OnInvalid(IntEnum):
    """What to do where the follower lifts off or the chain goes slack"""

    stop = 0
    warn = 1


class Motion(IntEnum):
    """Motion of the iron"""

    dwell = 0
    up = 1
    down = 2
    stuck = 3


@record
class Cam:
    R_b: Length = real(0.100, "Distance from cam to roller with the iron down", positive=True)
    h: Length = real(0.020, "Rise of the distance from cam to roller", min=0.0)
    rise: Angle = real(radians(100.0), "Cam angle of the rise, iron up", positive=True)
    top: Angle = real(radians(60.0), "Cam angle of the top dwell", min=0.0)
    ret: Angle = real(radians(80.0), "Cam angle of the return, iron down", positive=True)
    J: Inertia = real(0.0125, "Moment of inertia of the cam", positive=True)
    m: Mass = real(2.5, "Mass of the cam", positive=True)
    r: Length = real(0.008, "Distance of the cam's centre of mass from its axis", min=0.0)
    gamma: Angle = real(0.6, "Angle of the cam's centre of mass at phi = 0")


@record
class Rocker:
    L: Length = real(0.150, "Distance between the axes of cam and rocker", positive=True)
    l: Length = real(0.090, "Length of the rocker's small arm, to the roller", positive=True)
    l_K: Length = real(0.280, "Length of the rocker's large arm, to the link", positive=True)
    alpha0: Angle = real(2.38, "Angle of the large arm that would put the roller on the cam's axis")
    J: Inertia = real(0.025, "Moment of inertia of the rocker about its axis", positive=True)
    m: Mass = real(1.2, "Mass of the rocker", positive=True)
    r: Length = real(0.090, "Distance of the rocker's centre of mass from its axis", min=0.0)
    gamma: Angle = real(0.10, "Angle of the rocker's centre of mass from the large arm")


@record
class Link:
    l: Length = real(0.200, "Length of the link", positive=True)
    m: Mass = real(0.25, "Mass of the link", positive=True)
    J: Inertia = real(
        0.25 * 0.2**2 / 12, "Moment of inertia of the link about its middle", positive=True
    )


@record
class Chain:
    l: Length = real(0.700, "Length of the chain", positive=True)
    rho: LinearDensity = real(0.70, "Mass of the chain per length", positive=True)


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
    K_down: Ratio = real(-0.0747, "Friction over load with the iron going down")
    K_up: Ratio = real(0.089, "Friction over load with the iron going up")


@record
class Reducer:
    i_g: Ratio = real(36.0, "Speed of the motor over speed of the cam", positive=True)
    J: Inertia = real(3.0e-4, "Moment of inertia of rotor and reducer, at the motor", positive=True)


@record
class Parameters:
    wrap: Wrap = discrete(Wrap.top, "Run to the top (0) or on the tangent (1) of the sprocket")
    on_invalid: OnInvalid = discrete(
        OnInvalid.stop, "Where follower or chain would have to pull or push: stop (0) or warn (1)"
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


@record
class Inputs:
    tau: Torque = real(0.1, "Torque of the motor at its shaft, in the sense of +phi")


@record
class State:
    phi: Angle = real(-pi / 3, "Angle of the cam, 0 where the rise begins", nominal=1.0)
    w_cam: AngularVelocity = real(0.0, "Speed of the cam", nominal=1.0)
    E_friction: Energy = real(0.0, "Energy dissipated by friction in the guide", nominal=1.0)
    direction: int = discrete(0, "Sense of the cam's motion: 1 forwards, -1 backwards, 0 stuck")
    valid: bool = discrete(True, "Follower and chain are loaded, so that the equations hold")


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
        0.0, "Torque at the cam's shaft: geared motor torque less its inertia's", feedthrough=TAU
    )
    T_iron: Force = real(0.0, "Pull of the chain on the iron", feedthrough=TAU)
    T_hang: Force = real(0.0, "Pull of the chain on the sprocket, iron's side", feedthrough=TAU)
    T_span: Force = real(0.0, "Pull of the chain on the sprocket, link's side", feedthrough=TAU)
    M_rocker: Torque = real(
        0.0, "Torque of the cam on the rocker, negative while they touch", feedthrough=TAU
    )
    N: Force = real(0.0, "Force between cam and follower", feedthrough=TAU)
    pressure: Angle = real(0.0, "Pressure angle between cam and follower, with sign")
    E_kin: Energy = real(0.0, "Kinetic energy of the drive")
    E_pot: Energy = real(0.0, "Potential energy of the drive, weights and spring")
    motion: Motion = discrete(Motion.dwell, "Motion of the iron")
    top_dwell: bool = discrete(False, "The cam is in its top dwell")


def check(p: Parameters) -> Iterator[str]:
    """Refuse a mechanism that does not close or not turn; warn of a run too steep for `top`."""
    c, r, K = p.cam, p.rocker, p.friction
    if (turn := c.rise + c.top + c.ret) > 2 * pi * (1 + 1e-12):
        raise ValueError(
            f"cam angles exceed one revolution: cam.rise + cam.top + cam.ret = {turn!r} rad"
        )
    low, high = abs(r.L - r.l), r.L + r.l
    if not low < c.R_b <= c.R_b + c.h < high:
        raise ValueError(
            f"cam triangle cannot close: cam.R_b = {c.R_b!r} m must be > {low!r} m and with "
            f"cam.h = {c.h!r} m < {high!r} m, difference and sum of rocker.L and rocker.l"
        )
    if not -1.0 < K.K_down <= 0.0 <= K.K_up:
        raise ValueError(
            "friction: -1 < K_down <= 0 <= K_up violated: "
            f"friction.K_down = {K.K_down!r}, friction.K_up = {K.K_up!r}"
        )
    turns(p)
    slope = pi - min(position(p, phi).beta for phi in (0.0, c.rise))
    if p.wrap == Wrap.top and slope > 0.25:
        yield f"the run to the sprocket rises by {slope!r} rad: wrap = top (0) is a poor assumption"


@lru_cache(maxsize=16)
def turns(p: Parameters) -> bool:
    """True; raises ValueError for what is in the way first in a turn in steps of half a degree."""

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
    """What must be true at this cam angle, and what is in the way otherwise."""
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
    yield n > l, f"link reaches the sprocket: link.l = {l!r} m of {n!r} m"
    yield (
        H > 0.0,
        f"chain too short: hanging part vanishes: H = {H!r} m of chain.l = {p.chain.l!r} m",
    )
    yield at.H_a > 0.0, f"dead centre: beta - alpha = {at.beta - alpha!r} rad"
    yield e >= 0.0, f"spring slack: stretch = {e!r} m with spring.e_0 = {p.spring.e_0!r} m"
    d = forces(p, at, 0.0, dynamics(p, at, 0.0, 0, at.Pi_1))
    pull = (1 + p.friction.K_down) * at.W_0
    taut = min(pull, pull + d.T_span - d.T_iron) > 0.0
    yield taut, f"chain slack at standstill: T_iron = {pull!r} N"


Position = namedtuple(  # what the cam angle says; alpha and H are jets along it
    "Position", "slope top alpha n beta gamma H H_a lift e W_0 J_a J_aa J J_1 Pi Pi_a Pi_1"
)
Dynamics = namedtuple("Dynamics", "eps K H_tt W")
Forces = namedtuple("Forces", "T_iron T_hang T_span M_rocker N")


def law(f: float, width: float) -> Jet:
    """s along the angle f of a slope of this width; s', s'' and s''' vanish at both ends."""
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
        return 1, False, c.R_b + c.h * law(f, c.rise)
    if f < c.rise + c.top:
        return 0, True, constant(c.R_b + c.h)
    if f < c.rise + c.top + c.ret:
        return -1, False, c.R_b + c.h - c.h * law(f - c.rise - c.top, c.ret)
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
    above, beside = contact(p)
    X, Y = p.sprocket.C + x, p.sprocket.A + above - y
    n = sqrt(X * X + Y * Y - beside * beside)
    beta = pi - atan2(Y, X) - atan2(beside, n)
    gamma = pi / 2 + 0 * beta if p.wrap == Wrap.top else 3 * pi / 2 - beta
    return n, beta, gamma, p.chain.l - (n - p.link.l) - p.sprocket.R * gamma


@lru_cache(maxsize=16)
def lowest(p: Parameters) -> float:
    """Hanging length H_b of the chain with the iron down."""
    alpha = rocker(p, p.cam.R_b)
    H: float = run(p, p.rocker.l_K * cos(alpha), p.rocker.l_K * sin(alpha))[-1]
    return H


def prepare(p: Parameters, x: State) -> float:
    """What all evaluations of a step have in common."""
    return lowest(p)


def position(p: Parameters, phi: float) -> Position:
    """What the cam angle phi says."""
    return placed(p, phi, lowest(p))


def placed(p: Parameters, phi: float, H_b: float) -> Position:
    """What the cam angle phi says, with the hanging length H_b where the iron is down."""
    g, r, T, rho, z, s = p.g, p.rocker, p.link, p.chain.rho, p.sprocket, p.spring
    slope, top, R = cam(p, phi)
    alpha = rocker(p, R)
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
    return Position(
        slope, top, alpha, n.value, beta.value, gamma.value, H.along(alpha), H.first, lift.value,
        e.value, W_0, J_a.value, J_a.first, J.value, J.first, Pi.value, Pi.first, Pi_1,
    )  # fmt: skip


def friction(p: Parameters, at: Position, direction: float) -> float:
    """Coefficient K where the cam turns in this direction."""
    up = at.slope * direction
    return p.friction.K_up if up > 0 else p.friction.K_down if up < 0 else 0.0


def thresholds(p: Parameters, at: Position, M: float) -> tuple[float, float]:
    """g_+ and g_-: what is left of M to start forwards, and to start backwards."""
    rest, weight = M - at.Pi_1, at.W_0 * at.H.first
    return rest + friction(p, at, 1) * weight, rest + friction(p, at, -1) * weight


def sense(p: Parameters, at: Position, w: float, M: float) -> int:
    """Direction of the cam's motion, of its start from rest, or 0 where it sticks."""
    forwards, backwards = (w, w) if w else thresholds(p, at, M)
    return 1 if forwards > 0.0 else -1 if backwards < 0.0 else 0


def dynamics(p: Parameters, at: Position, w: float, direction: float, M: float) -> Dynamics:
    """Acceleration of the cam, friction K, second derivative of H by time, load W."""
    m, H = p.iron.m, at.H
    if direction:
        K = friction(p, at, direction)
        A = at.J + K * m * H.first * H.first
        B = at.J_1 / 2 + K * m * H.first * H.second
        eps = (M - at.Pi_1 + K * at.W_0 * H.first - B * w * w) / A
    else:
        K = (at.Pi_1 - M) / (at.W_0 * H.first) if H.first else 0.0
        K, eps = min(max(K, p.friction.K_down), p.friction.K_up), 0.0
    H_tt = H.first * eps + H.second * w * w
    return Dynamics(eps, K, H_tt, at.W_0 - m * H_tt)


def slip(p: Parameters, alpha: Jet) -> tuple[float, float]:
    """Speed of the cam beneath the follower over the cam's: across the small arm, and along it."""
    L, l, psi = p.rocker.L, p.rocker.l, p.rocker.alpha0 - alpha.value
    return L * sin(psi), l * (1 - alpha.first) - L * cos(psi)


def forces(p: Parameters, at: Position, w: float, d: Dynamics) -> Forces:
    """Forces of chain and follower, torque on the rocker."""
    rho, z, alpha = p.chain.rho, p.sprocket, at.alpha
    T_iron = (1 + d.K) * d.W - p.spring.m / 3 * d.H_tt
    T_hang = T_iron + rho * at.H.value * (p.g - d.H_tt)
    wrapped = z.J / (z.R * z.R) + rho * z.R * at.gamma
    T_span = T_hang + rho * p.g * z.R * sin(at.gamma) - wrapped * d.H_tt
    alpha_t, alpha_tt = alpha.first * w, alpha.first * d.eps + alpha.second * w * w
    M_rocker = at.J_a * alpha_tt + at.J_aa * alpha_t * alpha_t / 2 + at.Pi_a
    M_rocker = M_rocker - d.K * d.W * at.H_a
    across, along = slip(p, alpha)
    N = -M_rocker * sqrt(across * across + along * along) / (p.rocker.l * across)
    return Forces(T_iron, T_hang, T_span, M_rocker, N)


def instant(p: Parameters, x: State, u: Inputs) -> tuple[Position, Dynamics, Forces]:
    """Position, dynamics and forces of a state."""
    at = position(p, x.phi)
    d = dynamics(p, at, x.w_cam, x.direction, p.reducer.i_g * u.tau)
    return at, d, forces(p, at, x.w_cam, d)


def derivatives(p: Parameters, t: float, x: State, u: Inputs, H_b: float | None = None) -> State:
    at = position(p, x.phi) if H_b is None else placed(p, x.phi, H_b)
    d = dynamics(p, at, x.w_cam, x.direction, p.reducer.i_g * u.tau)
    loss = -d.K * d.W * at.H.first * x.w_cam
    return State(x.w_cam, d.eps, loss, 0, False)


def lost(x: State, W: float, f: Forces) -> str:
    """What has lost its load, empty if nothing has."""
    where = f"at phi = {x.phi!r} rad, omega = {x.w_cam!r} rad/s"
    if f.N < 0.0:
        return f"cam follower lifts off {where}: N = {f.N!r} N"
    slack = ", ".join(
        f"{name} = {pull!r} N"
        for name, pull in (("W", W), ("T_iron", f.T_iron), ("T_span", f.T_span))
        if pull < 0.0
    )
    return f"chain slack {where}: {slack}" if slack else ""


def judged(p: Parameters, x: State, u: Inputs) -> State:
    """The state with `valid` as the forces say; raises ValueError where it is to stop."""
    _, d, f = instant(p, x, u)
    reason = lost(x, d.W, f)
    if reason and p.on_invalid == OnInvalid.stop:
        raise ValueError(reason)
    return replace(x, valid=not reason)


def sample(p: Parameters, t: float, x: State, before: Inputs | None, now: Inputs) -> State:
    """The direction in which the cam starts from rest; at the beginning also the validity."""
    if before is None or x.w_cam == 0.0:
        direction = sense(p, position(p, x.phi), x.w_cam, p.reducer.i_g * now.tau)
        x = replace(x, direction=direction)
    return judged(p, x, now) if before is None else x


def guard(p: Parameters, t: float, x: State, u: Inputs) -> tuple[float, float]:
    """Below zero: the cam leaves its direction or its rest; the model loses or regains validity."""
    at, d, f = instant(p, x, u)
    forwards, backwards = thresholds(p, at, p.reducer.i_g * u.tau)
    held = x.direction * x.w_cam if x.direction else min(-forwards, backwards)
    margin = min(f.N, f.T_span, f.T_iron, d.W)
    return held, margin if x.valid else -margin


def jump(p: Parameters, t: float, x: State, u: Inputs, which: int) -> State:
    if which == 1:
        return judged(p, x, u)
    direction = sense(p, position(p, x.phi), 0.0, p.reducer.i_g * u.tau)
    return replace(x, w_cam=0.0, direction=direction)


def notes(p: Parameters, t: float, old: State, new: State, u: Inputs) -> Iterator[str]:
    if old.valid and not new.valid:
        _, d, f = instant(p, new, u)
        reason = lost(new, d.W, f)
        yield f"{reason}, t = {t!r} s; the results are not valid until it is loaded again"


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    w, i_g, at = x.w_cam, p.reducer.i_g, position(p, x.phi)
    direction = x.direction if w == 0 else 1 if w > 0 else -1
    up = at.slope * direction
    moving = Motion.up if up > 0 else Motion.down if up < 0 else Motion.stuck
    d = dynamics(p, at, w, direction, i_g * u.tau)
    across, along = slip(p, at.alpha)
    return Outputs(
        w=i_g * w,
        alpha=at.alpha.value,
        beta=at.beta,
        H=at.H.value,
        lift=at.lift,
        v=-at.H.first * w,
        a=-d.H_tt,
        tau_cam=i_g * u.tau - i_g * i_g * p.reducer.J * d.eps,
        **forces(p, at, w, d)._asdict(),
        pressure=atan(along / across),
        E_kin=at.J * w * w / 2,
        E_pot=at.Pi + p.g * p.cam.m * p.cam.r * sin(x.phi + p.cam.gamma),
        motion=moving if at.slope else Motion.dwell,
        top_dwell=at.top,
    )
