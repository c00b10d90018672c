"""What a run does to the process that it runs in: nothing that the rest of it would notice."""

from __future__ import annotations

import builtins
import contextlib
import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cosim import Result, System, child, run
from cosim.__main__ import main as command
from cosim.fmu import library
from tests.conftest import ROOT
from tests.cosim.foreign import pack, single_fmu_system


@pytest.fixture
def system(tmp_path: Path) -> System:
    return single_fmu_system(pack(tmp_path / "A.fmu"))


@pytest.mark.parametrize("output_step", [0.3, 7.3, 2.0**64 * 0.1, 1e300])
def test_rows_further_apart_than_a_run_is_long_are_its_first_and_last(
    output_step: float, system: System
) -> None:
    """2^64 steps are no number of C, and none of them a division by zero."""
    result: Result = run(system, stop=0.3, step=0.1, output_step=output_step, record=["A.y"])
    assert result["time"].tolist() == [0.0, 0.3]
    assert result.provenance["loop"] == "compiled"


def copies(fmu: Path, folder: Path, count: int) -> list[System]:
    """Systems of copies, each of which is loaded anew."""
    paths = [folder / f"Copy{k}.fmu" for k in range(count)]
    for path in paths:
        shutil.copy(fmu, path)
    return [System({"m": path}) for path in paths]


def test_loading_an_fmu_leaves_the_working_directory_to_others(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What another thread writes by relative names meanwhile is there afterwards."""
    systems = copies(fmus / "DriveMotor.fmu", tmp_path, 40)
    (home := tmp_path / "home").mkdir()
    monkeypatch.chdir(home)
    loaded = threading.Event()

    def load() -> None:
        for system in systems:
            run(system, stop=0.01, step=0.01)
        loaded.set()

    thread = threading.Thread(target=load)
    thread.start()
    written, elsewhere = 0, set()
    while not loaded.is_set():
        Path(f"mine_{written}.txt").write_text("precious")
        written += 1
        elsewhere.add(Path.cwd())
    thread.join()
    assert elsewhere == {home}
    assert sum(1 for _ in home.glob("mine_*.txt")) == written > 0


def test_an_fmu_is_loaded_where_the_working_directory_is_gone(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (system,) = copies(fmus / "DriveMotor.fmu", tmp_path, 1)
    (home := tmp_path / "home").mkdir()
    monkeypatch.chdir(home)
    home.rmdir()
    assert len(run(system, stop=0.02, step=0.01)["time"]) == 3


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks here")
def test_a_child_that_is_forked_while_a_thread_loads_an_fmu_runs_too(
    fmus: Path, tmp_path: Path
) -> None:
    """It inherits a lock that a thread holds which it does not have, and libraries that are not its own."""
    here, there = copies(fmus / "DriveMotor.fmu", tmp_path, 2)
    wanted = run(here, stop=0.1, step=0.01).data.tobytes()
    held, done = threading.Event(), threading.Event()

    def hold() -> None:
        with library.LOCK:
            held.set()
            done.wait()

    thread = threading.Thread(target=hold)
    thread.start()
    held.wait()
    try:
        child = os.fork()
        if not child:
            signal.alarm(60)  # a child that hangs ends by it
            rows = [run(system, stop=0.1, step=0.01).data.tobytes() for system in (here, there)]
            os._exit(0 if rows == [wanted, wanted] else 3)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    finally:
        done.set()
        thread.join()
    assert run(here, stop=0.1, step=0.01).data.tobytes() == wanted


def test_ctrl_c_while_the_modules_are_imported_prints_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What takes seconds to import is imported where the command hears it, and not before."""
    imported = builtins.__import__

    def interrupt(name: str, *more: Any) -> Any:
        if name == "cli.main":
            raise KeyboardInterrupt
        return imported(name, *more)

    monkeypatch.setattr(builtins, "__import__", interrupt)
    assert command() == 130
    assert capsys.readouterr().err == "interrupted\n"
    program = "import sys, cosim.__main__; print({'numpy', 'fmpy', 'scipy'} & sys.modules.keys())"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True
    )
    assert done.stdout.split() == [b"set()"]


def write_into(kind: str, pipe: Any) -> None:
    """What an FMU does that writes into descriptors that are not its own, of pipes or of sockets, and goes on."""
    is_kind = {"pipe": stat.S_ISFIFO, "socket": stat.S_ISSOCK}[kind]
    for descriptor in range(3, 4096):  # those of a process of many tests are high
        with contextlib.suppress(OSError):
            if is_kind(os.fstat(descriptor).st_mode):
                os.write(descriptor, b"AAAAAAAA")
    pipe.send("written")
    signal.pause()


@pytest.mark.skipif(sys.platform == "win32", reason="its pipes are not of POSIX")
@pytest.mark.parametrize("kind", ["pipe", "socket"])
def test_what_a_child_writes_into_the_pipes_to_its_parent_holds_up_nobody(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The parent waited for an end, or for the rest of a message of 1 GB, that never came."""
    monkeypatch.setattr(child, "GRACE", 1.0)
    one = child.Child(partial(write_into, kind), is_apart=True)
    heard: list[Any] = []
    while not heard:
        heard += one.messages(child.GRACE)
    was_alive = one.process.is_alive()
    one.end()
    assert (was_alive, heard) == (
        (True, ["written"]) if kind == "pipe" else (False, [child.Death(child.WROTE)])
    )
