"""Where files on the way lie: in a folder of this process, which goes with it.

A process that is killed leaves its folder behind, but no longer locks it: the next process that needs a
folder removes it.
"""

from __future__ import annotations

import os
import sys
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path
from shutil import rmtree
from tempfile import gettempdir, mkdtemp
from typing import IO

PREFIX, LOCK = "cosim_", "lock"


def scratch() -> Path:
    """The folder of this process."""
    return _made(os.getpid())


@cache
def _made(_process: int) -> Path:
    for lock in Path(gettempdir()).glob(f"{PREFIX}*/{LOCK}"):
        if _abandoned(lock):
            rmtree(lock.parent, ignore_errors=True)
    folder = Path(mkdtemp(prefix=PREFIX))
    fresh = folder / "new"
    file = fresh.open("w")
    _locks(file)
    fresh.rename(folder / LOCK)  # nobody sees a lock that is not held
    Finalize(None, _remove, (folder, file), exitpriority=-1)
    return folder


def _remove(folder: Path, file: IO[str]) -> None:
    rmtree(folder, ignore_errors=True)
    file.close()


def _abandoned(lock: Path) -> bool:
    """Whether the process that held a lock is gone."""
    try:
        if sys.platform == "win32":
            lock.unlink()  # an open file cannot be
            return True
        with lock.open("a") as file:
            return _locks(file)
    except OSError:
        return False


def _locks(file: IO[str]) -> bool:
    """Lock a file until it is closed; False if another process holds it."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
