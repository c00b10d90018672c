"""Start values that agree: parts in initialisation mode, their coupled inputs settled."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from itertools import chain, compress
from math import isclose
from types import MappingProxyType
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from ..errors import FmuError
from ..fmu.buffers import Slot
from ..fmu.library import Library, borrow
from ..fmu.session import CO_SIMULATION
from ..fmu.session2 import Session2
from ..fmu.session3 import Session3
from ..series import Kind
from ..system import Network, Port, Value, declared_start, feedthrough
from ..system.description import ModelDescription
from .changes import continuous_profiles
from .energy import Bond, BondSide, watts_per_product
from .hermite import SignalHistory
from .links import CastLink, InputPolynomials, Link
from .part import I, Part, WiredPart
from .settings import RunSettings
from .settle import settle_start
from .sources import InputSource

Vector = NDArray[np.float64]
#: Relative difference up to which a start value counts as kept: a convention of this project, which allows for an
#: FMU that converts units.
START_ROUNDING = 1e-9


class StartBlocks:
    """Start values of an instance, set by one call for each type; elements of arrays and Binaries one by one."""

    def __init__(self, session: Session2 | Session3, ports: Sequence[Port]) -> None:
        self._session = session
        is_single = [len(p.variable.family) > 1 or p.type == "Binary" for p in ports]
        self._singles = [*compress(ports, is_single)]
        plain = [p.variable for p, single in zip(ports, is_single) if not single]
        self._blocks = session.blocks("Set", plain)

    def set(self, values: Mapping[str, Value]) -> None:
        """Set those of these values, by name, that are of this instance; raises FmuError."""
        for block in self._blocks:
            for i, name in enumerate(block.names):
                block.put(i, values[name])
            block.move()
        for port in self._singles:
            self._session.set(port.variable, values[port.name])


class PartStart:
    """What an instance is given before it is initialised, and while; it is warned of what does not stay so."""

    def __init__(self, session: Session2 | Session3, ports: Sequence[Port]) -> None:
        self.before = StartBlocks(session, ports)
        self.inside = StartBlocks(session, [p for p in ports if is_set_while_initialising(p)])
        self._fixed = [p for p in ports if p.variable.causality != "input" and must_keep_start(p)]
        self._values = session.reader([port.variable for port in self._fixed])
        self._messages = session.messages

    def warn_of_others(self, starts: Mapping[str, Value]) -> None:
        """Warn of what was given a start value and is to keep it, but has another."""
        now = self._values() if self._fixed else {}
        for port in self._fixed:
            value, has = starts[port.name], now[port.variable.name]
            real = port.type == "Real" and isclose(float(value), float(has), rel_tol=START_ROUNDING)
            if has != value and not real:
                self._messages.keep_warning(
                    f"{port} = {value!r} was given, but the FMU starts with {has!r}"
                )


class WiredParts(Generic[I]):
    """Instances of the FMUs of a network on their wires, to begin any number of runs; `slots` are those of wired variables.

    The `opener` makes the instances, which the stack closes, unless they are `lent`. Raises FmuError where an FMU refuses.
    """

    def __init__(
        self,
        network: Network,
        stack: ExitStack,
        opener: Callable[[str, ModelDescription, Library], I],
        lent: Mapping[str, I] = MappingProxyType({}),
    ) -> None:
        self._open = partial(_opened, network, stack=stack, opener=opener)
        self.instances = {
            name: lent[name] if name in lent else self._open(name) for name in network.system.parts
        }
        self._starts: dict[str, PartStart] = {}
        self._network = network
        self._values: dict[str, Value] = {}
        self._ports: dict[str, list[Port]] = {}
        self.parts: dict[str, WiredPart[I]] = {}
        self.slots: dict[str, Slot] = {}

    def reset(self) -> bool:
        """Let the instances be as new; whether all could."""
        try:
            for instance in self.instances.values():
                if instance.session.fmu.abandoned:
                    return False
                instance.reset()
        except FmuError:
            return False
        return True

    def wire(self, network: Network, settings: RunSettings, starts: Mapping[str, Value]) -> None:
        """Connect the parts, and let their buffers be as new; elements of arrays have these start values, by name."""
        if not self.parts:
            self.parts = _with_buffers(network, self.instances, settings.substeps)
            self.slots = _connect(network, self.parts, settings.start)
        for part in self.parts.values():
            part.begin(settings.start, settings.stop)
            for block, i, v in part.array_inputs:
                block.put(i, starts.get(block.names[i], declared_start(v)))

    def begin(
        self,
        network: Network,
        settings: RunSettings,
        sequence: Sequence[str],
        case: Mapping[str, Value] = MappingProxyType({}),
    ) -> None:
        """Bring the parts, new or reset, to the start, out of initialisation mode; start values settle in this sequence.

        Those of the network that a `case` names have other values. Raises FmuError where an FMU refuses, SetupError where the
        start values have no solution.
        """
        if not self._starts or self._network is not network:
            starts = start_values(network, settings.start)
            self._network, self._values = network, {name: x for name, (_, x) in starts.items()}
            self._ports = {name: list[Port]() for name in self.instances}
            for port, _ in starts.values():
                self._ports[port.part].append(port)
            self._starts = {name: self._start(name) for name in self.instances}
        values = {**self._values, **case}
        for start in self._starts.values():
            start.before.set(values)
        for name in self.instances:
            self._set_up(name, settings, values)
        for start in self._starts.values():
            start.inside.set(values)
        self.wire(network, settings, values)
        settle_start([self.parts[name] for name in sequence], settings.start)
        for instance in self.instances.values():
            instance.leave_initialisation(waits=True)
        for start in self._starts.values():
            start.warn_of_others(values)

    def _start(self, name: str) -> PartStart:
        """How the present instance of a part begins."""
        return PartStart(self.instances[name].session, self._ports[name])

    def _set_up(self, name: str, settings: RunSettings, values: Mapping[str, Value]) -> None:
        """Let a part enter initialisation mode, by another instance if it needs the stop time for that.

        The stop time is handed over if the settings define it. Otherwise it is handed over only to an FMU
        that refuses to initialise without it, which is then warned of. Raises FmuError.
        """
        instance = self.instances[name]
        session, tolerance = instance.session, settings.told_tolerance
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
                self.instances[name] = other = self._open(name)
                self._starts[name], self.parts = self._start(name), {}
                self._starts[name].before.set(values)
                other.enter_initialisation(tolerance, settings.start, settings.stop)
                other.session.is_told_stop = True
                other.session.messages.keep_warning(
                    f"the FMU does not initialise without a stop time, so it was handed over: {failure}"
                )
                return
            raise


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


def must_keep_start(port: Port) -> bool:
    """Whether the variable is to keep its start value; some FMUs lose it in SetupExperiment."""
    return bool(port.variable.causality == "parameter" or port.variable.initial == "exact")


def _with_buffers(
    network: Network, instances: Mapping[str, I], substeps: Mapping[str, int]
) -> dict[str, WiredPart[I]]:
    """The parts with the buffers of their wired variables, which nothing connects yet; inputs begin at their declared start."""
    sources = outputs_read_each_step(network)
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
        parts[name] = WiredPart(instance, inputs, outputs, substeps.get(name, 1))
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


def interpolate_inputs(parts: Mapping[str, Part], degree: int) -> None:
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


def add_bond_sides(
    network: Network, parts: Mapping[str, Part], slots: Mapping[str, Slot], bonds: Sequence[Bond]
) -> None:
    """Give every part its sides of the power bonds; where inputs follow polynomials, their links know it."""
    links = {link.target.name: link for part in parts.values() for link in part.links}
    for bond in bonds:
        for side, (out, into) in enumerate([(bond.forth, bond.back), (bond.back, bond.forth)]):
            link = links[into.target.name]
            scale = watts_per_product(network, out.source, into.target)
            output = slots[out.source.name]
            bond_side = BondSide(
                bond.name, side, output, first=link.first, last=link.last, scale=scale
            )
            parts[out.source.part].bond_sides.append(bond_side)
