"""Coupling errors stated are true errors, or the figure is called not converged."""

from __future__ import annotations

import math
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cosim import Adaptive, Result, System, certify, limit, run
from cosim.accuracy.judge import row_spacing_error
from cosim.accuracy.nested import stored_column
from cosim.accuracy.trajectories import find_divergence
from cosim.metrics import (
    Largest,
    Last,
    Mean,
    Smallest,
    StrongestOrder,
    TimeOfLargest,
    TimeOfSmallest,
)
from cosim.result import Interrupted
from cosim.series import TIME, Column, Kind
from scenarios.iron import machine as iron
from tests.cosim.conftest import runs_of
from tests.cosim.test_cosim import pair, ripple
from tests.coupling_theory import Ideal
from tests.linear_systems import couple, drive


def test_jacobi_with_long_steps_is_called_not_converged(fmus) -> None:
    values = [ripple(fmus, "jacobi", steps, 48) for steps in (320, 160, 80)]
    assert not limit(values, 1).is_stated


def test_a_dip_close_behind_the_start_is_in_the_error(native: Path) -> None:
    """The cam falls back for 30 us before its motor pulls, a sixth of a step."""
    parts = {"motor": native / "DriveMotor.fmu", "iron": native / "IronDrive.fmu"}
    system = System(parts, iron.WIRES, iron.MOTOR)
    settings = {"step": 5e-5, "stop": 0.02, "record": ["iron.w_cam"]}
    exact = run(system, **settings | {"step": 1e-6, "stop": 1e-4})["iron.w_cam"].min()
    assert exact == pytest.approx(-3.248e-6, rel=1e-3)
    function = lambda r: r["iron.w_cam"].min()
    for metric, widest in ((Smallest("iron.w_cam"), -3 * exact), (function, -12 * exact)):
        estimate = certify(system, {"least": metric}, **settings).figures["least"]
        assert estimate.error is not None
        assert abs(estimate.value - exact) < estimate.error < widest


def certified_estimate(x: Any, metric: Any) -> Any:
    """What is certified of a figure of x(t, step) on 101 rows in a second, by order 1."""
    t = np.linspace(0.0, 1.0, 101)

    runner = runs_of(lambda step: [t, x(t, step)])
    return certify(System({}), {"x": metric}, step=0.0025, runner=runner).figures["x"]


@pytest.mark.parametrize("metric", [Smallest("x"), lambda r: float(r["x"].min())])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_dip_next_to_an_impact_is_in_the_error_though_it_is_over_before_the_next_row(
    direction: int, metric: Any
) -> None:
    """x is 1 until 0.5002 s, then 1 - 2 s + 250 s^2: the least, 0.996, is at s = 4 ms; or backwards."""

    def x(t: Any, _: float) -> Any:
        s = np.maximum((t if direction > 0 else 1.0 - t) - 0.5002, 0.0)
        return 1.0 - 2.0 * s + 250.0 * s**2

    estimate = certified_estimate(x, metric)
    assert estimate.error is not None and estimate.value - 0.996 < estimate.error < 0.03


def test_the_time_of_the_largest_value_is_that_of_all_peaks_as_high_and_of_a_plateau() -> None:
    """A share of 0.1 h is left by the coupling; the second peak is higher by a millionth, but lower in
    all runs, by what falls in no order.
    """

    def peaks(t: Any, h: float) -> Any:
        second = 1.0 + 1e-6 - 1e-4 * (100 * h) ** 0.4
        return np.where(t < 0.5, 1.0, second) * abs(np.sin(2 * math.pi * t)) * (1 - 0.1 * h)

    def plateau(t: Any, h: float) -> Any:
        return np.minimum(1.0 - abs(t - 0.5), 0.7) * (1 - 0.1 * h)

    def bell(t: Any, h: float) -> Any:
        return np.exp(-((t - 0.5) ** 2)) * (1 - 0.1 * h)

    metric = TimeOfLargest("x")
    assert certified_estimate(peaks, metric).error >= 0.5
    flat = certified_estimate(plateau, metric)
    assert flat.value == pytest.approx(0.2, abs=0.011) and flat.error >= 0.59
    assert certified_estimate(bell, metric).error < 0.02


def test_the_time_of_the_smallest_value_is_that_of_the_largest_of_the_opposite() -> None:
    def bell(t: Any, h: float) -> Any:
        return (1.0 + h) * np.exp(-(((t - 0.3 - h) / 0.05) ** 2))

    largest = certified_estimate(bell, TimeOfLargest("x"))
    smallest = certified_estimate(lambda t, h: -bell(t, h), TimeOfSmallest("x"))
    assert largest.error is not None and abs(largest.value - 0.3) < largest.error < 0.05
    assert smallest == largest


@pytest.mark.parametrize(
    "metric",
    [Mean("x"), Smallest("x"), *(lambda r, f=f: float(f(r["x"])) for f in (np.mean, np.max))],
)
def test_no_number_of_a_column_is_stated_whose_error_hardly_falls(metric: Any) -> None:
    """An error of 1 / log(1000 / h) falls by 5 % with each halving; noise of solvers is no such error."""
    slow = certified_estimate(lambda t, h: np.sin(7 * t) + (1 + t) / math.log(1e3 / h), metric)
    assert slow.error is None
    assert "not converged: the error of x falls with order 0.2" in str(slow)
    noisy = certified_estimate(lambda t, h: np.sin(7 * t) + 1e-7 * np.sin(1e9 * (t + h)), metric)
    assert noisy.error is not None


@pytest.mark.parametrize("rate", [33.6947, 16.25, 33.0 / 0.98])
def test_a_mean_over_rows_of_what_counts_is_as_exact_as_the_times_of_its_steps(rate: float) -> None:
    """Steps of a count that are nearly a whole number of rows apart are all found late by the same share of a row."""

    def rows(step: float) -> list[Any]:
        t = np.linspace(0.0, 1.0, round(1.0 / step) + 1)
        return [t, np.floor(rate * t + 1e-9)]

    runner = runs_of(rows, kind=Kind.INTEGER)
    whole = math.floor(rate)
    exact = whole - 0.5 * whole * (whole + 1) / rate
    mean = lambda r: float(r["x"].mean())
    estimate = certify(System({}), {"n": mean}, step=1 / 3200, runner=runner).figures["n"]
    assert estimate.error is not None
    assert abs(estimate.value - exact) < estimate.error < 2.0 * rate / 3200


@pytest.mark.parametrize("metric", [Largest("x"), lambda r: float(r["x"].max())])
def test_a_peak_that_is_over_before_the_runs_diverge_needs_to_stand_out(metric: Any) -> None:
    """The course of later rows is not known, and 1 in one run may be 1.2 in the truth, but not 5."""

    def x(t: Any, h: float, peak: float) -> Any:
        later = np.sin(60.0 * t + 2.0 * math.log2(h)) * (t > 0.4)
        return peak * np.exp(-(((t - 0.15) / 0.04) ** 2)) * (1.0 + h) + later

    assert certified_estimate(lambda t, h: x(t, h, 1.2), metric).reason.startswith(
        "not converged: the runs"
    )
    clear = certified_estimate(lambda t, h: x(t, h, 5.0), metric)
    assert clear.error is not None and abs(clear.value - 5.0) < clear.error < 0.6


@pytest.mark.parametrize(("J", "w"), [(4.93, 50.4), (0.77, 60.0), (2.89, 58.7)])
def test_an_output_that_follows_its_input_at_once_converges_with_order_1(
    J: float, w: float, native: Path
) -> None:
    """Also where the last step is shorter than the others, and by another share in each run."""
    system = pair(native, {"conveyor.w": w, "conveyor.rotor.J": J})
    settings = {"stop": 0.4, "record": ["conveyor.f_rod", "conveyor.w"]}
    exact = run(system, step=2e-6, output_step=1e-3, **settings)["conveyor.f_rod"][-1]
    ratios = []
    for step in np.geomspace(2.5e-4, 1e-3, 13).tolist():
        certified = certify(system, lambda r: {"f": r["conveyor.f_rod"][-1]}, step=step, **settings)
        figure = certified.figures["f"]
        if figure.error is not None:
            ratios.append(abs(figure.value - exact) / figure.error)
    assert len(ratios) > 6 and max(ratios) <= 1.0


def test_what_strang_shows_of_the_end_of_a_step_converges_with_order_2(native: Path) -> None:
    """On its way back the motor hears the speed of the end, and its power is not wider than need be."""
    system = pair(native, {"conveyor.w": 50.4, "motor.tau": 15.0})
    settings: dict[str, Any] = {"stop": 0.4, "record": ["motor.P", "conveyor.f_rod"]}
    exact = run(system, step=1e-5, output_step=1e-3, **settings)["motor.P"][-1]
    certified = certify(system, lambda r: {"P": r["motor.P"][-1]}, step=2.5e-4, **settings)
    assert certified.result.provenance["first_order"] == ["conveyor.f_rod"]
    assert certified.figures["P"].error is not None
    assert 0.2 < abs(certified.figures["P"].value - exact) / certified.figures["P"].error <= 1.0
    backwards = run(system, step=1e-3, order=["conveyor", "motor"], **settings)
    assert backwards.provenance["first_order"] == ["motor.P"]


def test_the_order_stated_knows_of_direct_feedthrough(fmus: Path) -> None:
    """Strang on the drive at its torsional resonance: outputs with feedthrough make it order 1."""
    units = drive(1.0)
    system = couple(units, fmus / "LinearSystem.fmu")
    figures: Any = lambda result: {"w": float(result["load.x[2]"][-1])}
    certified = certify(system, figures, stop=0.01, step=2.5e-5, record=["load.x[2]"])
    assert certified.result.provenance["convergence_order"] == 1
    estimate = certified.figures["w"]
    exact = Ideal(units).exact([0.01])[-1][3]
    assert estimate.error is not None
    assert abs(estimate.value - exact) <= 1.2 * estimate.error
    assert estimate.order == pytest.approx(1.0, abs=0.2)


def heun(rate: Any, x: list[float], h: float, stop: float) -> Any:
    """Rows of x' = rate(t, x) by Heun's method, of order 2, as (time, states)."""
    times = np.linspace(0.0, stop, round(stop / h) + 1)
    rows = [x]
    for t in times.tolist()[:-1]:
        a = rate(t, x)
        b = rate(t + h, [xi + h * ai for xi, ai in zip(x, a)])
        x = [xi + 0.5 * h * (ai + bi) for xi, ai, bi in zip(x, a, b)]
        rows.append(x)
    return np.column_stack([times, rows])


def lorenz(_: float, x: Any) -> list[float]:
    """The rates of the Lorenz equations."""
    return [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]]


def duffing(t: float, x: Any) -> list[float]:
    """The rates of a chaotic oscillator."""
    return [x[1], x[0] - 0.3 * x[1] - x[0] ** 3 + 0.5 * math.cos(1.2 * t)]


@pytest.mark.parametrize("stop", [12.0, 21.0, 27.0])
def test_figures_after_the_runs_have_diverged_are_refused(stop: float) -> None:
    """On the Lorenz attractor; what does not need the rows after that keeps its error."""

    def runner(_: System, *, step: float, **__: Any) -> Result:
        rows = heun(lorenz, [1.0, 1.0, 20.0], step, stop)
        columns = [TIME, *map(Column, ("x", "y", "z", "ramp"))]
        rows = np.column_stack([rows, rows[:, 0]])
        return Result(columns, {"convergence_order": 2}, rows.T.__getitem__)

    def figures(r: Result) -> dict[str, float]:
        final, early = r["time"] >= stop - 1.0, r["time"] <= 1.0
        estimates = {f"{k} late": float(np.max(r[k][final])) for k in "xyz"}
        return estimates | {"early": float(np.mean(r["x"][early])), "ramp": float(r["ramp"][-1])}

    estimates = certify(System({}), figures, step=0.00125, runner=runner).figures
    for name in ("x late", "y late", "z late"):
        assert estimates[name].error is None
        assert "not converged: the runs diverge from" in str(estimates[name])
    exact = solve_ivp(
        lorenz, (0.0, 1.0), [1.0, 1.0, 20.0], t_eval=np.linspace(0.0, 1.0, 201), rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    assert abs(estimates["early"].value - exact.y[0].mean()) <= estimates["early"].error
    assert estimates["ramp"].error is not None


def test_runs_that_differ_much_but_converge_have_not_diverged() -> None:
    """A phase that falls behind by an error of order 1, by a row or by a quarter of a turn."""
    t = np.linspace(0.0, 10.0, 401)

    def runs(x: Any, kind: Kind = Kind.CONTINUOUS) -> list[Result]:
        rows = [np.column_stack([t, x(h)]) for h in (0.025, 0.05, 0.1)]
        return [Result([TIME, Column("x", kind=kind)], {}, r.T.__getitem__) for r in rows]

    for delay in (0.02, 0.2, 1.0):
        late = runs(lambda h, delay=delay: np.sin(2 * (1 - delay * h) * t))
        assert not find_divergence(late).columns
    # a radian at the end of the coarser runs: as chaotic ones part, and as those of two periods do
    growing = runs(lambda h: np.sin(12 * t + 150 * h**2 * np.exp(0.8 * (t - 10))))
    assert 8.0 < find_divergence(growing).begin < 10.0
    assert not find_divergence(runs(lambda h: np.sin(12 * t + 15 * h**2 * t))).columns
    # a level that depends on the step, beside which the column hardly moves
    assert not find_divergence(runs(lambda h: 5 + h + 1e-6 * (1 + h) * np.sin(3 * t))).columns
    assert not find_divergence(runs(lambda h: (t > 5 + 4 * h) * 1.0, Kind.DISCRETE)).columns


def test_a_number_made_after_the_coarser_runs_part_exponentially_holds_or_is_refused() -> None:
    """A chaotic Duffing oscillator, whose finest two runs may still be together by accident when the coarser two are apart."""

    def runner(_: System, *, step: float, stop: float, **__: Any) -> Result:
        rows = heun(duffing, [start, 0.0], step, stop).T
        return Result([TIME, Column("x")], {"convergence_order": 2}, rows[:2].__getitem__)

    worst, stated = 0.0, 0
    for start in (0.2, 0.4, 0.6, 0.8, 1.0):
        exact = solve_ivp(
            duffing, (0.0, 100.0), [start, 0.0], method="DOP853", rtol=1e-12, atol=1e-12, dense_output=True,
        ).sol  # fmt: skip
        x = exact(np.linspace(0.0, 100.0, 20001))[0]
        truth = {"end": x[-1], "mean": np.trapezoid(x) / 20000, "largest": x.max()}
        metrics = {"end": Last("x"), "mean": Mean("x"), "largest": Largest("x")}
        figures = certify(System({}), metrics, step=0.00625, stop=100.0, runner=runner).figures
        for name, figure in figures.items():
            if figure.error is not None:
                stated += 1
                worst = max(worst, abs(figure.value - truth[name]) / figure.error)
    assert stated >= 2
    assert worst <= 1.0


@pytest.mark.parametrize("step", [1e-3, Adaptive(1e-4)])
def test_all_rows_are_those_of_each_step(step: Any, native: Path, tmp_path: Path) -> None:
    """Also where the result keeps others, and the last step is shorter."""
    settings: dict[str, Any] = {"stop": 0.0502, "step": step, "record": ["motor.tau"]}
    run(pair(native), output_step=7e-3, all_rows=tmp_path / "rows", **settings)
    stored = np.column_stack([stored_column(tmp_path / "rows", 2, k) for k in range(2)])
    np.testing.assert_array_equal(stored, run(pair(native), **settings).data)


@pytest.mark.parametrize(
    "figure",
    [Mean("motor.tau"), lambda r: float(np.mean(r["motor.tau"]))],
    ids=["metric", "function"],
)
def test_all_rows_stay_in_their_file(figure: Any, native: Path) -> None:
    """A figure of one column takes less memory than twice what all rows of the finest run would."""
    stop, step = 1.0, 1e-5
    tracemalloc.start()
    try:
        got = certify(pair(native), {"mean": figure}, stop=stop, step=step, output_step=0.01)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    numbers = stop / step * len(got.result.columns)
    assert peak < 2 * numbers * np.dtype(float).itemsize


def test_what_a_tenth_of_the_tolerance_changes_is_in_the_error_and_what_ignores_it_is_named(
    native: Path,
) -> None:
    """A solver inside the FMU that is off by its tolerance, the same in all runs with it."""
    system = System({"motor": native / "DriveMotor.fmu"})
    settings: dict[str, Any] = {"stop": 0.1, "step": 1e-3, "tolerance": 1e-3}

    def inexact(system: System, *, tolerance: float, **more: Any) -> Result:
        result = run(system, tolerance=tolerance, **more)
        return result.with_columns_from(lambda k: result.load(k) + (k > 0) * tolerance)

    figures = {"end": Last("motor.tau"), "own": lambda r: float(r["motor.tau"][-1])}
    plain, solver = (certify(system, figures, runner=r, **settings) for r in (run, inexact))
    assert "those of the solvers inside the FMUs" in str(plain)
    assert "a tenth of their tolerance" in str(solver)
    for name, figure in solver.figures.items():
        before = plain.figures[name]
        assert figure.error is not None and before.error is not None
        assert figure.error - before.error == pytest.approx(1e-3, rel=1e-6)


def test_a_number_that_the_sharper_run_does_not_have_or_counts_differently_is_refused_alone(
    native: Path,
) -> None:
    """With a tenth of the tolerance the column turns three times as fast, and functions fail."""
    system = System({"motor": native / "DriveMotor.fmu"})
    names = ["motor.tau", "motor.P"]

    def runner(system: System, *, tolerance: float, **more: Any) -> Result:
        result = run(system, tolerance=tolerance, record=names, **more)
        t, order = result["time"], 1 if tolerance == 1e-3 else 3
        return result.with_columns_from([t, np.sin(2 * math.pi * order * t), t * 7.0].__getitem__)

    def raising(r: Result) -> float:
        if r.provenance["tolerance"] < 1e-3:
            raise ValueError("no peak")
        return float(r["motor.P"][-1])

    figures: Any = {
        "order": StrongestOrder("motor.tau", over="motor.P"), "end": Last("motor.P"),
        "raising": raising,
        "lost": lambda r: {"a": float(r["motor.P"][-1])} if r.provenance["tolerance"] == 1e-3 else {},
    }  # fmt: skip
    settings: dict[str, Any] = {"stop": 1.0, "step": 1e-3, "tolerance": 1e-3}
    got = certify(system, figures, runner=runner, **settings)
    reasons = {name: x.reason for name, x in got.figures.items() if x.error is None}
    assert set(reasons) == {"order", "raising", "a"}
    assert "count" in reasons["order"] and "no peak" in reasons["raising"]
    assert "tolerance" in reasons["a"]


@pytest.mark.parametrize("which", [1, 3])
def test_a_run_for_comparison_that_is_interrupted_leaves_the_rows_of_the_finest(
    native: Path, which: int
) -> None:
    system = System({"motor": native / "DriveMotor.fmu"})
    done: list[Result] = []
    shares: list[float] = []

    def runner(system: System, **more: Any) -> Result:
        done.append(run(system, **more))
        if len(done) > which:
            raise Interrupted("stopped", done[-1])
        return done[-1]

    with pytest.raises(Interrupted) as interrupt:
        certify(system, {"end": Last("motor.tau")}, runner=runner, progress=shares.append,
                stop=0.1, step=1e-3, tolerance=1e-3)  # fmt: skip
    assert interrupt.value.result is done[0]
    assert shares == sorted(shares) and (max(shares) == 1.0) == (which == 3)


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_the_error_of_rows_is_that_of_a_power_of_their_distance(order: float) -> None:
    """Also where every second row changes nothing by chance, as between two extremes that lie alike."""
    second, third = 2.0**order - 1.0, 3.0**order - 1.0
    found = float(row_spacing_error(np.array([second]), np.array([third]))[0])
    assert (
        1.0 <= found < 1.15
    )  # never below the error; between the orders the ratio is nearly linear
    assert row_spacing_error(np.zeros(1), np.array([third]))[0] >= third / 8.0
