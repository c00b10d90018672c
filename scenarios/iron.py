"""What the iron-drive scenarios share: systems, parameters from the command line, ledgers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim import Result, System
from cosim.system import Value

from . import fmus
from .options import Start

Samples = NDArray[np.float64]

FLYWHEEL = 1e6
NOMINAL = 4 * math.pi / 3
PARTS = {"motor": "drive_motor", "iron": "iron_drive"}
MOTOR: dict[str, float] = {"motor.A": 4.0, "motor.B": 0.025, "motor.T": 0.012, "motor.tau": 0.0}
WIRES = ("motor.tau -> iron.tau", "iron.w -> motor.w")
IMPOSED = ("iron.tau", "iron.phi", "iron.w_cam", "iron.reducer.J")
FORCES = ("N", "T_span", "T_iron")


def own(start: Start) -> Start:
    """The start values of the iron drive among those of a system."""
    return {name: value for name, value in start.items() if name.startswith("iron.")}


def imposed(speed: float, start: Start) -> System:
    """The iron drive alone at a practically constant cam speed [rad/s], from phi = 0.

    A rotor a million times as heavy as any motor's imposes the speed: the acceleration left is
    below 1e-8 rad/s2, so that forces and cam torque are the kinetostatic ones. A stiff motor would
    need communication steps below 0.1 us to stay stable.
    """
    imposed = dict(zip(IMPOSED, (0.0, 0.0, speed, FLYWHEEL)))
    return System({"iron": fmus.fmu("iron_drive")}, start={"iron.on_invalid": 1} | start | imposed)


def driven(motor: Mapping[str, Value], start: Start) -> System:
    """The iron drive on a DriveMotor, wire to wire."""
    parts = {part: fmus.fmu(component) for part, component in PARTS.items()}
    return System(parts, WIRES, dict(motor) | start)


def turn(speed: float, start: Start, samples: int, record: Sequence[str]) -> Result:
    """One turn at constant speed, sampled evenly over the cam angle."""
    h = 2 * math.pi / (speed * samples)
    return cosim.run(imposed(speed, start), stop=h * samples, step=h, record=record)


def speed_limits(start: Start, samples: int = 1440) -> dict[str, tuple[float, float]]:
    """The constant speed at which each force vanishes first, and the cam angle where [rad/s, rad].

    At constant speed a force is f_0(phi) + f_2(phi) w^2: two turns tell both.
    """
    slow, fast = (turn(w, start, samples, names(FORCES)) for w in (1.0, 2.0))
    limits = {}
    for name in FORCES:
        f_2 = (fast[f"iron.{name}"] - slow[f"iron.{name}"]) / 3.0
        f_0 = slow[f"iron.{name}"] - f_2
        square = np.where(f_2 < 0.0, -f_0 / np.where(f_2 < 0.0, f_2, -1.0), np.inf)
        first = int(np.argmin(square))
        angle = 2 * math.pi * first / samples
        limits[name] = (float(np.sqrt(square[first])), angle)
    return limits


def names(variables: Sequence[str]) -> list[str]:
    """The iron drive's variables as the system names them."""
    return [f"iron.{name}" for name in variables]


def per_minute(speed: float) -> float:
    """Cycles per minute of a cam speed [rad/s]."""
    return speed * 30 / math.pi
