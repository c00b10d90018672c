"""What happens while the conveyor starts from rest and passes its resonance?

The same conveyor is started by the motor with the linear characteristic and by one with the Kloss
characteristic of an induction machine.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import cosim
from cosim import Result, System
from cosim.progress import bar

from . import fmus, options, plots
from .answer import Answer, Figure, Table, finish, parameters, question
from .theory import SETS, Machine

MOTORS = {"linear": 0, "kloss": 1}
RECORD = (
    "motor.tau",
    "motor.tau_static",
    "motor.P",
    "conveyor.phi",
    "conveyor.w",
    "conveyor.x",
    "conveyor.tau_load",
    "conveyor.f_rod",
    "conveyor.P_loss",
)


def drive(machine: Machine, motor: str, nu: float, start: options.Start) -> System:
    """The conveyor at rest; the linear motor set for the mean speed nu [rad/s]."""
    rest = {"motor.tau": 0.0, "conveyor.w": 0.0, "motor.characteristic": MOTORS[motor]}
    return fmus.conveyor_drive(machine.start(nu) | rest | start)


def passes(result: Result, nu: float) -> float | None:
    """When the crank last rises through the speed nu [s]; None if it does not stay above."""
    below = np.flatnonzero(result["conveyor.w"] < nu)
    if len(below) == len(result.data):
        return None
    return float(result["time"][below[-1]])


def revolutions_near(result: Result, nu: float) -> float:
    """Revolutions of the crank while its speed is within 10 % of nu."""
    w, phi = result["conveyor.w"], result["conveyor.phi"]
    near = np.abs(w[1:] / nu - 1.0) < 0.1
    return float(np.diff(phi)[near].sum() / (2 * math.pi))


def verdict(machine: Machine, motor: str, result: Result, passing: float | None) -> str:
    """What one motor does, in plain words."""
    w, tau, f_rod = (result[name] for name in ("conveyor.w", "motor.tau", "conveyor.f_rod"))
    end = result["time"][-1]
    late = result["time"] > 0.8 * end
    way = (
        f"stays above the resonance ({machine.nu_res:.1f} rad/s) from {passing:.3f} s on"
        if passing is not None
        else f"does not stay above the resonance ({machine.nu_res:.1f} rad/s) within {end:g} s"
    )
    return (
        f"{motor}: {way} and spends {revolutions_near(result, machine.nu_res):.2f} revolutions "
        f"within 10 % of it (building up takes {1 / (4 * math.pi * machine.zeta):.1f}); torque up to {np.abs(tau).max():.0f} N.m, speed up to {w.max():.1f} rad/s, "
        f"rod force up to {np.abs(f_rod).max():.0f} N on the way; "
        f"at the end {w[late].min():.1f} .. {w[late].max():.1f} rad/s and "
        f"{tau[late].min():.1f} .. {tau[late].max():.1f} N.m."
    )


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--set", dest="name", choices=SETS, default="B", help="parameter set")
    add("--speed", type=float, default=60.0, help="mean speed of the linear motor [rad/s]")
    add("--stop", type=float, default=1.0, help="simulated time [s]")
    add("--step", type=float, default=2e-4, help="communication step [s]")
    add("--algorithm", choices=cosim.ALGORITHMS, default="strang", help="coupling algorithm")
    add(
        "--out",
        type=Path,
        default=SUPPRESS,
        help="folder of the results, results/run_up/SET by default",
    )
    options.add_start(parser, "motor.T=0.05")


def answer(
    name: str = "B",
    speed: float = 60.0,
    stop: float = 1.0,
    step: float = 2e-4,
    algorithm: str = "strang",
    start: Sequence[str] = (),
    out: Path | None = None,
) -> Answer:
    """Start the conveyor with both motors; rows are kept in `out` on the way."""
    changes = options.start_values(start, ("motor.characteristic",))
    options.positive("speed", speed, "rad/s")
    machine = fmus.followed(SETS[name], changes)
    runs: dict[str, Result] = {}
    for motor in MOTORS:
        with bar(motor, 0.0, stop) as progress:
            runs[motor] = cosim.run(
                drive(machine, motor, speed, changes),
                stop=stop,
                step=step,
                algorithm=algorithm,
                record=RECORD,
                csv=out and out / f"{motor}.csv",
                progress=progress,
            )
    passing = {motor: passes(result, machine.nu_res) for motor, result in runs.items()}
    told = [verdict(machine, motor, result, passing[motor]) for motor, result in runs.items()]
    return Answer(
        scenario="run_up",
        question=question(__doc__),
        verdict="\n".join(told),
        figures=figures(machine, runs, passing),
        parameters=parameters(drive(machine, "linear", speed, changes)),
        tables={f"{motor}.csv": Table.of(result) for motor, result in runs.items()},
        provenance=runs["linear"].provenance | {"flavour": fmus.flavour()},
        stem="run_up",
        facts={"nu_res": machine.nu_res, "passing": passing, "set": name},
        files={"run_up.png": lambda path: plots.run_up(path, machine, runs, passing)},
    )


def figures(
    machine: Machine, runs: Mapping[str, Result], passing: Mapping[str, float | None]
) -> dict[str, Figure]:
    """Resonance by formula; for each motor when it is passed, and the largest loads."""
    told = {"nu_res": Figure(machine.nu_res, "rad/s", 0.0)}
    for motor, result in runs.items():
        at = passing[motor]
        if at is not None:
            told[f"{motor}_passing"] = Figure(at, "s")
        for name, column, unit in (
            ("w_max", "conveyor.w", "rad/s"),
            ("tau_max", "motor.tau", "N.m"),
            ("f_rod_max", "conveyor.f_rod", "N"),
        ):
            told[f"{motor}_{name}"] = Figure(float(np.abs(result[column]).max()), unit)
        near = revolutions_near(result, machine.nu_res)
        told[f"{motor}_revolutions_near"] = Figure(near, "1")
    return told


def run(name: str = "B", out: Path | None = None, **settings: Any) -> None:
    """Write the answer and print the verdict."""
    folder = out or Path("results") / "run_up" / name
    finish(answer(name, out=folder, **settings), folder)
