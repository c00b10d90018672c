"""The simple form of a question: a system and its figures; the workbench does the runs and states the errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim import Result, System

from .answer import Findings, Table
from .figure import Figure, checked
from .options import Run

if TYPE_CHECKING:
    from .context import Context

#: The result of a run; for several systems their results by name.
Results = Result | Mapping[str, Result]


def _options_as_run(o: Any) -> Run:
    """Take stop, step and algorithm from the options themselves."""
    run: Run = o
    return run


def _as_recorded(o: Any, result: Result) -> Result:
    """Take a result as it was recorded."""
    return result


def _no_figures(o: Any, figures: Mapping[str, Figure], results: Any) -> Mapping[str, Figure]:
    """Add no figures."""
    return {}


def _no_tables(o: Any, figures: Mapping[str, Figure], results: Any) -> Mapping[str, Table]:
    """Add no tables."""
    return {}


def _no_files(o: Any, results: Any) -> Mapping[str, Callable[[Path], object]]:
    """Write no files of its own."""
    return {}


@dataclass(frozen=True, kw_only=True)
class SimpleForm:
    """The functions of a question without `solve`; all but `system` and `figures` have defaults.

    Attributes
    ----------
    path : Path
        The file of the question; its table is called like it.
    system : function of options and FMUs
        Returns the system, or several by name, each of which is run and certified.
    figures : function of options and result
        Returns the figures of one run. Those of several systems get the name of their system in front, and in
        their meaning what `labels` calls it.
    run : function of options
        Returns stop, step and algorithm where the options do not have them.
    process : function of options and result
        Returns the result with further columns, or only some of its rows. Figures, tables and charts then
        see that.
    more_runs : function of options, context and system, or None
        Does further runs, such as a sweep, once the system is certified. The results that functions see are
        then a pair: what was certified, and what this returned.
    more_figures : function of options, certified figures and results
        Returns figures that follow from these, or from formulas, with their errors.
    tables : function of options, figures and results
        Returns further tables by file name.
    files : function of options and results
        Returns by file name functions that write a further file to a path.
    record : sequence of str, or None
        The columns to record, by default all.
    labels : mapping
        What several systems are called in the meaning of their figures, by default their names.
    """

    path: Path
    system: Callable[[Any, Mapping[str, Path]], System | Mapping[str, System]]
    figures: Callable[[Any, Result], Mapping[str, Figure]]
    run: Callable[[Any], Run] = _options_as_run
    process: Callable[[Any, Result], Result] = _as_recorded
    more_figures: Callable[[Any, Mapping[str, Figure], Any], Mapping[str, Figure]] = _no_figures
    more_runs: Callable[[Any, Context, Any], Any] | None = None
    tables: Callable[[Any, Mapping[str, Figure], Any], Mapping[str, Table]] = _no_tables
    files: Callable[[Any, Any], Mapping[str, Callable[[Path], object]]] = _no_files
    record: Any = None
    labels: Mapping[str, str] = field(default_factory=dict)

    def solve(self, o: Any, context: Context) -> Findings:
        """Run and certify every system, and collect figures, tables and files."""
        systems = self.system(o, context.fmus)
        by_name = {"": systems} if isinstance(systems, System) else systems
        figures: dict[str, Figure] = {}
        certified: dict[str, Result] = {}
        for name, system in by_name.items():
            csv = f"{name or self.path.stem}.csv"
            certified[name], of_run = self._certify(system, o, context, csv)
            figures |= self._named(name, of_run) if name else of_run
        tables = {f"{x or self.path.stem}.csv": Table.of(r) for x, r in certified.items()}
        results: Any = certified.get("", certified)
        if self.more_runs:
            results = (results, self.more_runs(o, context, systems))
        figures |= self.more_figures(o, figures, results)
        return Findings(
            figures,
            results,
            next(iter(by_name.values())),
            next(iter(certified.values())).provenance,
            tables=tables | dict(self.tables(o, figures, results)),
            files=self.files(o, results),
        )

    def _named(self, name: str, figures: Mapping[str, Figure]) -> dict[str, Figure]:
        """Return figures with the name of their system."""
        label = self.labels.get(name, name)
        return {
            f"{name}_{key}": figure._replace(meaning=f"{figure.meaning}, {label}")
            for key, figure in figures.items()
        }

    def _certify(
        self, system: System, o: Any, context: Context, csv: str
    ) -> tuple[Result, dict[str, Figure]]:
        """Return the result of a system, processed, and its figures with their errors."""

        def figures(result: Result) -> Mapping[str, Figure]:
            return checked(self.figures(o, self.process(o, result)), self.path)

        result, certified = context.certify(system, figures, self.run(o), self.record, csv)
        return self.process(o, result), certified
