"""Any command that writes may be ended at any moment: nothing half done looks done, nothing of the user is lost.

Nobody stays behind either, and the same command goes on to the same files, whatever it was ended in.
"""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import pytest

from cosim import write_ssp
from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.machine import conveyor_drive
from tests.conftest import ROOT, restore_ctrl_c, running, until
from workbench.files import UNFINISHED

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
STUDY = """
scenario = "orientator_cycle"
[fixed]
step = 0.01
[grid]
speed = { from = "20rpm", to = "90rpm", number = 6 }
"""
MAP = """
from pathlib import Path
from cosim import Prepared, RunSettings, System
parts = {"motor": "FMUS/DriveMotor.fmu", "conveyor": "FMUS/CrankConveyor.fmu"}
wires = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
if __name__ == "__main__":
    with Prepared.open(System(parts, wires), RunSettings(stop=1.0, step=1e-4)) as prepared:
        ensemble = prepared.map({"motor.A": [7000.0, 7250.0, 7500.0, 8000.0]}, jobs=2)
    assert not any(ensemble.reasons), ensemble.reasons
    for name, values in {name: ensemble[name] for name in ("conveyor.w", "motor.tau")}.items():
        fresh = Path(f"out/.partial-{name}.txt")
        fresh.write_text("\\n".join(map(repr, values.ravel().tolist())))
        fresh.replace(f"out/{name}.txt")
"""
RUN = "cosim run drive.ssp --step 1e-4"
QUESTION = "scenarios run {} --flavour native --out out"
COMMANDS = {
    "run": f"{RUN} --out out/r.csv",
    "run_parquet": f"{RUN} --out out/r.parquet",
    "certify": f"{RUN} --certify --out out/r.csv",
    "sweep": "cosim sweep drive.ssp --step 1e-4 --stop 1 --vary motor.A=7000:8000:8 --figure largest:motor.tau --jobs 2 --out out/t.csv",
    "map": "many",
    "resonance": f"{QUESTION.format('resonance')} --steps-per-rev 128 --speeds 36:44:5 --jobs 2",
    "identify": f"{QUESTION.format('identify')} --data {ROOT}/examples/conveyor_record.csv --map time=t "
    "--map conveyor.w=n --map motor.tau=M*0.8:N.m --known conveyor.trough.m=200+-5 "
    "--known conveyor.spring.c=720e3+-2% --rated-torque 80 --starts 2 --jobs 2",
    "study": "scenarios study speed.toml --flavour native --jobs 2 --out out",
    "site": "gallery --questions resonance --out out",
    "build": f"fmukit build {ROOT}/tests/fmukit/models/gain.py {ROOT}/tests/fmukit/models/van_der_pol.py "
    "--flavour both --out out",
}
#: Kills by each signal; those of the site and of identify take long.
KILLS = {"identify": 2, "site": 1}
MANY = 3
#: Time after which a command is loaded and says itself that it was interrupted [s]; chosen: an ordinary machine needs less.
LOADED = 1.0
#: What a folder may contain that depends on when and how often a command ran.
OF_THE_SESSION = ("journal.runs", "study.json", "made_of.txt", ".buildinfo")
CHANGING = re.compile(
    rb'own-[0-9a-f]{32}|sha256-[\w+/=]+|\d+ of them now in [\d.]+ s|"wall_time": [\d.e-]+'
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked for in /proc"),
]


class Place(NamedTuple):
    """A command, the folder in which it runs, and what it wrote there when nobody ended it."""

    name: str
    folder: Path
    duration: float
    files: dict[str, bytes]

    def begin(self, mark: str) -> subprocess.Popen[bytes]:
        """Begin the command, with a mark in the environment of all its processes."""
        environment = os.environ | {
            "TMPDIR": str(self.folder / "scratch"), "MARK": mark, "PYTHONPATH": str(ROOT), "COLUMNS": "100",
        }  # fmt: skip
        with (self.folder / "errors.txt").open("wb") as errors:
            return subprocess.Popen(
                [sys.executable, "-m", *COMMANDS[self.name].split()], cwd=self.folder, env=environment,
                start_new_session=True, stdout=subprocess.DEVNULL, stderr=errors,
                preexec_fn=restore_ctrl_c,  # noqa: PLW1509
            )  # fmt: skip

    def clear(self) -> None:
        """Leave nothing but what the user had there."""
        shutil.rmtree(self.folder / "out", ignore_errors=True)
        (self.folder / "out").mkdir()
        (self.folder / "out" / "notes.txt").write_text("mine")

    def written(self) -> dict[str, bytes]:
        """What the command wrote, by name, without what belongs to a session."""
        return {
            path.relative_to(self.folder / "out").as_posix(): CHANGING.sub(b"", path.read_bytes())
            for path in sorted((self.folder / "out").rglob("*"))
            if path.is_file() and path.name not in OF_THE_SESSION
        }

    def check_whole(self) -> None:
        """Whatever has its name is whole; what the user had is there."""
        out = self.folder / "out"
        assert (out / "notes.txt").read_text() == "mine"
        assert (self.folder / "scratch" / "notes.txt").read_text() == "mine"
        for path in out.rglob("*"):
            inside = path.relative_to(out).as_posix()
            if UNFINISHED in inside or ".partial" in path.name or inside not in self.files:
                continue
            if path.suffix == ".json" and path.name not in OF_THE_SESSION:
                json.loads(path.read_text())
            if path.suffix == ".parquet":
                pd.read_parquet(path)
            if path.suffix in (".csv", ".png", ".html", ".gif", ".fmu", ".wasm"):
                assert CHANGING.sub(b"", path.read_bytes()) == self.files[inside], inside


def was_ended(process: subprocess.Popen[bytes], after: float, number: signal.Signals) -> bool:
    """Send a signal after some time [s], and say whether it was before the end of the process."""
    try:
        assert process.wait(after) == 0
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    return process.wait() != 0


@pytest.fixture(scope="module", params=COMMANDS)
def place(
    request: pytest.FixtureRequest, fmus: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Place]:
    """A command that ran once without being ended."""
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "scratch").mkdir()
    (folder / "scratch" / "notes.txt").write_text("mine")
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    paths = {part: fmus / "native" / f"{fmu}.fmu" for part, fmu in parts.items()}
    write_ssp(conveyor_drive(paths, SETS["A"].start(40.0)), folder / "drive.ssp", stop=4.0)
    (folder / "speed.toml").write_text(STUDY)
    (folder / "many.py").write_text(MAP.replace("FMUS", str(fmus / "native")))
    place = Place(request.param, folder, 0.0, {})
    place.clear()
    began = time.monotonic()
    assert place.begin("").wait() == 0
    place = place._replace(duration=time.monotonic() - began, files=place.written())
    assert len(place.files) > 1
    yield place
    shutil.rmtree(folder)


@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
def test_an_end_at_any_moment_loses_nothing(number: signal.Signals, place: Place) -> None:
    draw, mark = random.Random(f"{place.name} {number.name}"), f"drive-fmus-{uuid.uuid4()}"
    ended, duration = 0, place.duration
    place.clear()
    while ended < KILLS.get(place.name, MANY):  # each goes on with what the last one left
        process = place.begin(mark)
        after = draw.uniform(0.05, 0.95) * duration
        if was_ended(process, after, number):
            ended += 1
            if number == signal.SIGINT and after > LOADED and place.name != "map":
                assert b"Traceback" not in (place.folder / "errors.txt").read_bytes()
        else:  # it was faster than before, or what the last one left was nearly all
            duration /= 2.0
            place.clear()
        until(lambda: not running(mark))
        place.check_whole()
    assert place.begin(mark).wait() == 0
    assert place.written() == place.files
    assert [path.name for path in (place.folder / "scratch").iterdir()] == ["notes.txt"]
