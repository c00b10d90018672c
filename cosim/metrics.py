"""Metrics: what a person asks of columns, as records that know their columns, and as functions of rows.

A record, such as `Largest("motor.tau")`, names its columns and a stretch of time and is a function of `Curves`: one
number for each of them, shape (curves,), nan where there is none. `certify` states its error. The functions take
times t [s] and values x, both of shape (rows,). Both look between the rows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, fields, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from .dense import Array, Curves, Extremes, Polynomials, ends_and_turns
from .errors import SetupError
from .names import only
from .series import Column, Kind

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

TURN = 2.0 * math.pi
#: Gauss points of each polynomial in the integral of a harmonic: derived, four are exact up to degree 7, so
#: that a cubic leaves degree 4 for the sine, whose next term is below (w h)^5 / 120.
GAUSS_POINTS = 4
#: Relative amount by which a stretch may fall short of whole periods and still have them. Derived: a frequency or a time
#: that is written with ten significant digits is off by up to 5e-10 of itself, and a product of two by twice that.
#: The part of a period that lacks then changes an amplitude by 2e-9 of the largest value at most.
PERIOD_ROUNDING = 1e-9
#: Share of a run by which a stretch may reach beyond it. Derived: as for a period, of the decimals that times are written with.
END_ROUNDING = 1e-9
#: Distance from a level, over the largest one, within which a curve is on it. Derived: some thousand roundings.
ON_LEVEL = 1e-12
#: Largest change to come, over the largest value of the column, of a steady motion; a convention.
STEADY = 0.01
#: Largest share of a change that is taken to be left after a turn; changes of rounding have any share.
SLOWEST = 0.9
#: Orders of an angle among which the strongest is sought: those of which sixteen rows in a turn still show one each.
HIGHEST_ORDER = 8


@dataclass(frozen=True)
class TurnMean:
    """A column's mean over the last turn of an angle [rad], as a curve over time from the end of the first turn on.

    `Largest(TurnMean("load.w", over="load.phi"))` is the largest mean speed over a turn, which has no ripple of whole
    orders. Turns count since the angle last turned back.
    """

    column: str
    _: KW_ONLY
    over: str

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns whose curves it takes."""
        return (self.column, self.over)

    def __str__(self) -> str:
        return f"the mean of {self.column} over a turn of {self.over}"

    def __call__(self, curve: Curves, angle: Curves) -> Curves | None:
        """The curve of the means of one curve and its angle; None if there is no whole turn."""
        row = angle.x[0]
        t, phi = angle.t, row * np.sign(row[-1] - row[0])
        first = int(np.flatnonzero(np.diff(phi) <= 0.0).max(initial=-1)) + 1
        t, phi = t[first:], phi[first:]
        first_end = phi[0] + TURN
        if len(t) <= 1 or not phi[-1] > first_end:
            return None
        time_of = spline(phi, t)
        later = phi > first_end
        ends = np.concatenate([time_of([first_end]), t[later]])
        begun = time_of(np.concatenate([[first_end], phi[later]]) - TURN)
        means = (_integral_until(curve, ends) - _integral_until(curve, begun)) / (ends - begun)
        return Curves(ends, means[None])


@dataclass(frozen=True)
class Metric:
    """A number of a column from `begin` to `end` [s], by default of the whole run.

    Parameters
    ----------
    column
        The name of the column, or what makes a curve of several, `TurnMean`.
    begin, end
        The stretch of time [s].
    """

    column: str | TurnMean
    _: KW_ONLY
    begin: float = -math.inf
    end: float = math.inf
    #: Whether it counts, and is right or wrong.
    is_count: ClassVar[bool] = False

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns whose curves it takes, in this order."""
        return (self.column,) if isinstance(self.column, str) else self.column.columns

    @property
    def unnamed(self) -> Metric:
        """The same metric of no column, which metrics of one form share."""
        column = "" if isinstance(self.column, str) else TurnMean("", over="")
        return replace(self, column=column)

    def __call__(self, *curves: Curves) -> Array:
        """The numbers, shape (curves,); nan where there is none, such as the time at which a level is passed."""
        return np.concatenate([np.full(n, np.nan) if c is None else self.measure(c)
                               for n, c in self.parts(*curves)])  # fmt: skip

    def parts(self, *curves: Curves) -> Iterator[tuple[int, Curves | None]]:
        """How many curves, and what it looks at of them within its stretch; None if there is nothing."""
        if isinstance(self.column, str):
            yield len(curves[0]), self.within(curves[0])
            return
        for each in one_by_one(*curves):
            curve = self.column(*each)
            yield 1, None if curve is None else self.within(curve)

    def within(self, curves: Curves) -> Curves | None:
        """Curves within its stretch; None if there is nothing."""
        first, last = curves.t[0], curves.t[-1]
        if not max(self.begin, first) < min(self.end, last):
            return None
        if self.begin <= first and self.end >= last:
            return curves
        return curves.between(self.begin, self.end)

    def measure(self, curves: Curves) -> Array:
        """The numbers of whole curves."""
        raise NotImplementedError

    def unit(self, of_column: str) -> str:
        """Its unit, from that of its column."""
        return of_column

    def times(self, *curves: Curves) -> Array:
        """The times [s] at which the values alone decide it, shape (times, curves); none if all do, or their slopes."""
        each = [np.full((0, n), np.nan) if c is None else self.times_of_value(c)
                for n, c in self.parts(*curves)]  # fmt: skip
        most = max(map(len, each))
        filled = [np.pad(t, ((0, most - len(t)), (0, 0)), constant_values=np.nan) for t in each]
        return np.concatenate(filled, axis=1)

    def times_of_value(self, curves: Curves) -> Array:
        """The same for whole curves."""
        return np.empty((0, len(curves)))

    def scale(self, *curves: Curves) -> Array:
        """The sizes that an error is compared with, shape (curves,); 0 if that is the number itself."""
        return np.concatenate([np.zeros(n) if c is None else self.size(c)
                               for n, c in self.parts(*curves)])  # fmt: skip

    def size(self, curves: Curves) -> Array:
        """The same for whole curves."""
        return np.zeros(len(curves))

    @property
    def height(self) -> Metric | None:
        """Of a time the value whose error may make it another one, see `rivals`."""
        return None

    def rivals(self, curves: Curves, error: float, apart: float) -> Array:
        """Of a single curve the times [s], further from this one than `apart`, that it may be within an error of its height.

        One of them is nan where it may be at no time.
        """
        return np.empty(0)

    def lack(self, unit: str, *curves: Curves) -> str:
        """Why it has no number of single curves, with the unit of its column."""
        if isinstance(self.column, TurnMean):
            return f"{self.column.over} does not turn once; a longer run shows more"
        return "it has no value in its stretch of the run"

    def __str__(self) -> str:
        """What it is in words, "crossing of motor.tau from 2 to 3 s, level 10"."""
        kind = re.sub(r"(?<=.)([A-Z])", r" \1", type(self).__name__).lower()
        ends = [f" {word} {t:g}" for word, t in (("from", self.begin), ("to", self.end)) if math.isfinite(t)]  # fmt: skip
        stretch = f"{''.join(ends)} s" if ends else ""
        own = {each.name for each in fields(self)} - {each.name for each in fields(Metric)}
        return f"{kind} of {self.column}{stretch}{''.join(f', {name} {getattr(self, name)}' for name in sorted(own))}"

    def check(self, columns: Mapping[str, Column], start: float, stop: float) -> None:
        """Refuse columns that a run does not have, and a stretch outside it.

        Raises
        ------
        SetupError
            With the columns, or the times, to choose from.
        """
        for name in self.columns:
            if name not in columns:
                raise SetupError(
                    f"{self}: {name} is not recorded: name it in `record`, where there is {only(name, columns)}"
                )
            if columns[name].kind is Kind.TEXT:
                raise SetupError(f"{self}: the column {name!r} is text and has no such number")
        if reason := self.beyond(start, stop):
            raise SetupError(f"{self}: {reason}")

    def beyond(self, start: float, stop: float) -> str:
        """Why a run from one time to another [s] does not have its stretch; "" if it has."""
        near = END_ROUNDING * (stop - start)
        begins = self.begin == -math.inf or self.begin >= start - near
        ends = self.end == math.inf or self.end <= stop + near
        if begins and ends and max(self.begin, start) < min(self.end, stop):
            return ""
        return f"its stretch must lie in the run, from {start:g} to {stop:g} s"


@dataclass(frozen=True)
class PointValue(Metric):
    """A value of the column at one time, or one less another."""

    def points(self, curves: Curves) -> Sequence[Extremes]:
        """The value that counts, and the one that is taken from it, with their times."""
        raise NotImplementedError

    def measure(self, curves: Curves) -> Array:
        """The value, less the other one."""
        value, *other = (point.values for point in self.points(curves))
        return value - other[0] if other else value

    def times_of_value(self, curves: Curves) -> Array:
        """Those of the values."""
        return np.stack([point.times for point in self.points(curves)])

    def size(self, curves: Curves) -> Array:
        """The range of the column."""
        return np.asarray(np.ptp(curves.x, axis=1))


@dataclass(frozen=True)
class Last(PointValue):
    """The last value."""

    def points(self, curves: Curves) -> Sequence[Extremes]:
        """The last row."""
        return [curves.row(-1)]


@dataclass(frozen=True)
class Largest(PointValue):
    """The largest value."""

    def points(self, curves: Curves) -> Sequence[Extremes]:
        """The peak, at or between rows."""
        return [curves.largest()]


@dataclass(frozen=True)
class Smallest(PointValue):
    """The smallest value."""

    def points(self, curves: Curves) -> Sequence[Extremes]:
        """The trough, at or between rows."""
        return [curves.smallest()]


@dataclass(frozen=True)
class Swing(PointValue):
    """The largest value less the smallest."""

    def points(self, curves: Curves) -> Sequence[Extremes]:
        """The peak and the trough, at or between rows."""
        return [curves.largest(), curves.smallest()]


@dataclass(frozen=True)
class Change(PointValue):
    """The last value less the first."""

    def points(self, curves: Curves) -> Sequence[Extremes]:
        """Both ends."""
        return [curves.row(-1), curves.row(0)]


@dataclass(frozen=True)
class TimeOfLargest(Metric):
    """When the value is largest [s]."""

    sign: ClassVar[float] = 1.0

    def measure(self, curves: Curves) -> Array:
        """The time of the height."""
        return np.asarray(self.height.times_of_value(curves)[0])

    def unit(self, of_column: str) -> str:
        """Seconds."""
        return "s"

    @property
    def height(self) -> Metric:
        """The value whose time it is."""
        of = Largest if self.sign > 0.0 else Smallest
        return of(self.column, begin=self.begin, end=self.end)

    def rivals(self, curves: Curves, error: float, apart: float) -> Array:
        """The times of other peaks that are as high."""
        ((_, curve),) = self.parts(curves)
        if curve is None:
            return np.empty(0)
        peaks = curve.with_values(self.sign * curve.x)
        highest = peaks.largest()
        _, times, values = peaks.maxima()
        near = values >= highest.values[0] - error
        return np.asarray(times[near & (np.abs(times - highest.times[0]) > apart)])


@dataclass(frozen=True)
class TimeOfSmallest(TimeOfLargest):
    """When the value is smallest [s]."""

    sign = -1.0


@dataclass(frozen=True, kw_only=True)
class Crossing(Metric):
    """When the column first passes a level, up or down [s].

    It has passed when it has been on both sides: a column that begins on the level passes it when it comes back.
    """

    level: float

    def measure(self, curves: Curves) -> Array:
        """The first time; nan if there is none."""
        firsts = (passings(curves, self.level, k, most=1) for k in range(len(curves)))
        return np.array([times[0] if len(times) else np.nan for times in firsts])

    def unit(self, of_column: str) -> str:
        """Seconds."""
        return "s"

    def times_of_value(self, curves: Curves) -> Array:
        """The time itself."""
        return self.measure(curves)[None]

    @property
    def height(self) -> Metric:
        """What has the error of both extremes."""
        return Swing(self.column, begin=self.begin, end=self.end)

    def rivals(self, curves: Curves, error: float, apart: float) -> Array:
        """The first times at which levels beside its own are passed elsewhere, as where it is only just reached."""
        levels = (self.level - error, self.level, self.level + error)
        low, time, high = times = [float(replace(self, level=x)(curves)[0]) for x in levels]
        begin, end = min(times) - apart, max(times) + apart
        times_within = [[t for t in passings(curves, x) if begin <= t <= end] for x in levels]
        if all(len(x) == 1 for x in times_within):  # one slope, whose error is that of the time
            return np.empty(0)
        other = np.array([low, high])
        return other[~(np.abs(other - time) <= apart)]

    def lack(self, unit: str, *curves: Curves) -> str:
        """On which side of the level it stays, and how far it gets."""
        ((_, curve),) = self.parts(*curves)
        if curve is None:
            return super().lack(unit, *curves)
        high, low = float(curve.largest().values[0]), float(curve.smallest().values[0])
        level = f"{self.level:g} {unit}".rstrip()
        if high <= self.level:
            return f"{self.column} stays below {level}, largest {high:.4g}"
        return f"{self.column} stays above {level}, smallest {low:.4g}"


@dataclass(frozen=True)
class Integral(Metric):
    """The integral over time [unit of the column times s]."""

    def measure(self, curves: Curves) -> Array:
        """The integral of the polynomials."""
        return curves.integral()

    def unit(self, of_column: str) -> str:
        """That of the column times seconds."""
        above, slash, below = of_column.partition("/")
        return f"{above}.s{slash}{below}" if of_column not in ("", "1") else "s"


@dataclass(frozen=True)
class Mean(Metric):
    """The mean over time."""

    def measure(self, curves: Curves) -> Array:
        """The integral over the time that it is taken over."""
        return curves.integral() / float(curves.t[-1] - curves.t[0])


@dataclass(frozen=True)
class Rms(Metric):
    """The square root of the mean of the square over time."""

    def measure(self, curves: Curves) -> Array:
        """The root of the mean of a spline through the squares."""
        mean = Mean("").measure(curves.with_values(np.square(curves.x)))
        return np.asarray(np.sqrt(np.maximum(0.0, mean)))


@dataclass(frozen=True, kw_only=True)
class Harmonic(Metric):
    """The amplitude of the component of a frequency [Hz], over the last whole periods of a stretch."""

    frequency: float

    def measure(self, curves: Curves) -> Array:
        """Twice the absolute value of the Fourier coefficient; nan if there is not one whole period."""
        end = float(curves.t[-1])
        span = (end - float(curves.t[0])) * self.frequency * (1.0 + PERIOD_ROUNDING)
        if math.floor(span) < 1:
            return np.full(len(curves), np.nan)
        span = math.floor(span) / self.frequency
        total = np.zeros(len(curves), dtype=complex)
        for p in curves.between(end - span, end).polynomials_in_chunks():
            for s, weights in _gauss(p):
                turned = np.exp(-2j * math.pi * self.frequency * (p.t + s))
                total += p.at(s) @ (weights * turned)
        return 2.0 * np.abs(total) / span

    def size(self, curves: Curves) -> Array:
        """The range of the column."""
        return np.asarray(np.ptp(curves.x, axis=1))

    def lack(self, unit: str, *curves: Curves) -> str:
        """There is not one whole period."""
        return f"the stretch has no whole period of {self.frequency:g} Hz"


@dataclass(frozen=True)
class LastTurn(Metric):
    """A metric over the last whole turns of an angle [rad], `LastTurn(Swing("load.w"), over="load.phi")`."""

    column: Metric  # type: ignore[assignment]
    _: KW_ONLY
    over: str
    turns: int = 1

    @property
    def columns(self) -> tuple[str, ...]:
        """Those of the metric, and the angle."""
        return (*self.column.columns, self.over)

    @property
    def unnamed(self) -> Metric:
        """The same metric of no column."""
        return replace(self, column=self.column.unnamed, over="")

    def parts(self, *curves: Curves) -> Iterator[tuple[int, Curves | None]]:
        """What the metric looks at within the last turns; None if there are fewer."""
        for each in one_by_one(*curves):
            part = self._turns(*each)
            yield from [(1, None)] if part is None else self.column.parts(*part)

    def _turns(self, *curves: Curves) -> list[Curves] | None:
        """The single curves of the metric within the last turns; None if there are fewer."""
        angle = self.within(curves[-1])
        begin = math.nan if angle is None else last_turn(angle, self.turns)
        if angle is None or math.isnan(begin):
            return None
        return [curve.between(begin, float(angle.t[-1])) for curve in curves[:-1]]

    def measure(self, curves: Curves) -> Array:
        """That of the metric."""
        return self.column.measure(curves)

    def times_of_value(self, curves: Curves) -> Array:
        """As those of the metric."""
        return self.column.times_of_value(curves)

    def size(self, curves: Curves) -> Array:
        """As those of the metric."""
        return self.column.size(curves)

    def unit(self, of_column: str) -> str:
        """As that of the metric."""
        return self.column.unit(of_column)

    def lack(self, unit: str, *curves: Curves) -> str:
        """It does not turn that often."""
        part = self._turns(*curves)
        if part is None:
            return f"{self.over} does not turn {self.turns} times"
        return self.column.lack(unit, *part)


@dataclass(frozen=True)
class Settled(LastTurn):
    """A metric over the last turn of an angle [rad] of a steady motion, `Settled(Mean("load.w"), over="load.phi")`.

    A motion is steady if what the number may still change is at most `share` of the largest value of the column in that turn.
    This change is part of its error.
    """

    share: float = STEADY

    def __call__(self, *curves: Curves) -> Array:
        """The numbers; nan where the motion is not steady."""
        found = super().__call__(*curves)
        for k, each in enumerate(one_by_one(*curves)):
            turn = self._turns(*each)
            size = 0.0 if turn is None else np.abs(turn[0].x).max()
            if not self.change_left(*each) <= self.share * size:
                found[k] = math.nan
        return found

    def change_left(self, *curves: Curves) -> float:
        """What the number of single curves may still change, a geometric series of three turns in sequence; nan with fewer."""
        angle = self.within(curves[-1]) or curves[-1]
        ends = (self.end, *(last_turn(angle, k * self.turns) for k in (1, 2)))
        return change_to_come(*(Metric.__call__(replace(self, end=t), *curves)[0] for t in ends))

    def lack(self, unit: str, *curves: Curves) -> str:
        """It turns less than three times, or is not steady."""
        if math.isnan(self.change_left(*curves)):
            return f"{self.over} turns less than three times; a longer run shows whether the motion is steady"
        return "the motion is not steady at the end; a longer run shows whether it gets so"


@dataclass(frozen=True, kw_only=True)
class StrongestOrder(Metric):
    """The order of an angle [rad] with the largest amplitude, up to `highest`, over the last whole turn."""

    over: str
    highest: int = HIGHEST_ORDER
    is_count = True

    @property
    def columns(self) -> tuple[str, ...]:
        """The column and the angle."""
        return (*super().columns, self.over)

    @property
    def unnamed(self) -> Metric:
        """The same metric of no column."""
        return replace(super().unnamed, over="")  # type: ignore[call-arg]

    def __call__(self, *curves: Curves) -> Array:
        """The orders; nan without a whole turn."""
        amplitudes = (self.amplitudes(*each) for each in one_by_one(*curves))
        return np.array([math.nan if a is None else 1.0 + np.argmax(a) for a in amplitudes])

    def amplitudes(self, *curves: Curves) -> Array | None:
        """The amplitudes of the orders 1, 2, ... of a single curve over the last whole turn; None without one."""
        ((_, curve),) = self.parts(*curves[:-1])
        if curve is None:
            return None
        angle = curves[-1].between(float(curve.t[0]), float(curve.t[-1]))
        begin = last_turn(angle, 1)
        if math.isnan(begin):
            return None
        end = float(angle.t[-1])
        curve, angle = curve.between(begin, end), angle.between(begin, end)
        orders = np.arange(1, self.highest + 1)
        total = np.zeros(self.highest, dtype=complex)
        for p in angle.polynomials_in_chunks():
            cubic, square, slope, _ = p.c[:, 0]
            for s, weights in _gauss(p):
                speed = (3.0 * cubic * s + 2.0 * square) * s + slope
                turned = np.exp(-1j * orders[:, None] * p.at(s)[0])
                total += turned @ (weights * speed * curve(p.t + s)[0])
        return np.abs(total) / math.pi

    def unit(self, of_column: str) -> str:
        """None: it is a count."""
        return ""

    def lack(self, unit: str, *curves: Curves) -> str:
        """It does not turn once."""
        return f"{self.over} does not turn once"


def one_by_one(*curves: Curves) -> Iterator[list[Curves]]:
    """The first of each of these curves, the second of each, and so on."""
    for k in range(len(curves[0])):
        yield [c.take([k]) for c in curves]


def change_to_come(last: float, before: float, first: float) -> float:
    """Return what a number may still change that had these values in sequence, as a geometric series; nan for nan."""
    change, earlier = abs(last - before), abs(before - first)
    share = np.minimum(change / earlier, SLOWEST) if earlier else SLOWEST
    return float(change * np.maximum(1.0, share / (1.0 - share)))


def last_turn(angle: Curves, turns: int) -> float:
    """When the last so many turns of one angle [rad] began [s]; nan if it turns less."""
    begin, end = angle.x[0, [0, -1]].tolist()
    times = passings(angle, end - math.copysign(turns * TURN, end - begin))
    return float(times[-1]) if len(times) else math.nan


def _gauss(p: Polynomials) -> Iterator[tuple[Array, Array]]:
    """Gauss points [s since the rows] of all pieces and their weights [s], shape (intervals,) each."""
    half = 0.5 * p.widths
    for node, weight in zip(*np.polynomial.legendre.leggauss(GAUSS_POINTS)):
        yield half * (1.0 + node), half * weight


def _integral_until(curve: Curves, times: Array) -> Array:
    """The integral of one curve from its first row to times [s]."""
    from scipy.interpolate import PPoly

    c = np.concatenate([p.c[:, 0] for p in curve.polynomials_in_chunks()], axis=1)
    return np.asarray(PPoly(c, curve.t).antiderivative()(times))


def passings(curves: Curves, level: float, curve: int = 0, most: int | None = None) -> Array:
    """The times [s] at which a curve changes the side of a level, at or between its rows, in order.

    Parameters
    ----------
    curves
        Columns over time.
    level
        In their unit.
    curve
        Which of them.
    most
        At most so many of the times, the first ones; by default all.
    """
    found: list[float] = []
    x, side = curves.x[curve], 0.0
    tolerance = ON_LEVEL * float(np.abs(x - level).max())
    for p in curves.polynomials_in_chunks():
        # Where each polynomial begins, turns and ends, and the row behind it: between two of these it is monotonic.
        at, values = ends_and_turns(p.c[:, curve], p.widths)
        after = x[p.first + 1 : p.first + 1 + len(p.t)]
        since = np.concatenate([at, p.widths[None]]).T.ravel()
        above = np.concatenate([values, after[None]]).T.ravel() - level
        sides = np.where(np.abs(above) > tolerance, np.sign(above), 0.0)
        known = np.flatnonzero(sides)
        if not len(known):
            continue
        changes = np.flatnonzero(np.diff(sides[known], prepend=side or sides[known[0]]))
        side = float(sides[known[-1]])
        for k in changes if most is None else changes[: most - len(found)]:
            first = known[k - 1] if k else 0
            over = above[first : known[k] + 1] * sides[known[k]] >= 0.0
            point = first + int(np.argmax(over))
            piece, number = divmod(point, len(at) + 1)
            end = float(since[point])
            if 0 < number < len(at):
                end = _root(
                    p.c[:, curve, piece] - [0.0, 0.0, 0.0, level], float(since[point - 1]), end
                )
            found.append(float(p.t[piece]) + end)
    return np.array(found[:most])


def _root(c: Array, low: float, high: float) -> float:
    """Where a polynomial, coefficients of the powers 3 to 0, is 0 between two times [s]; one of them if that is so there."""
    from scipy.optimize import brentq

    a, b, slope, d = (float(x) for x in c)

    def value(s: float) -> float:
        return ((a * s + b) * s + slope) * s + d

    if not value(low) * value(high) < 0.0:
        return low if value(low) == 0.0 else high
    return float(brentq(value, low, high, xtol=4.0 * math.ulp(high)))


def _number(metric: Metric, t: Array, x: Array) -> float:
    """The number that a metric of one column makes of rows."""
    return float(metric.measure(Curves.of_rows(t, x))[0])


def largest(t: Array, x: Array) -> float:
    """The largest value of x, in its unit, over times t [s], both of shape (rows,).

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(largest(t, np.sin(2 * np.pi * t)), 6)
    1.0
    """
    return _number(Largest(""), t, x)


def smallest(t: Array, x: Array) -> float:
    """The smallest value of x, in its unit, over times t [s], both of shape (rows,)."""
    return _number(Smallest(""), t, x)


def time_of_largest(t: Array, x: Array) -> float:
    """When x is largest [s], over times t [s], both of shape (rows,).

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(time_of_largest(t, np.sin(2 * np.pi * t)), 6)
    0.25
    """
    return _number(TimeOfLargest(""), t, x)


def time_of_smallest(t: Array, x: Array) -> float:
    """When x is smallest [s], over times t [s], both of shape (rows,)."""
    return _number(TimeOfSmallest(""), t, x)


def crossing(t: Array, x: Array, level: float) -> float:
    """When x first passes a level in its unit [s], up or down; nan if it never does. t [s] and x are of shape (rows,).

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(crossing(t, t**2, 0.25), 6)
    0.5
    """
    return _number(Crossing("", level=level), t, x)


def mean(t: Array, x: Array) -> float:
    """The mean of x, in its unit, over times t [s], both of shape (rows,).

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(mean(t, t**2), 6)
    0.333333
    """
    return _number(Mean(""), t, x)


def rms(t: Array, x: Array) -> float:
    """The square root of the mean of x squared, in the unit of x, over times t [s], both of shape (rows,)."""
    return _number(Rms(""), t, x)


def harmonics(phi: Array, x: Array, highest: int = HIGHEST_ORDER) -> NDArray[np.complex128]:
    """Complex amplitudes of the orders 1..highest, X = Im(X_hat exp(i k phi)), fitted together, shape (highest,).

    phi [rad] has shape (rows,), x too, or (rows, columns), which gives (highest, columns). They need more than
    2 * highest rows a turn. Over whole turns the normal equations are nearly diagonal.

    Examples
    --------
    >>> import numpy as np
    >>> phi = np.linspace(0.0, 4 * np.pi, 200, endpoint=False)
    >>> np.abs(harmonics(phi, 3.0 + 2.0 * np.sin(2 * phi), 3)).round(6).tolist()
    [0.0, 2.0, 0.0]
    """
    turned = np.repeat(np.exp(1j * phi)[:, None], highest, axis=1).cumprod(axis=1)
    design = np.hstack([np.ones((len(phi), 1)), turned.imag, turned.real])
    fit = np.linalg.solve(design.T @ design, design.T @ x)
    return np.asarray(fit[1 : highest + 1] + 1j * fit[highest + 1 :])


def spline(t: Array, x: Array) -> CubicSpline:
    """Imported where it is needed, since that takes longer than most runs."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(t, x)
