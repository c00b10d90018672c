"""How the parts of a system take a communication step together.

An algorithm makes, from the parts in their order, a function advance(t, h) that carries all of them
from t to t + h [s] and leaves their outputs in their buffers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from .errors import PartFailure
from .part import Part

Advance = Callable[[float, float], None]
Vector = NDArray[np.float64]

MOST_SWEEPS = 50
TOLERANCE = 1e-12
MEMORY = 5


def jacobi(parts: Sequence[Part]) -> Advance:
    """All parts step with the values of the step's beginning."""

    def advance(t: float, h: float) -> None:
        for part in parts:
            part.write()
        for part in parts:
            part.step(t, h)
        for part in parts:
            part.read()

    return advance


def gauss_seidel(parts: Sequence[Part]) -> Advance:
    """One after the other, each with the newest values of the ones before."""

    def advance(t: float, h: float) -> None:
        for part in parts:
            turn(part, t, h)

    return advance


def strang(parts: Sequence[Part]) -> Advance:
    """Symmetric: all but the last half a step, the last a full one, the others backwards."""
    *first, last = parts

    def advance(t: float, h: float) -> None:
        half = h / 2
        for part in first:
            turn(part, t, half)
        turn(last, t, h)
        for part in reversed(first):
            turn(part, t + half, half)

    return advance


def turn(part: Part, t: float, h: float) -> None:
    """Give a part the newest values, step it, fetch its outputs."""
    part.write()
    part.step(t, h)
    part.read()


def iterated(parts: Sequence[Part]) -> Advance:
    """Repeat the step until the inputs are those that the outputs at its end give.

    Rollback through the FMU state; fixed point with Anderson acceleration. What an input does
    within the step is the FMU's affair: one that holds it takes the value of the step's end.
    Raises PartFailure if MOST_SWEEPS do not bring every signal to TOLERANCE.
    """

    def advance(t: float, h: float) -> None:
        for part in parts:
            part.save()
            part.listen()
        mixing = Anderson()
        for sweep in range(MOST_SWEEPS):
            if sweep:
                for part in parts:
                    part.restore()
            for part in parts:
                part.send()
                part.step(t, h)
                part.read()
            given = np.concatenate([part.real_inputs() for part in parts])
            changed = [part.listen() for part in parts]
            wanted = np.concatenate([part.real_inputs() for part in parts])
            gap = np.abs(wanted - given) / (1.0 + np.abs(wanted))
            if not any(changed) or gap.max(initial=0.0) <= TOLERANCE:
                return
            distribute(parts, mixing.next(given, wanted))
        names = [name for part in parts for name in part.real_input_names()]
        worst = ", ".join(f"{name} by {g:.2g}" for name, g in zip(names, gap) if g > TOLERANCE)
        raise PartFailure(
            f"no convergence in {MOST_SWEEPS} sweeps from t = {t!r} s: {worst} still off"
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


def distribute(parts: Sequence[Part], values: Vector) -> None:
    """Put a vector of all Real inputs into the parts' buffers."""
    place = 0
    for part in parts:
        place += part.take_reals(values[place:])


ALGORITHMS: dict[str, Callable[[Sequence[Part]], Advance]] = {
    "jacobi": jacobi,
    "gauss-seidel": gauss_seidel,
    "strang": strang,
    "iterated": iterated,
}

ORDERS = {"jacobi": 1, "gauss-seidel": 1, "strang": 2, "iterated": 1}
