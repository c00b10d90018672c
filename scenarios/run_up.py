"""What happens while the conveyor starts from rest and passes its resonance?

The same conveyor is started by the motor with the linear characteristic and by one with the Kloss
characteristic of an induction machine.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
from cosim import Result, System

from . import conveyor_show, coupled, fmus, options, plots
from .answer import Answer, Figure, Show, Table, finish, parameters, question
from .coupled import crossings, largest
from .theory import SETS, Machine

PARTS = fmus.DRIVE
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


def passing(result: Result, nu: float) -> float:
    """When the crank rises through the speed nu for good [s]; nan if it does not stay above."""
    if result["conveyor.w"][-1] < nu:
        return math.nan
    return float(crossings(result["time"], result["conveyor.w"], nu)[-1])


def revolutions_near(result: Result, nu: float) -> float:
    """Revolutions of the crank while its speed is within 10 % of nu."""
    t, w, phi = (result[name] for name in ("time", "conveyor.w", "conveyor.phi"))
    ends = np.concatenate([crossings(t, w, share * nu) for share in (0.9, 1.1)])
    ends = np.sort(np.concatenate([t[:1], ends, t[-1:]]))
    middle = np.abs(CubicSpline(t, w)((ends[1:] + ends[:-1]) / 2) / nu - 1.0) < 0.1
    return float(np.diff(CubicSpline(t, phi)(ends))[middle].sum() / (2 * math.pi))


def figures(machine: Machine, motor: str, result: Result) -> dict[str, tuple[float, str, str]]:
    """When the resonance is passed, revolutions near it, the largest loads, where it all ends."""
    t = result["time"]
    last = t > 0.8 * t[-1]
    near = revolutions_near(result, machine.nu_res)
    found = {
        "passing": (passing(result, machine.nu_res), "s", f"when the {motor} motor has passed it"),
        "revolutions_near": (near, "1", f"revolutions within 10 % of it, {motor} motor"),
    }
    for name, column, unit, what in (
        ("w", "conveyor.w", "rad/s", "speed of the crank"),
        ("tau", "motor.tau", "N.m", "torque"),
        ("f_rod", "conveyor.f_rod", "N", "rod force"),
    ):
        x = result[column]
        most = largest(t, np.abs(x))[0]
        found[f"{name}_max"] = (most, unit, f"largest {what}, {motor} motor")
        if name != "f_rod":
            low, high = -largest(t[last], -x[last])[0], largest(t[last], x[last])[0]
            found[f"{name}_end_min"] = (low, unit, f"least {what} in the end, {motor} motor")
            found[f"{name}_end_max"] = (high, unit, f"largest {what} in the end, {motor} motor")
    return found


def verdict(machine: Machine, motor: str, stop: float, found: Mapping[str, Figure]) -> str:
    """What one motor does, in plain words."""
    told = {name: figure.text() for name, figure in found.items()}
    if math.isfinite(found["passing"].value):
        way = f"stays above the resonance ({machine.nu_res:.1f} rad/s) from {told['passing']} on"
    else:
        way = f"does not stay above the resonance ({machine.nu_res:.1f} rad/s) within {stop:g} s"
    build_up = 1 / (4 * math.pi * machine.zeta)
    ends = (
        f"{found[f'{name}_end_min'].value:.1f} .. {found[f'{name}_end_max'].value:.1f} {unit}"
        for name, unit in (("w", "rad/s"), ("tau", "N.m"))
    )
    return (
        f"{motor}: {way} and spends {found['revolutions_near'].value:.2f} revolutions within 10 % "
        f"of it (building up takes {build_up:.1f}); on the way torque up to {told['tau_max']}, "
        f"speed up to {told['w_max']}, rod force up to {told['f_rod_max']}; "
        f"at the end {' and '.join(ends)}."
    )


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--set", dest="name", choices=SETS, default="B", help="parameter set")
    add("--speed", type=float, default=60.0, help="mean speed of the linear motor [rad/s]")
    add("--stop", type=float, default=1.0, help="simulated time [s]")
    add("--step", type=float, default=2e-4, help="finest of three communication steps [s]")
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
    found: dict[str, dict[str, Figure]] = {}
    for motor in MOTORS:
        runs[motor], found[motor] = coupled.run(
            motor,
            drive(machine, motor, speed, changes),
            partial(figures, machine, motor),
            stop=stop,
            step=step,
            fed=("f_rod_max",),
            algorithm=algorithm,
            record=RECORD,
            csv=out and out / f"{motor}.csv",
        )
    told = [verdict(machine, motor, stop, figure) for motor, figure in found.items()]
    at = {motor: figure["passing"].value for motor, figure in found.items()}
    passed = {motor: t if math.isfinite(t) else None for motor, t in at.items()}
    return Answer(
        scenario="run_up",
        question=question(__doc__),
        verdict="\n".join(told),
        figures={
            "nu_res": Figure(machine.nu_res, "rad/s", 0.0, meaning="resonance by formula (22)")
        }
        | {f"{motor}_{name}": x for motor, mine in found.items() for name, x in mine.items()},
        parameters=parameters(drive(machine, "linear", speed, changes)),
        tables={f"{motor}.csv": Table.of(result) for motor, result in runs.items()},
        provenance=runs["linear"].provenance | {"flavour": fmus.flavour()},
        stem="run_up",
        facts={"nu_res": machine.nu_res, "passing": passed, "set": name},
        files={"run_up.png": lambda path: plots.run_up(path, machine, runs, passed)},
        show=lambda: Show(conveyor_show.run_up(machine, runs), [conveyor_show.run_up_motion(runs)]),
    )


def run(name: str = "B", out: Path | None = None, **settings: Any) -> None:
    """Write the answer and print the verdict."""
    folder = out or Path("results") / "run_up" / name
    finish(answer(name, out=folder, **settings), folder)
