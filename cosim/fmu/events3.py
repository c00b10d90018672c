"""Event mode of FMI 3.0: inputs that it takes, events and ticks until none is due."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Sequence
from copy import copy

from ..errors import FmuError
from ..system.description import Variable
from .blocks import VariableBlock
from .clocks import EventState, IntervalClock
from .session import Session
from .times import is_reached

#: The interval of a clock is known and as it was: fmi3IntervalUnchanged, a convention of FMI 3.0.
UNCHANGED = 1
#: The interval of a clock is new: fmi3IntervalChanged, a convention of FMI 3.0.
CHANGED = 2
#: Events at one time after which a part makes no progress. A convention: cascades of a few are real.
MOST_AT_ONCE = 100


class EventMode:
    """When the events of an instance are due, and how it goes through them.

    `due` is the time of the next event that is known in advance, `now` the time of the part [s]; `held`
    are the blocks of inputs that event mode takes, `waiting` those that it takes with the event of the present time.
    `observe` is called with the time before and after each event.
    """

    def __init__(self, session: Session, *, used: bool, observe: Callable[[float], None]) -> None:
        self.session, self.used = session, used
        self.due = ctypes.c_double(math.inf)
        self.now = 0.0
        self.held: list[VariableBlock] = []
        self.waiting: list[VariableBlock] = []
        self._is_starting = False
        self._observe = observe
        self._clocks: list[IntervalClock] = []

    def reset(self) -> None:
        """Know of no event, as of an instance that has been made anew."""
        self.due.value, self.held, self.waiting, self._clocks = math.inf, [], [], []
        self._is_starting = False

    def begin_stepping(self) -> None:
        """After initialisation mode has been left, stay in event mode, for the events and ticks of the start."""
        for block in self.held:
            block.remember_entered_inputs()
        if self.used:
            self.due.value, self._is_starting = self.now, True

    def start_clocks(self) -> None:
        """Read the clocks, while the instance is in initialisation mode."""
        self._clocks = [
            self._started_clock(v)
            for v in self.session.description.modelVariables
            if v.type == "Clock" and v.causality == "input"
        ]

    def enter_inputs(self, blocks: Sequence[VariableBlock]) -> None:
        """Enter the inputs of these blocks, at the time of the part, with the event that is due then if there is one."""
        if is_reached(self.due.value, self.now):
            self.waiting += blocks
        else:
            self._event(self.now, blocks)

    def enter_changed_inputs(self, t: float) -> None:
        """Enter the held inputs, which event mode takes, at time t [s], if one has changed and no event waits for them."""
        if not is_reached(self.due.value, t) and any(block.has_changed() for block in self.held):
            self._event(t, self.held)
            self.remember_entered_inputs()

    def remember_entered_inputs(self) -> None:
        """Note that event mode has taken the present held inputs."""
        for block in self.held:
            block.remember_entered_inputs()

    def happen(self, t: float, *, event: bool) -> None:
        """Go through event mode at time t [s], if an event is due there, until none is: inputs first, then clocks tick."""
        for _ in range(MOST_AT_ONCE):
            if not event and not is_reached(self.due.value, t):
                return
            clocks = [c for c in self._clocks if is_reached(c.due, t)]
            for clock in clocks:
                clock.tick()
            self._observe(t)
            blocks, self.waiting = [*self.waiting, *self.held], []
            self._event(t, blocks, [c.variable.valueReference for c in clocks])
            self.remember_entered_inputs()
            self._observe(t)
            event = False
        raise FmuError(f"{self.session.name}: events follow each other without end at t = {t!r} s")

    def state(self) -> EventState:
        """What the master keeps of the events."""
        entered = tuple(list[object](block.entered or ()) for block in self.held)
        return EventState(self.due.value, self.now, entered, tuple(map(copy, self._clocks)))

    def restore(self, state: EventState) -> None:
        """Return to a saved state."""
        self.due.value, self.now = state.due, state.now
        for block, cells in zip(self.held, state.entered):
            if block.entered is not None:
                block.entered[:] = cells
        self._clocks = list(map(copy, state.clocks))

    def _started_clock(self, clock: Variable) -> IntervalClock:
        """A clock as it starts, with the interval of the description or what the FMU says."""
        counts = clock.intervalVariability == "countdown"
        interval, qualifier = clock.interval, UNCHANGED
        if interval is None or counts:
            interval, qualifier = self._interval(clock)
        if not qualifier:
            name = f"{self.session.name}.{clock.name}"
            raise FmuError(f"{name}: the interval of the clock is not known")
        ticking = IntervalClock(clock, math.inf if counts else self.now + clock.shift, interval)
        if counts and qualifier == CHANGED:
            ticking.restart(self.now, interval)
        return ticking

    def _event(
        self, t: float, blocks: Iterable[VariableBlock] = (), clocks: Sequence[int] = ()
    ) -> None:
        """Event mode, in which inputs are set and clocks are active, and back."""
        if not self._is_starting:
            self.session.call("enterEventMode")
        self._is_starting = False
        for block in blocks:
            block.move()
        if clocks:
            self.session.call("setClock", clocks, [True] * len(clocks))
        self._update(t)
        self.session.call("enterStepMode")

    def _update(self, t: float) -> None:
        """Iterate event mode; learn when the next event and the next ticks are due."""
        for _ in range(MOST_AT_ONCE):
            again, end, _, _, timed, time = self.session.call("updateDiscreteStates")
            if end:
                raise self.session.terminated(t)
            if not again:
                break
        else:
            raise FmuError(f"{self.session.name}: its discrete states do not settle at t = {t!r} s")
        for clock in self._clocks:
            if clock.kind in ("tunable", "changing", "countdown"):
                interval, qualifier = self._interval(clock.variable)
                if qualifier == CHANGED:
                    clock.restart(t, interval)
        event = time if timed else math.inf
        self.due.value = min([event, *(clock.due for clock in self._clocks)])

    def _interval(self, clock: Variable) -> tuple[float, int]:
        """The interval of a clock [s], and whether the FMU knows it (1) or has changed it (2)."""
        interval, qualifier = (ctypes.c_double * 1)(), (ctypes.c_int * 1)()
        reference = (ctypes.c_uint * 1)(clock.valueReference)
        self.session.call("getIntervalDecimal", reference, interval, qualifier)
        return interval[0], qualifier[0]
