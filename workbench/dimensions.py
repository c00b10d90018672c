"""Whether a formula gives its result in the unit that is stated for it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from itertools import islice, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import SetupError
from cosim.system.base_units import BASES, BaseUnit, common_unit, unit_exponents
from cosim.units import multiples

from .figure import Figure
from .formula import Formula
from .options import Options, declared

#: By how much a unit is made smaller; chosen: so little that comparisons in a formula come out as before.
SCALE = 1.01
#: Sets of values with which a formula is computed; chosen: where one of them is outside its domain, others are not.
DRAWS = 20
#: Differences of powers that are rounding. Derived: 1e-15 of a value is 1e-13 of a power of SCALE.
POWER_ROUNDING = 1e-9
#: By how much of itself a factor may be off in a formula. Derived: that of one with three digits, as 57.3.
FACTOR_ROUNDING = 5e-3
#: Sets of meanings of numbers that are tried; chosen: those of seven numbers, in a second at most.
MOST_MEANINGS = 4**7

#: What Hz is in SI base units; the FMUs have none.
HERTZ = BaseUnit(s=-1)

Powers = NDArray[np.float64]


def unit_powers(unit: str) -> Powers | None:
    """Return the powers of the base units, rad last, and of SCALE for the factor of "kN.m/s2"; None if it is not known."""
    powers = np.zeros(len(BASES) + 1)
    for k, factors in enumerate(unit.split("/")):
        for text in factors.split("."):
            match = re.fullmatch(r"(1|[A-Za-z%]+)(-?\d+)?", text)
            base = common_unit(match[1]).baseUnit if match else None
            base = HERTZ if match and match[1] == "Hz" else base
            if match is None or base is None:
                return None
            own = [*unit_exponents(base), math.log(base.factor, SCALE)]
            powers += (-1.0 if k else 1.0) * int(match[2] or 1) * np.array(own)
    return powers


def is_count(unit: str) -> bool:
    """Whether a unit counts turns or pieces in a time, as Hz and 1/min do, which rad/s does not; 1/s may be either."""
    powers = unit_powers(unit)
    is_rate = powers is not None and (powers[:-1] == [*unit_exponents(HERTZ)]).all()
    return bool(is_rate and ("Hz" in unit or powers[-1]))  # type: ignore[index]


def conversion(from_unit: str, to_unit: str, what: str) -> float:
    """Return the factor from a unit, "" for none, to another of the same quantity; raises SetupError if there is none."""
    if from_unit in ("", to_unit):
        return 1.0
    if (factor := multiples(to_unit).get(from_unit)) is not None:
        return factor
    own, other = unit_powers(from_unit), unit_powers(to_unit)
    change = None if own is None or other is None else np.abs(own - other) > POWER_ROUNDING
    is_angle_lost = (
        change is not None
        and change[-2]
        and (change[-1] or is_count(from_unit) or is_count(to_unit))
    )
    if change is None or change[:-2].any() or is_angle_lost:
        raise SetupError(
            f"{what} is in {from_unit}, which does not convert to {to_unit}; write {' or '.join(multiples(from_unit))}"
        )
    return float(SCALE ** (own - other)[-1])  # type: ignore[operator]


def known_units(
    o: Options | None, figures: Mapping[str, Figure], *others: Mapping[str, Any]
) -> dict[str, str]:
    """Return the units of options, of figures, and of others by name: texts, or what has a unit."""
    units = {name: x.unit or "1" for name, x in declared(type(o)).items()} if o else {}
    units |= {f"figures.{name}": x.unit for name, x in figures.items()}
    return units | {name: getattr(x, "unit", x) for more in others for name, x in more.items()}


def check_unit(text: str | float, unit: str, units: Mapping[str, str], where: str) -> list[str]:
    """Refuse a unit that the terms of a formula do not give; return what has no unit that is known: terms, or all of it.

    A formula that holds whatever the units are grows by a power of each when that is made smaller, as its terms do
    (Bridgman, Dimensional Analysis, 1922, chapter 2). Where it converts, its numbers do.

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
    if unknown or not powers:
        return unknown
    if stated is None:
        return [str(text)]
    drawn = {name: draw.uniform(0.1, 2.0, DRAWS) for name in powers}
    with np.errstate(all="ignore"):
        scaled = {name: drawn[name] * SCALE ** x[:-2, None] for name, x in powers.items()}  # type: ignore[index]
        grows = np.log(np.abs(formula.over(scaled) / formula.over(drawn))) / math.log(SCALE)
    grows = grows[:, np.isfinite(grows).all(axis=0)]
    if not grows.size:
        return [str(text)]
    terms = ", ".join(f"{name} in {units[name]}" for name in sorted(powers))
    if np.ptp(grows, axis=1).max() > POWER_ROUNDING:
        raise SetupError(
            f"{where}: {text!r} adds or compares what is in different units, with {terms}; a number that has a unit "
            "must be an option with it"
        )
    if (np.abs(grows[:, 0] - stated[:-2]) > POWER_ROUNDING).any():
        what = "has a unit, but none is stated" if unit == "1" else f"is not in {unit}"
        raise SetupError(f"{where}: {text!r} {what}, with {terms}")
    if not _converts(formula, drawn, powers, stated, is_count=is_count(unit)):  # type: ignore[arg-type]
        raise SetupError(
            f"{where}: {text!r} is not in {unit}, with {terms}; what converts must be among its numbers, as 1000, "
            "180 / pi or 30 / pi"
        )
    return []


def _converts(
    formula: Formula,
    drawn: Mapping[str, Powers],
    powers: Mapping[str, Powers],
    stated: Powers,
    *,
    is_count: bool,
) -> bool:
    """Whether a formula gives its value in SI units with terms in SI units, each of its numbers having some meaning.

    It is itself; or a factor between units, which is 1 in SI units as 1000 mm/m are; or a turn, 2 pi rad, as in 60 / n; or
    the inverse of one. Where turns are among them, or the result `is_count`, powers of rad count.
    """
    numbers, value = formula.numbers(), formula.over(drawn)
    number, factor, turn, inverse = range(4)
    choices = product((number, factor, turn, inverse), repeat=len(numbers))
    meanings = np.array([*islice(choices, MOST_MEANINGS)], int)
    counts_rad = (meanings >= turn).any(axis=1) | is_count
    is_right = np.ones(len(meanings), bool)
    for rad in (1.0, SCALE):
        in_si = {name: drawn[name] * SCALE ** x[-1] * rad ** x[-2] for name, x in powers.items()}
        meant = [
            np.choose(kinds, (x, 1.0, math.tau * rad, 1.0 / (math.tau * rad)))[:, None]
            for kinds, x in zip(meanings.T, numbers)
        ]
        with np.errstate(all="ignore"):
            ratio = formula.over(in_si, meant) / (value * SCALE ** stated[-1] * rad ** stated[-2])
        off = (
            np.broadcast_to(ratio, (len(meanings), DRAWS))[:, np.isfinite(value) & (value != 0.0)]
            - 1.0
        )
        is_same = (np.ptp(off, axis=1) <= POWER_ROUNDING) & (np.abs(off[:, 0]) <= FACTOR_ROUNDING)
        is_right &= is_same if rad == 1.0 else is_same | ~counts_rad
    return bool(is_right.any())
