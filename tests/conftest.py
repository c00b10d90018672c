"""Build the FMUs once, as a user does, before any worker starts."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def pytest_sessionstart(session: pytest.Session) -> None:
    if not hasattr(session.config, "workerinput"):
        subprocess.run([sys.executable, "build_fmus.py"], cwd=ROOT, check=True)


def hear_ctrl_c() -> None:
    """Let a child hear Ctrl-C although the tests run in the background, where it is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture(scope="session")
def fmus() -> Path:
    """The folder of the built FMUs."""
    return ROOT / "fmus"
