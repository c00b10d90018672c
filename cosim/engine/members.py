"""Members of an ensemble in C: one system again and again with other start values, by members.c."""

from __future__ import annotations

import ctypes
import time as clock
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..fmu.messages import WARNING
from ..system import Value
from .control import Adaptive
from .energy import by_bond
from .loop import compiled_library
from .member_layout import SpanLayout, SystemLayout
from .structures import LONG

Array = NDArray[np.float64]
#: Statuses of a member: it is done; done, with a warning that an FMU returned; left to Python.
DONE, WARNED, LEFT = range(3)
#: Longest time in C [s], after which signals and progress are looked at.
PATIENCE = 0.05
#: How many members of a block are done.
MembersDone = int


class Place(ctypes.Structure):
    """struct place of members.c: the member that is worked on, and the steps of it that are done."""

    _fields_ = [("member", LONG), ("steps", LONG)]


class StepAndStop(NamedTuple):
    """The communication step of a member and its stop [s]."""

    step: float | Adaptive
    stop: float


@dataclass(frozen=True)
class Block:
    """Some members, in memory that C fills: n of them.

    Attributes
    ----------
    numbers
        Those of the members, shape (n,).
    values
        What they differ in, shape (n, names).
    spans
        How long each runs, n of SpanLayout.
    rows
        Shape (n, rows, columns), the time first.
    counts
        How many of the rows each has, shape (n,).
    work
        Energy given and exchanged [J] over each side of a bond, shape (n, sides, 2).
    status
        DONE, WARNED, or LEFT, shape (n,).
    """

    numbers: NDArray[np.int64]
    values: Array
    spans: Any
    rows: Array
    counts: NDArray[np.int64]
    work: Array
    status: NDArray[np.int32]


class Members:
    """The members of a system that is laid out.

    `place` is the one that is worked on, among the `numbers` of a block. Messages of the parts
    go to `warnings`: by the sentence, the numbers of the members.
    """

    def __init__(self, layout: SystemLayout, place: Place, numbers: Any) -> None:
        self._layout, self.place, self.numbers = layout, place, numbers
        self.warnings: dict[str, list[int]] = {}

    def bond_energy(self, block: Block) -> dict[str, Array]:
        """Energy given, taken and exchanged [J] over each power bond, shape (n, 3)."""
        sides, energy = self._layout.bond_sides, {}
        for bond, pair in by_bond(sides).items():
            first, second = map(sides.index, pair)
            exchanged = np.maximum(block.work[:, first, 1], block.work[:, second, 1])
            energy[bond] = np.stack(
                [block.work[:, first, 0], block.work[:, second, 0], exchanged], 1
            )
        return energy

    def allocate(
        self,
        numbers: NDArray[np.int64],
        values: Sequence[tuple[Value, ...]],
        spans: Sequence[StepAndStop],
        output_step: float | None,
    ) -> Block:
        """Memory for members of these numbers with these values; raises NeedsPythonError."""
        layouts = [self._layout.span(float(h), stop, output_step) for h, stop in spans]  # type: ignore[arg-type]
        n, most = len(values), max((2 + (x.count - 1) // x.every for x in layouts), default=0)
        return Block(
            numbers,
            np.array(values, float).reshape(n, -1),
            (SpanLayout * n)(*layouts),
            np.empty((n, most, self._layout.ensemble.width + 1)),
            np.zeros(n, np.int64),
            np.zeros((n, self._layout.ensemble.n_sides, 2)),
            np.zeros(n, np.int32),
        )

    def run(self, block: Block) -> Iterator[MembersDone]:
        """Run the members; how many are done, every PATIENCE or so."""
        place, n, most = self.place, len(block.values), 1 << 10
        self.numbers[:n] = block.numbers.tolist()
        place.member, place.steps = 0, -1
        self._take_over_instances()
        while place.member < n:
            began = clock.perf_counter()
            compiled_library().run_members(
                ctypes.byref(self._layout.ensemble), ctypes.byref(place), block.spans, n, most, block.values.ctypes,
                block.rows.ctypes, block.rows.shape[1], block.counts.ctypes, block.work.ctypes,
                block.status.ctypes,
            )  # fmt: skip
            most = most * 2 if clock.perf_counter() - began < PATIENCE else max(most // 2, 1)
            if place.steps < 0 and block.status[place.member - 1] == WARNED:
                self._collect_warnings_of_last_member(block.spans[place.member - 1].h)
            yield place.member

    def _collect_warnings_of_last_member(self, step: float) -> None:
        """Let the parts warn of what calls of the last member, whose steps are `step` [s], have returned."""
        self.place.member -= 1
        for k, n in enumerate(self._layout.warned):
            if n:
                operation, at, size = self._layout.loop.operations[k]
                t = self._layout.settings.start + (n - 1) * step
                operation.answered(t + at * step, size * step, WARNING)
        self.place.member += 1

    def _take_over_instances(self) -> None:
        """Let the instances be those of these members again, after others have used them."""
        for part in self._layout.parts.values():
            part.instance.connect_inputs(part.inputs)
            part.instance.go_forward_only(forward=True)
            part.instance.refuse_steps_across_events(refuses=False)
            part.messages.on_warning = self._note

    def _note(self, part: str, sentence: str) -> None:
        """Keep a warning of a part for the present member."""
        number = int(self.numbers[self.place.member])
        members = self.warnings.setdefault(f"{part}: {sentence}", [])
        if members[-1:] != [number]:
            members.append(number)
