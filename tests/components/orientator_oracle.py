"""One passage of the orientator from the equations of its page, by SciPy; without the model or the kit.

Times [s] and impulses [N.s] by the names of the figures of `orientator_cycle`. It ends in `Jam` where
the catcher or the cup stops, or the catcher falls back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy import cos, pi, sin, tan
from scipy.integrate import solve_ivp

Rates = Callable[[float, Any], Sequence[float]]
ONWARDS, DOWN, UP = 0.0, -1.0, 1.0


class Jam(Exception):
    """The product does not come to its end."""


def until(
    rates: Rates, begin: float, state: Sequence[float], *ends: tuple[Rates, float]
) -> tuple[int, float, Any]:
    """The first of some functions that passes zero in a sense, when, and the state there."""
    for function, sense in ends:
        function.terminal, function.direction = True, sense  # type: ignore[attr-defined]
    solution = solve_ivp(
        rates, (begin, begin + 5.0), state, "DOP853", events=[function for function, _ in ends],
        rtol=1e-13, atol=1e-15, max_step=2e-3,
    )  # fmt: skip
    if solution.status != 1:
        raise Jam("never")
    which = next(k for k, times in enumerate(solution.t_events) if len(times))
    return which, float(solution.t_events[which][0]), solution.y_events[which][0]


def passage(v: Mapping[str, float], w: Callable[[float], float]) -> dict[str, float]:
    """The passage of a machine with these parameters by name; w gives the speed of its rotor [rad/s] at a
    time since the release.
    """
    d, h, l2, m2, J2 = (v[f"cup.{name}"] for name in ("d", "h", "l", "m", "J"))
    l1, h1, m1, J1, rest = (v[f"catcher.{name}"] for name in ("l", "h", "m", "J", "phi"))
    c, R, H, mu, g = (v[x] for x in ("spring.c", "chute.R", "chute.H", "chute.mu", "g"))
    r, e, L = d / 2, h - l2, l1 * cos(rest) + d

    def F2(t: float) -> float:
        return m2 * w(t) ** 2 * (R - r)

    def Q1(t: float, p: float) -> float:
        F1 = m1 * w(t) ** 2 * (R - d - l1 * cos(rest) / 2)
        return float(-F1 * l1 / 2 * sin(p) - c * l1 * l1 / 4 * (p - rest) * cos(p))

    def joint(p: float) -> tuple[float, ...]:
        """phi2; derivatives by phi1 of phi2, xc, yc; path of the friction; J and half of J'."""
        A = L - r - l1 * cos(p)
        p2 = 2 * pi - math.atan2(r, h) - math.acos(A / math.hypot(h, r))
        c2, s2 = cos(p2), sin(p2)
        u = -l1 * sin(p) / (h * s2 + r * c2)
        bend = -(l1 * cos(p) + A * u * u) / (h * s2 + r * c2)
        x, xx = e * s2 * u, e * (c2 * u * u + s2 * bend)
        y = l1 * cos(p) + (l2 * c2 - r * s2) * u
        yy = -l1 * sin(p) - (r * c2 + l2 * s2) * u * u + (l2 * c2 - r * s2) * bend
        J = J1 + m2 * (x * x + y * y) + J2 * u * u
        return p2, u, x, y, l1 * cos(p) + (A + r) * u, J, m2 * (x * xx + y * yy) + J2 * u * bend

    def hook(p: float, p2: float) -> tuple[Any, ...]:
        """B, G, Y1, Y2, z1, z2, x2, how far the tip is from the end of the cylinder, masses."""
        Bx, By = l1 * cos(p) + h1 * sin(p), l1 * sin(p) - h1 * cos(p)
        G, T, S = L - r - Bx, tan(p2), 1 / cos(p2)
        Y1, Y2, x2 = Bx + By * T, G * S * S + r * S * T, e * sin(p2)
        z2 = Y2 - e * cos(p2)
        M = [[J1 + m2 * Y1 * Y1, m2 * Y1 * z2], [m2 * Y1 * z2, J2 + m2 * (x2 * x2 + z2 * z2)]]
        return Bx, By, G, Y1, Y2, z2, x2, (G + r * sin(p2)) / cos(p2), np.array(M)

    def falls(t: float, y: Any) -> Sequence[float]:
        return [y[1], g - mu * F2(t) / m2]

    def falls_in_joint(t: float, y: Any) -> Sequence[float]:
        _, _, x_1, y_1, path, J, half = joint(y[0])
        pushed = F2(t) * (x_1 - mu * path)
        return [y[1], (Q1(t, y[0]) + m2 * g * y_1 + pushed - half * y[1] ** 2) / J]

    def turns(t: float, y: Any) -> Sequence[float]:
        p, p2, w1, w2 = y
        Bx, By, G, Y1, Y2, z2, x2, _, M = hook(p, p2)
        T, S = tan(p2), 1 / cos(p2)
        bend = 2 * G * S * S * T + r * S * (T * T + S * S) + e * sin(p2)
        ay = (Bx * T - By) * w1 * w1 + 2 * By * S * S * w1 * w2 + bend * w2 * w2
        Ff = mu * F2(t)
        slid = m2 * z2 * (g - ay) + x2 * (F2(t) - m2 * e * cos(p2) * w2 * w2) - Ff * (Y2 + r)
        return [w1, w2, *np.linalg.solve(M, [Q1(t, p) + m2 * Y1 * (g - ay) - Ff * Y1, slid])]

    def tip_slides(_: float, y: Any) -> float:
        at = hook(y[0], y[1])
        return float(at[3] * y[2] + at[5] * y[3] + y[3] * (e * cos(y[1]) + r))

    def arm(p2: float) -> float:
        return float(e * sin(p2) - mu * (e * cos(p2) + r))

    def wall(t: float, y: Any) -> float:
        pushed = F2(t) - m2 * e * cos(y[0]) * y[1] ** 2
        return float(J2 * pushed / (J2 + arm(y[0]) * m2 * e * sin(y[0])))

    def slides(t: float, y: Any) -> Sequence[float]:
        N = wall(t, y)
        return [y[1], arm(y[0]) * N / J2, g - mu * N / m2]

    if mu * F2(0.0) >= m2 * g:
        raise Jam("held in the chute")
    stop, landed, (_, fall) = until(
        falls, 0.0, [0.0, 0.0], (lambda _, y: y[0] - H, ONWARDS),
        (lambda t, _: falls(t, [0.0, 0.0])[1], DOWN),
    )  # fmt: skip
    if stop:
        raise Jam("held in the chute")
    s1, c1 = sin(rest), cos(rest)
    landing = np.array([  # w1, w2, vxc, vyc, S_x, S_y, S_k
        [0, 0, m2, 0, 1, 0, 1], [0, 0, 0, m2, 0, 1, 0], [0, J2, 0, 0, -l2, -r, e],
        [J1, 0, 0, 0, l1 * s1, -l1 * c1, 0], [l1 * s1, -l2, 1, 0, 0, 0, 0],
        [-l1 * c1, -r, 0, 1, 0, 0, 0], [l1 * s1, -h, 0, 0, 0, 0, 0],
    ])  # fmt: skip
    w1, *_, S_x, S_y, S_k = np.linalg.solve(landing, [0, m2 * fall, 0, 0, 0, 0, 0])

    stop, hooked, (p, w1) = until(
        falls_in_joint, landed, [rest, w1],
        (lambda _, y: joint(y[0])[0] - y[0] - 1.5 * pi, ONWARDS), (lambda _, y: y[1], DOWN),
    )  # fmt: skip
    if stop:
        raise Jam("the catcher stops")
    p2, u, x_1, y_1, *_ = joint(p)
    *_, z1, _, z2, x2, _, M = hook(p, p2)
    before = [J1 * w1 + m2 * z1 * y_1 * w1, J2 * u * w1 + m2 * (x2 * x_1 + z2 * y_1) * w1]
    after = np.linalg.solve(M, before)
    P_B = -m2 * (z1 * after[0] + z2 * after[1] - y_1 * w1) / cos(p2)
    P_K = P_B * sin(p2) - m2 * (x2 * after[1] - x_1 * w1)

    stop, t, (p, p2, w1, w2) = until(
        turns, hooked, [p, p2, *after], (lambda _, y: hook(y[0], y[1])[7] - h, ONWARDS),
        (lambda _, y: y[3], DOWN), (lambda _, y: y[0] - rest, DOWN), (tip_slides, DOWN),
    )  # fmt: skip
    if stop:
        raise Jam("in turning")
    at = hook(p, p2)
    vx, vy, left, stop = at[6] * w2, at[3] * w1 + at[5] * w2, t, 1
    on_wall = wall(t, [p2, w2]) > 0.0
    while stop:
        over, begin = (lambda _, y: y[0] - 2.5 * pi, UP), t
        if on_wall:
            stop, t, (p2, w2, vy) = until(
                slides, begin, [p2, w2, vy], over, (wall, DOWN), (lambda _, y: y[1], DOWN),
                (lambda _, y: y[2] + y[1] * (e * cos(y[0]) + r), DOWN),
            )  # fmt: skip
            if stop > 1:
                raise Jam("after the release")
            vx = e * sin(p2) * w2
        else:
            stop, t, (p2, _, vx) = until(
                lambda t, y, w2=w2: [w2, e * sin(y[0]) * w2 - y[2], F2(t) / m2], begin,
                [p2, 0.0, vx], over,
                (lambda t, y, soon=begin + 1e-7: y[1] if t > soon else 1.0, DOWN),
            )  # fmt: skip
            vy += g * (t - begin)
            w2 = (J2 * w2 + m2 * e * sin(p2) * vx) / (J2 + m2 * (e * sin(p2)) ** 2)
        on_wall = not on_wall
    times = {"falling": landed, "joint": hooked - landed, "turning": left - hooked}
    solution = {f"t_{name}": float(time) for name, time in (times | {"released": t - left}).items()}
    return solution | {
        "orientation_time": t,
        "S_x": float(S_x),
        "P_K": float(P_K),
        "corner_impulse": float(S_y),
        "wall_impulse": float(S_k),
        "hook_impulse": float(P_B),
    }
