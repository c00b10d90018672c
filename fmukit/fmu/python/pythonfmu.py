"""Only the traps of pythonfmu 0.7.0, whose C wrapper runs an FMU in Python.

The wrapper turns any exception into fmi2Fatal and then drops its references to the class, the instance
and the log queue once too often. A `Failure` gives them back, so that the instance can still be reset,
rolled back and freed. The wrapper recognises slaves by a base class called Fmi2Slave.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import functools
import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn, TypeVar

WARNING = 1
STUB = """\
# pythonfmu 0.7.0 runs this file once per instance and then releases a reference
# to its namespace that it does not own: give one back each time.
import ctypes

from {module} import slave_class

ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))
"""

_adopted = threading.local()
_stepped: deque[int] = deque(maxlen=64)
Method = TypeVar("Method", bound=Callable[..., Any])


class Message(NamedTuple):
    """A log message as the wrapper reads it."""

    status: int
    category: str
    msg: str


class Failure(Exception):
    """Why an FMI call failed; its repr is the text that the wrapper logs."""

    def __repr__(self) -> str:
        return printable(str(self))


def printable(text: str) -> str:
    """Escape a message, since FMI loggers take it as a printf format."""
    return text.replace("%", "%%")


def adopt_thread() -> None:
    """Keep the Python thread state of a host's thread alive from its second step on.

    Without it CPython makes and destroys one at every FMI call from a thread it does not know;
    with it at the first step, a host that starts a thread per step would pile them up.
    """
    if hasattr(_adopted, "done"):
        return
    thread = threading.get_native_id()
    if thread in _stepped:
        ctypes.pythonapi.PyGILState_Ensure()
        _adopted.done = True
    _stepped.append(thread)


@functools.cache
def let_go_at_exit(resources: str, model: str) -> None:
    """Have the wrapper release the interpreter before its process ends.

    On Linux the first wrapper of a process stays loaded whatever its host does, for its symbols are
    unique. At exit it would release the interpreter twice, the second time by a write to memory that
    is free by then.
    """
    wrapper = f"/{resources.lstrip('/')}/../binaries/linux64/{model}.so"

    def let_go() -> None:
        with contextlib.suppress(OSError):  # unloaded
            ctypes.CDLL(
                os.path.normpath(wrapper), os.RTLD_NOLOAD | os.RTLD_NOW
            ).finalizePythonInterpreter()

    if sys.platform == "linux":
        atexit.register(let_go)


def guarded(method: Method) -> Method:
    """No exception leaves a callback but a Failure that the wrapper survives."""

    @functools.wraps(method)
    def call(self: Fmi2Slave, *args: Any) -> Any:
        try:
            return method(self, *args)
        except BaseException as error:  # noqa: BLE001
            self.fail(error)

    return call  # type: ignore[return-value]


class Fmi2Slave:
    """An instance as the wrapper makes it, and its log."""

    def __init__(self, instance_name: str, resources: str = "", **_: Any) -> None:
        self.instance_name = instance_name
        self.log_queue: list[Message] = []
        if resources:
            let_go_at_exit(resources, type(self).__name__)
            while resources in sys.path:  # where the wrapper puts it for every instance
                sys.path.remove(resources)

    def _get_log_queue(self) -> list[Message]:
        return self.log_queue

    def warn(self, sentence: str) -> None:
        """Queue a warning for the host's log; never once per step, the wrapper leaks on it."""
        text = printable(f"{self.instance_name}: {sentence}")
        self.log_queue.append(Message(WARNING, "logStatusWarning", text))

    def fail(self, error: BaseException) -> NoReturn:
        """Raise what the wrapper can report, and give its references back."""
        reason = str(error) or type(error).__name__
        if not isinstance(error, ValueError | ArithmeticError):
            reason = f"{type(error).__name__}: {reason}"
        reasons = [*(message.msg.replace("%%", "%") for message in self.log_queue), reason]
        self.log_queue.clear()
        for owner in (type(self), self, self.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(owner))
        raise Failure(f"{self.instance_name}: {'; '.join(reasons)}") from None
