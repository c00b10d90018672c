"""Equations of the components against derivations, closed solutions, balances and other solvers."""

from __future__ import annotations

import cmath
import math
import random
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
from fmukit.declare.record import start
from fmukit.runtime import direction as turn
from fmukit.runtime import hybrid as motion
from fmukit.runtime import ode
from scenarios.conveyor.first_order import SETS
from tests.oracle import monolithic, revolution_samples, symbolic

complete_model(crank_conveyor)
complete_model(drive_motor)

REFERENCE = {
    # set, nu: w2, phase, tau2, phase, nu_t, nu_phi, time-mean tau, peak rod force, w4
    ("A", 36): (2.098724270, -129.318486, 90.9984270, -26.805683, 35.997870289, 36.059134028,
                7.6255163, 4900.1039, 0.04344208),
    ("A", 40): (2.676625330, -169.435021, 104.9679504, -68.167724, 39.996704787, 40.086507219,
                8.6583836, 4651.8145, 0.08050181),
    ("A", 60): (0.352741650, -173.772629, 9.3145045, -76.181685, 60.000000001, 60.001037006,
                11.9999998, 2316.2294, 0.00388170),
    ("B", 21): (1.482231005, 178.564296, 40.6594720, -41.438537, 20.968965968, 21.021457675,
                5.3110184, 6424.1581, 0.03811338),
    ("B", 30): (1.428260459, 152.778003, 32.7524623, -77.426929, 29.984102423, 30.018171148,
                6.5691332, 5676.7526, 0.03232376),
}  # fmt: skip


@pytest.fixture(scope="module")
def lagrange() -> dict[bool, Any]:
    """theta, load torque and acceleration from the energies; the geometry from the rod's length."""
    t = sympy.Symbol("t")
    theta1, m, r, l, c, d, tau = sympy.symbols("theta1 m r l c d tau", positive=True)
    phi, w, a = sympy.symbols("phi w a", real=True)
    angle = sympy.Function("phi")(t)
    derived = {}
    for finite in (False, True):
        pin = (r * sympy.sin(angle), r * sympy.cos(angle))
        x = pin[0] + (sympy.sqrt(l**2 - pin[1] ** 2) - l if finite else 0)
        v = x.diff(t)
        kinetic = theta1 * angle.diff(t) ** 2 / 2 + m * v**2 / 2
        lagrangian = kinetic - c * x**2 / 2
        speed = angle.diff(t)
        balance = (
            lagrangian.diff(speed).diff(t) - lagrangian.diff(angle)
            + (d * v**2 / 2).diff(speed) - tau
        )  # fmt: skip
        plain = [(angle.diff(t, 2), a), (speed, w), (angle, phi)]
        balance = balance.subs(plain)
        theta, rest = balance.diff(a), balance.subs(a, 0)
        derived[finite] = sympy.lambdify(
            (theta1, m, r, l, c, d, tau, phi, w), (theta, rest + tau, -rest / theta)
        )
    return derived


@pytest.mark.parametrize("finite", [False, True])
def test_inertia_load_and_acceleration_follow_from_the_energies(
    lagrange: dict[bool, Any], finite: bool
) -> None:
    for values, p, x, u in states(finite, 50):
        theta, load, acceleration = lagrange[finite](*values)
        crank = crank_conveyor.prepare(p, x)
        assert crank_conveyor.load(p, x, crank) == pytest.approx(
            (theta, load), rel=1e-12, abs=1e-10
        )
        dx = crank_conveyor.derivatives(p, 0.0, x, u)
        assert dx.phi == x.w
        assert dx.w == pytest.approx(acceleration, rel=1e-12, abs=1e-10)


def test_equation_1_as_printed_does_not_follow_from_the_energies(lagrange: dict[bool, Any]) -> None:
    """It lacks the square of the speed beside theta'."""
    for values, p, x, u in states(False, 20):
        crank = crank_conveyor.prepare(p, x)
        theta, _ = crank_conveyor.load(p, x, crank)
        at_rest = crank_conveyor.load(p, x._replace(w=0.0), crank)[1]
        damping = p.trough.d * (p.crank.r * math.cos(x.phi)) ** 2 * x.w
        centrifugal = -p.trough.m * p.crank.r**2 * math.sin(2 * x.phi) / 2
        printed = (u.tau - at_rest - damping - centrifugal * x.w) / theta
        squared = (u.tau - at_rest - damping - centrifugal * x.w**2) / theta
        assert squared == pytest.approx(lagrange[False](*values)[2], rel=1e-12, abs=1e-10)
        assert abs(printed - squared) > 1e-6 * abs(squared)


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


@pytest.mark.parametrize("finite", [False, True])
def test_rod_force_balances_crank_and_trough(finite: bool) -> None:
    model, (r, l, phi) = symbolic(crank_conveyor), sympy.symbols("r l phi")
    geometry = start(model.Parameters, **{"crank.r": r, "rod.l": l, "rod.finite": finite})
    position = model.trough(geometry, model.prepare(geometry, model.State(phi, 0)))[0]
    path = sympy.lambdify((r, l, phi), [position, position.diff(phi), position.diff(phi, 2)])
    for (theta1, m, r, l, c, d, tau, phi, w), p, x, u in states(finite, 50):
        y = crank_conveyor.outputs(p, 0.0, x, u)
        at, slope, bend = path(r, l, phi)
        cosine = math.sqrt(1 - (r * math.cos(phi) / l) ** 2) if finite else 1.0
        push = m * (slope * y.a + bend * w * w) + c * at + d * slope * w
        assert y.f_rod * cosine == pytest.approx(push, rel=1e-9, abs=1e-9 * c * r)
        assert theta1 * y.a == pytest.approx(tau - push * slope, rel=1e-9, abs=1e-9)
        assert (y.x, y.v) == pytest.approx((at, slope * w), rel=1e-12)


@pytest.mark.parametrize("finite", [False, True])
def test_power_balance_closes_at_every_instant(finite: bool) -> None:
    model = symbolic(crank_conveyor)
    phi, w, tau = sympy.symbols("phi w tau", real=True)
    p = start(model.Parameters, **{"rod.finite": finite, "crank.r": 0.1})
    x, u = model.State(phi, w), model.Inputs(tau)
    dx, y = model.derivatives(p, 0.0, x, u), model.outputs(p, 0.0, x, u)
    stored = y.E_kin + y.E_pot
    leak = stored.diff(phi) * dx.phi + stored.diff(w) * dx.w + y.P_loss - tau * w
    for _ in range(10):
        at = {phi: random.uniform(-9, 9), w: random.uniform(-60, 60), tau: random.uniform(-99, 99)}
        assert float(leak.subs(at)) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("finite", [False, True])
def test_undriven_conveyor_keeps_its_energy(finite: bool) -> None:
    p = start(crank_conveyor.Parameters, **{"trough.d": 0.0, "rod.finite": finite})
    u, x = crank_conveyor.Inputs(0.0), crank_conveyor.State(0.3, 90.0)
    stored = []
    while x.phi < 0.3 + 200 * math.pi:
        y = crank_conveyor.outputs(p, 0.0, x, u)
        stored.append(y.E_kin + y.E_pot)
        x = motion.advance(crank_conveyor, p, 0.0, x, motion.InputTrajectory(u, u, 0.05))
    assert stored[-1] == pytest.approx(stored[0], rel=1e-9)


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


def test_integrator_estimates_its_error_and_keeps_the_tolerance() -> None:
    def slope(t: float, x: Any) -> list[float]:
        return [x[1], -900.0 * x[0]]

    for tolerance in (1e-4, 1e-7, 1e-10):
        x = ode.integrate(slope, [1.0, 0.0], 1.0, [tolerance, 30 * tolerance])
        assert abs(x[0] - math.cos(30.0)) < 200 * tolerance
    loose = ode.integrate(slope, [1.0, 0.0], 1.0, [1e-3, 3e-2])
    assert abs(loose[0] - math.cos(30.0)) > 1e-8


def test_integrator_gives_up_on_what_is_not_finite() -> None:
    with pytest.raises(ArithmeticError, match="no sub-step is small enough"):
        ode.integrate(lambda t, x: [math.sqrt(0.5 - t)], [0.0], 1.0, [1e-9])


def test_integrator_gives_up_on_what_takes_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ode, "MOST_SUBSTEPS", 1000)
    with pytest.raises(ArithmeticError, match="more than 1000 sub-steps"):
        ode.integrate(lambda t, x: [x[1], -1e12 * x[0]], [1.0, 0.0], 1.0, [1e-9, 1e-3])


@pytest.fixture(scope="module", params=REFERENCE, ids=lambda key: f"{key[0]}{key[1]}")
def orbit(request: pytest.FixtureRequest) -> Any:
    """The steady orbit of motor and conveyor integrated as one system."""
    name, nu = request.param
    machine = SETS[name]
    t = revolution_samples(nu, 28, 256)
    y = monolithic(machine.start(nu), t[-1], t_eval=t).y
    return machine, nu, t, y, REFERENCE[request.param]


def test_the_coupled_system_agrees_with_the_reference_orbit(orbit: Any) -> None:
    machine, nu, t, (phi, w, tau, _, _), want = orbit
    lagged = phi >= phi[-1] - 8 * math.pi
    speed, torque = (harmonics(phi[lagged], x[lagged])[1] for x in (w, tau))
    speed_4 = harmonics(phi[lagged], w[lagged])[3]
    assert abs(speed) == pytest.approx(want[0], rel=2e-7)
    assert math.degrees(cmath.phase(speed)) == pytest.approx(want[1], abs=1e-5)
    assert abs(torque) == pytest.approx(want[2], rel=2e-7)
    assert math.degrees(cmath.phase(torque)) == pytest.approx(want[3], abs=1e-5)
    began = CubicSpline(phi, t)(phi[-1] - 8 * math.pi)
    assert 8 * math.pi / (t[-1] - began) == pytest.approx(want[4], rel=1e-8)
    assert abs(speed_4) == pytest.approx(want[8], rel=1e-4)


def test_motor_work_is_damper_loss_in_every_revolution(orbit: Any) -> None:
    machine, nu, t, (phi, w, tau, work, loss), want = orbit
    turn = [phi[-1] - 2 * math.pi, phi[-1]]
    spent = [np.diff(CubicSpline(phi, x)(turn))[0] for x in (work, loss)]
    assert spent[0] == pytest.approx(spent[1], rel=1e-7)
    if nu == 40:
        assert spent[0] == pytest.approx(50.0658366, rel=1e-7)


def test_time_mean_of_the_torque_lies_on_the_motor_line(orbit: Any) -> None:
    machine, nu, t, (phi, w, tau, work, loss), want = orbit
    began = float(CubicSpline(phi, t)(phi[-1] - 8 * math.pi))
    mean = CubicSpline(t, tau).integrate(began, t[-1]) / (t[-1] - began)
    assert mean == pytest.approx(machine.A(nu) - machine.B * want[4], abs=2e-5)
    assert mean == pytest.approx(want[6], abs=2e-5)


@pytest.mark.parametrize(("name", "nu", "error"), [("A", 40.0, 168.7), ("B", 30.0, 140.2)])
def test_phase_of_formula_26_as_printed_is_wrong(name: str, nu: float, error: float) -> None:
    machine = SETS[name]
    printed = math.degrees(cmath.phase(machine.load_ripple(nu)) + math.atan(2 * machine.T * nu))
    torque = REFERENCE[name, int(nu)][3]
    corrected = math.degrees(cmath.phase(machine.torque_ripple(nu)))
    assert abs(corrected - torque) < 0.11
    assert (printed - torque) % 360.0 == pytest.approx(error, abs=0.2)


def test_ripple_of_formulas_10_17_and_26_as_printed_is_wrong() -> None:
    """The sign of (10), the root (1 + 2 T nu^2) of (17), the spring in the root of (26)."""
    m, nu = SETS["A"], 40.0
    w2, w2_phase, tau2, *_ = REFERENCE["A", 40]
    speed, torque = m.speed_ripple(nu), m.torque_ripple(nu)
    assert (abs(speed), abs(torque)) == pytest.approx((w2, tau2), rel=1e-3)
    assert math.degrees(cmath.phase(speed)) == pytest.approx(w2_phase, abs=0.1)
    assert math.degrees(cmath.phase(-speed)) - w2_phase == pytest.approx(180.0, abs=0.1)
    printed_17 = abs(speed) * math.sqrt((1 + 2 * m.T * nu**2) / (1 + (2 * m.T * nu) ** 2))
    assert (printed_17, w2) == pytest.approx((7.45, 2.68), rel=2e-3)
    printed_26 = math.hypot(
        m.slope - 4 * m.theta0 * m.T * nu**2, 2 * nu * (m.theta0 + m.T * m.c * m.r**2 / 2)
    )
    assert m.B * abs(m.load_ripple(nu)) / printed_26 / tau2 - 1 == pytest.approx(-0.81, abs=0.01)


def test_energies_12_as_printed_count_the_trough_twice() -> None:
    p = start(crank_conveyor.Parameters)
    x = crank_conveyor.State(0.7, 40.0)
    crank = crank_conveyor.prepare(p, x)
    dx = crank_conveyor.trough(p, crank)[1]
    theta, _ = crank_conveyor.load(p, x, crank)
    printed = 2 * (p.rotor.J / 2 + p.trough.m * dx**2)
    assert printed - p.rotor.J == pytest.approx(2 * (theta - p.rotor.J), rel=1e-12)


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
        got = turn.rotated(near, angle)
        assert got.angle == angle
        assert abs(got.sin - math.sin(angle)) < 3e-15
        assert abs(got.cos - math.cos(angle)) < 3e-15
        assert turn.rotated(near, start_angle) == near


@pytest.mark.parametrize("finite", [False, True])
@pytest.mark.parametrize("w", [-40.0, 40.0, 400.0])
def test_a_step_does_not_depend_on_the_direction_prepared_for_it(finite: bool, w: float) -> None:
    p = start(crank_conveyor.Parameters, **{"rod.finite": finite, "rod.l": 0.05})
    x, u = crank_conveyor.State(2.0, w), crank_conveyor.Inputs(30.0)
    unprepared: Any = SimpleNamespace(**vars(crank_conveyor) | {"prepare": None})
    ends = [
        motion.advance(model, p, 0.0, x, motion.InputTrajectory(u, u, 1e-3))
        for model in (crank_conveyor, unprepared)
    ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-13)
    assert abs(ends[0].w - w) > 1e-3
