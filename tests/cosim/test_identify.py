"""Machines are found from records that an independent integrator made."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from cosim import SetupError, System, Table, identify, measured

Samples = NDArray[np.float64]
WIRES = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
MACHINE = {
    "motor.A": 7200.0, "motor.B": 199.8, "motor.T": 0.0625, "conveyor.rotor.J": 0.49,
    "conveyor.trough.m": 200.0, "conveyor.trough.d": 4000.0, "conveyor.spring.c": 720e3,
    "conveyor.phi": 0.3, "conveyor.w": 36.0, "motor.tau": 60.0,
}  # fmt: skip
FREE = ["motor.B", "motor.T", "conveyor.rotor.J", "motor.A", "conveyor.phi", "conveyor.w"]
KNOWN = {"conveyor.trough.d": (4000.0, 200.0)}


def moved(p: Mapping[str, float], t: Samples) -> Samples:
    """Angle, speed and torque of motor and conveyor at times t, shape (3, n), by scipy."""
    m, c, d, r = (p[f"conveyor.{x}"] for x in ("trough.m", "spring.c", "trough.d", "crank.r"))

    def slope(_: float, y: Samples) -> list[float]:
        x, dx = r * np.sin(y[0]), r * np.cos(y[0])
        load = c * x * dx + d * dx**2 * y[1] - m * dx * x * y[1] ** 2
        a = (y[2] - load) / (p["conveyor.rotor.J"] + m * dx**2)
        return [y[1], a, (p["motor.A"] - p["motor.B"] * y[1] - y[2]) / p["motor.T"]]

    start = [p["conveyor.phi"], p["conveyor.w"], p["motor.tau"]]
    run = solve_ivp(slope, (t[0], t[-1]), start, "DOP853", t, rtol=1e-9, atol=1e-9)
    return np.asarray(run.y)


def resonance(p: Mapping[str, float], _: object = None) -> float:
    """Where motor and load swing against each other, from the mean machine [rad/s]."""
    half = p.get("conveyor.crank.r", 0.01) ** 2 / 2
    slope = p["motor.B"] + p["conveyor.trough.d"] * half
    inertia = p["conveyor.rotor.J"] + p.get("conveyor.trough.m", 200.0) * half
    return float((slope / (inertia * p["motor.T"])) ** 0.5 / 2)


def system(fmus: Path, **off: float) -> System:
    """The machine as one would guess it."""
    parts = {"motor": fmus / "native/DriveMotor.fmu", "conveyor": fmus / "native/CrankConveyor.fmu"}
    guess = MACHINE | {"motor.B": 170.0, "motor.T": 0.075, "conveyor.rotor.J": 0.55}
    return System(parts, WIRES, guess | {"motor.A": 6100.0, "conveyor.phi": 0.0} | off)


@pytest.fixture(scope="module")
def record() -> dict[str, Samples]:
    """One second of the machine at 1 kHz, without noise."""
    t = np.arange(1001) * 1e-3
    phi, w, tau = moved({"conveyor.crank.r": 0.01} | MACHINE, t)
    return {"t": t, "phi": phi, "w": w, "tau": tau}


def noisy(x: Samples, sigma: float, seed: int = 1) -> Samples:
    return x + sigma * np.random.default_rng(seed).standard_normal(len(x))


def test_the_resonance_is_found_though_its_parts_are_not(
    fmus: Path, record: dict[str, Samples]
) -> None:
    table = Table(record["t"], noisy(record["w"], 0.1) * 30 / np.pi, unit="rpm")
    fit = identify(
        system(fmus), {"conveyor.w": table}, free=FREE, known=KNOWN,
        derived={"resonance": resonance}, first=["conveyor.phi", "motor.A"],
    )  # fmt: skip
    assert not fit.misfit
    found, truth = fit.derived["resonance"], resonance(MACHINE)
    assert found.low < truth < found.high
    assert found.error < 0.01 * truth
    for name, value in fit.values.items():
        off = value.value - MACHINE[name]
        if name == "conveyor.phi":
            off -= round(off / np.pi) * np.pi  # the machine is the same half a turn later
        assert abs(off) < 2.5 * value.error, name
    assert any({"motor.B", "motor.A"} <= set(group) for group in fit.alike)


def test_what_is_wrong_with_a_record_is_one_line_with_file_row_and_column(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"

    def refused(text: str, message: str, columns: dict[str, str], time: str = "t") -> None:
        path.write_text(text)
        with pytest.raises(SetupError, match=re.escape(message)):
            measured(path, columns, time=time)

    w = {"conveyor.w": "n:rpm"}
    refused("t,n\n0,1\n2,1\n1,1\n", "log.csv, row 4, column t: 1.0 s after 2.0 s does not rise", w)
    refused("t,n\n0,1\n1,nan\n", "log.csv, row 3, column n: 'nan' is no finite number", w)
    refused("t,n\n0,1\n1,x\n", "log.csv, row 3, column n: 'x' is no number", w)
    refused("t,n\n0,1\n", "log.csv has no column 'time', only t, n", w, "time")
    refused("t,n\n0,1\n", "column n: it is mapped twice, to conveyor.w and motor.w",
            w | {"motor.w": "n"})  # fmt: skip
