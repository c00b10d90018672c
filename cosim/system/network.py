"""The network of a system: checked once against the descriptions of its FMUs, and never changed."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ..errors import SetupError
from ..names import meant, only
from .base_units import unit_conversion
from .description import Fmu, ModelDescription, Value, Variable, declared_start
from .inputs import FunctionInput, TableInput
from .ports import Catalog, Port, size_text, split_name
from .profiles import change_profiles, checked_profile
from .reading import WANTED, XML, read_fmu
from .start_values import checked_start
from .wires import SHAFT, System, Wire, require_field_types

Profile = TableInput | FunctionInput
log = logging.getLogger("cosim")


class Connection(NamedTuple):
    """A checked wire: target = factor * source + offset, each in its own unit."""

    source: Port
    target: Port
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Network(Catalog):
    """A system whose names, directions, units and start values have been checked.

    Attributes
    ----------
    wires
        The wires between scalars, in their sequence.
    start
        The start values of the system, and of `open` inputs.
    inputs
        What inputs and tunable parameters follow over time.
    open
        The inputs that nothing drives and nothing sets, with the start of their FMUs.
    """

    wires: tuple[Connection, ...]
    start: tuple[tuple[Port, Value], ...]
    inputs: tuple[tuple[Port, Profile], ...]
    open: tuple[tuple[Port, Value], ...]

    def sums(self) -> dict[str, list[Connection]]:
        """The wires of each input that has several, by its name."""
        return _sums(self.wires)


def connect(system: System, *, runnable: bool = True) -> Network:
    """Check a system against the model descriptions of its FMUs.

    If it need not be `runnable`, FMUs are accepted that can only be described here: those for other
    platforms or for scheduled execution, and those whose clocks nothing ticks.

    Raises SetupError for a file that is not an FMU of FMI 2.0 or 3.0, an unknown part or variable, a
    wire with the wrong direction, type or unit, an input driven twice, and a start value that is not
    finite, out of bounds or cannot be set. Parts for model exchange only are accepted; `run` refuses
    them.
    """
    require_field_types(system)
    if not system.parts:
        raise SetupError("a system needs a part")
    fmus = {
        name: read_fmu(name, path if isinstance(path, Path) else Path(path), runnable=runnable)
        for name, path in system.parts.items()
    }
    _require_distinct_names(fmus)
    catalog = Catalog(system, fmus)
    written = [wire for entry in system.wires for wire in _wires(catalog, entry)]
    wires = [_connection(catalog, wire) for wire in written]
    start = [
        checked_start(catalog, catalog.port(name), value) for name, value in system.start.items()
    ]
    driven = _require_single_drivers(written, wires)
    inputs: list[tuple[Port, Profile]] = [
        checked_profile(catalog, *item) for item in system.inputs.items()
    ]
    inputs += change_profiles(catalog, start)
    for port, _ in inputs:
        if port.name in driven:
            raise SetupError(f"{port} is driven twice, by {driven[port.name]} and over time")
    closed = driven.keys() | {port.name for port, _ in (*start, *inputs)}
    for text in _wrong_starts(catalog, closed) if runnable else ():
        raise SetupError(text)
    unset = tuple(_unconnected_inputs(catalog, closed, runnable=runnable))
    return Network(system, fmus, tuple(wires), (*start, *unset), tuple(inputs), unset)


def _require_single_drivers(
    written: Sequence[Wire], wires: Sequence[Connection]
) -> dict[str, Port]:
    """What drives each wired input; raises SetupError for one that is driven twice without being a sum."""
    driven: dict[str, Port] = {}
    for wire, connection in zip(written, wires):
        source, target = connection.source, connection.target
        if target.name in driven and not wire.adds:
            raise SetupError(f"{target} is driven twice, by {driven[target.name]} and by {source}")
        if wire.adds and (source.type, target.type) != ("Real", "Real"):
            raise SetupError(f"wire {str(wire)!r}: only Reals can be added, not {target.type}s")
        driven[target.name] = source
    for name, summed in _sums(wires).items():
        if len({wire.source for wire in summed}) < len(summed):
            raise SetupError(f"{name} adds one output twice: give it one wire, with a factor")
    return driven


def _sums(wires: Sequence[Connection]) -> dict[str, list[Connection]]:
    """The wires of each input that has several, by its name."""
    into: dict[str, list[Connection]] = {}
    for wire in wires:
        into.setdefault(wire.target.name, []).append(wire)
    return {name: several for name, several in into.items() if len(several) > 1}


def _wrong_starts(catalog: Catalog, closed: set[str]) -> Iterator[str]:
    """Start values of FMUs that are out of their own bounds, of what nothing else sets."""
    for part, fmu in catalog.fmus.items():
        for name, text in fmu.wrong_starts.items():
            if f"{part}.{name}" not in closed:
                yield f"part {part}: {catalog.system.parts[part]}: {XML}, {text}; give it another one"


def _unconnected_inputs(
    catalog: Catalog, closed: set[str], *, runnable: bool
) -> Iterator[tuple[Port, Value]]:
    """The inputs that keep the start of their FMUs; raises SetupError for one without, and silent clocks."""
    for name, description in catalog.descriptions.items():
        for variable in description.modelVariables:
            port = Port(name, variable)
            if variable.type == "Clock":
                if runnable and (obstacle := _clock_obstacle(port, description)):
                    raise SetupError(obstacle)
            elif variable.causality == "input" and port.name not in closed:
                value = declared_start(variable)
                if value is not None:
                    yield port, value
                elif runnable:
                    raise SetupError(f"input {port} is not connected and has no start value")


def _clock_obstacle(port: Port, description: ModelDescription) -> str:
    """Why this master cannot tick a clock; empty if it can or need not."""
    if port.variable.causality != "input":
        return ""
    if port.variable.intervalVariability == "triggered":
        return f"{port} is a triggered clock, which nothing here triggers; only clocks with an interval tick"
    if description.coSimulation and not description.coSimulation.hasEventMode:
        return f"{port} is a clock of an FMU without event mode, in which it would tick"
    return ""


def run_obstacles(network: Network) -> Iterator[str]:
    """Why the parts of a system that is only described cannot run here."""
    for name, fmu in network.fmus.items():
        if fmu.obstacle:
            yield f"part {name}: {network.system.parts[name]} {fmu.obstacle}"
        clocks = (v for v in fmu.description.modelVariables if v.type == "Clock")
        reasons = (_clock_obstacle(Port(name, v), fmu.description) for v in clocks)
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
    """Connect a system for a file format.

    Raises SetupError for inputs over time, parts without co-simulation and, unless the format supports
    `sums`, for sums of wires.
    """
    network = connect(system)
    require_cosimulation(network.descriptions, system.parts)
    if network.system.connectors and "ssp" not in where:
        names = ", ".join(network.system.connectors)
        log.warning("the connectors %s of the system are left out: %s has none", names, where)
    for name in () if sums else network.sums():
        raise SetupError(f"{name} is a sum of wires, which {where} cannot express")
    for port, _ in network.inputs:
        raise SetupError(f"{port.name} changes over time, which {where} cannot express")
    return network


def _require_distinct_names(fmus: Mapping[str, Fmu]) -> None:
    """Refuse variables of two parts that have one dotted name: a, b.c and a.b, c."""
    for inner, fmu in fmus.items():
        for outer, rest in split_name(inner):
            if outer in fmus:
                names = {f"{rest}.{name}" for name in fmu.variables} & fmus[outer].variables.keys()
                if names:
                    raise SetupError(f"parts {outer} and {inner} both have a {outer}.{min(names)}")


def _wires(catalog: Catalog, entry: str | Wire) -> Iterator[Wire]:
    """The wires that a system means by one entry: those between two terminals, or two arrays, or itself."""
    shaft = SHAFT.fullmatch(entry) if isinstance(entry, str) else None
    if shaft is None:
        yield from _elements(catalog, Wire.read(entry) if isinstance(entry, str) else entry)
        return
    context = f"wire {entry!r}"
    (first, ours), (second, theirs) = (_terminal(catalog, name, context) for name in shaft.groups())
    shared = [member for member in ours if member in theirs]
    if not shared:
        raise SetupError(
            f"{context}: {', '.join(ours)} and {', '.join(theirs)} have no member in common"
        )
    for member in shared:
        ends = Port(first, ours[member]), Port(second, theirs[member])
        by_causality = {port.variable.causality: port for port in ends}
        if by_causality.keys() != {"input", "output"}:
            raise SetupError(
                f"{context}: one of {ends[0]} and {ends[1]} must be an output, one an input"
            )
        source, target = by_causality["output"], by_causality["input"]
        yield Wire((source.part, source.variable.name), (target.part, target.variable.name))


def _elements(catalog: Catalog, wire: Wire) -> Iterator[Wire]:
    """The wires between the elements of two arrays, or the wire itself."""
    (shape, sources), (other, targets) = (catalog.array(end) for end in wire[:2])
    if shape != other:
        raise SetupError(f"wire {str(wire)!r}: {size_text(shape)} cannot drive {size_text(other)}")
    if not shape:
        yield wire
        return
    for source, target in zip(sources, targets):
        names = ((port.part, port.variable.name) for port in (source, target))
        yield wire._replace(source=next(names), target=next(names))


def _terminal(catalog: Catalog, name: str, context: str) -> tuple[str, dict[str, Variable]]:
    """The part of a terminal, and the variables of its members."""
    for part, terminal in split_name(name):
        if part in catalog.fmus:
            fmu = catalog.fmus[part]
            if terminal in fmu.terminals:
                return part, {
                    k: catalog.port((part, v)).variable for k, v in fmu.terminals[terminal].items()
                }
            choices = (", ".join(fmu.terminals) or "none") + meant(terminal, fmu.terminals)
            raise SetupError(f"{context}: {part} has no terminal {terminal!r}; it has {choices}")
    part = name.partition(".")[0]
    raise SetupError(f"{context}: {name} names no part, {only(part, catalog.fmus)}")


def _connection(catalog: Catalog, wire: Wire) -> Connection:
    context = f"wire {str(wire)!r}"
    source, target = catalog.port(wire.source), catalog.port(wire.target)
    causalities = source.variable.causality, target.variable.causality
    turned = f"; write {target.name} -> {source.name}" if causalities == ("input", "output") else ""
    if causalities[0] != "output":
        raise SetupError(f"{context}: {source} has causality {causalities[0]}, not output{turned}")
    if causalities[1] != "input":
        raise SetupError(f"{context}: {target} has causality {causalities[1]}, not input")
    for port in (source, target):
        if port.type in ("Binary", "Clock"):
            raise SetupError(f"{context}: {port} is a {port.type}, which wires cannot carry")
    if not types_match(source.type, target.type):
        raise SetupError(f"{context}: {source.type} cannot drive {target.type}")
    if not math.isfinite(wire.factor + wire.offset):
        raise SetupError(f"{context}: factor and offset must be finite numbers")
    scale, shift = _conversion(catalog, source, target) if wire.converts else (1.0, 0.0)
    connection = Connection(source, target, scale * wire.factor, scale * wire.offset + shift)
    if connection[2:] != (1.0, 0.0) and source.type != "Real":
        raise SetupError(f"{context}: {source.type} cannot be scaled")
    return connection


def types_match(source: str, target: str) -> bool:
    """Whether values of one type can be those of another: FMI hands enumerations on as Integers."""
    return source == target or {source, target} == {"Integer", "Enumeration"}


def _conversion(catalog: Catalog, source: Port, target: Port) -> tuple[float, float]:
    """Factor and offset from the source's unit to the target's; no unit fits every unit."""
    if not source.unit or not target.unit:
        return 1.0, 0.0
    try:
        return unit_conversion(catalog.unit(source), catalog.unit(target))
    except SetupError as error:
        raise SetupError(f"{source} cannot drive {target}: {error}") from None
