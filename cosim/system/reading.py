"""Read an FMU's description from its file into our own view."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from dataclasses import fields
from functools import cache, lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import BadZipFile, ZipFile

import fmpy
from lxml import etree

from ..errors import SetupError
from ..numbers import real, truth, whole
from .arrays import Scalars
from .base_units import BASES, BaseUnit, DisplayUnit, Unit
from .declarations import Declarations, Element
from .description import (
    DefaultExperiment,
    Fmu,
    Interface,
    ModelDescription,
    Unknown,
    Variable,
    is_positive,
)
from .flaws import forbidden, schema_findings, unreadable, wrong_starts

#: The file of an FMU that describes it, by FMI.
XML = "modelDescription.xml"
#: The file of terminals, by FMI 3.0; FMI 2.0 has it as a layered standard.
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
#: Bytes of a description. A convention: FMUs of hundreds of thousands of variables have a tenth of it.
MOST_BYTES = 128 * 2**20
#: FMUs whose descriptions are kept. A convention: more than a system of different machines has.
MOST_CACHED = 64
VERSIONS = ("2.0", "3.0")
WANTED = "this master runs co-simulation by FMI 2.0 and 3.0"
#: Abilities that FMI 3.0 names otherwise.
OF_FMI3 = {
    "canGetAndSetFMUstate": "canGetAndSetFMUState",
    "canSerializeFMUstate": "canSerializeFMUState",
    "providesDirectionalDerivative": "providesDirectionalDerivatives",
}
#: What a file within a zip file is that is none, is damaged, encrypted or packed otherwise, or is no XML.
UNREADABLE = (
    OSError, RuntimeError, ValueError, LookupError, BadZipFile, zlib.error, ElementTree.ParseError,
)  # fmt: skip
PIECE = r"[^\W\d][\w\[\]-]*"
PART = re.compile(rf"{PIECE}(\.{PIECE})*")


def describe_fmu(name: str, path: Path, *, runnable: bool = True) -> ModelDescription:
    """The description of a part's FMU.

    Raises SetupError if name or file cannot be used, or if the FMU cannot run here but is to be
    `runnable`.
    """
    return read_fmu(name, path, runnable=runnable).description


def read_fmu(name: str, path: Path, *, runnable: bool = True) -> Fmu:
    """A part's FMU as its file describes it; raises SetupError as `describe_fmu` does."""
    if PART.fullmatch(name) is None:
        raise SetupError(
            f"part name {name!r} must begin with a letter, then letters, digits, _, - and [], "
            "or be such names with dots between"
        )
    if not path.is_file():
        raise SetupError(f"part {name}: there is no file {path}")
    try:
        fmu = _read(path, time_and_size(path))
    except SetupError as error:
        raise SetupError(f"part {name}: {path} {error}") from error
    if runnable and fmu.obstacle:
        raise SetupError(f"part {name}: {path} {fmu.obstacle}")
    return fmu


def legal_part_name(name: str) -> str:
    """A name itself if a part may have it, else the nearest that it may have."""
    if PART.fullmatch(name):
        return name
    name = re.sub(r"[^\w-]+", "_", name).strip("_")
    return name if PART.fullmatch(name) else f"part_{name}"


def time_and_size(path: Path) -> tuple[int, int]:
    """The time of change [ns] and the size of a file, which show whether it has been replaced."""
    file = path.stat()
    return file.st_mtime_ns, file.st_size


@lru_cache(maxsize=MOST_CACHED)
def _read(path: Path, _: tuple[int, int]) -> Fmu:
    """An FMU, kept as long as its file has this version."""
    files, content = _contents(path)
    root = _root(content)
    if (version := root.get("fmiVersion")) not in VERSIONS:
        stated = f"is FMI {version}" if version else f"has a {XML} without fmiVersion"
        raise SetupError(f"{stated}; {WANTED}")
    findings = list(schema_findings(root, _schema(version)))
    declarations = Declarations(root)
    try:
        for text in (*(text for text, is_hard in findings if is_hard), *unreadable(declarations)):
            raise ValueError(text)
        scalars = Scalars(declarations)
        description = _description(declarations, scalars)
    except SetupError:
        raise
    except ValueError as error:  # behind what the schema does not know it checks nothing
        raise SetupError(f"is not a valid FMU: {XML}, {error}") from error
    variables: dict[str, Variable] = {}
    for variable in scalars.variables:
        if variables.setdefault(variable.name, variable) is not variable:
            where = [v.where for v in declarations.variables if v.name == variable.name]
            lines = f", {' and '.join(where)}" if where else ""
            raise SetupError(
                f"is not a valid FMU: {XML}{lines}: it has two variables named {variable.name}"
            )
    units = {unit.name: unit for unit in reversed(description.unitDefinitions)}
    terminals, wrong = _terminals(path) if TERMINALS in files else ({}, [])
    starts = dict(wrong_starts(declarations, scalars))
    flaws = [f"{XML} is not valid: {text}" for text, _ in findings]
    flaws += [f"{XML}, {text}" for text in (*forbidden(declarations), *starts.values())]
    return Fmu(
        path,
        description,
        variables,
        units,
        (*flaws, *wrong),
        starts,
        terminals,
        scalars.shapes,
        _obstacle(path, files, description),
    )


def _contents(path: Path) -> tuple[list[str], bytes]:
    """The names of the files in an FMU, and its description; raises SetupError if it cannot be read, or not safely."""
    try:
        with ZipFile(path) as archive:
            files = archive.namelist()
            sizes = [f.file_size for f in archive.infolist() if f.filename == XML]
            is_long = any(size > MOST_BYTES for size in sizes)
            content = archive.read(XML) if sizes and not is_long else b""
    except Exception as error:
        raise SetupError(
            f"is not a valid FMU: it cannot be opened as a zip file: {error}"
        ) from error
    if not sizes or is_long:
        which = f"a {XML} of more than {MOST_BYTES >> 20} MiB" if is_long else f"no {XML}"
        raise SetupError(f"is not a valid FMU: it has {which}")
    return files, content


def _root(content: bytes) -> Element:
    """The root of a description as XML, each element with its line; raises SetupError if it is none."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    try:
        root = etree.fromstring(content, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        why = str(error).partition(" (<string>")[0].replace("\n", "")
        raise SetupError(f"is not a valid FMU: {XML} is not XML: {why}") from error
    if root.getroottree().docinfo.doctype:
        raise SetupError(
            f"is not a valid FMU: {XML} has a document type, which may define entities: remove it"
        )
    return root


@cache
def _schema(version: str) -> Any:
    """The schema of the model descriptions of a version of FMI."""
    name = f"fmi{version[0]}"
    folder = Path(fmpy.__file__).with_name("schema") / name
    return etree.XMLSchema(file=str(folder / f"{name}ModelDescription.xsd"))


def _description(declarations: Declarations, scalars: Scalars) -> ModelDescription:
    """Our view of what a description declares."""
    root, is_fmi3 = declarations.root, declarations.is_fmi3

    def unknowns(*groups: str) -> tuple[Unknown, ...]:
        return tuple(
            Unknown(variable, *_dependencies(declarations, scalars, element))
            for group, element in declarations.structure_entries()
            if group in groups
            for variable in scalars.elements_of_all(
                declarations.referenced(element, declarations.reference)
            )
        )

    indicators = unknowns("EventIndicator")
    return ModelDescription(
        fmiVersion=declarations.version,
        modelName=root.get("modelName", ""),
        guid=root.get("instantiationToken" if is_fmi3 else "guid"),
        description=root.get("description"),
        generationTool=root.get("generationTool"),
        coSimulation=_interface(root.find("CoSimulation"), is_fmi3=is_fmi3),
        modelExchange=_interface(root.find("ModelExchange"), is_fmi3=is_fmi3),
        defaultExperiment=_experiment(root.find("DefaultExperiment")),
        unitDefinitions=tuple(map(_unit, root.iterfind("UnitDefinitions/Unit"))),
        modelVariables=tuple(scalars.variables),
        outputs=unknowns("Outputs", "Output"),
        derivatives=unknowns("Derivatives", "ContinuousStateDerivative"),
        initialUnknowns=unknowns("InitialUnknowns", "InitialUnknown"),
        eventIndicators=indicators,
        numberOfEventIndicators=whole(root.get("numberOfEventIndicators", str(len(indicators)))),
    )


def _dependencies(
    declarations: Declarations, scalars: Scalars, element: Element
) -> tuple[tuple[Variable, ...] | None, tuple[str, ...] | None]:
    """What an element of the model structure depends on and how; None for what it does not say."""
    kinds, named = element.get("dependenciesKind"), None
    if element.get("dependencies") is not None:
        named = scalars.elements_of_all(declarations.referenced(element, "dependencies"))
    return named, None if kinds is None else tuple(kinds.split())


def _interface(xml: Element | None, *, is_fmi3: bool) -> Interface | None:
    """An interface that an FMU offers; what it does not say of itself it cannot do."""
    if xml is None:
        return None
    stated: dict[str, Any] = {"modelIdentifier": xml.get("modelIdentifier")}
    for ability in fields(Interface)[1:]:
        text = xml.get(OF_FMI3.get(ability.name, ability.name) if is_fmi3 else ability.name)
        if text is not None:
            stated[ability.name] = whole(text) if ability.type == "int" else truth(text)
    if not is_fmi3 and xml.tag == "ModelExchange":
        is_needless = truth(xml.get("completedIntegratorStepNotNeeded", "false"))
        stated["needsCompletedIntegratorStep"] = not is_needless
    return Interface(**stated)


def _experiment(xml: Element | None) -> DefaultExperiment:
    """The default experiment; a step or a tolerance that no run can have is not stated."""
    names = ("startTime", "stopTime", "stepSize", "tolerance")
    texts = [None if xml is None else xml.get(name) for name in names]
    start, stop, step, tolerance = (None if text is None else real(text) for text in texts)
    return DefaultExperiment(
        start,
        stop,
        step if is_positive(step) else None,
        tolerance if is_positive(tolerance) else None,
    )


def _unit(xml: Element) -> Unit:
    """A unit with those in which it is shown."""

    def line(of: Element) -> tuple[float, float]:
        return real(of.get("factor", "1")), real(of.get("offset", "0"))

    base = xml.find("BaseUnit")
    if base is not None:
        factor, offset = line(base)
        powers = {name: whole(base.get(name, "0")) for name in BASES}
        base = BaseUnit(**powers, factor=factor, offset=offset)
    displays = tuple(
        DisplayUnit(shown.get("name"), *line(shown), truth(shown.get("inverse", "false")))
        for shown in xml.iterfind("DisplayUnit")
    )
    return Unit(xml.get("name"), base, displays)


def _obstacle(path: Path, files: Sequence[str], description: ModelDescription) -> str:
    """Why an FMU with these files cannot run here; empty if it can."""
    interface = description.coSimulation or description.modelExchange
    if interface is None:
        return f"offers scheduled execution only; {WANTED}: export it for that, too"
    platform = fmpy.platform_tuple if description.fmiVersion == "3.0" else fmpy.platform
    folder = f"binaries/{platform}/"
    binary = f"{folder}{interface.modelIdentifier}{fmpy.sharedLibraryExtension}"
    if binary in files:
        return ""
    binaries = [name.removeprefix(folder) for name in files if re.fullmatch(f"{folder}[^/]+", name)]
    if binaries:
        return f"has no {binary}, the name that its modelIdentifier gives; {folder} has {', '.join(binaries)}"
    platforms = ", ".join(fmpy.supported_platforms(str(path))) or "no platform"
    return f"has no binary for this platform, {binary}; it is for {platforms}"


def _terminals(path: Path) -> tuple[dict[str, dict[str, str]], list[str]]:
    """The variables of each terminal by member, without terminals within terminals; what is wrong."""
    try:
        with ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.open(TERMINALS).read(MOST_BYTES))
    except UNREADABLE as error:
        return {}, [f"{TERMINALS} cannot be read: {error}"]
    return {
        terminal.get("name", ""): {
            member.get("memberName", ""): member.get("variableName", "")
            for member in terminal.findall("TerminalMemberVariable")
        }
        for terminal in root.findall("Terminals/Terminal")
    }, []
