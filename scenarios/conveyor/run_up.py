"""What happens while the conveyor starts from rest and passes its resonance?

The same conveyor is started by a motor with a linear characteristic and by an induction motor, whose
characteristic is that of Kloss.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, System
from workbench import Bench, Figure, Findings, Run, Show, Table, option
from workbench.measure import Samples, crossings, largest, measured, smallest

from . import show as pictures
from .drive import PARTS as DRIVE
from .drive import conveyor_drive, followed
from .theory import SETS, Machine

PARTS = DRIVE
OWN = ("motor.characteristic",)
MOTORS = {"linear": 0, "kloss": 1}
WORDS = {"linear": "linear motor", "kloss": "induction motor"}
RECORD = (
    "motor.tau", "motor.tau_static", "motor.P", "conveyor.phi", "conveyor.w", "conveyor.x",
    "conveyor.tau_load", "conveyor.f_rod", "conveyor.P_loss",
)  # fmt: skip
LOADS = {
    "w": ("conveyor.w", "speed of the crank"),
    "tau": ("motor.tau", "torque"),
    "f_rod": ("conveyor.f_rod", "rod force"),
}
END = 0.8


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    set: str = option("B", "parameter set", choices=SETS)
    speed: float = option(60.0, "mean speed of the linear motor", "rad/s", above=0.0)


class RunUp(NamedTuple):
    """The machine, and a run for each motor."""

    machine: Machine
    runs: Mapping[str, Result]


def drive(fmus: Mapping[str, Path], machine: Machine, motor: str, o: Options) -> System:
    """The conveyor at rest; the linear motor set for its mean speed."""
    rest = {"motor.tau": 0.0, "conveyor.w": 0.0, "motor.characteristic": MOTORS[motor]}
    return conveyor_drive(fmus, machine.start(o.speed) | rest | dict(o.start))


def solve(o: Options, bench: Bench) -> Findings:
    """Both motors, one after the other."""
    machine = followed(bench.fmus, SETS[o.set], o.start)
    build_up = 1 / (4 * math.pi * machine.zeta)
    found = {
        "nu_res": Figure(machine.nu_res, "rad/s", 0.0, "resonance by formula (22)"),
        "build_up": Figure(build_up, "1", 0.0, "revolutions in which a resonance builds up"),
    }
    runs = {}
    for motor in MOTORS:
        system = drive(bench.fmus, machine, motor, o)
        tell = partial(figures, machine, motor)
        runs[motor], mine = bench.certify(system, tell, o, RECORD, f"{motor}.csv")
        found |= {f"{motor}_{name}": figure for name, figure in mine.items()}
    return Findings(
        found,
        RunUp(machine, runs),
        drive(bench.fmus, machine, "linear", o),
        runs["linear"].provenance,
        tables={f"{motor}.csv": Table.of(result) for motor, result in runs.items()},
    )


def figures(machine: Machine, motor: str, r: Result) -> dict[str, Figure]:
    """When the resonance is passed, revolutions near it, the largest loads, where it all ends."""
    t, word, last = r["time"], WORDS[motor], r["time"] > END * r["time"][-1]
    near = measured(
        partial(revolutions_near, machine.nu_res), t, r["conveyor.w"], r["conveyor.phi"]
    )
    found = {
        "passing": passing(r, machine.nu_res, f"when the crank has passed it, {word}"),
        "revolutions_near": near.figure("1", f"revolutions within 10 % of it, {word}"),
    }
    for name, (column, what) in LOADS.items():
        x, unit = r[column], r.units[column]
        peak = largest(t, np.abs(x))
        found[f"{name}_max"] = peak.figure(unit, f"largest {what}, {word}")
        if name != "f_rod":
            low, high = smallest(t[last], x[last]), largest(t[last], x[last])
            found[f"{name}_end_min"] = low.figure(unit, f"least {what} in the end, {word}")
            found[f"{name}_end_max"] = high.figure(unit, f"largest {what} in the end, {word}")
    return found


def passing(r: Result, nu: float, meaning: str) -> Figure:
    """When the crank rises through the speed nu [rad/s] for good."""
    if r["conveyor.w"][-1] < nu:
        reason = "the crank does not stay above the resonance"
        return Figure.refused(r.units["time"], reason, meaning)
    return crossings(r["time"], r["conveyor.w"], nu)[-1].figure(r.units["time"], meaning)


def revolutions_near(nu: float, t: Samples, w: Samples, phi: Samples) -> float:
    """Revolutions of the crank while its speed is within 10 % of nu."""
    speed = CubicSpline(t, w)
    passes = [speed.solve(share * nu, extrapolate=False) for share in (0.9, 1.1)]
    ends = np.sort(np.concatenate([t[:1], *passes, t[-1:]]))
    middle = np.abs(speed((ends[1:] + ends[:-1]) / 2) / nu - 1.0) < 0.1
    return float(np.diff(CubicSpline(t, phi)(ends))[middle].sum() / (2 * math.pi))


def verdict(o: Options, f: Mapping[str, Figure], r: RunUp) -> str:
    """Who passes the resonance, what it costs on the way, and where the drives end."""
    resonance = f["nu_res"].text()
    passed = " ".join(
        f"The {word} has passed it after {f[f'{motor}_passing'].text()}."
        if f[f"{motor}_passing"].error is not None
        else f"The {word} does not stay above it within {o.stop:g} s."
        for motor, word in WORDS.items()
    )
    lines = [f"The resonance lies at {resonance}. {passed}"]
    for motor, word in WORDS.items():
        told = {name: figure.text() for name, figure in f.items() if name.startswith(motor)}
        lines.append(
            f"The {word} spends {told[f'{motor}_revolutions_near']} revolutions within 10 % of the "
            f"resonance, which takes {f['build_up'].text()} to build up. On the way its torque "
            f"reaches {told[f'{motor}_tau_max']}, the speed {told[f'{motor}_w_max']} and the rod "
            f"force {told[f'{motor}_f_rod_max']}."
        )
        if f[f"{motor}_w_end_max"].value < 0.1 * f["nu_res"].value:
            lines.append(f"The {word} stalls: in the end the crank stands or only rocks.")
        else:
            lines.append(
                f"In the end the speed lies between {told[f'{motor}_w_end_min']} and "
                f"{told[f'{motor}_w_end_max']}."
            )
    return "\n".join(lines)


def show(o: Options, f: Mapping[str, Figure], r: RunUp) -> Show:
    """Speed, torque and rod force over time, and both conveyors in motion."""
    return Show(pictures.run_up(r.machine, r.runs), [pictures.run_up_motion(r.runs)])
