"""A result that another master wrote: its times, its columns, and which variables they are.

Masters name their columns in their own ways: `model.root.motor.tau`, `motor::tau[REAL]`, `motor.tau [N.m]`
or `tau [3 real output]`. A column is a variable if their names, without such additions, are equal or if one ends
with the other; a name that fits two variables or two columns is left out.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SetupError
from ...result import Result
from ...system import Network, Port, conversion_to
from ...system.inputs import Reading, separator
from ...units import multiples

if TYPE_CHECKING:
    import pandas as pd

    Source = Result | pd.DataFrame | Path | str

Array = NDArray[np.float64]
HEADING = re.compile(r"\s*(?P<name>.*?)\s*(?:\[(?P<bracket>[^\[\]]*)\]|/ ?(?P<slash>[^\s/]+))?\s*")
#: An index as in A[2,1], which belongs to the name and is no unit. A convention of FMI.
INDEX = re.compile(r"[\d, ]+")
#: What masters write in brackets that is no unit: the type of a variable, or its reference and causality.
TYPE = re.compile(
    r"(\d+ )?(real|integer|boolean|string|int|bool|float64|float32|int32)\b.*", re.IGNORECASE
)
#: The number of the matrix of what varies with time, `data_2`: a convention of the Modelica tools' format 1.1.
VARYING = 2
#: Columns that count steps instead of measuring something. A convention of Ecos and of libcosim.
COUNTERS = ("iterations", "stepcount")
TIMES = ("time", "t", "zeit", "timestamp")
#: The first line with which some programs state their separator. A convention of spreadsheets.
SEPARATOR_LINE = re.compile(r'"?sep=(.)"?\s*')


@dataclass(frozen=True)
class ForeignTable:
    """A result of another master.

    Attributes
    ----------
    label : str
        What messages call it.
    time : array of shape (rows,)
        Times [s].
    columns : mapping of str to array of shape (rows,)
        Values by the names that the file gives them, without units.
    units : mapping of str to str
        The units that the file states; "" where it states none.
    """

    label: str
    time: Array
    columns: Mapping[str, Array]
    units: Mapping[str, str]


@dataclass(frozen=True)
class MatchedColumn:
    """A column of a table as a variable of a system.

    `values` are in the unit of the variable. `stated_unit` is what the file says, "" if it says nothing.
    """

    port: Port
    column: str
    stated_unit: str
    values: Array


def read_foreign(source: Source) -> ForeignTable:
    """Read what another master wrote.

    Parameters
    ----------
    source : Result, pandas frame or path
        A .csv file with any of the separators comma, semicolon or tab, a .parquet file, or a .mat file of
        Modelica tools. Units come from headings or from a JSON file beside it, as `Result.write` makes it.

    Raises
    ------
    SetupError
        If it cannot be read, has fewer than two rows, or has times that fall.
    """
    if isinstance(source, Result):
        return _table("the result", source.frame, source.units)
    if not isinstance(source, (str, Path)):
        return _table("the table", source, {})
    path = Path(source)
    units: dict[str, str] = {}
    try:
        if path.suffix == ".mat":
            return _read_modelica(path)
        frame = _read_frame(path)
        metadata = path.with_suffix(".json")
        if metadata.is_file():
            content = json.loads(metadata.read_text(encoding="utf-8"))
            units = content.get("units", {}) if isinstance(content, dict) else {}
    except (OSError, ValueError, TypeError, LookupError, NotImplementedError, ImportError) as error:
        raise SetupError(f"{path} cannot be read as a table: {_reason(error)}") from error
    return _table(str(path), frame, units)


def _reason(error: Exception) -> str:
    """Why a file cannot be read, without what only programmers know."""
    if isinstance(error, UnicodeDecodeError):
        return "it is no text in UTF-8"
    return (isinstance(error, OSError) and error.strerror) or str(error)


def _read_frame(path: Path) -> pd.DataFrame:
    import pandas as pd

    if path.suffix == ".parquet":
        return pd.read_parquet(path)
    with path.open(encoding="utf-8-sig") as file:
        stated = SEPARATOR_LINE.fullmatch(file.readline())
    mark = stated[1] if stated else separator(path)
    options: Any = {
        "skipinitialspace": True,
        "encoding": "utf-8-sig",
        "skiprows": int(bool(stated)),
    }
    frame: pd.DataFrame = pd.read_csv(
        path, sep=mark, decimal="." if mark == "," else ",", **options
    )
    return frame


def _read_modelica(path: Path) -> ForeignTable:
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
        raise ValueError("it is no result of a Modelica tool")
    texts = {
        key: ["".join(map(str, letters)).replace("\0", " ").strip() for letters in content[key].T]
        for key in ("name", "description")
        if key in content
    }
    info, rows = content["dataInfo"], content["data_2"].shape[1]
    values: dict[str, Array] = {}
    units: dict[str, str] = {}
    for k, name in enumerate(texts["name"]):
        matrix, row = max(int(info[0, k]), VARYING) if k == 0 else int(info[0, k]), int(info[1, k])
        column = content[f"data_{matrix}"][abs(row) - 1] * (1.0 if row > 0 else -1.0)
        values[name] = np.asarray(column if matrix == VARYING else np.full(rows, column[0]), float)
        match = (
            re.search(r"\[([^\]|:]*)", texts["description"][k]) if "description" in texts else None
        )
        units[name] = match[1].strip() if match else ""
    first = texts["name"][0]
    time = values.pop(first)
    return _checked(ForeignTable(str(path), time, values, units))


def _table(label: str, frame: pd.DataFrame, units: Mapping[str, str]) -> ForeignTable:
    import pandas as pd

    columns: dict[str, Array] = {}
    stated_units: dict[str, str] = {}
    headings = [str(heading) for heading in frame.columns]
    clocks = [k for k, heading in enumerate(headings) if _split(heading)[0].lower() in TIMES]
    clock = clocks[0] if clocks else 0
    for k, heading in enumerate(headings):
        name, unit = (heading, units[heading]) if heading in units else _split(heading)
        values = np.asarray(pd.to_numeric(frame.iloc[:, k], errors="coerce"), float)
        if k != clock and name.lower() in COUNTERS:
            continue
        if name in columns:
            raise SetupError(f"{label} has two columns named {name!r}")
        columns[name], stated_units[name] = values, unit
    if not headings:
        raise SetupError(f"{label} has no columns")
    name = headings[clock] if headings[clock] in columns else _split(headings[clock])[0]
    scale = multiples("s").get(stated_units[name] or "s")
    if scale is None:
        raise SetupError(
            f"{label}: the time must be in a unit of time, not in {stated_units[name]}"
        )
    table = ForeignTable(label, scale * columns.pop(name), columns, stated_units)
    if clocks:
        return _checked(table)
    try:
        return _checked(table)
    except SetupError as error:
        reason = f"no column is called time, so that the first, {name}, is taken for it"
        raise SetupError(f"{error}; {reason}") from error


def _checked(table: ForeignTable) -> ForeignTable:
    """The table without rows that have no time; of rows with the same time, the last one counts."""
    finite = np.isfinite(table.time)
    time = table.time[finite]
    if (falls := np.flatnonzero(np.diff(time) < 0.0)).size:
        before, after = time[falls[0] :][:2].tolist()
        raise SetupError(f"{table.label}: time {after!r} s after {before!r} s must not fall")
    last = np.append(np.diff(time) > 0.0, True)
    if np.count_nonzero(last) <= 1 or not table.columns:
        raise SetupError(f"{table.label} needs two rows with a time and values")
    columns = {name: values[finite][last] for name, values in table.columns.items()}
    return ForeignTable(table.label, time[last], columns, table.units)


def _split(heading: str) -> tuple[str, str]:
    """A heading as name and unit; what is in its brackets may also be an index or a type."""
    match = HEADING.fullmatch(heading)
    if match is None or match["name"] == "":
        return heading.strip(), ""
    bracket = match["bracket"]
    if bracket is not None and INDEX.fullmatch(bracket):
        return heading.strip(), ""
    if bracket is not None and TYPE.fullmatch(bracket):
        return match["name"], ""
    if bracket is None and match["slash"] is not None and " " not in heading:
        return heading.strip(), ""
    return match["name"], (bracket if bracket is not None else match["slash"]) or ""


def match_columns(
    table: ForeignTable, network: Network, ports: Sequence[Port], columns: Mapping[str, str]
) -> list[MatchedColumn]:
    """The columns of a table as variables of a system.

    Parameters
    ----------
    table : ForeignTable
        The result of another master.
    network : Network
        The system, whose FMUs define units.
    ports : sequence of Port
        The variables that can be judged.
    columns : mapping of str to str
        Variables whose column is stated: "motor.tau": "M * 0.73:N.m", with a factor, an offset and a unit
        where needed.

    Raises
    ------
    SetupError
        For a variable or a column that does not exist, and for a unit that cannot be converted.
    """
    by_name = {port.name: port for port in ports}
    names = list(table.columns)
    matches: list[MatchedColumn] = []
    for variable, text in columns.items():
        port = network.port(variable)
        if port.name not in by_name:
            raise SetupError(f"{port} cannot be judged: it must be a numeric output")
        reading = Reading.read(text, names, table.label)
        values = reading.factor * table.columns[reading.name] + reading.offset
        unit = table.units.get(reading.name, "") if reading.unit is None else reading.unit
        matches.append(_matched(network, port, reading.name, unit, values))
    taken = {match.port.name for match in matches}
    used = {match.column for match in matches}
    for port, column in _pairs(
        [port for port in ports if port.name not in taken],
        [name for name in names if name not in used],
        Path(table.label).stem,
    ):
        values, unit = table.columns[column], table.units.get(column, "")
        matches.append(_matched(network, port, column, unit, values))
    order = list(by_name)
    return sorted(matches, key=lambda match: order.index(match.port.name))


def _matched(network: Network, port: Port, column: str, unit: str, values: Array) -> MatchedColumn:
    factor, offset = (
        (1.0, 0.0) if port.type != "Real" else conversion_to(network, port, unit, "be judged")
    )
    return MatchedColumn(port, column, unit, factor * values + offset)


def _pairs(ports: Sequence[Port], columns: Sequence[str], stem: str) -> list[tuple[Port, str]]:
    """Variables and columns whose names agree, from the strictest rule to the loosest."""
    rules = (
        lambda port, column: column == port.name,
        lambda port, column: _ends_with(_path(column), _path(port.name)),
        lambda port, column: _ends_with(_flat(column), _flat(port.name)),
        lambda port, column: (
            _path(column) == _path(port.variable.name) and stem.startswith(port.part)
        ),
        lambda port, column: _path(column) == _path(port.variable.name),
    )
    pairs: list[tuple[Port, str]] = []
    free_ports, free_columns = list(ports), list(columns)
    for agrees in rules:
        by_column: dict[str, list[Port]] = defaultdict(list)
        by_port: dict[str, list[str]] = defaultdict(list)
        for port in free_ports:
            for column in free_columns:
                if agrees(port, column):
                    by_column[column].append(port)
                    by_port[port.name].append(column)
        for column, candidates in by_column.items():
            if len(candidates) == 1 and len(by_port[candidates[0].name]) == 1:
                pairs.append((candidates[0], column))
        taken = {port.name for port, _ in pairs}
        used = {column for _, column in pairs}
        free_ports = [port for port in free_ports if port.name not in taken]
        free_columns = [column for column in free_columns if column not in used]
    return pairs


def _path(name: str) -> list[str]:
    """A name as its pieces, whatever separates them."""
    return re.split(r"::|[.:/|]", name.strip())


def _flat(name: str) -> list[str]:
    """A name as its words, for masters that replace every dot by an underscore."""
    return [word for word in re.split(r"[^A-Za-z0-9]+", name) if word]


def _ends_with(longer: Sequence[str], shorter: Sequence[str]) -> bool:
    """Whether a name ends with the pieces of another one."""
    return len(longer) >= len(shorter) and list(longer[-len(shorter) :]) == list(shorter)
