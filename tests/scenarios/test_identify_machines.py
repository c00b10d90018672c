"""What records of the iron drive and of the orientator tell, which no FMU had a part in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.identify_machines import KINDS, trial
from cosim import System, run
from examples import measured_iron, measured_orientator
from scenarios.iron import machine as iron
from scenarios.iron.questions import iron_identify
from scenarios.orientator.questions import orientator_identify
from tests.conftest import QUICK, ask, fmus_of
from workbench.answer import Answer

IRON, ORIENTATOR = measured_iron.TRUTH, measured_orientator.TRUTH
MU = "orientator_chute_mu"


@pytest.fixture(scope="module")
def products() -> Answer:
    return ask(
        "orientator_identify", **QUICK["orientator_identify"], known=["orientator.chute.H=0.04+-1%"]
    )


def test_the_iron_of_the_examples_moves_as_the_fmu_does() -> None:
    """They share no line of code; the coupling error of order 2 is all that is between them."""
    system = System(fmus_of(iron_identify), iron.WIRES, {**IRON, **measured_iron.STATES})
    error = []
    for step in (2e-3, 1e-3):
        result = run(system, stop=0.5, step=step)
        mine = measured_iron.angle_speed_torque(IRON, result["time"])
        error.append([abs(mine[k] - result[x]).max() for k, x in enumerate(measured_iron.STATES)])
    assert np.divide(*error) == pytest.approx(4.0, abs=0.2)
    assert max(error[1]) < 3e-3


@pytest.mark.parametrize(("n", "mu"), [(0.0, 0.35), (40.0, 0.5)])
def test_the_orientator_of_the_examples_takes_the_times_of_the_fmu(n: float, mu: float) -> None:
    """One with flight, one without; two bodies with constraints, and a formula for each stage."""
    start = {"orientator.chute.mu": mu, "orientator.w": n * math.pi / 30}
    result = run(System(fmus_of(orientator_identify), start=start), stop=0.4, step=0.4)
    times = [result[f"orientator.t_{x}"][-1] for x in measured_orientator.STAGES]
    assert measured_orientator.stage_durations(n, mu, 0.04) == pytest.approx(times, abs=2e-7)


def test_friction_and_fall_of_the_orientator_are_identified(products: Answer) -> None:
    f = products.figures
    for name, key in zip(ORIENTATOR, (MU, "orientator_chute_h")):
        assert abs(f[key].value - ORIENTATOR[name]) < f[key].error < 0.05 * ORIENTATOR[name]
    assert f["limit"].error < 1.0 and f["away"].value > 10.0
    following = products.tables["orientator_identify_next.csv"].frame
    fast = f"12 products at {max(products.facts['tried'])} rpm"
    assert following["record"][0] == fast
    assert following["error"].iloc[-1] < f[MU].error


def test_more_friction_makes_later_stages_longer_and_is_what_is_reported(tmp_path: Path) -> None:
    """With the times of another friction the answer follows it."""
    speeds = (30.0, 50.0)
    rows = measured_orientator.record(2, {"mu": 0.45, "H": 0.04}, speeds)
    rows.to_csv(tmp_path / "other.csv", index=False)
    options = {**QUICK["orientator_identify"], "data": str(tmp_path / "other.csv")}
    answer = ask("orientator_identify", **options)
    assert abs(answer.figures[MU].value - 0.45) < answer.figures[MU].error
    rows["turning [ms]"] *= 1.2
    rows.to_csv(tmp_path / "other.csv", index=False)
    other = ask("orientator_identify", **options)
    assert all(figure.error is None for figure in other.figures.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_intervals_hold_the_truth_of_random_machines(name: str) -> None:
    figures = [f for seed in (1, 2, 3) for f in trial(name, seed).figures.values()]
    stated = [figure for figure in figures if figure.value is not None]
    assert len(stated) >= 6
    assert np.mean([figure.error_ratio() <= 1.0 for figure in stated]) > 0.7
    assert max(figure.relative_width() for figure in stated) < 1.0


@pytest.mark.slow
def test_friction_mass_and_spring_of_the_iron_are_identified_and_correlated_values_are_named() -> (
    None
):
    answer = ask("iron_identify", **QUICK["iron_identify"])
    f = answer.figures
    up, down = 1 + IRON["iron.friction.K_up"], 1 + IRON["iron.friction.K_down"]
    mu = (up - down) / (up + down)
    assert abs(f["mu"].value - mu) < f["mu"].error < 0.05 * mu
    for name in ("iron.iron.m", "iron.spring.c", "motor.T", "iron.friction.K_up"):
        figure = f[name.replace(".", "_").lower()]
        assert abs(figure.value - IRON[name]) < 1.5 * figure.error
    assert f["iron_friction_k_up"].error > 5 * f["mu"].error
    meaning_beginning = "the record cannot tell it apart from "
    for name, partner in (("k_up", "K_down"), ("k_down", "K_up")):
        meaning = f[f"iron_friction_{name}"].meaning
        assert f"iron.friction.{partner}" in meaning.partition(meaning_beginning)[2]
