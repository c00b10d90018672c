"""The table of operations: complete, spelled alike in both languages, differentiated as numbers say."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest

from fmukit.trace.ops import OPS

#: Functions whose domain is not all numbers from 0.2 to 0.9: what is added to their operand.
SHIFT = {"acosh": 1.0}


def compute(name: str, *operands: float) -> float:
    """An operation as Python computes it."""
    text = OPS[name].python.format(*(f"({x!r})" for x in operands))
    return float(eval(text, vars(math) | {"abs": abs, "float": float}))


@pytest.mark.parametrize("name", [name for name, op in OPS.items() if op.derivative])
def test_derivatives_are_those_of_central_differences(name: str) -> None:
    """Of order 2 at random operands: an error of 1e-6 is 100 times that of the differences."""
    op, rng = OPS[name], random.Random(name)
    assert op.derivative is not None
    for _ in range(20):
        operands = [rng.uniform(0.2, 0.9) + SHIFT.get(name, 0.0) for _ in range(op.arity)]
        tangents: list[Any] = [rng.uniform(-1.0, 1.0) for _ in range(op.arity)]
        value = compute(name, *operands)
        h = 1e-5
        sides = [
            compute(name, *(x + sign * h * dx for x, dx in zip(operands, tangents)))
            for sign in (1.0, -1.0)
        ]
        if abs(sides[0] - sides[1]) > 0.1:  # a step lies between
            continue
        exact = op.derivative(compute, value, *operands, *tangents)
        assert exact == pytest.approx((sides[0] - sides[1]) / (2.0 * h), abs=1e-6)
