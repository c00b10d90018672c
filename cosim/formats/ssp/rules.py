"""The rules of SSP for a file by itself, in one table: the clause of the standard, and what a run does about a breach.

The clauses are those of SSP 2.0; rules that 1.0 does not have are applied to files of version 2.0 only. What reads a
file to run it and what checks it against the standard find the same breaches here.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
from lxml import etree

from ...errors import SetupError
from .files import (
    NAMELESS,
    NAMESPACES,
    Element,
    children,
    load,
    local_name,
    qualified,
    require_root,
    without_namespaces,
)
from .second import downgrade_to_1_0

#: Beside those of SSP, that of regular expressions.
XPATH_NAMESPACES = NAMESPACES | {"re": "http://exslt.org/regular-expressions"}
VERSIONS = ("1.0", "2.0")
SCHEMAS = {
    qualified("ssd:SystemStructureDescription"): "SystemStructureDescription.xsd",
    qualified("ssv:ParameterSet"): "SystemStructureParameterValues.xsd",
    qualified("ssm:ParameterMapping"): "SystemStructureParameterMapping.xsd",
    qualified("ssb:SignalDictionary"): "SystemStructureSignalDictionary.xsd",
}
#: What the schema calls an attribute that it does not know.
FOREIGN = "SCHEMAV_CVC_COMPLEX_TYPE_3_2_1"
#: Most errors of the schema that are listed of a file: a convention; later ones follow from the first.
MOST_SCHEMA_ERRORS = 20
log = logging.getLogger("cosim")


class Severity(StrEnum):
    """How bad a finding is."""

    ERROR = "error"
    MISSING = "missing"
    ADVICE = "advice"
    TOOL = "tool"
    UNCHECKED = "not checked"


class Treatment(StrEnum):
    """What a run does about a finding."""

    REFUSES = "refuses"
    WARNS = "warns"
    TAKES = "takes it as it is"


class Rule(NamedTuple):
    """The clause that states a rule, or the tool that has it, and what follows from a breach."""

    clause: str
    run: Treatment = Treatment.REFUSES
    severity: Severity = Severity.ERROR


XML, CONNECTORS = "5, 6, 7, 8: file format and schema", "5.2.1 Connectors"
RULES = {
    "schema": Rule(XML),
    "foreign attribute": Rule(XML, Treatment.WARNS),
    "enumeration without a name": Rule(XML, Treatment.WARNS),
    "encoding": Rule(XML, Treatment.TAKES),
    "version": Rule("5.1 SystemStructureDescription"),
    "not supported": Rule(XML, Treatment.REFUSES, Severity.UNCHECKED),
    "Units": Rule("4.4.2 Units"),
    "undefined unit": Rule("4.4.2 Units", Treatment.TAKES),
    "Enumerations": Rule("4.4.1 Enumerations"),
    "undefined enumeration": Rule("4.4.1 Enumerations", Treatment.WARNS),
    "Elements": Rule("5.2 Common Model Element Type"),
    "empty name": Rule("5.2 Common Model Element Type", Treatment.TAKES),
    "Connectors": Rule(CONNECTORS),
    "undeclared connector": Rule(CONNECTORS, Treatment.TAKES),
    "FMU": Rule(CONNECTORS, Treatment.TAKES),
    "unreadable FMU": Rule(CONNECTORS, Treatment.TAKES, Severity.UNCHECKED),
    "bindings": Rule("5.2.3 ParameterBindings"),
    "mapping": Rule("5.2.3.2 ParameterMapping"),
    "connections": Rule("5.3.2 Connections"),
    "allowed": Rule("5.3.2.1 Allowed Connections"),
    "dictionaries": Rule("5.3.3 SignalDictionaries", Treatment.TAKES),
    "geometry": Rule("5.3.4 SystemGeometry", Treatment.TAKES),
    "component": Rule("5.4 Component", Treatment.TAKES),
    "missing file": Rule("5.4 Component", Treatment.TAKES, Severity.MISSING),
    "missing parameters": Rule("5.2.3 ParameterBindings", Treatment.TAKES, Severity.MISSING),
    "reference": Rule("5.5 SignalDictionaryReference", Treatment.TAKES),
    "Parameters": Rule("6.2 Parameters"),
    "ParameterMapping": Rule("7.1.1 MappingEntry"),
    "package": Rule("3 System Structure Package", Treatment.TAKES),
    "reserved": Rule("3 System Structure Package", Treatment.TAKES, Severity.ADVICE),
    **{
        tool: Rule(tool, Treatment.TAKES, Severity.TOOL)
        for tool in ("OMSimulator", "libcosim", "Ecos")
    },
}
#: The lists whose entries have names of their own, which are rules too, and the attribute that is the name.
DISTINCT = {
    **dict.fromkeys(("Units", "Enumerations", "Elements", "Connectors", "Parameters"), "name"),
    "ParameterMapping": "target",
}
#: A rule, what breaks it as XPath, and what is said of it, with its attributes in braces.
BREACHES = (
    ("empty name", "//ssd:Elements/ssd:*[@name='']", "the name of an element must not be empty"),
    ("geometry", "//ssd:SystemGeometry[@x1 >= @x2 or @y1 >= @y2]", "x1 must be below x2, and y1 below y2"),
    ("component", "/*[@version='2.0']//ssd:Component[@source='']", "{name}: an empty source is not allowed"),
    ("bindings", "//ssd:ParameterBinding[not(string(@source) or ssd:ParameterValues/*)]",
     "ParameterBinding has neither a source nor its content inline"),
    ("bindings", "//ssd:ParameterBinding[string(@source) and ssd:ParameterValues]",
     "ParameterBinding has both a source and its content inline"),
    ("mapping", "//ssd:ParameterMapping[not(string(@source) or ssm:*)]",
     "ParameterMapping has neither a source nor its content inline"),
    ("mapping", "//ssd:ParameterMapping[string(@source) and ssm:*]",
     "ParameterMapping has both a source and its content inline"),
    ("reference", "//ssd:SignalDictionaryReference[not(@dictionary = "
     "ancestor::ssd:System/ssd:SignalDictionaries/ssd:SignalDictionary/@name)]",
     "no enclosing system has a signal dictionary '{dictionary}'"),
)  # fmt: skip
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


class End(NamedTuple):
    """One end of a connection: the element whose connector it is, "" for the system itself, its name and kind."""

    owner: str
    name: str
    kind: str | None

    def __str__(self) -> str:
        return f"{self.kind} {self.path}"

    @property
    def path(self) -> str:
        """Its name with that of its element."""
        return f"{self.owner}.{self.name}".removeprefix(".")


@dataclass(frozen=True)
class Finding:
    """A rule that a file breaks, and where; line 0 stands for all of the file."""

    rule: str
    file: str
    line: int
    text: str

    @property
    def clause(self) -> str:
        """The clause of the standard, or the tool."""
        return RULES[self.rule].clause

    @property
    def severity(self) -> Severity:
        """How bad it is."""
        return RULES[self.rule].severity

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}: {self.text}"


def load_valid(path: Path, tag: str) -> Element:
    """The root element of an XML file of SSP, of which `tag` is the expected name (ssd:...), in the words of 1.0.

    Raises SetupError with line and reason for what a run refuses; warns of what it ignores.
    """
    root = load(path)
    require_root(root, qualified(tag), f"{path.name}, line {root.sourceline}")
    for finding in check_document(root, path.name):
        run = RULES[finding.rule].run
        if run is Treatment.REFUSES:
            raise SetupError(str(finding))
        if run is Treatment.WARNS:
            log.warning("%s", finding)
    return root


def check_document(root: Element, file: str) -> Iterator[Finding]:
    """What is wrong in a file of SSP, of which `root` becomes one of version 1.0 as far as it can."""
    breaches = [*breaches_of(root, file, BREACHES), *_doubles(root, file)]
    breaches += [*_undefined(root, file), *_connections(root, file)]
    encoding = (root.getroottree().docinfo.encoding or "UTF-8").upper()
    if encoding not in ("UTF-8", "ASCII", "US-ASCII"):
        yield Finding("encoding", file, 1, f"the encoding is {encoding}, not UTF-8")
    if root.tag not in SCHEMAS:
        space = root.tag.rpartition("}")[0][1:] or "none"
        text = f"{local_name(root)} in the namespace {space} is not the root of an SSP file"
        yield Finding("schema", file, root.sourceline, text)
        return
    inline = root.iter(qualified("ssv:ParameterSet"), qualified("ssm:ParameterMapping"))
    for part in dict.fromkeys([root, *inline]):
        yield from _validate(part, file)
    yield from breaches


def breaches_of(
    root: Element, file: str, rows: Iterable[tuple[str, str, str]]
) -> Iterator[Finding]:
    """The findings of rules that are written as XPath; several rules may share a row, with blanks between."""
    for rules, path, text in rows:
        for element in root.xpath(path, namespaces=XPATH_NAMESPACES):
            said = text.format_map(defaultdict(str, element.attrib))
            for rule in rules.split():
                yield Finding(rule if rule in RULES else rules, file, element.sourceline, said)


def _doubles(root: Element, file: str) -> Iterator[Finding]:
    """Names that an entry of a list has after another one."""
    for listed in root.iter(*(f"{{*}}{tag}" for tag in DISTINCT)):
        if etree.QName(listed).namespace not in NAMESPACES.values():
            continue
        rule, names = local_name(listed), set[str]()
        for entry in listed.iterchildren("{*}*"):
            name = entry.get(DISTINCT[rule])
            if name in names:
                owner = listed.getparent().get("name") if listed is not root else None
                of = f"{owner}: " if owner else ""
                text = f"{of}{local_name(entry)} {name!r} is given twice"
                yield Finding(rule, file, entry.sourceline, text)
            if name is not None:
                names.add(name)


def _undefined(root: Element, file: str) -> Iterator[Finding]:
    """References to units and enumerations that the file does not define."""
    for kind, references, attribute in (
        ("Unit", "//*[@unit]", "unit"),
        ("Enumeration", "//ssc:Enumeration[@name and not(parent::*[local-name()='Enumerations'])]", "name"),
    ):  # fmt: skip
        defined = {
            x.get("name")
            for x in root.iter(f"{{*}}{kind}")
            if local_name(x.getparent()) == f"{kind}s"
        }
        for element in root.xpath(references, namespaces=NAMESPACES):
            name = element.get(attribute)
            if name and name not in defined:
                text = f"the {kind.lower()} {name!r} is not defined in the file"
                yield Finding(f"undefined {kind.lower()}", file, element.sourceline, text)


def _connections(root: Element, file: str) -> Iterator[Finding]:
    """Both ends of each connection are there, may be joined, and no connector is driven twice."""
    for system in root.iter(qualified("ssd:System")):
        owners = {e.get("name"): e for e in children(system, "ssd:Elements", "ssd:*")}
        declared = {
            owner: {c.get("name"): c.get("kind") for c in children(element, "ssd:Connectors", "ssd:Connector")}
            for owner, element in {**owners, "": system}.items()
        }  # fmt: skip
        driven: dict[End, End] = {}
        for connection in children(system, "ssd:Connections", "ssd:Connection"):
            ends = [
                (connection.get(f"{end}Element") or "", connection.get(f"{end}Connector"))
                for end in ("start", "end")
            ]
            for rule, text in _wrong_ends(ends, declared, owners, driven):
                yield Finding(rule, file, connection.sourceline, text)


def _wrong_ends(
    ends: Sequence[tuple[str, str]],
    declared: dict[str, dict[str, str | None]],
    owners: dict[str, Element],
    driven: dict[End, End],
) -> Iterator[tuple[str, str]]:
    """What is wrong with one connection; the connector that it drives joins those that are `driven`."""
    lacking = False
    for owner, name in ends:
        if owner not in declared:
            yield "connections", f"the system has no element {owner!r}"
        elif name not in declared[owner]:
            yield "undeclared connector", f"{owner or 'the system'} declares no connector {name!r}"
        else:
            continue
        lacking = True
    elements = [owners[owner] for owner, _ in ends if owner in owners]
    if lacking or "SignalDictionaryReference" in map(local_name, elements):
        return
    first, second = (End(owner, name, declared[owner][name]) for owner, name in ends)
    if first.kind in WILD or second.kind in WILD:
        return
    sinks = sinks_of(first, second)
    if not sinks:
        yield "allowed", f"{first} and {second} cannot be connected"
    elif len(sinks) == 1:
        (sink,), source = sinks, second if sinks[0] is first else first
        if sink in driven:
            yield "allowed", f"{sink.path} is also driven by {driven[sink].path}"
        driven[sink] = source


def sinks_of(first: End, second: End) -> list[End]:
    """Which ends of a connection may be driven by the other one: start and end do not say from where data flows."""
    sinks = []
    for source, sink in ((first, second), (second, first)):
        owner, other = ("element" if end.owner else "system" for end in (source, sink))
        if sink.kind in ALLOWED.get((owner, str(source.kind)), {}).get(other, ()):
            sinks.append(sink)
    return sinks


def _validate(element: Element, file: str) -> Iterator[Finding]:
    """Make an element and what is below it one of SSP 1.0 in place, and check it with the schema.

    What SSP 2.0 has more is made 1.0 as far as a system can have it. Attributes that are none of SSP are removed.
    """
    line, version, wide = element.sourceline, element.get("version"), []
    if version not in VERSIONS:
        yield Finding("version", file, line, f"the version is {version!r}, not 1.0 or 2.0")
        return
    if version == "2.0":
        try:
            wide = downgrade_to_1_0(element, file)
        except SetupError as error:
            text = str(error).removeprefix(f"{file}, ")
            yield Finding("not supported", file, line, f"the schema is not checked: {text}")
            return
    for kind in element.iter(qualified("ssc:Enumeration")):
        if kind.get("name") is None and kind.getparent().tag == qualified("ssd:Connector"):
            text = f"connector {kind.getparent().get('name')} has an Enumeration without a name; that of the FMU is taken"
            yield Finding("enumeration without a name", file, kind.sourceline, text)
            kind.set("name", NAMELESS)
    schema = _load_schema(SCHEMAS[element.tag])
    while not schema.validate(element):
        errors = list(schema.error_log)
        foreign = [*_remove_foreign(element, errors, file)]
        yield from foreign
        if not foreign:
            for wrong in errors[:MOST_SCHEMA_ERRORS]:
                yield Finding("schema", file, wrong.line, without_namespaces(wrong.message))
            break
    for value, text in wide:
        value.set("value", text)


def _remove_foreign(element: Element, errors: Iterable[Any], file: str) -> Iterator[Finding]:
    """Remove the attributes that errors of the schema call unknown."""
    lines: dict[int, list[Element]] = {}
    for inner in element.iter("*"):
        lines.setdefault(inner.sourceline, []).append(inner)
    foreign: dict[tuple[str, str], list[int]] = {}
    for error in errors:
        if error.type_name != FOREIGN:
            continue
        attribute = error.message.split("'")[3]
        for owner in lines.get(error.line, ()):
            if owner.attrib.pop(attribute, None) is not None:
                key = (without_namespaces(attribute), local_name(owner))
                foreign.setdefault(key, []).append(error.line)
    for (attribute, tag), where in foreign.items():
        more = f" (and in {len(where) - 1} more places)" if len(where) > 1 else ""
        text = f"attribute {attribute} of {tag} is not one of SSP and is ignored{more}"
        yield Finding("foreign attribute", file, where[0], text)


@cache
def _load_schema(name: str) -> Any:
    """The XML schema of this file name."""
    return etree.XMLSchema(file=str(Path(fmpy.__file__).with_name("ssp") / "schema" / name))
