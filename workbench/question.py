"""What a question is: a class whose fields are its options, and whose methods have defaults.

An instance is the question as it is asked, with a value for each option.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from inspect import isfunction
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, Self, dataclass_transform

from cosim import Result, SetupError, System
from cosim.metrics import Metric
from cosim.system import connect

from . import catalog
from .answer import Findings, Show, Table, parameters
from .charts.style import hex_color
from .dimensions import check_unit, conversion, known_units
from .figure import (
    ERROR_SCOPE,
    Figure,
    NamedFigures,
    checked_figures,
    figure_of_figures,
    scaled,
)
from .formula import DOTTED, Formula, with_formulas
from .judgement import Judgement
from .live import Formulas, Live, LiveMotion, Number, Reader, RunChart, Slider, drawn, moved
from .live.declare import UNIT_OF_COLUMN
from .options import Options, RunOptions, declared, option, unknown_option

if TYPE_CHECKING:
    from .context import Context

#: Names that the command line takes for every question.
RESERVED_OPTIONS = ("help", "start", "flavour", "jobs", "scheduler", "out", "animate")
#: The tables of a question, and what each contains.
TABLES = {
    "wires": '"a.w -> b.w"', "fixed_starts": '"a.w"', "record": '"a.w"', "decisive": '"figure"',
    "numbers": "Number(...)", "charts": "RunChart(...)", "sliders": "Slider(...)",
}  # fmt: skip


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
        if "solve" in vars(cls) and "is_sequential" not in vars(cls):
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
        """Return what the answer claims, first what decides it."""
        return ()

    def show(self, figures: Mapping[str, Figure], results: Any) -> Show:
        """Return charts and motions, by default those of `charts` and of `motion`."""
        shown, moving = certified_results(results), self.motion(figures, results)
        charts = [drawn(chart, shown, self, figures) for chart in self.charts]
        return Show(charts, [moved(moving, shown[0])] if moving else [])

    def motion(self, figures: Mapping[str, Figure], results: Any) -> LiveMotion | None:
        """Return the mechanism in motion, for picture and live page."""
        return None

    def live(self, figures: Mapping[str, Figure], results: Any) -> Live | None:
        """Return the live part of the page, by default `page` where there are `sliders`."""
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
        """Run and certify every system, and collect figures, tables and files."""
        systems = self.system(context.fmus)
        by_name = {"": systems} if isinstance(systems, System) else systems
        self._require_starts(by_name.values())
        figures = NamedFigures()
        certified: dict[str, Result] = {}
        for name, system in by_name.items():
            certified[name], of_run = self._certify(system, context, f"{name or self.name}.csv")
            label = self.labels.get(name, name)
            figures |= {
                f"{name}_{key}" if name else key: x._replace(meaning=f"{x.meaning}, {label}")
                if name
                else x
                for key, x in of_run.items()
            }
        tables = {f"{x or self.name}.csv": Table.of(r) for x, r in certified.items()}
        results: Any = certified.get("", certified)
        if (more := self.more_runs(context, systems)) is not None:
            results = (results, more)
        figures |= self.more_figures(figures, results)
        return Findings(
            figures,
            results,
            next(iter(by_name.values())),
            next(iter(certified.values())).provenance,
            tables=tables | dict(self.tables(figures, results)),
            files=self.files(results),
            warnings=list(
                dict.fromkeys(
                    f"nothing drives or sets the input {name}, which stays at {value:g}; add a wire, or give it in start_values"
                    for result in certified.values()
                    for name, value in result.provenance.get("open_inputs", {}).items()
                )
            ),
        )

    def _require_starts(self, systems: Collection[System]) -> None:
        """Refuse a system that lacks start values of the user, or of the question."""
        for name in (*self.start, *self.start_values):
            is_given, part = name in self.start, name.partition(".")[0]
            for system in [x for x in systems if part in x.parts] or systems:
                is_there = name in system.start or (not is_given and name in system.inputs)
                if not is_there or (is_given and system.start[name] != self.start[name]):
                    raise SetupError(
                        f"{'--start' if is_given else f'{self.path}: start_values:'} {name}: system() does not pass it "
                        "on; write replace(super().system(fmus), changes=[...])"
                    )

    @classmethod
    def solve_all(cls, context: Context, questions: Sequence[Self]) -> list[Findings | SetupError]:
        """Return what each of several cases finds, or why it is refused; by default one after the other.

        A question whose runs are arrays of members does those of all cases together, and sets `at_once`.
        """
        return [question.solve(context) for question in questions]

    def _certify(
        self, system: System, context: Context, csv: str
    ) -> tuple[Result, dict[str, Figure]]:
        """Return the result of a system, processed, and its figures with their errors."""
        results: list[Result] = []
        has_columns = self.process.__func__ is not Question.process  # type: ignore[attr-defined]
        texts: dict[str, str] = {}
        for x in self.numbers:
            if isinstance(x.value, Reader):
                is_of_column = x.value.kind in UNIT_OF_COLUMN
                texts.setdefault(x.value.column, x.unit if is_of_column else "1")
        given = parameters(system) if self.numbers else {}
        numbers = {n: float(x.value) for n, x in given.items() if isinstance(x.value, int | float)}
        values = {**numbers, **self.values}
        metrics: dict[str, Metric] = {}
        for x in self.numbers:
            if isinstance(x.value, Reader | Metric):
                value = x.value.metric(values) if isinstance(x.value, Reader) else x.value
                metrics[x.name] = value

        def derive(result: Result) -> Result:
            results.append(self.process(result))
            return with_formulas(results[-1], texts, values)

        def figures(result: Result) -> Mapping[str, Figure]:
            return checked_figures(self.figures(result), self.path, may_await_error=True)

        has_formulas = any(DOTTED.fullmatch(text) is None for text in texts)
        own = {} if type(self).figures is Question.figures else {"figures": figures}
        result, certified = context.certify(
            system, {**metrics, **own}, self.run_options(), self._recorded(system), csv,
            derive=derive if has_columns or has_formulas else None,
        )  # fmt: skip
        units = (results[0] if results else result).units
        for x in self.numbers:
            figure = certified[x.name] if x.name in metrics else follows(x, certified, values)
            known = known_units(self, certified, given, units)
            certified[x.name] = self._as_declared(x, figure, known)
        return results[0] if results else result, certified

    def _recorded(self, system: System) -> Sequence[str] | None:
        """Return the columns of `record`, and the outputs that numbers and charts use besides."""
        if self.record is None:
            return None
        used = [chart.x for chart in self.charts]
        used += [text for chart in self.charts for panel in chart.panels for text in panel.curves]
        for x in self.numbers:
            if isinstance(x.value, Reader):
                used += [x.value.column, *[x.value.angle] * bool(x.value.angle)]
        names = {name: None for text in used for name in sorted(Formula.read(text).names)}
        outputs = {
            f"{part}.{x.name}"
            for part, description in connect(system).descriptions.items()
            for x in description.modelVariables
            if x.causality == "output"
        }
        return [*dict.fromkeys((*self.record, *(x for x in names if x in outputs)))]

    def _as_declared(self, x: Number, figure: Figure, units: Mapping[str, str]) -> Figure:
        """Return the figure of a number with its meaning, in its unit, from one in that of a column."""
        where = f"{self.path}: number {x.name!r}"
        try:
            meaning = x.meaning.format(**vars(self))
        except LookupError as error:
            raise SetupError(
                f"{self.path}: the meaning of {x.name!r} names {error}, no option"
            ) from error
        except ValueError as error:
            raise SetupError(f"{self.path}: the meaning of {x.name!r}: {error}") from error
        factor: float = 1.0
        formula: str | float | None = None
        if isinstance(x.value, Reader):
            is_alone = DOTTED.fullmatch(x.value.column) is not None
            own = units.get(x.value.column, "") * is_alone
            factor = x.value.factor(own, x.unit, where)
            check_unit(x.value.level, own, units, f"{where}: level")
            if not is_alone and x.value.kind in UNIT_OF_COLUMN:
                formula = x.value.column
        elif not isinstance(x.value, Metric):
            formula = x.value
        else:
            factor = conversion(figure.unit, x.unit or figure.unit, where)
        stated = x.unit or figure.unit
        if formula is not None and (unknown := check_unit(formula, stated, units, where)):
            logging.getLogger("cosim").warning(
                f"number {x.name!r} is in {stated} as stated: the unit of {', '.join(unknown)} is not known"
            )
        return scaled(figure, factor, stated, meaning)


def follows(number: Number, figures: Mapping[str, Figure], values: Mapping[str, float]) -> Figure:
    """Return the figure of a formula, `figures.speed / 2`, see `figure_of_figures`."""
    known = {f"figures.{name}": x for name, x in figures.items()}
    formula = Formula.read(number.value)
    used = sorted(formula.names & known.keys())
    at = {**values, **{name: x.value for name, x in known.items()}}
    return figure_of_figures(
        lambda *x: formula.over({**at, **dict(zip(used, x))}),
        *(known[name] for name in used),
        unit=number.unit or "1",
    )


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
    if question.solve is not Question.solve:
        return question
    if question.figures is Question.figures and not question.numbers:
        raise SetupError(
            f"{where}: {question.__name__} must have numbers, or define figures(self, r) or solve(self, context)"
        )
    is_run = issubclass(question, RunOptions) or question.run_options is not Question.run_options
    if not is_run and "step" not in declared(question):
        raise SetupError(
            f"{where}: with figures, {question.__name__} must derive from workbench.RunOptions as well, or its run_options(self) "
            "return one"
        )
    return question
