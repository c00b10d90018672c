"""What the questions of the iron drive share: its systems, and what it does at constant speed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim import Result, System
from cosim.system import Value
from workbench import Figure
from workbench.measure import Measured, largest
from workbench.options import Start

Samples = NDArray[np.float64]

FLYWHEEL = 1e6
NOMINAL = "40rpm"
PARTS = {"motor": "DriveMotor", "iron": "IronDrive"}
MOTOR: dict[str, float] = {"motor.A": 4.0, "motor.B": 0.025, "motor.T": 0.012, "motor.tau": 0.0}
WIRES = ("motor.tau -> iron.tau", "iron.w -> motor.w")
IMPOSED = ("iron.tau", "iron.phi", "iron.w_cam", "iron.reducer.J")
FORCES = ("N", "T_span", "T_iron")


class Alone(NamedTuple):
    """The iron drive by itself: its FMU and start values."""

    fmu: Path
    start: Start


def own(fmus: Mapping[str, Path], start: Mapping[str, Value]) -> Alone:
    """The iron drive of a system, with those of the system's start values that are its own."""
    mine = {name: value for name, value in start.items() if name.startswith("iron.")}
    return Alone(fmus["iron"], mine)


def imposed(speed: float, iron: Alone) -> System:
    """The iron drive alone at a practically constant cam speed [rad/s], from phi = 0.

    A rotor a million times as heavy as any motor's imposes the speed: the acceleration left is
    below 1e-8 rad/s2, so that forces and cam torque are the kinetostatic ones. A stiff motor would
    need communication steps below 0.1 us to stay stable.
    """
    imposed = dict(zip(IMPOSED, (0.0, 0.0, speed, FLYWHEEL)))
    return System({"iron": iron.fmu}, start={"iron.on_invalid": 1} | iron.start | imposed)


def driven(
    fmus: Mapping[str, Path], motor: Mapping[str, Value], start: Mapping[str, Value]
) -> System:
    """The iron drive on a DriveMotor, wire to wire."""
    return System({part: fmus[part] for part in PARTS}, WIRES, {**motor, **start})


def turn(speed: float, iron: Alone, samples: int, record: Sequence[str]) -> Result:
    """One turn at constant speed, sampled evenly over the cam angle."""
    h = 2 * math.pi / (speed * samples)
    return cosim.run(imposed(speed, iron), stop=h * samples, step=h, record=record)


class Limit(NamedTuple):
    """The constant speed at which a force vanishes first [rad/s], and the cam angle where [deg]."""

    speed: Measured | None
    angle: Measured | None

    def figures(self, name: str, meaning: str) -> dict[str, Figure]:
        """Both as figures; a force that never vanishes, or always, has no such speed."""
        where = f"cam angle where {meaning}"
        meaning = f"cam speed where {meaning}"
        if self.speed is None or self.angle is None:
            reason = "no speed of the cam changes its sign"
            return {name: Figure.refused("rad/s", reason, meaning)}
        return {
            name: self.speed.figure("rad/s", meaning),
            f"{name}_angle": self.angle.figure("deg", where),
        }


def speed_limits(iron: Alone, samples: int = 1440) -> dict[str, Limit]:
    """For each force the speed of the cam at which it vanishes first.

    At constant speed a force is f_0(phi) + f_2(phi) w^2, and two turns tell both: it vanishes where
    -f_2 / f_0 is largest.
    """
    slow, fast = (turn(w, iron, samples, names(("phi", *FORCES))) for w in (1.0, 2.0))
    limits = {}
    for name in FORCES:
        f_2 = (fast[f"iron.{name}"] - slow[f"iron.{name}"]) / 3.0
        f_0 = slow[f"iron.{name}"] - f_2
        limits[name] = Limit(None, None)
        if f_0.min() > 0.0 > f_2.min():
            top = largest(np.degrees(slow["iron.phi"]), -f_2 / f_0)
            speed = top.value**-0.5
            limits[name] = Limit(Measured(speed, speed * top.error / (2 * top.value)), top.at)
    return limits


def names(variables: Sequence[str]) -> list[str]:
    """The iron drive's variables as the system names them."""
    return [f"iron.{name}" for name in variables]


def per_minute(speed: float) -> float:
    """Cycles per minute of a cam speed [rad/s]."""
    return speed * 30 / math.pi
