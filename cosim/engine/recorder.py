"""The rows of a run as they come: in memory or streamed to a file, on any grid of times."""

from __future__ import annotations

import csv
import errno
import io
import math
import os
import time as clock
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..dense import CUBIC_ROWS
from ..errors import FmuError, SetupError
from ..files import lock_file
from ..fmu.times import coincide
from ..result import (
    Provenance,
    Result,
    Rows,
    file_columns,
    open_unlinked,
    partial,
    require_writable_names,
    table_facts,
    write_json,
)
from ..series import NO_BREAKS, TIME, Column, Kind

#: Rows that wait in memory before they are written. A convention: a page or two of memory for each column.
CHUNK = 4096
#: Seconds that rows wait at most. A convention: who reads the file along notices no delay.
LONGEST = 0.1


class Recorder:
    """Takes rows; with a path it streams them to NAME.partial.csv, which becomes NAME.csv.

    A run that does not end leaves NAME.partial.csv and NAME.partial.json, which says where and why.
    Rows that are streamed are not kept in memory; they reach the file at once, as far as that is
    cheap. Until it ends, the JSON says that the run is "running".
    """

    def __init__(
        self,
        columns: Sequence[Column],
        path: Path | None = None,
        setup: Provenance | None = None,
    ) -> None:
        self.columns = [TIME, *columns]
        self.names = [column.name for column in self.columns]
        self.count = 0
        self.rows = array("d")
        self._path = path
        self._stream: Stream | None = None
        if path is not None:
            if path.suffix.lower() != ".csv" or path.is_dir():
                raise SetupError(f"csv = {path} must be a file that ends in .csv")
            require_writable_names(path)
            self._stream = Stream(partial(path))
            self._write(self.names)
            facts = {"status": "running", **table_facts(self.columns, NO_BREAKS)}
            write_json(partial(path).with_suffix(".json"), {**(setup or {}), **facts})

    def add(self, row: Sequence[float]) -> None:
        """Append one row, or several one after the other: the time, then the columns' values."""
        self.rows.extend(row)
        self.count += len(row) // len(self.columns)
        if self._stream is not None and (
            len(self.rows) >= CHUNK * len(self.columns)
            or clock.perf_counter() > self._flushed + LONGEST
        ):
            self.flush()

    def flush(self) -> None:
        """Bring the rows into the file; raises FmuError if it does not take them."""
        if self._stream is not None:
            fresh = np.array(self.rows).reshape(-1, len(self.columns))
            self.rows = array("d")
            self._write(*fresh.tolist())

    def _write(self, *rows: Sequence[object]) -> None:
        assert self._stream is not None
        text = io.StringIO(newline="")
        csv.writer(text).writerows(rows)
        self._stream.append(text.getvalue())
        self._flushed = clock.perf_counter()

    def finish(self, provenance: Provenance, breaks: Sequence[tuple[float, float]] = ()) -> Result:
        """Close the file; only a run of status "complete" gets the name that was asked for.

        `breaks` are the intervals, begin and end [s], in which columns may jump.
        """
        width, rows = len(self.columns), self.rows
        columns = [_with_convergence_order(column, provenance) for column in self.columns]
        intervals = np.array(breaks, dtype=float).reshape(-1, 2)
        if self._stream is None or self._path is None:
            load = np.asarray(rows).reshape(-1, width).T.__getitem__
            return Result(columns, provenance, load, breaks=intervals)
        with suppress(FmuError):
            self.flush()
        target = partial(self._path)
        content = provenance | table_facts(columns, intervals)
        if provenance["status"] == "complete":
            try:
                target = self._move_to_final_names(target, content)
            finally:
                self._stream.close()
        else:
            with suppress(OSError):
                write_json(target.with_suffix(".json"), content)
            self._stream.close()
        return Result(columns, provenance, file_columns(target), breaks=intervals)

    def _move_to_final_names(self, rows: Path, content: Provenance) -> Path:
        """Give the complete file and its JSON their names, so that old facts never stand beside new rows.

        Raises OSError if the JSON cannot have its name; the rows are then left where they are.
        """
        assert self._path is not None
        facts, name = rows.with_suffix(".json"), self._path.with_suffix(".json")
        try:
            write_json(facts, content)
            name.unlink(missing_ok=True)
            rows.replace(self._path)
            facts.replace(name)
        except OSError as error:
            reason = f"{error.strerror}; the rows are in {rows.name}"
            raise OSError(error.errno, reason, str(name)) from error
        return self._path


def _with_convergence_order(column: Column, statistics: Provenance) -> Column:
    """A column with its convergence order; adaptive steps keep the error per time, of order 1."""
    if column is TIME or column.kind is not Kind.CONTINUOUS:
        return column
    is_first = statistics["control"] != "fixed" or column.name in statistics["first_order"]
    order = 1 if is_first else statistics["convergence_order"]
    return Column(column.name, column.unit, column.kind, order, column.source)


class Stream:
    """A text file of whole lines that one run writes; raises SetupError if another one does.

    The lock goes when the file is closed, however its process ends.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._size = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            while True:
                self._file = open_unlinked(path, "ab")
                if not lock_file(self._file.fileno()):
                    self._file.close()
                    raise SetupError(f"another run is writing {path}")
                if path.exists() and path.stat().st_ino == os.fstat(self._file.fileno()).st_ino:
                    break
                self._file.close()
            self._file.truncate(0)
        except OSError as error:
            raise SetupError(f"{path} cannot be written: {error.strerror}") from error

    def append(self, text: str) -> None:
        """Add lines; raises FmuError, and leaves whole lines, if there is no room or no file."""
        rest = memoryview(text.encode())
        try:
            if not self.path.exists():
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError as error:
            self._file.truncate(self._size)
            raise FmuError(f"{self.path} cannot be written: {error.strerror}") from error
        self._size += len(text.encode())

    def close(self) -> None:
        """Let others write the file."""
        self._file.close()


IntermediateValues = tuple[list[tuple[float, list[float]]], list[int]]


def _cubic_through(t: float, rows: Sequence[Rows] | Rows) -> Rows:
    """The values at time t [s] on the polynomial through all rows, whose times stand first."""
    times = [row[0] for row in rows]
    weights = [math.prod((t - b) / (a - b) for b in times if b != a) for a in times]
    total: Rows = sum(w * values for w, values in zip(weights, rows))
    return total


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
        self._breaks, self._passed, self._broken_until = breaks, 0, -math.inf
        self._observations = observations
        self._window: list[Rows] = []
        self._start = self._last = 0.0
        self._next = 0

    def take(self, row: Sequence[float]) -> None:
        """The values at the next time."""
        now = np.array(row)
        if not self._window:
            self._start = row[0]
            self._window = [now]
            self._emit(now)
            return
        before = self._window[-1]
        if before[0] == now[0]:
            self.flush()
            self._add(now.tolist())
            self._window = [now]
            return
        if (before[self._discrete] != now[self._discrete]).any() or self._breaks_between(
            before[0], now[0]
        ):
            if len(self._window) > 1:
                self._fill(*self._window[-2:])
            self._window = [self._window[-1], now]
            self.flush()
            self._window = [now]
            return
        self._window.append(now)
        if len(self._window) == CUBIC_ROWS - 1:
            self._fill(*self._window[:2])
        elif len(self._window) == CUBIC_ROWS:
            self._fill(*self._window[1:3])
            del self._window[0]

    def extend(self, rows: Sequence[float]) -> None:
        """The values at the next times, one row after the other, behind those of a first time."""
        each = np.reshape(rows, (-1, len(self._window[-1])))
        if len(each) and not self._discrete and self._passed == len(self._breaks):
            each = each[self._is_near_output(each[:, 0])]
        for row in each.tolist():
            self.take(row)

    def _is_near_output(self, times: Rows) -> NDArray[np.bool_]:
        """Which of the next times [s] the cubics at times of the grid need: the others are of no use where nothing jumps."""
        number = math.ceil((times[-1] - self._due()) / self._spacing) + 1
        due = self._start + self._spacing * np.arange(self._next - 1, self._next + max(number, 1))
        near = np.searchsorted(times, due)[:, None] + np.arange(-CUBIC_ROWS, CUBIC_ROWS)
        is_near = np.zeros(len(times), bool)
        is_near[near[(near >= 0) & (near < len(times))]] = True
        is_near[:CUBIC_ROWS] = is_near[-CUBIC_ROWS:] = True
        return is_near

    def flush(self) -> None:
        """Write what waited for values to come, up to the last time, which gets a row."""
        if len(self._window) > 1:
            self._fill(*self._window[-2:])
            self._emit(self._window[-1])

    def _breaks_between(self, begin: float, end: float) -> bool:
        """Whether a part of a break lies between two times [s]."""
        while self._passed < len(self._breaks) and self._breaks[self._passed][0] < end:
            self._broken_until = max(self._broken_until, self._breaks[self._passed][1])
            self._passed += 1
        return self._broken_until > begin

    def _fill(self, before: Rows, after: Rows) -> None:
        """The rows after one time, up to the next."""
        while (due := self._due()) <= after[0] or coincide(due, after[0]):
            self._emit(
                after
                if coincide(due, after[0])
                else self._interpolated_by_cubic(due, before, after)
            )

    def _emit(self, row: Rows) -> None:
        """Write a row, unless its time has one."""
        if row[0] > self._last or not self._next:
            self._add(row.tolist())
            self._last = float(row[0])
        while (due := self._due()) <= row[0] or coincide(due, row[0]):
            self._next += 1

    def _due(self) -> float:
        return self._start + self._next * self._spacing

    def _interpolated_by_cubic(self, t: float, before: Rows, after: Rows) -> Rows:
        row = _cubic_through(t, self._window)
        for observations, columns in self._observations:
            del observations[: sum(time < self._window[0][0] for time, _ in observations)]
            within = [
                [time, *values] for time, values in observations if before[0] < time <= after[0]
            ]
            if within:
                selected = [0, *columns]
                nodes = np.array([before[selected], *within, after[selected]])
                cuts = [k for k in range(1, len(nodes)) if coincide(nodes[k - 1, 0], nodes[k, 0])]
                piece = next(p for p in np.split(nodes, cuts) if p[-1, 0] >= t)
                latest = max(len(piece) - CUBIC_ROWS, 0)
                k = min(max(int(np.searchsorted(piece[:, 0], t)) - 2, 0), latest)
                row[columns] = _cubic_through(t, piece[k : k + CUBIC_ROWS])[1:]
        row[self._discrete] = before[self._discrete]
        row[0] = t
        return row
