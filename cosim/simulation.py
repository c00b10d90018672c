"""A run on its way: its parts, from the start to the stop, and what it says of itself."""

from __future__ import annotations

import importlib.metadata
import math
import platform
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from .engine.changes import Jump, discrete_changes, inputs_before, known_jumps, source_jumps
from .engine.control import Adaptive
from .engine.driver import Driver, RowReader
from .engine.energy import bond_warnings, energy_balance
from .engine.initialise import initialise
from .engine.part import Part
from .engine.process_guard import ProcessGuard
from .engine.recorder import Recorder
from .engine.settings import RunSettings
from .engine.snapshot import WHOLE, Stretch, SystemState, part_state
from .errors import FmuError, SetupError, SimulationTerminated
from .fmu.instance import CoSimulation
from .result import Result
from .system import Network, Value
from .system.graph import stepping_order


class Simulation:
    """The parts of a checked system, initialised, on their way from start to stop.

    Instances that have been `used` and reset are taken, others are made, which the stack closes. Raises SetupError.
    """

    def __init__(
        self,
        network: Network,
        settings: RunSettings,
        stack: ExitStack,
        process: ProcessGuard,
        *,
        used: Mapping[str, CoSimulation] = MappingProxyType({}),
        stretch: Stretch = WHOLE,
    ) -> None:
        self.network, self.settings, self.process = network, settings, process
        self._begin, self._stretch = stretch.begin, stretch
        self.ports = settings.ports(network)
        self.sequence = stepping_order(network, settings.order)
        try:
            self.parts = initialise(
                network, settings, self.sequence, stack, used=used, begin=stretch.begin
            )
            self.setup = self._setup()
            process.restore()
        except FmuError as error:
            raise SetupError(str(error)) from error

    def _setup(self) -> dict[str, Any]:
        """What is run, complete enough to run it again: the first entries of the JSON file beside the rows."""
        system, settings, begin = self.network.system, self.settings, self._begin
        tolerance = settings.tolerance if begin is None else begin.tolerance
        begun = {} if begin is None else {"begin": {"time": begin.time, "start": begin.start}}
        return {
            "algorithm": settings.algorithm,
            "communication": settings.stepping_text(),
            "order": self.sequence,
            "input_order": settings.input_order,
            "substeps": settings.substeps,
            "start": settings.start if begin is None else begin.time,
            "stop": settings.stop,
            **begun,
            "tolerance": tolerance,
            "stop_time_defined": settings.stop_time_defined,
            "wires": [str(wire) for wire in system.wires],
            "inputs": {port.name: profile.provenance() for port, profile in self.network.inputs},
            "changes": list(system.changes),
            "start_values": dict(system.start),
            "open_inputs": {port.name: value for port, value in self.network.open},
            "unrecorded": settings.unrecorded_texts(self.network),
            "parts": {
                name: _identity(part, self.network.fmus[name].path.name, tolerance)
                for name, part in self.parts.items()
            },
            "versions": versions(),
        }

    def run(
        self,
        interrupts: Sequence[int],
        began: float,
        *,
        csv: Path | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Result:
        """Take the steps; the result, complete or not, of a run that `began` at a reading of the clock [s]."""
        settings = self.settings
        since = settings.start if self._begin is None else self._begin.start
        changes = discrete_changes(self.network, self.parts, since, settings.stop)
        row = RowReader(list(self.parts.values()), self.ports)
        recorder = Recorder(row.recorded, csv, self.setup)
        stepped = [self.parts[name] for name in self.sequence]
        driver = Driver(stepped, settings, row, recorder, changes, stretch=self._stretch)
        self.driver = driver
        status, reason = "failed", "stopped by an error outside the FMUs"
        try:
            status, reason = self._drive(driver, recorder, progress, interrupts)
        except FmuError as failure:
            reason = str(failure)
        finally:
            outcome = {
                "status": status,
                "reason": reason,
                "reached": driver.t,
                "rows": recorder.count,
            }
            provenance = {
                **self.setup,
                **driver.statistics(),
                **outcome,
                **self._energy_and_warnings(),
            }
            provenance["wall_time"] = clock.perf_counter() - began
            result = recorder.finish(provenance, driver.breaks)
        return result

    def jumps(self, stop: float) -> list[Jump]:
        """What happens at once between its start and a stop [s]."""
        start, sources = (
            self.settings.start,
            (x for part in self.parts.values() for x in part.feeds),
        )
        changes = discrete_changes(self.network, self.parts, start, stop)
        return known_jumps(changes, source_jumps(sources, start, stop))

    def state(self, system_start: Mapping[str, Value]) -> SystemState:
        """The state where the driver has come to, of a system with these start values but for the case; raises FmuError."""
        settings, driver = self.settings, self.driver
        is_told = any(part.instance.session.is_told_stop for part in self.parts.values())
        stop_told = settings.stop if settings.stop_time_defined or is_told else math.inf
        start, step = settings.start, settings.step
        if self._begin is not None:
            stop_told, start = min(stop_told, self._begin.stop_told), self._begin.start
        return SystemState(
            driver.t, start, stop_told, None if isinstance(step, Adaptive) else step,
            dict(self.network.system.start), dict(system_start), self.setup["tolerance"],
            inputs_before(self.network, driver.t), driver.broken_until,
            {name: part_state(part) for name, part in self.parts.items()}, driver.memory,
        )  # fmt: skip

    def _drive(
        self,
        driver: Driver,
        recorder: Recorder,
        progress: Callable[[float], None] | None,
        interrupts: Sequence[int],
    ) -> tuple[str, str]:
        """Take all steps; status and reason of the end. Raises FmuError."""
        try:
            for fraction in driver.steps():
                self.process.require_unchanged_arithmetic_at_times()
                if progress is not None:
                    progress(fraction)
                if interrupts:
                    return "interrupted", "interrupted by the user"
            self.process.require_unchanged_arithmetic()
            recorder.flush()
        except SimulationTerminated as end:
            with suppress(FmuError):
                driver.add_end_row(end.reached)
            recorder.flush()
            return "complete", f"{end}; the last row is at t = {driver.t!r} s"
        is_before_stop = driver.is_paused and driver.t < self.settings.stop
        return "complete", f"paused at t = {driver.t!r} s" if is_before_stop else ""

    def _energy_and_warnings(self) -> dict[str, Any]:
        """What the coupling made of the energy, and all warnings."""
        parts = self.parts.values()
        bonds = energy_balance(side for part in parts for side in part.bond_sides)
        warnings = list(self.network.flaw_texts())
        warnings += [f"{part.name}: {text}" for part in parts for text in part.messages.warnings]
        warnings += self.process.warnings
        if not self.ports:
            warnings.append("no FMU has an output to record: the rows contain only the time")
        return {"bonds": bonds, "warnings": [*warnings, *bond_warnings(bonds)]}


def _identity(part: Part, fmu: str, tolerance: float | None) -> dict[str, Any]:
    """What a result says of a part, with every parameter's value."""
    description = part.description
    if tolerance is None:
        tolerance = description.defaultExperiment.tolerance
    parameters = [v for v in description.modelVariables if v.causality == "parameter"]
    return {
        "fmu": fmu,
        "model": description.modelName,
        "guid": description.guid,
        "tolerance": tolerance,
        "tool": description.generationTool,
        "parameters": part.instance.session.values(parameters),
    }


@cache
def versions() -> dict[str, str]:
    """The versions that a result depends on."""
    packages = ("fmpy", "numpy", "scipy")
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        **{name: importlib.metadata.version(name) for name in packages},
    }
