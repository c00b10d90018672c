"""An instance of an FMU in a process of its own, for FMUs that allow one instance per process."""

from __future__ import annotations

import os
from collections.abc import Callable
from multiprocessing import Pipe
from typing import TypeVar

from ...errors import PartFailure

Answer = TypeVar("Answer")


def forked(work: Callable[[], Answer]) -> Answer:
    """What `work` returns in a copy of this process, in which nothing it does leaves a trace here.

    Raises what `work` raises, and PartFailure if the copy ends without an answer.
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
    try:
        answer, error = receiver.recv()
    except EOFError:
        answer, error = None, PartFailure("the process ended without an answer")
    finally:
        receiver.close()
        code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    if isinstance(error, PartFailure) and code < 0:
        raise PartFailure(f"the process was killed by signal {-code} (an FMU crashed)")
    if error is not None:
        raise error
    return answer
