"""Errors of values of three runs: array by array, and refused where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cosim import limit
from cosim.accuracy.limit import (
    CONFIRMED_FACTOR,
    UNCONFIRMED_FACTOR,
    Reason,
    likeliest,
)


@pytest.mark.parametrize("order", [1, 2])
def test_the_error_of_a_clean_series_holds_and_is_not_much_too_wide(order: int) -> None:
    """v(h) = 5 + 0.3 h^p + a little of the next order."""
    got = limit([5 + 0.3 * h**order + 0.05 * h ** (order + 1) for h in (0.1, 0.2, 0.4)], order)
    assert got.order == pytest.approx(order, abs=0.15)
    true = abs(got.value - 5.0)
    assert 1.0 < got.error / true < 3.6
    assert abs(got.extrapolated - 5.0) <= got.extrapolated_error < true


@pytest.mark.parametrize("share", [0.005, -0.005, 0.01, -0.01])
def test_terms_that_cancel_in_the_order_observed_are_within_the_extrapolated_error(
    share: float,
) -> None:
    """h^2 + b h^3 + c h^4 with 7 b = -45 c has the order 2 in three runs, and its extrapolation is off by 32 c / 7."""
    got = limit([h**2 + share * (h**4 - 45 / 7 * h**3) for h in (1.0, 2.0, 4.0)], 2)
    assert got.order == pytest.approx(2.0) and abs(got.extrapolated) == pytest.approx(
        32 / 7 * abs(share)
    )
    assert abs(got.extrapolated) <= got.extrapolated_error < 0.1


@pytest.mark.parametrize("share", [3.1, 4.0, 4.8, 4.99])
def test_two_terms_of_opposite_signs_that_alternate_are_within_the_error(share: float) -> None:
    got = limit([1e3 + share * h - h**2 for h in (1.0, 2.0, 4.0)], 1)
    assert abs(got.value - 1e3) <= got.error and got.reason == Reason.STATED


@pytest.mark.parametrize("ratio", [2.0, 3.0, 10.0])
@pytest.mark.parametrize(
    ("order", "power", "factor"),
    [(1.0, 1.0, CONFIRMED_FACTOR), (2.0, 2.0, CONFIRMED_FACTOR), (2.0, 1.0, UNCONFIRMED_FACTOR),
     (1.0, 0.6, UNCONFIRMED_FACTOR)],
)  # fmt: skip
def test_the_factor_of_safety_is_that_of_the_order_observed(
    order: float, power: float, factor: float, ratio: float
) -> None:
    """The error of a pure power is the true one times the factor, whatever the ratio of the steps."""
    x = 7.0 + 1e-3 * ratio ** (power * np.arange(3.0))
    assert limit(x, order, ratio).error == pytest.approx(factor * 1e-3)


@pytest.mark.parametrize("power", [0.55, 0.7, 0.9])
def test_what_is_approached_slowly_lies_within_the_error_of_its_extrapolation(power: float) -> None:
    got = limit(1.0 + 2.0 ** (power * np.arange(3.0)), 1.0)
    assert abs(got.extrapolated - 1.0) <= got.extrapolated_error * (1.0 + 1e-12)


def test_arrays_are_judged_element_by_element() -> None:
    rng = np.random.default_rng(3)
    x = 1.0 + rng.normal(size=(3, 5, 40)) * np.array([1.0, 2.0, 4.0])[:, None, None] * 1e-2
    every = limit(x, 1.0, noise=1e-4)
    for k in np.ndindex(5, 40):
        one = limit(x[(slice(None), *k)], 1.0, noise=1e-4)
        for name, values in vars(every).items():
            assert values[k] == pytest.approx(getattr(one, name), nan_ok=True), name


def test_the_error_of_an_amplitude_does_not_hang_on_where_its_phase_is_0() -> None:
    """The differences of these turn as they fall: the part along one axis hardly falls, while the whole does with order 2.

    They are torques of a drive with 128, 64 and 32 steps per revolution; `truth` is from 2048.
    """
    truth = 75.72738 - 53.35897j
    runs = np.array([75.7535505 - 52.9917326j, 75.8179553 - 51.8927410j, 75.8691627 - 47.5475377j])
    angles = np.linspace(0.0, 2.0 * math.pi, 25)
    got = limit(runs[:, None] * np.exp(1j * angles), 2.0)
    assert got.is_stated.all() and got.order == pytest.approx(1.98, abs=0.01)
    for error in (got.error, got.extrapolated_error):
        assert error == pytest.approx(error[0], rel=1e-9)
    assert (abs(got.extrapolated * np.exp(-1j * angles) - truth) <= got.extrapolated_error).all()
    real = limit(np.arange(9.0, 6.0, -1.0) ** 2, 2.0)
    also = limit(np.arange(9.0, 6.0, -1.0) ** 2 + 0j, 2.0)
    assert all(getattr(also, name) == x for name, x in vars(real).items())


def test_what_does_not_converge_has_a_reason_and_no_claim() -> None:
    for values, reason in (
        ([1.0, 1.1, 1.15], Reason.NOT_FALLING),
        ([1.0, 1.1, 1.0], Reason.NOT_FALLING),
        ([1.0, 1.1, 5.0], Reason.NOT_FALLING),
        ([4.0, 2.0, 1.0], Reason.GROWING),
        ([1.0, math.nan, 1.0], Reason.MISSING),
        ([math.nan, 1.0, 1.0], Reason.NO_VALUE),
    ):
        got = limit(values, 2)
        assert (got.reason, bool(got.is_stated)) == (reason, False)
        assert got.sentence()


def test_values_in_no_order_that_agree_to_three_digits_have_three_times_their_spread() -> None:
    got = limit([133.258, 133.293, 133.311], 1.0)
    assert got.is_stated and got.error == pytest.approx(3.0 * 0.053)
    assert not limit([133.258, 133.493, 133.611], 1.0).is_stated
    assert limit([0.01, 0.02, 0.025], 1.0, scale=100.0).is_stated


def test_what_grows_as_the_step_shrinks_has_no_error_whatever_its_noise() -> None:
    """A pulse within one step: the held mean is twice as high in a run with half the step."""
    assert limit([0.004, 0.002, 0.001], 1.0, noise=1.0).reason == Reason.GROWING
    assert limit([0.004, 0.005, 0.0035], 1.0, noise=1.0).is_stated


def test_without_the_coarsest_run_the_factor_is_that_of_two_grids() -> None:
    got = limit([1.1, 1.4, math.nan], 2.0)
    assert got.is_stated and got.error == pytest.approx(3.0 * 0.3 / 3.0)


def test_noise_is_added_and_explains_differences_within_it() -> None:
    assert limit([1.0, 1.0003, 1.0001], 2.0, noise=2e-4).error == pytest.approx(3e-4 + 2e-4)
    assert not limit([1.0, 1.1, 1.09], 2.0, noise=2e-4).is_stated
    clean, noisy = (limit([1.01, 1.04, 1.16], 2.0, noise=n) for n in (0.0, 1e-3))
    assert noisy.error == pytest.approx(clean.error + 1e-3)


def test_of_several_orders_the_highest_that_is_confirmed_counts() -> None:
    second, first = ([1.0 + 1e-3 * 2.0 ** (p * k) for k in range(3)] for p in (2.0, 1.0))
    assert likeliest(second, [1.0, 2.0]).error == limit(second, 2.0).error
    assert likeliest(first, [1.0, 2.0]).error == limit(first, 1.0).error
    between = [1.0 + 1e-3 * 2.0 ** (1.5 * k) for k in range(3)]
    assert likeliest(between, [1.0, 2.0]).error == limit(between, 1.0).error
