"""Columns of three runs whose steps, or tolerances, differ by one ratio: at a step of zero, and where they diverge.

What numbers and values make of three runs is in `limit`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dense import Array, DenseSolution, separate
from .estimate import Estimate
from .limit import LOWEST_ORDER, ROUNDING_SHARE, STEP_RATIO, limit

#: Ratio of two tolerances of adaptive steps: convention, steps of order 1 then differ by sqrt(10).
TOLERANCE_RATIO = 10.0
#: Parts of a run over which trajectories are compared: convention, a jump that one run makes a row later
#: than another is a small share of such a part, and a run that has diverged fills many.
PARTS = 20
#: Mean distance of two trajectories over a part, as a share of the range of a column, from which on they may
#: have diverged. Derived: two states of the Lorenz attractor drawn at random are 0.2 to 0.3 of the range
#: apart; runs that converge and are so far apart show it by falling differences.
DISTANT_SHARE = 0.1
#: Parts before and after one in which the coarser runs are looked at, too: convention. Where two runs differ in
#: phase, their distance vanishes twice a period, and not at the same times for each pair.
NEIGHBOURS = 2
#: Share of the rows whose differences must fall too slowly for a column to be refused. Measured on the systems of
#: benchmarks/certify.py: in 1008 columns of systems and machines it is at most 0.74, in the synthetic case that has
#: no order it is 1 in each of 16 runs. From 0.8 to 0.95 the same columns are refused.
SLOW_SHARE = 0.9
#: By how much later values may be further from their middle than those of a run that has diverged. Such values are
#: draws from an attractor whose range one run need not show. Measured on 1008 figures of the chaotic case of
#: benchmarks/certify.py, 24 draws: with 1, 9 of 364 errors stated do not hold and the worst is off by 10^4 times;
#: with 1.5, 2 and 3 all of 153, 151 and 145 hold.
DIVERGED_WIDTH = 2.0
#: Runs from which an order is observed: derived, two differences need three.
RUNS = 3
#: Differences that do not fall by this factor are not extrapolated: a convention of this project, not derived.
SLOWEST_FALL = 1.5
#: Differences below this share of a value are those of a settled orbit: a convention of this project.
SETTLED_SHARE = 1e-9
#: Differences in no order up to this share of a value still give an error: convention, three digits.
UNORDERED_SHARE = 1e-3
#: Factor on such differences: convention, twice the spread for each of two runs.
UNORDERED_FACTOR = 4.0
#: Smallest error of an extrapolated value as a share of the last difference, for limits of both pairs that agree by
#: accident: a convention of this project, not derived.
EXTRAPOLATION_SHARE = 0.02
#: The reasons why nothing is extrapolated.
UNSTABLE = "the run with four times the step is unstable, so that no error can be estimated"
NOT_CONVERGED = "results do not converge as the step is halved"
#: The reason why numbers are refused after trajectories have diverged.
DIVERGED = "not converged: the runs diverge"
#: The reason why all numbers of a column are refused.
COLUMN_NOT_CONVERGED = "not converged: the error of {} falls with order {:.1f}"


@dataclass(frozen=True)
class ErrorBand:
    """What remains to the solution of a column at the times that all three runs have.

    Attributes
    ----------
    finest : DenseSolution
        The column in the finest run.
    times : array of shape (times,)
        The times that all runs have [s].
    shift : array of shape (times,)
        What the extrapolation to a step of zero adds; nothing where the values do not converge regularly.
    widths : array of shape (times,)
        By how much the values of the finest run may be off; with the lowest order where they do not converge.
    regular : array of bool
        Where they converge regularly.
    rounding : float
        What is added to each width.
    """

    finest: DenseSolution
    times: Array
    shift: Array
    widths: Array
    regular: NDArray[np.bool_]
    rounding: float

    @property
    def solution(self) -> DenseSolution:
        """The column extrapolated to a step of zero, at the times of the finest run; made anew at each call."""
        return self.finest.with_values(self._at_rows(self.shift, self.finest.x))

    @property
    def width(self) -> DenseSolution:
        """By how much each value may be off, at the times of the finest run; made anew at each call."""
        return self.finest.with_values(self._at_rows(self.widths, self.rounding))

    def _at_rows(self, values: Array, addend: Array | float) -> Array:
        """Values at all rows of the finest run, and what is added to them."""
        rows: Array = np.interp(separate(self.finest.t), separate(self.times), values)
        rows += addend
        return rows

    def converges_at(self, time: float) -> bool:
        """Whether the values before and after a time [s] do, both that are in all runs."""
        k = min(max(int(np.searchsorted(self.times, time)), 1), len(self.times) - 1)
        return bool(self.regular[k - 1] and self.regular[k])


def error_band(
    finest: DenseSolution,
    runs: Sequence[tuple[Array, Array]],
    order: float,
    ratio: float = STEP_RATIO,
) -> ErrorBand | None:
    """Extrapolate a column to a step of zero, value by value.

    Parameters
    ----------
    finest : DenseSolution
        The column in the finest run.
    runs : sequence of three pairs of arrays
        Times [s] and values of the column in each run, the finest first.
    order : float
        The order of the algorithm for this column.
    ratio : float
        The ratio of the steps of two runs.

    Returns
    -------
    ErrorBand or None
        None for a discrete column.
    """
    if finest.is_discrete:
        return None
    shared, fine, middle, coarse = _shared_values(runs)
    rounding = ROUNDING_SHARE * max(abs(float(finest.x.min())), abs(float(finest.x.max())))
    of_runs = limit([fine, middle, coarse], order, ratio, noise=rounding)
    irregular = np.abs(fine - middle) / (math.pow(ratio, LOWEST_ORDER) - 1.0)
    return ErrorBand(
        finest,
        times=shared,
        shift=of_runs.extrapolated - fine,
        widths=np.where(of_runs.is_stated, of_runs.error, irregular),
        regular=of_runs.is_stated,
        rounding=rounding,
    )


def _shared_values(runs: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, Array, Array]:
    """The times [s] that all three runs have, and the values of each at these.

    Where they are less than half of the coarsest run's times, the finer two are interpolated to those.
    """
    shared = runs[2][0]
    for t, _ in runs[:2]:
        shared = shared[_is_in(shared, t)]
    if 2 * len(shared) < len(runs[2][0]) or len(shared) <= 1:
        shared, coarse = runs[2]
        times = separate(shared)
        fine, middle = (DenseSolution.from_rows(*run)(times) for run in runs[:2])
    else:
        fine, middle, coarse = (x[_row_index(t, shared)] for t, x in runs)
    return shared, fine, middle, coarse


def slow_order(runs: Sequence[tuple[Array, Array]], ratio: float = STEP_RATIO) -> float | None:
    """The order, below LOWEST_ORDER, with which the error of a whole column falls; None if it is not so slow.

    Differences of three runs count as slow where they keep their sign and fall with a lower order. A column is
    slow where at least the share SLOW_SHARE of its rows is; noise of solvers has either sign, and runs that have
    not yet come to their order fall fast in some rows.

    Parameters
    ----------
    runs : sequence of three pairs of arrays
        Times [s] and values of the column in each run, the finest first.
    ratio : float
        The ratio of the steps of two runs.
    """
    _, fine, middle, coarse = _shared_values(runs)
    last, previous = fine - middle, middle - coarse
    is_distinct = np.abs(last) > ROUNDING_SHARE * float(np.abs(fine).max())
    if not is_distinct.any():
        return None
    with np.errstate(all="ignore"):
        falls = np.log(previous[is_distinct] / last[is_distinct]) / math.log(ratio)
    slow = (falls > 0.0) & (falls < LOWEST_ORDER)
    return float(np.median(falls[slow])) if np.mean(slow) >= SLOW_SHARE else None


def _is_in(times: Array, sorted_times: Array) -> NDArray[np.bool_]:
    """Which times are among sorted ones, but for rounding."""
    rounding = ROUNDING_SHARE * max(abs(float(sorted_times[0])), abs(float(sorted_times[-1])))
    k = np.clip(np.searchsorted(sorted_times, times), 1, len(sorted_times) - 1)
    nearest = np.minimum(np.abs(sorted_times[k] - times), np.abs(sorted_times[k - 1] - times))
    return np.asarray(nearest <= rounding)


def _row_index(t: Array, times: Array) -> NDArray[np.intp]:
    """The row at each of these times, which are times of rows but for rounding: the first and the last of two equal ones."""
    rounding = ROUNDING_SHARE * max(abs(float(t[0])), abs(float(t[-1])))
    last = np.searchsorted(t, times + rounding, side="right") - 1
    is_before = np.append(np.diff(times) == 0.0, False)
    return np.where(is_before, np.searchsorted(t, times - rounding), last)


def divergence(
    runs: Sequence[NDArray[np.float64]], ratio: float = STEP_RATIO, held: Sequence[int] = ()
) -> tuple[float, NDArray[np.bool_]]:
    """Find the time [s] from which on the finest two of three runs have diverged, and in which columns.

    In a chaotic system two trajectories part exponentially, however close they begin. When their distance
    has reached the size of the attractor, smaller steps do not reduce it, and the difference of two
    numbers does not show their error any more. Trajectories have diverged where, over one of PARTS parts of
    the run, they are on average more than the share DISTANT_SHARE of the range of a column apart, and that
    distance is not smaller than between the coarser two, near that part, by at least LOWEST_ORDER.

    It fails for runs that diverge by less than that share, and for a difference of phase that the coarser
    runs do not have within NEIGHBOURS parts.

    Parameters
    ----------
    runs : sequence of three arrays of shape (rows, columns)
        The rows of the runs, the finest first; the first column is the time [s].
    ratio : float
        The ratio of the steps of two runs.
    held : sequence of int
        The columns whose values hold from row to row, which are left out.

    Returns
    -------
    tuple of float and array of bool
        The time is infinite, and there is no column, if the runs have not diverged.
    """
    t = runs[-1][:, 0]
    parts = np.array_split(np.arange(len(t)), min(PARTS, len(t)))
    fine, middle, coarse = (
        np.column_stack([t, *(np.interp(separate(t), separate(rows[:, 0]), x) for x in rows.T[1:])])
        for rows in runs
    )
    last, previous = (
        np.array([np.abs(of_short_step - of_long_step)[part].mean(axis=0) for part in parts])
        for of_short_step, of_long_step in ((fine, middle), (middle, coarse))
    )
    rounding = ROUNDING_SHARE * np.abs(fine).max(axis=0)
    least = np.maximum(DISTANT_SHARE * np.ptp(fine, axis=0), rounding)
    padded = np.pad(previous, ((NEIGHBOURS, NEIGHBOURS), (0, 0)))
    around = np.max([padded[k : k + len(previous)] for k in range(2 * NEIGHBOURS + 1)], axis=0)
    distant = last > least
    diverged = distant & (last > around / ratio**LOWEST_ORDER)
    diverged[:, list(held)] = False
    if not diverged.any():
        return math.inf, np.zeros(fine.shape[1], dtype=bool)
    first = int(diverged.any(axis=1).argmax())
    return float(t[parts[first][0]]), distant[first:].any(axis=0)


def after_widened(t: Array, x: Array, begin: float) -> Array:
    """Values of which those from a time [s] on are DIVERGED_WIDTH times as far from their middle.

    What a chaotic system does after its runs have diverged is not known; another trajectory may go further than
    the one of a run.

    Parameters
    ----------
    t : array of shape (rows,)
        Times [s].
    x : array of shape (rows,) or (rows, columns)
        Values.
    begin : float
        The time [s].
    """
    widened, is_after = x.copy(), t >= begin
    if is_after.any():
        middle = 0.5 * (x[is_after].min(axis=0) + x[is_after].max(axis=0))
        widened[is_after] = middle + DIVERGED_WIDTH * (x[is_after] - middle)
    return widened


def extrapolate(
    values: Sequence[float], order: float, errors: Sequence[float] = (0.0, 0.0, 0.0)
) -> Estimate:
    """Extrapolate values of runs with the steps h, 2 h and 4 h to a step of zero (Richardson).

    Parameters
    ----------
    values : sequence of floats
        The value with the step h, 2 h and 4 h; fewer where the runs with longer steps have failed.
    order : float
        The order with which the error falls.
    errors : sequence of floats
        What else the values may be wrong by, such as the errors of the searches that found them.

    Returns
    -------
    Estimate
        Its error is the distance of what the finer pair of runs extrapolates to from what the coarser pair does,
        which is 2^q times as wrong where differences fall with the order q; below order 1 the distance is less than
        the error and is divided by 2^q - 1. The errors of the finer two values are added with the weights that
        these have in the extrapolated one. Values that move by little and in no order are not
        extrapolated and keep four times their moves as error. The error is None, with a reason, where there are
        fewer than three values, or where they move by more and in no order.
    """
    if len(values) < RUNS:
        return Estimate(values[0], None, math.nan, reason=UNSTABLE)
    fine, middle, coarse = values
    last, previous = fine - middle, middle - coarse
    most = max(abs(last), abs(previous))
    if abs(previous) < SLOWEST_FALL * abs(last) or most <= SETTLED_SHARE * abs(fine):
        if most > UNORDERED_SHARE * abs(fine):
            return Estimate(fine, None, math.nan, reason=NOT_CONVERGED)
        return Estimate(fine, UNORDERED_FACTOR * most + errors[0], math.nan)
    observed = math.log2(abs(previous / last)) if last else math.inf
    gain = STEP_RATIO**order - 1.0
    limit, coarse_limit = fine + last / gain, middle + previous / gain
    distance = abs(limit - coarse_limit)
    if observed < 1.0:
        distance /= math.pow(STEP_RATIO, observed) - 1.0
    error = distance + EXTRAPOLATION_SHARE * abs(last)
    error_of_values = errors[0] + (errors[0] + errors[1]) / gain
    return Estimate(limit, error + error_of_values, observed)
