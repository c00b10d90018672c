"""Does an FMU keep its promises? The checks run in a separate process, which may crash or hang."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

from ...child import child
from ...errors import SetupError
from ...fmu.messages import quiet
from .checks import CHECKS, FAILED, NOT_RUN, STANDARD, CheckResult, checked
from .report import Crosscheck
from .subject import Subject


def crosscheck(fmu: Path | str, *, step: float | None = None, timeout: float = 60.0) -> Crosscheck:
    """Check what a co-simulation FMU of FMI 2.0 or 3.0 promises.

    The checks run in a child process, so that a script needs `if __name__ == "__main__"`.

    Parameters
    ----------
    fmu : path
        The FMU.
    step : float, optional
        The communication step [s], by default the one that the FMU prefers, or a hundredth of its default
        experiment.
    timeout : float
        A check fails if it takes longer [s], or if it ends the process.

    Returns
    -------
    Crosscheck
        A verdict for each of `CHECKS`.

    Raises
    ------
    SetupError
        For a file that is not such an FMU, or not for this platform.
    """
    path = Path(fmu).absolute()
    for name, number in (("step", step), ("timeout", timeout)):
        if number is not None and not 0.0 < number < float("inf"):
            raise SetupError(f"{name} = {number!r} s must be a finite number above 0")
    subject = Subject(path, step)
    version = subject.description.fmiVersion
    verdicts: list[CheckResult] = []
    while names := list(CHECKS)[len(verdicts) :]:
        finished = _checked_in_child(path, version, step, names, timeout)
        verdicts += finished
        if finished[-1].check == "run":  # after which the process ended
            rest = (CHECKS[name] for name in names[len(finished) :])
            verdicts += [
                c.verdict(version, NOT_RUN, f"the check run failed: {finished[-1].detail}")
                for c in rest
            ]
    name, standard = subject.description.modelName, STANDARD[version]
    return Crosscheck(str(fmu), name, standard, subject.how(), tuple(verdicts))


def _checked_in_child(
    path: Path, version: str, step: float | None, names: Sequence[str], timeout: float
) -> list[CheckResult]:
    """Verdicts of these checks, up to the first that does not come to its end."""
    verdicts: list[CheckResult] = []
    with child(_run_in_child, path, step, names) as one:
        for name in names:
            detail = f"no answer within {timeout:g} s: it hangs, or needs a longer timeout"
            answer = next(one.messages(timeout), None)
            if isinstance(answer, CheckResult):
                verdicts.append(answer)
                continue
            if answer is not None:
                detail = f"the process {answer.how}"
            verdicts.append(CHECKS[name].verdict(version, FAILED, detail))
            _end_group(one.process.pid)
            break
    return verdicts


def _end_group(leader: int | None) -> None:
    """End a process that has not answered, and the copies of it that run instances."""
    if leader is not None and hasattr(os, "killpg"):
        with suppress(OSError):
            os.killpg(leader, signal.SIGKILL)


def _run_in_child(pipe: Connection, path: Path, step: float | None, names: Sequence[str]) -> None:
    """Run in the child process and send each verdict."""
    os.dup2(2, 1)  # what an FMU prints is no part of the answer
    subject = Subject(path, step)
    with quiet():
        for name in names:
            pipe.send(checked(subject, name))
