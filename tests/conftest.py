"""Build the FMUs once, as a user does, before any worker starts."""

import gc
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any
from zipfile import ZipFile

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes would compile everything
sys.dont_write_bytecode = False

import pytest
from pythonfmu import FmuBuilder

from scenarios.project import PROJECT
from workbench.answer import Answer
from workbench.question import read
from workbench.run import ask as ask_question

ROOT = Path(__file__).resolve().parents[1]
DESCRIPTION = "modelDescription.xml"
TRIED = ("drive_motor", "gravity_orientator")
"""Machines whose FMUs of FMI 3.0 are tried in the default tests."""
STAGES = ("falling", "joint", "turning", "released")
QUICK: dict[str, dict[str, Any]] = {
    "resonance": {"speeds": "30,44", "steps_per_rev": 64},
    "resonance_map": {
        "x": "speed=30:60:5",
        "y": "motor.T=0.05:0.06:2",
        "samples": 16,
        "checks": 2,
        "check_runs": 2,
        "steps_per_rev": 80,
    },
    "mean_values": {"speeds": "30,44", "steps_per_rev": 256},
    "orbit": {"steps_per_rev": 128},
    "induction_motor": {"resistances": "6000", "slips": "0.32", "steps_per_rev": 256},
    "rod_force": {"speeds": "30:60:4", "springs": "1e5:1e6:4", "steps_per_rev": 128},
    "run_up": {"stop": 0.3},
    "iron_cycle": {"samples": 180},
    "iron_start": {"stop": 0.1},
    "iron_orders": {"speeds": "5"},
    "iron_bounce": {"speeds": "80rpm,100rpm", "samples": 720},
    "orientation_time": {"speeds": "40rpm,80rpm", "frictions": "0.35"},
    "orientator_cycle": {},
    "packing_line": {"iron_speed": 6.0, "stop": 3.75, "step": 1e-3},
    "speed_step": {"stop": 0.2},
    "sommerfeld": {"supplies": "18:30:3", "hold": 2.0, "step": 0.02},
    "identify": {
        "data": str(ROOT / "examples/conveyor_record.csv"),
        "map": ["time=t", "conveyor.w=n", "motor.tau=M*0.8:N.m"],
        "known": ["conveyor.trough.m=200+-5", "conveyor.spring.c=720e3+-2%"],
        "rated_torque": 80.0,
        "starts": 2,
    },
    "iron_identify": {
        "data": str(ROOT / "examples/iron_record.csv"),
        "map": ["time=t", "iron.w=n", "motor.tau=M*0.02:N.m"],
        "known": ["iron.iron.m=4.4+-1%"],
        "until": 1.65,
        "starts": 2,
    },
    "orientator_identify": {
        "data": str(ROOT / "examples/orientator_record.csv"),
        "map": ["orientator.w=n", *(f"orientator.t_{x}={x}" for x in STAGES)],
        "noise": [f"orientator.t_{x}=0.5ms" for x in STAGES],
        "starts": 2,
    },
}

#: Answers that are compared with another theory or machine: question and word, and the options that ask for it.
COMPARISONS: dict[str, dict[str, Any]] = {
    "resonance classical": {"theory": "classical", "speeds": "10:30:4", "steps_per_rev": 128},
    "iron_cycle dimensions": {"compare": "dimensions", "samples": 180},
    "orientation_time formula": {"compare": "formula", "frictions": "0.5"},
    "orientation_time neglected": {"compare": "neglected", "speeds": "20rpm,60rpm"},
}
#: Everything that is asked with few runs.
CASES = QUICK | COMPARISONS

LONG = {"iron_identify", "identify", "sommerfeld"}
"""Questions of many seconds of processor time, which have tests of their own; others are slow."""
COSTLY = LONG | {
    "induction_motor", "orientation_time formula", "orientation_time neglected", "resonance_map", "rod_force",
}  # fmt: skip
SAMPLED = [pytest.param(x, marks=[pytest.mark.slow] if x in COSTLY else []) for x in CASES]
"""Every case; those whose shortest answer takes seconds are looked at again in slow tests."""


def fmus_of(page: ModuleType, flavour: str = "native") -> dict[str, Path]:
    """The FMUs of a page, which are built already."""
    return PROJECT.fmus(read(page), flavour)


def ask(name: str, out: Path | None = None, **options: Any) -> Answer:
    """The answer to a question of the project, on compiled FMUs, in this process."""
    return ask_question(
        PROJECT, name, options, flavour="native", jobs=1, out=out, program="scenarios"
    )


def question_of(case: str) -> str:
    """The question of a case."""
    return case.partition(" ")[0]


@cache
def plain(case: str) -> Answer:
    """The answer with few runs, asked once."""
    return ask(question_of(case), **CASES[case])


def rewritten(fmu: Path, copy: Path, edit: Callable[[dict[str, Any]], Any]) -> Path:
    """A copy of an FMU, or of any archive, whose files by name were edited."""
    with ZipFile(fmu) as archive:
        files: dict[str, Any] = {name: archive.read(name) for name in archive.namelist()}
    edit(files)
    with ZipFile(copy, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return copy


def described(*swaps: tuple[str, str]) -> Callable[[dict[str, Any]], None]:
    """An edit that replaces regular expressions in the model description."""

    def edit(files: dict[str, Any]) -> None:
        for pattern, new in swaps:
            text, count = re.subn(pattern, new, str(files[DESCRIPTION], "utf-8"))
            assert count, pattern
            files[DESCRIPTION] = text.encode()

    return edit


def pytest_sessionstart(session: pytest.Session) -> None:
    if not hasattr(session.config, "workerinput"):
        build = [sys.executable, "build_fmus.py"]
        subprocess.run([*build, *TRIED, "--flavour", "all"], cwd=ROOT, check=True)
        subprocess.run([*build, "--flavour", "both"], cwd=ROOT, check=True)


QUICK_FILES = {
    "test_dimensions.py", "test_drive_parts.py", "test_linear_system.py", "test_physics.py",
    "test_inputs.py", "test_jet.py", "test_metrics.py", "test_scratch.py", "test_ssp.py",
    "test_journal.py", "test_means.py",
}  # fmt: skip
"""Files of tests that take seconds together and look at every package; `-m quick` runs them."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the quick tests, and put those of the whole project first: they are the longest, and no core
    shall wait for them at the end.
    """
    for item in items:
        if item.path.name in QUICK_FILES and item.get_closest_marker("slow") is None:
            item.add_marker("quick")
    items.sort(key=lambda item: item.path.parent != ROOT / "tests")


@pytest.fixture(scope="module", autouse=True)
def _garbage_is_what_these_tests_leave() -> None:
    """Collect it seldom, and leave out what was there before."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000)


def restore_ctrl_c() -> None:
    """Let a child hear what ends a program although the tests run where that is ignored."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def running(mark: str) -> list[str]:
    """The processes that carry a mark in their environment."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (process / "environ").read_bytes():
                found.append((process / "cmdline").read_text().replace("\0", " "))
        except OSError:
            continue
    return found


def until(condition: Callable[[], Any]) -> None:
    """Wait for what must come; the limit is only against waiting for ever."""
    deadline = time.monotonic() + 300.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture(scope="session")
def fmus() -> Path:
    """The folder of the built FMUs."""
    return ROOT / "fmus"


@pytest.fixture(scope="session")
def native(fmus: Path) -> Path:
    """The folder of the native FMUs."""
    return fmus / "native"


@pytest.fixture(scope="session")
def echo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU with Integer and String parameters, which the project's own do not have."""
    folder = tmp_path_factory.mktemp("echo")
    FmuBuilder.build_FMU(ROOT / "tests" / "hosts" / "echo.py", dest=folder)
    return folder / "Echo.fmu"


@pytest.fixture(scope="session")
def half(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU that is half of any system."""
    folder = tmp_path_factory.mktemp("half")
    FmuBuilder.build_FMU(ROOT / "tests" / "hosts" / "half.py", dest=folder)
    return folder / "Half.fmu"


@pytest.fixture(scope="session", params=["python", "native"])
def both(request: pytest.FixtureRequest, fmus: Path) -> Path:
    """The folder of the FMUs of one flavour, then of the other."""
    return fmus / {"python": "", "native": "native"}[request.param]
