"""The packing line: its system, its releases, and what its powers are made of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
from cosim import Result, System
from cosim.system import Value
from workbench.measure import Samples, harmonics
from workbench.options import Start

from ..conveyor.theory import SETS
from ..iron import drive as iron

PARTS = {
    "iron_motor": "DriveMotor",
    "iron": "IronDrive",
    "orientator": "GravityOrientator",
    "conveyor_motor": "DriveMotor",
    "conveyor": "CrankConveyor",
}
WIRES = (
    "iron_motor.tau -> iron.tau",
    "iron.w -> iron_motor.w",
    "iron.top_dwell -> orientator.release",
    "conveyor_motor.tau -> conveyor.tau",
    "conveyor.w -> conveyor_motor.w",
)
RECORD = (
    "iron_motor.P", "iron_motor.tau", "iron.phi", "iron.w_cam", "iron.lift", "iron.top_dwell",
    "iron.E_kin", "iron.E_pot", "iron.E_friction",
    "iron.alpha", "iron.beta", "iron.H", "iron.motion",
    "orientator.phi1", "orientator.xc", "orientator.yc",
    "orientator.stage", "orientator.reason", "orientator.orientation_time", "orientator.phi2",
    "orientator.oriented", "orientator.jammed", "orientator.missed",
    "conveyor_motor.P", "conveyor_motor.tau", "conveyor.phi", "conveyor.w", "conveyor.x",
    "conveyor.E_kin", "conveyor.E_pot", "conveyor.P_loss",
)  # fmt: skip
DRIVES = {"iron": "iron.phi", "conveyor": "conveyor.phi"}
HIGHEST = {"iron": 12, "conveyor": 4}
I_G = 36.0
START, FIRST_RELEASE = math.radians(-60.0), math.radians(100.0)


class Pace(NamedTuple):
    """What became of the products between the first release and the last: row numbers of the
    releases, products released and oriented, the reason of the last failure."""

    releases: list[int]
    released: int
    oriented: int
    reason: int


class Line(NamedTuple):
    """One order of the ripple: the drive whose angle counts it, frequency [Hz], amplitudes [W]."""

    drive: str
    order: int
    frequency: float
    own: float
    supply: float


def system(
    fmus: Mapping[str, Path],
    gear: float,
    iron_speed: float,
    conveyor_set: str,
    speed: float,
    start: Mapping[str, Value] | None = None,
) -> System:
    """The line; all start values are parameters, because some hosts set no other ones.

    `start` stands above what the other values say; the motors are set for their speeds with it.
    """
    changes = dict(start or {})
    slope = changes.get("iron_motor.B", iron.MOTOR["motor.B"])
    ratio = changes.get("iron.reducer.i_g", I_G)
    values: Start = {
        "iron_motor.A": float(slope) * float(ratio) * iron_speed,
        "iron_motor.B": slope,
        "iron_motor.T": iron.MOTOR["motor.T"],
        "iron.reducer.i_g": ratio,
    }
    own = {name.replace("conveyor_motor.", "motor."): value for name, value in changes.items()}
    for name, value in SETS[conveyor_set].follow(own).start(speed).items():
        if name not in ("motor.tau", "conveyor.phi", "conveyor.w"):
            values[name.replace("motor.", "conveyor_motor.")] = value
    wires = [*WIRES, f"iron.w_cam * {gear!r} -> orientator.w"]
    return System(dict(fmus), wires, values | changes)


def powers(result: Result) -> dict[str, Samples]:
    """Mechanical power of each motor and of the supply [W]."""
    parts = {drive: result[f"{drive}_motor.P"] for drive in DRIVES}
    return parts | {"supply": parts["iron"] + parts["conveyor"]}


def pace(result: Result) -> Pace:
    """Count the products of the whole cycles; raises SetupError where the cam does not keep turning."""
    if (
        result["iron.phi"][-1] < FIRST_RELEASE + 2 * math.pi
        or np.diff(result["iron.phi"]).min() <= 0.0
    ):
        raise cosim.SetupError(
            f"the cam stands or turns back, at iron.phi = {result['iron.phi'][-1]:.4g} rad in the "
            "end: at this speed its motor cannot lift the iron"
        )
    releases = (np.flatnonzero(np.diff(result["iron.top_dwell"]) > 0.5) + 1).tolist()
    if len(releases) < 2:
        raise cosim.SetupError(
            f"{len(releases)} top dwells begin until t = {result['time'][-1]:g} s, two must"
        )
    first, last = releases[0], releases[-1]
    oriented = result["orientator.oriented"]
    reason = int(result["orientator.reason"][last - 1])
    return Pace(releases, len(releases) - 1, int(oriented[last] - oriented[first]), reason)


def window(result: Result) -> slice:
    """The rows of the whole cycles."""
    releases = pace(result).releases
    return slice(releases[0], releases[-1] + 1)


def averages(result: Result) -> dict[str, float]:
    """Cycle, mean speed of the cam, mean and rms ripple of the powers over whole turns."""
    pace(result)
    angle = result["iron.phi"]
    when = CubicSpline(angle, result["time"])
    turns = int((angle[-1] - FIRST_RELEASE) / (2 * math.pi))
    began, ended = (float(when(FIRST_RELEASE + 2 * math.pi * k)) for k in (0, turns))
    found = {
        "cycle": (ended - began) / turns,
        "cam": 2 * math.pi * turns / (ended - began),
    }
    for name, P in powers(result).items():
        course = CubicSpline(result["time"], P)
        mean = float(course.integrate(began, ended)) / (ended - began)
        square = CubicSpline(result["time"], (P - mean) ** 2)
        found[f"mean_{name}"] = mean
        found[f"rms_{name}"] = math.sqrt(float(square.integrate(began, ended)) / (ended - began))
    return found


def orientation(result: Result) -> float:
    """How long the last product of the whole cycles took, 0 if it jammed [s]."""
    return float(result["orientator.orientation_time"][window(result)][-2])


def ripple(result: Result) -> list[Line]:
    """The orders of cam and crank over the whole cycles, in their drive's power and the supply's."""
    rows, power = window(result), powers(result)
    t = result["time"][rows]
    lines = []
    for drive, angle in DRIVES.items():
        phi = result[angle][rows]
        rate = float((phi[-1] - phi[0]) / (2 * math.pi * (t[-1] - t[0])))
        sizes = (np.abs(harmonics(phi, power[x][rows], HIGHEST[drive])) for x in (drive, "supply"))
        for k, (own, supply) in enumerate(zip(*sizes), 1):
            lines.append(Line(drive, k, k * rate, float(own), float(supply)))
    return lines


def correlation(result: Result) -> float:
    """Of the two powers over the whole cycles: 0 apart, 1 in phase, -1 against each other."""
    rows, power = window(result), powers(result)
    return float(np.corrcoef(power["iron"][rows], power["conveyor"][rows])[0, 1])
