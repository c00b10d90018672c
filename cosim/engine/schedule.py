"""The schedule of a communication step: an algorithm's stages as operations, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

from ..fmu.operations import Operation
from .algorithms import CouplingContext, Feedthrough, Stage
from .part import Part, step_operations

#: It carries all parts from t to t + h [s] and leaves their outputs in their buffers.
Advance = Callable[[float, float], None]


class TimedOperation(NamedTuple):
    """An operation of a step h: at t + at * h, for a turn of size * h."""

    operation: Operation
    at: float
    size: float


def schedule(stages: Sequence[Stage], parts: Mapping[str, Part]) -> list[TimedOperation]:
    """The operations of all stages: of each, first the turns, then what is read and booked of them."""
    operations: list[TimedOperation] = []
    for stage in stages:
        for name, begin, fraction in stage:
            turn = step_operations(parts[name])
            operations += (TimedOperation(operation, begin, fraction) for operation in turn)
        for name, begin, fraction in stage:
            part = parts[name]
            after = chain(part.read_operations(), part.bond_sides)
            operations += (TimedOperation(each, begin + fraction, fraction) for each in after)
    return operations


def explicit(operations: Sequence[TimedOperation]) -> Advance:
    """Do the operations one after the other, as loop.c does."""

    def advance(t: float, h: float) -> None:
        for operation, at, size in operations:
            operation(t + at * h, size * h)

    return advance


def coupling_context(parts: Sequence[Part], input_degree: int) -> CouplingContext:
    """What of these parts, in their stepping order, decides how fast an algorithm converges."""
    driver = {n: part.name for part in parts for block in part.outputs for n in block.names}
    feedthroughs: list[Feedthrough] = []
    for part in parts:
        wired = {n for block in part.outputs if block.real for n in block.names}
        feedthroughs += (
            Feedthrough(output, part.name, sources, output in wired)
            for output, sources in part.drivers_of_outputs(driver).items()
        )
    interpolates = all(part.curves is None or part.curves.capable for part in parts)
    return CouplingContext([p.name for p in parts], feedthroughs, input_degree, interpolates)
