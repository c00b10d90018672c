"""What certify runs: the step of the run that one gets, longer ones beside it, and shorter ones for a wanted error."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import (
    Adaptive,
    Estimate,
    Result,
    Series,
    SetupError,
    SimulationError,
    System,
    certify,
    run,
    sweep,
)
from cosim.metrics import Largest, Last, Mean, Smallest
from cosim.series import TIME, Column
from tests.cosim import foreign
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
    got = certify(system, {"end": Last("motor.tau")}, **settings).result
    sizes = np.diff(got["time"])
    assert sizes[0] == pytest.approx(1e-3 / 1024, rel=0.2) and sizes[-1] == pytest.approx(
        1e-3, rel=0.05
    )
    assert got["motor.tau"][-1] == pytest.approx(run(system, **settings)["motor.tau"][-1], rel=1e-3)


def test_of_adaptive_steps_the_tolerance_is_that_of_the_run(native: Path) -> None:
    """The others go along its steps; the rows are its own."""
    settings: dict[str, Any] = {"stop": 0.2, "step": Adaptive(1e-3)}
    taken = []

    def runner(system: System, *, step: Any, **more: Any) -> Result:
        taken.append(step)
        return run(system, step=step, **more)

    certified = certify(pair(native), {"end": Last("motor.tau")}, runner=runner, **settings)
    assert np.array_equal(certified.result.data, run(pair(native), **settings).data)
    assert [step.ratio for step in taken[1:]] == pytest.approx([1.0, 2.0, 0.309017])
    exact = run(pair(native), stop=0.2, step=2e-5)["motor.tau"][-1]
    figure = certified.figures["end"]
    assert figure.error is not None and abs(figure.value - exact) < figure.error < 0.01 * abs(exact)


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
def test_an_input_whose_period_divides_the_step_has_an_error_that_holds_or_none(
    frequency: float, kind: str, native: Path
) -> None:
    """Runs whose steps are multiples of a period see its mean: 8.0 N.m with an error of 1e-9, truth -827 to 843."""
    system = motor(native, vibration(frequency, kind))
    fine = certify(system, {"f": Largest("motor.tau")}, stop=0.01, step=1.0 / (64.0 * frequency))
    true = fine.figures["f"]
    assert true.error is not None
    figure = certify(system, {"f": Largest("motor.tau")}, stop=0.1, step=1e-3).figures["f"]
    assert figure.error is None or abs(figure.value - true.value) < figure.error + true.error


def test_a_pulse_within_a_step_has_an_error_that_holds(native: Path) -> None:
    """The runs meet its begin and its end, 1 us apart: the motor lags by 0.1 ms."""
    times = [0, 0.0101, 0.0101, 0.010101, 0.010101, 1]
    pulse = Series.of({"t": times, "w": [40.0, 40.0, 80.0, 80.0, 40.0, 40.0]})
    system = motor(native, pulse)
    own: Any = lambda r: float(r["motor.tau"].min())
    exact = run(system, stop=0.0102, step=1e-7)["motor.tau"].min()
    for metric in (Smallest("motor.tau"), own):
        figure = certify(system, {"f": metric}, stop=0.05, step=1e-3).figures["f"]
        assert figure.error is not None and abs(figure.value - exact) <= figure.error
        assert figure.value == pytest.approx(exact, rel=1e-2)


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


def test_names_with_dots_do_not_make_parts_one(native: Path) -> None:
    """A fast input of `line.one` is nothing to `line.two`, which no wire leads to."""

    def error(first: str, second: str) -> float | None:
        motors = dict.fromkeys((first, second), native / "DriveMotor.fmu")
        inputs = {f"{first}.w": vibration(1000.0, "function")}
        system = System(motors, [], {f"{second}.w": 40.0}, inputs=inputs)
        figures = {"last": Last(f"{second}.tau")}
        return certify(system, figures, stop=0.1, step=1e-3).figures["last"].error

    assert error("line.one", "line.two") == error("one", "two") is not None


def test_a_comparison_run_that_explodes_is_named_and_the_others_give_the_figures() -> None:
    """x' = -x by a method that is unstable from a step of 0.03 s on; with 0.01 and 0.02 s it is off by h."""

    def x(t: Any, h: float) -> Any:
        return np.exp(-t) * (1.0 + h) + (h > 0.03) * np.exp(90.0 * t)

    figure = certify(System({}), {"x": Last("x")}, step=0.01, runner=Steps(x)).figures["x"]
    assert figure.error == pytest.approx(3.0 * 0.01 * math.exp(-1.0))
    figure = certify(System({}), {"x": Last("x")}, step=0.02, runner=Steps(x)).figures["x"]
    assert figure.error is None
    assert (
        figure.reason
        == "the comparison run with 2 times the step is unstable: take a step of 0.005 s or less"
    )


@pytest.mark.parametrize("stretch", [(0.05, 0.15), (-0.05, 0.05), (0.05, 0.100001)])
def test_a_stretch_that_reaches_beyond_the_run_is_refused(
    stretch: tuple[float, float], native: Path
) -> None:
    metric = Largest("motor.tau", begin=stretch[0], end=stretch[1])
    system = System({"motor": native / "DriveMotor.fmu"})
    with pytest.raises(SetupError, match=r"its stretch must lie in the run, from 0 to 0\.1 s"):
        certify(system, {"f": metric}, stop=0.1, step=1e-3)
    with pytest.raises(SetupError, match="its stretch must lie in the run"):
        sweep(system, {"motor.A": [7000.0]}, {"f": metric}, stop=0.1, step=1e-3)


def test_runs_with_other_steps_that_a_part_cannot_take_are_named_as_such(tmp_path: Path) -> None:
    """Its own step fits; the refusal of one twice as long spoke of that alone."""
    steady = "canHandleVariableCommunicationStepSize"
    system = foreign.single_fmu_system(foreign.pack(tmp_path / "A.fmu", **{steady: False}))
    with pytest.raises(SetupError, match=r"errors come from runs with other steps.* 0.2 s"):
        certify(system, stop=0.3, step=0.1)
    with pytest.raises(SetupError, match=r"^stop = 0.35 s must be a whole number of steps"):
        certify(system, stop=0.35, step=0.1)
