"""Events that parts tell in advance, and ticks of clocks: all parts step to them, and they happen in one order."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial

from ..errors import EventReached, FmuError
from ..fmu.blocks import VariableBlock
from ..fmu.operations import Code, COperation, Operation
from ..fmu.times import is_reached
from .part import Part
from .schedule import Advance
from .settle import settle_wires

#: Events at one time after which parts make no progress. A convention: cascades of a few are real.
MOST_AT_ONCE = 100


class EventDueError(FmuError):
    """A part has told of an event within or at the end of the next step."""


class EventWatch(Operation):
    """Stops loop.c before a step that reaches the event of which a part has told."""

    def __init__(self, part: Part, address: int) -> None:
        self.part, self._address = part, address

    def __call__(self, t: float, h: float) -> None:
        """In Python, `Moments` looks for events."""

    def c_operation(self) -> COperation:
        """A look at the time of the event."""
        return COperation(Code.WATCH, first=self._address)

    def answered(self, t: float, h: float, status: int) -> None:  # noqa: ARG002
        """Raise EventDueError."""
        raise EventDueError(f"{self.part.name} has an event by t = {t + h!r} s")


def event_watches(parts: Sequence[Part]) -> list[EventWatch]:
    """The watches of the parts that may tell of events."""
    told = [(part, part.instance.next_event_address()) for part in parts]
    return [EventWatch(part, address) for part, address in told if address is not None]


class Moments:
    """What is to happen at the times of events that `parts`, in their stepping order, tell in advance.

    One rule for every algorithm and step: inputs take their values of that time and the wires are followed until
    nothing changes; then the parts with an event or a tick go through it one after the other, each once and with what
    those before it have given. Parts step to that time unless some are `unable` to vary their step, of which is warned.
    Steps across an event are split, or, where `refuses` is set, end by EventReached and are to be taken again.
    """

    refuses = False

    def __init__(self, parts: Sequence[Part], unable: Collection[str]) -> None:
        self.parts, self.unable = parts, unable

    def next(self) -> float:
        """The time of the next event [s]."""
        return min(part.instance.next_event for part in self.parts)

    def happen(self, t: float) -> bool:
        """Go through the events that are due at t [s]; whether there was one. Raises FmuError."""
        for n in range(MOST_AT_ONCE):
            due = [part for part in self.parts if is_reached(part.instance.next_event, t)]
            if not due:
                return n > 0
            self._exchange(t)
            for part in due:
                part.instance.go_through_event(t)
                self._exchange(t)
        raise FmuError(f"events of the parts follow each other without end at t = {t!r} s")

    def met(self, advance: Advance, waits: Callable[[float], bool]) -> Advance:
        """The same step by way of the events, those of its end included unless that `waits` for a jump."""
        if not event_watches(self.parts):
            return advance

        def go(t: float, h: float) -> None:
            end = t + h
            if not waits(t):
                self.happen(t)
            while True:
                event = self.next()
                if not self._is_inside(event, t, end):
                    break
                if self.refuses:
                    raise EventReached(f"an event is due at t = {event!r} s", event)
                advance(t, event - t)
                t, h = event, end - event
                self.happen(t)
            advance(t, h)
            if not waits(end):
                self.happen(end)

        return go

    def _is_inside(self, event: float, t: float, end: float) -> bool:
        """Whether a step from t to the end [s] is to be split at an event."""
        if is_reached(event, t) or is_reached(end, event):
            return False
        if not self.unable:
            return True
        for part in self.parts if len(self.parts) > 1 else ():
            if part.instance.next_event == event:
                part.messages.keep_warning(
                    f"events or ticks lie within steps, the first at t = {event!r} s, and {', '.join(self.unable)} "
                    "cannot vary the step: other parts see them at its end; take a step that ends there"
                )
        return False

    def _exchange(self, t: float) -> None:
        """Let inputs take their values of time t [s]; follow the wires until nothing changes, or once for each part."""
        for feed in (feed for part in self.parts for feed in part.feeds):
            feed.cell[0] = float(feed.profile.at(t))
        settle_wires(self.parts, len(self.parts) + 1, enter=partial(_enter, t))


def _enter(t: float, part: Part, block: VariableBlock) -> None:
    """Let a part take inputs at time t [s], by event mode if need be."""
    if block.held:
        part.instance.enter_changed_inputs(t)
    else:
        block.move()
