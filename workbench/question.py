"""What a question is: a class whose fields are its options, and whose methods have defaults.

An instance is the question as it is asked, with a value for each option.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from inspect import isfunction
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, dataclass_transform

from cosim import Result, SetupError, System
from cosim.metrics import Metric

from . import catalog
from .answer import Findings, Show, Table
from .charts.style import hex_color
from .figure import (
    ERROR_SCOPE,
    Figure,
)
from .formula import Formula
from .judgement import Judgement
from .live import Formulas, Live, LiveMotion, Number, RunChart, Slider, drawn, moved
from .method import Method, Run
from .options import Options, RunOptions, declared, option, unknown_option

if TYPE_CHECKING:
    from .context import Context

#: Names that the command line takes for every question.
RESERVED_OPTIONS = (
    "help", "start", "flavour", "jobs", "scheduler", "out", "animate", "remedies",
)  # fmt: skip
#: The tables of a question, and what each contains.
TABLES = {
    "wires": '"a.w -> b.w"', "fixed_starts": '"a.w"', "record": '"a.w"', "decisive": '"figure"',
    "numbers": "Number(...)", "charts": "RunChart(...)", "sliders": "Slider(...)",
}  # fmt: skip


class Probe(NamedTuple):
    """What a search asks in place of a question that found something.

    Attributes
    ----------
    question : Question
        What is asked at values of the inputs.
    judge : callable, optional
        Gives the judgements of what it finds, in the order of those of the answer; by default its own.
    sliders : sequence of Slider, optional
        The inputs, by default those of the answer.
    """

    question: Question
    judge: Callable[[Question, Findings], Sequence[Judgement]] | None = None
    sliders: Sequence[Slider] | None = None


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(option,))
class Question(Options):
    """A question, asked with the values of its options, which are its fields.

    A question of certified runs has `numbers` or defines `figures`; it derives from `RunOptions` as well, or defines `run_options`. Any
    other question defines `solve`.

    Attributes
    ----------
    parts : mapping
        FMUs by part: names of built ones, or paths that end in .fmu, from the file of the question.
    wires : sequence of str
        How they are coupled.
    fixed_starts : sequence of str
        Start values that it sets itself, and nobody else may.
    record : sequence of str, or None
        The columns that a certified run records, by default all.
    labels : mapping
        What several systems are called in the meaning of their figures, by default their names.
    decisive : sequence of str
        Figures without which the answer is refused.
    sources : sequence of pairs of str
        The papers whose formulas it names, and where they are described.
    error_scope : str
        What the errors of its figures cover, in sentences.
    start_values : mapping of str to str or float
        Start values, as formulas of options; those of the user come first.
    numbers : sequence of Number
        Figures that are read from a run, which are numbers of the live page, too.
    charts : sequence of RunChart
        Panels of columns, for picture and page.
    sliders : sequence of Slider
        What moves the live page; without one there is none.
    method : Method
        How its figures are measured: by default on certified runs.
    is_parallel : bool
        Whether its runs are spread over all cores by default with native FMUs, too.
    is_sequential : bool
        Whether no two of its runs may be done at the same time, so that jobs and a scheduler are refused; by default that
        of a question of certified runs alone.
    at_once : int
        How many cases of a study `solve_all` is given at a time.
    module, title, name, path, locator, own_files
        Where it is written, the first line of its module, the name by which it is asked, its file, what `load` takes to
        load it again, or in another process, and its file where it belongs to no package.
    """

    parts: ClassVar[Mapping[str, str]] = MappingProxyType({})
    wires: ClassVar[Sequence[str]] = ()
    fixed_starts: ClassVar[Sequence[str]] = ()
    record: ClassVar[Sequence[str] | None] = None
    labels: ClassVar[Mapping[str, str]] = MappingProxyType({})
    decisive: ClassVar[Sequence[str]] = ()
    sources: ClassVar[Sequence[tuple[str, str]]] = ()
    error_scope: ClassVar[str] = ERROR_SCOPE
    start_values: ClassVar[Formulas] = MappingProxyType({})
    numbers: ClassVar[Sequence[Number]] = ()
    charts: ClassVar[Sequence[RunChart]] = ()
    sliders: ClassVar[Sequence[Slider]] = ()
    method: ClassVar[Method] = Run()
    is_parallel: ClassVar[bool] = False
    is_sequential: ClassVar[bool] = True
    at_once: ClassVar[int] = 1
    module: ClassVar[ModuleType]
    title: ClassVar[str]
    name: ClassVar[str]
    path: ClassVar[Path]
    locator: ClassVar[str]
    own_files: ClassVar[Sequence[Path]]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        dataclass(frozen=True, kw_only=True)(cls)
        if {"solve", "solve_all", "method"} & vars(cls).keys() and "is_sequential" not in vars(cls):
            cls.is_sequential = False
        cls.module = sys.modules[cls.__module__]
        cls.title = (cls.module.__doc__ or "").strip().partition("\n")[0]
        cls.name = cls.__module__.rpartition(".")[2]
        cls.path = Path(str(cls.module.__file__))
        cls.locator = catalog.locator(cls.module)
        cls.own_files = [cls.path] if catalog.is_from_file(cls.module) else []

    @classmethod
    def parse(cls, options: Mapping[str, Any]) -> Self:
        """Return the question with these values; raises SetupError for what they cannot be."""
        names = [*declared(cls), "start"]
        for name in options:
            if name not in names:
                raise unknown_option(name, names, cls.name)
        return cls(**options)

    def system(self, fmus: Mapping[str, Path]) -> System | Mapping[str, System]:
        """Return the system, or several by name, each of which is run and certified."""
        values = {}
        for name, text in self.start_values.items():
            try:
                values[name] = Formula.read(text)(self.values)
            except SetupError as error:
                item = "; the item of an enumeration is written as its number"
                hint = item * (isinstance(text, str) and text.isidentifier())
                raise SetupError(f"{self.path}: start_values: {name}: {error}{hint}") from error
        return System(dict(fmus), self.wires, {**values, **self.start})

    @cached_property
    def values(self) -> dict[str, float]:
        """The options that are numbers, which formulas may name."""
        return {name: float(x) for name in declared(type(self)) if isinstance(x := getattr(self, name), int | float)}  # fmt: skip

    def with_value(self, name: str, x: float) -> Self:
        """Return the question with a value of an option, or of a start value, whose name has a dot."""
        changed: Any = {"start": {**self.start, name: x}} if "." in name else {name: x}
        return replace(self, **changed)

    def probe(self, context: Context, found: Findings) -> Probe:
        """Return what searches ask in place of the question: one with no more than the judgements need."""
        return Probe(self)

    def run_options(self) -> RunOptions:
        """Return stop, step and algorithm of the certified runs."""
        options: Any = self
        return options  # type: ignore[no-any-return]

    def process(self, result: Result) -> Result:
        """Return a result with further columns, or only some of its rows, for figures, tables and charts."""
        return result

    def figures(self, result: Result) -> Mapping[str, Figure]:
        """Return the figures of one run besides its `numbers`.

        Those of several systems get the name of their system in front, and in their meaning what `labels` calls it.
        """
        return {}

    def more_runs(self, context: Context, system: Any) -> Any:
        """Do further runs, such as a sweep, once the system is certified.

        The results that methods see are a pair where this returns any: what was certified, and what this returned.
        """

    def guide(self, figure: str, over: str) -> Any:
        """Return the course of a figure over an option or a start value by formulas, or None.

        It has `figures`, the names of what is measured; `smooth(x, values)`, what of these values is smooth, and `theory(x)`,
        what formulas give for that; `figure(x, smooth)`; `period`, after which the figure repeats, 360 for an angle in
        degrees and infinite for any other; and `half_width(x)` of a range around a peak that a polynomial of degree four
        meets. Arrays have values of x as their last axis.
        """
        return None

    def more_figures(self, figures: Mapping[str, Figure], results: Any) -> Mapping[str, Figure]:
        """Return figures that follow from these, or from formulas, with their errors."""
        return {}

    def tables(self, figures: Mapping[str, Figure], results: Any) -> Mapping[str, Table]:
        """Return further tables by file name."""
        return {}

    def files(self, results: Any) -> Mapping[str, Callable[[Path], object]]:
        """Return by file name functions that write a further file to a path."""
        return {}

    def judgements(self, figures: Mapping[str, Figure], results: Any) -> Sequence[Judgement]:
        """Return what the answer claims, first what decides it; claims with bounds in one order for all values of options."""
        return ()

    def show(self, figures: Mapping[str, Figure], results: Any) -> Show:
        """Return charts and motions, by default those of `charts` and of `motion`."""
        shown, moving = certified_results(results), self.motion(figures, results)
        charts = [drawn(chart, shown, self, figures) for chart in self.charts]
        return Show(charts, [moved(moving, shown[0])] if moving else [])

    def motion(self, figures: Mapping[str, Figure], results: Any) -> LiveMotion | None:
        """Return the mechanism in motion, for picture and live page."""
        return None

    def live(self, figures: Mapping[str, Figure], results: Any) -> Live | str | None:
        """Return the live part of the page, or why it has none, by default `page` where there are `sliders`."""
        return self.page(figures, results) if self.sliders else None

    @classmethod
    def has_live_page(cls) -> bool:
        """Whether its page has a live part."""
        return bool(cls.sliders) or cls.live is not Question.live

    def page(
        self,
        figures: Mapping[str, Figure],
        results: Any,
        *,
        more: Sequence[Number] = (),
        **settings: Any,
    ) -> Live:
        """Return a live part of `sliders`, `numbers` and `more` of these, `charts`, `start_values` and `motion`.

        Other settings of `Live` take the place of these.
        """
        numbers = [*(x for x in self.numbers if not isinstance(x.value, Metric)), *more]
        return Live(**{
            "sliders": self.sliders, "charts": self.charts, "start": self.start_values, "numbers": numbers,
            "motion": self.motion(figures, results), **settings,
        })  # fmt: skip

    def solve(self, context: Context) -> Findings:
        """Return what is found, by default what its method measures, or `solve_all` finds where that is its own."""
        solve_all = self.solve_all if self.overrides("solve_all") else self.method.measure
        (found,) = solve_all(context, [self])
        if isinstance(found, SetupError):
            raise found
        return found

    @classmethod
    def solve_all(cls, context: Context, questions: Sequence[Self]) -> list[Findings | SetupError]:
        """Return what each of several cases finds, or why it is refused; by default what the method measures of all.

        A question that does the runs of all cases together defines it in place of `solve`, and sets `at_once`.
        """
        if cls.overrides("solve"):
            return [question.solve(context) for question in questions]
        return cls.method.measure(context, questions)

    @classmethod
    def overrides(cls, name: str) -> bool:
        """Whether the question has a method of its own in place of that of `Question`."""
        own, default = getattr(cls, name), getattr(Question, name)
        return getattr(own, "__func__", own) is not getattr(default, "__func__", default)


def certified_results(results: Any) -> list[Result]:
    """The certified results among what methods of a question see."""
    of_systems = results[0] if isinstance(results, tuple) else results
    return [*of_systems.values()] if isinstance(of_systems, Mapping) else [of_systems]


def check_attributes(question: type[Question], where: str) -> None:
    """Refuse tables that are none, tables and methods in each other's place, and names that nearly are of these."""
    known = {
        x for x in (*dir(Question), *Question.__annotations__, *dir(RunOptions)) if x[0] != "_"
    }
    for name, value in vars(question).items():
        if name[0] == "_" or name in declared(question):
            continue
        if name not in known:
            for near in get_close_matches(name, sorted(known), 1, 0.85):
                raise SetupError(f"{where}: {name} is no part of a question; did you mean {near}?")
        elif isfunction(getattr(Question, name, None)) and not callable(value):
            raise SetupError(
                f"{where}: {name} must be a method; the tables of a question are {', '.join(TABLES)}"
            )
    for name in getattr(question.method, "options", ()):
        if name not in declared(question):
            raise SetupError(
                f"{where}: by its method {question.__name__} must have an option {name!r}"
            )
    for name, kind in TABLES.items():
        table = vars(question).get(name, ())
        is_table = isinstance(table, Sequence) and not isinstance(table, str)
        if not (is_table or table is None or isinstance(table, property | cached_property)):
            raise SetupError(f"{where}: {name} must be a tuple, ({kind},) with its comma")


def check_colors_and_looks(question: type[Question], where: str) -> None:
    """Refuse a colour or look of a curve that there is not."""
    for chart in question.charts:
        for panel in chart.panels:
            try:
                for look in panel.looks(()):
                    hex_color(look.color)
            except ValueError as error:
                raise SetupError(f"{where}: panel {panel.quantity!r}: {error}") from error


def load(locator: str) -> type[Question]:
    """Return the question of a module, "scenarios.conveyor.run_up", or of a file, "mine.py".

    Raises
    ------
    SetupError
        For a file that does not exist, and for what is no question.
    QuestionError
        If the question's own code raises.
    """
    module = catalog.load_module(locator)
    try:
        question = read(module, locator)
        check_colors_and_looks(
            question, locator
        )  # not in `read`, of which the rows of studies make use
        return question
    except SetupError:
        catalog.unload(module)
        raise


def read(module: ModuleType, locator: str = "") -> type[Question]:
    """Return the question that a module contains; `locator` is its name in messages.

    Raises
    ------
    SetupError
        If it has none, or more than one, or if that lacks what a question must have.
    """
    where = locator or str(module.__file__)
    questions = [
        x
        for x in vars(module).values()
        if isinstance(x, type) and issubclass(x, Question) and x.__module__ == module.__name__
    ]
    if len(questions) != 1:
        raise SetupError(
            f"{where} must define one class that derives from workbench.Question, not {len(questions)}"
        )
    question = questions[0]
    for name in declared(question):
        if name in RESERVED_OPTIONS:
            raise SetupError(
                f"{where}: no option can be called {name!r}, since every question has one of that name"
            )
    if not isinstance(question.parts, Mapping):
        raise SetupError(f"{where}: parts must be a dict of FMUs by part")
    if not question.title:
        raise SetupError(f"{where} must begin with its question as a docstring")
    check_attributes(question, where)
    has_own = question.overrides("solve") or question.overrides("solve_all")
    if has_own or not isinstance(question.method, Run):
        return question
    if question.method.finer and question.figures is not Question.figures:
        raise SetupError(f"{where}: with finer runs, figures are numbers = (...)")
    if question.figures is Question.figures and not question.numbers:
        raise SetupError(
            f"{where}: {question.__name__} must have numbers, or define figures(self, r) or solve(self, context)"
        )
    is_run = issubclass(question, RunOptions) or question.run_options is not Question.run_options
    if not is_run and "step" not in declared(question):
        raise SetupError(
            f"{where}: {question.__name__} has figures of a run, which needs the options stop and step; write "
            f"class {question.__name__}(Question, RunOptions), or define run_options(self), which returns RunOptions(...)"
        )
    return question
