"""Figures between rows, and stated errors that hold the true ones of continuous time."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.certify import judged, nonlinear_cases, uniform_sampler
from benchmarks.certify_cases import synthetic_cases
from cosim import (
    Estimate,
    Result,
    SetupError,
    System,
    certify,
    crossing,
    dense,
    largest,
    mean,
    rms,
    run,
    smallest,
    time_of_largest,
    time_of_smallest,
)
from cosim.dense import Curves
from cosim.metrics import (
    TURN,
    Crossing,
    Harmonic,
    Integral,
    Largest,
    Last,
    LastTurn,
    Mean,
    Metric,
    Settled,
    StrongestOrder,
    Swing,
    TimeOfLargest,
    TurnMean,
    passings,
)
from cosim.series import TIME, Column, Kind
from tests.cosim.conftest import runs_of

SEED = 20261122


def test_a_level_is_passed_where_a_gap_begins_if_what_follows_begins_beyond_it() -> None:
    t = np.linspace(0.0, 1.0, 41)
    x = np.where(t <= 0.5, np.sin(40.0 * t) - 1.2, 2.0 - 200.0 * (t - 0.5))
    after = Curves.of_rows(t, x).filled(dense.Side.AFTER)
    assert passings(after, 0.0) == pytest.approx([0.5, 0.51], abs=1e-12)


def test_stated_errors_hold_the_true_ones_of_random_systems(half: Path) -> None:
    """At least 19 of 20, none three times as large, and few figures without an error."""
    results = [
        figure
        for k, (name, case) in enumerate(nonlinear_cases(SEED, half))
        for figure in judged(name, case, [("jacobi", "gauss-seidel", "strang")[k % 3]], halvings=3)
    ]
    ratios = {x: r for x in results if (r := x.stated.error_ratio()) is not None}
    assert len(ratios) > 0.95 * len(results) > 200
    assert np.mean([r <= 1.0 for r in ratios.values()]) >= 0.95
    worst = max(ratios, key=ratios.__getitem__)
    assert ratios[worst] <= 3.0, worst
    assert np.median([1.0 / r for r in ratios.values() if r > 0.0]) < 4.0


def test_constructed_cases_keep_what_they_promise() -> None:
    """What cannot be determined is refused, and of what can be determined most is stated."""
    cases = synthetic_cases(uniform_sampler(SEED)).items()
    results = [figure for name, case in cases for figure in judged(name, case, halvings=1)]
    assert len(results) == 15 * 7
    ratios = [r for x in results if (r := x.stated.error_ratio()) is not None]
    assert np.mean([r > 1.0 for r in ratios]) <= 0.005 and max(ratios) <= 2.0
    assert not [x for x in results if x.promise is False and x.stated.value is not None]
    assert np.mean([x.stated.value is None for x in results if x.promise]) <= 0.05


def of(
    values: Callable[[Any], Any], stop: float = 1.0, kind: Kind = Kind.CONTINUOUS
) -> Callable[..., Result]:
    """A run whose rows are exact whatever the step."""

    t = np.linspace(0.0, stop, round(stop / 0.01) + 1)
    return runs_of(lambda _: [t, values(t)], order=2, kind=kind)


def rows_only(
    figure: Callable[[Any, Any], float],
    values: Callable[[Any], Any],
    kind: Kind = Kind.CONTINUOUS,
) -> Estimate:
    """A figure of rows that the coupling does not touch."""
    runner = of(values, kind=kind)
    got = certify(
        System({}), lambda r: {"f": figure(r["time"], r["x"])}, step=0.0025, runner=runner
    )
    return got.figures["f"]


@pytest.mark.parametrize("peak_time", [0.503, 0.505, 0.5])
def test_the_rows_share_holds_wherever_the_peak_lies(peak_time: float) -> None:
    def peak(t: Any) -> Any:
        return 5.0 - 300.0 * (t - peak_time) ** 2

    got = rows_only(lambda t, x: x.max(), peak)
    assert 5.0 - got.value <= got.error <= 0.05
    got = rows_only(lambda t, x: t[np.argmax(x)], peak)
    assert abs(got.value - peak_time) <= got.error <= 0.02
    for figure, true in ((largest, 5.0), (time_of_largest, peak_time)):
        got = rows_only(figure, peak)
        assert got.value == pytest.approx(true, abs=1e-9)


def test_a_dip_between_the_first_two_rows_is_in_the_error() -> None:
    """No row shows it, but the first row is not where the next ones lead."""
    t = np.linspace(0.0, 0.01, 10001)

    def dip(t: Any) -> Any:
        return 3.0 * t - 0.01 * (1.0 - np.exp(-t / 0.0015))

    for figure in (smallest, lambda t, x: x.min()):
        got = rows_only(figure, dip)
        assert 1e-3 < got.value - dip(t).min() <= got.error < 0.03
        smooth = rows_only(figure, lambda t: 3.0 * t + t**2)
        assert smooth.value == 0.0
        assert smooth.error < 4.0 * 3.1e-10  # three times the rounding of the largest value


def test_a_function_that_counts_rows_is_refused_with_its_sentence() -> None:
    """A slice by row number means another time with fewer rows."""

    def decay(t: Any) -> Any:
        return np.exp(-5.0 * t) * np.cos(30.0 * t)

    got = rows_only(lambda t, x: x[50:].max(), decay)
    assert (got.error is None and "fewer rows" in got.reason) or "zero-size" in got.reason


def test_an_event_that_locks_to_rows_is_reported() -> None:
    """The change of a discrete column is known to a row."""

    def switch(t: Any) -> Any:
        return np.where(t >= 0.4567, 1.0, 0.0)

    got = rows_only(lambda t, x: t[np.argmax(x > 0)], switch, Kind.DISCRETE)
    assert got.value - 0.4567 <= 0.01 <= got.error <= 0.02
    assert got.rows > 0.99 * got.error
    got = rows_only(lambda t, x: crossing(t, x, 0.5), switch, Kind.DISCRETE)
    assert abs(got.value - 0.4567) <= got.error


def test_means_of_rows_are_not_means_over_time() -> None:
    got = rows_only(lambda t, x: x.mean(), lambda t: 1.0 + np.cos(2 * np.pi * t))
    assert 0.005 < abs(got.value - 1.0) <= got.error < 0.05
    assert rows_only(mean, lambda t: 1.0 + np.cos(2 * np.pi * t)).value == pytest.approx(1.0)


def test_a_figure_that_cannot_be_determined_is_refused_with_the_reason() -> None:
    got = rows_only(lambda t, x: crossing(t, x, 2.0), lambda t: t)
    assert got.error is None
    assert math.isnan(got.value)
    assert "it has no value" in str(got)


def test_figures_between_rows_are_those_of_the_curve() -> None:
    t = np.linspace(0.0, 2.0, 81)
    x = np.exp(-t) * np.sin(5.0 * t)
    top = math.atan(5.0) / 5.0
    bottom = top + math.pi / 5.0
    assert time_of_largest(t, x) == pytest.approx(top, abs=1e-5)
    assert largest(t, x) == pytest.approx(math.exp(-top) * math.sin(5.0 * top), abs=1e-5)
    assert time_of_smallest(t, x) == pytest.approx(bottom, abs=1e-5)
    assert smallest(t, x) == pytest.approx(math.exp(-bottom) * math.sin(5.0 * bottom), abs=1e-5)
    when = crossing(t, x, -0.1)
    assert bottom > when > math.pi / 5.0
    assert math.exp(-when) * math.sin(5.0 * when) == pytest.approx(-0.1, abs=1e-5)
    assert crossing(t, -x, 0.1) == crossing(t, x, -0.1)
    assert math.isnan(crossing(t, x, 2.0))
    assert mean(t, t**3) == pytest.approx(2.0, rel=1e-12)
    assert rms(t, np.sin(math.pi * t)) == pytest.approx(math.sqrt(0.5), rel=1e-6)


def test_a_row_of_an_event_close_to_a_row_does_not_make_a_peak_uncertain() -> None:
    """Neither its value nor its error; a spline through two rows 1 us apart would ring."""

    def certified(events: tuple[float, ...]) -> Estimate:
        t = np.union1d(np.linspace(0.0, 1.0, 101), events)

        runner = runs_of(lambda step: [t, np.sin(7.0 * t) * (1.0 + step)])
        return certify(System({}), {"f": Largest("x")}, step=0.0025, runner=runner).figures["f"]

    without_row, with_row = certified(()), certified((0.22 + 1e-6,))
    assert with_row.value == pytest.approx(without_row.value, abs=1e-9)
    assert abs(with_row.value - 1.0) <= with_row.error <= 1.01 * without_row.error


def test_a_function_that_fails_on_other_rows_than_those_of_the_run_is_refused() -> None:
    """It does not get an error from the evaluations that happen not to fail."""

    def strict(t: Any, x: Any) -> float:
        if len(x) != 101:
            raise ValueError("there must be 101 rows")
        return float(x.max())

    got = rows_only(strict, lambda t: np.sin(7.0 * t))
    assert got.error is None and "there must be 101 rows" in got.reason


def test_a_mode_between_frequencies_and_parts_of_a_run_have_their_metrics() -> None:
    t = np.linspace(0.0, 2.0, 2001)
    x = Curves.of_rows(t, 2.0 * np.sin(6 * np.pi * t + 0.3) + np.cos(12 * np.pi * t))
    assert Harmonic("x", frequency=3.0)(x) == pytest.approx(2.0, rel=1e-8)
    assert Harmonic("x", frequency=6.0, begin=1.0)(x) == pytest.approx(1.0, rel=1e-8)
    assert np.isnan(Harmonic("x", frequency=0.3)(x)).all()
    line = Curves.of_rows(t, 3.0 * t)
    assert Integral("x", begin=1.0)(line) == pytest.approx(4.5, rel=1e-12)
    assert Largest("x", end=0.5)(line) == pytest.approx(1.5, rel=1e-12)
    assert Last("x", end=0.25)(line) == pytest.approx(0.75, rel=1e-12)


def test_a_jump_is_no_peak() -> None:
    """No spline rises above a step, however it rings."""
    t = np.linspace(0.0, 1.0, 21)
    step = np.where(t > 0.52, 1.0, 0.0)
    assert (largest(t, step), smallest(t, step)) == (1.0, 0.0)
    assert largest(t, 1.0 - step) == 1.0
    assert (largest(t[:2], step[:2]), mean(t[:2], t[:2])) == (0.0, pytest.approx(0.025))


def test_rows_that_repeat_a_time_are_left_out() -> None:
    t = np.linspace(0.0, 1.0, 21)
    x = np.sin(3.0 * t)
    indices = np.repeat(np.arange(21), 3)
    for figure in (largest, smallest, mean, rms, time_of_largest):
        assert figure(t[indices], x[indices]) == figure(t, x)


def sine(n: int = 2001, sign: float = 1.0) -> Curves:
    """Two periods of a sine in 2 s, from 0."""
    t = np.linspace(0.0, 2.0, n)
    return Curves.of_rows(t, sign * np.sin(2 * np.pi * t))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_crossing_is_alike_up_and_down_and_no_start_on_the_level(sign: float) -> None:
    assert Crossing("x", level=0.0)(sine(sign=sign)) == pytest.approx(0.5, abs=1e-9)
    assert Crossing("x", level=0.5 * sign)(sine(sign=sign)) == pytest.approx(1 / 12, abs=1e-9)
    assert Crossing("x", level=0.5 * sign, begin=0.2)(sine(sign=sign)) == pytest.approx(5 / 12)


def test_a_crossing_between_two_rows_is_found_as_a_largest_value_is() -> None:
    """Five intervals of half a period: no row is above 0.98, the curve is."""
    t = np.linspace(0.0, 1.0, 6)
    x = np.sin(math.pi * t)
    assert x.max() < 0.98 < largest(t, x)
    assert crossing(t, x, 0.98) == pytest.approx(math.asin(0.98) / math.pi, abs=5e-3)
    assert len(passings(Curves.of_rows(t, x), 0.98)) == 2


def test_a_jump_and_a_value_that_holds_pass_a_level_when_they_change() -> None:
    t = np.array([0.0, 1.0, 1.0, 2.0])
    assert Crossing("x", level=2.0)(Curves.of_rows(t, np.array([0.0, 1.0, 5.0, 5.0]))) == 1.0
    held = Curves.of_rows(t[[0, 1, 3]], np.array([0.0, 0.0, 5.0]), is_held=True)
    assert 1.0 < Crossing("x", level=2.0)(held) < 2.0


def test_what_never_passes_a_level_says_how_far_it_gets() -> None:
    figures = {"high": Crossing("x", level=3.0), "low": Crossing("x", level=-3.0)}
    got = certify(System({}), figures, step=0.0025, runner=of(lambda t: np.sin(7 * t))).figures
    assert got["high"].reason == "x stays below 3, largest 1"
    assert got["low"].reason == "x stays above -3, smallest -1"
    t = np.linspace(0.0, 1.0, 101)

    def touching(_: Any, *, step: float, **__: Any) -> Result:
        rows = np.column_stack([t, np.sin(7.0 * t) * (1.0 + step)])
        return Result([TIME, Column("x")], {"convergence_order": 1}, rows.T.__getitem__)

    for level in (1.0001, 1.0026):
        passes = {"f": Crossing("x", level=level)}
        near = certify(System({}), passes, step=0.0025, runner=touching).figures["f"]
        assert (near.error, near.reason) == (None, "it comes as near to it as its error")


def turning(n: int = 4001) -> tuple[Curves, Curves]:
    """A speed of 10 rad/s with a ripple of the second and a little of the third order, and its angle."""
    t = np.linspace(0.0, 4.0, n)
    phi = 10.0 * t
    w = 10.0 + np.sin(2 * phi) + 0.3 * np.cos(3 * phi) + np.exp(-t)
    return Curves.of_rows(t, w), Curves.of_rows(t, phi)


def test_metrics_of_turns() -> None:
    w, phi = turning()
    turn = 2 * math.pi / 10.0
    mean_of_turn = lambda end: 10.0 + (math.exp(turn - end) - math.exp(-end)) / turn
    assert Largest(TurnMean("w", over="phi"))(w, phi) == pytest.approx(mean_of_turn(turn), abs=1e-6)
    assert LastTurn(Mean("w"), over="phi")(w, phi) == pytest.approx(mean_of_turn(4.0), abs=1e-6)
    last = w.t >= 4.0 - turn
    assert LastTurn(Swing("w"), over="phi")(w, phi) == pytest.approx(np.ptp(w.x[0, last]), abs=1e-4)
    assert LastTurn(Mean("w"), over="phi", turns=3).columns == ("w", "phi")
    assert np.isnan(LastTurn(Mean("w"), over="phi", turns=7)(w, phi)).all()
    assert StrongestOrder("w", over="phi")(w, phi) == 2.0
    amplitudes = StrongestOrder("w", over="phi").amplitudes(w, phi)
    assert amplitudes is not None and amplitudes[:4] == pytest.approx([0, 1, 0.3, 0], abs=0.01)
    back = phi.with_values(-phi.x)
    assert LastTurn(Mean("w"), over="phi")(w, back) == pytest.approx(mean_of_turn(4.0), abs=1e-6)
    assert StrongestOrder("w", over="phi")(w, back) == 2.0


def test_what_a_steady_motion_may_still_change_is_in_its_error_and_one_that_is_not_steady_is_refused() -> (
    None
):
    """The means of turns fall to 10 rad/s as a geometric series."""

    def runner(_system: object, *, stop: float, step: float, **_: Any) -> Result:
        t = np.linspace(0.0, stop, round(stop / step) + 1)
        w = 10.0 + np.sin(20.0 * t) + np.exp(-t)
        columns = [TIME, Column("w", "rad/s"), Column("phi", "rad")]
        return Result(columns, {"convergence_order": 1}, np.array([t, w, 10.0 * t]).__getitem__)

    def mean(stop: float, **how: Any) -> Estimate:
        metrics = {"mean": Settled(Mean("w"), over="phi", **how)}
        return certify(System({}), metrics, stop=stop, step=1e-3, runner=runner).figures["mean"]

    settled = mean(4.0)
    left = math.exp(-4.0) * math.expm1(TURN / 10.0) / (TURN / 10.0)
    assert settled.value == pytest.approx(10.0 + left, abs=1e-6)
    assert settled.error is not None
    assert left < settled.error < 1.01 * left
    assert "not steady" in mean(2.0).reason
    assert mean(2.0, share=0.1).error is not None
    assert "turns less than three times" in mean(1.8).reason


def test_metrics_know_their_units() -> None:
    assert Integral("x").unit("N") == "N.s"
    assert Integral("x").unit("rad/s") == "rad.s/s"
    assert Crossing("x", level=1.0).unit("N") == TimeOfLargest("x").unit("N") == "s"
    assert LastTurn(Swing("x"), over="phi").unit("N") == "N"
    assert StrongestOrder("x", over="phi").unit("N") == ""


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        (Largest("motor.tua"), "motor has no variable 'tua', only "),
        (LastTurn(Swing("motor.tau"), over="phi"), "motor has no variable 'phi', only "),
        (Largest("motor.P"), "largest of motor.P: motor.P is not recorded: name it"),
        (Last("motor.tau", begin=5.0), "its stretch must lie in the run, from 0 to 0.1 s"),
        (Mean("motor.tau", begin=0.05, end=0.05), "its stretch must lie in the run"),
    ],
)
def test_a_metric_that_the_run_cannot_have_is_refused_before_it(
    metric: Metric, message: str, native: Path
) -> None:
    def never(*_: Any, **__: Any) -> Result:
        raise AssertionError("it was run")

    system = System({"motor": native / "DriveMotor.fmu"})
    with pytest.raises(SetupError, match=re.escape(message)):
        certify(system, {"f": metric}, stop=0.1, step=1e-3, record=["motor.tau"], runner=never)
    certify(system, {"f": Largest("motor.tau")}, stop=0.1, step=1e-3, runner=run)


def test_a_function_that_weighs_rows_and_not_time_has_that_in_its_error() -> None:
    """Rows of adaptive steps are dense where x is small: their mean is 0.2, that over time 0.5, with fewer rows, too."""

    t = np.linspace(0.0, 1.0, 401) ** 0.25
    runner = runs_of(lambda step: [t, 1.0 - t + step * t])
    figures = {"of rows": lambda r: float(r["x"].mean()), "last": lambda r: float(r["x"][-1])}
    got = certify(System({}), figures, step=0.0025, runner=runner).figures
    error = got["of rows"].error
    assert abs(got["of rows"].value - 0.2) < 0.01 and error is not None and 0.3 <= error < 0.5
    assert got["last"].error is not None and got["last"].error < 0.01
