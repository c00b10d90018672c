"""The resonance map: ridges, gain, probabilities and their check, files and refusals."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq

import cosim
from cosim.errors import pluralize
from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.orbit import Drive as Runs
from scenarios.conveyor.parameter_plane import (
    BuiltMachines,
    Plane,
    axis,
    compared_with_orbits,
    on_edge,
    shares,
)
from scenarios.conveyor.questions import resonance_map
from tests.conftest import ROOT, ask, fmus_of, restore_ctrl_c
from tests.scenarios.orbit_oracle import Drive, features
from workbench import Context
from workbench.find import Find, LineSearch
from workbench.orbits import Columns
from workbench.plan import Measured, extreme, measure

A = SETS["A"]
FMUS = fmus_of(resonance_map)
DRIVE = Runs(Context(FMUS), "strang", 256)
LIMIT = 50.0
MONOLITHIC = {36.0: 90.9984270, 40.0: 104.9679504, 60.0: 9.3145045}
SPEEDS = np.linspace(24.0, 64.0, 11).tolist()
Points = tuple[Plane, Measured]


def plane(x: str, y: str, speed: float = 60.0) -> Plane:
    return Plane(axis(FMUS, "x", x, 4), axis(FMUS, "y", y, 2), A, speed)


def measured(map_plane: Plane) -> Measured:
    map_plan = map_plane.plan(DRIVE, resonance_map.SOUGHT, resonance_map.COLUMNS)
    return measure(DRIVE.context, {"map": map_plan})["map"]


@pytest.fixture(scope="module")
def mapped() -> Points:
    """Speed and motor.T, with the reference machine in the middle row."""
    map_plane = plane("speed=24:64:11", "motor.T=0.05:0.075:3")
    return map_plane, measured(map_plane)


@pytest.fixture(scope="module")
def ridges(mapped: Points) -> pd.DataFrame:
    return resonance_map.ridges(*mapped)


def ridges_of(map_plane: Plane) -> pd.DataFrame:
    return resonance_map.ridges(map_plane, measured(map_plane))


def test_torque_ripple_is_that_of_an_independent_integration(mapped: Points) -> None:
    """Within the coupling error of each point."""
    points = mapped[1].table.frame
    for nu, ripple in MONOLITHIC.items():
        row = points.iloc[11 + SPEEDS.index(nu)]
        assert 0.0 < row["ripple_error"] < 2e-4 * ripple
        assert abs(row["ripple"] - ripple) <= row["ripple_error"] + 1e-7


def test_an_extreme_reaches_as_far_as_any_value_and_takes_an_unknown_error_for_large() -> None:
    values, errors = np.array([1.0, 2.0, 1.9, np.nan]), np.array([0.1, 0.01, 0.3, np.nan])
    assert extreme(values, errors) == pytest.approx((2.0, 0.2))
    assert extreme(values, errors, -1.0) == pytest.approx((1.0, 0.1))
    errors[1] = np.nan
    assert extreme(values, errors) == pytest.approx((2.0, 0.9))
    assert np.isnan(extreme(values, 0.0 * errors + np.nan)).all()


def test_gain_is_theorys_closest_far_from_resonance(mapped: Points) -> None:
    map_plane, points = mapped[0], mapped[1].table.frame
    m, nu = map_plane.points()
    damped = m.slope - 4 * m.theta0 * m.T * nu**2 + 2j * nu * m.J
    gain, theory = points["gain"].to_numpy(), A.B / np.abs(damped)
    assert gain == pytest.approx(theory, rel=4e-3)
    far = abs(nu / m.nu_res - 1) > 0.2
    assert 10 < far.sum() < 25
    assert gain[far] == pytest.approx(theory[far], rel=2e-3)


def test_ridges_lie_where_theory_and_exact_orbits_have_them(ridges: pd.DataFrame) -> None:
    """The phase on formula (22), the largest ripple off it."""
    truth = features(Drive(), 24.0, 64.0)
    for row in ridges.itertuples():
        assert row.formula == pytest.approx(replace(A, T=ridges["motor.T"][row.Index]).nu_res)
        assert row.lag_90 == pytest.approx(row.formula, rel=3e-4)
        assert row.peak == pytest.approx(row.peak_theory, rel=5e-4)
        assert row.peak < 0.985 * row.formula
    for name, exact in (("lag_90", truth["nu_90"]), ("peak", truth["nu_peak_tau"])):
        assert abs(ridges[name][1] - exact) <= ridges[f"{name}_error"][1] < 1e-4 * exact
    assert ridges["peak_theory"][1] == pytest.approx(39.053, abs=1e-3)


def test_ridges_do_not_depend_on_the_points_of_the_map(ridges: pd.DataFrame) -> None:
    map_plane = plane("speed=21:66:5", "motor.T=0.0625:0.075:2")
    coarse = ridges_of(map_plane)
    for name in ("lag_90", "peak"):
        assert coarse[name][0] == pytest.approx(ridges[name][1], rel=1e-5)


def test_torque_of_the_wrong_sign_has_no_phase_ridge(mapped: Points) -> None:
    motions = mapped[1].motions
    row, sought = motions[:11], Find("speed", SPEEDS[0], SPEEDS[-1], "lag", 90.0)
    turned = {"tau2_phase": row.columns["tau2_phase"].each(lambda x: x + 180.0, "deg", "")}
    reversed_ = replace(
        row,
        columns=Columns(
            {
                name: partial(turned.get(name, x).take, slice(None))
                for name, x in row.columns.items()
            }
        ),
    )
    assert LineSearch.along(row, sought, np.array(SPEEDS)).crossings()
    assert not LineSearch.along(reversed_, sought, np.array(SPEEDS)).crossings()


def test_values_of_an_axis_are_even_or_even_in_their_logarithm() -> None:
    even = axis(FMUS, "y", "motor.T=0.01:0.04:3", 2)
    assert even.values == pytest.approx([0.01, 0.025, 0.04]) and not even.log
    log = axis(FMUS, "y", "motor.T=0.01:0.04:3:log", 2)
    assert log.values == pytest.approx([0.01, 0.02, 0.04]) and log.log
    assert (log.quantity, log.unit) == ("motor.T", "s")


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
    map_plane = plane(x, y, speed)
    ridges = ridges_of(map_plane)
    assert ridges["formula"].notna().all()
    assert ridges["lag_90"].to_list() == pytest.approx(ridges["formula"].to_list(), rel=1.5e-3)
    for row in ridges.itertuples():
        machine, nu = map_plane.at(row.lag_90, map_plane.y.values[row.Index])
        assert machine.nu_res == pytest.approx(nu, rel=6e-4)


def test_points_without_a_steady_orbit_are_reported_and_left_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A motor too weak to turn the crank over its spring stands still at every slow speed."""
    map_plane = plane("speed=4:60:4", "motor.T=0.05:0.06:2")._replace(machine=replace(A, B=2.0))
    orbits = measured(map_plane)
    points = orbits.table.frame
    resonance_map.warn_of_unsteady(map_plane, points)
    assert points["ripple"].isna().any() and not points["ripple"].isna().all()
    assert "No steady orbit at motor.T = 0.05 s, speed of 4 rad/s" in caplog.text
    assert math.isnan(resonance_map.ridges(map_plane, orbits)["lag_90"][0])


def test_a_tolerance_is_in_percent() -> None:
    read = shares(FMUS, "tolerance", ["motor.T=5"], {"motor.T": 0.1, "motor.B": 0.02})
    assert read == {"motor.T": 0.05, "motor.B": 0.02}


def test_parts_lie_evenly_within_their_tolerance(mapped: Points) -> None:
    factors = machines(mapped, {"motor.T": 0.1, "motor.B": 0.05}).factors
    for name, share in (("motor.T", 0.1), ("motor.B", 0.05)):
        assert len(factors[name]) == 1024
        assert np.abs(factors[name] - 1.0).max() < share
        assert factors[name].mean() == pytest.approx(1.0, abs=1e-4)
        assert factors[name].std() == pytest.approx(share / math.sqrt(3), rel=1e-3)
    assert abs(np.corrcoef(factors["motor.T"], factors["motor.B"])[0, 1]) < 0.01


def machines(mapped: Points, tolerances: Any = resonance_map.TOLERANCES) -> BuiltMachines:
    """Machines like those of the map."""
    map_plane, points = mapped[0], mapped[1].table.frame
    ratio = (points["ripple"] / points["ripple_theory"]).to_numpy().reshape(3, -1)
    return BuiltMachines.within(map_plane, ratio, tolerances, 1024)


def built(mapped: Points, x: Any, share: Any = 1.0, row: int = 1) -> Any:
    """Machines of a row at a speed or at several, with so many times the usual tolerances."""
    usual = resonance_map.TOLERANCES.items()
    spread = (
        share if isinstance(share, dict) else {name: share * tolerance for name, tolerance in usual}
    )
    return machines(mapped, spread).sample(row, np.atleast_1d(x))


def test_probability_is_1_on_the_ridge_and_0_far_from_it(mapped: Points) -> None:
    assert built(mapped, 40.0).probability(LIMIT) == 1.0
    assert built(mapped, 64.0).probability(LIMIT) == 0.0


def test_probability_rises_with_the_tolerance_outside_the_zone_and_falls_inside(
    mapped: Points,
) -> None:
    edge = int(np.flatnonzero(mapped[1].table.columns["ripple"][11:22] > LIMIT)[-1])
    inside, outside = (
        [built(mapped, nu, scale).probability(LIMIT) for scale in (0.0, 0.5, 1.0, 2.0)]
        for nu in SPEEDS[edge : edge + 2]
    )
    assert outside[0] == 0.0 and outside == sorted(outside) and outside[-1] > 0.01
    assert inside[0] == 1.0 and inside == sorted(inside, reverse=True) and inside[-1] < 0.99


def test_probability_of_a_single_toleranced_part_is_the_share_of_its_tolerance(
    mapped: Points,
) -> None:
    nominal = built(mapped, 44.0, {"motor.T": 0.0}).expected[0] / abs(A.torque_ripple(44.0))

    def above(factor: float) -> float:
        return float(abs(replace(A, T=A.T * factor).torque_ripple(44.0)) * nominal - LIMIT)

    assert above(0.9) > 0.0 > above(1.1)
    probability = built(mapped, 44.0, {"motor.T": 0.1}).probability(LIMIT)
    assert probability == pytest.approx((float(brentq(above, 0.9, 1.1)) - 0.9) / 0.2, abs=1e-3)


def test_probability_in_the_range_is_that_of_the_worst_speed(mapped: Points) -> None:
    over = built(mapped, np.linspace(40.0, 60.0, 61), row=0)
    at = [built(mapped, nu, row=0).expected for nu in SPEEDS if 40.0 <= nu <= 60.0]
    assert (over.expected >= np.max(at, axis=0) * (1 - 1e-12)).all()
    assert over.expected == pytest.approx(np.max(at, axis=0), rel=0.1)
    assert 40.0 <= over.x.min() < over.x.max() <= 60.0
    machine, nu = machines(mapped).at(0, over.x[:99], slice(99))
    assert over.expected[:99] == pytest.approx(abs(machine.torque_ripple(nu)), rel=0.01)


def test_cosimulated_machines_agree_with_the_probability(mapped: Points) -> None:
    samples = [built(mapped, 44.0), built(mapped, np.linspace(48.0, 60.0, 61))]
    for check in machines(mapped).check(samples, 32, LIMIT, DRIVE):
        assert check["samples"] == 32
        assert check["interval"][0] <= check["probability"] <= check["interval"][1]
        assert 0.0 < check["off_max"] < 4e-3
        assert check["judged_above"] + check["judged_below"] <= 1
    assert 0.1 < samples[0].probability(LIMIT) < 0.9


def test_machines_without_a_steady_orbit_are_left_out_of_a_check(mapped: Points) -> None:
    sample = built(mapped, 44.0)
    torques = sample.expected[:8].copy()
    torques[2] = math.nan
    check = compared_with_orbits(sample, torques, LIMIT)
    names = ("samples", "not_steady", "judged_above", "judged_below", "off_max")
    assert [check[name] for name in names] == [7, 1, 0, 0, 0.0]
    lost = compared_with_orbits(sample, np.full(8, math.nan), LIMIT)
    assert [lost[name] for name in names[:4]] == [0, 8, 0, 0]
    two, one = (resonance_map.check_figures(x, 1e-3) for x in ([check, lost], [check]))
    assert two == one
    reason = resonance_map.check_figures([lost], 1e-3)["misjudged"].reason
    assert reason == "no machine that is co-simulated has a steady orbit"


def test_check_sees_a_prediction_that_is_wrong(mapped: Points) -> None:
    right = built(mapped, 44.0)
    wrong = right._replace(expected=0.8 * right.expected)
    (check,) = machines(mapped).check([wrong], 32, LIMIT, DRIVE)
    assert check["judged_above"] > 5 and check["judged_below"] == 0
    assert check["off_rms"] == pytest.approx(1 / 0.8 - 1, abs=5e-3)
    more = check["judged_above"] / 32
    left = abs(check["probability"] + more - right.probability(LIMIT))
    assert left < 0.5 * abs(check["probability"] - right.probability(LIMIT))


def test_edge_is_where_the_outcome_is_open() -> None:
    probabilities = np.array([0.0, 0.04, 0.5, 1.0, math.nan, 0.2, 0.9, 0.96])
    for count, wanted in ((8, [2, 5, 6]), (2, [2, 6]), (0, [])):
        assert on_edge(probabilities, count) == wanted


def small(folder: Path | None, **settings: Any) -> Any:
    options = {
        "x": "speed=30:62:9", "y": "motor.T=0.03:0.12:3:log", "range": "45:60",
        "samples": 256, "checks": 2, "check_runs": 8, "steps_per_rev": 128,
    }  # fmt: skip
    return ask("resonance_map", folder, **(options | settings))


def test_rows_lines_and_figures_of_a_map_say_the_same() -> None:
    answer = small(None, range=None)
    rows, lines = (
        answer.tables[f"{name}.csv"].frame for name in ("resonance_map", "resonance_map_rows")
    )
    high, low = (rows["probability"][far] for far in (rows["ripple"] > 75, rows["ripple"] < 25))
    assert len(high) > 1 and (high > 0.9).all() and len(low) > 5 and (low < 0.1).all()
    machines = [replace(A, T=T).load_ripple(nu) for nu, T in zip(rows["speed"], rows["motor.T"])]
    assert (rows["ripple"] / rows["gain"]).to_numpy() == pytest.approx(np.abs(machines))
    inside = rows[rows["speed"].between(45, 60)].groupby("motor.T")["ripple"].max()
    assert (lines["ripple_in_range"] / inside.to_numpy()).between(0.99, 1.25).all()
    assert (lines["ripple_in_range"] <= 50.0).to_list() == [True, False, True]
    assert (lines["probability_in_range"] <= 0.01).to_list() == [False, False, True]
    assert [str(x.answer) for x in answer.judgements] == ["yes", "yes"]
    assert [str(x.answer) for x in small(None, limit=1.0, checks=0).judgements] == ["no", "no"]
    figures, off = answer.figures, 100 * (lines["peak"] / lines["formula"] - 1).dropna()
    for name, value in (
        ("gain_max", rows["gain"].max()),
        ("peak_off_formula_max", abs(off).max()),
        ("peak_off_formula_rms", (off**2).mean() ** 0.5),
    ):
        assert figures[name].value == pytest.approx(value)


def test_start_values_change_the_machine_of_the_map(tmp_path: Path) -> None:
    answer = small(tmp_path, y="motor.T=0.05:0.06:2", checks=1, start=["conveyor.rotor.J=0.99"])
    assert answer.facts["checks"][0]["off_max"] < 5e-3
    (probability, ripple, ridges) = answer.show().charts[2].panels
    names = ["formula (22)", "90 deg lag", "largest torque ripple"]
    assert [curve.name for curve in ridges.curves] == names
    assert (ripple.unit, probability.unit) == ("N.m", "1")
    table = pd.read_csv(tmp_path / "resonance_map.partial.csv")
    points = answer.tables["resonance_map.csv"].frame
    assert table.equals(points.drop(columns="probability")) and len(points) == 18
    lines = answer.tables["resonance_map_rows.csv"].frame
    assert lines["formula"][0] == pytest.approx(replace(A, theta1=0.99, T=0.05).nu_res, rel=1e-6)
    assert lines["lag_90"][0] == pytest.approx(lines["formula"][0], rel=2e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"y": "motor.Q=1:2:5"},
            "'motor.Q' is not a parameter of the drive, only motor.B, motor.T",
        ),
        ({"y": "speed=1:2:5"}, "the speed belongs on x"),
        ({"x": "motor.T=1:2:5", "range": None}, "both motor.T"),
        ({"y": "motor.T=a:2:5"}, "--y motor.T = 'a:2:5' must read from:to:number or a,b,c"),
        ({"y": "motor.T=1:2"}, "must read from:to:number"),
        ({"y": "motor.T=1:2:5:cubic"}, "must read from:to:number"),
        ({"y": "motor.T=-1:2:5"}, "motor.T = -1 s must be a finite number above 0"),
        ({"y": "motor.T=0.1:inf:5"}, "motor.T = nan s must be a finite number"),
        ({"x": "speed=30:60:3"}, "number of values of speed = 3 must be at least 4"),
        (
            {"range": "45:90"},
            "--range 45:90 rad/s must read FROM:TO, rise and lie inside the map, 30 .. 62",
        ),
        ({"range": "45"}, "must read FROM:TO"),
        ({"range": "nan:50"}, "--range = nan rad/s must be a finite number"),
        ({"speed": 40.0}, "--speed is for maps whose x is not the speed"),
        ({"x": "motor.B=100:200:5"}, "--range is for maps whose x is the speed"),
        (
            {"tolerance": ["motor.T=100"]},
            "motor.T = 100 % must be a finite number at least 0 % and at most 99 %",
        ),
        ({"tolerance": ["motor.T=-1"]}, "must be a finite number at least 0 %"),
        ({"tolerance": ["motor.T=nan"]}, "motor.T = nan % must be a finite number at least 0 %"),
        ({"tolerance": ["motor.T"]}, "motor.T = '' must be a number in 1 or %"),
        ({"tolerance": ["motor.kloss.s_b=5"]}, "'motor.kloss.s_b' is not a parameter of the drive"),
        ({"samples": 100}, "samples = 100 must be a power of 2"),
        ({"check_runs": 512}, "check_runs = 512 must be at most samples = 256"),
        ({"limit": 0.0}, "limit = 0 % must be a finite number above 0"),
        ({"rated_torque": -5.0}, "rated_torque = -5 N.m must be"),
        ({"start": ["motor.T=0.1"]}, "start value motor.T: this question sets it"),
        ({"start": ["motor.characteristic=1"]}, "motor.characteristic: this question sets it"),
        (
            {"steps_per_rev": 64},
            "64 steps per revolution must be at least 72, because runs with 4 times fewer give the errors",
        ),
    ],
)
def test_settings_that_give_no_answer_are_refused(
    tmp_path: Path, settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(cosim.SetupError) as refused:
        small(tmp_path, **settings)
    assert message in str(refused.value)
    assert not list(tmp_path.iterdir())


#: The program, which hears Ctrl-C as soon as rows are in its file.
PRESSED = """
import csv, os, signal, sys
from types import SimpleNamespace
from scenarios.__main__ import main
from workbench import files
class Writer:
    def __init__(self, file):
        self.writer = csv.writer(file)
        self.writerow = self.writer.writerow
    def writerows(self, rows):
        self.writer.writerows(rows)
        os.kill(os.getpid(), signal.SIGINT)
files.csv = SimpleNamespace(writer=Writer)
sys.exit(main())
"""


def test_ctrl_c_keeps_the_rows(tmp_path: Path) -> None:
    words = ["run", "resonance_map", "--out", str(tmp_path)]
    process = subprocess.run(
        [sys.executable, "-c", PRESSED, *words],
        cwd=ROOT, capture_output=True, preexec_fn=restore_ctrl_c, check=False,
    )  # fmt: skip
    errors, partial = process.stderr, tmp_path / "resonance_map.partial.csv"
    assert process.returncode == 130, errors.decode()
    assert "Traceback" not in errors.decode()
    rows = pd.read_csv(partial)
    assert 1 <= len(rows) < 2400 and rows.notna().all(axis=None)
    assert f"{pluralize(len(rows), 'row')} in {partial}" in errors.decode()
    assert rows.iloc[0, :2].to_list() == [15.0, 0.015]
    assert not (tmp_path / "resonance_map.csv").exists()
