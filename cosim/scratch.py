"""A folder for temporary files of this process, which is removed when the process ends.

A process that is killed leaves its folder behind. The next process that needs a folder removes it, but only
if the folder carries the mark of this module: a file that names the folder and its number in the file
system (so that a copy carries no valid mark), in a folder of this user that nobody else may open. The folder
is locked as long as its process lives. A process may be killed before it has written the mark: a folder with
the whole name of this module, in which nothing is yet, is removed too. Any other folder without a mark is
somebody else's, whatever its name.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path
from shutil import rmtree
from tempfile import gettempdir, mkdtemp

#: A convention of this module: what the names of its folders begin with.
PREFIX = "cosim_"
#: A convention of this module: what the names of its folders end with, which nobody else takes by chance.
SUFFIX = ".cosim-scratch"
#: A convention of this module: the file that Windows locks, in place of its folder.
LOCK = "lock"
#: The file in a folder that says whose it is: derived from the end of the folder's name.
MARK = SUFFIX
#: A convention of POSIX and of `mkdtemp`: only its user may open the folder.
PRIVATE = 0o700


def scratch() -> Path:
    """The folder of this process."""
    return _folder_of(os.getpid())


@cache
def _folder_of(process: int) -> Path:
    for folder in Path(gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):
            _remove_leftover(folder)
    while True:
        folder = Path(mkdtemp(prefix=PREFIX, suffix=SUFFIX))
        lock: int | None = None
        try:
            lock = _locked(folder)
        except BlockingIOError:  # an earlier version of this module removes whatever is not locked
            continue
        except OSError:  # a file system without locks, where nobody removes what is left
            pass
        if not folder.is_dir():
            continue
        with suppress(OSError):  # a full disk, which what is written next reports
            (folder / MARK).write_text(f"{_mark_of(folder)}{process}\n", encoding="utf-8")
        Finalize(None, _remove, (folder, lock), exitpriority=-1)
        return folder


def _mark_of(folder: Path) -> str:
    """The mark of a folder without the number of its process."""
    return f"temporary folder of cosim\n{folder.name}\n{folder.lstat().st_ino}\n"


def _remove_leftover(folder: Path) -> None:
    """Remove a folder if it is one of this module's and its process has ended.

    Raises
    ------
    OSError
        If the folder cannot be read, or if its process lives and locks the folder.
    """
    status = folder.lstat()
    if not _belongs_to_user(status, stat.S_ISDIR):
        return
    if sys.platform != "win32" and stat.S_IMODE(status.st_mode) != PRIVATE:
        return
    if not _is_empty(folder) and not _is_marked(folder):
        return
    lock = _locked(folder)
    if folder.is_dir() and os.path.samestat(status, folder.lstat()):
        _remove(folder, lock)
    else:  # another process has removed it meanwhile
        os.close(lock)


def _is_empty(folder: Path) -> bool:
    """Whether a folder has the whole name of this module, and nothing in it but what comes before the mark."""
    return folder.name.endswith(SUFFIX) and all(
        file.name == LOCK or (file.name == MARK and file.lstat().st_size == 0)
        for file in folder.iterdir()
    )


def _is_marked(folder: Path) -> bool:
    """Whether a folder carries a valid mark; raises OSError if it carries none."""
    mark = folder / MARK
    return _belongs_to_user(mark.lstat(), stat.S_ISREG) and mark.read_text(
        encoding="utf-8", errors="replace"
    ).startswith(_mark_of(folder))


def _belongs_to_user(status: os.stat_result, has_kind: Callable[[int], bool]) -> bool:
    """Whether a file is of the kind and belongs to this user; a link is of neither kind."""
    return has_kind(status.st_mode) and (sys.platform == "win32" or status.st_uid == os.geteuid())


def _remove(folder: Path, lock: int | None) -> None:
    if lock is not None and sys.platform == "win32":
        os.close(lock)  # an open file cannot be removed there
    rmtree(folder, ignore_errors=True)
    if lock is not None and sys.platform != "win32":
        os.close(lock)


def _locked(folder: Path) -> int:
    """Lock a folder until the lock is closed; raises BlockingIOError if another process has locked it."""
    from filelock import lock_descriptor  # which few processes need

    if sys.platform == "win32":
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT)
    else:
        lock = os.open(folder, os.O_RDONLY)
    try:
        if not lock_descriptor(lock, blocking=False):
            raise BlockingIOError
    except OSError:
        os.close(lock)
        raise
    return lock
