"""What a coupling algorithm says of itself: its schedule, what its inputs are made of, its orders.

The engine carries it out; in the tests the theory of coupled linear systems predicts what it does, and both are
compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol


class Turn(NamedTuple):
    """A part's step within a communication step: from `begin` over `fraction`, both of the step's size."""

    part: str
    begin: float = 0.0
    fraction: float = 1.0

    @property
    def end_fraction(self) -> float:
        """Where it ends, as a fraction of the communication step."""
        return self.begin + self.fraction


#: The turns of a stage do not see each other: they are taken with what the stages before have given.
Stage = tuple[Turn, ...]


class Feedthrough(NamedTuple):
    """An output on which inputs of its part act directly, and what drives these inputs.

    `sources` are the parts whose wires lead to these inputs; an empty name stands for an input over
    time. `is_wired` says whether the output is Real and drives another part.
    """

    output: str
    part: str
    sources: frozenset[str]
    is_wired: bool


@dataclass(frozen=True)
class CouplingContext:
    """What of a system decides how fast an algorithm converges.

    Parameters
    ----------
    parts
        The names of the parts in their stepping order.
    feedthroughs
        The outputs with direct feedthrough from inputs that something drives.
    input_degree
        The degree of the polynomials that Real inputs follow within a step; 0 holds them.
    interpolates
        Whether every FMU follows these polynomials itself. One that cannot gets their means.
    """

    parts: Sequence[str]
    feedthroughs: Sequence[Feedthrough] = ()
    input_degree: int = 0
    interpolates: bool = False

    @property
    def has_moving_inputs(self) -> bool:
        """Whether all inputs move within a step, so that outputs belong to its end."""
        return self.input_degree > 0 and self.interpolates


class Algorithm(Protocol):
    """A coupling algorithm.

    To add one, write a class with this base in a file of its own and register an instance of it in
    `cosim/engine/algorithms/__init__.py`.

    Attributes
    ----------
    name
        What `run(algorithm=...)` calls it.
    summary
        One sentence on how it couples the parts.
    held_order
        The convergence order of the states with inputs held over a step and without direct feedthrough.
    end_weight
        A held input takes this share of what its source shows at the end of the step, and the rest of
        what it has shown at the beginning. Above 0 the algorithm is implicit: its stages are repeated
        until the outputs at the end are those that the inputs were made of.
    """

    name: str
    summary: str
    held_order: int = 1
    end_weight: float = 0.0

    def stages(self, parts: Sequence[str]) -> list[Stage]:
        """The stages of a step, in their sequence; `parts` are in the stepping order."""
        ...

    @property
    def is_implicit(self) -> bool:
        """Whether its stages are repeated. It needs FMUs that can restore their state, and solves algebraic loops."""
        return self.end_weight > 0.0

    def delays_every_wire(self, parts: Sequence[str]) -> bool:
        """Whether every part steps with values of the step's beginning only."""
        return not self.is_implicit and len(self.stages(parts)) == 1

    def convergence_order(self, context: CouplingContext) -> int:
        """The order at which the states converge.

        An FMU that cannot interpolate gets means, of order 2. Means and held inputs of order 2 lose an
        order where a wired output has direct feedthrough: it shows its input from within the step.
        """
        if context.has_moving_inputs:
            return context.input_degree + 1
        if any(each.is_wired for each in context.feedthroughs):
            return 1
        return 2 if context.input_degree else self.held_order

    def first_order_outputs(self, context: CouplingContext) -> frozenset[str]:
        """The outputs that show an input from within the step.

        They converge with order 1, whatever the order of the states. Where the states have order 2 by
        the schedule alone, an input that its part takes last, after all its sources have come to the end
        of the step, belongs to that end.
        """
        if context.has_moving_inputs:
            return frozenset()
        if self.held_order == 1 or context.input_degree:
            return frozenset(each.output for each in context.feedthroughs)
        last, at_end = dict[str, int](), dict[str, int]()
        for n, stage in enumerate(self.stages(context.parts)):
            last |= {turn.part: n for turn in stage}
            at_end |= {turn.part: n for turn in stage if turn.end_fraction == 1.0}

        def is_current(source: str, part: str) -> bool:
            """Whether a source has come to the end of the step before the last turn of the part."""
            return source in at_end and at_end[source] < last[part]

        return frozenset(
            each.output
            for each in context.feedthroughs
            if not all(is_current(source, each.part) for source in each.sources)
        )
