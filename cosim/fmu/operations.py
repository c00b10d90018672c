"""What a step is made of: operations on buffers, called one by one or laid out for loop.c."""

from __future__ import annotations

import ctypes
from enum import IntEnum


class Code(IntEnum):
    """The operations, numbered as in the enumeration of loop.c."""

    #: target = source
    COPY = 0
    #: target = factor * source + offset
    SCALE = 1
    #: target += factor * source + offset
    ADD = 2
    #: target = the mean of an input over time, laid out step by step
    FEED = 3
    #: get or set variables by a function of FMI 2.0
    EXCHANGE = 4
    #: the same by FMI 3.0
    EXCHANGE3 = 5
    #: enter inputs by event mode, if they have changed
    ENTER = 6
    #: a step by FMI 2.0
    STEP = 7
    #: a step by FMI 3.0
    STEP3 = 8
    #: add the work of a step to a side of a bond
    BOOK = 9
    #: stop before a step that reaches an event
    WATCH = 10


#: The status of an operation that read a value which is not finite. A convention: FMI has none below 0.
NOT_FINITE = -(2**31)


class COperation(ctypes.Structure):
    """struct operation of loop.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("code", "count", "checked", "forward", "values")),
        *((name, ctypes.c_void_p) for name in ("function", "component", "references")),
        *((name, ctypes.c_void_p) for name in ("cells", "source", "first", "last")),
        *((name, ctypes.c_double) for name in ("at", "size", "factor", "offset")),
    ]


class Operation:
    """Called with the time [s] at which it is done and the size [s] of the step it belongs to.

    What follows its call in loop.c is the same arithmetic in the same order.
    """

    def __call__(self, t: float, h: float) -> None:
        """Do it; raises FmuError."""
        raise NotImplementedError

    def c_operation(self) -> COperation | None:
        """What loop.c does in its place, but for `at` and `size`; None if it cannot."""
        return None

    def answered(self, t: float, h: float, status: int) -> None:
        """Keep a warning of a call; raise FmuError for a worse status, or NOT_FINITE."""
        raise AssertionError("an operation that cannot fail")
