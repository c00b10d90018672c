"""All rows of a run in a file of plain numbers, for what looks at each communication point."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..result import Rows

#: Size from which on rows stay in their file [bytes]: convention, a small share of a computer's memory.
MAPPED_BYTES = 50_000_000
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


def read_row_file(path: Path, width: int) -> Rows:
    """The rows of a file, shape (rows, width); they stay there if they are MAPPED_BYTES or more."""
    if path.stat().st_size < MAPPED_BYTES:
        return np.fromfile(path).reshape(-1, width)
    return np.memmap(path, dtype=np.float64, mode="r").reshape(-1, width)
