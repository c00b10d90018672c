"""A part on its wires: what it does before a step, in it, and after it, one operation at a time."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence

from ..fmu.library import Library
from ..fmu.operations import Code, Layout, Operation
from ..system import feedthrough
from ..system.description import ModelDescription, Variable
from .energy import BondSide
from .instance import OK, Instance, VariableBlock
from .links import InputPolynomials, Link
from .sources import InputSource


class Part(Instance):
    """A part with the buffers of its wired variables and what moves values into them.

    `substeps` is the number of sub-steps that it takes in a step; `within` are the variables to show
    within a step if it can. If it `stops`, it refuses steps across its events, and the system steps to
    them. `intermediate_values` gives times [s] within its steps and the values of the variables in `watched` there.
    """

    def __init__(
        self,
        name: str,
        description: ModelDescription,
        fmu: Library,
        within: Sequence[Variable] = (),
    ) -> None:
        super().__init__(name, description, fmu)
        self.substeps = 1
        self.inputs: list[VariableBlock] = []
        self.outputs: list[VariableBlock] = []
        self.links: list[Link] = []
        self.curves: InputPolynomials | None = None
        self.feeds: list[InputSource] = []
        self.bond_sides: list[BondSide] = []
        self.do_steps = 0
        self.stops = False
        self.watched: Sequence[str] = ()
        self.intermediate_values: list[tuple[float, list[float]]] = []

    def shows_events(self) -> bool:
        """Whether a wire carries what its events alone change, and a step can end there."""
        return False

    def direct_feedthrough(self, driver: Mapping[str, str]) -> dict[str, frozenset[str]]:
        """The outputs on which driven inputs act directly, as far as declared, and the parts that drive them.

        `driver` is the part of each wired output; an empty name stands for an input over time.
        """
        by_input: dict[str, set[str]] = {}
        for link in self.links:
            by_input.setdefault(link.target.name, set()).add(driver.get(link.source.name, ""))
        acting = {
            f"{self.name}.{output}": frozenset[str]().union(
                *(by_input.get(f"{self.name}.{name}", ()) for name in inputs)
            )
            for output, inputs in feedthrough(self.description).items()
        }
        return {output: drivers for output, drivers in acting.items() if drivers}

    def apply_links(self) -> None:
        """Bring the values of the wires into the buffers."""
        for link in self.links:
            link(0.0, 0.0)

    def exchange(self) -> None:
        """Set the inputs and get the outputs."""
        for block in (*self.inputs, *self.outputs):
            block.move()

    def step_operations(self) -> Iterator[Operation]:
        """What the part does in its turn: take what the wires bring, and step."""
        if self.curves is None:
            yield from (*self.feeds, *self.links, *self.inputs)
        else:
            yield from (link for link in self.links if link.signal is None)
            yield from (block for block in self.inputs if not block.real)
        yield StepOperation(self)

    def advance(self, t: float, h: float) -> None:
        """Step from t by h [s]; raises FmuError."""
        self.begin_of_step.value, self.size_of_step.value = t, h
        status = self.do_step()
        if status != OK:
            self.stepped(t, h, status)

    def step_layout(self) -> Layout:
        """What loop.c does in place of `advance`."""
        function = ctypes.cast(self.library.fmi2DoStep, ctypes.c_void_p).value
        return Layout(Code.STEP, function=function, component=self.component.value)

    def read_operations(self) -> Iterator[Operation]:
        """What is read of the part when all of a stage have stepped."""
        yield from self.outputs
        if self.curves is not None:
            yield self.curves


class StepOperation(Operation):
    """A part's step, in as many pieces as it has substeps; inputs that move do so in each."""

    def __init__(self, part: Part) -> None:
        self.part = part

    def __call__(self, t: float, h: float) -> None:
        part = self.part
        size = h / part.substeps
        for k in range(part.substeps):
            begin = t + k * size
            if part.curves is not None:
                part.curves.hand_over(begin, size, first=k == 0)
            if begin + size >= part.nearly:
                size = part.rest(begin, size)
            part.do_steps += 1
            part.advance(begin, size)

    def layout(self) -> Layout | None:
        """None if inputs move within it."""
        part = self.part
        if part.curves is not None:
            return None
        layout = part.step_layout()
        layout.count, layout.forward = part.substeps, part.forward.value
        return layout

    def answered(self, t: float, h: float, status: int) -> None:
        self.part.stepped(t, h, status)
