"""Units of measurements, as people and loggers write them for the quantities of FMUs."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

QUANTITY = re.compile(
    r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|[+-]?inf|nan)(?:\s*([a-z%][\w./%]*))?\s*",
    re.IGNORECASE,
)
#: The one table of units: by the unit of a quantity, its powers of SI base units and the other units with their factors.
#: J and N.m, and rad/s and Hz, are quantities of their own, so that no message offers one for the other.
QUANTITIES: dict[str, tuple[dict[str, int], dict[str, float]]] = {
    "rad/s": ({"s": -1, "rad": 1}, {"rpm": math.pi / 30, "deg/s": math.pi / 180}),
    "rad": ({"rad": 1}, {"deg": math.pi / 180, "turn": 2 * math.pi}),
    "s": ({"s": 1}, {"ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}),
    "m": ({"m": 1}, {"mm": 1e-3, "cm": 1e-2}),
    "m/s": ({"m": 1, "s": -1}, {"mm/s": 1e-3}),
    "m3/s": ({"m": 3, "s": -1}, {"l/min": 1e-3 / 60, "l/s": 1e-3, "m3/h": 1.0 / 3600}),
    "kg": ({"kg": 1}, {"g": 1e-3, "t": 1e3}),
    "N": ({"kg": 1, "m": 1, "s": -2}, {"mN": 1e-3, "kN": 1e3}),
    "N.m": ({"kg": 1, "m": 2, "s": -2}, {"mN.m": 1e-3, "kN.m": 1e3, "N.mm": 1e-3}),
    "N/m": ({"kg": 1, "s": -2}, {"N/mm": 1e3, "kN/m": 1e3, "MN/m": 1e6}),
    "Pa": ({"kg": 1, "m": -1, "s": -2}, {"kPa": 1e3, "MPa": 1e6, "bar": 1e5}),
    "J": ({"kg": 1, "m": 2, "s": -2}, {"mJ": 1e-3, "kJ": 1e3}),
    "W": ({"kg": 1, "m": 2, "s": -3}, {"mW": 1e-3, "kW": 1e3}),
    "1": ({}, {"%": 0.01}),
}


def is_common(unit: str) -> bool:
    """Whether people and loggers mean one unit by a name."""
    return len(multiples(unit)) > 1


def multiples(unit: str) -> dict[str, float]:
    """The units of the same quantity as this one, and the factor from each to this one.

    It is this unit alone if no others are known.
    """
    for base, (_, scales) in QUANTITIES.items():
        factors = {base: 1.0} | scales
        if unit in factors:
            return {name: scale / factors[unit] for name, scale in factors.items()}
    return {unit: 1.0}


class NumberWithUnit(NamedTuple):
    """A number as it is written, and its unit, "" for none."""

    number: float
    unit: str


def read_quantity(text: object) -> NumberWithUnit | None:
    """The one reader of "7.3 rpm", "9.3e5N/m", "-.5", "inf"; None for what is no such text."""
    match = QUANTITY.fullmatch(text) if isinstance(text, str) else None
    return NumberWithUnit(float(match[1]), match[2] or "") if match else None


def in_unit(text: object, unit: str) -> float:
    """The number of "7.3 rpm" in this unit, in which it is if it states none; nan for another text or quantity."""
    written = read_quantity(text)
    return (
        multiples(unit).get(written.unit or unit, math.nan) * written.number
        if written
        else math.nan
    )
