"""What happens while the conveyor starts from rest and passes its resonance?

The same conveyor is started by the motor with the linear characteristic and by one with the Kloss
characteristic of an induction machine.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

import cosim
from cosim import Result
from cosim.result import write_json

from . import fmus, options, plots
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


def start_values(machine: Machine, motor: str, nu: float) -> dict[str, float]:
    """The conveyor at rest; the linear motor set for the mean speed nu [rad/s]."""
    rest = {"motor.tau": 0.0, "conveyor.w": 0.0, "motor.characteristic": MOTORS[motor]}
    return machine.start(nu) | rest


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


def run(
    name: str = "B",
    speed: float = 60.0,
    stop: float = 1.0,
    step: float = 2e-4,
    algorithm: str = "strang",
    out: Path | None = None,
) -> None:
    """Start both motors, write a CSV for each, run_up.json and .png, print the verdict."""
    options.positive("speed", speed, "rad/s")
    machine = SETS[name]
    folder = out or Path("results") / "run_up" / name
    fmus.build(*fmus.DRIVE.values())
    runs: dict[str, Result] = {}
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal) as bar:
        for motor in MOTORS:
            task = bar.add_task(motor, total=1.0)
            runs[motor] = cosim.run(
                fmus.conveyor_drive(start_values(machine, motor, speed)),
                stop=stop,
                step=step,
                algorithm=algorithm,
                record=RECORD,
                csv=folder / f"{motor}.csv",
                progress=lambda share, task=task: bar.update(task, completed=share),  # type: ignore[misc]
            )
    passing = {motor: passes(result, machine.nu_res) for motor, result in runs.items()}
    plots.run_up(folder / "run_up.png", machine, runs, passing)
    write_json(
        folder / "run_up.json",
        {"nu_res": machine.nu_res, "passing": passing, "set": name, "flavour": fmus.flavour()},
    )
    for motor, result in runs.items():
        print(verdict(machine, motor, result, passing[motor]))
    print(f"{', '.join(f'{m}.csv' for m in runs)}, run_up.json and run_up.png written to {folder}")
