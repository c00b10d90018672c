"""The connectors of a system's own: set, recorded, driven, given in files, and written again."""

from __future__ import annotations

from pathlib import Path
from zipfile import ZipFile

import pytest

from cosim import Series, System, Wire, read_ssp, run, write_ssp
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack

TIMES = ["--stop", "1", "--step", "0.5"]


@pytest.fixture
def system(tmp_path: Path) -> System:
    """One input as it is, one that is doubled and goes to two parts, a parameter, an output."""
    parts = {"A": pack(tmp_path / "A.fmu"), "B": pack(tmp_path / "B.fmu")}
    both = [Wire("both", f"{part}.d", 2.0, 1.0, converts=False) for part in parts]
    return System(
        parts,
        connectors={
            "in": [Wire("in", "A.u", converts=False)],
            "both": both,
            "K": [Wire("K", "A.a", converts=False)],
            "out": [Wire("A.z", "out", converts=False)],
        },
    )


@pytest.fixture
def package(system: System, tmp_path: Path) -> Path:
    write_ssp(system, tmp_path / "s.ssp", stop=1.0, step=0.5)
    return tmp_path / "s.ssp"


def test_they_survive_reading_and_writing(system: System, package: Path, tmp_path: Path) -> None:
    for k in range(2):
        read = read_ssp(package, tmp_path / f"unpacked{k}")
        assert {n: tuple(w) for n, w in read.system.connectors.items()} == {
            n: tuple(w) for n, w in system.connectors.items()
        }
        assert read.connectors == {"in": "A.u", "K": "A.a", "out": "A.z"}
        package = tmp_path / f"again{k}.ssp"
        write_ssp(read.system, package, stop=1.0, step=0.5)


def test_each_option_takes_them(
    package: Path, tmp_path: Path, command_output: CommandOutput, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same rows as by the names of the variables, to the byte."""
    monkeypatch.chdir(tmp_path)
    Path("u.csv").write_text("time,x,in,A.u\n0,1,1,1\n1,3,3,3\n", encoding="utf-8")
    Path("a.csv").write_text("time,A.u\n0,1\n1,3\n", encoding="utf-8")
    Path("c.csv").write_text("time,in\n0,1\n1,3\n", encoding="utf-8")
    Path("K.csv").write_text("name,value\nK,-3\nin,4\n", encoding="utf-8")
    Path("V.csv").write_text("name,value\nA.a,-3\nA.u,4\n", encoding="utf-8")
    pairs = [
        ("--set in=5 --set K=-2", "--set A.u=5 --set A.a=-2"),
        ("--set both=0.25", "--set A.d=1.5 --set B.d=1.5"),
        ("--at", "--at"),
        ("--input u.csv --map in=x", "--input u.csv --map A.u=x"),
        ("--input c.csv", "--input a.csv"),
        ("--parameters K.csv", "--parameters V.csv"),
    ]
    for outer, inner in pairs:
        changes = (["0.5 in=7"], ["0.5 A.u=7"]) if outer == "--at" else ([], [])
        for name, words, change in zip(("o", "i"), (outer, inner), changes):
            command_output("run", package, *words.split(), *change, "--out", f"{name}.csv")
        assert Path("o.csv").read_bytes() == Path("i.csv").read_bytes(), outer
    command_output("run", package, "--set", "in=5", "--record", "out,B.z", "--out", "r.csv")
    assert Series.read("r.csv").names == ["time", "out", "B.z"]
    command_output("run", package, "--set", "in=5", "--out", "all.csv")
    assert Series.read("r.csv")["out"].tolist() == Series.read("all.csv")["A.z"].tolist()


def test_one_that_is_no_variable_as_it_is_is_told(
    package: Path, command_output: CommandOutput
) -> None:
    error = command_output("run", package, "--record", "both", code=2)
    assert "both is no variable as it is, but both * 2.0 + 1.0 => A.d" in error
    assert "connector both: both * 2.0 + 1.0 => A.d" in command_output("info", package)


def test_they_drive_in_python_too(system: System) -> None:
    given = System(system.parts, start={"in": 5.0}, connectors=system.connectors)
    result = run(given, stop=1.0, step=0.5, record=["out"])
    plain = run(System(system.parts, start={"A.u": 5.0}), stop=1.0, step=0.5, record=["A.z"])
    assert result["out"].tolist() == plain["A.z"].tolist()


def test_what_cannot_have_them_says_so(
    package: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, command_output: CommandOutput
) -> None:
    command_output("export", package, "--out", tmp_path / "osp", "--step", "0.5")
    assert "the connectors in, both, K, out of the system are left out" in caplog.text


def test_a_second_structure_is_named(
    package: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, command_output: CommandOutput
) -> None:
    with ZipFile(package, "a") as archive:
        archive.writestr("VariantB.ssd", archive.read("SystemStructure.ssd"))
    command_output("info", package)
    assert "the package has VariantB.ssd, too: unpack it to run that" in caplog.text
