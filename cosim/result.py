"""The result of a run, complete or stopped early: columns with units, and provenance."""

from __future__ import annotations

import base64
import functools
import html
import os
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, cached_property
from io import BytesIO, FileIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .dense import Curves
from .errors import RunError, SetupError
from .json_values import json_text
from .series import NO_BREAKS, TIME, Column, Kind, Series, column_facts
from .table_file import TableFile, facts_path, read_file

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Rows = NDArray[np.float64]
#: The entries of the JSON file beside rows: what was run, what it took, how it ended.
Provenance = dict[str, Any]
#: Whole numbers below this one are all doubles. Derived: 2^53.
MOST_EXACT = 2.0**53
#: Curves that a notebook shows unasked. A convention: more do not fit on a screen.
MOST_CURVES = 6


#: Parts of a run whose peaks are compared, and how much each of the last ones exceeds that before. Chosen: in a stable
#: system a signal that comes from rest has grown by the middle; t**12 grows less; 1e5 in half a run is no machine.
PARTS = 10
GROWTH = 10.0


def growth_start(t: Rows, x: Rows) -> Rows:
    """From when [s] on columns over times t [s] grow without bound, shape (columns,), nan for those that do not.

    x has the shape (columns, rows). The size of what grows exceeds that of the part of the run before ten times, in each part
    of the second half at least, or is no finite number at last.
    """
    edges = np.linspace(t[0], t[-1], PARTS + 1)[:-1]
    first = np.searchsorted(t, edges)
    if len(np.unique(first)) < PARTS:
        return np.full(len(x), np.nan)
    is_lost = ~np.isfinite(x)
    peaks = np.maximum.reduceat(np.abs(np.where(is_lost, np.inf, x)), first, axis=1)
    with np.errstate(invalid="ignore"):
        grows = (peaks[:, 1:] >= GROWTH * peaks[:, :-1]) & (peaks[:, 1:] > 0.0)
    late = (grows | np.isinf(peaks[:, 1:])) & (peaks[:, :-1] > 0.0)
    since = PARTS - 1 - np.argmin(np.pad(late, ((0, 0), (1, 0)))[:, ::-1], axis=1)
    return np.where(since < PARTS // 2, edges[since], np.nan)


class Result(Series):
    """Rows of a run, a `Series`; rows streamed to a file are read from it on first use.

    At a jump that the master knows, of an input or by a change, two rows have the same time: the first is the
    last before the jump, the second the first after it.

    Attributes
    ----------
    columns
        What each column is; the first is the time.
    provenance
        The entries of the JSON file beside the rows.
    breaks
        Intervals, begin and end [s], in which columns may jump, shape (breaks, 2): of length zero where two
        rows show the jump, else from a row before it to the first that what is behind it reaches.
    """

    def __init__(
        self,
        columns: Sequence[Column],
        provenance: Provenance,
        load: Callable[[int], Rows],
        *,
        breaks: Rows = NO_BREAKS,
    ) -> None:
        super().__init__(columns, load, breaks=breaks, label="the result")
        self.provenance = provenance

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column, shape (rows,); whole numbers as such, where doubles tell them apart. Raises KeyError."""
        values, kind = super().__getitem__(name), self.column(name).kind
        if kind in (Kind.INTEGER, Kind.ENUMERATION, Kind.BOOLEAN):
            is_whole = np.isfinite(values).all() and np.abs(values).max(initial=0.0) < MOST_EXACT
            return values.astype(np.int64) if is_whole else values
        return values

    def with_columns(self, more: Mapping[Column, Rows], of: Sequence[str] = ()) -> Result:
        """The result with further columns, each with its values, shape (rows,), which are made `of` these of its own.

        Where one of those converges with order 1 only, so do the new ones.
        """
        columns, values, known = [*self.columns, *more], [*more.values()], len(self.columns)
        first = self.provenance.get("first_order", ())
        names = [column.name for column in more] if {*first} & {*of} else []
        return Result(
            columns, {**self.provenance, "first_order": [*first, *names]},
            lambda k: self.load(k) if k < known else values[k - known], breaks=self.breaks,
        )  # fmt: skip

    def solution(self, name: str) -> Curves:
        """A column as a function of time, one curve, of its kind and with its breaks; raises KeyError."""
        is_held = self.column(name).kind.is_held
        return Curves.of_rows(self["time"], self[name], is_held=is_held, breaks=self.breaks)

    def __repr__(self) -> str:
        columns = (f"{column.name} [{column.unit}]" for column in self.columns[1:])
        return f"Result({self._span()}: {', '.join(columns)})"

    def _span(self) -> str:
        """How it ended, from when to when."""
        ran = self.provenance
        reason = f"; {ran['reason']}" if ran["status"] == "complete" and ran.get("reason") else ""
        return f"{ran['status']}, {ran['start']:g} to {ran['reached']:g} s{reason}"

    def _repr_html_(self) -> str:
        """Status, warnings, the extremes of every column and a picture of the first of them."""
        content = "".join(f"<p>{html.escape(text)}</p>" for text in (self._span(), *self.warnings))
        if len(self.columns) <= 1 or not len(self.data):
            return content
        rows = self.frame.drop(columns="time")
        table = rows.agg(["min", "mean", "max"]).T.assign(last=rows.iloc[-1])
        table.insert(0, "unit", [column.unit for column in self.columns[1:]])
        content += table.to_html(float_format="{:.6g}".format)
        self.plot(self.names[1 : 1 + MOST_CURVES], buffer := BytesIO())
        picture = base64.b64encode(buffer.getvalue()).decode()
        return f'{content}<img src="data:image/png;base64,{picture}" style="max-width: 100%">'

    @cached_property
    def data(self) -> Rows:
        """All rows, shape (rows, columns); the first column is the time in s."""
        loaded = [self.load(k) for k in range(len(self.columns))]
        return np.column_stack(loaded) if loaded else np.empty((0, 0))

    @property
    def warnings(self) -> list[str]:
        """Warnings of the parts, as "part: sentence", and of bonds in which the coupling created energy."""
        warnings: list[str] = self.provenance["warnings"]
        return warnings

    def doubts(self) -> Iterator[str]:
        """What the rows themselves show to be wrong: signals without bound, whole numbers that doubles round."""
        t = self.t
        for column in self.columns[1:] if len(t) else ():
            if column.kind is Kind.TEXT:
                continue
            x = self.numbers(column.name, gaps=True, finite=False)
            if column.kind is Kind.INTEGER and np.abs(x).max() >= MOST_EXACT:
                yield f"{column.name} exceeds 2^53: rows are doubles and do not hold its last digits"
            start = float(growth_start(t, x[None])[0])
            if not np.isnan(start):
                yield (
                    f"{column.name} grows without bound from {start:g} s on, to {x[-1]:.2g}: the system is unstable, or "
                    "the step is too long for it; run it with half the step to tell which"
                )

    @property
    def energy(self) -> dict[str, dict[str, float]]:
        """By power bond: the energy `given` and `taken`, their `residual`, and the energy exchanged [J].

        All counted from the initialisation on: of a run that begins with a state, before the state too.
        """
        bonds: dict[str, dict[str, float]] = self.provenance["bonds"]
        return bonds

    @property
    def frame(self) -> pd.DataFrame:
        """The rows as a pandas frame."""
        import pandas as pd

        return pd.DataFrame(self.data, columns=self.names)

    def write(self, path: Path | str, part: str | None = None) -> None:
        """Write NAME.csv and NAME.json with units and provenance, or NAME.parquet and NAME.parquet.json: both or neither.

        Parameters
        ----------
        path : path
            The file of the rows.
        part : str, optional
            The part whose columns are written, under their bare names; by default all columns.

        Raises
        ------
        SetupError
            For any other suffix or a part without columns.
        OSError
            If there is no room.
        """
        path, frame, columns = Path(path), self.frame, self.columns
        if part is not None:
            prefix = f"{part}."
            own = [column for column in columns if column.name.startswith(prefix)]
            if not own:
                raise SetupError(f"no column of part {part!r}, only {', '.join(self.names)}")
            bare_names = {column.name: column.name.removeprefix(prefix) for column in own}
            frame = frame[["time", *bare_names]].rename(columns=bare_names)
            columns = (TIME, *(replace(column, name=bare_names[column.name]) for column in own))
        if path.suffix.lower() not in (".csv", ".parquet"):
            raise SetupError(f"{path} must end in .csv or .parquet")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_table(frame, path, self.provenance | table_facts(columns, self.breaks))

    def plot(
        self, names: Sequence[str] | str | None = None, path: Path | str | IO[bytes] | None = None
    ) -> Figure:
        """Plot columns over time, one axis per unit.

        Parameters
        ----------
        names : str or sequence of str, optional
            The columns, by default all.
        path : path or file, optional
            Where the figure is also written.

        Returns
        -------
        Figure
            A figure of matplotlib.
        """
        from .picture import panels

        names = self.names[1:] if names is None else names
        names = [names] if isinstance(names, str) else list(names)
        names_of: dict[str, list[str]] = {}
        for name in names:
            names_of.setdefault(self.units.get(name, ""), []).append(name)

        def draw(names: Sequence[str], axis: Axes) -> None:
            for name in names:
                axis.plot(self["time"], self[name], label=name, linewidth=1)

        figure = panels([(unit, functools.partial(draw, own)) for unit, own in names_of.items()])
        ran = self.provenance
        ended = "" if ran["status"] == "complete" else f" ({ran['status']})"
        title = f"{ran['algorithm']}, {ran['communication']}{ended}"
        figure.axes[0].set_title(title, fontsize="small", loc="left")
        figure.write(path)
        return figure


class Unfinished(BaseException):
    """What ended a run or several; `result` contains all rows up to then, of many runs those that are done."""

    def __init__(self, message: str, result: Any) -> None:
        super().__init__(message)
        self.result = result


class SimulationError(Unfinished, RunError):
    """A part failed during the run."""

    result: Result


class Interrupted(Unfinished, KeyboardInterrupt):
    """A run was interrupted by Ctrl-C."""


def partial(path: Path) -> Path:
    """Where a file lives until it is complete."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def require_writable_names(path: Path) -> None:
    """Raise SetupError if a file that goes with a result cannot have its name.

    A symbolic link at such a name would lead to a file that nobody has named: it is refused.
    """
    rows = partial(path)
    for name in (rows, facts_path(rows), facts_path(path)):
        try:
            mode = name.lstat().st_mode
        except FileNotFoundError:
            continue
        except OSError as error:
            raise SetupError(f"{name} cannot be written: {error.strerror}") from None
        if stat.S_ISDIR(mode):
            raise SetupError(f"{name} is a folder, and a file of the result needs the name")
        if stat.S_ISLNK(mode):
            raise SetupError(
                f"{name} is a symbolic link, and results are not written through links: "
                "remove it or choose another name"
            )


def open_unlinked(path: Path, mode: str) -> FileIO:
    """Open a file for writing without a buffer, but not through a symbolic link at its name."""

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)

    return FileIO(path, mode, opener=opener)


def file_columns(path: Path) -> Callable[[int], Rows]:
    """Gives the columns of a file of rows by their number; it is read when the first is asked for, a large one each time.

    Raises SetupError if the file has been written since, and has to be read.
    """

    def written() -> tuple[int, int] | None:
        with suppress(OSError):
            return path.stat().st_mtime_ns, path.stat().st_ino
        return None

    now = written()

    def require_same() -> None:
        if written() != now:
            raise SetupError(f"{path} has been written since by another run: give each its own csv")

    @cache
    def table() -> TableFile:
        require_same()
        return read_file(path)

    def load(k: int) -> Rows:
        if table().is_large:
            require_same()
        return table().load(k).astype(np.float64)

    return load


def write_table(frame: pd.DataFrame, path: Path, facts: dict[str, Any]) -> None:
    """Write a frame to NAME.csv or NAME.parquet and the facts beside it: both files or neither.

    Raises SetupError if a file cannot have its name or pyarrow is missing, and OSError without room.
    """
    require_writable_names(path)
    rows = partial(path)
    try:
        if path.suffix.lower() == ".csv":
            frame.to_csv(rows, index=False)
        else:
            frame.to_parquet(rows, index=False)
        write_json(facts_path(rows), facts)
        facts_path(rows).replace(facts_path(path))
        rows.replace(path)
    except ImportError:
        raise SetupError(
            f"{path}: Parquet needs the package pyarrow, the extra `parquet`"
        ) from None
    except OSError:
        for name in (rows, facts_path(rows)):
            name.unlink(missing_ok=True)
        raise


def table_facts(columns: Sequence[Column], breaks: Rows) -> dict[str, Any]:
    """What the JSON file says of the columns beside it: `units`, `kinds` and `breaks`."""
    return {**column_facts(columns), "breaks": breaks.tolist()}


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write readable JSON, in which numbers that are infinite or nan are null."""
    with open_unlinked(path, "wb") as file:
        file.write(json_text(content).encode())
