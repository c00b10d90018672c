"""Run a system with a fixed communication step: Jacobi, Gauss-Seidel or Strang."""

from __future__ import annotations

import importlib.metadata
import logging
import math
import platform
import signal
import threading
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy

from .errors import Interrupted, PartFailure, SetupError, SimulationError
from .part import Block, Part
from .result import Recorder, Result
from .system import Network, Port, System, connect

Advance = Callable[[float, float], None]
log = logging.getLogger("cosim")


def jacobi(parts: Sequence[Part]) -> Advance:
    """All parts step with the values of the step's beginning."""

    def advance(t: float, h: float) -> None:
        for part in parts:
            part.write()
        for part in parts:
            part.step(t, h)
        for part in parts:
            part.read()

    return advance


def gauss_seidel(parts: Sequence[Part]) -> Advance:
    """One after the other, each with the newest values of the ones before."""

    def advance(t: float, h: float) -> None:
        for part in parts:
            turn(part, t, h)

    return advance


def strang(parts: Sequence[Part]) -> Advance:
    """Symmetric: all but the last half a step, the last a full one, the others backwards."""
    *first, last = parts

    def advance(t: float, h: float) -> None:
        half = h / 2
        for part in first:
            turn(part, t, half)
        turn(last, t, h)
        for part in reversed(first):
            turn(part, t + half, half)

    return advance


def turn(part: Part, t: float, h: float) -> None:
    """Give a part the newest values, step it, fetch its outputs."""
    part.write()
    part.step(t, h)
    part.read()


ALGORITHMS: dict[str, Callable[[Sequence[Part]], Advance]] = {
    "jacobi": jacobi,
    "gauss-seidel": gauss_seidel,
    "strang": strang,
}


def run(
    system: System,
    *,
    stop: float,
    step: float,
    start: float = 0.0,
    algorithm: str = "strang",
    order: Sequence[str] | None = None,
    record: Sequence[str] | None = None,
    every: int = 1,
    csv: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Result:
    """Simulate from `start` to `stop` [s] with communication steps of `step` [s].

    Rows are the values at t = start + n*step for every `every`-th n, the first and the last step;
    `record` names the columns (default: all outputs). `order` is the order in which Gauss-Seidel
    and Strang step the parts (default: each after the parts it hears, else as declared).
    `progress` is called with the share of the run that is done.

    Raises SetupError before the first step; SimulationError or Interrupted with the rows so far.
    """
    network = connect(system)
    sequence = _sequence(network, order)
    steps = _steps(start, stop, step)
    if algorithm not in ALGORITHMS:
        raise SetupError(f"algorithm {algorithm!r} must be one of {', '.join(ALGORITHMS)}")
    if every < 1:
        raise SetupError(f"every = {every!r} must be at least 1")
    ports = [network.port(name) for name in record] if record is not None else _outputs(network)
    if any(port.type == "String" for port in ports):
        raise SetupError("a String cannot be recorded")

    began = clock.perf_counter()
    with ExitStack() as stack:
        interrupted = stack.enter_context(_interrupts())
        try:
            parts = _initialise(network, sequence, stack, start, stop)
        except PartFailure as error:
            raise SetupError(str(error)) from error
        provenance = {
            "algorithm": algorithm,
            "order": sequence,
            "start": start,
            "stop": stop,
            "step": step,
            "steps": steps,
            "wires": list(system.wires),
            "parts": {name: _identity(part, system.parts[name]) for name, part in parts.items()},
            "versions": versions(),
        }
        row = _row(parts, ports)
        advance = ALGORITHMS[algorithm]([parts[name] for name in sequence])
        recorder = Recorder(
            [port.name for port in ports], {port.name: port.unit for port in ports}, csv
        )
        status, reason, t = "complete", "", start
        notice = max(1, steps // 200)
        try:
            recorder.add(row(t))
            for n in range(1, steps + 1):
                last = n == steps
                rest = stop - t
                advance(t, rest if last and abs(rest - step) > 1e-6 * step else step)
                t = stop if last else start + n * step
                if last or n % every == 0:
                    recorder.add(row(t))
                if progress is not None and n % notice == 0:
                    progress(n / steps)
                if interrupted:
                    status, reason = "interrupted", "interrupted by the user"
                    break
        except PartFailure as failure:
            status, reason = "failed", str(failure)
        finally:
            result = recorder.finish(
                provenance
                | {"status": status, "reason": reason, "reached": t}
                | {"wall_time": clock.perf_counter() - began}
            )
    stopped = f"{reason}; stopped at t = {t!r} s, {len(result.data)} rows kept"
    if status == "failed":
        raise SimulationError(stopped, result)
    if status == "interrupted":
        raise Interrupted(stopped, result)
    return result


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """A list that fills when the user presses Ctrl-C, so that no FMU is interrupted half-way."""
    seen: list[int] = []
    elsewhere = threading.current_thread() is not threading.main_thread()
    if elsewhere or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        yield seen
        return
    before = signal.signal(signal.SIGINT, lambda number, _: seen.append(number))
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)


def _steps(start: float, stop: float, step: float) -> int:
    for name, value in (("start", start), ("stop", stop), ("step", step)):
        if not math.isfinite(value):
            raise SetupError(f"{name} = {value!r} s must be a finite number")
    if step <= 0.0:
        raise SetupError(f"step = {step!r} s must be above 0")
    if stop <= start:
        raise SetupError(f"stop = {stop!r} s must be after start = {start!r} s")
    return math.ceil((stop - start) / step - 1e-6)


def _sequence(network: Network, order: Sequence[str] | None) -> list[str]:
    """The parts, each after those it hears where the wires allow it, else as declared."""
    parts = list(network.descriptions)
    if order is not None:
        if sorted(order) != sorted(parts):
            raise SetupError(f"order {list(order)} must name each of {', '.join(parts)} once")
        return list(order)
    hears = {
        name: {w.source.part for w in network.wires if w.target.part == name} for name in parts
    }
    sequence: list[str] = []
    while parts:
        ready = [name for name in parts if not (hears[name] - {name}) & set(parts)]
        sequence.append((ready or parts)[0])
        parts.remove(sequence[-1])
    return sequence


def _outputs(network: Network) -> list[Port]:
    return [
        Port(name, variable)
        for name, description in network.descriptions.items()
        for variable in description.modelVariables
        if variable.causality == "output" and variable.type != "String"
    ]


def _initialise(
    network: Network, sequence: Sequence[str], stack: ExitStack, start: float, stop: float
) -> dict[str, Part]:
    """All parts at `start`, their coupled start values consistent, ready for the first step."""
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
    _settle([parts[name] for name in sequence])
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


def _settle(parts: Sequence[Part]) -> None:
    """Propagate start values in initialisation mode until no input changes."""
    for part in parts:
        part.read()
    for _ in range(2 + sum(len(block.cells) for part in parts for block in part.inputs)):
        changed = []
        for part in parts:
            if part.listen():
                changed.append(part.name)
            part.send()
            part.read()
        if not changed:
            return
    raise SetupError(f"the start values of {', '.join(changed)} do not settle: algebraic loop")


def _row(parts: dict[str, Part], ports: Sequence[Port]) -> Callable[[float], list[float]]:
    """A function that reads the recorded variables and returns a row for the time t."""
    blocks: list[Block] = []
    for name, part in parts.items():
        variables = list({p.variable.name: p.variable for p in ports if p.part == name}.values())
        blocks += part.blocks("Get", variables)
    place = {name: (block.cells, i) for block in blocks for i, name in enumerate(block.names)}
    cells = [place[port.name] for port in ports]

    def row(t: float) -> list[float]:
        for block in blocks:
            block()
            block.require_finite()
        return [t, *(cell[i] for cell, i in cells)]

    return row


def _identity(part: Part, path: Path) -> dict[str, Any]:
    """What a result says of a part: file, guid, model and every parameter's value."""
    description = part.description
    parameters = [v for v in description.modelVariables if v.causality == "parameter"]
    return {
        "fmu": Path(path).name,
        "model": description.modelName,
        "guid": description.guid,
        "parameters": {v.name: part.get(v) for v in parameters},
        "warnings": part.warnings,
    }


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    packages = ("fmpy", "numpy", "scipy")
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        **{name: importlib.metadata.version(name) for name in packages},
    }
