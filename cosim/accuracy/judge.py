"""How numbers get their errors: from three runs, from the errors of the columns they are made of, from fewer rows.

A number is evaluated for the three runs on common rows; for the finest one on all its rows, with every second and
every third of them, and with the gaps that hide an event filled from either side; at a step of zero; and, where
single times decide it, with its columns moved up and down by their errors, one at a time. The largest effect
counts, and that of the rows is added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ..dense import Array, Curves, Mask, Side
from ..metrics import Metric
from ..result import Result, Rows
from .estimate import Estimate
from .limit import CONFIRMED_FACTOR, RUNS, STEP_RATIO, UNCONFIRMED_FACTOR, Reason, likeliest
from .nested import NestedRuns
from .trajectories import Divergence, spread_after
from .variants import THINNED, ColumnForms, Forms, thinned_results, with_columns

#: Orders between which a number may depend on the spacing of the rows. Derived: the time of a row is known to
#: order 1, the height of a peak to order 2; splines have order 4, which is not relied on.
ROW_ORDERS = (1.0, 2.0)
SOME_RUNS = "only some of the runs have it"
NO_ROWS = "it cannot be determined from fewer rows"
OTHER_ROWS = "it cannot be computed from other rows: {}"
TOUCHES = "it comes as near to it as its error"
COLUMN_NOT_CONVERGED = "not converged: the error of {} falls with order {:.1f}"
SAME_STEPS = "control takes nearly the same steps with all three tolerances, so that no error can be estimated"
RUNS_DISAGREE = "the runs count differently"

#: The directions in which columns are moved.
SIGNS = (1.0, -1.0)
#: By how much of its error a peak is lowered at its start and at its end: all of it or either end. Derived: the top of
#: a plateau lies at one end of it.
TILTS = ((1.0, 1.0), (0.0, 1.0), (1.0, 0.0))
#: A function from a result to numbers by name; an `Estimate` brings the error of its rows.
Function = Callable[[Result], Mapping[str, "float | Estimate"]]


@dataclass
class Evaluations:
    """The values of numbers, shape (numbers,) each.

    Attributes
    ----------
    value
        With all rows of the finest run.
    runs
        Of the three runs, on common rows, finest first, shape (runs, numbers).
    thinned
        With every second and every third row, each from every first row.
    sides
        With gaps that hide an event filled otherwise.
    shifts
        By how much they change from and to a step of zero.
    beside
        By how much they change with columns moved by their errors.
    doubt
        How far they may be off because something else is as good within the error of their column.
    scale
        What an error without an order is compared with.
    rows
        The error that they bring for the spacing of the rows; by default, that is what `thinned` and `sides` show.
    noise
        The same for the values of the runs on common rows; by default that of `rows`.
    """

    value: Array
    runs: Array
    thinned: Mapping[int, Sequence[Array]] = field(default_factory=dict)
    sides: Sequence[Array] = ()
    shifts: Sequence[Array] = ()
    beside: Sequence[Array] = ()
    doubt: Array | float = 0.0
    scale: Array | float = 0.0
    rows: Array | None = None
    noise: Array | float = 0.0

    def row_error(self) -> Array:
        """The errors due to the spacing of the rows; nan if fewer of them give no value."""
        if self.rows is not None:
            return self.rows
        if not self.thinned:
            return np.zeros_like(self.value)
        second, third = (self.largest(x - self.value for x in self.thinned[n]) for n in THINNED)
        hidden = self.largest(x - self.value for x in self.sides)
        error = CONFIRMED_FACTOR * np.maximum(row_spacing_error(second, third), hidden)
        return np.where(np.isfinite(error), error, math.nan)

    def largest(self, changes: Iterable[Array]) -> Array:
        """The largest of changes by size, 0 of none; nan if one of them is."""
        return np.abs([np.zeros_like(self.value), *changes]).max(axis=0)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Circumstances:
    """What is known of numbers beside their values: the orders that they may have, and the ratio of the steps.

    `orders` is of shape (orders, numbers). `converges` says whether the columns do at the times that decide a number,
    `is_regular` whether nothing speaks against an order that is observed, `has_jumps` whether that is an input which
    jumps inside a step of one of the runs.
    """

    orders: Array
    ratio: float
    converges: Mask | bool = False
    is_regular: bool = True
    has_jumps: bool = False


def combined(e: Evaluations, known: Circumstances) -> list[Estimate]:
    """The estimates of numbers.

    Their errors are the largest of what the three runs show, of what the extrapolation of their columns changes, with a
    factor of safety, of what the errors of these change and of their doubt; those of the rows are added. Where a number
    has no order, but its columns converge at the times that decide it, the spread of the runs takes its place; where an
    input jumps at another share of a step in each run, so that there is no order, three times that spread.
    """
    rows = e.row_error()
    runs = np.concatenate([e.runs, np.full((RUNS - len(e.runs), len(e.value)), math.nan)])
    noises = np.array([rows, *[np.maximum(rows, e.noise)] * (RUNS - 1)])
    of_runs = likeliest(
        runs, known.orders, known.ratio, noises, scale=e.scale, is_regular=known.is_regular
    )
    shift, beside = e.largest(e.shifts), e.largest(e.beside)
    grows = of_runs.reason == Reason.GROWING
    by_spread = ~of_runs.is_stated & known.converges
    with np.errstate(invalid="ignore"):
        spread = np.maximum(np.ptp(e.runs, axis=0), UNCONFIRMED_FACTOR * shift)
        error = np.where(by_spread, spread, of_runs.error - rows)
        agree = (shift * CONFIRMED_FACTOR**2 <= UNCONFIRMED_FACTOR * error) & known.is_regular
        factor = np.where(agree, CONFIRMED_FACTOR, UNCONFIRMED_FACTOR)
        error = np.maximum.reduce([error, factor * shift, beside, error * 0.0 + e.doubt]) + rows
    claimed: Mask = np.asarray(of_runs.is_stated | (~grows & (by_spread | known.has_jumps)))
    lacks: Mask = np.asarray(np.isnan(e.runs).any(axis=0))
    estimates = []
    for k, (value, row) in enumerate(zip(e.value.tolist(), rows.tolist())):
        order = float(of_runs.order[k])
        if math.isnan(value):
            estimates.append(Estimate(value, None, reason=Reason.NO_VALUE.sentence()))
        elif not math.isfinite(row):
            estimates.append(Estimate(value, None, reason=NO_ROWS))
        elif lacks[k]:
            estimates.append(Estimate(value, None, rows=row, reason=SOME_RUNS))
        elif math.isnan(shift[k] + beside[k]):
            estimates.append(Estimate(value, None, order, row, TOUCHES))
        elif claimed[k]:
            estimates.append(Estimate(value, float(error[k]), order, row))
        else:
            reason = Reason(int(of_runs.reason[k])).sentence(order)
            estimates.append(Estimate(value, None, order, row, reason))
    return estimates


def row_spacing_error(second: Array, third: Array) -> Array:
    """The errors with all rows, from the changes with every second and every third row.

    An error C h^q becomes C (2 h)^q and C (3 h)^q, so that the changes are 2^q - 1 and 3^q - 1 times it. The ratio
    of the two shows q.
    """
    low, high = ROW_ORDERS
    ratios = [(3.0**q - 1.0) / (2.0**q - 1.0) for q in ROW_ORDERS]
    quotient = np.divide(third, second, out=np.full_like(third, ratios[1]), where=second != 0.0)
    q = low + (high - low) * np.clip((quotient - ratios[0]) / (ratios[1] - ratios[0]), 0.0, 1.0)
    return np.maximum(third / (3.0**q - 1.0), second / (2.0**q - 1.0))  # type: ignore[no-any-return]


def judge_metrics(
    metrics: Mapping[str, Metric], runs: NestedRuns, diverged: Divergence
) -> dict[str, Estimate]:
    """The estimates of metrics; those of one form are judged at once, for all their columns.

    Parameters
    ----------
    metrics : mapping of str to Metric
        By name.
    runs : NestedRuns
        The runs.
    diverged : Divergence
        From when on, and in which columns, these have diverged.
    """
    forms = Forms(runs, diverged)
    estimates: dict[str, Estimate] = {}
    for columns, group in _groups(metrics, forms):
        for metric, of in group.items():
            estimates |= zip(of, _judge_metric(metric, of.values(), columns, forms))
    units = runs.finest.units
    for name, metric in metrics.items():
        x, unit = estimates[name], units.get(metric.columns[0], "")
        if x.error is None and math.isnan(x.value) and not x.reason:
            x = x._replace(reason=metric.lack(unit, *map(runs.dense.solution, metric.columns)))
        estimates[name] = x._replace(unit=metric.unit(unit))
    return {name: estimates[name] for name in metrics}


def _groups(
    metrics: Mapping[str, Metric], forms: Forms
) -> Iterator[tuple[Sequence[ColumnForms], Mapping[Metric, Mapping[str, int]]]]:
    """The forms of columns, and by metric of no column the figures that are made of them, each with its position."""
    single = dict.fromkeys(m.columns[0] for m in metrics.values() if len(m.columns) == 1)
    for columns in forms.batches([*single]):
        group: dict[Metric, dict[str, int]] = {}
        for name, metric in metrics.items():
            if len(metric.columns) == 1 and metric.columns[0] in columns.names:
                k = columns.names.index(metric.columns[0])
                group.setdefault(metric.unnamed, {})[name] = k
        yield [columns], group
    for several in dict.fromkeys(m.columns for m in metrics.values() if len(m.columns) > 1):
        parts = [ColumnForms([name], forms) for name in several]
        yield parts, {m.unnamed: {n: 0} for n, m in metrics.items() if m.columns == several}


def _judge_metric(
    metric: Metric, which: Iterable[int], columns: Sequence[ColumnForms], forms: Forms
) -> list[Estimate]:
    """The estimates of a metric of some of the columns, without their units."""
    of, runs, diverged = [*which], forms.runs, forms.diverged

    def some(curves: Iterable[Curves]) -> list[Curves]:
        return [c.take(of) for c in curves]

    finest = some(c.finest for c in columns)
    value = metric(*finest)
    moved = _moved_by_errors(metric, columns, some)
    touched = ~np.all(np.isnan([value, *moved]), axis=0)
    reasons = [
        (TOUCHES if touched[k] else "") if math.isnan(value[k])
        else _why_none(runs, columns, of[k])
        or ("" if _precedes_divergence(metric, columns, diverged, value[k], of[k]) else diverged.reason)
        for k in range(len(of))
    ]  # fmt: skip
    if all(reasons) or np.isnan(value).all():
        return [Estimate(float(x), None, reason=why) for x, why in zip(value, reasons)]
    of_runs = np.array([metric(*some(curves)) for curves in zip(*(c.of_runs for c in columns))])
    if metric.is_count:
        agree = (np.array([*of_runs, metric(*some(c.at_zero for c in columns))]) == value).all(
            axis=0
        )
        estimates = [
            Estimate(float(x), 0.0) if a else Estimate(float(x), None, reason=RUNS_DISAGREE)
            for x, a in zip(value, agree)
        ]
    else:
        e = _evaluate_finest_run(metric, columns, some)
        e.runs, e.scale = of_runs, metric.scale(*finest)
        if any(column.band is not None for column in columns):
            e.shifts = [metric(*some(c.at_zero for c in columns)) - value]
            e.beside = [x - value for x in moved]
        first, converges = columns[0], np.zeros(len(of), dtype=bool)
        if len(columns) == 1 and first.band is not None:
            e.shifts = [*e.shifts, metric(*some([first.at_zero.filled(Side.AFTER)])) - e.sides[0]]
            e.doubt = metric.doubt(*finest, *some([first.width]))
            times = np.concatenate([metric.times(*finest), metric.times(*some([first.at_zero]))])
            if len(times):
                converges |= first.band.converges_at(times, of).all(axis=0)
        orders = np.array([column.orders[of] for column in columns])
        estimates = combined(
            e,
            Circumstances(
                orders, runs.ratio, converges, forms.is_regular, runs.have_jumps_within_steps
            ),
        )
    return [
        Estimate(float(v), None, reason=why) if why or math.isnan(v) else x
        for v, why, x in zip(value, reasons, estimates)
    ]


def _evaluate_finest_run(
    metric: Metric,
    columns: Sequence[ColumnForms],
    some: Callable[[Iterable[Curves]], list[Curves]],
) -> Evaluations:
    """A metric of the finest run with all its rows, with fewer of them, and with its gaps filled otherwise."""
    value = metric(*some(c.finest for c in columns))
    thinned = {n: [metric(*some(c.thinned(n, k) for c in columns)) for k in range(n)]
               for n in THINNED}  # fmt: skip
    filled = columns[0].filled if len(columns) == 1 else []
    return Evaluations(value, value[None], thinned, [metric(*some([c])) for c in filled])


def estimates_of_rows(
    metrics: Mapping[str, Metric], result: Result, errors: Mapping[str, float]
) -> dict[str, Estimate]:
    """Metrics of one result with the errors of the spacing of its rows, and those of their columns by name added."""
    forms, estimates = Forms(NestedRuns([result], result, STEP_RATIO)), {}
    for columns, group in _groups(metrics, forms):
        for metric, which in group.items():
            e = _evaluate_finest_run(metric, columns, list)
            for name, k in which.items():
                column, rows = metrics[name].columns[0], float(e.row_error()[k])
                x = Estimate(float(e.value[k]), rows + errors[column], rows=rows,
                             unit=metrics[name].unit(result.units.get(column, "")))  # fmt: skip
                is_known = math.isfinite(rows)
                estimates[name] = (
                    x if is_known else x._replace(error=None, rows=0.0, reason=NO_ROWS)
                )
    return estimates


def _why_none(runs: NestedRuns, columns: Sequence[ColumnForms], k: int) -> str:
    """Why no number of columns has an error; "" if one may have."""
    if len(runs.results) == 1:
        return runs.lost
    if not runs.steps_differ_enough:
        return SAME_STEPS
    for column in columns:
        if not math.isnan(column.too_slow[k]):
            return COLUMN_NOT_CONVERGED.format(column.names[k], column.too_slow[k])
    return ""


def _moved_by_errors(
    metric: Metric,
    columns: Sequence[ColumnForms],
    some: Callable[[Iterable[Curves]], list[Curves]],
) -> list[Array]:
    """A metric with its columns moved up and down by their errors, one at a time, where then other times decide it.

    What moves at the same times is in the error of the number itself.
    """
    if not metric.is_local:
        return []
    curves = some(column.finest for column in columns)
    value, times = metric(*curves), metric.times(*curves)
    values = []
    for k, column in enumerate(columns):
        for moved in some(column.beside):
            others = [*curves[:k], moved, *curves[k + 1 :]]
            distances = np.abs(metric.times(*others) - times)
            near = np.where(times == curves[0].t[0], 0.0, column.spacing)
            same = (distances <= near).all(axis=0)
            values.append(np.where(same, value, metric(*others)))
    return values


def _precedes_divergence(
    metric: Metric, columns: Sequence[ColumnForms], diverged: Divergence, value: float, k: int
) -> bool:
    """Whether a metric depends only on the rows before its columns diverge, if they do.

    That is so if it has the same value without the later rows, and with later values spread further from
    their middle, as those of another chaotic trajectory might be.
    """
    if not any(column.names[k] in diverged.columns for column in columns):
        return True
    begin, finest = diverged.begin, [column.finest.take([k]) for column in columns]
    if begin <= finest[0].t[1]:
        return False
    wide = [
        curve.with_values(spread_after(curve.t, curve.x[0], begin)[None])
        if column.names[k] in diverged.columns
        else curve
        for column, curve in zip(columns, finest)
    ]
    before = [curve.between(-math.inf, begin) for curve in finest]
    return bool(metric(*before)[0] == value == metric(*wide)[0])


class ObservedResult(Result):
    """A result that notes which columns are read."""

    def __init__(self, result: Result) -> None:
        super().__init__(result.columns, result.provenance, result.load, breaks=result.breaks)
        self._rows, self._read = result, set[str]()

    def __getitem__(self, name: str) -> Rows:
        self._read.add(name)
        return self._rows[name]

    def columns_read(self) -> list[str]:
        """The columns asked for by name; all, if the rows were taken as a whole."""
        reads_all = "data" in vars(self) or not self._read
        return [name for name in self.names[1:] if reads_all or name in self._read]


def judge_function(
    function: Function, runs: NestedRuns, diverged: Divergence
) -> dict[str, Estimate]:
    """The estimates of the numbers that a function makes of a result.

    A function of rows cannot look between them; what all rows change of its numbers counts as an error of the
    rows, so that the error of one that counts rows is large. Of the order only those of the columns are known that
    the function reads, see `likeliest`. Where it fails on any of the rows, all its numbers are refused,
    with the sentence of the exception. Numbers that are `Estimate`s bring the error of their rows.

    Parameters
    ----------
    function : callable
        It is called for each run, with fewer rows, and with other values of its columns.
    runs : NestedRuns
        The runs.
    diverged : Divergence
        From when on, and in which columns, these have diverged.
    """
    observed = ObservedResult(runs.dense)
    first = function(observed)
    forms = Forms(runs, diverged, keep_rows=True)
    names = observed.columns_read()
    columns = {name: ColumnForms([name], forms) for name in names}
    if reason := _why_none(runs, [*columns.values()], 0):
        return {name: _estimate(x)._replace(error=None, reason=reason) for name, x in first.items()}
    numbers = {name: x for name, x in first.items() if not isinstance(x, Estimate)}
    try:
        of_runs = [function(result) for result in (forms.results() if numbers else runs.results)]
        after = _numbers_after_divergence(function, runs, diverged, [*columns])
        every = _evaluations(function, runs, columns, of_runs, [*numbers]) if numbers else None
    except Exception as error:  # noqa: BLE001 - whatever the function of a person raises
        reason = OTHER_ROWS.format(error)
        return {name: _estimate(x)._replace(error=None, reason=reason) for name, x in first.items()}
    orders = {column.orders[0] for column in columns.values()} or {runs.nominal_order("")}
    known = Circumstances(
        np.array(sorted(orders))[:, None], runs.ratio, is_regular=forms.is_regular,
        has_jumps=runs.have_jumps_within_steps,
    )  # fmt: skip
    estimates = {}
    if every is not None:
        estimates = dict(zip(numbers, combined(every, known)))
        if any(x.error is None and name not in after for name, x in estimates.items()):
            coarse = _common_row_errors(function, forms, of_runs, [*numbers])
            lacking = np.array([x.error is None for x in estimates.values()])
            rows = every.row_error()
            every.rows = np.where(lacking & (coarse >= rows), coarse, rows)
            estimates = dict(zip(numbers, combined(every, known)))
    for name, x in first.items():
        given = _estimate(x)
        if name in after and not (isinstance(x, Estimate) and x.error is None):
            estimates[name] = given._replace(error=None, reason=diverged.reason)
        elif isinstance(x, Estimate):
            estimates[name] = _with_coupling(x, [run.get(name) for run in of_runs], known)
    return {name: estimates[name] for name in first}


def _common_row_errors(
    function: Function,
    forms: Forms,
    of_runs: Sequence[Mapping[str, float | Estimate]],
    names: Sequence[str],
) -> Array:
    """The errors of numbers due to the spacing of the common rows of the runs, which may hide their differences."""
    finest = forms.results()[0]
    try:
        fewer = {n: [function(result) for result in thinned_results(finest, n)] for n in THINNED}
    except Exception:  # noqa: BLE001 - whatever the function of a person raises
        return np.full(len(names), math.nan)
    thinned = {n: [numbers_of(r, names) for r in results] for n, results in fewer.items()}
    return Evaluations(numbers_of(of_runs[0], names), np.zeros((0, 1)), thinned).row_error()


def _estimate(x: float | Estimate) -> Estimate:
    return x if isinstance(x, Estimate) else Estimate(float(x), None)


def _with_coupling(
    x: Estimate, of_runs: Sequence[float | Estimate | None], known: Circumstances
) -> Estimate:
    """A number that brings the error of its rows, with that of the coupling added."""
    if x.error is None:
        return x
    runs = [run for run in of_runs if isinstance(run, Estimate) and run.error is not None]
    if len(runs) < len(of_runs):
        return x._replace(error=None, reason=SOME_RUNS)
    values = [run.value for run in runs]
    if len(set(values)) == 1 and x.value == values[0] == round(x.value):
        return x  # a count that all runs agree on
    noise = max(run.error or 0.0 for run in runs)
    e = Evaluations(
        np.array([x.value]), np.array(values)[:, None], rows=np.array([x.error]), noise=noise
    )
    return combined(e, known)[0]._replace(unit=x.unit)


def _evaluations(
    function: Function,
    runs: NestedRuns,
    columns: Mapping[str, ColumnForms],
    of_runs: Sequence[Mapping[str, float | Estimate]],
    names: Sequence[str],
) -> Evaluations:
    """The named numbers that a function makes of all the forms of the columns that it reads."""
    dense = runs.dense

    def of(changed: Mapping[str, Callable[[], Array]]) -> Array:
        single = {name: lambda make=make: make()[0] for name, make in changed.items()}
        return numbers_of(function(with_columns(dense, single)), names)

    value, series = of({}), np.array([numbers_of(run, names) for run in of_runs])
    thinned = {n: [numbers_of(function(r), names) for r in thinned_results(dense, n)]
               for n in THINNED}  # fmt: skip
    hidden = [
        of({n: partial(c.finest.row_values_with_gap_extremes, s) for n, c in columns.items()})
        for s in SIGNS
    ]
    zero = [
        of({n: partial(c.at_zero.row_values_with_gap_extremes, s) for n, c in columns.items()})
        for s in SIGNS
    ]
    joint = {name: column for name, column in columns.items() if column.band is not None}
    beside = [of({name: partial(c.moved, s)}) for name, c in joint.items() for s in SIGNS]
    beside += [of({n: partial(c.lowered, *tilt) for n, c in joint.items()}) for tilt in TILTS]
    e = Evaluations(value, series, thinned, hidden)
    rows = e.row_error()
    if columns and (times := even_times_if_uneven(dense["time"])) is not None:
        even = {n: lambda c=c: c.finest(times) for n, c in columns.items()}
        rows = rows + CONFIRMED_FACTOR * np.abs(of({"time": lambda: times[None], **even}) - value)
    e.rows = np.where(np.isnan(rows), rows, np.fmax(rows, np.abs(value - series[0])))

    def beyond_rows(change: Array) -> Array:
        return np.where(np.abs(change) <= rows_, 0.0, change)

    rows_ = e.rows
    e.shifts = [beyond_rows(to - x) for x, to in zip(hidden, zero)]
    e.beside = [beyond_rows(x - value) for x in beside]
    return e


def even_times_if_uneven(t: Array) -> Array | None:
    """As many times [s] at even distances; None where rows are as even as those of fixed steps and of events beside them.

    A function that weighs rows instead of time has another limit where steps adapt, which no thinner rows show.
    """
    even = np.linspace(t[0], t[-1], len(t))
    return even if len(t) > 1 and np.abs(t - even).max() > np.diff(t).max() else None


def numbers_of(values: Mapping[str, float | Estimate], names: Sequence[str]) -> Array:
    """The named values of what a function gives; raises KeyError for one that it does not give."""
    every = [values[name] for name in names]
    return np.array([x.value if isinstance(x, Estimate) else float(x) for x in every])


def _numbers_after_divergence(
    function: Function, runs: NestedRuns, diverged: Divergence, columns: Sequence[str]
) -> set[str]:
    """The numbers that need rows after the runs have diverged.

    Those that do not are the same with the later rows of the second run, and with rows that are further from
    their middle.
    """
    if not diverged.columns.intersection(columns):
        return set()
    finest, second = runs.results[:2]
    values = function(finest)
    t, other = finest["time"], second["time"]
    before, later = t < diverged.begin, other >= diverged.begin

    def swapped(name: str) -> Rows:
        return np.concatenate([finest[name][before], second[name][later]])

    def wide(name: str) -> Rows:
        x = finest[name]
        return spread_after(t, x, diverged.begin) if name in diverged.columns else x

    need: set[str] = set()
    for rows in (swapped, wide):
        try:
            others = function(with_columns(finest, {n: partial(rows, n) for n in finest.names}))
        except Exception:  # noqa: BLE001 - it depends on which of the rows it gets
            return set(values)
        need |= {name for name, x in values.items() if others.get(name) != x}
    return need
