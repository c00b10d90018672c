"""Child processes, which may crash, hang or be killed; they die with their parent and leave nothing behind.

A child leads a session of its own, whose processes end with it, and has a folder for its temporary files. It ignores
Ctrl-C until it wants to hear it.
"""

from __future__ import annotations

import ctypes
import faulthandler
import math
import multiprocessing
import os
import signal
import socket
import struct
import sys
import tempfile
import threading
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib.machinery import ModuleSpec
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from shutil import rmtree
from typing import Any, Concatenate, Literal, NamedTuple

from .scratch import scratch

#: Time for the child to close its files or to react to a signal [s]: a convention of this project, which
#: limits how long a stuck FMU holds up the end.
GRACE = 10.0
#: Least time between two messages on the progress [s]: a convention of this project, which limits their number.
BETWEEN = 0.05
#: Time between two looks at whether a process has ended [s]. Chosen: it ends in a few of them.
PAUSE = 1e-3
#: Bytes that are dropped at a time of what does not belong into a pipe. A convention.
MOST_JUNK = 1 << 16
#: Why a process was killed whose FMU has written into the pipes between it and this one.
WROTE = "wrote what is no message into the pipes to its parent and was ended (an FMU writes into files that are not its own)"
#: Signals of a process that has crashed.
CRASHES = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")
#: The file in the folder of a child that is heard by nobody, with what it prints.
OUTPUT_FILE = "words"
#: Letters of a child's output that are reported, its last; chosen: a traceback.
TRACE = 4000
#: The signal that Linux sends when the parent dies: a number of prctl.
PARENT_DEATH_SIGNAL = 1

_SPAWN = multiprocessing.get_context("spawn")
_STARTING = threading.Lock()


class Death(NamedTuple):
    """How a process ended, as the rest of a sentence about it."""

    how: str


class Child:
    """A process that does work(pipe, *arguments), and our end of the pipe.

    One that is apart does not import the script that starts it, what it prints are its last words, and its BLAS has one
    thread. A process is killed that is silent for longer than its `limit` [s], or takes longer for a task if this is what
    it `limits`; both count from the first message after a task was given. Raises OSError, and leaves nothing, where no process can be
    started.
    """

    def __init__(
        self,
        work: Callable[Concatenate[Connection, ...], None],
        *arguments: Any,
        is_apart: bool = False,
        limits: Literal["silence", "task"] = "silence",
    ) -> None:
        with ExitStack() as undo:
            self._folder = Path(tempfile.mkdtemp(dir=scratch()))
            undo.callback(rmtree, self._folder, ignore_errors=True)
            output = (self._folder / OUTPUT_FILE).open("a+", errors="replace")
            self._output = undo.enter_context(output)
            self.pipe, its = _SPAWN.Pipe()
            undo.callback(self.pipe.close)
            _limit_stalls(self.pipe)
            told = (str(self._folder), work, its, *arguments)
            how = {"is_apart": is_apart}
            self.process = _SPAWN.Process(target=_live, args=told, kwargs=how, daemon=is_apart)
            with its, _without_ctrl_c(is_apart=is_apart):
                self.process.start()
            undo.pop_all()
        self.limit, self._limits = math.inf, limits
        self.heard: float | None = None
        self.why_killed, self._told_to_stop = "", math.inf

    def give(self, *pieces: bytes | memoryview[int]) -> None:
        """Let the process have a task; one that has died is seen by who reads its messages."""
        self.heard = None
        with suppress(OSError):
            for piece in pieces:
                self.pipe.send_bytes(piece)

    def left(self) -> float | None:
        """Seconds until it is killed, None if it never is."""
        if self.heard is None or self.limit == math.inf:
            return None
        return max(self.heard + self.limit - clock.monotonic(), 0.0)

    def messages(self, patience: float = 0.0) -> Iterator[Any]:
        """What the process has sent, waiting so long for it [s]; at its end a `Death` is the last."""
        limit = None if patience == math.inf else patience
        ready = wait([self.pipe, self.process.sentinel], limit)
        if self.process.sentinel in ready and self._is_ending():
            self._ends(GRACE)  # it closes its files one by one
        is_alive = self.process.is_alive()
        try:
            while self.pipe.poll():
                message = self.pipe.recv()
                if self.heard is None or self._limits == "silence":
                    self.heard = clock.monotonic()
                yield message
        except BlockingIOError:  # what it has begun to send does not come
            self.why_killed = WROTE
            self.process.kill()
        except (EOFError, OSError):
            self._ends(GRACE)
            is_alive = False
        if not is_alive:
            yield Death(self.why_killed or death(self.process))
        elif self.left() == 0.0 and not self.why_killed:
            self.why_killed = f"did not respond for {self.limit:g} s and was ended"
            self.process.kill()

    def _is_ending(self) -> bool:
        """Whether the pipe that tells of its end is closed, not only written into, as an FMU may: that is dropped."""
        return sys.platform == "win32" or not os.read(self.process.sentinel, MOST_JUNK)

    def _ends(self, seconds: float) -> bool:
        """Whether the process ends within a while [s], whatever stands in the pipe that tells of it."""
        latest = clock.monotonic() + seconds
        while (is_alive := self.process.is_alive()) and clock.monotonic() < latest:
            clock.sleep(PAUSE)
        return not is_alive

    def pass_on(self, stops: Sequence[int]) -> None:
        """Pass on the first of the signals that ask to stop; a second one kills, and so does another one than Ctrl-C after GRACE."""
        if stops and stops[0] != signal.SIGINT:
            self._told_to_stop = min(self._told_to_stop, clock.monotonic())
        if len(stops) > 1 or clock.monotonic() > self._told_to_stop + GRACE:
            self.process.kill()
        elif stops and self.process.pid is not None:
            os.kill(self.process.pid, signal.SIGINT)

    def end(self, grace: float = 0.0) -> tuple[str, str]:
        """The last words of the process and how it ended, by itself within a while [s]; what it leaves is removed."""
        self.pipe.close()
        if not self._ends(grace):
            with suppress(AttributeError, OSError):
                os.killpg(self.process.pid or 0, signal.SIGKILL)
            self.process.kill()
        self.process.join()
        code = self.process.exitcode or 0
        self._output.seek(0)
        words = self._output.read()[-TRACE:]
        self._output.close()
        rmtree(self._folder, ignore_errors=True)
        return words, signal.Signals(-code).name if code < 0 else f"exit code {code}"


def _limit_stalls(pipe: Connection) -> None:
    """Let a message that has begun and does not go on for GRACE raise BlockingIOError, where the system can."""
    if sys.platform != "win32":
        with socket.socket(fileno=os.dup(pipe.fileno())) as end:
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", int(GRACE), 0))


@contextmanager
def child(
    work: Callable[Concatenate[Connection, ...], None], *arguments: Any, grace_seconds: float = 0.0
) -> Iterator[Child]:
    """A process that does work(pipe, *arguments); it is killed `grace_seconds` after the body."""
    one = Child(work, *arguments)
    try:
        yield one
    finally:
        one.end(grace_seconds)


def death(process: BaseProcess) -> str:
    """How a process that ran FMUs ended."""
    code = process.exitcode or 0
    if code >= 0:
        return f"ended with exit code {code} (an FMU ended it)"
    name = signal.Signals(-code).name
    return f"was killed by signal {name}" + (" (an FMU crashed)" if name in CRASHES else "")


def progress_sender(pipe: Connection) -> Callable[[float], None]:
    """A function that tells the parent how much is done, now and then."""
    sent_at = -math.inf

    def send(done: float) -> None:
        nonlocal sent_at
        if clock.monotonic() > sent_at + BETWEEN:
            pipe.send(("progress", done))
            sent_at = clock.monotonic()

    return send


@contextmanager
def _without_ctrl_c(*, is_apart: bool) -> Iterator[None]:
    """A child that starts hears no Ctrl-C, and if it is apart does not import the script that starts it."""
    with _STARTING, ExitStack() as after:
        if is_apart:
            main = sys.modules["__main__"]
            after.callback(setattr, main, "__spec__", main.__spec__)
            main.__spec__ = ModuleSpec("hidden.__main__", None)
        if sys.platform != "win32":
            from multiprocessing import resource_tracker

            resource_tracker.ensure_running()  # it unblocks signals when it starts
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
            after.callback(signal.pthread_sigmask, signal.SIG_SETMASK, mask)
        yield


def _live(
    folder: str, work: Callable[..., None], pipe: Connection, *arguments: Any, is_apart: bool
) -> None:
    """The life of a child."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if is_apart:
        output = os.open(Path(folder) / OUTPUT_FILE, os.O_WRONLY | os.O_APPEND)
        for stream in (1, 2):
            os.dup2(output, stream)
        os.environ.update({name: "1" for name in os.environ if name.endswith("_NUM_THREADS")})
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_exit_with_parent, args=(parent.sentinel, folder), daemon=True).start()
    if sys.platform == "linux":  # at once, also from code that gives Python no turn
        ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, int(signal.SIGKILL))
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
        os.setsid()
        os.set_inheritable(pipe.fileno(), False)
    if is_apart:
        faulthandler.enable(all_threads=False)
    tempfile.tempdir = os.environ["TMPDIR"] = folder
    multiprocessing.current_process().daemon = False  # it may have children of its own
    work(pipe, *arguments)


def _exit_with_parent(parent: int, folder: str) -> None:
    """Leave no trace when the parent is gone."""
    wait([parent])
    rmtree(folder, ignore_errors=True)
    os._exit(1)
