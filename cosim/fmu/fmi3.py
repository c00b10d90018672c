"""FMI 3.0: a part that steps, with events and clocks within its steps, and values within them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from contextlib import suppress

from ..errors import EventReached, FmuError, StepDiscarded
from ..system.description import ModelDescription, Value, Variable
from .blocks import VariableBlock
from .blocks3 import block3
from .buffers import address
from .events3 import MOST_AT_ONCE, EventMode
from .instance import CoSimulation
from .library import Library
from .messages import DISCARD, OK
from .operations import Code, COperation
from .session import CO_SIMULATION, SavedState, Session
from .session3 import Session3
from .times import coincide, is_reached

#: The status of a function of ours that raised, for loop.c. A convention: FMI has none below 0.
RAISED = -1
#: Share of a step at its ends within which an event belongs to the end. Derived: FMUs locate events to about that.
NEAR = 1e-6
#: Share of a step by which the others stop past an event, so that they are on its far side. Derived: far
#: below NEAR, far above rounding.
PAST = 1e-9
FINISH = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, ctypes.c_double, ctypes.c_int)


class StepAnswer(ctypes.Structure):
    """The structure `answer` of loop.c: the time [s] that a step has reached, and why it ended there.

    It may have met an event, the end of the simulation, or its own end early.
    """

    _fields_ = [
        ("reached", ctypes.c_double),
        *((name, ctypes.c_bool) for name in ("event", "ended", "early")),
    ]


class IntermediateObserver:
    """Keeps the values that an instance shows within its steps, in `values` with their times [s]."""

    def __init__(self, variables: Sequence[Variable]) -> None:
        self.variables = variables
        self.values: list[tuple[float, list[float]]] = []
        self._block: VariableBlock | None = None
        self._elements: list[int] = []

    def open(self, session: Session) -> list[str]:
        """Read from this instance from now on; the names of what is read."""
        if not self.variables:
            return []
        self._block = block3(session, "Get", self.variables)
        self._elements = [self._block.variables.index(v) for v in self.variables]
        return [f"{session.name}.{v.name}" for v in self.variables]

    def on_update(
        self, _: object, t: float, __: bool, may: bool, ___: bool, ____: bool, *early: list[bool]
    ) -> None:
        """What the FMU calls within a step, when values may be got."""
        early[0][0] = False
        if may:
            with suppress(FmuError):
                self.observe(t)

    def observe(self, t: float) -> None:
        """Keep the values at time t [s]."""
        if self._block is not None:
            self._block.move()
            self.values.append((t, [self._block.cells[k] for k in self._elements]))

    def drop_after(self, t: float) -> None:
        """Drop the values of times after t [s], of a step that is taken again."""
        while self.values and self.values[-1][0] > t:
            self.values.pop()


class CoSimulation3(CoSimulation):
    """A part of FMI 3.0 that steps.

    A step that meets an event ends there, goes through event mode, and goes on to its end. An event that was told
    for that end, or the tick of a clock, waits for the other parts, see `Moments`, at the latest for the next step.
    """

    session: Session3

    def __init__(
        self,
        name: str,
        description: ModelDescription,
        fmu: Library,
        within: Sequence[Variable] = (),
    ) -> None:
        interface = description.offered_interface(CO_SIMULATION)
        shows, has_events = interface.providesIntermediateUpdate, interface.hasEventMode
        observed = [v for v in within if shows and v.intermediateUpdate and v.type == "Real"]
        self._observer = IntermediateObserver(observed)
        options: dict[str, object] = {
            "eventModeUsed": has_events,
            "earlyReturnAllowed": bool(interface.mightReturnEarlyFromDoStep),
        }
        if observed:
            options["intermediateUpdate"] = self._observer.on_update
            references = dict.fromkeys(v.valueReference for v in observed)
            options["requiredIntermediateVariables"] = list(references)
        session = Session3(name, description, fmu, CO_SIMULATION, event_mode=has_events, **options)
        super().__init__(session, ctypes.c_bool())
        self.watched = self._observer.open(session)
        self.intermediate_values = self._observer.values
        self.events = EventMode(session, used=has_events, observe=self._observer.observe)
        self._inputs: Sequence[VariableBlock] = ()
        self._refuses_events = False
        self._answer = StepAnswer()
        self._raised: Exception | None = None
        self._step = self._step_call()
        # for loop.c: finish a step that meets events, and take inputs that have changed
        self._finish = FINISH(
            lambda t, h, stepped: self._status(
                lambda: self._step_through_events(t, h, stepped=bool(stepped))
            )
        )
        self._take = FINISH(lambda t, _, __: self._status(lambda: self.enter_changed_inputs(t)))

    def _step_call(self) -> Callable[[], int]:
        """The prepared call of a step of the size and from the time that are set."""
        answer = ctypes.addressof(self._answer)
        offsets = (
            StepAnswer.event.offset,
            StepAnswer.ended.offset,
            StepAnswer.early.offset,
            StepAnswer.reached.offset,
        )
        results = [ctypes.c_void_p(answer + offset) for offset in offsets]
        function, component = self.session.fmu.free.fmi3DoStep, self.session.component

        def call() -> int:
            status: int = function(component, self._begin, self._size, self._forward, *results)
            return status

        return call

    def enter_initialisation(
        self, tolerance: float | None, start: float, stop: float | None
    ) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""
        self.events.now = start
        super().enter_initialisation(tolerance, start, stop)

    def connect_inputs(self, blocks: Sequence[VariableBlock]) -> None:
        """Note the blocks by which wires set inputs; event mode takes some of them."""
        self._inputs = blocks
        self.events.held = [block for block in blocks if block.held]

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable, in event mode if steps have begun."""
        if variable.type == "Binary":
            self.session.set_binary(variable, str(value))
            return
        block = self.session.element_block(variable, value)
        if block.held and self.session.is_stepping:
            self.events.enter_inputs([block])
        else:
            block.move()
        name = f"{self.session.name}.{variable.name}"
        for other in self._inputs:  # which hand the whole array over once more
            if name in other.names:
                other.put(other.names.index(name), value)
        self.events.remember_entered_inputs()

    def leave_initialisation(self, *, waits: bool = False) -> None:
        """Leave initialisation mode for the first step, with the events and ticks of the start unless they wait."""
        self.events.start_clocks()
        self.session.leave_initialisation()
        self.events.begin_stepping()
        if not waits:
            self.events.happen(self.events.now, event=False)

    def reset(self) -> None:
        """Be as if made anew."""
        self.session.reset()
        self.events.reset()
        self.intermediate_values.clear()

    def advance(self, t: float, h: float) -> None:
        """Step from t by h [s]; raises FmuError, StepDiscarded, EventReached, SimulationTerminated."""
        self._step_through_events(t, h, stepped=False)

    def _step_through_events(self, t: float, h: float, *, stepped: bool) -> None:
        """Step from t by h [s] by way of its events; the first piece may have been `stepped` already."""
        begin, end, at_once = t, t + h, 0
        due = self.events.due
        self._observer.drop_after(t)
        if not stepped and is_reached(due.value, t):
            self.events.happen(t, event=False)
        while True:
            size = h if is_reached(end, due.value) else due.value - t
            if size < h:
                self._refuse_event_within(due.value, begin, end)
            if not stepped:
                status = self.step_status(t, size)
                if status != OK:
                    self.stepped(t, size, status)
            stepped, answer = False, self._answer
            reached = min(answer.reached if answer.early else t + size, end)
            at_once = at_once + 1 if is_reached(reached, t) else 0
            if answer.ended:
                raise self.session.terminated(reached)
            if answer.event:
                self._refuse_event_within(reached, begin, end, PAST)
            if at_once > MOST_AT_ONCE:
                name = self.session.name
                raise FmuError(f"{name}: its steps make no progress from t = {t!r} s")
            self.events.now = t = end if coincide(reached, end) else reached
            self._go_through_events_before(end, event=answer.event)
            if t == end:
                return
            h = end - t

    def _go_through_events_before(self, end: float, *, event: bool) -> None:
        """Go through what is due now, unless it was told for the end of a step [s]: it waits for other parts."""
        t = self.events.now
        if t < end or not is_reached(self.events.due.value, t):
            self.events.happen(t, event=event)

    def _refuse_event_within(self, t: float, begin: float, end: float, past: float = 0.0) -> None:
        """Refuse a step in which an event is at time t [s], if all are to stop there or just past it."""
        size = end - begin
        if self._refuses_events and begin + NEAR * size < t < end - NEAR * size:
            event = f"{self.session.name} has an event at t = {t!r} s"
            raise EventReached(event, t + past * size)

    def stepped(self, t: float, h: float, status: int) -> None:
        """Keep a warning of a step from t by h [s]; raise FmuError for a worse status."""
        if status == RAISED and self._raised is not None:
            raise self._raised
        call = f"doStep(t = {t!r} s, h = {h!r} s)"
        if status == DISCARD:
            failure = self.session.failure(call, status)
            raise StepDiscarded(str(failure), self._reached(t, h))
        self.session.answered(call, status)

    def _reached(self, t: float, h: float) -> float:
        """The time [s] that a discarded step from t by h [s] has reached."""
        reached: float = self._answer.reached
        return reached if t < reached < t + h else t

    def last_success(self) -> tuple[int, float, bool]:
        """Of a discarded step: OK, the time reached [s], whether that is the end."""
        return OK, self._answer.reached, self._answer.ended

    def come_to(self, t: float) -> None:
        """Note the time [s] that steps of loop.c have reached."""
        self.events.now = t

    def step_c_operation(self) -> COperation:
        """What loop.c does in place of `advance`."""
        return COperation(
            Code.STEP3,
            function=ctypes.cast(self.session.library.fmi3DoStep, ctypes.c_void_p).value,
            component=self.session.component.value,
            cells=ctypes.addressof(self._answer),
            first=ctypes.addressof(self.events.due),
            source=ctypes.cast(self._finish, ctypes.c_void_p).value,
        )

    @property
    def next_event(self) -> float:
        """The time of the next event [s] that is known in advance, of a clock too."""
        return self.events.due.value

    def go_through_event(self, t: float) -> None:
        """Take the inputs of time t [s], and go through the event that is due then."""
        self.events.happen(t, event=False)

    def next_event_address(self) -> int | None:
        """Where the time of the next event [s] stands."""
        return ctypes.addressof(self.events.due)

    def has_event_outputs(self, outputs: Sequence[VariableBlock]) -> bool:
        """Whether one of these outputs is changed by its events alone, and a step can end there."""
        variables = (v for block in outputs for v in block.variables)
        return self.events.used and any(v.variability != "continuous" for v in variables)

    def refuse_steps_across_events(self, *, refuses: bool) -> None:
        """Refuse steps across an event from now on, or take them; the system then steps to the event."""
        self._refuses_events = refuses

    def enter_changed_inputs(self, t: float) -> None:
        """Enter the inputs that event mode takes, if one has changed."""
        self.events.enter_changed_inputs(t)

    def input_c_operation(self, block: VariableBlock) -> COperation | None:
        """What loop.c does in place of `enter_changed_inputs`, if this block has changed.

        None if it is not held, and for texts, whose memory is Python's.
        """
        cells, entered = block.cells, block.entered
        if entered is None or cells._type_ is ctypes.c_char_p:
            return None
        function, size = ctypes.cast(self._take, ctypes.c_void_p).value, ctypes.sizeof(cells)
        return COperation(
            Code.ENTER, size, function=function, cells=address(cells), source=address(entered)
        )

    def save(self, state: SavedState) -> None:
        """Put the FMU's state into a place, instead of what was there, and what is known of its events."""
        super().save(state)
        state.events = self.events.state()

    def restore(self, state: SavedState) -> None:
        """Return to a saved state."""
        super().restore(state)
        if state.events is not None:
            self.events.restore(state.events)

    def _status(self, act: Callable[[], None]) -> int:
        """OK, or RAISED if the function raises, whose exception is kept."""
        try:
            act()
        except Exception as error:  # noqa: BLE001
            self._raised = error
            return RAISED
        return OK
