"""The drive of the conveyor: its FMUs, coupled, and made to run at a speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from cosim import Prepared, RunSettings, SetupError, System
from cosim.system import Value

from .first_order import Machine

PARTS = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
WIRES = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
NO_SLOPE = "motor.B = 0.0 N.m.s/rad must be above 0: no slope, no resonance"
KLOSS = {"motor.kloss.tau_b": 190.0, "motor.kloss.s_b": 0.16, "motor.kloss.w_s": 65.4}


def conveyor_drive(fmus: Mapping[str, Path], start: Mapping[str, Value]) -> System:
    """Motor and conveyor, coupled by torque and speed."""
    return System(dict(fmus), WIRES, start)


def machine_with_start_values(
    fmus: Mapping[str, Path], machine: Machine, start: Mapping[str, Value]
) -> Machine:
    """The machine with these start values; raises SetupError for what its FMUs or theory refuse."""
    changed = machine.follow(start)
    (why,) = refusals(fmus, [changed])
    if why:
        raise SetupError(why)
    return changed


def refusals(fmus: Mapping[str, Path], machines: Sequence[Machine]) -> list[str]:
    """Why the FMUs or theory refuse each of many machines; "" if they do not."""
    starts = [machine.start(1.0) for machine in machines]
    why = [NO_SLOPE * (machine.B == 0.0) for machine in machines]
    settings = RunSettings(1e-6, 1e-6, record=())
    with Prepared.open(conveyor_drive(fmus, {}), settings) as prepared:
        for names in {tuple(start) for start in starts}:
            some = [k for k, start in enumerate(starts) if tuple(start) == names]
            cases = {name: [starts[k][name] for k in some] for name in names}
            for k, reason in zip(some, prepared.map(cases).reasons):
                why[k] = reason or why[k]
    return why


def linearised(machine: Machine, nu: Any) -> Machine:
    """The machine with the slope that its motor has at the mean speed nu; nan where the load pulls it out.

    A motor is fed so that it runs at that speed. The line of a linear motor moves; of an induction
    motor (Kloss) the synchronous speed does, while its breakdown torque and the slip speed there stay.
    """
    if not has_kloss_characteristic(machine):
        return machine
    tau_b, b, slip = kloss_slips(machine, nu)
    return replace(machine, B=2.0 * tau_b * b * (b**2 - slip**2) / (slip**2 + b**2) ** 2)


def start_values(machine: Machine, nu: Any) -> dict[str, Any]:
    """Start values near the orbit of the mean speed nu, of a motor fed for it."""
    if not has_kloss_characteristic(machine):
        return machine.start(nu)
    _, b, slip = kloss_slips(machine, nu)
    fed = {"motor.kloss.w_s": nu + slip, "motor.kloss.s_b": b / (nu + slip)}
    return machine.start(nu) | fed


def speed_on_mains(machine: Machine) -> float:
    """The mean speed [rad/s] at which an induction motor on the mains carries the load of the machine.

    It is where Kloss's torque is that of the load, between the synchronous speed and that of the breakdown torque.
    The slip is positive there: a motor above its synchronous speed would brake.

    Raises
    ------
    SetupError
        For a motor with a linear characteristic, and for one that the load pulls out.
    """
    if not has_kloss_characteristic(machine):
        raise SetupError(
            "supply = 'mains' needs an induction motor, motor.characteristic=kloss: the line of a linear motor is "
            "set for each speed"
        )
    tau_b, s_b, w_s = kloss(machine).values()

    def surplus(w: float) -> float:
        s = 1.0 - w / w_s
        return float(2.0 * tau_b * s * s_b / (s * s + s_b * s_b) - machine.load_slope * w)

    slowest = max(0.0, w_s * (1.0 - s_b))
    if surplus(slowest) <= 0.0:
        raise SetupError(
            f"motor.kloss.tau_b = {tau_b!r} N.m must be above {machine.load_slope * slowest:.6g} N.m, the mean load "
            f"torque at {slowest:.4g} rad/s: on the mains of {w_s:g} rad/s the load pulls the motor out"
        )
    return float(brentq(surplus, slowest, w_s, xtol=1e-13 * w_s, rtol=1e-14))


def require_torque(machine: Machine, nu: Any) -> None:
    """Raise SetupError for an induction motor that the load pulls out at one of the mean speeds nu [rad/s]."""
    tau_b, fastest = kloss(machine)["motor.kloss.tau_b"], float(np.max(nu))
    if has_kloss_characteristic(machine) and machine.load_slope * fastest >= tau_b:
        raise SetupError(
            f"motor.kloss.tau_b = {tau_b!r} N.m must be above {machine.load_slope * fastest:.6g} N.m, "
            f"the mean load torque at {fastest:g} rad/s"
        )


def has_kloss_characteristic(machine: Machine) -> bool:
    """Whether the start values of a machine choose the Kloss characteristic."""
    return machine.more.get("motor.characteristic", 0) in (1, "kloss")


def kloss(machine: Machine) -> dict[str, Any]:
    """The start values of the Kloss characteristic."""
    return {name: machine.more.get(name, value) for name, value in KLOSS.items()}


class KlossSlips(NamedTuple):
    """The breakdown torque of an induction motor [N.m], and its slip speeds [rad/s] there and under a load."""

    breakdown_torque: Any
    at_breakdown: Any
    under_load: Any


def kloss_slips(machine: Machine, nu: Any) -> KlossSlips:
    """The slips under the mean load of the mean speeds nu [rad/s]; nan where the load pulls the motor out."""
    tau_b, s_b, w_s = kloss(machine).values()
    share = machine.load_slope * nu / tau_b
    root = np.sqrt(np.where(share < 1.0, 1.0 - share**2, np.nan))
    return KlossSlips(tau_b, s_b * w_s, s_b * w_s * share / (1.0 + root))
