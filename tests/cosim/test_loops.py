"""Algebraic loops: every signal is solved to its own size."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cosim.engine.newton import solve_fixed_point

#: The solution of q = 1e-6 cos(1e6 q): 1e-6 times the fixed point of the cosine.
FLOW = 0.7390851332151607e-6


def response(z: Any) -> Any:
    """A flow that it makes itself, and a pressure that leans on it."""
    return np.array([1e-6 * np.cos(1e6 * z[0]), 1e7 + 1e6 * z[0]])


def derivative(z: Any) -> Any:
    """Of the response."""
    return np.array([[-np.sin(1e6 * z[0]), 0.0], [1e6, 0.0]])


@pytest.mark.parametrize("exact", [True, False])
def test_a_small_flow_beside_a_large_pressure_is_solved(exact: bool) -> None:
    last: list[Any] = []

    def observed(z: Any) -> Any:
        last[:] = [z]
        return response(z)

    worst = solve_fixed_point(
        observed, np.array([1e-6, 1e7]), np.array([1e-6, 1e5]), ["q", "p"],
        derivative=(lambda: derivative(last[0])) if exact else None,
    )  # fmt: skip
    assert worst == ""
    assert last[0][0] == pytest.approx(FLOW, rel=1e-9)


def test_a_difference_of_large_signals_counts_as_solved_within_their_rounding() -> None:
    """d = p - q of 1e9 each, in a loop that rounds them."""

    def rounds(z: Any) -> Any:
        p, q, _ = z
        return np.array([1e9 + 0.1, 1e9 + 0.3 + 1e-3 * np.sin(q), p - q])

    z = np.array([0.0, 0.0, 0.0])
    assert solve_fixed_point(rounds, z, np.array([1e9, 1e9, 1e-12]), ["p", "q", "d"]) == ""


@pytest.mark.parametrize(("drift", "start"), [(1e-12, 0.0), (1e-3, 0.0), (1e-3, 1.0)])
def test_a_signal_that_only_adds_to_itself_has_no_solution(drift: float, start: float) -> None:
    """z = z + drift: the difference quotient of the residual is rounding; it led to z = -36 227."""
    places: list[Any] = []

    def drifting(z: Any) -> Any:
        places.append(z)
        return z + drift

    worst = solve_fixed_point(drifting, np.array([start]), np.array([1.0]), ["z"])
    is_within_tolerance = drift <= 1e-10  # of the nominal value
    assert (worst == "") == is_within_tolerance
    assert places[-1].tolist() == [start]


@pytest.mark.parametrize("start", [0.0, 1e-3])
def test_the_system_is_left_where_the_iteration_ends(start: float) -> None:
    """Two signals that hand each other's value on: a singular loop, which is as good as solved at its start."""
    places: list[Any] = []

    def crossed(z: Any) -> Any:
        places.append(z)
        return np.array([z[1] + 1e-12, z[0]])

    guess = np.array([start, start])
    assert solve_fixed_point(crossed, guess, np.ones(2), ["a", "b"]) == ""
    assert places[-1].tolist() == guess.tolist()
