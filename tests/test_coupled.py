"""Figures between samples, and the coupling errors that scenarios state for them."""

import math
from functools import partial

import numpy as np
import pytest

from cosim import Result
from scenarios import coupled, fmus, iron, iron_orders, iron_start, resonance, run_up
from scenarios.theory import SETS


def test_the_largest_value_and_its_time_lie_between_the_samples() -> None:
    t = np.arange(0.0, 3.0, 0.1)
    x, at = coupled.largest(t, 5.0 * np.sin(t) - 1.0)
    assert (x, at) == pytest.approx((4.0, math.pi / 2), abs=2e-5)
    assert abs(t - math.pi / 2).min() > 1e-2


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_a_largest_value_at_an_end_is_that_sample(end: float) -> None:
    t = np.linspace(0.0, 1.0, 11)
    assert coupled.largest(t, -((t - end) ** 2)) == (0.0, end)


def test_crossings_are_found_up_and_down() -> None:
    t = np.linspace(0.0, 2 * math.pi, 200)
    found = coupled.crossings(t, np.sin(t), 0.5)
    assert found == pytest.approx([math.pi / 6, 5 * math.pi / 6], abs=1e-6)


def test_revolutions_near_a_speed_add_up_over_all_visits() -> None:
    """w = 1 + cos t, phi = t + sin t: near 1 twice a period, 2 asin 0.1 rad each time."""
    t = np.linspace(0.0, 2 * math.pi, 2000)
    data = np.column_stack([t, 1 + np.cos(t), t + np.sin(t)])
    result = Result(("time", "conveyor.w", "conveyor.phi"), {}, {}, lambda: data)
    band = math.asin(0.1)
    wanted = 2 * (2 * band) / (2 * math.pi)
    assert run_up.revolutions_near(result, 1.0) == pytest.approx(wanted, rel=1e-6)


def test_stated_errors_hold_the_true_ones() -> None:
    """Against steps eight times shorter; outputs that the held torque moves fall with order 1."""
    fmus.build(*fmus.DRIVE.values())
    machine = SETS["B"]
    system = run_up.drive(machine, "linear", 60.0, {})
    settings = {"stop": 0.3, "record": run_up.RECORD, "fed": ("f_rod_max",)}
    figures = partial(run_up.figures, machine, "linear")
    _, found = coupled.run("", system, figures, step=4e-4, **settings)
    _, exact = coupled.run("", system, figures, step=5e-5, **settings)
    for name in ("passing", "w_max", "tau_max", "f_rod_max"):
        error, stated = abs(found[name].value - exact[name].value), found[name].error
        assert stated is not None
        assert error <= 1.1 * stated < 20 * error, name
    assert found["f_rod_max"].order == pytest.approx(1.0, abs=0.3)
    assert found["tau_max"].order == pytest.approx(2.0, abs=0.5)
    assert found["tau_max"].unit == "N.m"


def test_the_start_of_the_iron_states_its_errors() -> None:
    fmus.build("drive_motor", "iron_drive")
    system = iron.driven(iron.MOTOR, {})
    record = iron_start.RECORD
    result, found = coupled.run("", system, iron_start.figures, stop=0.1, step=5e-4, record=record)
    assert len(result.data) == 201
    for name in ("w_cam_max", "w_cam_max_time", "tau_max", "tau_max_time"):
        error = found[name].error
        assert error is not None and 0.0 < error < 1e-3 * found[name].value


def test_the_rod_force_of_the_sweep_states_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(fmus.CHOICE, "native")
    case = resonance.Case(SETS["A"], 40.0, 256, "strang", {})
    stated = resonance.rod_force(resonance.simulate(case), case, 1)
    exact = resonance.simulate(case._replace(steps_per_rev=4096)).f_rod_peak
    assert stated.order == pytest.approx(1.0, abs=0.3)
    assert stated.error is not None
    assert abs(stated.value - exact) <= 1.1 * stated.error < 10.0


def test_the_gain_of_an_order_states_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(fmus.CHOICE, "native")
    found = iron_orders.answer(speeds="5").figures
    for lag in ("80ms", "200ms"):
        for name in ("gain", "added"):
            figure = found[f"{name}_{lag}"]
            assert figure.order == pytest.approx(2.0, abs=0.6)
            assert figure.error is not None and 0.0 < figure.error < 1e-3 * figure.value
