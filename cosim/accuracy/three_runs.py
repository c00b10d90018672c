"""Three runs of a system whose steps, or tolerances, differ by one ratio, and a column of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..dense import DenseSolution
from ..engine.control import Adaptive
from ..engine.row_file import StoredRows
from ..result import DerivedResult, Result
from ..scratch import scratch
from ..system import System
from .extrapolation import (
    COLUMN_NOT_CONVERGED,
    RUNS,
    TOLERANCE_RATIO,
    ErrorBand,
    error_band,
    slow_order,
)
from .limit import STEP_RATIO


@dataclass(frozen=True)
class ColumnRuns:
    """A column in three runs, the finest first, on the rows of their results, and on all rows of the finest.

    `order` is the convergence order of the column and `ratio` that of the steps of two runs.
    """

    finest: DenseSolution
    solutions: Sequence[DenseSolution]
    band: ErrorBand | None
    order: float
    ratio: float = STEP_RATIO


@dataclass(frozen=True)
class ThreeRuns:
    """The results of three runs, the finest first, and the finest one with all its rows, `dense`."""

    results: Sequence[Result]
    dense: Result
    ratio: float

    @property
    def finest(self) -> Result:
        """The result of the finest run."""
        return self.results[0]

    def order(self, column: str) -> float:
        """The convergence order of a column, in the step or in the tolerance.

        Adaptive steps keep the error per time, h^p, within the tolerance: it has order 1 in that, and an output that
        converges with order 1 in h has 1 / p.
        """
        provenance = self.finest.provenance
        order = float(provenance["convergence_order"])
        is_first = column in provenance.get("first_order", ())
        if self.ratio == TOLERANCE_RATIO:
            return 1.0 / order if is_first else 1.0
        return 1.0 if is_first else order

    def column(self, name: str, *, keep_rows: bool = False) -> ColumnRuns:
        """A column of the three runs, with all rows or without those that say nothing new."""
        t, x, kind = self.dense["time"], self.dense[name], self.dense.column(name).kind
        make = DenseSolution if keep_rows else DenseSolution.from_rows
        finest = make(t, x, kind, self.dense.breaks)
        runs = [(r["time"], r[name]) for r in self.results]
        order = self.order(name)
        band = error_band(finest, runs, order, self.ratio)
        return ColumnRuns(finest, [r.solution(name) for r in self.results], band, order, self.ratio)


def not_converged(runs: ThreeRuns, columns: Sequence[str]) -> str:
    """Why no number of these columns is known: one of them has an error that falls too slowly; else nothing."""
    for name in columns:
        rows = [(r["time"], r[name]) for r in runs.results]
        if not runs.finest.column(name).kind.is_held:
            order = slow_order(rows, runs.ratio)
            if order is not None:
                return COLUMN_NOT_CONVERGED.format(name, order)
    return ""


@contextmanager
def three_runs(
    system: System, step: float | Adaptive, runner: Callable[..., Result], settings: dict[str, Any]
) -> Iterator[ThreeRuns]:
    """Run with the step, a half and a quarter of it, or the tolerance, a tenth and a hundredth.

    Rows are `step` apart in all runs unless the settings, which are those of `run`, say otherwise. Only the last
    run gets `csv`. Its rows at all communication points are in a file until the context ends.
    """
    progress = settings.pop("progress", None) or (lambda _: None)
    csv = settings.pop("csv", None)
    if isinstance(step, Adaptive):
        ratio = TOLERANCE_RATIO
        steps: list[Any] = [replace(step, tolerance=step.tolerance / ratio**k) for k in range(RUNS)]
    else:
        ratio = STEP_RATIO
        steps = [step / ratio**k for k in range(RUNS)]
        settings = {"output_step": step} | settings
    results: list[Result] = []
    with TemporaryDirectory(dir=scratch(), ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "rows"
        for k, h in enumerate(steps):
            begin, end = ((ratio**n - 1) / (ratio**RUNS - 1) for n in (k, k + 1))
            last: dict[str, Any] = {}
            if k == RUNS - 1:
                last = {"all_rows": path} | ({} if csv is None else {"csv": csv})
            report = partial(_report, progress, begin, end)
            result = runner(system, step=h, **settings, progress=report, **last)
            len(result.data)  # read now: the next run may write the same file
            results.insert(0, result)
        finest = results[0]
        dense = finest
        if path.exists():
            rows = StoredRows(path, len(finest.columns))
            dense = DerivedResult(finest, lambda name: rows.column(finest.names.index(name)))
        yield ThreeRuns(results, dense, ratio)


def _report(progress: Callable[[float], None], begin: float, end: float, fraction: float) -> None:
    """Report the progress of all runs from that of one."""
    progress(begin + fraction * (end - begin))
