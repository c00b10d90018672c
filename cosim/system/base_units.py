"""Units as what they are defined as: a factor, powers of SI base units and an offset."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from ..errors import SetupError
from ..units import QUANTITIES

#: The base units, by the names that FMI gives their powers.
BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
#: The powers of an angle.
ANGLE = (0, 0, 0, 0, 0, 0, 0, 1)
#: Relative difference up to which two definitions are one. Derived: a factor that is written with ten significant
#: digits is off by up to 5e-10 of itself, and a quotient of two by twice that. The international and the US survey
#: foot, the closest of the units in use, differ by 2e-6.
DEFINITION_ROUNDING = 1e-9


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
    """A unit in which a value is shown: shown = factor * value + offset, or factor / value if `inverse`."""

    name: str
    factor: float = 1.0
    offset: float = 0.0
    inverse: bool = False


@dataclass(frozen=True)
class Unit:
    """A unit by its name; `baseUnit` is None if nothing says what it measures."""

    name: str
    baseUnit: BaseUnit | None = None
    displayUnits: tuple[DisplayUnit, ...] = ()

    def __str__(self) -> str:
        """What it is defined as, "rpm is 0.10472 s-1.rad"."""
        if self.baseUnit is None:
            return f"{self.name}, which is not defined"
        powers = zip(BASES, unit_exponents(self.baseUnit))
        product = ".".join(f"{base}{n if n != 1 else ''}" for base, n in powers if n) or "1"
        offset = "" if self.baseUnit.offset == 0.0 else f" + {self.baseUnit.offset:.15g}"
        return f"{self.name} is {self.baseUnit.factor:.15g} {product}{offset}"

    def without_offset(self) -> Unit:
        """The unit of a difference, for which FMI ignores offsets: 10 degC are 10 K."""
        base = self.baseUnit and replace(self.baseUnit, offset=0.0)
        shown = tuple(replace(display, offset=0.0) for display in self.displayUnits)
        return replace(self, baseUnit=base, displayUnits=shown)

    def shown_in(self, display: DisplayUnit) -> Unit:
        """A display unit of it as a unit; raises SetupError if it shows the inverse, or has a factor of 0."""
        if display.inverse:
            raise SetupError(f"{display.name} shows the inverse of a value in {self.name}")
        _require_factor(display.name, display.factor)
        base = self.baseUnit
        if base is not None:
            factor = base.factor / display.factor
            base = replace(base, factor=factor, offset=base.offset - factor * display.offset)
        return Unit(display.name, base)


def common_unit(name: str) -> Unit:
    """The unit that people and loggers mean by a name, such as ms or rpm; not defined if it is none of these."""
    for base, (powers, scales) in QUANTITIES.items():
        if name == base or name in scales:
            return Unit(name, BaseUnit(**powers, factor=scales.get(name, 1.0)))
    return Unit(name)


def unit_exponents(unit: BaseUnit) -> tuple[int, ...]:
    """The powers of the base units."""
    return tuple(getattr(unit, base) for base in BASES)


def unit_conversion(source: Unit, target: Unit) -> tuple[float, float]:
    """Factor and offset from one unit to another, by what they are defined as, whatever they are called.

    Units of one name are the same if one of them is not defined. FMI leaves it to the tool whether rad is
    a base unit, so that its power makes no difference between units of one name, nor between common
    ones. Raises SetupError, with both definitions, for units that measure different things, and for a
    factor of 0.
    """
    if source.baseUnit is not None and source.baseUnit == target.baseUnit:
        _require_factor(source.name, source.baseUnit.factor)
        return 1.0, 0.0
    source, target = (_with_common_angle(unit) for unit in (source, target))
    first, second = source.baseUnit, target.baseUnit
    if first is None or second is None:
        if source.name == target.name:
            return 1.0, 0.0
        missing = source if first is None else target
        raise SetupError(f"unit {missing.name!r} is not defined")
    for unit, base in ((source, first), (target, second)):
        _require_factor(unit.name, base.factor)
    is_same = _agree(first, second)
    if unit_exponents(first) != unit_exponents(second) and not (
        source.name == target.name and is_same
    ):
        raise SetupError(f"{source.name} cannot be converted to {target.name}: {source}, {target}")
    if is_same:
        return 1.0, 0.0
    return first.factor / second.factor, (first.offset - second.offset) / second.factor


def agreed_unit(name: str, candidates: Iterable[Unit]) -> Unit:
    """The one meaning that a name has in several places; raises SetupError with both if it has two."""
    found = Unit(name)
    for unit in candidates:
        if unit.name != name or unit.baseUnit is None:
            continue
        if found.baseUnit is not None and not _agree(found.baseUnit, unit.baseUnit):
            raise SetupError(f"unit {name!r} has two meanings, {found} and {unit}")
        found = unit
    return found


def _agree(first: BaseUnit, second: BaseUnit) -> bool:
    """Whether two definitions are one but for rounding and the power of rad."""
    numbers = ((getattr(unit, name) for unit in (first, second)) for name in ("factor", "offset"))
    return unit_exponents(first)[:-1] == unit_exponents(second)[:-1] and all(
        math.isclose(one, other, rel_tol=DEFINITION_ROUNDING) for one, other in numbers
    )


def _with_common_angle(unit: Unit) -> Unit:
    """A common unit with the power of rad that it has in `QUANTITIES`."""
    common = common_unit(unit.name)
    if unit.baseUnit and common.baseUnit and _agree(unit.baseUnit, common.baseUnit):
        return common
    return unit


def _require_factor(name: str, factor: float) -> None:
    if not factor or not math.isfinite(factor):
        raise SetupError(f"unit {name!r} has the factor {factor!r}, by which nothing converts")
