"""Columns of runs whose steps, or tolerances, differ by one ratio: at a step of zero, and where they diverge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dense import NOISE_FRACTION, Array, Curves, separate
from ..result import Result
from .limit import LOWEST_ORDER, ROUNDING_SHARE, RUNS, STEP_RATIO, limit

#: Parts of a run over which trajectories are compared: convention, a jump that one run makes a row later
#: than another is a small share of such a part, and a run that has diverged fills many.
PARTS = 20
#: Parts before and after one in which the coarser runs are looked at, too: convention. Where two runs differ in
#: phase, their distance vanishes twice a period, and not at the same times for each pair.
NEIGHBOURS = 2
#: Share of the rows whose differences must fall too slowly for a column to be refused. Measured on the systems of
#: benchmarks/certify.py: in 1008 columns of systems and machines it is at most 0.74, in the synthetic case that has
#: no order it is 1 in each of 16 runs. From 0.8 to 0.95 the same columns are refused.
SLOW_SHARE = 0.9
#: By how much later values may be further from their middle than those of a run that has diverged. Such values are
#: draws from an attractor whose range one run need not show. Measured, before runs were compared with values drawn at
#: random, on 1008 figures of the chaotic case of benchmarks/certify.py, 24 draws: with 1, 9 of 364 errors stated do not
#: hold and the worst is off by 10^4 times; with 1.5, 2 and 3 all of 153, 151 and 145 hold.
DIVERGED_WIDTH = 2.0
#: Steps after the first whose moves are compared with it: derived, one or two of them may lie at a turn.
RELAXED = 3
#: The reason why numbers are refused after trajectories have diverged.
DIVERGED = "not converged: the runs diverge from {:.4g} s on"


class AtZero(NamedTuple):
    """Columns extrapolated to a step of zero, and where, at the times that all runs have [s], they converge regularly."""

    solution: Curves
    times: Array
    regular: NDArray[np.bool_]

    def converges_at(self, times: Array, columns: Sequence[int]) -> NDArray[np.bool_]:
        """Whether the values of columns before and after times [s], shape (times, columns), do, both that are in all runs."""
        k = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        regular = self.regular[columns, k - 1] & self.regular[columns, k]
        return np.asarray(regular & np.isfinite(times))


def extrapolate(
    finest: Curves, times: Array, runs: Sequence[Array], orders: Array, ratio: float = STEP_RATIO
) -> AtZero:
    """Extrapolate columns that are continuous to a step of zero, value by value.

    Parameters
    ----------
    finest : Curves
        The columns in the finest run.
    times : array of shape (times,)
        Those that all runs have [s].
    runs : sequence of two or three arrays of shape (columns, times)
        The values of each run at these, the finest first.
    orders : array of shape (columns,)
        The order of the algorithm for each column.
    ratio : float
        The ratio of the steps of two runs.
    """
    lacks = [np.full_like(runs[0], math.nan)] * (RUNS - len(runs))
    values = np.array([*runs, *lacks])
    rounding = ROUNDING_SHARE * np.abs(finest.x).max(axis=1, keepdims=True)
    of_runs = limit(values, orders[:, None], ratio, noise=rounding)
    shift, rows, at = of_runs.extrapolated - values[0], separate(finest.t), separate(times)
    moved = np.array([np.interp(rows, at, of) for of in shift])
    return AtZero(finest.with_values(finest.x + moved), times, of_runs.is_stated)


def shared_rows(times: Sequence[Array]) -> list[NDArray[np.intp]] | None:
    """The rows of each run at the times [s] that all have; None if these are less than half of the coarsest run's."""
    shared = times[-1]
    for t in times[:-1]:
        shared = shared[_is_in(shared, t)]
    if 2 * len(shared) < len(times[-1]) or len(shared) <= 1:
        return None
    return [_row_index(t, shared) for t in times]


def too_slow_orders(runs: Sequence[Array], ratio: float = STEP_RATIO) -> Array:
    """The order, below LOWEST_ORDER, with which the error of whole columns falls; nan for those where it is not so slow.

    Differences of three runs count as slow where they keep their sign and fall with a lower order. A column is
    slow where at least the share SLOW_SHARE of its rows is; noise of solvers has either sign, and runs that have
    not yet come to their order fall fast in some rows.

    Parameters
    ----------
    runs : sequence of three arrays of shape (columns, times)
        The values of each run at times that all have, the finest first.
    ratio : float
        The ratio of the steps of two runs.
    """
    fine, middle, coarse = runs
    last, previous = fine - middle, middle - coarse
    is_distinct = np.abs(last) > ROUNDING_SHARE * np.abs(fine).max(axis=1, keepdims=True)
    with np.errstate(all="ignore"):
        falls = np.log(previous / last) / math.log(ratio)
    slow = is_distinct & (falls > 0.0) & (falls < LOWEST_ORDER)
    rows = is_distinct.sum(axis=1)
    orders = np.full(len(fine), math.nan)
    for k in np.flatnonzero((slow.sum(axis=1) >= SLOW_SHARE * rows) & (rows > 0)):
        orders[k] = np.median(falls[k][slow[k]])
    return orders


def relaxes_within_a_step(t: Array, x: Array) -> bool:
    """Whether a column moves in the first step, or in the first one after a jump, by more than e times as far as in the next ones.

    A part then relaxes within a step. A step that holds what has relaxed before its end leaves an error in proportion to
    the time constant, not to the step, so that it is in no difference of runs; and where what is in them vanishes by
    chance, it is all of the error (the boundary layer of a singular perturbation, Hairer and Wanner, Solving ODEs II, VI.3).

    Parameters
    ----------
    t : array of shape (rows,)
        Times [s].
    x : array of shape (columns, rows)
        Columns that are continuous.
    """
    begins = np.concatenate([[0], np.flatnonzero(np.diff(t) == 0.0) + 1])
    begins = begins[begins + 1 + RELAXED < len(t)]
    moves = np.abs([x[:, begins + k + 1] - x[:, begins + k] for k in range(RELAXED + 1)])
    first, later = moves[0], moves[1:].max(axis=0)
    ranges = np.ptp(x, axis=1)[:, None] if x.size else np.zeros((len(x), 1))
    return bool(((first > math.e * later) & (first > NOISE_FRACTION * ranges)).any())


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


def find_divergence(results: Sequence[Result], ratio: float = STEP_RATIO) -> Divergence:
    """Find the time [s] from which on the finest two of three runs have diverged, and in which columns.

    In a chaotic system two trajectories part exponentially, however close they begin. When their distance
    has reached the size of the attractor, smaller steps do not reduce it, and the difference of two
    numbers does not show their error any more. Two runs are apart where, over one of PARTS parts of the
    run, their mean distance is above half of that of two values of the column drawn at random: half of what it
    comes to in the end is the limit of predictability (Lorenz, J. Atmos. Sci. 26, 1969). Runs have diverged where the
    finest two are apart and no nearer than the coarser two, near that part, by at least LOWEST_ORDER.

    They have also diverged from where the coarser two are apart if these part exponentially, and from where they are
    as far apart as at random in any case: their difference then shows no order, and in a chaotic system the finest
    two part as they did, some growth times later. These are the decoupling times of Teixeira, Reynolds and Judd
    (J. Atmos. Sci. 64, 2007).

    It fails for runs that diverge by less than that, and for a difference of phase that the coarser
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
    times, columns = separate(t), results[0].columns[1:]
    if not columns:
        return Divergence()
    runs = [
        np.array([np.interp(times, separate(r["time"]), r[c.name]) for c in columns])
        for r in results
    ]
    many = min(PARTS, len(t))
    begins = np.array([part[0] for part in np.array_split(np.arange(len(t)), many)])
    sizes = np.diff(begins, append=len(t))
    # a level that changes with the step says nothing of how runs part
    _, middle, coarse = (x - x.mean(axis=1, keepdims=True) for x in runs)
    last, previous, beside_level = (
        np.add.reduceat(np.abs(finer - coarser), begins, axis=1) / sizes
        for finer, coarser in (*pairwise(runs), (middle, coarse))
    )
    rank = np.arange(1.0 - len(times), len(times), 2.0)
    at_random = 2.0 * np.max([np.sort(x, axis=1) @ rank for x in runs], axis=0) / len(times) ** 2
    at_random = np.maximum(at_random, ROUNDING_SHARE * np.abs(runs[0]).max(axis=1))[:, None]
    padded = np.pad(previous, ((0, 0), (NEIGHBOURS, NEIGHBOURS)))
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1, axis=1).max(
        axis=2
    )
    apart, coarser_apart = last > 0.5 * at_random, beside_level > 0.5 * at_random
    ends = t[begins + sizes - 1] - t[0]
    grows = [
        parts_exponentially(ends[: k + 1], of[: k + 1])
        for of, k in zip(beside_level, coarser_apart.argmax(axis=1))
    ]
    parted = (beside_level > at_random) | (coarser_apart & np.array(grows)[:, None])
    is_held = np.array([[column.kind.is_held] for column in columns])
    parted = np.logical_or.accumulate(parted, axis=1) & ~is_held
    apart &= ~is_held
    diverged = ((apart & (last > around / ratio**LOWEST_ORDER)) | parted).any(axis=0)
    if not diverged.any():
        return Divergence()
    first = int(diverged.argmax())
    there = (apart | parted)[:, first:].any(axis=1)
    names = frozenset(c.name for c, is_apart in zip(columns, there) if is_apart)
    return Divergence(float(t[begins[first]]), names)


def parts_exponentially(t: Array, distance: Array) -> bool:
    """Whether the largest distance up to each time after the start [s] grows exponentially with time, not as a power of it.

    The logarithm of the distance is then correlated more closely with the time than with the logarithm of the time.
    """
    grown = np.maximum.accumulate(distance)
    has_both = (grown > 0.0) & (t > 0.0)
    t, grown = t[has_both], grown[has_both]
    if len(t) <= RUNS or not grown[-1] > grown[0]:
        return False
    by_time, by_power = np.corrcoef([np.log(grown), t, np.log(t)])[0, 1:]
    return bool(by_time > by_power)


def spread_after(t: Array, x: Array, begin: float) -> Array:
    """Values of which those from a time [s] on are DIVERGED_WIDTH times as far from their middle.

    What a chaotic system does after its runs have diverged is not known; another trajectory may go further than
    the one of a run.
    """
    other, is_after = x.copy(), t >= begin
    if is_after.any():
        middle = 0.5 * (x[is_after].min() + x[is_after].max())
        other[is_after] = middle + DIVERGED_WIDTH * (x[is_after] - middle)
    return other
