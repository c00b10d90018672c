"""The parts of a drive against closed solutions, derivations and balances.

Most also show that a term of the wrong sign would be seen.
"""

from __future__ import annotations

import cmath
import math
import random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

from components.DC_motor import model as motor
from components.gearbox import model as gearbox
from components.shaft_link import model as link
from components.speed_controller import model as controller
from components.unbalance_exciter import model as exciter
from fmukit.declare.model import complete_model
from fmukit.declare.record import start
from fmukit.runtime import hybrid as motion
from tests.oracle import TIGHT, Part, joined, lagrange, part


def rotor(J: float, w: float = 0.0) -> Part:
    """An inertia: a gearbox that changes nothing."""
    return part(gearbox, i=1.0, eta=1.0, J=J, w_a=w)


def differs(actual: Any, wanted: Any) -> float:
    """The largest difference over the largest value."""
    return float(np.abs(actual - np.asarray(wanted)).max() / np.abs(wanted).max())


@pytest.mark.parametrize(("J", "swings"), [(0.01, False), (2e-4, True)])
def test_motor_on_an_inertia_runs_up_as_the_closed_solution(J: float, swings: bool) -> None:
    """Current and speed, from s^2 + s R/L + k^2/(J L) = 0, with real and with complex roots."""
    parts, t = {"motor": part(motor), "rotor": rotor(J)}, np.linspace(0.0, 0.05, 101)
    R, L, k = parts["motor"].p
    root = cmath.sqrt((R / L) ** 2 - 4 * k**2 / (J * L))
    assert (root.imag > 0.0) == swings
    root_1, root_2 = (-R / L + root) / 2, (-R / L - root) / 2
    a, b = np.exp(root_1 * t), np.exp(root_2 * t)
    w = 48.0 / k * (1 + (root_2 * a - root_1 * b) / (root_1 - root_2)).real
    i = 48.0 * J / k**2 * (root_1 * root_2 * (a - b) / (root_1 - root_2)).real

    def feed(x: dict[str, Any]) -> list[Any]:
        inputs = motor.Inputs(48.0, x["rotor"].w_a)
        return [inputs, gearbox.Inputs(k * x["motor"].i, 0.0)]

    actual = joined(parts, feed, t)
    assert max(differs(actual["motor"].i, i), differs(actual["rotor"].w_a, w)) < 1e-9


@pytest.mark.parametrize("h", [1e-5, 3e-3, 0.1])
def test_motor_steps_exactly(h: float) -> None:
    """A step over which voltage and speed run on lines, and v i = tau w + R i^2 + dE/dt."""
    p = start(motor.Parameters)
    for v0, v1, w0, w1, i in np.random.default_rng(1).uniform(-100, 100, (10, 5)):
        u0, u1, x = motor.Inputs(v0, w0), motor.Inputs(v1, w1), motor.State(i)
        trajectory = motion.InputTrajectory(u0, u1, h)

        def slope(t: float, y: Any, line: Any = trajectory) -> Any:
            return motor.derivatives(p, t, motor.State(*y), line.at(t))

        wanted = solve_ivp(slope, (0.0, h), x, **(TIGHT | {"atol": 1e-11})).y[0, -1]
        assert motor.exact(p, x, u0, u1, h).i == pytest.approx(wanted, rel=1e-9, abs=1e-9)
        y = motor.outputs(p, 0.0, x, u0)
        assert y.P_el == v0 * i
        assert (y.E_mag, y.P) == pytest.approx((p.L * i * i / 2, y.tau * w0), rel=1e-12)
        stored = p.L * i * motor.derivatives(p, 0.0, x, u0).i
        assert v0 * i == pytest.approx(y.P + p.R * i * i + stored, rel=1e-9, abs=1e-9)


def controlled(J: float, w_ref: float, stop: float, **values: Any) -> tuple[Any, Any]:
    """Times and speed of an inertia from rest under a controller."""
    it, t = part(controller, **values), np.linspace(0.0, stop, 2001)

    def feed(x: dict[str, Any]) -> list[Any]:
        u = controller.Inputs(w_ref, x["rotor"].w_a)
        return [u, gearbox.Inputs(controller.outputs(it.p, 0.0, x["it"], u).tau, 0.0)]

    return t, joined({"it": it, "rotor": rotor(J)}, feed, t, max_step=stop / 400)["rotor"].w_a


@pytest.mark.parametrize("J", [0.1, 2.0])
def test_controlled_inertia_follows_the_closed_step_response(J: float) -> None:
    """1 - e^(-D w0 t) [cosh s - D/s sinh s], s^2 = (D^2 - 1), overdamped and not; no limit."""
    t, w = controlled(J, 40.0, 3.0, tau_max=1e6)
    w0, D = math.sqrt(2.0 / (0.5 * J)), math.sqrt(2.0 * 0.5 / J) / 2
    assert (D < 1) == (J > 1)
    s = cmath.sqrt(D * D - 1)
    for sign in (1.0, -1.0):
        fade = np.cosh(s * w0 * t) - sign * D / s * np.sinh(s * w0 * t)
        wanted = 40.0 * (1 - np.exp(-D * w0 * t) * fade).real
        assert (differs(w, wanted) < 1e-8) == (sign > 0.0)


def test_back_calculation_keeps_the_overshoot_of_a_long_saturation_small() -> None:
    """The torque stays within its limit; without back-calculation the overshoot grows with the step."""
    worst = {}
    for on in (True, False):
        for w_ref in (40.0, 160.0):
            t, w = controlled(2.0, w_ref, w_ref / 2 + 4, antiwindup=on)
            assert w[:100] == pytest.approx(30.0 / 2.0 * t[:100], rel=1e-9)
            assert np.abs(np.diff(w) / t[1]).max() < 30.0 / 2.0 * (1 + 1e-9)
            worst[on, w_ref] = w.max() - w_ref
            assert not on or w[-1] == pytest.approx(w_ref, abs=1e-3)
    assert worst[True, 160.0] == pytest.approx(worst[True, 40.0], rel=0.02)
    assert worst[False, 160.0] > 3.5 * worst[False, 40.0] > 20 * worst[True, 160.0]


@pytest.mark.parametrize("i", [5.0, -3.0])
def test_gearbox_keeps_ratio_efficiency_and_balance_in_both_directions(i: float) -> None:
    draw, p = random.Random(2), start(gearbox.Parameters, i=i, eta=0.8)
    for _ in range(100):
        x: Any = gearbox.State(draw.uniform(-9, 9), draw.choice([-1, 1]) * draw.uniform(0.2, 90))
        u = gearbox.Inputs(draw.uniform(-9, 9), draw.uniform(-50, 50))
        y = gearbox.outputs(p, 0.0, x, u)
        assert (y.w_b, y.phi_b) == (x.w_a / i, x.phi_a / i)
        energy_pair = [gearbox.outputs(p, 0.0, x._replace(w_a=x.w_a + d), u).E_kin for d in (1, -1)]
        stored = (energy_pair[0] - energy_pair[1]) / 2 * y.a_a
        from_a, to_b = u.tau_a * x.w_a - stored, -u.tau_b * y.w_b
        args, taken = (from_a, to_b) if to_b > 0 else (-to_b, -from_a)
        assert taken == pytest.approx(p.eta * args, rel=1e-9)
        assert y.P_loss == pytest.approx(args - taken, rel=1e-9)
        assert y.P_loss > 0.0


def test_gearbox_reverses_without_chatter_and_closes_its_energy() -> None:
    """Two straight lines of the speed through standstill under load, at few calls of the equations."""
    calls, it, t = [], part(gearbox, w_0=1e-4), np.linspace(0.0, 2.0, 401)

    def counted(*args: Any) -> Any:
        calls.append(args)
        return gearbox.derivatives(*args)

    model: Any = SimpleNamespace(**vars(complete_model(gearbox)) | {"derivatives": counted})
    states, trajectory = [it.x], motion.InputTrajectory(it.u, it.u, t[1])
    for now in t[:-1]:
        states.append(motion.advance(model, it.p, now, states[-1], trajectory))
    phi, w = np.array(states).T
    forward, back = (2.0 - 3.0 / 0.9) / it.p.J, (2.0 - 3.0 * 0.9) / it.p.J
    turn = -100.0 / forward
    wanted = np.where(t < turn, 100.0 + forward * t, back * (t - turn))
    assert np.abs(w - wanted).max() < 1e-4
    assert len(calls) < 10_000
    forward_turn, again = 100.0 * turn / 2, -w[-1] * (2.0 - turn) / 2
    energy_loss = 3.0 * (forward_turn * (1 / 0.9 - 1) + again * (1 - 0.9))
    work, stored = (2.0 - 3.0) * phi[-1], it.p.J * (w[-1] ** 2 - 100.0**2) / 2
    assert work == pytest.approx(stored + energy_loss, rel=1e-5)
    assert work != pytest.approx(stored - energy_loss, rel=0.1)


def test_a_locking_gearbox_is_warned_of() -> None:
    assert "this one does not" in next(gearbox.check(start(gearbox.Parameters, eta=0.4)))


def two_rotors(it: Part, times: Any, w: float = 3.0, sign: float = 1.0) -> Any:
    """Twist and speeds of inertias of 0.1 and 0.4 kg.m2 on a shaft; sign = -1 turns the torque at b."""

    def feed(x: dict[str, Any]) -> list[Any]:
        u = link.Inputs(x["a"].w_a, x["b"].w_a)
        y = link.outputs(it.p, 0.0, x["it"], u)
        return [u, gearbox.Inputs(y.tau_a, 0.0), gearbox.Inputs(sign * y.tau_b, 0.0)]

    actual = joined({"it": it, "a": rotor(0.1, w), "b": rotor(0.4)}, feed, times, max_step=1e-3)
    return actual["it"].twist, actual["a"].w_a, actual["b"].w_a


def test_two_inertias_swing_and_decay_as_the_closed_solution() -> None:
    """Without play: w^2 = c g - decay^2, decay = d g / 2, g = 1/J1 + 1/J2."""
    it, t, g = part(link, b=0.0, twist=0.0), np.linspace(0.0, 0.5, 501), 1 / 0.1 + 1 / 0.4
    decay = it.p.d * g / 2
    w = math.sqrt(it.p.c * g - decay**2)
    wanted = 3.0 / w * np.exp(-decay * t) * np.sin(w * t)
    assert differs(two_rotors(it, t)[0], wanted) < 1e-9
    assert differs(two_rotors(it, t, sign=-1.0)[0], wanted) > 0.1


def test_shaft_flies_through_its_play_and_rebounds_as_the_closed_solution() -> None:
    """Undamped: b/v from flank to flank, half a period pi/w in contact, and back."""
    it, v, w = part(link, d=0.0, twist=-0.01), 3.0, math.sqrt(1000.0 * (1 / 0.1 + 1 / 0.4))
    flight, contact = 0.02 / v, math.pi / w
    t = np.linspace(0.0, 1.999 * (flight + contact), 801)
    since = t % (flight + contact)
    expected_twist = np.where(
        since < flight, v * since - 0.01, 0.01 + v / w * np.sin(w * (since - flight))
    )
    actual, w_a, w_b = two_rotors(it, t, v)
    assert differs(actual, np.where(t < flight + contact, expected_twist, -expected_twist)) < 1e-6
    assert 0.1 * w_a + 0.4 * w_b == pytest.approx(np.full(801, 0.3))


@pytest.mark.parametrize("b", [0.0, 0.02])
def test_flanks_never_pull_and_a_shaft_never_makes_energy(b: float) -> None:
    draw, it = random.Random(3), part(link, b=b, d=40.0, twist=0.0)
    for _ in range(500):
        x = link.State(draw.uniform(-0.03, 0.03))
        u = link.Inputs(draw.uniform(-20, 20), draw.uniform(-20, 20))
        y = link.outputs(it.p, 0.0, x, u)
        pressed = math.copysign(max(abs(x.twist) - b / 2, 0.0), x.twist)
        assert (y.tau_a, y.E_pot) == pytest.approx((-y.tau_b, it.p.c * pressed**2 / 2))
        assert y.P_loss >= 0.0
        assert b == 0.0 or (y.tau_b * x.twist >= 0.0 and (pressed != 0.0 or y.tau_b == 0.0))
    twist, w_a, w_b = two_rotors(it, np.linspace(0.0, 0.3, 1001))
    kinetic = (0.1 * w_a**2 + 0.4 * w_b**2) / 2
    energy = kinetic + it.p.c * np.maximum(np.abs(twist) - b / 2, 0.0) ** 2 / 2
    assert np.diff(energy).max() < 1e-10
    assert energy[-1] < 0.9 * energy[0]


def test_exciter_obeys_lagrange() -> None:
    """From the energies of the places of both masses, by SymPy, at random points; the mount's force is
    what the momentum of both lacks.
    """
    symbols = sympy.symbols("J m r d_r M c d tau phi w x v")
    J, m, r, d_r, M, c, d, tau, phi, w, x, v = symbols
    place = sympy.Matrix([x + r * sympy.cos(phi), r * sympy.sin(phi)])
    mass = place.jacobian([phi, x]) * sympy.Matrix([w, v])
    energy = (M * v**2 + J * w**2 + m * mass.dot(mass) - c * x**2) / 2
    derived = lagrange(energy, [phi, x], [w, v], [tau - d_r * w, -d * v])
    solve, draw = sympy.lambdify(symbols, derived), random.Random(4)
    for _ in range(50):
        at = [draw.uniform(0.5, 2.0) for _ in range(8)] + [draw.uniform(-9, 9) for _ in range(4)]
        J, m, r, d_r, M, c, d, tau, *state = at
        p = exciter.Parameters(exciter.Rotor(J, m, r, d_r), exciter.Mount(M, c, d))
        x, u = exciter.State(*state), exciter.Inputs(tau)
        rates = exciter.derivatives(p, 0.0, x, u)
        inertia, rest = solve(*at)
        assert inertia @ [[rates.w], [rates.v]] == pytest.approx(-rest, rel=1e-9, abs=1e-9)
        turned = r * (math.sin(x.phi) * rates.w + math.cos(x.phi) * x.w**2)
        force = exciter.outputs(p, 0.0, x, u).f
        assert -force == pytest.approx((M + m) * rates.v - m * turned, rel=1e-9, abs=1e-9)


def test_undriven_exciter_keeps_its_energy() -> None:
    values = {"rotor.d": 0.0, "mount.d": 0.0, "tau": 0.0, "phi": 0.3, "w": 60.0, "x": 2e-3}
    it = part(exciter, **values)
    actual = joined({"it": it}, lambda x: [it.u], np.linspace(0.0, 5.0, 251))["it"]
    ends = [exciter.outputs(it.p, 0.0, exciter.State(*y), it.u) for y in zip(*actual)]
    stored = np.array([y.E_kin + y.E_pot for y in ends])
    assert stored == pytest.approx(np.full(251, stored[0]), rel=1e-9)
    assert np.ptp([y.E_pot for y in ends]) > 1e-3 * stored[0]


@pytest.mark.parametrize("w", [30.0, 50.0, 90.0])
def test_mount_shakes_as_the_formula_for_a_small_unbalance(w: float) -> None:
    """|x| = U w^2 / |c - M w^2 + i d w| at a speed that a heavy rotor keeps; so the force."""
    values = {"rotor.J": 1e6, "rotor.d": 0.0, "rotor.m": 0.01, "mount.d": 200.0, "tau": 0.0}
    answer = 0.01 * 0.05 * w**2 / complex(50000.0 - 19.51 * w**2, 200.0 * w)
    it = part(exciter, **values, w=w, x=answer.real, v=(1j * w * answer).real)
    t = np.linspace(0.0, 4.0, 4001)
    actual = joined({"it": it}, lambda x: [it.u], t)["it"]
    for sign in (1, -1):
        wanted = (answer * np.exp(1j * sign * w * t)).real
        assert (differs(actual.x, wanted) < 1e-6) == (sign > 0)
    force = [exciter.outputs(it.p, 0.0, exciter.State(*y), it.u).f for y in zip(*actual)]
    assert max(force) == pytest.approx(abs(answer * complex(50000.0, 200.0 * w)), rel=1e-3)
