"""A claim is decided where all that figure and bounds may be agree, and only there."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from workbench.figure import Figure
from workbench.judgement import Holds, Judgement


@pytest.mark.parametrize("seed", range(40))
def test_the_answer_is_that_of_all_values_within_the_errors(seed: int) -> None:
    """Every corner of the errors is looked at one by one; a bound may be a number, a figure or none."""
    rng = np.random.default_rng(seed)
    value, least, most = rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 0.0), rng.uniform(0.0, 2.0)
    errors = rng.uniform(0.0, 0.8, 3) * rng.integers(0, 2, 3)
    if rng.random() < 0.3:
        least, errors[1] = -np.inf, 0.0
    figure, low, high = (Figure(x, "N", e) for x, e in zip((value, least, most), errors))
    corners = [
        least + b * errors[1] <= value + a * errors[0] <= most + c * errors[2]
        for a, b, c in product((-1.0, 1.0), repeat=3)
    ]
    bounds = {
        "least": low.value if not errors[1] else low,
        "most": high.value if not errors[2] else high,
    }
    answer = Judgement("the force is right", figure, **bounds).answer
    if all(corners):
        assert answer is Holds.YES
    elif any(corners):
        assert answer is Holds.OPEN
    else:
        # both bounds may exclude a part of what the figure may be, and no single one all of it
        excluded = value + errors[0] < least - errors[1] or value - errors[0] > most + errors[2]
        assert answer is (Holds.NO if excluded else Holds.OPEN)


def test_a_claim_names_all_that_must_hold() -> None:
    torque = Judgement("torque below its limit", Figure(9.0, "N.m", 0.1), most=8.0)
    both = Judgement("in time", Figure(0.1, "s", 0.01), most=0.5, also=[torque])
    assert both.text().startswith("In time and torque below its limit: no, ")
    assert Judgement("safe", also=[torque]).claim == "safe"
