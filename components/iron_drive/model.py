r"""Cam drive of a sealing iron: cam, rocker, link, chain and the iron it lifts against dry friction

A motor turns a cam through a reducer ($\omega_m = i_g\,\omega$, $M = i_g\,\tau$). The cam moves the
small arm $l$ of a rocker; the end of its large arm $l_K$ pulls, through a link $l_T$ and a chain
over a sprocket at $(-C, A)$, an iron that hangs in a vertical guide, loaded by its weight and by a
spring. The origin is the axis of the rocker, $x$ to the right, $y$ up, angles counter-clockwise.
More distance $R$ from the cam's axis to the roller means iron up. $' = \mathrm{d}/\mathrm{d}\varphi$,
a subscript $\alpha$ is $\mathrm{d}/\mathrm{d}\alpha$, $\delta = \beta - \alpha$.

**Cam.** Rise, top dwell, return and bottom dwell follow one another; on the rise, with
$x = f/\varphi_{\mathrm{rise}}$ and $f = \varphi \bmod 2\pi$, and mirrored on the return,

$$ R = R_b + h\,s(x), \quad s = 35x^4 - 84x^5 + 70x^6 - 20x^7 $$

**Rocker.** With $q = L^2 + l^2 - R^2$ and $\Delta = 4L^2l^2 - q^2$,

$$ \psi = \arccos\frac{q}{2Ll}, \quad \alpha = \alpha_0 - \psi, \quad
   \alpha' = -\frac{2RR'}{\sqrt\Delta}, \quad \alpha'' = -\frac{2R}{\sqrt\Delta}
   \left[R'' + R'^2\left(\frac1R - \frac{2Rq}{\Delta}\right)\right] $$

**Run.** From the end of the rocker to the sprocket, $n$ long, turned by $\beta$, then the angle
$\gamma$ on the sprocket. `wrap = top` lets the run end at the top of the sprocket, so that
$\gamma = \pi/2$; `wrap = tangent` is exact. $X = C + l_K\cos\alpha$, $Y_0 = A - l_K\sin\alpha$:

$$ \mathrm{top}: \; n^2 = X^2 + (Y_0 + R_z)^2, \;
   \beta = \pi - \arctan\frac{Y_0 + R_z}{X}; \quad
   \mathrm{tangent}: \; n^2 = X^2 + Y_0^2 - R_z^2, \;
   \beta = \pi - \arctan\frac{Y_0}{X} - \arctan\frac{R_z}{n} = \frac{3\pi}{2} - \gamma $$

$$ H = l_c - (n - l_T) - R_z\gamma, \quad H_\alpha = l_K\sin\delta, \quad
   \beta_\alpha = -\frac{l_K\cos\delta}{n}, \quad
   \beta_{\alpha\alpha} = \frac{H_\alpha(\beta_\alpha - 1)}{n} + \frac{l_K\cos\delta\,n_\alpha}{n^2}, \quad
   n_\alpha = -H_\alpha \mathrm{\ or\ } -H_\alpha + R_z\beta_\alpha $$

**Inertia.** With $m_e = J_z/R_z^2 + \rho(R_z\gamma + H) + m_y + m_s/3$ for all that moves with the
iron, and $J_\alpha$ for all behind the cam,

$$ J_\alpha = J_r + m_T\left(l_K^2 + \frac{l_T^2\beta_\alpha^2}{4}
   + l_Kl_T\beta_\alpha\cos\delta\right) + J_T\beta_\alpha^2
   + \rho\left[l_K^2(n - l_T) + \frac{\beta_\alpha^2(n^3 - l_T^3)}{3}
   + l_K\beta_\alpha\cos\delta\,(n^2 - l_T^2)\right] + m_eH_\alpha^2 $$

$$ J = J_mi_g^2 + J_c + J_\alpha\alpha'^2 $$

**Load.** $W_0 = (m_y + m_s/2)\,g + \sigma c\,e$ hangs on the chain at rest, with the stretch
$e = e_0 + \sigma(H_b - H)$ of a spring below the iron ($\sigma = 1$) or above it ($\sigma = -1$).
The weights of rocker, link, run and hanging chain and $W_0$ turn the rocker back with

$$ \Pi_\alpha = g\,m_r r_r\cos(\alpha + \gamma_r)
   + g\,m_T\left(l_K\cos\alpha + \tfrac12 l_T\beta_\alpha\cos\beta\right)
   + g\rho\left[l_K\cos\alpha\,(n - l_T) + \tfrac12(n^2 - l_T^2)\beta_\alpha\cos\beta
   - H_\alpha(H + R_z\sin\gamma)\right] - W_0H_\alpha $$

and with the cam, $\Pi' = g\,m_c r_c\cos(\varphi + \gamma_c) + \Pi_\alpha\alpha'$. The guide's
friction is proportional to the load $W = W_0 - m_y\ddot H$:

$$ Q_f = K\,W\,H', \quad K = K_{\mathrm{up}} \ge 0 \mathrm{\ or\ } K_{\mathrm{down}} \le 0,
   \; 0 \mathrm{\ in\ the\ dwells} $$

**Motion.** From the energies,

$$ (J + K m_y H'^2)\,\dot\omega + \left(\tfrac12 J' + K m_y H'H''\right)\omega^2
   = M - \Pi' + K W_0 H' $$

The iron reverses in the dwells, without an event. Where the cam comes to rest on a slope,
$g_\pm = M - \Pi' + K_\pm W_0 H'$ decides: forwards if $g_+ > 0$, backwards if $g_- < 0$, else it
sticks until one of the two is true.

**Forces.** Chain at the iron, at the sprocket's hanging side and at the link's side; torque of the
cam on the rocker; force between cam and follower:

$$ T_{\mathrm{iron}} = (1 + K)W - \tfrac13 m_s\ddot H, \quad
   T_{\mathrm{hang}} = T_{\mathrm{iron}} + \rho H(g - \ddot H), \quad
   T_{\mathrm{span}} = T_{\mathrm{hang}} + \rho g R_z\sin\gamma
   - (J_z/R_z^2 + \rho R_z\gamma)\ddot H $$

$$ M_r = J_\alpha\ddot\alpha + \tfrac12 J_{\alpha,\alpha}\dot\alpha^2 + \Pi_\alpha - KWH_\alpha, \quad
   N = -M_r\,\frac{\sqrt{(L\sin\psi)^2 + (l(1 - \alpha') - L\cos\psi)^2}}{l\,L\sin\psi} $$

They assume a cam that turns counter-clockwise and a small arm at $-\psi$ from the line between the
axes. At rest in a dwell the pull of the chain is known only within the friction; $K = 0$ is shown.
Where the cam sticks, $K$ is what equilibrium needs. `tau_cam` is what a torque meter between
reducer and cam would show.

Assumptions: one degree of freedom; links rigid, no play, no friction in the joints; chain uniform
and inextensible, one end of the spring fixed. Cam and follower cannot pull, a chain cannot push:
the equations hold while $N$, $T_{\mathrm{span}}$, $T_{\mathrm{iron}}$ and $W$ are positive. Where
one of them vanishes, `on_invalid = stop` ends the step; `warn` logs it and goes on as if they
could, with `valid = false`. Moments shorter than 1 ms may pass unseen. With the defaults the
follower lifts off first, on the return, at 7.898 rad/s (75 cycles/min); without spring at
5.63 rad/s, with the spring above at 5.15 rad/s. The working range is 20 to 60 cycles/min.

The defaults are a 4 kg iron with 62.4 mm of stroke on an 08B chain and a 20-tooth sprocket, at rest
in the middle of the bottom dwell. A `DriveMotor` with `A = 4`, `B = 0.025`, `T = 0.012` and
`tau = 0` runs it at 42.39 cycles/min, with `A = 3.775` at 40.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator
from enum import IntEnum
from functools import lru_cache
from math import acos, atan, cos, pi, radians, sin, sqrt

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

EXPERIMENT = Experiment(stop=1.0, step=1e-3)
LONGEST_STEP = 1e-3
TAU, CHAIN = ("tau",), ("T_span", "T_iron", "W")


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
    h: Length = real(0.020, "Lift of the distance", min=0.0)
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
    l: Length = real(0.090, "Small arm, to the roller", positive=True)
    l_K: Length = real(0.280, "Large arm, to the link", positive=True)
    alpha0: Angle = real(2.38, "Angle of the large arm were the roller on the cam's axis")
    J: Inertia = real(0.025, "Moment of inertia of the rocker about its axis", positive=True)
    m: Mass = real(1.2, "Mass of the rocker", positive=True)
    r: Length = real(0.090, "Distance of the rocker's centre of mass from its axis", min=0.0)
    gamma: Angle = real(0.10, "Angle of the rocker's centre of mass from the large arm")


@record
class Link:
    l: Length = real(0.200, "Length of the link", positive=True)
    m: Mass = real(0.25, "Mass of the link", positive=True)
    J: Inertia = real(0.25 * 0.2**2 / 12, "Inertia of the link about its middle", positive=True)


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
    J: Inertia = real(3.0e-4, "Inertia of rotor and reducer, at the motor", positive=True)


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
    E_friction: Energy = real(0.0, "Energy dissipated in the guide", nominal=1.0)
    direction: int = discrete(0, "Sense of the cam's motion: 1 forwards, -1 backwards, 0 stuck")
    valid: bool = discrete(True, "Follower and chain are loaded, so that the equations hold")


@record
class Outputs:
    w: AngularVelocity = real(0.0, "Speed of the motor's shaft")
    alpha: Angle = real(0.0, "Angle of the rocker's large arm")
    beta: Angle = real(0.0, "Angle of link and run")
    H: Length = real(0.0, "Hanging length of the chain")
    lift: Length = real(0.0, "Lift of the iron")
    v: Velocity = real(0.0, "Velocity of the iron, upwards")
    a: Acceleration = real(0.0, "Acceleration of the iron, upwards", feedthrough=TAU)
    tau_cam: Torque = real(
        0.0, "Load on the cam's shaft: i_g tau less what speeds up the motor", feedthrough=TAU
    )
    T_iron: Force = real(0.0, "Pull of the chain on the iron", feedthrough=TAU)
    T_hang: Force = real(0.0, "Pull of the chain on the sprocket, iron's side", feedthrough=TAU)
    T_span: Force = real(0.0, "Pull of the chain on the sprocket, link's side", feedthrough=TAU)
    M_rocker: Torque = real(
        0.0, "Torque of the cam on the rocker, negative while they touch", feedthrough=TAU
    )
    N: Force = real(0.0, "Force between cam and follower", feedthrough=TAU)
    pressure: Angle = real(0.0, "Pressure angle between cam and follower, signed")
    E_kin: Energy = real(0.0, "Kinetic energy")
    E_pot: Energy = real(0.0, "Potential energy")
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
    for what in obstacles(p, phi):
        raise ValueError(f"{what} at phi = {phi!r} rad")
    return True


def obstacles(p: Parameters, phi: float) -> Iterator[str]:
    """What is in the way at this cam angle."""
    r, z = p.rocker, p.sprocket
    alpha = r.alpha0 - arm(p, cam(p, phi)[2])
    X, Y = z.C + r.l_K * cos(alpha), z.A - r.l_K * sin(alpha)
    if not X > 0.0:
        yield (
            "rocker end must stay on the far side of the sprocket: "
            f"sprocket.C + rocker.l_K cos(alpha) = {X!r} m"
        )
    if p.wrap == Wrap.tangent and not sqrt(X**2 + Y**2) > z.R:
        yield f"link reaches the sprocket: its end is within sprocket.R = {z.R!r} m of the axis"
    at = position(p, phi)
    if not at.n > p.link.l:
        yield f"link reaches the sprocket: link.l = {p.link.l!r} m of {at.n!r} m"
    if not at.H > 0.0:
        yield f"chain too short: hanging part vanishes: H = {at.H!r} m of chain.l = {p.chain.l!r} m"
    if not at.H_a > 0.0:
        yield f"dead centre: beta - alpha = {at.beta - at.alpha!r} rad"
    if not at.e >= 0.0:
        yield f"spring slack: stretch = {at.e!r} m with spring.e_0 = {p.spring.e_0!r} m"
    d = dynamics(p, at, 0.0, 0, at.Pi_1)
    pull = (1 + p.friction.K_down) * at.W_0
    if not min(pull, pull + d.T_span - d.T_iron) > 0.0:
        yield f"chain slack at standstill: T_iron = {pull!r} N"


Position = namedtuple(  # what the cam angle says; _1, _2: derivatives by phi, _a, _aa: by alpha
    "Position",
    "slope top psi alpha alpha_1 alpha_2 beta n gamma H H_a H_1 H_2 lift e W_0"
    " J_a J_aa J J_1 Pi_a Pi_1",
)
Dynamics = namedtuple("Dynamics", "eps K W T_iron T_hang T_span M_rocker N")


def law(x: float) -> tuple[float, float, float]:
    """s(x) from 0 to 1 with its derivatives s', s''; these and s''' vanish at both ends."""
    s = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
    return s, 140 * x**3 * (1 - x) ** 3, 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x)


def cam(p: Parameters, phi: float) -> tuple[int, bool, float, float, float]:
    """Iron up (1), down (-1) or dwelling (0), whether at the top, and the distance R, R', R''."""
    c = p.cam
    f = phi % (2 * pi)
    if f < c.rise:
        s, s_1, s_2 = law(f / c.rise)
        return 1, False, c.R_b + c.h * s, c.h * s_1 / c.rise, c.h * s_2 / c.rise**2
    if f < c.rise + c.top:
        return 0, True, c.R_b + c.h, 0 * c.h, 0 * c.h
    if f < c.rise + c.top + c.ret:
        s, s_1, s_2 = law((f - c.rise - c.top) / c.ret)
        return -1, False, c.R_b + c.h * (1 - s), -c.h * s_1 / c.ret, -c.h * s_2 / c.ret**2
    return 0, False, c.R_b, 0 * c.h, 0 * c.h


def arm(p: Parameters, R: float) -> float:
    """Angle psi of the small arm from the line between the axes, at the distance R."""
    L, l = p.rocker.L, p.rocker.l
    return acos((L**2 + l**2 - R**2) / (2 * L * l))


def run(p: Parameters, alpha: float) -> tuple[float, float, float, float]:
    """Length n and angle beta of the run, angle gamma on the sprocket, hanging length H."""
    z, l_K = p.sprocket, p.rocker.l_K
    X, Y = z.C + l_K * cos(alpha), z.A - l_K * sin(alpha)
    if p.wrap == Wrap.top:
        Y = Y + z.R
        n, beta, gamma = sqrt(X**2 + Y**2), pi - atan(Y / X), pi / 2
    else:
        n = sqrt(X**2 + Y**2 - z.R**2)
        beta = pi - atan(Y / X) - atan(z.R / n)
        gamma = 3 * pi / 2 - beta
    return n, beta, gamma, p.chain.l - (n - p.link.l) - z.R * gamma


def position(p: Parameters, phi: float) -> Position:
    """Position functions, reduced inertia and static load at the cam angle phi."""
    g, r, T, rho, z, s = p.g, p.rocker, p.link, p.chain.rho, p.sprocket, p.spring
    slope, top, R, R_1, R_2 = cam(p, phi)
    q = r.L**2 + r.l**2 - R**2
    Delta = 4 * r.L**2 * r.l**2 - q**2
    psi, lever = arm(p, R), 2 * R / sqrt(Delta)
    alpha = r.alpha0 - psi
    alpha_1 = -lever * R_1
    alpha_2 = -lever * (R_2 + R_1**2 * (1 / R - 2 * R * q / Delta))

    n, beta, gamma, H = run(p, alpha)
    S, C = r.l_K * sin(beta - alpha), r.l_K * cos(beta - alpha)
    beta_a, H_a = -C / n, S
    n_a = -H_a if p.wrap == Wrap.top else -H_a + z.R * beta_a
    beta_aa = S * (beta_a - 1) / n + C * n_a / n**2
    H_aa = C * (beta_a - 1)
    H_1, H_2 = H_a * alpha_1, H_aa * alpha_1**2 + H_a * alpha_2

    b, b_a, bb_a = beta_a * C, beta_aa * C - beta_a * S * (beta_a - 1), beta_a * beta_aa
    m_e = z.J / z.R**2 + rho * (z.R * gamma + H) + p.iron.m + s.m / 3
    J_a = (
        r.J
        + T.m * (r.l_K**2 + T.l**2 * beta_a**2 / 4 + T.l * b)
        + T.J * beta_a**2
        + rho * (r.l_K**2 * (n - T.l) + beta_a**2 * (n**3 - T.l**3) / 3 + b * (n**2 - T.l**2))
        + m_e * H_a**2
    )
    J_aa = (
        T.m * (T.l**2 * bb_a / 2 + T.l * b_a)
        + 2 * T.J * bb_a
        + rho * n_a * (r.l_K**2 + n**2 * beta_a**2 + 2 * n * b - H_a**2)
        + rho * (bb_a * (n**3 - T.l**3) * 2 / 3 + b_a * (n**2 - T.l**2))
        + 2 * m_e * H_a * H_aa
    )
    J = p.reducer.J * p.reducer.i_g**2 + p.cam.J + J_a * alpha_1**2
    J_1 = J_aa * alpha_1**3 + 2 * J_a * alpha_1 * alpha_2

    lift = run(p, r.alpha0 - arm(p, p.cam.R_b))[-1] - H
    e = s.e_0 + s.side * lift
    W_0 = (p.iron.m + s.m / 2) * g + s.side * s.c * e
    x_a, y_a = r.l_K * cos(alpha), cos(beta) * beta_a
    Pi_a = (
        r.m * g * r.r * cos(alpha + r.gamma)
        + T.m * g * (x_a + T.l * y_a / 2)
        + rho * g * (x_a * (n - T.l) + y_a * (n**2 - T.l**2) / 2 - H_a * (H + z.R * sin(gamma)))
        - W_0 * H_a
    )
    Pi_1 = p.cam.m * g * p.cam.r * cos(phi + p.cam.gamma) + Pi_a * alpha_1
    return Position(
        slope, top, psi, alpha, alpha_1, alpha_2, beta, n, gamma, H, H_a, H_1, H_2, lift, e, W_0,
        J_a, J_aa, J, J_1, Pi_a, Pi_1,
    )  # fmt: skip


def potential(p: Parameters, phi: float, at: Position) -> float:
    """Potential energy; zero is the rocker's axis, for the cam its own, and the slack spring."""
    r, T, z, H = p.rocker, p.link, p.sprocket, at.H
    spring: float = p.spring.c * at.e**2 / 2
    y_K, y_n = r.l_K * sin(at.alpha), sin(at.beta)
    run = y_K * (at.n - T.l) + y_n * (at.n**2 - T.l**2) / 2
    wrap = z.R * (z.A * at.gamma + z.R * (1 - cos(at.gamma)))
    weights: float = (
        p.cam.m * p.cam.r * sin(phi + p.cam.gamma)
        + r.m * r.r * sin(at.alpha + r.gamma)
        + T.m * (y_K + T.l * y_n / 2)
        + p.chain.rho * (run + wrap + H * (z.A - H / 2))
        + p.iron.m * (z.A - H)
        - p.spring.m * H / 2
    )
    return p.g * weights + spring


def friction(p: Parameters, at: Position, direction: float) -> float:
    """Coefficient K where the cam turns in this direction."""
    up = at.slope * direction
    return p.friction.K_up if up > 0 else p.friction.K_down if up < 0 else 0.0


def thresholds(p: Parameters, at: Position, M: float) -> tuple[float, float]:
    """g_+ and g_-: what is left of M to start forwards, and to start backwards."""
    rest, weight = M - at.Pi_1, at.W_0 * at.H_1
    return rest + friction(p, at, 1) * weight, rest + friction(p, at, -1) * weight


def sense(p: Parameters, at: Position, w: float, M: float) -> int:
    """Direction of the cam's motion, of its start from rest, or 0 where it sticks."""
    forwards, backwards = (w, w) if w else thresholds(p, at, M)
    return 1 if forwards > 0.0 else -1 if backwards < 0.0 else 0


def dynamics(p: Parameters, at: Position, w: float, direction: float, M: float) -> Dynamics:
    """Acceleration of the cam and all forces."""
    L, l, rho, z = p.rocker.L, p.rocker.l, p.chain.rho, p.sprocket
    if direction:
        K = friction(p, at, direction)
        A_1 = at.J + K * p.iron.m * at.H_1**2
        B_1 = at.J_1 / 2 + K * p.iron.m * at.H_1 * at.H_2
        eps = (M - at.Pi_1 + K * at.W_0 * at.H_1 - B_1 * w**2) / A_1
    else:
        K = (at.Pi_1 - M) / (at.W_0 * at.H_1) if at.H_1 else 0.0
        K, eps = min(max(K, p.friction.K_down), p.friction.K_up), 0.0
    H_tt = at.H_1 * eps + at.H_2 * w**2
    W = at.W_0 - p.iron.m * H_tt
    T_iron = (1 + K) * W - p.spring.m / 3 * H_tt
    T_hang = T_iron + rho * at.H * (p.g - H_tt)
    T_span = T_hang + rho * p.g * z.R * sin(at.gamma) - (z.J / z.R**2 + rho * z.R * at.gamma) * H_tt
    alpha_t, alpha_tt = at.alpha_1 * w, at.alpha_1 * eps + at.alpha_2 * w**2
    M_rocker = at.J_a * alpha_tt + at.J_aa * alpha_t**2 / 2 + at.Pi_a - K * W * at.H_a
    across, along = L * sin(at.psi), l * (1 - at.alpha_1) - L * cos(at.psi)
    N = -M_rocker * sqrt(across**2 + along**2) / (l * across)
    return Dynamics(eps, K, W, T_iron, T_hang, T_span, M_rocker, N)


def instant(p: Parameters, x: State, u: Inputs) -> tuple[Position, Dynamics]:
    """Position and dynamics of a state."""
    at = position(p, x.phi)
    return at, dynamics(p, at, x.w_cam, x.direction, p.reducer.i_g * u.tau)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    at, d = instant(p, x, u)
    return State(x.w_cam, d.eps, -d.K * d.W * at.H_1 * x.w_cam, 0, False)


def lost(x: State, d: Dynamics) -> str:
    """What has lost its load, empty if nothing has."""
    where = f"at phi = {x.phi!r} rad, omega = {x.w_cam!r} rad/s"
    if d.N < 0.0:
        return f"cam follower lifts off {where}: N = {d.N!r} N"
    slack = [f"{name} = {f!r} N" for name, f in zip(d._fields, d) if name in CHAIN and f < 0.0]
    return f"chain slack {where}: {', '.join(slack)}" if slack else ""


def judged(p: Parameters, x: State, u: Inputs) -> State:
    """The state with `valid` as the forces say; raises ValueError where it is to stop."""
    reason = lost(x, instant(p, x, u)[1])
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
    at, d = instant(p, x, u)
    forwards, backwards = thresholds(p, at, p.reducer.i_g * u.tau)
    held = x.direction * x.w_cam if x.direction else min(-forwards, backwards)
    margin = min(d.N, d.T_span, d.T_iron, d.W)
    return held, margin if x.valid else -margin


def jump(p: Parameters, t: float, x: State, u: Inputs, which: int) -> State:
    if which == 1:
        return judged(p, x, u)
    direction = sense(p, position(p, x.phi), 0.0, p.reducer.i_g * u.tau)
    return replace(x, w_cam=0.0, direction=direction)


def notes(p: Parameters, t: float, old: State, new: State, u: Inputs) -> Iterator[str]:
    if old.valid and not new.valid:
        reason = lost(new, instant(p, new, u)[1])
        yield f"{reason}, t = {t!r} s; the results are not valid until it is loaded again"


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    w, i_g, at = x.w_cam, p.reducer.i_g, position(p, x.phi)
    direction = x.direction if w == 0 else 1 if w > 0 else -1
    d = dynamics(p, at, w, direction, i_g * u.tau)
    up = at.slope * direction
    moving = Motion.up if up > 0 else Motion.down if up < 0 else Motion.stuck
    L, l = p.rocker.L, p.rocker.l
    return Outputs(
        w=i_g * w,
        alpha=at.alpha,
        beta=at.beta,
        H=at.H,
        lift=at.lift,
        v=-at.H_1 * w,
        a=-at.H_1 * d.eps - at.H_2 * w**2,
        tau_cam=i_g * u.tau - i_g**2 * p.reducer.J * d.eps,
        T_iron=d.T_iron,
        T_hang=d.T_hang,
        T_span=d.T_span,
        M_rocker=d.M_rocker,
        N=d.N,
        pressure=atan((l * (1 - at.alpha_1) - L * cos(at.psi)) / (L * sin(at.psi))),
        E_kin=at.J * w**2 / 2,
        E_pot=potential(p, x.phi, at),
        motion=moving if at.slope else Motion.dwell,
        top_dwell=at.top,
    )
