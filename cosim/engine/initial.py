"""Start values that agree: parts in initialisation mode, their coupled inputs settled."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import chain
from math import isclose, isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import PartFailure, SetupError
from ..system import Network, Port, Value, Wire, feedthrough
from .changes import fed
from .curve import Curves, Entry, Signal
from .exchange import Coupled
from .feed import Feed
from .ledger import End, bonds, watt
from .library import borrow
from .part import Block

Vector = NDArray[np.float64]
MOST_ITERATIONS = 20
TOLERANCE = 1e-10
SINGULAR = 1e8


def initialise(
    network: Network,
    sequence: Sequence[str],
    stack: ExitStack,
    start: float,
    stop: float,
    *,
    tolerance: float | None = None,
    substeps: Mapping[str, int] | None = None,
    input_order: int = 0,
) -> dict[str, Coupled]:
    """All parts at `start`, their coupled start values consistent, ready for the first step.

    The stack closes the parts. Raises PartFailure where an FMU refuses,
    SetupError where the start values have no solution.
    """
    parts: dict[str, Coupled] = {}
    for name, path in network.system.parts.items():
        description = network.descriptions[name]
        try:
            fmu = borrow(Path(path), description)
        except PartFailure as error:
            raise PartFailure(f"{name}: {error}") from error
        parts[name] = Coupled(name, description, fmu, (substeps or {}).get(name, 1))
        stack.callback(parts[name].close)
    given = {port.name: (port, value) for port, value in network.start}
    given |= {port.name: (port, profile.at(start)) for port, profile in network.inputs}
    for port, value in given.values():
        parts[port.part].set(port.variable, value)
    for part in parts.values():
        part.set_up(tolerance, start, stop)
    for port, value in given.values():
        if port.variable.causality == "input" or _keeps(port):
            parts[port.part].set(port.variable, value)
    _make_blocks(network, parts)
    _connect(network, parts, start)
    settle([parts[name] for name in sequence], start)
    for part in parts.values():
        part.begin()
    for port, value, kept in _lost(given.values(), parts):
        parts[port.part].warn(f"{port} = {value!r} was given, but the FMU starts with {kept!r}")
    if input_order:
        _watch(network, parts, input_order)
    _open_ledger(network, parts)
    for part in parts.values():
        part.read(start)
        for end in part.ends:
            end.before = end.value()
    return parts


def _keeps(port: Port) -> bool:
    """Whether the variable is to keep its start value; some FMUs lose it in SetupExperiment."""
    return bool(port.variable.causality == "parameter" or port.variable.initial == "exact")


def _lost(
    given: Collection[tuple[Port, Value]], parts: Mapping[str, Coupled]
) -> Iterator[tuple[Port, Value, Value]]:
    """What was given a start value and is to keep it, but has another: both values."""
    for name, part in parts.items():
        own = {
            port.variable.name: (port, value)
            for port, value in given
            if port.part == name and port.variable.causality != "input" and _keeps(port)
        }
        for variable, kept in part.values([port.variable for port, _ in own.values()]).items():
            port, value = own[variable]
            real = port.type == "Real" and isclose(float(value), float(kept), rel_tol=1e-9)
            if kept != value and not real:
                yield port, value, kept


def _make_blocks(network: Network, parts: Mapping[str, Coupled]) -> None:
    """Give every part the buffers of its wired variables, the inputs at their declared start.

    A part that only follows inputs over time shows its Real outputs, for step control to see; but
    not those on which an input acts at once, which show it as it was within the step.
    """
    for name, part in parts.items():
        sources = dict.fromkeys(w.source for w in network.wires if w.source.part == name)
        targets = [w.target for w in network.wires if w.target.part == name]
        driven = [port for port, _ in fed(network) if port.part == name]
        targets += driven
        if driven and not any(port.type == "Real" for port in sources):
            acting = feedthrough(part.description)
            sources |= {
                Port(name, v): None
                for v in part.description.modelVariables
                if v.causality == "output" and v.type == "Real" and not acting.get(v.name)
            }
        part.outputs = part.blocks("Get", [port.variable for port in sources])
        part.inputs = part.blocks("Set", [port.variable for port in targets])
        declared = {port.name: port.variable.start for port in targets}
        for block in part.inputs:
            if block.real:
                block.cells[:] = [float(declared[name] or 0.0) for name in block.names]


def _places(parts: Mapping[str, Coupled]) -> dict[str, tuple[Block, int]]:
    """Where each wired variable's value stands."""
    blocks = (block for part in parts.values() for block in chain(part.outputs, part.inputs))
    return {name: (block, i) for block in blocks for i, name in enumerate(block.names)}


def _connect(network: Network, parts: Mapping[str, Coupled], start: float) -> None:
    """Let every input follow its source."""
    place = _places(parts)
    for wire in network.wires:
        (target, i), (source, j) = place[wire.target.name], place[wire.source.name]
        ends = (target.cells, i, source.cells, j)
        parts[wire.target.part].wire(*ends, wire.factor, wire.offset)
    for port, profile in fed(network):
        (target, i), feed = place[port.name], Feed(port.name, profile, start)
        parts[port.part].feeds.append(feed)
        parts[port.part].wire(target.cells, i, feed.cell, 0, 1.0, 0.0)


def _watch(network: Network, parts: Mapping[str, Coupled], degree: int) -> None:
    """Let Real inputs follow the polynomials of their sources in place of the last values."""
    signals: dict[str, Signal] = {}
    for part in parts.values():
        part.curves = Curves(part, degree)
        for block in part.outputs:
            for i, name in enumerate(block.names if block.real else ()):
                signals[name] = Signal(degree)
                part.curves.signals.append((signals[name], block.cells, i))
    wires = {wire.target.name: wire for wire in network.wires}
    for part in parts.values():
        assert part.curves is not None
        real = [block for block in part.inputs if block.real]
        for block in real:
            for i, name in enumerate(block.names):
                feeds = [feed for feed in part.feeds if feed.name == name]
                if feeds:
                    entry = Entry(block.cells, i, feeds[0], 1.0, 0.0)
                else:
                    wire = wires[name]
                    signal = signals[wire.source.name]
                    entry = Entry(block.cells, i, signal, wire.factor, wire.offset)
                part.curves.entries.append(entry)
        moved = {id(block.cells) for block in real}
        part.copies = [copy for copy in part.copies if id(copy[0]) not in moved]
        part.scaled = [copy for copy in part.scaled if id(copy[0]) not in moved]
        part.curves.prepare(
            [vr for block in real for vr in block.references],
            [vr for block in part.outputs if block.real for vr in block.references],
        )


def _open_ledger(network: Network, parts: Mapping[str, Coupled]) -> None:
    """Give every part its sides of the power bonds."""
    place = _places(parts)

    def end(bond: str, side: int, out: Wire, into: Wire) -> End:
        (block, i), (entry, j) = place[out.source.name], place[into.target.name]
        part = parts[out.source.part]
        scale = watt(network, out.source, into.target)
        if part.curves is not None:
            curve = part.curves.entry(entry.cells, j)
            return End(bond, side, (block.cells, i), (curve.first, 0), (curve.last, 0), scale)
        return End(bond, side, (block.cells, i), (entry.cells, j), (entry.cells, j), scale)

    for bond in bonds(network):
        parts[bond.there.source.part].ends.append(end(bond.name, 0, bond.there, bond.back))
        parts[bond.back.source.part].ends.append(end(bond.name, 1, bond.back, bond.there))


def settle(parts: Sequence[Coupled], t: float) -> None:
    """Propagate start values in initialisation mode; solve what feeds back on itself by Newton."""
    for part in parts:
        part.fetch()
    for _ in range(2 + sum(len(block.cells) for part in parts for block in part.inputs)):
        changed = False
        for part in parts:
            changed = _listen(part) or changed
            part.send()
            part.fetch()
        if not changed:
            break
    else:
        names = [name for part in parts for b in part.inputs if b.real for name in b.names]
        newton(lambda z: _response(parts, z), _inputs(parts), names)
    for part in parts:
        for block in part.outputs:
            block.require_finite(t)


def _listen(part: Coupled) -> bool:
    """Bring the values of the wires as far as they are finite; whether any has changed."""
    before = [list(block.cells) for block in part.inputs]
    part.bring()
    for block, old in zip(part.inputs, before):
        if block.real:
            block.cells[:] = [new if isfinite(new) else x for new, x in zip(block.cells, old)]
    return before != [list(block.cells) for block in part.inputs]


def _inputs(parts: Sequence[Coupled]) -> Vector:
    """The wired Real inputs as they stand."""
    return np.array(
        [x for part in parts for block in part.inputs if block.real for x in block.cells]
    )


def _response(parts: Sequence[Coupled], z: Vector) -> Vector:
    """The Real inputs that the outputs give when the inputs are z."""
    values = iter(z.tolist())
    for part in parts:
        for block in part.inputs:
            if block.real:
                block.cells[:] = [next(values) for _ in block.cells]
        part.send()
        part.fetch()
    for part in parts:
        part.bring()
    return _inputs(parts)


def newton(response: Callable[[Vector], Vector], z: Vector, names: Sequence[str]) -> None:
    """Find z = response(z) with finite differences; leaves the system at the solution.

    Raises SetupError with the signals and residuals if there is no solution or no convergence.
    """
    residual = response(z) - z
    for _ in range(MOST_ITERATIONS):
        if (np.abs(residual) <= TOLERANCE * (1.0 + np.abs(z))).all():
            return
        jacobian = np.empty((len(z), len(z)))
        for i in range(len(z)):
            step = 1e-6 * (1.0 + abs(z[i]))
            shifted = z.copy()
            shifted[i] += step
            jacobian[:, i] = (response(shifted) - shifted - residual) / step
        if np.linalg.cond(jacobian) > SINGULAR:
            break
        z = z - np.linalg.solve(jacobian, residual)
        residual = response(z) - z
    worst = ", ".join(
        f"{name} by {r:.2g}" for name, r in zip(names, residual) if abs(r) > TOLERANCE
    )
    raise SetupError(f"the start values of an algebraic loop were not found: {worst} off")
