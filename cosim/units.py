"""Units of measurements, as people and loggers write them for the quantities of FMUs."""

from __future__ import annotations

import math
import re

QUANTITY = re.compile(
    r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|[+-]?inf|nan)(?:\s*([a-z%][\w./%]*))?\s*",
    re.IGNORECASE,
)
SCALES: dict[str, dict[str, float]] = {
    "rad/s": {"rpm": math.pi / 30, "deg/s": math.pi / 180},
    "rad": {"deg": math.pi / 180, "turn": 2 * math.pi},
    "s": {"ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    "m": {"mm": 1e-3, "cm": 1e-2},
    "m/s": {"mm/s": 1e-3},
    "kg": {"g": 1e-3, "t": 1e3},
    "N": {"mN": 1e-3, "kN": 1e3},
    "N.m": {"mN.m": 1e-3, "kN.m": 1e3, "N.mm": 1e-3},
    "N/m": {"N/mm": 1e3, "kN/m": 1e3},
    "J": {"mJ": 1e-3, "kJ": 1e3},
    "W": {"mW": 1e-3, "kW": 1e3},
    "1": {"%": 0.01},
}


def multiples(unit: str) -> dict[str, float]:
    """The units of the same quantity as this one, and the factor from each to this one.

    It is this unit alone if no others are known.
    """
    for base, scales in SCALES.items():
        factors = {base: 1.0} | scales
        if unit in factors:
            return {name: scale / factors[unit] for name, scale in factors.items()}
    return {unit: 1.0}
