"""The state of all parts and of what the master keeps of them, to come back to."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

from .part import Part


class Snapshot:
    """One place for the state of the parts; `take` overwrites what was there."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self._states = [(part.instance, part.instance.state()) for part in parts]
        # inputs too: an array is handed over whole, with elements that no wire brings anew
        self._blocks = [b for part in parts for b in (*part.inputs, *part.outputs)]
        self._ends = [end for part in parts for end in part.bond_sides]
        self._cells: list[list[object]] = []
        self._booked: list[list[ctypes.c_double | float]] = []

    def take(self) -> None:
        """Remember the parts as they are now; raises FmuError."""
        for instance, state in self._states:
            instance.save(state)
        self._cells = [list(block.cells) for block in self._blocks]
        self._booked = [list(end.totals) for end in self._ends]

    def restore_fmus(self) -> None:
        """Bring the FMUs back, not what the master keeps; raises FmuError."""
        for instance, state in self._states:
            instance.restore(state)

    def restore(self) -> None:
        """Bring back everything but the nodes of moving inputs; raises FmuError."""
        self.restore_fmus()
        for block, cells in zip(self._blocks, self._cells):
            block.cells[:] = cells
        for end, booked in zip(self._ends, self._booked):
            end.totals[:] = booked


def drop_nodes_after(parts: Sequence[Part], t: float) -> None:
    """Drop what moving inputs know of their sources after the time t [s]."""
    for part in parts:
        for signal in part.curves.signals if part.curves else ():
            signal.drop_after(t)
