"""Sentences that must turn where the figures do."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cosim import System
from scenarios.conveyor import classical
from scenarios.conveyor.first_order import SETS
from scenarios.iron.questions import iron_bounce
from scenarios.orientator import formula_comparison
from tests.conftest import ask
from workbench.answer import Table
from workbench.figure import Figure


def test_a_cam_that_creeps_into_its_rise_does_not_turn_in_the_verdict() -> None:
    """The largest torque of a slow turn is the slope of what is stored and lost over the angle."""
    answer: Any = ask("iron_start", motor_A=0.05)
    f = answer.figures
    first = f"Within 3 s the cam does not complete a turn: it makes {f['turns'].brief()} turns"
    assert answer.verdict.startswith(first)
    assert "it cannot turn the cam slowly through a whole turn" in answer.verdict
    assert f["tau_cam_rest"].value == pytest.approx(0.05 * 36, rel=1e-9)
    rows = ask("iron_start", stop=3.0).tables["iron_start.csv"].frame
    phi, work = (
        rows["iron.phi"].to_numpy(),
        (rows["iron.E_pot"] + rows["iron.E_friction"]).to_numpy(),
    )
    turn = phi < phi[0] + 2 * math.pi
    most = np.max(np.diff(work[turn]) / np.diff(phi[turn]))
    assert f["tau_cam_max"].value == pytest.approx(most, rel=0.01)
    strong = ask("iron_start", motor_A=0.35, stop=0.5).verdict
    assert strong.startswith("Within 0.5 s the cam does not complete a turn: it makes 0.")
    assert "cycles/min" not in strong
    assert "cannot" not in strong
    backwards = ask("iron_start", motor_A=-4.0, stop=0.2).verdict
    assert "cannot" not in backwards


def test_a_wall_that_would_have_to_pull_is_named() -> None:
    """At the default speed it would, from rows twenty times as dense; on a slower spring it does not."""
    answer = ask("orientator_cycle")
    rows = ask("orientator_cycle", step=5e-5).tables["orientator_cycle.csv"].frame
    least = rows["orientator.N_K"].min()
    figure = answer.figures["wall_least"]
    assert least < -0.019
    assert figure.error is not None and abs(figure.value - least) < figure.error < 1e-3
    assert f"The reaction of the wall falls to {figure.brief()}: the wall would" in answer.verdict
    short = ask(
        "orientator_cycle",
        speed=0.7367,
        friction=0.22,
        step=0.006815,
        start={"orientator.chute.H": 0.03295},
    )
    told = re.search(r"wall falls to (-[\d.]+)", short.verdict)
    assert told is not None and abs(float(told[1]) - short.figures["wall_least"].value) < 1e-3
    held = ask("orientator_cycle", speed="62.5rpm", friction=0.5)
    assert held.figures["wall_least"].value > 0.2
    assert "pull" not in held.verdict


def test_a_landing_that_does_not_happen_has_no_impulse() -> None:
    f = ask("orientator_cycle", speed="110rpm").figures
    for name in ("corner_impulse", "wall_impulse", "hook_impulse"):
        assert f[name].error is None
        assert "it does not come to that: the product jams: held in chute" in f[name].reason
    stopped = ask("orientator_cycle", speed="62.5rpm", friction=0.5).figures
    assert all(
        stopped[name].value > 0.0 for name in ("corner_impulse", "wall_impulse", "hook_impulse")
    )


def test_a_single_landing_is_once_and_a_single_dimension_is_named_once() -> None:
    single = Figure(1.0, "1", 0.0)
    f = dict.fromkeys(
        ("follower_limit", "cycles", "flight", "speed", "impulse", "force", "loss"), single
    )
    verdict = iron_bounce.verdict(iron_bounce.Options(), f | {"landings": single}, None)
    assert "lands once, with an impact speed of up to" in verdict


def test_the_dimension_that_moves_the_limit_most_is_named_or_none() -> None:
    """Drawn gains of either sign, some of which are not determined."""
    rng, outcomes = np.random.default_rng(4), set()
    names = ("limit", "formula", "off", "above_least", "above_most")
    plane = Table(pd.DataFrame({"limit": [1.0]}), {})
    for _ in range(100):
        gains = {
            x: Figure.undetermined("%", "one of the limits was not found")
            if rng.random() < 0.7
            else Figure(rng.normal(), "%", 0.001)
            for x in formula_comparison.LENGTHS
        }
        f = dict.fromkeys(names, Figure(1.0, "1", 0.0)) | {
            f"gain_{x.replace('.', '_').lower()}": figure for x, figure in gains.items()
        }
        tables = {formula_comparison.PLANE: plane}
        comparison = formula_comparison.FormulaComparison(System({}), 0.35, (0.5,), f, tables)
        (text,) = comparison.sentences()
        certain = {x: abs(y.value) for x, y in gains.items() if y.error is not None}
        most = max(certain, key=lambda x: certain[x]) if certain else ""
        outcomes.add(bool(most))
        assert ("is not determined among" in text) == (not most)
        assert not most or f". {most} moves the limit most: " in text
    assert outcomes == {True, False}


def random_comparison(rng: np.random.Generator) -> classical.Comparison:
    """Limits and largest errors of the classical calculation, each of them as a sweep may leave it."""
    figures = {}
    for case in classical.CASES:
        worst = Figure(rng.choice([3.0, 30.0]), "%", 0.1)
        if worst.value < 5.0:
            end = Figure.undetermined("rad/s", "the error stays below 5 % at every speed")
        elif rng.random() < 0.3:
            end = Figure.undetermined("rad/s", classical.NOWHERE)
        elif rng.random() < 0.2:
            end = Figure.undetermined("rad/s", classical.TOO_COARSE)
        else:
            end = Figure(rng.uniform(10.0, 40.0), "rad/s", 1e-3)
        figures |= {f"limit_{case.key}": end, f"worst_{case.key}": worst}
    return classical.Comparison(figures, Table(pd.DataFrame(), {}), SETS["A"], 5.0, 20.0)


def test_the_classical_calculation_holds_in_the_verdict_where_all_of_it_does() -> None:
    rng, outcomes = np.random.default_rng(5), set()
    for _ in range(200):
        comparison = random_comparison(rng)
        text = classical.clause(comparison, "spring", "the classical calculation")
        ends = [comparison.figures[f"limit_spring_{load}"] for load in classical.QUANTITIES]
        nowhere = [end for end in ends if end.reason == classical.NOWHERE]
        unsure = [end for end in ends if end.reason == classical.TOO_COARSE]
        speeds = [end.value for end in ends if end.error is not None]
        if nowhere:
            outcomes.add("nowhere")
            assert "is off by more than 5 %" in text and "already at 20 rad/s" in text
        elif unsure:
            outcomes.add("open")
            assert text.endswith(f"is not determined: {classical.TOO_COARSE}")
        elif speeds:
            outcomes.add("up to")
            assert text.endswith(
                f"is within 5 % up to {Figure(min(speeds), 'rad/s', 1e-3).brief()}"
            )
        else:
            outcomes.add("everywhere")
            assert text.endswith("is within 5 % at every speed of the sweep")
        second = classical.clause(comparison, "whole")
        assert classical.sentence(comparison) == f"W{text[1:]}; {second}."
    assert outcomes == {"nowhere", "open", "up to", "everywhere"}


def test_orders_that_are_not_valid_are_named_in_a_line_each() -> None:
    """At 9.5 rad/s the follower lifts off, at 5 rad/s nothing lets go."""
    answer = ask("iron_orders", speeds="5,9.5")
    assert len(answer.warnings) == 3
    for warning, lag in zip(answer.warnings, (12, 80, 200)):
        first = f"in the steady motion at 9.5 rad/s with a lag of {lag} ms the follower lifts off"
        assert warning.startswith(first)
        assert "e-1" not in warning


def test_a_jam_costs_a_product_and_the_line_its_idling() -> None:
    answer: Any = ask("packing_line", iron_speed=6.0, stop=3.75, step=1e-3)
    f = answer.figures
    work = f"A cycle takes {f['work'].brief()} from the supply, with or without a product."
    assert work in answer.verdict
    share = 100 * f["mean_conveyor"].value / f["mean_supply"].value
    assert share > 99.0
    assert ("Jams cost" in answer.verdict) == (f["lost"].value > 0.0)
