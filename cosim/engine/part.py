"""A part on its wires: what it does before a step, in it, and after it, one operation at a time."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Generic, TypeVar

from ..fmu.blocks import VariableBlock
from ..fmu.instance import CoSimulation, Instance
from ..fmu.messages import MessageLog
from ..fmu.operations import COperation, Operation
from ..system import feedthrough
from ..system.description import ModelDescription
from .energy import BondSide
from .links import InputPolynomials, Link
from .sources import InputSource

I = TypeVar("I", bound=Instance)


class WiredPart(Generic[I]):
    """An instance of an FMU, the buffers of its wired variables, and what moves values into them.

    `substeps` is the number of sub-steps that it takes in a step, none of which goes beyond the first of its `ends` [s];
    what comes to the second would be beyond it but for rounding. `do_steps` counts them. `links` bring values to its
    `inputs`, those over time from `feeds`; `curves`, if any, let them move within a step. `bond_sides` book the work of its
    `outputs`.
    """

    def __init__(
        self,
        instance: I,
        inputs: Sequence[VariableBlock],
        outputs: Sequence[VariableBlock],
        substeps: int = 1,
    ) -> None:
        """The inputs hold what they begin with."""
        self.instance, self.inputs, self.outputs = instance, inputs, outputs
        self.substeps, self.do_steps = substeps, 0
        self.ends = (ctypes.c_double * 2)()
        self._initial_inputs = [bytes(block.cells) for block in inputs]
        self.array_inputs = [
            (b, i, v) for b in inputs for i, v in enumerate(b.variables) if len(v.family) > 1
        ]
        self.links: list[Link] = []
        self.curves: InputPolynomials | None = None
        self.feeds: list[InputSource] = []
        self.bond_sides: list[BondSide] = []

    @property
    def name(self) -> str:
        """The name of the part in its system."""
        return self.instance.session.name

    @property
    def description(self) -> ModelDescription:
        """What its FMU says of itself."""
        return self.instance.session.description

    @property
    def messages(self) -> MessageLog:
        """What its FMU logs."""
        return self.instance.session.messages

    def drivers_of_outputs(self, part_of_output: Mapping[str, str]) -> dict[str, frozenset[str]]:
        """The outputs on which driven inputs act directly, as far as declared, and the parts that drive them.

        `part_of_output` is the part of each wired output; an empty name stands for an input over time.
        """
        by_input: dict[str, set[str]] = {}
        for link in self.links:
            by_input.setdefault(link.target.name, set()).add(
                part_of_output.get(link.source.name, "")
            )
        acting = {
            f"{self.name}.{output}": frozenset[str]().union(
                *(by_input.get(f"{self.name}.{name}", ()) for name in inputs)
            )
            for output, inputs in feedthrough(self.description).items()
        }
        return {output: drivers for output, drivers in acting.items() if drivers}

    def begin(self, start: float, stop: float) -> None:
        """Be as new for a run from start to stop [s], but for the instance."""
        self.do_steps, self.ends[:] = 0, [stop, stop - 64 * math.ulp(stop)]
        self.instance.connect_inputs(self.inputs)
        for block, content in zip(self.inputs, self._initial_inputs):
            ctypes.memmove(block.cells, content, len(content))
        for feed in self.feeds:
            feed.cell[0] = float(feed.profile.at(start))
        for signal in self.curves.signals if self.curves else ():
            signal.nodes = []

    def apply_links(self) -> None:
        """Bring the values of the wires into the buffers."""
        for link in self.links:
            link(0.0, 0.0)

    def read_operations(self) -> Iterator[Operation]:
        """What is read of the part when all of a stage have stepped."""
        yield from self.outputs
        if self.curves is not None:
            yield self.curves


#: A part that steps.
Part = WiredPart[CoSimulation]


def step_operations(part: Part) -> Iterator[Operation]:
    """What a part does in its turn: take what the wires bring, and step."""
    plain = [block for block in part.inputs if not block.held]
    if part.curves is None:
        yield from (*part.feeds, *part.links, *plain)
    else:
        yield from (link for link in part.links if link.signal is None)
        yield from (block for block in plain if not block.real)
    yield from (EventModeEntry(part.instance, block) for block in part.inputs if block.held)
    yield StepOperation(part)


class EventModeEntry(Operation):
    """Enters the inputs of a part that take event mode, if one of a block has changed."""

    def __init__(self, instance: CoSimulation, block: VariableBlock) -> None:
        self.instance, self.block = instance, block

    def __call__(self, t: float, h: float) -> None:
        """Enter the inputs at the time t [s]."""
        self.instance.enter_changed_inputs(t)

    def c_operation(self) -> COperation | None:
        """None for texts, whose memory is Python's."""
        return self.instance.input_c_operation(self.block)

    def answered(self, t: float, h: float, status: int) -> None:
        """Leave the status of the FMU's call to the instance, which knows what it allows."""
        self.instance.stepped(t, h, status)


class StepOperation(Operation):
    """A part's step, in as many pieces as it has substeps; inputs that move do so in each.

    A piece that would end beyond the part's stop, or before it by rounding only, ends there.
    """

    def __init__(self, part: Part) -> None:
        self.part = part

    def __call__(self, t: float, h: float) -> None:
        """Step the part from t by h [s], at a stop time exactly onto it; raises FmuError."""
        part = self.part
        size = h / part.substeps
        for k in range(part.substeps):
            begin = t + k * size
            if part.curves is not None:
                part.curves.hand_over(begin, size, first=k == 0)
            if begin + size >= part.ends[1]:
                size = self._size_to_stop(begin, size)
            part.do_steps += 1
            part.instance.advance(begin, size)

    def _size_to_stop(self, t: float, h: float) -> float:
        """The step h from t [s], or what is left to the stop time where it differs by rounding."""
        stop: float = self.part.ends[0]
        if t + h != stop:
            h = stop - t
            while t + h > stop:
                h = math.nextafter(h, 0.0)
        return h

    def c_operation(self) -> COperation | None:
        """None if inputs move within it, or values are shown."""
        part = self.part
        if part.curves is not None or part.instance.watched:
            return None
        c_operation = part.instance.step_c_operation()
        c_operation.count = part.substeps
        c_operation.last = ctypes.addressof(part.ends)
        return c_operation

    def answered(self, t: float, h: float, status: int) -> None:
        """Leave the status of the FMU's step to the instance, which knows what it allows."""
        self.part.instance.stepped(t, h, status)
