"""The columns of three runs in all the forms that decide an error, each made once for all metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from ..dense import KEPT_ROWS, Array, Indices, Side, thinned_rows
from ..metrics import Curve
from ..result import Result
from .nested import RUNS, NestedRuns
from .trajectories import (
    Divergence,
    ErrorBand,
    error_band,
    relaxes_within_a_step,
    shared_rows,
    slow_order,
)

#: Every second and every third row are left: the smallest numbers without a common factor.
THINNED = (2, 3)
#: Times that the width of a settled column has its rounding: derived, as noise, as the least error, and once more.
ROUNDINGS = 3.0
#: Runs that have not diverged.
NOWHERE = Divergence()


class ColumnForms:
    """A column of three runs: its curves on common rows, and those of the finest run on all its rows."""

    def __init__(
        self,
        name: str,
        runs: NestedRuns,
        diverged: Divergence,
        common: Sequence[Indices] | None,
        *,
        keep_rows: bool,
    ) -> None:
        self.name, self.runs, self._diverged, self._keep_rows = name, runs, diverged, keep_rows
        self.order = runs.order(name)
        self._thinned: dict[tuple[int, int], Curve] = {}
        self.is_held = runs.finest.column(name).kind.is_held
        self._common = common

    @cached_property
    def of_runs(self) -> Sequence[Curve]:
        """The curve of each run, on the rows that all of them have if these are enough.

        A column that holds its values has those of each run's own rows, since the common ones hide when it changes.
        """
        results, kind = self.runs.results, self.runs.finest.column(self.name).kind
        if self._common is None or self.is_held:
            return [result.solution(self.name) for result in results]
        return [
            Curve.from_rows(r["time"][rows], r[self.name][rows], kind, results[-1].breaks)
            for r, rows in zip(results, self._common)
        ]

    @cached_property
    def finest(self) -> Curve:
        """The finest run."""
        dense, name = self.runs.dense, self.name
        if not self._keep_rows:
            return dense.solution(name)
        return Curve(dense["time"], dense[name], dense.column(name).kind, dense.breaks)

    @cached_property
    def band(self) -> ErrorBand | None:
        """What remains to a step of zero; None for what holds its values, or without another run."""
        if self.is_held or len(self.runs.results) <= 1:
            return None
        rows = [(r["time"], r[self.name]) for r in self.runs.results]
        return error_band(self.finest, rows, self.order, self.runs.ratio)

    @cached_property
    def width(self) -> Curve:
        """By how much the finest run may be off."""
        assert self.band is not None
        return self.band.width

    @cached_property
    def at_zero(self) -> Curve:
        """The finest run extrapolated to a step of zero."""
        return self.finest if self.band is None else self.band.solution

    @cached_property
    def beside(self) -> Sequence[Curve]:
        """The finest run moved up and down by its error."""
        if self.band is None:
            return []
        return [self.finest.with_values(self.finest.x + s * self._shift) for s in (1.0, -1.0)]

    @cached_property
    def spacing(self) -> float:
        """The largest distance of rows that the runs have in common [s], within which times are the same."""
        return float(np.diff(self.of_runs[-1].t).max())

    @cached_property
    def _shift(self) -> Array:
        """By how much the finest run may be off beyond rounding, at its rows; nothing after runs have diverged."""
        assert self.band is not None
        shift = np.maximum(self.width.x - ROUNDINGS * self.band.rounding, 0.0)
        if self.name in self._diverged.columns:
            shift[self.finest.t >= self._diverged.begin] = 0.0
        return shift

    def thinned(self, n: int, first: int) -> Curve:
        """The finest run with the rows first, first + n, ...; kept if there are few."""
        if (n, first) in self._thinned:
            return self._thinned[n, first]
        curve = self.finest.thinned(n, first)
        if len(self.finest.t) <= KEPT_ROWS:
            self._thinned[n, first] = curve
        return curve

    @cached_property
    def filled(self) -> Sequence[Curve]:
        """The finest run with gaps filled from the side behind them, and from that before where there are any."""
        sides = [Side.AFTER, *([Side.BEFORE] if len(self.finest.gaps) else [])]
        return [self.finest.filled(side) for side in sides]

    @cached_property
    def zero_filled(self) -> Curve:
        """The extrapolated one with gaps filled from behind."""
        return self.at_zero.filled(Side.AFTER)

    def with_extremes(self, sign: float) -> Array:
        """The values at the rows, with the extremes that gaps hide, high (1) or low (-1)."""
        return self.finest.with_extremes(sign)

    def zero_extremes(self, sign: float) -> Array:
        """The same at a step of zero."""
        return self.at_zero.with_extremes(sign)

    def moved(self, sign: float) -> Array:
        """The values at the rows moved up (1) or down (-1) by their errors, with the extreme that this has at the start."""
        x = self.finest.x + sign * self._shift
        row, highest = self.finest.start_extreme(self._shift, sign)
        x[row] = sign * max(sign * x[row], highest)
        return x

    def lowered(self, begin: float, end: float) -> Array:
        """The values at the rows with the top lower and the bottom higher by their errors, times begin to end of them."""
        return self.finest.with_top_lowered(self._shift, begin, end)

    @cached_property
    def slow(self) -> float | None:
        """The order with which the whole column converges, if it is too low to count."""
        if self.is_held or len(self.runs.results) < RUNS:
            return None
        return slow_order([(r["time"], r[self.name]) for r in self.runs.results], self.runs.ratio)


class Forms:
    """The columns of runs; those of a metric are kept for the next one.

    With `keep_rows` the finest run has all its rows, for a function that reads them, and else only those that say
    something new.
    """

    def __init__(
        self, runs: NestedRuns, diverged: Divergence = NOWHERE, *, keep_rows: bool = False
    ) -> None:
        self.runs, self._diverged, self._keep_rows = runs, diverged, keep_rows
        self._kept: dict[str, ColumnForms] = {}
        self._common = shared_rows([result["time"] for result in runs.results])

    @cached_property
    def is_regular(self) -> bool:
        """Whether nothing speaks against an order that a number shows: no part relaxes and no input jumps within a step."""
        return not self.runs.have_jumps_inside and not relaxes_within_a_step(self.runs.dense)

    def of(self, names: Sequence[str]) -> list[ColumnForms]:
        """The forms of columns."""
        self._kept = {
            name: self._kept.get(name)
            or ColumnForms(name, self.runs, self._diverged, self._common, keep_rows=self._keep_rows)
            for name in names
        }
        return list(self._kept.values())

    def results(self) -> list[Result]:
        """The results of the runs, on common rows."""
        if self._common is None:
            return list(self.runs.results)
        return [result.select(rows) for result, rows in zip(self.runs.results, self._common)]


def with_columns(result: Result, changed: Mapping[str, Callable[[], Array]]) -> Result:
    """A result with other values in some columns, which are made when they are read."""
    names = result.names
    return result.with_values(
        lambda k: changed[names[k]]() if names[k] in changed else result.load(k)
    )


def thinned_results(result: Result, n: int) -> Iterator[Result]:
    """The result with the rows first, first + n, ..., and the ends, for each first row."""
    t = result["time"]
    for first in range(n):
        yield result.select(np.flatnonzero(thinned_rows(t, n, first)))
