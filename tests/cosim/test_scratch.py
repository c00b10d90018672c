"""Files on the way go with their process, however it ends; nobody else's file is touched."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from cosim.scratch import MARK, PREFIX, SUFFIX
from tests.conftest import ROOT

WAIT = "from cosim.scratch import scratch; print(scratch(), flush=True); input()"
#: A convention of the test: a number that no user has who runs it.
STRANGER = 4711


def begin(folder: Path, code: str = WAIT) -> tuple[subprocess.Popen[str], Path]:
    """A process that waits for a line, and its folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", code], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        env=os.environ | {"TMPDIR": str(folder), "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert process.stdout is not None
    scratch = Path(process.stdout.readline().strip())
    assert scratch.parent == folder
    return process, scratch


def end(process: subprocess.Popen[str]) -> None:
    process.communicate("\n")
    assert process.returncode == 0


def leftover(folder: Path) -> Path:
    """What a process that was killed left in a new folder for temporary files."""
    folder.mkdir(exist_ok=True)
    process, scratch = begin(folder)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert scratch.is_dir()
    return scratch


def test_a_folder_goes_with_its_process_or_with_the_next_process(tmp_path: Path) -> None:
    lives, folder = begin(tmp_path)
    left = leftover(tmp_path)
    assert folder.is_dir(), "another one that lives keeps its folder"
    ends, last = begin(tmp_path)
    assert not left.exists()
    assert folder.is_dir()
    end(ends)
    end(lives)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_whose_process_was_killed_before_the_mark_was_written_goes(tmp_path: Path) -> None:
    """Nothing is in it yet; a folder with anything in it, or without the whole name, stays."""
    names = (
        f"{PREFIX}empty{SUFFIX}",
        f"{PREFIX}half{SUFFIX}",
        f"{PREFIX}full{SUFFIX}",
        f"{PREFIX}empty",
    )
    empty, half, full, other = (tmp_path / name for name in names)
    for folder in (empty, half, full, other):
        folder.mkdir(0o700)
    (half / MARK).touch()
    (full / "week.csv").write_text("time,x\n")
    process, _ = begin(tmp_path)
    end(process)
    assert {*tmp_path.iterdir()} == {full, other}


def test_what_belongs_to_somebody_else_stays(tmp_path: Path) -> None:
    """A name proves nothing, and a mark only where nobody but its user could write it."""
    shared = tmp_path / "shared"
    (shared / "home").mkdir(parents=True)
    (shared / "cosim_clone" / ".git").mkdir(parents=True)
    (shared / "cosim_clone" / ".git" / "HEAD").write_text("ref: refs/heads/main\n")
    for name in ("cosim_measurements", "cosim_by_hand"):
        (shared / name).mkdir(0o700)
    (shared / "cosim_measurements" / "week.csv").write_text("time,x\n")
    (shared / "cosim_by_hand" / MARK).write_text("temporary folder of cosim\n")
    (shared / "cosim_link").symlink_to(shared / "home")
    (shared / "cosim_file.txt").write_text("a file")
    original = leftover(tmp_path / "first")
    shutil.copytree(original, shared / "cosim_copy")
    (shared / "cosim_copy").chmod(0o700)
    (shared / "cosim_second_link").symlink_to(original)
    opened = leftover(tmp_path / "second").rename(shared / "cosim_opened")
    opened.chmod(0o755)
    linked = leftover(tmp_path / "third")
    contents = {*shared.rglob("*")}

    process, _ = begin(shared)
    end(process)
    assert {*shared.rglob("*")} == contents
    assert original.is_dir()

    of_this_user = linked.rename(shared / linked.name)
    stranger = f"import os; os.geteuid = lambda: {STRANGER}; {WAIT}"
    process, folder = begin(shared, stranger)
    end(process)
    assert of_this_user.is_dir(), "another user's leftovers stay"
    process, _ = begin(shared)
    end(process)
    assert not of_this_user.exists(), "the same folder goes when its own user comes by"
    assert {*shared.rglob("*")} == contents
