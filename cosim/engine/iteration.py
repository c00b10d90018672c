"""A communication step that is repeated until the outputs at its end are those that its inputs were made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import FmuError, NonFiniteValueError, SetupError, StepDiscarded
from ..fmu.blocks import VariableBlock
from .algorithms import Algorithm, Turn
from .hermite import polynomial_value
from .part import Part, step_operations
from .snapshot import Snapshot

Array = NDArray[np.float64]

#: Limits the sweeps of a step. Derived: a sweep that halves the error takes 40 to come from 1 to the tolerance.
MOST_SWEEPS = 50
#: The change of a signal in a sweep over its size, below which it has converged. Derived: some thousand
#: times the rounding error of a double, 2.2e-16, which FMUs that integrate inside multiply.
TOLERANCE = 1e-12
#: Residuals that Anderson's method combines. A convention: Walker and Ni, SIAM J. Numer. Anal. 49 (2011), use 3 to 5.
MEMORY = 5


class Iteration:
    """An implicit algorithm's step; called, it carries all parts from t to t + h [s].

    A fixed point by Anderson's method, with rollback through the FMU state. A held input takes the
    algorithm's mixture of what its source has shown at the beginning and shows at the end of the step;
    one of higher degree runs on a polynomial to that end.

    Raises
    ------
    SetupError
        If the algorithm's stages are not one stage of whole steps.
    FmuError
        On a call, if MOST_SWEEPS do not bring every signal to TOLERANCE.
    StepDiscarded
        On a call, where a sweep runs into a value that is not finite.
    """

    def __init__(self, algorithm: Algorithm, parts: Sequence[Part]) -> None:
        names = [part.name for part in parts]
        stages = algorithm.stages(names)
        if [set(stage) for stage in stages] != [{Turn(name) for name in names}]:
            raise SetupError(
                f"algorithm {algorithm.name!r}: an implicit algorithm must have one stage, of whole steps"
            )
        self._weight, self._parts = algorithm.end_weight, parts
        outputs = [block for part in parts for block in part.outputs]
        self._real = [block for block in outputs if block.real]
        self._discrete = [block for block in outputs if not block.real]
        self._names = [name for block in self._real for name in block.names]
        self._nominal = np.array([x for block in self._real for x in block.nominals()])
        self._turns = [operation for part in parts for operation in step_operations(part)]
        self._reads = [operation for part in parts for operation in part.read_operations()]
        self._bond_sides = [side for part in parts for side in part.bond_sides]
        self._snapshot = Snapshot(parts)

    def __call__(self, t: float, h: float) -> None:
        """Repeat the step from t by h [s] until its outputs agree; raises as the class says."""
        self._snapshot.take()
        begin = _values(self._real)
        z = self._prediction(t, h, begin)
        mixing = Anderson()
        for sweep in range(MOST_SWEEPS):
            if sweep:
                self._snapshot.restore_fmus()
            self._assume_end(begin, z, t + h)
            supposed = [list(block.cells) for block in self._discrete]
            self._sweep(t, h)
            image = _values(self._real)
            change = np.abs(image - z) / (self._nominal + np.abs(image))
            is_settled = supposed == [list(block.cells) for block in self._discrete]
            if is_settled and change.max(initial=0.0) <= TOLERANCE:
                for side in self._bond_sides:
                    side(t + h, h)
                return
            z = mixing.next(z, image)
        worst = ", ".join(
            f"{name} by {x:.2g}" for name, x in zip(self._names, change) if x > TOLERANCE
        )
        raise FmuError(
            f"no convergence in {MOST_SWEEPS} sweeps from t = {t!r} s; still off: {worst}"
        )

    def _prediction(self, t: float, h: float, begin: Array) -> Array:
        """The outputs at the end as their past continues, or as they are; shape (outputs,)."""
        if self._parts[0].curves is None:
            return begin
        signals = (s for part in self._parts if part.curves for s in part.curves.signals)
        return np.array([polynomial_value(signal.taylor(t), h) for signal in signals])

    def _assume_end(self, begin: Array, z: Array, end: float) -> None:
        """Let the outputs at the step's end be z."""
        _put(self._real, z)
        for part in self._parts:
            if part.curves is not None:
                part.curves.remember_outputs(end)
        if self._weight != 1.0:
            _put(self._real, (1.0 - self._weight) * begin + self._weight * z)

    def _sweep(self, t: float, h: float) -> None:
        for operation in self._turns:
            operation(t, h)
        try:
            for operation in self._reads:
                operation(t + h, h)
        except NonFiniteValueError as failure:
            raise StepDiscarded(str(failure), t) from failure


def _values(blocks: Sequence[VariableBlock]) -> Array:
    return np.array([cell for block in blocks for cell in block.cells])


def _put(blocks: Sequence[VariableBlock], values: Array) -> None:
    numbers = iter(values.tolist())
    for block in blocks:
        block.cells[:] = [next(numbers) for _ in block.cells]


class Anderson:
    """Accelerates z -> g(z): the next z is the mixture of the last g that leaves the least residual.

    D. G. Anderson, Iterative procedures for nonlinear integral equations, J. ACM 12 (1965).
    """

    def __init__(self) -> None:
        self.images: list[Array] = []
        self.residuals: list[Array] = []

    def next(self, z: Array, image: Array) -> Array:
        """The next guess after g(z) = image; shapes (n,)."""
        self.images = [*self.images, image][-MEMORY:]
        self.residuals = [*self.residuals, image - z][-MEMORY:]
        if len(self.images) == 1:
            return image
        steps = np.diff(np.array(self.residuals), axis=0).T
        weights = np.linalg.lstsq(steps, self.residuals[-1], rcond=None)[0]
        mixed: Array = image - np.diff(np.array(self.images), axis=0).T @ weights
        return mixed
