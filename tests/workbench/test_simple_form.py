"""The simple form of a question: several certified runs, processed results, further figures and tables."""

from typing import Any

import numpy as np
import pytest

from scenarios.__main__ import PROJECT
from tests.conftest import ROOT
from workbench.answer import Answer
from workbench.run import ask

EXAMPLES = ROOT / "examples"


def answer_of(name: str, **options: Any) -> Answer:
    return ask(PROJECT, str(EXAMPLES / f"{name}.py"), options, flavour="native", jobs=1)


def test_two_systems_are_certified_and_compared() -> None:
    """Their difference is that of the speeds in the two tables, read without the workbench."""
    answer = answer_of("stop_compared")
    times = {}
    for name in ("quick", "slow"):
        frame = answer.tables[f"{name}.csv"].frame
        times[name] = float(np.interp(-20.0, -frame["conveyor.w"], frame["time"]))
    sooner = answer.figures["sooner"]
    assert 0.0 < (sooner.error or 0.0) < 1e-4
    assert sooner.value == pytest.approx(times["slow"] - times["quick"], abs=1e-5)
    assert sooner.text() in answer.verdict


def test_a_processed_result_is_what_figures_and_tables_see() -> None:
    answer = answer_of("brake_work")
    frame = answer.tables["brake_work.csv"].frame
    power = -frame["motor.tau"] * frame["conveyor.w"]
    assert np.asarray(frame["power"]) == pytest.approx(np.asarray(power))
    work = answer.figures["work"]
    assert work.value == pytest.approx(float(np.trapezoid(power, frame["time"])), rel=1e-3)
    assert answer.tables["brake_steps.csv"].frame["brake"][0] == answer.figures["brake"].value


def test_examples_are_short_and_one_is_live() -> None:
    files = {name: EXAMPLES / f"{name}.py" for name in ("stop_compared", "brake_work")}
    assert all(len(path.read_text().splitlines()) <= 40 for path in files.values())
    assert answer_of("brake_work").live is not None
