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
from ..fmu.operations import COperation, Operation
from .compiler import SOURCE, compile_loop, file_name, loop_of_sources
from .control import EqualSteps
from .part import StepOperation
from .schedule import TimedOperation
from .sources import InputSource

INT, LONG, DOUBLE, PLACE = ctypes.c_int, ctypes.c_longlong, ctypes.c_double, ctypes.c_void_p
ARGUMENTS: Any = [
    PLACE,
    PLACE,
    INT,
    INT,
    PLACE,
    INT,
    *[DOUBLE] * 2,
    *[LONG] * 4,
    DOUBLE,
    PLACE,
    PLACE,
]
#: Means of inputs over time that are kept for further runs. Chosen: 8 MB of them.
MOST_MEANS = 10**6


class ColumnCell(ctypes.Structure):
    """The structure `column` of loop.c: a cell, and the letter of its type."""

    _fields_ = [("cell", PLACE), ("type", INT)]


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
    return loop


class Program(NamedTuple):
    """Operations laid out for loop.c; those before `begin` look for events, those from `row_begin` on are done before a row."""

    operations: list[TimedOperation]
    c_operations: list[COperation]
    begin: int
    row_begin: int


def lay_out(
    watches: Sequence[Operation], steps: Sequence[TimedOperation], extra: Sequence[VariableBlock]
) -> Program | None:
    """The program of these steps, and of what is done before one and before a row; None if an operation needs Python."""
    before = (TimedOperation(watch, 0.0, 1.0) for watch in watches)
    operations = [*before, *steps, *(TimedOperation(block, 1.0, 0.0) for block in extra)]
    c_operations = []
    for operation, at, size in operations:
        c_operation = operation.c_operation()
        if c_operation is None:
            return None
        c_operation.at, c_operation.size = at, size
        c_operations.append(c_operation)
    return Program(operations, c_operations, len(watches), len(watches) + len(steps))


class Loop:
    """Steps of a program, with rows of `columns` after the time.

    Raises OSError with the reason if there is no compiled loop.
    """

    def __init__(self, program: Program, columns: Sequence[Slot]) -> None:
        self._take_steps = compiled_library().take_steps
        self.operations = program.operations
        self.c_operations = (COperation * len(program.c_operations))(*program.c_operations)
        self._warned = (LONG * len(self.operations))()
        self._feeds = [
            k for k, timed in enumerate(self.operations) if isinstance(timed.operation, InputSource)
        ]
        self._means: dict[EqualSteps, list[Any]] = {}
        steps = enumerate(timed.operation for timed in self.operations)
        self._turns = [(k, step.part) for k, step in steps if isinstance(step, StepOperation)]
        self._begin, self._row_begin = program.begin, program.row_begin
        cells = (ColumnCell(slot.address, ord(slot.kind._type_)) for slot in columns)
        self._columns = (ColumnCell * len(columns))(*cells)

    def run(
        self, steps: EqualSteps, first: int, last: int, every: int, begin: int = 0
    ) -> tuple[array[float], int, FmuError | None]:
        """Take steps first + 1 to last, with a row after every `every`-th, and after the last of all.

        Returns the rows, one after the other, the last step that was completed, and the failure
        that ended it there. Operations before `begin` are left out.
        """
        width = len(self._columns) + 1
        rows = array("d", [0.0]) * (width * ((last - first) // every + 2))
        kept = self._lay_out_means(steps, first, last) if self._feeds else None
        for k, part in self._turns:
            self.c_operations[k].forward = part.instance.forward
        report = (LONG * 3)()
        taken = self._take_steps(
            address(self.c_operations, begin), address(self._warned, begin),
            len(self.c_operations) - begin, self._row_begin - begin,
            self._columns, len(self._columns), steps.begin, steps.size, first, last, every,
            last + 1 if steps.stop is None else steps.number, steps.stop or 0.0,
            rows.buffer_info()[0], report,
        )  # fmt: skip
        del kept
        done, failed, status = report
        answers = [(k, n - 1, WARNING) for k, n in enumerate(self._warned) if n]
        if failed >= 0:
            answers.append((begin + failed, done, status))
        reached = sum(steps.at(done - 1)) if done > first else steps.at(first)[0]
        for k, part in self._turns:
            part.instance.come_to(reached)
            part.do_steps += part.substeps * (done - first + (failed >= 0 and k <= begin + failed))
        if answers:
            ctypes.memset(self._warned, 0, ctypes.sizeof(self._warned))
        failure = None
        try:
            for k, n, answer in answers:
                operation, at, size = self.operations[k]
                t, h = steps.at(n)
                operation.answered(t + at * h, size * h, answer)
        except FmuError as error:
            failure = error
        del rows[taken * width :]
        return rows, done, failure

    def advance(self, t: float, h: float) -> None:
        """Take one step from t by h [s], whatever events are due, without a row; raises FmuError."""
        _, _, failure = self.run(EqualSteps(t, h, 1), 0, 1, 2, self._begin)
        if failure is not None:
            raise failure

    def _lay_out_means(self, steps: EqualSteps, first: int, last: int) -> list[Any]:
        """Lay out the means of inputs over time in steps first + 1 to last, in arrays that are to live as long."""
        offset, arrays = 0, [array("d") for _ in self._feeds]
        if steps.stop is not None and len(self._feeds) * steps.number <= MOST_MEANS:
            offset, arrays = first, self._means.setdefault(steps, arrays)
        for k, means in zip(self._feeds, arrays):
            feed, at, size = self.operations[k]
            assert isinstance(feed, InputSource)
            for n in range(first - offset + len(means), last):
                t, h = steps.at(n)
                means.append(feed.profile.mean(t + at * h, size * h))
            self.c_operations[k].source = means.buffer_info()[0] + 8 * offset
        return arrays
