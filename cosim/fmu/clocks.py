"""Clocks with an interval, and when they tick."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..system.description import Variable


@dataclass(frozen=True)
class EventState:
    """What the master keeps of a part's events.

    These are the times [s] at which the next is due and of the part now, the inputs that event mode took
    last, block by block, and its clocks.
    """

    due: float
    now: float
    entered: tuple[list[object], ...]
    clocks: tuple[IntervalClock, ...]


class IntervalClock:
    """A clock with an interval, and the time at which it ticks next [s]."""

    def __init__(self, variable: Variable, begin: float, interval: float) -> None:
        self.variable, self.interval = variable, interval
        self.kind = variable.intervalVariability
        self.begin, self.count = begin, 0

    @property
    def due(self) -> float:
        """The time of the next tick [s], without the rounding errors of a sum of intervals."""
        return self.begin + self.count * self.interval if self.count else self.begin

    def tick(self) -> None:
        """Go on to the next tick; a countdown waits for a new interval."""
        if self.kind == "countdown":
            self.begin = math.inf
        else:
            self.count += 1

    def restart(self, t: float, interval: float) -> None:
        """Tick an interval [s] after the time t [s], and from there on."""
        self.begin, self.interval, self.count = t, interval, 1
