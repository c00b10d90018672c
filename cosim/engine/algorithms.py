"""How the parts of a system take a communication step together.

An explicit algorithm is a list of stages: the turns of a stage are taken with the values of its
beginning, and the next stage sees what they gave. `advance` makes of it a function advance(t, h)
that carries all parts from t to t + h [s] and leaves their outputs in their buffers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import FmuError, NonFiniteValueError, StepDiscarded
from .links import polynomial_value
from .operations import Operation
from .part import Part
from .snapshot import Snapshot

Advance = Callable[[float, float], None]
Vector = NDArray[np.float64]

MOST_SWEEPS = 50
TOLERANCE = 1e-12
MEMORY = 5


class Turn(NamedTuple):
    """A part's step within a communication step h: from t + at * h by size * h."""

    part: Part
    at: float
    size: float


Stages = list[list[Turn]]


class Timed(NamedTuple):
    """An operation of a step h: at t + at * h, for a turn of size * h."""

    operation: Operation
    at: float
    size: float


def jacobi(parts: Sequence[Part]) -> Stages:
    """All parts step with the values of the step's beginning."""
    return [[Turn(part, 0.0, 1.0) for part in parts]]


def gauss_seidel(parts: Sequence[Part]) -> Stages:
    """One after the other, each with the newest values of the ones before."""
    return [[Turn(part, 0.0, 1.0)] for part in parts]


def strang(parts: Sequence[Part]) -> Stages:
    """Symmetric: all but the last half a step, the last a full one, the others backwards."""
    *first, last = parts
    there = [[Turn(part, 0.0, 0.5)] for part in first]
    back = [[Turn(part, 0.5, 0.5)] for part in reversed(first)]
    return [*there, [Turn(last, 0.0, 1.0)], *back]


def program(stages: Stages) -> list[Timed]:
    """The operations of all stages, one after the other."""
    operations: list[Timed] = []
    for stage in stages:
        for part, at, size in stage:
            operations += (Timed(operation, at, size) for operation in part.turn())
        for part, at, size in stage:
            shown = (*part.look(), *part.ends)
            operations += (Timed(operation, at + size, size) for operation in shown)
    return operations


def explicit(program: Sequence[Timed]) -> Advance:
    """Run a program, one operation after the other, as loop.c does."""

    def advance(t: float, h: float) -> None:
        for operation, at, size in program:
            operation(t + at * h, size * h)

    return advance


def iterated(parts: Sequence[Part]) -> Advance:
    """Repeat the step until the outputs at its end are those that the inputs were made of.

    Rollback through the FMU state; fixed point with Anderson acceleration. An input that is held
    takes the value of the step's end, one of higher order runs there on a polynomial. Raises
    FmuError if MOST_SWEEPS do not bring every signal to TOLERANCE; StepDiscarded where a sweep runs
    into a value that is not finite.
    """
    outputs = [block for part in parts for block in part.outputs]
    real = [block for block in outputs if block.real]
    discrete = [block for block in outputs if not block.real]
    names = [name for block in real for name in block.names]
    turns = [operation for part in parts for operation in part.turn()]
    looks = [operation for part in parts for operation in part.look()]
    ledger = [end for part in parts for end in part.ends]

    def ends() -> Vector:
        return np.array([cell for block in real for cell in block.cells])

    def suppose(z: Vector, end: float) -> None:
        """Let the outputs at the step's end be z."""
        given = iter(z.tolist())
        for block in real:
            block.cells[:] = [next(given) for _ in block.cells]
        for part in parts:
            if part.curves is not None:
                part.curves.suppose(end)

    snapshot = Snapshot(parts)

    def advance(t: float, h: float) -> None:
        snapshot.take()
        z = ends()
        if parts[0].curves is not None:  # as their past tells them
            signals = (s for part in parts if part.curves for s in part.curves.signals)
            z = np.array([polynomial_value(signal.taylor(t), h) for signal in signals])
        mixing = Anderson()
        for sweep in range(MOST_SWEEPS):
            if sweep:
                snapshot.restore_fmus()
            suppose(z, t + h)
            before = [list(block.cells) for block in discrete]
            for operation in turns:
                operation(t, h)
            try:
                for operation in looks:
                    operation(t + h, h)
            except NonFiniteValueError as failure:
                raise StepDiscarded(str(failure), t) from failure
            image = ends()
            gap = np.abs(image - z) / (1.0 + np.abs(image))
            same = before == [list(block.cells) for block in discrete]
            if same and gap.max(initial=0.0) <= TOLERANCE:
                for end in ledger:
                    end(t + h, h)
                return
            z = mixing.next(z, image)
        worst = ", ".join(f"{name} by {g:.2g}" for name, g in zip(names, gap) if g > TOLERANCE)
        raise FmuError(
            f"no convergence in {MOST_SWEEPS} sweeps from t = {t!r} s; still off: {worst}"
        )

    return advance


class Anderson:
    """Accelerates z -> g(z): the next z is the mixture of the last g that leaves the least residual."""

    def __init__(self) -> None:
        self.images: list[Vector] = []
        self.residuals: list[Vector] = []

    def next(self, z: Vector, image: Vector) -> Vector:
        """The next guess after g(z) = image; shapes (n,)."""
        self.images = [*self.images, image][-MEMORY:]
        self.residuals = [*self.residuals, image - z][-MEMORY:]
        if len(self.images) == 1:
            return image
        steps = np.diff(np.array(self.residuals), axis=0).T
        share = np.linalg.lstsq(steps, self.residuals[-1], rcond=None)[0]
        mixed: Vector = image - np.diff(np.array(self.images), axis=0).T @ share
        return mixed


EXPLICIT: dict[str, Callable[[Sequence[Part]], Stages]] = {
    "jacobi": jacobi,
    "gauss-seidel": gauss_seidel,
    "strang": strang,
}
CONVERGENCE_ORDERS = {"jacobi": 1, "gauss-seidel": 1, "strang": 2, "iterated": 1}
ALGORITHMS = tuple(CONVERGENCE_ORDERS)


def convergence_order(algorithm: str, input_order: int, parts: Sequence[Part]) -> int:
    """The order at which the states converge.

    An FMU that cannot interpolate gets means, of order 2. Means and the half steps of Strang are of
    order 1 over outputs with direct feedthrough, which show an input from within the step.
    """
    if inputs_interpolated(input_order, parts):
        return input_order + 1
    if any(part.fed_through() for part in parts):
        return 1
    return 2 if input_order else CONVERGENCE_ORDERS[algorithm]


def inputs_interpolated(input_order: int, parts: Sequence[Part]) -> bool:
    """Whether all inputs move within a step, so that outputs belong to its end."""
    return input_order > 0 and all(p.curves is None or p.curves.capable for p in parts)


def first_order_outputs(algorithm: str, input_order: int, parts: Sequence[Part]) -> set[str]:
    """The outputs that show an input from within the step: whatever the order of the states, they
    converge with order 1.

    Strang's way back brings each part what those after it show at the step's end.
    """
    if inputs_interpolated(input_order, parts):
        return set()
    back = algorithm == "strang" and not input_order
    after = (parts[k:] if back else () for k in range(1, len(parts) + 1))
    return set[str]().union(*(part.following(others) for part, others in zip(parts, after)))
