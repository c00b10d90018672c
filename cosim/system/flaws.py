"""What is wrong in a model description: what of it cannot be read, and what can be but the standard forbids."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Any

from ..names import only
from ..numbers import real, truth
from .arrays import Scalars
from .base_units import BASES
from .declarations import (
    INITIALS,
    REALS,
    SETTABLE,
    TYPES,
    Declarations,
    Declared,
    Element,
    Reader,
    canonical,
    integer,
    line_of,
    value_reader,
)
from .description import declared_start
from .start_values import broken_limits

#: The lists of a model structure of which a rule is stated here, by what they list, in FMI 2.0 and 3.0.
OUTPUTS = ("Outputs", "Output")
DERIVATIVES = ("Derivatives", "ContinuousStateDerivative")
INITIAL = ("InitialUnknowns", "InitialUnknown")
#: The attributes that every variable must have.
VARIABLE = ("name", "valueReference")
#: How the names of abilities begin, which are true or false.
ABILITIES = ("can", "needs", "provides", "has", "might", "completed")
INTERFACES = ("CoSimulation", "ModelExchange", "ScheduledExecution")


def one_of(words: Iterable[str]) -> Reader:
    """What reads one of some words, and raises ValueError for another text."""
    known = tuple(words)

    def read(text: str) -> str:
        if text not in known:
            raise ValueError(f"{text!r} is not known, {only(text, known)}")
        return text

    return read


def each(reader: Reader) -> Reader:
    """What reads several values with blanks between them; no text is none of them."""
    return lambda text: [reader(piece) for piece in text.split()]


def one_or_more(reader: Reader) -> Reader:
    """What reads the start values of an array, of which there is one at least."""
    return lambda text: [reader(piece) for piece in text.split() or [text]]


def unsigned(text: str) -> int:
    """A whole number of 32 bits without a sign."""
    return integer(text, "UInt32")


def unsigned64(text: str) -> int:
    """A whole number of 64 bits without a sign."""
    return integer(text, "UInt64")


def resolution(text: str) -> int:
    """Ticks of a clock in a second."""
    if (number := unsigned64(text)) == 0:
        raise ValueError("'0' must be above 0")
    return number


CAUSALITIES, VARIABILITIES = (one_of(dict.fromkeys(pair[n] for pair in INITIALS)) for n in (0, 1))
#: Of elements by their path: the attributes that they must have, and what reads those that are no texts.
ATTRIBUTES: tuple[tuple[str, tuple[str, ...], Mapping[str, Reader]], ...] = (
    (".", (), {"numberOfEventIndicators": unsigned}),
    ("CoSimulation", ("modelIdentifier",), {"maxOutputDerivativeOrder": unsigned, "fixedInternalStepSize": real}),
    ("ModelExchange", ("modelIdentifier",), {}),
    ("UnitDefinitions/Unit", ("name",), {}),
    ("UnitDefinitions/Unit/BaseUnit", (), dict.fromkeys(BASES, lambda text: integer(text, "Int32"))),
    ("UnitDefinitions/Unit/*", (), {"factor": real, "offset": real}),
    ("UnitDefinitions/Unit/DisplayUnit", ("name",), {"inverse": truth}),
    ("DefaultExperiment", (), dict.fromkeys(("startTime", "stopTime", "stepSize", "tolerance"), real)),
    ("ModelVariables/*/Dimension", (), {"start": unsigned64, "valueReference": unsigned64}),
    ("ModelVariables/*/Alias", ("name",), {}),
)  # fmt: skip
#: What reads the attributes of any variable and of any type.
OF_ANY_KIND: dict[str, Reader] = {
    "valueReference": unsigned,
    "causality": CAUSALITIES,
    "variability": VARIABILITIES,
    "initial": one_of(("exact", "approx", "calculated")),
    "previous": unsigned,
    **dict.fromkeys(("intermediateUpdate", "canHandleMultipleSetPerTimeInstant"), truth),
    **dict.fromkeys(("intervalDecimal", "shiftDecimal"), real),
    **dict.fromkeys(("intervalCounter", "shiftCounter"), unsigned64),
    "resolution": resolution,
    "derivative": unsigned,
    "nominal": real,
    **dict.fromkeys(("relativeQuantity", "unbounded", "reinit"), truth),
}


@cache
def attribute_readers(kind: str, version: str) -> Mapping[str, Reader]:
    """What reads the attributes of a variable or a type of this kind, so far as they are no texts."""
    readers = dict(OF_ANY_KIND)
    if (own := value_reader(kind, version)) is not None:
        readers |= {} if kind == "Boolean" else {"min": own, "max": own}
        readers["start"] = one_or_more(own) if version == "3.0" else own
    return readers


def unreadable(declarations: Declarations) -> Iterator[str]:
    """What is missing, is none of its type by XML Schema and FMI, or refers to nothing, each with its line."""
    version = declarations.version
    for element, required, readers in _elements(declarations):
        owner = element
        while owner is not None and not owner.get("name"):
            owner = owner.getparent()
        of = "" if owner is None else f" of {owner.get('name')}"
        for text in _unreadable_attributes(element.attrib, required, readers, of):
            yield f"{line_of(element)}: {text}"
    for v in declarations.variables:
        readers = attribute_readers(v.kind, version)
        for text in _unreadable_attributes(v.attributes, VARIABLE, readers, f" of {v.name}"):
            yield f"{v.where}: {text}"
    token = "instantiationToken" if declarations.is_fmi3 else "guid"
    if declarations.root.get(token) is None:
        yield f"{line_of(declarations.root)}: there is no {token}, which every instance is given"
    yield from _references_to_nothing(declarations)


def _unreadable_attributes(
    attributes: Mapping[str, str], required: tuple[str, ...], readers: Mapping[str, Reader], of: str
) -> Iterator[str]:
    """The attributes that are missing, and those that their readers do not read; `of` says whose they are."""
    for name in required:
        if name not in attributes:
            yield f"there is no {name}{of}"
    for name, text in attributes.items():
        if (reader := readers.get(name)) is not None:
            try:
                reader(text)
            except ValueError as error:
                yield f"{name}{of}: {error}"


def _elements(
    declarations: Declarations,
) -> Iterator[tuple[Element, tuple[str, ...], Mapping[str, Reader]]]:
    """Elements but those of variables, with the attributes that they must have and what reads those that are no texts."""
    root, version, what = declarations.root, declarations.version, declarations.reference
    for path, required, readers in ATTRIBUTES:
        yield from ((element, required, readers) for element in root.iterfind(path))
    for element in (e for tag in INTERFACES for e in root.iterfind(tag)):
        abilities = [str(name) for name in element.attrib if name.startswith(ABILITIES)]
        yield element, (), dict.fromkeys(abilities, truth)
    values: dict[str, Reader] = {"value": value_reader("Enumeration", version) or str}
    for item in root.iterfind("TypeDefinitions//Item"):
        yield item, ("name", "value"), values
    for element in declarations.type_elements:
        yield element, ("name",), {}
    for content in declarations.types.values():
        yield content, (), attribute_readers(type_kind(content), version)
    for _, element in declarations.structure_entries():
        yield element, (what,), {what: unsigned, "dependencies": each(unsigned)}


def type_kind(content: Element) -> str:
    """The kind of the variables of a type, by FMI's name."""
    return str(content.tag).removesuffix("Type")


def _references_to_nothing(declarations: Declarations) -> Iterator[str]:
    """References to variables and types that there are not, and types that FMI does not have."""
    kinds = TYPES[declarations.version]
    entries = [
        (line_of(element), group, name, element.get(name))
        for group, element in declarations.structure_entries()
        for name in (declarations.reference, "dependencies")
    ]
    for v in declarations.variables:
        named = v.attributes.get("declaredType")
        if v.kind not in kinds:
            yield f"{v.where}: {v.name} has the type {v.kind}, which is not known, {only(v.kind, kinds)}"
        if named is not None and v.type is None:
            known = only(named, declarations.types)
            yield f"{v.where}: {v.name} has declaredType {named}, which is not defined, {known}"
        elif v.type is not None and type_kind(v.type) != v.kind:
            yield f"{v.where}: {v.name} is {v.kind}, and its declaredType {named} is {type_kind(v.type)}"
        names = ("derivative", "previous")
        entries += [(v.where, v.name, n, v.attributes[n]) for n in names if n in v.attributes]
        entries += [
            (line_of(x), v.name, "valueReference", x.get("valueReference"))
            for x in v.inner_elements("Dimension")
        ]
    why = f"indices are 1 to {len(declarations.variables)}"
    for where, owner, name, references in entries:
        for text in (references or "").split():
            if canonical(text) not in declarations.by_reference:
                reason = "no variable has it" if declarations.is_fmi3 else why
                yield f"{where}: {name} {text} of {owner} is not a variable: {reason}"


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
    for name, content in declarations.types.items():
        yield from _doubles(content.iterfind("Item"), "value", f"of {name}")
        yield from _doubles(content.iterfind("Item"), "name", f"of {name}")
    named = [(line_of(x), x.get("name")) for x in declarations.type_elements]
    for where, name in (*named, *((v.where, v.name) for v in declarations.variables)):
        if not name.strip():
            yield f"{where}: the name is empty"
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
        start = next((x.get("value", "") for x in variable.inner_elements("Start")), None)
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
    """Units that are defined twice, or by factors that convert nothing or turn the sign."""
    units = list(declarations.root.iterfind("UnitDefinitions/Unit"))
    yield from _doubles(units, "name", "of a unit")
    for unit in units:
        name = unit.get("name") or ""
        if not name.strip():
            yield f"{line_of(unit)}: the name of a unit is empty"
        yield from _doubles(unit.iterfind("DisplayUnit"), "name", f"of a display unit of {name}")
        for element in unit.iterfind("*"):
            if element.tag in ("BaseUnit", "DisplayUnit"):
                factor = real(element.get("factor", "1"))
                if not 0.0 < factor < math.inf:
                    shown = element.get("name") or name
                    yield f"{line_of(element)}: unit {shown} has the factor {factor:g}, which must be above 0"


def _structure_flaws(declarations: Declarations) -> Iterator[str]:
    """What the model structure lists and must not, does not list and must, or says of dependencies."""
    listed: list[tuple[str, str]] = []
    for group, element in declarations.structure_entries():
        variable = declarations.referenced(element.get(declarations.reference))
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


def _doubles(elements: Any, attribute: str, of: str) -> Iterator[str]:
    """Elements whose attribute an earlier one has."""
    before: set[str] = set()
    for element in elements:
        text = element.get(attribute) or ""
        if canonical(text) in before:
            yield f"{line_of(element)}: {attribute} {text} {of} is given twice"
        before.add(canonical(text))
