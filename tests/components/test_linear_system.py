"""The linear system against other exponentials, closed solutions and systems solved as a whole."""

from __future__ import annotations

import functools
import itertools
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

from components.linear_system import model as linear
from fmukit.declare.interface import InputHold
from fmukit.declare.model import complete_model
from fmukit.declare.record import array, declarations, fill, real, record, replace, start
from fmukit.runtime import hybrid as motion
from fmukit.si import Ratio

complete_model(linear)
FMU = "LinearSystem.fmu"
near = functools.partial(pytest.approx, abs=0.0)
STEPS = [1e-6, 1e-3, 0.1, 10.0]
ZERO = {name: 0.0 for name, _ in declarations(linear.Parameters)} | {"x[1]": 0.0}


def entries(name: str, matrix: Any) -> dict[str, float]:
    """Start values M[1,1], M[1,2] of a matrix, v[1], v[2] of a vector."""
    indices = np.ndenumerate(np.array(matrix, dtype=float))
    return {f"{name}[{','.join(str(i + 1) for i in index)}]": value for index, value in indices}


def system(**arrays: Any) -> dict[str, float]:
    """Start values of a system, zero where not given."""
    return ZERO | {k: v for name, m in arrays.items() for k, v in entries(name, m).items()}


def records(values: dict[str, float]) -> Any:
    """Parameters, state and inputs with these start values."""
    kinds = (linear.Parameters, linear.State, linear.Inputs)
    return tuple(fill(c, [values.get(k, 0.0) for k, _ in declarations(c)]) for c in kinds)


def exponential(A: Any, h: float) -> Any:
    """exp(A h) as the propagator has it, both parts."""
    n = len(A)
    rows = np.array(linear.propagator(tuple(map(tuple, A)), ((0.0,),) * n, h))
    return rows[:, :n] + rows[:, -n:]


def test_an_array_is_declared_element_by_element_and_read_at_a_time() -> None:
    @record
    class Part:
        k: Ratio = real(7.0, "Gain")
        M: tuple[tuple[Ratio, ...], ...] = array([(1.0, 2.0), (3.0, 4.0)], "Row {0}, column {1}")
        v: tuple[Ratio, ...] = array([5.0, 6.0], "Entry {0}", min=0.0)

    names = dict(declarations(Part))
    assert list(names) == ["k", "M[1,1]", "M[1,2]", "M[2,1]", "M[2,2]", "v[1]", "v[2]"]
    assert names["M[2,1]"].meaning == "Row 2, column 1"
    assert names["v[2]"].min == 0.0 and names["v[2]"].quantity == names["k"].quantity
    part = start(Part, **{"M[1,2]": 9.0})
    assert (part.k, part.M, part.v) == (7.0, ((1.0, 9.0), (3.0, 4.0)), (5.0, 6.0))
    assert replace(fill(Part, [*part]), v_1=0.5).v == (0.5, 6.0)


def test_exponential_agrees_with_scipy_and_with_thirty_digits() -> None:
    draw = np.random.default_rng(1)
    for _, h in itertools.product(range(20), STEPS):
        A = draw.normal(size=(4, 4)) * 10.0 ** draw.uniform(-2, 1)
        got, size = exponential(A.tolist(), h), np.linalg.norm
        assert size(got - expm(A * h)) <= 1e-14 * (1 + size(A * h)) ** 2 * size(got)
        with mpmath.workdps(60):
            digits = mpmath.expm(mpmath.matrix(A.tolist()) * mpmath.mpf(h)).tolist()
        assert got == near(np.array(digits, dtype=float), 1e-15)


def test_an_exponential_beyond_the_range_is_refused() -> None:
    with pytest.raises(OverflowError, match=r"exp\(A h\) is beyond 1e300 with h = 1.0 s"):
        exponential([[800.0]], 1.0)


def end_by_scipy(p: Any, x: Any, u0: Any, u1: Any, h: float) -> Any:
    """The state at the end of a step by SciPy's exponential of state, input and its slope."""
    M = np.zeros((12, 12))
    M[:4, :4], M[:4, 4:8], M[4:8, 8:] = p.A, p.B, np.eye(4)
    slope = (np.array(u1) - np.array(u0)) / h
    return (expm(M * h) @ np.concatenate([x, u0, slope]))[:4]


@pytest.mark.parametrize("h", STEPS)
@pytest.mark.parametrize("hold", InputHold)
def test_steps_are_exact_for_every_trajectory_of_the_inputs(hold: InputHold, h: float) -> None:
    draw = np.random.default_rng(2)
    for _ in range(20):
        A = draw.normal(size=(4, 4)) - 2.5 * np.eye(4)
        p, x, before = records(system(A=A, B=draw.normal(size=(4, 4)), x=draw.normal(size=4)))
        now = fill(linear.Inputs, draw.normal(size=4).tolist())
        inputs = motion.input_trajectory(hold, before, now, 0.7 * h, h)
        got = motion.advance(linear, p, 0.0, x, inputs)
        want = end_by_scipy(p, x, inputs.start, inputs.end, h)
        assert got == pytest.approx(want, rel=1e-12, abs=1e-12 * np.linalg.norm(want))


def test_the_error_does_not_pile_up_over_many_short_steps() -> None:
    p, x, u = records(system(A=[[0, 1], [-100, -2]], x=[1, 0]))
    exact_system, h = linear.exact(p, x, u, u, 0.1), 0.1 / 100_000
    for _ in range(100_000):
        x = linear.exact(p, x, u, u, h)
    assert x == near(exact_system, 1e-13)


def test_rates_and_outputs_are_the_products() -> None:
    p, x, u = records(full(4) | entries("u", [1.0, -2.0, 3.0, -4.0]))
    A, B, C, D = (np.array(matrix) for matrix in (p.A, p.B, p.C, p.D))
    y, z = C @ x, C @ x + D @ u
    assert linear.outputs(p, 0.0, x, u) == near([*y, *z], 1e-13)
    assert linear.derivatives(p, 0.0, x, u) == near(A @ x + B @ u, 1e-13)


def full(seed: int) -> dict[str, float]:
    """A damped system without a zero in it."""
    draw = np.random.default_rng(seed)
    matrices = {name: draw.normal(size=(4, 4)) for name in "ABCD"}
    return system(**matrices | {"A": matrices["A"] - 3 * np.eye(4)}, x=draw.normal(size=4))
