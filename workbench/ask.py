"""A question is asked: runs with the errors of their figures, warnings, and the answer."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import cosim
from cosim import Result, SetupError, System
from cosim.progress import bar
from cosim.system import connect

from .answer import Answer, Parameter, Show, Table, parameters
from .figure import Figure
from .limit import coupling
from .options import Options, Run, declared, refuse
from .question import Carried, asked, blamed, name, where
from .runs import local
from .runs.identity import computation, digest
from .runs.journal import Journal, sweep

Case = TypeVar("Case")
Found = TypeVar("Found")


@dataclass(frozen=True)
class Findings:
    """What `solve` returns: figures with their whole errors, and what verdict and show are given.

    Tables and files by file name; `facts` is what else stands in the JSON; `system` tells the FMUs
    and parameters behind it all, `provenance` is that of a run, or else `algorithm` and
    `communication` say how many were made.
    """

    figures: Mapping[str, Figure]
    data: Any = None
    system: System | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    communication: str = ""
    algorithm: str | None = None
    tables: Mapping[str, Table] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)


@dataclass(frozen=True)
class Bench:
    """What a question has at hand: its FMUs by part, what loads its page elsewhere, so many processes,
    a folder for rows on the way, the journal of its sweeps.
    """

    fmus: Mapping[str, Path]
    page: str = ""
    jobs: int = 1
    out: Path | None = None
    journal: Callable[[], Journal] | None = None

    def certify(
        self,
        system: System,
        figures: Callable[[Result], Mapping[str, Figure]],
        o: Run,
        record: Sequence[str] | None,
        csv: str = "",
    ) -> tuple[Result, dict[str, Figure]]:
        """The result with steps of `o.step`, and its figures; their errors are those that `figures`
        gives for this result, and that of the coupling, from runs with two and four times the step.

        Rows go to the CSV file of that name on the way. Raises what `cosim.run` raises.
        """

        def advance(cost: int, part: float) -> None:
            progress((cost - 1 + cost * part) / 7)

        told = []
        with bar(csv.removesuffix(".csv") or "run", 0.0, o.stop) as progress:
            for coarser in (4, 2, 1):
                with hearing() if coarser > 1 else nullcontext():
                    result = cosim.run(
                        system,
                        stop=o.stop,
                        step=coarser * o.step,
                        algorithm=o.algorithm,
                        record=record,
                        csv=self.out / csv if self.out and csv and coarser == 1 else None,
                        progress=partial(advance, 4 // coarser),
                    )
                told.append(figures(result))
        order = result.provenance["convergence_order"]
        return result, {
            name: certified([run.get(name) for run in told], order) for name in told[-1]
        }

    def each(
        self,
        function: Callable[[Case], Found],
        cases: Sequence[Case],
        title: str,
        probes: bool = False,
    ) -> Iterator[Found]:
        """function(case) for every case, in their order, on so many processes.

        Warnings are those of the question, but for `probes`, which look for what FMUs warn of.
        """
        heard = partial(_heard, function)
        call = Carried(self.page, heard) if self.page else heard
        journal = self.journal and self.journal()
        for found, warnings in local.each(call, cases, self.jobs, title, journal=journal):
            for warning in () if probes else warnings:
                logging.getLogger("cosim").warning(warning)
            yield found


def _heard(function: Callable[[Case], Found], case: Case) -> tuple[Found, list[str]]:
    """What a function makes of a case, and the warnings of its runs."""
    with hearing() as heard:
        return function(case), list(heard)


def certified(runs: Sequence[Figure | None], order: float) -> Figure:
    """The figure of the last of three runs, each with half the step of the one before, with the
    coupling error added to its own.
    """
    fine = runs[-1]
    assert fine is not None
    if fine.error is None:
        return fine
    values = [run.value for run in reversed(runs) if run is not None and run.error is not None]
    if len(values) < len(runs):
        reason = "only some of the three runs with different communication steps have it"
        return Figure.refused(fine.unit, reason, fine.meaning)
    return fine._replace(error=fine.error + coupling(values, order))


class _Hearing(logging.Handler):
    """Keeps warnings, each once."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.heard: dict[str, None] = {}

    def emit(self, record: logging.LogRecord) -> None:
        self.heard[record.getMessage()] = None


@contextmanager
def hearing() -> Iterator[dict[str, None]]:
    """The warnings of the runs in this process, which nobody else hears or prints meanwhile."""
    log, handler = logging.getLogger("cosim"), _Hearing()
    before = log.handlers, log.propagate
    log.handlers, log.propagate = [handler], False
    try:
        yield handler.heard
    finally:
        log.handlers, log.propagate = before


def answer(
    page: ModuleType,
    o: Options,
    fmus: Mapping[str, Path],
    *,
    flavour: str = "",
    jobs: int = 1,
    out: Path | None = None,
) -> Answer:
    """The answer of a page to its options, with these FMUs by part.

    Rows are kept in the folder `out` on the way. Raises SetupError for what is refused, SimulationError
    for a run that fails, QuestionError where the page's own code raises.
    """
    own = getattr(page, "OWN", ())
    refuse(o.start, own)
    with ExitStack() as stack, hearing() as heard, blamed(page):
        opened = cache(lambda folder: stack.enter_context(_journal(page, o, fmus, folder)))
        bench = Bench(fmus, where(page), jobs, out, partial(opened, out) if out else None)
        found = page.solve(o, bench) if hasattr(page, "solve") else _solve(page, o, bench)
        _check(page, found.figures)
        verdict = page.verdict(o, found.figures, found.data) if hasattr(page, "verdict") else ""
        system = found.system or System({})
        told = parameters(system, own) if system.parts else {}
    made = _provenance(system, found.algorithm, found.communication)

    def show() -> Show:
        if not hasattr(page, "show"):
            return Show()
        with hearing(), blamed(page):
            return Show(*page.show(o, found.figures, found.data))

    return Answer(
        scenario=name(page),
        question=asked(page),
        verdict=verdict,
        figures=found.figures,
        options=said(o),
        parameters=told,
        tables=found.tables,
        provenance=dict(found.provenance or made) | {"flavour": flavour},
        warnings=list(heard),
        facts=found.facts,
        files=found.files,
        show=show,
    )


def _solve(page: ModuleType, o: Any, bench: Bench) -> Findings:
    """The way of a page with a system and figures."""
    system = page.system(o, bench.fmus)
    table = f"{name(page)}.csv"

    def figures(result: Result) -> Mapping[str, Figure]:
        found: Mapping[str, Figure] = page.figures(o, result)
        _check(page, found)
        return found

    record = getattr(page, "RECORD", None)
    result, certain = bench.certify(system, figures, o, record, table)
    tables = {table: Table.of(result)}
    return Findings(certain, result, system, result.provenance, tables=tables)


def _check(page: ModuleType, figures: Any) -> None:
    """Refuse what is no figure, one by one."""
    if not isinstance(figures, Mapping):
        raise SetupError(f"{page.__file__}: figures must be a dict of workbench.Figure")
    for key, figure in figures.items():
        where = f"{page.__file__}: figure {key!r}"
        if not isinstance(figure, Figure):
            raise SetupError(f"{where} must be a workbench.Figure(value, unit, error, meaning)")
        if not isinstance(figure.unit, str) or not figure.unit:
            raise SetupError(f'{where} has no unit; a number without one has the unit "1"')
        if figure.error is None and not (figure.reason and math.isnan(figure.value)):
            raise SetupError(f"{where} has no error; Figure.refused(unit, reason) says why not")
        if figure.error is not None and not (figure.error >= 0.0 and math.isfinite(figure.value)):
            raise SetupError(f"{where} = {figure.value!r} +- {figure.error!r} is no figure")


def _journal(
    page: ModuleType, o: Options, fmus: Mapping[str, Path], folder: Path
) -> AbstractContextManager[Journal]:
    """The journal of the sweeps of a question."""
    source, package = where(page), page.__name__.partition(".")[0]
    own = source.endswith(".py")
    identity = {
        "question": digest(Path(source).read_bytes()) if own else source,
        "options": {key: repr(told.value) for key, told in said(o).items()},
        "start": dict(o.start),
        **computation(fmus, *([] if own else [package])),
    }
    return sweep(folder, identity)


def said(o: Options) -> dict[str, Parameter]:
    """The options as they were taken."""
    return {
        key: Parameter(getattr(o, key), told.unit, told.meaning)
        for key, told in declared(type(o)).items()
    }


def _provenance(system: System, algorithm: str | None, communication: str) -> dict[str, Any]:
    """How the runs of a sweep were made, in the words in which one run tells it."""
    descriptions = connect(system).descriptions if system.parts else {}
    return {
        "algorithm": algorithm,
        "communication": communication,
        "wires": [str(wire) for wire in system.wires],
        "parts": {
            part: {"fmu": Path(path).name, "model": d.modelName, "guid": d.guid}
            for (part, path), d in zip(system.parts.items(), descriptions.values())
        },
        "versions": cosim.versions(),
    }
