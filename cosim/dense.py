"""Columns as functions of time: cubic splines between breakpoints, for all columns of one time axis at once.

A run gives rows. Between them the solution is smooth except at breakpoints: where two rows have the same
time, in the breaks that the master knows, and where a part changes its course inside a step without telling
the master (`hidden_gaps`). A spline through a breakpoint would ring, so each piece has its own. A column that
is not continuous keeps the value of a row until the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .series import NO_BREAKS

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

#: Rows through which a cubic is laid: derived, a polynomial of degree 3 has four coefficients.
CUBIC_ROWS = 4
#: Stencils beside a gap that must be smooth: derived, so many of the stencils of CUBIC_ROWS + 1 rows
#: share no gap but touch the next rows, and one of them alone may vanish where a curve turns.
SMOOTH_STENCILS = 3
#: Ratio of a fourth difference to the largest of its neighbours from which on a gap hides an event. Derived:
#: a mode that decays by exp(-2.08) = 1/8 from row to row is not resolved by the rows, and is like a jump.
GAP_RATIO = 8.0
#: Fourth differences below this share of a column's range are noise: the square root of the machine precision, 1.5e-8,
#: rounded down, below which differences of differences have no digit (Press et al., Numerical Recipes, section 5.7).
NOISE_FRACTION = 1e-8
#: Rows closer than this share of the median spacing repeat their neighbour. Derived: the slope between two
#: such rows loses three digits more than that between others, and a spline through both rings.
REPEATED_FRACTION = 1e-3
#: Values of which polynomials are made at a time, and up to which they are kept for the next question: derived, with all
#: that is computed of one, 2^15 take 9 MB, and so do the dozen forms in which `certify` looks at them.
MOST_POINTS = 1 << 15
#: Rows of overlap of two such chunks. Derived: a spline forgets a row by a factor 2 - sqrt(3) per row further,
#: so that 32 rows leave 5e-19.
OVERLAP_ROWS = 32


class Side(Enum):
    """How a gap that hides an event is filled."""

    LINE = "a straight line between its two rows"
    BEFORE = "the polynomial before it, up to its end"
    AFTER = "the polynomial after it, from its beginning"


class Extremes(NamedTuple):
    """The largest, smallest or other values of curves and their times [s], shape (curves,)."""

    values: Array
    times: Array


class Polynomials(NamedTuple):
    """Polynomials behind some rows: coefficients of the powers 3 to 0 of the time since a row, shape (4, curves, intervals).

    `first` is the number of the first row, `t` its time and those of the next ones [s], shape (intervals,), and
    `widths` how long each interval is [s].
    """

    c: Array
    first: int
    t: Array
    widths: Array

    def at(self, s: Array) -> Array:
        """The values at times [s] since their rows, shape (curves, intervals)."""
        a, b, c, d = self.c
        return ((a * s + b) * s + c) * s + d  # type: ignore[no-any-return]


class Curves:
    """Columns of one time axis between their rows, such as those of a run, or one column of many runs.

    Parameters
    ----------
    t : array of shape (rows,)
        Times [s], which do not fall. Two rows with the same time are a jump.
    x : array of shape (curves, rows)
        Values.
    is_held : bool
        Whether the values hold until the next row.
    breaks : array of shape (breaks, 2)
        Intervals, begin and end [s], in which the master knows of a jump without rows at its time.
    gaps : array of bool, shape (curves, rows - 1), optional
        The rows behind which, before the next, an event is hidden; by default those of the breaks and those that
        `hidden_gaps` finds, or where held values change.
    side : Side
        How these gaps are filled. The truth lies between Side.BEFORE and Side.AFTER: it follows the
        first up to the event and the second from then on.
    """

    def __init__(
        self,
        t: Array,
        x: Array,
        *,
        is_held: bool = False,
        breaks: Array = NO_BREAKS,
        gaps: Mask | None = None,
        side: Side = Side.LINE,
    ) -> None:
        self.t, self.x, self.is_held, self.breaks, self.side = t, x, is_held, breaks, side
        self._of: tuple[Curves, Indices | list[int]] | None = None
        self._found: dict[float, Extremes] = {}
        if gaps is None and is_held:
            gaps = np.diff(x) != 0.0
        elif gaps is None:
            gaps = hidden_gaps(t, x)
            gaps[:, broken_gaps(t, breaks)] = True
            gaps |= lonely_intervals(t, gaps)
        self.gaps = gaps

    @classmethod
    def of_rows(
        cls, t: Array, x: Array, *, is_held: bool = False, breaks: Array = NO_BREAKS
    ) -> Curves:
        """The curves of rows of which some may repeat the one before, or nearly; x of shape (rows,) is one curve."""
        x = np.atleast_2d(np.asarray(x, dtype=np.float64))
        distinct = distinct_rows(t, x, breaks)
        if not distinct.all():
            t, x = t[distinct], x[:, distinct]
        return cls(t, x, is_held=is_held, breaks=breaks)

    def __len__(self) -> int:
        return len(self.x)

    def _with(
        self, x: Array, gaps: Mask, *, t: Array | None = None, side: Side | None = None
    ) -> Curves:
        """The same columns with other rows, or others of them."""
        return Curves(
            self.t if t is None else t, x, is_held=self.is_held, breaks=self.breaks, gaps=gaps,
            side=self.side if side is None else side,
        )  # fmt: skip

    def take(self, curves: Indices | list[int]) -> Curves:
        """Some of the curves, whose polynomials and extremes are made for all; all of them are this object itself."""
        if len(curves) == len(self) and np.array_equal(curves, np.arange(len(self))):
            return self
        some = self._with(self.x[curves], self.gaps[curves])
        if self.x.size <= MOST_POINTS:
            some._of = self, curves  # noqa: SLF001 - one of its own
        return some

    def with_values(self, x: Array) -> Curves:
        """Other values at the same times, with the same gaps, such as the squares of these."""
        return self._with(x, self.gaps)

    def filled(self, side: Side) -> Curves:
        """The same rows with their gaps filled from another side; without gaps these curves themselves."""
        return self._with(self.x, self.gaps, side=side) if self.gaps.any() else self

    def thinned(self, n: int, first: int) -> Curves:
        """The curves of the rows first, first + n, ..., of the first and the last row, and of both at a jump."""
        rows = np.flatnonzero(thinned_rows(self.t, n, first))
        gaps = np.logical_or.reduceat(self.gaps, rows[:-1], axis=1)
        return self._with(self.x[:, rows], gaps, t=self.t[rows])

    def between(self, begin: float, end: float) -> Curves:
        """The part from one time to another [s], which get rows of their own.

        It begins with the value after a jump at its first time, and ends with that before one at its last.
        """
        begin, end = max(begin, float(self.t[0])), min(end, float(self.t[-1]))
        inside = np.flatnonzero((self.t > begin) & (self.t < end))
        ends = self(np.array([begin, end]))
        last = int(np.searchsorted(self.t, end))
        if last < len(self.t) - 1 and self.t[last] == end:
            ends[:, 1] = self.x[:, last]
        first = int(np.searchsorted(self.t, begin, side="right")) - 1
        t = np.concatenate([[begin], self.t[inside], [end]])
        x = np.concatenate([ends[:, :1], self.x[:, inside], ends[:, 1:]], axis=1)
        return self._with(x, self.gaps[:, first : first + len(t) - 1], t=t)

    def __call__(self, times: Array) -> Array:
        """The values at times [s], shape (times,) or (curves, times), and nan outside the rows; shape (curves, times)."""
        times = np.broadcast_to(times, (len(self), np.shape(times)[-1]))
        wide = np.flatnonzero(np.diff(self.t) > 0.0)
        if not len(wide):
            return np.where(times == self.t[0], self.x[:, -1:], np.nan)
        values = np.full(times.shape, np.nan)
        row = wide[np.maximum(np.searchsorted(self.t[wide], times, side="right") - 1, 0)]
        inside = (times >= self.t[0]) & (times <= self.t[-1])
        for p in self.polynomials_in_chunks():
            curve, k = np.nonzero(inside & (row >= p.first) & (row < p.first + len(p.t)))
            at = row[curve, k] - p.first
            a, b, c, d = p.c[:, curve, at]
            s = times[curve, k] - p.t[at]
            values[curve, k] = ((a * s + b) * s + c) * s + d
        return values

    def polynomials_in_chunks(self) -> Iterator[Polynomials]:
        """The polynomials from the first row to the last, all at once or in chunks of rows that follow each other."""
        rows = len(self.t)
        if self.x.size <= MOST_POINTS:
            yield self._whole
            return
        many = max(MOST_POINTS // len(self), OVERLAP_ROWS)
        for low in range(0, max(rows - 1, 1), many):
            yield self._polynomials(low, min(low + many, rows - 1))

    @cached_property
    def _whole(self) -> Polynomials:
        """The polynomials of all rows, made once, where they are few enough to be kept."""
        if self._of is not None:
            every, curves = self._of
            return every._whole._replace(c=every._whole.c[:, curves])  # noqa: SLF001 - one of its own
        return self._polynomials(0, len(self.t) - 1)

    def _polynomials(self, low: int, high: int) -> Polynomials:
        """The polynomials from row `low` to row `high`."""
        begin, end = max(0, low - OVERLAP_ROWS), min(len(self.t), high + OVERLAP_ROWS + 1)
        t, x, gaps = self.t[begin:end], self.x[:, begin:end], self.gaps[:, begin : end - 1]
        widths = np.diff(t)
        c = np.zeros((4, len(self), len(widths)))
        c[3] = x[:, :-1]
        if not self.is_held:
            _lay_splines(c, widths, x, gaps | (widths <= 0.0))
        if gaps.any():
            _fill_gaps_from_side(c, (t, x), gaps, self.side, broken_gaps(t, self.breaks))
        used = slice(low - begin, high - begin)
        return Polynomials(c[:, :, used], low, t[used], widths[used])

    def row(self, k: int) -> Extremes:
        """The values and the time of row k."""
        return Extremes(self.x[:, k], np.full(len(self), self.t[k]))

    def largest(self) -> Extremes:
        """The largest values, at a row or where a polynomial has no slope."""
        return self._extremes(1.0)

    def smallest(self) -> Extremes:
        """The smallest values, at a row or where a polynomial has no slope."""
        values, times = self._extremes(-1.0)
        return Extremes(-values, times)

    def _extremes(self, sign: float) -> Extremes:
        """The largest values of sign times the curves, found once."""
        if sign not in self._found:
            every, curves = self._of or (self, None)
            self._found[sign] = (
                self._find_extremes(sign)
                if curves is None
                else Extremes(*(of[curves] for of in every._extremes(sign)))  # noqa: SLF001 - one of its own
            )
        return self._found[sign]

    def _find_extremes(self, sign: float) -> Extremes:
        """The largest values of sign times the curves.

        A cubic is nowhere above its Bezier points (Farin, Curves and Surfaces for CAGD, 2002, section 4.3): where
        these are below the highest row, it is not looked for a turn.
        """
        every, x = np.arange(len(self)), sign * self.x
        row = x.argmax(axis=1)
        values, times = x[every, row], self.t[row]
        for p in self.polynomials_in_chunks():
            _, b, c, d = p.c
            third = p.widths / 3.0
            inner = sign * (d + c * third)
            highest = np.fmax(inner, inner + sign * third * (c + b * p.widths))
            if self.side is not Side.LINE:
                highest = np.fmax(highest, np.fmax(sign * d, sign * p.at(p.widths)))
            curve, k = np.nonzero(highest > values[:, None])
            tops, top_times = _tops(p, sign, curve, k)
            before = values.copy()
            np.maximum.at(values, curve, tops)
            best = np.flatnonzero((tops == values[curve]) & (tops > before[curve]))[::-1]
            times[curve[best]] = top_times[best]
        return Extremes(values, times)

    def maxima(self) -> tuple[Indices, Array, Array]:
        """The curves, times [s] and values of all maxima.

        They are those of rows that no neighbour exceeds, or of the polynomials beside them if those are
        higher; ends of gaps and of pieces are among them.
        """
        edge = np.full((len(self), 1), -np.inf)
        rises = np.diff(self.x, prepend=edge, append=edge)
        curve, row = np.nonzero((rises[:, :-1] >= 0.0) & (rises[:, 1:] <= 0.0))
        times, values = self.t[row], self.x[curve, row]
        wide = np.flatnonzero(np.diff(self.t) > 0.0)
        after = np.searchsorted(wide, row)
        sides = [(after > 0, after - 1), (after < len(wide), after)]
        for p in self.polynomials_in_chunks():
            for there_is, interval in sides:
                beside = wide[interval % max(len(wide), 1)] if len(wide) else interval
                there = there_is & (beside >= p.first) & (beside < p.first + len(p.t))
                there = np.flatnonzero(there)
                tops, top_times = _tops(p, 1.0, curve[there], beside[there] - p.first)
                higher = tops > values[there]
                values[there[higher]], times[there[higher]] = tops[higher], top_times[higher]
        return curve, times, values

    def integral(self) -> Array:
        """The integrals over time from the first row to the last, shape (curves,)."""
        total = np.zeros(len(self))
        for p in self.polynomials_in_chunks():
            parts = (p.c[k] * (p.widths ** (4 - k) / (4 - k)) for k in range(4))
            total += sum(parts).sum(axis=-1)  # row by row: `@` has other last bits for fewer curves
        return total

    def row_values_with_gap_extremes(self, sign: float) -> Array:
        """The values of the rows, of which those behind a gap may be higher (or lower, for a sign of -1).

        Where a polynomial that fills a gap rises above both its rows, the row behind the gap has the largest
        value of it. What is held has changed a row earlier, for a sign of 1.
        """
        x = self.x.copy()
        if self.is_held:
            if sign > 0.0:
                x[:, :-1] = self.x[:, 1:]
            return x
        for side in (Side.AFTER, Side.BEFORE):
            filled = self.filled(side)
            for p in filled.polynomials_in_chunks():
                curve, k = np.nonzero(filled.gaps[:, p.first : p.first + len(p.t)])
                highest, _ = _tops(p, sign, curve, k)
                row = p.first + k
                rows = [self.x[curve, row], self.x[curve, row + 1], x[curve, row + 1]]
                better = highest > (sign * np.array(rows)).max(axis=0)
                x[curve[better], row[better] + 1] = sign * highest[better]
        return x


def ends_and_turns(c: Array, widths: Array) -> tuple[Array, Array]:
    """The times since their rows at which polynomials begin, turn and end, in order, and the values there, shape (4, ...).

    Between two of them they are monotonic. Where there is no turn, the beginning takes its place.
    """
    a, b, slope, d = c
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - 3.0 * a * slope)
        # The roots of 3 a s^2 + 2 b s + c, without cancellation, whatever of a and b vanishes.
        q = -(b + np.copysign(root, b))
        inner = np.stack([q / (3.0 * a), slope / q])
    inner = np.where(np.isfinite(inner), np.clip(inner, 0.0, widths), 0.0)
    at = np.concatenate([np.zeros((1, *widths.shape)), np.sort(inner, axis=0), widths[None]])
    return at, ((a * at + b) * at + slope) * at + d


def _tops(p: Polynomials, sign: float, curve: Indices, k: Indices) -> tuple[Array, Array]:
    """The largest values of sign times some polynomials and their times [s]; -inf where they are not known."""
    at, values = ends_and_turns(p.c[:, curve, k], p.widths[k])
    values = np.where(np.isnan(values), -np.inf, sign * values)
    best = values.argmax(axis=0), np.arange(len(k))
    return values[best], p.t[k] + at[best]


def _lay_splines(c: Array, widths: Array, x: Array, cut: Mask) -> None:
    """Set the coefficients of not-a-knot splines through the rows between cuts (de Boor, A Practical Guide to Splines, IV).

    The slopes at all rows of all curves are the solution of one tridiagonal system, whose blocks are the pieces: through
    three rows a parabola, through two a line. A curve with values that are not finite has none.
    """
    from scipy.linalg.lapack import dgtsv

    if not len(widths):
        return
    rows = x.shape[1]
    with np.errstate(all="ignore"):
        slope = np.diff(x) / widths
    slope[cut] = 0.0
    h, padded = np.ones(rows + 1), np.zeros((len(x), rows + 1))
    h[1:-1] = np.where(widths > 0.0, widths, 1.0)
    padded[:, 1:-1] = slope
    before, after = h[:-1], h[1:]
    right = 3.0 * (after * padded[:, :-1] + before * padded[:, 1:])
    lower, upper = (np.broadcast_to(w, x.shape).copy() for w in (after, before))
    diagonal = np.broadcast_to(2.0 * (before + after), x.shape).copy()
    # A piece begins behind a cut and ends in front of one; `one` is its first interval from there, `two` the next one.
    edges = np.ones((len(x), rows + 1), dtype=bool)
    edges[:, 1:-1] = cut
    for step, (of, row) in ((1, np.nonzero(edges[:, :-1])), (-1, np.nonzero(edges[:, 1:]))):
        inward, outward = (upper, lower) if step > 0 else (lower, upper)
        one = np.minimum(row, rows - 2) if step > 0 else np.maximum(row - 1, 0)
        two = np.minimum(np.maximum(one + step, 0), rows - 2)
        alone = edges[of, one + 1] | (row == (rows - 1 if step > 0 else 0))
        is_line, is_parabola = (edges[of, np.clip(one + 1 + n * step, 0, rows)] for n in (1, 2))
        w, v, m, n = widths[one], widths[two], slope[of, one], slope[of, two]
        with np.errstate(all="ignore"):
            knot = ((w + 2.0 * (w + v)) * v * m + w**2 * n) / (w + v)
        diagonal[of, row], inward[of, row], outward[of, row], right[of, row] = v, w + v, 0.0, knot
        for short, slope_inward, rise in (
            (is_parabola, 1.0, 2.0 * m),
            (is_line, 0.0, m),
            (alone, 0.0, 0.0 * m),
        ):
            if short.any():
                at = of[short], row[short]
                diagonal[at], inward[at], right[at] = 1.0, slope_inward, rise[short]
    wrong = ~np.isfinite(right).all(axis=1)
    right[wrong] = 0.0
    *_, solved, _ = dgtsv(
        lower.ravel()[1:], diagonal.ravel(), upper.ravel()[:-1], right.ravel(), 1, 1, 1, 1
    )
    s = solved.reshape(x.shape)
    s[wrong] = np.nan
    bend = (s[:, :-1] + s[:, 1:] - 2.0 * slope) / h[1:-1]
    c[0] = bend / h[1:-1]
    c[1] = (slope - s[:, :-1]) / h[1:-1] - bend
    c[2] = s[:, :-1]
    c[:3, cut] = 0.0


def _fill_gaps_from_side(
    c: Array, rows: tuple[Array, Array], gaps: Mask, side: Side, valueless: Indices
) -> None:
    """Set the coefficients in gaps between rows, from the next piece that has a polynomial.

    Without such a piece up to the next jump they keep the value of its row; but behind a `valueless` gap, whose row
    in front says nothing of what follows, there are no values, nan.
    """
    t, x = rows
    widths = np.diff(t)
    curve, k = np.nonzero(gaps)
    if side is Side.LINE:
        rise = x[curve, k + 1] - x[curve, k]
        slope = np.divide(rise, widths[k], out=np.zeros(len(k)), where=widths[k] > 0.0)
        c[:, curve, k] = [0.0 * slope, 0.0 * slope, slope, x[curve, k]]
        return
    way = (
        1 if side is Side.BEFORE else -1
    )  # rows are counted from the end if the piece is behind the gap
    every, known, jump = np.arange(len(widths)), ~gaps & (widths > 0.0), widths <= 0.0
    nearest = np.maximum.accumulate(np.where(known[:, ::way], every, -1), axis=1)[:, ::way]
    last = np.maximum.accumulate(np.where(jump[::way], every, -1))[::way]
    of, found = every[::way][nearest[curve, k]], nearest[curve, k] > last[k]
    value = x[curve, k]
    if side is Side.AFTER:
        value = np.where(np.isin(k, valueless), np.nan, x[curve, k + 1])
    of = np.where(found, of, 0)
    s = t[k] - t[of]
    cubic, square, slope, level = c[:, curve, of]
    shifted = np.stack([
        cubic, 3.0 * cubic * s + square, (3.0 * cubic * s + 2.0 * square) * s + slope,
        ((cubic * s + square) * s + slope) * s + level,
    ])  # fmt: skip
    none = np.zeros((3, len(k)))
    c[:, curve, k] = np.where(found, shifted, np.concatenate([none, value[None]]))


def _median_gap(gaps: Array) -> float:
    """The median of the gaps that are above 0; 0 without any."""
    positive = gaps[gaps > 0.0]
    return float(np.median(positive, overwrite_input=True)) if len(positive) else 0.0


def distinct_rows(t: Array, x: Array, breaks: Array = NO_BREAKS) -> Mask:
    """Which rows of x, shape (curves, rows), say something new, or are one of the two of a jump.

    Those do not that come right after another, as the row of an event beside one of the grid, or that repeat time
    and values of the row before, unless the time is that of one of the breaks: the slope may jump there.
    """
    gaps = np.diff(t)
    distinct = np.ones(len(t), dtype=bool)
    if not len(gaps):
        return distinct
    least = REPEATED_FRACTION * _median_gap(gaps)
    near = np.flatnonzero(~(gaps > least))
    if not len(near):
        return distinct
    at_break = np.isin(t[near + 1], breaks[breaks[:, 0] == breaks[:, 1], 0])
    is_jump = (x[:, near] != x[:, near + 1]).any(axis=0) | at_break
    distinct[near + 1] = (gaps[near] == 0.0) & is_jump
    distinct[-1] = True
    if len(gaps) > 1 and not gaps[-1] > least and gaps[-1] > 0.0:
        distinct[-2] = False
    return distinct


def thinned_rows(t: Array, n: int, first: int) -> Mask:
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


def lonely_intervals(t: Array, gaps: Mask) -> Mask:
    """The rows k of pieces that have no other row than k and k + 1, so that nothing tells of what is between them.

    A table of two rows has none: that they are all says more than a polynomial.
    """
    cuts = np.pad(gaps | (np.diff(t) <= 0.0), ((0, 0), (1, 1)), constant_values=True)
    lonely = ~cuts[:, 1:-1] & cuts[:, :-2] & cuts[:, 2:]
    return np.asarray(lonely & (lonely.shape[1] > 1))


def hidden_gaps(t: Array, x: Array) -> Mask:
    """Find the rows k behind which, before row k + 1, smooth columns change their course; shape (curves, rows - 1).

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
    gaps = np.zeros((len(x), max(len(t) - 1, 0)), dtype=bool)
    if not x.size:
        return gaps
    floor = NOISE_FRACTION * np.ptp(x, axis=1)
    ends = [0, *(np.flatnonzero(np.diff(t) <= 0.0) + 1), len(t)]
    many = max(MOST_POINTS // len(x), OVERLAP_ROWS)
    for begin, end in pairwise(ends):
        for low in range(begin, end, many):
            part = slice(max(begin, low - OVERLAP_ROWS), min(end, low + many + OVERLAP_ROWS))
            if part.stop - part.start - CUBIC_ROWS > SMOOTH_STENCILS:
                for curve, row in _unpredicted_gaps(t[part], x[:, part], floor):
                    gaps[curve, part.start + row] = True
    return gaps


def _unpredicted_gaps(t: Array, x: Array, floor: Array) -> Iterator[tuple[Indices, Indices]]:
    """Curves and gaps beside rows that the cubic through the next four does not predict, although it is smooth.

    The error of the cubic is the fourth difference of five rows, times what makes the weight of the predicted row 1:
    once of the first of them, and once of the last.
    """
    many = len(t) - CUBIC_ROWS
    nodes = np.lib.stride_tricks.sliding_window_view(t, CUBIC_ROWS + 1)
    apart = nodes[:, :, None] - nodes[:, None, :]
    apart[:, range(CUBIC_ROWS + 1), range(CUBIC_ROWS + 1)] = 1.0
    weights = 1.0 / np.prod(apart, axis=2).T
    weights /= weights[0].copy()
    error = x[:, :many].copy()
    for k in range(1, CUBIC_ROWS + 1):
        error += weights[k] * x[:, k : k + many]
    error = np.abs(error, out=error)
    for back in (False, True):
        if back:
            error = (error / np.abs(weights[CUBIC_ROWS]))[:, ::-1]
        smooth = np.maximum(np.maximum(error[:, 1:-2], error[:, 2:-1]), error[:, 3:])
        least = np.maximum(GAP_RATIO * smooth, floor[:, None])
        curve, row = np.nonzero(error[:, :-SMOOTH_STENCILS] > least)
        # The stencils of the next rows reach over the same gap; the one that begins right behind it is the last.
        last = np.append((np.diff(row) > CUBIC_ROWS) | (np.diff(curve) != 0), True)[: len(row)]
        yield curve[last], len(t) - 2 - row[last] if back else row[last]
