"""What changes between the steps of a run: discrete inputs and tunable parameters."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from fmpy.model_description import ScalarVariable

from ..inputs import Course, Table
from ..system import Network, Port, Value, moves
from .clock import same
from .exchange import Coupled


class Change(NamedTuple):
    """A value that a variable takes between two steps, at a time [s]."""

    time: float
    part: Coupled
    variable: ScalarVariable
    value: Value


def fed(network: Network) -> list[tuple[Port, Table | Course]]:
    """The Real inputs, which move within steps, and what they follow."""
    return [(port, profile) for port, profile in network.inputs if moves(port)]


def changes(
    network: Network, parts: Mapping[str, Coupled], start: float, stop: float
) -> list[Change]:
    """All other changes between start and stop [s], in their order."""
    moving = [port for port, _ in fed(network)]
    found = [
        Change(time, parts[port.part], port.variable, profile.at(time))
        for port, profile in network.inputs
        if port not in moving
        for time in profile.jumps(start, stop)
    ]
    return sorted(found, key=lambda change: change.time)


def changing(
    advance: Callable[[float, float], None], changes: Sequence[Change]
) -> Callable[[float, float], None]:
    """The same step from t by h [s], with the changes at t made and one inside split off."""
    times = [change.time for change in changes]

    def go(t: float, h: float) -> None:
        end, near = t + h, 64 * math.ulp(t)
        for change in changes[bisect_left(times, t - near) : bisect_right(times, end)]:
            if same(change.time, end):
                break
            if not same(change.time, t):
                advance(t, change.time - t)
                t, h = change.time, end - change.time
            change.part.set(change.variable, change.value)
        advance(t, h)

    return go if changes else advance
