"""A system is a value: parts, wires, start values. Connecting it checks every name and unit."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from zipfile import ZipFile

import fmpy
from fmpy.model_description import ModelDescription, ScalarVariable, read_model_description

from .errors import SetupError
from .inputs import Course, Table, change

Value = float | int | bool | str
STATE, VARIABLE_STEP = "canGetAndSetFMUstate", "canHandleVariableCommunicationStepSize"
FALSE_TRUE = {"false": False, "0": False, "true": True, "1": True}
READ: dict[str, Callable[[str], Value]] = {
    "Real": float,
    "Integer": int,
    "Boolean": lambda text: FALSE_TRUE[text.strip()],
    "String": str,
    "Enumeration": str,
}
XML, LONGEST = "modelDescription.xml", 128 * 2**20
NUMERIC = {"Real": float, "Integer": int, "Enumeration": int, "Boolean": int}


NUMBER = r"\s*(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
WIRE = re.compile(
    rf"\s*(?P<source>[^*+\s]+)\s*(?:\*\s*(?P<factor>[+-]?{NUMBER}))?\s*(?P<offset>[+-]{NUMBER})?"
    r"\s*(?P<arrow>->|=>)\s*(?P<target>[^*+\s]+)\s*"
)
PIECE = r"[^\W\d][\w\[\]-]*"
PART = re.compile(rf"{PIECE}(\.{PIECE})*")


@dataclass(frozen=True)
class System:
    """FMU files by part name, wires, start values by variable.

    A wire reads "motor.tau -> conveyor.tau", or with a factor and an offset in the source's unit
    "cam.w * 2.5 + 0.1 -> rotor.w". Convertible units are converted (rpm -> rad/s). With "=>" the
    target takes the number as it stands, whatever the units. A bond names two outputs that are wired
    there and back and multiply to a power: "motor.tau * conveyor.w". Wires whose units show a bond
    beyond doubt need not be named. A part of a subsystem has a dotted name, "line.motor".

    `inputs` are inputs over time by variable: a Table, or a function of time [s]. A change of an
    input or a tunable parameter reads "at 2 s motor.A = 7500". Within a step a Real input is held at
    its mean, or moves on a line where its FMU can; all else changes between steps.
    """

    parts: Mapping[str, Path]
    wires: Sequence[str] = ()
    start: Mapping[str, Value] = field(default_factory=dict)
    bonds: Sequence[str] = ()
    inputs: Mapping[str, Table | Callable[[float], float]] = field(default_factory=dict)
    changes: Sequence[str] = ()


class Port(NamedTuple):
    """A variable of a part."""

    part: str
    variable: ScalarVariable

    @property
    def name(self) -> str:
        return f"{self.part}.{self.variable.name}"

    @property
    def type(self) -> str:
        return str(self.variable.type)

    @property
    def unit(self) -> str:
        return self.variable.unit or ""

    def text(self, value: Value) -> str:
        """A value of it as XML spells it."""
        return str(bool(value)).lower() if self.type == "Boolean" else str(value)

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Wire(NamedTuple):
    """From an output to an input: target = factor * source + offset, each in its own unit."""

    source: Port
    target: Port
    factor: float = 1.0
    offset: float = 0.0


class Network(NamedTuple):
    """A system whose names, directions, units and start values have been checked.

    `blemishes` say by part what is wrong in its model description but does not touch a run.
    """

    system: System
    descriptions: dict[str, ModelDescription]
    wires: list[Wire]
    start: list[tuple[Port, Value]]
    blemishes: Mapping[str, str] = MappingProxyType({})
    inputs: Sequence[tuple[Port, Table | Course]] = ()

    def port(self, name: str) -> Port:
        """The port of a dotted name; raises SetupError if there is none."""
        return _port(self.descriptions, name)


def connect(system: System) -> Network:
    """Check a system against the model descriptions of its FMUs.

    Raises SetupError for a file that is no FMI 2.0 co-simulation FMU, an unknown part or variable,
    a wire of wrong direction, type or unit, an input driven twice or not at all, and a start value
    that is not finite, out of bounds or cannot be set.
    """
    if not system.parts:
        raise SetupError("a system needs a part")
    descriptions = {name: describe_fmu(name, Path(path)) for name, path in system.parts.items()}
    _require_distinct(descriptions)
    wires = [_wire(descriptions, text) for text in system.wires]
    start = [_start(descriptions, name, value) for name, value in system.start.items()]
    driven: dict[str, Wire] = {}
    for wire in wires:
        if wire.target.name in driven:
            first = driven[wire.target.name].source
            raise SetupError(f"{wire.target} is driven twice, by {first} and by {wire.source}")
        driven[wire.target.name] = wire
    inputs = [_input(descriptions, name, given) for name, given in system.inputs.items()]
    inputs += _changed(descriptions, system, {port.name: value for port, value in start})
    for port, _ in inputs:
        if port.name in driven:
            raise SetupError(f"{port} is driven twice, by {driven[port.name].source} and over time")
    given = {port.name for port, _ in (*start, *inputs)}
    for name, description in descriptions.items():
        for variable in description.modelVariables:
            port = Port(name, variable)
            if variable.causality == "input" and port.name not in driven.keys() | given:
                raise SetupError(f"input {port} is not connected: wire it or give it a start value")
    read = {name: _read(Path(path), version(Path(path))) for name, path in system.parts.items()}
    blemishes = {name: blemish for name, (_, blemish) in read.items() if blemish}
    return Network(system, descriptions, wires, start, blemishes, inputs)


def still(system: System, where: str) -> Network:
    """Connect a system for a format, which has no place for inputs over time; raises SetupError."""
    network = connect(system)
    for port, _ in network.inputs:
        raise SetupError(f"{port.name} changes over time, which {where} cannot say")
    return network


def describe_fmu(name: str, path: Path) -> ModelDescription:
    """The description of a part's FMU; raises SetupError if name or file cannot be used."""
    if PART.fullmatch(name) is None:
        raise SetupError(
            f"part name {name!r} must begin with a letter, then letters, digits, _, - and [], "
            "or be such names with dots between"
        )
    if not path.is_file():
        raise SetupError(f"part {name}: there is no file {path}")
    try:
        return _read(path, version(path))[0]
    except SetupError as error:
        raise SetupError(f"part {name}: {path} {error}") from error


def part_name(name: str) -> str:
    """A name as it stands if a part may have it, else the nearest that it may have."""
    if PART.fullmatch(name):
        return name
    name = re.sub(r"[^\w-]+", "_", name).strip("_")
    return name if PART.fullmatch(name) else f"part_{name}"


def version(path: Path) -> tuple[int, int]:
    """What tells a file that has been replaced: its time of change [ns] and its size."""
    file = path.stat()
    return file.st_mtime_ns, file.st_size


@lru_cache(maxsize=64)
def _read(path: Path, _: tuple[int, int]) -> tuple[ModelDescription, str]:
    """The model description of an FMU that this master can run on this platform, and its blemish.

    Kept for as long as the file has this version.
    """
    wanted = "this master runs FMI 2.0 co-simulation"
    try:
        with ZipFile(path) as archive:
            files = archive.namelist()
            long = any(f.file_size > LONGEST for f in archive.infolist() if f.filename == XML)
    except Exception as error:
        raise SetupError(f"is not a valid FMU, it cannot be opened as zip: {error}") from error
    if XML not in files or long:
        which = f"one of more than {LONGEST >> 20} MiB" if long else "no"
        raise SetupError(f"is not a valid FMU, it has {which} {XML}")
    try:
        description = read_model_description(str(path), validate=False)
    except Exception as error:
        raise SetupError(f"is not a valid FMU: modelDescription.xml: {_reason(error)}") from error
    if description.fmiVersion != "2.0":
        raise SetupError(f"is FMI {description.fmiVersion}; {wanted}")
    if description.coSimulation is None:
        raise SetupError(f"offers model exchange only; {wanted}")
    library = f"{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    if f"binaries/{fmpy.platform}/{library}" not in files:
        there = ", ".join(fmpy.supported_platforms(str(path))) or "no platform"
        raise SetupError(
            f"has no binary for this platform, binaries/{fmpy.platform}/{library}; it is for {there}"
        )
    names = Counter(v.name for v in description.modelVariables)
    if twice := [name for name, count in names.items() if count > 1]:
        raise SetupError(f"is not a valid FMU: it has two variables {twice[0]}")
    for variable in description.modelVariables:
        for attribute in ("unit", "min", "max", "nominal") if variable.declaredType else ():
            if getattr(variable, attribute) is None:
                setattr(variable, attribute, getattr(variable.declaredType, attribute))
    try:
        read_model_description(str(path))
    except Exception as error:  # noqa: BLE001
        return description, f"modelDescription.xml is not valid: {_reason(error)}"
    return description, ""


def _reason(error: Exception) -> str:
    """The last lines of an error as one."""
    return "; ".join(line.removeprefix("- ") for line in str(error).splitlines()[-3:])


def _require_distinct(descriptions: Mapping[str, ModelDescription]) -> None:
    """Refuse variables of two parts that have one dotted name: a, b.c and a.b, c."""
    for inner in descriptions:
        for outer in descriptions:
            if inner.startswith(f"{outer}."):
                names = {f"{inner}.{v.name}" for v in descriptions[inner].modelVariables}
                names &= {f"{outer}.{v.name}" for v in descriptions[outer].modelVariables}
                if names:
                    raise SetupError(f"parts {outer} and {inner} both have a {min(names)}")


def _port(descriptions: Mapping[str, ModelDescription], name: str) -> Port:
    name = name.strip()
    parts = sorted((p for p in descriptions if name.startswith(f"{p}.")), key=len, reverse=True)
    for part in parts:
        for candidate in descriptions[part].modelVariables:
            if f"{part}.{candidate.name}" == name:
                return Port(part, candidate)
    if not parts:
        known = ", ".join(descriptions)
        raise SetupError(f"{name}: there is no part {name.partition('.')[0]!r}, only {known}")
    part, names = parts[0], [v.name for v in descriptions[parts[0]].modelVariables]
    variable = name.removeprefix(f"{part}.")
    raise SetupError(f"{part} has no variable {variable!r}, only {', '.join(names)}")


def _wire(descriptions: Mapping[str, ModelDescription], text: str) -> Wire:
    match = WIRE.fullmatch(text)
    if match is None:
        raise SetupError(
            f"wire {text!r} must read 'part.output [* factor] [+ offset] -> part.input', "
            "or => to convert no units"
        )
    source, target = (_port(descriptions, match[end]) for end in ("source", "target"))
    if source.variable.causality != "output":
        raise SetupError(f"wire {text!r}: {source} is {source.variable.causality}, not an output")
    if target.variable.causality != "input":
        raise SetupError(f"wire {text!r}: {target} is {target.variable.causality}, not an input")
    if not fits(source.type, target.type):
        raise SetupError(f"wire {text!r}: {source.type} cannot drive {target.type}")
    factor, offset = (float(re.sub(r"\s", "", match[key] or default))
                      for key, default in (("factor", "1"), ("offset", "0")))  # fmt: skip
    if not math.isfinite(factor + offset):
        raise SetupError(f"wire {text!r}: factor and offset must be finite numbers")
    raw = match["arrow"] == "=>"
    scale, shift = (1.0, 0.0) if raw else _conversion(descriptions, source, target)
    wire = Wire(source, target, scale * factor, scale * offset + shift)
    if wire[2:] != (1.0, 0.0) and source.type != "Real":
        raise SetupError(f"wire {text!r}: {source.type} cannot be scaled")
    return wire


def fits(source: str, target: str) -> bool:
    """Whether values of one type can be those of another: FMI hands enumerations on as Integers."""
    return source == target or {source, target} == {"Integer", "Enumeration"}


def _conversion(
    descriptions: Mapping[str, ModelDescription], source: Port, target: Port
) -> tuple[float, float]:
    """Factor and offset from the source's unit to the target's; no unit fits every unit."""
    if not source.unit or not target.unit or source.unit == target.unit:
        return 1.0, 0.0
    here, there = (base_unit(descriptions, port) for port in (source, target))
    factors = convert(here, there) if here and there else None
    if factors is None:
        raise SetupError(f"{source} cannot drive {target}")
    return factors


def convert(here: Any, there: Any) -> tuple[float, float] | None:
    """Factor and offset from one base unit to another; None if they measure different things."""
    if exponents(here) != exponents(there):
        return None
    return here.factor / there.factor, (here.offset - there.offset) / there.factor


def own_start(variable: ScalarVariable) -> Value | None:
    """The start value that the model description gives a variable, if any."""
    if variable.start is None:
        return None
    kind = "Integer" if variable.type == "Enumeration" else str(variable.type)
    return READ[kind](str(variable.start))


def feedthrough(description: ModelDescription) -> dict[str, frozenset[str]]:
    """By output, the inputs that act on it at once; only what the model description declares."""
    return {
        unknown.variable.name: frozenset(
            v.name for v in unknown.dependencies or () if v.causality == "input"
        )
        for unknown in description.outputs
    }


def lacking(descriptions: Mapping[str, ModelDescription], ability: str) -> list[str]:
    """The parts whose FMUs do not have a capability, by FMI's name of it."""
    return [name for name, d in descriptions.items() if not getattr(d.coSimulation, ability)]


def exponents(unit: Any) -> tuple[int, ...]:
    """The powers of the base units."""
    return tuple(getattr(unit, base) for base in ("kg", "m", "s", "A", "K", "mol", "cd", "rad"))


def base_unit(descriptions: Mapping[str, ModelDescription], port: Port) -> Any:
    """The unit of a port in SI base units, None if its model description does not say."""
    for unit in descriptions[port.part].unitDefinitions:
        if unit.name == port.unit:
            return unit.baseUnit
    return None


def _start(
    descriptions: Mapping[str, ModelDescription], name: str, value: Value
) -> tuple[Port, Value]:
    port = _port(descriptions, name)
    variable = port.variable
    free = variable.causality in ("parameter", "input") or variable.initial in ("exact", "approx")
    if variable.variability == "constant" or not free:
        raise SetupError(f"{port} is {variable.causality} and cannot be given a start value")
    if port.type == "String":
        if not isinstance(value, str):
            raise SetupError(f"{port} = {value!r} must be of type String")
        return port, value
    items = enumeration(port.variable)
    try:
        value = items.get(value, value) if isinstance(value, str) else value
        number = NUMERIC[port.type](value)
    except (TypeError, ValueError):
        expected = f"one of {', '.join(items)}" if items else f"of type {port.type}"
        raise SetupError(f"{port} = {value!r} must be {expected}") from None
    if isinstance(value, str) or number != value:
        given = "a finite number" if port.type == "Real" else f"of type {port.type}"
        raise SetupError(f"{port} = {value!r} must be {given}")
    if not math.isfinite(number):
        raise SetupError(f"{port} = {value!r} must be a finite number")
    for limit, allowed in _limits(port):
        if not allowed(number):
            raise SetupError(f"{port} = {value!r} must be {limit} {port.unit}".rstrip())
    if items and number not in items.values():
        known = ", ".join(f"{n} ({item})" for item, n in items.items())
        raise SetupError(f"{port} = {value!r} must be one of {known}")
    return port, number


def _input(
    descriptions: Mapping[str, ModelDescription],
    name: str,
    given: Table | Callable[[float], float],
) -> tuple[Port, Table | Course]:
    """A table in the unit of its input, or a function; raises SetupError for what does not fit."""
    port = _port(descriptions, name)
    causality = str(port.variable.causality)
    parameter = causality == "parameter"
    if causality != "input" and not (parameter and port.variable.variability == "tunable"):
        kind = "a parameter that is not tunable" if parameter else causality
        raise SetupError(f"{port} is {kind} and cannot change over time")
    moving = port.type == "Real" and not parameter
    if not isinstance(given, Table):
        if not moving:
            raise SetupError(f"{port} cannot follow a function of time, only a Real input can")
        return port, Course(given)
    if not (moving or given.held):
        raise SetupError(f"{port} cannot follow lines, only a table that is held")
    factor, offset = _scale(descriptions, port, given.unit)
    if (factor, offset) != (1.0, 0.0):
        given = given.mapped(lambda value: factor * value + offset)
    extremes = set(given.values)
    if moving:
        extremes = {min(extremes), max(extremes), *filter(math.isnan, extremes)}
    fitting = {value: _start(descriptions, name, value)[1] for value in extremes}
    return port, given.mapped(float if moving else fitting.__getitem__)


def _scale(
    descriptions: Mapping[str, ModelDescription], port: Port, unit: str
) -> tuple[float, float]:
    """Factor and offset from a unit to that of a port."""
    if unit in ("", port.unit):
        return 1.0, 0.0
    units = [known for d in descriptions.values() for known in d.unitDefinitions]
    for shown in (s for known in units if known.name == port.unit for s in known.displayUnits):
        if shown.name == unit:
            return 1.0 / shown.factor, -shown.offset / shown.factor
    here = next((known.baseUnit for known in units if known.name == unit), None)
    there = base_unit(descriptions, port)
    if here is None or there is None:
        raise SetupError(f"{port} cannot follow a table in {unit}: no FMU here defines that unit")
    factors = convert(here, there)
    if factors is None:
        raise SetupError(f"{port} cannot follow a table in {unit}")
    return factors


def _changed(
    descriptions: Mapping[str, ModelDescription], system: System, start: Mapping[str, Value]
) -> Iterator[tuple[Port, Table | Course]]:
    """The changes of each variable as a table that begins with its start value."""
    steps: dict[str, list[tuple[float, Value]]] = {}
    for time, name, text in map(change, system.changes):
        port = _port(descriptions, name)
        value: Value = text
        with suppress(KeyError, ValueError):
            whole = text.isdecimal() and port.type != "String"
            value = READ["Integer" if whole else port.type](text)
        steps.setdefault(port.name, []).append((time, value))
    for name, rows in steps.items():
        port = _port(descriptions, name)
        before = start.get(name, own_start(port.variable))
        if name in system.inputs or before is None:
            why = "follows a table too" if name in system.inputs else "has no start value"
            raise SetupError(f"{port} cannot change: it {why}")
        fitting = [(time, _start(descriptions, name, value)[1]) for time, value in rows]
        times, values = zip(*sorted(fitting, key=lambda row: row[0]))
        table = Table(times, values, held=True)
        yield _input(descriptions, name, table.after(before))


def enumeration(variable: ScalarVariable) -> dict[str, int]:
    """The names of an enumeration and what they stand for."""
    if variable.type != "Enumeration" or variable.declaredType is None:
        return {}
    return {str(item.name): int(item.value) for item in variable.declaredType.items or ()}


def _limits(port: Port) -> Iterator[tuple[str, Any]]:
    if port.type == "Boolean":
        yield "true or false", lambda number: number in (0, 1)
        return
    if port.type == "Integer":
        yield "a 32-bit integer", lambda number: -(2**31) <= number < 2**31
    if port.variable.min is not None:
        low = float(port.variable.min)
        yield f"at least {low!r}", lambda number: number >= low
    if port.variable.max is not None:
        high = float(port.variable.max)
        yield f"at most {high!r}", lambda number: number <= high
