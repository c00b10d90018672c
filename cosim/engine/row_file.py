"""All rows of a run in a file of plain numbers, for what looks at each communication point."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..result import Rows

#: Size of a number of this machine [bytes].
DOUBLE_BYTES = array("d").itemsize
#: Rows that are read at a time, which bounds the memory: derived, 2^15 rows of 20 columns are 5 MB.
ROWS_AT_A_TIME = 1 << 15
#: Numbers that are collected before they are written: derived, 64 kB, a few pages of the file system.
BUFFERED_NUMBERS = 8192


class RowFile:
    """Writes rows one after the other as doubles of this machine, without a header."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._numbers = array("d")

    def add(self, rows: Sequence[float]) -> None:
        """Append one row, or several one after the other: the time, then the columns' values."""
        self._numbers.extend(rows)
        if len(self._numbers) >= BUFFERED_NUMBERS:
            self._write()

    def _write(self) -> None:
        self._file.write(self._numbers.tobytes())
        self._numbers = array("d")

    def close(self) -> None:
        """Write what is left and close the file."""
        self._write()
        self._file.close()


def stored_column(path: Path, width: int, k: int) -> Rows:
    """Column number k of such a file with so many numbers in a row, shape (rows,); no other one is in memory."""
    values = np.empty(path.stat().st_size // (width * DOUBLE_BYTES))
    with path.open("rb") as file:
        for begin in range(0, len(values), ROWS_AT_A_TIME):
            rows = np.fromfile(file, count=ROWS_AT_A_TIME * width).reshape(-1, width)
            values[begin : begin + len(rows)] = rows[:, k]
    return values
