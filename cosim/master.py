"""Run a system with a fixed communication step."""

from __future__ import annotations

import importlib.metadata
import math
import platform
import signal
import threading
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from .algorithms import ALGORITHMS
from .errors import Interrupted, PartFailure, SetupError, SimulationError
from .initial import initialise
from .part import Block, Part
from .result import Recorder, Result
from .structure import algebraic_loops, describe
from .system import Network, Port, System, connect


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
    _check_algorithm(network, algorithm)
    if every < 1:
        raise SetupError(f"every = {every!r} must be at least 1")
    ports = [network.port(name) for name in record] if record is not None else _outputs(network)
    if any(port.type == "String" for port in ports):
        raise SetupError("a String cannot be recorded")

    began = clock.perf_counter()
    with ExitStack() as stack:
        interrupted = stack.enter_context(_interrupts())
        try:
            parts = initialise(network, sequence, stack, start, stop)
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
        status, reason, t = "failed", "stopped by an error outside the FMUs", start
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
            else:
                status, reason = "complete", ""
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


def _check_algorithm(network: Network, algorithm: str) -> None:
    """Refuse what an algorithm cannot do with these FMUs."""
    if algorithm == "iterated":
        for name, description in network.descriptions.items():
            if not description.coSimulation.canGetAndSetFMUstate:
                raise SetupError(f"iterated needs the FMU state, which {name} cannot save")
        return
    for loop in algebraic_loops(network):
        raise SetupError(
            f"algebraic loop: {describe(loop)} act on each other at once; "
            f"{algorithm} cannot solve that, iterated can"
        )


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
