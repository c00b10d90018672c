"""What a question is: a class whose fields are its options, and whose methods have defaults.

An instance is the question as it is asked, with a value for each option.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, Self, dataclass_transform

from cosim import Result, SetupError, System

from . import catalog
from .answer import Findings, Show, Table
from .figure import ERROR_SCOPE, Figure, checked
from .judgement import Judgement
from .options import Options, Run, declared, option, parse_options

if TYPE_CHECKING:
    from .context import Context
    from .live import Live

#: Names that the command line takes for every question.
RESERVED_OPTIONS = ("help", "start", "flavour", "jobs", "scheduler", "out", "animate")


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(option,))
class Question(Options):
    """A question, asked with the values of its options, which are its fields.

    A question of certified runs defines `figures`, and `system` where it sets start values; it derives from `Run` as
    well, or defines `run`. Any other question defines `solve`.

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
        cls.locator, cls.own_files = catalog.locator(cls.module), catalog.files(cls.module)

    @classmethod
    def parse(cls, options: Mapping[str, Any]) -> Self:
        """Return the question with these values; raises SetupError for what they cannot be."""
        return parse_options(cls, options, cls.name)

    def system(self, fmus: Mapping[str, Path]) -> System | Mapping[str, System]:
        """Return the system, or several by name, each of which is run and certified."""
        return System(dict(fmus), self.wires, self.start)

    def run(self) -> Run:
        """Return stop, step and algorithm of the certified runs."""
        run: Any = self
        return run  # type: ignore[no-any-return]

    def process(self, result: Result) -> Result:
        """Return a result with further columns, or only some of its rows, for figures, tables and charts."""
        return result

    def figures(self, result: Result) -> Mapping[str, Figure]:
        """Return the figures of one run.

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
        """Return charts and motions."""
        return Show()

    def live(self, figures: Mapping[str, Figure], results: Any) -> Live | None:
        """Return the live part of the page."""
        return None

    def solve(self, context: Context) -> Findings:
        """Run and certify every system, and collect figures, tables and files."""
        systems = self.system(context.fmus)
        by_name = {"": systems} if isinstance(systems, System) else systems
        figures: dict[str, Figure] = {}
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

        def figures(result: Result) -> Mapping[str, Figure]:
            return checked(self.figures(self.process(result)), self.path)

        result, certified = context.certify(system, figures, self.run(), self.record, csv)
        return self.process(result), certified


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
        return read(module, locator)
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
    prefix = locator or str(module.__file__)
    questions = [
        x
        for x in vars(module).values()
        if isinstance(x, type) and issubclass(x, Question) and x.__module__ == module.__name__
    ]
    if len(questions) != 1:
        raise SetupError(
            f"{prefix} must define one class that derives from workbench.Question, not {len(questions)}"
        )
    question = questions[0]
    for name in declared(question):
        if name in RESERVED_OPTIONS:
            raise SetupError(
                f"{prefix}: no option can be called {name!r}, since every question has one of that name"
            )
    if not isinstance(question.parts, Mapping):
        raise SetupError(f"{prefix}: parts must be a dict of FMUs by part")
    if not question.title:
        raise SetupError(f"{prefix} must begin with its question as a docstring")
    if question.solve is not Question.solve:
        return question
    if question.figures is Question.figures:
        raise SetupError(
            f"{prefix}: {question.__name__} must define figures(self, r), or solve(self, context)"
        )
    is_run = issubclass(question, Run) or question.run is not Question.run
    if not is_run and "step" not in declared(question):
        raise SetupError(
            f"{prefix}: with figures, {question.__name__} must derive from workbench.Run as well, or its run(self) "
            "return one"
        )
    return question
