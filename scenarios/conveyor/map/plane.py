"""A plane of two parameters of motor and conveyor: every point is a machine at a speed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim.system import Port, Value, describe_fmu
from workbench import Bench
from workbench.options import at_least

from ..response import Case
from ..theory import FIELDS, Machine

SPEED = "speed"


class Axis(NamedTuple):
    """A parameter, its unit and meaning, its values, and whether these are even in its logarithm."""

    name: str
    unit: str
    meaning: str
    values: NDArray[np.float64]
    log: bool

    @property
    def label(self) -> str:
        """What stands at the axis of a picture."""
        name = "" if self.name == SPEED else f"\n{self.name}"
        return f"{self.meaning}{name} [{self.unit}]"


class Plane(NamedTuple):
    """Two axes; all else is as in `machine`, which turns at `speed` [rad/s] unless x is the speed."""

    x: Axis
    y: Axis
    machine: Machine
    speed: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows of equal y, columns of equal x."""
        return len(self.y.values), len(self.x.values)

    @property
    def over_speed(self) -> bool:
        return self.x.name == SPEED

    def at(self, x: float, y: float) -> tuple[Machine, float]:
        """The machine at a point, and its mean speed [rad/s]."""
        here = {self.x.name: x, self.y.name: y}
        nu = here.pop(SPEED, self.speed)
        return replace(self.machine, **{FIELDS[name]: v for name, v in here.items()}), nu

    def points(self) -> Iterator[tuple[Machine, float]]:
        """All points, row by row."""
        return (self.at(float(x), float(y)) for y in self.y.values for x in self.x.values)


class Setup(NamedTuple):
    """How machines are run: start values that they do not know, algorithm, steps, and on what."""

    start: Mapping[str, Value]
    algorithm: str
    steps_per_rev: int
    bench: Bench

    def case(self, machine: Machine, nu: float, coarser: int = 1) -> Case:
        """The case of a machine at its nominal mean speed [rad/s], with `coarser` times fewer steps."""
        start = {**machine.start(nu), **self.start}
        steps = self.steps_per_rev // coarser
        return Case(self.bench.fmus, start, machine, nu, steps, self.algorithm)


def part(fmus: Mapping[str, Path], name: str) -> tuple[str, str]:
    """Unit and meaning that an FMU gives a parameter; raises SetupError for names not in FIELDS."""
    if name not in FIELDS:
        raise cosim.SetupError(f"{name!r} is no part of the drive, only {', '.join(FIELDS)}")
    owner, _, variable = name.partition(".")
    description = describe_fmu(owner, fmus[owner])
    found = next(v for v in description.modelVariables if v.name == variable)
    return Port(owner, found).unit, found.description


def axis(fmus: Mapping[str, Path], option: str, text: str, least: int) -> Axis:
    """Read NAME=FROM:TO:NUMBER[:log], at least so many values; raises SetupError."""
    name, _, numbers = text.partition("=")
    if name == SPEED and option != "x":
        raise cosim.SetupError(f"--{option} {text}: the speed belongs on x")
    unit, meaning = ("rad/s", "Operating speed") if name == SPEED else part(fmus, name)
    try:
        first, last, count, *spacing = numbers.split(":")
        low, high, number = float(first), float(last), int(count)
        log = {(): False, ("log",): True}[tuple(spacing)]
    except (ValueError, KeyError):
        raise cosim.SetupError(
            f"--{option} {text!r} must read NAME=FROM:TO:NUMBER or NAME=FROM:TO:NUMBER:log"
        ) from None
    for value in (low, high):
        if not 0.0 < value < math.inf:
            raise cosim.SetupError(
                f"--{option} {name} = {value!r} {unit} must be a finite number above 0"
            )
    if high <= low:
        raise cosim.SetupError(f"--{option} {name} must rise: {low:g} .. {high:g} {unit} does not")
    at_least(f"--{option} number of values of {name}", number, least)
    values = np.geomspace(low, high, number) if log else np.linspace(low, high, number)
    return Axis(name, unit, meaning, values, log)


def shares(
    fmus: Mapping[str, Path], option: str, texts: Sequence[str], default: dict[str, float]
) -> dict[str, float]:
    """Read NAME=PERCENT, several, over the defaults, as shares of 1; raises SetupError."""
    read = dict(default)
    for text in texts:
        name, _, percent = text.partition("=")
        part(fmus, name)
        try:
            value = float(percent)
        except ValueError:
            raise cosim.SetupError(f"--{option} {text!r} must read NAME=PERCENT") from None
        if not 0.0 <= value < 100.0:
            raise cosim.SetupError(
                f"--{option} {name} = {value!r} % must be at least 0 and below 100"
            )
        read[name] = value / 100.0
    return read


def span(option: str, text: str, within: Axis) -> tuple[float, float]:
    """Read FROM:TO inside an axis; raises SetupError."""
    try:
        low, high = (float(end) for end in text.split(":"))
    except ValueError:
        raise cosim.SetupError(f"--{option} {text!r} must read FROM:TO") from None
    first, last = float(within.values[0]), float(within.values[-1])
    if not (first <= low < high <= last and math.isfinite(high)):
        raise cosim.SetupError(
            f"--{option} {low:g}:{high:g} {within.unit} must rise and lie inside the map, "
            f"{first:g} .. {last:g} {within.unit}"
        )
    return low, high
