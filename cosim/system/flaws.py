"""What in a model description the standard forbids, although it can be read."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

from ..numbers import real
from .declarations import SETTABLE, Declarations, Declared, line, plain, value_reader

#: The lists of a model structure of which a rule is stated here, by what they list, in FMI 2.0 and 3.0.
OUTPUTS = ("Outputs", "Output")
DERIVATIVES = ("Derivatives", "ContinuousStateDerivative")
INITIAL = ("InitialUnknowns", "InitialUnknown")


def wrong_starts(declarations: Declarations) -> Iterator[tuple[str, str]]:
    """By variable, what is wrong with a start value of its file that holds, as `--set` says it of one."""
    for variable in declarations.variables:
        text = variable.typed.get("start")
        reader = value_reader(variable.kind, declarations.version)
        if text is None or reader is None or variable.kind == "Boolean":
            continue
        if variable.causality not in SETTABLE and variable.initial != "exact":
            continue
        low, high = (declarations.declared(variable, name) for name in ("min", "max"))
        items = declarations.items(variable)
        for piece in text.split():
            value: Any = reader(piece)
            wrong = ""
            if items and plain(piece) not in map(plain, items):
                wrong = f"one of {', '.join(f'{name} ({n})' for n, name in items.items())}"
            elif low is not None and not value >= (bound := reader(low)):
                wrong = f"at least {bound!r}"
            elif high is not None and not value <= (bound := reader(high)):
                wrong = f"at most {bound!r}"
            if wrong:
                where = f"{line(variable.element)}: start {piece} of {variable.name}"
                yield variable.name, f"{where} must be {wrong}"
                break


def forbidden(declarations: Declarations) -> Iterator[str]:
    """The declarations that can be read, but that the standard forbids, with their lines."""
    yield from _structure_flaws(declarations)
    yield from _unit_flaws(declarations)
    for named in declarations.types.values():
        content = declarations.content(named)
        yield from _doubles(content.iterfind("Item"), "value", f"of {named.get('name')}")
        yield from _doubles(content.iterfind("Item"), "name", f"of {named.get('name')}")
    for element in [*declarations.type_elements(), *(v.element for v in declarations.variables)]:
        if not (element.get("name") or "").strip():
            yield f"{line(element)}: the name is empty"
    for variable in declarations.variables:
        yield from _bound_flaws(declarations, variable)
    yield from _alias_flaws(declarations)
    yield from (text for _, text in wrong_starts(declarations))


def _bound_flaws(declarations: Declarations, variable: Declared) -> Iterator[str]:
    """Bounds of a variable that nothing keeps, and a size that is none."""
    where = f"{line(variable.element)}: {variable.name}"
    reader = value_reader(variable.kind, declarations.version)
    if reader is None or variable.kind == "Boolean":
        return
    low, high = (declarations.declared(variable, name) for name in ("min", "max"))
    if low is not None and high is not None and reader(low) > reader(high):
        yield f"{where} has min {low} above max {high}"
    nominal = declarations.declared(variable, "nominal")
    if nominal is not None and not real(nominal) > 0.0:
        yield f"{where} has nominal {nominal}, which must be above 0"


def _unit_flaws(declarations: Declarations) -> Iterator[str]:
    """Units that are defined twice, or by factors that convert nothing or turn the sign."""
    units = list(declarations.root.iterfind("UnitDefinitions/Unit"))
    yield from _doubles(units, "name", "of a unit")
    for unit in units:
        name = unit.get("name") or ""
        if not name.strip():
            yield f"{line(unit)}: the name of a unit is empty"
        yield from _doubles(unit.iterfind("DisplayUnit"), "name", f"of a display unit of {name}")
        for element in unit.iterfind("*"):
            if element.tag in ("BaseUnit", "DisplayUnit"):
                factor = real(element.get("factor", "1"))
                if not 0.0 < factor < math.inf:
                    shown = element.get("name") or name
                    yield f"{line(element)}: unit {shown} has the factor {factor:g}, which must be above 0"


def _structure_flaws(declarations: Declarations) -> Iterator[str]:
    """What the model structure lists and must not, does not list and must, or says of dependencies."""
    listed: list[tuple[str, str]] = []
    for group, element in declarations.structure_entries():
        if (variable := declarations.named(element)) is None:
            continue
        listed.append((group, variable.name))
        if why := _does_not_belong(group, variable):
            yield f"{line(element)}: {group} lists {variable.name}, which {why}"
        dependencies, kinds = (element.get(name) for name in ("dependencies", "dependenciesKind"))
        count, given = (len((text or "").split()) for text in (dependencies, kinds))
        if kinds is not None and count != given:
            yield f"{line(element)}: {group} gives {variable.name} {count} dependencies and {given} kinds"
    for (group, name), count in Counter(listed).items():
        if count > 1:
            yield f"{group} lists {name} {count} times"
    outputs = {name for group, name in listed if group in OUTPUTS}
    for variable in declarations.variables:
        if variable.causality == "output" and variable.name not in outputs:
            yield f"{line(variable.element)}: the model structure does not list the output {variable.name}"


def _does_not_belong(group: str, variable: Declared) -> str:
    """Why a list of the model structure must not have a variable; empty if it may."""
    of_its_kind = f"has causality {variable.causality}"
    if group in OUTPUTS and variable.causality != "output":
        return of_its_kind
    if group in DERIVATIVES and variable.typed.get("derivative") is None:
        return "is the derivative of nothing"
    if group in INITIAL and variable.causality in (*SETTABLE, "independent"):
        return of_its_kind
    return "has initial exact" if group in INITIAL and variable.initial == "exact" else ""


def _alias_flaws(declarations: Declarations) -> Iterator[str]:
    """Variables of one value reference that cannot have one value."""
    version = declarations.version
    shared: dict[tuple[str, str], list[Declared]] = {}
    for variable in declarations.variables:
        kind = str(variable.kind).replace("Enumeration", "Integer") if version == "2.0" else ""
        reference = plain(variable.element.get("valueReference", ""))
        shared.setdefault((kind, reference), []).append(variable)
    for variables in shared.values():
        if len(variables) == 1:
            continue
        settable = [v for v in variables if v.causality in SETTABLE]
        first, *others = settable + [v for v in variables if v not in settable]
        for other in others:
            fixed = {v.variability in ("constant", "fixed", "tunable") for v in (first, other)}
            if version == "3.0" or other in settable or (settable and len(fixed) > 1):
                yield (
                    f"{line(other.element)}: {other.causality} {other.name} has the value reference of "
                    f"{first.causality} {first.name}"
                )


def _doubles(elements: Any, attribute: str, of: str) -> Iterator[str]:
    """Elements whose attribute an earlier one has."""
    before: set[str] = set()
    for element in elements:
        text = element.get(attribute) or ""
        if plain(text) in before:
            yield f"{line(element)}: {attribute} {text} {of} is given twice"
        before.add(plain(text))
