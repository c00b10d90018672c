"""Any command may be ended at any moment: nothing half done looks done, and nobody stays behind."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pandas as pd
import pytest

from cosim import write_ssp
from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.machine import conveyor_drive
from tests.conftest import ROOT, restore_ctrl_c

MOMENTS, GRACE = 50, 5.0
MOMENTS_OF_BUILDS = 12
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
STUDY = """
scenario = "orientator_cycle"
[fixed]
step = 0.01
[grid]
speed = { from = "20rpm", to = "90rpm", number = 6 }
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked for in /proc"),
]


def command(name: str, folder: Path, fmus: Path) -> list[str]:
    """A command whose files go to `folder`/out, or to `folder`/out.csv and .json."""
    if name == "run":
        parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
        paths = {part: fmus / "native" / f"{fmu}.fmu" for part, fmu in parts.items()}
        write_ssp(conveyor_drive(paths, SETS["A"].start(40.0)), folder / "drive.ssp", stop=4.0)
        arguments = ["cosim", "run", "drive.ssp", "--step", "2e-5", "--out", "out.csv"]
    elif name == "resonance":
        arguments = ["scenarios", "run", "resonance", "--flavour", "native", "--speeds", "36:44:5"]
        arguments += ["--steps-per-rev", "128", "--jobs", "2", "--out", "out"]
    else:
        (folder / "speed.toml").write_text(STUDY)
        arguments = ["scenarios", "study", "speed.toml", "--flavour", "native", "--jobs", "2"]
        arguments += ["--out", "out"]
    return [sys.executable, "-m", *arguments]


def running_processes(mark: str) -> list[str]:
    """The processes that carry a mark in their environment."""
    processes = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (process / "environ").read_bytes():
                processes.append((process / "cmdline").read_text().replace("\0", " "))
        except OSError:
            continue
    return processes


def finished(name: str, folder: Path) -> bool:
    """Whether the files say that all is done; what says so must be whole."""
    if name == "run":
        if not (folder / "out.csv").exists():
            return False
        provenance = json.loads((folder / "out.json").read_text())
        rows = pd.read_csv(folder / "out.csv")
        assert provenance["status"] == "complete"
        assert rows["time"].iloc[-1] == 4.0
        return True
    answer = folder / "out" / f"{name}.json"
    for file in (folder / "out").glob("*.csv"):
        if ".partial" not in file.name:
            assert file.read_text().endswith("\n"), file
    return answer.exists() and bool(json.loads(answer.read_text())["verdict"])


@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
@pytest.mark.parametrize("name", ["run", "resonance", "study"])
def test_an_end_at_any_moment_loses_nothing(
    name: str, number: signal.Signals, fmus: Path, tmp_path: Path
) -> None:
    scratch, draw = tmp_path / "scratch", random.Random(f"{name} {number.name}")
    scratch.mkdir()
    arguments = command(name, tmp_path, fmus)
    mark = f"drive-fmus-{uuid.uuid4()}"
    environment = os.environ | {
        "TMPDIR": str(scratch), "MARK": mark, "PYTHONPATH": str(ROOT),
    }  # fmt: skip

    def begin() -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            arguments, cwd=tmp_path, env=environment, start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, preexec_fn=restore_ctrl_c,  # noqa: PLW1509
        )  # fmt: skip

    def remove() -> None:
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        for file in tmp_path.glob("out*"):
            file.unlink()

    began = time.monotonic()
    assert begin().wait() == 0
    duration = time.monotonic() - began
    assert finished(name, tmp_path)
    ended = 0
    for moment in range(MOMENTS):
        if moment % 5 == 0:  # else what the last one left is there, and may be taken up
            remove()
        process = begin()
        try:
            process.wait(draw.uniform(0.0, duration))
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        code = process.wait()
        ended += code != 0
        deadline = time.monotonic() + GRACE
        while (left := running_processes(mark)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not left
        done = finished(name, tmp_path)
        assert done or code != 0
    assert ended > MOMENTS / 4, "most are ended on their way"
    remove()
    assert begin().wait() == 0
    assert finished(name, tmp_path)
    assert not [*scratch.iterdir()], "what a killed run leaves, a later one removes"


BUILDS = {
    "fmukit build": ["-m", "fmukit", "build", str(ROOT / "tests/fmukit/models/gain.py"), "--out"],
    "build_fmus.py": [str(ROOT / "build_fmus.py"), "drive_motor", "gearbox", "--into"],
}
MINE = ("notes.txt", "native/mine.fmu", ".building-plans/plan.txt")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM], ids=lambda number: number.name)
@pytest.mark.parametrize("name", BUILDS)
def test_a_build_that_is_ended_at_any_moment_leaves_whole_files_or_none(
    name: str, number: signal.Signals, tmp_path: Path
) -> None:
    out, scratch, mark = tmp_path / "out", tmp_path / "scratch", f"drive-fmus-{uuid.uuid4()}"
    draw = random.Random(f"{name} {number.name}")
    scratch.mkdir()
    for file in MINE:
        (out / file).parent.mkdir(parents=True, exist_ok=True)
        (out / file).write_text("mine")
    cache = {"ZIG_GLOBAL_CACHE_DIR": str(tmp_path / "zig"), "TMPDIR": str(scratch), "MARK": mark}

    def begin() -> subprocess.Popen[bytes]:
        shutil.rmtree(tmp_path / "zig" / "h", ignore_errors=True)  # compile again
        return subprocess.Popen(
            [sys.executable, *BUILDS[name], str(out)],
            env=os.environ | cache | {"PYTHONPATH": str(ROOT)}, start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, preexec_fn=restore_ctrl_c,  # noqa: PLW1509
        )  # fmt: skip

    def files() -> dict[str, bytes]:
        found = {p.relative_to(out).as_posix(): p for p in out.rglob("*.*") if p.is_file()}
        assert {file for file, path in found.items() if path.read_text("latin-1") == "mine"} == {
            *MINE
        }
        return {
            file: path.read_bytes()
            for file, path in found.items()
            if file.endswith((".fmu", ".wasm")) and not file.startswith(".") and file not in MINE
        }

    began = time.monotonic()
    assert begin().wait() == 0
    duration, expected = time.monotonic() - began, files()
    assert len(expected) == 3 * (2 if "py" in name else 1)
    ended = 0
    for moment in range(MOMENTS_OF_BUILDS):
        if moment % 3 == 0:  # else what the last one left is there, and is taken up
            for file in expected:
                (out / file).unlink(missing_ok=True)
        process = begin()
        try:
            process.wait(draw.uniform(0.0, duration))
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        ended += process.wait() != 0
        deadline = time.monotonic() + GRACE
        while (left := running_processes(mark)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not left
        assert files().items() <= expected.items()
    assert ended > MOMENTS_OF_BUILDS / 4, "most are ended on their way"
    assert begin().wait() == 0
    assert files() == expected
    assert [path.name for path in out.glob(".building-*")] == [".building-plans"]
    assert not [*scratch.iterdir()]
