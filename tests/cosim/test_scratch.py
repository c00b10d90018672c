"""Files on the way go with their process, however it ends."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from cosim.scratch import PREFIX
from tests.conftest import ROOT

WAIT = "from cosim.scratch import scratch; print(scratch(), flush=True); input()"


def test_a_folder_goes_with_its_process_or_with_the_next_one(tmp_path: Path) -> None:
    environment = os.environ | {"TMPDIR": str(tmp_path), "PYTHONPATH": str(ROOT)}

    def begin() -> tuple[subprocess.Popen[str], Path]:
        process = subprocess.Popen(
            [sys.executable, "-c", WAIT], env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        assert process.stdout is not None
        folder = Path(process.stdout.readline().strip())
        assert folder.parent == tmp_path
        return process, folder

    lives, own = begin()
    killed, left = begin()
    assert own.is_dir(), "another one that lives keeps its folder"
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert left.is_dir()
    unlocked = tmp_path / f"{PREFIX}killed_before_it_was_locked"
    unlocked.mkdir()
    ends, last = begin()
    assert not left.exists()
    assert not unlocked.exists()
    assert own.is_dir()
    for process in (ends, lives):
        process.communicate("\n")
        assert process.returncode == 0
    assert not own.exists()
    assert not last.exists()
