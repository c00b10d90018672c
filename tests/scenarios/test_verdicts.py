"""Verdicts of the conveyor's questions say what their figures and rows say, and refuse the rest."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.second_order import settling_rates
from scenarios.project import PROJECT
from tests.conftest import ask
from tests.scenarios.orbit_oracle import Drive, orbit
from workbench.answer import Answer
from workbench.cli import REFUSED, main
from workbench.figure import ERROR_SCOPE
from workbench.page.html import code

SPEEDS = "34:46:7"


def answers(answer: Answer) -> tuple[str, str]:
    """Two answers of `resonance`: on resonance, torque ripple below its limit."""
    ripple, resonance = answer.judgements[:2]
    assert ripple.what.startswith("torque ripple below") and resonance.what == "on resonance"
    assert all(x.figure in answer.figures.values() for x in (ripple, *resonance.also))
    return str(resonance.answer), str(ripple.answer)


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ({}, ("yes", "no")),
        ({"limit": 150.0}, ("yes", "yes")),
        ({"limit": 1000.0}, ("yes", "yes")),
        ({"speed": 45.0}, ("no", "no")),
        ({"speed": 60.0, "limit": 5.0}, ("no", "no")),
        ({"set": "B"}, ("no", "yes")),
    ],
)
def test_resonance_and_limit_are_two_answers(
    options: dict[str, Any], wanted: tuple[str, str]
) -> None:
    speeds = "20:40:5" if options.get("set") == "B" else SPEEDS
    answer = ask("resonance", speeds=speeds, steps_per_rev=512, **options)
    assert answers(answer) == wanted
    figure, speed = answer.figures["nu_90_away"], answer.facts["operating_speed"]
    assert figure.value == answer.figures["nu_90"].value - speed
    # a unit in the last digit of 40 is 1e-10 of the error
    assert figure.error == pytest.approx(answer.figures["nu_90"].error, rel=1e-9)
    assert figure.error is not None and abs(figure.value) > figure.error
    side = "above" if answer.figures["nu_90"].value > speed else "below"
    assert f" rad/s {side} the operating speed" in answer.verdict
    assert not answer.refused


@pytest.mark.parametrize("name", ["A", "B"])
def test_the_gain_is_the_torque_ripple_over_that_of_the_load(name: str) -> None:
    """Of exact orbits; the load of set A is larger in a slow turn than at this speed."""
    speeds = "20:40:5"
    answer = ask("resonance", set=name, speeds=speeds, speed=40.0, steps_per_rev=512)
    drive = Drive.of(SETS[name].start(40.0))
    load = max(abs(drive.load_ripple(nu)) for nu in (0.0, 40.0))
    gain = answer.figures["gain_operating"]
    assert gain.error is not None
    assert abs(gain.value - abs(orbit(drive, 40.0).tau2) / load) <= gain.error < 0.01 * gain.value


def half_power(first: float, last: float, lag: float) -> float:
    """The speed [rad/s] at which exact orbits of set A have that lag [deg] behind the load."""

    def excess(nu: float) -> float:
        load = SETS["A"].load_ripple(nu)
        return float(np.angle(load / orbit(Drive(), nu).tau2, deg=True) % 360.0) - lag

    return float(brentq(excess, first, last, xtol=1e-6))


@pytest.mark.parametrize(("lag", "near", "inside"), [(45.0, 36.0, 1e-3), (135.0, 44.3, -1e-3)])
def test_on_resonance_ends_at_the_half_power_points_of_exact_orbits(
    lag: float, near: float, inside: float
) -> None:
    """At 45 and 135 degrees: yes on the inner side, no on the outer side."""
    end = half_power(near - 2.0, near + 2.0, lag)
    for shift, wanted in ((inside, "yes"), (-inside, "no")):
        answer = ask("resonance", speeds=SPEEDS, speed=end + shift, steps_per_rev=512)
        assert answers(answer)[0] == wanted


def test_no_claim_of_a_sweep_goes_beyond_the_speeds_that_have_an_orbit() -> None:
    """A long crank makes the drive stall at most speeds; a slow motor at all but the fastest."""
    long = ask("resonance", speeds="40,54,57,60,66", start={"conveyor.crank.r": 0.1})
    steady = int(long.first_table["tau2"].notna().sum())
    assert 1 < steady < 5
    assert (long.first_table["tau2"].dropna() > 50.0).all()
    slow = ask("resonance", speeds="30,40,50,60", start={"motor.T": 1e9})
    assert slow.first_table["tau2"].notna().sum() == 1
    reasons = ("the motor stalls at 40 rad/s", "no steady orbit is found at 40 rad/s")
    for answer, expected in zip((long, slow), reasons):
        assert answer.refused and answers(answer)[1] == "not determined"
        reason = answer.figures["tau2_operating"].reason
        assert reason == expected
        assert not answer.show().charts[0].spans


#: A crank that a spring stops at low speeds, and that takes short steps at others.
WEAK = {
    "conveyor.trough.m": 13.74, "conveyor.crank.r": 0.01659, "conveyor.rotor.J": 0.03411,
    "conveyor.spring.c": 55300.0, "conveyor.trough.d": 200.2, "motor.B": 1.361, "motor.T": 0.05053,
}  # fmt: skip


def test_a_resonance_among_speeds_without_an_orbit_is_not_said_to_be_outside_the_sweep() -> None:
    start = {
        "conveyor.trough.m": 8.316, "conveyor.crank.r": 0.003444, "conveyor.rotor.J": 0.001854,
        "conveyor.spring.c": 16220.0, "conveyor.trough.d": 9.264, "motor.B": 0.04909, "motor.T": 0.2075,
    }  # fmt: skip
    answer = ask(
        "resonance",
        speeds="4.998:10.34:5",
        speed=8.817,
        rated_torque=0.00122,
        steps_per_rev=256,
        start=start,
    )
    assert 4.998 < answer.figures["nu_res"].value < 6.334
    reason = answer.figures["nu_90"].reason
    assert reason.startswith("the motor stalls at 4.998 and 6.333 rad/s, and the other speeds")


def test_a_drive_that_stalls_everywhere_is_told_so_first() -> None:
    answer = ask("resonance", speeds="6:9:3", speed=7.0, steps_per_rev=256, start=WEAK)
    assert answer.figures["nu_90"].reason == "the motor stalls at every speed of the sweep"
    assert answer.refused


def test_rows_without_an_error_answer_nothing() -> None:
    """Jacobi with 128 steps is far from the truth: ripples of 200 N.m instead of 100 N.m."""
    answer = ask("resonance", speeds="36:44:5", steps_per_rev=128, algorithm="jacobi")
    assert answer.first_table["tau2"].max() > 150.0
    assert answers(answer) == ("not determined", "not determined")
    chart = answer.show().charts[0]
    assert not chart.spans


def test_an_overdamped_drive_has_no_resonance() -> None:
    """Beside a damping ratio of 1 / sqrt 2, where torque over load just has a peak, or none."""
    for lag, wanted in ((1.26e-3, False), (1.24e-3, True)):
        answer = ask("resonance", speeds="150:500:5", speed=283.0, start={"motor.T": lag})
        zeta = answer.figures["zeta"].value
        assert (zeta > 0.5**0.5) == wanted and zeta == pytest.approx(0.5**0.5, rel=1e-2)
        assert answers(answer)[0] == "no"
        assert answer.judgements[2].what.startswith("90 degree lag") == wanted
        assert answer.figures["nu_res"].meaning.startswith("90 deg lag" if wanted else "resonance")
        assert answer.figures["nu_90"].error is not None


def test_a_load_of_exactly_nothing_is_answered() -> None:
    """Without resistance the spring carries the trough at sqrt(c / m) = 60 rad/s."""
    start = {"conveyor.trough.d": 0.0}
    answer = ask("resonance", speeds="30:60:7", speed=60.0, start=start)
    ripple = answer.figures["tau2_operating"]
    assert abs(ripple.value) <= ripple.known_error < 1e-9
    assert answers(answer) == ("no", "yes")
    assert "the load ripple is almost zero at 60 rad/s" in answer.figures["lag_operating"].reason
    assert answer.figures["nu_90"].value == pytest.approx(40.0, rel=1e-3)


def test_a_limit_within_the_error_of_the_ripple_decides_nothing() -> None:
    ripple = ask("resonance", speeds=SPEEDS, steps_per_rev=128).figures["tau2_operating"].value
    answer = ask("resonance", speeds=SPEEDS, steps_per_rev=128, limit=ripple)
    assert answers(answer)[1] == "not determined"


def test_a_refused_answer_has_a_separate_exit_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = "run resonance --flavour native --jobs 1 --speeds 38:42:3 --algorithm jacobi"
    command += f" --steps-per-rev 128 --out {tmp_path}"
    assert main(command.split(), PROJECT, "scenarios") == REFUSED == 3
    assert ERROR_SCOPE in capsys.readouterr().out
    assert json.loads((tmp_path / "resonance.json").read_text())["refused"] is True
    assert str(code(ERROR_SCOPE)) in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(("lag", "overshoots"), [(1e-3, True), (2e-4, False)])
def test_a_mean_speed_overshoots_as_its_damping_says(lag: float, overshoots: bool) -> None:
    """Damping ratios of 0.79 and 1.8; the first overshoots after 5 / (2 pi) of a period."""
    start = {"motor.T": lag}
    answer = ask("mean_values", speeds="40", speed=40.0, start=start, steps_per_rev=1024)
    machine, figure = replace(SETS["A"], T=lag), answer.figures["overshoot"]
    rate = settling_rates(machine)[0]
    theory = 100 * math.exp(math.pi * rate.real / abs(rate.imag)) if overshoots else 0.0
    assert figure.error is not None and figure.error < 0.1
    assert figure.value == pytest.approx(theory, abs=0.2)


def test_a_mean_speed_that_still_rises_has_not_overshot() -> None:
    """A ripple as large as the mean slows the response, and the step response ends before its peak."""
    start = {
        "conveyor.trough.m": 286.0, "conveyor.crank.r": 0.01643, "conveyor.rotor.J": 0.8095,
        "conveyor.spring.c": 70410.0, "conveyor.trough.d": 797.4, "motor.B": 9.961, "motor.T": 0.08729,
    }  # fmt: skip
    answer = ask("mean_values", speeds="8.747", speed=5.831, start=start)
    mean = answer.tables["drift.csv"].frame["mean"].to_numpy()
    assert mean.argmax() == len(mean) - 1 and mean[-1] > 5.831
    assert "it still rises at the end of the run" in answer.verdict


def test_a_crank_that_stalls_has_no_overshoot() -> None:
    """A spring too stiff for its motor: the means are refused, and what the mean speed settles at."""
    start = {"motor.B": 14.0, "motor.T": 0.13, "conveyor.rotor.J": 0.1, "conveyor.spring.c": 2e6}
    answer = ask("mean_values", speeds="10", speed=11.0, start=start, steps_per_rev=256)
    assert answer.refused and answer.figures["overshoot"].error is None


def test_the_largest_deviation_carries_the_coupling_error_of_its_point() -> None:
    answer = ask("rod_force", speeds="25:55:7", springs="1e5:1e6:7", steps_per_rev=160)
    data, figure = answer.data, answer.figures["formula_off"]
    ratio = (data.table.frame["f_rod_formula"] / data.table.frame["f_rod"]).to_numpy()
    at = int(np.nanargmax(np.abs(ratio - 1.0)))
    point_error = (100 * ratio * data.table.frame["f_rod_error"] / data.table.frame["f_rod"])[at]
    assert figure.error is not None and figure.error >= 0.999 * point_error > 0.0


def test_a_motor_that_cannot_reach_a_high_resonance_does_not_stall() -> None:
    """A drive at 60 rad/s turns, though that is below a tenth of its 90 degree lag at 1000 rad/s."""
    answer = ask("run_up", set="A", start={"motor.T": 1e-4}, stop=0.3)
    assert "more time does not help" in answer.judgements[0].note


def test_a_motor_that_is_set_below_its_resonance_needs_no_more_time() -> None:
    """Both motors at 41 rad/s, the resonance at 46 rad/s; then the induction motor above it."""
    start = {
        "conveyor.trough.m": 176.6, "conveyor.crank.r": 0.004694, "conveyor.rotor.J": 0.004543,
        "conveyor.spring.c": 64290.0, "conveyor.trough.d": 2912.0, "motor.B": 0.5847, "motor.T": 0.01124,
        "motor.kloss.tau_b": 8.54,
    }  # fmt: skip
    for w_s, expected in ((41.0, [True, True]), (71.83, [True, False])):
        options = {"start": start | {"motor.kloss.w_s": w_s}}
        linear, kloss, *_ = ask("run_up", speed=42.1, stop=0.5, **options).judgements
        assert ["more time does not help" in x.note for x in (linear, kloss)] == expected


def test_an_induction_motor_is_not_compared_with_itself() -> None:
    """A breakdown slip that is the machine's own, or larger than it, leaves one case less."""
    answer = ask("induction_motor", slips="0.2,0.3", resistances="2000,8000")
    least = answer.figures["least_slip"]
    assert least.value < 0.2  # that of the data sheet
    assert not any("breakdown slip" in x.what for x in answer.judgements)


def test_a_crank_that_swings_across_its_resonance_has_not_passed_it() -> None:
    """The run ends 1.6 ms after the speed has risen through it once more, and a turn takes 0.1 s."""
    start = {
        "conveyor.trough.m": 74.55, "conveyor.crank.r": 0.005175, "conveyor.rotor.J": 0.002986,
        "conveyor.spring.c": 158600.0, "conveyor.trough.d": 781.3, "motor.B": 2.654, "motor.T": 0.0437,
    }  # fmt: skip
    answer = ask("run_up", speed=62.8, stop=0.81, step=2.5e-4, start=start)
    w = answer.tables["linear.csv"].frame["conveyor.w"].to_numpy()
    assert w[-1] > answer.figures["nu_res"].value
    assert answer.figures["linear_passing"].error is None
