"""The parts of a drive against closed solutions, derivations and balances."""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from components.DC_motor import model as motor
from components.drive_motor import model as drive_motor
from components.gearbox import model as gearbox
from components.shaft_link import model as link
from components.speed_controller import model as controller
from fmukit.declare.model import complete_model
from fmukit.declare.record import start
from fmukit.runtime import hybrid as motion
from tests.oracle import Part, joined, part, random_parameters


def rotor(J: float, w: float = 0.0) -> Part:
    """An inertia: a gearbox that changes nothing."""
    return part(gearbox, i=1.0, eta=1.0, J=J, w_a=w)


def differs(actual: Any, wanted: Any) -> float:
    """The largest difference over the largest value."""
    return float(np.abs(actual - np.asarray(wanted)).max() / np.abs(wanted).max())


LAGS: dict[str, tuple[Any, Callable[[Any, Any], tuple[float, float]]]] = {
    # each motor's state goes to a value with a time constant
    "DC motor": (motor, lambda p, u: ((u.v - p.k * u.w) / p.R, p.L / p.R)),
    "drive motor": (drive_motor, lambda p, u: (p.A - p.B * u.w, p.T)),
}


@pytest.mark.parametrize("name", LAGS)
def test_motor_steps_exactly(name: str) -> None:
    """Voltage and speed run on lines over steps much shorter and much longer than the time constant."""
    model, lag = complete_model(LAGS[name][0]), LAGS[name][1]
    draw = random.Random(2)
    for h in (1e-5, 3e-3, 0.1, 1.0) * 20:
        p = random_parameters(model, draw, 0.5)
        x = model.State(draw.uniform(-90, 90))
        u0, u1 = (
            model.Inputs(*(draw.uniform(-90, 90) for _ in model.Inputs._fields)) for _ in "01"
        )
        (before, T), (after, _) = lag(p, u0), lag(p, u1)
        late = (after - before) / h * T
        wanted = after - late + (x[0] - before + late) * math.exp(-h / T)
        rounding = 1e-14 * (abs(late) + abs(before))
        assert model.exact(p, x, u0, u1, h)[0] == pytest.approx(
            wanted, rel=1e-9, abs=1e-9 + rounding
        )
        assert model.derivatives(p, 0.0, x, u0)[0] == pytest.approx((before - x[0]) / T, rel=1e-9)


def run_under_control(J: float, w_ref: float, stop: float, **values: Any) -> tuple[Any, Any]:
    """Times and speed of an inertia from rest under a controller."""
    it, t = part(controller, **values), np.linspace(0.0, stop, 2001)

    def feed(x: dict[str, Any]) -> list[Any]:
        u = controller.Inputs(w_ref, x["rotor"].w_a)
        return [u, gearbox.Inputs(controller.outputs(it.p, 0.0, x["it"], u).tau, 0.0)]

    return t, joined({"it": it, "rotor": rotor(J)}, feed, t, max_step=stop / 400)["rotor"].w_a


@pytest.mark.parametrize("J", [0.1, 2.0])
def test_controlled_inertia_follows_the_closed_step_response(J: float) -> None:
    """1 - e^(-D w0 t) [cosh s - D/s sinh s], s^2 = (D^2 - 1), overdamped and not; no limit."""
    t, w = run_under_control(J, 40.0, 3.0, tau_max=1e6)
    w0, D = math.sqrt(2.0 / (0.5 * J)), math.sqrt(2.0 * 0.5 / J) / 2
    assert (D < 1) == (J > 1)
    s = cmath.sqrt(D * D - 1)
    fade = np.cosh(s * w0 * t) - D / s * np.sinh(s * w0 * t)
    assert differs(w, 40.0 * (1 - np.exp(-D * w0 * t) * fade).real) < 1e-8


def test_back_calculation_keeps_the_overshoot_of_a_long_saturation_small() -> None:
    """The torque stays within its limit; without back-calculation the overshoot grows with the step."""
    worst = {}
    for on in (True, False):
        for w_ref in (40.0, 160.0):
            t, w = run_under_control(2.0, w_ref, w_ref / 2 + 4, antiwindup=on)
            assert w[:100] == pytest.approx(30.0 / 2.0 * t[:100], rel=1e-9)
            assert np.abs(np.diff(w) / t[1]).max() < 30.0 / 2.0 * (1 + 1e-9)
            worst[on, w_ref] = w.max() - w_ref
            assert not on or w[-1] == pytest.approx(w_ref, abs=1e-3)
    assert worst[True, 160.0] == pytest.approx(worst[True, 40.0], rel=0.02)
    assert worst[False, 160.0] > 3.5 * worst[False, 40.0] > 20 * worst[True, 160.0]


def test_gearbox_reverses_without_chatter_and_closes_its_energy() -> None:
    """Two straight lines of the speed through standstill under load, at few calls of the equations."""
    calls, it, t = [], part(gearbox, w_0=1e-4), np.linspace(0.0, 2.0, 401)

    def count_calls(*args: Any) -> Any:
        calls.append(args)
        return gearbox.derivatives(*args)

    model: Any = SimpleNamespace(**vars(complete_model(gearbox)) | {"derivatives": count_calls})
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


def test_a_locking_gearbox_is_warned_of() -> None:
    assert "this one does not" in next(gearbox.check(start(gearbox.Parameters, eta=0.4)))


def two_rotors(it: Part, times: Any, w: float = 3.0) -> Any:
    """Twist and speeds of inertias of 0.1 and 0.4 kg.m2 on a shaft."""

    def feed(x: dict[str, Any]) -> list[Any]:
        u = link.Inputs(x["a"].w_a, x["b"].w_a)
        y = link.outputs(it.p, 0.0, x["it"], u)
        return [u, gearbox.Inputs(y.tau_a, 0.0), gearbox.Inputs(y.tau_b, 0.0)]

    actual = joined({"it": it, "a": rotor(0.1, w), "b": rotor(0.4)}, feed, times, max_step=1e-3)
    return actual["it"].twist, actual["a"].w_a, actual["b"].w_a


def test_two_inertias_swing_and_decay_as_the_closed_solution() -> None:
    """Without play: w^2 = c g - decay^2, decay = d g / 2, g = 1/J1 + 1/J2."""
    it, t, g = part(link, b=0.0, twist=0.0), np.linspace(0.0, 0.5, 501), 1 / 0.1 + 1 / 0.4
    decay = it.p.d * g / 2
    w = math.sqrt(it.p.c * g - decay**2)
    wanted = 3.0 / w * np.exp(-decay * t) * np.sin(w * t)
    assert differs(two_rotors(it, t)[0], wanted) < 1e-9


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
