"""The crank and the link that it moves, and the other end of the elastic shaft, as lines in motion."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from cosim import Result
from workbench.charts import motion
from workbench.charts.motion import Shape, line
from workbench.live import Caption, Coordinate, LiveMotion

TITLE = "Both ends of the shaft"
NOTE = "The thin hand is the gearbox end of the shaft, the crank the load end. Their angle is the twist."
#: How many times slower than the drive the motion runs; a convention.
SLOWER = 5.0


def link_shapes(p: Mapping[str, Any], at: motion.Columns) -> list[Shape]:
    """The lines by columns with the names of the system, and the parameters of the load."""
    a, x, phi, ahead = p["crank.r"], at["load.x"], at["load.phi"], at["gear.phi_b"]
    tilt = 1.0 / p["link.l"] if p["link.swings"] else 0.0
    pin, high = (a * np.sin(phi), a * np.cos(phi)), 1.4 * a
    slot = line((x * (1.0 - high * tilt), -high), (x * (1.0 + high * tilt), high))
    near, far = x + 3.0 * a, x + 6.0 * a
    trough = line((near, -a), (far, -a), (far, a), (near, a))
    hand = line((0.0, 0.0), (1.8 * a * np.sin(ahead), 1.8 * a * np.cos(ahead)))
    return [
        Shape("ground", motion.ground(1.6 * a, -1.2 * a, 7.4 * a, -1.2 * a, 0.3 * a), "grey", 1.5),
        Shape("slot", slot, "green", 5.0),
        Shape("rod", line((x, 0.0), (near, 0.0)), "green", 3.0),
        Shape("trough", trough, "green", 3.0, closed=True, label=2),
        Shape("gearbox", hand, "blue", 2.0, label=1),
        Shape("crank", line((0.0, 0.0), pin), "red", 4.0),
        Shape("pin", line(pin, pin), "red", 12.0),
    ]


def live_motion(r: Result) -> LiveMotion:
    """The crank and the link that it moves, and the other end of the shaft as a second hand."""
    p = r.provenance["parts"]["load"]["parameters"]
    a = p["crank.r"]
    return LiveMotion(
        TITLE,
        partial(link_shapes, p),
        [
            Coordinate("load.phi", 0.0, 2 * math.pi, (1.0,)),
            Coordinate("load.x", -a, a),
            Coordinate("gear.phi_b", 0.0, 2 * math.pi, (1.0,)),
        ],
        [Caption("gearbox", "gear.w_b", "rad/s"), Caption("load", "load.w", "rad/s")],
        SLOWER,
        NOTE,
    )
