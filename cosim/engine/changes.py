"""What changes between the steps of a run: discrete inputs and tunable parameters."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from ..fmu.instance import Instance
from ..fmu.times import coincide
from ..system import Network, Port, Value, is_continuous_input
from ..system.description import Variable
from ..system.inputs import FunctionInput, Table
from .part import I, WiredPart


class Change(NamedTuple):
    """A value that a variable takes between two steps, at a time [s]."""

    time: float
    instance: Instance
    variable: Variable
    value: Value


def continuous_profiles(network: Network) -> list[tuple[Port, Table | FunctionInput]]:
    """The Real inputs, which move within steps, and what they follow."""
    return [(port, profile) for port, profile in network.inputs if is_continuous_input(port)]


def discrete_changes(
    network: Network, parts: Mapping[str, WiredPart[I]], start: float, stop: float
) -> list[Change]:
    """All other changes between start and stop [s], in their order."""
    moving = [port for port, _ in continuous_profiles(network)]
    changes = [
        Change(time, parts[port.part].instance, port.variable, profile.at(time))
        for port, profile in network.inputs
        if port not in moving
        for time in profile.jumps(start, stop)
    ]
    return sorted(changes, key=lambda change: change.time)


def with_changes(
    advance: Callable[[float, float], None], changes: Sequence[Change]
) -> Callable[[float, float], None]:
    """The same step from t by h [s], with the changes at t made and one inside split off."""
    times = [change.time for change in changes]

    def go(t: float, h: float) -> None:
        end, near = t + h, 64 * math.ulp(t)
        for change in changes[bisect_left(times, t - near) : bisect_right(times, end)]:
            if coincide(change.time, end):
                break
            if not coincide(change.time, t):
                advance(t, change.time - t)
                t, h = change.time, end - change.time
            change.instance.set(change.variable, change.value)
        advance(t, h)

    return go if changes else advance
