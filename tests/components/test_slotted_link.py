"""The slotted link against Lagrange's equation, the balances of its link, and the crank conveyor."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

from components.crank_conveyor import model as crank_conveyor
from components.slotted_link import model as link
from cosim import System, run
from fmukit.declare.record import start
from tests.oracle import lagrange

NAMES = "J r l m d c m_L tau phi w"
EACH = pytest.mark.parametrize("swings", [False, True])


def points(swings: bool, count: int = 50) -> Iterator[tuple[list[float], Any, Any, Any]]:
    """Random machines in random states: numbers in the order of NAMES, and as records."""
    draw = random.Random(5)
    for _ in range(count):
        r = draw.uniform(0.005, 0.1)
        body = [draw.uniform(0.1, 2.0), r, r * draw.uniform(1.2, 9.0), draw.uniform(1.0, 300.0)]
        load = [draw.uniform(0.0, 9e3), draw.uniform(0.0, 1e6), draw.uniform(0.0, 90.0)]
        state = [draw.uniform(-300, 300), draw.uniform(-9, 9), draw.uniform(-90, 90)]
        names = ("rotor.J", "crank.r", "link.l", "trough.m", "trough.d", "spring.c", "load.m")
        p = start(link.Parameters, **dict(zip(names, body + load)), **{"link.swings": swings})
        yield body + load + state, p, link.State(*state[1:]), link.Inputs(state[0])


@EACH
def test_link_obeys_lagrange_with_a_load_that_depends_on_the_acceleration(swings: bool) -> None:
    """The load's force -m_L x.. does its work along the trough's position; it is no part of T. The pin's
    force acts on the crank by its lever, on the link by moments about the pivot, on the trough along x.
    """
    symbols = sympy.symbols(NAMES, real=True)
    J, r, l, m, d, c, m_L, tau, phi, w = symbols
    reach = l + r * sympy.cos(phi)
    x = r * sympy.sin(phi) * (l / reach if swings else 1)
    slope, bend = x.diff(phi), x.diff(phi, 2)
    energy = (J * w**2 + m * (slope * w) ** 2 - c * x**2) / 2
    load = [tau - (d * slope * w + m_L * bend * w**2) * slope]
    inertia, rest = lagrange(energy, [phi], [w], load)
    derived = [-rest[0] / (inertia[0] + m_L * slope**2), x, slope, bend]
    solve = sympy.lambdify(symbols, derived)
    for values, p, state, u in points(swings):
        a, at, by, by_2 = solve(*values)
        J, r, l, m, d, c, m_L, tau, phi, w = values
        y, along = link.outputs(p, 0.0, state, u), by * a + by_2 * w * w
        assert link.derivatives(p, 0.0, state, u) == (w, y.a)
        assert (y.a, y.x, y.v) == pytest.approx((a, at, by * w), rel=1e-9, abs=1e-9)
        assert y.f_load == pytest.approx(c * at + d * by * w + m_L * along, rel=1e-9, abs=1e-6)
        psi = math.atan2(r * math.sin(phi), l + r * math.cos(phi)) if swings else 0.0
        arm = math.hypot(r * math.sin(phi), l + r * math.cos(phi)) if swings else 1.0
        block = l / math.cos(psi) if swings else 1.0
        pushed = y.f_pin * arm / block * math.cos(psi)
        assert pushed == pytest.approx(m * along + y.f_load, rel=1e-9, abs=1e-6)
        assert J * a == pytest.approx(tau - y.f_pin * r * math.cos(phi - psi), rel=1e-9, abs=1e-8)


def coupled(fmus: Path, conveyor: str, **values: Any) -> Any:
    """Motor and machine over four revolutions: crank angle, speed, torque."""
    parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / f"{conveyor}.fmu"}
    wires = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
    options = {f"conveyor.{name}": value for name, value in values.items()}
    r = run(System(parts, wires, options), stop=0.6, step=1e-3, algorithm="strang")
    return np.stack([r[f"conveyor.{name}"] for name in ("phi", "w", "x", "v", "tau_load", "E_kin")])


def test_a_yoke_is_the_crank_with_an_infinite_rod(fmus: Path) -> None:
    """Coupled with a motor, and whether the mass is the trough's or the load's; a finite rod is not."""
    native = fmus / "native"
    crank = coupled(native, "CrankConveyor")
    size = np.abs(crank).max(axis=1, keepdims=True)
    for shared in ({"trough.m": 200.0, "load.m": 0.0}, {"trough.m": 140.0, "load.m": 60.0}):
        yoke = coupled(native, "SlottedLink", **shared)
        assert np.abs((yoke - crank) / size).max() < 1e-11
    finite = coupled(native, "CrankConveyor", **{"rod.finite": True})
    assert np.abs((finite - crank) / size).max() > 1e-3
    for numbers, p, x, u in points(False):
        J, r, _, m, d, c, m_L, *_ = numbers
        names = {"rotor.J": J, "crank.r": r, "trough.m": m + m_L, "trough.d": d, "spring.c": c}
        other = crank_conveyor.outputs(
            start(crank_conveyor.Parameters, **names),
            0.0,
            crank_conveyor.State(*x),
            crank_conveyor.Inputs(*u),
        )
        y = link.outputs(p, 0.0, x, u)
        assert (y.a, y.f_pin, y.tau_load) == pytest.approx(
            (other.a, other.f_rod, other.tau_load), rel=1e-9, abs=1e-9
        )


def test_a_swinging_link_with_a_far_pivot_becomes_a_yoke_as_its_distance_grows() -> None:
    """In proportion to r/l."""
    x, u = link.State(0.7, 40.0), link.Inputs(30.0)
    yoke = link.outputs(start(link.Parameters), 0.0, x, u)
    error = []
    for l in (10.0, 100.0, 1000.0):
        p = start(link.Parameters, **{"link.swings": True, "link.l": l})
        error.append(link.outputs(p, 0.0, x, u).f_pin / yoke.f_pin - 1.0)
    assert error[1] / error[0] == pytest.approx(0.1, rel=0.01)
    assert error[2] / error[1] == pytest.approx(0.1, rel=0.001)
