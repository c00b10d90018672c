"""Commands in processes that end with this one, however it ends."""

from __future__ import annotations

import ctypes
import signal
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

from scenarios.fmu_files import CLONE as ROOT

PARENT_DEATH_SIGNAL = 1


def run_in_project(
    command: Sequence[str], *, check: bool, **settings: Any
) -> subprocess.CompletedProcess[str]:
    """Run a command in the folder of the project; settings are those of `subprocess.run`."""
    linux = sys.platform == "linux"
    return subprocess.run(
        command, check=check, cwd=ROOT, preexec_fn=_die_with_parent if linux else None, **settings
    )  # fmt: skip


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, int(signal.SIGKILL))
