"""The mechanisms as lines, from the outputs and parameters of their FMUs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from .motion import Columns, Samples, Shape, circle, line

Parameters = Mapping[str, Any]
ENLARGED = 4.0
AXIS = math.radians(-35.0)


def crank_conveyor(p: Parameters, at: Columns) -> list[Shape]:
    """Crank, rod, trough and spring, the crank drawn ENLARGED times as long as it is."""
    phi, l = at["phi"], p["rod.l"]
    r = ENLARGED * p["crank.r"]
    pin = (r * np.sin(phi), -r * np.cos(phi))
    x = l + ENLARGED * at["x"]
    end, height, wall = 1.1 * l, 0.12 * l, 2.7 * l
    trough = line((x, 0), (x, height), (x + end, height), (x + end, -height), (x, -height), (x, 0))
    coils = 14
    along = [(x + end) + (wall - x - end) * k / (coils + 1) for k in range(coils + 2)]
    across = [0.0, *(0.07 * l * (-1) ** k for k in range(coils)), 0.0]
    ground = -1.6 * height
    return [
        Shape("ground", line((-1.5 * r, ground), (wall, ground), (wall, height)), "grey", 2.0),
        Shape("circle of the crank", circle(0.0, 0.0, r), "grey", 1.0),
        Shape("spring", line(*zip(along, across)), "green", 2.0),
        Shape("trough", trough, "blue", 4.0),
        Shape("rod", line(pin, (x, 0.0)), "gold", 4.0),
        Shape("crank", line((0.0, 0.0), pin), "red", 6.0),
    ]


def iron_drive(p: Parameters, at: Columns, cam: Samples) -> list[Shape]:
    """Cam with its `pitch_curve`, rocker, link, chain over its sprocket, and iron."""
    C, A, R = p["sprocket.C"], p["sprocket.A"], p["sprocket.R"]
    l_K, l_T = p["rocker.l_K"], p["link.l"]
    phi, alpha, beta, H = (at[name] for name in ("phi", "alpha", "beta", "H"))
    hub, roller, turn = _hub(p), _roller(p, alpha), phi[:, None]
    body = np.stack(
        [
            hub[0] + cam[0] * np.cos(turn) - cam[1] * np.sin(turn),
            hub[1] + cam[0] * np.sin(turn) + cam[1] * np.cos(turn),
        ],
        axis=-1,
    )
    D = (l_K * np.cos(alpha), l_K * np.sin(alpha))
    joint = (D[0] + l_T * np.cos(beta), D[1] + l_T * np.sin(beta))
    leaves = beta - math.pi / 2 if p["wrap"] else np.full_like(beta, math.pi / 2)
    arc = [leaves + (math.pi - leaves) * share for share in np.linspace(0.0, 1.0, 16)]
    over = [(-C + R * np.cos(a), A + R * np.sin(a)) for a in arc]
    x, y, half = -C - R, A - H, 0.05
    iron = line(
        (x - half, y), (x + half, y), (x + half, y - half), (x - half, y - half)
    )  # fmt: skip
    return [
        Shape("sprocket", circle(-C, A, R), "gold", 1.5),
        Shape("cam", body, "red", 3.0, closed=True),
        Shape(
            "mark of the cam", line((hub[0], hub[1]), (body[:, 0, 0], body[:, 0, 1])), "red", 1.5
        ),
        Shape("rocker", line((roller[0], roller[1]), (0.0, 0.0), D), "grey", 6.0),
        Shape("roller", roller.T[:, None] + circle(0.0, 0.0, 0.01), "red", 2.0),
        Shape("link", line(D, joint), "blue", 4.0),
        Shape("chain", line(joint, *over, (x, y)), "gold", 2.5),
        Shape("iron", iron, "green", 5.0, closed=True),
        Shape("axis of the rocker", circle(0.0, 0.0, 0.008), "grey", 3.0),
        Shape("axis of the cam", circle(hub[0], hub[1], 0.008), "grey", 3.0),
    ]


def pitch_curve(p: Parameters, phi: Samples, alpha: Samples) -> Samples:
    """What the roller's centre does about the cam in one whole turn, at phi = 0, shape (2, n)."""
    reach = _roller(p, alpha) - _hub(p)[:, None]
    distance, bearing = np.hypot(*reach), np.arctan2(reach[1], reach[0]) - phi
    return np.stack([distance * np.cos(bearing), distance * np.sin(bearing)])


def _hub(p: Parameters) -> Samples:
    """The cam's axis, seen from the rocker's."""
    return np.asarray(p["rocker.L"] * np.array([math.cos(AXIS), math.sin(AXIS)]))


def _roller(p: Parameters, alpha: Samples) -> Samples:
    """The roller's centre, shape (2, frames)."""
    angle = AXIS - (p["rocker.alpha0"] - alpha)
    return np.asarray(p["rocker.l"] * np.stack([np.cos(angle), np.sin(angle)]))


def gravity_orientator(p: Parameters, at: Columns) -> list[Shape]:
    """Wall, catcher and cup; the FMU counts y downwards."""
    phi1, phi2, xc, yc = (at[name] for name in ("phi1", "phi2", "xc", "yc"))
    r, back, front = p["cup.d"] / 2, p["cup.l"], p["cup.h"] - p["cup.l"]
    c, s = np.cos(phi2), np.sin(phi2)

    def cup(along: float, aside: float) -> tuple[Samples, Samples]:
        return xc + along * c - aside * s, -(yc + along * s + aside * c)

    bend = np.linspace(-math.pi / 2, math.pi / 2, 25)
    bottom = [cup(front + r * math.cos(b), r * math.sin(b)) for b in bend]
    corner = (p["catcher.l"] * np.cos(phi1), -p["catcher.l"] * np.sin(phi1))
    hook = (corner[0] + p["catcher.h"] * np.sin(phi1), corner[1] + p["catcher.h"] * np.cos(phi1))
    wall = p["catcher.l"] * math.cos(p["catcher.phi"]) + p["cup.d"]
    return [
        Shape("wall", line((wall, 0.07), (wall, -0.3)), "grey", 4.0),
        Shape("pivot", circle(0.0, 0.0, 0.003), "blue", 3.0),
        Shape("cup", line(cup(-back, -r), *bottom, cup(-back, r)), "red", 3.0),
        Shape("catcher", line((0.0, 0.0), corner, hook), "blue", 4.0),
    ]
