"""Tables of other programs are read rightly or refused in one line: inputs, records, foreign results, comparisons."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cosim import SetupError, compare, measured
from cosim.accuracy.referee.table import read_foreign
from cosim.cli.main import main
from cosim.series import Kind, Series


def _written(folder: Path, text: str, beside: str | None = None) -> Path:
    path = folder / "a.csv"
    path.write_text(text, encoding="utf-8")
    if beside is not None:
        path.with_suffix(".json").write_text(beside)
    return path


#: Headings, and the names and units of the columns.
HEADINGS: dict[str, list[tuple[str, str]]] = {
    'time,"speed\nset",a,b': [("time", ""), ("speed\nset", ""), ("a", ""), ("b", "")],
    '"time\n(s)",x,a,b': [("time", "s"), ("x", ""), ("a", ""), ("b", "")],
    "time (ms),n (rpm),a/b,c": [("time", "ms"), ("n", "rpm"), ("a/b", ""), ("c", "")],
    "t/ms,n/rpm,v / m,w [rad/s]": [("t", "ms"), ("n", "rpm"), ("v", "m"), ("w", "rad/s")],
    "time,x[1],x[2] [m],tau [3 real output]": [("time", ""), ("x[1]", ""), ("x[2]", "m"), ("tau", "")],
    "time,n (set),n (actual),b (2nd run)": [
        ("time", ""), ("n (set)", ""), ("n (actual)", ""), ("b (2nd run)", ""),
    ],
    "\ufefftime , a,b,c": [("time", ""), ("a", ""), ("b", ""), ("c", "")],
}  # fmt: skip


@pytest.mark.parametrize("heading", HEADINGS)
def test_a_heading_is_a_name_and_a_unit_and_moves_no_column(heading: str, tmp_path: Path) -> None:
    """A line break in one of them shifted all that follow: `b` was read from the column before."""
    series = Series.read(_written(tmp_path, f"{heading}\n0,1,2,3\n1,4,5,6.5\n"))
    assert [(c.name, c.unit) for c in series.columns] == HEADINGS[heading]
    assert [series[name].tolist() for name in series.names] == [[0, 1], [1, 4], [2, 5], [3, 6.5]]


def test_every_reader_understands_the_same_headings(tmp_path: Path) -> None:
    """ "time (ms)" was 1000 s for 1 s, and 30 rpm in "n (rpm)" were 30 rad/s."""
    path = _written(tmp_path, "time (ms),n (rpm)\n0,30\n500,60\n1000,90\n")
    table = Series.read(path, "n")
    (record,) = measured(path, {"w": "n"}, time="time").values()
    foreign, _ = read_foreign(path)
    for series in (table, record, foreign):
        assert series.t.tolist() == [0.0, 0.5, 1.0]
        assert (series.numbers().tolist(), series.signal.unit) == ([30.0, 60.0, 90.0], "rpm")
    plain = pd.DataFrame({"t [s]": [0.0, 0.5, 1.0], "n [rad/s]": np.pi * np.array([1.0, 2.0, 3.0])})
    assert compare(plain, path, value=1e-9).passed


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("t;x\n0;1,5\n0,5;-2,5e1\n1;3\n\n", [1.5, -25.0, 3.0]),
        ("t\tx\n0\t1,5\n0,5\t-25\n1\t3.25\n", [1.5, -25.0, 3.25]),
        ("sep=;\nt;x\n0;1\n0,5;2\n1;3\n", [1.0, 2.0, 3.0]),
        ("t,x,\n0,1,\n0.5,2,\n1,3,\n", [1.0, 2.0, 3.0]),
        ("t , x \n0 , 1 \n0.5, 2\n1, 3\n", [1.0, 2.0, 3.0]),
        ("t,x\n0,1\n0.5,2\n1,3\n,\n , \n", [1.0, 2.0, 3.0]),
    ],
)
def test_decimal_commas_stated_separators_and_blanks_are_read(
    text: str, values: list[float], tmp_path: Path
) -> None:
    series = Series.read(_written(tmp_path, text))
    assert (series.names, series.t.tolist()) == (["t", "x"], [0.0, 0.5, 1.0])
    assert series.numbers("x").tolist() == values


#: What is refused, and the reason.
REFUSED: dict[str, tuple[str, str]] = {
    "text": ("t,x\n0,1\n1,jam\n", "a.csv, row 3, column x: 'jam' is not a number"),
    "number of Python": ("t,x\n0,1\n1,1_0\n", "row 3, column x: '1_0' is not a number"),
    "Arabic digits": ("t,x\n0,1\n1,\u0663\n", "row 3, column x: '\u0663' is not a number"),
    "empty": ("t,x\n0,1\n1,\n", "row 3, column x: 'nan' is not a finite number"),
    "more cells": ("t,x\n0,1\n1,2,3\n", "row 3 has more cells than the heading"),
    "two of a name": ("t,x [m],x [mm]\n0,1,2\n", "has two columns named 'x'"),
    "unit of time": ("time (m),x\n0,1\n", "time [m] cannot be converted to s"),
    "nothing": ("", "it is empty"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_table_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    text, reason = REFUSED[case]
    path = _written(tmp_path, text)
    readers: list[Callable[[], Any]] = [
        lambda: (Series.read(path, "x").t, Series.read(path, "x").numbers()),
        lambda: compare(path, path),
    ]
    for read in readers:
        with pytest.raises(SetupError) as refused:
            read()
        assert reason in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("beside", "reason"),
    [
        ('{"units": null}', "'units' must be texts by the names of columns"),
        ('{"units": {"x": ["m"]}}', "'units' must be texts by the names of columns"),
        ('{"kinds": {"x": "foo"}}', "x is 'foo', which is not a kind of column"),
        ('{"breaks": [0, 1]}', "'breaks' must be a list of pairs"),
        ("[" * 100_000, "cannot be read: too many brackets"),
        ("{", "cannot be read"),
        ("[]", ""),
        ('"text"', ""),
        ('{"time": ["s"]}', ""),
    ],
)
def test_json_of_any_shape_beside_a_table_is_no_traceback(
    beside: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = _written(tmp_path, "time,x\n0,1\n1,2\n2,3\n", beside)
    assert main(["compare", str(path), str(path)]) == (2 if reason else 0)
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == bool(reason)


def test_times_of_parquet_are_seconds(tmp_path: Path) -> None:
    """Dates and durations were nanoseconds: 1 s was 1e9 s."""
    when = pd.to_datetime(1_700_000_000_000 + np.array([0, 500, 1500]), unit="ms")
    for name, column in (("date", when), ("duration", when - when[0])):
        path = tmp_path / f"{name}.parquet"
        pd.DataFrame({"time": column, "x": [1.0, 2.0, 3.0]}).to_parquet(path)
        assert read_foreign(path)[0].t.tolist() == [0.0, 0.5, 1.5]
        pd.DataFrame({"x": [1.0, 2.0, 3.0]}, index=pd.Index(column, name="time")).to_parquet(path)
        assert Series.read(path).t.tolist() == [0.0, 0.5, 1.5]


def test_every_column_keeps_its_type(tmp_path: Path) -> None:
    """A double does not hold 2^53 + 1; whole numbers of a text are no counts unless that is stated."""
    text = "time,n,big,on,word\n0,1,9007199254740993,true,go\n1,2,18446744073709551615,false,\n"
    beside = '{"units": {"n": "1"}, "kinds": {"n": "integer"}, "breaks": [[0, 1]]}'
    series = Series.read(_written(tmp_path, text, beside))
    assert series["big"].tolist() == [2**53 + 1, 2**64 - 1]
    kinds = [Kind.CONTINUOUS, Kind.INTEGER, Kind.CONTINUOUS, Kind.BOOLEAN, Kind.TEXT]
    assert [c.kind for c in series.columns] == kinds
    assert series.breaks.tolist() == [[0.0, 1.0]] and list(series.pieces()) == []


def test_a_mapping_names_scales_and_gives_units(tmp_path: Path) -> None:
    path = _written(tmp_path, "t [ms],n (rpm)\n0,1\n1000,2\n")
    series = Series.read(path, {"motor.w": "n * 2 + 1", "motor.v": "n:deg/s"})
    assert (series.names, series.t.tolist()) == (["time", "motor.w", "motor.v"], [0.0, 1.0])
    assert series["motor.w"].tolist() == [3.0, 5.0]
    assert series.units == {"time": "s", "motor.w": "rpm", "motor.v": "deg/s"}


def test_pieces_have_no_equal_times_and_no_breaks(tmp_path: Path) -> None:
    text = "time,x\n0,0\n1,1\n1,5\n2,6\n3,7\n4,1\n5,2\n6,3\n"
    series = Series.read(_written(tmp_path, text, '{"breaks": [[1, 1], [3, 4.5]]}'))
    assert [piece.t.tolist() for piece in series.pieces()] == [[0, 1], [1, 2, 3], [5, 6]]
    assert [piece["x"].tolist() for piece in series.pieces()] == [[0, 1], [5, 6, 7], [2, 3]]


@pytest.mark.parametrize(
    ("heading", "reason"),
    [
        ("name,value,Unit", "has a column 'Unit': 'unit' must be spelt so"),
        ("name,value,units", "has a column 'units': 'unit' must be spelt so"),
        ("name,value,einheit", "has a column 'einheit': 'unit' must be spelt so"),
        ("name,value,value", "has two columns named 'value'"),
        ("name,value,unit ", ""),
        ("name,value,unit,note", ""),
    ],
)
def test_a_misspelt_column_of_units_is_not_ignored(
    heading: str, reason: str, fmus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """30 rpm were 30 rad/s."""
    path = _written(tmp_path, f"{heading}\nw,30,rpm\n")
    code = main(["info", str(fmus / "DriveMotor.fmu"), "--parameters", str(path)])
    captured = capsys.readouterr()
    assert code == (2 if reason else 0) and reason in captured.err
    assert bool(reason) or "DriveMotor.w [rad/s] = 3.14" in captured.out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("m.T,m.A\n5ms,7000\n0.05\n", "row 3: there is no cell under m.A"),
        ("m.T,m.A\n5ms,7000,1\n", "row 2 has more cells than the heading"),
        ("m.T,m.T\n1,2\n", "has two columns named 'm.T'"),
        ("m.T\n", "has no row below its header"),
        ("", "it is empty"),
    ],
)
def test_cases_are_refused_as_other_tables_are(
    text: str, message: str, fmus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """But for empty cells, which fail the run of their row."""
    (tmp_path / "c.csv").write_text(text)
    options = ["--table", str(tmp_path / "c.csv"), "--figure", "last:m.tau"]
    assert main(["sweep", f"m={fmus / 'DriveMotor.fmu'}", *options]) == 2
    assert message in capsys.readouterr().err


def test_cells_are_texts_with_decimal_points(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text("# made by me\nT;A [N.m]\n5ms; 0,05 \n;7000\n\n")
    table = Series.read_cells(tmp_path / "c.csv")
    assert table.units == {"T": "", "A": "N.m"}
    assert [table[name].tolist() for name in table.names] == [["5ms", ""], ["0.05", "7000"]]
