"""How a person's own function of a result gets its error: from three runs, and from fewer rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from ..result import Result, Rows
from .estimate import Estimate
from .extrapolation import DIVERGED, divergence, estimate
from .metric_error import NO_ROWS, ROWS_FACTOR, THINNED, spacing_error
from .three_runs import ThreeRuns

#: A function from a result to numbers by name.
Function = Callable[[Result], Mapping[str, float]]


class _ObservedResult(Result):
    """A result that notes which columns are read."""

    def __init__(self, result: Result) -> None:
        super().__init__(result.columns, result.units, result.provenance, lambda: result.data)
        self._rows, self._read = result, set[str]()

    def __getitem__(self, name: str) -> Rows:
        self._read.add(name)
        return self._rows[name]

    def columns_read(self) -> list[str]:
        """The columns asked for by name; all, if the rows were taken as a whole."""
        whole = "data" in vars(self) or not self._read
        return [name for name in self.columns[1:] if whole or name in self._read]


def function_errors(function: Function, runs: ThreeRuns) -> dict[str, Estimate]:
    """Estimate the numbers that a function makes of a result.

    It is called for each run with the rows of its result, for the finest one with all its rows, and with every
    second and every third of those: nothing else than rows that a run had. The error of the coupling follows from
    the three runs, that of the rows from the fewer ones. Of the order only that of the columns is known
    that the function reads; the lowest of them counts unless the order observed is another one of them. If
    trajectories have diverged, numbers that earlier rows alone do not give are refused. Where the function
    fails on fewer rows, all its numbers are, with the sentence of the exception.
    """
    observed = _ObservedResult(runs.dense)
    values = dict(function(observed))
    columns = observed.columns_read()
    coupled = [function(result) for result in runs.results]
    orders = sorted({runs.order(name) for name in columns} or {runs.order("")})
    try:
        thinned = {n: [function(r) for r in _thinned(runs.dense, n)] for n in THINNED}
    except Exception as error:  # whatever the function of a person raises
        reason = f"it cannot be computed from fewer rows: {error}"
        return {name: Estimate(v, None, math.nan, reason=reason) for name, v in values.items()}
    diverged = _diverged(function, runs, values, columns)
    estimates = {}
    for name, value in values.items():
        changes = (max(abs(others[name] - value) for others in thinned[n]) for n in THINNED)
        rows = ROWS_FACTOR * spacing_error(*changes)
        series = [numbers[name] for numbers in coupled]
        coupling = estimate(series, _nearest_order(series, orders, runs.ratio), runs.ratio)
        estimates[name] = (
            Estimate(value, None, math.nan, reason=diverged[name])
            if name in diverged
            else _add_rows(coupling._replace(value=value), series, rows)
        )
    return estimates


def _nearest_order(values: Sequence[float], orders: Sequence[float], ratio: float) -> float:
    """The order of the columns that is nearest to the one observed; the lowest if none is."""
    observed = estimate(values, orders[0], ratio).order
    if not math.isfinite(observed):
        return orders[0]
    return min(orders, key=lambda p: abs(p - observed) / p)


def _add_rows(coupling: Estimate, values: Sequence[float], rows: float) -> Estimate:
    """The estimate with the error due to the rows added.

    Where the runs differ by no more than that, their differences show no order and count as an error.
    """
    if not math.isfinite(rows):
        return coupling._replace(error=None, reason=NO_ROWS)
    spread = max(values) - min(values)
    if coupling.error is None and spread <= 2.0 * rows:
        return coupling._replace(error=spread + rows, rows=rows)
    if coupling.error is None:
        return coupling
    return coupling._replace(error=coupling.error + rows, rows=rows)


def _thinned(result: Result, n: int) -> Iterator[Result]:
    """The result with the rows first, first + n, ..., and the ends, for each first row."""
    count = len(result.data)
    for first in range(n):
        kept = np.unique([0, *range(first, count, n), count - 1])
        yield _with_rows(result, result.data[kept])


def _with_rows(result: Result, rows: Rows) -> Result:
    return Result(result.columns, result.units, result.provenance, lambda: rows)


def _diverged(
    function: Function, runs: ThreeRuns, values: Mapping[str, float], columns: Sequence[str]
) -> dict[str, str]:
    """The numbers that need rows after the runs have diverged, each with the reason why it is refused."""
    begin, is_diverged = divergence([result.data for result in runs.results], runs.ratio)
    names = runs.finest.columns
    if not any(is_diverged[names.index(name)] for name in columns):
        return {}
    reason = f"{DIVERGED} from {begin:.4g} s on"
    early = runs.all_rows[runs.all_rows[:, 0] < begin]
    try:
        before = function(_with_rows(runs.finest, early))
    except Exception:  # it needs the later rows
        before = {}
    return {name: reason for name, value in values.items() if before.get(name) != value}
