"""Transfer functions of the iron drive, and its follower in the air and landing."""

from __future__ import annotations

import math
import random
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from components.iron_drive import flight, geometry
from components.iron_drive import model as iron
from components.iron_drive.declarations import Side
from cosim import System, run
from fmukit.declare.model import complete_model
from fmukit.declare.record import start
from tests.components.iron_oracle import DIMENSIONS, Reference, transfer
from tests.hosts.host import Unit
from tests.oracle import by_name, events_and_end, random_parameters

FLIES: dict[str, Any] = {"follower.lifts": True}
RUBS = {"joints.cam": 0.05, "joints.rocker": 0.1, "joints.link": 0.02, "joints.sprocket": 0.01}
ABOVE: dict[str, Any] = {"wrap": iron.Wrap.tangent, "spring.side": Side.above}
STORED = ("E_kin", "E_pot", "E_friction", "E_joints", "E_landing")
TRANSFER = ("alpha_1", "alpha_2", "beta_1", "beta_2", "H_1", "H_2")


@pytest.mark.parametrize("wrap", iron.Wrap)
def test_transfer_functions_are_the_derivatives_of_the_papers_positions(wrap: iron.Wrap) -> None:
    draw = random.Random(3)
    for p in [
        start(iron.Parameters, wrap=wrap),
        *(random_parameters(iron, draw, 0.1, wrap=wrap),) * 3,
    ]:
        phi = draw.uniform(0.05, 0.95) * p.cam.rise
        wanted = map(float, transfer(wrap)(phi, *(by_name(p)[name] for name in DIMENSIONS)))
        y = iron.outputs(p, 0.0, start(iron.State, phi=phi, w_cam=1.0), iron.Inputs(0.1))
        assert [getattr(y, name) for name in TRANSFER] == pytest.approx(list(wanted), rel=1e-9)


CASES: dict[str, tuple[dict[str, Any], float, float, float, float, int]] = {
    # parameters, tau, phi, w_cam, until, landings
    "below": ({"follower.e": 0.3}, 0.1, 0.0, 9.0, 0.5, 5),
    "above, tangent, with friction in the joints": (
        {"follower.e": 0.8, "on_invalid": 1} | ABOVE | RUBS, 0.1, 0.0, 6.0, 0.9, 3,
    ),
    "reversing in the air": ({"follower.e": 0.5}, 0.3, 0.0, 14.0, 0.6, 4),
}  # fmt: skip


*USUAL, LAST = CASES


@pytest.mark.parametrize("name", [*USUAL, pytest.param(LAST, marks=pytest.mark.slow)])
def test_flight_and_landings_are_those_of_another_integration(name: str, fmus: Path) -> None:
    values, tau, phi, w, stop, landings = CASES[name]
    end = Reference(start(iron.Parameters, **FLIES, **values), tau).run(phi, w, stop)
    python, native, ends = fmus, fmus / "native", []
    runs = (
        [(native, 100), (python, 10), (native, 10)]
        if name == "below"
        else [(native, 100), (native, 10)]
    )
    for folder, steps in runs:
        unit = Unit(folder / "IronDrive.fmu").start(tau=tau, phi=phi, w_cam=w, **FLIES, **values)
        for n in range(steps):
            unit.step(n * stop / steps, stop / steps)
        ends.append([float(value) for value in unit.outputs()])
    assert ends[-1] == pytest.approx(ends[0], rel=1e-8, abs=1e-8)
    assert all(end == ends[-1] for end in ends[1:])
    assert unit.get("landings") == len(end["landed"]) == landings
    for key in ("phi", "w_cam", "alpha", "gap", "E_friction", "E_landing", "t_flight"):
        assert unit.get(key) == pytest.approx(end[key], rel=2e-9, abs=2e-9), key
    _, speed, impulse, _ = end["landed"][-1]
    assert unit.get("v_landing") == pytest.approx(speed, rel=1e-8)
    assert unit.get("S_landing") == pytest.approx(impulse, rel=1e-8)


def test_energy_of_a_bouncing_drive_is_the_work_of_its_torque(fmus: Path) -> None:
    """Stored, rubbed off in guide and joints, and lost at landings."""
    for values, tau, phi, w, _, _ in CASES.values():
        inputs = {"tau": tau, "phi": phi, "w_cam": w} | FLIES | values
        options = {f"iron.{name}": value for name, value in inputs.items()}
        r = run(
            System({"iron": fmus / "native" / "IronDrive.fmu"}, [], options), stop=1.0, step=1e-3
        )
        energy = sum(r[f"iron.{name}"] for name in STORED)
        work = 36 * tau * (r["iron.phi"] - phi)
        assert r["iron.landings"][-1] >= 3
        assert np.abs(energy - energy[0] - work).max() < 1e-9 * energy.max()


def met(p: Any, phi: float, w: float, w_gap: float) -> tuple[Any, Any, Any]:
    """A state in which the follower meets the cam, the one after, and the position."""
    x = start(iron.State, phi=phi, w_cam=w, w_gap=w_gap, flying=True)
    return x, flight.after_landing(p, x), geometry.position(p, phi)


def test_an_impact_takes_momentum_and_energy_as_the_reference_solution() -> None:
    """Newton's restitution with the friction of the guide, in random states; energy is lost between cam
    and follower, (1 - e^2) / 2 m v^2 where the iron does not reverse, and in the guide, and never made.
    """
    draw, reversed_, reference = random.Random(6), 0, Reference(start(iron.Parameters), 0.0)
    for n in range(100):
        e, light = draw.uniform(0.0, 1.0), {"reducer.J": draw.uniform(0, 1e-3)}
        p = start(iron.Parameters, **FLIES, **{"follower.e": e} | (light if n % 2 else {}))
        x, y, at = met(p, draw.uniform(-9, 9), draw.uniform(-9, 9), -draw.uniform(0.1, 9.0))
        a_1, J_c = at.alpha.first, p.cam.J + p.reducer.J * p.reducer.i_g**2
        reference.q, reference.J_c = by_name(p), J_c
        v, v_1 = (a_1 * s.w_cam - s.w_gap for s in (x, y))
        cell = sum(x.phi % (2 * pi) >= end for end in reference.ends)
        state = np.array([x.phi, x.w_cam, at.alpha.value, v, 0.0, 0.0])
        after, leaves, impulse = reference.impact(state, cell)
        wanted = [after[1], after[3], after[5], impulse, leaves]
        assert [y.w_cam, v_1, y.E_friction, y.S_landing, y.flying] == pytest.approx(
            wanted, rel=1e-9
        )
        kinetic = (J_c * (x.w_cam**2 - y.w_cam**2) + at.J_a * (v**2 - v_1**2)) / 2
        assert kinetic == pytest.approx(y.E_landing + y.E_friction, abs=1e-10)
        assert y.E_friction > 0.0 and y.E_landing >= -1e-12
        if v * v_1 > 0.0:
            K = p.friction.K_down if v > 0 else p.friction.K_up
            reduced = 1 / (a_1**2 / J_c + 1 / (at.J_a + K * p.iron.m * at.H_a**2))
            assert y.E_landing == pytest.approx((1 - e * e) / 2 * reduced * x.w_gap**2, abs=1e-10)
        reversed_ += v > 0.0 > v_1
    assert 10 < reversed_ < 95


def test_bounces_on_a_cam_at_rest_end_as_a_ball_does() -> None:
    """Dropped from a small gap in a dwell: all bounces last 2 e v / (a (1 - e)), and v^2 falls by e^2."""
    rest = {"reducer.J": 1e9, "friction.K_up": 0.0, "friction.K_down": 0.0}
    p = start(iron.Parameters, **FLIES, **rest, **{"follower.e": 0.25, "follower.v": 5e-9})
    u, gap = iron.Inputs(0.0), 1e-6
    x = iron.sample(p, 0.0, start(iron.State, phi=5.0, gap=gap), None, u)
    fall = -iron.derivatives(p, 0.0, x, u).w_gap
    events = events_and_end(complete_model(iron), p, 0.0, x, u, 2e-3)
    recorded = [(t, old, new) for t, old, new in events if new.landings > old.landings]
    first, v = math.sqrt(2 * gap / fall), math.sqrt(2 * gap * fall)
    times, bounces = [t for t, _, _ in recorded], [-old.w_gap for _, old, _ in recorded]
    assert bounces[:6] == pytest.approx([v * 0.25**k for k in range(6)], rel=1e-5)
    assert times[-1] == pytest.approx(first + 2 * v / fall / 3, rel=1e-5)
    end = recorded[-1][2]
    assert not end.flying and (end.gap, end.w_gap) == (0.0, 0.0)
    J = geometry.position(p, 5.0).J_a
    assert end.E_landing == pytest.approx(J * v * v / 2, rel=1e-5)


def test_the_chain_stays_taut_above_the_speed_at_which_the_follower_leaves(fmus: Path) -> None:
    """Held to the cam, the run of the chain would go slack at 8.54 rad/s, the iron at 9.11 rad/s."""
    for w in (8.6, 9.4, 12.0):
        options = {"w_cam": w, "tau": 0.0, "reducer.J": 1e3, "phi": 0.0} | FLIES
        options = {f"iron.{name}": value for name, value in options.items()}
        system = System({"iron": fmus / "native" / "IronDrive.fmu"}, [], options)
        r = run(system, stop=2 * pi / w, step=1e-3)
        assert r["iron.landings"][-1] > 0
        assert min(r["iron.T_span"].min(), r["iron.T_iron"].min()) > 5.0
