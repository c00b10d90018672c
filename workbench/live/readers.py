"""Readers of columns: the numbers of a live page, in a few lines each.

`js/readers.js` has the same functions in JavaScript; a test compares both on recorded runs. They work on rows
alone. What is between the rows is covered by the step difference that the page shows beside each number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float64]
TURN = 2 * math.pi
#: Rows to either side of a peak that are read: derived, its neighbours and what their bends take.
PEAK_REACH = 2


@dataclass(frozen=True)
class Rows:
    """Rows of a column.

    Attributes
    ----------
    t, x : ndarray of shape (n,)
        Time [s] and the column.
    angle : ndarray of shape (n,)
        The crank angle [rad]; nan without one.
    order : int
        The order of `amplitude` and `phase`.
    level : float
        The level of `first_crossing`.
    """

    t: Samples
    x: Samples
    angle: Samples
    order: int = 1
    level: float = 0.0


def curvature(y: Samples, x: Samples) -> Samples:
    """Return the second derivative of y over x between rows, of shape (n - 1,).

    It is the smaller of those at both rows, and 0 where they differ in sign or x does not grow, as at a jump.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.diff(y) / np.diff(x)
        bend = 2 * np.diff(slope) / (x[2:] - x[:-2])
    before, after = np.append(bend[0], bend), np.append(bend, bend[-1])
    with np.errstate(invalid="ignore"):
        is_smooth = (before * after > 0) & np.isfinite(before) & np.isfinite(after)
    return np.where(is_smooth, np.where(abs(before) < abs(after), before, after), 0.0)


def integral(y: Samples, x: Samples) -> float:
    """Return the integral of y over x, by the trapezoidal rule less what the curvature adds to it."""
    return float(np.trapezoid(y, x) - np.sum(np.diff(x) ** 3 * curvature(y, x)) / 12)


def last(rows: Rows) -> float:
    """Return the value of the last row."""
    return float(rows.x[-1])


def change(rows: Rows) -> float:
    """Return the last value less the first."""
    return float(rows.x[-1] - rows.x[0])


def maximum(rows: Rows) -> float:
    """Return the largest value, on the parabola through the largest row and its neighbours.

    It rises above the row by no more than the bends beside it allow, since a parabola overshoots at a jump.
    """
    x, k = rows.x, int(np.argmax(rows.x))
    if k < PEAK_REACH or k >= len(x) - PEAK_REACH:
        return float(x[k])
    before, bend, after = 2 * x[k - 1 : k + 2] - x[k - 2 : k + 1] - x[k : k + 3]
    rise = (x[k + 1] - x[k - 1]) ** 2 / (8 * bend) if bend > 0 else 0.0
    return float(x[k] + max(0.0, min(rise, before / 8, after / 8)))


def minimum(rows: Rows) -> float:
    """Return the smallest value, on such a parabola."""
    return -maximum(Rows(rows.t, -rows.x, rows.angle))


def mean(rows: Rows) -> float:
    """Return the mean over time."""
    return integral(rows.x, rows.t) / float(rows.t[-1] - rows.t[0])


def first_crossing(rows: Rows) -> float:
    """Return the time at which the straight line through the rows first passes the level; nan if never."""
    over = rows.x - rows.level
    passed = np.flatnonzero((over[:-1] * over[1:] <= 0) & (over[:-1] != 0))
    if not len(passed):
        return math.nan
    k = int(passed[0])
    return float(rows.t[k] + (rows.t[k + 1] - rows.t[k]) * over[k] / (over[k] - over[k + 1]))


def _wave(rows: Rows) -> complex:
    """The complex amplitude, x = Im(X exp(i k angle)), over a revolution."""
    scale = 2 / float(rows.angle[-1] - rows.angle[0])
    sine, cosine = (rows.x * f(rows.order * rows.angle) for f in (np.sin, np.cos))
    return complex(scale * integral(sine, rows.angle), scale * integral(cosine, rows.angle))


def amplitude(rows: Rows) -> float:
    """Return the amplitude of an order of the crank angle."""
    return abs(_wave(rows))


def phase(rows: Rows) -> float:
    """Return the phase of an order of the crank angle [deg], as of sin(k angle + phase)."""
    wave = _wave(rows)
    return math.degrees(math.atan2(wave.imag, wave.real))


READERS: Mapping[str, Callable[[Rows], float]] = {
    "last": last, "change": change, "max": maximum, "min": minimum, "mean": mean,
    "first_crossing": first_crossing, "amplitude": amplitude, "phase": phase,
}  # fmt: skip


def since(rows: Rows, begin: float) -> Rows:
    """Return the rows from a time [s] on, the first of them between two rows."""
    if not begin > rows.t[0]:
        return rows
    later = rows.t > begin
    k = int(np.argmax(later))
    first, second = rows.t[k - 1], rows.t[k]

    def cut(column: Samples) -> Samples:
        sag = curvature(column, rows.t)[k - 1] * (begin - first) * (second - begin) / 2
        return np.concatenate([[np.interp(begin, rows.t, column) - sag], column[later]])

    return Rows(
        np.concatenate([[begin], rows.t[later]]),
        cut(rows.x),
        cut(rows.angle),
        rows.order,
        rows.level,
    )


def revolution(t: Samples, angle: Samples) -> float:
    """Return the time [s] at which the last revolution begins; nan if there is no whole one."""
    begin = angle[-1] - TURN
    before = np.flatnonzero(angle <= begin)
    if not len(before):
        return math.nan
    k = int(before[-1])
    return float(t[k] + (t[k + 1] - t[k]) * (begin - angle[k]) / (angle[k + 1] - angle[k]))
