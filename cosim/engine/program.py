"""The loop of fixed-step runs in C: loop.c, compiled once with ziglang and kept beside this file."""

from __future__ import annotations

import ctypes
import hashlib
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from ..errors import PartFailure
from .algorithms import Timed
from .exchange import Step
from .feed import Feed
from .operation import Layout, address
from .part import OK, WARNING, Block

SOURCE = Path(__file__).with_name("loop.c")


class Column(ctypes.Structure):
    """struct column of loop.c."""

    _fields_ = [("cell", ctypes.c_void_p), ("real", ctypes.c_int)]


@cache
def library() -> Any:
    """The compiled loop; raises OSError with the reason if there is none."""
    compiler = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-O2",
        "-ffp-contract=off",
        "-shared",
        "-fPIC",
    ]
    made_of = (SOURCE.read_text(), *compiler[1:], sys.platform, platform.machine())
    name = f"loop-{hashlib.sha256(repr(made_of).encode()).hexdigest()[:16]}.so"
    path = SOURCE.parent / "__pycache__" / name
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            made = Path(folder) / name
            command = [*compiler, "-o", str(made), str(SOURCE)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise OSError((done.stderr.strip() or "the compiler failed").splitlines()[-1])
            made.replace(path)
    return ctypes.CDLL(str(path))


class Loop:
    """Fixed steps of a program, a row after every `every`-th step.

    `extra` are the blocks to get before a row, `columns` what a row holds after the time. Raises
    OSError with the reason if there is no compiled loop; `possible` tells which programs it can run.
    """

    def __init__(
        self,
        program: Sequence[Timed],
        extra: Sequence[Block],
        columns: Sequence[tuple[Block, int]],
        every: int,
    ) -> None:
        self._advance = library().advance
        self._operations = [*program, *(Timed(block, 1.0, 0.0) for block in extra)]
        self._layouts = (Layout * len(self._operations))(*map(_layout, self._operations))
        self._row_begin = len(program)
        cells = (Column(address(block.cells, i), block.real) for block, i in columns)
        self._columns = (Column * len(columns))(*cells)
        self._width = len(columns) + 1
        self._every = every

    def run(
        self, start: float, h: float, first: int, last: int
    ) -> tuple[list[float], int, PartFailure | None]:
        """Take steps first + 1 to last of size h [s] from `start` on.

        Returns the rows, one after the other, the last step that was completed, and the failure
        that ended it there.
        """
        rows = (ctypes.c_double * (self._width * ((last - first) // self._every + 1)))()
        kept = []
        for (operation, at, size), layout in zip(self._operations, self._layouts):
            if isinstance(operation, Feed):
                times = (start + n * h + at * h for n in range(first, last))
                means = [operation.profile.mean(t, size * h) for t in times]
                kept.append((ctypes.c_double * len(means))(*means))
                layout.source = address(kept[-1])
        done, failed, status = ctypes.c_longlong(), ctypes.c_int(), ctypes.c_int()
        count = self._advance(
            self._layouts,
            ctypes.c_int(len(self._layouts)),
            ctypes.c_int(self._row_begin),
            self._columns,
            ctypes.c_int(len(self._columns)),
            ctypes.c_double(start),
            ctypes.c_double(h),
            ctypes.c_longlong(first),
            ctypes.c_longlong(last),
            ctypes.c_longlong(self._every),
            rows,
            ctypes.byref(done),
            ctypes.byref(failed),
            ctypes.byref(status),
        )
        failure = None
        try:
            self._tell(start, h, done.value - first, done.value, failed.value, status.value)
        except PartFailure as error:
            failure = error
        return rows[: count * self._width], done.value, failure

    def _tell(
        self, start: float, h: float, steps: int, done: int, failed: int, status: int
    ) -> None:
        """Count the steps and keep the warnings; raise the failure of the operation that failed."""
        for (operation, at, size), layout in zip(self._operations, self._layouts):
            if isinstance(operation, Step):
                operation.part.do_steps += operation.part.substeps * steps
            if layout.warned:
                t = start + (layout.warned - 1) * h
                operation.answered(t + at * h, size * h, WARNING)
        if failed >= 0:
            operation, at, size = self._operations[failed]
            t = start + done * h + at * h
            if status in (OK, WARNING):
                raise operation.not_finite(t)
            operation.answered(t, size * h, status)


def possible(program: Sequence[Timed]) -> bool:
    """Whether all operations can do without Python."""
    return all(operation.layout() is not None for operation, _, _ in program)


def _layout(timed: Timed) -> Layout:
    operation, at, size = timed
    layout = operation.layout()
    assert layout is not None
    layout.at, layout.size = at, size
    return layout
