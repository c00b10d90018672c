"""The simple form of a question: a system and its figures; the workbench does the runs and states the errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim import Result, System

from .answer import Findings, Table
from .figure import Figure, check_figures
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
        Returns the figures of one run. Those of several systems get the name of their system in front.
    run : function of options
        Returns stop, step and algorithm where the options do not have them.
    process : function of options and result
        Returns the result with further columns, or only some of its rows. Figures, tables and charts then
        see that.
    more_figures : function of options, certified figures and results
        Returns figures that follow from these, or from formulas, with their errors.
    tables : function of options, figures and results
        Returns further tables by file name.
    record : sequence of str, or None
        The columns to record, by default all.
    """

    path: Path
    system: Callable[[Any, Mapping[str, Path]], System | Mapping[str, System]]
    figures: Callable[[Any, Result], Mapping[str, Figure]]
    run: Callable[[Any], Run] = _options_as_run
    process: Callable[[Any, Result], Result] = _as_recorded
    more_figures: Callable[[Any, Mapping[str, Figure], Any], Mapping[str, Figure]] = _no_figures
    tables: Callable[[Any, Mapping[str, Figure], Any], Mapping[str, Table]] = _no_tables
    record: Any = None

    def solve(self, o: Any, context: Context) -> Findings:
        """Run and certify every system, and collect figures and tables."""
        systems = self.system(o, context.fmus)
        if isinstance(systems, System):
            result, figures = self._certify(systems, o, context, f"{self.path.stem}.csv")
            return self._findings(o, figures, result, {self.path.stem: result}, systems)
        figures, results = {}, {}
        for name, system in systems.items():
            csv = f"{self.path.stem}_{name}.csv"
            results[name], of_run = self._certify(system, o, context, csv)
            figures |= {
                f"{name}_{key}": figure._replace(meaning=f"{figure.meaning}, {name}")
                for key, figure in of_run.items()
            }
        tables = {f"{self.path.stem}_{name}": result for name, result in results.items()}
        return self._findings(o, figures, results, tables, next(iter(systems.values())))

    def _certify(
        self, system: System, o: Any, context: Context, csv: str
    ) -> tuple[Result, dict[str, Figure]]:
        """Return the result of a system, processed, and its figures with their errors."""

        def figures(result: Result) -> Mapping[str, Figure]:
            computed = self.figures(o, self.process(o, result))
            check_figures(computed, self.path)
            return computed

        result, certified = context.certify(system, figures, self.run(o), self.record, csv)
        return self.process(o, result), certified

    def _findings(
        self,
        o: Any,
        figures: dict[str, Figure],
        results: Any,
        tables: Mapping[str, Result],
        system: System,
    ) -> Findings:
        """Add what follows from the certified figures."""
        figures = figures | dict(self.more_figures(o, figures, results))
        csv = {f"{name}.csv": Table.of(result) for name, result in tables.items()}
        return Findings(
            figures,
            results,
            system,
            next(iter(tables.values())).provenance,
            tables=csv | dict(self.tables(o, figures, results)),
        )
