"""One module, one question: `scenarios list`, or from Python `ask` and `study`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from workbench import Answer

__all__ = ["ask", "study"]


def ask(
    question: str,
    *,
    flavour: str = "",
    jobs: int | None = None,
    scheduler: str | None = None,
    out: Path | str | None = None,
    **options: Any,
) -> Answer:
    """The answer to a question, by its name or a file NAME.py: `ask("resonance", set="B", speed="300rpm")`.

    Options are those of the command line, with `_` for `-`, as texts or as values in SI units. `start` is a
    dictionary of start values of FMUs. The flavour is by default native where the FMUs are built, else
    Python, and `jobs` are all cores where that is faster. Files are written to the folder `out` if it is given. Raises
    cosim.SetupError for what is refused, cosim.SimulationError for a run that fails, and
    workbench.question.QuestionError where a file of one's own raises.

    Parameters
    ----------
    question : str
        The name of a question, or a file NAME.py.
    flavour : str
        The kind of FMUs; "" for the default.
    jobs : int, optional
        How many processes do the runs.
    scheduler : str, optional
        The address of a Dask scheduler whose workers do the runs instead.
    out : path, optional
        The folder for files.
    **options
        The options of the question.
    """
    from scenarios.project import PROGRAM, PROJECT
    from workbench.export import write
    from workbench.run import ask
    from workbench.runs.folder import reservation

    folder = None if out is None else Path(out)
    with reservation(folder):
        answer = ask(
            PROJECT, question, options, flavour=flavour, jobs=jobs, scheduler=scheduler, out=folder,
            program=PROGRAM,
        )  # fmt: skip
        if folder is not None:
            write(answer, folder)
    return answer


def study(
    file: Path | str,
    *,
    flavour: str = "",
    jobs: int | None = None,
    scheduler: str | None = None,
    out: Path | str | None = None,
) -> Answer:
    """What a study found, `study("studies/rotor_speed.toml")`; runs that are already done are not repeated.

    `jobs` are all cores by default. Files go to the folder `out`, by default results/studies/NAME. Raises
    cosim.SetupError for a mistake in the file, before any run.

    Parameters
    ----------
    file : path
        The study, a TOML file.
    flavour : str
        The kind of FMUs; "" for the default.
    jobs : int, optional
        How many processes do the runs.
    scheduler : str, optional
        The address of a Dask scheduler whose workers do the runs instead.
    out : path, optional
        The folder for files.
    """
    from scenarios.project import PROJECT
    from workbench import study

    folder = None if out is None else Path(out)
    plan = study.load(Path(file), PROJECT)
    return study.run(plan, flavour=flavour, jobs=jobs, scheduler=scheduler, out=folder)
