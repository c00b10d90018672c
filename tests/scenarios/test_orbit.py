"""Steady orbits, and the figures that the resonance states of them, against exact orbits."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import cosim
from scenarios.conveyor import machine as drives
from scenarios.conveyor.drive_orbits import CRANK_TURN
from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.orbit import Drive as Runs
from scenarios.conveyor.questions import resonance
from scenarios.motor import nameplate
from tests.conftest import ask, fmus_of
from tests.scenarios import shooting
from tests.scenarios.orbit_oracle import (
    Drive,
    f_rod_peak,
    orbit,
    random_drive,
    resampled,
)
from tests.scenarios.orbit_oracle import (
    features as exact_features,
)
from workbench import Context, steady
from workbench.figure import Figure
from workbench.orbits import Motions
from workbench.steady import STALLED, at_angles, return_maps

FIGURES = ("nu_90", "nu_peak_tau", "tau2_peak", "nu_peak_w", "w2_peak", "f_rod_peak")
FMUS = fmus_of(resonance)


def answer_for(
    drive: Drive, first: float, last: float, number: int, limit: float = 50.0
) -> dict[str, Figure]:
    """The figures of the scenario for a drive, a sweep and a limit of the torque ripple [N.m]."""
    options = {"speeds": f"{first}:{last}:{number}", "start": drive.start, "speed": first}
    return dict(ask("resonance", **options, limit=100.0, rated_torque=limit).figures)


def held(figure: Figure, truth: float | None) -> float:
    """Error over stated error; inf for a figure of something that does not exist."""
    assert figure.error is None or figure.error > 0.0
    if figure.error is None:
        assert figure.reason and math.isnan(figure.value)
        return math.nan
    if truth is None:
        return math.inf
    return max(0.0, abs(figure.value - truth) - 1e-9 * abs(truth)) / figure.error


def test_a_sharp_resonance_between_the_points_of_the_sweep_is_located() -> None:
    drive = Drive(B=4230, T=0.247, J=1.86, m=15.4, r=0.0316, c=0.0, d=16.8)
    stated = answer_for(drive, 29, 72, 11)
    for name, exact in exact_features(drive, 29.0, 72.0).items():
        assert held(stated[name], exact) <= 1.0
        assert stated[name].error < 1e-3 * exact


PUSH_AND_PULL = Drive(B=40720.0, T=0.04009, J=15.55, r=0.04312, m=164.5, d=200300.0, c=1.47e7,
                      l=0.2662, finite=True)  # fmt: skip
TWICE_A_TURN = Drive(l=0.03, d=40.0, c=722922.5, finite=True)


@pytest.mark.parametrize(
    ("drive", "speed", "steps"),
    [(PUSH_AND_PULL, 205.0, 512), (TWICE_A_TURN, 60.0, 128)],
    ids=["of either sense", "of the same sense"],
)
def test_of_two_nearly_equal_peaks_of_the_rod_force_each_converges_by_itself(
    drive: Drive, speed: float, steps: int
) -> None:
    """One is the larger with long steps, the other with short ones."""
    answer = ask("resonance", speeds=[speed], speed=speed, steps_per_rev=steps, start=drive.start)
    figure = answer.figures["f_rod_peak"]
    assert held(figure, f_rod_peak(drive, [speed])) <= 1.0
    assert figure.error is not None and figure.error < 1e-4 * figure.value


def motions_of(nu: Any, steps_per_rev: int = 512, multiples: int = 1, **start: float) -> Motions:
    """Motions of set A at speeds; names have two underscores for a dot."""
    changes = {name.replace("__", "."): value for name, value in start.items()}
    drive = Runs(Context(FMUS), "strang", steps_per_rev)
    return drive.motions(SETS["A"].follow(changes), nu, multiples)


def amplitudes(motions: Motions, name: str) -> Any:
    """Complex amplitudes of order 2, with each step size."""
    size, phase = (motions.columns[x].steps for x in (name, f"{name}_phase"))
    return size * np.exp(1j * np.radians(phase))


def test_orbits_are_those_of_an_independent_solver() -> None:
    """With the phase of each; several speeds and step sizes side by side."""
    speeds = np.array([24.0, 40.0, 57.0])
    found = motions_of(speeds, 512, 3)
    exact = [orbit(Drive(), nu) for nu in speeds]
    torque, truth = amplitudes(found, "tau2"), np.array([x.tau2 for x in exact])
    assert_allclose(torque[0], truth, rtol=1e-3)
    assert_allclose(amplitudes(found, "w2")[0], [x.w2 for x in exact], rtol=1e-3)
    for k, error in enumerate(abs(torque - truth)):
        assert_allclose(error, 4.0**k * abs(torque[0] - truth), rtol=0.1)


def test_the_share_that_a_revolution_leaves_is_that_of_the_eigenvalues() -> None:
    rates = abs(orbit(Drive(), 60.0).multipliers)
    assert motions_of(60.0).multipliers[0] == pytest.approx(rates.max(), rel=1e-3)


def test_a_motor_that_stalls_has_no_orbit() -> None:
    stalled = motions_of(5.0, motor__B=1.0)
    assert stalled.problems[0] == STALLED and np.isnan(stalled.columns["speed"].value)
    answer = ask("resonance", speeds="3,4,5", start=["motor.B=1"], speed=3.0)
    assert all(answer.figures[name].error is None for name in FIGURES)
    zeta = answer.figures["zeta"].value
    assert zeta > math.sqrt(0.5)
    assert [warning[:27] for warning in answer.warnings] == [
        f"No steady orbit at {nu} rad/s:" for nu in (3, 4, 5)
    ]


def test_a_start_from_which_the_crank_stalls_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first Newton step that leads far too low, as a return map far from linear may."""
    wrong = []

    def too_far(differences: Any) -> Any:
        jacobian, contraction = return_maps(differences)
        wrong.append(len(wrong))
        return jacobian - (len(wrong) == 1) * np.array([[1e4, 0.0], [0.0, 0.0]]), contraction

    monkeypatch.setattr(steady, "return_maps", too_far)
    found = motions_of(40.0)
    assert len(wrong) > 1 and not found.problems.any()
    assert_allclose(amplitudes(found, "tau2")[0, 0], orbit(Drive(), 40.0).tau2, rtol=1e-3)


def test_an_orbit_that_deviations_leave_is_refused() -> None:
    """A rotor on a torque that grows with its speed: the steady speed is there and not held."""
    line = {"motor.A": 45.0 - 60.0, "motor.B": 0.0, "conveyor.trough.d": 0.0}
    turns = steady.steady_turns(
        cosim.System(FMUS, drives.WIRES, line),
        {"conveyor.w": np.array([40.0]), "motor.tau": np.array([0.0])},
        ("conveyor.w", "motor.tau"),
        "conveyor.phi",
        np.array([40.0]),
        steps_per_rev=128,
        record=(),
    )
    assert (
        steady.GROWS in turns.problems[0]
        and np.isnan(turns.values).all()
        and np.isnan(turns.periods).all()
    )


def test_values_between_rows_lie_on_the_polynomial_through_them() -> None:
    """Of crank speeds that rise and fall, at angles of rows and between them, to the ends."""
    k = np.arange(60.0)
    phi = np.stack([0.15 * k + 0.02 * np.sin(0.1 * k), 0.2 * k - 0.1 * np.cos(0.15 * k)])
    wanted = np.array([[x[0], 1.2345, x[30], x[-1] - 0.01] for x in phi])
    values = np.stack([np.sin(phi), np.ones_like(phi), 3.0 * phi], axis=2)
    rows, found = at_angles(phi, values, wanted)
    assert_allclose(
        found, np.stack([np.sin(wanted), np.ones((2, 4)), 3.0 * wanted], axis=2), atol=1e-12
    )
    assert_allclose(rows[:, [0, 2]], [[0.0, 30.0]] * 2, atol=1e-12)


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        (["conveyor.trough.d=1", "motor.T=0.0278"], "the load ripple is almost zero there"),
        (
            [],
            "The sweep from 50 to 70 rad/s leaves out the resonance, at 40 rad/s by formula (22).",
        ),
    ],
)
def test_a_lag_that_means_nothing_or_is_missing_is_refused(start: list[str], reason: str) -> None:
    """Without damping the load falls to nothing at sqrt(c/m), where it turns by 180 degrees."""
    answer = ask("resonance", speeds="50:70:11", speed=60.0, start=start)
    assert answer.figures["nu_90"].error is None


def test_an_induction_motor_is_linearised_at_its_working_point() -> None:
    kloss = SETS["B"].follow({"motor.characteristic": "kloss"})
    machine, start = drives.linearised(kloss, 40.0), drives.start_values(kloss, 40.0)
    tau_b, s_b, w_s = 190.0, start["motor.kloss.s_b"], start["motor.kloss.w_s"]

    def torque(w: float) -> float:
        s = 1.0 - w / w_s
        return 2 * tau_b * s * s_b / (s**2 + s_b**2)

    assert torque(40.0) == pytest.approx(SETS["B"].load_slope * 40.0)
    slope = (torque(40.0 - 1e-4) - torque(40.0 + 1e-4)) / 2e-4
    assert pytest.approx(slope, rel=1e-6) == machine.B
    assert pytest.approx(SETS["B"].B, rel=0.02) == machine.B
    with pytest.raises(cosim.SetupError, match=r"tau_b = 1\.0 N\.m must be above 8"):
        drives.require_torque(kloss.follow({"motor.kloss.tau_b": 1.0}), 40.0)


@pytest.mark.parametrize(
    "motor", [{}, {"motor.characteristic": 1, "motor.kloss.tau_b": 1000.0}], ids=["linear", "kloss"]
)
def test_many_machines_in_one_batch_answer_as_each_does_alone(motor: dict[str, Any]) -> None:
    """One of them is refused, and one with a motor that stalls, and neither costs the others anything."""
    changes = [
        {}, {"motor.T": 0.05}, {"conveyor.trough.m": 250.0, "conveyor.rod.l": 0.5},
        {"motor.T": -1.0}, {"motor.kloss.tau_b": 1.0, "motor.B": 1.0},
    ]  # fmt: skip
    questions = [
        resonance.Resonance.parse({
            "speeds": "24:52:8", "steps_per_rev": 128, "speed": 30.0 + k, "start": {**motor, **x},
        })
        for k, x in enumerate(changes)
    ]  # fmt: skip
    found = resonance.Resonance.solve_all(Context(FMUS), questions)
    refused = [isinstance(x, cosim.SetupError) for x in found]
    assert refused == [False, False, False, True, bool(motor)]
    assert "motor.T" in str(found[3])
    for asked, of_batch in zip(questions, found):
        if isinstance(of_batch, cosim.SetupError):
            continue
        alone = asked.solve(Context(FMUS)).figures
        assert alone.keys() == of_batch.figures.keys()
        for name, figure in alone.items():
            x = of_batch.figures[name]
            assert x.reason == figure.reason, name
            assert (x.error or 0.0) == pytest.approx(figure.error or 0.0, rel=1e-3), name
            near = 1e-3 * (figure.error or 0.0) + 1e-12 * abs(figure.value)
            assert x.value == pytest.approx(figure.value, abs=near, nan_ok=True), name
    values = [x.figures["nu_90"].value for x in found[:3]]
    assert len(set(values)) == 3


def test_the_resonance_of_an_induction_motor_lies_near_that_of_its_line() -> None:
    """With a light trough the ripple is small, and the characteristic is its tangent."""
    light = ["conveyor.trough.m=2", "conveyor.spring.c=7200", "conveyor.trough.d=40"]
    estimates = ask(
        "resonance", set="B", speeds="20:45:9", start=[*light, "motor.characteristic=kloss"]
    ).figures
    assert estimates["nu_90"].error is not None
    assert estimates["nu_90"].value == pytest.approx(estimates["nu_res"].value, rel=1e-3)


def test_rows_carry_errors_that_hold(tmp_path: Path) -> None:
    answer = ask("resonance", speeds="34:46:4", out=tmp_path)
    for row in answer.tables["resonance.csv"].frame.itertuples():
        exact = orbit(Drive(), row.nu)
        for value, error, true in (
            (row.tau2, row.tau2_error, abs(exact.tau2)),
            (row.w2, row.w2_error, abs(exact.w2)),
            (row.f_rod_peak, row.f_rod_peak_error, exact.f_rod_max),
        ):
            assert 0.0 < error < 1e-3 * true
            assert abs(value - true) <= error


MAINS = {"motor.characteristic": "kloss", "motor.kloss.w_s": 45.81, "motor.kloss.s_b": 0.2166,
         "motor.kloss.tau_b": 120.0}  # fmt: skip


def kloss_torque(w: float, start: dict[str, Any]) -> float:
    s, s_b = 1.0 - w / start["motor.kloss.w_s"], start["motor.kloss.s_b"]
    return float(2.0 * start["motor.kloss.tau_b"] * s * s_b / (s**2 + s_b**2))


@pytest.mark.parametrize("more", [{}, {"motor.kloss.w_s": 62.0, "conveyor.trough.d": 9000.0}])
def test_on_the_mains_the_speed_is_where_the_torques_balance(more: dict[str, Any]) -> None:
    """A slip of the wrong sign would be a generator, and the torque a brake: no load would be carried."""
    start = MAINS | more
    answer = ask("resonance", speeds="30:70:5", supply="mains", start=start)
    speed, figure = answer.facts["operating_speed"], answer.figures["w_operating"]
    load = SETS["A"].follow(start).load_slope * speed
    assert speed < start["motor.kloss.w_s"]
    assert kloss_torque(speed, start) == pytest.approx(load, rel=1e-9)
    for name in ("motor.kloss.w_s", "motor.kloss.s_b", "motor.kloss.tau_b"):
        assert answer.parameters[name].value == start[name]
    # The drive on this supply, run until it turns evenly: its mean speed, and what the motor gives is lost.
    machine = SETS["A"].follow(start)
    values = {**machine.start(speed), **start}
    run = cosim.run(drives.conveyor_drive(FMUS, values), stop=4.0, step=2e-4)
    phi, t = run["conveyor.phi"], run["time"]
    turns = np.interp(phi[-1] - 2.0 * math.pi * np.array([10.0, 0.0]), phi, t)
    mean = 20.0 * math.pi / (turns[1] - turns[0])
    assert figure.error is not None and mean == pytest.approx(figure.value, rel=1e-6)
    last = t >= turns[0]
    given, lost = (
        np.trapezoid(run[name][last], t[last]) for name in ("motor.P", "conveyor.P_loss")
    )
    assert given > 0.0 and given == pytest.approx(lost, rel=5e-3)


@pytest.mark.parametrize(
    ("options", "start", "message"),
    [
        ({"speed": 40.0}, MAINS, "speed = 40 rad/s cannot be chosen"),
        ({}, {}, "needs an induction motor, motor.characteristic=kloss"),
        ({}, MAINS | {"motor.kloss.tau_b": 5.0}, "the load pulls the motor out"),
    ],
)
def test_a_supply_that_cannot_be_is_refused(
    options: dict[str, Any], start: dict[str, Any], message: str
) -> None:
    with pytest.raises(cosim.SetupError, match=re.escape(message)):
        ask("resonance", speeds="38:42:3", supply="mains", start=start, **options)


def test_an_inverter_is_told_and_the_parameters_are_those_at_the_operating_speed() -> None:
    answer = ask("resonance", speeds="36:60:4", speed="420rpm", start=MAINS)
    w_s, s_b = (answer.parameters[f"motor.kloss.{x}"].value for x in ("w_s", "s_b"))
    at = {**MAINS, "motor.kloss.w_s": w_s, "motor.kloss.s_b": s_b}
    nu = 14.0 * math.pi
    assert kloss_torque(nu, at) == pytest.approx(SETS["A"].load_slope * nu, rel=1e-9)
    assert w_s * s_b == pytest.approx(45.81 * 0.2166, rel=1e-12)
    plain = ask("resonance", speeds="36:60:4")
    assert "supply" not in plain.verdict


def test_a_speed_whose_rod_force_has_no_error_matters_where_it_may_be_the_largest() -> None:
    """Around the sharp resonance of this drive the errors of the smaller forces are not known."""
    drive = Drive(B=26.57, T=0.7192, J=0.01097, r=0.02606, m=3.918, d=0.1768, c=3488.0)
    speeds = np.linspace(17.8, 39.1, 29)
    answer = ask("resonance", start=drive.start, speeds="17.8:39.1:29", speed=39.1)
    assert not np.isfinite(answer.tables["resonance.csv"].columns["f_rod_peak_error"]).all()
    assert held(answer.figures["f_rod_peak"], f_rod_peak(drive, speeds)) <= 1.0


def test_an_orbit_that_is_found_and_not_held_is_told_as_that() -> None:
    """A motor whose lag is thirty times that of its plate does not hold the crank above the resonance."""
    plate = "5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, 3.43:1, 0.02 kg.m2"
    answer = ask("resonance", nameplate=plate, start=["motor.T=0.5"], speeds="20", speed=20.0)
    assert answer.warnings[0].endswith(steady.UNSTABLE)


#: A motor of 7.5 kW on a light rotor, of which the ripple reaches the breakdown slip.
TWO_MOTIONS = "7.5 kW, 736 rpm, 50 Hz, 8 poles, 3.5, 1.31:1, 0.032 kg.m2"


#: A motor that accelerates and brakes its crank within a turn, whose rows make more noise than the last changes of a search.
UNEVEN = "13.4 kW, 946 rpm, 50 Hz, 6 poles, 2.22, 3.64:1"
UNEVEN_CONVEYOR = {
    "conveyor.rotor.J": 0.2814, "conveyor.crank.r": 0.0138, "conveyor.trough.m": 288.7, "conveyor.trough.d": 9218.0,
    "conveyor.spring.c": 1.647e7,
}  # fmt: skip


@pytest.mark.parametrize(
    ("plate", "start", "speeds", "several"),
    [
        (TWO_MOTIONS, {}, [78.0, 86.0], [86.0]),
        (UNEVEN, UNEVEN_CONVEYOR, [97.3, 127.6, 158.0], []),
    ],
)
def test_every_stable_motion_that_shooting_finds_is_stated(
    plate: str, start: dict[str, Any], speeds: list[float], several: list[float]
) -> None:
    """From states drawn at random, by Newton's method on the map of a revolution of equations of its own."""
    options = {"nameplate": plate, "start": start, "rated_torque": 200.0, "speed": speeds[-1]}
    answer = ask("resonance", speeds=",".join(map(str, speeds)), **options)
    fed = drives.start_values(SETS["A"].follow({**nameplate(plate), **start}), np.array(speeds))
    drive, motor = Drive.of(fed), shooting.Motor.of(fed)
    states = np.random.default_rng(1).uniform(
        [[[0.3]], [[-0.5]]], [[[1.3]], [[1.0]]], (2, len(speeds), 30)
    )
    sought = shooting.stable_motions(drive, motor, states * motor.size[..., None])
    assert [nu for nu, found in zip(speeds, sought) if len(found) > 1] == several
    frames = [
        answer.tables[name].frame
        for name in ("resonance_motions.csv", "resonance.csv")
        if name in answer.tables
    ]
    for nu, found in zip(speeds, sought):
        stated = (
            pd.concat([x[np.isclose(x["nu"], nu)] for x in frames])
            .drop_duplicates("tau2")
            .sort_values("tau2")
        )
        assert len(stated) == len(found) > 0, nu
        for row, truth in zip(stated[::-1].itertuples(), found):
            assert abs(row.tau2 - abs(truth.tau2)) <= row.tau2_error < 1e-3 * abs(truth.tau2), nu
            lag = np.angle(drive.load_ripple(nu) / truth.tau2, deg=True) % 360.0
            assert abs(row.lag - lag) <= row.lag_error < 0.1, nu
            if nu in several:
                assert row.multiplier == pytest.approx(truth.multiplier, rel=1e-2)


def test_of_two_steady_motions_the_one_with_the_larger_ripple_is_judged_and_both_are_named() -> (
    None
):
    """The slope of the motor at its working point leads to the harmless one."""
    answer = ask(
        "resonance", nameplate=TWO_MOTIONS, speed=86.0, rated_torque=200.0, speeds="70,78,86"
    )
    assert answer.figures["tau2_operating"].value == pytest.approx(117.25, abs=0.01)
    assert answer.verdict.startswith("Avoid 86 rad/s")
    (told,) = [x.text() for x in answer.judgements if "two steady motions" in x.what]
    assert "117.2 N.m and a lag of 121 deg" in told and "75.01 N.m and a lag of 12 deg" in told


def test_where_a_branch_ends_the_ripple_jumps_and_there_is_no_peak() -> None:
    """Its two motions are both there from about 81.2 to 88.4 rad/s."""
    answer = ask(
        "resonance",
        nameplate=TWO_MOTIONS,
        speed=70.0,
        rated_torque=200.0,
        speeds="70,78,84,88,92,100",
    )
    for name in ("nu_peak_tau", "tau2_peak", "avoid_from"):
        assert "one of two steady motions ends between 81" in answer.figures[name].reason
    (told,) = [x.text() for x in answer.judgements if "two steady motions" in x.what]
    assert "ends between 88" in told


@pytest.mark.parametrize("start", [{}, {"motor.kloss.tau_b": 1000.0, "motor.kloss.w_s": 46.0}])
def test_a_characteristic_that_hardly_bends_has_one_motion(start: dict[str, Any]) -> None:
    more = {"motor.characteristic": "kloss"} if start else {}
    answer = ask("resonance", speeds="30:50:5", steps_per_rev=128, start={**start, **more})
    assert "resonance_motions.csv" not in answer.tables


def test_a_linear_motor_has_one_motion_from_wherever_it_is_sought_be_it_from_itself() -> None:
    nu = np.array([34.0, 39.0, 44.0])
    states = np.stack([nu * 0.8, np.full(3, 120.0)], axis=1)
    drive = Runs(Context(FMUS), "strang", 128)
    near = drive.motions(SETS["A"], nu)
    far = CRANK_TURN.motions(drive.context, drive.asked(SETS["A"], nu), states, 1)
    assert_allclose(far.states, near.states, rtol=1e-6)
    again = CRANK_TURN.motions(drive.context, drive.asked(SETS["A"], nu), near.states, 1)
    exact = [np.abs(orbit(Drive(), x).multipliers).max() for x in nu]
    assert_allclose(again.multipliers, exact, rtol=2e-2)


@pytest.mark.parametrize("seed", range(3))
def test_the_figures_of_a_turn_are_those_of_an_exact_orbit(seed: int) -> None:
    drive = random_drive(np.random.default_rng([7, seed]))
    nu = 0.7 * drive.nu_res
    exact = orbit(drive, nu)
    answer = ask("orbit", start=drive.start, speed=nu)
    for name, truth in (
        ("tau2", abs(exact.tau2)), ("w2", abs(exact.w2)), ("lag", exact.lag), ("f_rod_peak", exact.f_rod_max),
        ("angle", nu + float(np.mean(exact.v))), ("speed", exact.mean_speed),
    ):  # fmt: skip
        figure = answer.figures[name]
        assert held(figure, truth) <= 1.0, name
        assert figure.error is not None and figure.error < 3e-3 * abs(truth), name
    power = [answer.figures[x] for x in ("supply", "trough", "motor")]
    left = power[0].value - power[1].value - power[2].value
    assert abs(left) <= sum(x.error or math.nan for x in power)
    (motion,) = answer.data
    w = motion.turn["conveyor.w"]
    assert_allclose(w, nu + resampled(exact.v, len(w)), rtol=1e-3)
    assert motion.multiplier == pytest.approx(np.abs(exact.multipliers).max(), rel=1e-2)


def test_a_turn_has_both_motions_of_an_induction_motor_each_with_its_multiplier() -> None:
    """At one speed, without a sweep, from the orbits of softer motors."""
    start = {
        f"motor.kloss.{x}": y
        for x, y in (("tau_b", 446.1636), ("s_b", 0.1279432), ("w_s", 59.95406))
    }
    start |= {
        "motor.characteristic": "kloss",
        "motor.T": 0.024878993,
        "conveyor.rotor.J": 0.0549152,
    }
    answer = ask("orbit", start=start, speed=86.0, rated_torque=200.0)
    ripples = [x.figures["tau2"].value for x in answer.data]
    assert_allclose(ripples, [117.25, 75.01], atol=0.01)
    assert all(0.0 < x.multiplier < 0.5 for x in answer.data)
    assert "another steady motion: 75.01 N.m" in answer.verdict
