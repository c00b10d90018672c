"""What changes between the steps of a run: discrete inputs and tunable parameters."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from ..fmu.instance import Instance
from ..fmu.times import coincide
from ..system import Network, Port, Value, is_continuous_input
from ..system.description import Variable
from ..system.inputs import FunctionInput, TableInput
from .part import I, WiredPart
from .sources import InputSource


class TimedChange(NamedTuple):
    """A value that a variable takes between two steps, at a time [s]."""

    time: float
    instance: Instance
    variable: Variable
    value: Value


def continuous_profiles(network: Network) -> list[tuple[Port, TableInput | FunctionInput]]:
    """The Real inputs, which move within steps, and what they follow."""
    return [(port, profile) for port, profile in network.inputs if is_continuous_input(port)]


def discrete_changes(
    network: Network, parts: Mapping[str, WiredPart[I]], start: float, stop: float
) -> list[TimedChange]:
    """All other changes between start and stop [s], in their order."""
    moving = [port for port, _ in continuous_profiles(network)]
    changes = [
        TimedChange(time, parts[port.part].instance, port.variable, profile.at(time))
        for port, profile in network.inputs
        if port not in moving
        for time in profile.jumps(start, stop)
    ]
    return sorted(changes, key=lambda change: change.time)


def held_inputs(network: Network, start: float, t: float) -> dict[str, Value]:
    """The values just before t [s] of the inputs and parameters that change between steps, by name."""
    values = {}
    for port, profile in network.inputs:
        if not is_continuous_input(port):
            changes = [time for time in profile.jumps(start, t) if not coincide(time, t)]
            values[port.name] = profile.at(changes[-1] if changes else start)
    return values


class Jump(NamedTuple):
    """What happens at once at a time [s]: changes, and jumps of the inputs that follow `sources`."""

    time: float
    changes: Sequence[TimedChange]
    sources: Sequence[InputSource]


def known_jumps(
    changes: Sequence[TimedChange], sources: Iterable[InputSource], start: float, stop: float
) -> list[Jump]:
    """The jumps between start and stop [s], in their order; times that differ by rounding are one."""
    events: list[tuple[float, TimedChange | InputSource]] = [(each.time, each) for each in changes]
    events += [(t, source) for source in sources for t in source.profile.jumps(start, stop)]
    groups: list[list[tuple[float, TimedChange | InputSource]]] = []
    for event in sorted(events, key=lambda event: event[0]):
        if groups and coincide(groups[-1][0][0], event[0]):
            groups[-1].append(event)
        else:
            groups.append([event])
    return [
        Jump(
            group[0][0],
            [each for _, each in group if isinstance(each, TimedChange)],
            [each for _, each in group if isinstance(each, InputSource)],
        )
        for group in groups
    ]


def with_jumps(
    advance: Callable[[float, float], None],
    jumps: Sequence[Jump],
    occur: Callable[[float, float, Jump], None],
) -> Callable[[float, float], None]:
    """The same step from t by h [s], before which a jump at t is to `occur`, and which changes inside it split.

    An input that jumps inside a step does not split it: its part gets the mean.
    """
    times = [jump.time for jump in jumps]

    def go(t: float, h: float) -> None:
        end, near = t + h, 64 * math.ulp(t)
        for jump in jumps[bisect_left(times, t - near) : bisect_right(times, end)]:
            if coincide(jump.time, end):
                break
            if not coincide(jump.time, t):
                if not jump.changes:
                    continue
                advance(t, jump.time - t)
                t, h = jump.time, end - jump.time
            occur(t, h, jump)
        advance(t, h)

    return go if jumps else advance
