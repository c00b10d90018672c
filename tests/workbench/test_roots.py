"""Searches of roots and peaks: their errors hold, and they go on side by side."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Chebyshev
from scipy.optimize import minimize_scalar

from workbench.roots import (
    NO_VALUE,
    PEAK_NODES,
    Array,
    bound_next_coefficients,
    peaks,
    roots_between,
    secant,
)


def search(
    smooth: Callable[[Any], Any], center: float, half_width: float, noise: float = 0.0
) -> list[tuple[float, float]]:
    """Place and height of the peak of 1 / |smooth|, with noise of random sign at the nodes, and their errors."""
    signs = np.random.default_rng(1).choice([-1.0, 1.0], (PEAK_NODES, 1))

    def function(x: Array) -> tuple[Any, Array]:
        return (smooth(x) * (1.0 + noise * signs))[None], np.array([noise])

    found = peaks(
        function, lambda x, y, _: 1.0 / np.abs(y), np.array([center]), np.array([half_width])
    )
    assert not any(x.reasons[0] for x in found)
    return [(float(x.x[0, 0]), float(x.error[0, 0])) for x in found]


def resonances() -> list[tuple[Callable[[Any], Any], float, float]]:
    """Inverse responses 1 - x^2 + 2 i zeta x with factors whose series fall slowly or fast, and their peaks."""
    rng = np.random.default_rng(3)
    responses: list[tuple[Callable[[Any], Any], float, float]] = []
    for _ in range(100):
        zeta, pole, size = (
            10 ** rng.uniform(-2, -0.5),
            rng.uniform(1.5, 6.0),
            rng.uniform(-0.2, 0.2),
        )

        def smooth(x: Any, zeta: float = zeta, pole: float = pole, size: float = size) -> Any:
            s = (x - 1.0) / zeta
            return (1.0 - x**2 + 2j * zeta * x) * (1.0 + size * 1j / (pole - 1j * s))

        peak = minimize_scalar(
            lambda s, zeta=zeta, smooth=smooth: abs(smooth(1.0 + zeta * s)),
            bounds=(-1.5, 0.5),
            method="bounded",
            options={"xatol": 1e-12},
        )
        responses.append((smooth, 1.0 + zeta * float(peak.x), zeta))
    return responses


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_a_peak_lies_within_its_error_wherever_the_nodes_are(noise: float) -> None:
    """Also at their middle, where the last term of the polynomial has no slope and the first left out has most."""
    rng = np.random.default_rng(4)
    wide = []
    for smooth, peak, zeta in resonances():
        for shift in (0.0, *rng.uniform(-0.5, 0.5, 3)):
            half_width = 0.25 * zeta
            (x, error), (height, height_error) = search(
                smooth, peak + shift * half_width, half_width, noise
            )
            assert abs(x - peak) < error
            assert abs(height - 1.0 / abs(smooth(peak))) < height_error
            wide.append(error / zeta)
    assert np.median(wide) < 2e-5 + 100.0 * noise


def bound(coefficients: Any) -> float:
    return float(bound_next_coefficients(np.array(coefficients)[:, None])[0])


def test_what_a_series_leaves_out_is_bounded_by_the_fall_of_its_coefficients() -> None:
    """1 / (a - s) has the coefficients 2 / (sqrt(a^2 - 1) rho^k), rho = a + sqrt(a^2 - 1)."""
    for a in (1.1, 1.5, 3.0):
        root = math.sqrt(a * a - 1.0)
        sizes = [2.0 / root / (a + root) ** k for k in range(6)]
        assert bound(sizes[:5]) == pytest.approx(sizes[5])
    even = Chebyshev.interpolate(lambda s: 1.0 / (2.0 - s**2), 30).coef
    assert bound(even[:5]) >= abs(even[6])
    assert bound([1.0, 0.5, 0.1, 0.2, 0.3]) == pytest.approx(0.3)
    assert bound([1.0, 0.0, 0.0, 0.0, 0.1]) == 0.1


def test_a_peak_far_from_the_nodes_is_approached() -> None:
    smooth, peak, zeta = resonances()[0]
    (x, error), _ = search(smooth, peak + 1.2 * zeta, 0.25 * zeta)
    assert abs(x - peak) < error < 1e-3 * zeta


def test_secants_reach_roots_of_both_slopes_within_their_errors_and_give_up_with_reasons() -> None:
    """Roots of x^2 = c from slopes that are off; one that never changes, one below 0, one without a value."""
    squares, asked = np.array([2.0, 3.0, 4.0, 5.0, 6.0]), []

    def residual(x: Array) -> tuple[Array, Array]:
        asked.append(np.isfinite(x))
        value = x**2 - squares
        value[2], value[3], value[4] = np.nan, x[3] + 5.0, 1.0 + 0.0 * x[4]
        return value, np.array([0.0, 1e-6, 0.0, 0.0, 0.0])

    found = secant(residual, [1.4, 1.8, 2.0, 2.0, 2.0], [2.5, 4.0, 1.0, 1.0, 10.0])
    off = abs(found.x[:2] - np.sqrt(squares[:2]))
    assert (off <= found.error[:2]).all() and found.error[0] < 1e-7
    assert found.error[1] == pytest.approx(1e-6 / (2.0 * math.sqrt(3.0)), rel=0.3)
    assert list(found.reasons[:2]) == ["", ""] and np.isnan(found.x[2:]).all()
    assert found.reasons[2] == NO_VALUE
    assert "down to zero" in found.reasons[3] and "does not change" in found.reasons[4]
    assert asked[0].all() and not asked[1][2:4].any(), "what has ended is asked for no more"


def test_roots_are_found_beside_zero_and_below_it() -> None:
    grid = np.linspace(0.0, 1.0, 11)
    assert roots_between(lambda x: x - 0.05, grid) == pytest.approx([0.05], rel=1e-11)
    assert roots_between(lambda x: (x + 0.05) * (x - 0.31), grid - 1.0) == pytest.approx([-0.05])
    assert roots_between(lambda x: x * (x - 0.5) - 1e-9, grid)[-1] == pytest.approx(0.5)
