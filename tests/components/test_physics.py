"""Equations of the components against derivations, closed solutions, balances and other solvers."""

from __future__ import annotations

import importlib
import math
import random
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy

from components.crank_conveyor import model as crank_conveyor
from components.drive_motor import model as drive_motor
from fmukit.declare.model import complete_model
from fmukit.declare.record import declarations, fill, start
from fmukit.runtime import direction as turn
from fmukit.runtime import hybrid as motion
from fmukit.runtime import ode
from scenarios.conveyor.first_order import SETS
from tests.oracle import by_name, lagrange, random_parameters

complete_model(crank_conveyor)
complete_model(drive_motor)


Mechanics = tuple[Any, Any, list[Any], dict[str, Any]]
"""Kinetic and potential energy, the other forces along the coordinates, and outputs, in symbols."""


def crank_and_rod(s: dict[str, Any], *, finite: bool) -> Mechanics:
    """The rod's force is that of the trough's balance, over the cosine of the rod's angle."""
    r, l, m, c, d = (s[x] for x in ("crank.r", "rod.l", "trough.m", "spring.c", "trough.d"))
    root = sympy.sqrt(l**2 - (r * sympy.cos(s["phi"])) ** 2)
    x = r * sympy.sin(s["phi"]) + (root - l if finite else 0)
    v, push = velocity_and_push(s, x, m, c, d)
    kinetic, force = (s["rotor.J"] * s["w"] ** 2 + m * v**2) / 2, s["tau"] - d * v**2 / s["w"]
    return (
        kinetic,
        c * x**2 / 2,
        [force],
        {"x": x, "v": v, "f_rod": push * (l / root if finite else 1)},
    )


def pin_and_link(s: dict[str, Any], *, swings: bool) -> Mechanics:
    """The pin's force acts by moments about the pivot of the link on the trough, with its load, along x."""
    r, l, c, d = (s[x] for x in ("crank.r", "link.l", "spring.c", "trough.d"))
    reach, across = l + r * sympy.cos(s["phi"]), r * sympy.sin(s["phi"])
    x, arm = across * (l / reach if swings else 1), sympy.sqrt(reach**2 + across**2)
    v, push = velocity_and_push(s, x, s["trough.m"] + s["load.m"], c, d)
    _, load = velocity_and_push(s, x, s["load.m"], c, d)
    kinetic = (s["rotor.J"] * s["w"] ** 2 + (s["trough.m"] + s["load.m"]) * v**2) / 2
    pin = push * (l * arm / reach**2 if swings else 1)
    return (
        kinetic,
        c * x**2 / 2,
        [s["tau"] - d * v**2 / s["w"]],
        {"x": x, "v": v, "f_load": load, "f_pin": pin},
    )


def velocity_and_push(s: dict[str, Any], x: Any, m: Any, c: Any, d: Any) -> tuple[Any, Any]:
    """Velocity of a mass at the position x of the crank angle, and the force that moves it."""
    slope = x.diff(s["phi"])
    a = slope * s["w'"] + slope.diff(s["phi"]) * s["w"] ** 2
    return slope * s["w"], m * a + c * x + d * slope * s["w"]


def unbalance(s: dict[str, Any]) -> Mechanics:
    """From the places of both masses; the mount's force is what the momentum of both lacks."""
    J, m, r, M, c, phi, w = (
        s[x] for x in ("rotor.J", "rotor.m", "rotor.r", "mount.m", "mount.c", "phi", "w")
    )
    place = sympy.Matrix([s["x"] + r * sympy.cos(phi), r * sympy.sin(phi)])
    speed = place.jacobian([phi, s["x"]]) * sympy.Matrix([w, s["v"]])
    kinetic = (M * s["v"] ** 2 + J * w**2 + m * speed.dot(speed)) / 2
    turned = r * (sympy.sin(phi) * s["w'"] + sympy.cos(phi) * w**2)
    f = m * turned - (M + m) * s["v'"]
    forces = [s["tau"] - s["rotor.d"] * w, -s["mount.d"] * s["v"]]
    return kinetic, c * s["x"] ** 2 / 2, forces, {"f": f}


LAGRANGE: dict[str, tuple[str, dict[str, Any], Callable[[dict[str, Any]], Mechanics]]] = {
    # component and options, and what its mechanics are; each crank is long beside its rod or link
    "crank": ("crank_conveyor", {}, partial(crank_and_rod, finite=False)),
    "crank and rod": (
        "crank_conveyor", {"rod.finite": True, "rod.l": 0.016}, partial(crank_and_rod, finite=True)),
    "yoke": ("slotted_link", {}, partial(pin_and_link, swings=False)),
    "swinging link": (
        "slotted_link", {"link.swings": True, "link.l": 0.02}, partial(pin_and_link, swings=True)),
    "exciter": ("unbalance_exciter", {}, unbalance),
}  # fmt: skip


@pytest.mark.parametrize("name", LAGRANGE)
def test_inertia_load_and_acceleration_follow_from_the_energies(name: str) -> None:
    """Rates and outputs by Lagrange's equations, which SymPy derives, at random points."""
    component, options, mechanics = LAGRANGE[name]
    model = model_of(component)
    speeds = [n for n in ("w", "v") if n in dict(declarations(model.State))]
    records = (model.Parameters, model.State, model.Inputs)
    names = [n for cls in records for n, _ in declarations(cls)]
    s = {n: sympy.Symbol(n) for n in [*names, *(f"{n}'" for n in speeds)]}
    kinetic, potential, forces, outputs = mechanics(s)
    q, w = [s["phi" if n == "w" else "x"] for n in speeds], [s[n] for n in speeds]
    inertia, rest = lagrange(kinetic - potential, q, w, forces)
    solve = sympy.lambdify([s[n] for n in names], [inertia, rest])
    outputs |= {"E_kin": kinetic, "E_pot": potential}
    value_of = sympy.lambdify(list(s.values()), list(outputs.values()))
    for p, x, u in random_points(model, random.Random(1), 0.5, [options] * 50):
        at = [*by_name(p).values(), *x, *u]
        M, b = solve(*at)
        rates, y = model.derivatives(p, 0.0, x, u)._asdict(), model.outputs(p, 0.0, x, u)
        wanted = np.linalg.solve(M, -b)[:, 0]
        assert [rates[n] for n in speeds] == pytest.approx(wanted, rel=1e-9, abs=1e-9)
        actual = [getattr(y, n) for n in outputs]
        assert actual == pytest.approx(value_of(*at, *wanted), rel=1e-9, abs=1e-9)
        if "tau_load" in y._fields:
            assert (y.a, y.tau_load) == pytest.approx(
                (wanted[0], u.tau - M[0, 0] * wanted[0]), rel=1e-9, abs=1e-9
            )


def model_of(component: str) -> Any:
    return complete_model(importlib.import_module(f"components.{component}.model"))


def random_points(
    model: Any, draw: random.Random, spread: float, cases: list[dict[str, Any]]
) -> Iterator[tuple[Any, Any, Any]]:
    """Random parameters, states and inputs of a machine, for each of some options."""
    sizes = {
        n: d.nominal or 1.0
        for n, d in declarations(model.State)
        if d.fmi_type == "Real" and not d.held and "gap" not in n
    }
    for case in cases:
        p = random_parameters(model, draw, spread, **case)
        x = start(model.State, **{n: size * draw.uniform(-1, 1) for n, size in sizes.items()})
        yield p, x, fill(model.Inputs, [draw.uniform(-9, 9) for _ in declarations(model.Inputs)])


POWERS: dict[str, tuple[list[dict[str, Any]], Callable[[Any, Any, Any], float]]] = {
    # component: options, and the power that comes in at its ends
    "crank_conveyor": ([{"rod.finite": x} for x in (False, True)], lambda x, u, y: u.tau * x.w),
    "slotted_link": (
        [{"link.swings": x, "load.m": 30.0} for x in (False, True)], lambda x, u, y: u.tau * x.w),
    "unbalance_exciter": ([{}], lambda x, u, y: u.tau * x.w),
    "gearbox": ([{"i": 5.0}, {"i": -3.0}], lambda x, u, y: u.tau_a * x.w_a + u.tau_b * y.w_b),
    "shaft_link": ([{"b": 0.0}, {"b": 0.02}], lambda x, u, y: -y.tau_a * u.w_a - y.tau_b * u.w_b),
    "DC_motor": ([{}], lambda x, u, y: u.v * x.i - y.tau * u.w),
    "iron_drive": (
        [{"wrap": x, "joints.cam": 0.05, "joints.rocker": 0.1, "joints.link": 0.02, "on_invalid": 1}
         for x in (0, 1)],
        lambda x, u, y: u.tau * y.w),
}  # fmt: skip


@pytest.mark.parametrize("name", POWERS)
def test_power_balance_closes_at_every_instant(name: str) -> None:
    """What comes in at the ends is stored or lost: along the rates, by differences of order 4."""
    model, h, (options, power) = model_of(name), 1e-5, POWERS[name]
    for p, x, u in random_points(model, random.Random(1), 0.1, options * 20):
        if name == "iron_drive":
            x = x._replace(direction=math.copysign(1, x.w_cam))
        rates, y = model.derivatives(p, 0.0, x, u), model.outputs(p, 0.0, x, u)

        def stored(time: float, p: Any = p, x: Any = x, u: Any = u, rates: Any = rates) -> float:
            there = type(x)(*(a + time * v for a, v in zip(x, rates)))
            values = there._asdict() | model.outputs(p, 0.0, there, u)._asdict()
            return float(sum(value for name, value in values.items() if name.startswith("E_")))

        flow = (8 * (stored(h) - stored(-h)) - stored(2 * h) + stored(-2 * h)) / (12 * h)
        terms = [power(x, u, y), -getattr(y, "P_loss", 0.0), -flow]
        rounding = 1e-14 * abs(stored(0.0)) / h
        assert abs(sum(terms)) <= 1e-7 * max(map(abs, terms)) + rounding, terms


def test_kloss_characteristic_has_its_breakdown_torque_at_the_breakdown_slip() -> None:
    p = start(drive_motor.Parameters, characteristic=drive_motor.Characteristic.kloss)
    k = p.kloss
    torque = [drive_motor.static_torque(p, k.w_s * (1 - s)) for s in np.linspace(-1, 1.5, 2501)]
    top = int(np.argmax(torque))
    assert np.linspace(-1, 1.5, 2501)[top] == pytest.approx(k.s_b, abs=1e-3)
    assert max(torque) == pytest.approx(k.tau_b, rel=1e-6)
    assert drive_motor.static_torque(p, k.w_s) == 0.0
    assert drive_motor.static_torque(p, 1.1 * k.w_s) < 0.0
    assert drive_motor.static_torque(p, 0.0) == pytest.approx(2 * k.tau_b / (k.s_b + 1 / k.s_b))


def test_integrator_has_order_five() -> None:
    """On x' = x cos t, x = exp(sin t), with fixed steps."""

    def slope(t: float, x: Any) -> list[float]:
        return [x[0] * math.cos(t)]

    errors = []
    for steps in (8, 16, 32, 64):
        x, h = [1.0], 2.0 / steps
        for n in range(steps):
            x, _, _ = ode.attempt(slope, n * h, x, slope(n * h, x), h, [1.0])
        errors.append(abs(x[0] - math.exp(math.sin(2.0))))
    orders = [math.log2(a / b) for a, b in pairwise(errors)]
    assert orders == pytest.approx([5.0] * 3, abs=0.4)
    assert orders[-1] == pytest.approx(5.0, abs=0.15)


def integrate(f: ode.RightHandSide, x: ode.Vector, tolerance: ode.Vector) -> ode.Vector:
    """Carry x from s = 0 to s = 1."""
    at = ode.IntegratorState(0.0, x, f(0.0, x), 1.0, 0)
    while at.s < 1.0:
        at = ode.substep(f, at, 1.0, tolerance).further
    return at.x


def test_integrator_estimates_its_error_and_keeps_the_tolerance() -> None:
    def slope(t: float, x: Any) -> list[float]:
        return [x[1], -900.0 * x[0]]

    for tolerance in (1e-4, 1e-7, 1e-10):
        x = integrate(slope, [1.0, 0.0], [tolerance, 30 * tolerance])
        assert abs(x[0] - math.cos(30.0)) < 200 * tolerance
    loose = integrate(slope, [1.0, 0.0], [1e-3, 3e-2])
    assert abs(loose[0] - math.cos(30.0)) > 1e-8


def test_integrator_gives_up_on_what_is_not_finite() -> None:
    with pytest.raises(ArithmeticError, match="no sub-step is small enough"):
        integrate(lambda t, x: [math.sqrt(0.5 - t)], [0.0], [1e-9])


def test_integrator_gives_up_on_what_takes_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ode, "MOST_SUBSTEPS", 1000)
    with pytest.raises(ArithmeticError, match="more than 1000 sub-steps"):
        integrate(lambda t, x: [x[1], -1e12 * x[0]], [1.0, 0.0], [1e-9, 1e-3])


def test_rod_force_is_least_below_the_speed_that_the_text_after_17_names() -> None:
    m = SETS["A"]
    nu = np.linspace(50.0, 70.0, 20001)
    force = [abs(m.load_ripple(float(n))) for n in nu]
    assert math.sqrt(m.c / m.m) == 60.0
    assert nu[int(np.argmin(force))] == pytest.approx(58.31, abs=2e-3)


def test_a_turned_direction_is_that_of_the_angle() -> None:
    """On both sides of the limit up to which it comes from the series."""
    draw = random.Random(2)
    for _ in range(20_000):
        start_angle = draw.uniform(-1000.0, 1000.0)
        near = turn.Direction(start_angle, math.sin(start_angle), math.cos(start_angle))
        angle = start_angle + draw.uniform(-1.5, 1.5) * turn.SERIES_LIMIT
        got = turn.at_angle(angle, near)
        assert got.angle == angle
        assert abs(got.sin - math.sin(angle)) < 3e-15
        assert abs(got.cos - math.cos(angle)) < 3e-15
        assert turn.at_angle(start_angle, near) == near


@pytest.mark.parametrize("finite", [False, True])
@pytest.mark.parametrize("w", [-40.0, 40.0, 400.0])
def test_a_step_does_not_depend_on_its_step_constants(finite: bool, w: float) -> None:
    p = start(crank_conveyor.Parameters, **{"rod.finite": finite, "rod.l": 0.05})
    x, u = crank_conveyor.State(2.0, w), crank_conveyor.Inputs(30.0)
    anew: Any = SimpleNamespace(**vars(crank_conveyor) | {"step_constants": None})
    ends = [
        motion.advance(model, p, 0.0, x, motion.InputTrajectory(u, u, 1e-3))
        for model in (crank_conveyor, anew)
    ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-13)
    assert abs(ends[0].w - w) > 1e-3
