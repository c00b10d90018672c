"""A question is asked: runs with the errors of their figures, warnings, and the answer."""

from __future__ import annotations

import logging
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cache, partial
from logging.handlers import BufferingHandler
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, TypeVar

import cosim
from cosim import Result, SetupError, SimulationError, System
from cosim.progress import bar
from cosim.system import connect

from . import live, question
from .answer import Answer, Findings, Parameter, Show, Table, parameters, stream
from .figure import Figure, drop_undetermined
from .limit import certified, converged
from .options import Options, Run, check_fixed_starts, declared, parse_options
from .question import FLAVOURS, PYTHON, Project, QuestionError, attribute_errors, locator, name
from .runs.codec import Records
from .runs.fingerprint import SOURCES, computation
from .runs.folder import reservation
from .runs.journal import Journal, open_journal
from .runs.runner import Runner

IN_PROCESS = Runner(jobs=1)
TOO_LONG = (
    "step = {:g} s is too long to determine errors: a run with {} times the step, {:g} s, fails: {}"
)
FEWEST = 16
Case = TypeVar("Case")
Found = TypeVar("Found")


@dataclass(frozen=True)
class Context:
    """What a question works with: its FMUs by part, the runner of its runs, a folder for rows as they
    are computed, and the journal of its sweeps.
    """

    fmus: Mapping[str, Path]
    runner: Runner = IN_PROCESS
    out: Path | None = None
    journal: Callable[[], Journal | None] = lambda: None

    def certify(
        self,
        system: System,
        figures: Callable[[Result], Mapping[str, Figure]],
        o: Run,
        record: Sequence[str] | None,
        csv: str = "",
    ) -> tuple[Result, dict[str, Figure]]:
        """The result with steps of `o.step`, and its figures. Their errors are those that `figures`
        gives for this result plus that of the coupling, from runs with two and four times the step.

        Rows go to the CSV file of that name as they are computed. Raises what `cosim.run` raises. For a
        step that is too long to determine errors it raises SetupError before the runs or SimulationError
        after them.
        """
        if o.step > o.stop / FEWEST:
            raise SetupError(
                f"step = {o.step:g} s must be at most {o.stop / FEWEST:g} s, a {FEWEST}th of stop = "
                f"{o.stop:g} s: three runs with up to four times the step give the errors"
            )

        def advance(cost: int, part: float) -> None:
            progress((cost - 1 + cost * part) / 7)

        told, runs, missing = [], [], ""
        with bar(csv.removesuffix(".csv") or "run", 0.0, o.stop) as progress:
            for coarser in (4, 2, 1):
                try:
                    with captured_warnings() if coarser > 1 else nullcontext():
                        result = cosim.run(
                            system,
                            stop=o.stop,
                            step=coarser * o.step,
                            algorithm=o.algorithm,
                            record=record,
                            csv=self.out / csv if self.out and csv and coarser == 1 else None,
                            progress=partial(advance, 4 // coarser),
                        )
                except SimulationError as error:
                    if coarser == 1:
                        raise
                    missing = TOO_LONG.format(o.step, coarser, coarser * o.step, error)
                else:
                    told.append(figures(result))
                    runs.append(result.data)
        if missing:
            raise SimulationError(missing, result)
        with captured_warnings():
            return result, converged(figures, result, certified(figures, result, told), runs)

    def each(
        self,
        function: Callable[[Case], Found],
        cases: Sequence[Case],
        title: str,
        probes: bool = False,
    ) -> Iterator[Found]:
        """function(case) for every case, in order, wherever the runner does its runs.

        Warnings become those of the question, except for `probes`, which look for what FMUs warn of.
        """
        call = partial(_with_warnings, function)
        for found, warnings in self.runner.each(call, cases, title, self.journal()):
            for warning in () if probes else warnings:
                logging.getLogger("cosim").warning(warning)
            yield found

    def record_rows(
        self, csv: str, units: Mapping[str, str], rows: Iterable[Sequence[Any]]
    ) -> Table:
        """The table of rows, which are kept in NAME.partial.csv as they are computed."""

        def passed() -> Iterator[Sequence[Any]]:
            for row in rows:
                keep([row])
                yield row

        with stream(self.out and self.out / csv, list(units)) as keep:
            return Table.of_rows(passed(), units)


def _with_warnings(function: Callable[[Case], Found], case: Case) -> tuple[Found, list[str]]:
    """What a function makes of a case, and the warnings of its runs."""
    with captured_warnings() as heard:
        return function(case), heard()


@contextmanager
def captured_warnings() -> Iterator[Callable[[], list[str]]]:
    """Collect the warnings of the runs in this process, each once, and keep them from other handlers."""
    log, handler = logging.getLogger("cosim"), BufferingHandler(sys.maxsize)
    handler.setLevel(logging.WARNING)
    before = log.handlers, log.propagate
    log.handlers, log.propagate = [handler], False
    try:
        yield lambda: list(dict.fromkeys(record.getMessage() for record in handler.buffer))
    finally:
        log.handlers, log.propagate = before


def ask(
    project: Project,
    text: str,
    options: Mapping[str, Any],
    *,
    flavour: str = "",
    jobs: int | None = None,
    scheduler: str | None = None,
    out: Path | None = None,
    program: str = "",
) -> Answer:
    """The answer to a question of a project, by its name, or of a file.

    Options are given as on its command line, or as values in the declared units; "start" contains
    start values of FMUs. The flavour is by default native where these FMUs are built, else Python. By
    default `jobs` are all cores for Python FMUs and for a question that says PARALLEL, else one. Rows are
    kept in the folder `out`, which no other run may use meanwhile, as they are computed. Raises what
    `answer` raises.
    """
    page = question.load(question.find(project.home, text))
    used = flavour or project.flavour(page)
    if used not in FLAVOURS:
        raise SetupError(f"flavour = {used!r} must be one of {', '.join(FLAVOURS)}")
    spread = used == PYTHON or getattr(page, "PARALLEL", False)
    one = jobs is None and scheduler is None and not spread
    return answer(
        page,
        parse_options(page.Options, options, name(page)),
        project.fmus(page, used),
        flavour=used,
        runner=Runner(1 if one else jobs, scheduler, project.packages),
        out=out,
        modules=project.modules(page),
        command=f"{program} run {text}" + f" --flavour {flavour}" * bool(flavour),
    )


def answer(
    page: ModuleType,
    o: Options,
    fmus: Mapping[str, Path],
    *,
    flavour: str = "",
    runner: Runner = IN_PROCESS,
    out: Path | None = None,
    modules: Mapping[str, Path] = MappingProxyType({}),
    command: str = "",
) -> Answer:
    """The answer of a page to its options, with these FMUs by part; the runner does the sweeps.

    Rows are kept in the folder `out` as they are computed. The page has a live part if there are
    modules of the FMUs by part; `command` is then the start of the command line that asks the same.
    Raises SetupError for what is refused, SimulationError for a run that fails, and QuestionError where
    the page's own code raises.
    """
    own = getattr(page, "FIXED_STARTS", ())
    check_fixed_starts(o.start, own)
    with (
        reservation(out),
        ExitStack() as stack,
        captured_warnings() as heard,
        attribute_errors(page),
    ):
        files = [*fmus.values(), *question.files(page)]
        runner = replace(runner, page=locator(page), files=files)

        @cache
        def journal() -> Journal | None:
            if out is None:
                return None
            packages = _packages(page, runner.packages)
            records = Records(frozenset({*SOURCES, *packages, page.__name__}))
            who = _identity(page, o, fmus, packages)
            return stack.enter_context(open_journal(out, who, passing=True, records=records))

        context = Context(fmus, runner, out, journal)
        found = page.solve(o, context) if hasattr(page, "solve") else _solve(page, o, context)
        if not isinstance(found, Findings):
            raise SetupError(f"{page.__file__}: solve must return workbench.Findings")
        _check(page, found.figures)
        verdict = page.verdict(o, found.figures, found.data) if hasattr(page, "verdict") else ""
        verdict = drop_undetermined(verdict, found.figures)
        system = found.system or System({})
        told = parameters(system, own) if system.parts else {}
        live_part = live.of(page, o, found, modules, command)
    provenance = _provenance(system, found.algorithm, found.communication)

    def show() -> Show:
        if not hasattr(page, "show"):
            return Show()
        with captured_warnings(), attribute_errors(page):
            return Show(*page.show(o, found.figures, found.data))

    return Answer(
        **vars(found) | {"provenance": {**(found.provenance or provenance), "flavour": flavour}},
        scenario=name(page),
        question=question.title(page),
        verdict=verdict,
        options=option_values(o, found.defaults),
        parameters=told,
        warnings=heard(),
        show=show,
        live=live_part,
        refused=is_refused(page, found.figures),
    )


def is_refused(page: ModuleType, figures: Mapping[str, Figure]) -> bool:
    """Whether an answer is refused: a figure that it hangs on is not determined.

    These are the figures that the page names in DECISIVE. Without that, an answer is refused if figures
    are not determined and all others come from formulas alone.

    Raises
    ------
    SetupError
        For a name in DECISIVE that is no figure.
    """
    names = getattr(page, "DECISIVE", ())
    for key in names:
        if key not in figures:
            raise SetupError(f"{page.__file__}: DECISIVE names {key!r}, which is no figure")
    if names:
        return any(figures[name].error is None for name in names)
    errors = [figure.error for figure in figures.values()]
    return None in errors and not any(errors)


def row(page: Path | str, fmus: Mapping[str, Path], case: Mapping[str, Any]) -> dict[str, Any]:
    """What the page of a file or a module answers to options and start values, which have a dot:
    {"figures": {name: (value, unit, error, reason)}, "warnings": texts}. Its errors name no folder.
    """
    start = {key: value for key, value in case.items() if "." in key}
    options = {key: value for key, value in case.items() if key not in start}
    try:
        asked = question.load_cached(str(page))
        o = parse_options(asked.Options, {**options, "start": start}, name(asked))
        found = answer(asked, o, fmus)
    except (SetupError, QuestionError) as error:
        text = str(error)
        for folder in {path.parent for path in (page, *fmus.values()) if isinstance(path, Path)}:
            text = text.replace(f"{folder}{os.sep}", "")
        raise type(error)(text) from error
    figures = {
        key: (float(f.value), f.unit, None if f.error is None else float(f.error), f.reason)
        for key, f in found.figures.items()
    }
    return {"figures": figures, "warnings": list(found.warnings)}


def is_row(answer: Any) -> bool:
    """Whether a value has the form of what `row` returns."""
    try:
        figures, warnings = answer["figures"], answer["warnings"]
        return (
            set(answer) == {"figures", "warnings"}
            and all(isinstance(text, str) for text in warnings)
            and all(
                isinstance(value, float)
                and isinstance(error, float | None)
                and all(isinstance(text, str) for text in (name, unit, reason))
                for name, (value, unit, error, reason) in figures.items()
            )
        )
    except (TypeError, ValueError, KeyError, AttributeError):
        return False


def _solve(page: ModuleType, o: Any, context: Context) -> Findings:
    """The way of a page with a system and figures."""
    system = page.system(o, context.fmus)
    table = f"{name(page)}.csv"

    def figures(result: Result) -> Mapping[str, Figure]:
        found: Mapping[str, Figure] = page.figures(o, result)
        _check(page, found)
        return found

    record = getattr(page, "RECORD", None)
    result, certain = context.certify(system, figures, o, record, table)
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
            raise SetupError(f'{where} has no unit; a dimensionless number has the unit "1"')
        if figure.error is None and not (figure.reason and math.isnan(figure.value)):
            raise SetupError(
                f"{where} has no error; use Figure.undetermined(unit, reason) to say why"
            )
        if figure.error is not None and not (figure.error >= 0.0 and math.isfinite(figure.value)):
            raise SetupError(
                f"{where} = {figure.value!r} +- {figure.error!r} is not a valid figure"
            )


def _identity(
    page: ModuleType, o: Options, fmus: Mapping[str, Path], packages: Sequence[str]
) -> dict[str, Any]:
    """What the sweeps of a question depend on."""
    return {
        "options": {key: repr(told.value) for key, told in option_values(o).items()},
        "start": dict(o.start),
        **computation(locator(page), fmus, *packages),
    }


def _packages(page: ModuleType, packages: Sequence[str]) -> Sequence[str]:
    """The packages that a page lies in, by default that of its own module."""
    return packages or ([] if question.files(page) else [page.__name__.partition(".")[0]])


def option_values(
    o: Options, defaults: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Parameter]:
    """The options as they were taken, with the question's `defaults` for those left to it."""
    values = {
        key: getattr(o, key)
        if getattr(o, key) not in (None, ())
        else defaults.get(key, getattr(o, key))
        for key in declared(type(o))
    }
    return {
        key: Parameter(values[key], option.unit, option.meaning)
        for key, option in declared(type(o)).items()
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
