"""Coupling errors stated are true errors, or the figure is called not converged."""

from __future__ import annotations

import math

import pytest
from test_cosim import HELD_TAU2, ripple

from cosim import ORDERS, estimate


@pytest.mark.parametrize("order", [1, 2])
def test_error_of_a_clean_series_is_found(order: int) -> None:
    """v(h) = 5 + 0.3 h^p + a little of the next order."""
    values = [5 + 0.3 * h**order + 0.05 * h ** (order + 1) for h in (0.1, 0.2, 0.4)]
    got = estimate(values, order)
    assert got.order == pytest.approx(order, abs=0.15)
    assert got.error == pytest.approx(abs(values[0] - 5.0), rel=0.2)


def test_a_figure_that_does_not_converge_is_no_figure() -> None:
    for values in ([1.0, 1.1, 1.15], [1.0, 1.1, 1.0], [1.0, 1.1, 5.0], [1.0, 0.9, math.nan]):
        got = estimate(values, 2)
        assert got.error is None
        assert "not converged" in got.text("N")


def test_text_shows_the_digits_that_the_error_leaves() -> None:
    assert estimate([104.968, 104.96, 104.928], 2).text("N.m") == "104.9680 +- 0.0027 N.m"
    assert estimate([7.0, 7.0, 7.0], 1).text("s") == "7.0000000 +- 0.0000001 s"


@pytest.mark.parametrize(
    ("algorithm", "n"), [("strang", 256), ("gauss-seidel", 256), ("jacobi", 2048)]
)
def test_stated_error_of_the_resonance_holds_the_true_one(fmus, algorithm: str, n: int) -> None:
    """The torque ripple at resonance against the monolithic reference."""
    values = [ripple(fmus, algorithm, steps)[1] for steps in (n, n // 2, n // 4)]
    got = estimate(values, ORDERS[algorithm])
    true = abs(values[0] - HELD_TAU2)
    assert got.error is not None
    assert true <= 1.3 * got.error
    assert got.error <= max(10 * true, 1e-4 * HELD_TAU2)


def test_jacobi_with_long_steps_is_called_not_converged(fmus) -> None:
    values = [ripple(fmus, "jacobi", steps, 48)[1] for steps in (320, 160, 80)]
    assert estimate(values, 1).error is None
