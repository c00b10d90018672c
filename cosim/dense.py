"""A column of a result as a function of time: cubic splines between breakpoints.

A run gives rows. Between them the solution is smooth except at breakpoints: where two rows have the same
time, where a discrete column changes, and where a part changes its course inside a step without telling
the master (`hidden_gaps`). A spline through a breakpoint would ring, so each piece has its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from math import comb
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Rows through which a cubic is laid: derived, a polynomial of degree 3 has four coefficients.
CUBIC_ROWS = 4
#: Stencils beside a gap that must be smooth: derived, so many of the stencils of CUBIC_ROWS + 1 rows
#: share no gap but touch the next rows, and one of them alone may vanish where a curve turns.
SMOOTH_STENCILS = 3
#: Ratio of a fourth difference to the largest of its neighbours from which on a gap hides an event. Derived:
#: a mode that decays by exp(-2.08) = 1/8 from row to row is not resolved by the rows, and is like a jump.
GAP_RATIO = 8.0
#: Fourth differences below this share of a column's range are noise: convention, the square root of the
#: machine precision, 1.5e-8, rounded down.
NOISE_FRACTION = 1e-8
#: Rows closer than this share of the median spacing repeat their neighbour. Derived: the slope between two
#: such rows loses three digits more than that between others, and a spline through both rings.
REPEATED_FRACTION = 1e-3
#: Rows of which polynomials are made at a time, which bounds the memory: with all that is computed of one, 2^17 rows
#: take 36 MB (measured).
CHUNK_ROWS = 1 << 17
#: Rows of overlap of two such chunks. Derived: a spline forgets a row by a factor 2 - sqrt(3) per row further,
#: so that 32 rows leave 5e-19.
OVERLAP_ROWS = 32


class Side(Enum):
    """How a gap that hides an event is filled."""

    LINE = "a straight line between its two rows"
    BEFORE = "the polynomial before it, up to its end"
    AFTER = "the polynomial after it, from its beginning"


@dataclass(frozen=True)
class Extreme:
    """A largest or smallest value and its time [s]."""

    value: float
    time: float


class DenseSolution:
    """A column between its rows.

    Parameters
    ----------
    t : array of shape (rows,)
        Times [s], which do not fall. Two rows with the same time and other values are a jump.
    x : array of shape (rows,)
        Values. If all are whole numbers, the column is discrete and keeps a value until the next row.
    gaps : array of int, optional
        Numbers k of rows behind which, before row k + 1, an event is hidden; by default `hidden_gaps`
        looks for them.
    side : Side
        How these gaps are filled. The truth lies between Side.BEFORE and Side.AFTER: it follows the
        first up to the event and the second from then on.
    """

    def __init__(
        self, t: Array, x: Array, gaps: Indices | None = None, side: Side = Side.LINE
    ) -> None:
        self.t, self.x, self.side = t, x, side
        self.is_discrete = _are_integers(x[:CHUNK_ROWS]) and _are_integers(x[CHUNK_ROWS:])
        if gaps is None:
            gaps = np.flatnonzero(np.diff(x)) if self.is_discrete else hidden_gaps(t, x)
        self.gaps = gaps

    @classmethod
    def from_rows(cls, t: Array, x: Array) -> DenseSolution:
        """The solution of rows of which some may repeat the one before, or nearly."""
        distinct = distinct_rows(t, x)
        return cls(t, x) if distinct.all() else cls(t[distinct], x[distinct])

    def with_values(self, x: Array) -> DenseSolution:
        """Other values at the same times, with the same gaps, such as the square of this column."""
        other = DenseSolution(self.t, x, self.gaps, self.side)
        other.is_discrete = self.is_discrete
        return other

    def filled(self, side: Side) -> DenseSolution:
        """The same rows with their gaps filled from another side.

        From the side after it, the first interval counts as a gap, too: a start need not be smooth, and what
        relaxes within the first step shows in no row.
        """
        gaps = np.union1d(self.gaps, [0]) if side is Side.AFTER else self.gaps
        other = DenseSolution(self.t, self.x, gaps.astype(np.intp), side)
        other.is_discrete = self.is_discrete
        return other

    def with_extremes(self, sign: float) -> Array:
        """The values of the rows, of which those behind a gap may be higher (or lower, for a sign of -1).

        Where a polynomial that fills a gap rises above both its rows, the row behind the gap has the largest
        value of it. The start counts as a gap, see `filled`.
        """
        x = self.x.copy()
        if self.is_discrete:
            return x
        for side in (Side.AFTER, Side.BEFORE):
            solution = self.filled(side)
            for k in solution.gaps:
                highest = solution.highest_in_gap(int(k), sign)
                if highest > max(sign * self.x[k], sign * self.x[k + 1], sign * x[k + 1]):
                    x[k + 1] = sign * highest
        return x

    def start_extreme(self, width: Array, sign: float) -> tuple[int, float]:
        """The row behind the first interval, and the largest value in it within a band of a width around the rows.

        Multiplied by sign. The value at the start is exact, and the error grows from there, so that
        the band may have an extreme of its own between the two rows; it is -inf where it has none.
        """
        k = int(np.argmax(np.diff(self.t) > 0.0))
        edge = DenseSolution(self.t, self.x + sign * width, self.gaps, self.side)
        edge.is_discrete = self.is_discrete
        highest = edge.highest_in_gap(k, sign)
        inside = highest > max(sign * edge.x[k], sign * edge.x[k + 1])
        return k + 1, highest if inside else -np.inf

    def with_start_extreme(self, width: Array, sign: float) -> Array:
        """The values of the rows, of which the first behind the start has the extreme of `start_extreme`."""
        x = self.x.copy()
        k, highest = self.start_extreme(width, sign)
        if highest > max(sign * x[k - 1], sign * x[k]):
            x[k] = sign * highest
        return x

    def with_top_lowered(self, width: Array, begin: float = 1.0, end: float = 1.0) -> Array:
        """The values of the rows, of which the highest are lower by a width and the lowest ones higher.

        The width is multiplied by `begin` at the first of them and by `end` at the last, evenly in between. These are the rows around the extreme, to the middle of the range and to where they turn again.
        """
        x = self.x.copy()
        middle = 0.5 * (float(x.min()) + float(x.max()))
        if not self.is_discrete:
            for sign in (1.0, -1.0):
                top = _around_top(sign * self.x)
                half = sign * self.x[top] > sign * middle
                weights = np.linspace(begin, end, top.stop - top.start)
                x[top] -= np.where(half, sign * weights * width[top], 0.0)
        return x

    def highest_in_gap(self, k: int, sign: float) -> float:
        """The largest value of sign times the polynomial from row k to row k + 1."""
        low = max(0, k - OVERLAP_ROWS)
        p = self._polynomial(low, min(len(self.t) - 1, k + 1 + OVERLAP_ROWS))
        inside = (p.x[:-1] >= self.t[k]) & (p.x[:-1] < self.t[k + 1])
        values, _ = _peaks(sign * p.c[:, inside], p.x[:-1][inside], np.diff(p.x)[inside])
        return float(values.max(initial=-np.inf))

    def thinned(self, n: int, first: int) -> DenseSolution:
        """The solution of the rows first, first + n, ..., of the first and the last row."""
        start, end = slice(0, min(first, 1)), slice(-1, None)
        if (len(self.t) - 1 - first) % n == 0:
            end = slice(0, 0)
        t, x = (
            np.concatenate([values[start], values[first::n], values[end]])
            for values in (self.t, self.x)
        )
        before = (self.gaps - first) // n + min(first, 1)  # the row of these in front of a gap
        other = DenseSolution(t, x, np.unique(np.maximum(before, 0)), self.side)
        other.is_discrete = self.is_discrete
        return other

    def between(self, begin: float, end: float) -> DenseSolution:
        """The part from one time to another [s], which get rows of their own."""
        begin, end = max(begin, float(self.t[0])), min(end, float(self.t[-1]))
        inside = np.flatnonzero((self.t > begin) & (self.t < end))
        ends = self(np.array([begin, end]))
        first = int(np.searchsorted(self.t, begin, side="right")) - 1
        t = np.concatenate([[begin], self.t[inside], [end]])
        x = np.concatenate([ends[:1], self.x[inside], ends[1:]])
        gaps = self.gaps - first
        other = DenseSolution(t, x, gaps[(gaps >= 0) & (gaps < len(t) - 1)], self.side)
        other.is_discrete = self.is_discrete
        return other

    def __call__(self, t: Array) -> Array:
        """The values at times [s] between the first and the last row; shape of t."""
        values = np.empty(np.shape(t))
        for polynomial in self.polynomials():
            inside = (t >= polynomial.x[0]) & (t <= polynomial.x[-1])
            values[inside] = polynomial(t[inside])
        return values

    def polynomials(self) -> Iterator[PPoly]:
        """Polynomials of degree 3 that follow each other from the first row to the last."""
        rows = len(self.t)
        for low in range(0, max(rows - 1, 1), CHUNK_ROWS):
            high = min(low + CHUNK_ROWS, rows - 1)
            yield self._polynomial(low, high)

    def _polynomial(self, low: int, high: int) -> PPoly:
        """The polynomials from row `low` to row `high`."""
        from scipy.interpolate import PPoly

        begin, end = max(0, low - OVERLAP_ROWS), min(len(self.t), high + OVERLAP_ROWS + 1)
        t, x = self.t[begin:end], self.x[begin:end]
        if self.is_discrete:
            c = np.zeros((4, len(t) - 1))
            c[3] = x[:-1]
        else:
            c = self._coefficients(t, x, begin)
        gaps = self.gaps[(self.gaps >= begin) & (self.gaps < end - 1)] - begin
        _fill(c, t, x, gaps, self.side)
        used = slice(low - begin, high - begin)
        widths = np.diff(t)[used]
        wide = widths > 0.0
        breaks = np.concatenate([t[used][wide], t[high - begin : high - begin + 1]])
        return PPoly(c[:, used][:, wide], breaks)

    def _coefficients(self, t: Array, x: Array, begin: int) -> Array:
        """A spline for each piece; those of the gaps between them are not set."""
        from scipy.interpolate import CubicSpline

        c = np.zeros((4, len(t) - 1))
        jumps = np.flatnonzero(np.diff(t) <= 0.0)
        inside = self.gaps[(self.gaps >= begin) & (self.gaps < begin + len(t) - 1)] - begin
        cuts = np.union1d(jumps, inside)
        for first, last in zip(
            np.concatenate([[0], cuts + 1]), np.concatenate([cuts, [len(t) - 1]])
        ):
            if last > first:
                c[:, first:last] = CubicSpline(t[first : last + 1], x[first : last + 1]).c[-4:]
        return c

    def largest(self) -> Extreme:
        """The largest value, at a row or where a polynomial has no slope."""
        row = int(np.argmax(self.x))
        value, time = float(self.x[row]), float(self.t[row])
        for p in self.polynomials():
            values, times = _peaks(p.c, p.x[:-1], np.diff(p.x))
            if len(values) and values.max() > value:
                k = int(np.argmax(values))
                value, time = float(values[k]), float(times[k])
        return Extreme(value, time)

    def maxima(self) -> tuple[Array, Array]:
        """The times [s] and values of all maxima.

        They are those of rows that no neighbour exceeds, or of the polynomials beside them if those are
        higher; ends of gaps and of pieces are among them.
        """
        padded = np.concatenate([[-np.inf], self.x, [-np.inf]])
        at = np.flatnonzero((self.x >= padded[:-2]) & (self.x >= padded[2:]))
        times, values = self.t[at], self.x[at]
        for p in self.polynomials():
            tops, top_times = (
                extrema.reshape(-1, p.c.shape[1]) for extrema in _peaks(p.c, p.x[:-1], np.diff(p.x))
            )
            best = tops.argmax(axis=0), np.arange(p.c.shape[1])
            tops, top_times = tops[best], top_times[best]
            rows = np.flatnonzero((self.t[at] >= p.x[0]) & (self.t[at] <= p.x[-1]))
            after = np.searchsorted(p.x, self.t[at[rows]], side="right") - 1
            for piece in (np.maximum(after - 1, 0), np.minimum(after, len(tops) - 1)):
                higher = tops[piece] > values[rows]
                values[rows[higher]] = tops[piece[higher]]
                times[rows[higher]] = top_times[piece[higher]]
        return times, values

    def integral(self) -> float:
        """The integral over time from the first row to the last."""
        return float(sum(p.integrate(p.x[0], p.x[-1]) for p in self.polynomials()))


def _are_integers(x: Array) -> bool:
    """Whether all values are integers."""
    return bool(np.array_equal(x, np.round(x)))


def _around_top(x: Array) -> slice:
    """The rows around the highest, down to where they rise again."""
    top, steps = int(np.argmax(x)), np.diff(x)
    falls, rises = np.flatnonzero(steps[:top] < 0.0), np.flatnonzero(steps[top:] > 0.0)
    return slice(falls[-1] + 1 if len(falls) else 0, top + rises[0] + 1 if len(rises) else len(x))


def _peaks(coefficients: Array, begin: Array, width: Array) -> tuple[Array, Array]:
    """The values and times of all points where polynomials have no slope, begin or end."""
    a, b, c, d = coefficients
    start = np.zeros(len(width))
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - 3.0 * a * c)
        # The roots of 3 a s^2 + 2 b s + c, without cancellation, whatever of a and b vanishes.
        q = -(b + np.copysign(root, b))
        candidates = np.stack([q / (3.0 * a), c / q, start, width])
        values = ((a * candidates + b) * candidates + c) * candidates + d
    inside = (candidates >= 0.0) & (candidates <= width) & np.isfinite(values)
    values = np.where(inside, values, -np.inf)
    return values.ravel(), (begin + candidates).ravel()


def _fill(c: Array, t: Array, x: Array, gaps: Indices, side: Side) -> None:
    """Set the coefficients in gaps, from the next piece that has a polynomial.

    Without such a piece they keep the value of its row.
    """
    hidden = {int(k) for k in gaps}
    for k in gaps:
        width = t[k + 1] - t[k]
        if side is Side.LINE:
            c[:, k] = [0.0, 0.0, (x[k + 1] - x[k]) / width if width else 0.0, x[k]]
            continue
        step = -1 if side is Side.BEFORE else 1
        neighbour = int(k) + step
        while neighbour in hidden:
            neighbour += step
        if not 0 <= neighbour < c.shape[1]:
            c[:, k] = [0.0, 0.0, 0.0, x[k] if side is Side.BEFORE else x[k + 1]]
            continue
        shift = t[k] - t[neighbour]
        of = c[:, neighbour]
        c[:, k] = [
            sum(of[3 - m] * comb(m, n) * shift ** (m - n) for m in range(n, 4))
            for n in range(3, -1, -1)
        ]


def _median_gap(gaps: Array) -> float:
    """The median of the gaps that are above 0; 0 without any."""
    positive = gaps[gaps > 0.0]
    return float(np.median(positive, overwrite_input=True)) if len(positive) else 0.0


def distinct_rows(t: Array, x: Array) -> NDArray[np.bool_]:
    """Which rows say something new.

    These are not the rows that repeat a time with the same value, nor those that come right after
    another, as the row of an event beside one of the grid.

    Of several rows at one time the first and the last are kept, the values before and after a jump.
    """
    gaps = np.diff(t)
    if not len(gaps):
        return np.ones(len(t), dtype=bool)
    least = REPEATED_FRACTION * _median_gap(gaps)
    distinct = np.ones(len(t), dtype=bool)
    distinct[1:] = (gaps > least) | ((gaps == 0.0) & (np.diff(x) != 0.0))
    distinct[-1] = True
    if len(gaps) > 1 and not gaps[-1] > least and gaps[-1] > 0.0:
        distinct[-2] = False
    return distinct


def hidden_gaps(t: Array, x: Array) -> Indices:
    """Find the rows k behind which, before row k + 1, a smooth column changes its course.

    The cubic through the four rows on one side of a gap predicts the row on the other side. Where the curve
    is smooth, it does so nearly as well as the cubics further away from the gap do for their rows; where
    something has happened in between, such as an impact, its error is at least GAP_RATIO times
    theirs. This compares the stencils of an ENO scheme (Harten, Engquist, Osher and Chakravarthy, J. Comput.
    Phys. 71, 1987). Looked for from both sides, since only one may be smooth.

    It fails where two events are less than eight rows apart, so that neither side is smooth; where an event
    changes only the third derivative or a higher one; and for kinks below NOISE_FRACTION of the range.
    It takes motions that decay by more than a factor of 8 per row for events; an extrapolation over one
    gap then only widens an error.
    """
    many = len(t) - CUBIC_ROWS
    if many <= SMOOTH_STENCILS:
        return np.zeros(0, dtype=np.intp)
    floor = NOISE_FRACTION * float(np.ptp(x))
    gaps = []
    for low in range(0, len(t), CHUNK_ROWS):
        part = slice(max(0, low - OVERLAP_ROWS), low + CHUNK_ROWS + OVERLAP_ROWS)
        if len(t[part]) - CUBIC_ROWS <= SMOOTH_STENCILS:
            continue
        after = _leaps(t[part], x[part], floor)
        before = _leaps(-t[part][::-1], x[part][::-1], floor)
        gaps.append(part.start + np.concatenate([after, len(t[part]) - 2 - before]))
    return np.unique(np.concatenate(gaps)).astype(np.intp)


def _leaps(t: Array, x: Array, floor: float) -> Indices:
    """Gaps behind rows that the cubic through the next four does not predict, although it is smooth."""
    many = len(t) - CUBIC_ROWS
    windows = np.lib.stride_tricks.sliding_window_view
    nodes, values = windows(t, CUBIC_ROWS)[1:], windows(x, CUBIC_ROWS)[1:]
    predicted = np.zeros(many)
    with np.errstate(all="ignore"):
        for i in range(CUBIC_ROWS):
            other_nodes = [j for j in range(CUBIC_ROWS) if j != i]
            weight = np.prod(
                [(t[:many] - nodes[:, j]) / (nodes[:, i] - nodes[:, j]) for j in other_nodes],
                axis=0,
            )
            predicted += weight * values[:, i]
        error = np.abs(predicted - x[:many])
    smooth_error = windows(error, SMOOTH_STENCILS)[1:].max(axis=1)
    leaps = np.flatnonzero(error[:-SMOOTH_STENCILS] > np.maximum(GAP_RATIO * smooth_error, floor))
    # The stencils of the next rows reach over the same gap; the one that begins right behind it is the last.
    return leaps[np.append(np.diff(leaps) > CUBIC_ROWS, True)] if len(leaps) else leaps
