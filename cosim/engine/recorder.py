"""The rows of a run as they come: in memory or streamed to a file, on any grid of times."""

from __future__ import annotations

import csv
import errno
import io
import os
import time as clock
from array import array
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..errors import FmuError, SetupError
from ..files import lock_file
from ..result import (
    Provenance,
    Result,
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
