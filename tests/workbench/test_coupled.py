"""Figures between rows, and the errors that questions state."""

import math

import numpy as np
import pytest

from cosim import Result
from cosim.series import TIME, Column
from scenarios.conveyor.questions import run_up
from tests.conftest import ask
from workbench.figure import figure_of_columns


def test_a_number_of_rows_states_what_their_spacing_leaves() -> None:
    """A sum over rows is off by the square of their distance."""
    t = np.linspace(0.0, 3.0, 31)
    area = figure_of_columns(
        lambda t, x: float(np.trapezoid(x, t)), t, np.exp(-t) * np.sin(7 * t), unit="m.s"
    )
    exact = (7 - math.exp(-3) * (math.sin(21) + 7 * math.cos(21))) / 50
    assert area.error and 0.0 < abs(area.value - exact) < area.error < 2e-2


def test_revolutions_near_a_speed_add_up_over_all_visits() -> None:
    """w = 1 + cos t, phi = t + sin t: near 1 twice a period, 2 asin 0.1 rad each time."""
    t = np.linspace(0.0, 2 * math.pi, 2000)
    columns = [TIME, Column("conveyor.w"), Column("conveyor.phi")]
    rows = np.stack([t, 1 + np.cos(t), t + np.sin(t)])
    near = run_up.revolutions_near(1.0, Result(columns, {}, rows.__getitem__))
    assert near == pytest.approx(4 * math.asin(0.1) / (2 * math.pi), rel=1e-6)


LIGHT = {
    "conveyor.trough.d": 1383.0, "conveyor.rotor.J": 0.257, "conveyor.trough.m": 103.3,
    "conveyor.spring.c": 939565.0, "conveyor.crank.r": 0.015,
}  # fmt: skip


def test_stated_errors_hold_the_true_ones() -> None:
    """Against steps eight times shorter; the rod force, which the held torque moves at once, falls
    with order 1 and the rest with order 2.
    """
    estimates = ask("run_up", stop=0.3, step=4e-4).figures
    exact = ask("run_up", stop=0.3, step=5e-5).figures
    for name in ("passing", "w_max", "tau_max", "f_rod_max", "revolutions_near"):
        stated, value = estimates[f"linear_{name}"].error, estimates[f"linear_{name}"].value
        assert stated is not None
        error = abs(value - exact[f"linear_{name}"].value)
        assert error <= stated < 40 * error, name
    ratio = estimates["linear_f_rod_max"].error / exact["linear_f_rod_max"].error
    assert ratio == pytest.approx(8.0, rel=0.4)
    coarse, fine = (
        ask("run_up", speed=36.1, stop=0.68, step=h, start=LIGHT).figures["linear_f_rod_max"]
        for h in (9e-4, 6e-5)
    )
    assert abs(coarse.value - fine.value) <= coarse.error + fine.error
