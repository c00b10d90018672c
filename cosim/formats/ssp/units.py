"""Units and enumerations of an SSP file, and what linear steps make of a value on its way."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

from ...errors import SetupError
from ...system import BASES, unit_conversion
from ...system.base_units import BaseUnit
from ...system.description import ModelDescription, Variable
from .files import Element, children

SCALE = {"factor": 1.0, "offset": 0.0}


class Unit(NamedTuple):
    """A unit by name and, if it is defined anywhere, its base units."""

    name: str
    base: BaseUnit | None = None


UNKNOWN = Unit("")


class Step(NamedTuple):
    """One step of a value: conversion to `unit`, unless suppressed, then factor and offset."""

    where: str
    unit: Unit | None
    convert: bool = True
    factor: float = 1.0
    offset: float = 0.0


class Definitions(NamedTuple):
    """Units and enumerations that a file defines."""

    units: dict[str, Unit]
    items: dict[str, dict[str, int]]

    def unit(self, name: str | None) -> Unit | None:
        """The unit of a name; without base units if the file does not define it."""
        return self.units.get(name, Unit(name)) if name else None

    def over(self, outer: Definitions) -> Definitions:
        """These definitions, and the outer ones where they have none."""
        return Definitions(outer.units | self.units, outer.items | self.items)


def definitions(root: Element, file: str) -> Definitions:
    """What the Units and Enumerations of a file define; raises SetupError for doubles."""
    units: dict[str, Unit] = {}
    items: dict[str, dict[str, int]] = {}
    for unit in children(root, "{*}Units", "ssc:Unit"):
        (base,) = children(unit, "ssc:BaseUnit")
        powers = {key: int(base.get(key, 0)) for key in BASES}
        factor, offset = (float(base.get(key, default)) for key, default in SCALE.items())
        name = _new(unit, units, file)
        units[name] = Unit(name, BaseUnit(**powers, factor=factor, offset=offset))
    for enumeration in children(root, "{*}Enumerations", "ssc:Enumeration"):
        items[_new(enumeration, items, file)] = {
            item.get("name"): int(item.get("value")) for item in children(enumeration, "ssc:Item")
        }
    return Definitions(units, items)


def _new(element: Element, defined_names: Iterable[str], file: str) -> str:
    name = str(element.get("name"))
    if name in defined_names:
        raise SetupError(f"{file}, line {element.sourceline}: {name!r} is defined twice")
    return name


def unit_of(variable: Variable, description: ModelDescription) -> Unit | None:
    """The unit that an FMU gives a variable."""
    return defined(Unit(variable.unit), description) if variable.unit else None


def defined(unit: Unit, description: ModelDescription) -> Unit:
    """A unit with the base units of the FMU that knows it, if the file did not define it."""
    return unit if unit.base is not None else _units_of(description).get(unit.name, unit)


@lru_cache(maxsize=64)
def _units_of(description: ModelDescription) -> dict[str, Unit]:
    """The units of an FMU, and its display units: shown = factor * value + offset."""
    units = {}
    for unit in description.unitDefinitions:
        base = unit.baseUnit
        for display_unit in unit.displayUnits:
            if base is not None:
                factor = base.factor / display_unit.factor
                offset = base.offset - factor * display_unit.offset
                units[display_unit.name] = Unit(
                    display_unit.name, replace(base, factor=factor, offset=offset)
                )
    return units | {
        unit.name: Unit(unit.name, unit.baseUnit) for unit in description.unitDefinitions
    }


def same(first: Unit, second: Unit) -> bool:
    """Whether two units have one name or one meaning."""
    if first.name == second.name:
        return True
    try:
        return _conversion(first, second, "") == (1.0, 0.0)
    except SetupError:
        return False


def chain(unit: Unit | None, steps: Iterable[Step]) -> tuple[float, float]:
    """Factor and offset of all steps together for a value in `unit`.

    Where no unit is given, that of the step before is meant. Raises SetupError where units do not
    fit each other or a unit cannot be deduced.
    """
    factor, offset = 1.0, 0.0
    for step in steps:
        if step.convert and step.unit is not None and unit is not None:
            scale, shift = _conversion(unit, step.unit, step.where)
            factor, offset = scale * factor, scale * offset + shift
        factor, offset = step.factor * factor, step.factor * offset + step.offset
        unit = step.unit or (unit if step.convert or unit is None else UNKNOWN)
    return factor, offset


def _base(unit: Unit, where: str) -> BaseUnit:
    """The base units of a unit; raises SetupError if nothing defines it."""
    if unit.base is None:
        raise SetupError(f"{where}: unit {unit.name!r} is not defined")
    return unit.base


def _conversion(source: Unit, target: Unit, where: str) -> tuple[float, float]:
    if source is UNKNOWN:
        raise SetupError(f"{where}: its source has no unit from which to convert to {target.name}")
    if source.name == target.name:
        return 1.0, 0.0
    factors = unit_conversion(_base(source, where), _base(target, where))
    if factors is None:
        raise SetupError(f"{where}: {source.name} cannot be converted to {target.name}")
    return factors
