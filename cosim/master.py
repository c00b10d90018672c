"""Run a system once: `run` makes it ready and runs it, see `Prepared` for many runs."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Signature, signature
from pathlib import Path
from typing import Any

from .engine.settings import RunSettings
from .prepared import Prepared
from .result import Result
from .system import System


def run(
    system: System,
    *,
    csv: Path | str | None = None,
    progress: Callable[[float], None] | None = None,
    all_rows: Path | None = None,
    **settings: Any,
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
    csv : path, optional
        The file to which rows are streamed, which no other run may write at the same time.
    progress : callable, optional
        Called with the fraction of the run that is done.
    all_rows : Path, optional
        The file that takes the rows of all communication points, also those that `output_step` leaves out, as plain
        doubles.
    **settings
        The fields of `RunSettings`, of which `stop` and `step` are required.

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
    with Prepared.open(system, RunSettings(**settings)) as prepared:
        return prepared.run(csv=csv, progress=progress, all_rows=all_rows)


def _with_fields_of_settings(function: Callable[..., Result]) -> Signature:
    """The signature of a function with `**settings`, for `help`: the fields of RunSettings in their place."""
    *own, _ = signature(function).parameters.values()
    fields = signature(RunSettings).parameters.values()
    return Signature([*own, *(x.replace(kind=x.KEYWORD_ONLY) for x in fields)])


vars(run)["__signature__"] = _with_fields_of_settings(run)
