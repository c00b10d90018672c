"""How the iron drive moves with its follower on the cam: dry friction, equation of motion, forces.

The functions take the position along any angle that the iron follows, so that they also serve in flight.
*Paper* and the names of sections are those of `page.md`.
"""

from __future__ import annotations

from collections import namedtuple
from typing import NamedTuple

from fmukit.runtime.jet import sin, sqrt

from .declarations import Parameters
from .geometry import Position, slip_per_cam_speed

#: Torque that is left to start forwards, and to start backwards: g_+ and g_- of *Motion*.
StartTorques = namedtuple("StartTorques", "forwards backwards")
#: What acceleration and squared speed multiply in the equation of motion: A_1 and B_1.
ReducedInertia = namedtuple("ReducedInertia", "A_1 B_1")
#: Pulls of the chain, torque of the cam on the rocker, and force between cam and follower.
Forces = namedtuple("Forces", "T_iron T_hang T_span M_rocker N")


class Dynamics(NamedTuple):
    """Acceleration along the position, friction K, second derivative of H by time, load W of the guide."""

    eps: float
    K: float
    H_tt: float
    W: float


def friction_coefficient(p: Parameters, at: Position, direction: float) -> float:
    """Coefficient K with the cam turning in this direction: paper (48)."""
    up = at.slope * direction
    return p.friction.K_up if up > 0 else p.friction.K_down if up < 0 else 0.0


def torques_to_start(p: Parameters, at: Position, M: float) -> StartTorques:
    """The generalised force of paper (40) at rest, where the paper leaves friction open."""
    K_plus, K_minus = friction_coefficient(p, at, 1), friction_coefficient(p, at, -1)
    balance, load = M - at.Pi_1, at.W_0 * at.H.first
    return StartTorques(balance + K_plus * load, balance + K_minus * load)


def direction_of_motion(p: Parameters, at: Position, w: float, M: float) -> int:
    """Direction in which the cam moves or starts from rest, by the rule of g_+ and g_-; 0 where it sticks."""
    forwards, backwards = (w, w) if w else torques_to_start(p, at, M)
    return 1 if forwards > 0.0 else -1 if backwards < 0.0 else 0


def reduced_inertia(p: Parameters, at: Position, K: float) -> ReducedInertia:
    """The inertia with the coefficient of friction K: paper (48b) and (48c)."""
    m, H = p.iron.m, at.H
    return ReducedInertia(at.J + K * m * H.first * H.first, at.J_1 / 2 + K * m * H.first * H.second)


def dynamics(p: Parameters, at: Position, w: float, direction: float, M: float) -> Dynamics:
    """The equation of motion: paper (27), (39), (48a) to (48d) with A_1, B_1, C_1 of *Motion*.

    At rest K is what equilibrium requires, within its bounds. The load W is that of *Load*.
    """
    m, H = p.iron.m, at.H
    if direction:
        K = friction_coefficient(p, at, direction)
        A, B = reduced_inertia(p, at, K)
        eps = (M - at.Pi_1 + K * at.W_0 * H.first - B * w * w - at.D * w) / A
    else:
        K = (at.Pi_1 - M) / (at.W_0 * H.first) if H.first else 0.0
        K, eps = min(max(K, p.friction.K_down), p.friction.K_up), 0.0
    H_tt = H.first * eps + H.second * w * w
    return Dynamics(eps, K, H_tt, at.W_0 - m * H_tt)


def forces(p: Parameters, at: Position, w: float, d: Dynamics) -> Forces:
    """Forces of chain and follower, torque on the rocker: the five equations of *Forces*.

    Speed and acceleration of the rocker are those of paper (19) and (20).
    """
    rho, z, alpha = p.chain.rho, p.sprocket, at.alpha
    T_iron = (1 + d.K) * d.W - p.spring.m / 3 * d.H_tt
    T_hang = T_iron + rho * at.H.value * (p.g - d.H_tt)
    wrapped = z.J / (z.R * z.R) + rho * z.R * at.gamma
    T_span = T_hang + rho * p.g * z.R * sin(at.gamma) - wrapped * d.H_tt
    T_span = T_span - p.joints.sprocket / (z.R * z.R) * at.H.first * w
    alpha_t, alpha_tt = alpha.first * w, alpha.first * d.eps + alpha.second * w * w
    M_rocker = at.J_a * alpha_tt + at.J_aa * alpha_t * alpha_t / 2 + at.Pi_a
    M_rocker = (M_rocker - d.K * d.W * at.H_a + at.D_a * alpha_t) * at.touch
    across, along = slip_per_cam_speed(p, alpha)
    N = -M_rocker * sqrt(across * across + along * along) / (p.rocker.l * across)
    return Forces(T_iron, T_hang, T_span, M_rocker, N)
