"""What the orientator scenarios share: one product through the FMU, stages and reasons by name."""

from __future__ import annotations

import math

from fmpy.model_description import read_model_description

import cosim
from cosim import Result, System

from . import fmus
from .options import Start

PARTS = {"orientator": "gravity_orientator"}
LONGEST = 1.5
ORIENTED, JAMMED = 4, 5


def system(n: float, mu: float, start: Start) -> System:
    """One product dropped at t = 0, at n rpm of the rotor and friction mu on the wall."""
    dropped: Start = {
        "orientator.w": n * math.pi / 30,
        "orientator.release": 1,
        "orientator.chute.mu": mu,
    }
    parts = {part: fmus.fmu(component) for part, component in PARTS.items()}
    return System(parts, start=dropped | start)


def product(
    n: float, mu: float, start: Start, step: float, stop: float, record: list[str]
) -> Result:
    """The course of one product."""
    names = [f"orientator.{name}" for name in record]
    return cosim.run(system(n, mu, start), stop=stop, step=step, record=names)


def item_names(variable: str) -> dict[int, str]:
    """The values of an enumeration of the FMU, in words."""
    description = read_model_description(str(fmus.fmu("gravity_orientator")))
    found = next(v for v in description.modelVariables if v.name == variable)
    return {int(item.value): item.name.replace("_", " ") for item in found.declaredType.items}
