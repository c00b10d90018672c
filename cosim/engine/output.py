"""Where the rows of a run go: after every k-th step, or interpolated to times between steps."""

from __future__ import annotations

import math
import time as clock
from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dense import CUBIC_ROWS
from ..fmu.times import coincide
from ..result import Rows
from .recorder import LONGEST

#: Rows that wait before those between them are made. Chosen: what a call of NumPy costs is then little of a row.
WAITING_ROWS = 1 << 10

Flags = NDArray[np.bool_]
#: Times and values that a part shows within steps, of which it makes a list, and their columns.
IntermediateValues = tuple[list[tuple[float, list[float]]], list[int]]


class Output:
    """Hands on rows, one after the other, as numbers: those after each `every`-th step and after number `last`, and of jumps.

    `shown` is the time of the last one [s].
    """

    def __init__(self, add: Callable[[Sequence[float]], object], every: int, last: int) -> None:
        self.add_rows, self.every, self.last = add, every, last
        self.shown = math.nan

    def add(self, row: Sequence[float]) -> None:
        """Hand on a row."""
        self.shown = row[0]
        self.add_rows(row)

    def add_unless_shown(self, row: Sequence[float]) -> None:
        """Hand on a row of a time that may have one."""
        if not coincide(row[0], self.shown):
            self.add(row)

    def take(self, rows: array[float], width: int, first: int, every: int) -> None:
        """Hand on what is due of rows after each `every`-th step from number `first` on, this one or a finer distance."""
        if every != self.every:
            each = np.reshape(rows, (-1, width))
            steps = np.arange(first, first + len(each))
            due = (steps % self.every == 0) | (steps == self.last)
            rows = array("d", each[due].tobytes())
        if len(rows):
            self.add_rows(rows)
            self.shown = rows[-width]


class OutputGrid:
    """Rows at start + k * spacing [s], from values at any times, and at every event.

    A time of the grid that is met is taken as it is. Between two others a row is interpolated by
    the cubic through the four values around it; the columns in `discrete` keep the value before.
    A change of such a column is an event: it gets a row. So do both values of a time that is taken twice, a
    jump. No cubic reaches over an event, a jump or one of the intervals `breaks`, begin and end [s], which may
    still be added to; within these rows lie on straight lines. What parts have shown of their columns within a
    step, `observations`, takes the place of the values at the other times.
    """

    def __init__(
        self,
        add: Callable[[Sequence[float]], None],
        spacing: float,
        discrete: Sequence[int],
        breaks: Sequence[tuple[float, float]] = (),
        observations: Sequence[IntermediateValues] = (),
    ) -> None:
        self._add, self._spacing, self._discrete = add, spacing, list(discrete)
        self._breaks, self._observations = breaks, observations
        self._waiting, self._width = array("d"), 0
        self._done = 0  # of the waiting rows, which are there for the cubics behind them
        self._start, self._next = 0.0, 0
        self._written = clock.perf_counter()

    def add(self, rows: Sequence[float]) -> None:
        """Take the values at the next time, or at several times one after the other."""
        if not self._width:
            self._width, self._start = len(rows), rows[0]
        self._waiting.extend(rows)
        if (
            len(self._waiting) >= WAITING_ROWS * self._width
            or clock.perf_counter() > self._written + LONGEST
        ):
            self._write(CUBIC_ROWS // 2)

    def flush(self) -> None:
        """Write what waited for values to come, up to the last time, which gets a row."""
        self._write(0)

    def _write(self, ahead: int) -> None:
        """Write the rows up to so many before the last one."""
        rows = np.array(self._waiting).reshape(-1, max(self._width, 1))
        stop = len(rows) - ahead
        if stop <= self._done:
            return
        t, held = rows[:, 0], rows[:, self._discrete]
        is_event = (held[1:] != held[:-1]).any(axis=1) | self._are_broken(t)
        is_shown = np.append(self._done == 0, is_event | (t[1:] == t[:-1]))
        is_shown[:-1] |= t[1:] == t[:-1]
        is_shown[-1] |= not ahead
        due = self._due_times(t[stop - 1])
        at = np.searchsorted(t, due - _rounding(due))
        is_met = np.abs(t[at] - due) <= _rounding(due)
        is_shown[at[is_met]] = True
        is_shown[: self._done] = is_shown[stop:] = False
        due = due[~is_met]
        before = np.searchsorted(t, due) - 1
        between = _cubics(due, rows, _beside(is_event))
        for shown, columns in self._observations:
            self._put_observed(between, before, rows, shown, columns)
        between[:, self._discrete] = held[before]
        between[:, 0] = due
        every = np.concatenate([rows[is_shown], between])
        self._add(array("d", every[np.argsort(every[:, 0], kind="stable")].tobytes()))
        kept = max(0, stop - CUBIC_ROWS // 2 - 1)
        self._done = stop - kept
        self._waiting = array("d", rows[kept:].tobytes())
        self._written = clock.perf_counter()

    def _due_times(self, end: Any) -> Rows:
        """The next times of the grid up to one [s]."""
        end += _rounding(end)
        stop = math.floor((end - self._start) / self._spacing) + 2
        due = self._start + self._spacing * np.arange(self._next, stop)
        due = due[due <= end]
        self._next += len(due)
        return np.asarray(due)

    def _are_broken(self, t: Rows) -> Flags:
        """Whether a part of a break lies between a time [s] and the next."""
        begins, ends = np.reshape([*self._breaks, (math.inf, math.inf)], (-1, 2)).T
        latest = np.append(-math.inf, np.maximum.accumulate(ends))
        return np.asarray(latest[np.searchsorted(begins, t[1:])] > t[:-1])

    def _put_observed(
        self,
        between: Rows,
        before: Rows,
        rows: Rows,
        shown: list[tuple[float, list[float]]],
        columns: Sequence[int],
    ) -> None:
        """Interpolate columns between what a part has shown within steps, where it has; `before` are the rows before."""
        t = rows[:, 0]
        del shown[: sum(time <= t[0] for time, _ in shown)]
        inner = np.array([[time, *values] for time, values in shown if time <= t[-1]])
        if not len(inner):
            return
        at = np.searchsorted(t, inner[:, 0])
        nodes = np.insert(rows[:, [0, *columns]], at, inner, axis=0)
        has = np.bincount(at - 1, minlength=len(t) - 1) > 0
        ends = np.insert(_beside(has), at, np.zeros(len(at), bool))
        these = np.flatnonzero(has[before])
        between[these[:, None], columns] = _cubics(between[these, 0], nodes, ends)[:, 1:]


def _rounding(times: Any) -> Any:
    """By how much times [s] may differ that are the same, see `coincide`."""
    return 64 * np.spacing(np.abs(times))


def _beside(events: Flags) -> Flags:
    """The rows before and behind events, each between a row and the next."""
    return np.asarray(np.append(events, False) | np.append(False, events))


def _cubics(due: Rows, nodes: Rows, ends: Flags) -> Rows:
    """Values at times [s], shape (times, columns), on the cubic through the four nodes around each, if there are so many.

    The times of the nodes stand first. No cubic reaches over one of the `ends`, nor over a time that is there twice.
    """
    t, numbers = nodes[:, 0], np.arange(len(nodes))
    jumps = np.diff(t) <= _rounding(t[1:])
    begins = np.maximum.accumulate(np.where(ends | np.append(True, jumps), numbers, 0))
    stops = np.where(ends | np.append(jumps, True), numbers, len(nodes))
    before = np.searchsorted(t, due) - 1
    begin, stop = begins[before], np.minimum.accumulate(stops[::-1])[::-1][before + 1]
    first = np.maximum(np.minimum(before + 1 - CUBIC_ROWS // 2, stop + 1 - CUBIC_ROWS), begin)
    around = first[:, None] + np.arange(CUBIC_ROWS)
    is_node = around <= stop[:, None]
    around = np.minimum(around, stop[:, None])
    distances = t[around][:, :, None] - t[around][:, None, :]
    counts = is_node[:, None, :] & (distances != 0.0)
    ahead = (due[:, None] - t[around])[:, None, :]
    weights = is_node * np.divide(ahead, distances, where=counts, out=np.ones(counts.shape)).prod(
        axis=2
    )
    return np.asarray(sum(weights[:, k, None] * nodes[around[:, k]] for k in range(CUBIC_ROWS)))
