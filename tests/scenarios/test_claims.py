"""Sentences that state a result turn where machines, or the figures behind them, turn."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from scenarios.conveyor.first_order import Machine
from scenarios.conveyor.questions import mean_values, resonance, rod_force
from scenarios.conveyor.rows import LARGEST_PEAKED_ZETA, OPERATING
from scenarios.iron.questions import iron_orders
from scenarios.orientator.questions import orientation_time
from tests.conftest import ask
from workbench.figure import Figure
from workbench.options import declared

DRAWS = 200


def random_figure(rng: np.random.Generator, middle: float) -> Figure:
    """A figure on either side of a value, with an error that may reach it, or one that is not determined."""
    if rng.random() < 0.2:
        return Figure.undetermined("%", "there is no steady motion")
    return Figure(middle * rng.uniform(0.5, 1.5), "%", middle * rng.uniform(0.0, 0.2))


def test_an_order_rises_in_the_verdict_where_it_does_within_its_error() -> None:
    rng, outcomes = np.random.default_rng(1), set()
    for _ in range(DRAWS):
        adds = {f"{lag} ms": random_figure(rng, iron_orders.IMPORTANT) for lag in iron_orders.LAGS}
        stated = [x for x in adds.values() if x.error is not None]
        above = [lag for lag, x in adds.items() if x.error is not None and x.value - x.error > 10.0]
        below = [x for x in stated if x.value + x.error <= 10.0]
        text = " ".join(iron_orders.importance(adds))
        outcome = "rises" if above else "none" if below and len(below) == len(stated) else "open"
        outcomes.add(outcome)
        assert all((lag in text) == (lag in above) for lag in adds if outcome == "rises")
        assert ("a torque order rises" in text) == (outcome == "rises")
        assert ("no torque order rises" in text) == (outcome == "none")
        assert bool(text) == (outcome != "open")
    assert outcomes == {"rises", "none", "open"}


def test_a_cam_speed_exceeds_the_limit_where_it_is_above_it() -> None:
    texts = {speed: ask("iron_cycle", speed=speed, samples=180).verdict for speed in (7.0, 9.0)}
    limit = ask("iron_cycle", speed=7.0, samples=180).figures["follower_limit"].value
    assert 7.0 < limit < 9.0
    assert "is safe" in texts[7.0] and "exceeds" not in texts[7.0]
    assert "exceeds the limit" in texts[9.0] and "is safe" not in texts[9.0]


def test_the_resonance_moves_up_down_or_stays_with_the_other_spring() -> None:
    """Drawn pairs of speeds with errors: the sentence has the sign of the difference, or none."""
    rng, outcomes = np.random.default_rng(2), set()
    for _ in range(DRAWS):
        present, other = (
            Figure(40.0 + rng.normal(0.0, 0.1), "rad/s", rng.uniform(0.0, 0.1)) for _ in range(2)
        )
        machine = Machine(B=rng.choice([199.8, 5.0]), T=0.0625)
        text = rod_force.shifted(_plane_of(machine), present, other)
        difference, error = other.value - present.value, (present.error or 0) + (other.error or 0)
        outcome = "stays" if abs(difference) <= error else "up" if difference > 0.0 else "down"
        outcomes.add(outcome)
        assert {"stays": "stays at", "up": " up by ", "down": " down by "}[outcome] in text
        assert ("no resonance" in text) == (machine.zeta > LARGEST_PEAKED_ZETA)
    assert outcomes == {"stays", "up", "down"}


def _plane_of(machine: Machine) -> Any:
    """What `shifted` reads of an answer."""
    return type("Data", (), {"plane": type("Plane", (), {"machine": machine})})


def test_more_and_less_power_are_distinguished_and_neither_is_stated_within_the_error() -> None:
    rng = np.random.default_rng(3)
    for _ in range(DRAWS):
        figure = Figure(rng.normal(0.0, 1.0), "W", rng.uniform(0.0, 1.0))
        text, error = mean_values.changed(figure), figure.error or 0.0
        is_within = abs(figure.value) <= error
        assert text.endswith("more or less") == is_within
        assert (text.endswith(" more")) == (not is_within and figure.value > 0.0)


@pytest.mark.parametrize(("frictions", "jams"), [("0.2", False), ("0.5", True)])
def test_a_chart_names_a_jam_where_products_jam(frictions: str, jams: bool) -> None:
    answer = ask(
        "orientation_time", frictions=frictions, speeds="40rpm,75rpm" if jams else "20rpm,40rpm"
    )
    limit = answer.figures[orientation_time.key("limit", float(frictions))]
    assert (limit.error is not None) == jams
    (chart,) = answer.show().charts
    assert ("jam" in chart.title) == jams


def test_friction_changes_the_time_by_less_in_the_verdict_where_it_does() -> None:
    """The sentence names the first speed of the sweep at which the times differ by the spread or more."""
    answer = ask("orientation_time", frictions="0.2,0.5", speeds="20rpm,40rpm,60rpm,65rpm")
    frame = answer.tables[orientation_time.TABLE].frame
    works = frame[frame["stage"] == 4].groupby("n")["orientation_time"].agg(["count", "min", "max"])
    spread = (works["max"] / works["min"])[works["count"] > 1]
    wide = spread[spread >= orientation_time.SPREAD]
    assert ("fan" in answer.figures) == bool(len(wide))
    assert ("friction changes the orientation time by less" in answer.verdict) == bool(len(wide))
    if len(wide):
        assert f"below {wide.index[0]:.4g} rpm" in answer.verdict


def test_help_texts_have_the_defaults_that_the_questions_use() -> None:
    for page in (resonance, rod_force):
        meaning = declared(page.Options)["speed"].meaning
        for name, speed in OPERATING.items():
            assert f"{speed:g} in set {name}" in meaning
    meaning = declared(resonance.Options)["speed"].meaning
    assert all(f"{x:g}" in meaning for x in resonance.BAND)
    assert math.isclose(LARGEST_PEAKED_ZETA**2, 0.5)
