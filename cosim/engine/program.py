"""The loop of fixed-step runs in C: loop.c, compiled by ziglang, in the wheel for every platform."""

from __future__ import annotations

import ctypes
import hashlib
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn

from ..errors import PartFailure
from .algorithms import Stages, Turn
from .feed import Feed
from .ledger import End
from .part import WARNING, Block

SOURCE = Path(__file__).with_name("loop.c")
COPY, SCALE, SET, GET, FINITE, STEP, BOOK, FEED = range(8)


class Operation(ctypes.Structure):
    """struct operation of loop.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("code", "count", "forward")),
        *((name, ctypes.c_void_p) for name in ("function", "component", "references", "cells")),
        *((name, ctypes.c_void_p) for name in ("target", "source", "first", "last")),
        *((name, ctypes.c_double) for name in ("a", "b")),
        *((name, ctypes.c_void_p) for name in ("energy", "exchanged", "before")),
        ("warned", ctypes.c_longlong),
    ]


class Column(ctypes.Structure):
    """struct column of loop.c."""

    _fields_ = [("cell", ctypes.c_void_p), ("real", ctypes.c_int)]


TARGETS = {
    ("linux", "x86_64"): "x86_64-linux-gnu.2.17",
    ("linux", "aarch64"): "aarch64-linux-gnu.2.17",
    ("win32", "AMD64"): "x86_64-windows-gnu",
    ("darwin", "x86_64"): "x86_64-macos",
    ("darwin", "arm64"): "aarch64-macos",
}
OPTIONS = ("-O2", "-ffp-contract=off", "-shared", "-fPIC", "-s")


@cache
def library() -> Any:
    """The compiled loop: the one that came with the package, or one made here of its source.

    Raises OSError with the reason if there is none.
    """
    here = file_name(sys.platform, platform.machine())
    shipped = SOURCE.parent / "compiled" / here
    if shipped.exists():
        return ctypes.CDLL(str(shipped))
    made_of = hashlib.sha256(f"{SOURCE.read_text()}{OPTIONS}".encode()).hexdigest()[:16]
    path = SOURCE.parent / "__pycache__" / f"{made_of}-{here}"
    if not path.exists():
        compile_loop(path)
    return ctypes.CDLL(str(path))


def file_name(system: str, machine: str) -> str:
    """The name of the compiled loop for `sys.platform` and `platform.machine()`."""
    return f"loop-{system}-{machine}.so"


def compile_loop(path: Path, target: str = "native") -> None:
    """Compile the loop for a target of Zig; raises OSError with the words of the compiler."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        made = Path(folder) / path.name
        command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *OPTIONS]
        command += ["-o", str(made), str(SOURCE)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise OSError((done.stderr.strip() or "the compiler failed").splitlines()[-1])
        made.replace(path)


class Loop:
    """Fixed steps of an explicit algorithm over Real wires, a row after every `every`-th step.

    `extra` are the blocks to get before a row, `columns` what a row holds after the time.
    """

    def __init__(
        self,
        stages: Stages,
        extra: Sequence[Block],
        columns: Sequence[tuple[Block, int]],
        every: int,
    ) -> None:
        self._advance = library().advance
        self._turns = [turn for stage in stages for turn in stage]
        self._ends = list(dict.fromkeys(end for turn in self._turns for end in turn.part.ends))
        self._energy = (ctypes.c_double * len(self._ends))()
        self._exchanged = (ctypes.c_double * len(self._ends))()
        self._before = (ctypes.c_double * len(self._ends))()
        self._feeds: list[tuple[int, Turn, Feed]] = []
        self._tell: list[Callable[[float, float, int], None]] = []
        operations = [*chain.from_iterable(map(self._stage, stages))]
        self._row_begin = len(operations)
        operations += [*chain.from_iterable(self._get(block, 1.0) for block in extra)]
        self._program = (Operation * len(operations))(*operations)
        cells = (Column(_address(block.cells, i), block.real) for block, i in columns)
        self._columns = (Column * len(columns))(*cells)
        self._width = len(columns) + 1
        self._every = every

    def _stage(self, stage: Sequence[Turn]) -> Iterator[Operation]:
        for turn in stage:
            yield from self._step(turn)
        for turn in stage:
            for block in turn.part.outputs:
                yield from self._get(block, turn.at + turn.size)
            for end in turn.part.ends:
                yield self._book(end, turn.size)

    def _step(self, turn: Turn) -> Iterator[Operation]:
        part, at, size = turn
        for feed in part.feeds:
            self._feeds.append((len(self._tell), turn, feed))
            self._tell.append(_cannot)
            yield Operation(FEED, target=_address(feed.cell, 0))
            self._tell.append(lambda t, h, _, feed=feed: feed.require_finite(t + at * h))  # type: ignore[misc]
            yield Operation(FINITE, 1, cells=_address(feed.cell, 0))
        for target, i, source, j in part.copies:
            self._tell.append(_cannot)
            ends = {"target": _address(target, i), "source": _address(source, j)}
            yield Operation(code=COPY, **ends)
        for target, i, source, j, factor, offset in part.scaled:
            self._tell.append(_cannot)
            ends = {"target": _address(target, i), "source": _address(source, j)}
            yield Operation(code=SCALE, a=factor, b=offset, **ends)
        for block in part.inputs:
            yield self._exchange(SET, block)
        self._tell.append(lambda t, h, status: part.stepped(t + at * h, size * h, status))
        function = ctypes.cast(part.library.fmi2DoStep, ctypes.c_void_p)
        count, forward = part.substeps, part.forward.value
        yield Operation(STEP, count, forward, function, part.component, a=at, b=size)

    def _get(self, block: Block, at: float) -> Iterator[Operation]:
        yield self._exchange(GET, block)
        if block.real:
            self._tell.append(lambda t, h, status: block.require_finite(t + at * h))
            yield Operation(FINITE, len(block.cells), cells=_address(block.cells, 0))

    def _exchange(self, code: int, block: Block) -> Operation:
        self._tell.append(lambda t, h, status: block.part.answered(block.call, status))
        return Operation(
            code,
            len(block.cells),
            0,
            ctypes.cast(block.function, ctypes.c_void_p),
            block.part.component,
            _address(block.references, 0),
            _address(block.cells, 0),
        )

    def _book(self, end: End, size: float) -> Operation:
        self._tell.append(_cannot)
        k = self._ends.index(end)
        return Operation(
            BOOK,
            source=_address(*end.output),
            first=_address(*end.first),
            last=_address(*end.last),
            a=end.scale,
            b=size,
            energy=_address(self._energy, k),
            exchanged=_address(self._exchanged, k),
            before=_address(self._before, k),
        )

    def run(
        self, start: float, h: float, first: int, last: int
    ) -> tuple[list[float], int, PartFailure | None]:
        """Take steps first + 1 to last of size h [s] from `start` on.

        Returns the rows, one after the other, the last step that was completed, and the failure
        that ended it there.
        """
        for k, end in enumerate(self._ends):
            self._energy[k], self._exchanged[k], self._before[k] = end.booked
        rows = (ctypes.c_double * (self._width * ((last - first) // self._every + 1)))()
        kept = []
        for k, turn, feed in self._feeds:
            times = (start + n * h + turn.at * h for n in range(first, last))
            means = [feed.profile.mean(t, turn.size * h) for t in times]
            kept.append((ctypes.c_double * len(means))(*means))
            self._program[k].source = _address(kept[-1], 0)
        done, failed, status = ctypes.c_longlong(), ctypes.c_int(), ctypes.c_int()
        count = self._advance(
            self._program,
            ctypes.c_int(len(self._program)),
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
        for k, end in enumerate(self._ends):
            end.booked = self._energy[k], self._exchanged[k], self._before[k]
        for turn in self._turns:
            turn.part.do_steps += turn.part.substeps * (done.value - first)
        failure = None
        try:
            for tell, operation in zip(self._tell, self._program):
                if operation.warned:
                    tell(start + (operation.warned - 1) * h, h, WARNING)
            if failed.value >= 0:
                self._tell[failed.value](start + done.value * h, h, status.value)
        except PartFailure as error:
            failure = error
        return rows[: count * self._width], done.value, failure


def _address(cells: Any, i: int) -> int:
    """Where element i of a buffer stands."""
    return ctypes.addressof(cells) + i * ctypes.sizeof(cells._type_)


def _cannot(*_: Any) -> NoReturn:
    raise AssertionError("an operation without a call cannot fail")
