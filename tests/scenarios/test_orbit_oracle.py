"""The exact orbits against integration in time."""

from __future__ import annotations

import numpy as np
import pytest

from components.crank_conveyor import model as crank_conveyor
from fmukit.declare.record import start
from scenarios.conveyor.first_order import SETS
from tests.oracle import monolithic
from tests.scenarios.orbit_oracle import (
    Drive,
    angles,
    orbit,
    order2,
)

RATTLING = Drive(m=2000.0, c=1.6e6, d=200.0, J=0.3, r=0.012, l=0.06, finite=True)
STIFF = Drive(T=0.002, B=35.8, r=0.02, l=0.1, finite=True, c=0.0)


def in_time(drive: Drive, nu: float, revolutions: int, **state: float) -> tuple[np.ndarray, ...]:
    """Times, speeds, torques, work of the motor and loss of the damper at the crank angles of 128 nodes in
    the last revolution.
    """
    began = {"motor.A": drive.slope * nu, "motor.tau": 0.0, "conveyor.phi": 0.0, "conveyor.w": nu}
    stop = 2 * np.pi * (revolutions + 1.2) / nu
    run = monolithic(drive.start | began | state, stop, dense_output=True)
    phi = 2 * np.pi * (revolutions - 1) + np.append(angles(128), 2 * np.pi)
    t = np.interp(phi, run.y[0], run.t)
    for _ in range(6):
        t = t - (run.sol(t)[0] - phi) / run.sol(t)[1]
    return t, *run.sol(t)[1:]


@pytest.mark.parametrize(
    ("drive", "nu", "revolutions", "large"),
    [
        (Drive(), 40.0, 20, 0.06),
        (Drive(), 60.0, 20, 0.005),
        (Drive.of(SETS["B"].start(30.0)), 30.0, 8, 0.04),
        (Drive(T=0.02, B=35.8, finite=True, l=0.03), 21.0, 8, 0.05),
        (STIFF, 30.0, 3, 0.02),
        (RATTLING, 44.0, 20, 0.35),
    ],
    ids=["long rod", "above", "set B", "short rod", "stiff motor", "large ripple"],
)
def test_orbits_are_what_runs_in_time_settle_on(drive, nu, revolutions, large):
    """So does the torque's mean in time, on the motor's line, and the work of the motor is the damper's loss."""
    t, w, tau, work, loss = in_time(drive, nu, revolutions)
    exact = orbit(drive, nu)
    assert work[-1] - work[0] == pytest.approx(loss[-1] - loss[0], rel=1e-7)
    mean = np.mean(tau[:-1] / w[:-1]) / np.mean(1 / w[:-1])
    assert mean == pytest.approx(drive.slope * nu - drive.B * exact.mean_speed, abs=2e-5)
    assert abs(exact.w2) > large * nu
    assert order2(w[:-1]) == pytest.approx(exact.w2, rel=1e-8)
    assert order2(tau[:-1]) == pytest.approx(exact.tau2, rel=1e-8)
    assert 2 * np.pi / (t[-1] - t[0]) == pytest.approx(exact.mean_speed, rel=1e-9)
    parameters = {
        name.removeprefix("conveyor."): value
        for name, value in drive.start.items()
        if name.startswith("conveyor.")
    }
    page = start(crank_conveyor.Parameters, **parameters)
    force = [
        crank_conveyor.outputs(
            page, 0.0, crank_conveyor.State(*state), crank_conveyor.Inputs(torque)
        ).f_rod
        for *state, torque in zip(angles(128), w, tau)
    ]
    assert exact.f_rod(angles(128)) == pytest.approx(np.array(force), rel=1e-7, abs=1e-6)
    assert 1.0 <= exact.f_rod_max / max(map(abs, force)) < 1.003
