"""The columns of three runs in all the forms that decide an error, each made once for all columns and metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from ..dense import MOST_POINTS, Array, Curves, Side, separate, thinned_rows
from ..result import Result
from .limit import RUNS
from .nested import NestedRuns
from .trajectories import (
    Divergence,
    ErrorBand,
    error_band,
    relaxes_within_a_step,
    shared_rows,
    too_slow_orders,
)

#: Every second and every third row are left: the smallest numbers without a common factor.
THINNED = (2, 3)
#: Times that the width of a settled column has its rounding: derived, as noise, as the least error, and once more.
ROUNDINGS = 3.0
#: Runs that have not diverged.
NOWHERE = Divergence()


def rows_of(result: Result, names: Sequence[str]) -> Array:
    """Columns of a result, shape (columns, rows)."""
    return np.array([result[name] for name in names], dtype=np.float64)


class ColumnForms:
    """Columns of three runs, all continuous or all held: their curves on common rows, and those of the finest run."""

    def __init__(self, names: Sequence[str], forms: Forms) -> None:
        self.names, self.runs, self._forms = names, forms.runs, forms
        self.orders = np.array([self.runs.nominal_order(name) for name in names])
        self.is_held = self.runs.finest.column(names[0]).kind.is_held

    def _of(self, result: Result, breaks: Array) -> Curves:
        return Curves.of_rows(
            result["time"], rows_of(result, self.names), is_held=self.is_held, breaks=breaks
        )

    @cached_property
    def of_runs(self) -> Sequence[Curves]:
        """The curves of each run, on the rows that all of them have if these are enough.

        Columns that hold their values have those of each run's own rows, since the common ones hide when they change.
        """
        results, common = self.runs.results, self._forms.common
        if common is None or self.is_held:
            return [self._of(result, result.breaks) for result in results]
        return [
            Curves.of_rows(r["time"][rows], x, breaks=results[-1].breaks)
            for r, rows, x in zip(results, common, self._shared)
        ]

    @cached_property
    def finest(self) -> Curves:
        """The finest run."""
        dense = self.runs.dense
        if not self._forms.keep_rows:
            return self._of(dense, dense.breaks)
        rows = rows_of(dense, self.names)
        return Curves(dense["time"], rows, is_held=self.is_held, breaks=dense.breaks)

    @cached_property
    def _shared(self) -> Sequence[Array]:
        """The values of each run at the times that all have, shape (columns, times).

        Where they are less than half of the coarsest run's times, the finer ones are interpolated to those.
        """
        results, common = self.runs.results, self._forms.common
        if common is not None:
            return [rows_of(r, self.names)[:, rows] for r, rows in zip(results, common)]
        times = separate(results[-1]["time"])
        finer = [Curves.of_rows(r["time"], rows_of(r, self.names))(times) for r in results[:-1]]
        return [*finer, rows_of(results[-1], self.names)]

    @cached_property
    def band(self) -> ErrorBand | None:
        """What remains to a step of zero; None for what holds its values, or without a run whose step is another."""
        if self.is_held or len(self.runs.results) <= 1 or not self.runs.steps_differ_enough:
            return None
        return error_band(
            self.finest, self._forms.times, self._shared, self.orders, self.runs.ratio,
            is_regular=self._forms.is_regular,
        )  # fmt: skip

    @cached_property
    def width(self) -> Curves:
        """By how much the finest run may be off."""
        assert self.band is not None
        return self.band.width

    @cached_property
    def at_zero(self) -> Curves:
        """The finest run extrapolated to a step of zero."""
        return self.finest if self.band is None else self.band.solution

    @cached_property
    def beside(self) -> Sequence[Curves]:
        """The finest run moved up and down by its error."""
        if self.band is None:
            return []
        return [
            self.finest.with_values(self.finest.x + s * self._error_at_rows) for s in (1.0, -1.0)
        ]

    @cached_property
    def spacing(self) -> float:
        """The largest distance of rows that the runs have in common [s], within which times are the same.

        Where runs are irregular no time is: an error at a time says nothing of that which is missing there.
        """
        if not self._forms.is_regular:
            return -1.0
        return float(np.diff(self.of_runs[-1].t).max())

    @cached_property
    def _error_at_rows(self) -> Array:
        """By how much the finest run may be off beyond rounding, at its rows; nothing after runs have diverged."""
        assert self.band is not None
        shift = np.maximum(self.width.x - ROUNDINGS * self.band.rounding, 0.0)
        diverged = self._forms.diverged
        parted = np.array([[name in diverged.columns] for name in self.names])
        shift[parted & (self.finest.t >= diverged.begin)] = 0.0
        return shift

    @cached_property
    def _thinned(self) -> dict[tuple[int, int], Curves]:
        return {}

    def thinned(self, n: int, first: int) -> Curves:
        """The finest run with the rows first, first + n, ...; kept if there are few."""
        if (n, first) in self._thinned:
            return self._thinned[n, first]
        curves = self.finest.thinned(n, first)
        if self.finest.x.size <= MOST_POINTS:
            self._thinned[n, first] = curves
        return curves

    @cached_property
    def filled(self) -> Sequence[Curves]:
        """The finest run with gaps filled from the side behind them, and from that before where there are any."""
        sides = [Side.AFTER, *([Side.BEFORE] if self.finest.gaps.any() else [])]
        return [self.finest.filled(side) for side in sides]

    def moved(self, sign: float) -> Array:
        """The values at the rows moved up (1) or down (-1) by their errors, with the extreme that this has at the start."""
        return self.finest.moved(self._error_at_rows, sign)

    def lowered(self, begin: float, end: float) -> Array:
        """The values at the rows with the top lower and the bottom higher by their errors, times begin to end of them."""
        return self.finest.with_extremes_narrowed(self._error_at_rows, begin, end)

    @cached_property
    def too_slow(self) -> Array:
        """The orders with which whole columns converge, where they are too low to count; else nan."""
        if self.is_held or len(self.runs.results) < RUNS:
            return np.full(len(self.names), np.nan)
        return too_slow_orders(self._shared, self.runs.ratio)


class Forms:
    """The columns of runs.

    With `keep_rows` the finest run has all its rows, for a function that reads them, and else only those that say
    something new.
    """

    def __init__(
        self, runs: NestedRuns, diverged: Divergence = NOWHERE, *, keep_rows: bool = False
    ) -> None:
        self.runs, self.diverged, self.keep_rows = runs, diverged, keep_rows
        self.common = shared_rows([result["time"] for result in runs.results])

    @property
    def times(self) -> Array:
        """The times that all runs have [s], or those of the coarsest."""
        rows = slice(None) if self.common is None else self.common[-1]
        return np.asarray(self.runs.results[-1]["time"][rows])

    @cached_property
    def is_regular(self) -> bool:
        """Whether nothing speaks against an order that a number shows: no part relaxes and no input jumps within a step."""
        if self.runs.have_jumps_within_steps:
            return False
        coarsest = self.runs.results[-1]
        return not any(
            relaxes_within_a_step(coarsest["time"], rows_of(coarsest, names))
            for names, is_held in self._batches(coarsest.names[1:])
            if not is_held
        )

    def _batches(self, names: Sequence[str]) -> Iterator[tuple[list[str], bool]]:
        """Columns that are all continuous or all held, and few enough for all their curves to be kept."""
        most = max(1, MOST_POINTS // len(self.runs.dense["time"]))
        for is_held in (False, True):
            of = [n for n in names if self.runs.dense.column(n).kind.is_held is is_held]
            yield from ((of[k : k + most], is_held) for k in range(0, len(of), most))

    def batches(self, names: Sequence[str]) -> Iterator[ColumnForms]:
        """The forms of columns, of as many at a time as have few rows."""
        return (ColumnForms(batch, self) for batch, _ in self._batches(names))

    def results(self) -> list[Result]:
        """The results of the runs, on common rows."""
        if self.common is None:
            return list(self.runs.results)
        return [result.select(rows) for result, rows in zip(self.runs.results, self.common)]


def with_columns(result: Result, changed: Mapping[str, Callable[[], Array]]) -> Result:
    """A result with other values in some columns, which are made when they are read."""
    names = result.names
    return result.with_columns_from(
        lambda k: changed[names[k]]() if names[k] in changed else result.load(k)
    )


def thinned_results(result: Result, n: int) -> Iterator[Result]:
    """The result with the rows first, first + n, ..., and the ends, for each first row."""
    t = result["time"]
    for first in range(n):
        yield result.select(np.flatnonzero(thinned_rows(t, n, first)))
