"""A folder for temporary files of this process, which is removed when the process ends.

A process that is killed leaves its folder behind but no longer locks it. The next process that needs a
folder removes it.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path
from shutil import rmtree
from tempfile import gettempdir, mkdtemp

PREFIX = "cosim_"


def scratch() -> Path:
    """The folder of this process."""
    return _made(os.getpid())


@cache
def _made(_process: int) -> Path:
    for left in Path(gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):
            _remove(left, _locked(left))
    while True:
        folder = Path(mkdtemp(prefix=PREFIX))
        lock: int | None = None
        try:
            lock = _locked(folder)
        except BlockingIOError:  # another process takes it for one that is left
            continue
        except OSError:  # no locks there, so that nobody removes what is left
            pass
        if folder.is_dir():
            Finalize(None, _remove, (folder, lock), exitpriority=-1)
            return folder


def _remove(folder: Path, lock: int | None) -> None:
    if lock is not None and sys.platform == "win32":
        os.close(lock)  # an open file cannot be removed there
    rmtree(folder, ignore_errors=True)
    if lock is not None and sys.platform != "win32":
        os.close(lock)


def _locked(folder: Path) -> int:
    """Lock a folder until the lock is closed; raises BlockingIOError if another process has locked it."""
    if sys.platform == "win32":
        import msvcrt

        lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT)
    else:
        lock = os.open(folder, os.O_RDONLY)
    try:
        if sys.platform == "win32":
            msvcrt.locking(lock, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise
    return lock
