"""A plane of two parameters of motor and conveyor: every point is a machine at a speed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim import SetupError
from workbench.answer import Parameter, parameters
from workbench.options import at_least
from workbench.report.chart import Direction

from .drive import conveyor_drive
from .response import Line, Spot
from .theory import FIELDS, Machine

SPEED = "speed"


class Axis(NamedTuple):
    """A parameter and its values."""

    name: str
    along: Direction


class Plane(NamedTuple):
    """Two axes; all else is as in `machine`, which turns at `speed` [rad/s] unless x is the speed."""

    x: Axis
    y: Axis
    machine: Machine
    speed: float

    @property
    def units(self) -> dict[str, str]:
        """Those of both axes, by name."""
        return {axis.name: axis.along.unit for axis in (self.x, self.y)}

    def at(self, x: Any, y: Any) -> tuple[Machine, Any]:
        """The machine at a point, or machines at arrays of points, and its mean speed [rad/s]."""
        here = {self.x.name: x, self.y.name: y}
        nu = here.pop(SPEED, self.speed)
        return replace(self.machine, **{FIELDS[name]: v for name, v in here.items()}), nu

    def nodes(self) -> list[tuple[float, float]]:
        """x and y of all points, row by row."""
        x, y = self.x.along.values.tolist(), self.y.along.values.tolist()
        return [(one, level) for level in y for one in x]

    def spots(self) -> list[Spot]:
        """The machines of these and their mean speeds."""
        return [(*self.at(*node), 1) for node in self.nodes()]

    def line(self, y: float) -> Line:
        """The machines of equal y."""
        first, last = self.x.along.values[[0, -1]].tolist()
        return Line(lambda x: self.at(x, y), first, last)


def part(fmus: Mapping[str, Path], name: str) -> Parameter:
    """A parameter as its FMU has it; raises SetupError for names not in FIELDS."""
    if name not in FIELDS:
        raise SetupError(f"{name!r} is no part of the drive, only {', '.join(FIELDS)}")
    return parameters(conveyor_drive(fmus, {}))[name]


def axis(fmus: Mapping[str, Path], option: str, text: str, least: int) -> Axis:
    """Read NAME=FROM:TO:NUMBER[:log], at least so many values; raises SetupError."""
    name, _, numbers = text.partition("=")
    if name == SPEED and option != "x":
        raise SetupError(f"--{option} {text}: the speed belongs on x")
    words, unit = "Operating speed", "rad/s"
    if name != SPEED:
        _, unit, meaning = part(fmus, name)
        words = f"{meaning}\n{name}"
    log = numbers.endswith(":log")
    form = "NAME=FROM:TO:NUMBER or NAME=FROM:TO:NUMBER:log"
    low, high, number = read(option, text, numbers.removesuffix(":log"), form, float, float, int)
    for value in (low, high):
        if not 0.0 < value < math.inf:
            raise SetupError(
                f"--{option} {name} = {value!r} {unit} must be a finite number above 0"
            )
    if high <= low:
        raise SetupError(f"--{option} {name} must rise: {low:g} .. {high:g} {unit} does not")
    at_least(f"--{option} number of values of {name}", number, least)
    values = np.geomspace(low, high, number) if log else np.linspace(low, high, number)
    return Axis(name, Direction(words, unit, values, log))


def shares(
    fmus: Mapping[str, Path], option: str, texts: Sequence[str], default: Mapping[str, float]
) -> dict[str, float]:
    """Read NAME=PERCENT, several, over the defaults, as shares of 1; raises SetupError."""
    found = dict(default)
    for text in texts:
        name, _, percent = text.partition("=")
        part(fmus, name)
        (value,) = read(option, text, percent, "NAME=PERCENT", float)
        if not 0.0 <= value < 100.0:
            raise SetupError(f"--{option} {name} = {value!r} % must be at least 0 and below 100")
        found[name] = value / 100.0
    return found


def span(option: str, text: str, within: Direction) -> tuple[float, float]:
    """Read FROM:TO inside an axis; raises SetupError."""
    low, high = read(option, text, text, "FROM:TO", float, float)
    first, last = within.values[[0, -1]]
    if not first <= low < high <= last:
        raise SetupError(
            f"--{option} {low:g}:{high:g} {within.unit} must rise and lie inside the map, "
            f"{first:g} .. {last:g} {within.unit}"
        )
    return low, high


def read(option: str, text: str, numbers: str, form: str, *kinds: type) -> list[Any]:
    """Numbers between colons; raises SetupError for others than these kinds of them."""
    try:
        return [kind(number) for kind, number in zip(kinds, numbers.split(":"), strict=True)]
    except ValueError:
        raise SetupError(f"--{option} {text!r} must read {form}") from None
