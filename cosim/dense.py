"""A column of a result as a function of time: cubic splines between breakpoints.

A run gives rows. Between them the solution is smooth except at breakpoints: where two rows have the same
time, in the breaks that the master knows, and where a part changes its course inside a step without telling
the master (`hidden_gaps`). A spline through a breakpoint would ring, so each piece has its own. A column that
is not continuous keeps the value of a row until the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from itertools import pairwise
from math import comb
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .series import NO_BREAKS, Kind

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
#: Rows up to which the polynomials are kept for the next question about the column: derived, the dozen forms in which
#: `certify` looks at a column then take 13 MB.
KEPT_ROWS = 1 << 15
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
        Times [s], which do not fall. Two rows with the same time are a jump.
    x : array of shape (rows,)
        Values.
    kind : Kind
        What the values are; those of any kind but continuous hold until the next row.
    breaks : array of shape (breaks, 2)
        Intervals, begin and end [s], in which the master knows of a jump without rows at its time.
    gaps : array of int, optional
        Numbers k of rows behind which, before row k + 1, an event is hidden; by default those of the breaks
        and those that `hidden_gaps` finds.
    side : Side
        How these gaps are filled. The truth lies between Side.BEFORE and Side.AFTER: it follows the
        first up to the event and the second from then on.
    """

    def __init__(
        self,
        t: Array,
        x: Array,
        kind: Kind = Kind.CONTINUOUS,
        breaks: Array = NO_BREAKS,
        *,
        gaps: Indices | None = None,
        side: Side = Side.LINE,
    ) -> None:
        self.t, self.x, self.kind, self.breaks, self.side = t, x, kind, breaks, side
        if gaps is None and kind.is_held:
            gaps = np.flatnonzero(np.diff(x))
        elif gaps is None:
            gaps = np.union1d(broken_gaps(t, breaks), hidden_gaps(t, x)).astype(np.intp)
            gaps = np.union1d(gaps, lonely_intervals(t, gaps)).astype(np.intp)
        self.gaps = gaps

    @classmethod
    def from_rows(
        cls, t: Array, x: Array, kind: Kind = Kind.CONTINUOUS, breaks: Array = NO_BREAKS
    ) -> DenseSolution:
        """The solution of rows of which some may repeat the one before, or nearly."""
        distinct = distinct_rows(t, x, breaks)
        if not distinct.all():
            t, x = t[distinct], x[distinct]
        return cls(t, x, kind, breaks)

    @property
    def is_discrete(self) -> bool:
        """Whether its values hold from a row to the next."""
        return self.kind.is_held

    def _with(self, t: Array, x: Array, gaps: Indices, side: Side | None = None) -> DenseSolution:
        """The same column with other rows."""
        side = self.side if side is None else side
        return DenseSolution(t, x, self.kind, self.breaks, gaps=gaps, side=side)

    def with_values(self, x: Array) -> DenseSolution:
        """Other values at the same times, with the same gaps, such as the square of this column."""
        return self._with(self.t, x, self.gaps)

    def filled(self, side: Side) -> DenseSolution:
        """The same rows with their gaps filled from another side.

        From the side after it, the first interval counts as a gap, too: a start need not be smooth, and what
        relaxes within the first step shows in no row.
        """
        gaps = np.union1d(self.gaps, [0]) if side is Side.AFTER else self.gaps
        return self._with(self.t, self.x, gaps.astype(np.intp), side)

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
        edge = self.with_values(self.x + sign * width)
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
        """The solution of the rows first, first + n, ..., of the first and the last row, and of both at a jump."""
        kept = thinned_rows(self.t, n, first)
        before = np.cumsum(kept)[self.gaps] - 1  # the row of these in front of a gap
        return self._with(self.t[kept], self.x[kept], np.unique(before).astype(np.intp))

    def between(self, begin: float, end: float) -> DenseSolution:
        """The part from one time to another [s], which get rows of their own.

        It begins with the value after a jump at its first time, and ends with that before one at its last.
        """
        begin, end = max(begin, float(self.t[0])), min(end, float(self.t[-1]))
        inside = np.flatnonzero((self.t > begin) & (self.t < end))
        ends = self(np.array([begin, end]))
        last = int(np.searchsorted(self.t, end))
        if last < len(self.t) - 1 and self.t[last] == end:
            ends[1] = self.x[last]
        first = int(np.searchsorted(self.t, begin, side="right")) - 1
        t = np.concatenate([[begin], self.t[inside], [end]])
        x = np.concatenate([ends[:1], self.x[inside], ends[1:]])
        gaps = self.gaps - first
        return self._with(t, x, gaps[(gaps >= 0) & (gaps < len(t) - 1)])

    def __call__(self, t: Array) -> Array:
        """The values at times [s] between the first and the last row, and nan elsewhere; shape of t."""
        values = np.full(np.shape(t), np.nan)
        for polynomial in self.polynomials():
            inside = (t >= polynomial.x[0]) & (t <= polynomial.x[-1])
            values[inside] = polynomial(t[inside])
        return values

    def polynomials(self) -> Iterator[PPoly]:
        """Polynomials of degree 3 that follow each other from the first row to the last."""
        rows = len(self.t)
        if rows <= KEPT_ROWS:
            yield self._whole
            return
        for low in range(0, max(rows - 1, 1), CHUNK_ROWS):
            high = min(low + CHUNK_ROWS, rows - 1)
            yield self._polynomial(low, high)

    @cached_property
    def _whole(self) -> PPoly:
        """The polynomials of all rows, made once, where they are few enough to be kept."""
        return self._polynomial(0, len(self.t) - 1)

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
        _fill(c, (t, x), gaps, self.side, broken_gaps(t, self.breaks))
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
        return self._extremes[0]

    def smallest(self) -> Extreme:
        """The smallest value, at a row or where a polynomial has no slope."""
        return self._extremes[1]

    @cached_property
    def _extremes(self) -> tuple[Extreme, Extreme]:
        """The largest and the smallest value."""
        rows = int(np.argmax(self.x)), int(np.argmin(self.x))
        high, low = ((float(self.x[row]), float(self.t[row])) for row in rows)
        for p in self.polynomials():
            values, times = _turns(p.c, p.x[:-1], np.diff(p.x))
            if not len(values):
                continue
            top, bottom = np.nanargmax(values), np.nanargmin(values)
            high = max(high, (float(values[top]), float(times[top])), key=lambda of: of[0])
            low = min(low, (float(values[bottom]), float(times[bottom])), key=lambda of: of[0])
        return Extreme(*high), Extreme(*low)

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


def _around_top(x: Array) -> slice:
    """The rows around the highest, down to where they rise again."""
    top, steps = int(np.argmax(x)), np.diff(x)
    falls, rises = np.flatnonzero(steps[:top] < 0.0), np.flatnonzero(steps[top:] > 0.0)
    return slice(falls[-1] + 1 if len(falls) else 0, top + rises[0] + 1 if len(rises) else len(x))


def _turns(coefficients: Array, begin: Array, width: Array) -> tuple[Array, Array]:
    """The values and times of all points where polynomials have no slope, begin or end; nan where there is none."""
    a, b, c, d = coefficients
    start = np.zeros(len(width))
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - 3.0 * a * c)
        # The roots of 3 a s^2 + 2 b s + c, without cancellation, whatever of a and b vanishes.
        q = -(b + np.copysign(root, b))
        candidates = np.stack([q / (3.0 * a), c / q, start, width])
        values = ((a * candidates + b) * candidates + c) * candidates + d
    inside = (candidates >= 0.0) & (candidates <= width) & np.isfinite(values)
    values = np.where(inside, values, np.nan)
    return values.ravel(), (begin + candidates).ravel()


def _peaks(coefficients: Array, begin: Array, width: Array) -> tuple[Array, Array]:
    """The values and times of `_turns`; -inf where there is none."""
    values, times = _turns(coefficients, begin, width)
    return np.where(np.isnan(values), -np.inf, values), times


def _fill(c: Array, rows: tuple[Array, Array], gaps: Indices, side: Side, broken: Indices) -> None:
    """Set the coefficients in gaps between rows, from the next piece that has a polynomial.

    Without such a piece up to the next jump they keep the value of its row; but behind a `broken` gap, whose row
    in front says nothing of what follows, there are no values, nan.
    """
    t, x = rows
    hidden, unknown = {int(k) for k in gaps}, {int(k) for k in broken}
    for k in gaps:
        width = t[k + 1] - t[k]
        if side is Side.LINE:
            c[:, k] = [0.0, 0.0, (x[k + 1] - x[k]) / width if width else 0.0, x[k]]
            continue
        step = -1 if side is Side.BEFORE else 1
        neighbour = int(k) + step
        while neighbour in hidden and t[neighbour] < t[neighbour + 1]:
            neighbour += step
        if not 0 <= neighbour < c.shape[1] or t[neighbour] == t[neighbour + 1]:
            value = x[k] if side is Side.BEFORE else x[k + 1]
            c[:, k] = [0.0, 0.0, 0.0, np.nan if side is Side.AFTER and k in unknown else value]
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


def distinct_rows(t: Array, x: Array, breaks: Array = NO_BREAKS) -> NDArray[np.bool_]:
    """Which rows say something new, or are one of the two of a jump.

    Those do not that come right after another, as the row of an event beside one of the grid, or that repeat time
    and value of the row before, unless the time is that of one of the breaks: the slope may jump there.
    """
    gaps = np.diff(t)
    if not len(gaps):
        return np.ones(len(t), dtype=bool)
    least = REPEATED_FRACTION * _median_gap(gaps)
    distinct = np.ones(len(t), dtype=bool)
    is_jump = (np.diff(x) != 0.0) | np.isin(t[1:], breaks[breaks[:, 0] == breaks[:, 1], 0])
    distinct[1:] = (gaps > least) | ((gaps == 0.0) & is_jump)
    distinct[-1] = True
    if len(gaps) > 1 and not gaps[-1] > least and gaps[-1] > 0.0:
        distinct[-2] = False
    return distinct


def thinned_rows(t: Array, n: int, first: int) -> NDArray[np.bool_]:
    """Which rows are the first, the last, number first, first + n, ..., or one of the two at a jump."""
    kept = np.zeros(len(t), dtype=bool)
    kept[first::n] = kept[0] = kept[-1] = True
    jumps = np.flatnonzero(np.diff(t) <= 0.0)
    kept[jumps] = kept[jumps + 1] = True
    return kept


def separate(t: Array) -> Array:
    """Times of which the first of two equal ones, the row before a jump, is the next smaller number."""
    before = np.flatnonzero(np.diff(t) == 0.0)
    if not len(before):
        return t
    times = t.copy()
    times[before] = np.nextafter(times[before], -np.inf)
    return times


def broken_gaps(t: Array, breaks: Array) -> Indices:
    """The rows k behind which, before row k + 1, lies a part of one of the intervals `breaks` [s]."""
    wide = breaks[breaks[:, 1] > breaks[:, 0]]
    first = np.searchsorted(t, wide[:, 0], side="right") - 1
    last = np.searchsorted(t, wide[:, 1], side="left")
    gaps = [np.arange(max(a, 0), min(b, len(t) - 1)) for a, b in zip(first, last)]
    return np.concatenate([np.zeros(0, dtype=np.intp), *gaps])


def lonely_intervals(t: Array, gaps: Indices) -> Indices:
    """The rows k of pieces that have no other row than k and k + 1, so that nothing tells of what is between them.

    A table of two rows has none: that they are all says more than a polynomial.
    """
    cuts = np.ones(len(t) + 1, dtype=bool)
    cuts[1:-1] = np.diff(t) <= 0.0
    cuts[gaps + 1] = True
    lonely = ~cuts[1:-1] & cuts[:-2] & cuts[2:]
    return np.flatnonzero(lonely & (len(lonely) > 1))


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
    floor = NOISE_FRACTION * float(np.ptp(x)) if len(x) else 0.0
    ends = [0, *(np.flatnonzero(np.diff(t) <= 0.0) + 1), len(t)]
    gaps = [np.zeros(0, dtype=np.intp)]
    for begin, end in pairwise(ends):
        for low in range(begin, end, CHUNK_ROWS):
            part = slice(max(begin, low - OVERLAP_ROWS), min(end, low + CHUNK_ROWS + OVERLAP_ROWS))
            if part.stop - part.start - CUBIC_ROWS <= SMOOTH_STENCILS:
                continue
            after = _leaps(t[part], x[part], floor)
            before = _leaps(-t[part][::-1], x[part][::-1], floor)
            gaps.append(part.start + np.concatenate([after, part.stop - part.start - 2 - before]))
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
