"""A value and its error as texts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cosim import Estimate
from cosim.identification.intervals import Interval
from cosim.rounding import rounded
from workbench import Figure


def test_a_small_figure_is_not_printed_as_zero() -> None:
    assert str(Estimate(3.2e-9, 1e-11, 2.0)) == "3.200e-09 +- 1.0e-11"
    assert Interval(3.2e-9, 3.19e-9, 3.21e-9, 5e-12, "m").text() == "3.200e-09 +- 1.0e-11 m"
    assert Figure(3.2e-9, "m", 1e-11).text() == "3.200e-09 ± 1.0e-11 m"


@pytest.mark.parametrize(
    ("value", "error", "texts"),
    [
        (8.0, 8e-10, ("8.0000000000", "0.0000000008")),
        (3.0, 0.0, ("3", "0")),
        (0.0, 1e-12, ("0.0e+00", "1.0e-12")),
        (0.0, 0.0, ("0", "0")),
        (123456.0, 789.0, ("123460", "800")),
        (1.0, math.inf, ("1", "?")),
    ],
)
def test_values_and_errors_as_texts(value: float, error: float, texts: tuple[str, str]) -> None:
    assert rounded(value, error) == texts


def test_what_is_written_holds_the_truth_at_any_size() -> None:
    """The error that is written covers what rounding does to both, and is at most twice as large."""
    rng = np.random.default_rng(5)
    for _ in range(3000):
        value = rng.normal() * 10.0 ** rng.uniform(-20, 20)
        error = abs(value) * 10.0 ** rng.uniform(-8, 2)
        written, written_error = map(float, rounded(value, error))
        assert abs(written - value) + error <= written_error * (1.0 + 1e-8)
        assert written_error <= 1.2 * error
