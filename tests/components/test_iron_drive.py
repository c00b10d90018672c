"""The iron drive against material points, its derivation, reference numbers, balances, misuse."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from math import pi, radians
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

from components.iron_drive import dynamics, geometry
from components.iron_drive import model as iron
from components.iron_drive.declarations import Side
from cosim import System, run
from fmukit.declare.record import replace, start
from tests.components.iron_oracle import Reference, by_material_points
from tests.hosts.host import MESSAGES, Unit
from tests.oracle import random_parameters

NOMINAL = 4 * pi / 3
FORCES = ("W", "T_iron", "T_span", "T_hang", "M_rocker", "N", "tau_cam")


def machine(**changes: Any) -> Any:
    """Parameters of a drive that goes on where it is not valid."""
    return start(iron.Parameters, **{"on_invalid": iron.OnInvalid.warn} | changes)


def quantities(p: Any, phi: float, w: float = NOMINAL, M: float | None = None) -> dict[str, float]:
    """All that the equations say at a state; without M at constant speed."""
    at, sense = geometry.position(p, phi), math.copysign(1, w)
    (_, H_1, H_2), K = at.H, dynamics.friction_coefficient(p, at, sense)
    B, C = at.J_1 / 2 + K * p.iron.m * H_1 * H_2, K * at.W_0 * H_1 - at.Pi_1
    M = B * w * w - C if M is None else M
    y: Any = iron.outputs(
        p, 0.0, start(iron.State, phi=phi, w_cam=w), iron.Inputs(M / p.reducer.i_g)
    )
    d = dynamics.dynamics(p, at, w, sense, M)
    return at._asdict() | d._asdict() | y._asdict() | {
        "alpha_1": at.alpha.first, "alpha_2": at.alpha.second, "H_1": H_1, "H_2": H_2, "M": M,
    }  # fmt: skip


@pytest.mark.parametrize("wrap", iron.Wrap)
def test_material_points_agree(wrap: iron.Wrap) -> None:
    """In random drives and states, and at eight angles, on all four parts of the cam, with constant speed."""
    angles = (10, 50, 80, 130, 182, 200, 235, 300)
    cases = [(machine(wrap=wrap), radians(deg), NOMINAL, None) for deg in angles]
    for p, phi, w, M in [*cases, *states(wrap, 12)]:
        got = quantities(p, phi, w, M)
        with mpmath.workdps(30):
            points = by_material_points(p, phi, w, got["eps"], got["K"])
        assert abs(got["pressure"]) == pytest.approx(float(points.pop("tilt")), rel=1e-9)
        for name, value in points.items():
            rel = 1e-8 if name in FORCES else 1e-9
            floor = 1e-10 if name in FORCES else 1e-13
            assert got[name] == pytest.approx(float(value), rel=rel, abs=floor), (phi, name)


def states(wrap: iron.Wrap, count: int) -> Iterator[Any]:
    """Random drives and states: parameters, phi, w, M."""
    draw = random.Random(2)
    for _ in range(count):
        side = draw.choice(list(Side))
        p = random_parameters(iron, draw, 0.1, wrap=wrap, **{"spring.side": side})
        yield p, draw.uniform(-9, 9), draw.uniform(-9, 9), draw.uniform(-9, 9)


MOTOR = {"A": 4.0, "B": 0.025, "T": 0.012}
STALLING = {"A": 0.10, "B": 0.0025, "T": 0.012}
BOUNCING: dict[str, Any] = {"follower.lifts": True}


@pytest.mark.parametrize(
    ("motor", "tau", "phi", "w", "stop", "options", "landings"),
    [
        (MOTOR, 0.0, -pi / 3, 0.0, 1.0, {}, 0),
        (STALLING, 0.1, -0.3, 0.0, 1.5, {}, 0),
        (MOTOR | {"A": 8.0}, 0.0, 0.0, 8.0, 0.6, BOUNCING, 2),
    ],
    ids=["start-up", "stall", "bouncing"],
)
def test_coupled_start_up_is_that_of_the_reference_solution(
    motor: dict[str, float], tau: float, phi: float, w: float, stop: float,
    options: dict[str, Any], landings: int, native: Path,
) -> None:  # fmt: skip
    """Two FMUs, Strang, extrapolated from two steps, beside SciPy's one system."""
    p = start(iron.Parameters, **options)
    end = Reference(p, tau, motor).run(phi, w, stop)
    values = options | {"phi": phi, "w_cam": w}
    starts = {f"iron.{name}": value for name, value in values.items()} | {"motor.tau": tau}
    system = System(
        {"motor": native / "DriveMotor.fmu", "iron": native / "IronDrive.fmu"},
        ["motor.tau -> iron.tau", "iron.w -> motor.w"],
        starts | {f"motor.{name}": value for name, value in motor.items()},
    )
    fine, coarse = (run(system, stop=stop, step=h, algorithm="strang") for h in (1e-4, 2e-4))
    assert len(end["landed"]) >= landings and fine["iron.landings"][-1] == len(end["landed"])
    assert (fine["iron.motion"][-1] == iron.Motion.stuck) == (end["t"] < stop)
    for name in ("phi", "w_cam", "E_friction", "E_landing", "t_flight"):
        a, b = (result[f"iron.{name}"][-1] for result in (fine, coarse))
        assert a + (a - b) / 3 == pytest.approx(end[name], rel=1e-5, abs=1e-5), name


def coasting(native: Path, w: float, stop: float, **changes: Any) -> Unit:
    """A drive with a heavy rotor that turns at this speed, without torque, at the end of a step."""
    values = {"w_cam": w, "tau": 0.0, "reducer.J": 1e3, "phi": -pi / 3} | changes
    return Unit(native / "IronDrive.fmu").start(**values).step(0.0, stop)


def test_friction_loss_per_turn_does_not_depend_on_the_speed(native: Path) -> None:
    """It is that of the load along the way up and down."""
    p = machine()
    s, h = p.spring, 0.062385664995
    load = (p.iron.m + s.m / 2) * p.g * h + s.c * (s.e_0 * h + h * h / 2)
    loss = (p.friction.K_up - p.friction.K_down) * load
    for w in (20 * pi / 30, 40 * pi / 30, 60 * pi / 30):
        unit = coasting(native, w, 2 * pi / w)
        assert unit.get("E_friction") == pytest.approx(loss, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "limit"),
    [({}, 7.89776), ({"spring.c": 0.0, "spring.m": 0.0}, 5.63049), ({"spring.side": -1}, 5.15434)],
)
def test_follower_leaves_its_cam_where_it_should(
    changes: dict[str, Any], limit: float, native: Path
) -> None:
    coasting(native, limit * 0.999, 6.0 / limit, **changes)
    unit = coasting(native, limit * 1.001, 1e-6, **changes)
    refusal = unit.refusal(lambda u: u.step(1e-6, 6.0 / limit))
    assert "cam follower lifts off at phi = 3.1" in refusal
    reference = Reference(start(iron.Parameters, **BOUNCING, **{"reducer.J": 1e6}, **changes), 0.0)
    flies = [reference.run(0.0, w, 2 * pi / w)["lifted"] for w in (limit * 0.999, limit * 1.001)]
    assert [len(times) for times in flies] == [0, 1]


def test_a_steep_run_to_the_top_of_the_sprocket_is_warned_of() -> None:
    p = machine(**{"sprocket.A": 0.4})
    assert [sentence.split(":")[1] for sentence in iron.check(p)] == [
        " wrap = top (0) is a poor assumption"
    ]
    assert list(iron.check(replace(p, wrap=iron.Wrap.tangent))) == []
    assert list(iron.check(machine())) == []


def test_where_the_follower_leaves_its_cam_the_fmu_stops_or_warns_once_per_episode(
    fmus: Path,
) -> None:
    heavy = {"reducer.J": 1e3, "w_cam": 8.2, "tau": 0.0}
    stops = Unit(fmus / "IronDrive.fmu").start(**heavy)
    refusal = stops.refusal(lambda u: [u.step(n * 0.01, 0.01) for n in range(100)])
    assert "cam follower lifts off at phi = 3.1" in refusal
    assert "omega = 8.19" in refusal
    assert ": N = -" in refusal
    stops.fmi.freeInstance()
    MESSAGES.clear()
    warns, valid = Unit(fmus / "IronDrive.fmu").start(on_invalid=1, **heavy), []
    for n in range(1600):
        valid.append(warns.step(n * 1e-3, 1e-3).get("valid"))
        assert valid[-1] == (warns.get("N") > 0.0)
    edges = [a and not b for a, b in itertools.pairwise(valid)]
    assert sum(edges) == len([m for m in MESSAGES if "cam follower lifts off at phi" in m]) == 2
    assert valid[-1]
    reason_for = Unit(fmus / "IronDrive.fmu").start(on_invalid=1, phi=3.1853, w_cam=9.0)
    assert not reason_for.get("valid")


def test_a_drive_at_rest_moves_where_the_torque_passes_the_friction(fmus: Path) -> None:
    """Between the two limits it is stuck, and its cam bears the whole torque."""
    phi, p = radians(50), machine()
    at = geometry.position(p, phi)
    down, up = (
        (at.Pi_1 - K * at.W_0 * at.H.first) / 36 for K in (p.friction.K_down, p.friction.K_up)
    )
    for tau, moves, direction in (
        (1.001 * up, "up", 1), (0.999 * up, "stuck", 0), (1.001 * down, "stuck", 0), (0.999 * down, "down", -1),
    ):  # fmt: skip
        unit = Unit(fmus / "IronDrive.fmu").start(phi=phi, w_cam=0.0, tau=tau)
        assert (unit.get("motion"), unit.get("direction")) == (iron.Motion[moves], direction)
        K = unit.get("T_iron") / at.W_0 - 1
        if moves == "stuck":
            assert (unit.get("tau_cam"), unit.get("a")) == (36 * tau, 0.0)
            assert p.friction.K_down < K < p.friction.K_up
        assert np.sign(unit.step(0.0, 0.01).get("w_cam")) == direction
