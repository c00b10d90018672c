"""A question becomes an answer."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim import SetupError, System
from cosim.calls import OK, Outcome, failure
from cosim.journal import OutcomeJournal, open_outcomes
from cosim.system import connect

from . import catalog, export, live
from .answer import Answer, Findings, Show, option_values, parameters
from .catalog import QuestionError, as_question_errors
from .context import IN_PROCESS, Context, captured_log_warnings
from .figure import Figure, checked_figures
from .find import Find, find, with_level
from .judgement import Holds, Judgement, lines
from .live import Live
from .live.build import for_shell
from .options import check_fixed_starts, declared
from .plan import case_of
from .project import FLAVOURS, PYTHON, Project
from .question import Question, read
from .remedies import search_for
from .runs.folder import reservation
from .runs.identity import computation
from .runs.runner import Runner

#: What judgement number k of an answer is called among figures.
JUDGED = "judgement_{}"
#: What was found: name, unit and reason of each figure; value and error of each, nan without one; and warnings.
Row = tuple[list[list[str]], NDArray[np.float64], list[str]]


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
    """Return the answer to a question of a project, by its name, or of a file.

    Options are given as on its command line, or as values in the declared units; "start" contains
    start values of FMUs. The flavour is by default native where these FMUs are built, else Python. By
    default `jobs` are all cores for Python FMUs and for a question that is parallel, else one. Rows go
    to the folder `out`, which no other run may use meanwhile, as they are computed. Raises what
    `answer` raises.
    """
    question = project.load(text)
    chosen = flavour or project.flavour(question)
    if chosen not in FLAVOURS:
        raise SetupError(f"flavour = {chosen!r} must be one of {', '.join(FLAVOURS)}")
    runner = Runner(jobs, scheduler or "", project.packages)
    if question.is_sequential and (scheduler is not None or jobs not in (None, 1)):
        option = f"jobs = {jobs}" if scheduler is None else f"scheduler = {scheduler!r}"
        raise SetupError(
            f"{option} has no effect on {question.name}, whose runs follow one after the other; leave it out"
        )
    is_parallel = chosen == PYTHON or question.is_parallel
    if jobs is None and scheduler is None and not is_parallel:
        runner = replace(runner, jobs=1)
    return answer(
        question,
        question.parse(options),
        project.fmus(question, chosen),
        flavour=chosen,
        runner=runner,
        out=out,
        modules=project.wasm_modules(question),
        command=f"{program} run {for_shell(text)}{f' --flavour {flavour}' if flavour else ''}",
    )


def answer(
    question: type[Question],
    o: Question,
    fmus: Mapping[str, Path],
    *,
    flavour: str = "",
    runner: Runner = IN_PROCESS,
    out: Path | None = None,
    modules: Mapping[str, Path] = MappingProxyType({}),
    command: str = "",
) -> Answer:
    """Return the answer of a question to its options, with these FMUs by part; the runner does the sweeps.

    Rows go to the folder `out` as they are computed. The page has a live part if there are modules of
    the FMUs by part; `command` is then the start of the command line that asks the same.

    Raises
    ------
    SetupError
        For what is refused.
    SimulationError
        For a run that fails.
    QuestionError
        Where the question's own code raises.

    Parameters
    ----------
    question : Question
        What is asked.
    o : dataclass
        The question's options.
    fmus : mapping
        The FMU of each part.
    flavour : str
        What kind of FMUs these are, for the provenance.
    runner : Runner
        Does the runs of a sweep.
    out : Path, optional
        The folder for rows.
    modules : mapping
        The module for WebAssembly of each part.
    command : str
        The start of the command line that asks the same.
    """
    runner = replace(runner, page=question.locator, files=[*fmus.values(), *question.own_files])
    with (
        captured_log_warnings() as warnings,
        as_question_errors(question.module),
        found(question, o, fmus, runner, out) as findings,
    ):
        judgements = tuple(o.judgements(findings.figures, findings.data))
        live_page = o.live(findings.figures, findings.data)
        system = findings.system or System({})
        values = parameters(system, question.fixed_starts) if system.parts else {}
        live_part = live.of(live_page, o, findings, modules, command)

    def show() -> Show:
        with captured_log_warnings(), as_question_errors(question.module):
            return Show(*o.show(findings.figures, findings.data))

    options = option_values(o, findings.defaults)
    sliders = live_page.sliders if isinstance(live_page, Live) else o.sliders
    provenance = findings.provenance or _provenance(o, findings, system)
    return Answer(
        **vars(findings)
        | {
            "provenance": {**provenance, "flavour": flavour},
            "warnings": [*findings.warnings, *warnings()],
        },
        scenario=question.name,
        question=question.title,
        verdict="\n".join(lines(judgements)),
        judgements=judgements,
        options=options,
        parameters=values,
        show=show,
        live=live_part,
        search=search_for(o, Context(fmus, runner), findings, sliders, {**values, **options}),
        refused=is_refused(question, findings.figures),
        sources=question.sources,
        error_scope=question.error_scope,
        picture=export.html_picture,
    )


@contextmanager
def found(
    question: type[Question],
    o: Question,
    fmus: Mapping[str, Path],
    runner: Runner = IN_PROCESS,
    out: Path | None = None,
) -> Iterator[Findings]:
    """Give what a question finds, as `answer` does, without what is said and shown of it.

    The rows of its sweeps are kept in the folder `out` until the end, and stay there after an error.
    """
    check_fixed_starts(o.start, question.fixed_starts)
    with reservation(out), ExitStack() as stack:

        @cache
        def journal() -> OutcomeJournal | None:
            if out is None:
                return None
            own = [] if question.own_files else [question.module.__name__.partition(".")[0]]
            identity = {
                "options": {name: repr(x.value) for name, x in option_values(o).items()},
                "start": dict(o.start),
                **computation(question.locator, fmus, *(runner.packages or own)),
            }
            return stack.enter_context(open_outcomes(out, identity, passing=True))

        yield _require_findings(question, o.solve(Context(fmus, runner, out, journal)))


def _require_findings(question: type[Question], findings: Any) -> Findings:
    """What `solve` has returned, as it was declared; raises SetupError for anything else."""
    if not isinstance(findings, Findings):
        raise SetupError(f"{question.path}: solve must return workbench.Findings")
    return replace(findings, figures=checked_figures(findings.figures, question.path))


def is_refused(question: type[Question], figures: Mapping[str, Figure]) -> bool:
    """Whether an answer is refused: a figure that it hangs on is undetermined.

    These are the question's decisive figures. Without such, an answer is refused if figures are
    undetermined and all others come from formulas alone.

    Raises
    ------
    SetupError
        For a decisive figure that does not exist.
    """
    for key in question.decisive:
        if key not in figures:
            raise SetupError(f"{question.path}: decisive names {key!r}, which is no figure")
    if question.decisive:
        return any(figures[name].error is None for name in question.decisive)
    errors = [figure.error for figure in figures.values()]
    return None in errors and not any(errors)


def rows(
    page: Path | str,
    fmus: Mapping[str, Path],
    cases: Sequence[Mapping[str, Any]],
    finds: Mapping[str, Find] = MappingProxyType({}),
    *,
    judged: bool = False,
) -> list[Outcome]:
    """Return what becomes of the question of a file or a module in each case: options, and start values, which have a dot.

    Where figures reach the levels of `finds` is sought in each case, and is a figure as well; so are judgements where they are
    `judged`, 1 for yes and 0 for no.
    The answer of an outcome is a `Row`. Cases that cannot be solved together are solved in halves. Errors name no folder.
    """
    began = perf_counter()
    try:
        found = _solve_cases(page, fmus, cases, finds, judged=judged)
    except Exception as error:  # noqa: BLE001
        if len(cases) > 1:
            half = len(cases) // 2
            halves = (cases[:half], cases[half:])
            return [x for some in halves for x in rows(page, fmus, some, finds, judged=judged)]
        found = [error]
    seconds = (perf_counter() - began) / len(cases)
    return [
        (failure(x) if isinstance(x, Exception) else Outcome(OK, x))._replace(seconds=seconds)
        for x in found
    ]


def _solve_cases(
    page: Path | str,
    fmus: Mapping[str, Path],
    cases: Sequence[Mapping[str, Any]],
    finds: Mapping[str, Find],
    *,
    judged: bool,
) -> list[Row | Exception]:
    """The answers to cases, or why they are refused; raises what `solve_all` does, and if it is not clear who warns."""
    try:
        question = read(catalog.load_cached(str(page)))
        with captured_log_warnings() as logged, as_question_errors(question.module):
            asked = [case_of(question, case) for case in cases]
            for o in asked:
                check_fixed_starts(o.start, question.fixed_starts)
            found = question.solve_all(Context(fmus), asked)
            good = {k: x for k, x in enumerate(found) if isinstance(x, Findings)}
            sought = [
                (asked[k], with_level(x, of_case.figures))
                for k, of_case in good.items()
                for x in finds.values()
            ]
            places = find(Context(fmus), sought)
            for j, (k, x) in enumerate(good.items()):
                of_case = zip(finds, places[j * len(finds) :])
                more = {
                    f"{name}_{n}" if n > 1 else name: y
                    for name, all_ in of_case
                    for n, y in enumerate(all_, 1)
                }
                more |= (
                    _figures_of_judgements(asked[k].judgements(x.figures, x.data)) if judged else {}
                )
                found[k] = replace(x, figures={**x.figures, **more})
            if len(cases) > 1 and logged():
                raise SetupError(f"one of {len(cases)} cases warns: {logged()[0]}")
            return [
                x
                if isinstance(x, SetupError)
                else _study_row(_require_findings(question, x), logged())
                for x in found
            ]
    except (SetupError, QuestionError) as error:
        text = str(error)
        for folder in {path.parent for path in (page, *fmus.values()) if isinstance(path, Path)}:
            text = text.replace(f"{folder}{os.sep}", "")
        raise type(error)(text) from error


def _figures_of_judgements(judgements: Sequence[Judgement]) -> dict[str, Figure]:
    """Judgements as figures: 1 for yes, 0 for no, and why one is open."""
    return {
        JUDGED.format(k): Figure(float(x.answer is Holds.YES), "1", 0.0, x.what)
        if x.answer is not Holds.OPEN
        else Figure.undetermined("1", x.why_open or "it is open", x.what)
        for k, x in enumerate(judgements, 1)
        if x.answer
    }


def _study_row(findings: Findings, logged: Sequence[str]) -> Row:
    """What a row of a study has of what was found."""
    figures = findings.figures.items()
    numbers = [(f.value, f.known_error) for _, f in figures]
    texts = [[name, f.unit, f.reason] for name, f in figures]
    return texts, np.array(numbers, float).reshape(-1, 2), [*findings.warnings, *logged]


def _provenance(o: Any, findings: Findings, system: System) -> dict[str, Any]:
    """Return how the runs of a sweep were made, in the form of the provenance of one run; by default as steady turns are."""
    descriptions = connect(system).descriptions if system.parts else {}
    algorithm, steps = findings.algorithm, findings.communication
    if not steps and "steps_per_rev" in declared(type(o)):
        algorithm, steps = o.algorithm, f"{o.steps_per_rev} steps per revolution"
    return {
        "algorithm": algorithm,
        "communication": steps,
        "wires": [str(wire) for wire in system.wires],
        "parts": {
            part: {"fmu": Path(path).name, "model": d.modelName, "guid": d.guid}
            for (part, path), d in zip(system.parts.items(), descriptions.values())
        },
        "versions": cosim.versions(),
    }
