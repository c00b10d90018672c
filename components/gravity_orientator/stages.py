"""The four stages of the orientation: falling, joint, turning, released.

Each stage has its geometry and its function of MECHANICS, which gives accelerations and reactions. *Paper*
and the names of sections are those of `page.md`.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from math import atan2, pi, tan

from fmukit.runtime.jet import Jet, acos, cos, sin, sqrt

from .declarations import Parameters, Reason, Stage, State
from .loads import distance_of_bottom, friction_share, inverse_speed, loads, side_friction

#: Accelerations of catcher and product; reactions of wall and hook.
Rates = namedtuple("Rates", "a1 a2 ax ay N_K N_B")
#: Angle and centre of the product as jets along phi1; derivative of the path of the wall on it; J and J'/2.
Joint = namedtuple("Joint", "phi2 x y path J half_dJ")
TransferFunctions = namedtuple("TransferFunctions", "u_phi2 u_xc1 u_xc2 u_yc1 u_yc2 u_yK1 u_yK2")
#: Tip on the cup, height of the centre, mass matrix, its derivatives by phi1 and phi2, second ones of the height.
Turning = namedtuple("Turning", "x1 yc M11 M12 M22 z1 z2 x2 Y11 Y12 Y22")


def friction_less_weight(p: Parameters, w: float) -> float:
    """Friction in the chute less the weight of the product: what holds it in *Falling*."""
    return loads(p, p.catcher.phi, w)[2] - p.cup.m * p.g


def falling_rates(p: Parameters, x: State, w: float) -> Rates:
    """The product falls along the wall, or is held by its friction: paper (1)."""
    _, F_2, F_f = loads(p, x.phi1, w)
    still = 0 * w * w
    ay = 0 * p.g if x.reason == Reason.held_in_chute else p.g - F_f / p.cup.m
    return Rates(still, still, 0 * p.g, ay, F_2, 0 * F_2)


def landing_height(p: Parameters) -> float:
    """Height of the product's centre of mass when its rim is in the corner of the catcher: see *Landing*."""
    return p.catcher.l * sin(p.catcher.phi) - p.cup.l


def joint_geometry(p: Parameters, phi1: float) -> Joint:
    """Stage joint along phi1: angle and centre of the product, path of the wall on it, inertia J.

    Paper (6a) to (7b) in closed form, and (9a); errata 7 and 9 of the paper are corrected.
    """
    h, l1, l2, r = p.cup.h, p.catcher.l, p.cup.l, p.cup.d / 2
    at = Jet(phi1, 1.0, 0.0)
    A = distance_of_bottom(p) - l1 * cos(at)
    phi2 = 2 * pi - atan2(r, h) - acos(A / sqrt(h * h + r * r))
    x = distance_of_bottom(p) - (h - l2) * cos(phi2)
    y = l1 * sin(at) + r * cos(phi2) + l2 * sin(phi2)
    path = y + (h - l2) * sin(phi2) + r * phi2
    J = p.catcher.J + p.cup.m * (x.derivative**2 + y.derivative**2) + p.cup.J * phi2.derivative**2
    return Joint(phi2, x, y, path.first, J.value, J.first / 2)


def joint_rates(p: Parameters, x: State, w: float) -> Rates:
    """J w1' + J' w1^2 / 2 = Q: paper (8), (10) and (10a), with errata 2, 3 and 6 corrected.

    The wall's reaction follows from the product's moments about the corner. Friction in the corner is that of *What
    the paper neglects*.
    """
    l1, J_2, m, at = p.catcher.l, p.cup.J, p.cup.m, joint_geometry(p, x.phi1)
    Q_1, F_2, F_f = loads(p, x.phi1, w)
    fx, fy, turn = side_friction(p, x, w)
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
        moment += (distance_of_bottom(p) + p.cup.d / 2 - at.x.value) * F_f
        N_K = -moment * at.phi2.first / (l1 * s1)
        return a1, a2, ax, ay, N_K, (N_K - right) * (s1 - c1) - down * (c1 + s1)

    tried = m * p.g * l1
    *free, push = rates(0 * tried)
    *held, pushed = rates(tried)
    part = friction_share(p.neglected.mu_catcher * p.neglected.rim, tried, push, pushed)
    a1, a2, ax, ay, N_K = (a + part * (b - a) for a, b in zip(free, held))
    return Rates(a1, a2, ax, ay, N_K, 0 * F_2)


def flush_angle(p: Parameters) -> float:
    """Angle of the catcher at which the cup's wall lies on the hook: paper (7c) in closed form."""
    r, h, l1 = p.cup.d / 2, p.cup.h, p.catcher.l
    far = r + l1
    return atan2(h, far) + acos((r + l1 * cos(p.catcher.phi)) / sqrt(h * h + far * far))


def turning_geometry(p: Parameters, phi1: float, phi2: float) -> Turning:
    """Stage turning: tip on the cup, height, mass matrix; the centre's derivatives by phi1 and phi2.

    Paper (10b), (10e) and (10f).
    """
    l1, h1, m, r, e = p.catcher.l, p.catcher.h, p.cup.m, p.cup.d / 2, p.cup.h - p.cup.l
    c1, s1, s2, T, S = cos(phi1), sin(phi1), sin(phi2), tan(phi2), 1 / cos(phi2)
    Bx, By = l1 * c1 + h1 * s1, l1 * s1 - h1 * c1
    G = distance_of_bottom(p) - Bx
    z1, z2, x2 = Bx + By * T, G * S * S + r * S * T - e / S, e * s2
    Y22 = 2 * G * S * S * T + r * S * (T * T + S * S) + e * s2
    M11, M12, M22 = p.catcher.J + m * z1 * z1, m * z1 * z2, p.cup.J + m * (x2 * x2 + z2 * z2)
    x1, yc = (G + r * s2) * S, By + G * T + r * S - e * s2
    return Turning(x1, yc, M11, M12, M22, z1, z2, x2, Bx * T - By, By * S * S, Y22)


def solve_2_by_2(at: Turning, Q_1: float, Q_2: float) -> tuple[float, float]:
    """Accelerations from two torques in stage turning, or speeds from two momenta: Cramer's rule."""
    det = at.M11 * at.M22 - at.M12 * at.M12
    return (Q_1 * at.M22 - Q_2 * at.M12) / det, (Q_2 * at.M11 - Q_1 * at.M12) / det


def turning_rates(p: Parameters, x: State, w: float) -> Rates:
    """M11 w1' + M12 w2' = Q_1 + ..., M12 w1' + M22 w2' = ..., and the balance of forces.

    Paper (10g), with errata 3, 5 and 6 corrected. Friction on the hook is that of *What the paper neglects*.
    """
    m, r, e, at = p.cup.m, p.cup.d / 2, p.cup.h - p.cup.l, turning_geometry(p, x.phi1, x.phi2)
    c2, s2 = cos(x.phi2), sin(x.phi2)
    Q_1, F_2, F_f = loads(p, x.phi1, w)
    ax = e * c2 * x.w2 * x.w2
    ay = at.Y11 * x.w1 * x.w1 + 2 * at.Y12 * x.w1 * x.w2 + at.Y22 * x.w2 * x.w2
    fx, fy, turn = side_friction(p, x, w)
    down = m * (p.g - ay) - F_f + fy
    Q_2 = at.z2 * down + at.x2 * (F_2 - m * ax) - F_f * (e * c2 + r) + at.x2 * fx + turn
    along, about = at.Y12 * c2, r + at.x1 * s2 / c2
    slip = along * x.w1 + about * x.w2

    def rates(F: float) -> tuple[float, ...]:
        """Rates with the friction F on the hook."""
        a1, a2 = solve_2_by_2(at, Q_1 + at.z1 * down - F * along, Q_2 - F * about)
        bx, by = ax + at.x2 * a2, ay + at.z1 * a1 + at.z2 * a2
        N_B = (m * (p.g - by) - F_f + fy - F * s2) / c2
        return a1, a2, bx, by, F_2 + fx + N_B * s2 - F * c2 - m * bx, N_B

    free, held = rates(0 * F_f), rates(m * p.g)
    k = p.neglected.mu_catcher * slip * inverse_speed(p, slip, 0 * slip)
    part = friction_share(k, m * p.g, free[-1], held[-1])
    return Rates(*(a + part * (b - a) for a, b in zip(free, held)))


def pressing_force(p: Parameters, x: State, w: float) -> float:
    """Force that presses a released product to the wall, less what its rotation takes.

    The numerator of N in *Released*, paper (10m), with the friction of the side walls.
    """
    fx, _, turn = side_friction(p, x, w)
    m, e, c2, s2 = p.cup.m, p.cup.h - p.cup.l, cos(x.phi2), sin(x.phi2)
    return loads(p, x.phi1, w)[1] - m * e * c2 * x.w2 * x.w2 + fx - m * e * s2 * turn / p.cup.J


def released_rates(p: Parameters, x: State, w: float) -> Rates:
    """The product turns on at the wall, or flies; the catcher returns to its stop.

    Paper (10i) to (10n), with errata 4 and 11 corrected.
    """
    J_2, m, e, c2, s2 = p.cup.J, p.cup.m, p.cup.h - p.cup.l, cos(x.phi2), sin(x.phi2)
    Q_1, F_2, _ = loads(p, x.phi1, w)
    q = e * s2 - p.chute.mu * (e * c2 + p.cup.d / 2)
    N = J_2 * pressing_force(p, x, w) / (J_2 + q * m * e * s2) if x.contact else 0 * F_2
    a1 = 0 * w * w if x.phi1 == p.catcher.phi else Q_1 / p.catcher.J
    fx, fy, turn = side_friction(p, x, w)
    ax, ay = (F_2 - N + fx) / m, p.g - (p.chute.mu * N - fy) / m
    return Rates(a1, (q * N + turn) / J_2, ax, ay, N, 0 * F_2)


def sliding_speed(p: Parameters, x: State, w: float = 0.0) -> float:
    """Sliding speed v_s of the product at the wall, down: see *End*."""
    return x.vyc + x.w2 * ((p.cup.h - p.cup.l) * cos(x.phi2) + p.cup.d / 2)


def transfer_functions(p: Parameters, x: State) -> TransferFunctions:
    """Derivatives of phi2, xc, yc and the contact's height by phi1 and phi2, while the catcher leads.

    Paper (7d) in stage joint, (10e) in stage turning.
    """
    none, lever = 0 * p.cup.d, (p.cup.h - p.cup.l) * cos(x.phi2)
    match x.stage:
        case Stage.joint:
            at = joint_geometry(p, x.phi1)
            u, y = at.phi2.first, at.y.first
            return TransferFunctions(u, at.x.first, none, y, none, y + lever * u, none)
        case Stage.turning:
            k = turning_geometry(p, x.phi1, x.phi2)
            return TransferFunctions(0.0, none, k.x2, k.z1, k.z2, k.z1, k.z2 + lever)
    return TransferFunctions(0.0, none, none, none, none, none, none)


MECHANICS: dict[int, Callable[[Parameters, State, float], Rates]] = {
    Stage.falling: falling_rates,
    Stage.joint: joint_rates,
    Stage.turning: turning_rates,
    Stage.released: released_rates,
}
