"""Files that are read and written: nothing through links, no old facts beside new rows, no endless ones."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cosim import SetupError, System, Wire, run, write_osp
from cosim.engine.recorder import Stream
from cosim.files import replacement
from cosim.series import Reading
from cosim.system.inputs import parse_change
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack

SETTINGS: dict[str, Any] = {"stop": 0.3, "step": 0.1, "record": ["A.y"]}
MANY = " " * 300_000


@pytest.fixture
def system(tmp_path: Path) -> System:
    return System({"A": pack(tmp_path / "A.fmu")})


@pytest.mark.parametrize("name", ["r.json", "r.partial.json", "r.partial.csv"])
def test_a_folder_at_a_name_of_a_result_is_refused_before_the_run(
    name: str, system: System, tmp_path: Path, command_output: CommandOutput
) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(SetupError, match="is a folder, and a file of the result needs the name"):
        run(system, csv=tmp_path / "r.csv", **SETTINGS)
    arguments = ("run", system.parts["A"], "--stop", 1, "--step", 0.1, "--out", tmp_path / "r.csv")
    assert "is a folder" in command_output(*arguments, code=2)


def test_rows_whose_json_cannot_be_written_do_not_stand_beside_that_of_another_run(
    system: System, tmp_path: Path
) -> None:
    """The folder comes while the run goes on: it is an error, and the rows are kept."""
    out = tmp_path / "r.csv"
    run(system, csv=out, **SETTINGS)
    old = out.read_bytes(), out.with_suffix(".json").read_bytes()

    def progress(share: float) -> None:
        if share == 1.0:
            out.with_suffix(".json").unlink()
            out.with_suffix(".json").mkdir()

    with pytest.raises(OSError, match=r"the rows are in r\.partial\.csv"):
        run(system, csv=out, progress=progress, **(SETTINGS | {"step": 0.05}))
    assert out.read_bytes() == old[0]
    assert len((tmp_path / "r.partial.csv").read_text().splitlines()) == 8
    assert json.loads((tmp_path / "r.partial.json").read_text())["status"] == "complete"
    out.with_suffix(".json").rmdir()
    run(system, csv=out, **SETTINGS)
    assert out.read_bytes() == old[0]
    assert sorted(p.name for p in tmp_path.glob("r.*")) == ["r.csv", "r.json"]


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_nothing_is_written_through_links(system: System, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (folder := tmp_path / "osp").mkdir()
    write_osp(system, folder, step=0.1)
    names = sorted(path.name for path in folder.iterdir())
    for name in names:
        (folder / name).unlink()
        (folder / name).symlink_to(precious)
    write_osp(system, folder, step=0.1)
    assert precious.read_text() == "mine"
    assert sorted(path.name for path in folder.iterdir()) == names
    assert not any(path.is_symlink() for path in folder.iterdir())


@pytest.mark.skipif(os.name == "nt", reason="devices of POSIX")
def test_a_device_is_written_in_place_and_a_failure_leaves_the_old_file(tmp_path: Path) -> None:
    with replacement(Path("/dev/null")) as path:
        assert path == Path("/dev/null")
    (old := tmp_path / "a.txt").write_text("old")
    with pytest.raises(ZeroDivisionError), replacement(old) as path:
        path.write_text("new")
        raise ZeroDivisionError
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"] and old.read_text() == "old"
    with pytest.raises(OSError, match="No such file"), replacement(tmp_path / "no/a.txt") as path:
        path.write_text("new")


def test_two_runs_do_not_write_one_file_on_windows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its lock is of a byte far behind the rows, so that others can read them."""
    locked: dict[tuple[int, int], int] = {}

    def locking(file: int, mode: int, count: int) -> None:
        key = os.fstat(file).st_ino, os.lseek(file, 0, os.SEEK_CUR)
        if (mode, count) != (2, 1) or locked.setdefault(key, file) != file:
            raise PermissionError

    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(LK_NBLCK=2, locking=locking))
    monkeypatch.setattr(sys, "platform", "win32")
    first = Stream(tmp_path / "r.csv")
    first.append("a\n")
    with pytest.raises(SetupError, match="another run is writing"):
        Stream(tmp_path / "r.csv")
    first.append("b\n")
    first.close()
    assert (tmp_path / "r.csv").read_text() == "a\nb\n"
    assert [at for _, at in locked] == [2**31 - 2]


@pytest.mark.skipif(os.name == "nt", reason="devices of POSIX")
@pytest.mark.parametrize("kind", ["fifo", "zero", "full", "folder"])
@pytest.mark.parametrize("option", ["--input", "--parameters"])
def test_a_table_is_a_file(
    kind: str, option: str, system: System, tmp_path: Path, command_output: CommandOutput
) -> None:
    """A pipe would be waited for without end, and a device read without end."""
    (tmp_path / "folder.csv").mkdir()
    os.mkfifo(tmp_path / "fifo.csv")
    for name in ("zero", "full"):
        (tmp_path / f"{name}.csv").symlink_to(f"/dev/{name}")
    arguments = [
        "run",
        system.parts["A"],
        "--stop",
        1,
        "--step",
        0.1,
        option,
        tmp_path / f"{kind}.csv",
    ]
    arguments += ["--map", "A.u=u"] if option == "--input" else []
    assert "it is not a file but a folder, a pipe or a device" in command_output(*arguments, code=2)


def test_blanks_without_end_take_no_time() -> None:
    """Patterns that go back over them would take hours."""
    for text in (f"a{MANY}b", f"a{MANY}* x", f"{MANY}a * 2{MANY}+ x"):
        with pytest.raises(SetupError):
            Reading.read(text, ["a"], "a table")
    with pytest.raises(SetupError):
        Wire.read(f"a.b{MANY}- > c.d")
    with pytest.raises(SetupError):
        parse_change(f"at 1{MANY}a b")
    assert Wire.read(f"a.b{MANY}*{MANY}2{MANY}->{MANY}c.d").factor == 2.0
    assert parse_change(f"at 1{MANY}s{MANY}a.b{MANY}={MANY}3") == (1.0, "a.b", "3")
