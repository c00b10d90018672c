"""A child process for calls that may crash, hang or leave; whatever becomes of one, the caller is told.

The child is a `cosim.child.Child` that is apart, and imports only what its calls need.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, NamedTuple

from cosim.child import Child, Death
from cosim.errors import SetupError

from .. import THREADS

OK, TIMEOUT = "ok", "timeout"
STATUSES = (OK, "refused", "failed", "crashed", TIMEOUT)
MACHINE = "machine"
#: What the operating system lacks, whatever is asked of it: room, open files, memory, a device that
#: works; codes of POSIX.
FAULTS = frozenset(
    {
        errno.ENOSPC,
        errno.EDQUOT,
        errno.EMFILE,
        errno.ENFILE,
        errno.ENOMEM,
        errno.EIO,
        errno.ESTALE,
    }
)
#: How often a child may be killed from outside before its call is given up; chosen: a busy machine may do it once or twice.
MAX_DEATHS = 3
OUTSIDE = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT")
#: How long a child that ends is waited for [s]; chosen: writing its output takes less.
LAST_MOMENTS = 2.0


class Outcome(NamedTuple):
    """What became of a call: its status, answer or message, wall time [s], and its last words.

    The status is "ok", "refused" (SetupError), "failed" (any other exception; `trace` has the
    traceback unless it is a SimulationError), "crashed" (the call ended its process), "timeout", or
    "machine": the machine was short of room, memory or open files, which says nothing of the call.
    """

    status: str
    answer: Any = None
    message: str = ""
    seconds: float = 0.0
    trace: str = ""


class CallWorker:
    """A child process that does one call after the other, and the next process when it dies."""

    def __init__(self) -> None:
        self._child: Any = None
        self._began: float | None = None

    def give(
        self, function: Callable[[Any], Any], task: Any, timeout: float | None, page: str = ""
    ) -> None:
        """Begin function(task) where this question is loaded; from then on it has `timeout` seconds."""
        self._call = page, ForkingPickler.dumps((function, task))
        self._timeout, self._deaths = timeout, 0
        self._send()

    def do(
        self, function: Callable[[Any], Any], task: Any, timeout: float | None, page: str = ""
    ) -> Outcome:
        """What becomes of function(task); blocks."""
        self.give(function, task, timeout, page)
        while (outcome := self.step()) is None:
            wait_for_any([self])
        return outcome

    def handles(self) -> tuple[Any, int]:
        """What to wait for: the pipe has a message, or the child has ended."""
        return self._child.pipe, self._child.process.sentinel

    def step(self) -> Outcome | None:
        """What became of the call, None while it is under way; does not block.

        A child that was killed from outside is replaced and its call done again, three times at
        most. Raises SetupError if no child can be started.
        """
        message = None
        try:
            for message in self._child.messages():
                if isinstance(message, Outcome):
                    return message
                if not isinstance(message, Death):
                    self._began = time.monotonic()
        except Exception as error:  # noqa: BLE001
            return Outcome("failed", message=f"its answer cannot be read: {error}")
        if isinstance(message, Death):
            return self._retry_or_crash()
        if self.left() == 0.0:
            output, _ = self._bury()
            text = f"no answer after {self._timeout:g} s"
            return Outcome(TIMEOUT, None, text, self._timeout or 0.0, output)
        return None

    def left(self) -> float | None:
        """Seconds until the call is too late, None if it never is."""
        if self._timeout is None or self._began is None:
            return None
        return max(self._began + self._timeout - time.monotonic(), 0.0)

    def close(self) -> None:
        """End the child, whatever it does."""
        if self._child is not None:
            self._bury()

    def _send(self) -> None:
        """Give the call to the child, which is started if there is none."""
        self._began = None
        if self._child is None:
            try:
                self._child = Child(_serve, is_apart=True)
            except OSError as error:
                why = error.strerror or error
                raise SetupError(f"no process for runs can be started: {why}") from error
        with contextlib.suppress(OSError):  # the next step sees that the child is dead
            page, content = self._call
            self._child.pipe.send(page)
            self._child.pipe.send_bytes(content)

    def _retry_or_crash(self) -> Outcome | None:
        """The child died: None, and its call sent again, if that came from outside; else what became of it."""
        output, death = self._bury(LAST_MOMENTS)
        outside, began = death in OUTSIDE, self._began
        self._deaths += 1
        if (outside or began is None) and self._deaths < MAX_DEATHS:
            self._send()
            return None
        if began is None:
            why = "".join(output.strip().splitlines()[-1:]) or death
            raise SetupError(f"no process for runs can be started: {why}")
        what = (
            f"its process was killed {MAX_DEATHS} times" if outside else "the run ended its process"
        )
        return Outcome("crashed", None, f"{what}: {death}", time.monotonic() - began, output)

    def _bury(self, grace: float = 0.0) -> tuple[str, str]:
        """The last words of a child, and how it ended."""
        one, self._child = self._child, None
        words, death = one.end(grace)
        return words, death


def wait_for_any(workers: Sequence[CallWorker]) -> None:
    """Block until one of these workers can do a step."""
    left = [seconds for worker in workers if (seconds := worker.left()) is not None]
    handles = [handle for worker in workers for handle in worker.handles()]
    wait(handles, min(left, default=None))


def _serve(pipe: Connection) -> None:
    """Do calls in the child."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            _do_call(pipe, pipe.recv(), pipe.recv_bytes())


def _do_call(pipe: Connection, page: str, content: bytes) -> None:
    """Do a call, once its question is loaded: say that it begins, and what became of it."""
    os.ftruncate(2, 0)
    began = time.perf_counter()
    try:
        if page:
            from ..catalog import load_cached

            load_cached(page)
        function, task = ForkingPickler.loads(content)
        pipe.send("begun")
        began = time.perf_counter()
        answer = function(task)
        reply = ForkingPickler.dumps(Outcome(OK, answer, "", time.perf_counter() - began))
    except BaseException as error:  # noqa: BLE001
        failed = failure(error)._replace(seconds=time.perf_counter() - began)
        reply = ForkingPickler.dumps(failed)
    pipe.send_bytes(reply)


def failure(error: BaseException) -> Outcome:
    """What an exception makes of a call; cosim may not be loaded."""
    if _is_machine_fault(error):
        name = "" if isinstance(error, OSError | ValueError) else f"{type(error).__name__}: "
        return Outcome(MACHINE, message=f"{name}{error}")
    errors: Any = sys.modules.get("cosim")
    if errors and isinstance(error, errors.SetupError):
        return Outcome("refused", message=str(error))
    if errors and isinstance(error, errors.SimulationError):
        return Outcome("failed", message=str(error))
    text = str(error) if getattr(error, "plain", False) else f"{type(error).__name__}: {error}"
    return Outcome("failed", message=text, trace="".join(traceback.format_exception(error)))


def _is_machine_fault(error: BaseException) -> bool:
    """Whether the machine's lack of something is behind an exception.

    The loader of libraries says so by its text alone.
    """
    chain: list[BaseException | None] = [error]
    texts = tuple(os.strerror(code) for code in FAULTS)
    for link in chain:
        if link is None:
            continue
        untold = isinstance(link, OSError) and link.errno is None and str(link).endswith(texts)
        if isinstance(link, MemoryError) or untold:
            return True
        if isinstance(link, OSError) and link.errno in FAULTS:
            return True
        chain += [other for other in (link.__cause__, link.__context__) if other not in chain]
    return False
