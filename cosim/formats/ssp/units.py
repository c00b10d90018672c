"""Units and enumerations of an SSP file, and what linear steps make of a value on its way."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from ...errors import SetupError
from ...system import BASES, unit_conversion
from ...system.base_units import BaseUnit, Unit, agreed_unit
from ...system.description import ModelDescription, Variable
from .files import Element, children

SCALE = {"factor": 1.0, "offset": 0.0}


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


def definitions(root: Element) -> Definitions:
    """What the Units and Enumerations of a file define."""
    units: dict[str, Unit] = {}
    for unit in children(root, "{*}Units", "ssc:Unit"):
        (base,) = children(unit, "ssc:BaseUnit")
        powers = {key: int(base.get(key, 0)) for key in BASES}
        factor, offset = (float(base.get(key, default)) for key, default in SCALE.items())
        name = unit.get("name")
        units[name] = Unit(name, BaseUnit(**powers, factor=factor, offset=offset))
    items = {
        enumeration.get("name"): {
            item.get("name"): int(item.get("value")) for item in children(enumeration, "ssc:Item")
        }
        for enumeration in children(root, "{*}Enumerations", "ssc:Enumeration")
    }
    return Definitions(units, items)


def unit_of(variable: Variable, description: ModelDescription) -> Unit | None:
    """The unit that an FMU gives a variable, that of a difference without an offset."""
    unit = with_definition(Unit(variable.unit), description) if variable.unit else None
    return unit.without_offset() if unit and variable.relativeQuantity else unit


def with_definition(unit: Unit, description: ModelDescription, of_unit: str | None = None) -> Unit:
    """A unit as its file defines it, else as the FMU does that knows it; raises SetupError.

    In an FMU it may be a display unit of `of_unit`, a unit, or another display unit.
    """
    units = description.unitDefinitions
    if unit.baseUnit is not None:
        return unit
    for own in (u for u in units if u.name == of_unit):
        for display in (d for d in own.displayUnits if d.name == unit.name):
            return own.shown_in(display)
    for own in (u for u in units if u.name == unit.name and u.baseUnit is not None):
        return own
    displays = ((own, d) for own in units for d in own.displayUnits if d.name == unit.name)
    return agreed_unit(unit.name, (own.shown_in(display) for own, display in displays))


def same(first: Unit, second: Unit) -> bool:
    """Whether two units have one meaning."""
    try:
        return unit_conversion(first, second) == (1.0, 0.0)
    except SetupError:
        return False


def chain(
    unit: Unit | None, steps: Iterable[Step], *, relative: bool = False
) -> tuple[float, float]:
    """Factor and offset of all steps together for a value in `unit`, a `relative` one without offsets of units.

    Where no unit is given, that of the step before is meant. Raises SetupError where units do not
    fit each other or a unit cannot be deduced.
    """
    factor, offset = 1.0, 0.0
    for step in steps:
        if step.convert and step.unit is not None and unit is not None:
            ends = (unit, step.unit)
            if relative:
                ends = (unit.without_offset(), step.unit.without_offset())
            scale, shift = _conversion(*ends, step.where)
            factor, offset = scale * factor, scale * offset + shift
        factor, offset = step.factor * factor, step.factor * offset + step.offset
        unit = step.unit or (unit if step.convert or unit is None else UNKNOWN)
    return factor, offset


def _conversion(source: Unit, target: Unit, where: str) -> tuple[float, float]:
    if source.name == UNKNOWN.name:
        raise SetupError(f"{where}: its source has no unit from which to convert to {target.name}")
    try:
        return unit_conversion(source, target)
    except SetupError as error:
        raise SetupError(f"{where}: {error}") from None
