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
    """Run a system from `start` to `stop`.

    There is a row at every communication point, or at every `output_step` and at changes of a recorded discrete
    variable; where an input jumps or a parameter changes, one before and one after. Warnings of the FMUs are in the
    result. They are also logged under "cosim" as they occur, unless `quiet` suppresses them. A run that an FMU ends
    itself is complete: `provenance` gives the time `reached` [s] and the `reason`.

    Parameters
    ----------
    system : System
        What is run: parts, wires, start values and inputs over time.
    stop, start : float
        When the run ends and begins [s].
    step : float or Adaptive
        The communication step [s], or adaptive steps.
    algorithm : str
        The coupling algorithm, one of `ALGORITHMS`.
    order : sequence of str, optional
        The order in which Gauss-Seidel and Strang step the parts. By default each part steps after those that drive
        it, or as declared where that is impossible.
    input_order : int
        The degree of the polynomials that Real inputs follow within a step; 0 holds them.
    substeps : mapping, optional
        Sub-steps of a communication step, by part.
    tolerance : float, optional
        The relative tolerance that FMUs get. By default it is the one that the default experiment of each FMU
        states, or that of the adaptive steps.
    record : sequence of str, optional
        The columns, by default all outputs.
    output_step : float, optional
        The distance of the rows [s].
    stop_time_defined : bool
        Whether the FMUs are told the stop time before the start. Some then compute all of the run in their first
        step, so that by default only an FMU that does not initialise without it is told it.
    csv : path, optional
        The file to which rows are streamed, which no other run may write at the same time.
    progress : callable, optional
        Called with the fraction of the run that is done.
    all_rows : Path, optional
        The file that takes the rows of all communication points, also those that `output_step` leaves out, as plain
        doubles.

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
