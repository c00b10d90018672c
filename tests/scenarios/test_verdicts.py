"""Verdicts of the conveyor's questions say what their figures and rows say, and refuse the rest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from scenarios.__main__ import PROJECT
from scenarios.conveyor.theory import SETS
from tests.conftest import ask
from tests.scenarios.orbit_oracle import Drive, orbit
from workbench.answer import Answer
from workbench.command import REFUSED, main
from workbench.figure import ERROR_SCOPE

SPEEDS = "34:46:7"


def answers(answer: Answer) -> tuple[str, str]:
    """Both answers of the verdict of `resonance`: on resonance, ripple above its limit."""
    resonance, limit, *_ = answer.verdict.splitlines()
    starts = ("On resonance: ", "Torque ripple above its limit: ")
    for line, start in zip((resonance, limit), starts):
        assert line.startswith(start)
    return tuple(  # type: ignore[return-value]
        line.removeprefix(start).split(".")[0].split(",")[0]
        for line, start in zip((resonance, limit), starts)
    )


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ({}, ("yes", "yes")),
        ({"limit": 150.0}, ("yes", "no")),
        ({"limit": 1000.0}, ("yes", "no")),
        ({"speed": 45.0}, ("no", "yes")),
        ({"speed": 60.0, "limit": 5.0}, ("no", "yes")),
        ({"set": "B"}, ("no", "no")),
    ],
)
def test_resonance_and_limit_are_two_answers(
    options: dict[str, Any], wanted: tuple[str, str]
) -> None:
    """The title of the picture gives the same."""
    speeds = "20:40:5" if options.get("set") == "B" else SPEEDS
    answer = ask("resonance", speeds=speeds, steps_per_rev=128, **options)
    assert answers(answer) == wanted
    first, second = answer.show().charts[0].title.split(". ")
    assert (first.split(": ")[1], second.split(": ")[1]) == wanted
    figure, speed = answer.figures["nu_90_away"], answer.facts["operating_speed"]
    assert figure.value == answer.figures["nu_90"].value - speed
    assert figure.error == answer.figures["nu_90"].error
    size = figure._replace(value=abs(figure.value)).brief()
    side = "above" if figure.value > 0.0 else "below"
    assert (
        f"{size} ({100 * abs(figure.value) / speed:.3g} %) {side} the operating" in answer.verdict
    )
    assert not answer.refused


def half_power(first: float, last: float, lag: float) -> float:
    """The speed [rad/s] at which exact orbits of set A have that lag [deg] behind the load."""

    def away(nu: float) -> float:
        load = SETS["A"].load_ripple(nu)
        return float(np.angle(load / orbit(Drive(), nu).tau2, deg=True) % 360.0) - lag

    return float(brentq(away, first, last, xtol=1e-6))


@pytest.mark.parametrize(("lag", "near", "inside"), [(45.0, 36.0, 1e-3), (135.0, 44.3, -1e-3)])
def test_on_resonance_ends_at_the_half_power_points_of_exact_orbits(
    lag: float, near: float, inside: float
) -> None:
    """At 45 and 135 degrees: yes on the inner side, no on the outer side."""
    end = half_power(near - 2.0, near + 2.0, lag)
    for shift, wanted in ((inside, "yes"), (-inside, "no")):
        answer = ask("resonance", speeds=SPEEDS, speed=end + shift, steps_per_rev=256)
        assert answers(answer)[0] == wanted


def test_no_claim_of_a_sweep_goes_beyond_the_speeds_that_have_an_orbit() -> None:
    """A long crank makes the drive stall at most speeds; a slow motor at all but the fastest."""
    long = ask("resonance", speeds="40,54,57,60,66", start={"conveyor.crank.r": 0.1})
    steady = int(long.table["tau2"].notna().sum())
    assert 1 < steady < 5
    assert (long.table["tau2"].dropna() > 50.0).all()
    assert f"above the limit at each of the {steady} of 5 speeds that have a steady" in long.verdict
    assert f"No steady orbit is found at {5 - steady} of the 5 speeds." in long.verdict
    slow = ask("resonance", speeds="30,40,50,60", start={"motor.T": 1e9})
    assert slow.table["tau2"].notna().sum() == 1
    assert "below the limit at the only one of 4 speeds at which it is determined" in slow.verdict
    for answer in (long, slow):
        assert "every speed" not in answer.verdict
        assert answer.refused and answers(answer)[1] == "not determined"
        reason = answer.figures["tau2_operating"].reason
        assert reason == "no steady orbit is found at 40 rad/s"
        assert answer.show().charts[0].title.endswith(f"not determined ({reason})")
        assert not answer.show().charts[0].spans


def test_rows_without_an_error_answer_nothing() -> None:
    """Jacobi with 128 steps is far from the truth: ripples of 200 N.m instead of 100 N.m."""
    answer = ask("resonance", speeds="36:44:5", steps_per_rev=128, algorithm="jacobi")
    assert answer.table["tau2"].max() > 150.0
    assert answers(answer) == ("not determined", "not determined")
    assert "every speed" not in answer.verdict and "Avoid" not in answer.verdict
    chart = answer.show().charts[0]
    assert not chart.spans and chart.title.count("not determined") == 2


def test_an_overdamped_drive_has_no_resonance() -> None:
    """Beside a damping ratio of 1 / sqrt 2, where torque over load just has a peak, or none."""
    for lag, wanted in ((1.26e-3, False), (1.24e-3, True)):
        answer = ask("resonance", speeds="150:500:5", speed=283.0, start={"motor.T": lag})
        zeta = answer.figures["zeta"].value
        assert (zeta > 0.5**0.5) == wanted and zeta == pytest.approx(0.5**0.5, rel=1e-2)
        assert ("The drive has no resonance" in answer.verdict) == wanted
        assert ("that is no resonance" in answer.verdict) == wanted
        assert answers(answer)[0] == ("no" if wanted else "yes")
        assert answer.figures["nu_res"].meaning.startswith("90 deg lag" if wanted else "resonance")
        assert answer.figures["nu_90"].error is not None


def test_a_load_of_exactly_nothing_is_answered() -> None:
    """Without resistance the spring carries the trough at sqrt(c / m) = 60 rad/s."""
    start = {"conveyor.trough.d": 0.0}
    answer = ask("resonance", speeds="30:60:7", speed=60.0, start=start)
    assert answer.figures["tau2_operating"].value == 0.0
    assert answers(answer) == ("not determined", "no")
    assert "the load ripple nearly vanishes at 60 rad/s" in answer.figures["lag_operating"].reason
    assert answer.figures["nu_90"].value == pytest.approx(40.0, rel=1e-3)


def test_a_limit_within_the_error_of_the_ripple_decides_nothing() -> None:
    ripple = ask("resonance", speeds=SPEEDS, steps_per_rev=128).figures["tau2_operating"].value
    answer = ask("resonance", speeds=SPEEDS, steps_per_rev=128, limit=ripple)
    assert answers(answer)[1] == "not determined"
    assert "because the limit lies within the error" in answer.verdict


def test_a_refused_answer_has_its_own_exit_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, (words, refused) in enumerate(
        (("--steps-per-rev 128", False), ("--algorithm jacobi --steps-per-rev 128", True))
    ):
        out = tmp_path / str(number)
        command = f"run resonance --flavour native --jobs 1 --speeds 38:42:3 {words} --out {out}"
        assert main(command.split(), PROJECT, "scenarios") == (REFUSED if refused else 0)
        assert ERROR_SCOPE in capsys.readouterr().out
        assert json.loads((out / "resonance.json").read_text())["refused"] is refused
        assert ERROR_SCOPE in (out / "report.html").read_text().replace("&#39;", "'")
    assert REFUSED == 3
