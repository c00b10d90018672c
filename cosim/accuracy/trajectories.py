"""Columns of runs whose steps, or tolerances, differ by one ratio: at a step of zero, and where they diverge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..dense import GAP_RATIO, NOISE_FRACTION, Array, DenseSolution, separate
from ..result import Result
from .limit import CONFIRMED_FACTOR, LOWEST_ORDER, ROUNDING_SHARE, STEP_RATIO, limit

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
#: Steps after the first whose moves are compared with it: derived, one or two of them may lie at a turn.
RELAXED = 3
#: The reason why numbers are refused after trajectories have diverged.
DIVERGED = "not converged: the runs diverge from {:.4g} s on"
Rows = tuple[Array, Array]


@dataclass(frozen=True)
class ErrorBand:
    """What remains to the solution of a column at the times that all runs have.

    Attributes
    ----------
    finest : DenseSolution
        The column in the finest run.
    times : array of shape (times,)
        The times that all runs have [s].
    shift : array of shape (times,)
        What the extrapolation to a step of zero adds; nothing where the values do not converge regularly.
    widths : array of shape (times,)
        By how much the values of the finest run may be off: by the shift with the factor of safety where they
        converge regularly, whose order one value alone does not confirm or refute, and with the lowest order where
        they do not converge.
    regular : array of bool
        Where they converge.
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
    finest: DenseSolution, runs: Sequence[Rows], order: float, ratio: float = STEP_RATIO
) -> ErrorBand:
    """Extrapolate a column that is continuous to a step of zero, value by value.

    Parameters
    ----------
    finest : DenseSolution
        The column in the finest run.
    runs : sequence of two or three pairs of arrays
        Times [s] and values of the column in each run, the finest first.
    order : float
        The order of the algorithm for this column.
    ratio : float
        The ratio of the steps of two runs.
    """
    shared, values = shared_values(runs)
    if len(values) == 2:  # noqa: PLR2004 - a run lacks
        values = [*values, np.full(len(shared), math.nan)]
    rounding = ROUNDING_SHARE * max(abs(float(finest.x.min())), abs(float(finest.x.max())))
    of_runs = limit(values, order, ratio, noise=rounding)
    shift = of_runs.extrapolated - values[0]
    irregular = np.abs(values[0] - values[1]) / (math.pow(ratio, LOWEST_ORDER) - 1.0)
    widths = np.where(of_runs.is_stated, of_runs.error, irregular)
    return ErrorBand(
        finest,
        times=shared,
        shift=shift,
        widths=np.where(shift != 0.0, CONFIRMED_FACTOR * np.abs(shift) + rounding, widths),
        regular=of_runs.is_stated,
        rounding=rounding,
    )


def shared_rows(times: Sequence[Array]) -> list[NDArray[np.intp]] | None:
    """The rows of each run at the times [s] that all have; None if these are less than half of the coarsest run's."""
    shared = times[-1]
    for t in times[:-1]:
        shared = shared[_is_in(shared, t)]
    if 2 * len(shared) < len(times[-1]) or len(shared) <= 1:
        return None
    return [_row_index(t, shared) for t in times]


def shared_values(runs: Sequence[Rows]) -> tuple[Array, list[Array]]:
    """The times [s] that all runs have, and the values of each at these.

    Where they are less than half of the coarsest run's times, the finer ones are interpolated to those.
    """
    rows = shared_rows([t for t, _ in runs])
    if rows is None:
        shared, coarse = runs[-1]
        times = separate(shared)
        return shared, [*(DenseSolution.from_rows(*run)(times) for run in runs[:-1]), coarse]
    return runs[-1][0][rows[-1]], [x[k] for (_, x), k in zip(runs, rows)]


def slow_order(runs: Sequence[Rows], ratio: float = STEP_RATIO) -> float | None:
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
    _, (fine, middle, coarse) = shared_values(runs)
    last, previous = fine - middle, middle - coarse
    is_distinct = np.abs(last) > ROUNDING_SHARE * float(np.abs(fine).max())
    if not is_distinct.any():
        return None
    with np.errstate(all="ignore"):
        falls = np.log(previous[is_distinct] / last[is_distinct]) / math.log(ratio)
    slow = (falls > 0.0) & (falls < LOWEST_ORDER)
    return float(np.median(falls[slow])) if np.mean(slow) >= SLOW_SHARE else None


def relaxes_within_a_step(result: Result) -> bool:
    """Whether a column moves in the first step, or in the first one after a jump, by far more than in the next ones.

    A part then relaxes within a step. Errors that arise there fall with no power of the step before steps are much
    shorter, and differences of runs show the order of the algorithm by chance.
    """
    t = result["time"]
    begins = np.concatenate([[0], np.flatnonzero(np.diff(t) == 0.0) + 1])
    begins = begins[begins + 1 + RELAXED < len(t)]
    for column in result.columns[1:]:
        if column.kind.is_held:
            continue
        x = result[column.name]
        moves = np.abs(np.array([x[begins + k + 1] - x[begins + k] for k in range(RELAXED + 1)]))
        first, later = moves[0], moves[1:].max(axis=0)
        if ((first > GAP_RATIO * later) & (first > NOISE_FRACTION * np.ptp(x))).any():
            return True
    return False


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


@dataclass(frozen=True)
class Divergence:
    """The time [s] from which on the finest two of three runs have diverged, and the columns in which they have."""

    begin: float = math.inf
    columns: frozenset[str] = frozenset()

    @property
    def reason(self) -> str:
        """Why a number that needs later rows is refused."""
        return DIVERGED.format(self.begin)


def divergence(results: Sequence[Result], ratio: float = STEP_RATIO) -> Divergence:
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
    results : sequence of three results
        The runs, the finest first.
    ratio : float
        The ratio of the steps of two runs.

    Returns
    -------
    Divergence
        The time is infinite, and there is no column, if the runs have not diverged.
    """
    t = results[-1]["time"]
    times = separate(t)
    parts = np.array_split(np.arange(len(t)), min(PARTS, len(t)))
    distant: dict[str, NDArray[np.bool_]] = {}
    first = len(parts)
    for column in results[0].columns[1:]:
        runs = [
            np.interp(times, separate(result["time"]), result[column.name]) for result in results
        ]
        last, previous = (
            np.array([np.abs(short - long)[part].mean() for part in parts])
            for short, long in pairwise(runs)
        )
        least = max(DISTANT_SHARE * np.ptp(runs[0]), ROUNDING_SHARE * np.abs(runs[0]).max())
        padded = np.pad(previous, NEIGHBOURS)
        around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1).max(axis=1)
        distant[column.name] = last > least
        diverged = distant[column.name] & (last > around / ratio**LOWEST_ORDER)
        if diverged.any() and not column.kind.is_held:
            first = min(first, int(diverged.argmax()))
    if first == len(parts):
        return Divergence()
    columns = frozenset(name for name, there in distant.items() if there[first:].any())
    return Divergence(float(t[parts[first][0]]), columns)


def widened(t: Array, x: Array, begin: float) -> Array:
    """Values of which those from a time [s] on are DIVERGED_WIDTH times as far from their middle.

    What a chaotic system does after its runs have diverged is not known; another trajectory may go further than
    the one of a run.
    """
    other, is_after = x.copy(), t >= begin
    if is_after.any():
        middle = 0.5 * (x[is_after].min() + x[is_after].max())
        other[is_after] = middle + DIVERGED_WIDTH * (x[is_after] - middle)
    return other
