"""What options say, read and checked in one place; all raise cosim.SetupError."""

from __future__ import annotations

import math

import numpy as np

from cosim import SetupError


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
