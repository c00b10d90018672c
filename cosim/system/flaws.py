"""What is wrong in a model description: what of it cannot be read, and what can be but the standard forbids."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from ..names import only
from ..numbers import real
from .arrays import Scalars
from .declarations import (
    INITIALS,
    REALS,
    SETTABLE,
    TYPES,
    Declarations,
    Declared,
    Element,
    canonical,
    line_of,
    name_of,
    value_reader,
)
from .description import declared_start
from .start_values import broken_limits

#: The lists of a model structure of which a rule is stated here, by what they list, in FMI 2.0 and 3.0.
OUTPUTS = ("Outputs", "Output")
DERIVATIVES = ("Derivatives", "ContinuousStateDerivative")
INITIAL = ("InitialUnknowns", "InitialUnknown")
#: What an element may not have in common with others in the same element, and what must have a name.
DISTINCT = (
    ("UnitDefinitions/Unit", "name"),
    ("UnitDefinitions/Unit/DisplayUnit", "name"),
    ("TypeDefinitions//Item", "value"),
    ("TypeDefinitions//Item", "name"),
)
NAMED = ("UnitDefinitions/Unit", "TypeDefinitions/*", "ModelVariables/*")
#: What of the schema's words is said otherwise: types of values, as a reader knows them.
VALID = re.compile(
    r"(?P<text>'.*') is not a valid value of the (?:atomic|local atomic) type '(?P<type>[\w:]+)'\.",
    re.DOTALL,
)
TYPE_WORDS = {
    "xs:double": "a number, written as 0.5 or 1e-3", "xs:float": "a number, written as 0.5 or 1e-3", "xs:boolean": "true or false",
    "xs:int": "a 32-bit integer", "xs:unsignedInt": "a 32-bit unsigned integer",
    "xs:short": "a 16-bit integer", "xs:unsignedShort": "a 16-bit unsigned integer",
    "xs:byte": "an 8-bit integer", "xs:unsignedByte": "an 8-bit unsigned integer",
    "xs:long": "a 64-bit integer", "xs:unsignedLong": "a 64-bit unsigned integer",
}  # fmt: skip
#: How the schema says that an attribute is missing, and what follows its element and attribute.
MISSING = "SCHEMAV_CVC_COMPLEX_TYPE_4"
NO_VALUE = ("SCHEMAV_CVC_DATATYPE", "SCHEMAV_CVC_ENUMERATION", "SCHEMAV_CVC_MIN", "SCHEMAV_CVC_MAX")
SAID = re.compile(
    r"Element '(?P<tag>[^']*)'(?:, attribute '(?P<name>[^']*)')?: (?P<text>.*)", re.DOTALL
)
#: The attributes without which nothing can be read, and the elements and attributes that nothing here reads.
NEEDED = (
    "name",
    "valueReference",
    "modelIdentifier",
    "guid",
    "instantiationToken",
    "index",
    "value",
)
UNREAD = (
    "File",
    "Category",
    "Tool",
    "generationDateAndTime",
    "variableNamingConvention",
    "dependenciesKind",
)


def schema_findings(root: Element, schema: Any) -> Iterator[tuple[str, bool]]:
    """What the schema forbids, with its lines, and whether the description can then not be read."""
    if schema.validate(root):
        return
    for error in schema.error_log:
        said = SAID.fullmatch(error.message)
        tag, name, text = said.groups() if said else ("", None, error.message)
        quoted = re.search(r"'(\w+)' is required", text) if error.type_name == MISSING else None
        is_missing = quoted is not None and quoted[1] in NEEDED
        is_hard = is_missing or error.type_name.startswith(NO_VALUE)
        if not is_hard or tag in UNREAD or name in UNREAD:
            yield f"line {error.line}: {error.message}", False
            continue
        owner = name_of(next(iter(root.xpath(error.path)), None))
        of = f" of {owner}" if owner else ""
        if quoted is not None:
            yield f"line {error.line}: there is no {quoted[1]}{of}, which {tag} must have", True
            continue
        if (value := VALID.fullmatch(text)) and value["type"] in TYPE_WORDS:
            text = f"{value['text']} is not {TYPE_WORDS[value['type']]}"
        yield f"line {error.line}: {name or tag}{of}: {text}", True


def unreadable(declarations: Declarations) -> Iterator[str]:
    """What the schema lets pass and cannot be read: numbers too large for their type, and references to nothing."""
    for v in declarations.variables:
        reader = value_reader(v.kind, declarations.version)
        for name in ("start", "min", "max"):
            text = v.attributes.get(name)
            if text is None or reader is None or (name != "start" and v.kind == "Boolean"):
                continue
            try:
                for piece in text.split() or [text] if declarations.is_fmi3 else [text]:
                    reader(piece)
            except ValueError as error:
                yield f"{v.where}: {name} of {v.name}: {error}"
        named, kinds = v.attributes.get("declaredType"), TYPES[declarations.version]
        if v.kind not in kinds:
            yield f"{v.where}: {v.name} has the type {v.kind}, which is not known, {only(v.kind, kinds)}"
        if named is not None and v.type is None:
            known = only(named, declarations.types)
            yield f"{v.where}: {v.name} has declaredType {named}, which is not defined, {known}"
        kind = v.kind if v.type is None else str(v.type.tag).removesuffix("Type")
        if kind != v.kind:
            yield f"{v.where}: {v.name} is {v.kind}, and its declaredType {named} is {kind}"
        declarations.referenced(v.typed, "previous")


def wrong_starts(declarations: Declarations, scalars: Scalars) -> Iterator[tuple[str, str]]:
    """By variable, what is wrong with a start value of its file that holds, as `--set` says it of one."""
    for declared in declarations.variables:
        is_free = declared.causality in SETTABLE or declared.initial == "exact"
        if "start" in declared.attributes and is_free:
            for variable in scalars.elements_of(declared):
                start = declared_start(variable)
                limits = () if isinstance(start, str | None) else broken_limits(variable, start)
                if limit := next(iter(limits), ""):
                    what = f"start {variable.start} of {variable.name}"
                    yield variable.name, f"{declared.where}: {what} must be {limit}"


def forbidden(declarations: Declarations) -> Iterator[str]:
    """The declarations that can be read, but that the standard forbids, with their lines; not `wrong_starts`."""
    yield from _structure_flaws(declarations)
    yield from _unit_flaws(declarations)
    for path, attribute in DISTINCT:
        yield from _doubles(declarations.root.iterfind(path), attribute)
    for path in NAMED:
        for element in declarations.root.iterfind(path):
            if not element.get("name", "").strip():
                yield f"{line_of(element)}: the name is empty"
    shown = {
        unit.get("name"): {display.get("name") for display in unit.iterfind("DisplayUnit")}
        for unit in declarations.root.iterfind("UnitDefinitions/Unit")
    }
    for variable in declarations.variables:
        for text in _variable_flaws(variable, declarations.version, shown):
            yield f"{variable.where}: {text}"
    times = sum(variable.causality == "independent" for variable in declarations.variables)
    if declarations.is_fmi3 and times != 1:
        yield f"there are {times} variables of causality independent, where one must be, the time"
    yield from _alias_flaws(declarations)


def _variable_flaws(
    variable: Declared, version: str, shown: Mapping[str, set[str]]
) -> Iterator[str]:
    """What the standard forbids of a variable by itself, given the display units of each unit."""
    name = variable.name
    yield from _start_flaws(variable)
    stated = variable.attributes.get
    unit, display, nominal = stated("unit"), stated("displayUnit"), stated("nominal")
    if unit is not None and unit not in shown:
        yield f"{name} has unit {unit}, which is not defined: define it in UnitDefinitions"
    elif display is not None and display not in shown.get(unit or "", ()):
        yield f"{name} has displayUnit {display}, which is not defined for unit {unit}"
    if nominal is not None and not real(nominal) > 0.0:
        yield f"{name} has nominal {nominal}, which must be above 0"
    low, high, reader = stated("min"), stated("max"), value_reader(variable.kind, version)
    if low is not None and high is not None and reader is not None and reader(low) > reader(high):
        yield f"{name} has min {low} above max {high}"


def _start_flaws(variable: Declared) -> Iterator[str]:
    """Where causality, variability, initial and start do not go together."""
    causality, variability, initial = variable.causality, variable.variability, variable.initial
    is_like = f"{variable.name} has causality {causality}"
    initials = INITIALS.get((causality, variability))
    start = variable.attributes.get("start")
    if start is None:
        start = next((x.get("value", "") for x in variable.element.iterfind("Start")), None)
    if variability == "continuous" and variable.kind not in REALS:
        yield f"{variable.name} is {variable.kind} and must not have variability continuous"
    elif initials is None:
        known = " or ".join(v for c, v in INITIALS if c == causality)
        yield f"{is_like} and must have variability {known}, not {variability}"
    elif initial not in (initials or (None,)):
        known = " or ".join(initials) or "none"
        yield f"{is_like} and variability {variability} and must have initial {known}, not {initial}"
    elif start and initial in ("calculated", None):
        yield f"{variable.name} must not have start {start}: it is {initial or causality}"
    elif start is None and variable.kind != "Clock" and initial in ("exact", "approx"):
        yield f"{variable.name} has no start, which initial {initial} requires"


def _unit_flaws(declarations: Declarations) -> Iterator[str]:
    """Units that are defined by factors that convert nothing or turn the sign."""
    for definitions in declarations.root.iterfind("UnitDefinitions"):
        for element in definitions.iter("BaseUnit", "DisplayUnit"):
            factor = real(element.get("factor", "1"))
            if not 0.0 < factor < math.inf:
                unit = f"unit {name_of(element)} has the factor {factor:g}"
                yield f"{line_of(element)}: {unit}, which must be above 0"


def _structure_flaws(declarations: Declarations) -> Iterator[str]:
    """What the model structure lists and must not, does not list and must, or says of dependencies."""
    listed: list[tuple[str, str]] = []
    for group, element in declarations.structure_entries():
        (variable,) = declarations.referenced(element, declarations.reference)
        listed.append((group, variable.name))
        if why := _does_not_belong(group, variable):
            yield f"{line_of(element)}: {group} lists {variable.name}, which {why}"
        dependencies, kinds = (element.get(name) for name in ("dependencies", "dependenciesKind"))
        count, given = (len((text or "").split()) for text in (dependencies, kinds))
        if kinds is not None and count != given:
            yield f"{line_of(element)}: {group} gives {variable.name} {count} dependencies and {given} kinds"
    for (group, name), count in Counter(listed).items():
        if count > 1:
            yield f"{group} lists {name} {count} times"
    outputs = {name for group, name in listed if group in OUTPUTS}
    for variable in declarations.variables:
        if variable.causality == "output" and variable.name not in outputs:
            yield f"{variable.where}: the model structure does not list the output {variable.name}"


def _does_not_belong(group: str, variable: Declared) -> str:
    """Why a list of the model structure must not have a variable; empty if it may."""
    of_its_kind = f"has causality {variable.causality}"
    if group in OUTPUTS and variable.causality != "output":
        return of_its_kind
    if group in DERIVATIVES and "derivative" not in variable.attributes:
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
        shared.setdefault((kind, variable.reference), []).append(variable)
    for variables in shared.values():
        if len(variables) == 1:
            continue
        settable = [v for v in variables if v.causality in SETTABLE]
        first, *others = settable + [v for v in variables if v not in settable]
        for other in others:
            fixed = {v.variability in ("constant", "fixed", "tunable") for v in (first, other)}
            if version == "3.0" or other in settable or (settable and len(fixed) > 1):
                yield (
                    f"{other.where}: {other.causality} {other.name} has the value reference of "
                    f"{first.causality} {first.name}"
                )


def _doubles(elements: Iterable[Element], attribute: str) -> Iterator[str]:
    """Elements whose attribute an earlier one in the same element has."""
    before: set[tuple[Element, str]] = set()
    for element in elements:
        text, around = element.get(attribute) or "", element.getparent()
        if (around, canonical(text)) in before:
            of = name_of(around) or "a unit"
            yield f"{line_of(element)}: {attribute} {text} of {of} is given twice"
        before.add((around, canonical(text)))
