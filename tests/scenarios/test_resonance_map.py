"""The resonance map: ridges, gain, probabilities and their check, files and refusals."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq

import cosim
from scenarios.conveyor import resonance_map
from scenarios.conveyor.map import survey, tolerances, zone
from scenarios.conveyor.map.plane import Plane, Setup, axis
from scenarios.conveyor.response import NONE, simulate
from scenarios.conveyor.theory import SETS
from tests.conftest import ROOT, ask, hear_ctrl_c
from workbench import Bench
from workbench.answer import finish

A = SETS["A"]
PARTS = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
FMUS = {part: ROOT / "fmus" / "native" / f"{name}.fmu" for part, name in PARTS.items()}
SETUP = Setup({}, "strang", 256, Bench(FMUS))
LIMIT = 50.0
MONOLITHIC = {36.0: 90.9984270, 40.0: 104.9679504, 60.0: 9.3145045}


def plane(x: str, y: str, speed: float = 60.0) -> Plane:
    return Plane(axis(FMUS, "x", x, 4), axis(FMUS, "y", y, 2), A, speed)


@pytest.fixture(scope="module")
def mapped() -> survey.Survey:
    """Speed and motor.T, with the reference machine in the middle row."""
    return survey.sweep(plane("speed=24:64:11", "motor.T=0.05:0.075:3"), SETUP, None)[0]


@pytest.fixture(scope="module")
def ridges(mapped: survey.Survey) -> list[survey.Row]:
    return survey.locate(mapped, SETUP)


def test_torque_ripple_is_that_of_an_independent_integration(mapped: survey.Survey) -> None:
    speeds = mapped.plane.x.values.tolist()
    for nu, ripple in MONOLITHIC.items():
        assert mapped.ripple[1, speeds.index(nu)] == pytest.approx(ripple, rel=1e-3)


def test_gain_is_theorys_closest_far_from_resonance(mapped: survey.Survey) -> None:
    points = list(mapped.plane.points())
    damped = [m.slope - 4 * m.theta0 * m.T * nu**2 + 2j * nu * m.J for m, nu in points]
    theory = A.B / np.abs(damped)
    gain = mapped.gain.ravel()
    assert gain == pytest.approx(theory, rel=4e-3)
    far = np.array([abs(nu / m.nu_res - 1) > 0.2 for m, nu in points])
    assert 10 < far.sum() < 25
    assert gain[far] == pytest.approx(theory[far], rel=2e-3)


def test_phase_ridge_lies_on_formula_22(ridges: list[survey.Row]) -> None:
    for row in ridges:
        assert row.formula == pytest.approx(replace(A, T=row.y).nu_res, rel=1e-6)
        assert row.lag_90 == pytest.approx(row.formula, rel=3e-4)
    assert ridges[1].lag_90 == pytest.approx(40.0022, abs=0.006)


def test_amplitude_ridge_lies_off_formula_22_where_theory_puts_it(
    ridges: list[survey.Row],
) -> None:
    for row in ridges:
        assert row.peak is not None and row.formula is not None
        assert row.peak == pytest.approx(row.peak_theory, rel=5e-4)
        assert row.peak < 0.985 * row.formula
    assert ridges[1].peak == pytest.approx(39.058, abs=0.006)
    assert ridges[1].peak_theory == pytest.approx(39.053, abs=1e-3)


def test_ridges_do_not_depend_on_the_points_of_the_map(ridges: list[survey.Row]) -> None:
    coarse = survey.sweep(plane("speed=21:66:5", "motor.T=0.0625:0.075:2"), SETUP, None)[0]
    row = survey.locate(coarse, SETUP)[0]
    assert row.lag_90 == pytest.approx(ridges[1].lag_90, rel=1e-5)
    assert row.peak == pytest.approx(ridges[1].peak, rel=1e-5)


def test_torque_of_the_wrong_sign_has_no_phase_ridge(mapped: survey.Survey) -> None:
    for sign, there in ((1.0, True), (-1.0, False)):
        trace = survey.Trace(0.0625, mapped.plane.x.values, sign * mapped.torque[1])
        assert (survey.find_row(mapped.plane, trace).lag_90 is not None) is there


def test_coupling_error_covers_the_distance_from_an_independent_integration(
    mapped: survey.Survey, ridges: list[survey.Row]
) -> None:
    errors = survey.coupling(mapped, ridges, SETUP)
    assert errors.gain is not None and errors.lag_90 is not None and errors.peak is not None
    assert errors.points == 15 + 6 * 5 and errors.converged > 30
    for nu, ripple in MONOLITHIC.items():
        column = mapped.plane.x.values.tolist().index(nu)
        assert abs(mapped.ripple[1, column] / ripple - 1) < errors.gain < 2e-3
    assert ridges[1].lag_90 is not None and ridges[1].peak is not None
    assert 0.5 * errors.lag_90 < abs(ridges[1].lag_90 / 40.0022 - 1) < 1.5 * errors.lag_90
    assert 0.3 * errors.peak < abs(ridges[1].peak / 39.058 - 1) < 1.5 * errors.peak


def test_values_of_an_axis_are_even_or_even_in_their_logarithm() -> None:
    even = axis(FMUS, "y", "motor.T=0.01:0.04:3", 2)
    assert even.values == pytest.approx([0.01, 0.025, 0.04]) and not even.log
    log = axis(FMUS, "y", "motor.T=0.01:0.04:3:log", 2)
    assert log.values == pytest.approx([0.01, 0.02, 0.04]) and log.log
    assert (log.name, log.unit) == ("motor.T", "s") and "Time constant" in log.label


@pytest.mark.parametrize(
    ("x", "y", "speed"),
    [
        ("speed=26:56:7", "conveyor.rotor.J=0.3:0.8:2", 60.0),
        ("motor.T=0.03:0.12:7:log", "motor.B=150:250:2", 40.0),
        ("conveyor.rotor.J=0.3:0.9:5", "conveyor.trough.m=150:250:2", 40.0),
    ],
)
def test_any_two_parameters_have_a_ridge_where_formula_22_has_it(
    x: str, y: str, speed: float
) -> None:
    there = plane(x, y, speed)
    found = survey.locate(survey.sweep(there, SETUP, None)[0], SETUP)
    assert len(found) == 2
    for row in found:
        assert row.lag_90 is not None
        machine, nu = there.at(row.lag_90, row.y)
        assert machine.nu_res == pytest.approx(nu, rel=6e-4)
        assert row.lag_90 == pytest.approx(row.formula, rel=1.5e-3)


def test_transients_die_out_at_the_rate_of_the_eigenvalues() -> None:
    assert A.decay_rate == pytest.approx(8.2, rel=1e-3)
    assert SETS["B"].decay_rate == pytest.approx(25.2, rel=1e-3)
    overdamped = replace(SETS["B"], T=0.002)
    roots = np.roots([overdamped.theta0 * 0.002, overdamped.J, overdamped.slope])
    assert overdamped.decay_rate == pytest.approx(min(-roots.real)) and np.isreal(roots).all()


def test_points_without_a_steady_orbit_are_told_and_left_out() -> None:
    """A motor too weak to turn the crank over its spring stands still at every slow speed."""
    weak = Setup({"motor.B": 2.0}, "strang", 256, Bench(FMUS))
    there = plane("speed=4:60:4", "motor.T=0.05:0.06:2")
    found = survey.sweep(there, weak, None)[0]
    assert not found.steady.all()
    assert "speed" in resonance_map.restless_places(found)[0]
    assert survey.locate(found, weak)[0].lag_90 is None


def test_parts_lie_evenly_within_their_tolerance() -> None:
    drawn = tolerances.factors({"motor.T": 0.1, "motor.B": 0.05}, 10)
    for name, share in (("motor.T", 0.1), ("motor.B", 0.05)):
        assert len(drawn[name]) == 1024
        assert np.abs(drawn[name] - 1.0).max() < share
        assert drawn[name].mean() == pytest.approx(1.0, abs=1e-4)
        assert drawn[name].std() == pytest.approx(share / math.sqrt(3), rel=1e-3)
    assert abs(np.corrcoef(drawn["motor.T"], drawn["motor.B"])[0, 1]) < 0.01


def risk(mapped: survey.Survey, scale: float, row: int, column: int) -> float:
    spread = {name: scale * share for name, share in resonance_map.TOLERANCES.items()}
    drawn = tolerances.factors(spread, 10)
    return zone.probability(zone.at_point(mapped.plane, mapped.ratio, drawn, row, column), LIMIT)


def test_probability_is_one_on_the_ridge_and_zero_far_away(mapped: survey.Survey) -> None:
    speeds = mapped.plane.x.values.tolist()
    assert risk(mapped, 1.0, 1, speeds.index(40.0)) == 1.0
    assert risk(mapped, 1.0, 1, speeds.index(64.0)) == 0.0


def test_probability_rises_with_the_tolerance_outside_the_zone_and_falls_inside(
    mapped: survey.Survey,
) -> None:
    edge = int(np.flatnonzero(mapped.ripple[1] > LIMIT)[-1])
    outside = [risk(mapped, scale, 1, edge + 1) for scale in (0.0, 0.5, 1.0, 2.0)]
    inside = [risk(mapped, scale, 1, edge) for scale in (0.0, 0.5, 1.0, 2.0)]
    assert outside[0] == 0.0 and outside == sorted(outside) and outside[-1] > 0.01
    assert inside[0] == 1.0 and inside == sorted(inside, reverse=True) and inside[-1] < 0.99


def test_probability_of_one_toleranced_part_is_the_share_of_its_tolerance(
    mapped: survey.Survey,
) -> None:
    column = mapped.plane.x.values.tolist().index(44.0)
    ratio = mapped.ratio[1, column]

    def above(factor: float) -> float:
        ripple = abs(replace(A, T=A.T * factor).torque_ripple(44.0))
        return float(ripple * ratio - LIMIT)

    drawn = tolerances.factors({"motor.T": 0.1}, 12)
    found = zone.probability(zone.at_point(mapped.plane, mapped.ratio, drawn, 1, column), LIMIT)
    assert above(0.9) > 0.0 > above(1.1)
    assert found == pytest.approx((float(brentq(above, 0.9, 1.1)) - 0.9) / 0.2, abs=1e-3)


def test_probability_in_the_range_is_that_of_the_worst_speed(mapped: survey.Survey) -> None:
    drawn = tolerances.factors(resonance_map.TOLERANCES, 10)
    speeds = mapped.plane.x.values.tolist()
    over = zone.in_range(mapped.plane, mapped.ratio, drawn, 0, (40.0, 60.0))
    at = [
        zone.at_point(mapped.plane, mapped.ratio, drawn, 0, speeds.index(nu)).expected
        for nu in (40.0, 44.0, 48.0, 52.0, 56.0, 60.0)
    ]
    assert (over.expected >= np.max(at, axis=0) * (1 - 1e-12)).all()
    assert over.expected == pytest.approx(np.max(at, axis=0), rel=0.1)
    assert 40.0 <= over.nu.min() < over.nu.max() <= 60.0
    again = [abs(tolerances.one(over.machines, k).torque_ripple(over.nu[k])) for k in range(99)]
    assert over.expected[:99] == pytest.approx(np.array(again), rel=0.01)


def test_cosimulated_machines_agree_with_the_probability(mapped: survey.Survey) -> None:
    drawn = tolerances.factors(resonance_map.TOLERANCES, 10)
    column = mapped.plane.x.values.tolist().index(44.0)
    sample = zone.at_point(mapped.plane, mapped.ratio, drawn, 1, column)
    place = zone.in_range(mapped.plane, mapped.ratio, drawn, 1, (48.0, 60.0))
    for check in zone.check([sample, place], 32, LIMIT, SETUP):
        assert check.samples == 32
        assert check.interval[0] <= check.predicted <= check.interval[1]
        assert np.abs(check.off).max() < 4e-3 and np.abs(check.off).max() > 0.0
        assert check.above + check.below <= 1
    assert 0.1 < zone.probability(sample, LIMIT) < 0.9


def test_machines_without_a_steady_orbit_are_left_out_of_a_check(mapped: survey.Survey) -> None:
    drawn = tolerances.factors(resonance_map.TOLERANCES, 3)
    sample = zone.at_point(mapped.plane, mapped.ratio, drawn, 1, 5)
    good = simulate(SETUP.case(A, 44.0))
    orbits = [good._replace(torque=complex(value)) for value in sample.expected]
    orbits[2] = good._replace(torque=NONE, problem="it does not turn")
    check = zone.judged(sample, orbits, LIMIT)
    assert (check.samples, check.restless, check.above, check.below) == (7, 1, 0, 0)
    assert check.off == pytest.approx(np.zeros(7), abs=1e-12)


def test_check_sees_a_prediction_that_is_wrong(mapped: survey.Survey) -> None:
    drawn = tolerances.factors(resonance_map.TOLERANCES, 10)
    column = mapped.plane.x.values.tolist().index(44.0)
    wrong = zone.at_point(mapped.plane, 0.8 * mapped.ratio, drawn, 1, column)
    (check,) = zone.check([wrong], 32, LIMIT, SETUP)
    assert check.above > 5 and check.below == 0
    assert check.off == pytest.approx(np.full(32, 1 / 0.8 - 1), abs=5e-3)
    right = risk(mapped, 1.0, 1, column)
    assert abs(check.corrected - right) < 0.5 * abs(check.predicted - right)


def test_edge_is_where_the_outcome_is_open() -> None:
    probabilities = np.array([[0.0, 0.04, 0.5, 1.0], [math.nan, 0.2, 0.9, 0.96]])
    assert zone.on_edge(probabilities, 8) == [(0, 2), (1, 1), (1, 2)]
    assert zone.on_edge(probabilities, 2) == [(0, 2), (1, 2)]
    assert zone.on_edge(probabilities, 0) == []


def small(folder: Path, **settings: Any) -> Any:
    given = {
        "x": "speed=30:62:9", "y": "motor.T=0.03:0.12:3:log", "range": "45:60",
        "samples": 256, "checks": 2, "check_runs": 8, "steps_per_rev": 80,
    }  # fmt: skip
    return ask("resonance_map", folder, **(given | settings))


def test_answer_has_verdict_tables_and_picture(tmp_path: Path) -> None:
    given = {
        "x": "speed=30:62:9", "y": "motor.T=0.03:0.12:3:log", "samples": 256, "checks": 2,
        "check_runs": 8, "steps_per_rev": 80,
    }  # fmt: skip
    finish(ask("resonance_map", **given), tmp_path)
    rows = pd.read_csv(tmp_path / "resonance_map.csv")
    assert list(rows.columns[:4]) == ["speed", "motor.T", "ripple", "gain"]
    assert len(rows) == 27 and rows["speed"][:9].is_monotonic_increasing
    assert rows["probability"].between(0.0, 1.0).all()
    high, low = (rows["probability"][far] for far in (rows["ripple"] > 75, rows["ripple"] < 25))
    assert len(high) > 1 and (high > 0.9).all() and len(low) > 5 and (low < 0.1).all()
    machines = [replace(A, T=T).load_ripple(nu) for nu, T in zip(rows["speed"], rows["motor.T"])]
    assert (rows["ripple"] / rows["gain"]).to_numpy() == pytest.approx(np.abs(machines))
    lines = pd.read_csv(tmp_path / "resonance_map_rows.csv")
    worst = [rows[(rows["motor.T"] == T) & rows["speed"].between(45, 60)]["ripple"].max()
             for T in lines["motor.T"]]  # fmt: skip
    assert (lines["ripple_in_range"] > 0.99 * np.array(worst)).all()
    assert (lines["ripple_in_range"] < 1.25 * np.array(worst)).all()
    facts = json.loads((tmp_path / "resonance_map.json").read_text())
    assert facts["units"]["motor.T"] == "s" and facts["units"]["lag"] == "deg"
    assert facts["figures"]["gain_max"]["value"] == pytest.approx(rows["gain"].max())
    assert 0.0 < facts["figures"]["gain_max"]["error"] < 0.01 * rows["gain"].max()
    assert facts["limit"] == 50.0 and facts["flavour"] == "native"
    assert len(facts["checks"]) <= 2 and all(c["samples"] == 8 for c in facts["checks"])
    assert "range 45 .. 60 rad/s stays clear" in facts["verdict"][0]
    assert (lines["ripple_in_range"] <= 50.0).to_list() == [True, False, True]
    assert "motor.T of 0.03 .. 0.03 s and 0.12 .. 0.12 s; with every part" in facts["verdict"][0]
    assert (lines["probability_in_range"] <= 0.01).to_list() == [False, False, True]
    assert "99% of the machines, with 0.12 .. 0.12 s." in facts["verdict"][0]
    beside = 100 * (lines["peak"] / lines["formula"] - 1).dropna()
    assert math.sqrt((beside**2).mean()) > 1.0
    for name in ("max", "rms"):
        figure = facts["figures"][f"peak_off_formula_{name}"]
        assert (figure["value"], figure["error"]) == (None, None)
        assert figure["reason"].startswith("runs with coarser steps converge in no order")
    assert not (tmp_path / "resonance_map.partial.csv").exists()


def test_map_at_a_fixed_speed_has_no_range(tmp_path: Path) -> None:
    settings = {"x": "motor.T=0.03:0.12:5:log", "y": "motor.B=150:250:2", "range": None}
    found = small(tmp_path, **settings, speed=40.0, checks=0, start=["conveyor.rod.finite=true"])
    assert found.options["speed"].value == 40.0 and found.facts["range"] is None
    assert "At 40 rad/s a torque ripple above 50 N.m" in found.verdict
    assert "No point of the map was checked" in found.verdict
    assert found.parameters["conveyor.rod.finite"].value
    panels = [panel.quantity for panel in found.show().charts[2].panels]
    assert panels == ["motor.T"]


def test_start_values_change_the_machine_of_the_map(tmp_path: Path) -> None:
    found = small(tmp_path, y="motor.T=0.05:0.06:2", checks=1, start=["conveyor.rotor.J=0.99"])
    assert found.facts["checks"][0]["ripple_off_max"] < 5e-3
    (probability, ripple, ridges) = found.show().charts[2].panels
    assert [curve.name for curve in ridges.curves] == [
        "formula (22)",
        "90 deg lag",
        "largest torque ripple",
    ]
    assert ripple.levels[0].at == 50.0 and probability.unit == "%"
    kept = pd.read_csv(tmp_path / "resonance_map.partial.csv")
    told = found.tables["resonance_map.csv"].frame
    assert kept.equals(told.drop(columns="probability")) and len(told) == 18
    lines = found.tables["resonance_map_rows.csv"].frame
    assert lines["formula"][0] == pytest.approx(replace(A, theta1=0.99, T=0.05).nu_res, rel=1e-6)
    assert lines["lag_90"][0] == pytest.approx(lines["formula"][0], rel=2e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"y": "motor.Q=1:2:5"}, "'motor.Q' is no part of the drive, only motor.B, motor.T"),
        ({"y": "speed=1:2:5"}, "the speed belongs on x"),
        ({"x": "motor.T=1:2:5", "range": None}, "both motor.T"),
        ({"y": "motor.T=a:2:5"}, "must read NAME=FROM:TO:NUMBER"),
        ({"y": "motor.T=1:2"}, "must read NAME=FROM:TO:NUMBER"),
        ({"y": "motor.T=1:2:5:cubic"}, "must read NAME=FROM:TO:NUMBER"),
        ({"y": "motor.T=-1:2:5"}, "motor.T = -1.0 s must be a finite number above 0"),
        ({"y": "motor.T=0.1:inf:5"}, "motor.T = inf s must be"),
        ({"y": "motor.T=2:1:5"}, "motor.T must rise: 2 .. 1 s does not"),
        ({"x": "speed=30:60:3"}, "number of values of speed = 3 must be at least 4"),
        ({"range": "45:90"}, "--range 45:90 rad/s must rise and lie inside the map, 30 .. 62"),
        ({"range": "50:45"}, "must rise and lie inside the map"),
        ({"range": "45"}, "must read FROM:TO"),
        ({"range": "nan:50"}, "must rise and lie inside the map"),
        ({"speed": 40.0}, "--speed is for maps whose x is not the speed"),
        ({"x": "motor.B=100:200:5"}, "--range is for maps whose x is the speed"),
        ({"tolerance": ["motor.T=100"]}, "motor.T = 100.0 % must be at least 0 and below 100"),
        ({"tolerance": ["motor.T=-1"]}, "must be at least 0 and below 100"),
        ({"tolerance": ["motor.T=nan"]}, "must be at least 0 and below 100"),
        ({"tolerance": ["motor.T"]}, "must read NAME=PERCENT"),
        ({"tolerance": ["motor.kloss.s_b=5"]}, "'motor.kloss.s_b' is no part of the drive"),
        ({"samples": 100}, "samples = 100 must be a power of 2"),
        ({"check_runs": 512}, "check_runs = 512 must be at most samples = 256"),
        ({"limit": 0.0}, "limit = 0 % must be a finite number above 0"),
        ({"rated_torque": -5.0}, "rated_torque = -5 N.m must be"),
        ({"start": ["motor.T=0.1"]}, "start value motor.T: this question sets it"),
        ({"start": ["motor.characteristic=1"]}, "motor.characteristic: this question sets it"),
        ({"steps_per_rev": 64}, "16 steps per revolution must be at least 18"),
    ],
)
def test_settings_that_give_no_answer_are_refused(
    tmp_path: Path, settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(cosim.SetupError) as refused:
        small(tmp_path, **settings)
    assert message in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_ctrl_c_keeps_the_rows(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "scenarios", "run", "resonance_map", "--out", str(tmp_path)]
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=hear_ctrl_c,  # noqa: PLW1509
    )
    kept = tmp_path / "resonance_map.partial.csv"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if kept.exists() and len(kept.read_text().splitlines()) > 3:
            break
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors.decode()
    assert "Traceback" not in errors.decode()
    rows = pd.read_csv(kept)
    assert 3 <= len(rows) < 2400 and rows.notna().all(axis=None)
    assert f"{len(rows)} of 2400 points in {kept}" in errors.decode()
    assert rows.iloc[0, :2].to_list() == [15.0, 0.015]
    assert not (tmp_path / "resonance_map.csv").exists()


@pytest.mark.slow
def test_the_map_of_the_defaults_tells_the_figures_of_the_documentation(tmp_path: Path) -> None:
    resonance_map.run(jobs=2, out=tmp_path)
    rows = pd.read_csv(tmp_path / "resonance_map.csv")
    assert len(rows) == 2400 and (rows["settling"] < 1e-6).all()
    lines = pd.read_csv(tmp_path / "resonance_map_rows.csv")
    assert len(lines) == 40 and lines["lag_90"].notna().sum() == 39
    facts = json.loads((tmp_path / "resonance_map.json").read_text())
    figures = {name: figure["value"] for name, figure in facts["figures"].items()}
    assert abs(figures["lag_90_off_formula_max"]) < 0.15
    assert figures["lag_90_off_formula_rms"] < 0.05
    assert figures["peak_off_formula_max"] == pytest.approx(13.8, abs=0.5)
    assert abs(figures["peak_off_peak_theory_max"]) < 0.3
    assert facts["figures"]["lag_90_off_formula_max"]["error"] < 0.05
    checks = [*facts["checks"], *facts["range_checks"]]
    assert len(checks) == 12
    assert sum(check["judged_above"] + check["judged_below"] for check in checks) <= 3
    outside = [c for c in checks if not c["interval"][0] <= c["probability"] <= c["interval"][1]]
    assert len(outside) <= 1
    beyond = lines["motor.T"][lines["probability_in_range"] <= 0.01]
    assert beyond[beyond < 0.045].max() == pytest.approx(0.027, rel=0.08)
    assert beyond[beyond > 0.045].min() == pytest.approx(0.077, rel=0.08)
