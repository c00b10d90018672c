"""The loop of fixed-step runs in C: loop.c, compiled by ziglang, in the wheel for every platform."""

from __future__ import annotations

import ctypes
import platform
import sys
from array import array
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

from ..errors import FmuError
from ..fmu.blocks import VariableBlock
from ..fmu.buffers import Slot, address
from ..fmu.messages import WARNING
from ..fmu.operations import COperation
from .compiler import SOURCE, compile_loop, file_name, loop_of_sources
from .part import StepOperation
from .schedule import TimedOperation
from .sources import InputSource
from .structures import DOUBLE, INT, LONG, PLACE, structures

ARGUMENTS: Any = [PLACE, PLACE, INT, INT, PLACE, INT, *[DOUBLE] * 2, *[LONG] * 3, PLACE, PLACE]
MEMBER_ARGUMENTS: Any = [*[PLACE] * 3, LONG, LONG, PLACE, PLACE, LONG, *[PLACE] * 3]


Column = structures(SOURCE.read_text())["column"]


def compiled_library() -> ctypes.CDLL:
    """The compiled loop: the one that came with the package, or one made here of its source.

    Raises OSError with the reason if there is none.
    """
    loop = _library_or_reason()
    if isinstance(loop, OSError):
        raise loop
    return loop


@cache
def _library_or_reason() -> ctypes.CDLL | OSError:
    """The same, or the reason: what cannot be made is tried once."""
    name = file_name(sys.platform, platform.machine())
    path = SOURCE.parent / "compiled" / name
    try:
        if not path.exists():
            path = loop_of_sources()
            if not path.exists() or not path.stat().st_size:
                compile_loop(path)
        loop = ctypes.CDLL(str(path))
    except OSError as error:
        return error
    loop.take_steps.argtypes = ARGUMENTS
    loop.run_members.argtypes = MEMBER_ARGUMENTS
    loop.run_members.restype = None
    return loop


class Program(NamedTuple):
    """Operations laid out for loop.c; those from `row_begin` on are done before a row."""

    operations: list[TimedOperation]
    c_operations: list[COperation]
    row_begin: int


def lay_out(steps: Sequence[TimedOperation], extra: Sequence[VariableBlock]) -> Program | None:
    """The program of these steps and of blocks to get before a row; None if an operation needs Python."""
    operations = [*steps, *(TimedOperation(block, 1.0, 0.0) for block in extra)]
    c_operations = []
    for operation, at, size in operations:
        c_operation = operation.c_operation()
        if c_operation is None:
            return None
        c_operation.at, c_operation.size = at, size
        c_operations.append(c_operation)
    return Program(operations, c_operations, len(steps))


class Loop:
    """Fixed steps of a program, a row of `columns` after the time and after every `every`-th step.

    Raises OSError with the reason if there is no compiled loop.
    """

    def __init__(self, program: Program, columns: Sequence[Slot], every: int) -> None:
        self._take_steps = compiled_library().take_steps
        self.operations = program.operations
        self.c_operations = (COperation * len(program.c_operations))(*program.c_operations)
        self._warned = (ctypes.c_longlong * len(self.operations))()
        self._feeds = [
            k
            for k, timed in enumerate(program.operations)
            if isinstance(timed.operation, InputSource)
        ]
        self._parts = [
            timed.operation.part
            for timed in program.operations
            if isinstance(timed.operation, StepOperation)
        ]
        self.row_begin = program.row_begin
        cells = (Column(slot.address, ord(slot.kind._type_)) for slot in columns)
        self.columns = (Column * len(columns))(*cells)
        self._width = len(columns) + 1
        self._every = every

    def run(
        self, start: float, h: float, first: int, last: int
    ) -> tuple[array[float], int, FmuError | None]:
        """Take steps first + 1 to last of size h [s] from `start` on.

        Returns the rows, one after the other, the last step that was completed, and the failure
        that ended it there.
        """
        rows = array("d", [0.0]) * (self._width * ((last - first) // self._every + 1))
        laid_out = []
        for k in self._feeds:
            feed, at, size = self.operations[k]
            assert isinstance(feed, InputSource)
            times = (start + n * h + at * h for n in range(first, last))
            means = [feed.profile.mean(t, size * h) for t in times]
            laid_out.append((ctypes.c_double * len(means))(*means))
            self.c_operations[k].source = address(laid_out[-1])
        report = (ctypes.c_longlong * 3)()
        count = self._take_steps(
            self.c_operations, self._warned, len(self.c_operations), self.row_begin,
            self.columns, len(self.columns), start, h, first, last, self._every,
            rows.buffer_info()[0], report,
        )  # fmt: skip
        done, failed, status = report
        for part in self._parts:
            part.do_steps += part.substeps * (done - first)
        answers = [(k, n - 1, WARNING) for k, n in enumerate(self._warned) if n]
        answers += [(failed, done, status)] if failed >= 0 else []
        failure = None
        try:
            for k, n, answer in answers:
                operation, at, size = self.operations[k]
                operation.answered(start + n * h + at * h, size * h, answer)
        except FmuError as error:
            failure = error
        del rows[count * self._width :]
        return rows, done, failure
