"""Conversions of units that people forget, or do twice: by what factor a number is then wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ...system import Network, Port
from ...units import multiples

#: Kelvin at 0 degrees Celsius: the definition of the degree Celsius.
CELSIUS_ZERO = 273.15
#: How many of the first unit are one of the second; those of length, mass and force by their definitions.
RATIOS = {
    ("deg", "rad"): 180.0 / math.pi, ("rpm", "rad/s"): 30.0 / math.pi, ("rad", "turn"): 2.0 * math.pi,
    ("s", "min"): 60.0, ("s", "h"): 3600.0, ("km/h", "m/s"): 3.6,
    ("in", "m"): 1.0 / 0.0254, ("ft", "m"): 1.0 / 0.3048, ("lb", "kg"): 1.0 / 0.45359237,
    ("lbf", "N"): 1.0 / 4.4482216152605, ("N", "kgf"): 9.80665, ("N.m", "lbf.ft"): 1.3558179483314,
    ("W", "hp"): 745.69987158227, ("degF", "K"): 1.8, ("peak", "rms value"): math.sqrt(2.0), ("diameter", "radius"): 2.0,
}  # fmt: skip
#: Share by which a factor may differ from that of a conversion and be it: a number that is fitted has its errors.
CLOSE = 1e-3
#: Prefixes of SI by the power of ten that they stand for.
PREFIXES = {-6: "u", -3: "m", -2: "c", 2: "h", 3: "k", 6: "M"}


def units_of(port: Port, network: Network) -> Iterator[tuple[str, float, float]]:
    """Other units of a variable that its FMU or people use, and factor and offset of a value in them."""
    for name, scale in sorted(multiples(port.unit).items()):
        if scale != 1.0:
            yield name, 1.0 / scale, 0.0
    for display in network.unit(port).displayUnits:
        if not display.inverse:
            yield display.name, display.factor, display.offset
    if port.unit == "K":
        yield "degC", 1.0, -CELSIUS_ZERO
    if port.unit == "degC":
        yield "K", 1.0, CELSIUS_ZERO


def wrong_factors(unit: str) -> Iterator[tuple[str, float]]:
    """What was taken for what, and by what factor a value in a unit is then wrong."""
    for (one, other), ratio in RATIOS.items():
        yield f"{one} for {other}", ratio
        yield f"{other} for {one}", 1.0 / ratio
    for power, prefix in PREFIXES.items():
        yield f"{prefix}{unit or '1'} for {unit or '1'}", 10.0**-power


def conversion_of(factor: float, unit: str) -> str:
    """The conversion by which a value in a unit is wrong by a factor, as ": rad/s for rpm?"; "" if none is known."""
    fits = (what for what, x in wrong_factors(unit) if abs(factor / x - 1.0) <= CLOSE)
    return next((f": {what}?" for what in fits), "")
