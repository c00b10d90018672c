"""What changes between the steps of a run: discrete inputs and tunable parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
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


def value_before(profile: TableInput | FunctionInput, t: float) -> Value:
    """The value just before t [s], where a jump may be."""
    jumps = (time for time in profile.jumps(-math.inf, t) if coincide(time, t))
    value: Value = profile.before(next(jumps, t))
    return value


def inputs_before(network: Network, t: float) -> dict[str, Value]:
    """The values just before t [s] of inputs over time and of parameters that change, by name."""
    return {port.name: value_before(profile, t) for port, profile in network.inputs}


class Jump(NamedTuple):
    """What happens at once at a time [s]: changes; with none of them, an input over time jumps."""

    time: float
    changes: list[TimedChange]


def source_jumps(sources: Iterable[InputSource], start: float, stop: float) -> list[float]:
    """The times [s] between start and stop at which inputs over time jump."""
    return [t for source in sources for t in source.profile.jumps(start, stop)]


def known_jumps(changes: Sequence[TimedChange], times: Iterable[float]) -> list[Jump]:
    """The changes, and the jumps of inputs at these times [s], in their order; times that differ by rounding are one."""
    events: list[tuple[float, list[TimedChange]]] = [(each.time, [each]) for each in changes]
    events += [(t, []) for t in times]
    jumps: list[Jump] = []
    for time, at_once in sorted(events, key=lambda event: event[0]):
        if jumps and coincide(jumps[-1].time, time):
            jumps[-1].changes.extend(at_once)
        else:
            jumps.append(Jump(time, at_once))
    return jumps
