"""Searches of roots and peaks: their errors hold, and no search calls its function itself."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.polynomial import Chebyshev
from scipy.optimize import minimize_scalar

from cosim.accuracy.extrapolation import extrapolate
from workbench.roots import (
    PEAK_NODES,
    PeakSearch,
    Root,
    next_coefficient,
    roots_between,
)


def search(
    smooth: Callable[[float], complex], center: float, half_width: float, noise: float = 0.0
) -> tuple[Root, Root]:
    """The peak of 1 / |smooth|, with noise of random sign at the nodes."""
    peak = PeakSearch(center, half_width, lambda x, value: 1.0 / np.abs(value))
    signs = np.random.default_rng(1).choice([-1.0, 1.0], PEAK_NODES)
    while True:
        values = [smooth(x) * (1.0 + noise * sign) for x, sign in zip(peak.nodes, signs)]
        if roots := peak.update(values, noise):
            return roots


def resonances() -> list[tuple[Callable[[float], complex], float, float]]:
    """Inverse responses 1 - x^2 + 2 i zeta x with factors whose series fall slowly or fast, and their peaks."""
    rng = np.random.default_rng(3)
    responses: list[tuple[Callable[[float], complex], float, float]] = []
    for _ in range(100):
        zeta, pole, size = (
            10 ** rng.uniform(-2, -0.5),
            rng.uniform(1.5, 6.0),
            rng.uniform(-0.2, 0.2),
        )

        def smooth(x: float, zeta: float = zeta, pole: float = pole, size: float = size) -> complex:
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
            position, height = search(smooth, peak + shift * half_width, half_width, noise)
            assert abs(position.x - peak) < position.error
            assert abs(height.x - 1.0 / abs(smooth(peak))) < height.error
            wide.append(position.error / zeta)
    assert np.median(wide) < 2e-5 + 100.0 * noise


def test_what_a_series_leaves_out_is_bounded_by_the_fall_of_its_coefficients() -> None:
    """1 / (a - s) has the coefficients 2 / (sqrt(a^2 - 1) rho^k), rho = a + sqrt(a^2 - 1)."""
    for a in (1.1, 1.5, 3.0):
        root = math.sqrt(a * a - 1.0)
        sizes = [2.0 / root / (a + root) ** k for k in range(6)]
        assert next_coefficient(sizes[:5]) == pytest.approx(sizes[5])
    even = Chebyshev.interpolate(lambda s: 1.0 / (2.0 - s**2), 30).coef
    assert next_coefficient(even[:5].tolist()) >= abs(even[6])
    assert next_coefficient([1.0, 0.5, 0.1, 0.2, 0.3]) == pytest.approx(0.3)
    assert next_coefficient([1.0, 0.0, 0.0, 0.0, 0.1]) == 0.1


def test_a_peak_far_from_the_nodes_is_approached() -> None:
    smooth, peak, zeta = resonances()[0]
    position, _ = search(smooth, peak + 1.2 * zeta, 0.25 * zeta)
    assert abs(position.x - peak) < position.error < 1e-3 * zeta


def test_errors_of_values_are_weighted_as_the_values_are() -> None:
    """The limit is fine + (fine - middle) / 3, so that it has 4/3 and 1/3 of their errors."""
    values = [1.01, 1.04, 1.16]
    bare, with_errors = extrapolate(values, 2.0), extrapolate(values, 2.0, [3e-3, 6e-3, 1.0])
    assert with_errors.value == bare.value
    assert bare.error is not None and with_errors.error is not None
    assert with_errors.error - bare.error == pytest.approx(6e-3)


def test_roots_are_found_beside_zero_and_below_it() -> None:
    grid = np.linspace(0.0, 1.0, 11)
    assert roots_between(lambda x: x - 0.05, grid) == pytest.approx([0.05], rel=1e-11)
    assert roots_between(lambda x: (x + 0.05) * (x - 0.31), grid - 1.0) == pytest.approx([-0.05])
    assert roots_between(lambda x: x * (x - 0.5) - 1e-9, grid)[-1] == pytest.approx(0.5)
