"""What is no fault of a run costs no row: it ends a study in one line, and the same command goes on."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from cosim import SetupError, SimulationError
from cosim.calls import Caller
from scenarios.project import PROJECT
from tests.conftest import ROOT, until
from workbench import study

QUESTION = '''
"""What does the machine do to a run?"""
import errno
import time
from dataclasses import dataclass
from pathlib import Path
from cosim import SetupError
import workbench
from workbench import Figure, Findings, option, Question
HOME = Path(HOME_TEXT)
class Faulty(Question):
    parts = {"motor": "Motor.fmu"}

    x: float = option(0.0, "abscissa")

    def solve(self, context):
        with open(HOME / "ledger", "a") as file:
            file.write(f"{self.x!r}\\n")
        if self.x == 2.0 and (HOME / "fault").exists():
            globals()[(HOME / "fault").read_text()]()
        if (HOME / "motor_needed").exists() and not Path(context.fmus["motor"]).exists():
            raise SetupError("part motor: there is no file Motor.fmu")
        return Findings({"y": Figure(3.0 * self.x, "1", 0.0)})
def disk():
    try:
        raise OSError(errno.ENOSPC, "No space left on device")
    except OSError as error:
        raise SetupError(f"Motor.fmu cannot be unpacked: {error}") from error
def files(): raise OSError(errno.EMFILE, "Too many open files", "some.file")
def memory(): raise MemoryError("no memory for rows")
def device(): raise OSError(errno.EIO, "Input/output error")
def library():
    raise OSError("some.so: cannot open shared object file: Too many open files")
def own(): raise FileNotFoundError(errno.ENOENT, "No such file or directory", "record.csv")
def gate():
    (HOME / "reached").touch()
    while (HOME / "fault").exists():
        time.sleep(0.01)
    (HOME / "motor_needed").touch()
'''
GRID = 'scenario = "faults.py"\n[grid]\nx = [0.0, 1.0, 2.0, 3.0]\n'


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A study of four runs, the third of which meets the fault that a file names."""
    shutil.copy(ROOT / "fmus" / "native" / "DriveMotor.fmu", tmp_path / "Motor.fmu")
    (tmp_path / "faults.py").write_text(QUESTION.replace("HOME_TEXT", repr(str(tmp_path))))
    (tmp_path / "some.toml").write_text(GRID)
    return tmp_path


def done(home: Path) -> list[float]:
    """The runs since the last call."""
    runs = [float(line) for line in (home / "ledger").read_text().split()]
    (home / "ledger").unlink()
    return runs


FAULTS = {
    "disk": "Motor.fmu cannot be unpacked: [Errno 28] No space left on device",
    "files": "Too many open files",
    "memory": "MemoryError: no memory for rows",
    "device": "Input/output error",
    "library": "some.so: cannot open shared object file: Too many open files",
}


def test_a_fault_of_the_machine_ends_a_study_and_the_same_command_goes_on(home: Path) -> None:
    for fault, message in FAULTS.items():
        (home / "fault").write_text(fault)
        with pytest.raises(SimulationError) as ended:
            study.run(study.load(home / "some.toml"), out=home / "out", jobs=1)
        text = str(ended.value)
        assert text.startswith("some: run 2: ")
        assert message in text
        assert text.endswith(
            "; this is a fault of the machine, so the run does not count; once it is mended, the same "
            "command continues"
        )
        assert "\n" not in text
        # the next run is handed out before the outcome of this one is looked at; its row is not kept
        before = [0.0, 1.0] if fault == "disk" else []
        assert done(home)[: len(before) + 1] == [*before, 2.0]
        assert not (home / "out" / "table.csv").exists()
    (home / "fault").unlink()
    result = study.run(study.load(home / "some.toml"), out=home / "out", jobs=1)
    assert done(home) == [2.0, 3.0]
    assert list(result.first_table["y"]) == [0.0, 3.0, 6.0, 9.0]


def test_a_file_that_a_question_misses_for_itself_costs_its_row(home: Path) -> None:
    (home / "fault").write_text("own")
    result = study.run(study.load(home / "some.toml"), out=home / "out", jobs=1)
    assert list(result.first_table["status"]) == ["ok", "ok", "failed", "ok"]


def test_a_study_whose_folder_moves_ends_and_goes_on_where_it_is(home: Path) -> None:
    (home / "fault").write_text("gate")
    out, destination = home / "out", home / "moved"
    process = subprocess.Popen(
        [sys.executable, "-m", "scenarios", "study", str(home / "some.toml"), "--out", str(out),
         "--jobs", "1"],
        cwd=ROOT, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    until(lambda: process.poll() is not None or (home / "reached").exists())
    out.rename(destination)
    (home / "fault").unlink()
    errors = process.communicate(timeout=100)[1]
    assert process.returncode == 1
    assert errors == (
        f"error: some: run 2: {out / 'inputs' / 'Motor.fmu'} is gone; what was computed is in the "
        "study's journal, and the same command continues once the file is back\n"
    )
    assert not out.exists()
    assert done(home)[:3] == [0.0, 1.0, 2.0]
    result = study.run(study.load(home / "some.toml", PROJECT), out=destination, jobs=1)
    assert done(home) == [2.0, 3.0]
    assert set(result.first_table["status"]) == {"ok"}


def changed(fmu: Path) -> None:
    """Another content under the same GUID."""
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr("resources/other.txt", "other")


def test_a_study_with_another_fmu_of_the_same_guid_is_another_study(home: Path) -> None:
    study.run(study.load(home / "some.toml"), out=home / "out", jobs=1)
    changed(home / "Motor.fmu")
    with pytest.raises(SetupError, match=r"rows of other runs: fmus\.motor has changed; remove"):
        study.run(study.load(home / "some.toml"), out=home / "out", jobs=1)


def descriptors() -> list[int]:
    """The open files of this process."""
    return [int(path.name) for path in Path("/proc/self/fd").iterdir()]


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_without_a_process_the_error_is_a_line_and_nothing_is_left(tmp_path: Path) -> None:
    """A worker that cannot be started has nothing to end."""
    from tests.hosts import light

    worker = Caller()
    assert worker.do(light.modules, None, None).status == "ok"
    worker.close()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    top = max(descriptors())
    fillers = [os.open(os.devnull, os.O_RDONLY)]
    while fillers[-1] < top:
        fillers.append(os.open(os.devnull, os.O_RDONLY))
    before = descriptors()
    ends = []
    for limit in range(fillers[-1] + 1, fillers[-1] + 25):
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
        try:
            ends.append(worker.do(light.modules, None, None).status)
        except SetupError as error:
            assert re.match("no process for runs can be started: (Too many open|.*Errno 24|.*exit)",
                            str(error)), error  # fmt: skip
            ends.append("no process")
        finally:
            worker.close()
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert len(descriptors()) == len(before)
    for filler in fillers:
        os.close(filler)
    assert ends[0] == "no process"
    assert ends[-1] == "ok"
