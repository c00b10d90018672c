"""The table of operations: complete, spelled alike in both languages, differentiated as numbers say."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest

from fmukit.trace.ops import COMPARISONS, OPS, Failure, ResultType, libm_functions

#: Functions whose domain is not all numbers from 0.2 to 0.9: what is added to their operand.
SHIFT = {"acosh": 1.0}


def computed(name: str, *operands: float) -> float:
    """An operation as Python computes it."""
    text = OPS[name].python.format(*(f"({x!r})" for x in operands))
    return float(eval(text, vars(math) | {"abs": abs, "float": float}))


@pytest.mark.parametrize("name", OPS)
def test_both_languages_take_all_operands(name: str) -> None:
    op = OPS[name]
    marks = [f"<{k}>" for k in range(op.arity)]
    for form in (op.c, op.c_unchecked, op.python):
        text = form.format(*marks)
        assert all(mark in text for mark in marks)
        assert "{" not in text
    assert ("(c, " in op.c) == (op.failure is not Failure.NEVER)
    if op.libm and op.name == op.libm:
        assert f"libm_{op.libm}(" in op.c or op.libm in ("pow", "fmod")


def test_the_table_has_the_functions_of_math_by_their_names() -> None:
    for name, op in OPS.items():
        if op.from_math:
            operands = [0.5] * op.arity
            shift = SHIFT.get(name, 0.0)
            value = getattr(math, name)(*(x + shift for x in operands))
            assert computed(name, *(x + shift for x in operands)) == float(value), name
    assert {op.name for op in OPS.values() if op.result is ResultType.BOOLEAN} == COMPARISONS
    assert all(name in OPS for name in libm_functions())


@pytest.mark.parametrize("name", [name for name, op in OPS.items() if op.derivative])
def test_derivatives_are_those_of_central_differences(name: str) -> None:
    """Of order 2 at random operands: an error of 1e-6 is 100 times that of the differences."""
    op, rng = OPS[name], random.Random(name)
    assert op.derivative is not None
    for _ in range(20):
        operands = [rng.uniform(0.2, 0.9) + SHIFT.get(name, 0.0) for _ in range(op.arity)]
        tangents: list[Any] = [rng.uniform(-1.0, 1.0) for _ in range(op.arity)]
        value = computed(name, *operands)
        h = 1e-5
        sides = [
            computed(name, *(x + sign * h * dx for x, dx in zip(operands, tangents)))
            for sign in (1.0, -1.0)
        ]
        if abs(sides[0] - sides[1]) > 0.1:  # a step lies between
            continue
        exact = op.derivative(computed, value, *operands, *tangents)
        assert exact == pytest.approx((sides[0] - sides[1]) / (2.0 * h), abs=1e-6)
