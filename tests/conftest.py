"""Build the FMUs once, as a user does, before any worker starts."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def pytest_sessionstart(session: pytest.Session) -> None:
    if not hasattr(session.config, "workerinput"):
        subprocess.run([sys.executable, "build_fmus.py"], cwd=ROOT, check=True)


@pytest.fixture(scope="session")
def fmus() -> Path:
    """The folder of the built FMUs."""
    return ROOT / "fmus"
