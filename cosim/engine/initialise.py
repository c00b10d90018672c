"""Start values that agree: parts in initialisation mode, their coupled inputs settled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from itertools import chain
from math import isclose, isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FmuError
from ..fmu.buffers import Slot
from ..fmu.library import borrow
from ..system import Network, Port, Value, declared_start, feedthrough
from .changes import continuous_profiles
from .energy import BondSide, find_bonds, watts_per_product
from .fmi3 import Part3
from .hermite import SignalHistory
from .links import CastLink, InputPolynomials, Link
from .newton import solve_fixed_point
from .part import Part
from .settings import RunSettings
from .sources import InputSource

Vector = NDArray[np.float64]
KINDS: dict[str, type[Part]] = {"2.0": Part, "3.0": Part3}


def initialise(
    network: Network,
    settings: RunSettings,
    sequence: Sequence[str],
    stack: ExitStack,
    within: Sequence[Port] = (),
    kinds: Mapping[str, type[Part]] = KINDS,
) -> dict[str, Part]:
    """All parts at the start, their coupled start values consistent, ready for the first step.

    The FMUs that can are to show the ports `within` their steps. `kinds` makes a part, by the version
    of its FMU. The stack closes the parts.
    Raises FmuError where an FMU refuses, SetupError where the start values have no solution.
    """
    start, parts = settings.start, dict[str, Part]()
    starts = {port.name: (port, value) for port, value in network.start}
    starts |= {port.name: (port, profile.at(start)) for port, profile in network.inputs}

    def instance(name: str) -> Part:
        """The part, instantiated and with its start values."""
        description = network.descriptions[name]
        try:
            fmu = borrow(Path(network.system.parts[name]), description)
        except FmuError as error:
            raise FmuError(f"{name}: {error}") from error
        watched = [port.variable for port in within if port.part == name]
        part = kinds[description.fmiVersion](name, description, fmu, watched)
        part.open()
        stack.callback(part.close)
        part.substeps = settings.substeps.get(name, 1)
        for port, value in starts.values():
            if port.part == name:
                part.set(port.variable, value)
        return part

    for name in network.system.parts:
        parts[name] = instance(name)
    for name in parts:
        parts[name] = _set_up(parts[name], settings, partial(instance, name))
    for port, value in starts.values():
        if port.variable.causality == "input" or _keeps(port):
            parts[port.part].set(port.variable, value)
    slots = _connect(network, parts, start)
    settle([parts[name] for name in sequence], start)
    for part in parts.values():
        part.begin()
    _warn_of_other_starts(starts.values(), parts)
    if settings.input_order:
        _interpolate_inputs(parts, settings.input_order)
    _open_bonds(network, parts, slots)
    for part in parts.values():
        for operation in part.read_operations():
            operation(start, 0.0)
        for end in part.bond_sides:
            end.open()
    return parts


def _set_up(part: Part, settings: RunSettings, again: Callable[[], Part]) -> Part:
    """The part in initialisation mode; another instance from `again` if it needs the stop time for that.

    The stop time is handed over if the settings define it. Otherwise it is handed over only to an FMU
    that refuses to initialise without it, which is then warned of. Raises FmuError.
    """
    tolerance = settings.tolerance
    if tolerance is None and part.SIDE == "coSimulation":
        tolerance = part.description.defaultExperiment.tolerance
    stop = settings.stop if settings.stop_time_defined else None
    part.limit(settings.stop)
    try:
        part.set_up(tolerance, settings.start, stop)
    except FmuError as failure:
        if stop is not None or part.fmu.abandoned:
            raise
        with suppress(FmuError):
            part.close()
            other = again()
            other.limit(settings.stop)
            other.set_up(tolerance, settings.start, settings.stop)
            other.warn(
                f"the FMU does not initialise without a stop time, so it was handed over: {failure}"
            )
            return other
        raise
    return part


def _keeps(port: Port) -> bool:
    """Whether the variable is to keep its start value; some FMUs lose it in SetupExperiment."""
    return bool(port.variable.causality == "parameter" or port.variable.initial == "exact")


def _warn_of_other_starts(starts: Iterable[tuple[Port, Value]], parts: Mapping[str, Part]) -> None:
    """Let the parts warn of what was given a start value and is to keep it, but has another."""
    by_part: dict[str, list[tuple[Port, Value]]] = {}
    for port, value in starts:
        if port.variable.causality != "input" and _keeps(port):
            by_part.setdefault(port.part, []).append((port, value))
    for name, fixed in by_part.items():
        now = parts[name].values([port.variable for port, _ in fixed])
        for port, value in fixed:
            has = now[port.variable.name]
            real = port.type == "Real" and isclose(float(value), float(has), rel_tol=1e-9)
            if has != value and not real:
                parts[name].warn(f"{port} = {value!r} was given, but the FMU starts with {has!r}")


def _connect(network: Network, parts: Mapping[str, Part], start: float) -> dict[str, Slot]:
    """Give every part the buffers of its wired variables, and let every input follow its source.

    Inputs begin at their declared start, those of an array at what they are given. Returns the slots of
    the wired variables by name.
    """
    sources, driven = monitored_outputs(network), continuous_profiles(network)
    starts = {port.name: value for port, value in network.start}
    targets: dict[str, list[Port]] = {name: [] for name in parts}
    for entry in dict.fromkeys(wire.target for wire in network.wires):
        targets[entry.part].append(entry)
    for port, _ in driven:
        targets[port.part].append(port)
    for name, part in parts.items():
        part.outputs = part.blocks("Get", [port.variable for port in sources[name]])
        part.inputs = part.blocks("Set", [port.variable for port in targets[name]])
        for block in part.inputs:
            if block.real:
                block.cells[:] = [float(v.start or 0.0) for v in block.variables]
            for i, v in enumerate(block.variables):
                if len(v.family) > 1:
                    block.put(i, starts.get(block.names[i], declared_start(v)))
    slots, driven_names = _slots(parts), set[str]()
    for wire in network.wires:
        target, source = slots[wire.target.name], slots[wire.source.name]
        kind = Link if target.kind is source.kind else CastLink
        link = kind(target, source, wire.factor, wire.offset)
        link.adds = target.name in driven_names
        driven_names.add(target.name)
        parts[wire.target.part].links.append(link)
    for port, profile in driven:
        source_over_time = InputSource(port.name, profile, start)
        parts[port.part].feeds.append(source_over_time)
        parts[port.part].links.append(Link(slots[port.name], source_over_time.slot))
    return slots


def monitored_outputs(network: Network) -> dict[str, list[Port]]:
    """By part the outputs that are read at every communication point.

    These are the wired ones. A part that only follows inputs over time shows its Real outputs, for
    step control to see; but not those on which an input acts at once, which show it as it was within
    the step.
    """
    sources: dict[str, dict[Port, None]] = {name: {} for name in network.descriptions}
    for wire in network.wires:
        sources[wire.source.part][wire.source] = None
    for name in {port.part for port, _ in continuous_profiles(network)}:
        if not any(port.type == "Real" for port in sources[name]):
            description = network.descriptions[name]
            acting = feedthrough(description)
            sources[name] |= {
                Port(name, v): None
                for v in description.modelVariables
                if v.causality == "output" and v.type == "Real" and not acting.get(v.name)
            }
    return {name: list(ports) for name, ports in sources.items()}


def _slots(parts: Mapping[str, Part]) -> dict[str, Slot]:
    """Where each wired variable's value stands, by its name."""
    slots: dict[str, Slot] = {}
    for part in parts.values():
        for block in chain(part.outputs, part.inputs):
            slots |= block.slots()
    return slots


def _interpolate_inputs(parts: Mapping[str, Part], degree: int) -> None:
    """Let Real inputs follow the polynomials of their sources in place of the last values."""
    signals: dict[str, SignalHistory | InputSource] = {}
    for part in parts.values():
        inputs, outputs = (
            next((block for block in blocks if block.real), None)
            for blocks in (part.inputs, part.outputs)
        )
        names = set(inputs.names) if inputs else set[str]()
        links = [link for link in part.links if link.target.name in names]
        part.curves = InputPolynomials(part, degree, inputs, links, outputs)
        signals |= part.curves.signals_by_name()
        signals |= {source.name: source for source in part.feeds}
    for part in parts.values():
        for link in part.curves.links if part.curves else ():
            link.follow(signals[link.source.name])


def _open_bonds(network: Network, parts: Mapping[str, Part], slots: Mapping[str, Slot]) -> None:
    """Give every part its sides of the power bonds; where inputs follow polynomials, their links know it."""
    links = {link.target.name: link for part in parts.values() for link in part.links}
    for bond in find_bonds(network):
        for side, (out, into) in enumerate([(bond.forth, bond.back), (bond.back, bond.forth)]):
            link = links[into.target.name]
            scale = watts_per_product(network, out.source, into.target)
            output = slots[out.source.name]
            bond_side = BondSide(bond.name, side, output, link.first, link.last, scale)
            parts[out.source.part].bond_sides.append(bond_side)


def settle(parts: Sequence[Part], t: float) -> None:
    """Propagate start values in initialisation mode; solve what feeds back on itself by Newton."""
    real = [block for part in parts for block in part.inputs if block.real]
    outputs = [block for part in parts for block in part.outputs]
    for block in outputs:
        block.move()

    def response(z: Vector | None = None) -> Vector:
        """The Real inputs as they stand, or those that the outputs give when the inputs are z."""
        if z is not None:
            values = iter(z.tolist())
            for block in real:
                block.cells[:] = [next(values) for _ in block.cells]
            for part in parts:
                part.exchange()
            for part in parts:
                part.apply_links()
        return np.array([x for block in real for x in block.cells])

    for _ in range(2 + sum(len(block.cells) for part in parts for block in part.inputs)):
        changed = False
        for part in parts:
            changed = _listen(part) or changed
            part.exchange()
        if not changed:
            break
    else:
        names = [name for block in real for name in block.names]
        nominal = np.array([size for block in real for size in block.nominals()])
        solve_fixed_point(response, response(), nominal, names)
    for block in outputs:
        block(t)


def _listen(part: Part) -> bool:
    """Bring the values of the wires as far as they are finite; whether any has changed."""
    before = [list(block.cells) for block in part.inputs]
    part.apply_links()
    for block, old in zip(part.inputs, before):
        if block.real:
            block.cells[:] = [new if isfinite(new) else x for new, x in zip(block.cells, old)]
    return before != [list(block.cells) for block in part.inputs]
