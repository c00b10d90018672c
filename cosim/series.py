"""A table over time: what its columns are, as the master or a file knows them, and one reader for all files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import SetupError
from .names import only
from .table_file import TableFile, is_empty, is_time, number_of, of_columns, read_file, read_text
from .units import multiples

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
#: No intervals.
NO_BREAKS = np.zeros((0, 2))
NUMBER = r"\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
SCALED = re.compile(
    rf"(?P<name>.*?)\s*(?:(?P<sign>[*/])\s*(?P<factor>[+-]?{NUMBER}))?\s*(?P<offset>[+-]{NUMBER})?\s*",
    re.DOTALL,
)


class Kind(Enum):
    """What the values of a column are; all but continuous ones hold from a row to the next."""

    CONTINUOUS = "continuous"
    DISCRETE = "discrete"
    INTEGER = "integer"
    BOOLEAN = "boolean"
    ENUMERATION = "enumeration"
    TEXT = "text"

    @property
    def is_held(self) -> bool:
        """Whether a value holds from its row to the next, so that nothing lies between two values."""
        return self is not Kind.CONTINUOUS


#: What a column of a file is whose kind is not stated, by the type of its values.
KIND_OF_TYPE = dict.fromkeys("fiu", Kind.CONTINUOUS) | {"b": Kind.BOOLEAN}


@dataclass(frozen=True)
class Column:
    """A column of a table: `order` is the convergence order of its values, `source` where they come from."""

    name: str
    unit: str = ""
    kind: Kind = Kind.CONTINUOUS
    order: int | None = None
    source: str = ""


#: The first column of every table.
TIME = Column("time", "s")


def described_columns(
    names: Sequence[str], units: Mapping[str, str], kinds: Mapping[str, str]
) -> tuple[Column, ...]:
    """The columns that the entries `units` and `kinds` of a JSON file describe; kinds that lack are continuous."""
    return tuple(
        Column(name, units.get(name, ""), Kind(kinds.get(name, Kind.CONTINUOUS.value)))
        for name in names
    )


def column_facts(columns: Sequence[Column]) -> dict[str, dict[str, str]]:
    """The entries `units` and `kinds` of a JSON file, the latter for columns that are not continuous."""
    held = {column.name: column.kind.value for column in columns if column.kind.is_held}
    return {"units": {column.name: column.unit for column in columns}, "kinds": held}


class Reading(NamedTuple):
    """A column of a file and how to read its numbers: factor * number + offset, in a unit if given."""

    name: str
    factor: float = 1.0
    offset: float = 0.0
    unit: str | None = None

    @classmethod
    def read(cls, text: str, names: Collection[str], where: str) -> Reading:
        """The column of "M", or of "M * 0.73 + 5:N.m", which scales it and gives it a unit.

        Raises SetupError for a column that `where` lacks, and for a factor of 0.
        """
        text = text.strip()
        if text not in names:  # long runs of blanks take the expression below hours
            text = re.sub(r"\s+", " ", text)
        scaled, colon, unit = text.rpartition(":")
        match = SCALED.fullmatch(scaled if colon else text)
        name = match["name"] if match and text not in names else text
        if name not in names:
            raise SetupError(f"{where} has no column {text!r}, {only(text, names)}")
        if match is None or name == text:
            return cls(name)
        factor = float(re.sub(r"\s", "", match["factor"] or "1"))
        if not factor:
            raise SetupError(f"column {text!r}: the factor must not be 0")
        factor = 1.0 / factor if match["sign"] == "/" else factor
        offset = float(re.sub(r"\s", "", match["offset"] or "0"))
        return cls(name, factor, offset, unit.strip() if colon else None)


class Series:
    """Columns over time: an input table, a measured record, a result of this master or of another.

    Parameters
    ----------
    columns : sequence of Column
        What each column is, in the sequence of the file.
    load : callable
        Gives the values of a column, by its number, in their own type, shape (rows,).
    breaks : array of shape (breaks, 2)
        Intervals, begin and end [s], in which columns may jump.
    label : str
        What messages call it.
    """

    def __init__(
        self,
        columns: Sequence[Column],
        load: Callable[[int], NDArray[Any]],
        *,
        breaks: Array = NO_BREAKS,
        label: str = "the table",
    ) -> None:
        self.columns, self.breaks, self.label = tuple(columns), breaks, label
        self.load = load

    @property
    def names(self) -> list[str]:
        """The names of the columns in their sequence."""
        return [column.name for column in self.columns]

    @property
    def units(self) -> dict[str, str]:
        """The units of the columns by name; empty where none is known."""
        return {column.name: column.unit for column in self.columns}

    def column(self, name: str) -> Column:
        """What a column is; raises KeyError for one that there is not."""
        return self.columns[self._index(name)]

    @property
    def signal(self) -> Column:
        """The one column beside the times, of an input or a record; raises SetupError if there is not one."""
        columns = [column for column in self.columns if column.name != self.clock]
        if len(columns) != 1:
            names = ", ".join(column.name for column in columns) or "none"
            raise SetupError(f"{self.label} must have one column beside {self.clock}, not {names}")
        return columns[0]

    def _index(self, name: str) -> int:
        if name not in (names := self.names):
            raise KeyError(f"{name} was not recorded, {only(name, names)}")
        return names.index(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The values of a column in their own type, shape (rows,); raises KeyError for one that there is not."""
        return self.load(self._index(name))

    @property
    def clock(self) -> str:
        """The name of the column of times: one that is called so, else the first."""
        named = (column.name for column in self.columns if is_time(column.name))
        return next(named, self.columns[0].name)

    @cached_property
    def t(self) -> Array:
        """The times [s], shape (rows,), of which two may be equal; raises SetupError for times that fall, or are none."""
        return rising_times(self.scaled(Reading(self.clock), "s"), self.label)

    def numbers(self, name: str = "", *, gaps: bool = False, finite: bool = True) -> Array:
        """The numbers of a column, by default of the one beside the times, nan for cells that are none.

        Raises SetupError with row and column for what is not finite, unless there may be `gaps`, cells that are empty,
        or the numbers need not be `finite` at all; row 1 is the heading.
        """
        name = name or self.signal.name
        values = self[name]
        if values.dtype.kind in "mM":
            raise SetupError(f"{self.label}, column {name}: it has dates, and must have numbers")
        if values.dtype.kind in "fiub":
            numbers, is_number = values.astype(float), np.ones(len(values), dtype=bool)
        else:
            cells = values.tolist()
            numbers = np.array([number_of(cell) for cell in cells], float)
            is_number = ~np.isnan(numbers) | np.array([is_empty(cell) for cell in cells], bool)
        wrong = ~is_number | np.isinf(numbers) | (np.isnan(numbers) & (not gaps))
        if finite and wrong.any():
            row = int(np.argmax(wrong))
            what = "not a number" if not is_number[row] else "not a finite number"
            raise SetupError(
                f"{self.label}, row {row + 2}, column {name}: {str(values[row])[:40]!r} is {what}"
            )
        return numbers

    def readings(self, texts: Mapping[str, str]) -> dict[str, Reading]:
        """By new names, how columns are read that are stated as texts; raises SetupError if one is stated twice."""
        names, taken = dict.fromkeys(self.names), dict[str, str]()
        readings = {name: Reading.read(text, names, self.label) for name, text in texts.items()}
        for name, reading in readings.items():
            if (other := taken.setdefault(reading.name, name)) != name:
                of = f"{self.label}, column {reading.name}"
                raise SetupError(f"{of}: it is mapped twice, to {other} and {name}")
        return readings

    def unit_of(self, reading: Reading) -> str:
        """The unit of a reading, that of its column where it states none; empty if neither does."""
        return self.column(reading.name).unit if reading.unit is None else reading.unit

    def scaled(self, reading: Reading, unit: str, *, gaps: bool = False) -> Array:
        """The numbers of a reading in a unit, none for its own; raises SetupError if it cannot be converted."""
        stated = self.unit_of(reading)
        scale = 1.0 if not stated or not unit or stated == unit else multiples(unit).get(stated)
        if scale is None:
            choices = " or ".join(multiples(unit))
            raise SetupError(
                f"{self.label}: {reading.name} [{stated}] cannot be converted to {unit}, only from {choices}"
            )
        numbers = self.numbers(reading.name, gaps=gaps)
        return scale * (reading.factor * numbers + reading.offset)

    def __copy__(self) -> Self:
        """The same table, whose values stay where they are."""
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        return other

    def __getstate__(self) -> dict[str, Any]:
        """With its values, for another process."""
        values = [self.load(k) for k in range(len(self.columns))]
        return vars(self) | {"load": values.__getitem__}

    def held(self) -> Self:
        """The table with numbers that hold from their row to the next, in place of lying on lines."""
        other = copy(self)
        other.columns = tuple(
            c if c.kind.is_held or c.name == self.clock else replace(c, kind=Kind.DISCRETE)
            for c in self.columns
        )
        return other

    def between(self, first: float, last: float) -> Self:
        """The rows between two times [s]; raises SetupError if there are none."""
        rows = (self.t >= first) & (self.t <= last)
        if not rows.any():
            raise SetupError(
                f"{self.label}: it has no rows from {first:g} to {last:g} s, only from "
                f"{self.t[0]:g} to {self.t[-1]:g} s"
            )
        return self.select(rows)

    def with_columns_from(self, load: Callable[[int], NDArray[Any]]) -> Self:
        """The table with the values that `load` gives by the number of the column, 0 for the first, shape (rows,)."""
        other = copy(self)
        other.load = load
        for made in ("t", "data"):  # of the values that it has no more
            vars(other).pop(made, None)
        return other

    def select(self, rows: slice | NDArray[Any]) -> Self:
        """The table with these rows only."""
        return self.with_columns_from(lambda k: self.load(k)[rows])

    def pieces(self) -> Iterator[Self]:
        """The stretches without equal times and without breaks, each with two rows at least."""
        t = self.t
        cut = np.diff(t) <= 0.0
        for begin, end in self.breaks[self.breaks[:, 1] > self.breaks[:, 0]]:
            cut |= (t[:-1] < end) & (t[1:] > begin)
        ends = [0, *(np.flatnonzero(cut) + 1).tolist(), len(t)]
        for first, last in pairwise(ends):
            if last - first > 1:
                piece = self.select(slice(first, last))
                piece.breaks = NO_BREAKS
                yield piece

    @classmethod
    def read(cls, path: Path | str, columns: Mapping[str, str] | str | None = None) -> Series:
        """Read a table.

        Parameters
        ----------
        path : path
            A .parquet file, a .mat file of Modelica tools, or a text of cells with a heading, whose separator is a
            comma, a semicolon or a tab; with the latter two, decimals may have commas. Units come from
            headings, "n [rpm]", "n (rpm)" or "n / rpm", or from a JSON file beside it, as `Result.write` makes it.
            A file above 50 MB is read column by column, when they are asked for.
        columns : str or mapping of str to str, optional
            A column with a factor, an offset and a unit where needed: "n * 0.4:rpm"; or by their new names several of
            them. The columns of the series are the time and these.

        Raises
        ------
        SetupError
            With the reason for a file that cannot be read, and for two columns of one name.
        """
        path = Path(path)
        series = _series(read_file(path), str(path), path.name)
        if columns is None:
            return series
        texts = {"": columns} if isinstance(columns, str) else columns
        kept: list[Column] = [TIME]
        loads: list[Callable[[], NDArray[Any]]] = [lambda: series.t]
        for name, text in texts.items():
            reading = Reading.read(text, series.names, str(path))
            of = series.column(reading.name)
            kept.append(replace(of, name=name or of.name, unit=series.unit_of(reading)))
            is_number = of.kind not in (Kind.BOOLEAN, Kind.TEXT) or reading != Reading(of.name)
            loads.append(
                partial(series.scaled, reading, "")
                if is_number
                else partial(series.__getitem__, of.name)
            )
        return cls(kept, lambda k: loads[k](), breaks=series.breaks, label=str(path))

    @classmethod
    def read_cells(cls, path: Path | str, *, may_lack: bool = False) -> Series:
        """The cells of a file as texts, "" for empty ones: of a table whose values are not numbers alone.

        Raises SetupError for rows that are shorter than the heading, unless they `may_lack` cells.
        """
        path = Path(path)
        series = _series(read_file(path, as_texts=True), str(path))
        cells = []
        for k, name in enumerate(series.names):
            values = series.load(k).tolist()
            if None in values and not may_lack:
                row = values.index(None) + 2
                raise SetupError(f"{path}, row {row}: there is no cell under {name}")
            cells.append(np.array(["" if is_empty(x) else str(x).strip() for x in values]))
        return series.with_columns_from(cells.__getitem__)

    @classmethod
    def of_any(
        cls, source: Series | pd.DataFrame | Mapping[str, ArrayLike] | Path | str, label: str
    ) -> Series:
        """The table of a result, of a frame or of columns, which messages call `label`, or of a file."""
        if isinstance(source, str | Path):
            return cls.read(source)
        if isinstance(source, Series):
            return Series(source.columns, source.load, breaks=source.breaks, label=label)
        return cls.of(source, label)

    @classmethod
    def of(
        cls, columns: pd.DataFrame | Mapping[str, ArrayLike], label: str = "the table"
    ) -> Series:
        """The columns of a pandas frame or a mapping, whose headings may have units.

        Raises SetupError for two of one name, and for columns of several lengths.
        """
        return _series(of_columns(columns, label), label)

    @classmethod
    def of_text(cls, text: str, label: str) -> Series:
        """The columns of a text of cells with a heading; raises ValueError or SetupError for what is none."""
        return _series(read_text(text, label), label, label)


def rising_times(t: Array, label: str, *, strictly: bool = False) -> Array:
    """Times [s] of rows, shape (rows,); raises SetupError with the row for those that fall, or do not rise `strictly`."""
    falls = np.flatnonzero(np.diff(t) <= 0.0 if strictly else np.diff(t) < 0.0)
    if falls.size:
        before, after = t[falls[0] :][:2].tolist()
        what = "must rise" if strictly else "must be finite and not fall"
        raise SetupError(f"{label}, row {falls[0] + 3}: time {after!r} s after {before!r} s {what}")
    return t


def _series(table: TableFile, label: str, source: str = "") -> Series:
    """The series of what a file has; raises SetupError for two columns of one name, and for a kind that there is not."""
    names = Counter(name for name, _ in table.headings)
    if twice := [name for name, count in names.items() if count > 1]:
        raise SetupError(f"{label} has two columns named {twice[0]!r}")
    if not names:
        raise SetupError(f"{label} cannot be read as a table: it has no columns")
    kinds, columns = table.facts.get("kinds", {}), []
    for k, (name, unit) in enumerate(table.headings):
        stated = kinds.get(name)
        if stated is not None and stated not in Kind._value2member_map_:
            raise SetupError(f"{label}: {name} is {stated!r}, which is not a kind of column")
        if stated is not None or table.is_large:
            kind = Kind.CONTINUOUS if stated is None else Kind(stated)
        else:
            kind = KIND_OF_TYPE.get(table.load(k).dtype.kind, Kind.TEXT)
        of = f"{source}, column {name}" if source else ""
        columns.append(Column(name, unit, kind, source=of))
    breaks = np.array(table.facts.get("breaks", []), float).reshape(-1, 2)
    return Series(columns, table.load, breaks=breaks, label=label)
