"""A system is a value: parts, wires and start values. Connecting it checks every name and unit."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat
from zipfile import ZipFile

import fmpy
from fmpy.model_description import ModelDescription, ScalarVariable, read_model_description

from ..errors import SetupError
from ..units import multiples
from .arrays import WIDTHS, expand_arrays
from .inputs import NUMBER, FunctionInput, Table, parse_change

Value = float | int | bool | str
Name = str | tuple[str, str]
STATE, VARIABLE_STEP = "canGetAndSetFMUstate", "canHandleVariableCommunicationStepSize"
FALSE_TRUE = {"false": False, "0": False, "true": True, "1": True}
READ: dict[str, Callable[[str], Value]] = {
    "Real": float,
    "Integer": int,
    "Boolean": lambda text: FALSE_TRUE[text.strip()],
    "String": str,
    "Enumeration": str,
}
BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
ANGLE = (0, 0, 0, 0, 0, 0, 0, 1)
XML, LONGEST = "modelDescription.xml", 128 * 2**20
WANTED = "this master runs co-simulation by FMI 2.0 and 3.0"
#: What reading a description raises where it lacks something: errors of Python, not of the file.
INTERNAL = (TypeError, AttributeError, LookupError, NameError, MemoryError, ArithmeticError)
NO_NUMBER = re.compile(r"(?:could not convert string to float:|invalid literal for int.*:) ('.*')")
NUMERIC = {"Real": float, "Integer": int, "Enumeration": int, "Boolean": int}


WIRE = re.compile(
    rf"\s*(?P<source>[^*+\s]+)\s*(?:\*\s*(?P<factor>[+-]?{NUMBER}))?\s*(?P<offset>[+-]{NUMBER})?"
    r"\s*(?P<arrow>->|=>|\+>|\+=>)\s*(?P<target>[^*+\s]+)\s*"
)
SHAFT = re.compile(r"\s*(?P<one>[^*+\s]+)\s+--\s+(?P<other>[^*+\s]+)\s*")
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
PIECE = r"[^\W\d][\w\[\]-]*"
PART = re.compile(rf"{PIECE}(\.{PIECE})*")


class Wire(NamedTuple):
    """A wire as a value. Its ends may have any names: "motor.tau" or ("motor", "tau").

    Factor and offset apply in the source's unit. Unless the wire `converts`, the target takes the
    number unchanged, whatever the units. A wire that `adds` is added to the earlier wires into the
    same input.
    """

    source: Name
    target: Name
    factor: float = 1.0
    offset: float = 0.0
    converts: bool = True
    adds: bool = False

    def __str__(self) -> str:
        factor = "" if self.factor == 1.0 else f" * {self.factor!r}"
        sign = "-" if self.offset < 0.0 else "+"
        offset = "" if self.offset == 0.0 else f" {sign} {abs(self.offset)!r}"
        arrow = ("+>" if self.converts else "+=>") if self.adds else "->" if self.converts else "=>"
        return f"{dotted(self.source)}{factor}{offset} {arrow} {dotted(self.target)}"

    @classmethod
    def read(cls, text: str) -> Wire:
        """Read a wire from text; raises SetupError if it is not one."""
        match = WIRE.fullmatch(text)
        if match is None:
            raise SetupError(
                f"wire {text!r} must read 'part.output [* factor] [+ offset] -> part.input', "
                "=> to convert no units, +> or +=> to add to another wire, "
                "or 'part.terminal -- part.terminal'"
            )
        factor, offset = (
            float(re.sub(r"\s", "", match[key] or default))
            for key, default in (("factor", "1"), ("offset", "0"))
        )
        converts, adds = "=" not in match["arrow"], "+" in match["arrow"]
        return cls(match["source"], match["target"], factor, offset, converts, adds)


def dotted(name: Name) -> str:
    """A name as one text."""
    return name if isinstance(name, str) else ".".join(name)


@dataclass(frozen=True)
class System:
    """FMU files by part name, wires, start values by variable.

    A wire reads "motor.tau -> conveyor.tau" or, with a factor and an offset in the source's unit,
    "cam.w * 2.5 + 0.1 -> rotor.w". Convertible units are converted (rpm -> rad/s). With "=>" the
    target takes the number unchanged, whatever the units. A `Wire` is the same as a value; names
    with a blank, * or + need it. "motor.flange -- conveyor.flange" joins two terminals: it stands
    for a wire for each member that both have, from the output to the input. A bond names two outputs
    that are wired there and back and whose product is a power: "motor.tau * conveyor.w". Bonds that
    are clear from the units of the wires need not be named. A part of a subsystem has a dotted name,
    "line.motor".

    `inputs` are inputs over time by variable: a Table, or a function of time [s]. A change of an
    input or a tunable parameter reads "at 2 s motor.A = 7500". Within a step, a Real input is held at
    its mean, or follows a line if its FMU can interpolate; everything else changes between steps.
    """

    parts: Mapping[str, Path]
    wires: Sequence[str | Wire] = ()
    start: Mapping[str, Value] = field(default_factory=dict)
    bonds: Sequence[str] = ()
    inputs: Mapping[str, Table | Callable[[float], float]] = field(default_factory=dict)
    changes: Sequence[str] = ()


class Port(NamedTuple):
    """A variable of a part; `type` is that of FMI 2.0, `native` that of the FMU's own version."""

    part: str
    variable: ScalarVariable

    @property
    def name(self) -> str:
        return f"{self.part}.{self.variable.name}"

    @property
    def type(self) -> str:
        return str(self.variable.type)

    @property
    def native(self) -> str:
        return getattr(self.variable, "native", self.type)

    @property
    def unit(self) -> str:
        return self.variable.unit or ""

    def text(self, value: Value) -> str:
        """A value of it as XML spells it."""
        return str(bool(value)).lower() if self.type == "Boolean" else str(value)

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Connection(NamedTuple):
    """A checked wire: target = factor * source + offset, each in its own unit."""

    source: Port
    target: Port
    factor: float = 1.0
    offset: float = 0.0


class Fmu(NamedTuple):
    """A model description, its variables by name, its units in SI base units by name.

    `schema_warning` says what is wrong in it but does not affect a run, `obstacle` why it cannot run here, but
    only be described. `terminals` are the variables of each
    terminal by member, `shapes` the dimensions of arrays, of which the elements are variables.
    """

    description: ModelDescription
    variables: dict[str, ScalarVariable]
    units: dict[str, Any]
    schema_warning: str
    terminals: dict[str, dict[str, str]]
    shapes: dict[str, tuple[int, ...]]
    obstacle: str = ""


@dataclass(frozen=True)
class Network:
    """A system whose names, directions, units and start values have been checked.

    `open` are the inputs that nothing drives and nothing sets, with the start of their FMUs.
    """

    system: System
    fmus: Mapping[str, Fmu]
    wires: list[Connection] = field(default_factory=list)
    start: list[tuple[Port, Value]] = field(default_factory=list)
    inputs: list[tuple[Port, Table | FunctionInput]] = field(default_factory=list)
    open: list[tuple[Port, Value]] = field(default_factory=list)

    @cached_property
    def descriptions(self) -> dict[str, ModelDescription]:
        """The model descriptions by part."""
        return {name: fmu.description for name, fmu in self.fmus.items()}

    @cached_property
    def schema_warnings(self) -> dict[str, str]:
        """By part, what is wrong in its model description but does not affect a run."""
        return {name: fmu.schema_warning for name, fmu in self.fmus.items() if fmu.schema_warning}

    def sums(self) -> dict[str, list[Connection]]:
        """The wires of each input that has several, by its name."""
        into: dict[str, list[Connection]] = {}
        for wire in self.wires:
            into.setdefault(wire.target.name, []).append(wire)
        return {name: wires for name, wires in into.items() if len(wires) > 1}

    def port(self, name: Name) -> Port:
        """The port of a name; raises SetupError if there is none."""
        places = split_name(name.strip()) if isinstance(name, str) else [name]
        places = [place for place in places if place[0] in self.fmus]
        for part, variable in places:
            if variable in self.fmus[part].variables:
                return Port(part, self.fmus[part].variables[variable])
            if shape := self.fmus[part].shapes.get(variable):
                first = ",".join("1" for _ in shape)
                raise SetupError(
                    f"{part}.{variable} is an array of {_size(shape)}: name one, {variable}[{first}]"
                )
        if not places:
            whole, known = dotted(name).strip(), ", ".join(self.fmus)
            part = whole.partition(".")[0] if isinstance(name, str) else name[0]
            raise SetupError(f"{whole}: there is no part {part!r}, only {known}")
        part, variable = places[0]
        known = ", ".join(self.fmus[part].variables)
        raise SetupError(f"{part} has no variable {variable!r}, only {known}")

    def array(self, name: Name) -> tuple[tuple[int, ...], list[Port]]:
        """The dimensions and elements of an array, none and the port of another name; SetupError."""
        for part, variable in split_name(name.strip()) if isinstance(name, str) else [name]:
            if part in self.fmus and variable in self.fmus[part].shapes:
                known = self.fmus[part].variables.values()
                elements = [Port(part, v) for v in known if v.name.startswith(f"{variable}[")]
                return self.fmus[part].shapes[variable], elements
        return (), [self.port(name)]

    def base_unit(self, port: Port) -> Any:
        """The unit of a port in SI base units, None if its model description does not say."""
        return self.fmus[port.part].units.get(port.unit)


def connect(system: System, *, runnable: bool = True) -> Network:
    """Check a system against the model descriptions of its FMUs.

    If it need not be `runnable`, FMUs are accepted that can only be described here: those for other
    platforms or for scheduled execution, and those whose clocks nothing ticks.

    Raises SetupError for a file that is not an FMU of FMI 2.0 or 3.0, an unknown part or variable, a
    wire with the wrong direction, type or unit, an input driven twice, and a start value that is not
    finite, out of bounds or cannot be set. Parts for model exchange only are accepted; `run` refuses
    them.
    """
    if not system.parts:
        raise SetupError("a system needs a part")
    fmus = {name: _fmu(name, Path(path), runnable) for name, path in system.parts.items()}
    network = Network(system, fmus)
    _require_distinct(network.fmus)
    wires = [wire for given in system.wires for wire in _wires(network, given)]
    network.wires.extend(_connection(network, wire) for wire in wires)
    network.start.extend(_start(network.port(name), value) for name, value in system.start.items())
    driven: dict[str, Port] = {}
    for wire, (source, target, *_) in zip(wires, network.wires):
        if target.name in driven and not wire.adds:
            raise SetupError(f"{target} is driven twice, by {driven[target.name]} and by {source}")
        if wire.adds and (source.type, target.type) != ("Real", "Real"):
            raise SetupError(f"wire {str(wire)!r}: only Reals can be added, not {target.type}s")
        driven[target.name] = source
    for name, summed in network.sums().items():
        if len({wire.source for wire in summed}) < len(summed):
            raise SetupError(f"{name} adds one output twice: give it one wire, with a factor")
    network.inputs.extend(_input(network, *item) for item in system.inputs.items())
    network.inputs.extend(_changed(network))
    for port, _ in network.inputs:
        if port.name in driven:
            raise SetupError(f"{port} is driven twice, by {driven[port.name]} and over time")
    known = driven.keys() | {port.name for port, _ in (*network.start, *network.inputs)}
    for name, description in network.descriptions.items():
        for variable in description.modelVariables:
            if variable.type == "Clock":
                if runnable and (obstacle := _silent(Port(name, variable), description)):
                    raise SetupError(obstacle)
            elif variable.causality == "input" and f"{name}.{variable.name}" not in known:
                port, own = Port(name, variable), declared_start(variable)
                if own is None and not runnable:
                    continue
                if own is None:
                    raise SetupError(f"input {port} is not connected and has no start value")
                network.open.append((port, own))
    network.start.extend(network.open)
    return network


def _silent(port: Port, description: ModelDescription) -> str:
    """Why this master cannot tick a clock; empty if it can or need not."""
    if port.variable.causality != "input":
        return ""
    if port.variable.intervalVariability == "triggered":
        return f"{port} is a triggered clock, which nothing here triggers; only clocks with an interval tick"
    if description.coSimulation and not description.coSimulation.hasEventMode:
        return f"{port} is a clock of an FMU without event mode, in which it would tick"
    return ""


def obstacles(network: Network) -> Iterator[str]:
    """Why the parts of a system that is only described cannot run here."""
    for name, fmu in network.fmus.items():
        if fmu.obstacle:
            yield f"part {name}: {network.system.parts[name]} {fmu.obstacle}"
        clocks = (v for v in fmu.description.modelVariables if v.type == "Clock")
        reasons = (_silent(Port(name, v), fmu.description) for v in clocks)
        yield from filter(None, reasons)


def require_fmi2(descriptions: Mapping[str, ModelDescription], what: str) -> None:
    """Refuse parts of FMI 3.0 where only FMI 2.0 is supported; raises SetupError."""
    for name, description in descriptions.items():
        if description.fmiVersion != "2.0":
            raise SetupError(f"{name} is FMI {description.fmiVersion}; {what} FMI 2.0 only")


def require_cosimulation(
    descriptions: Mapping[str, ModelDescription], files: Mapping[str, Path]
) -> None:
    """Refuse parts whose FMUs offer no co-simulation; raises SetupError."""
    for name, description in descriptions.items():
        if description.coSimulation is None:
            raise SetupError(
                f"part {name}: {files[name]} offers model exchange only; {WANTED}: export it for that, too; "
                "oracle and linearize accept it as it is"
            )


def connect_for_export(system: System, where: str, *, sums: bool = False) -> Network:
    """Connect a system for a file format. Raises SetupError for inputs over time, parts without
    co-simulation and, unless the format supports `sums`, for sums of wires.
    """
    network = connect(system)
    require_cosimulation(network.descriptions, system.parts)
    for name in () if sums else network.sums():
        raise SetupError(f"{name} is a sum of wires, which {where} cannot express")
    for port, _ in network.inputs:
        raise SetupError(f"{port.name} changes over time, which {where} cannot express")
    return network


def describe_fmu(name: str, path: Path, *, runnable: bool = True) -> ModelDescription:
    """The description of a part's FMU; raises SetupError if name or file cannot be used, or if it cannot
    run here but is to be `runnable`.
    """
    return _fmu(name, path, runnable).description


def _fmu(name: str, path: Path, runnable: bool = True) -> Fmu:
    if PART.fullmatch(name) is None:
        raise SetupError(
            f"part name {name!r} must begin with a letter, then letters, digits, _, - and [], "
            "or be such names with dots between"
        )
    if not path.is_file():
        raise SetupError(f"part {name}: there is no file {path}")
    try:
        fmu = _read(path, version(path))
    except SetupError as error:
        raise SetupError(f"part {name}: {path} {error}") from error
    if runnable and fmu.obstacle:
        raise SetupError(f"part {name}: {path} {fmu.obstacle}")
    return fmu


def part_name(name: str) -> str:
    """A name as it stands if a part may have it, else the nearest that it may have."""
    if PART.fullmatch(name):
        return name
    name = re.sub(r"[^\w-]+", "_", name).strip("_")
    return name if PART.fullmatch(name) else f"part_{name}"


def version(path: Path) -> tuple[int, int]:
    """The time of change [ns] and the size of a file, which show whether it has been replaced."""
    file = path.stat()
    return file.st_mtime_ns, file.st_size


@lru_cache(maxsize=64)
def _read(path: Path, _: tuple[int, int]) -> Fmu:
    """An FMU that runs on this platform; kept as long as its file has this version."""
    try:
        with ZipFile(path) as archive:
            files = archive.namelist()
            long = any(f.file_size > LONGEST for f in archive.infolist() if f.filename == XML)
            typed = XML in files and not long and _has_document_type(archive.read(XML))
    except Exception as error:
        raise SetupError(
            f"is not a valid FMU: it cannot be opened as a zip file: {error}"
        ) from error
    if XML not in files or long:
        which = f"a {XML} of more than {LONGEST >> 20} MiB" if long else f"no {XML}"
        raise SetupError(f"is not a valid FMU: it has {which}")
    if typed:
        raise SetupError(
            f"is not a valid FMU: {XML} has a document type, which may define entities: remove it"
        )
    try:
        description, schema_warning = _description(path)
    except Exception as error:
        raise SetupError(f"is not a valid FMU: modelDescription.xml: {_reason(error)}") from error
    if description.fmiVersion not in ("2.0", "3.0"):
        raise SetupError(f"is FMI {description.fmiVersion}; {WANTED}")
    try:
        shapes = expand_arrays(path, description) if description.fmiVersion == "3.0" else {}
        default_experiment(description)
    except SetupError:
        raise
    except Exception as error:
        raise SetupError(f"is not a valid FMU: modelDescription.xml: {_reason(error)}") from error
    variables: dict[str, ScalarVariable] = {}
    for variable in description.modelVariables:
        if variables.setdefault(variable.name, variable) is not variable:
            raise SetupError(f"is not a valid FMU: it has two variables named {variable.name}")
        for attribute in ("unit", "min", "max", "nominal") if variable.declaredType else ():
            if getattr(variable, attribute) is None:
                setattr(variable, attribute, getattr(variable.declaredType, attribute))
    units = {unit.name: unit.baseUnit for unit in reversed(description.unitDefinitions)}
    terminals, wrong = _terminals(path) if TERMINALS in files else ({}, "")
    obstacle = _obstacle(path, files, description)
    return Fmu(description, variables, units, schema_warning or wrong, terminals, shapes, obstacle)


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
    others = [name.removeprefix(folder) for name in files if re.fullmatch(f"{folder}[^/]+", name)]
    if others:
        return f"has no {binary}, the name that its modelIdentifier gives; {folder} has {', '.join(others)}"
    there = ", ".join(fmpy.supported_platforms(str(path))) or "no platform"
    return f"has no binary for this platform, {binary}; it is for {there}"


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
        parser.Parse(content, True)
    except _Prologue as prologue:
        return bool(prologue.args)
    except (expat.ExpatError, ValueError, LookupError):  # who reads the elements says what is wrong
        return False
    return False


def _terminals(path: Path) -> tuple[dict[str, dict[str, str]], str]:
    """The variables of each terminal by member, without terminals within terminals; what is wrong."""
    try:
        with ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.open(TERMINALS).read(LONGEST))
    except (OSError, ElementTree.ParseError) as error:
        return {}, f"{TERMINALS} cannot be read: {error}"
    return {
        terminal.get("name", ""): {
            member.get("memberName", ""): member.get("variableName", "")
            for member in terminal.findall("TerminalMemberVariable")
        }
        for terminal in root.findall("Terminals/Terminal")
    }, ""


def _description(path: Path) -> tuple[ModelDescription, str]:
    """The model description of an FMU, and what is wrong in it if it can be read all the same."""
    try:
        return read_model_description(str(path)), ""
    except Exception as error:  # noqa: BLE001
        reason = _reason(error)
    try:
        return read_model_description(str(path), validate=False), f"{XML} is not valid: {reason}"
    except Exception as error:
        if isinstance(error, INTERNAL):
            raise SetupError(reason) from error
        raise


def _reason(error: Exception) -> str:
    """The last lines of an error as one; errors of the reader itself, of which a user knows nothing, in
    other words.
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


def _require_distinct(fmus: Mapping[str, Fmu]) -> None:
    """Refuse variables of two parts that have one dotted name: a, b.c and a.b, c."""
    for inner, fmu in fmus.items():
        for outer, rest in split_name(inner):
            if outer in fmus:
                names = {f"{rest}.{name}" for name in fmu.variables} & fmus[outer].variables.keys()
                if names:
                    raise SetupError(f"parts {outer} and {inner} both have a {outer}.{min(names)}")


def split_name(name: str) -> list[tuple[str, str]]:
    """The two pieces of a name, cut at each of its dots, the last one first."""
    return [(name[: dot.start()], name[dot.end() :]) for dot in re.finditer(r"\.", name)][::-1]


def _wires(network: Network, given: str | Wire) -> Iterator[Wire]:
    """The wires that a system means by one entry: those between two terminals, or two arrays, or itself."""
    shaft = SHAFT.fullmatch(given) if isinstance(given, str) else None
    if shaft is None:
        yield from _elements(network, Wire.read(given) if isinstance(given, str) else given)
        return
    here = f"wire {given!r}"
    (one, ours), (other, theirs) = (_terminal(network, name, here) for name in shaft.groups())
    shared = [member for member in ours if member in theirs]
    if not shared:
        raise SetupError(
            f"{here}: {', '.join(ours)} and {', '.join(theirs)} have no member in common"
        )
    for member in shared:
        ends = Port(one, ours[member]), Port(other, theirs[member])
        ways = {port.variable.causality: port for port in ends}
        if ways.keys() != {"input", "output"}:
            raise SetupError(
                f"{here}: one of {ends[0]} and {ends[1]} must be an output, one an input"
            )
        source, target = ways["output"], ways["input"]
        yield Wire((source.part, source.variable.name), (target.part, target.variable.name))


def _elements(network: Network, wire: Wire) -> Iterator[Wire]:
    """The wires between the elements of two arrays, or the wire itself."""
    (shape, sources), (other, targets) = (network.array(end) for end in wire[:2])
    if shape != other:
        raise SetupError(f"wire {str(wire)!r}: {_size(shape)} cannot drive {_size(other)}")
    if not shape:
        yield wire
    for source, target in zip(sources, targets) if shape else ():
        there, here = ((port.part, port.variable.name) for port in (source, target))
        yield wire._replace(source=there, target=here)


def _size(shape: Sequence[int]) -> str:
    """Dimensions in words."""
    return f"{' x '.join(map(str, shape))} elements" if shape else "one element"


def _terminal(network: Network, name: str, here: str) -> tuple[str, dict[str, ScalarVariable]]:
    """The part of a terminal, and the variables of its members."""
    for part, terminal in split_name(name):
        if part in network.fmus:
            fmu = network.fmus[part]
            if terminal in fmu.terminals:
                return part, {
                    k: network.port((part, v)).variable for k, v in fmu.terminals[terminal].items()
                }
            known = ", ".join(fmu.terminals) or "none"
            raise SetupError(f"{here}: {part} has no terminal {terminal!r}; it has {known}")
    raise SetupError(f"{here}: {name} names no part, only {', '.join(network.fmus)}")


def _connection(network: Network, wire: Wire) -> Connection:
    here = f"wire {str(wire)!r}"
    source, target = network.port(wire.source), network.port(wire.target)
    if source.variable.causality != "output":
        raise SetupError(f"{here}: {source} has causality {source.variable.causality}, not output")
    if target.variable.causality != "input":
        raise SetupError(f"{here}: {target} has causality {target.variable.causality}, not input")
    for port in (source, target):
        if port.type in ("Binary", "Clock"):
            raise SetupError(f"{here}: {port} is a {port.type}, which wires cannot carry")
    if not types_match(source.type, target.type):
        raise SetupError(f"{here}: {source.type} cannot drive {target.type}")
    if not math.isfinite(wire.factor + wire.offset):
        raise SetupError(f"{here}: factor and offset must be finite numbers")
    scale, shift = _conversion(network, source, target) if wire.converts else (1.0, 0.0)
    made = Connection(source, target, scale * wire.factor, scale * wire.offset + shift)
    if made[2:] != (1.0, 0.0) and source.type != "Real":
        raise SetupError(f"{here}: {source.type} cannot be scaled")
    return made


def types_match(source: str, target: str) -> bool:
    """Whether values of one type can be those of another: FMI hands enumerations on as Integers."""
    return source == target or {source, target} == {"Integer", "Enumeration"}


def _conversion(network: Network, source: Port, target: Port) -> tuple[float, float]:
    """Factor and offset from the source's unit to the target's; no unit fits every unit."""
    if not source.unit or not target.unit or source.unit == target.unit:
        return 1.0, 0.0
    here, there = network.base_unit(source), network.base_unit(target)
    factors = unit_conversion(here, there) if here and there else None
    if factors is None:
        raise SetupError(f"{source} cannot drive {target}")
    return factors


def unit_conversion(here: Any, there: Any) -> tuple[float, float] | None:
    """Factor and offset from one base unit to another; None if they measure different things."""
    if unit_exponents(here) != unit_exponents(there):
        return None
    return here.factor / there.factor, (here.offset - there.offset) / there.factor


def is_continuous_input(port: Port) -> bool:
    """Whether it is an input that moves within steps: a Real one, in FMI 3.0 if it is continuous."""
    real = port.type == "Real" and port.variable.causality == "input"
    return real and (port.native == "Real" or port.variable.variability == "continuous")


class Experiment(NamedTuple):
    """The default experiment of an FMU: times [s] and relative tolerance, None for what it does not state."""

    start: float | None = None
    stop: float | None = None
    step: float | None = None
    tolerance: float | None = None


def default_experiment(description: ModelDescription) -> Experiment:
    """The default experiment that a model description states.

    A step or a tolerance that is not above 0, which no run can have, counts as not stated.
    """
    stated = description.defaultExperiment
    if stated is None:
        return Experiment()
    names = ("startTime", "stopTime", "stepSize", "tolerance")
    texts = (getattr(stated, name) for name in names)
    start, stop, step, tolerance = (None if text is None else float(text) for text in texts)
    positive = (value if value and 0.0 < value < math.inf else None for value in (step, tolerance))
    return Experiment(start, stop, *positive)


def declared_start(variable: ScalarVariable) -> Value | None:
    """The start value that the model description gives a variable, if any."""
    if variable.start is None:
        return None
    kind = "Integer" if variable.type == "Enumeration" else str(variable.type)
    return READ.get(kind, str)(str(variable.start))


def feedthrough(description: ModelDescription) -> dict[str, frozenset[str]]:
    """By output, the inputs that act on it at once; only what the model description declares."""
    return {
        unknown.variable.name: frozenset(
            v.name for v in unknown.dependencies or () if v.causality == "input"
        )
        for unknown in description.outputs
    }


def parts_without(descriptions: Mapping[str, ModelDescription], ability: str) -> list[str]:
    """The parts whose FMUs do not have a capability, by FMI's name of it."""
    return [name for name, d in descriptions.items() if not getattr(d.coSimulation, ability)]


def unit_exponents(unit: Any) -> tuple[int, ...]:
    """The powers of the base units."""
    return tuple(getattr(unit, base) for base in BASES)


def _start(port: Port, value: Value) -> tuple[Port, Value]:
    """A start value in the type of its port; raises SetupError for one that it cannot have."""
    variable = port.variable
    if variable.causality == "structuralParameter" or port.type == "Clock":
        kind = "a clock" if port.type == "Clock" else "a structural parameter"
        raise SetupError(f"{port} is {kind} and cannot be given a start value")
    free = variable.causality in ("parameter", "input") or variable.initial in ("exact", "approx")
    if variable.variability == "constant" or not free:
        raise SetupError(
            f"{port} has causality {variable.causality} and cannot be given a start value"
        )
    if port.type in ("String", "Binary"):
        if not isinstance(value, str):
            raise SetupError(f"{port} = {value!r} must be of type {port.type}")
        if port.type == "Binary":
            try:
                value = bytes.fromhex(value).hex()
            except ValueError:
                raise SetupError(f"{port} = {value!r} must be hexadecimal digits") from None
        return port, value
    items = enumeration(port.variable)
    try:
        value = items.get(value, value) if isinstance(value, str) else value
        number = NUMERIC[port.type](value)
    except (TypeError, ValueError):
        expected = f"one of {', '.join(items)}" if items else f"of type {port.type}"
        raise SetupError(f"{port} = {value!r} must be {expected}") from None
    logical = isinstance(value, bool) and port.type != "Boolean"
    if isinstance(value, str) or logical or number != value:
        given = f"of type {port.type}" if logical or port.type != "Real" else "a finite number"
        raise SetupError(f"{port} = {value!r} must be {given}")
    if not math.isfinite(number):
        raise SetupError(f"{port} = {value!r} must be a finite number")
    for limit in _broken(port, number):
        unit = "" if port.unit in ("", "1") else f" {port.unit}"
        raise SetupError(f"{port} = {value!r} must be {limit}{unit}")
    if items and number not in items.values():
        known = ", ".join(f"{n} ({item})" for item, n in items.items())
        raise SetupError(f"{port} = {value!r} must be one of {known}")
    return port, ctypes.c_float(number).value if port.native == "Float32" else number


def _input(
    network: Network, name: Name, given: Table | Callable[[float], float]
) -> tuple[Port, Table | FunctionInput]:
    """A table in the unit of its input, or a function; raises SetupError for what does not fit."""
    port = network.port(name)
    causality = str(port.variable.causality)
    parameter = causality == "parameter"
    if causality != "input" and not (parameter and port.variable.variability == "tunable"):
        kind = "is a parameter that is not tunable" if parameter else f"has causality {causality}"
        raise SetupError(f"{port} {kind} and cannot change over time")
    moving = is_continuous_input(port)
    if not isinstance(given, Table):
        if not moving:
            raise SetupError(f"{port} cannot follow a function of time; only a Real input can")
        return port, FunctionInput(given)
    if not (moving or given.held):
        raise SetupError(f"{port} cannot be interpolated and can only follow a table that is held")
    factor, offset = conversion_to(network, port, given.unit, "follow a table")
    if (factor, offset) != (1.0, 0.0):
        given = given.mapped(lambda value: factor * value + offset)
    extremes = set(given.values)
    if moving:
        extremes = {min(extremes), max(extremes), *filter(math.isnan, extremes)}
    fitting = {value: _start(port, value)[1] for value in extremes}
    return port, given.mapped(float if moving else fitting.__getitem__)


def conversion_to(network: Network, port: Port, unit: str, what: str) -> tuple[float, float]:
    """Factor and offset from a unit to that of a port, which is to do `what` in that unit.

    The port's display units, common multiples of its own unit and all units that an FMU of the network
    defines are known. Raises SetupError for others.
    """
    if unit in ("", port.unit):
        return 1.0, 0.0
    units = [known for d in network.descriptions.values() for known in d.unitDefinitions]
    for shown in (s for known in units if known.name == port.unit for s in known.displayUnits):
        if shown.name == unit:
            return 1.0 / shown.factor, -shown.offset / shown.factor
    common = multiples(port.unit)
    if unit in common:
        return common[unit], 0.0
    here = next((known.baseUnit for known in units if known.name == unit), None)
    there = network.base_unit(port)
    if here is None or there is None:
        raise SetupError(f"{port} cannot {what} in {unit}: no FMU here defines that unit")
    factors = unit_conversion(here, there)
    if factors is None:
        raise SetupError(f"{port} cannot {what} in {unit}")
    return factors


def _changed(network: Network) -> Iterator[tuple[Port, Table | FunctionInput]]:
    """The changes of each variable as a table that begins with its start value."""
    steps: dict[str, list[tuple[float, Value]]] = {}
    for time, name, text in map(parse_change, network.system.changes):
        port = network.port(name)
        value: Value = text
        with suppress(KeyError, ValueError):
            whole = text.isdecimal() and port.type != "String"
            value = READ["Integer" if whole else port.type](text)
        steps.setdefault(port.name, []).append((time, value))
    start = {port.name: value for port, value in network.start} if steps else {}
    for name, rows in steps.items():
        port = network.port(name)
        before = start.get(name, declared_start(port.variable))
        over = name in network.system.inputs
        if over or before is None:
            why = "also follows a table" if over else "has no start value"
            raise SetupError(f"{port} cannot change: it {why}")
        fitting = [(time, _start(port, value)[1]) for time, value in rows]
        times, values = zip(*sorted(fitting, key=lambda row: row[0]))
        table = Table(times, values, held=True)
        yield _input(network, name, table.after(before))


def enumeration(variable: ScalarVariable) -> dict[str, int]:
    """The names of an enumeration and what they stand for."""
    if variable.type != "Enumeration" or variable.declaredType is None:
        return {}
    return {str(item.name): int(item.value) for item in variable.declaredType.items or ()}


def _broken(port: Port, number: float) -> Iterator[str]:
    """The limits of a port that a number does not keep."""
    if port.type == "Boolean":
        if number not in (0, 1):
            yield "true or false"
        return
    if port.type == "Integer":
        bits, signed = WIDTHS.get(port.native, (32, True))
        lowest, highest = (-(2 ** (bits - 1)), 2 ** (bits - 1)) if signed else (0, 2**bits)
        if not lowest <= number < highest:
            article = "an" if bits == 8 else "a"
            yield f"{article} {bits}-bit {'' if signed else 'unsigned '}integer"
    if port.variable.min is not None and not number >= (low := float(port.variable.min)):
        yield f"at least {low!r}"
    if port.variable.max is not None and not number <= (high := float(port.variable.max)):
        yield f"at most {high!r}"
