"""The nameplate of a motor against an equivalent circuit of rotor resistance and leakage, from which it is drawn."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from cosim import SetupError
from scenarios.conveyor.first_order import SETS
from scenarios.motor import nameplate
from tests.conftest import ask

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


def test_kloss_has_the_rated_torque_at_the_rated_speed() -> None:
    start = nameplate(PLATE)
    s = 1.0 - 1440.0 / 1500.0
    s_b = start["motor.kloss.s_b"]
    torque = 2.0 * start["motor.kloss.tau_b"] / (s / s_b + s_b / s)
    assert torque == pytest.approx(3.43 * 5500.0 / (1440.0 * math.pi / 30), rel=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("5.5 kW, 1440 rpm, 50 Hz, 2.8", r"lacks poles \[poles\]: write it as"),
        (
            "5.5 kW, 1510 rpm, 50 Hz, 4 poles, 2.8",
            "speed = 1510 rpm must be below the synchronous speed of 1500 rpm",
        ),
        ("5.5 kW, 1440 rpm, 50 Hz, 4 poles, 0.9", "breakdown = 0.9 must be above 1"),
        ("5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, 3 m", "'3 m' cannot be read: write it as"),
        ("5.5 kW, 4 kW, 1440 rpm, 50 Hz, 4 poles, 2.8", "power is given twice"),
        ("5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, -1:1", "every number must be finite and above 0"),
        ("nan kW, 1440 rpm, 50 Hz, 4 poles, 2.8", "every number must be finite and above 0"),
        ("1e308 kW, 1440 rpm, 50 Hz, 4 poles, 2.8", "every number must be finite and above 0"),
        ("5.5 kW, 1440 rpm, 50 Hz, 4 poles, nan", "every number must be finite and above 0"),
        (
            "5.5 kW, 1440 rpm, 50 Hz, 2 poles, 2.8",
            "is a slip of 52 % of .* from 0.1 to 15 %: 2 poles, or 2 pole pairs",
        ),
        ("5.5 kW, 1 rpm, 50 Hz, 4 poles, 2.8", "is a slip of 99.9 % of .* from 0.1 to 15 %$"),
        ("5.5 kW, 1499.9 rpm, 50 Hz, 4 poles, 2.8", "is a slip of 0.00667 % of "),
        ("5.5 kW, 1440 rpm, 60 Hz, 4 poles, 2.8", "is a slip of 20 % of "),
        ("5.5 kW, 1440 rpm, 50 Hz, 3 poles, 2.8", "poles = 3 must be a whole even number"),
        ("5.5 kW, 1300 rpm, 50 Hz, 4 poles, 4.5", "gives a breakdown slip of 1.18, .* below 1"),
        ("5.5 kW, 1440 rpm, 50 Hz, 4 poles, 280", "breakdown = 280 must be above 1 and at most 6"),
    ],
)
def test_what_a_nameplate_cannot_be_is_a_line(text: str, message: str) -> None:
    with pytest.raises(SetupError, match=message):
        nameplate(text)


def test_a_question_about_ones_own_motor_is_asked_by_its_nameplate() -> None:
    start = {
        "conveyor.trough.m": 320.0, "conveyor.crank.r": 0.008, "conveyor.spring.c": 9e5,
    }  # fmt: skip
    answer = ask("resonance", nameplate=PLATE, speed="420rpm", start=start, steps_per_rev=128)
    assert answer.parameters["conveyor.rotor.J"].value == pytest.approx(0.02 * 3.43**2)
    assert answer.options["rated_torque"].value == pytest.approx(3.43 * 36.473, rel=1e-4)
    assert answer.judgements[0].answer == "yes"
    assert "conveyor.trough.d" in answer.verdict and "conveyor.rotor.J" not in answer.verdict
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


def test_a_frequency_beside_that_of_a_nameplate_is_refused() -> None:
    with pytest.raises(
        SetupError, match="frequency = 60 Hz contradicts the nameplate, which says 50 Hz"
    ):
        ask("induction_motor", nameplate=PLATE, frequency=60.0)
