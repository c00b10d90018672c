"""Start values that agree: parts in initialisation mode, their coupled inputs settled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from itertools import chain
from math import isclose, isfinite
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..errors import FmuError, SetupError
from ..fmu.buffers import Slot
from ..fmu.fmi2 import CoSimulation2
from ..fmu.fmi3 import CoSimulation3
from ..fmu.instance import CoSimulation, Instance
from ..fmu.library import Library, borrow
from ..fmu.session import CO_SIMULATION
from ..series import Kind
from ..system import Network, Port, Value, declared_start, feedthrough
from ..system.description import ModelDescription, Variable
from .changes import continuous_profiles
from .energy import BondSide, find_bonds, watts_per_product
from .hermite import SignalHistory
from .links import CastLink, InputPolynomials, Link
from .moments import Moments
from .newton import solve_fixed_point
from .part import I, Part, WiredPart
from .settings import RunSettings
from .snapshot import LiveState, SystemState, require_same_buffers, resume
from .sources import InputSource

Vector = NDArray[np.float64]
#: Relative difference up to which a start value counts as kept: a convention of this project, which allows for an
#: FMU that converts units.
START_ROUNDING = 1e-9


def open_cosimulation(
    name: str, description: ModelDescription, fmu: Library, within: Sequence[Variable] = ()
) -> CoSimulation:
    """An instance that steps, and shows the variables `within` its steps if it can; raises FmuError."""
    kind = CoSimulation2 if description.fmiVersion == "2.0" else CoSimulation3
    return kind(name, description, fmu, within)


def initialise(
    network: Network,
    settings: RunSettings,
    sequence: Sequence[str],
    stack: ExitStack,
    *,
    used: Mapping[str, CoSimulation] = MappingProxyType({}),
    begin: SystemState | None = None,
) -> dict[str, Part]:
    """All parts at the start, their coupled start values consistent, or in the state to `begin` with; ready for a step.

    Where rows lie between steps, FMUs that can are to show recorded columns within them. Instances that have been `used`
    and reset are taken, by part; others are made, and the stack closes them. Raises FmuError where an FMU refuses, SetupError where
    the start values have no solution, and for the state of another system.
    """
    within = settings.ports(network) if settings.steps_per_row() is None else ()

    def opener(name: str, description: ModelDescription, fmu: Library) -> CoSimulation:
        watched = [port.variable for port in within if port.part == name]
        return open_cosimulation(name, description, fmu, watched)

    if begin is None:
        parts, slots = prepare(network, settings, sequence, stack, opener, used=used)
    else:
        states = {name: part.fmu for name, part in begin.parts.items()}
        instances = {
            name: state.instance
            if isinstance(state, LiveState)
            else _opened(network, name, stack, opener)
            for name, state in states.items()
        }
        parts = _with_buffers(network, instances, settings)
        slots = _connect(network, parts, settings.start)
    if settings.input_order:
        _interpolate_inputs(parts, settings.input_order)
    _add_bond_sides(network, parts, slots)
    if begin is not None:
        for name, part in parts.items():
            require_same_buffers(part, begin.parts[name])
        for name, part in parts.items():
            resume(part, begin.parts[name])
        return parts
    Moments([parts[name] for name in sequence], ()).happen(settings.start)
    for part in parts.values():
        for operation in part.read_operations():
            operation(settings.start, 0.0)
        for side in part.bond_sides:
            side.begin_with_present_output()
    return parts


def prepare(
    network: Network,
    settings: RunSettings,
    sequence: Sequence[str],
    stack: ExitStack,
    opener: Callable[[str, ModelDescription, Library], I],
    *,
    used: Mapping[str, I] = MappingProxyType({}),
) -> tuple[dict[str, WiredPart[I]], dict[str, Slot]]:
    """All parts wired at the start, out of initialisation mode, and the slots of wired variables by name.

    The `opener` makes the parts' instances; the other parameters and exceptions are those of `initialise`.
    """
    start = settings.start
    starts = start_values(network, start)

    instance = partial(_opened, network, stack=stack, opener=opener)

    def with_starts(opened: I) -> I:
        """An instance with its start values."""
        for port, value in starts.values():
            if port.part == opened.session.name:
                opened.set(port.variable, value)
        return opened

    instances = {
        name: with_starts(used[name] if name in used else instance(name))
        for name in network.system.parts
    }
    for name, opened in instances.items():
        again = partial(lambda name: with_starts(instance(name)), name)
        instances[name] = _set_up(opened, settings, again)
    for port, value in starts.values():
        if is_set_while_initialising(port):
            instances[port.part].set(port.variable, value)
    parts = _with_buffers(network, instances, settings)
    slots = _connect(network, parts, start)
    settle([parts[name] for name in sequence], start)
    for opened in instances.values():
        opened.leave_initialisation(waits=True)
    _warn_of_other_starts(starts.values(), instances)
    return parts, slots


def _opened(
    network: Network,
    name: str,
    stack: ExitStack,
    opener: Callable[[str, ModelDescription, Library], I],
) -> I:
    """A new instance of a part, which the stack closes."""
    description = network.descriptions[name]
    try:
        fmu = borrow(network.fmus[name].path, description)
    except FmuError as error:
        raise FmuError(f"{name}: {error}") from error
    instance = opener(name, description, fmu)
    stack.callback(instance.session.close)
    return instance


def start_values(network: Network, start: float) -> dict[str, tuple[Port, Value]]:
    """What is set before a run that begins at a time [s], by name and in this sequence."""
    starts = {port.name: (port, value) for port, value in network.start}
    return starts | {port.name: (port, profile.at(start)) for port, profile in network.inputs}


def is_set_while_initialising(port: Port) -> bool:
    """Whether it is set in initialisation mode too."""
    return port.variable.causality == "input" or must_keep_start(port)


def _set_up(instance: I, settings: RunSettings, again: Callable[[], I]) -> I:
    """The instance in initialisation mode; another one from `again` if it needs the stop time for that.

    The stop time is handed over if the settings define it. Otherwise it is handed over only to an FMU
    that refuses to initialise without it, which is then warned of. Raises FmuError.
    """
    session, tolerance = instance.session, settings.tolerance
    if tolerance is None and session.side == CO_SIMULATION:
        tolerance = session.description.defaultExperiment.tolerance
    stop = settings.stop if settings.stop_time_defined or session.is_told_stop else None
    try:
        instance.enter_initialisation(tolerance, settings.start, stop)
    except FmuError as failure:
        if stop is not None or session.fmu.abandoned:
            raise
        with suppress(FmuError):
            session.close()
            other = again()
            other.enter_initialisation(tolerance, settings.start, settings.stop)
            other.session.is_told_stop = True
            other.session.messages.keep_warning(
                f"the FMU does not initialise without a stop time, so it was handed over: {failure}"
            )
            return other
        raise
    return instance


def must_keep_start(port: Port) -> bool:
    """Whether the variable is to keep its start value; some FMUs lose it in SetupExperiment."""
    return bool(port.variable.causality == "parameter" or port.variable.initial == "exact")


def _warn_of_other_starts(
    starts: Iterable[tuple[Port, Value]], instances: Mapping[str, Instance]
) -> None:
    """Let the parts warn of what was given a start value and is to keep it, but has another."""
    by_part: dict[str, list[tuple[Port, Value]]] = {}
    for port, value in starts:
        if port.variable.causality != "input" and must_keep_start(port):
            by_part.setdefault(port.part, []).append((port, value))
    for name, fixed in by_part.items():
        instance = instances[name]
        now = instance.session.values([port.variable for port, _ in fixed])
        for port, value in fixed:
            has = now[port.variable.name]
            real = port.type == "Real" and isclose(float(value), float(has), rel_tol=START_ROUNDING)
            if has != value and not real:
                instance.session.messages.keep_warning(
                    f"{port} = {value!r} was given, but the FMU starts with {has!r}"
                )


def _with_buffers(
    network: Network, instances: Mapping[str, I], settings: RunSettings
) -> dict[str, WiredPart[I]]:
    """The parts with the buffers of their wired variables, which nothing connects yet.

    Inputs begin at their declared start, those of an array at what they are given.
    """
    sources = outputs_read_each_step(network)
    starts = {port.name: value for port, value in network.start}
    targets: dict[str, list[Port]] = {name: [] for name in instances}
    for entry in dict.fromkeys(wire.target for wire in network.wires):
        targets[entry.part].append(entry)
    for port, _ in continuous_profiles(network):
        targets[port.part].append(port)
    parts: dict[str, WiredPart[I]] = {}
    for name, instance in instances.items():
        outputs = instance.session.blocks("Get", [port.variable for port in sources[name]])
        inputs = instance.session.blocks("Set", [port.variable for port in targets[name]])
        for block in inputs:
            if block.real:
                block.cells[:] = [float(v.start or 0.0) for v in block.variables]
            for i, v in enumerate(block.variables):
                if len(v.family) > 1:
                    block.put(i, starts.get(block.names[i], declared_start(v)))
        substeps = settings.substeps.get(name, 1)
        parts[name] = WiredPart(instance, inputs, outputs, settings.stop, substeps)
    return parts


def _connect(network: Network, parts: Mapping[str, WiredPart[I]], start: float) -> dict[str, Slot]:
    """Let every input follow its source; the slots of the wired variables by name."""
    slots, driven_names = _slots(parts), set[str]()
    for wire in network.wires:
        target, source = slots[wire.target.name], slots[wire.source.name]
        kind = Link if target.kind is source.kind else CastLink
        link = kind(target, source, wire.factor, wire.offset)
        link.adds = target.name in driven_names
        link.is_held = {wire.source.kind, wire.target.kind} != {Kind.CONTINUOUS}
        driven_names.add(target.name)
        parts[wire.target.part].links.append(link)
    for port, profile in continuous_profiles(network):
        source_over_time = InputSource(port.name, profile, start)
        parts[port.part].feeds.append(source_over_time)
        parts[port.part].links.append(Link(slots[port.name], source_over_time.slot))
    return slots


def outputs_read_each_step(network: Network) -> dict[str, list[Port]]:
    """By part the outputs that are read at every communication point.

    These are the wired ones. A part that only follows inputs over time shows its Real outputs, for
    step control to see; but not those with direct feedthrough, which show it as it was within
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


def _slots(parts: Mapping[str, WiredPart[I]]) -> dict[str, Slot]:
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
        part.curves = InputPolynomials(part.instance, degree, inputs, links, outputs)
        signals |= part.curves.histories_by_output()
        signals |= {source.name: source for source in part.feeds}
    for part in parts.values():
        for link in part.curves.links if part.curves else ():
            link.follow(signals[link.source.name])


def _add_bond_sides(network: Network, parts: Mapping[str, Part], slots: Mapping[str, Slot]) -> None:
    """Give every part its sides of the power bonds; where inputs follow polynomials, their links know it."""
    links = {link.target.name: link for part in parts.values() for link in part.links}
    for bond in find_bonds(network):
        for side, (out, into) in enumerate([(bond.forth, bond.back), (bond.back, bond.forth)]):
            link = links[into.target.name]
            scale = watts_per_product(network, out.source, into.target)
            output = slots[out.source.name]
            bond_side = BondSide(
                bond.name, side, output, first=link.first, last=link.last, scale=scale
            )
            parts[out.source.part].bond_sides.append(bond_side)


def settle(parts: Sequence[WiredPart[I]], t: float) -> None:
    """Propagate start values in initialisation mode; solve what feeds back on itself by Newton."""
    real = [block for part in parts for block in part.inputs if block.real]
    outputs = [block for part in parts for block in part.outputs]
    for block in outputs:
        block.move()

    def response(z: Vector | None = None) -> Vector:
        """The present Real inputs, or those that the outputs give when the inputs are z."""
        if z is not None:
            values = iter(z.tolist())
            for block in real:
                block.cells[:] = [next(values) for _ in block.cells]
            for part in parts:
                part.set_inputs_and_get_outputs()
            for part in parts:
                part.apply_links()
        return np.array([x for block in real for x in block.cells])

    for _ in range(2 + sum(len(block.cells) for part in parts for block in part.inputs)):
        changed = False
        for part in parts:
            changed = _apply_finite_links(part) or changed
            part.set_inputs_and_get_outputs()
        if not changed:
            break
    else:
        names = [name for block in real for name in block.names]
        nominal = np.array([size for block in real for size in block.nominals()])
        if worst := solve_fixed_point(response, response(), nominal, names):
            raise SetupError(
                f"the start values of an algebraic loop were not found; still off: {worst}"
            )
    for block in outputs:
        block(t)


def _apply_finite_links(part: WiredPart[I]) -> bool:
    """Bring the values of the wires as far as they are finite; whether any has changed."""
    before = [list(block.cells) for block in part.inputs]
    part.apply_links()
    for block, old in zip(part.inputs, before):
        if block.real:
            block.cells[:] = [new if isfinite(new) else x for new, x in zip(block.cells, old)]
    return before != [list(block.cells) for block in part.inputs]
