"""The clauses on systems: names, connectors, connections, components, parameters, dictionaries."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from ...errors import SetupError
from ...system import describe_fmu
from .files import FMU, Element, children, local_name
from .standard_report import Finding, Severity, doubled, finding_in

ELEMENTS = ("Component", "System", "SignalDictionaryReference")
INWARD = ("structuralParameter", "parameter", "input", "inout")
OUTWARD = ("calculatedParameter", "output", "local")
#: Which kinds a connection may join: (owner, kind) of the source, (owner, kinds) of the sink. A clause of the standard.
ALLOWED: dict[tuple[str, str], dict[str, tuple[str, ...]]] = {
    ("system", "structuralParameter"): {"system": OUTWARD, "element": INWARD},
    ("system", "parameter"): {"system": OUTWARD, "element": ("parameter", "input", "inout")},
    ("system", "input"): {"system": ("output", "local"), "element": ("input", "inout")},
    ("system", "inout"): {"element": ("input", "inout")},
    ("element", "constant"): {"element": INWARD, "system": ("constant", *OUTWARD)},
    ("element", "calculatedParameter"): {
        "element": ("parameter", "input", "inout"),
        "system": OUTWARD,
    },
    ("element", "output"): {"element": ("input", "inout"), "system": ("output", "local", "inout")},
    ("element", "local"): {"element": ("input", "inout"), "system": ("output", "local")},
    ("element", "inout"): {"element": ("input", "inout"), "system": ("output", "local", "inout")},
}
#: Kinds that stand for any kind: a clause of the standard for "unspecified"; acausal ones have no direction.
WILD = ("unspecified", "acausal", None)
#: Kinds of connectors that are causalities of variables.
CAUSALITIES = (
    "input",
    "output",
    "parameter",
    "calculatedParameter",
    "structuralParameter",
    "local",
)
#: What of an element is not its content.
NO_CONTENT = ("Annotations", "MetaData")


@dataclass(frozen=True)
class Structure:
    """An open SSD: where its findings and its files are."""

    file: str
    folder: Path
    version: str


def check_structure(root: Element, path: Path) -> Iterator[Finding]:
    """The findings in a system structure description, the root of a file."""
    structure = Structure(path.name, path.parent, root.get("version") or "1.0")
    for system in children(root, "ssd:System"):
        yield from _check_element(structure, system)
        yield from _check_system(structure, system, {})


def _connectors(element: Element) -> list[Element]:
    return children(element, "ssd:Connectors", "ssd:Connector")


def _check_system(
    structure: Structure, system: Element, outer: dict[str, set[str]]
) -> Iterator[Finding]:
    dictionaries = dict(outer)
    for dictionary in children(system, "ssd:SignalDictionaries", "ssd:SignalDictionary"):
        entries = {e.get("name") for e in dictionary.iter("{*}DictionaryEntry")}
        is_known = dictionary.get("source") is None or entries
        dictionaries[dictionary.get("name")] = entries if is_known else {"*"}
    elements = [e for e in children(system, "ssd:Elements", "*") if local_name(e) in ELEMENTS]
    names = [element.get("name") for element in elements]
    for name, count in doubled(names).items():
        text = f"{count} elements of a system are named {name!r}"
        yield finding_in(structure.file, "name", system, text)
    for element in elements:
        if element.get("name") == "":
            yield finding_in(
                structure.file, "name", element, "the name of an element must not be empty"
            )
        yield from _check_element(structure, element)
        if local_name(element) == "Component":
            yield from _check_component(structure, element)
        elif local_name(element) == "System":
            yield from _check_system(structure, element, dictionaries)
        else:
            yield from _check_reference(structure, element, dictionaries)
    yield from _check_connections(structure, system, elements)
    for geometry in children(system, "ssd:SystemGeometry"):
        x1, y1, x2, y2 = (float(geometry.get(key) or "nan") for key in ("x1", "y1", "x2", "y2"))
        if x1 >= x2 or y1 >= y2:
            yield finding_in(
                structure.file, "geometry", geometry, "x1 must be below x2, and y1 below y2"
            )


def _check_element(structure: Structure, element: Element) -> Iterator[Finding]:
    """What components and systems have in common: connectors and parameter bindings."""
    names = [connector.get("name") for connector in _connectors(element)]
    for name, count in doubled(names).items():
        text = f"{element.get('name')} has {count} connectors named {name!r}"
        yield finding_in(structure.file, "connectors", element, text)
    for binding in children(element, "ssd:ParameterBindings", "ssd:ParameterBinding"):
        inline = children(binding, "ssd:ParameterValues")
        yield from _check_source(structure, binding, "bindings", inline, element)
        for mapping in children(binding, "ssd:ParameterMapping"):
            inline = [e for e in mapping.iterchildren("*") if local_name(e) not in NO_CONTENT]
            yield from _check_source(structure, mapping, "mapping", inline, element)
            targets = [entry.get("target") for entry in mapping.iter("{*}MappingEntry")]
            for name, count in doubled(targets).items():
                text = f"{count} parameters are mapped to {name!r}"
                yield finding_in(structure.file, "entries", mapping, text)
        for values in binding.iter("{*}Parameters"):
            names = [parameter.get("name") for parameter in values.iterfind("{*}Parameter")]
            for name, count in doubled(names).items():
                text = f"the parameter {name!r} is in a parameter set {count} times"
                yield finding_in(structure.file, "parameters", values, text)


def _check_source(
    structure: Structure, element: Element, clause: str, inline: list[Element], owner: Element
) -> Iterator[Finding]:
    """A binding or mapping has either a source, which is there, or its content inline."""
    source, what = element.get("source"), local_name(element)
    if source is None and not inline:
        text = f"{what} has neither a source nor its content inline"
        yield finding_in(structure.file, clause, element, text)
    if source and inline:
        text = f"{what} has both a source and its content inline"
        yield finding_in(structure.file, clause, element, text)
    if source and element.get("sourceBase", "SSD") == "SSD" and _is_local(source):
        yield from _missing_file(structure, clause, element, owner, source)


def _missing_file(
    structure: Structure, clause: str, element: Element, owner: Element, source: str
) -> Iterator[Finding]:
    """A file that an element names and that is not there; only a file in the package can be told to be missing.

    A component may also be a folder.
    """
    path = structure.folder / unquote(urlsplit(source).path)
    if not (path.exists() if clause == "component" else path.is_file()):
        text = f"{owner.get('name')}: there is no file {source!r}"
        yield finding_in(structure.file, clause, element, text, Severity.MISSING)


def _is_local(source: str) -> bool:
    parts = urlsplit(source)
    return not parts.scheme and not parts.netloc and bool(parts.path)


def _check_component(structure: Structure, component: Element) -> Iterator[Finding]:
    name, source = component.get("name"), component.get("source")
    if source == "" and structure.version == "2.0":
        yield finding_in(
            structure.file, "component", component, f"{name}: an empty source is not allowed"
        )
    if source and source.startswith("#"):
        identifiers = component.xpath("//*[local-name()='System']/@id")
        if unquote(source[1:]) not in identifiers:
            text = f"{name}: no system of this file has the id {source[1:]!r}"
            yield finding_in(structure.file, "component", component, text)
    if source is None or not _is_local(source):
        return
    yield from _missing_file(structure, "component", component, component, source)
    path = structure.folder / unquote(urlsplit(source).path)
    if component.get("type", FMU) == FMU and path.is_file() and path.suffix == ".fmu":
        yield from _check_fmu(structure, component, path)


def _check_fmu(structure: Structure, component: Element, path: Path) -> Iterator[Finding]:
    """The connectors of a component beside the variables of its FMU."""
    name = str(component.get("name"))
    try:
        description = describe_fmu("fmu", path.absolute(), runnable=False)
    except SetupError as error:
        text = f"{name}: its FMU is not read: {error}"
        yield finding_in(structure.file, "connectors", component, text, Severity.UNCHECKED)
        return
    variables = {v.name: v for v in description.modelVariables}
    arrays = {v.name.partition("[")[0] for v in description.modelVariables if "[" in v.name}
    for connector in _connectors(component):
        variable, kind = connector.get("name"), connector.get("kind")
        if variable not in variables:
            if variable not in arrays:
                text = f"{name}: the FMU has no variable {variable!r}"
                yield finding_in(structure.file, "connectors", connector, text)
            continue
        causality = variables[variable].causality
        if kind in CAUSALITIES and causality != kind:
            text = f"{name}.{variable} is of kind {kind}, and of causality {causality} in the FMU"
            yield finding_in(structure.file, "connectors", connector, text)


def _check_reference(
    structure: Structure, element: Element, dictionaries: dict[str, set[str]]
) -> Iterator[Finding]:
    """A reference to a signal dictionary names one of an enclosing system, and entries of it."""
    dictionary = element.get("dictionary")
    if dictionary not in dictionaries:
        text = f"no enclosing system has a signal dictionary {dictionary!r}"
        yield finding_in(structure.file, "reference", element, text)
        return
    entries = dictionaries[dictionary]
    for connector in _connectors(element):
        if "*" not in entries and connector.get("name") not in entries:
            text = f"the dictionary {dictionary!r} has no entry {connector.get('name')!r}"
            yield finding_in(structure.file, "reference", connector, text)


def _check_connections(
    structure: Structure, system: Element, elements: list[Element]
) -> Iterator[Finding]:
    """Both ends of each connection are there, may be joined, and no connector is driven twice."""
    owners = {element.get("name"): element for element in elements}
    dictionaries = {e.get("name") for e in elements if local_name(e) == ELEMENTS[2]}
    driven: list[tuple[str, str]] = []
    for connection in children(system, "ssd:Connections", "ssd:Connection"):
        ends = []
        for end in ("start", "end"):
            owner, name = connection.get(f"{end}Element") or None, connection.get(f"{end}Connector")
            if owner is not None and owner not in owners:
                text = f"the system has no element {owner!r}"
                yield finding_in(structure.file, "connections", connection, text)
                continue
            declared = _connectors(owners[owner] if owner else system)
            kinds = [c.get("kind") for c in declared if c.get("name") == name]
            if not kinds:
                text = f"{owner or 'the system'} declares no connector {name!r}"
                yield finding_in(structure.file, "connectors", connection, text)
                continue
            ends.append((owner or "", str(name), kinds[0]))
        if len(ends) > 1 and not {ends[0][0], ends[1][0]} & dictionaries:
            yield from _check_ends(structure, connection, ends, driven)
    for (owner, name), count in doubled(driven).items():
        text = f"{owner}.{name} is driven by {count} connections".removeprefix(".")
        yield finding_in(structure.file, "allowed", system, text)


def _check_ends(
    structure: Structure,
    connection: Element,
    ends: list[tuple[str, str, str | None]],
    driven: list[tuple[str, str]],
) -> Iterator[Finding]:
    """The kinds of both ends, in either direction: start and end do not say from where data flows."""
    if any(kind in WILD for _, _, kind in ends):
        return
    first, second = ends
    forth, back = _is_allowed(first, second), _is_allowed(second, first)
    if not forth and not back:
        texts = [f"{kind} {owner}.{name}".replace(" .", " ") for owner, name, kind in ends]
        yield finding_in(
            structure.file,
            "allowed",
            connection,
            f"{texts[0]} and {texts[1]} must not be connected",
        )
    elif forth != back:
        sink = second if forth else first
        driven.append(sink[:2])


def _is_allowed(source: tuple[str, str, str | None], sink: tuple[str, str, str | None]) -> bool:
    owners = ["element" if owner else "system" for owner, _, _ in (source, sink)]
    return sink[2] in ALLOWED.get((owners[0], str(source[2])), {}).get(owners[1], ())
