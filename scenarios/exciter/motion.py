"""The unbalanced rotor on its mount as lines, from the outputs and the parameters of its FMU."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from workbench.charts import motion
from workbench.charts.motion import Columns, Shape, line
from workbench.live import Caption, Coordinate, LiveMotion

#: How many times too large the displacement is drawn; a convention, so that it is seen.
ENLARGED = 2.0
NOTE = f"The displacement is drawn {ENLARGED:g} times as large as it is."


def exciter(p: Mapping[str, Any], at: Columns) -> list[Shape]:
    """Wall, spring, damper, body and rotor; x is drawn ENLARGED times as long as it is."""
    r, x, phi = p["rotor.r"], ENLARGED * at["x"], at["phi"]
    half, wall, floor = 1.8 * r, -5.0 * r, -2.2 * r
    body = line((x - half, -half), (x + half, -half), (x + half, half), (x - half, half))
    turns = motion.arrow(motion.arc(0.0, 0.0, 2.4 * r, 0.35 * math.pi, 0.65 * math.pi), 0.4 * r)
    arrows = motion.arrow(line((2.4 * r, 0.0), (3.4 * r, 0.0)), 0.3 * r)
    damper = motion.damper((wall, -r), (x - half, -r), 0.35 * r)
    mass = (x + r * np.cos(phi), r * np.sin(phi))
    return [
        Shape("wall", motion.ground(wall, half, wall, floor, 0.3 * r), "grey", 1.5),
        Shape("floor", motion.ground(wall, floor, 3.5 * r, floor, 0.3 * r), "grey", 1.5),
        Shape("spring", motion.spring((wall, r), (x - half, r), 0.4 * r), "green", 2.0, label=3),
        Shape("damper", damper, "purple", 1.5),
        Shape("body", body, "blue", 4.0, closed=True, label=2),
        Shape("arm", line((x, 0.0), mass), "red", 4.0),
        Shape("turns", turns, "red", 1.5),
        Shape("moves", arrows, "blue", 1.5),
        Shape("mass", line(mass, mass), "red", 12.0),
    ]


def live_motion(title: str, parameters: Mapping[str, Any]) -> LiveMotion:
    """Runs, one above the other; `parameters` are those of the system."""
    p = {name.removeprefix("exciter."): x.value for name, x in parameters.items()}
    r = p["rotor.r"]
    return LiveMotion(
        title,
        lambda at: exciter(p, {"phi": at["exciter.phi"], "x": at["exciter.x"]}),
        [
            Coordinate("exciter.phi", 0.0, 2 * math.pi, (1.0,)),
            Coordinate("exciter.x", -r / 4, r / 4),
        ],
        [Caption("", "exciter.w", "rad/s")],
        4.0,
        NOTE,
        offset=(0.0, -5.0 * r),
    )
