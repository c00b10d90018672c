"""The referee judges results of masters that are not ours, and its verdicts agree with an independent integration."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cosim import referee
from cosim.accuracy.referee.signals import Verdict
from tests.cosim.test_referee import DRIVE_START, drive
from tests.hosts.test_hosts import HOSTS, finish
from tests.oracle import monolithic

STOP = 0.2
STATES = ("conveyor.phi", "conveyor.w", "motor.tau")


def run_in_host(program: str, folder: Path, step: float) -> pd.DataFrame:
    """What another master makes of the drive."""
    system = drive(folder)
    task = {
        "parts": {name: str(path) for name, path in system.parts.items()},
        "wires": [["motor.tau", "conveyor.tau"], ["conveyor.w", "motor.w"]],
        "start": dict(system.start),
        "record": STATES,
        "step": step,
        "steps": round(STOP / step),
    }
    done = finish(sys.executable, HOSTS / program, json.dumps(task))
    rows = np.array(json.loads(done.stdout.splitlines()[-1]))
    rows[:, 0] *= 1e-9 if program.startswith("libcosim") else 1.0
    return pd.DataFrame(rows, columns=["time", *STATES])


@pytest.mark.parametrize("step", [2e-4, 1e-3, 4e-3])
@pytest.mark.parametrize("program", ["libcosim_system.py", "ecos_system.py"])
def test_masters_that_hold_inputs_are_named(native: Path, program: str, step: float) -> None:
    frame = run_in_host(program, native, step)
    report = referee(drive(native), frame)
    times = frame["time"].to_numpy()  # Ecos adds its steps up and ends a rounding error late
    true = monolithic(DRIVE_START, max(STOP, times[-1]), times).y[:3]
    for name, values in zip(STATES, true, strict=True):
        distance, signal = np.abs(frame[name] - values).max(), report[name]
        assert signal.deviation == pytest.approx(distance, rel=1e-3, abs=signal.error)
        assert (signal.verdict is Verdict.DIFFERS) == (distance > 0.01 * np.ptp(values))
    assert report.verdict is Verdict.DIFFERS
    assert report.causes[0].kind == "held inputs" and f"{step:g} s" in report.causes[0].text
