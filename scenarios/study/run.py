"""Do the runs of a study that are missing in its folder, and tell what all of them found."""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from cosim import SetupError

from .. import fmus, options, pool
from ..runs import cluster, processes
from ..runs.bundle import collect
from . import subject
from .identity import identity
from .journal import NAME, Journal, opened
from .outcome import Outcome, Session, conclude
from .plan import Study, Value
from .progress import bar

GOOD = "ok"


def run(
    study: Study,
    *,
    out: Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Outcome:
    """Do the runs that are missing in the folder `out` (results/studies/NAME) and write its files.

    Runs go to `jobs` processes of this machine (all cores), or to the Dask cluster of a scheduler,
    "tcp://host:8786". Raises SetupError for what cannot be run, and for a folder with another study;
    KeyboardInterrupt after Ctrl-C, with what is done kept in the journal.
    """
    if jobs is not None:
        if scheduler is not None:
            raise SetupError(
                "jobs are processes of this machine; the scheduler has its own workers"
            )
        options.at_least("jobs", jobs, 1)
    began = time.perf_counter()
    fmus.build(*subject.parts(study.module).values())
    units = subject.units(study.module, study.varied, study.fixed)
    who, inputs = identity(study), study.runs()
    folder = Path("results") / "studies" / study.name if out is None else out
    with opened(folder, who) as book:
        (folder / "study.toml").write_bytes(study.path.read_bytes())
        cases = {n: _case(study, x) for n, x in enumerate(inputs) if n not in book.done}
        if cases:
            bundle = collect(_files(study))
            if scheduler is not None:
                rows = cluster.rows(cases, bundle, study.timeout, scheduler)
            else:
                count = min(jobs or pool.available_cores(), len(cases))
                rows = processes.rows(cases, bundle, study.timeout, count, folder / "inputs")
            _keep(rows, book, len(inputs), study.name, folder)
        done = [book.done[number] for number in range(len(inputs))]
        session = Session(who, len(cases), time.perf_counter() - began)
        return conclude(study, inputs, done, units, session, folder)


def _case(study: Study, values: Sequence[Value]) -> dict[str, Any]:
    """What a child process is told of a run."""
    given = {**study.fixed, **dict(zip(study.varied, values))}
    return {
        "scenario": study.scenario,
        "options": {name: value for name, value in given.items() if "." not in name},
        "start": [f"{name}={_text(x)}" for name, x in given.items() if "." in name],
        "flavour": fmus.flavour(),
    }


def _files(study: Study) -> list[Path]:
    """The FMUs, and a scenario of one's own."""
    components = dict.fromkeys(subject.parts(study.module).values())
    own = study.path.parent / study.scenario
    return [fmus.fmu(name) for name in components] + [own] * (own.suffix == ".py")


def _text(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _keep(
    rows: Generator[tuple[int, dict[str, Any]]], book: Journal, total: int, title: str, folder: Path
) -> None:
    """Bring the rows to the journal as they come."""
    failed = sum(row["status"] != GOOD for row in book.done.values())
    try:
        with closing(rows), bar(title, total, len(book.done), failed) as tell:
            for number, row in rows:
                if number not in book.done:
                    book.add(number, row)
                    tell(row["status"] != GOOD)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"{len(book.done)} of {total} runs in {folder / NAME}; the same command goes on"
        ) from None
