"""Figures between rows, and the errors that questions state."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from cosim import Estimate, Result
from cosim.accuracy.judge import Function, judge_function
from cosim.accuracy.nested import NestedRuns
from cosim.accuracy.trajectories import find_divergence
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


def result_of_steps(steps: float = 1.0, first_order: Sequence[str] = ()) -> Result:
    """Columns x and y, which are off by 0.1 steps**2."""
    t = np.linspace(0.0, 1.0, 11)
    error = 0.1 * steps**2 * np.ones_like(t)
    report = {"convergence_order": 2, "first_order": first_order}
    columns = [TIME, Column("x", "N"), Column("y", "N")]
    return Result(columns, report, np.column_stack([t, 5.0 + error, 5.0 + error]).T.__getitem__)


def judged(function: Function, results: Sequence[Result]) -> dict[str, Estimate]:
    """What certify makes of the numbers of three runs that bring the errors of their rows."""
    return judge_function(function, NestedRuns(results, results[0], 2.0), find_divergence(results))


def ends(r: Result) -> dict[str, Estimate]:
    return {name: Estimate(r[name][-1], 0.02, unit="N") for name in "xy"}


def with_errors(
    first_order: Sequence[str] = (), figures: Callable[[Result], dict[str, Estimate]] = ends
) -> dict[str, Estimate]:
    """The figures of columns that are off by 0.1, 0.4 and 1.6."""
    return judged(figures, [result_of_steps(steps, first_order) for steps in (1.0, 2.0, 4.0)])


def test_errors_of_rows_and_coupling_add_up_and_a_refusal_stays_a_refusal() -> None:
    error = with_errors()["x"].error
    assert error == pytest.approx(0.02 + 1.25 * 0.1)
    results = [result_of_steps(steps) for steps in (1.0, 2.0, 4.0)]
    refused = {"x": Estimate(math.nan, None, reason="it never was")}
    assert judged(lambda _: refused, results) == refused
    last = iter([*(ends(r) for r in (results[0], *results[:2])), refused])
    assert judged(lambda _: next(last), results)["x"].error is None


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


def test_the_start_and_the_turn_of_the_iron_state_their_errors() -> None:
    """A turn of 180 rows against one of 1440; the start against steps four times shorter."""
    coarse, fine = (ask("iron_cycle", samples=n).figures for n in (180, 1440))
    for name in ("tau_cam_min", "tau_cam_max", "stroke", "work", "follower_force_min"):
        difference = abs(coarse[name].value - fine[name].value)
        assert difference < coarse[name].error + fine[name].error, name
        assert coarse[name].error < 0.02 * abs(fine[name].value), name
    coarse, fine = (ask("iron_start", stop=0.1, step=h).figures for h in (5e-4, 1.25e-4))
    for name in ("w_cam_max", "w_cam_max_time", "tau_max", "tau_max_time", "energy_in"):
        error = coarse[name].error
        assert abs(coarse[name].value - fine[name].value) < 1.1 * error < 2e-3 * fine[name].value
