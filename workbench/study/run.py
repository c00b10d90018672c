"""Do the runs of a study that are missing in its folder, and report what all of them found."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

from cosim import SetupError, System
from cosim.calls import TIMEOUT, Outcome
from cosim.errors import pluralize
from cosim.journal import OutcomeJournal, digest, open_outcomes
from cosim.scratch import scratch
from cosim.system import connect

from ..answer import Answer
from ..export import write
from ..files import replacement
from ..run import rows
from ..runs.folder import contents, reservation, unpack
from ..runs.identity import computation
from ..runs.runner import Runner
from .file import Study, ends
from .report import conclude, figures_of, is_row

#: Keys of a study file on which no row depends.
BESIDE_ROWS = ("figures", "timeout", "limits")


def run(
    study: Study,
    *,
    out: Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    flavour: str = "",
    end: Callable[[Answer, Path], object] = write,
) -> Answer:
    """Do the runs that are missing in the folder `out` (results/studies/NAME) and write its files.

    They use FMUs of the flavour, "python" or "native" (by default native where they are built), and run in `jobs` processes of this machine (by
    default all cores), or on the Dask cluster of a scheduler, "tcp://host:8786". Raises SetupError for
    what cannot be run, for a folder with another study and, after `end`, for a figure that no run has.
    Raises KeyboardInterrupt after Ctrl-C; what is done is kept in the journal.
    """
    began = time.perf_counter()
    runner = Runner(jobs, scheduler or "", study.project.packages)
    flavour = flavour or study.project.flavour(study.question)
    fmus = study.project.fmus(study.question, flavour)
    units, who = _units(study, fmus), identity(study, fmus, flavour)
    folder = Path("results") / "studies" / study.name if out is None else out
    scratch()  # removes what killed runs left there, though this one may have no run to do
    with reservation(folder), open_outcomes(folder, who, is_row) as journal:
        with replacement(folder / "study.toml") as fresh:
            fresh.write_bytes(study.path.read_bytes())
        _forget_short_of(study.timeout, journal)
        before, question_files = len(journal), study.question.own_files
        home = (folder / "inputs").resolve()
        inputs = contents([*fmus.values(), *question_files])
        unpack(inputs, home)
        page = home / question_files[0].name if question_files else study.question.locator
        files = {part: home / path.name for part, path in fmus.items()}
        answers = partial(rows, page, files, finds=study.finds(fmus), judged=study.judgements)
        runner = replace(runner, page=str(page), files=[home / name for name in inputs])
        cases = dict(enumerate(study.cases()))
        at_once = study.question.at_once
        outcomes: dict[int, Outcome] = {}
        for number, outcome in runner.outcomes(
            answers, cases, study.name, journal, timeout=study.timeout, at_once=at_once
        ):
            if not outcomes:
                _warn_of_first(study, outcome)
            outcomes[number] = outcome
        session = len(cases) - before, time.perf_counter() - began
        done = [outcomes[number] for number in cases]
        try:
            answer = conclude(study, done, units, who, session)
            end(answer, folder)
        except KeyboardInterrupt:
            raise journal.interruption() from None
    figures = dict.fromkeys(name for outcome in done for name in figures_of(outcome))
    unknown = [name for name in (*study.figures, *study.limits) if name not in figures]
    if unknown and figures:
        raise SetupError(
            f"{study.path}: no run has {unknown[0]!r}, only {', '.join(figures)}; "
            f"the table is in {folder}"
        )
    return answer


def _warn_of_first(study: Study, outcome: Outcome) -> None:
    """Say at once why the first run that is done has no figures, or which of the file it lacks."""
    figures = figures_of(outcome)
    lacking = [x for x in (*study.figures, *study.limits) if x not in figures]
    only = f"there is no {lacking[0]!r}, only {', '.join(figures)}" if lacking and figures else ""
    if why := outcome.message or only:
        print(f"{study.path}: the first run: {why}", file=sys.stderr)


def _forget_short_of(timeout: float | None, journal: OutcomeJournal) -> None:
    """Let runs be done again that had less time than they may take now [s]; None is without end."""
    ended = [
        number
        for number, outcome in journal.items()
        if outcome.status == TIMEOUT and (timeout is None or outcome.seconds < timeout)
    ]
    for number in ended:
        del journal[number]  # its row counts until then, if this session ends before
    if ended:
        runs = f"{pluralize(len(ended), 'run')} that had no answer in time {'is' if len(ended) == 1 else 'are'}"
        print(f"{journal.path.parent}: {runs} done again", file=sys.stderr)


def work(
    study: Study, flavour: str = ""
) -> tuple[Callable[[list[Mapping[str, Any]]], list[Outcome]], list[dict[str, Any]]]:
    """Return a function that solves some cases of a study wherever it is called, as it can be pickled; and all cases.

    Its outcomes have a status, and an answer with names, units and reasons, values and errors of the figures, and warnings.
    """
    fmus = study.project.fmus(study.question, flavour or study.project.flavour(study.question))
    return partial(
        rows, study.question.locator, fmus, finds=study.finds(fmus), judged=study.judgements
    ), study.cases()


def identity(study: Study, fmus: Mapping[str, Path], flavour: str) -> dict[str, Any]:
    """Everything that the rows of a study depend on."""
    return {
        "file": {key: value for key, value in study.content.items() if key not in BESIDE_ROWS},
        "flavour": flavour,
        **computation(study.question.locator, fmus, *study.project.packages),
        "inputs": digest(json.dumps(study.cases()).encode()),
    }


def _units(study: Study, fmus: Mapping[str, Path]) -> dict[str, str]:
    """The units of the varied inputs; raises SetupError for a start value that no FMU has or takes."""
    values = {**{name: [value] for name, value in study.fixed.items()}, **study.grid}
    if study.linked:
        values |= {name: [x] for name, x in study.cases()[0].items() if name in study.linked}
    values |= {name: ends(tolerance) for name, tolerance in study.tolerances.items()}
    start_values = {name: several for name, several in values.items() if "." in name}
    try:
        for each in zip_longest(*start_values.values()):
            start = {name: value for name, value in zip(start_values, each) if value is not None}
            connect(System(fmus, start=study.given(start)))
        return study.units_of(fmus)
    except SetupError as error:
        raise SetupError(f"{study.path}: {error}") from None
