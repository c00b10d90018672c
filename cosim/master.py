"""Run a system once: `run` makes it ready and runs it, see `Prepared` for many runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from .engine.control import Adaptive
from .engine.settings import RunSettings
from .prepared import Prepared
from .result import Result
from .system import System


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
    all_rows: Path | None = None,
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
    recorded discrete variable. Where an input jumps or a parameter changes at a communication point, two
    rows have that time: the one before and the one after. `record` lists the columns (default: all outputs). With `csv`, the
    rows are streamed to this file, which no other run may write at the same time. `progress` is
    called with the fraction of the run that is done. `all_rows` is a file that takes the rows of all
    communication points, also those that `output_step` leaves out, as plain doubles.

    Warnings of the FMUs are in the result. They are also logged under "cosim" as they occur, unless
    `quiet` suppresses them. A run that an FMU ends itself is complete: `provenance` gives the time
    `reached` [s] and the `reason`.

    Parameters
    ----------
    system : System
        What is run: parts, wires, start values and inputs over time.
    stop : float
        When the run ends [s].
    start : float
        When it begins [s].
    step : float or Adaptive
        The communication step [s], or adaptive steps.
    algorithm : str
        The coupling algorithm, one of `ALGORITHMS`.
    order : sequence of str, optional
        The order in which the parts step.
    input_order : int
        The degree of the polynomials that inputs follow within a step; 0 holds them.
    substeps : mapping, optional
        Sub-steps of a communication step, by part.
    tolerance : float, optional
        The relative tolerance that FMUs get.
    record : sequence of str, optional
        The columns.
    output_step : float, optional
        The distance of the rows [s].
    stop_time_defined : bool
        Whether the FMUs get the stop time before the start.
    csv : path, optional
        The file that takes the rows as they are computed.
    progress : callable, optional
        Called with the fraction of the run that is done.
    all_rows : Path, optional
        The file that takes the rows of all communication points.

    Raises
    ------
    SetupError
        Before the first step, for a system or settings that cannot be run.
    SimulationError
        With the rows so far, if a part fails on its way.
    Interrupted
        With the rows so far, after Ctrl-C.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cosim import System, run
    >>> result = run(System({"motor": Path("fmus/DriveMotor.fmu")}), stop=0.1, step=0.01)
    >>> result.names
    ['time', 'motor.tau', 'motor.tau_static', 'motor.P']
    >>> len(result["time"])
    11
    """
    settings = RunSettings(
        stop, step, start, algorithm, order, input_order, dict(substeps or {}), tolerance, record,
        output_step, stop_time_defined,
    )  # fmt: skip
    with Prepared.open(system, settings) as prepared:
        return prepared.run(csv=csv, progress=progress, all_rows=all_rows)


def begin(system: System, settings: RunSettings) -> None:
    """Bring a system to its start, as `run` does before the first step, and end it there.

    Parameters
    ----------
    system : System
        What is begun.
    settings : RunSettings
        How it would be run.

    Raises
    ------
    SetupError
        For what `run` refuses before the first step.
    """
<<<<<<< HEAD
    with Prepared.open(system, settings) as prepared:
        prepared.begin()
=======
    network = connect(system)
    require_runnable(network, settings)
    with ExitStack() as stack:
        process = ProcessState()
        stack.callback(process.restore)
        _Simulation(network, settings, stack, process)


class _Simulation:
    """The parts of a checked system, initialised, on their way from start to stop."""

    def __init__(
        self, network: Network, settings: RunSettings, stack: ExitStack, process: ProcessState
    ) -> None:
        self.network, self.settings, self.process = network, settings, process
        self.all_rows: RowFile | None = None
        self.ports = settings.ports(network)
        self.sequence = stepping_order(network, settings.order)
        within = self.ports if settings.every() is None else ()
        try:
            self.parts = initialise(network, settings, self.sequence, stack, within)
            self.setup = self._setup()
            process.restore()
        except FmuError as error:
            raise SetupError(str(error)) from error

    def _setup(self) -> RunSetup:
        """What is run."""
        system, settings = self.network.system, self.settings
        identities = {
            name: _identity(part, system.parts[name], settings.tolerance)
            for name, part in self.parts.items()
        }
        return RunSetup(
            algorithm=settings.algorithm,
            communication=settings.text(),
            order=self.sequence,
            input_order=settings.input_order,
            substeps=settings.substeps,
            start=settings.start,
            stop=settings.stop,
            tolerance=settings.tolerance,
            stop_time_defined=settings.stop_time_defined,
            wires=[str(wire) for wire in system.wires],
            inputs={port.name: profile.provenance() for port, profile in self.network.inputs},
            changes=list(system.changes),
            start_values=dict(system.start),
            open_inputs={port.name: value for port, value in self.network.open},
            unrecorded=settings.unrecorded(self.network),
            parts=identities,
            versions=versions(),
        )

    def finish(
        self,
        csv: Path | None,
        progress: Callable[[float], None] | None,
        interrupts: Sequence[int],
        began: float,
    ) -> tuple[Result, RunReport]:
        """Take all steps; the result and report, complete or not, of a run that `began` at a reading of the clock [s]."""
        recorder = Recorder([port.column for port in self.ports], csv, self.setup)
        settings = self.settings
        changes = discrete_changes(self.network, self.parts, settings.start, settings.stop)
        row = RowReader(list(self.parts.values()), self.ports)
        stepped = [self.parts[name] for name in self.sequence]
        driver = Driver(stepped, settings, row, recorder, changes, all_rows=self.all_rows)
        status, reason = "failed", "stopped by an error outside the FMUs"
        try:
            status, reason = self._drive(driver, recorder, progress, interrupts)
        except FmuError as failure:
            reason = str(failure)
        finally:
            outcome = Outcome(status, reason, driver.t, recorder.count)
            report = self._report(driver, outcome, began)
            result = recorder.finish(report, driver.breaks)
        return result, report

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
                self.process.require()
                if progress is not None:
                    progress(fraction)
                if interrupts:
                    return "interrupted", "interrupted by the user"
            self.process.require_now()
            recorder.flush()
        except SimulationTerminated as end:
            with suppress(FmuError):
                driver.end_at(end.reached)
            recorder.flush()
            return "complete", f"{end}; the last row is at t = {driver.t!r} s"
        return "complete", ""

    def _report(self, driver: Driver, outcome: Outcome, began: float) -> RunReport:
        parts = self.parts.values()
        balance = energy_balance(side for part in parts for side in part.bond_sides)
        warnings = list(self.network.flaw_texts())
        warnings += [f"{part.name}: {text}" for part in parts for text in part.messages.warnings]
        warnings += self.process.warnings
        if not self.ports:
            warnings.append("no FMU has an output to record: the rows contain only the time")
        return RunReport(
            setup=self.setup,
            statistics=driver.statistics(),
            outcome=outcome,
            bonds=balance,
            warnings=[*warnings, *bond_warnings(balance)],
            wall_time=clock.perf_counter() - began,
        )


def _identity(part: Part, path: Path, tolerance: float | None) -> PartIdentity:
    """What a result says of a part, with every parameter's value."""
    description = part.description
    if tolerance is None:
        tolerance = description.defaultExperiment.tolerance
    parameters = [v for v in description.modelVariables if v.causality == "parameter"]
    return PartIdentity(
        fmu=Path(path).name,
        model=description.modelName,
        guid=description.guid,
        tolerance=tolerance,
        tool=description.generationTool,
        parameters=part.instance.access.values(parameters),
    )


@cache
def versions() -> dict[str, str]:
    """The versions that a result depends on; scipy is optional, since it only serves to judge results."""
    packages = [name for name in ("fmpy", "numpy", "scipy") if find_spec(name)]
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        **{name: importlib.metadata.version(name) for name in packages},
    }
>>>>>>> 09797fe (A run says which outputs it leaves out because they are texts)
