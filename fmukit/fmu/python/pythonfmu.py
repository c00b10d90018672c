"""Only the traps of pythonfmu 0.7.0, whose C wrapper runs an FMU in Python.

The wrapper turns any exception into fmi2Fatal and then drops its references to the class, the instance
and the log queue once too often. A `CallError` gives them back, so that the instance can still be reset,
rolled back and freed. The wrapper recognises slaves by a base class called Fmi2Slave.
"""

from __future__ import annotations

import _ctypes
import atexit
import contextlib
import ctypes
import functools
import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar

#: A convention of FMI 2.0: the number of fmi2Warning.
WARNING = 1
#: A convention of all FMUs made by this kit: the attribute of `sys` that names the interpreter's first wrapper.
FIRST_WRAPPER = "pythonfmu_first_wrapper"
#: A convention of Linux, see proc(5): range, permissions, offset, device and inode, which identify a mapping.
MAPPING_FIELDS = 5
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


class CallError(Exception):
    """Why an FMI call failed; its repr is the text that the wrapper logs."""

    def __repr__(self) -> str:
        return escape_percent(str(self))


def escape_percent(text: str) -> str:
    """Escape a message, since FMI loggers take it as a printf format."""
    return text.replace("%", "%%")


def keep_thread_state() -> None:
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
def release_interpreter_at_exit(resources: str, model: str) -> None:
    """Have the wrapper release the interpreter before its process ends, and only then.

    The wrapper that started the interpreter ends it when its host closes the library: in a thread for
    which the closing call waits with the loader's lock held, and under the instances of all other FMUs.
    The first wrapper of an interpreter is therefore never unloaded. At exit a wrapper that is still
    loaded would release the interpreter twice, the second time by a write to memory that is free by
    then. Its function is looked up now, since nothing may ask the loader while the interpreter ends.
    """
    if sys.platform != "linux":
        return
    path = os.path.normpath(f"/{resources.lstrip('/')}/../binaries/linux64/{model}.so")
    stays = os.RTLD_NODELETE if vars(sys).setdefault(FIRST_WRAPPER, path) == path else 0
    try:
        wrapper = ctypes.CDLL(path, os.RTLD_NOLOAD | os.RTLD_NOW | stays)
    except OSError:  # loaded from another place
        return
    release = wrapper.finalizePythonInterpreter
    address = ctypes.cast(release, ctypes.c_void_p).value or 0
    mapping = memory_mapping_at(address)
    _ctypes.dlclose(wrapper._handle)

    def let_go() -> None:
        if mapping and memory_mapping_at(address) == mapping:  # otherwise unloaded
            release()

    atexit.register(let_go)


def memory_mapping_at(address: int) -> list[bytes]:
    """Which part of which file is mapped where the address is; empty if none is."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/maps").read_bytes().splitlines():
            begin, end = (int(bound, 16) for bound in line.split(maxsplit=1)[0].split(b"-"))
            if begin <= address < end:
                return line.split()[:MAPPING_FIELDS]
    return []


def guarded(method: Method) -> Method:
    """No exception leaves a callback but a CallError that the wrapper survives."""

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
            release_interpreter_at_exit(resources, type(self).__name__)
            while resources in sys.path:  # where the wrapper puts it for every instance
                sys.path.remove(resources)

    def _get_log_queue(self) -> list[Message]:
        return self.log_queue

    def warn(self, sentence: str) -> None:
        """Queue a warning for the host's log; never once per step, the wrapper leaks on it."""
        text = escape_percent(f"{self.instance_name}: {sentence}")
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
        raise CallError(f"{self.instance_name}: {'; '.join(reasons)}") from None
