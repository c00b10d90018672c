"""Units in SI base units, and what converts one into another."""

from __future__ import annotations

from dataclasses import dataclass

#: The base units, by the names that FMI gives their powers.
BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
#: The powers of an angle.
ANGLE = (0, 0, 0, 0, 0, 0, 0, 1)


@dataclass(frozen=True)
class BaseUnit:
    """A unit as factor * product of powers of base units + offset."""

    kg: int = 0
    m: int = 0
    s: int = 0
    A: int = 0
    K: int = 0
    mol: int = 0
    cd: int = 0
    rad: int = 0
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class DisplayUnit:
    """A unit in which a value is shown: shown = factor * value + offset."""

    name: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Unit:
    """A unit that an FMU defines; `baseUnit` is None if it does not say what the unit measures."""

    name: str
    baseUnit: BaseUnit | None = None
    displayUnits: tuple[DisplayUnit, ...] = ()


def unit_exponents(unit: BaseUnit) -> tuple[int, ...]:
    """The powers of the base units."""
    return tuple(getattr(unit, base) for base in BASES)


def unit_conversion(source: BaseUnit, target: BaseUnit) -> tuple[float, float] | None:
    """Factor and offset from one unit to another; None if they measure different things."""
    if unit_exponents(source) != unit_exponents(target):
        return None
    return source.factor / target.factor, (source.offset - target.offset) / target.factor
