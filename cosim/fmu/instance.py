"""What the engine asks of an FMU's instance, whatever its version of FMI."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

from ..system.description import Value, Variable
from .blocks import VariableBlock
from .messages import OK
from .operations import COperation
from .session import SavedState
from .session2 import Session2
from .session3 import Session3


class Instance:
    """An instance of an FMU by one of its interfaces; raises FmuError where a call fails.

    The `session` gets and sets variables by one call; what begins with `set` here also does what events need.
    """

    def __init__(self, session: Session2 | Session3) -> None:
        self.session = session

    def enter_initialisation(
        self, tolerance: float | None, start: float, stop: float | None
    ) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""
        self.session.enter_initialisation(tolerance, start, stop)

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable, at a time when the FMU allows it."""
        self.session.set(variable, value)

    def connect_inputs(self, blocks: Sequence[VariableBlock]) -> None:
        """Note the blocks by which wires set inputs, if some of them take more than setting."""

    def leave_initialisation(self, *, waits: bool = False) -> None:  # noqa: ARG002
        """Leave initialisation mode for the first step; events of the start may wait for those of other parts."""
        self.session.leave_initialisation()

    def reset(self) -> None:
        """Be as if made anew."""
        self.session.reset()


class CoSimulation(Instance):
    """An instance that steps; one whose events stay within its steps need not know of them.

    `watched` are the names of variables whose values it shows within a step, and `intermediate_values`
    these values, in that sequence, each with its time [s].
    """

    watched: Sequence[str] = ()

    def __init__(self, session: Session2 | Session3, forward: Any) -> None:
        """The cell `forward` says whether the FMU may forget its past, as a truth value of its version."""
        super().__init__(session)
        self.intermediate_values: list[tuple[float, list[float]]] = []
        self._forward = forward
        self._begin, self._size = ctypes.c_double(), ctypes.c_double()
        self._step: Callable[[], int]  # a step of this size and from this time

    @property
    def forward(self) -> bool:
        """Whether the FMU may forget its past, since no step will be taken again."""
        return bool(self._forward.value)

    def go_forward_only(self, *, forward: bool) -> None:
        """Promise that no step will be taken again, or do so no longer."""
        self._forward.value = forward

    def step_status(self, t: float, h: float) -> int:
        """The status of a step from t by h [s], whatever it is."""
        self._begin.value, self._size.value = t, h
        return self._step()

    def advance(self, t: float, h: float) -> None:
        """Step from t by h [s]; raises FmuError, StepDiscarded, EventReached, SimulationTerminated."""
        status = self.step_status(t, h)
        if status != OK:
            self.stepped(t, h, status)

    def stepped(self, t: float, h: float, status: int) -> None:
        """Keep a warning of a step from t by h [s]; raise FmuError for a worse status."""
        raise NotImplementedError

    def come_to(self, t: float) -> None:
        """Note the time [s] that steps of loop.c have reached."""

    def step_c_operation(self) -> COperation:
        """What loop.c does in place of `advance`."""
        raise NotImplementedError

    def last_success(self) -> tuple[int, float, bool]:
        """Of a discarded step: the status of the answer, the time reached [s], whether that is the end."""
        raise NotImplementedError

    @property
    def next_event(self) -> float:
        """The time of the next event [s] that is known in advance."""
        return math.inf

    def go_through_event(self, t: float) -> None:
        """Take the inputs of time t [s], and go through the event that is due then."""

    def next_event_address(self) -> int | None:
        """Where the time of the next event [s] stands; None for an instance that tells of none."""
        return None

    def has_event_outputs(self, outputs: Sequence[VariableBlock]) -> bool:  # noqa: ARG002
        """Whether one of these outputs is changed by its events alone, and a step can end there."""
        return False

    def refuse_steps_across_events(self, *, refuses: bool) -> None:
        """Refuse steps across an event from now on, or take them; the system then steps to the event."""

    def enter_changed_inputs(self, t: float) -> None:
        """Enter the inputs that are not set before a step, if one has changed."""

    def input_c_operation(self, block: VariableBlock) -> COperation | None:  # noqa: ARG002
        """What loop.c does in place of `enter_changed_inputs`, if this block has changed; None if it cannot."""
        return None

    def save(self, state: SavedState) -> None:
        """Put the FMU's state into a place, instead of what was there."""
        self.session.save(state)

    def restore(self, state: SavedState) -> None:
        """Return to a saved state."""
        self.session.restore(state)
