"""Columns with units and provenance: rows in memory or streamed to a file, on any grid of times."""

from __future__ import annotations

import csv
import json
import math
import time as clock
from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .curve import same
from .errors import SetupError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

CHUNK = 4096
LONGEST = 0.1
Rows = NDArray[np.float64]


class Result:
    """Rows of a run, read from their file when they are asked for if they were streamed there."""

    def __init__(
        self,
        columns: list[str],
        units: dict[str, str],
        provenance: dict[str, Any],
        load: Callable[[], Rows],
    ) -> None:
        self.columns, self.units, self.provenance = columns, units, provenance
        self._load = load

    @cached_property
    def data(self) -> Rows:
        """All rows, shape (rows, columns); the first column is the time in s."""
        return self._load()

    def __getitem__(self, name: str) -> Rows:
        """The column of a variable, shape (rows,)."""
        if name not in self.columns:
            raise KeyError(f"{name} was not recorded, only {', '.join(self.columns)}")
        column: Rows = self.data[:, self.columns.index(name)]
        return column

    @property
    def warnings(self) -> list[str]:
        """What the parts warned of, "part: sentence", and bonds on which the coupling made energy."""
        warnings: list[str] = self.provenance["warnings"]
        return warnings

    @property
    def energy(self) -> dict[str, dict[str, float]]:
        """By power bond: the energy `given`, `taken`, their `residual`, and what went to and fro [J]."""
        bonds: dict[str, dict[str, float]] = self.provenance["bonds"]
        return bonds

    @property
    def frame(self) -> pd.DataFrame:
        """The rows as a pandas frame."""
        import pandas as pd

        return pd.DataFrame(self.data, columns=self.columns)

    def write(self, path: Path, part: str | None = None) -> None:
        """Write NAME.csv or NAME.parquet, and units and provenance to NAME.json.

        With a part, only its columns, under their bare names. Raises SetupError for another suffix
        or a part without columns.
        """
        frame, units = self.frame, self.units
        if part is not None:
            own = {name: name.removeprefix(f"{part}.") for name in self.columns[1:]}
            own = {name: bare for name, bare in own.items() if name != bare}
            if not own:
                raise SetupError(f"no column of part {part!r}, only {', '.join(self.columns)}")
            frame = frame[["time", *own]].rename(columns=own)
            units = {"time": "s"} | {bare: units[name] for name, bare in own.items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".csv":
            frame.to_csv(path, index=False)
        elif path.suffix == ".parquet":
            try:
                frame.to_parquet(path)
            except ImportError:
                raise SetupError(
                    f"{path}: Parquet needs the package pyarrow, the extra `parquet`"
                ) from None
        else:
            raise SetupError(f"{path} must end in .csv or .parquet")
        write_json(path.with_suffix(".json"), {**self.provenance, "units": units})

    def plot(self, names: Sequence[str] | None = None, path: Path | None = None) -> Figure:
        """The columns over time, those of one unit in one axis; written to a file if asked."""
        from matplotlib.figure import Figure

        names = self.columns[1:] if names is None else list(names)
        axes_of = list(dict.fromkeys(self.units.get(name, "") for name in names))
        figure = Figure(figsize=(9, 1.2 + 2.2 * len(axes_of)), layout="constrained")
        axes = figure.subplots(len(axes_of), sharex=True, squeeze=False)[:, 0]
        for axis, unit in zip(axes, axes_of):
            for name in names:
                if self.units.get(name, "") == unit:
                    axis.plot(self["time"], self[name], label=name, linewidth=1)
            axis.set_ylabel(unit or "1")
            axis.grid(alpha=0.3)
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
        axes[-1].set_xlabel("time / s")
        axes[0].set_title(self._subtitle(), fontsize="small", loc="left")
        if path is not None:
            figure.savefig(path, dpi=150)
        return figure

    def _subtitle(self) -> str:
        """How the run was made, and whether it came to its end."""
        told = self.provenance
        text = f"{told['algorithm']}, {told['communication']}"
        return text if told["status"] == "complete" else f"{text} ({told['status']})"


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


def partial(path: Path) -> Path:
    """Where a file lives until it is complete."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def read_rows(path: Path) -> Rows:
    """The rows of a CSV file, to the last digit."""
    import pandas as pd

    rows: Rows = pd.read_csv(path).to_numpy(dtype=np.float64)
    return rows


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write readable JSON."""
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
