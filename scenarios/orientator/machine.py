"""What the questions of the orientator share: one product through the FMU, stages and reasons."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import cosim
from cosim import Result, System
from cosim.system import Value
from workbench.measure import Samples

PARTS = {"orientator": "GravityOrientator"}
LONGEST = 1.5
ORIENTED, JAMMED = 4, 5
ITEMS = {
    "stage": ("falling", "joint", "turning", "released", "oriented", "jammed", "waiting"),
    "reason": (
        "none", "held in chute", "catcher stopped", "rim stayed at hook contact",
        "sliding stopped in turning", "turning stopped", "catcher back at stop",
        "rotation stopped after release", "sliding stopped after release",
    ),
}  # fmt: skip
STAGES = ("falling", "joint", "turning", "released")


def system(fmus: Mapping[str, Path], w: float, mu: float, start: Mapping[str, Value]) -> System:
    """One product dropped at t = 0, at the speed w of the rotor [rad/s] and friction mu on the wall."""
    dropped = {"orientator.w": w, "orientator.release": 1, "orientator.chute.mu": mu}
    return System({"orientator": fmus["orientator"]}, start={**dropped, **start})


def product(system: System, step: float, record: Sequence[str], stop: float = LONGEST) -> Result:
    """The course of one product."""
    return cosim.run(system, stop=stop, step=step, record=names(record))


def shortened(r: Result) -> Result:
    """The rows up to the first one after the end."""
    over = (r["orientator.stage"] >= ORIENTED).nonzero()[0]
    rows: Samples = r.data[: over[0] + 1] if len(over) else r.data
    return Result(r.columns, r.units, r.provenance, lambda: rows)


def names(variables: Sequence[str]) -> list[str]:
    """The orientator's variables as the system names them."""
    return [f"orientator.{name}" for name in variables]


def item_names(variable: str) -> dict[int, str]:
    """The values of an enumeration of the FMU, in words."""
    return dict(enumerate(ITEMS[variable]))


def rpm(w: float) -> float:
    """A speed [rad/s] in turns per minute, to the ninth decimal, so that 20 rpm stay 20."""
    return round(w * 30 / math.pi, 9)


def rad_per_s(n: float) -> float:
    """A speed [rpm] in rad/s."""
    return n * math.pi / 30
