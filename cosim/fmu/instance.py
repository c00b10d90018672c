"""What the engine asks of an FMU's instance, whatever its version of FMI."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

from ..system.description import ModelDescription, Value, Variable
from .blocks import VariableBlock
from .library import Library
from .operations import Layout
from .session import SavedState, Session


class VariableAccess(Protocol):
    """How a version of FMI gets and sets variables, and begins."""

    def set_up(self, tolerance: float | None, start: float, stop: float | None) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""

    def blocks(self, action: str, variables: Sequence[Variable]) -> list[VariableBlock]:
        """One block per type, in the order of the variables; `action` is "Get" or "Set"."""

    def derivative_block(
        self, action: str, variables: Sequence[Variable], orders: Sequence[int]
    ) -> VariableBlock:
        """A block of derivatives of Real outputs or inputs over time, with an order for each."""

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable."""

    def values(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values of variables, by their names and in their order."""

    def slopes(self, unknown: Sequence[Variable], by: Variable) -> list[float]:
        """The directional derivatives of variables by one, as the FMU has them."""


class Instance(Protocol):
    """An instance of an FMU by one of its interfaces; raises FmuError where a call fails."""

    @property
    def session(self) -> Session:
        """The instance in its C library."""

    @property
    def access(self) -> VariableAccess:
        """How its variables are got and set; what begins with `set` here also does what events need."""

    def set_up(self, tolerance: float | None, start: float, stop: float | None) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable, at a time when the FMU allows it."""

    def connect_inputs(self, blocks: Sequence[VariableBlock]) -> None:
        """Note the blocks by which wires set inputs."""

    def begin(self) -> None:
        """Leave initialisation mode for the first step."""

    def reset(self) -> None:
        """Be as if made anew."""


class CoSimulation(Instance, Protocol):
    """An instance that steps.

    `watched` are the names of variables whose values it shows within a step, and `intermediate_values`
    these values, in that sequence, each with its time [s].
    """

    watched: Sequence[str]
    intermediate_values: list[tuple[float, list[float]]]

    @property
    def forward(self) -> bool:
        """Whether the FMU may forget its past, since no step will be taken again."""

    def go_forward_only(self, *, forward: bool) -> None:
        """Promise that no step will be taken again, or do so no longer."""

    def advance(self, t: float, h: float) -> None:
        """Step from t by h [s]; raises FmuError, StepDiscarded, EventReached, SimulationTerminated."""

    def stepped(self, t: float, h: float, status: int) -> None:
        """Keep a warning of a step from t by h [s]; raise FmuError for a worse status."""

    def step_layout(self) -> Layout:
        """What loop.c does in place of `advance`."""

    def due_address(self) -> int | None:
        """Where the time of the next event [s] that is known in advance stands, for members.c."""

    def step_status(self, t: float, h: float) -> int:
        """The status of a step from t by h [s], whatever it is."""

    def last_success(self) -> tuple[int, float, bool]:
        """Of a discarded step: the status of the answer, the time reached [s], whether that is the end."""

    def shows_events(self, outputs: Sequence[VariableBlock]) -> bool:
        """Whether one of these outputs is changed by its events alone, and a step can end there."""

    def stop_at_events(self, *, stops: bool) -> None:
        """Refuse steps across an event from now on, or take them; the system then steps to the event."""

    def take_inputs(self, t: float) -> None:
        """Enter the inputs that are not set before a step, if one has changed."""

    def input_layout(self, block: VariableBlock) -> Layout | None:
        """What loop.c does in place of `take_inputs`, if this block has changed; None if it cannot."""

    def state(self) -> SavedState:
        """A place for a state of the FMU, freed with it."""

    def save(self, state: SavedState) -> None:
        """Put the FMU's state into a place, instead of what was there."""

    def restore(self, state: SavedState) -> None:
        """Return to a saved state."""


I_co = TypeVar("I_co", bound=Instance, covariant=True)


class Opener(Protocol[I_co]):
    """Makes an instance of an FMU by one of its interfaces."""

    def __call__(
        self,
        name: str,
        description: ModelDescription,
        fmu: Library,
        within: Sequence[Variable] = (),
    ) -> I_co:
        """The instance, which shows the variables `within` its steps if it can; raises FmuError."""
