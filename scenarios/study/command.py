"""python -m scenarios study FILE.toml [options]."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from .plan import load
from .run import GOOD, run


def arguments(parser: ArgumentParser) -> None:
    """The options of the command."""
    add = parser.add_argument
    add("file", type=Path, metavar="FILE.toml", help="what varies, see docs/studies.md")
    add("--jobs", type=int, default=None, help="parallel processes, all cores by default")
    add("--scheduler", default=None, help="Dask cluster that does the runs, tcp://HOST:8786")
    add("--out", type=Path, default=None, help="folder, results/studies/NAME by default")


def command(file: Path, jobs: int | None, scheduler: str | None, out: Path | None) -> int:
    """Do a study and say what it found; 1 if no run came to its end."""
    outcome = run(load(file), jobs=jobs, scheduler=scheduler, out=out)
    print(outcome.verdict)
    return 0 if (outcome.table["status"] == GOOD).any() else 1
