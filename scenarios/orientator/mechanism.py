"""The orientator as lines, from the outputs and parameters of its FMU."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from workbench.report.motion import Columns, Samples, Shape, arrow, ground, line, pivot

Parameters = Mapping[str, Any]


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
    falls = arrow(line((wall - 3.2 * r, 0.07), (wall - 3.2 * r, 0.02)), 0.012)
    return [
        Shape("wall", ground(wall, -0.3, wall, 0.07, 0.015), "grey", 1.5, label=0),
        Shape("pivot", pivot(0.0, 0.0, 0.008), "grey", 1.5, label=1),
        Shape("falls", falls, "grey", 1.5, label=0),
        Shape("cup", line(cup(-back, -r), *bottom, cup(-back, r)), "red", 3.0, label=0),
        Shape("catcher", line((0.0, 0.0), corner, hook), "blue", 4.0, label=1),
    ]
