"""The command that does a study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cosim.commandline import Parser

from ..question import ALONE, Project
from ..runs.worker import OK
from .plan import load
from .run import run


def main(words: Sequence[str], project: Project, program: str) -> int:
    """Do the study that a command line names."""
    parser = Parser(
        prog=f"{program} study",
        description="Vary inputs of a question as a file says.",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("file", type=Path, metavar="FILE.toml", help="what varies, see docs/studies.md")
    add("--flavour", choices=("python", "native"), default="python", help="(default: python)")
    add("--jobs", type=int, help="parallel processes (default: all cores)")
    add("--scheduler", help="Dask cluster that does the runs, tcp://HOST:8786")
    add("--out", type=Path, help="folder (default: results/studies/NAME)")
    told = vars(parser.parse_args(words))
    return command(**told, project=project)


def command(
    file: Path,
    jobs: int | None,
    scheduler: str | None,
    out: Path | None,
    flavour: str = "python",
    project: Project = ALONE,
) -> int:
    """Do a study and say what it found; 1 if no run came to its end."""
    study = load(file, project)
    outcome = run(study, out=out, jobs=jobs, scheduler=scheduler, flavour=flavour)
    print(outcome.verdict)
    return 0 if (outcome.table["status"] == OK).any() else 1
