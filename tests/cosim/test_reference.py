"""The oracle agrees with closed solutions and independent integrations, and judges runs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import certify as benchmark
from cosim import (
    Result,
    Series,
    SetupError,
    SimulationError,
    System,
    linearize,
    mean,
    oracle,
    run,
    true_errors,
)
from cosim.accuracy.reference import _distances
from cosim.fmu.exchange import ModelExchange
from cosim.series import TIME, Column
from scenarios.packing_line.questions import packing_line
from tests.cosim.conftest import CommandOutput
from tests.cosim.test_linearize import conveyor, looped, two_masses
from tests.oracle import monolithic

J_1, J_2, SOFT = 1.1, 2.2, 1e4
LOOSE = {"shaft__c": SOFT, "shaft__twist": 0.01, "one__w_a": 0.0, "two__w_a": 0.0}


def unloaded(system: System) -> System:
    """The two masses without torques from outside."""
    return replace(system, start={**system.start, "one.tau_a": 0.0, "two.tau_b": 0.0})


def test_the_conveyor_is_integrated_as_from_its_equations(native: Path) -> None:
    got = oracle(conveyor(native), stop=0.1)
    start = {"conveyor.phi": 0.0, "conveyor.w": 40.0, "motor.tau": 8.0}
    exact = monolithic(start, 0.1, got["time"], rtol=1e-13)
    for name, values in zip(start, exact.y):
        error = np.abs(got[name] - values).max()
        assert error <= 1e-10 * np.abs(values).max(), name
        assert error <= 1.5 * got.provenance["errors"][name] + 1e-11 * np.abs(values).max()
    assert got.provenance["events"] == []
    assert (got.units["motor.tau"], got.names[0], len(got.data)) == ("N.m", "time", 1001)


@pytest.mark.parametrize("method", ["DOP853", "Radau", "LSODA"])
def test_two_masses_swing_as_the_cosine(native: Path, method: str) -> None:
    system = unloaded(two_masses(native, **LOOSE))
    tight = method == "DOP853"
    got = oracle(system, stop=0.05, method=method, tolerance=1e-12 if tight else 1e-8)
    w = math.sqrt(SOFT * (1 / J_1 + 1 / J_2))
    error = np.abs(got["shaft.twist"] - 0.01 * np.cos(w * got["time"])).max()
    assert error <= (1e-12 if tight else 1e-7)


def test_a_coupled_drive_that_sticks_and_falls_back_is_inside_its_interval(native: Path) -> None:
    """The motor breaks the iron away, cannot lift it over the top, and is turned back."""
    parts = {"motor": native / "DriveMotor.fmu", "iron": native / "IronDrive.fmu"}
    start = {"motor.A": 0.12, "motor.B": 6e-4, "motor.T": 0.01, "motor.tau": 0.0, "iron.phi": 0.3}
    wires = ["motor.tau -> iron.tau", "iron.w -> motor.w"]

    def figures(r: Any) -> dict[str, float]:
        return {"last": float(r["iron.w"][-1]), "mean": mean(r["time"], r["iron.w"])}

    record = ["iron.w", "iron.direction"]
    estimates = true_errors(
        System(parts, wires, start), figures, stop=0.8, step=1e-3, record=record
    )
    assert set(estimates.result["iron.direction"]) == {-1.0, 1.0}
    assert len(estimates.result.provenance["events"]) == 2
    for name, figure in estimates.figures.items():
        assert figure.certified.error is not None, name
        assert 1e-9 < figure.error <= figure.certified.error, name


@pytest.mark.parametrize("only", ["orientator", pytest.param("", marks=pytest.mark.slow)])
def test_stated_errors_of_the_machines_hold_in_95_of_100_figures(native: Path, only: str) -> None:
    """Three algorithms, ends, extremes, means, crossings and events, against the oracle."""
    machines = benchmark.machines(benchmark.uniform_sampler(0), native)
    figures = [
        figure
        for name, machine in machines.items()
        if only in name
        for figure in benchmark.judged(name, benchmark.integrated(*machine), halvings=1)
    ]
    ratios = np.array([r for x in figures if (r := x.stated.error_ratio()) is not None])
    assert len(ratios) > 0.8 * len(figures) > 30
    assert any(x.figure == "event" for x in figures)
    assert np.mean(ratios <= 1.0) >= 0.95


IRON = {"phi": 0.3, "w_cam": 3.0, "friction.K_up": 0.6, "friction.K_down": -0.9, "on_invalid": 1}
HYBRID: list[tuple[str, dict[str, Any], float, str]] = [
    ("IronDrive", IRON | {"tau": 0.03}, 0.3, "direction"),
    ("GravityOrientator", {"chute.mu": 0.5, "w": 60 * math.pi / 30}, 0.6, "stage"),
]


@pytest.mark.parametrize("case", HYBRID, ids=lambda case: case[0])
def test_events_are_those_of_co_simulation(native: Path, case: Any) -> None:
    """Stick and lift-off, to 1e-9 s: the FMU in co-simulation changes between just before and after."""
    name, start, stop, discrete = case
    system = System({"m": native / f"{name}.fmu"}, start={f"m.{k}": v for k, v in start.items()})
    got = oracle(system, stop=stop, output_step=stop / 10)
    t, column = got["time"], got[f"m.{discrete}"]
    changed = [k for k in range(1, len(t)) if column[k] != column[k - 1]]
    assert changed
    for k in changed:
        assert t[k] in got.provenance["events"]
        for aside, row in ((-1e-9, k - 1), (1e-9, k)):
            end = float(t[k]) + aside
            result = run(system, stop=end, step=end, record=[f"m.{discrete}"])
            assert result[f"m.{discrete}"][-1] == column[row], (t[k], aside)
    fine = run(system, stop=stop, step=stop / 100)
    for output in fine.names[1:]:
        scale = max(np.abs(fine[output]).max(), 1e-3)
        assert abs(got[output][-1] - fine[output][-1]) <= 1e-7 * scale, output


def test_a_boolean_wire_acts_when_its_source_changes(native: Path) -> None:
    """The iron at its top dwell releases a product: at a cam angle of 100 degrees, at once."""
    fmus = {name: native / f"{fmu}.fmu" for name, fmu in packing_line.PackingLine.parts.items()}
    line = packing_line.PackingLine.parse({}).system(fmus)
    record = ["iron.phi", "iron.top_dwell", "orientator.since", "orientator.stage"]
    got = oracle(line, stop=0.7, output_step=0.1, record=record)
    released = int(np.argmax(got["iron.top_dwell"]))
    t = float(got["time"][released])
    assert got.provenance["events"] == [t]
    assert got["iron.phi"][released] == pytest.approx(math.radians(100.0), abs=1e-10)
    assert got["orientator.since"][-1] == pytest.approx(t, abs=1e-12)
    assert list(got["orientator.stage"][[released - 1, -1]]) == [6.0, 0.0]


def test_inputs_over_time_act_at_each_instant(native: Path) -> None:
    """J w' = tau along a function, lines and a jump, and from a change of a time on."""
    start = {"g.J": 2.0, "g.eta": 1.0, "g.i": 1.0, "g.w_a": 0.0, "g.tau_b": 0.0}
    gearbox = System({"g": native / "Gearbox.fmu"}, start=start)
    wave = oracle(replace(gearbox, inputs={"g.tau_a": lambda t: math.sin(9 * t)}), stop=1.0)
    assert wave["g.w_a"] == pytest.approx((1 - np.cos(9 * wave["time"])) / 18, abs=1e-11)
    lines = Series.of({"t": [0.0, 0.25, 0.5, 0.5, 1.0], "u": [0.0, 4.0, 4.0, -8.0, -8.0]})
    ramp = oracle(replace(gearbox, inputs={"g.tau_a": lines}), stop=1.0)
    t = ramp["time"]
    exact = np.where(
        t < 0.25, 4 * t**2, np.where(t < 0.5, 0.25 + 2 * (t - 0.25), 0.75 - 4 * (t - 0.5))
    )
    assert ramp["g.w_a"] == pytest.approx(exact, abs=1e-11)
    later = replace(gearbox, start={**start, "g.tau_a": 0.0}, changes=["at 0.333 s g.tau_a = 6"])
    changed = oracle(later, stop=1.0)
    exact = 3 * np.maximum(changed["time"] - 0.333, 0.0)
    assert changed["g.w_a"] == pytest.approx(exact, abs=1e-11)


@pytest.mark.parametrize("factor", [0.1, 0.5])
def test_an_algebraic_loop_is_solved_at_each_instant(native: Path, factor: float) -> None:
    """With loop gains of 0.25 and 6.25: the second grows if it is only followed round."""
    system = looped(native, factor)
    start = {"one.w_b": 0.0, "two.w_b": 0.0, "one.twist": 0.2, "two.twist": -0.1}
    system = replace(system, start={**system.start, **start})
    got = oracle(system, stop=1.0, output_step=0.1, tolerance=1e-10)
    once, c = 5.0 * factor, 7.0
    inner = factor * c / (1 - once**2) * np.array([[once, -1.0], [-1.0, once]])
    rates, shapes = np.linalg.eigh(inner)
    for t, first, second in zip(got["time"], got["one.twist"], got["two.twist"]):
        exact = shapes @ (np.exp(rates * t) * (shapes.T @ [0.2, -0.1]))
        assert [first, second] == pytest.approx(exact, abs=1e-8)


def test_a_linear_system_is_that_where_the_run_is(native: Path) -> None:
    system = conveyor(native)
    reference = oracle(system, stop=0.05, output_step=0.05)
    linear = linearize(system, at=0.05)
    states = {name: float(reference[name][-1]) for name in linear.states}
    assert {name: linear.point[name] for name in states} == pytest.approx(states, rel=1e-12)
    linear_at_start = linearize(replace(system, start={**system.start, **states}))
    assert pytest.approx(linear_at_start.A, rel=1e-9, abs=1e-9) == linear.A
    assert linear.time == 0.05


def test_what_has_no_oracle_is_refused(native: Path, fmus: Path) -> None:
    system = conveyor(native)
    mixed = replace(system, parts={**system.parts, "motor": fmus / "DriveMotor.fmu"})
    with pytest.raises(SetupError, match=r"motor: .*DriveMotor\.fmu offers no model exchange"):
        oracle(mixed, stop=0.1)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"method": "Euler"}, "method 'Euler' must be one of DOP853, Radau, LSODA"),
        ({"tolerance": 0.0}, "tolerance = 0.0 must be at least 1e-13"),
        ({"stop": -1.0}, "stop = -1.0 s must be after start"),
        ({"output_step": 0.0}, "output_step = 0.0 s must be above 0"),
    ]
    for settings, reason in wrong:
        with pytest.raises(SetupError, match=reason):
            oracle(system, **{"stop": 0.1} | settings)
    with pytest.raises(SetupError, match=r"at = -1\.0 s must be a finite number"):
        linearize(system, at=-1.0)


def test_the_shell_states_true_errors(
    native: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    file, out = str(native / "IronDrive.fmu"), tmp_path / "exact.csv"
    options = ["--stop", "0.1", "--step", "0.01", "--record", "IronDrive.w", "--out", str(out)]
    text = command_output("oracle", file, *options)
    assert "IronDrive.w, largest" in text and "+-" in text
    assert out.with_suffix(".json").exists() and len(out.read_text().splitlines()) == 12


@pytest.mark.parametrize("method", ["DOP853", "Radau", "LSODA"])
def test_a_nominal_value_of_0_is_taken_as_1(
    method: str, native: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = System({"motor": native / "DriveMotor.fmu"}, start={"motor.w": 10.0})
    usual = oracle(drive, stop=0.1, method=method)
    array = ModelExchange.array

    def zero(model: ModelExchange, function: str, cells: Any) -> None:
        array(model, function, cells)
        if function == "GetNominalsOfContinuousStates":
            cells[:] = [0.0] * len(cells)

    monkeypatch.setattr(ModelExchange, "array", zero)
    reference = oracle(drive, stop=0.1, method=method, timeout=600.0)
    assert reference.data == pytest.approx(usual.data, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("events", "error"),
    [
        ((2.0, 2.0000001), 0.0),  # the row at 2 s is before the event in one of them only
        ((2.0, 4.5), 5.0),  # another event
        (([1.0, 2.0, 8.0], [1.0, 8.0]), 5.0),  # which of them are the same is not known
    ],
)
def test_only_a_row_at_an_event_does_not_count_in_the_error_of_the_oracle(
    events: Any, error: float
) -> None:
    t = np.arange(11.0)

    def result(x: Any, times: Any) -> Result:
        return Result([TIME, Column("x")], {"events": np.atleast_1d(times)}, [t, x].__getitem__)

    tight, loose = events
    end = 3.0 if error == 0.0 else 5.0
    moved = result(5.0 * ((t >= 2.0) & (t < end)), tight)
    still = result(5.0 * ((t > 2.0) & (t < end)) if error == 0.0 else 0.0 * t, loose)
    assert _distances(moved, still)[1] == error


def test_an_oracle_that_takes_too_long_ends(native: Path) -> None:
    drive = System({"motor": native / "DriveMotor.fmu"})
    with pytest.raises(
        SimulationError, match="not finished within the timeout: the integrator is at t = "
    ):
        oracle(drive, stop=1.0, timeout=1e-9)
    with pytest.raises(SetupError, match=r"timeout = 0\.0 s must be above 0"):
        oracle(drive, stop=1.0, timeout=0.0)
