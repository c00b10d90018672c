"""The drive of the conveyor: its FMUs, coupled, and made to run at a speed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cosim
from cosim import SetupError, System
from cosim.system import Value

from .theory import Machine

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


@dataclass(frozen=True)
class Drive:
    """A machine and further start values; its motor's line is moved so that it runs at a mean speed.

    An induction motor (Kloss) is fed with another frequency: its synchronous speed moves, its
    breakdown torque and the slip speed there stay. Theory knows it by its slope at the working point.
    """

    base: Machine
    changes: Mapping[str, Value]

    @property
    def induction(self) -> bool:
        """Whether the motor has the Kloss characteristic."""
        return self.changes.get("motor.characteristic", 0) in (1, "kloss")

    def _kloss(self, nu: float) -> tuple[float, float, float]:
        """Breakdown torque [N.m], slip speed there, and slip speed at the load of nu [rad/s]."""
        tau_b, s_b, w_s = (float(self.changes.get(name, x)) for name, x in KLOSS.items())
        load = self.base.load_slope * nu
        if load >= tau_b:
            raise SetupError(
                f"motor.kloss.tau_b = {tau_b!r} N.m must be above {load:.6g} N.m, the mean load "
                f"torque at {nu:g} rad/s"
            )
        breakdown = s_b * w_s
        share = load / tau_b
        return tau_b, breakdown, breakdown * share / (1.0 + math.sqrt(1.0 - share**2))

    def machine(self, nu: float) -> Machine:
        """The machine with the slope that its motor has at the mean speed nu."""
        if not self.induction:
            return self.base
        tau_b, b, slip = self._kloss(nu)
        return replace(self.base, B=2.0 * tau_b * b * (b**2 - slip**2) / (slip**2 + b**2) ** 2)

    def start(self, nu: float) -> dict[str, Value]:
        """Start values near the orbit of the mean speed nu."""
        start = {**self.base.start(nu), **self.changes}
        if self.induction:
            _, breakdown, slip = self._kloss(nu)
            start |= {"motor.kloss.w_s": nu + slip, "motor.kloss.s_b": breakdown / (nu + slip)}
        return start
