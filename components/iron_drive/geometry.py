r"""Where the parts of the iron drive are at a cam angle: cam, rocker, run of the chain.

Lengths and angles are jets along the cam angle or along the rocker's angle alpha, so that their derivatives
come with them. Inertias and potential energy follow from the same position. *Paper*, with the number of a formula,
is the one whose formulas `page.md` lists; what has no number there is named by its section on that page.
"""

from __future__ import annotations

from collections import namedtuple
from functools import lru_cache
from math import pi
from typing import Any

from fmukit.runtime.jet import Jet, acos, atan2, constant, cos, sin, sqrt

from .declarations import Parameters, Wrap

#: All that the cam angle determines; alpha, beta and H are jets along it.
Position = namedtuple(
    "Position",
    "slope top touch alpha n beta gamma H H_a H_aa lift e W_0 J_a J_aa J J_1 Pi Pi_a Pi_1 D_a D",
)


#: A cam at an angle: iron up (1), down (-1) or dwelling (0), whether at the top, and the distance R along phi.
CamPoint = namedtuple("CamPoint", "slope top R")
#: A velocity across and along the small arm of the rocker.
Slip = namedtuple("Slip", "across along")
#: The run of the chain: length, angle, angle on the sprocket, and hanging length.
ChainRun = namedtuple("ChainRun", "n beta gamma H")


def rise_profile(f: float, width: float) -> Jet:
    """Rise s along the angle f of a slope of this width: the polynomial of *Cam*.

    s', s'' and s''' vanish at both ends. The paper does not print its law.
    """
    x = f / width
    square, both = x * x, x * (1 - x)
    s = square * square * (35 - 84 * x + 70 * square - 20 * square * x)
    s_1, s_2 = 140 * (both * both * both), 420 * (both * both) * (1 - 2 * x)
    return Jet(s, s_1 / width, s_2 / (width * width))


def cam_at(p: Parameters, phi: float) -> CamPoint:
    """The cam at its angle: paper (1) to (3), with the law of *Cam*."""
    c = p.cam
    f = phi % (2 * pi)
    if f < c.rise:
        return CamPoint(1, False, c.R_b + c.h * rise_profile(f, c.rise))
    if f < c.rise + c.top:
        return CamPoint(0, True, constant(c.R_b + c.h))
    if f < c.rise + c.top + c.ret:
        fallen = c.h * rise_profile(f - c.rise - c.top, c.ret)
        return CamPoint(-1, False, c.R_b + c.h - fallen)
    return CamPoint(0, False, constant(c.R_b))


def rocker_angle(p: Parameters, R: Any) -> Any:
    """Angle alpha of the large arm with the roller at the distance R: paper (4), law of cosines."""
    L, l = p.rocker.L, p.rocker.l
    return p.rocker.alpha0 - acos((L * L + l * l - R * R) / (2 * L * l))


def chain_run(p: Parameters, x: Any, y: Any) -> ChainRun:
    """The run of the chain from the end x, y of the rocker: paper (7) and (10), with jets also (9a) and (9b).

    It ends above the sprocket's axis or as a tangent, by `wrap`: see *Run*.
    """
    R = p.sprocket.R
    above, tangent_radius = (R, 0 * R) if p.wrap == Wrap.top else (0 * R, R)
    X, Y = p.sprocket.C + x, p.sprocket.A + above - y
    n = sqrt(X * X + Y * Y - tangent_radius * tangent_radius)
    beta = pi - atan2(Y, X) - atan2(tangent_radius, n)
    gamma = pi / 2 + 0 * beta if p.wrap == Wrap.top else 3 * pi / 2 - beta
    return ChainRun(n, beta, gamma, p.chain.l - (n - p.link.l) - R * gamma)


@lru_cache(maxsize=16)
def lowered_length(p: Parameters) -> float:
    """Hanging length H_b of the chain with the iron down: paper (10) with R = R_b."""
    alpha = rocker_angle(p, p.cam.R_b)
    H: float = chain_run(p, p.rocker.l_K * cos(alpha), p.rocker.l_K * sin(alpha)).H
    return H


def position_with_gap(p: Parameters, phi: float, gap: float, H_b: float) -> Position:
    """The position at a cam angle and a gap; H_b is the hanging length with the iron down.

    Derivatives are those of paper (5), (6), (8), (9), (11) and (12), the reduced inertias J_a and J those of
    (28) to (38), and Pi the potential energy of (41) to (46) with its derivative (47). W_0 is the load of
    *Load*; D is the damping of *Motion*.
    """
    g, r, T, rho, z, s = p.g, p.rocker, p.link, p.chain.rho, p.sprocket, p.spring
    slope, top, R = cam_at(p, phi)
    alpha = rocker_angle(p, R) - gap
    x_K, y_K = r.l_K * cos(alpha.value), r.l_K * sin(alpha.value)
    y = Jet(y_K, x_K, -y_K)
    n, beta, gamma, H = chain_run(p, Jet(x_K, -y_K, -x_K), y)

    moving = T.m + rho * p.chain.l + z.J / (z.R * z.R) + p.iron.m + s.m / 3
    turning = T.J + T.m * (n - T.l / 2) ** 2 + rho / 3 * (n - T.l) ** 3
    J_a = r.J + turning * beta.derivative**2 + moving * H.derivative**2

    lift, up = H_b - H, sin(beta)
    e = s.e_0 + s.side * lift
    chain = (n - T.l) * (y + up * ((n + T.l) / 2) - z.A) + z.R * z.R * (1 - cos(gamma)) - H**2 / 2
    level, hanging = (rho * p.chain.l + p.iron.m) * z.A, p.iron.m + s.m / 2
    centre = Jet(alpha.value + r.gamma, 1.0, 0.0)
    Pi = s.c / 2 * e**2 + g * (
        r.m * r.r * sin(centre) + T.m * (y + up * (T.l / 2)) + rho * chain - hanging * H + level
    )
    W_0 = hanging * g + s.side * s.c * e.value
    J = (
        J_a.along(alpha) * alpha.derivative**2
        + p.reducer.J * p.reducer.i_g * p.reducer.i_g
        + p.cam.J
    )
    Pi_1 = cam_weight(p, phi) + Pi.first * alpha.first
    joints, wound = p.joints, H.first / z.R
    D_a = joints.rocker + joints.link * (beta.first - 1) ** 2 + joints.sprocket * wound * wound
    return Position(
        slope, top, 1.0, alpha, n.value, beta.along(alpha), gamma.value, H.along(alpha), H.first,
        H.second, lift.value, e.value, W_0, J_a.value, J_a.first, J.value, J.first, Pi.value,
        Pi.first, Pi_1, D_a, joints.cam + D_a * alpha.first * alpha.first,
    )  # fmt: skip


def cam_weight(p: Parameters, phi: float) -> float:
    """Torque of the cam's weight against its motion: the derivative of its potential energy, paper (41)."""
    torque: float = p.g * p.cam.m * p.cam.r * cos(phi + p.cam.gamma)
    return torque


def position(p: Parameters, phi: float) -> Position:
    """The position at the cam angle phi, with the follower on the cam."""
    return position_with_gap(p, phi, 0.0, lowered_length(p))


def slip_per_cam_speed(p: Parameters, alpha: Jet) -> Slip:
    """Velocity of the cam under the follower over the cam's speed.

    Its direction is the tangent of the contact in *Forces*.
    """
    L, l, psi = p.rocker.L, p.rocker.l, p.rocker.alpha0 - alpha.value
    return Slip(L * sin(psi), l * (1 - alpha.first) - L * cos(psi))
