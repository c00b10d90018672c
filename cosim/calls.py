"""Calls in a child process that may crash, hang or leave: whatever becomes of one is told.

The child is apart, and imports only what its calls need.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, NamedTuple

from .child import WROTE, Child, Death
from .errors import SetupError

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
#: What is said before the reason.
NO_PROCESS = "no process for runs can be started"


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


class Caller:
    """A child process that does one call after the other, and the next process when it dies."""

    def __init__(self) -> None:
        self._child: Child | None = None

    def give(
        self,
        function: Callable[[Any], Any],
        task: Any,
        timeout: float | None,
        prepare: Callable[[], object] | None = None,
    ) -> None:
        """Begin function(task), once `prepare` has made the function known; from then on it has `timeout` seconds."""
        self._call = [ForkingPickler.dumps(x) for x in (prepare, (function, task))]
        self._timeout, self._deaths = timeout, 0
        self._send()

    def do(
        self,
        function: Callable[[Any], Any],
        task: Any,
        timeout: float | None,
        prepare: Callable[[], object] | None = None,
    ) -> Outcome:
        """What becomes of function(task); blocks."""
        self.give(function, task, timeout, prepare)
        while (outcome := self.step()) is None:
            wait_for_any([self])
        return outcome

    def step(self) -> Outcome | None:
        """What became of the call, None while it is under way; does not block.

        A child that was killed from outside is replaced and its call done again, three times at
        most. Raises SetupError if no child can be started.
        """
        assert self._child is not None
        message = None
        try:
            for message in self._child.messages():
                if isinstance(message, Outcome):
                    return message
        except Exception as error:  # noqa: BLE001
            return Outcome("failed", message=f"its answer cannot be read: {error}")
        return self._retry_or_tell(self._child) if isinstance(message, Death) else None

    def close(self) -> None:
        """End the child, whatever it does."""
        if self._child is not None:
            self._child.end()
        self._child = None

    def _send(self) -> None:
        """Give the call to the child, which is started if there is none."""
        if self._child is None:
            try:
                self._child = Child(_serve, is_apart=True, limits="task")
            except OSError as error:
                raise SetupError(f"{NO_PROCESS}: {error.strerror or error}") from error
        self._child.limit = math.inf if self._timeout is None else self._timeout
        self._child.give(*self._call)

    def _retry_or_tell(self, child: Child) -> Outcome | None:
        """What became of a call whose child died; None, and the call sent again, if that came from outside."""
        began, self._child = child.heard, None
        output, death = child.end(LAST_MOMENTS)
        if child.why_killed == WROTE:
            return Outcome("crashed", None, f"its process {WROTE}", trace=output)
        if child.why_killed:
            text = f"no answer after {self._timeout:g} s"
            return Outcome(TIMEOUT, None, text, self._timeout or 0.0, output)
        outside = death in OUTSIDE
        self._deaths += 1
        if (outside or began is None) and self._deaths < MAX_DEATHS:
            self._send()
            return None
        if began is None:
            raise SetupError(f"{NO_PROCESS}: {''.join(output.strip().splitlines()[-1:]) or death}")
        what = (
            f"its process was killed {MAX_DEATHS} times" if outside else "the run ended its process"
        )
        return Outcome("crashed", None, f"{what}: {death}", time.monotonic() - began, output)


def wait_for_any(callers: Sequence[Caller]) -> None:
    """Block until one of these callers can do a step."""
    children = [caller._child for caller in callers if caller._child is not None]  # noqa: SLF001
    left = [seconds for child in children if (seconds := child.left()) is not None]
    wait(
        [x for child in children for x in (child.pipe, child.process.sentinel)],
        min(left, default=None),
    )


def _serve(pipe: Connection) -> None:
    """Do calls in the child: say that each begins, once what it needs is loaded, and what became of it."""
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            prepare, call = pipe.recv_bytes(), pipe.recv_bytes()
            os.ftruncate(2, 0)
            began = time.perf_counter()
            try:
                if (do_first := ForkingPickler.loads(prepare)) is not None:
                    do_first()
                function, task = ForkingPickler.loads(call)
                pipe.send(None)
                began = time.perf_counter()
                outcome = Outcome(OK, function(task), "", time.perf_counter() - began)
                reply = ForkingPickler.dumps(outcome)
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
