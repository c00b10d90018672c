"""A run on its way, and what it says of itself."""

from __future__ import annotations

import importlib.metadata
import math
import platform
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from .engine.changes import inputs_before
from .engine.control import Adaptive
from .engine.energy import balance, bond_warnings, energies
from .engine.march import March
from .engine.recorder import Recorder
from .engine.snapshot import SystemState, part_state
from .engine.system_instance import SystemInstance
from .errors import FmuError, SimulationTerminated
from .result import Result
from .system import Value


class Simulation:
    """A run on its way, of an instance that has begun; `began` is a reading of the clock [s], `stretch` as of `March`."""

    def __init__(
        self,
        instance: SystemInstance,
        began: float,
        *,
        csv: Path | None = None,
        setup: dict[str, Any] | None = None,
        **stretch: Any,
    ) -> None:
        """With `setup`, what it is to say of what is run is known."""
        self.instance, self._began = instance, began
        self.setup = run_setup(instance) if setup is None else setup
        self.recorder = Recorder(instance.row.recorded, csv, self.setup)
        self.march = March(instance, instance.setup.settings, self.recorder, **stretch)
        self.status, self.reason = "failed", "stopped by an error outside the FMUs"

    def run(
        self, interrupts: Sequence[int], progress: Callable[[float], None] | None = None
    ) -> Result:
        """Take the steps; the result, complete or not."""
        try:
            self.drive(interrupts, progress)
        finally:
            result = self.recorder.finish(self.provenance(), self.march.breaks)
        return result

    def drive(
        self, interrupts: Sequence[int], progress: Callable[[float], None] | None = None
    ) -> None:
        """Take the steps, up to the end, a failure or an interrupt."""
        try:
            self.status, self.reason = self._drive(progress, interrupts)
        except FmuError as failure:
            self.reason = str(failure)
            self.instance.process.restore()

    def provenance(self) -> dict[str, Any]:
        """All that the run says of itself."""
        energy = {bond: balance(*energies(sides)) for bond, sides in self.instance.bonds.items()}
        return {
            **self.setup,
            **self.march.statistics(),
            "status": self.status,
            "reason": self.reason,
            "reached": self.march.t,
            "rows": self.recorder.count,
            "bonds": energy,
            "warnings": [*self.warnings(), *bond_warnings(energy)],
            "wall_time": clock.perf_counter() - self._began,
        }

    def warnings(self) -> list[str]:
        """All warnings, but those of bonds."""
        instance = self.instance
        parts = instance.parts.values()
        setup = instance.setup
        warnings = list(setup.settings.foreseen_warnings(setup.network))
        warnings += [f"{part.name}: {text}" for part in parts for text in part.messages.warnings]
        return warnings + instance.process.warnings

    def state(self, system_start: Mapping[str, Value]) -> SystemState:
        """The state where the march has come to, of a system with these start values but for the case; raises FmuError."""
        instance, march = self.instance, self.march
        settings, begin = instance.setup.settings, instance.state
        is_told = any(part.instance.session.is_told_stop for part in instance.parts.values())
        stop_told = settings.stop if settings.stop_time_defined or is_told else math.inf
        start, step = settings.start, settings.step
        if begin is not None:
            stop_told, start = min(stop_told, begin.stop_told), begin.start
        return SystemState(
            march.t, start, stop_told, None if isinstance(step, Adaptive) else step,
            dict(instance.setup.network.system.start), dict(system_start), self.setup["tolerance"],
            inputs_before(instance.setup.network, march.t), march.broken_until,
            {name: part_state(part) for name, part in instance.parts.items()}, march.controller.memory,
        )  # fmt: skip

    def _drive(
        self, progress: Callable[[float], None] | None, interrupts: Sequence[int]
    ) -> tuple[str, str]:
        """Take all steps; status and reason of the end. Raises FmuError."""
        march, process = self.march, self.instance.process
        try:
            for fraction in march.steps():
                process.require_unchanged_arithmetic_at_times()
                if progress is not None:
                    progress(fraction)
                if interrupts:
                    return "interrupted", "interrupted by the user"
            if self.instance.begins_again:
                process.require_unchanged_arithmetic_at_times()
            else:
                process.require_unchanged_arithmetic()
            self.recorder.flush()
        except SimulationTerminated as end:
            with suppress(FmuError):
                march.add_end_row(end.reached)
            self.recorder.flush()
            return "complete", f"{end}; the last row is at t = {march.t!r} s"
        is_before_stop = march.is_paused and march.t < self.instance.setup.settings.stop
        return "complete", f"paused at t = {march.t!r} s" if is_before_stop else ""


def run_setup(instance: SystemInstance) -> dict[str, Any]:
    """What is run, complete enough to run it again: the first entries of the JSON file beside the rows."""
    network, settings, begin = instance.setup.network, instance.setup.settings, instance.state
    system = network.system
    tolerance = settings.told_tolerance if begin is None else begin.tolerance
    begun = {} if begin is None else {"begin": {"time": begin.time, "start": begin.start}}
    return {
        "algorithm": settings.algorithm,
        "communication": settings.stepping_text(),
        "order": instance.setup.sequence,
        "input_order": settings.input_order,
        "substeps": settings.substeps,
        "start": settings.start if begin is None else begin.time,
        "stop": settings.stop,
        **begun,
        "tolerance": tolerance,
        "stop_time_defined": settings.stop_time_defined,
        "wires": [str(wire) for wire in system.wires],
        "inputs": {port.name: profile.provenance() for port, profile in network.inputs},
        "changes": list(system.changes),
        "start_values": dict(system.start),
        "open_inputs": {port.name: value for port, value in network.open},
        "unrecorded": settings.unrecorded_texts(network),
        "parts": {
            name: {
                "fmu": network.fmus[name].path.name,
                "model": d.modelName,
                "guid": d.guid,
                "tolerance": d.defaultExperiment.tolerance if tolerance is None else tolerance,
                "tool": d.generationTool,
                "parameters": instance.parameters[name](),
            }
            for name, d in network.descriptions.items()
        },
        "versions": versions(),
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
