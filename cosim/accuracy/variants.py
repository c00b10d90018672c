"""The columns of the runs in all the forms that decide an error, each made once for all columns and metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from ..dense import MOST_POINTS, Array, Curves, Side, separate, thinned_rows
from ..result import Result
from .limit import RUNS
from .nested import NestedRuns
from .trajectories import (
    AtZero,
    Divergence,
    extrapolate,
    relaxes_within_a_step,
    shared_rows,
    too_slow_orders,
)

#: Every second and every third row are left: the smallest numbers without a common factor.
THINNED = (2, 3)
#: Runs that have not diverged.
NOWHERE = Divergence()
#: How gaps are filled, and whether rows behind them are then the highest or the lowest.
SIDES = ((Side.AFTER, 1.0), (Side.BEFORE, -1.0))


def rows_of(result: Result, names: Sequence[str]) -> Array:
    """Columns of a result, shape (columns, rows)."""
    return np.array([result[name] for name in names], dtype=np.float64)


class ColumnForms:
    """Columns of the runs, all continuous or all held: their curves on common rows, and those of the finest run."""

    def __init__(self, names: Sequence[str], forms: Forms) -> None:
        self.names, self.runs, self._forms = names, forms.runs, forms
        self.orders = np.array([self.runs.nominal_order(name) for name in names])
        self.is_held = self.runs.finest.column(names[0]).kind.is_held
        self._made: dict[str, Curves] = {}

    def of(self, result: Result) -> Curves:
        """Their curves in one of the runs, on its own rows."""
        x = rows_of(result, self.names)
        return Curves.of_rows(result["time"], x, is_held=self.is_held, breaks=result.breaks)

    @cached_property
    def of_runs(self) -> Sequence[Curves]:
        """The curves of each run, on the rows that all of them have if these are enough.

        Columns that hold their values have those of each run's own rows, since the common ones hide when they change,
        and so have runs that follow another one's steps.
        """
        results, common = self.runs.results, self._forms.common
        if common is None or self.is_held or self.runs.follows:
            return [self.of(result) for result in results]
        return [
            Curves.of_rows(r["time"][rows], x, breaks=results[-1].breaks)
            for r, rows, x in zip(results, common, self._shared)
        ]

    @cached_property
    def finest(self) -> Curves:
        """The finest run."""
        dense = self.runs.dense
        if not self._forms.keep_rows:
            return self.of(dense)
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
    def limit(self) -> AtZero | None:
        """The finest run extrapolated to a step of zero; None for what holds its values, and where no order is expected."""
        if self.is_held or len(self.runs.results) <= 1 or self.runs.follows:
            return None
        return extrapolate(
            self.finest, self._forms.times, self._shared, self.orders, self.runs.ratio
        )

    @cached_property
    def at_zero(self) -> Curves:
        """The same as curves, those of the finest run where there is none."""
        return self.finest if self.limit is None else self.limit.solution

    def curves(self, form: Form) -> Curves:
        """Their curves in one of the forms; kept if they are few."""
        if form.name not in self._made:
            curves = form.curves(self)
            if curves.x.size > MOST_POINTS:
                return curves
            self._made[form.name] = curves
        return self._made[form.name]

    @cached_property
    def too_slow(self) -> Array:
        """The orders with which whole columns converge, where they are too low to count; else nan."""
        if self.is_held or len(self.runs.results) < RUNS or self.runs.follows:
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
        """Whether an order that a number shows may confirm it: no part relaxes and no input jumps within a step."""
        if not self.runs.confirms or self.runs.have_jumps_within_steps:
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

    @cached_property
    def finest(self) -> Form:
        """The finest run with all its rows."""
        return Form("finest", lambda c: c.finest, lambda _: self.runs.dense)

    @cached_property
    def of_runs(self) -> list[Form]:
        """Each run, on common rows."""
        results = list(self.runs.results)
        if self.common is not None and not self.runs.follows:
            results = [result.select(rows) for result, rows in zip(results, self.common)]
        return [self._of_run(k, result) for k, result in enumerate(results)]

    def _of_run(self, k: int, result: Result) -> Form:
        return Form(f"run {k}", lambda c: c.of_runs[k], lambda _: result)

    @cached_property
    def witness(self) -> list[Form]:
        """The run whose steps end elsewhere, if there is one."""
        result = self.runs.witness
        return [] if result is None else [Form("witness", lambda c: c.of(result), lambda _: result)]

    def thinned(self, result: Result) -> dict[int, list[Form]]:
        """With every second and every third row, from each of the first ones on; for functions those of a result."""
        return {n: [self._thinned(n, first, result) for first in range(n)] for n in THINNED}

    def _thinned(self, n: int, first: int, result: Result) -> Form:
        def rows(_: Mapping[str, ColumnForms]) -> Result:
            return result.select(np.flatnonzero(thinned_rows(result["time"], n, first)))

        return Form(f"{n} {first}", lambda c: c.finest.thinned(n, first), rows)

    @cached_property
    def sides(self) -> list[Form]:
        """With gaps that hide an event filled otherwise."""
        return [self._side("finest", *side) for side in SIDES]

    @cached_property
    def at_zero(self) -> list[tuple[Form, Form]]:
        """At a step of zero, each behind that of the finest run to which it belongs."""
        zero = Form("at_zero", lambda c: c.at_zero, partial(self._changed, lambda c: c.at_zero.x))
        of_sides = [self._side("at_zero", *side) for side in SIDES]
        return [(self.finest, zero), *zip(self.sides, of_sides)]

    def _side(self, of: str, side: Side, sign: float) -> Form:
        """Curves with their gaps filled from a side, and rows behind gaps as high or as low as these then get."""

        def rows(c: ColumnForms) -> Array:
            curves: Curves = getattr(c, of)
            return curves.row_values_with_gap_extremes(sign)

        return Form(
            f"{of} {side}", lambda c: getattr(c, of).filled(side), partial(self._changed, rows)
        )

    def even(self, times: Array) -> Form:
        """The finest run at other times [s]."""

        def result(columns: Mapping[str, ColumnForms]) -> Result:
            at_times = self._changed(lambda c: c.finest(times), columns)
            return with_columns(at_times, {"time": lambda: times})

        return Form("even", lambda c: c.finest, result)

    def _changed(
        self, values: Callable[[ColumnForms], Array], columns: Mapping[str, ColumnForms]
    ) -> Result:
        """The finest run with other values in columns."""
        made = {name: partial(lambda c: values(c)[0], c) for name, c in columns.items()}
        return with_columns(self.runs.dense, made)


class Form(NamedTuple):
    """One way in which runs are looked at: `curves` gives those of columns, `result` the rows for a function that reads them."""

    name: str
    curves: Callable[[ColumnForms], Curves]
    result: Callable[[Mapping[str, ColumnForms]], Result]


def with_columns(result: Result, changed: Mapping[str, Callable[[], Array]]) -> Result:
    """A result with other values in some columns, which are made when they are read."""
    names = result.names
    return result.with_columns_from(
        lambda k: changed[names[k]]() if names[k] in changed else result.load(k)
    )
