"""How a person's own function of a result gets its error: from three runs, and from fewer rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..dense import thinned_rows
from ..result import DerivedResult, Result, Rows
from .estimate import Estimate
from .extrapolation import (
    DIVERGED,
    after_widened,
    divergence,
)
from .limit import CONFIRMED_DISTANCE, likeliest
from .metric_error import (
    NO_ROWS,
    ROWS_FACTOR,
    SOME_RUNS,
    THINNED,
    band_error,
    spacing_error,
)
from .three_runs import ColumnRuns, ThreeRuns, not_converged

#: By how much of its width a peak is lowered at its begin and at its end: all of it or either end, derived: the top of
#: a plateau lies at one end of it.
TILTS = ((1.0, 1.0), (0.0, 1.0), (1.0, 0.0))

#: The extremes of a band: the highest and the lowest.
SIGNS = (1.0, -1.0)

#: A function from a result to numbers by name.
Function = Callable[[Result], Mapping[str, float]]


class ObservedResult(Result):
    """A result that notes which columns are read."""

    def __init__(self, result: Result) -> None:
        super().__init__(
            result.columns, result.provenance, lambda: result.data, breaks=result.breaks
        )
        self._rows, self._read = result, set[str]()

    def __getitem__(self, name: str) -> Rows:
        self._read.add(name)
        return self._rows[name]

    def columns_read(self) -> list[str]:
        """The columns asked for by name; all, if the rows were taken as a whole."""
        reads_all = "data" in vars(self) or not self._read
        return [name for name in self.names[1:] if reads_all or name in self._read]


@dataclass(frozen=True)
class _Numbers:
    """What a function makes of results.

    It is given all rows of the finest run, the rows of the three results, fewer of them, and rows with
    the extremes that gaps hide, or at a step of zero.
    """

    value: Mapping[str, float]
    runs: Sequence[Mapping[str, float]]
    fewer: Mapping[int, Sequence[Mapping[str, float]]]
    fewer_of_result: Mapping[int, Sequence[Mapping[str, float]]]
    sides: Sequence[Mapping[str, float]]
    limits: Sequence[Mapping[str, float]]


def function_errors(function: Function, runs: ThreeRuns) -> dict[str, Estimate]:
    """Estimate the numbers that a function makes of a result.

    It is called for each run with the rows of its result; for the finest one with all its rows; with every second and
    every third row of both. The error of the coupling follows from the three runs, that of the rows from the
    fewer ones: of all rows where the runs confirm the order, else of those of the results, since these may hide
    differences of the runs. What all rows change of the number counts, too, so that the error of a function that
    counts rows is large. Of the order only that of the columns is known that the function reads, see
    `likeliest`.

    A function of rows cannot look between them. It is therefore called again, at the times of all rows, with
    values extrapolated to a step of zero, with the extremes that the start and hidden events may have behind a row,
    and with peaks that are lower by what remains to a step of zero, so that another one may be the highest. Where trajectories have diverged, numbers that earlier rows alone do not
    give are refused. Where the function fails on any of these rows, all its numbers are refused, with the
    sentence of the exception.
    """
    observed = ObservedResult(runs.dense)
    value = dict(function(observed))
    columns = observed.columns_read()
    if reason := not_converged(runs, columns):
        return {name: Estimate(v, None, math.nan, reason=reason) for name, v in value.items()}
    of_runs = [function(result) for result in runs.results]
    try:
        sides, limits = _other_values(runs, columns)
        numbers = _Numbers(
            value,
            of_runs,
            {n: [function(r) for r in _thinned(runs.dense, n)] for n in THINNED},
            {n: [function(r) for r in _thinned(runs.finest, n)] for n in THINNED},
            [function(side) for side in sides],
            [function(limit) for limit in limits],
        )
    except Exception as error:  # noqa: BLE001 - whatever the function of a person raises
        reason = f"it cannot be computed from other rows: {error}"
        return {name: Estimate(v, None, math.nan, reason=reason) for name, v in value.items()}
    orders = sorted({runs.order(name) for name in columns} or {runs.order("")})
    diverged = after_divergence(function, runs.results, runs.ratio)
    return {
        name: Estimate(v, None, math.nan, reason=diverged[name])
        if name in diverged
        else _estimate(name, numbers, orders, runs.ratio)
        for name, v in value.items()
    }


def _estimate(name: str, numbers: _Numbers, orders: Sequence[float], ratio: float) -> Estimate:
    """The estimate of one number."""
    value = numbers.value[name]
    series = [run[name] for run in numbers.runs]
    order = float(likeliest(series, orders, ratio).order)
    coarse = _rows_share(name, series[0], numbers.fewer_of_result)
    rows = _rows_share(name, value, numbers.fewer)
    confirmed = any(abs(order - p) <= CONFIRMED_DISTANCE * p for p in orders)
    hidden = max(abs(side[name] - value) for side in numbers.sides)
    rows = max(rows, ROWS_FACTOR * hidden, abs(value - series[0]))
    rows = rows if confirmed else max(rows, coarse)
    if not math.isfinite(rows):
        return Estimate(value, None, order, reason=NO_ROWS)
    of_runs = likeliest(series, orders, ratio, [rows] * len(series))
    if not of_runs.is_stated:
        return Estimate(value, None, order, rows, of_runs.sentence())
    unshifted = [*(side[name] for side in numbers.sides), *(value for _ in (*TILTS, *SIGNS))]
    shift = max(abs(limit[name] - v) for limit, v in zip(numbers.limits, unshifted))
    if math.isnan(shift):
        return Estimate(value, None, order, rows, SOME_RUNS)
    shift = shift if shift > rows else 0.0  # to the next row, which the rows' share has
    return Estimate(value, band_error(float(of_runs.error) - rows, shift) + rows, order, rows)


def _rows_share(
    name: str, value: float, fewer: Mapping[int, Sequence[Mapping[str, float]]]
) -> float:
    """The error of a number due to the spacing of the rows, from its values with fewer of them."""
    changes = (max(abs(other[name] - value) for other in fewer[n]) for n in THINNED)
    return ROWS_FACTOR * spacing_error(*changes)


def _other_values(runs: ThreeRuns, columns: Sequence[str]) -> tuple[list[Result], list[Result]]:
    """All rows with the extremes that gaps hide, high and low; these at a step of zero, and with lower peaks.

    Their columns are made when a function asks for them.
    """
    solutions = {name: runs.column(name, keep_rows=True) for name in columns}

    def with_values(change: Callable[[ColumnRuns], Rows]) -> Result:
        """The finest run with other values in the columns that the function reads."""
        return DerivedResult(
            runs.dense,
            lambda name: change(solutions[name]) if name in solutions else runs.dense[name],
        )

    def lowered(tilt: tuple[float, float]) -> Callable[[ColumnRuns], Rows]:
        return lambda c: (
            c.finest.with_top_lowered(c.band.width.x, *tilt) if c.band else c.finest.x.copy()
        )

    def started(sign: float) -> Callable[[ColumnRuns], Rows]:
        return lambda c: (
            c.finest.with_start_extreme(c.band.width.x, sign) if c.band else c.finest.x.copy()
        )

    def hidden(sign: float) -> Callable[[ColumnRuns], Rows]:
        return lambda c: c.finest.with_extremes(sign)

    def limit(sign: float) -> Callable[[ColumnRuns], Rows]:
        return lambda c: (c.band.solution if c.band else c.finest).with_extremes(sign)

    sides = [with_values(hidden(sign)) for sign in SIGNS]
    limits = [with_values(limit(sign)) for sign in SIGNS]
    limits += [with_values(lowered(tilt)) for tilt in TILTS]
    limits += [with_values(started(sign)) for sign in SIGNS]
    return sides, limits


def _thinned(result: Result, n: int) -> Iterator[Result]:
    """The result with the rows first, first + n, ..., and the ends, for each first row."""
    t = result["time"]
    for first in range(n):
        indices = np.flatnonzero(thinned_rows(t, n, first))
        yield DerivedResult(result, lambda name, indices=indices: result[name][indices])  # type: ignore[misc]


def _with_rows(result: Result, rows: Rows) -> Result:
    return Result(result.columns, result.provenance, lambda: rows, breaks=result.breaks)


def after_divergence(
    function: Callable[[Result], Mapping[str, Any]],
    results: Sequence[Result],
    ratio: float,
) -> dict[str, str]:
    """The values that need rows after the runs have diverged, each with the reason why it is refused.

    Parameters
    ----------
    function : callable
        Makes values by name of a result.
    results : sequence of three results
        The runs, the finest first. A value that does not need the later rows is the same with those of the second
        run in their place, and with rows that are further from their middle.
    ratio : float
        The ratio of the steps of two runs.
    """
    held = [k for k, each in enumerate(results[0].columns) if each.kind.is_held]
    begin, is_diverged = divergence([result.data for result in results], ratio, held)
    if not is_diverged.any():
        return {}
    observed = ObservedResult(results[0])
    values = function(observed)
    names = results[0].names
    if not any(is_diverged[names.index(name)] for name in observed.columns_read()):
        return {}
    reason = f"{DIVERGED} from {begin:.4g} s on"
    finest, second = results[0].data, results[1].data
    swapped = np.vstack([finest[finest[:, 0] < begin], second[second[:, 0] >= begin]])
    widened = finest.copy()
    widened[:, is_diverged] = after_widened(finest[:, 0], finest[:, is_diverged], begin)
    alternatives: list[Mapping[str, Any]] = []
    for rows in (swapped, widened):
        try:
            alternatives.append(function(_with_rows(results[0], rows)))
        except Exception:  # noqa: BLE001 - it depends on which of the rows it gets
            alternatives.append({})
    return {
        name: reason
        for name, value in values.items()
        if any(alternative.get(name) != value for alternative in alternatives)
    }
