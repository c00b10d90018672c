"""Do the runs of a study that are missing in its folder, and tell what all of them found."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from cosim import SetupError, System
from cosim.system import Network, describe_fmu

from ..options import at_least, declared
from ..runs import local
from ..runs.case import cases
from ..runs.identity import computation, digest
from ..runs.journal import Journal, opened
from ..runs.progress import bar
from ..runs.worker import OK, Outcome
from .outcome import Outcome as Found
from .outcome import conclude
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

    They take FMUs of the flavour, "python" or "native", and go to `jobs` processes of this machine
    (all cores), or to the Dask cluster of a scheduler, "tcp://host:8786". Raises SetupError for what
    cannot be run, and for a folder with another study; KeyboardInterrupt after Ctrl-C, with what is
    done kept in the journal.
    """
    if jobs is not None:
        if scheduler is not None:
            raise SetupError(
                "jobs are processes of this machine; the scheduler has its own workers"
            )
        at_least("jobs", jobs, 1)
    began = time.perf_counter()
    fmus = study.project.paths(study.module, flavour)
    units, who = _units(study, fmus), identity(study, fmus, flavour)
    folder = Path("results") / "studies" / study.name if out is None else out
    with opened(folder, who) as journal:
        (folder / "study.toml").write_bytes(study.path.read_bytes())
        given = study.cases()
        missing = {n: case for n, case in enumerate(given) if n not in journal.done}
        if missing:
            page, timeout = cases(study.where, fmus), study.timeout
            if scheduler is None:
                function, count = page.unpacked(folder / "inputs"), jobs or local.available_cores()
                outcomes = local.rows(function, missing, jobs=count, timeout=timeout)
            else:
                from ..runs import dask

                packages = study.project.packages
                outcomes = dask.rows(
                    page, missing, packages=packages, timeout=timeout, scheduler=scheduler
                )
            _keep(outcomes, journal, len(given), study.name)
        rows = [json.loads(journal.done[number]) for number in range(len(given))]
        session = len(missing), time.perf_counter() - began
        return conclude(study, rows, units, who, session, folder)


def identity(study: Study, fmus: Mapping[str, Path], flavour: str) -> dict[str, Any]:
    """Everything that the rows of a study depend on."""
    own = study.where.endswith(".py")
    return {
        "file": {key: value for key, value in study.content.items() if key != PRESENTATION},
        "scenario": digest(Path(study.where).read_bytes()) if own else study.where,
        "flavour": flavour,
        **computation(fmus, *study.project.packages),
        "inputs": digest(json.dumps(study.cases()).encode()),
    }


def _units(study: Study, fmus: Mapping[str, Path]) -> dict[str, str]:
    """The units of the varied inputs; raises SetupError for a start value that no FMU has."""
    descriptions = {part: describe_fmu(part, path) for part, path in fmus.items()}
    network = Network(System(dict(fmus)), descriptions, [], [])
    options = declared(study.module.Options)
    starts = {n: network.port(n).unit for n in (*study.varied, *study.fixed) if "." in n}
    return {name: starts[name] if "." in name else options[name].unit for name in study.varied}


def _keep(outcomes: local.Outcomes, journal: Journal, total: int, title: str) -> None:
    """Bring the rows to the journal as they come."""
    done = journal.done
    failed = sum(json.loads(row)["status"] != OK for row in done.values())
    with journal.kept(), closing(outcomes), bar(title, total, len(done), failed) as step:
        for number, outcome in outcomes:
            journal.add(number, json.dumps(_row(outcome)))
            step(outcome.status != OK)


def _row(outcome: Outcome) -> dict[str, Any]:
    """What the journal keeps of a run."""
    row = {"status": outcome.status, "message": outcome.message, "figures": {}, "warnings": []}
    row |= outcome.answer or {}
    return row | {"seconds": outcome.seconds, "trace": outcome.trace}
