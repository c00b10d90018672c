"""How numbers get their errors: from runs with other steps, from the columns at a step of zero, from fewer rows.

A number is evaluated in all the forms of the runs, see `Forms`: the runs on common rows; the finest one on all its rows,
with every second and every third of them, and with the gaps that hide an event filled from either side; at a step of
zero; and the witness. The largest effect counts, and that of the rows is added. Metrics take the curves of a form and
functions of a person its rows; the rest is the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ..dense import Array, Mask
from ..metrics import Metric, Settled
from ..result import Result, Rows
from .estimate import Estimate
from .limit import CONFIRMED_FACTOR, RUNS, STEP_RATIO, UNCONFIRMED_FACTOR, Reason, likeliest
from .nested import GOLDEN, NestedRuns
from .trajectories import Divergence, spread_after
from .variants import THINNED, ColumnForms, Form, Forms, with_columns

#: Orders between which a number may depend on the spacing of the rows. Derived: the time of a row is known to
#: order 1, the height of a peak to order 2; splines have order 4, which is not relied on.
ROW_ORDERS = (1.0, 2.0)
#: Times the difference to the witness. Derived: its steps are 1 / phi of those of the run, so that of an error of order 1
#: it has 1 / phi as well, and the difference is 1 - 1 / phi = 1 / phi^2 of it.
WITNESS_FACTOR = GOLDEN**2
SOME_RUNS = "only some of the runs have it"
NO_ROWS = "it cannot be determined from fewer rows"
OTHER_ROWS = "it cannot be computed from other rows: {}"
TOUCHES = "it comes as near to it as its error"
COLUMN_NOT_CONVERGED = "not converged: the error of {} falls with order {:.1f}"
RUNS_DISAGREE = "the runs count differently"
RIVALS = "within the error of the height, it may also be at {} s"
#: Most times that the reason names.
MOST_RIVALS = 3

#: A function from a result to numbers by name; an `Estimate` brings the error of its rows.
Function = Callable[[Result], Mapping[str, "float | Estimate"]]
#: The numbers that are made of a form, shape (numbers,).
Evaluate = Callable[[Form], Array]


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
        By how much they change to a step of zero.
    witness
        Of the run whose steps end elsewhere; empty without one.
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
    witness: Sequence[Array] = ()
    scale: Array | float = 0.0
    rows: Array | None = None
    noise: Array | float = 0.0

    @classmethod
    def of_rows(cls, evaluate: Evaluate, forms: Forms) -> Evaluations:
        """Those of the finest run alone."""
        value, thinned = evaluate(forms.finest), forms.thinned(forms.runs.dense)
        few = {n: [evaluate(form) for form in some] for n, some in thinned.items()}
        return cls(value, value[None], few, [evaluate(form) for form in forms.sides])

    @classmethod
    def of_all(cls, evaluate: Evaluate, forms: Forms) -> Evaluations:
        """Those of all forms."""
        e = cls.of_rows(evaluate, forms)
        e.runs = np.array([evaluate(form) for form in forms.of_runs])
        e.shifts = [evaluate(zero) - evaluate(of) for of, zero in forms.at_zero]
        e.witness = [evaluate(form) for form in forms.witness]
        return e

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


def combined(
    e: Evaluations, orders: Array, forms: Forms, converges: Mask | None = None
) -> list[Estimate]:
    """The estimates of numbers that may have some orders, shape (orders, numbers).

    Their errors are the largest of what the three runs show, of what the extrapolation of their columns changes, with a
    factor of safety, and of the distance to the witness; those of the rows are added. Where a number
    has no order, but its columns converge there, as `converges` says, the spread of the runs takes its place; where an
    input jumps at another share of a step in each run, so that there is no order, three times that spread. Runs that
    follow the steps of another have no order: the distances themselves count.
    """
    rows, apart = e.row_error(), e.largest(x - e.value for x in e.witness)
    runs = np.concatenate([e.runs, np.full((RUNS - len(e.runs), len(e.value)), math.nan)])
    lacks: Mask = np.asarray(np.isnan([*e.runs, *e.witness]).any(axis=0))
    shift = e.largest(e.shifts)
    if forms.runs.follows:
        whole, two = np.abs(runs[1:] - e.value)
        error = np.maximum.reduce([whole, two / STEP_RATIO, UNCONFIRMED_FACTOR * apart]) + rows
        order, reason = np.full_like(rows, math.nan), np.zeros(len(rows), int)
        claimed: Mask = np.ones(len(rows), dtype=bool)
    else:
        noises = np.array([rows, *[np.maximum(rows, e.noise)] * (RUNS - 1)])
        of_runs = likeliest(
            runs, orders, forms.runs.ratio, noises, scale=e.scale, is_regular=forms.is_regular
        )
        by_spread = ~of_runs.is_stated & (False if converges is None else converges)
        with np.errstate(invalid="ignore"):
            spread = np.maximum(np.ptp(e.runs, axis=0), UNCONFIRMED_FACTOR * shift)
            error = np.where(by_spread, spread, of_runs.error - rows)
            agree = (shift * CONFIRMED_FACTOR**2 <= UNCONFIRMED_FACTOR * error) & forms.is_regular
            factor = np.where(agree, CONFIRMED_FACTOR, UNCONFIRMED_FACTOR)
            error = np.maximum.reduce([error, factor * shift, WITNESS_FACTOR * apart]) + rows
        grows = of_runs.reason == Reason.GROWING
        claimed = np.asarray(
            of_runs.is_stated | (~grows & (by_spread | forms.runs.have_jumps_within_steps))
        )
        order, reason = of_runs.order, of_runs.reason
    estimates = []
    for k, (value, row) in enumerate(zip(e.value.tolist(), rows.tolist())):
        without = partial(Estimate, value, None, float(order[k]), row)
        if math.isnan(value):
            estimates.append(Estimate(value, None, reason=Reason.NO_VALUE.sentence()))
        elif not math.isfinite(row):
            estimates.append(Estimate(value, None, reason=NO_ROWS))
        elif lacks[k]:
            estimates.append(Estimate(value, None, rows=row, reason=SOME_RUNS))
        elif math.isnan(shift[k]):
            estimates.append(without(reason=TOUCHES))
        elif claimed[k]:
            estimates.append(Estimate(value, float(error[k]), float(order[k]), row))
        else:
            estimates.append(without(reason=Reason(int(reason[k])).sentence(float(order[k]))))
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
    heights = {name: m.height for name, m in metrics.items() if len(m.columns) == 1 and m.height}
    asked = dict(metrics) | {f"{name}\0": height for name, height in heights.items()}
    estimates: dict[str, Estimate] = {}
    for columns, group in _groups(asked, forms):
        for metric, of in group.items():
            estimates |= zip(of, _judge_metric(metric, of.values(), columns, forms))
    units = runs.finest.units
    for name, metric in metrics.items():
        x, unit = estimates[name], units.get(metric.columns[0], "")
        if name in heights and x.error is not None:
            x = _beside_rivals(metric, x, estimates[f"{name}\0"], runs)
        if short := metric.beyond(*runs.dense["time"][[0, -1]].tolist()):  # a part may end a run
            x = x._replace(error=None, reason=short)
        if x.error is None and math.isnan(x.value) and not x.reason:
            x = x._replace(reason=metric.lack(unit, *map(runs.dense.solution, metric.columns)))
        if x.error is not None and isinstance(metric, Settled):
            left = metric.change_left(*map(runs.dense.solution, metric.columns))
            x = x._replace(error=x.error + left)
        estimates[name] = x._replace(unit=metric.unit(unit))
    return {name: estimates[name] for name in metrics}


def _beside_rivals(metric: Metric, x: Estimate, height: Estimate, runs: NestedRuns) -> Estimate:
    """The estimate of a time, where the error of the height leaves others to the run, or to its witness.

    It may be at any of them. Where events may be hidden it is refused, since they move peaks by any amount.
    """
    if height.error is None:
        return x._replace(error=None, reason=height.reason)
    found = np.empty(0)
    for result in (runs.dense, runs.witness):
        if result is not None:
            curve = result.solution(metric.columns[0])
            apart = STEP_RATIO * float(np.diff(curve.t).max())
            found = np.concatenate([found, metric.rivals(curve, height.error, apart)])
    if not len(found):
        return x
    if np.isnan(found).any():
        return x._replace(error=None, reason=TOUCHES)
    if runs.tells_events:
        furthest = float(np.abs(found - x.value).max())
        return x._replace(error=max(x.error or 0.0, furthest + x.rows))
    names = ", ".join(f"{t:.4g}" for t in np.unique(found)[:MOST_RIVALS])
    return x._replace(error=None, reason=RIVALS.format(names))


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
        together: dict[Metric, dict[str, int]] = {}
        for name, metric in metrics.items():
            if metric.columns == several:
                together.setdefault(metric.unnamed, {})[name] = 0
        yield parts, together


def _evaluate_curves(metric: Metric, columns: Sequence[ColumnForms], of: Sequence[int]) -> Evaluate:
    """A metric of some of the columns in any form; forms with the same curves have the same numbers."""
    known: dict[tuple[int, ...], tuple[object, Array]] = {}

    def evaluate(form: Form) -> Array:
        curves = [c.curves(form) for c in columns]
        key = tuple(map(id, curves))
        if key not in known:  # the curves are kept, so that no others get their identities
            known[key] = curves, metric(*(c.take([*of]) for c in curves))
        return known[key][1]

    return evaluate


def _judge_metric(
    metric: Metric, which: Iterable[int], columns: Sequence[ColumnForms], forms: Forms
) -> list[Estimate]:
    """The estimates of a metric of some of the columns, without their units."""
    of, runs, diverged = [*which], forms.runs, forms.diverged
    evaluate = _evaluate_curves(metric, columns, of)
    value = evaluate(forms.finest)
    others = np.array([evaluate(form) for form in (*forms.of_runs, *forms.witness)])
    reasons = [
        (TOUCHES if np.isfinite(others[:, k]).any() else "") if math.isnan(value[k])
        else _why_none(runs, columns, of[k])
        or ("" if _precedes_divergence(metric, columns, diverged, value[k], of[k]) else diverged.reason)
        for k in range(len(of))
    ]  # fmt: skip
    if all(reasons) or np.isnan(value).all():
        return [Estimate(float(x), None, reason=why) for x, why in zip(value, reasons)]
    zero = forms.at_zero[0][1]
    if metric.is_count:
        agree = (np.array([*others, evaluate(zero)]) == value).all(axis=0)
        estimates = [
            Estimate(float(x), 0.0) if a else Estimate(float(x), None, reason=RUNS_DISAGREE)
            for x, a in zip(value, agree)
        ]
    else:
        e = Evaluations.of_all(evaluate, forms)
        finest, at_zero = (
            [c.curves(form).take(of) for c in columns] for form in (forms.finest, zero)
        )
        e.scale = metric.scale(*finest)
        converges, limit = np.zeros(len(of), dtype=bool), columns[0].limit
        if len(columns) == 1 and limit is not None:
            times = np.concatenate([metric.times(*finest), metric.times(*at_zero)])
            if len(times):
                converges |= limit.converges_at(times, of).all(axis=0)
        orders = np.array([column.orders[of] for column in columns])
        estimates = combined(e, orders, forms, converges)
    return [
        Estimate(float(v), None, reason=why) if why or math.isnan(v) else x
        for v, why, x in zip(value, reasons, estimates)
    ]


def estimates_of_rows(
    metrics: Mapping[str, Metric], result: Result, errors: Mapping[str, float]
) -> dict[str, Estimate]:
    """Metrics of one result with the errors of the spacing of its rows, and those of their columns by name added."""
    forms, estimates = Forms(NestedRuns([result], result)), {}
    for columns, group in _groups(metrics, forms):
        for metric, which in group.items():
            every = range(len(columns[0].names))
            e = Evaluations.of_rows(_evaluate_curves(metric, columns, every), forms)
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
    for column in columns:
        if not math.isnan(column.too_slow[k]):
            return COLUMN_NOT_CONVERGED.format(column.names[k], column.too_slow[k])
    return ""


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
    columns = {name: ColumnForms([name], forms) for name in observed.columns_read()}
    if reason := _why_none(runs, [*columns.values()], 0):
        return {name: _estimate(x)._replace(error=None, reason=reason) for name, x in first.items()}
    numbers = [name for name, x in first.items() if not isinstance(x, Estimate)]

    def evaluate(form: Form) -> Array:
        return numbers_of(function(form.result(columns)), numbers)

    try:
        after = _numbers_after_divergence(function, runs, diverged, [*columns])
        every = _evaluations_of_function(evaluate, forms, columns) if numbers else None
        others = [*runs.results, *([] if runs.witness is None else [runs.witness])]
        given = [function(result) for result in others] if len(numbers) < len(first) else []
    except Exception as error:  # noqa: BLE001 - whatever the function of a person raises
        reason = OTHER_ROWS.format(error)
        return {name: _estimate(x)._replace(error=None, reason=reason) for name, x in first.items()}
    orders = {column.orders[0] for column in columns.values()} or {runs.nominal_order("")}
    possible = np.array(sorted(orders))[:, None]
    estimates = {}
    if every is not None:
        estimates = dict(zip(numbers, combined(every, possible, forms)))
        if any(x.error is None and name not in after for name, x in estimates.items()):
            coarse = _common_row_errors(evaluate, forms)
            lacking = np.array([x.error is None for x in estimates.values()])
            rows = every.row_error()
            every.rows = np.where(lacking & (coarse >= rows), coarse, rows)
            estimates = dict(zip(numbers, combined(every, possible, forms)))
    for name, x in first.items():
        if name in after and not (isinstance(x, Estimate) and x.error is None):
            estimates[name] = _estimate(x)._replace(error=None, reason=diverged.reason)
        elif isinstance(x, Estimate):
            estimates[name] = _with_coupling(x, [run.get(name) for run in given], possible, forms)
    return {name: estimates[name] for name in first}


def _common_row_errors(evaluate: Evaluate, forms: Forms) -> Array:
    """The errors of numbers due to the spacing of the common rows of the runs, which may hide their differences."""
    value, common = evaluate(forms.of_runs[0]), forms.of_runs[0].result({})
    try:
        few = {n: [evaluate(form) for form in some] for n, some in forms.thinned(common).items()}
    except Exception:  # noqa: BLE001 - whatever the function of a person raises
        return np.full(len(value), math.nan)
    return Evaluations(value, value[None], few).row_error()


def _estimate(x: float | Estimate) -> Estimate:
    return x if isinstance(x, Estimate) else Estimate(float(x), None)


def _with_coupling(
    x: Estimate, others: Sequence[float | Estimate | None], orders: Array, forms: Forms
) -> Estimate:
    """A number that brings the error of its rows, with that of the coupling added; the runs, and the witness behind three."""
    if x.error is None:
        return x
    runs = [run for run in others if isinstance(run, Estimate) and run.error is not None]
    if len(runs) < len(others):
        return x._replace(error=None, reason=SOME_RUNS)
    values = [run.value for run in runs]
    if len(set(values)) == 1 and x.value == values[0] == round(x.value):
        return x  # a count that all runs agree on
    every = np.array(values)[:, None]
    e = Evaluations(
        np.array([x.value]), every[:RUNS], witness=[*every[RUNS:]], rows=np.array([x.error]),
        noise=max(run.error or 0.0 for run in runs),
    )  # fmt: skip
    return combined(e, orders, forms)[0]._replace(unit=x.unit)


def _evaluations_of_function(
    evaluate: Evaluate, forms: Forms, columns: Mapping[str, ColumnForms]
) -> Evaluations:
    """All values of numbers that a function makes of the rows of the columns that it reads.

    A function cannot look between rows: what all of them change of a number that the common ones give is an error of the
    rows, and a change to a step of zero within it says nothing.
    """
    e = Evaluations.of_all(evaluate, forms)
    rows = e.row_error()
    if columns and (times := even_times_if_uneven(forms.runs.dense["time"])) is not None:
        rows = rows + CONFIRMED_FACTOR * np.abs(evaluate(forms.even(times)) - e.value)
    e.rows = np.where(np.isnan(rows), rows, np.fmax(rows, np.abs(e.value - e.runs[0])))
    e.shifts = [np.where(np.abs(x) <= e.rows, 0.0, x) for x in e.shifts]
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
