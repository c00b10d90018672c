"""What the questions about the sealing iron say, against references that know no FMU."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from components.iron_drive import model as iron
from cosim import SetupError
from fmukit.declare.record import start
from scenarios.iron import transfer as kinematics
from tests.components.iron_oracle import (
    DIMENSIONS,
    Reference,
    transfer,
)
from tests.conftest import CASES, ask, question_of
from tests.oracle import by_name

FUNCTIONS = list(kinematics.FUNCTIONS)[:6]


def largest(function: Any, last: float) -> float:
    """The largest absolute value of a function from 0 on, near the best of 16 places."""
    angles = np.linspace(0.0, last, 17)
    best = max(angles[1:-1], key=lambda x: abs(float(function(x))))
    ends = best - angles[1], best + angles[1]
    optimum = minimize_scalar(
        lambda x: -abs(float(function(x))), bounds=ends, method="bounded", options={"xatol": 1e-6}
    )
    return float(-optimum.fun)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "dimension", ["cam.R_b", *(pytest.param(x, marks=SLOW) for x in ("rocker.l", "sprocket.C"))]
)
def test_iron_kinematics_and_its_shares_are_those_of_the_papers_formulas(dimension: str) -> None:
    """Largest on the return, which is a rise backwards; derivatives with 30 digits."""
    answer = ask("iron_cycle", compare="dimensions", samples=360)
    shares = answer.tables["iron_kinematics_shares.csv"].frame
    parameters = by_name(start(iron.Parameters))
    last = parameters["cam.ret"]
    values = {name: parameters[name] for name in DIMENSIONS} | {"cam.rise": last}
    index = list(DIMENSIONS).index(dimension)
    for k, name in enumerate(FUNCTIONS):

        def value(phi: float, share: Any = 1, k: int = k) -> Any:
            arguments = [mpmath.mpf(x) for x in values.values()]
            arguments[index] *= share
            return transfer(0)(mpmath.mpf(phi), *arguments)[k]

        def slope(phi: float, value: Any = value) -> float:
            with mpmath.workdps(30):
                h = mpmath.mpf("1e-8")
                return float((value(phi, 1 + h) - value(phi, 1 - h)) / (2 * h))

        top, figure = largest(value, last), answer.figures[f"{name.lower()}_max"]
        assert figure.error and figure.error < 1e-4 * figure.value
        assert abs(figure.value - top) <= figure.error
        row = shares[(shares["dimension"] == dimension) & (shares["function"] == name)].iloc[0]
        assert row["change_error"] < 1e-3 * row["change"] + 1e-8
        wanted = largest(slope, last) / top
        assert abs(row["change"] - wanted) <= row["change_error"] + 1e-8


@pytest.mark.parametrize("name", ["iron_cycle dimensions", "iron_bounce"])
def test_a_cam_without_a_rise_is_refused(name: str) -> None:
    with pytest.raises(SetupError, match=r"^iron.cam.h = 0 m: a cam without a rise "):
        ask(question_of(name), **CASES[name], start={"iron.cam.h": 0.0})


@pytest.mark.parametrize("v", [1e-3, pytest.param(2e-5, marks=SLOW)])
def test_iron_bounce_reports_what_the_reference_integrates(v: float) -> None:
    """The last of three turns at 90 cycles/min; bounces that go on change no figure by more than its
    error.
    """
    answer, w = ask("iron_bounce", speeds="80rpm", samples=720), 3 * math.pi
    heavy = {"reducer.J": 1e4, "follower.lifts": True}
    reference = Reference(start(iron.Parameters, **heavy, **{"follower.v": v}), 0.0)
    stated = {name: figure for name, figure in answer.figures.items() if figure.error}
    turn = 2 * math.pi / w
    two, three = (reference.run(0.0, w, n * turn) for n in (2, 3))
    landed = [x for x in three["landed"] if x[0] > 2 * turn]
    hardest = max(landed, key=lambda x: x[1])
    for name, wanted in (
        ("flight", three["t_flight"] - two["t_flight"]),
        ("speed", hardest[1]),
        ("impulse", hardest[2]),
        ("loss", three["E_landing"] - two["E_landing"]),
    ):
        error = stated[name].error or 0.0
        assert abs(stated[name].value - wanted) <= error + 1e-6 * wanted, name
    assert answer.figures["landings"].value == 5
    e, c, mass = 0.3, 1e7, hardest[2] / (1.3 * hardest[1])
    assert e == start(iron.Parameters).follower.e
    assert answer.figures["force"].value == pytest.approx(
        math.sqrt(c * mass) * hardest[1], rel=1e-5
    )


def test_bounces_that_never_end_change_the_flight_by_no_more_than_its_error() -> None:
    """The time that is cut off falls as the speed at which bounces end, 1 mm/s by default."""
    stated, endless = (
        ask("iron_bounce", speeds="80rpm", samples=360, start=[f"iron.follower.v={v!r}"]).figures
        for v in (1e-3, 1e-8)
    )
    change = abs(stated["flight"].value - endless["flight"].value)
    assert 1e-6 < change <= stated["flight"].error < 2 * change
    assert endless["flight"].error < 1e-7


def test_the_widest_gap_of_iron_bounce_lies_between_rows() -> None:
    """At this speed a row is the widest with 720 rows and with twice as many."""
    stated, wanted = (
        ask("iron_bounce", speeds="80rpm", speed="88.39190418499093rpm", samples=n).figures["gap"]
        for n in (720, 4320)
    )
    assert stated.error and wanted.error and stated.error < 1e-6 * stated.value
    assert abs(stated.value - wanted.value) <= stated.error + wanted.error


def test_iron_bounce_says_where_nothing_bounces_and_where_no_turn_is_like_the_next() -> None:
    quiet = ask("iron_bounce", speeds="70rpm", speed="70rpm", samples=360)
    assert quiet.figures["loss"].value == 0.0
    wild = ask("iron_bounce", speeds="70rpm", speed="160rpm", start={"iron.follower.e": 0.7})
    assert wild.figures["force"].error is None
    near = ask(
        "iron_bounce", speeds="70rpm", speed="9", samples=360, start={"iron.follower.e": 0.02}
    )
    assert near.figures["flight"].reason.endswith("more samples are needed to separate them")


def test_orders_that_are_not_valid_are_named_in_a_line_each() -> None:
    """At 9.5 rad/s the follower lifts off, at 5 rad/s nothing lets go."""
    answer = ask("iron_orders", speeds="5,9.5")
    assert len(answer.warnings) == 3
    for warning, lag in zip(answer.warnings, (12, 80, 200)):
        first = f"in the steady motion at 9.5 rad/s with a lag of {lag} ms the follower lifts off"
        assert warning.startswith(first)
        assert "e-1" not in warning
