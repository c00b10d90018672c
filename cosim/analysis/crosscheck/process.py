"""An instance of an FMU in a process of its own, for FMUs that allow one instance per process."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe
from typing import TypeVar, cast

from ...errors import FmuError

Answer = TypeVar("Answer")


def forked(work: Callable[[], Answer]) -> Answer:
    """What `work` returns in a copy of this process, in which nothing it does leaves a trace here.

    Raises what `work` raises, and FmuError if the copy ends without an answer.
    """
    receiver, sender = Pipe(duplex=False)
    process = os.fork()
    if not process:
        try:
            try:
                sender.send((work(), None))
            except Exception as error:  # noqa: BLE001
                sender.send((None, error))
        finally:
            os._exit(0)
    sender.close()
    answer: Answer | None = None
    failure: Exception | None = FmuError("the process ended without an answer")
    with suppress(EOFError):
        answer, failure = receiver.recv()
    receiver.close()
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    if failure is not None and code < 0:
        raise FmuError(f"the process was killed by signal {-code} (an FMU crashed)")
    if failure is not None:
        raise failure
    return cast(Answer, answer)
