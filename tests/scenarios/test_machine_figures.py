"""Figures behind the verdicts about iron and orientator hold against points of mass and finer steps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from components.iron_drive import model as iron
from fmukit.declare.record import start
from scenarios.orientator import machine as orientator
from tests.components.iron_oracle import by_material_points
from tests.conftest import ask


def slow_torque() -> float:
    """The largest torque [N.m] at the cam of a turn at no speed, from points of mass in the rise."""
    p = start(iron.Parameters)

    def torque(phi: float) -> float:
        return float(by_material_points(p, phi, 0.0, 0.0, p.friction.K_up)["tau_cam"])

    best = max(np.linspace(0.05, 0.95, 10) * p.cam.rise, key=torque)
    ends = best - 0.1 * p.cam.rise, best + 0.1 * p.cam.rise
    top = minimize_scalar(lambda phi: -torque(phi), bounds=ends, method="bounded")
    return -float(top.fun)


def test_the_torque_of_a_slow_turn_is_that_of_points_of_mass() -> None:
    figure = ask("iron_start", motor_A=0.05).figures["tau_cam_max"]
    assert figure.error and abs(figure.value - slow_torque()) <= figure.error


def test_a_motor_that_turns_the_cam_backwards_does_not_stall() -> None:
    """It turns at 42 cycles per minute, like the same motor forwards."""
    answer = ask("iron_start", motor_A=-4.0, step=2e-3)
    mean = answer.figures["w_cam_mean"]
    assert mean.value < -4.0


@pytest.mark.parametrize(
    ("speed", "friction"), [(4.19, 0.35), (1.3, 0.6), (5.0, 0.1), (9.0, 0.05), (8.5, 0.35)]
)
def test_the_least_reaction_of_the_wall_holds_against_finer_steps(
    speed: float, friction: float
) -> None:
    """Against the rows of a run with steps of 20 us, and a pull has its sentence."""
    answer = ask("orientator_cycle", speed=speed, friction=friction)
    rows = ask("orientator_cycle", speed=speed, friction=friction, step=2e-5)
    frame = rows.tables["orientator_cycle.csv"].frame
    force = frame["orientator.N_K"][frame["orientator.stage"] < orientator.ORIENTED].to_numpy()
    least, figure = int(force.argmin()), answer.figures["wall_least"]
    near = np.abs(np.diff(force[max(least - 2, 0) : least + 2])).min()
    assert figure.error is not None and figure.error < 0.02
    oriented, pulls = answer.figures["oriented"].value == 1.0, figure.value + figure.error < 0.0
    assert ("which a real wall cannot" in answer.verdict.splitlines()[0]) == (oriented and pulls)
    assert abs(figure.value - force[least]) <= figure.error + near


def test_an_impulse_of_a_landing_that_never_was_is_refused() -> None:
    """A product held in the chute lands on nothing; one that stops the catcher, not on the hook."""
    held = ask("orientator_cycle", speed="110rpm").figures
    stopped = ask("orientator_cycle", speed=10.7, friction=0.3, start={"orientator.chute.H": 0.025})
    for name in ("corner_impulse", "wall_impulse", "hook_impulse"):
        assert held[name].error is None
    assert stopped.figures["corner_impulse"].value > 0.0
    assert stopped.figures["hook_impulse"].error is None


def test_a_run_up_that_passes_its_resonance_by_a_hundred_errors_has_a_time() -> None:
    """Its speed comes back to 0.177 rad/s above it, with an error of 0.001 rad/s."""
    start = {
        "motor.B": 13.6933, "motor.T": 0.0305013, "conveyor.rotor.J": 0.013186, "conveyor.crank.r": 0.00381011,
        "conveyor.trough.m": 62.6949, "conveyor.trough.d": 187.206, "conveyor.spring.c": 1657520.0,
        "conveyor.rod.l": 0.164591,
    }  # fmt: skip
    figures = ask("run_up", speed=215.698, start=start).figures
    passing = figures["linear_passing"]
    assert passing.error is not None, passing.reason
    assert abs(passing.value - 0.0055195) <= passing.error + 1e-5
    near = ask("run_up", speed=215.295, start=start).figures["linear_passing"]
    assert near.error is None or near.error > 1e-3


def test_the_curves_of_fig_4_part_with_the_square_of_the_speed() -> None:
    """The paper says that they nearly coincide up to 40 rpm; four times the spread at twice the speed."""
    answer = ask(
        "orientation_time", frictions=[0.2, 0.35, 0.5], speeds=["20rpm", "40rpm", "100rpm"]
    )
    rows = answer.tables["orientation_time.csv"].frame
    spread = {}
    for n, times in ((20.0, [0.2419, 0.2442, 0.2465]), (40.0, [0.2521, 0.2638, 0.2778])):
        row = rows[rows["n"] == n].sort_values("mu")["orientation_time"].to_numpy()
        assert row == pytest.approx(times, abs=6e-5)
        spread[n] = np.ptp(row)
    assert 4.0 < spread[40.0] / spread[20.0] < 7.0
