"""Do the runs of a study that are missing in its folder, and tell what all of them found."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from cosim import SetupError

from ..command import parts
from ..options import at_least
from ..runs import local
from ..runs.bundle import collect
from ..runs.case import Asked
from ..runs.identity import computation, digest
from ..runs.journal import Journal, opened
from ..runs.progress import bar
from ..runs.worker import OK, Outcome
from . import subject
from .outcome import Outcome as Found
from .outcome import Session, conclude
from .plan import Study

PRESENTATION = "figures"


def run(
    study: Study,
    *,
    out: Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    flavour: str = "python",
) -> Found:
    """Do the runs that are missing in the folder `out` (results/studies/NAME) and write its files.

    They take FMUs of the flavour, "python" or "native", and go to `jobs` processes of this machine (all
    cores), or to the Dask cluster of a scheduler, "tcp://host:8786". Raises SetupError for what cannot be run, and for a folder with another study;
    KeyboardInterrupt after Ctrl-C, with what is done kept in the journal.
    """
    if jobs is not None:
        if scheduler is not None:
            raise SetupError(
                "jobs are processes of this machine; the scheduler has its own workers"
            )
        at_least("jobs", jobs, 1)
    began = time.perf_counter()
    fmus = study.project.fmus.paths(
        parts(study.module), flavour, Path(str(study.module.__file__)).parent
    )
    units = subject.units(study.module, fmus, study.varied, study.fixed)
    who, cases = identity(study, fmus, flavour), study.cases()
    folder = Path("results") / "studies" / study.name if out is None else out
    with opened(folder, who) as journal:
        (folder / "study.toml").write_bytes(study.path.read_bytes())
        missing = {n: case for n, case in enumerate(cases) if n not in journal.done}
        if missing:
            bundle = collect(_files(study, fmus))
            own = study.where.endswith(".py")
            where = Path(study.where).name if own else study.where
            files = {part: path.name for part, path in fmus.items()}
            ask = partial(Asked, where, files, flavour)
            if scheduler is not None:
                from ..runs import dask

                outcomes = dask.rows(
                    ask, missing, bundle=bundle, timeout=study.timeout, scheduler=scheduler
                )
            else:
                place = bundle.unpack(folder / "inputs")
                count = jobs or local.available_cores()
                outcomes = local.rows(ask(place), missing, jobs=count, timeout=study.timeout)
            _keep(outcomes, journal, len(cases), study.name)
        rows = [json.loads(journal.done[number]) for number in range(len(cases))]
        session = Session(who, len(missing), time.perf_counter() - began)
        return conclude(study, study.runs(), rows, units, session, folder)


def identity(study: Study, fmus: Mapping[str, Path], flavour: str) -> dict[str, Any]:
    """Everything that the rows of a study depend on."""
    own = study.where.endswith(".py")
    return {
        "file": {key: value for key, value in study.content.items() if key != PRESENTATION},
        "scenario": digest(Path(study.where).read_bytes()) if own else study.where,
        "flavour": flavour,
        **computation(fmus),
        "inputs": digest(json.dumps(study.cases()).encode()),
    }


def _files(study: Study, fmus: Mapping[str, Path]) -> list[Path]:
    """The FMUs, and a question of one's own; raises SetupError for two files of one name."""
    own = [Path(study.where)] if study.where.endswith(".py") else []
    paths = [*dict.fromkeys(fmus.values()), *own]
    for path in paths:
        if sum(path.name == other.name for other in paths) > 1:
            raise SetupError(f"PARTS: two files are called {path.name}")
    return paths


def _row(outcome: Outcome) -> dict[str, Any]:
    """What the journal keeps of a run."""
    row = {"status": outcome.status, "message": outcome.message, "figures": {}, "warnings": []}
    row |= outcome.answer or {}
    return row | {"seconds": outcome.seconds, "trace": outcome.trace}


def _keep(outcomes: local.Outcomes, journal: Journal, total: int, title: str) -> None:
    """Bring the rows to the journal as they come."""
    done = journal.done
    failed = sum(json.loads(row)["status"] != OK for row in done.values())
    with journal.kept(), closing(outcomes), bar(title, total, len(done), failed) as tell:
        for number, outcome in outcomes:
            if number not in done:
                journal.add(number, json.dumps(_row(outcome)))
                tell(outcome.status != OK)
