"""A folder for temporary files of this process, which is removed when the process ends.

A process that is killed leaves its folder behind. The next process that needs a folder removes it, but only
if the folder carries the mark of this module: a file that names the folder and its number in the file
system (so that a copy carries no valid mark), in a folder of this user that nobody else may open. The mark
is locked as long as its process lives. A folder without a mark is somebody else's, whatever its name.
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
#: A convention of this module: the file in a folder that says whose it is.
MARK = ".cosim-scratch"
#: A convention of this module: more than any mark has.
MARK_BYTES = 4096
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
    folder = Path(mkdtemp(prefix=PREFIX))
    lock = _mark(folder, process)
    Finalize(None, _remove, (folder, lock), exitpriority=-1)
    return folder


def _mark(folder: Path, process: int) -> int:
    """Write the mark of a new folder; returns the file that locks it while it is open.

    The mark is locked before it has its content, so that no other process takes it for a leftover.
    """
    lock = os.open(folder / MARK, os.O_RDWR | os.O_CREAT | os.O_EXCL, stat.S_IRUSR | stat.S_IWUSR)
    with suppress(OSError):  # a file system without locks, where nobody removes what is left
        _lock(lock)
    os.write(lock, f"{_content(folder)}{process}\n".encode())
    return lock


def _content(folder: Path) -> str:
    """The mark of a folder without the number of its process."""
    return f"temporary folder of cosim\n{folder.name}\n{folder.lstat().st_ino}\n"


def _remove_leftover(folder: Path) -> None:
    """Remove a folder if its mark is valid and its process has ended.

    Raises
    ------
    OSError
        If the folder has no mark, or if its process lives and locks the mark.
    """
    if not _is_own(folder.lstat(), stat.S_ISDIR):
        return
    if sys.platform != "win32" and stat.S_IMODE(folder.lstat().st_mode) != PRIVATE:
        return
    mark = folder / MARK
    if not _is_own(mark.lstat(), stat.S_ISREG):
        return
    lock = os.open(mark, os.O_RDWR)
    try:
        if not os.read(lock, MARK_BYTES).startswith(_content(folder).encode()):
            raise FileNotFoundError(mark)
        _lock(lock)
        if not os.path.samestat(os.fstat(lock), mark.lstat()):
            raise FileNotFoundError(mark)  # another process removed that folder meanwhile
    except OSError:
        os.close(lock)
        raise
    _remove(folder, lock)


def _is_own(status: os.stat_result, has_kind: Callable[[int], bool]) -> bool:
    """Whether a file is of the kind and belongs to this user; a link is of neither kind."""
    return has_kind(status.st_mode) and (sys.platform == "win32" or status.st_uid == os.geteuid())


def _remove(folder: Path, lock: int) -> None:
    if sys.platform == "win32":
        os.close(lock)  # an open file cannot be removed there
    rmtree(folder, ignore_errors=True)
    if sys.platform != "win32":
        os.close(lock)


def _lock(file: int) -> None:
    """Lock an open file until it is closed; raises BlockingIOError if another process has locked it."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(file, 0, os.SEEK_SET)
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
