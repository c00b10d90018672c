"""Tables in files: texts of cells, Parquet and the results of Modelica tools, with what a JSON file beside them says."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import SetupError
from .numbers import real
from .units import is_common, multiples

if TYPE_CHECKING:
    import pandas as pd

Values = NDArray[Any]
#: Size of a file from which on its columns are read one by one [bytes]: chosen, as doubles it is some 30 MB.
LARGE = 50_000_000
#: What a column of times is called.
TIMES = ("time", "t", "zeit", "timestamp")
#: A heading, whose unit stands in brackets, in parentheses or behind a slash.
HEADING = re.compile(
    r"(?P<name>.*?)\s*(?:\[(?P<bracket>[^\[\]]*)\]|\((?P<round>[^()]*)\)|/ ?(?P<slash>[^\s/]+))?",
    re.DOTALL,
)
ROUND = re.compile(r"\([^()]*\)\s*$")
#: What in parentheses may be a unit: no digit first and no blank.
UNIT = re.compile(r"[^\W\d][^\s,;]*|[%°][^\s,;]*|1")
#: An index as in A[2,1], which belongs to the name and is no unit. A convention of FMI.
INDEX = re.compile(r"[\d, ]+")
#: What masters write in brackets that is no unit: the type of a variable, or its reference and causality.
TYPE = re.compile(
    r"(\d+ )?(real|integer|boolean|string|int|bool|float64|float32|int32)\b.*", re.IGNORECASE
)
DECIMAL = re.compile(r"^\s*([+-]?[0-9]*),([0-9]+)")
#: A name that ends with its unit, as loggers write it: t_ms, w_rpm, "time in ms".
UNIT_AT_END = re.compile(r"(?P<name>.+?)(?:_| in )(?P<unit>[\w./%]{2,})")
#: In a file whose cells are not separated by commas: a number with a decimal comma, and one whose point may stand for
#: thousands.
COMMA_CELL = re.compile(r"(?:^|[;\t])\s*[+-]?\d*,\d+\s*(?=[;\t]|$)", re.MULTILINE)
POINT_CELL = re.compile(
    r"(?:^|[;\t])\s*(?P<cell>[+-]?\d{1,3}(?:\.\d{3})+)(?:,\d*)?\s*(?=[;\t]|$)", re.MULTILINE
)
#: The number of the matrix of what varies with time, `data_2`: a convention of the Modelica tools' format 1.1.
VARYING = 2
#: The first line with which some programs state their separator. A convention of spreadsheets.
SEPARATOR_LINE = re.compile(r'"?sep=(.)"?\s*')
#: What stands for no number in a cell. A convention of loggers.
NOTHING = ("", "nan", "NaN", "NAN", "-nan")
#: What the JSON file beside a table says of its columns.
FACTS = ("units", "kinds", "breaks")


@dataclass(frozen=True)
class TableFile:
    """A table as a file has it.

    Attributes
    ----------
    headings : sequence of pairs of str
        Name and unit of each column; the unit is "" where none is stated.
    load : callable
        Gives the values of a column, by its number, in their own type, shape (rows,).
    facts : mapping
        What the JSON file beside it says: `units` and `kinds` by name, and `breaks`.
    is_large : bool
        Whether columns are read from the file each time they are asked for.
    """

    headings: Sequence[tuple[str, str]]
    load: Callable[[int], Values]
    facts: Mapping[str, Any]
    is_large: bool = False


def read_file(path: Path, *, as_texts: bool = False) -> TableFile:
    """The table of a .parquet, a .mat or a text file, of which cells may be left `as_texts`; raises SetupError."""
    if not path.is_file():
        what = (
            "it is not a file but a folder, a pipe or a device"
            if path.exists()
            else "there is no such file"
        )
        raise SetupError(f"{path} cannot be read as a table: {what}")
    facts = _facts_beside(path)
    try:
        if path.suffix.lower() == ".mat":
            return _read_modelica(path, facts)
        if path.suffix.lower() == ".parquet":
            return _read_parquet(path, facts)
        is_large = path.stat().st_size > LARGE
        return _read_text(path, str(path), facts, is_large=is_large, as_texts=as_texts)
    except (
        OSError, ValueError, TypeError, LookupError, NotImplementedError, ImportError, csv.Error,
    ) as error:  # fmt: skip
        raise SetupError(f"{path} cannot be read as a table: {_reason(error)}") from error


def facts_path(path: Path) -> Path:
    """The JSON file beside a table, NAME.json; NAME.parquet has NAME.parquet.json, since NAME.csv may stand beside it."""
    is_parquet = path.suffix.lower() == ".parquet"
    return path.with_suffix(".parquet.json" if is_parquet else ".json")


def is_of_result(path: Path) -> bool:
    """Whether a JSON file says something of columns, as that beside a result does."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and not {*FACTS}.isdisjoint(content)


def split_heading(heading: str) -> tuple[str, str]:
    """A heading as name and unit; what is in its brackets may also be an index or a type.

    A unit that a name ends with, as in t_ms or w_rpm, stays in the name; x_min is no time.
    """
    heading = heading.strip()
    if (end := UNIT_AT_END.fullmatch(heading)) is not None and is_common(end["unit"]):
        is_time = end["name"].lower() in TIMES
        if is_time or end["unit"] != "min":
            return heading, end["unit"] if not is_time or end["unit"] in multiples("s") else ""
    match = HEADING.fullmatch(heading)
    if match is None or not match["name"]:
        return heading, ""
    name, bracket, slash = match["name"], match["bracket"], match["slash"]
    if bracket is not None:
        if INDEX.fullmatch(bracket):
            return heading, ""
        return name, "" if TYPE.fullmatch(bracket) else bracket.strip()
    if match["round"] is not None:
        return (name, match["round"]) if UNIT.fullmatch(match["round"]) else (heading, "")
    if slash is None:
        return heading, ""
    is_spaced = heading[len(name)].isspace()
    is_time = name.lower() in TIMES and slash in multiples("s")
    is_known = len(slash) > 1 and is_common(slash)
    return (name, slash) if is_spaced or is_time or is_known else (heading, "")


def is_time(name: str) -> bool:
    """Whether a column of this name has times: t, time, t_ms, "time in ms"."""
    end = UNIT_AT_END.fullmatch(name)
    is_timed = end is not None and end["unit"] in multiples("s") and end["name"].lower() in TIMES
    return is_timed or name.lower() in TIMES


def split_headings(
    headings: Sequence[str], units: Mapping[str, str], label: str
) -> list[tuple[str, str]]:
    """Names and units of headings, whose units the mapping has first; raises SetupError if there are none."""
    if not headings:
        raise SetupError(f"{label} cannot be read as a table: it has no columns")
    split = [
        (heading.strip(), units[heading.strip()])
        if heading.strip() in units
        else split_heading(heading)
        for heading in headings
    ]
    count = Counter(name for name, _ in split)
    for k, (heading, (name, _)) in enumerate(zip(headings, split)):
        if count[name] > 1 and ROUND.search(heading):  # "speed (set)" and "speed (actual)"
            split[k] = heading.strip(), ""
    return split


def is_empty(cell: object) -> bool:
    """Whether a cell has nothing in it, or nan."""
    is_nan = isinstance(cell, float) and math.isnan(cell)
    return cell is None or is_nan or (isinstance(cell, str) and not cell.strip())


def number_of(cell: object) -> float:
    """The number of a cell, nan for a text that is none."""
    try:
        return real(cell) if isinstance(cell, str) else float(cell)  # type: ignore[arg-type]
    except (ValueError, TypeError):
        return math.nan


def _reason(error: Exception) -> str:
    """Why a file cannot be read, without what only programmers know."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not text in UTF-8"
    reason = (isinstance(error, OSError) and error.strerror) or str(error)
    return str(reason).strip().partition("\n")[0]


def _facts_beside(path: Path) -> dict[str, Any]:
    """What a JSON file beside a table says of its columns; raises SetupError for one that is no JSON, or says it wrong."""
    beside = facts_path(path)
    if not beside.is_file():
        return {}
    try:
        content = json.loads(beside.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = "too many brackets" if isinstance(error, RecursionError) else _reason(error)
        raise SetupError(f"{beside}, beside the table, cannot be read: {reason}") from error
    content = content if isinstance(content, dict) else {}
    facts = {key: content[key] for key in FACTS if key in content}
    for key in ("units", "kinds"):
        texts = facts.get(key, {})
        if not isinstance(texts, dict) or not all(isinstance(x, str) for x in texts.values()):
            raise SetupError(f"{beside}: {key!r} must be texts by the names of columns")
    breaks = facts.get("breaks", [])
    is_pairs = isinstance(breaks, list) and all(
        isinstance(pair, list) and len(pair) == len(("begin", "end"))
        and all(isinstance(x, int | float) for x in pair) for pair in breaks
    )  # fmt: skip
    if not is_pairs:
        raise SetupError(f"{beside}: 'breaks' must be a list of pairs, begin and end in s")
    return facts


def _separator(file: TextIO) -> str:
    """The separator of a text, which is then at its heading: behind comments, and a line that only states it."""
    start, first = 0, file.readline()
    while first.startswith("#"):
        place, following = file.tell(), file.readline()
        if math.isfinite(number_of(re.split(r"[;\t,]", following)[0])):
            break  # it is the heading
        start, first = place, following
    if stated := SEPARATOR_LINE.fullmatch(first):
        return stated[1]
    file.seek(start)
    return next((mark for mark in ";\t" if mark in first), ",")


def _require_one_mark(file: TextIO, mark: str) -> None:
    """Raise ValueError where commas are decimal and a point may stand for thousands; the file stays where it is."""
    if mark == ",":
        return
    place = file.tell()
    text = file.read()
    file.seek(place)
    point = POINT_CELL.search(text)
    if point is not None and COMMA_CELL.search(text):
        cell = point["cell"]
        raise ValueError(
            f"{cell!r} beside decimal commas may be {cell.replace('.', '')} or {cell.replace('.', ',')}: write one of them"
        )


def _read_text(
    source: Path | str,
    label: str,
    facts: Mapping[str, Any],
    *,
    is_large: bool = False,
    as_texts: bool = False,
) -> TableFile:
    """A file, or a text, of cells with a heading."""
    with _opened(source) as file:
        mark = _separator(file)
        if not is_large:
            _require_one_mark(file, mark)
        headings = next(csv.reader(file, delimiter=mark, skipinitialspace=True), [])
    if not headings:
        raise ValueError("it is empty")
    split, count = split_headings(headings, facts.get("units", {}), label), len(headings)
    if is_large and not as_texts:
        return TableFile(
            split, lambda k: _values(_cells(source, count, k)[k], mark), facts, is_large=True
        )
    frame = _cells(source, count, as_texts=as_texts)
    is_filled = frame.notna() & (frame != "")
    beyond = np.flatnonzero(is_filled[count])
    if len(beyond):
        raise ValueError(f"row {beyond[0] + 2} has more cells than the heading")
    frame = frame[: int(np.flatnonzero(is_filled.any(axis=1)).max(initial=-1)) + 1]
    named = [k for k, (name, _) in enumerate(split) if name or is_filled[k].any()]
    read = _texts if as_texts else _values
    loaded = [read(frame[k], mark) for k in named]
    return TableFile([split[k] for k in named], loaded.__getitem__, facts)


def _opened(source: Path | str) -> TextIO:
    if isinstance(source, Path):
        return source.open(newline="", encoding="utf-8-sig")
    return io.StringIO(source, newline="")


def _cells(
    source: Path | str, count: int, only: int | None = None, *, as_texts: bool = False
) -> pd.DataFrame:
    """All columns below the heading, or this one; one more has what rows have beyond the heading."""
    import pandas as pd

    with _opened(source) as file:
        mark = _separator(file)
        next(csv.reader(iter(file.readline, ""), delimiter=mark, skipinitialspace=True))
        if as_texts:  # None where a row has no cell
            cells = csv.reader(file, delimiter=mark, skipinitialspace=True)
            columns = dict(enumerate(zip_longest(*filter(None, cells))))
            return pd.DataFrame(columns, dtype=object).reindex(columns=range(count + 1))
        try:
            names = range(count + 1) if only is None else range(count)
            return pd.read_csv(
                file, sep=mark, decimal="." if mark == "," else ",", header=None, names=names,
                usecols=None if only is None else [only], skipinitialspace=True,
                keep_default_na=False, na_values=NOTHING, low_memory=False, index_col=False,
            )  # fmt: skip
        except pd.errors.EmptyDataError:
            return pd.DataFrame({k: [] for k in range(count + 1)}, dtype=float)


def _values(column: pd.Series, mark: str) -> Values:
    """The cells of a column in their own type; where commas do not separate, they may be points."""
    if mark != "," and column.dtype.kind == "O":
        texts = _texts(column, mark)
        numbers = [number_of(x) for x in texts]
        if all(is_empty(x) or not math.isnan(number) for x, number in zip(texts, numbers)):
            return np.array(numbers)
        return texts
    return column.to_numpy()


def _texts(column: pd.Series, mark: str) -> Values:
    """The cells of a column as they are; decimal commas are points where commas do not separate."""
    if mark == ",":
        return column.to_numpy()
    pointed = column.map(lambda x: DECIMAL.sub(r"\1.\2", x) if isinstance(x, str) else x)
    return pointed.to_numpy()


def read_text(text: str, label: str) -> TableFile:
    """The table of a text of cells with a heading; raises ValueError for what is none."""
    return _read_text(text, label, {})


def _read_parquet(path: Path, facts: Mapping[str, Any]) -> TableFile:
    """A Parquet file, of which columns are read when they are asked for if it is large."""
    import pandas as pd

    if path.stat().st_size <= LARGE:
        return of_frame(pd.read_parquet(path), str(path), facts)
    from pyarrow.parquet import read_schema  # type: ignore[import-untyped]

    headings = read_schema(path).names

    def load(k: int) -> Values:
        return _seconds(pd.read_parquet(path, columns=[headings[k]]).iloc[:, 0]).to_numpy()

    split = split_headings(headings, facts.get("units", {}), str(path))
    return TableFile(split, load, facts, is_large=True)


def of_columns(columns: pd.DataFrame | Mapping[str, ArrayLike], label: str) -> TableFile:
    """The table of a pandas frame or of columns by heading; raises SetupError if these have several lengths."""
    if not isinstance(columns, Mapping):
        return of_frame(columns, label, {})
    loaded = [np.asarray(values) for values in columns.values()]
    if len({values.shape for values in loaded}) > 1:
        counts = ", ".join(f"{heading} {len(x)}" for heading, x in zip(columns, loaded))
        raise SetupError(f"{label}: its columns must have as many rows each, not {counts}")
    return TableFile(split_headings([*columns], {}, label), loaded.__getitem__, {})


def of_frame(frame: pd.DataFrame, label: str, facts: Mapping[str, Any]) -> TableFile:
    """The table of a pandas frame; an index with a name is a column, too."""
    if frame.index.name is not None:
        frame = frame.reset_index()
    headings = [str(heading) for heading in frame.columns]
    loaded = [_seconds(frame.iloc[:, k]).to_numpy() for k in range(len(headings))]
    split = split_headings(headings, facts.get("units", {}), label)
    return TableFile(split, loaded.__getitem__, facts)


def _seconds(column: pd.Series) -> pd.Series:
    """A column, of which durations are in seconds, and dates in seconds from the first."""
    if column.dtype.kind == "M":
        column = column - column.iloc[0] if len(column) else column
    return column.dt.total_seconds() if column.dtype.kind == "m" else column


def _read_modelica(path: Path, facts: Mapping[str, Any]) -> TableFile:
    """A result of Dymola or OpenModelica, a .mat file of version 1.1.

    Names are columns of characters; `dataInfo` gives for each the matrix, and the row in it with its sign.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, chars_as_strings=False)
    except MatReadError as error:
        raise ValueError(str(error)) from error
    if not {"name", "dataInfo", "data_2"} <= content.keys():
        raise ValueError("it is not a result of a Modelica tool")
    texts = {
        key: ["".join(map(str, letters)).replace("\0", " ").strip() for letters in content[key].T]
        for key in ("name", "description")
        if key in content
    }
    info, rows = content["dataInfo"], content["data_2"].shape[1]
    values: list[Values] = []
    headings: list[tuple[str, str]] = []
    for k, name in enumerate(texts["name"]):
        matrix, row = max(int(info[0, k]), VARYING) if k == 0 else int(info[0, k]), int(info[1, k])
        column = content[f"data_{matrix}"][abs(row) - 1] * (1.0 if row > 0 else -1.0)
        values.append(np.asarray(column if matrix == VARYING else np.full(rows, column[0]), float))
        match = (
            re.search(r"\[([^\]|:]*)", texts["description"][k]) if "description" in texts else None
        )
        headings.append((name, match[1].strip() if match else ""))
    return TableFile(headings, values.__getitem__, facts)
