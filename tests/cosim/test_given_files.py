"""Files that a user gives: read by one set of rules, and never written over."""

from __future__ import annotations

import hashlib
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

from cosim import Series, SetupError
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack

TIMES = ["--stop", "0.1", "--step", "0.05"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with files of every kind that commands read."""
    monkeypatch.chdir(tmp_path)
    pack(Path("A.fmu"))
    Path("in.csv").write_text("time,u\n0,0\n1,2\n", encoding="utf-8")
    Path("in.json").write_text('{"units": {"u": ""}}', encoding="utf-8")
    Path("par.csv").write_text("name,value\nA.a,-2\n", encoding="utf-8")
    Path("cases.csv").write_text("A.a\n-1\n-2\n", encoding="utf-8")
    Path("keep.json").write_text('{"mine": 1}', encoding="utf-8")
    Path("r.partial.csv").write_text("time,u\n0,0\n1,2\n", encoding="utf-8")
    os.link("in.csv", "hard.csv")
    Path("soft.csv").symlink_to("in.csv")
    return tmp_path


@pytest.mark.parametrize(
    ("kept", "arguments"),
    [
        ("in.csv", "run A.fmu --input in.csv --map A.u=u --out in.csv"),
        ("in.csv", "run A.fmu --input in.csv --map A.u=u --out hard.csv"),
        ("in.csv", "run A.fmu --input in.csv --map A.u=u --out soft.csv"),
        ("in.csv", "run A.fmu --input in.csv --map A.u=u --out ./x/../in.csv"),
        ("in.json", "run A.fmu --input in.csv --map A.u=u --out in.parquet.csv --plot in.json"),
        ("r.partial.csv", "run A.fmu --input r.partial.csv --map A.u=u --out r.csv"),
        ("par.csv", "run A.fmu --parameters par.csv --out par.csv"),
        ("cases.csv", "sweep A.fmu --table cases.csv --figure last:A.y --jobs 1 --out cases.csv"),
        ("A.fmu", "export A.fmu --to ssp --out A.fmu"),
        ("A.fmu", "export part=A.fmu --to ssp --out A.fmu"),
        ("keep.json", "run A.fmu --out keep.csv"),
        ("in.json", "referee A.fmu --result in.csv --out in.json"),
        ("in.csv", "compare in.csv par.csv --plot in.csv"),
        ("A.fmu", "crosscheck A.fmu --out A.fmu"),
    ],
)
def test_no_output_takes_the_place_of_an_input(
    kept: str, arguments: str, folder: Path, command_output: CommandOutput
) -> None:
    Path("x").mkdir()
    before = hashlib.sha256(Path(kept).read_bytes()).digest()
    words = arguments.split()
    times = [] if words[0] in ("export", "compare", "crosscheck") else TIMES
    error = command_output(*words, *times, code=2)
    assert "would be overwritten" in error
    assert hashlib.sha256(Path(kept).read_bytes()).digest() == before


def test_a_part_of_a_folder_is_an_input_too(folder: Path, command_output: CommandOutput) -> None:
    command_output("export", "A.fmu", "--to", "osp", "--out", "osp", "--step", "0.1")
    error = command_output("export", "osp", "--to", "ssp", "--out", "osp/A.fmu", code=2)
    assert "osp/A.fmu is read" in error


def test_a_result_may_be_written_again(folder: Path, command_output: CommandOutput) -> None:
    command_output("export", "A.fmu", "--to", "osp", "--out", "osp", "--step", "0.1")
    os.chdir("osp")
    for source in ("../A.fmu", "../A.fmu", ".", "."):
        command_output("run", source, *TIMES, "--out", "../r.csv")


@pytest.mark.parametrize(
    ("heading", "seconds", "unit"),
    [
        ("t_ms", 1.0, "ms"), ("time_ms", 1.0, "ms"), ("time in ms", 1.0, "ms"), ("time_min", 60000.0, "min"),
        ("t", 1000.0, ""), ("Zeit_us", 1e-3, "us"),
    ],
)  # fmt: skip
def test_a_name_may_end_with_its_unit(
    heading: str, seconds: float, unit: str, tmp_path: Path
) -> None:
    """A thousand of it."""
    path = tmp_path / "a.csv"
    path.write_text(
        f"{heading},w_rpm,x_min,speed in deg/s\n0,0,0,0\n1000,30,1,180\n", encoding="utf-8"
    )
    table = Series.read(path)
    assert table.names == [heading, "w_rpm", "x_min", "speed in deg/s"]
    assert table.t[-1] == pytest.approx(seconds, rel=1e-12)
    assert list(table.units.values()) == [unit, "rpm", "", "deg/s"]


def test_points_of_thousands_are_not_decimal(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t;x;y\n0;1.000;0,05\n1;7.000;0,06\n", encoding="utf-8")
    with pytest.raises(SetupError, match=r"'1\.000' beside decimal commas may be 1000 or 1,000"):
        Series.read(path)
    path.write_text("t;x;y\n0;1.000;0.05\n1;7.000;0.06\n", encoding="utf-8")
    assert Series.read(path).numbers("x").tolist() == [1.0, 7.0]


@pytest.mark.parametrize(
    "head", ["# logger 7\ntime,u\n", "# one\n# two\ntime,u\n", "time,u\n", "# time,u\n"]
)
def test_comments_stand_above_a_heading(head: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{head}0,1\n1,2\n", encoding="utf-8")
    assert Series.read(path).numbers("u").tolist() == [1.0, 2.0]


def test_columns_that_are_named_like_inputs_drive_them(
    folder: Path, command_output: CommandOutput
) -> None:
    command_output("run", "A.fmu", *TIMES, "--input", "in.csv", "--out", "bare.csv")
    Path("dotted.csv").write_text("time,A.u\n0,0\n1,2\n", encoding="utf-8")
    command_output("run", "A.fmu", *TIMES, "--input", "dotted.csv", "--out", "b.CSV")
    mapped = ["--input", "in.csv", "--map", "A.u=u"]
    command_output("run", "A.fmu", *TIMES, *mapped, "--out", "c.csv")
    assert Path("bare.csv").read_bytes() == Path("b.CSV").read_bytes() == Path("c.csv").read_bytes()
    error = command_output("run", "A.fmu", *TIMES, "--input", "par.csv", code=2)
    assert "no column of par.csv has the name of an input: give --map NAME=COLUMN" in error


def test_a_map_may_leave_a_unit_aside(folder: Path, command_output: CommandOutput) -> None:
    """The FMU states no unit, the heading does."""
    Path("q.csv").write_text("time,q [l/min]\n0,3\n1,3\n", encoding="utf-8")
    error = command_output("run", "A.fmu", *TIMES, "--input", "q.csv", "--map", "A.u=q", code=2)
    assert "A.u=>COLUMN" in error
    command_output("run", "A.fmu", *TIMES, "--input", "q.csv", "--map", "A.u=>q", "--out", "r.csv")
    command_output("run", "A.fmu", *TIMES, "--set", "A.u=3", "--out", "s.csv")
    assert Path("r.csv").read_bytes() == Path("s.csv").read_bytes()


@pytest.mark.parametrize("cell", ["n/a", "", "nan", "=1+1", "inf", "True"])
def test_a_cell_that_is_no_number_fails_its_own_run(
    cell: str, folder: Path, command_output: CommandOutput
) -> None:
    Path("c.csv").write_text(f"A.a,A.boolean_in\n-1,True\n\n{cell},0\n-3,false\n", encoding="utf-8")
    asked = ["--table", "c.csv", "--figure", "last:A.y", "--jobs", "1", "--out", "o.csv"]
    command_output("sweep", "A.fmu", *TIMES, *asked)
    table = Series.read("o.csv")
    figures = table.numbers("last:A.y", gaps=True)
    assert np.isnan(figures).tolist() == [False, True, False]
    assert "A.a" in table["reason"][1]


def test_a_not_a_number_of_a_file_is_no_start(
    tmp_path: Path, command_output: CommandOutput
) -> None:
    from tests.conftest import described, rewritten

    fmu = rewritten(
        pack(tmp_path / "A0.fmu"), tmp_path / "A.fmu", described(('start="0.0"', 'start="NaN"'))
    )
    assert "start NaN of u must be a number" in command_output("run", fmu, *TIMES, code=2)


@pytest.mark.parametrize(
    "option", ["--timeout", "--stop", "--step", "--fmu-tolerance", "--adaptive"]
)
def test_no_option_is_not_a_number(
    option: str, folder: Path, command_output: CommandOutput
) -> None:
    said = command_output("run", "A.fmu", option, "nan", code=2)
    assert option in said and ": 'nan' is not a number" in said


def test_names_with_commas_are_recorded(folder: Path, command_output: CommandOutput) -> None:
    from tests.conftest import described, rewritten

    fmu = rewritten(Path("A.fmu"), Path("B.fmu"), described(('name="y"', 'name="y,of x,1"')))
    command_output("run", fmu, *TIMES, "--record", "B.u,B.y,of x,1,B.z", "--out", "r.csv")
    facts = json.loads(Path("r.json").read_text(encoding="utf-8"))
    assert list(facts["units"]) == ["time", "B.u", "B.y,of x,1", "B.z"]
    assert math.isfinite(Series.read("r.csv").t[-1])
