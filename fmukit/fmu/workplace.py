"""Where a build works, and who works for it: nothing and nobody is left behind, however the build ends.

All that is not finished is in one folder beside what is built, which the build locks. If it is killed, the next
build there finds the folder unlocked and removes it. Its processes end with it, and their compilers with them.
"""

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait
from pathlib import Path
from shutil import rmtree
from types import FrameType
from typing import TypeVar

from filelock import lock_descriptor

Task = TypeVar("Task")
Result = TypeVar("Result")

PREFIX = ".building-"
#: The file that marks a folder as a build's own, and that the build locks.
OWNER = "owner"

STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextmanager
def workplace(out: Path) -> Iterator[Path]:
    """A locked folder in the folder of the FMUs; those of builds that have ended are removed first."""
    out.mkdir(parents=True, exist_ok=True)
    for left in out.glob(f"{PREFIX}*"):
        with suppress(OSError):
            _remove_if_abandoned(left)
    folder, lock = _new_locked_folder(out)
    try:
        yield folder
    finally:
        _remove(folder, lock)


def _new_locked_folder(out: Path) -> tuple[Path, int]:
    """A folder that nobody else removes, and its lock."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=out.absolute()))
        try:
            lock = os.open(folder / OWNER, os.O_RDWR | os.O_CREAT)
        except FileNotFoundError:  # another build took the folder for one that was left
            continue
        with suppress(OSError):  # a file system without locks, where nobody removes what is left
            lock_descriptor(lock, blocking=False)
        if (folder / OWNER).exists():
            return folder, lock
        os.close(lock)


def _remove_if_abandoned(folder: Path) -> None:
    """Remove the folder of a build that has ended."""
    if folder.is_symlink():
        return
    if not (folder / OWNER).is_file():
        folder.rmdir()  # of a build that was killed before it had a lock; anything else is not empty
        return
    lock = os.open(folder / OWNER, os.O_RDWR)
    if lock_descriptor(lock, blocking=False):
        _remove(folder, lock)
    else:
        os.close(lock)


def _remove(folder: Path, lock: int) -> None:
    """Remove a locked folder and its lock; where a compiler that ends still writes, the next build removes the rest."""
    if sys.platform == "win32":
        os.close(lock)  # an open file cannot be removed there
    rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        (folder / OWNER).touch()
    if sys.platform != "win32":
        os.close(lock)


def put_in_place(candidate: Path, target: Path) -> None:
    """Put a finished file in its place; a loss of power leaves the old one or the new one there."""
    with candidate.open("r+b") as file:
        os.fsync(file.fileno())
    target.parent.mkdir(parents=True, exist_ok=True)
    candidate.replace(target)
    if os.name == "posix":
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def results(
    function: Callable[[Task], Result], tasks: Sequence[Task], folder: Path
) -> Iterator[Result]:
    """What the function makes of each task, in order, each core a task, with temporary files in the folder.

    Raises BrokenProcessPool if one of the processes is killed.
    """
    others = {*multiprocessing.active_children()}
    count = max(1, min(len(tasks), os.cpu_count() or 1))
    with ProcessPoolExecutor(count, initializer=_begin_worker, initargs=(folder,)) as pool:
        futures = [pool.submit(function, task) for task in tasks]
        try:
            for future in futures:
                yield future.result()
        except BaseException:
            for child in {*multiprocessing.active_children()} - others:
                child.terminate()
            pool.shutdown(cancel_futures=True)
            raise


def _begin_worker(folder: Path) -> None:
    """Make this process one that works for a build: the build hears Ctrl-C, and this ends with it and takes its compilers along."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)
    if sys.platform != "win32":
        os.setsid()
        signal.signal(signal.SIGTERM, _leave)
    tempfile.tempdir = str(folder)
    # what the compiler keeps of a model goes with the folder; else its cache grows for ever
    os.environ.setdefault("ZIG_LOCAL_CACHE_DIR", str(folder / "zig"))
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def _leave_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    _leave()


def _leave(*_: object) -> None:
    """End this process and those that it has begun: a compiler and what that begins."""
    if sys.platform != "win32":
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt for whatever asks to stop, once, as far as it is not ignored.

    Only the main thread can: in any other nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    process = os.getpid()
    heard = [n for n in STOPS if signal.getsignal(n) not in (signal.SIG_IGN, None)]

    def stop(_number: int, _frame: FrameType | None) -> None:
        if os.getpid() != process:  # a child that has not begun yet
            os._exit(1)
        for number in heard:
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
