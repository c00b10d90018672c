"""The conveyor as lines, from the outputs and parameters of its FMU."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from workbench.report import motion
from workbench.report.motion import Columns, Shape, line

Parameters = Mapping[str, Any]
ENLARGED = 4.0


def crank_conveyor(p: Parameters, at: Columns) -> list[Shape]:
    """Crank, rod, trough and spring, the crank drawn ENLARGED times as long as it is."""
    phi, l = at["phi"], p["rod.l"]
    r = ENLARGED * p["crank.r"]
    pin = (r * np.sin(phi), -r * np.cos(phi))
    x = l + ENLARGED * at["x"]
    end, height, wall = 1.1 * l, 0.12 * l, 2.7 * l
    trough = line((x, 0), (x, height), (x + end, height), (x + end, -height), (x, -height), (x, 0))
    coil = motion.spring((x + end, 0.0), (wall, 0.0), 0.07 * l, 14)
    floor = -1.35 * height
    turns = motion.arrow(motion.arc(0.0, 0.0, 1.3 * r, -0.3 * math.pi, 0.2 * math.pi), 0.3 * r)
    return [
        Shape("floor", motion.ground(0.8 * l, floor, wall, floor, 0.05 * l), "grey", 1.5),
        Shape("wall", motion.ground(wall, height, wall, floor, 0.05 * l), "grey", 1.5),
        Shape("bearing", motion.pivot(0.0, 0.0, 0.6 * r), "grey", 1.5),
        Shape("circle of the crank", motion.circle(0.0, 0.0, r), "grey", 1.0),
        Shape("spring", coil, "green", 2.0, label=3),
        Shape("trough", trough, "blue", 4.0, label=1),
        Shape("rod", line(pin, (x, 0.0)), "gold", 4.0),
        Shape("crank", line((0.0, 0.0), pin), "red", 6.0),
        Shape("turns", turns, "red", 1.5),
    ]
