"""The nameplate of a motor against an equivalent circuit of rotor resistance and leakage, from which it is drawn."""

from __future__ import annotations

import math
import re
import shlex
from argparse import ArgumentParser
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from scenarios.conveyor.first_order import SETS
from scenarios.motor import nameplate, read_nameplate
from scenarios.project import PROJECT
from tests.conftest import ROOT, ask
from workbench.options import add_arguments, parse_starts

PLATE = "5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, 3.43:1, 0.02 kg.m2"


def test_a_nameplate_gives_the_circuit_that_it_was_drawn_from() -> None:
    """Torque 3 p V^2 (R/s) / (w ((R/s)^2 + (w L)^2)); the flux of the rotor decays with L / R."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        R, f, p = rng.uniform(0.2, 2.0), rng.choice([16.7, 50.0, 60.0]), int(rng.integers(1, 5))
        L, w = R / (rng.uniform(0.08, 0.4) * 2 * math.pi * f), 2 * math.pi * f

        def torque(s: float, p: int = p, R: float = R, L: float = L, w: float = w) -> float:
            return 3 * p * 230.0**2 * (R / s) / (w * ((R / s) ** 2 + (w * L) ** 2))

        best = minimize_scalar(
            lambda s: -torque(s), bounds=(1e-3, 1.0), method="bounded", options={"xatol": 1e-10}
        )
        rated = rng.uniform(0.1, 0.37) * best.x
        speed, gear = (1 - rated) * w / p, rng.uniform(0.5, 5.0)
        text = (
            f"{float(torque(rated) * speed)!r} W, {float(speed)!r} rad/s, {float(f)!r} Hz, {2 * p} poles, "
            f"{float(torque(best.x) / torque(rated))!r}, "
            f"{gear!r}:1, 0.3 kg.m2"
        )
        start = nameplate(text, "m", "load.J")
        assert start["m.kloss.s_b"] == pytest.approx(best.x, rel=1e-6)
        assert start["m.kloss.tau_b"] == pytest.approx(gear * torque(best.x), rel=1e-9)
        assert start["m.kloss.w_s"] == pytest.approx(w / p / gear, rel=1e-12)
        assert start["m.T"] == pytest.approx(L / R, rel=1e-6)
        assert start["load.J"] == pytest.approx(0.3 * gear**2, rel=1e-12)
        energy = 0.5 * 0.3 * (w / p) ** 2  # of the rotor, the same on both sides of the gear
        assert 0.5 * start["load.J"] * start["m.kloss.w_s"] ** 2 == pytest.approx(energy, rel=1e-12)


def test_pole_pairs_are_two_poles_each_and_units_of_catalogues_are_read() -> None:
    other = "5.5 kW, 1440 1/min, 50 Hz, 2 pole pairs, 2.8, 3.43:1, 0.02 kgm2"
    assert nameplate(other) == pytest.approx(nameplate(PLATE), rel=1e-15)


def test_a_question_about_ones_own_motor_is_asked_by_its_nameplate() -> None:
    start = {
        "conveyor.trough.m": 320.0, "conveyor.crank.r": 0.008, "conveyor.spring.c": 9e5,
    }  # fmt: skip
    answer = ask("resonance", nameplate=PLATE, speed="420rpm", start=start, steps_per_rev=128)
    assert answer.parameters["conveyor.rotor.J"].value == pytest.approx(0.02 * 3.43**2)
    assert answer.options["rated_torque"].value == pytest.approx(3.43 * 36.473, rel=1e-4)
    assert answer.judgements[0].answer == "yes"
    (taken,) = (x for x in answer.judgements if x.what.startswith("taken from set A"))
    assert taken.note == "conveyor.trough.d"
    speeds = answer.options["speeds"].value
    assert (
        min(speeds)
        < 0.8 * answer.figures["nu_res"].value
        < 1.2 * answer.figures["nu_res"].value
        < max(speeds)
    )
    assert answer.figures["nu_90"].error is not None


@pytest.mark.parametrize(
    ("question", "options"),
    [
        ("resonance", {"speed": "420rpm", "speeds": "40,50", "steps_per_rev": 64}),
        ("run_up", {"stop": 0.2, "step": 1e-3}),
        ("induction_motor", {"resistances": "4000", "slips": "0.2", "steps_per_rev": 128}),
    ],
)
def test_a_lag_that_contradicts_the_slip_of_the_nameplate_is_named(
    question: str, options: dict[str, Any]
) -> None:
    for lag, is_named in ((0.0625, True), (0.0147, False)):
        answer = ask(question, nameplate=PLATE, start={"motor.T": lag}, **options)
        told = [x for x in answer.judgements if x.what == "motor.T is that of the breakdown slip"]
        assert [x.answer for x in told] == ["no"] * is_named, lag


def test_a_linear_motor_in_the_place_of_that_of_a_nameplate_has_its_resonance() -> None:
    """Its slope is that of the characteristic at a small slip, not that of the set."""
    answer = ask("run_up", nameplate=PLATE, stop=0.2, step=1e-3)
    start = nameplate(PLATE)
    b = start["motor.kloss.s_b"] * start["motor.kloss.w_s"]
    slip = 1e-6 * b
    torque = 2.0 * start["motor.kloss.tau_b"] * slip * b / (slip**2 + b**2)
    assert answer.parameters["motor.B"].value == pytest.approx(torque / slip, rel=1e-9)
    machine = SETS["B"].follow(start)
    assert answer.figures["nu_res"].value == pytest.approx(
        math.sqrt((torque / slip + machine.load_slope) / machine.theta0 / start["motor.T"]) / 2,
        rel=1e-9,
    )


FEEDER_PLATE = "7.5 kW, 970 rpm, 50 Hz, 6 poles, 2.6, 2.35:1, 0.05 kg.m2"
FEEDER = {
    "conveyor.trough.m": 180.0, "conveyor.crank.r": 0.012, "conveyor.spring.c": 9e5, "conveyor.trough.d": 1300.0,
}  # fmt: skip


def test_a_run_up_with_a_nameplate_is_about_its_motor_alone() -> None:
    """When it reaches its rated speed, its torque over the breakdown torque and at its own shaft, by an integration of its own."""
    answer = ask("run_up", nameplate=FEEDER_PLATE, start=FEEDER)
    start = nameplate(FEEDER_PLATE)
    m, r, c, d = (FEEDER[f"conveyor.{x}"] for x in ("trough.m", "crank.r", "spring.c", "trough.d"))
    J, T, w_s, s_b, tau_b = (
        float(start[x])
        for x in (
            "conveyor.rotor.J",
            "motor.T",
            *(f"motor.kloss.{x}" for x in ("w_s", "s_b", "tau_b")),
        )
    )
    speed = 970.0 * math.pi / 30 / 2.35

    def slope(_: float, state: Any) -> list[float]:
        phi, w, tau = state
        s = 1.0 - w / w_s
        sin, cos = math.sin(phi), math.cos(phi)
        load = r * cos * (d * r * w * cos + c * r * sin - m * r * w * w * sin)
        kloss = 2.0 * tau_b * s * s_b / (s * s + s_b * s_b)
        return [w, (tau - load) / (J + m * (r * cos) ** 2), (kloss - tau) / T]

    def reached(_: float, state: Any) -> float:
        return float(state[1] - speed)

    phi = answer.tables["kloss.csv"].frame["conveyor.phi"].iloc[0]
    run = solve_ivp(
        slope,
        (0.0, 1.0),
        [phi, 0.0, 0.0],
        "DOP853",
        events=reached,
        rtol=1e-11,
        atol=1e-11,
        max_step=1e-3,
    )
    time = answer.figures["kloss_reach"]
    assert time.error is not None and abs(time.value - run.t_events[0][0]) <= time.error < 1e-3
    most = answer.figures["kloss_tau_max"].value
    assert most == pytest.approx(run.y[2].max(), rel=1e-3)
    assert answer.figures["tau_motor_max"].value == pytest.approx(most / 2.35, rel=1e-12)
    weak = ask("run_up", nameplate=FEEDER_PLATE, start=FEEDER, speed=60.0).judgements[0]
    assert weak.answer == "no" and "the largest speed is" in weak.note


@pytest.mark.parametrize(
    ("question", "options", "parameter_set"),
    [
        ("resonance", {"speed": "420rpm", "speeds": "40,50", "steps_per_rev": 64}, "A"),
        ("run_up", {"stop": 0.2, "step": 1e-3, "set": "A"}, "A"),
        ("induction_motor", {"resistances": "4000", "slips": "0.2", "steps_per_rev": 128}, "B"),
    ],
)
def test_an_answer_tells_what_it_took_from_a_set_and_what_an_inertia_stands_for(
    question: str, options: dict[str, Any], parameter_set: str
) -> None:
    answer = ask(question, nameplate=PLATE, start={"conveyor.trough.m": 320.0}, **options)
    (taken,) = (x for x in answer.judgements if x.what.startswith("taken from set"))
    assert taken.what == f"taken from set {parameter_set} because not given"
    assert taken.note == "conveyor.crank.r, conveyor.spring.c, conveyor.trough.d"
    (inertia,) = (x for x in answer.judgements if x.what == "inertia at the crank")
    assert inertia.figure is not None and inertia.figure.value == pytest.approx(0.02 * 3.43**2)
    assert "crank, pulleys and flywheel weigh nothing here" in inertia.note
    sum_of_all = {"conveyor.trough.m": 320.0, "conveyor.rotor.J": 0.725}
    answer = ask(question, nameplate=PLATE, start=sum_of_all, **options)
    assert not any(x.what == "inertia at the crank" for x in answer.judgements)


def test_the_example_of_the_page_on_drives_is_computed_as_its_table_demands() -> None:
    """With the inertia of crank and pulley besides that of the rotor; the page's line, lag and speeds are the answer's."""
    page = (ROOT / "docs" / "drive.md").read_text(encoding="utf-8")
    command, *_ = re.findall(
        r"^\.venv/bin/scenarios run resonance (.*nameplate.*)$", page, re.MULTILINE
    )
    kind, parser = PROJECT.load("resonance"), ArgumentParser()
    add_arguments(parser, kind)
    given = {
        k: x for k, x in vars(parser.parse_args(shlex.split(command))).items() if x is not None
    }
    rotor = read_nameplate(given["nameplate"])
    inertia = 0.49 + rotor.ratio**2 * (rotor.inertia or math.nan)
    assert parse_starts(given["start"])["conveyor.rotor.J"] == pytest.approx(inertia, abs=5e-4)
    answer = ask("resonance", **given)
    assert f"> {answer.judgements[0].headline()}" in page.splitlines()
    f = answer.figures
    assert (
        f"The lag is {f['lag_operating'].value:.0f}° there, and 90° at {f['nu_90'].value:.2f} rad/s"
        in page
    )
    assert (
        f"below](#your-own-motor) at {f['nu_peak_tau'].value:.2f} instead of {f['nu_90'].value:.2f}"
        in page
    )
    bare = ask("resonance", **{name: x for name, x in given.items() if name != "start"})
    alone = bare.figures["nu_90"].value, bare.figures["tau2_operating"].value
    assert "at {:.2f} rad/s, and the ripple {:.2f} N m".format(*alone) in page


def test_a_speed_whose_ripple_is_stated_has_a_steady_orbit() -> None:
    """Of two motions that are sought one may be lost; the other one is told, and nothing says that there is none."""
    plate = "2.2 kW, 950 rpm, 50 Hz, 3 pole pairs, 2.1, 1.5:1, 0.01 kg.m2"
    answer = ask("resonance", nameplate=plate, speed=39.52, speeds="30,45,60", steps_per_rev=128)
    assert answer.figures["tau2_operating"].error is not None
    assert not any("No steady orbit at 39.52" in text for text in answer.warnings)
