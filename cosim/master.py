"""Run a system: checks before the first step, provenance after the last."""

from __future__ import annotations

import importlib.metadata
import platform
import time as clock
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import cache
from heapq import heappop, heappush
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from .engine.algorithms import REGISTRY, find_algorithm
from .engine.changes import continuous_profiles, discrete_changes
from .engine.control import Adaptive
from .engine.driver import Driver, RowReader, RunSettings
from .engine.energy import bond_warnings, energy_balance, find_bonds
from .engine.initialise import initialise, monitored_outputs
from .engine.instance import Instance
from .engine.process_state import ProcessState
from .engine.recorder import Recorder
from .engine.times import coincide
from .errors import FmuError, SetupError, SimulationTerminated, pluralize
from .result import Interrupted, Result, SimulationError
from .signals import collect_interrupts
from .system import (
    STATE,
    VARIABLE_STEP,
    Network,
    System,
    connect,
    default_experiment,
    parts_without,
    require_cosimulation,
)
from .system.graph import algebraic_loops, describe_loop

MOST_SUBSTEPS = 1 << 20
HIGHEST = 8


def run(
    system: System,
    *,
    stop: float,
    step: float | Adaptive,
    start: float = 0.0,
    algorithm: str = "strang",
    order: Sequence[str] | None = None,
    input_order: int = 0,
    substeps: Mapping[str, int] | None = None,
    tolerance: float | None = None,
    record: Sequence[str] | None = None,
    output_step: float | None = None,
    stop_time_defined: bool = False,
    csv: Path | str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Result:
    """Simulate from `start` to `stop` [s] with communication steps of `step` [s], or adaptive steps.

    `order` is the order in which Gauss-Seidel and Strang step the parts. By default each part steps
    after those that drive it, or as declared where that is impossible. With `input_order` above 0,
    Real inputs follow polynomials of that order within a step. `substeps` gives the number of
    sub-steps that a part takes within a communication step. `tolerance` is passed to the FMUs; by
    default it is the one that the default experiment of each FMU states, or that of the adaptive steps.
    With `stop_time_defined`, the FMUs are told the stop time before the start; some then compute all of
    the run in their first step, so that by default only an FMU that does not initialise without it is
    told it.

    There is a row at every communication point, or at every `output_step` [s] and at changes of a
    recorded discrete variable. `record` lists the columns (default: all outputs). With `csv`, the
    rows are streamed to this file, which no other run may write at the same time. `progress` is
    called with the fraction of the run that is done.

    Warnings of the FMUs are in the result. They are also logged under "cosim" as they occur, unless
    `quiet` suppresses them. A run that an FMU ends itself is complete: `provenance` gives the time
    `reached` [s] and the `reason`. Raises SetupError before the first step, and later SimulationError or
    Interrupted with the rows so far.
    """
    network = connect(system)
    rates = dict(substeps or {})
    if tolerance is None and isinstance(step, Adaptive):
        tolerance = step.tolerance
    settings = RunSettings(
        stop, step, start, algorithm, order, input_order, rates, tolerance, record, output_step,
        stop_time_defined,
    )  # fmt: skip
    for problem in setup_problems(network, settings):
        raise SetupError(problem)
    ports, sequence = settings.ports(network), stepping_order(network, order)
    began = clock.perf_counter()
    with ExitStack() as stack:
        interrupted, around = stack.enter_context(collect_interrupts()), ProcessState()
        stack.callback(around.restore)
        try:
            within = ports if settings.every() is None else ()
            parts = initialise(network, settings, sequence, stack, within)
            identities = {
                name: _identity(p, system.parts[name], tolerance) for name, p in parts.items()
            }
            around.restore()
        except FmuError as error:
            raise SetupError(str(error)) from error
        provenance: dict[str, Any] = {
            "algorithm": algorithm, "communication": settings.text(), "order": sequence,
            "input_order": input_order, "substeps": rates, "start": start, "stop": stop,
            "tolerance": tolerance, "stop_time_defined": stop_time_defined, "wires": [str(wire) for wire in system.wires],
            "inputs": {port.name: profile.told() for port, profile in network.inputs},
            "changes": list(system.changes), "start_values": dict(system.start),
            "open_inputs": {port.name: value for port, value in network.open}, "parts": identities,
            "versions": versions(),
        }  # fmt: skip
        row = RowReader([parts[name] for name in parts], ports)
        units = {port.name: port.unit for port in ports}
        path = None if csv is None else Path(csv).absolute()
        recorder = Recorder([port.name for port in ports], units, path, provenance)
        made = discrete_changes(network, parts, start, stop)
        stepped = [parts[name] for name in sequence]
        run = Driver(stepped, settings, row, recorder, made)
        status, reason = "failed", "stopped by an error outside the FMUs"
        try:
            for share in run.steps():
                around.require()
                if progress is not None:
                    progress(share)
                if interrupted:
                    status, reason = "interrupted", "interrupted by the user"
                    break
            else:
                around.require_now()
                recorder.flush()
                status, reason = "complete", ""
        except SimulationTerminated as asked:
            status, reason = "complete", _end(run, recorder, asked)
        except FmuError as failure:
            reason = str(failure)
        finally:
            energy = energy_balance(end for part in parts.values() for end in part.bond_sides)
            heard = [f"{name}: {text}" for name, text in network.blemishes.items()]
            heard += [f"{part.name}: {text}" for part in parts.values() for text in part.warnings]
            heard += around.warnings
            if not ports:
                heard.append("no FMU has an output to record: the rows contain only the time")
            end = {"status": status, "reason": reason, "reached": run.t, "rows": recorder.count}
            end |= {"bonds": energy, "warnings": [*heard, *bond_warnings(energy)]}
            end |= {"wall_time": clock.perf_counter() - began}
            result = recorder.finish(provenance | run.statistics() | end)
    stopped = f"{reason}; stopped at t = {run.t!r} s, {pluralize(recorder.count, 'row')} kept"
    if status == "failed":
        raise SimulationError(stopped, result)
    if status == "interrupted":
        raise Interrupted(stopped, result)
    return result


def _end(run: Driver, recorder: Recorder, end: SimulationTerminated) -> str:
    """Close the rows of a run that a part has ended; what to say of it."""
    with suppress(FmuError):
        run.end_at(end.reached)
    recorder.flush()
    return f"{end}; the last row is at t = {run.t!r} s"


def setup_problems(network: Network, settings: RunSettings) -> Iterator[str]:
    """The reasons why this system cannot be run with these settings."""
    start, stop, step = settings.start, settings.stop, settings.step
    order, input_order, tolerance = settings.order, settings.input_order, settings.tolerance
    try:
        require_cosimulation(network.descriptions, network.system.parts)
        settings.ports(network)
        settings.check()
        algorithm = find_algorithm(settings.algorithm)
    except SetupError as error:
        yield str(error)
        return
    parts = ", ".join(network.descriptions)
    if order is not None and sorted(order) != sorted(network.descriptions):
        yield f"order {list(order)} must name each of {parts} once"
    if tolerance is not None and not tolerance > 0.0:
        yield f"tolerance = {tolerance!r} must be above 0"
    if not 0 <= input_order <= HIGHEST:
        yield f"input_order = {input_order!r} must be at least 0 and at most {HIGHEST}"
    for name, count in settings.substeps.items():
        if name not in network.descriptions:
            yield f"substeps: there is no part {name!r}, only {parts}"
        if not 1 <= count < MOST_SUBSTEPS:
            yield f"substeps of {name} = {count!r} must be at least 1 and below {MOST_SUBSTEPS}"
    by_guid: dict[str, str] = {}
    for name, description in network.descriptions.items():
        twin = by_guid.setdefault(description.guid, name)
        if twin != name and description.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            yield f"{name}: its FMU allows only one instance per process, and {twin} is another"
    lost = parts_without(network.descriptions, STATE)
    steady = parts_without(network.descriptions, VARIABLE_STEP)
    if algorithm.is_implicit:
        for name in lost:
            yield f"{algorithm.name} needs the FMU state, which {name} cannot save"
    else:
        implicit = [each.name for each in REGISTRY.values() if each.is_implicit]
        for loop in algebraic_loops(network):
            yield (
                f"algebraic loop: {describe_loop(loop)} act on each other by direct feedthrough; "
                f"{algorithm.name} cannot solve that, but {' and '.join(implicit)} can"
            )
    if isinstance(step, Adaptive):
        for name in steady:
            yield f"adaptive steps: {name} cannot vary its step"
        if step.control == "doubling":
            for name in lost:
                yield f"step doubling needs the FMU state, which {name} cannot save"
        elif (step.control == "energy" or lost) and not find_bonds(network):
            yield "step control by energy needs a power bond, and the system has none"
        watched = [
            p.name
            for ports in monitored_outputs(network).values()
            for p in ports
            if p.type == "Real"
        ]
        for name in step.absolute:
            if name not in watched:
                yield f"absolute tolerance of {name}: only {', '.join(watched)} can have one"
    elif steady:
        moving, times = [port for port, _ in continuous_profiles(network)], {"stop": [stop]}
        for port, profile in network.inputs:
            if port not in moving:
                times[port.name] = profile.jumps(start, stop)
        for name, found in times.items():
            for time in found:
                steps = max(1, round((time - start) / step))
                if not coincide(start + steps * step, time):
                    yield (
                        f"{name} = {time!r} s must be a whole number of steps of {step!r} s "
                        f"after start, since {steady[0]} cannot vary its step"
                    )
    for port, profile in network.inputs:
        if lack := profile.lacks(start, stop):
            yield f"{port.name}: its table {lack}"


def stepping_order(network: Network, order: Sequence[str] | None) -> list[str]:
    """The parts, each after those that drive it where the wires allow it, else as declared."""
    if order is not None:
        return list(order)
    parts = list(network.descriptions)
    place = {name: k for k, name in enumerate(parts)}
    arrows = {(place[source.part], place[target.part]) for source, target, *_ in network.wires}
    waits = Counter(hearer for speaker, hearer in arrows if speaker != hearer)
    hearers = defaultdict(list)
    for speaker, hearer in arrows:
        hearers[speaker].append(hearer)
    ready, declared = [k for k in range(len(parts)) if not waits[k]], iter(range(len(parts)))
    sequence: dict[int, str] = {}
    while len(sequence) < len(parts):
        k = heappop(ready) if ready else next(declared)
        if k not in sequence:
            sequence[k] = parts[k]
            for hearer in hearers[k]:
                waits[hearer] -= 1
                if not waits[hearer]:
                    heappush(ready, hearer)
    return list(sequence.values())


def _identity(part: Instance, path: Path, tolerance: float | None) -> dict[str, Any]:
    """What a result says of a part: file, guid, model, tolerance and every parameter's value."""
    description = part.description
    if tolerance is None:
        tolerance = default_experiment(description).tolerance
    parameters = [v for v in description.modelVariables if v.causality == "parameter"]
    told = {"fmu": Path(path).name, "model": description.modelName, "guid": description.guid}
    told |= {"tolerance": tolerance}
    return told | {"tool": description.generationTool, "parameters": part.values(parameters)}


@cache
def versions() -> dict[str, str]:
    """The versions that a result depends on; scipy is optional, since it only serves to judge results."""
    packages = [name for name in ("fmpy", "numpy", "scipy") if find_spec(name)]
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        **{name: importlib.metadata.version(name) for name in packages},
    }
