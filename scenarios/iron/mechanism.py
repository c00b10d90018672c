"""The sealing iron as lines, from the outputs and parameters of its FMU."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from workbench.report.motion import (
    Columns,
    Samples,
    Shape,
    arc,
    arrow,
    circle,
    ground,
    line,
    pivot,
    spring,
)

Parameters = Mapping[str, Any]
AXIS = math.radians(-35.0)
ROLLER = 0.012


def iron_drive(p: Parameters, at: Columns, cam: Samples) -> list[Shape]:
    """Cam of the `working_profile`, rocker with its roller, link, chain over its sprocket, iron in
    its guide above the product."""
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
    over = [
        (-C + R * np.cos(a), A + R * np.sin(a))
        for share in np.linspace(0.0, 1.0, 16)
        for a in [leaves + (math.pi - leaves) * share]
    ]
    x, y, half = -C - R, A - H, 0.05
    iron = line((x - half, y), (x + half, y), (x + half, y - half), (x - half, y - half))
    lowest, highest = float(np.min(y)) - half, float(np.max(y))
    table, top = lowest - 0.09, highest + 0.12
    box = line((x - half, lowest), (x, lowest), (x, table), (x - half, table))
    aside = x + 0.7 * half
    if p["spring.side"] > 0:
        fixed, coil = (aside, table), (aside, y - half)
    else:
        fixed, coil = (aside, top), (aside, y)
    shapes = [
        Shape("table", ground(x - 1.6 * half, table, x + 1.6 * half, table, 0.02), "grey", 1.5),
        Shape("sprocket", circle(-C, A, R), "gold", 1.5, label=42),
        Shape("bearing of the sprocket", pivot(-C, A, 0.012), "grey", 1.5),
        Shape("bearing of the rocker", pivot(0.0, 0.0, 0.012), "grey", 1.5),
        Shape("bearing of the cam", pivot(hub[0], hub[1], 0.012), "grey", 1.5),
        Shape("cam", body, "red", 3.0, closed=True, label=0),
        Shape("turns", arrow(arc(hub[0], hub[1], 0.05, -0.4, 1.2), 0.015), "red", 1.5),
        Shape(
            "mark of the cam", line((hub[0], hub[1]), (body[:, 0, 0], body[:, 0, 1])), "red", 1.0
        ),
        Shape("rocker", line((roller[0], roller[1]), (0.0, 0.0), D), "grey", 6.0, label=1),
        Shape("roller", roller.T[:, None] + circle(0.0, 0.0, ROLLER), "black", 2.0, label=6),
        Shape("link", line(D, joint), "blue", 4.0, label=1),
        Shape("chain", line(joint, *over, (x, y)), "gold", 2.5, label=1),
        Shape("spring", spring(coil, fixed, 0.012), "purple", 1.5, label=6),
        Shape("product", box, "sky", 2.0, closed=True, label=3),
        Shape("guide", line((x - half - 0.008, top), (x - half - 0.008, lowest)), "grey", 1.5),
        Shape("guide", line((x + half + 0.008, top), (x + half + 0.008, lowest)), "grey", 1.5),
        Shape("iron", iron, "green", 5.0, closed=True, label=2),
    ]
    if p["spring.side"] < 0:
        shapes.append(Shape("ceiling", ground(x + half, top, x, top, 0.02), "grey", 1.5))
    return shapes


def working_profile(p: Parameters, phi: Samples, alpha: Samples) -> Samples:
    """The cam itself at phi = 0, from one whole turn, shape (2, n): what the roller's centre does
    about it, nearer by the roller's radius."""
    reach = _roller(p, alpha) - _hub(p)[:, None]
    distance, bearing = np.hypot(*reach), np.arctan2(reach[1], reach[0]) - phi
    path = np.stack([distance * np.cos(bearing), distance * np.sin(bearing)])
    along = np.roll(path, -1, axis=1) - np.roll(path, 1, axis=1)
    normal = np.stack([-along[1], along[0]]) / np.hypot(*along)
    inwards = -np.sign(np.sum(normal * path))
    return np.asarray(path + ROLLER * inwards * normal)


def _hub(p: Parameters) -> Samples:
    """The cam's axis, seen from the rocker's."""
    return np.asarray(p["rocker.L"] * np.array([math.cos(AXIS), math.sin(AXIS)]))


def _roller(p: Parameters, alpha: Samples) -> Samples:
    """The roller's centre, shape (2, frames)."""
    angle = AXIS - (p["rocker.alpha0"] - alpha)
    return np.asarray(p["rocker.l"] * np.stack([np.cos(angle), np.sin(angle)]))
