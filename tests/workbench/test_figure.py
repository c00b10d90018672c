"""Figures in sentences: four digits, and the error where it is not small beside the last of them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.json_values import without_infinities
from workbench.figure import Figure, checked_figures, figure_of_figures, scaled


@pytest.mark.parametrize(
    ("value", "error", "sentence"),
    [
        (40.0022, 0.0002, "40.00 N"),
        (40.0022, 0.00499, "40.00 N"),
        (40.0022, 0.0051, "40.0022 ± 0.0051 N"),
        (9.99996, 1e-5, "10.00 N"),
        (-3.47125, 1e-5, "-3.471 N"),
        (723456.0, 3.0, "723500 N"),
        (723456.0, 60.0, "723456 ± 60 N"),
        (0.000123456, 1e-9, "0.0001235 N"),
        (1.23456e-9, 1e-14, "1.235e-09 N"),
        (0.0, 0.1, "below 0.10 N in size"),
        (200.0, 230.0, "below 430 N in size"),
        (-200.0, 200.0, "below 400 N in size"),
        (200.0, 199.0, "200 ± 200 N"),
        (720000.0, 0.0, "720000 N"),
    ],
)
def test_a_sentence_has_four_digits_or_the_error(value: float, error: float, sentence: str) -> None:
    assert Figure(value, "N", error).brief() == sentence
    if sentence[0] != "b" and "±" not in sentence and error:
        unit = 10.0 ** (math.floor(math.log10(abs(float(sentence.split()[0])))) - 3)
        assert abs(float(sentence.split()[0]) - value) + error < unit


def test_a_figure_whose_error_has_no_bound_is_undetermined_and_json_has_no_infinity() -> None:
    figures = checked_figures({"force": Figure(1.0, "N", math.inf, "a force")}, Path("q.py"))
    assert figures["force"].text() == "not determined (its error has no bound)"
    assert figures["force"].meaning == "a force"
    for figure in (*figures.values(), Figure(math.inf, "N", math.inf)):
        assert json.loads(json.dumps(figure.json(), allow_nan=False))["error"] is None
    facts = {"a": (1.0, math.nan, {"b": [math.inf, 2, True, "x"]})}
    assert without_infinities(facts) == {"a": [1.0, None, {"b": [None, 2, True, "x"]}]}


@pytest.mark.parametrize(("factor", "error"), [(-60.0, 12.0), (1e-3, 2e-4)])
def test_a_multiple_has_as_large_a_share_of_error(factor: float, error: float) -> None:
    told = scaled(Figure(5.0, "Hz", 0.2), factor, "1/min", "")
    assert (told.value, told.unit, told.error) == (5.0 * factor, "1/min", pytest.approx(error))


def test_a_refused_figure_says_why_in_a_sentence() -> None:
    assert Figure.undetermined("N", "it jams").brief() == "not determined (it jams)"


@pytest.mark.parametrize(
    ("function", "of", "error"),
    [
        (lambda x, y: x / y, [(1.0, 0.1), (1.0, 0.9)], 10.0),
        (lambda x, y: x * y, [(0.0, 1.0), (0.0, 2.0)], 2.0),
        (np.cos, [(0.0, 1.0)], 1.0 - math.cos(1.0)),
        (lambda x, y: x - y, [(3.0, 0.0), (2.0, 0.0)], 0.0),
        (lambda x: 1.0 / x, [(1.0, 1.5)], None),
        (lambda x: 1.0 / x, [(1.0, 1.001)], None),
        (lambda x: 1.0 / x, [(1.0, 1.0)], None),
        (lambda x, y: 1.0 / (x - y), [(1.0, 0.3), (0.5, 0.3)], None),
        (np.cos, [(0.0, 2.0 * math.pi)], None),
        (np.sqrt, [(1.0, 2.0)], None),
        (lambda x: x**-0.5, [(1.0, 2.0)], None),
    ],
)
def test_the_error_of_a_number_of_figures_reaches_all_that_they_may_be(
    function: Callable[..., Any], of: list[tuple[float, float]], error: float | None
) -> None:
    told = figure_of_figures(function, *(Figure(x, "N", e) for x, e in of), unit="N")
    assert told.error == (None if error is None else pytest.approx(error, rel=1e-9))
    assert bool(told.reason) == (error is None)
