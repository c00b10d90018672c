"""Start values that agree: parts in initialisation mode, their coupled inputs settled."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np
from numpy.typing import NDArray

from .algorithms import distribute
from .errors import SetupError
from .part import Part
from .system import Network

Vector = NDArray[np.float64]
log = logging.getLogger("cosim")

MOST_ITERATIONS = 20
TOLERANCE = 1e-10
SINGULAR = 1e8


def initialise(
    network: Network, sequence: Sequence[str], stack: ExitStack, start: float, stop: float
) -> dict[str, Part]:
    """All parts at `start`, their coupled start values consistent, ready for the first step.

    The stack closes the parts and removes their folders. Raises PartFailure where an FMU refuses,
    SetupError where the start values have no solution.
    """
    parts: dict[str, Part] = {}
    folders: dict[Path, Path] = {}
    for name, path in network.system.parts.items():
        if path not in folders:
            folders[path] = Path(stack.enter_context(TemporaryDirectory(prefix="cosim_")))
            fmpy.extract(str(path), str(folders[path]))
        parts[name] = Part(name, network.descriptions[name], folders[path])
        stack.callback(parts[name].close)
    for port, value in network.start:
        parts[port.part].set(port.variable, value)
    for part in parts.values():
        part.call("setupExperiment", None, start, stop)
        part.call("enterInitializationMode")
    _wire_up(network, parts)
    settle([parts[name] for name in sequence])
    for part in parts.values():
        part.call("exitInitializationMode")
        part.read()
        for sentence in part.warnings:
            log.warning(sentence)
    return parts


def _wire_up(network: Network, parts: dict[str, Part]) -> None:
    """Give every part the blocks of its wired variables and the copies between them."""
    place: dict[str, tuple[Any, int]] = {}
    for name, part in parts.items():
        sources = dict.fromkeys(w.source for w in network.wires if w.source.part == name)
        targets = [w.target for w in network.wires if w.target.part == name]
        part.outputs = part.blocks("Get", [port.variable for port in sources])
        part.inputs = part.blocks("Set", [port.variable for port in targets])
        for block in (*part.outputs, *part.inputs):
            place |= {variable: (block.cells, i) for i, variable in enumerate(block.names)}
    for wire in network.wires:
        ends = (*place[wire.target.name], *place[wire.source.name])
        parts[wire.target.part].wire(*ends, wire.factor, wire.offset)


def settle(parts: Sequence[Part]) -> None:
    """Propagate start values in initialisation mode; solve what feeds back on itself by Newton."""
    for part in parts:
        part.read()
    for _ in range(2 + sum(len(block.cells) for part in parts for block in part.inputs)):
        changed = False
        for part in parts:
            changed = part.listen() or changed
            part.send()
            part.read()
        if not changed:
            return
    names = [name for part in parts for name in part.real_input_names()]
    newton(lambda z: _response(parts, z), _inputs(parts), names)


def _inputs(parts: Sequence[Part]) -> Vector:
    return np.concatenate([part.real_inputs() for part in parts])


def _response(parts: Sequence[Part], z: Vector) -> Vector:
    """The Real inputs that the outputs give when the inputs are z."""
    distribute(parts, z)
    for part in parts:
        part.send()
        part.read()
    for part in parts:
        part.listen()
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
