"""The loads of the orientator: centrifugal forces, spring, and friction on wall, side walls and catcher.

*Paper*, with the number of a formula, is the one whose formulas `page.md` lists; what has no number there is named
by its section on that page.
"""

from __future__ import annotations

from fmukit.runtime.jet import cos, sin, sqrt

from .declarations import Parameters, State


def distance_of_bottom(p: Parameters) -> float:
    """Distance L - r of the bottom's centre from the pivot while it slides on the wall: see *Equations*."""
    return p.catcher.l * cos(p.catcher.phi) + p.cup.d / 2


def loads(p: Parameters, phi1: float, w: float) -> tuple[float, float, float]:
    """Torque Q_1 on the catcher, centrifugal force F_2 and friction F_f on the product.

    Paper (9b) and *Forces*; errata 5 and 6 of the paper are corrected.
    """
    half, phi10, R, d = p.catcher.l / 2, p.catcher.phi, p.chute.R, p.cup.d
    F_1 = p.catcher.m * w * w * (R - d - half * cos(phi10))
    F_2 = p.cup.m * w * w * (R - d / 2)
    spring = p.spring.c * half * (phi1 - phi10)
    pull = anchored_spring(p, phi1)[0] if p.neglected.anchored else spring * cos(phi1)
    return -half * (F_1 * sin(phi1) + pull), F_2, p.chute.mu * F_2


def anchored_spring(p: Parameters, phi1: float) -> tuple[float, float]:
    """Pull of the spring across the arm, less the weight balanced at the stop, and their energy.

    The upper end of the spring is fixed above the middle of the arm at the stop: see the last sentence of *What
    the paper neglects*.
    """
    half, phi10, length = p.catcher.l / 2, p.catcher.phi, p.neglected.length
    weight = p.catcher.m * p.g
    down = half * (sin(phi1) - sin(phi10))
    X, Y = half * (cos(phi10) - cos(phi1)), -length - down
    far = sqrt(X * X + Y * Y)
    stretch = far - length
    tension = weight + p.spring.c * stretch
    across = tension / far * (X * sin(phi1) - Y * cos(phi1)) - weight * cos(phi1)
    return across, p.spring.c / 2 * stretch * stretch + weight * (stretch - down)


def inverse_speed(p: Parameters, vx: float, vy: float) -> float:
    """Times mu N and a velocity it is the Coulomb friction that opposes this velocity; a stuck contact creeps.

    The square root regularises friction at rest, far below the speed `neglected.creep`.
    """
    return 1 / sqrt(vx * vx + vy * vy + p.neglected.creep * p.neglected.creep)


def side_friction(p: Parameters, x: State, w: float) -> tuple[float, float, float]:
    """Force and moment on the product from friction at the side walls.

    Coriolis forces press the rim and the end of the cylinder against them, with N_rim and N_end of *What the paper
    neglects*.
    """
    h, l2, m, e, mu = p.cup.h, p.cup.l, p.cup.m, p.cup.h - p.cup.l, p.neglected.mu_side
    c2, s2 = cos(x.phi2), sin(x.phi2)
    F, S = 2 * m * w * x.vxc, -2 * w * x.w2 * s2 * (p.cup.J - p.neglected.J_a / 2)
    ux, uy = x.vxc - x.w2 * e * s2, x.vyc + x.w2 * e * c2
    vx, vy = x.vxc + x.w2 * l2 * s2, x.vyc - x.w2 * l2 * c2
    end = mu / h * abs(S + l2 * F) * inverse_speed(p, ux, uy)
    rim = mu / h * abs(e * F - S) * inverse_speed(p, vx, vy)
    turn = l2 * rim * (c2 * vy - s2 * vx) - e * end * (c2 * uy - s2 * ux)
    return -(end * ux + rim * vx), -(end * uy + rim * vy), turn


def friction_share(k: float, tried: float, push: float, pushed: float) -> float:
    """Friction k N over the friction tried; the normal force N is `push` without it, `pushed` with it.

    N is linear in the friction, so this share of the one that was tried solves for both.
    """
    return k * push / (tried - k * (pushed - push)) if push > 0 * push else 0 * k * push / tried
