"""What the questions of the orientator share: one product through the FMU, stages and reasons."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np

from cosim import Result, System
from cosim.system import Value
from workbench.charts.model import Span

PARTS = {"orientator": "GravityOrientator"}
#: Time after which a product that has not come out is given up [s]; a convention, five slow products long.
LONGEST = 1.5
#: Number of the stage of a product that came out, by the FMU.
ORIENTED = 4
#: Number of the stage of a jam, by the FMU.
JAMMED = 5
STAGES = ("falling", "joint", "turning", "released", "oriented", "jammed", "waiting")
COLORS = ("grey", "sky", "green", "gold", "purple", "red", "grey")
REASONS = (
    "none", "held in chute", "catcher stopped", "rim stayed at hook contact",
    "sliding stopped in turning", "turning stopped", "catcher back at stop",
    "rotation stopped after release", "sliding stopped after release",
)  # fmt: skip


def system(fmus: Mapping[str, Path], w: float, mu: float, start: Mapping[str, Value]) -> System:
    """One product dropped at t = 0, at the speed w of the rotor [rad/s] and friction mu on the wall."""
    dropped = {"orientator.w": w, "orientator.release": 1, "orientator.chute.mu": mu}
    return System(fmus, start={**dropped, **start})


def until_oriented_or_jammed(r: Result) -> Result:
    """The rows up to the first one after the end."""
    over = np.flatnonzero(r["orientator.stage"] >= ORIENTED)
    return r.select(slice(over[0] + 1)) if len(over) else r


def stages(r: Result, first: int = 0, last: int = -1) -> list[Span]:
    """The stages of a product between two rows, from when to when [s]."""
    t, stage = r["time"], r["orientator.stage"].astype(int)
    last %= len(t)
    begins = [first, *(np.flatnonzero(np.diff(stage[first:last])) + first + 1).tolist(), last]
    return [
        Span(float(t[a]), float(t[b]), STAGES[stage[a]], COLORS[stage[a]])
        for a, b in pairwise(begins)
    ]
