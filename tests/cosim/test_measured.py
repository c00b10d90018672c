"""The made record of a logger: its motion is that of the FMUs but for the belt, its rows are a logger's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim import System, run
from examples import logger
from examples import measured_drive as drive


def geared(fmus: Path) -> System:
    """The drive as its FMUs make it."""
    return System(
        {"motor": fmus / "native/DriveMotor.fmu", "conveyor": fmus / "native/CrankConveyor.fmu"},
        [f"motor.tau * {drive.RATIO} -> conveyor.tau", f"conveyor.w * {drive.RATIO} -> motor.w"],
        drive.TRUTH | {"conveyor.rod.finite": True, "conveyor.w": 0.0, "motor.tau": 0.0},
    )


def test_without_its_belt_the_measured_drive_is_that_of_the_fmus(fmus: Path) -> None:
    """They share no line of code; the coupling error of order 2 is all that is between them."""
    error = []
    for step in (1e-3, 5e-4):
        result = run(geared(fmus), stop=drive.STOP, step=step)
        phi, w, torque, angle = drive.motion(result["time"], belt=0.0)
        error.append([abs(w - result["conveyor.w"]).max(), abs(phi - result["conveyor.phi"]).max()])
        error[-1].append(abs(torque / drive.RATIO - result["motor.tau"]).max())
        assert angle == pytest.approx(drive.RATIO * phi, abs=1e-9)
    assert np.divide(*error) == pytest.approx(4.0, abs=0.05)
    assert error[1] == pytest.approx([6.0e-4, 4.8e-5, 4.1e-3], rel=0.1)


def test_the_record_is_what_a_logger_makes_of_the_motion() -> None:
    """Counts that add up to the angle, noise of the stated size, rows lost, the belt seen."""
    rows = drive.record()
    assert drive.record().equals(rows) and not drive.record(2).equals(rows)
    t, speed, percent = rows.to_numpy().T
    gaps = np.flatnonzero(np.diff(t) > 1.5 * logger.SAMPLE)
    assert np.allclose([*t[gaps], *t[gaps + 1]], [0.539, 1.499, 0.561, 1.601])
    counts = speed / 60 * logger.SAMPLE * drive.COUNTS
    assert np.allclose(counts, counts.round(), atol=1e-4)
    clean = drive.motion(t)
    until = t <= drive.GAPS[0][0]
    turned = drive.motion(t[until][-1:] + logger.SAMPLE / 2)[3, 0] / (2 * np.pi)
    assert 0 <= turned * drive.COUNTS - counts[until].sum() < 1.01
    noise = percent - 100 * clean[2] / drive.RATIO / drive.RATED
    assert noise.std() == pytest.approx(drive.NOISE, rel=0.1) and abs(noise.mean()) < 0.1
    ahead = speed / 60 * 2 * np.pi / drive.RATIO / clean[1] - 1
    slips = abs(t - drive.SLIP_BEGIN - drive.SLIP_DURATION / 2) < 0.005
    assert ahead[slips].mean() == pytest.approx(drive.SLIP, rel=0.1)
