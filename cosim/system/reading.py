"""Read an FMU's description from its file: FMPy parses the XML, and what it gives is copied into our own view."""

from __future__ import annotations

import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat
from zipfile import ZipFile

import fmpy
from fmpy.model_description import read_model_description
from lxml import etree

from ..errors import SetupError
from ..numbers import real
from .arrays import TRUE, Elements
from .base_units import BaseUnit, DisplayUnit, Unit
from .declarations import Declarations, unreadable
from .description import (
    DefaultExperiment,
    Fmu,
    Interface,
    ModelDescription,
    Unknown,
    Variable,
    is_positive,
)
from .flaws import forbidden, wrong_starts

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
#: What reading a description raises where it lacks something: errors of Python, not of the file.
INTERNAL = (TypeError, AttributeError, LookupError, NameError, MemoryError, ArithmeticError)
NO_NUMBER = re.compile(r"(?:could not convert string to float:|invalid literal for int.*:) ('.*')")
#: What an XML file says of its encoding.
ENCODING = re.compile(r"<\?xml[^>]*encoding=[\"']([^\"']*)")
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
        fmu = _read(path, file_version(path))
    except SetupError as error:
        raise SetupError(f"part {name}: {path} {error}") from error
    if runnable and fmu.obstacle:
        raise SetupError(f"part {name}: {path} {fmu.obstacle}")
    return fmu


def part_name(name: str) -> str:
    """A name itself if a part may have it, else the nearest that it may have."""
    if PART.fullmatch(name):
        return name
    name = re.sub(r"[^\w-]+", "_", name).strip("_")
    return name if PART.fullmatch(name) else f"part_{name}"


def file_version(path: Path) -> tuple[int, int]:
    """The time of change [ns] and the size of a file, which show whether it has been replaced."""
    file = path.stat()
    return file.st_mtime_ns, file.st_size


@lru_cache(maxsize=MOST_CACHED)
def _read(path: Path, _: tuple[int, int]) -> Fmu:
    """An FMU, kept as long as its file has this version."""
    files = _files(path)
    try:
        declarations = Declarations(_root(path))
        if declarations.root.get("fmiVersion") in VERSIONS:
            for text in unreadable(declarations):
                raise SetupError(f"is not a valid FMU: {XML}, {text}")
        original, schema_flaws = _parsed(path)
    except SetupError:
        raise
    except Exception as error:
        raise SetupError(f"is not a valid FMU: {XML}: {_reason(error)}") from error
    if original.fmiVersion not in VERSIONS:
        raise SetupError(f"is FMI {original.fmiVersion}; {WANTED}")
    try:
        root, is_fmi3 = declarations.root, original.fmiVersion == "3.0"
        elements = Elements(root, original.modelVariables, is_fmi3=is_fmi3)
        description = _copied(original, elements, root)
    except SetupError:
        raise
    except Exception as error:
        raise SetupError(f"is not a valid FMU: {XML}: {_reason(error)}") from error
    variables: dict[str, Variable] = {}
    for variable in description.modelVariables:
        if variables.setdefault(variable.name, variable) is not variable:
            raise SetupError(f"is not a valid FMU: it has two variables named {variable.name}")
    units = {unit.name: unit for unit in reversed(description.unitDefinitions)}
    terminals, wrong = _terminals(path) if TERMINALS in files else ({}, [])
    flaws = [f"{XML} is not valid: {text}" for text in schema_flaws]
    flaws += [f"{XML}, {text}" for text in forbidden(declarations)]
    return Fmu(
        path,
        description,
        variables,
        units,
        (*flaws, *wrong),
        dict(wrong_starts(declarations)),
        terminals,
        elements.shapes,
        _obstacle(path, files, description),
    )


def _files(path: Path) -> list[str]:
    """The names of the files in an FMU; raises SetupError if it cannot be read, or not safely."""
    try:
        with ZipFile(path) as archive:
            files = archive.namelist()
            sizes = [f.file_size for f in archive.infolist() if f.filename == XML]
            is_long = any(size > MOST_BYTES for size in sizes)
            is_typed = XML in files and not is_long and _has_document_type(archive.read(XML))
    except Exception as error:
        raise SetupError(
            f"is not a valid FMU: it cannot be opened as a zip file: {error}"
        ) from error
    if XML not in files or is_long:
        which = f"a {XML} of more than {MOST_BYTES >> 20} MiB" if is_long else f"no {XML}"
        raise SetupError(f"is not a valid FMU: it has {which}")
    if is_typed:
        raise SetupError(
            f"is not a valid FMU: {XML} has a document type, which may define entities: remove it"
        )
    return files


def _root(path: Path) -> Any:
    """The root of a description as XML, each element with its line."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=True)
    with ZipFile(path) as archive:
        content = archive.read(XML)
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        said = ENCODING.match(content[:200].decode("utf-16", "ignore"))
        if said and not said[1].lower().startswith("utf-16"):
            raise SetupError(f"is not a valid FMU: {XML} says {said[1]} and is UTF-16")
    return etree.fromstring(content, parser)


def _copied(original: Any, elements: Elements, root: Any) -> ModelDescription:
    """Our view of what FMPy has read of the XML."""

    def unknowns(of: Sequence[Any]) -> tuple[Unknown, ...]:
        return tuple(
            Unknown(
                variable,
                None if u.dependencies is None else elements.all(u.dependencies),
                None if u.dependenciesKind is None else tuple(u.dependenciesKind),
            )
            for u in of
            for variable in elements.of(u.variable)
        )

    return ModelDescription(
        fmiVersion=original.fmiVersion,
        modelName=original.modelName,
        guid=original.guid,
        description=original.description,
        generationTool=original.generationTool,
        coSimulation=_interface(
            original.coSimulation, provides_derivatives=elements.derivatives("CoSimulation")
        ),
        modelExchange=_interface(
            original.modelExchange, provides_derivatives=elements.derivatives("ModelExchange")
        ),
        defaultExperiment=_experiment(original.defaultExperiment),
        unitDefinitions=tuple(
            map(_unit, original.unitDefinitions, root.iterfind("UnitDefinitions/Unit"))
        ),
        modelVariables=elements.all(original.modelVariables),
        outputs=unknowns(original.outputs),
        derivatives=unknowns(original.derivatives),
        initialUnknowns=unknowns(original.initialUnknowns),
        eventIndicators=unknowns(original.eventIndicators),
        numberOfEventIndicators=int(original.numberOfEventIndicators or 0),
    )


def _interface(original: Any, *, provides_derivatives: bool | None) -> Interface | None:
    """An interface that an FMU offers; what it does not say of itself it cannot do."""
    if original is None:
        return None
    stated = {
        name: getattr(original, name)
        for name in Interface.__dataclass_fields__
        if getattr(original, name, None) is not None
    }
    if provides_derivatives is not None:
        stated["providesDirectionalDerivative"] = provides_derivatives
    return Interface(**stated)


def _experiment(original: Any) -> DefaultExperiment:
    if original is None:
        return DefaultExperiment()
    names = ("startTime", "stopTime", "stepSize", "tolerance")
    texts = (getattr(original, name) for name in names)
    start, stop, step, tolerance = (None if text is None else real(text) for text in texts)
    return DefaultExperiment(
        start,
        stop,
        step if is_positive(step) else None,
        tolerance if is_positive(tolerance) else None,
    )


def _unit(original: Any, xml: Any) -> Unit:
    base = original.baseUnit
    if base is not None:
        base = BaseUnit(**{name: getattr(base, name) for name in BaseUnit.__dataclass_fields__})
    display_units = tuple(
        DisplayUnit(d.name, d.factor, d.offset, element.get("inverse") in TRUE)
        for d, element in zip(original.displayUnits, xml.iterfind("DisplayUnit"))
    )
    return Unit(original.name, base, display_units)


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


class _Prologue(Exception):
    """The end of what precedes the first element of a document, or its document type."""


def _has_document_type(content: bytes) -> bool:
    """Whether an XML document has a document type; nothing in it is expanded."""

    def end(*_: Any) -> None:
        raise _Prologue

    def document_type(*_: Any) -> None:
        raise _Prologue("document type")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.StartDoctypeDeclHandler = end, document_type
    try:
        parser.ParseFile(BytesIO(content))
    except _Prologue as prologue:
        return bool(prologue.args)
    except (expat.ExpatError, ValueError, LookupError):  # who reads the elements says what is wrong
        return False
    return False


def _terminals(path: Path) -> tuple[dict[str, dict[str, str]], list[str]]:
    """The variables of each terminal by member, without terminals within terminals; what is wrong."""
    try:
        with ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.open(TERMINALS).read(MOST_BYTES))
    except (OSError, ElementTree.ParseError) as error:
        return {}, [f"{TERMINALS} cannot be read: {error}"]
    return {
        terminal.get("name", ""): {
            member.get("memberName", ""): member.get("variableName", "")
            for member in terminal.findall("TerminalMemberVariable")
        }
        for terminal in root.findall("Terminals/Terminal")
    }, []


def _parsed(path: Path) -> tuple[Any, list[str]]:
    """What FMPy reads of an FMU, and what is wrong in it if it can be read all the same."""
    try:
        return read_model_description(str(path)), []
    except Exception as error:  # noqa: BLE001
        reason = _reason(error)
    try:
        return read_model_description(str(path), validate=False), [reason]
    except Exception as error:
        if isinstance(error, INTERNAL):
            raise SetupError(f"is not a valid FMU: {XML}: {reason}") from error
        raise


def _reason(error: Exception) -> str:
    """The last lines of an error as one line.

    Errors of the reader itself, of which a user knows nothing, are put in other words.
    """
    text = str(error)
    if isinstance(error, ValueError) and (value := NO_NUMBER.search(text)):
        return f"{value[1]} is not a number"
    if isinstance(error, INTERNAL) or not text.strip("-0123456789 "):
        return (
            "an element or an attribute is missing, has a value of another type, or is not known to FMPy, "
            "which reads it"
        )
    return "; ".join(line.removeprefix("- ") for line in text.splitlines()[-3:])
