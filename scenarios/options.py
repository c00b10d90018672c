"""What options say, read and checked in one place; all raise cosim.SetupError."""

from __future__ import annotations

import math
from argparse import ArgumentParser
from collections.abc import Sequence

import numpy as np

from cosim import SetupError
from cosim.commandline import assignment, literal
from cosim.system import Value

Start = dict[str, Value]


def add_start(parser: ArgumentParser, example: str) -> None:
    """The option that changes start values of the system."""
    parser.add_argument(
        "--start",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help=f"start value of an FMU, {example}, above what other options say (repeatable)",
    )


def start_values(settings: Sequence[str], own: Sequence[str] = ()) -> Start:
    """["motor.T=0.05"] -> {"motor.T": 0.05}; refuses what a scenario sets on its `own`."""
    values = {name: literal(text) for name, text in map(assignment, settings)}
    for name in values:
        if name in own:
            raise SetupError(f"start value {name}: this scenario sets it on its own")
    return values


def numbers(name: str, text: str) -> list[float]:
    """ "20:66:24" (from, to, number) or "20,30,40" as ascending numbers."""
    try:
        if ":" in text:
            first, last, count = text.split(":")
            values = np.linspace(float(first), float(last), int(count)).tolist()
        else:
            values = [float(value) for value in text.split(",")]
    except ValueError:
        raise SetupError(f"{name} {text!r} must read from:to:number or a,b,c") from None
    if not values:
        raise SetupError(f"{name} {text!r} name no number")
    return sorted(set(values))


def positive(name: str, value: float, unit: str) -> None:
    """Refuse what is not a finite number above 0."""
    if not 0.0 < value < math.inf:
        raise SetupError(f"{name} = {value!r} {unit} must be a finite number above 0")


def not_negative(name: str, value: float, unit: str = "") -> None:
    """Refuse what is not a finite number of at least 0."""
    if not 0.0 <= value < math.inf:
        text = f"{value!r} {unit}".rstrip()
        raise SetupError(f"{name} = {text} must be a finite number, at least 0")


def at_least(name: str, value: int, least: int) -> None:
    """Refuse a count that is too small."""
    if value < least:
        raise SetupError(f"{name} = {value} must be at least {least}")
