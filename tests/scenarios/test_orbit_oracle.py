"""The exact orbits against integration in time, first-order theory and a known drive."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from components.crank_conveyor import model as crank_conveyor
from fmukit.declare.record import start
from scenarios.conveyor.first_order import SETS, Machine
from tests.oracle import monolithic
from tests.scenarios.orbit_oracle import (
    Drive,
    NoOrbitError,
    angles,
    collocated,
    f_rod_peak,
    features,
    orbit,
    order2,
    resampled,
)

RATTLING = Drive(m=2000.0, c=1.6e6, d=200.0, J=0.3, r=0.012, l=0.06, finite=True)
STIFF = Drive(T=0.002, B=35.8, r=0.02, l=0.1, finite=True, c=0.0)
PARAMETRIC = Drive(m=2000.0, c=1.6e6, d=200.0, J=0.3, T=1.0)
NARROW = Drive(B=4230, T=0.247, J=1.86, m=15.4, r=0.0316, c=0, d=16.8)


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


@pytest.mark.parametrize("drive", [Drive(), RATTLING, NARROW], ids=["A", "large", "narrow"])
def test_twice_the_nodes_change_nothing(drive):
    exact = orbit(drive, 1.01 * drive.nu_res)
    finer = collocated(drive, exact.nu, resampled(exact.v, 2 * len(exact.v) - 1))
    for name in ("w2", "tau2", "mean_speed", "f_rod_max"):
        assert getattr(finer, name) == pytest.approx(getattr(exact, name), rel=1e-11), name
    for name in ("w2_slope", "tau2_slope"):
        assert getattr(finer, name) == pytest.approx(getattr(exact, name), rel=1e-9), name


@pytest.mark.parametrize("quantity", ["w2", "tau2"])
def test_orbits_of_small_ripple_are_those_of_first_order_theory(quantity):
    formula = {"w2": Machine.speed_ripple, "tau2": Machine.torque_ripple}[quantity]
    error = []
    for share in (1 / 8, 1 / 16, 1 / 32):
        machine = replace(SETS["A"], m=200.0 * share, c=720e3 * share, d=4000.0 * share)
        exact = getattr(orbit(Drive.of(machine.start(38.0)), 38.0), quantity)
        error.append(abs(exact / formula(machine, 38.0) - 1))
    assert [np.log2(a / b) for a, b in pairwise(error)] == pytest.approx([2.0, 2.0], abs=0.05)


def test_deviations_grow_by_the_multipliers():
    exact = orbit(PARAMETRIC, 2 * PARAMETRIC.nu_res)
    w, tau = exact.nu + exact.v[0], exact.M[0]
    change = []
    for dw, dtau in ((0.0, 0.0), (1e-5, 0.0), (0.0, 1e-3)):
        state = {"conveyor.w": w + dw, "motor.tau": tau + dtau}
        _, speeds, torques, *_ = in_time(PARAMETRIC, exact.nu, 1, **state)
        change.append((speeds[-1], torques[-1]))
    initial, *after_turns = np.array(change)
    assert initial == pytest.approx([w, tau], rel=1e-9)
    matrix = (after_turns - initial).T / [1e-5, 1e-3]
    assert sorted(np.linalg.eigvals(matrix).real) == pytest.approx(
        sorted(exact.multipliers.real), rel=1e-4
    )
    assert not exact.stable
    with pytest.raises(NoOrbitError, match="unstable"):
        features(PARAMETRIC, 1.9 * PARAMETRIC.nu_res, 2.1 * PARAMETRIC.nu_res)


def test_a_small_ripple_dies_out_as_the_damping_ratio_says():
    drive = Drive()
    rate = 2 * drive.nu_res * drive.zeta
    expected = np.exp(-2 * np.pi * rate / 50.0)
    assert abs(orbit(drive, 50.0).multipliers) == pytest.approx([expected] * 2, rel=1e-3)


def test_a_narrow_ridge_is_located():
    assert features(NARROW, 29.0, 72.0) == {
        "nu_90": pytest.approx(47.87854, abs=6e-6),
        "nu_peak_tau": pytest.approx(47.89995, abs=6e-6),
        "tau2_peak": pytest.approx(416.129, abs=6e-4),
        "nu_peak_w": pytest.approx(47.92160, abs=6e-6),
        "w2_peak": pytest.approx(2.32908, abs=6e-6),
    }


@pytest.mark.parametrize(
    ("drive", "lowest", "highest"),
    [
        (replace(RATTLING, m=500.0, c=5e5), 45.0, 53.0),
        (Drive(T=0.02, B=35.8), 18.0, 45.0),
        (NARROW, 29.0, 72.0),
    ],
    ids=["large ripple", "set B", "narrow ridge"],
)
def test_features_stand_where_the_orbits_have_them(drive, lowest, highest):
    """The slope over five orbits, which knows no derivative by the speed, is zero."""
    located = features(drive, lowest, highest)
    assert orbit(drive, located["nu_90"]).lag == pytest.approx(90.0, abs=1e-7)
    step = 0.02 * drive.zeta * drive.nu_res
    for name, height in (("nu_peak_tau", "tau2"), ("nu_peak_w", "w2")):
        around = [orbit(drive, located[name] + k * step) for k in range(-2, 3)]
        a, b, top, d, e = (abs(getattr(sample, height)) for sample in around)
        assert located[f"{height}_peak"] == pytest.approx(top, rel=1e-10)
        assert top > max(b, d)
        assert abs(a - 8 * b + 8 * d - e) / 12 < 1e-4 * (2 * top - b - d)


def test_a_range_without_a_feature_holds_none():
    below = features(NARROW, 29.0, 40.0)
    assert set(below.values()) == {None}
    beyond = features(NARROW, 47.88, 72.0)
    assert beyond["nu_90"] is None
    assert beyond["nu_peak_tau"] == pytest.approx(47.899946559, abs=1e-8)


def test_the_rod_force_is_that_of_the_listed_speeds():
    drive = Drive()
    assert f_rod_peak(drive, [60.0, 36.0, 40.0]) == pytest.approx(4900.10399, abs=6e-6)


def test_a_crank_that_is_thrown_back_has_no_orbit():
    drive = replace(PARAMETRIC, T=0.3)
    nu = drive.nu_res
    began = {"motor.A": drive.slope * nu, "motor.tau": 0.0, "conveyor.phi": 0.0, "conveyor.w": nu}
    run = monolithic(drive.start | began, 2 * np.pi * 40 / nu, rtol=1e-8, atol=1e-8)
    assert run.y[1][run.t > run.t[-1] / 2].min() < 0
    with pytest.raises(NoOrbitError, match="no orbit found at"):
        orbit(drive, nu)
