"""Build the FMUs once, as a user does, before any worker starts."""

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pythonfmu import FmuBuilder

ROOT = Path(__file__).resolve().parents[1]
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
    "run_up": {"stop": 0.3},
    "iron_cycle": {"samples": 180},
    "iron_start": {"stop": 0.1},
    "iron_orders": {"speeds": "5"},
    "orientation_time": {"speeds": "40,80", "frictions": "0.35"},
    "orientator_cycle": {},
    "packing_line": {"stop": 4.0, "step": 4e-3},
}


def pytest_sessionstart(session: pytest.Session) -> None:
    if not hasattr(session.config, "workerinput"):
        subprocess.run([sys.executable, "build_fmus.py", "--flavour", "both"], cwd=ROOT, check=True)


def hear_ctrl_c() -> None:
    """Let a child hear Ctrl-C although the tests run in the background, where it is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture(scope="session")
def fmus() -> Path:
    """The folder of the built FMUs."""
    return ROOT / "fmus"


@pytest.fixture(scope="session")
def echo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU with Integer and String parameters, which the project's own do not have."""
    folder = tmp_path_factory.mktemp("echo")
    FmuBuilder.build_FMU(ROOT / "tests" / "hosts" / "echo.py", dest=folder)
    return folder / "Echo.fmu"


@pytest.fixture(scope="session", params=["python", "native"])
def both(request: pytest.FixtureRequest, fmus: Path) -> Path:
    """The folder of the FMUs of one flavour, then of the other."""
    return fmus / {"python": "", "native": "native"}[request.param]
