"""Branches of steady motions: those of a cubic, whose folds are known in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from workbench.branches import first_of_same, follow_branches

#: Where two of the three roots of s^3 - s = x meet: at s = 1 / sqrt(3).
FOLD = 2.0 / (3.0 * np.sqrt(3.0))


def settle(_line: Any, x: Any, states: Any) -> Any:
    """The end of ds/dt = x + s - s^3 from a state: up to the next root or down to it; nan stays nan."""
    ends = []
    for at, (s,) in zip(x, states):
        roots = np.sort(np.roots([-1.0, 0.0, 1.0, at]))
        real = roots[np.abs(np.imag(roots)) < 1e-9].real
        stable = real if len(real) == 1 else real[[0, -1]]
        is_low = len(real) == 1 or s < real[1]
        ends.append([np.nan if np.isnan(s) else stable[0 if is_low else -1]])
    return np.array(ends)


@pytest.mark.parametrize("number", [4, 9, 40])
@pytest.mark.parametrize("start", [-5.0, 0.0, 5.0])
def test_both_branches_of_a_cubic_are_followed_to_their_folds(number: int, start: float) -> None:
    x = np.linspace(-1.03, 1.0, number)
    low, high = follow_branches(settle, [x], np.full((1, number, 1), start))
    assert (low.x[0], high.x[-1]) == (x[0], x[-1])
    assert np.isnan(low.ends[0]).all() and np.isnan(high.ends[1]).all()
    for (first, last), fold in ((low.ends[1], FOLD), (high.ends[0], -FOLD)):
        assert first <= fold <= last
        assert last - first <= (x[1] - x[0]) / 16.0
    assert len(low.x) + len(high.x) == number + np.count_nonzero(np.abs(x) < FOLD)
    assert (low.states < 0.0).all() and (high.states > 0.0).all()


def test_lines_do_not_mix_and_one_motion_is_one_branch() -> None:
    lines = [np.linspace(0.5, 1.0, 5), np.linspace(-0.2, 0.2, 3), np.array([2.0])]
    found = follow_branches(settle, lines, np.full((2, 9, 1), [[[-1.0]], [[1.0]]]))
    assert [(b.line, len(b.x)) for b in found] == [(0, 5), (1, 3), (1, 3), (2, 1)]
    assert all(np.isnan(b.ends).all() for b in found)


def test_what_leads_nowhere_is_no_motion() -> None:
    assert follow_branches(settle, [np.array([0.0, 1.0])], np.full((1, 2, 1), np.nan)) == []


def test_a_motion_to_which_two_searches_lead_counts_once_at_each_place() -> None:
    states = np.array([[1.0, 50.0], [1.0, 50.01], [1.0, 40.0], [1.0, 50.0], [np.nan, np.nan]])
    kept = first_of_same([1, 1, 1, 2, 2], states)
    assert kept.tolist() == [True, False, True, True, True]
    assert first_of_same([], np.empty((0, 2))).tolist() == []
