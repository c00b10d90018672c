"""Child processes for FMUs, which may crash, hang or be killed; they die with their parent and leave nothing behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from shutil import rmtree
from tempfile import TemporaryDirectory
from typing import Any

from .scratch import scratch

#: Time for the child to close its files or to react to a signal [s]: a convention of this project, which
#: limits how long a stuck FMU holds up the end.
GRACE = 10.0
#: Signals of a process that has crashed.
CRASHES = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")


@contextmanager
def child(
    work: Callable[..., None], *arguments: Any, grace: float = 0.0
) -> Iterator[tuple[BaseProcess, Connection]]:
    """A process that does work(pipe, *arguments), and our end of the pipe; it is ended after a while [s].

    Its temporary files go with it. It ignores Ctrl-C until it wants to hear it.
    """
    context = multiprocessing.get_context("spawn")
    with TemporaryDirectory(dir=scratch()) as folder:
        ours, its = context.Pipe()
        process = context.Process(target=_begin, args=(folder, work, its, *arguments))
        with _ignore_sigint():
            process.start()
        its.close()
        try:
            yield process, ours
        finally:
            ours.close()
            process.join(grace)
            process.kill()
            process.join()


def _begin(folder: str, work: Callable[..., None], *arguments: Any) -> None:
    threading.Thread(target=_die_with_parent, args=(folder,), daemon=True).start()
    tempfile.tempdir = os.environ["TMPDIR"] = folder
    work(*arguments)


def _die_with_parent(folder: str) -> None:
    """Leave no trace when the parent is gone."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    rmtree(folder, ignore_errors=True)
    os._exit(1)


@contextmanager
def _ignore_sigint() -> Iterator[None]:
    """Ignore Ctrl-C, as a child that is started then does until it is ready to hear it."""
    try:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # only the main thread may, and only there Ctrl-C is heard
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def death(process: BaseProcess) -> str:
    """How a process ended."""
    code = process.exitcode or 0
    if code >= 0:
        return f"ended with exit code {code} (an FMU ended it)"
    name = signal.Signals(-code).name
    return f"was killed by signal {name}" + (" (an FMU crashed)" if name in CRASHES else "")
