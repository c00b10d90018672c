"""Steady turns as a method: a question of a user's own, beside the same machine of the project."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from cosim import SetupError
from tests.conftest import ROOT, ask

PAGE = (ROOT / "docs/scenarios.md").read_text(encoding="utf-8")
(TURN,) = re.findall(r"```python turn.py\n(.*?)```", PAGE, re.DOTALL)


def answer_of(folder: Path, text: str, **options: Any) -> Any:
    path = folder / "turn.py"
    path.write_text(text, encoding="utf-8")
    return ask(str(path), **options)


def test_a_link_without_a_pivot_rocks_its_motor_as_a_crank_with_an_endless_rod(
    tmp_path: Path,
) -> None:
    answer, crank = answer_of(tmp_path, TURN), ask("orbit", steps_per_rev=256)
    for name, other in (("ripple", "tau2"), ("pull", "pull")):
        figure, truth = answer.figures[name], crank.figures[other]
        assert figure.error is not None and truth.error is not None
        assert abs(figure.value - truth.value) <= figure.error + truth.error
        assert 0.0 < figure.error < 1e-3 * figure.value
    (motion,) = answer.data
    assert 0.0 < motion.multiplier < 1.0


def test_what_a_turn_lacks_is_named(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="by its method Turn must have an option 'steps_per_rev'"):
        answer_of(tmp_path, TURN.replace("steps_per_rev", "steps"))


def test_a_reader_that_a_turn_does_not_have_is_named(tmp_path: Path) -> None:
    last = TURN.replace('Reader("max", "link.f_pin", REVOLUTION)', 'Reader("last", "link.f_pin")')
    with pytest.raises(SetupError, match="of a turn it must be max, min, mean, amplitude or phase"):
        answer_of(tmp_path, last)


def test_a_number_whose_pole_lies_within_the_error_of_another_is_not_determined(
    tmp_path: Path,
) -> None:
    """Of two equal numbers with errors nobody knows the difference, or its sign."""
    last = '        Number("pull"'
    more = (
        '        Number("again", Reader("amplitude", "motor.tau", REVOLUTION, 2), "N.m", "it"),\n'
        '        Number("sum", "figures.ripple + figures.again", "N.m", "twice"),\n'
        '        Number("share", "figures.ripple / (figures.ripple - figures.again)", "1", "share"),\n'
    )
    figures = answer_of(tmp_path, TURN.replace(last, more + last)).figures
    assert figures["sum"].error == pytest.approx(2.0 * figures["ripple"].error)
    assert figures["share"].error is None
    assert "within the errors of what it follows from" in figures["share"].reason
