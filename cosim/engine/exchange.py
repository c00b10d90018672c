"""A part on its wires: what it hears before a step, what it shows after it."""

from __future__ import annotations

from typing import Any

from fmpy.model_description import ModelDescription

from ..system import feedthrough
from .curve import Curves
from .feed import Feed
from .ledger import End
from .library import Library
from .part import OK, Block, Part


class Coupled(Part):
    """A part with the buffers of its wired variables and what moves values into them.

    `substeps` is the number of steps that it takes within one that it is given.
    """

    def __init__(
        self, name: str, description: ModelDescription, fmu: Library, substeps: int = 1
    ) -> None:
        super().__init__(name, description, fmu)
        self.substeps = substeps
        self.inputs: list[Block] = []
        self.outputs: list[Block] = []
        self.copies: list[tuple[Any, int, Any, int]] = []
        self.scaled: list[tuple[Any, int, Any, int, float, float]] = []
        self.curves: Curves | None = None
        self.feeds: list[Feed] = []
        self.ends: list[End] = []
        self.do_steps = 0

    def fed_through(self) -> frozenset[str]:
        """The wired Real outputs on which a wired input acts at once, as far as it is declared."""
        wired = {name for block in self.inputs for name in block.names}
        shown = frozenset(name for block in self.outputs if block.real for name in block.names)
        return shown & {
            f"{self.name}.{output}"
            for output, inputs in feedthrough(self.description).items()
            if any(f"{self.name}.{name}" in wired for name in inputs)
        }

    def wire(self, target: Any, i: int, source: Any, j: int, factor: float, offset: float) -> None:
        """Let input cell `target[i]` follow factor * source[j] + offset."""
        if (factor, offset) == (1.0, 0.0):
            self.copies.append((target, i, source, j))
        else:
            self.scaled.append((target, i, source, j, factor, offset))

    def fetch(self) -> None:
        """Get the wired outputs."""
        for block in self.outputs:
            block()

    def read(self, t: float) -> None:
        """Get the wired outputs at time t [s]; they must be finite."""
        for block in self.outputs:
            block()
            block.require_finite(t)
        if self.curves is not None:
            self.curves.read(t)

    def bring(self) -> None:
        """Bring the values of the wires."""
        for target, i, source, j in self.copies:
            target[i] = source[j]
        for target, i, source, j, factor, offset in self.scaled:
            target[i] = factor * source[j] + offset

    def send(self) -> None:
        """Hand the inputs over as they stand in the buffers."""
        for block in self.inputs:
            block()

    def step(self, t: float, h: float) -> None:
        """Take the values of the wires and advance from time t by h [s]."""
        size = h / self.substeps
        if self.curves is None:
            for feed in self.feeds:
                feed.bring(t, h)
        for k in range(self.substeps):
            begin = t + k * size
            self.bring()
            if self.curves is not None:
                self.curves.bring(begin, size, first=k == 0)
            self.send()
            if self.curves is not None:
                self.curves.send()
            if begin + size >= self.nearly:
                size = self.rest(begin, size)
            self.begin_of_step.value, self.size_of_step.value = begin, size
            self.do_steps += 1
            status = self.do_step()
            if status != OK:
                self.stepped(begin, size, status)

    def book(self, h: float) -> None:
        """Enter the energy of a step of size h [s] that ends with the outputs as they stand."""
        for end in self.ends:
            end.book(h)
