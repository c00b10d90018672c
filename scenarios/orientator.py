"""What the orientator scenarios share: one product through the FMU, stages and reasons by name."""

from __future__ import annotations

import math
from pathlib import Path

from fmpy.model_description import read_model_description

import cosim
from cosim import Result, System

from . import fmus

LONGEST = 1.5
ORIENTED, JAMMED = 4, 5


def product(n: float, mu: float, step: float, stop: float, record: list[str]) -> Result:
    """One product dropped at t = 0, at n rpm of the rotor and friction mu on the wall."""
    start: dict[str, float | int | bool | str] = {
        "orientator.w": n * math.pi / 30,
        "orientator.release": 1,
        "orientator.chute.mu": mu,
    }
    system = System({"orientator": fmus.fmu("gravity_orientator")}, start=start)
    return cosim.run(system, stop=stop, step=step, record=[f"orientator.{x}" for x in record])


def item_names(variable: str) -> dict[int, str]:
    """The values of an enumeration of the FMU, in words."""
    description = read_model_description(str(fmus.fmu("gravity_orientator")))
    found = next(v for v in description.modelVariables if v.name == variable)
    return {int(item.value): item.name.replace("_", " ") for item in found.declaredType.items}


def built() -> Path:
    """Build the FMU where needed; its path."""
    fmus.build("gravity_orientator")
    return fmus.fmu("gravity_orientator")
