"""The rows of a run as they come: in memory or streamed to a file, on any grid of times."""

from __future__ import annotations

import csv
import math
import time as clock
from array import array
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..result import Result, Rows, partial, read_rows, write_json
from .clock import same

CHUNK = 4096
LONGEST = 0.1


class Recorder:
    """Takes rows; with a path it streams them to NAME.partial.csv, which becomes NAME.csv.

    A run that does not end leaves NAME.partial.csv and NAME.partial.json, which says where and why.
    Rows that are streamed are not kept in memory; they reach the file at once, as far as that is
    cheap. Until it ends, the JSON says that the run is "running".
    """

    def __init__(
        self,
        columns: Sequence[str],
        units: dict[str, str],
        path: Path | None,
        provenance: Mapping[str, Any],
    ) -> None:
        self.columns = ["time", *columns]
        self.units = {"time": "s", **units}
        self.count = 0
        self.rows = array("d")
        self._path = path
        self._file: IO[str] | None = None
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = partial(path).open("w", newline="", encoding="utf-8")
            csv.writer(self._file).writerow(self.columns)
            self._file.flush()
            self._flushed = clock.perf_counter()
            write_json(
                partial(path).with_suffix(".json"),
                {**provenance, "status": "running", "units": self.units},
            )

    def add(self, row: Sequence[float]) -> None:
        """Append one row, or several one after the other: the time, then the columns' values."""
        self.rows.extend(row)
        self.count += len(row) // len(self.columns)
        if self._file is not None and (
            len(self.rows) >= CHUNK * len(self.columns)
            or clock.perf_counter() > self._flushed + LONGEST
        ):
            self._flush(self._file)

    def _flush(self, file: IO[str]) -> None:
        fresh = np.array(self.rows).reshape(-1, len(self.columns))
        csv.writer(file).writerows(fresh.tolist())
        file.flush()
        self._flushed = clock.perf_counter()
        self.rows = array("d")

    def finish(self, provenance: dict[str, Any]) -> Result:
        """Close the file; only a run of status "complete" gets the name that was asked for."""
        width, rows = len(self.columns), self.rows
        if self._file is None or self._path is None:
            return Result(
                self.columns, self.units, provenance, lambda: np.array(rows).reshape(-1, width)
            )
        self._flush(self._file)
        self._file.close()
        target = partial(self._path)
        if provenance["status"] == "complete":
            target.with_suffix(".json").unlink()
            target = target.replace(self._path)
        write_json(target.with_suffix(".json"), {**provenance, "units": self.units})
        return Result(self.columns, self.units, provenance, lambda: read_rows(target))


class Grid:
    """Rows at start + k * spacing [s], from values at any times, and at every event.

    A time of the grid that is met is taken as it is. Between two others a row is interpolated by
    the cubic through the four values around it; the columns in `discrete` keep the value before.
    A change of such a column is an event: it gets a row, and no cubic reaches over it.
    """

    def __init__(
        self, add: Callable[[Sequence[float]], None], spacing: float, discrete: Sequence[int]
    ) -> None:
        self._add, self._spacing, self._discrete = add, spacing, list(discrete)
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
        event = (self._window[-1][self._discrete] != now[self._discrete]).any()
        self._window.append(now)
        if event:
            self.flush()
            self._window = [now]
        elif len(self._window) == 3:
            self._fill(*self._window[:2])
        elif len(self._window) == 4:
            self._fill(*self._window[1:3])
            del self._window[0]

    def flush(self) -> None:
        """Write what waited for values to come, up to the last time, which gets a row."""
        if len(self._window) > 1:
            self._fill(*self._window[-2:])
            self._emit(self._window[-1])

    def _fill(self, before: Rows, after: Rows) -> None:
        """The rows after one time, up to the next."""
        while (due := self._due()) <= after[0] or same(due, after[0]):
            self._emit(after if same(due, after[0]) else self._interpolated(due, before))

    def _emit(self, row: Rows) -> None:
        """Write a row, unless its time has one."""
        if row[0] > self._last or not self._next:
            self._add(row.tolist())
            self._last = float(row[0])
        while (due := self._due()) <= row[0] or same(due, row[0]):
            self._next += 1

    def _due(self) -> float:
        return self._start + self._next * self._spacing

    def _interpolated(self, t: float, before: Rows) -> Rows:
        times = [row[0] for row in self._window]
        weights = [math.prod((t - b) / (a - b) for b in times if b != a) for a in times]
        row: Rows = sum(w * values for w, values in zip(weights, self._window))
        row[self._discrete] = before[self._discrete]
        row[0] = t
        return row
