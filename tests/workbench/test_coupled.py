"""Figures between rows, and the errors that questions state."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from cosim import Estimate, Result, limit
from cosim.accuracy.judge import Function, judge_function
from cosim.accuracy.nested import NestedRuns
from cosim.accuracy.trajectories import divergence
from cosim.series import TIME, Column
from scenarios.conveyor.questions import run_up
from tests.conftest import ask
from workbench import Figure, measure


def test_the_largest_value_and_its_time_lie_between_the_rows() -> None:
    t = np.arange(0.0, 3.0, 0.1)
    peak = measure.largest(t, 5.0 * np.sin(t) - 1.0)
    assert 0.0 < abs(peak.value - 4.0) < peak.error < 2e-3
    assert 0.0 < abs(peak.at.value - math.pi / 2) < peak.at.error < 2e-3
    assert abs(t - math.pi / 2).min() > 1e-2
    low = measure.smallest(t, 1.0 - 5.0 * np.sin(t))
    assert (low.value, low.error) == pytest.approx((-peak.value, peak.error))


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_a_largest_value_at_an_end_is_that_row(end: float) -> None:
    t = np.linspace(0.0, 1.0, 11)
    assert measure.largest(t, 3.0 - (t - end) ** 2)[::2] == (3.0, (end, end * 1e-12))


def test_crossings_are_located_up_and_down_with_their_errors() -> None:
    t = np.linspace(0.0, 2 * math.pi, 60)
    for which, exact in zip((0, 1, -1), np.pi / 6 * np.array([1, 5, 5])):
        crossing = measure.crossing(t, np.sin(t), 0.5, which)
        assert 0.0 < abs(crossing.value - exact) < crossing.error < 1e-3


def test_where_x_hardly_moves_from_rest_it_crosses_nothing() -> None:
    """A spline that is nearly zero there, 1e-319, has zeros of the level in SciPy's arithmetic."""
    t = np.linspace(0.0, 1.0, 2001)
    x = np.maximum(t - 0.5, 0.0) ** 3
    assert len(CubicSpline(t, x).solve(0.1, extrapolate=False)) > 1
    only = measure.crossing(t, x, 0.1)
    assert measure.crossing(t, x, 0.1, -1) == only
    assert abs(only.value - 0.5 - 0.1 ** (1 / 3)) < only.error < 1e-6


def test_a_crossing_that_never_happens_is_a_refused_figure() -> None:
    t = np.linspace(0.0, 2 * math.pi, 60)
    for level, which in ((2.0, 0), (0.5, 2), (0.5, -3)):
        figure = measure.crossing(t, np.sin(t), level, which).figure("s", "when")
        assert (figure.error, figure.reason) == (None, "it does not happen during the run")


@pytest.mark.parametrize("off", [-1e-8, 1e-8])
def test_a_level_that_is_only_just_reached_or_missed_gives_no_time(off: float) -> None:
    """x = 3 - cos(t) - t / 100 turns at 3.9686, 1.9371, 3.9058: what comes before the time sought decides.

    The rows leave 1e-7 of x open.
    """
    t = np.linspace(0.0, 12.0, 400)
    x = 3.0 - np.cos(t) - t / 100.0
    turn = math.pi - math.asin(0.01)
    level = 3.0 - math.cos(turn) - turn / 100.0 + off
    crossings = [
        measure.crossing(t, x, level, which).figure("s", "when") for which in (0, 1, -1, -2)
    ]
    assert {figure.reason for figure in crossings} == {
        "the signal only touches the level, within its error"
    }
    final = t > 4.0
    assert (
        measure.crossing(t[final], x[final], level).figure("s", "when").reason.startswith("it does")
    )
    for low in (2.5, 3.5):
        assert measure.crossing(t, x, low).figure("s", "when").error


def test_only_turns_before_a_time_make_it_doubtful() -> None:
    """t sin(t) turns at 1.820 and at 7.917: a level there is passed twice, and twice or not again."""
    t = np.linspace(0.1, 12.0, 800)
    x = t * np.sin(t)
    turns = [float(brentq(lambda t: math.tan(t) + t, *span)) for span in ((1.8, 2.2), (7.9, 8.1))]
    low, high = (turn * math.sin(turn) - 1e-9 for turn in turns)
    for level, doubtful in ((low, {0, 1, 2, 3, -3, -4}), (high, {*range(-4, 4)})):
        for which in range(-4, 4):
            infinite = math.isinf(measure.crossing(t, x, level, which).error)
            assert infinite == (which in doubtful), (level, which)


@pytest.mark.parametrize(
    ("level", "which", "clear"),
    [(7.0, 0, 0.827), (7.0, -1, 0.827), (8.0, 0, 3.022), (8.0, -1, 0.173)],
)
def test_the_clearance_is_that_of_the_turns_which_decide(
    level: float, which: int, clear: float
) -> None:
    """t + 3 sin(t) turns at 4.739, 1.544, 11.022, 7.827 and 17.305: it passes 7 once, and 8 three times."""
    t = np.linspace(0.0, 15.0, 600)
    near = measure.clearance(t, t + 3.0 * np.sin(t), level, which)
    assert near.value == pytest.approx(clear, abs=1e-3) and near.error < 1e-5
    passing = Figure(1.0, "s", 1e-6)
    for error in (0.5 * near.value, 2.0 * near.value):
        told = measure.passed_for_certain(passing, Figure(near.value, "rad", error))
        assert (told == passing) == (error < near.value)
    assert measure.passed_for_certain(passing, None) == passing


def test_an_integral_states_what_its_rows_leave_open() -> None:
    t = np.linspace(0.0, 3.0, 31)
    integral = measure.integral(t, np.exp(-t) * np.sin(7 * t))
    exact = (7 - math.exp(-3) * (math.sin(21) + 7 * math.cos(21))) / 50
    assert 0.0 < abs(integral.value - exact) < integral.error < 1e-2


def test_revolutions_near_a_speed_add_up_over_all_visits() -> None:
    """w = 1 + cos t, phi = t + sin t: near 1 twice a period, 2 asin 0.1 rad each time."""
    t = np.linspace(0.0, 2 * math.pi, 2000)
    near = run_up.revolutions_near(1.0, t, 1 + np.cos(t), t + np.sin(t))
    assert near == pytest.approx(4 * math.asin(0.1) / (2 * math.pi), rel=1e-6)


@pytest.mark.parametrize("values", [(1.0, 1.1, 1.11), (2.0, 1.0, 0.99), (1.0, 1.5, 1.2)])
def test_what_certify_refuses_is_no_figure_of_a_question_either(
    values: tuple[float, float, float],
) -> None:
    results = [result_of_steps(steps) for steps in (1.0, 2.0, 4.0)]
    assert not limit(values, 2.0).is_stated
    for own, refused in ((0.001, True), (1.0, False)):
        figures = iter([{"x": Estimate(value, own)} for value in (values[0], *values)])
        figure = judged(lambda _, f=figures: next(f), results)["x"]
        assert (figure.error is None) == refused
        assert ("not converged" in figure.reason) == refused


@pytest.mark.parametrize(("order", "power"), [(2.0, 2.0), (2.0, 1.0), (2.0, 3.0), (1.0, 1.0)])
def test_a_coupling_error_holds_whatever_the_order_and_is_not_much_too_wide(
    order: float, power: float
) -> None:
    values = [5.0 + 0.1 * h**power for h in (1.0, 2.0, 4.0)]
    error = float(limit(values, order).error)
    assert 0.1 < error < (1.3 if power == order else 14.1) * 0.1


def result_of_steps(steps: float = 1.0, first_order: Sequence[str] = ()) -> Result:
    """Columns x and y, which are off by 0.1 steps**2."""
    t = np.linspace(0.0, 1.0, 11)
    error = 0.1 * steps**2 * np.ones_like(t)
    report = {"convergence_order": 2, "first_order": first_order}
    columns = [TIME, Column("x", "N"), Column("y", "N")]
    return Result(columns, report, np.column_stack([t, 5.0 + error, 5.0 + error]).T.__getitem__)


def judged(function: Function, results: Sequence[Result]) -> dict[str, Estimate]:
    """What certify makes of the numbers of three runs that bring the errors of their rows."""
    return judge_function(function, NestedRuns(results, results[0], 2.0), divergence(results))


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


def test_figures_of_outputs_of_order_1_have_the_errors_of_order_1() -> None:
    """Where only such an output is read; where others are, too, the order that is observed counts."""

    def only_y(r: Result) -> dict[str, Estimate]:
        return {"y": Estimate(r["y"][-1], 0.02)}

    error = with_errors(first_order=["y"], figures=only_y)["y"].error
    assert error == pytest.approx(0.02 + float(limit([5.1, 5.4, 6.6], 1.0).error))
    assert error > with_errors(figures=only_y)["y"].error + 0.5
    assert with_errors(first_order=["y"])["x"] == with_errors()["x"]


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


def test_the_gain_of_an_order_states_its_error() -> None:
    estimates = ask("iron_orders", speeds="5").figures
    for lag in ("80ms", "200ms"):
        for name in ("gain", "added"):
            figure = estimates[f"{name}_{lag}"]
            assert figure.error is not None and 0.0 < figure.error < 1e-3 * figure.value


def test_the_cost_of_a_jam_and_its_error_follow_the_cycle() -> None:
    estimates = ask("packing_line", step=1e-3).figures
    cycle, products = estimates["cycle"], estimates["products"]
    assert products.value == pytest.approx(60 / cycle.value, rel=1e-12)
    share = products.error / products.value
    assert share == pytest.approx(cycle.error / cycle.value, rel=0.2)


def test_rows_of_a_result_are_thinned_together() -> None:
    t = np.linspace(0.0, 1.0, 21)
    r = Result([TIME, Column("a.x", "m")], {}, np.column_stack([t, t**2]).T.__getitem__)

    def figures_of(r: Result) -> dict[str, Figure]:
        area = float(np.trapezoid(r["a.x"], r["time"]))
        return {"sum": Figure(area, "m.s", 0.0), "none": Figure.undetermined("m", "why")}

    figures = measure.with_row_errors(figures_of, r)
    assert figures["sum"].value == pytest.approx(1 / 3, abs=1e-3)
    assert abs(figures["sum"].value - 1 / 3) < figures["sum"].error
    assert figures["none"].reason == "why"


@pytest.mark.parametrize("jump", [1.0, 1.0003])
def test_a_largest_value_next_to_a_jump_is_not_that_of_a_spline(jump: float) -> None:
    t = np.linspace(0.0, 2.0, 2001)
    peak = measure.largest(t, np.where(t <= jump, 93.0 - (t - 1.2) ** 2, 80.0))
    assert abs(peak.value - (93.0 - (jump - 1.2) ** 2)) <= peak.error < 1e-3
    assert abs(peak.at.value - jump) <= peak.at.error < 3e-3


def test_figures_after_the_runs_have_diverged_are_refused() -> None:
    """Trajectories that do not come closer with shorter steps, after they begin alike."""
    t = np.linspace(0.0, 10.0, 401)
    past_divergence = np.where(t > 5.0, 1.0, 0.0)

    def diverged(phase: float) -> Result:
        rows = np.column_stack([t, np.sin(t + phase * past_divergence)])
        return Result([TIME, Column("x")], {"convergence_order": 1}, rows.T.__getitem__)

    results = [diverged(phase) for phase in (5.5, 3.0, 1.0)]

    def figures(r: Result) -> dict[str, Estimate]:
        x = r["x"]
        return {"early": Estimate(float(x[100]), 0.1), "late": Estimate(float(x[-1]), 0.1)}

    refused = judged(figures, results)
    assert refused["early"].error == pytest.approx(0.1)
    assert refused["late"].error is None
    assert "the runs diverge from 5" in refused["late"].reason
    same = [results[0]] * 3
    for figure in judged(figures, same).values():
        assert figure.error == pytest.approx(0.1)
