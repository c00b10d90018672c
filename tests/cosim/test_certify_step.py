"""What certify runs: the step of the run that one gets, longer ones beside it, and shorter ones for a wanted error."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Adaptive, Estimate, Result, Series, SimulationError, System, certify, run
from cosim.engine.sources import largest_change_within_steps
from cosim.metrics import Largest, Last, Mean
from cosim.series import TIME, Column
from cosim.system.inputs import FunctionInput, TableInput
from tests.cosim.test_cosim import pair

#: A motor without a load, whose speed is its input.
LAG = 1e-4


class Steps:
    """A runner of x(t, step) that notes its steps, and fails from a step on."""

    def __init__(self, x: Any, fails_from: float = math.inf, order: int = 1) -> None:
        self.x, self.fails_from, self.order = x, fails_from, order
        self.taken: list[Any] = []

    def __call__(self, _: System, *, step: Any, **settings: Any) -> Result:
        size = step.tolerance if isinstance(step, Adaptive) else step
        self.taken.append(size)
        t = np.linspace(0.0, 1.0, 101 if isinstance(step, Adaptive) else round(1.0 / size) + 1)
        rows = np.column_stack([t, self.x(t, size)])
        report = {"convergence_order": self.order, "status": "complete", "warnings": []}
        result = Result([TIME, Column("x", "N")], report, rows.T.__getitem__)
        if size >= self.fails_from:
            raise SimulationError(f"it lifts off with {size:g}", result)
        return result


def slope(t: Any, h: float) -> Any:
    """A line with an error of the first order."""
    return 2.0 * t * (1.0 + h)


def test_the_step_is_that_of_the_run_and_the_others_are_longer(native: Path) -> None:
    runner = Steps(slope)
    certified = certify(System({}), {"end": Last("x")}, step=0.01, runner=runner)
    assert runner.taken == [0.01, 0.02, 0.04]
    assert certified.step == 0.01 and len(certified.result.data) == 101
    assert certified.figures["end"].error == pytest.approx(1.25 * 0.02)
    assert str(certified).startswith("end  2.020 +- 0.025 N\n")
    system, settings = pair(native), {"stop": 0.05, "step": 1e-3}
    got = certify(system, {"end": Last("motor.tau")}, **settings)
    assert np.array_equal(got.result.data, run(system, **settings).data)


def test_of_adaptive_steps_the_tolerance_is_that_of_the_run() -> None:
    runner = Steps(lambda t, tolerance: 2.0 * t * (1.0 + tolerance))
    certified = certify(System({}), {"end": Last("x")}, step=Adaptive(1e-4), runner=runner)
    assert runner.taken == pytest.approx([1e-4, 1e-3, 1e-2])
    figure = certified.figures["end"]
    assert figure.error is not None and 2e-4 < figure.error < 4e-4


@pytest.mark.parametrize(("fails_from", "factor"), [(0.04, 3.0), (0.02, None)])
def test_the_run_stands_where_longer_steps_fail(fails_from: float, factor: float | None) -> None:
    """Two runs have the factor of safety of two grids; one has no error, and says why."""
    runner = Steps(slope, fails_from)
    figure = certify(System({}), {"end": Last("x")}, step=0.01, runner=runner).figures["end"]
    assert figure.value == 2.02
    if factor is not None:
        assert figure.error == pytest.approx(factor * 0.02)
    else:
        assert figure.error is None and "a step of 0.02 s fails" in figure.reason
        assert "it lifts off with 0.02" in figure.reason
    with pytest.raises(SimulationError, match="it lifts off"):
        certify(System({}), {"end": Last("x")}, step=0.01, runner=Steps(slope, 0.01))


def test_a_run_of_two_steps_has_the_factor_of_two_grids(native: Path) -> None:
    for stop, stated in ((0.004, True), (0.002, True), (0.001, False)):
        figure = certify(pair(native), {"f": Last("motor.tau")}, stop=stop, step=1e-3).figures["f"]
        assert (figure.error is not None) == stated, stop
    assert "shorter than a step of 0.002 s" in figure.reason


def test_steps_are_halved_until_figures_have_the_error_and_two_runs_are_used_again() -> None:
    runner = Steps(slope)
    metrics = {"end": Last("x"), "mean": Mean("x")}
    certified = certify(System({}), metrics, step=0.01, error=4e-3, runner=runner)
    assert runner.taken == [0.01, 0.02, 0.04, 0.005, 0.0025]
    assert certified.step == 0.0025 and not certified.unmet
    assert all(x.error <= 4e-3 * x.value for x in certified.figures.values() if x.error)
    absolute = certify(System({}), metrics, step=0.01, error={"mean": 6e-3}, runner=Steps(slope))
    assert absolute.step == 0.0025


def test_what_no_step_gives_is_said() -> None:
    """Noise does not fall; halving ends, and the figure that has its error keeps it."""
    noise = Steps(lambda t, h: 2.0 * t + 1e-3 * np.sin(1e9 * (t + h)) * (t > 0.0))
    certified = certify(System({}), {"end": Last("x")}, step=0.01, error=1e-6, runner=noise)
    assert 3 < len(noise.taken) < 9
    assert set(certified.unmet) == {"end"}
    assert "error" in certified.unmet["end"] and certified.unmet["end"] in str(certified)


def motor(native: Path, w: Any) -> System:
    return System({"motor": native / "DriveMotor.fmu"}, [], {"motor.T": LAG}, inputs={"motor.w": w})


def vibration(frequency: float, kind: str) -> Any:
    """A speed of 40 rad/s with 5 rad/s of a vibration, as a function or as a table of sixteen rows in a period."""

    def w(t: float) -> float:
        return 40.0 + 5.0 * math.sin(2.0 * math.pi * frequency * t)

    times = np.arange(0.0, 0.1005, 1.0 / (16.0 * frequency))
    return w if kind == "function" else Series.of({"t": times, "w": [w(t) for t in times]})


@pytest.mark.parametrize("kind", ["function", "table"])
@pytest.mark.parametrize("frequency", [1000.0, 3999.0, 4000.0])
def test_an_input_whose_period_divides_the_step_gives_no_figure(
    frequency: float, kind: str, native: Path
) -> None:
    """All three runs see its mean: 8.0 N.m with an error of 1e-9, truth -827 to 843."""
    system = motor(native, vibration(frequency, kind))
    certified = certify(system, {"f": Largest("motor.tau")}, stop=0.1, step=1e-3)
    figure = certified.figures["f"]
    assert figure.error is None
    assert figure.reason.startswith("the input changes within the finest step: motor.w")
    fine = certify(system, {"f": Largest("motor.tau")}, stop=0.01, step=1.0 / (64.0 * frequency))
    assert fine.figures["f"].error is not None


def test_a_pulse_within_a_step_gives_no_figure(native: Path) -> None:
    times = [0, 0.0101, 0.0101, 0.010101, 0.010101, 1]
    pulse = Series.of({"t": times, "w": [40.0, 40.0, 80.0, 80.0, 40.0, 40.0]})
    system = motor(native, pulse)
    own: Any = lambda r: float(r["motor.tau"].min())
    for metric in (Largest("motor.tau"), own):
        figure = certify(system, {"f": metric}, stop=0.05, step=1e-3).figures["f"]
        assert figure.error is None and "changes within the finest step" in figure.reason


def test_inputs_that_steps_resolve_are_no_reason_against_a_figure(native: Path) -> None:
    for w in (
        vibration(50.0, "function"),
        vibration(50.0, "table"),
        Series.of({"t": [0.0, 0.1], "w": [40.0, 45.0]}),
        Series.of({"t": [0.0, 0.0503, 0.0503, 0.1], "w": [40.0, 40.0, 41.0, 41.0]}),
        Series.of({"t": [0.0, 0.05, 0.1], "w": [40.0, 41.0, 41.0]}).held(),
        lambda t: 40.0,
    ):
        figure = certify(motor(native, w), {"f": Mean("motor.tau")}, stop=0.1, step=5e-4).figures[
            "f"
        ]
        assert isinstance(figure, Estimate) and "within" not in figure.reason


def test_a_pulse_as_short_as_a_step_is_seen_wherever_it_is_in_its_step_and_no_jump_is() -> None:
    """Runs with h, 2 h and 4 h can be off by the same shift of a pulse, so that their differences vanish."""
    random, times = np.random.default_rng(7), np.linspace(0.0, 1.0, 101)
    knots = lambda begin, end: [0.0, begin, begin, end, end, 1.0]
    for begin, width, step in random.uniform([0.0, 1e-4, 0.1], [0.9, 1e-2, 3.0], (200, 3)).tolist():
        pulse = TableInput(knots(begin, begin + width), [step, step, 3.0, 3.0, step, step])
        if step < 2.9:
            assert largest_change_within_steps(pulse, times)[0] == pytest.approx(3.0 - step)
        exact = np.array([begin, begin + width])
        assert largest_change_within_steps(pulse, np.union1d(times, exact), exact)[0] == 0.0
        jumps = TableInput(knots(begin, 0.5 * (begin + 1.0)), [0.0, 0.0, step, step, 4.0, 4.0])
        for resolved in (jumps, TableInput([0.0, begin + 0.01, 1.0], [0.0, 0.0, step])):
            assert largest_change_within_steps(resolved, times)[0] == 0.0


def test_noise_with_a_row_in_each_step_is_seen_by_the_steps() -> None:
    times = np.linspace(0.0, 1.0, 1001)
    for seed in range(20):
        values = np.random.default_rng(seed).normal(size=1001)
        assert (
            largest_change_within_steps(TableInput(times.tolist(), values.tolist()), times)[0]
            == 0.0
        )
    sharp = FunctionInput(lambda t: 1.0 + math.sin(2e4 * math.pi * t))
    most, _ = largest_change_within_steps(sharp, times)
    assert most == pytest.approx(2.0, abs=0.1)
