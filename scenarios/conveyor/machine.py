"""The drive of the conveyor: its FMUs, coupled, and made to run at a speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

import cosim
from cosim import SetupError, System
from cosim.system import Value

from .first_order import Machine

PARTS = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
WIRES = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
KLOSS = {"motor.kloss.tau_b": 190.0, "motor.kloss.s_b": 0.16, "motor.kloss.w_s": 65.4}


def conveyor_drive(fmus: Mapping[str, Path], start: Mapping[str, Value]) -> System:
    """Motor and conveyor, coupled by torque and speed."""
    return System(dict(fmus), WIRES, start)


def followed(fmus: Mapping[str, Path], machine: Machine, start: Mapping[str, Value]) -> Machine:
    """The machine with these start values; raises SetupError for what its FMUs or theory refuse."""
    cosim.run(conveyor_drive(fmus, machine.start(1.0) | dict(start)), stop=1e-6, step=1e-6)
    changed = machine.follow(start)
    if changed.B == 0.0:
        raise SetupError("motor.B = 0.0 N.m.s/rad must be above 0: no slope, no resonance")
    return changed


def linearised(machine: Machine, start: Mapping[str, Value], nu: Any) -> Machine:
    """The machine with the slope that its motor has at the mean speed nu.

    A motor is fed so that it runs at that speed. The line of a linear motor moves; of an induction
    motor (Kloss) the synchronous speed does, while its breakdown torque and the slip speed there stay.
    """
    if not induction(start):
        return machine
    tau_b, b, slip = _kloss(machine, start, nu)
    return replace(machine, B=2.0 * tau_b * b * (b**2 - slip**2) / (slip**2 + b**2) ** 2)


def start_values(machine: Machine, start: Mapping[str, Value], nu: float) -> dict[str, Value]:
    """Start values near the orbit of the mean speed nu, of a motor fed for it."""
    values = {**machine.start(nu), **start}
    if induction(start):
        _, b, slip = _kloss(machine, start, nu)
        values |= {"motor.kloss.w_s": nu + slip, "motor.kloss.s_b": b / (nu + slip)}
    return values


def mains_speed(machine: Machine, start: Mapping[str, Value]) -> float:
    """The mean speed [rad/s] at which an induction motor on the mains carries the load of the machine.

    It is where Kloss's torque is that of the load, between the synchronous speed and that of the breakdown torque.
    The slip is positive there: a motor above its synchronous speed would brake.

    Raises
    ------
    SetupError
        For a motor with a linear characteristic, and for one that the load pulls out.
    """
    if not induction(start):
        raise SetupError(
            "supply = 'mains' needs an induction motor, motor.characteristic=kloss: the line of a linear motor is "
            "set for each speed"
        )
    tau_b, s_b, w_s = (float(start.get(name, value)) for name, value in KLOSS.items())

    def surplus(w: float) -> float:
        s = 1.0 - w / w_s
        return 2.0 * tau_b * s * s_b / (s * s + s_b * s_b) - machine.load_slope * w

    slowest = max(0.0, w_s * (1.0 - s_b))
    if surplus(slowest) <= 0.0:
        raise SetupError(
            f"motor.kloss.tau_b = {tau_b!r} N.m must be above {machine.load_slope * slowest:.6g} N.m, the mean load "
            f"torque at {slowest:.4g} rad/s: on the mains of {w_s:g} rad/s the load pulls the motor out"
        )
    return float(brentq(surplus, slowest, w_s, xtol=1e-13 * w_s, rtol=1e-14))


def slip_speeds(
    machine: Machine, start: Mapping[str, Value], nu: float
) -> tuple[float, float, float]:
    """The synchronous speed of an induction motor fed for nu, that of its start values, and its slip at breakdown [rad/s]."""
    _, b, slip = _kloss(machine, start, nu)
    return nu + float(slip), float(start.get("motor.kloss.w_s", KLOSS["motor.kloss.w_s"])), b


def induction(start: Mapping[str, Value]) -> bool:
    """Whether start values choose the Kloss characteristic."""
    return start.get("motor.characteristic", 0) in (1, "kloss")


def _kloss(machine: Machine, start: Mapping[str, Value], nu: Any) -> tuple[float, float, Any]:
    """Breakdown torque [N.m], slip speed there, and slip speed at the load of nu [rad/s]."""
    tau_b, s_b, w_s = (float(start.get(name, value)) for name, value in KLOSS.items())
    fastest = float(np.max(nu))
    if machine.load_slope * fastest >= tau_b:
        raise SetupError(
            f"motor.kloss.tau_b = {tau_b!r} N.m must be above {machine.load_slope * fastest:.6g} N.m, "
            f"the mean load torque at {fastest:g} rad/s"
        )
    share = machine.load_slope * nu / tau_b
    return tau_b, s_b * w_s, s_b * w_s * share / (1.0 + (1.0 - share**2) ** 0.5)
