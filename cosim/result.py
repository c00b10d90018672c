"""Columns with units and provenance, in memory and streamed to CSV."""

from __future__ import annotations

import csv
import json
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

CHUNK = 4096


@dataclass(frozen=True)
class Result:
    """Rows of a run: `data` has shape (rows, columns), the first column is the time in s."""

    columns: list[str]
    units: dict[str, str]
    data: NDArray[np.float64]
    provenance: dict[str, Any]

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """The column of a variable, shape (rows,)."""
        if name not in self.columns:
            raise KeyError(f"{name} was not recorded, only {', '.join(self.columns)}")
        column: NDArray[np.float64] = self.data[:, self.columns.index(name)]
        return column

    @property
    def frame(self) -> pd.DataFrame:
        """The rows as a pandas frame."""
        import pandas as pd

        return pd.DataFrame(self.data, columns=self.columns)


class Recorder:
    """Takes rows; with a path it streams them to NAME.partial.csv, which becomes NAME.csv.

    A run that does not end leaves NAME.partial.csv and NAME.partial.json, which says where and why.
    """

    def __init__(self, columns: Sequence[str], units: dict[str, str], path: Path | None) -> None:
        self.columns = ["time", *columns]
        self.units = {"time": "s", **units}
        self.rows = array("d")
        self._path = path
        self._written = 0
        self._file: IO[str] | None = None
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = partial(path).open("w", newline="", encoding="utf-8")
            csv.writer(self._file).writerow(self.columns)

    def add(self, row: Sequence[float]) -> None:
        """Append one row: the time and the values in the order of the columns."""
        self.rows.extend(row)
        if self._file is not None and len(self.rows) - self._written >= CHUNK * len(self.columns):
            self._flush()

    def _flush(self) -> None:
        if self._file is not None:
            width = len(self.columns)
            fresh = np.array(self.rows[self._written :]).reshape(-1, width)
            csv.writer(self._file).writerows(fresh.tolist())
            self._file.flush()
            self._written = len(self.rows)

    def finish(self, provenance: dict[str, Any]) -> Result:
        """Close the file; only a run of status "complete" gets the name that was asked for."""
        data = np.array(self.rows).reshape(-1, len(self.columns))
        result = Result(self.columns, self.units, data, provenance)
        if self._file is not None and self._path is not None:
            self._flush()
            self._file.close()
            target = partial(self._path)
            if provenance["status"] == "complete":
                target = target.replace(self._path)
            write_json(target.with_suffix(".json"), {**provenance, "units": self.units})
        return result


def partial(path: Path) -> Path:
    """Where a file lives until it is complete."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write readable JSON."""
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
