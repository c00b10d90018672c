"""Values over the wires until nothing changes any more; what feeds back on itself by Newton's method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SetupError
from ..fmu.blocks import VariableBlock
from .newton import solve_fixed_point
from .part import I, WiredPart

Vector = NDArray[np.float64]


def settle_wires(
    parts: Sequence[WiredPart[I]],
    sweeps: int,
    *,
    takes: Callable[[VariableBlock], bool] = lambda _: True,
    reads: Callable[[VariableBlock], bool] = lambda _: True,
    enter: Callable[[WiredPart[I], VariableBlock], None] = lambda _, block: block.move(),
    is_start: bool = False,
) -> int | None:
    """After how many sweeps over the parts no input changes any more; None if one still does after so many.

    Parts show outputs, of which some are read, at first and where they have taken inputs. A part `takes` inputs, which it is
    to `enter` where they have changed; at a start it takes all at first, and what is not finite is left out.
    """
    for block in (block for part in parts for block in part.outputs if reads(block)):
        block.move()
    for sweep in range(sweeps):
        has_changed = False
        for part in parts:
            before = [list(block.cells) for block in part.inputs]
            part.apply_links()
            for block, old in zip(part.inputs, before) if is_start else ():
                if block.real:
                    now = zip(block.cells, old)
                    block.cells[:] = [new if isfinite(new) else kept for new, kept in now]
            fresh = [
                block
                for block, old in zip(part.inputs, before)
                if list(block.cells) != old and takes(block)
            ]
            taken = part.inputs if is_start and not sweep else fresh
            for block in taken:
                enter(part, block)
            for block in filter(reads, part.outputs) if taken else ():
                block.move()
            has_changed = has_changed or bool(fresh)
        if not has_changed:
            return sweep
    return None


def solve_loops(
    parts: Sequence[WiredPart[I]], check: Callable[[Vector], object] = lambda _: None, **how: Any
) -> str:
    """Find Real inputs that the outputs bring back, by `solve_fixed_point`; what is still off. `check` sees all that is tried."""
    real = [block for part in parts for block in part.inputs if block.real]

    def response(z: Vector) -> Vector:
        """The Real inputs that the outputs give when the inputs are z."""
        check(z)
        values = iter(z.tolist())
        for block in real:
            block.cells[:] = [next(values) for _ in block.cells]
            block.move()
        for block in (block for part in parts for block in part.outputs):
            block.move()
        for part in parts:
            part.apply_links()
        return present()

    def present() -> Vector:
        return np.array([x for block in real for x in block.cells])

    names = [name for block in real for name in block.names]
    nominal = np.array([size for block in real for size in block.nominals()])
    return solve_fixed_point(response, present(), nominal, names, **how)


def settle_start(parts: Sequence[WiredPart[I]], t: float) -> None:
    """Propagate start values in initialisation mode; raises SetupError where an algebraic loop has no solution."""
    cells = sum(len(block.cells) for part in parts for block in part.inputs)
    if settle_wires(parts, 2 + cells, is_start=True) is None and (worst := solve_loops(parts)):
        raise SetupError(
            f"the start values of an algebraic loop were not found; still off: {worst}"
        )
    for block in (block for part in parts for block in part.outputs):
        block(t)
