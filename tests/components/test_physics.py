"""Equations of the components against derivations, closed solutions, balances and other solvers."""

from __future__ import annotations

import cmath
import importlib
import math
import random
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from components.crank_conveyor import model as crank_conveyor
from components.drive_motor import model as drive_motor
from cosim.metrics import harmonics
from fmukit.declare.model import complete_model
from fmukit.declare.record import declarations, fill, start
from fmukit.runtime import direction as turn
from fmukit.runtime import hybrid as motion
from fmukit.runtime import ode
from scenarios.conveyor.first_order import SETS
from tests.oracle import lagrange, monolithic, random_parameters, revolution_samples
from tests.scenarios.orbit_oracle import Drive, orbit

complete_model(crank_conveyor)
complete_model(drive_motor)


@pytest.mark.parametrize("finite", [False, True])
def test_inertia_load_and_acceleration_follow_from_the_energies(finite: bool) -> None:
    """The rod's force from the balance of the trough, and that of the crank."""
    symbols = sympy.symbols("J m r l c d tau phi w")
    J, m, r, l, c, d, tau, phi, w = symbols
    x = r * sympy.sin(phi)
    if finite:
        x += sympy.sqrt(l**2 - (r * sympy.cos(phi)) ** 2) - l
    slope, bend = x.diff(phi), x.diff(phi, 2)
    energy = (J * w**2 + m * (slope * w) ** 2 - c * x**2) / 2
    inertia, rest = lagrange(energy, [phi], [w], [tau - d * slope**2 * w])
    derived = sympy.lambdify(symbols, [inertia[0], rest[0] + tau, x, slope, bend])
    for values, p, state, u in states(finite, 50):
        theta, load, at, by, by_2 = derived(*values)
        J_1, mass, _, rod, spring, damper, _, _, speed = values
        crank = crank_conveyor.step_constants(p, state)
        assert crank_conveyor.inertia_and_load_torque(p, state, crank) == pytest.approx(
            (theta, load), rel=1e-12, abs=1e-10
        )
        rates, y = (
            crank_conveyor.derivatives(p, 0.0, state, u),
            crank_conveyor.outputs(p, 0.0, state, u),
        )
        assert rates.phi == speed
        assert rates.w == y.a == pytest.approx((u.tau - load) / theta, rel=1e-12, abs=1e-10)
        cosine = math.sqrt(1 - (p.crank.r * math.cos(state.phi) / rod) ** 2) if finite else 1.0
        push = mass * (by * y.a + by_2 * speed**2) + spring * at + damper * by * speed
        assert y.f_rod * cosine == pytest.approx(push, rel=1e-9, abs=1e-9 * spring * p.crank.r)
        assert J_1 * y.a == pytest.approx(u.tau - push * by, rel=1e-9, abs=1e-9)
        assert (y.x, y.v) == pytest.approx((at, by * speed), rel=1e-12)


def states(finite: bool, count: int) -> Any:
    """Random machines and states: values in the order of the derivation, and as records."""
    draw = random.Random(1)
    for _ in range(count):
        theta1, m, r = draw.uniform(0.01, 2), draw.uniform(1, 500), draw.uniform(0.001, 0.1)
        l, c, d = r * draw.uniform(1.1, 30), draw.uniform(0, 1e6), draw.uniform(0, 1e4)
        tau, phi, w = draw.uniform(-500, 500), draw.uniform(-7, 7), draw.uniform(-90, 90)
        p = start(
            crank_conveyor.Parameters,
            **{"rotor.J": theta1, "crank.r": r, "rod.l": l, "rod.finite": finite},
            **{"trough.m": m, "trough.d": d, "spring.c": c},
        )
        values = (theta1, m, r, l, c, d, tau, phi, w)
        yield values, p, crank_conveyor.State(phi, w), crank_conveyor.Inputs(tau)


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
    model = complete_model(importlib.import_module(f"components.{name}.model"))
    draw, h, (options, power) = random.Random(1), 1e-5, POWERS[name]
    states = {
        n: d.nominal or 1.0
        for n, d in declarations(model.State)
        if d.fmi_type == "Real" and not d.held and "gap" not in n
    }
    for case in options * 20:
        p = random_parameters(model, draw, 0.1, **case)
        x = start(model.State, **{n: size * draw.uniform(-1, 1) for n, size in states.items()})
        if name == "iron_drive":
            x = x._replace(direction=math.copysign(1, x.w_cam))
        u = fill(model.Inputs, [draw.uniform(-9, 9) for _ in declarations(model.Inputs)])
        rates, y = model.derivatives(p, 0.0, x, u), model.outputs(p, 0.0, x, u)

        def stored(time: float, p: Any = p, x: Any = x, u: Any = u, rates: Any = rates) -> float:
            there = type(x)(*(a + time * v for a, v in zip(x, rates)))
            values = there._asdict() | model.outputs(p, 0.0, there, u)._asdict()
            return float(sum(value for name, value in values.items() if name.startswith("E_")))

        flow = (8 * (stored(h) - stored(-h)) - stored(2 * h) + stored(-2 * h)) / (12 * h)
        terms = [power(x, u, y), -getattr(y, "P_loss", 0.0), -flow]
        rounding = 1e-14 * abs(stored(0.0)) / h
        assert abs(sum(terms)) <= 1e-7 * max(map(abs, terms)) + rounding, terms


def test_motor_with_linear_characteristic_steps_exactly() -> None:
    """Against the solution of the differential equation that SymPy finds for a linear speed."""
    t, h = sympy.symbols("t h", positive=True)
    A, B, T, M0, w0, w1 = sympy.symbols("A B T M0 w0 w1", positive=True)
    M = sympy.Function("M")
    equation = sympy.Eq(M(t) + T * M(t).diff(t), A - B * (w0 + (w1 - w0) * t / h))
    solution = sympy.dsolve(equation, M(t), ics={M(0): M0}).rhs.subs(t, h)
    solve = sympy.lambdify((A, B, T, M0, w0, w1, h), solution)
    draw = random.Random(2)
    for _ in range(50):
        values = [draw.uniform(low, high) for low, high in
                  ((1, 9e3), (0, 300), (0.01, 1), (-500, 500), (-50, 90), (-50, 90), (1e-3, 1))]  # fmt: skip
        a, b, lag, m0, u0, u1, step = values
        p = start(drive_motor.Parameters, A=a, B=b, T=lag)
        x = drive_motor.exact(
            p, drive_motor.State(m0), drive_motor.Inputs(u0), drive_motor.Inputs(u1), step
        )
        assert x is not None
        assert x.tau == pytest.approx(solve(*values), rel=1e-9, abs=1e-9)


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


def test_kloss_motor_follows_the_lag_equation() -> None:
    p = start(drive_motor.Parameters, characteristic=drive_motor.Characteristic.kloss)
    u0, u1, h = drive_motor.Inputs(20.0), drive_motor.Inputs(62.0), 0.2
    got = motion.advance(
        drive_motor, p, 0.0, drive_motor.State(5.0), motion.InputTrajectory(u0, u1, h)
    )

    def slope(t: float, y: Any) -> Any:
        u = drive_motor.Inputs(20.0 + 42.0 * t / h)
        return drive_motor.derivatives(p, t, drive_motor.State(y[0]), u)

    want = solve_ivp(slope, (0.0, h), [5.0], method="DOP853", rtol=1e-13, atol=1e-12).y[0, -1]
    assert got.tau == pytest.approx(want, rel=1e-10)


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


@pytest.mark.parametrize(("name", "nu", "error"), [("A", 40.0, 168.7), ("B", 30.0, 140.2)])
def test_ripple_of_formulas_10_17_and_26_as_printed_is_wrong(
    name: str, nu: float, error: float
) -> None:
    """The sign of (10), the root (1 + 2 T nu^2) of (17), the spring in the root of (26), and its phase."""
    m, degrees = SETS[name], lambda ripple: math.degrees(cmath.phase(ripple))
    exact, speed, torque = orbit(Drive.of(m.start(nu)), nu), m.speed_ripple(nu), m.torque_ripple(nu)
    assert abs(degrees(torque) - degrees(exact.tau2)) < 0.11
    printed = degrees(m.load_ripple(nu)) + math.degrees(math.atan(2 * m.T * nu))
    assert (printed - degrees(exact.tau2)) % 360.0 == pytest.approx(error, abs=0.2)
    if name == "A":
        assert (speed, torque) == pytest.approx((exact.w2, exact.tau2), rel=2e-3)
        assert degrees(-speed) - degrees(exact.w2) == pytest.approx(180.0, abs=0.1)
        printed = abs(speed) * math.sqrt((1 + 2 * m.T * nu**2) / (1 + (2 * m.T * nu) ** 2))
        assert (printed, abs(exact.w2)) == pytest.approx((7.45, 2.68), rel=2e-3)
        root = math.hypot(
            m.slope - 4 * m.theta0 * m.T * nu**2, 2 * nu * (m.theta0 + m.T * m.c * m.r**2 / 2)
        )
        printed = m.B * abs(m.load_ripple(nu)) / root
        assert printed / abs(exact.tau2) - 1 == pytest.approx(-0.81, abs=0.01)


def test_speed_equation_16_as_printed_settles_fifty_times_too_fast() -> None:
    """A kick of the speed on the steady orbit dies out with 2 theta0 T / J, not J / B*."""
    m, nu = SETS["A"], 40.0
    values = m.start(nu) | {"conveyor.w": 39.6767723312, "motor.tau": -90.697972024}
    phi, t = np.linspace(2.0, 18.0, 2001), np.linspace(0.0, 0.5, 2001)
    runs = (
        monolithic(values | {"conveyor.w": values["conveyor.w"] + w}, 0.5, t_eval=t).y
        for w in (0.0, 1e-3)
    )
    orbit, kicked = (CubicSpline(y[0], y[2])(phi) for y in runs)
    error = np.abs(kicked - orbit)
    tops = np.flatnonzero((error[1:-1] > error[:-2]) & (error[1:-1] > error[2:])) + 1
    settling = -1 / (nu * np.polyfit(phi[tops], np.log(error[tops]), 1)[0])
    assert settling == pytest.approx(2 * m.theta0 * m.T / m.J, rel=0.02)
    assert settling == pytest.approx(0.12195, rel=0.02)
    assert m.J / m.slope == pytest.approx(2.56e-3, rel=2e-3)
    assert math.exp(-math.pi * m.zeta / math.sqrt(1 - m.zeta**2)) == pytest.approx(0.72, abs=4e-3)


def test_rod_force_is_least_below_the_speed_that_the_text_after_17_names() -> None:
    m = SETS["A"]
    nu = np.linspace(50.0, 70.0, 20001)
    force = [abs(m.load_ripple(float(n))) for n in nu]
    assert math.sqrt(m.c / m.m) == 60.0
    assert nu[int(np.argmin(force))] == pytest.approx(58.31, abs=2e-3)


def test_finite_rod_adds_the_odd_orders() -> None:
    machine = SETS["A"]
    for nu, k, want in ((26.67, 3, 0.0537), (80.0, 1, 0.0875)):
        t = revolution_samples(nu, 40, 128)
        y = monolithic(machine.start(nu) | {"conveyor.rod.finite": True}, t[-1], t_eval=t).y
        lagged = y[0] >= y[0][-1] - 8 * math.pi
        assert abs(harmonics(y[0][lagged], y[1][lagged])[k - 1]) == pytest.approx(want, abs=6e-5)


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
