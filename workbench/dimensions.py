"""Whether a formula gives its result in the unit that is stated for it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import SetupError
from cosim.system.base_units import BASES, common_unit, unit_exponents

from .figure import Figure
from .formula import Formula
from .options import Options, declared

#: By how much a unit is made smaller; chosen: so little that comparisons in a formula come out as before.
SCALE = 1.01
#: Sets of values with which a formula is computed; chosen: where one of them is outside its domain, others are not.
DRAWS = 20
#: Differences of powers that are rounding. Derived: 1e-15 of a value is 1e-13 of a power of SCALE.
POWER_ROUNDING = 1e-9
#: Numbers that may turn a value into another unit, as 60 and pi do; halves, doubles and the like do not.
CONVERSION = re.compile(r"\bpi\b|(?<![\w.])(?![1-9]\b(?!\.))[\d.]")


def unit_powers(unit: str) -> NDArray[np.float64] | None:
    """Return the powers of the base units but rad, and of SCALE for the factor of "kN.m/s2"; None if it is not known."""
    powers = np.zeros(len(BASES))
    for k, product in enumerate(unit.split("/")):
        for text in product.split("."):
            match = re.fullmatch(r"(1|[A-Za-z%]+)(-?\d+)?", text)
            base = common_unit(match[1]).baseUnit if match else None
            if match is None or base is None:
                return None
            own = [*unit_exponents(base)[:-1], math.log(base.factor, SCALE)]
            powers += (-1.0 if k else 1.0) * int(match[2] or 1) * np.array(own)
    return powers


def known_units(
    o: Options | None, figures: Mapping[str, Figure], *others: Mapping[str, Any]
) -> dict[str, str]:
    """Return the units of options, of figures, and of others by name: texts, or what has a unit."""
    units = {name: x.unit or "1" for name, x in declared(type(o)).items()} if o else {}
    units |= {f"figures.{name}": x.unit for name, x in figures.items()}
    return units | {name: getattr(x, "unit", x) for more in others for name, x in more.items()}


def check_unit(text: str | float, unit: str, units: Mapping[str, str], where: str) -> list[str]:
    """Refuse a unit that the terms of a formula do not give; return the terms whose units are not known.

    A formula that holds whatever the units are grows by a power of each when that is made smaller, as its terms do
    (Bridgman, Dimensional Analysis, 1922, chapter 2).

    Parameters
    ----------
    text
        The formula.
    unit
        What is stated.
    units
        The units of what it may name.
    where
        What messages begin with.
    """
    formula = Formula.read(text)
    powers = {name: unit_powers(units.get(name) or "?") for name in formula.names}
    stated, draw = unit_powers(unit), np.random.default_rng(1)
    unknown = sorted(name for name, x in powers.items() if x is None)
    if stated is None or unknown or not powers:
        return unknown
    drawn = {name: draw.uniform(0.1, 2.0, DRAWS) for name in powers}
    scaled = {name: drawn[name] * SCALE ** x[:, None] for name, x in powers.items()}  # type: ignore[index]
    with np.errstate(all="ignore"):
        grows = np.log(np.abs(formula.over(scaled) / formula.over(drawn))) / math.log(SCALE)
    grows = grows[:, np.isfinite(grows).all(axis=0)]
    if not grows.size:
        return []
    terms = ", ".join(f"{name} in {units[name]}" for name in sorted(powers))
    if np.ptp(grows, axis=1).max() > POWER_ROUNDING:
        raise SetupError(
            f"{where}: {text!r} adds or compares what is in different units, with {terms}; a number that has a unit "
            "must be an option with it"
        )
    differs = np.abs(grows[:, 0] - stated) > POWER_ROUNDING
    if differs[:-1].any() or (differs[-1] and not CONVERSION.search(str(text))):
        raise SetupError(f"{where}: {text!r} is not in {unit}, with {terms}")
    return []
