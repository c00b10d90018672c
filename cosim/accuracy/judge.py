"""How numbers get their errors: from three runs, from the errors of the columns they are made of, from fewer rows.

A number is evaluated for the three runs on common rows; for the finest one on all its rows, with every second and
every third of them, and with the gaps that hide an event filled from either side; at a step of zero; and, where
single times decide it, with its columns moved up and down by their errors, one at a time. The largest effect
counts, and that of the rows is added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ..metrics import Metric
from ..result import Result, Rows
from .estimate import Estimate
from .limit import CONFIRMED_FACTOR, UNCONFIRMED_FACTOR, Reason, likeliest
from .nested import RUNS, NestedRuns
from .trajectories import Divergence, widened
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
#: By how much of its error a peak is lowered at its begin and at its end: all of it or either end. Derived: the top of
#: a plateau lies at one end of it.
TILTS = ((1.0, 1.0), (0.0, 1.0), (1.0, 0.0))
#: A function from a result to numbers by name; an `Estimate` brings the error of its rows.
Function = Callable[[Result], Mapping[str, "float | Estimate"]]


@dataclass
class Evaluations:
    """The values of one number.

    Attributes
    ----------
    value
        With all rows of the finest run.
    runs
        Of the three runs, on common rows, finest first.
    thinned
        With every second and every third row, each from every first row.
    sides
        With gaps that hide an event filled otherwise.
    shifts
        Pairs of values from and to a step of zero.
    beside
        With columns moved by their errors.
    doubt
        How far it may be off because something else is as good within the error of its column.
    scale
        What an error without an order is compared with.
    rows
        The error that it brings for the spacing of the rows; by default, that is what `thinned` and `sides` show.
    noise
        The same for the values of the runs on common rows; by default that of `rows`.
    """

    value: float
    runs: Sequence[float]
    thinned: Mapping[int, Sequence[float]] = field(default_factory=dict)
    sides: Sequence[float] = ()
    shifts: Sequence[tuple[float, float]] = ()
    beside: Sequence[float] = ()
    doubt: float = 0.0
    scale: float = 0.0
    rows: float | None = None
    noise: float = 0.0

    def row_error(self) -> float:
        """The error due to the spacing of the rows; nan if fewer of them give no value."""
        if self.rows is not None:
            return self.rows
        if not self.thinned:
            return 0.0
        second, third = (_largest(x - self.value for x in self.thinned[n]) for n in THINNED)
        hidden = _largest(x - self.value for x in self.sides)
        if not math.isfinite(second + third + hidden):
            return math.nan
        return CONFIRMED_FACTOR * max(spacing_error(second, third), hidden)


@dataclass(frozen=True)
class Circumstances:
    """What is known of a number beside its values: the orders that it may have, and the ratio of the steps.

    `converges` says whether its columns do at the times that decide it, `is_regular` whether nothing speaks against
    an order that is observed, `has_jumps` whether that is an input which jumps inside a step of one of the runs.
    """

    orders: Sequence[float]
    ratio: float
    converges: bool = False
    is_regular: bool = True
    has_jumps: bool = False


def combined(e: Evaluations, known: Circumstances) -> Estimate:
    """The estimate of a number.

    Its error is the largest of what the three runs show, of what the extrapolation of its columns changes, with a
    factor of safety, of what their errors change and of its doubt; that of the rows is added. Where the number has
    no order, but its columns converge at the times that decide it, the spread of the runs takes its place; where an
    input jumps at another share of a step in each run, so that there is no order, three times that spread.
    """
    rows = e.row_error()
    if math.isnan(e.value):
        return Estimate(e.value, None, reason=Reason.NO_VALUE.sentence())
    if not math.isfinite(rows):
        return Estimate(e.value, None, reason=NO_ROWS)
    if any(math.isnan(x) for x in e.runs):
        return Estimate(e.value, None, rows=rows, reason=SOME_RUNS)
    runs = [*e.runs, *[math.nan] * (RUNS - len(e.runs))]
    noises = [rows, *[max(rows, e.noise)] * (RUNS - 1)]
    of_runs = likeliest(
        runs, known.orders, known.ratio, noises, scale=e.scale, is_regular=known.is_regular
    )
    order = float(of_runs.order)
    shift = _largest(to - of for of, to in e.shifts)
    beside = _largest(x - e.value for x in e.beside)
    if math.isnan(shift + beside):
        return Estimate(e.value, None, order, rows, TOUCHES)
    if of_runs.is_stated:
        error = float(of_runs.error) - rows
    elif known.converges and of_runs.reason != Reason.GROWING:
        error = max(max(e.runs) - min(e.runs), UNCONFIRMED_FACTOR * shift)
    elif known.has_jumps and of_runs.reason != Reason.GROWING:
        error = float(of_runs.error) - rows
    else:
        return Estimate(e.value, None, order, rows, of_runs.sentence())
    agree = shift * CONFIRMED_FACTOR**2 <= UNCONFIRMED_FACTOR * error and known.is_regular
    factor = CONFIRMED_FACTOR if agree else UNCONFIRMED_FACTOR
    return Estimate(e.value, max(error, factor * shift, beside, e.doubt) + rows, order, rows)


def _largest(changes: Iterable[float]) -> float:
    """The largest of changes by size, 0 of none; nan if one of them is."""
    return float(np.abs([0.0, *changes]).max())


def spacing_error(second: float, third: float) -> float:
    """The error with all rows, from the changes with every second and every third row.

    An error C h^q becomes C (2 h)^q and C (3 h)^q, so that the changes are 2^q - 1 and 3^q - 1 times it. The ratio
    of the two shows q.
    """
    low, high = ROW_ORDERS
    ratios = [(3.0**q - 1.0) / (2.0**q - 1.0) for q in ROW_ORDERS]
    position = (third / second - ratios[0]) / (ratios[1] - ratios[0]) if second else 1.0
    q = low + (high - low) * min(max(position, 0.0), 1.0)
    return float(max(third / (3.0**q - 1.0), second / (2.0**q - 1.0)))


def judge_metrics(
    metrics: Mapping[str, Metric], runs: NestedRuns, diverged: Divergence
) -> dict[str, Estimate]:
    """The estimates of metrics; those of the same columns share the curves of these.

    Parameters
    ----------
    metrics : mapping of str to Metric
        By name.
    runs : NestedRuns
        The runs.
    diverged : Divergence
        From when on, and in which columns, these have diverged.
    """
    forms, units = Forms(runs, diverged), runs.finest.units
    estimates: dict[str, Estimate] = {}
    for name in sorted(metrics, key=lambda name: metrics[name].columns):
        metric = metrics[name]
        columns = forms.of(metric.columns)
        unit = metric.unit(units.get(metric.columns[0], ""))
        estimate = _judge_metric(metric, columns, runs, diverged, is_regular=forms.is_regular)
        if estimate.error is None and math.isnan(estimate.value) and not estimate.reason:
            finest = [column.finest for column in columns]
            reason = metric.lack(units.get(metric.columns[0], ""), *finest)
            estimate = estimate._replace(reason=reason)
        estimates[name] = estimate._replace(unit=unit)
    return {name: estimates[name] for name in metrics}


def _judge_metric(
    metric: Metric,
    columns: Sequence[ColumnForms],
    runs: NestedRuns,
    diverged: Divergence,
    *,
    is_regular: bool,
) -> Estimate:
    """The estimate of a metric, without its unit."""
    finest = [column.finest for column in columns]
    value = metric(*finest)
    if math.isnan(value):
        touched = any(not math.isnan(x) for x in _beside(metric, columns))
        return Estimate(value, None, reason=TOUCHES if touched else "")
    if reason := _why_none(runs, columns):
        return Estimate(value, None, reason=reason)
    if not _is_over(metric, columns, diverged, value):
        return Estimate(value, None, reason=diverged.reason)
    of_runs = [metric(*curves) for curves in zip(*(c.of_runs for c in columns))]
    if metric.is_count:
        return _count(value, [*of_runs, metric(*(c.at_zero for c in columns))])
    evaluations = Evaluations(
        value,
        of_runs,
        _thinned(metric, columns),
        scale=metric.scale(*finest),
    )
    first = columns[0]
    if len(columns) == 1:
        evaluations.sides = [metric(curve) for curve in first.filled]
    if any(column.band is not None for column in columns):
        evaluations.shifts = [(value, metric(*(c.at_zero for c in columns)))]
        evaluations.beside = _beside(metric, columns)
    converges = False
    if len(columns) == 1 and first.band is not None:
        evaluations.shifts = [
            *evaluations.shifts, (evaluations.sides[0], metric(first.zero_filled))
        ]  # fmt: skip
        evaluations.doubt = metric.doubt(first.finest, first.width)
        times = [*metric.times(first.finest), *metric.times(first.at_zero)]
        converges = bool(times) and all(
            math.isfinite(t) and first.band.converges_at(t) for t in times
        )
    orders = sorted({column.order for column in columns})
    return combined(
        evaluations,
        Circumstances(orders, runs.ratio, converges, is_regular, runs.have_jumps_inside),
    )


def row_estimate(metric: Metric, forms: Forms, error: float) -> Estimate:
    """A metric of one result with the error of the spacing of its rows, and one of its column added."""
    columns = forms.of(metric.columns)
    value = metric(*(column.finest for column in columns))
    thinned = _thinned(metric, columns)
    sides = [metric(curve) for curve in columns[0].filled] if len(columns) == 1 else []
    rows = Evaluations(value, [value], thinned, sides).row_error()
    unit = metric.unit(forms.runs.finest.units.get(metric.columns[0], ""))
    if not math.isfinite(rows):
        return Estimate(value, None, reason=NO_ROWS, unit=unit)
    return Estimate(value, rows + error, rows=rows, unit=unit)


def _why_none(runs: NestedRuns, columns: Sequence[ColumnForms]) -> str:
    """Why no number of columns has an error; "" if one may have."""
    if len(runs.results) == 1:
        return runs.lost
    if not runs.refines:
        return SAME_STEPS
    for column in columns:
        if column.slow is not None:
            return COLUMN_NOT_CONVERGED.format(column.name, column.slow)
    return ""


def _thinned(metric: Metric, columns: Sequence[ColumnForms]) -> dict[int, list[float]]:
    """A metric with every second and every third row, from each first one."""
    return {n: [metric(*(c.thinned(n, k) for c in columns)) for k in range(n)] for n in THINNED}


def _beside(metric: Metric, columns: Sequence[ColumnForms]) -> list[float]:
    """A metric with its columns moved up and down by their errors, one at a time, where then other times decide it.

    What moves at the same times is in the error of the number itself.
    """
    if not metric.is_local:
        return []
    curves = [column.finest for column in columns]
    times = np.array(metric.times(*curves))
    values = []
    for k, column in enumerate(columns):
        for moved in column.beside:
            others = [*curves[:k], moved, *curves[k + 1 :]]
            distances = np.abs(np.array(metric.times(*others)) - times)
            from_start = times == curves[0].t[0]
            if not (distances <= np.where(from_start, 0.0, column.spacing)).all():
                values.append(metric(*others))
    return values


def _count(value: float, others: Sequence[float]) -> Estimate:
    """A count is right if all runs agree on it."""
    if all(other == value for other in others):
        return Estimate(value, 0.0)
    return Estimate(value, None, reason=RUNS_DISAGREE)


def _is_over(
    metric: Metric, columns: Sequence[ColumnForms], diverged: Divergence, value: float
) -> bool:
    """Whether a metric depends only on the rows before its columns diverge, if they do.

    That is so if it has the same value without the later rows, and with later values spread further from
    their middle, as those of another chaotic trajectory might be.
    """
    if not any(column.name in diverged.columns for column in columns):
        return True
    begin, finest = diverged.begin, [column.finest for column in columns]
    if begin <= finest[0].t[1]:
        return False
    wide = [
        curve.with_values(widened(curve.t, curve.x, begin))
        if column.name in diverged.columns
        else curve
        for column, curve in zip(columns, finest)
    ]
    before = [curve.between(-math.inf, begin) for curve in finest]
    return bool(metric(*before) == value == metric(*wide))


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
    columns = dict(zip(names, forms.of(names)))
    if reason := _why_none(runs, [*columns.values()]):
        return {name: _estimate(x)._replace(error=None, reason=reason) for name, x in first.items()}
    numbers = {name: x for name, x in first.items() if not isinstance(x, Estimate)}
    try:
        of_runs = [function(result) for result in (forms.results() if numbers else runs.results)]
        after = _need_later_rows(function, runs, diverged, [*columns])
        every = _evaluations(function, runs, columns, of_runs) if numbers else {}
    except Exception as error:  # noqa: BLE001 - whatever the function of a person raises
        reason = OTHER_ROWS.format(error)
        return {name: _estimate(x)._replace(error=None, reason=reason) for name, x in first.items()}
    orders = sorted({column.order for column in columns.values()} or {runs.order("")})
    known = Circumstances(
        orders, runs.ratio, is_regular=forms.is_regular, has_jumps=runs.have_jumps_inside
    )
    estimates = {}
    for name, x in first.items():
        given = _estimate(x)
        if name in after and not (isinstance(x, Estimate) and x.error is None):
            estimates[name] = given._replace(error=None, reason=diverged.reason)
        elif isinstance(x, Estimate):
            estimates[name] = _with_coupling(x, [run.get(name) for run in of_runs], known)
        else:
            estimates[name] = combined(every[name], known)
    open_ = [n for n, x in estimates.items() if x.error is None and n in every and n not in after]
    if open_:
        coarse = _coarse_rows(function, forms, of_runs)
        for name in set(open_).intersection(coarse):
            every[name].rows = max(every[name].row_error(), coarse[name])
            estimates[name] = combined(every[name], known)
    return estimates


def _coarse_rows(
    function: Function, forms: Forms, of_runs: Sequence[Mapping[str, float | Estimate]]
) -> dict[str, float]:
    """The errors of numbers due to the spacing of the common rows of the runs, which may hide their differences."""
    finest = forms.results()[0]
    try:
        fewer = {n: [function(result) for result in thinned_results(finest, n)] for n in THINNED}
    except Exception:  # noqa: BLE001 - whatever the function of a person raises
        return {}
    thinned = {
        name: {n: [number(r[name]) for r in rs] for n, rs in fewer.items()} for name in of_runs[0]
    }
    return {
        name: Evaluations(number(x), [], thinned[name]).row_error()
        for name, x in of_runs[0].items()
    }


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
    of_values = combined(Evaluations(x.value, values, rows=x.error, noise=noise), known)
    return of_values._replace(unit=x.unit)


def _evaluations(
    function: Function,
    runs: NestedRuns,
    columns: Mapping[str, ColumnForms],
    of_runs: Sequence[Mapping[str, float | Estimate]],
) -> dict[str, Evaluations]:
    """What a function makes of all the forms of the columns that it reads."""
    dense = runs.dense
    value = function(dense)
    thinned = {n: [function(result) for result in thinned_results(dense, n)] for n in THINNED}
    hidden = [
        function(
            with_columns(dense, {n: partial(c.with_extremes, sign) for n, c in columns.items()})
        )
        for sign in SIGNS
    ]
    zero = [
        function(
            with_columns(dense, {n: partial(c.zero_extremes, sign) for n, c in columns.items()})
        )
        for sign in SIGNS
    ]
    beside = [
        function(with_columns(dense, {name: partial(column.moved, sign)}))
        for name, column in columns.items()
        if column.band is not None
        for sign in SIGNS
    ]
    joint = {name: column for name, column in columns.items() if column.band is not None}
    beside += [
        function(with_columns(dense, {n: partial(c.lowered, *tilt) for n, c in joint.items()}))
        for tilt in TILTS
    ]
    every = {}
    for name, x in value.items():
        finest = number(x)
        series = [number(run[name]) for run in of_runs]
        e = Evaluations(
            finest,
            series,
            {n: [number(r[name]) for r in results] for n, results in thinned.items()},
            [number(r[name]) for r in hidden],
        )
        e.rows = max(e.row_error(), abs(finest - series[0]))
        e.shifts = [
            (number(of[name]), number(to[name]))
            for of, to in zip(hidden, zero)
            if not abs(number(of[name]) - number(to[name])) <= e.rows
        ]
        e.beside = [number(r[name]) for r in beside if not abs(number(r[name]) - finest) <= e.rows]
        every[name] = e
    return every


def number(x: float | Estimate) -> float:
    """The value of what a function gives."""
    return x.value if isinstance(x, Estimate) else float(x)


def _need_later_rows(
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
        return widened(t, x, diverged.begin) if name in diverged.columns else x

    need: set[str] = set()
    for rows in (swapped, wide):
        try:
            others = function(with_columns(finest, {n: partial(rows, n) for n in finest.names}))
        except Exception:  # noqa: BLE001 - it depends on which of the rows it gets
            return set(values)
        need |= {name for name, x in values.items() if others.get(name) != x}
    return need
