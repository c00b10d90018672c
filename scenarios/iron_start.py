"""How does the sealing iron's drive start, and where does the motor's work go?

A motor with lag starts the mechanism from rest in the middle of the bottom dwell; the energy
ledger (work in = stored + friction) stands in the CSV, with what the coupling lost or made.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
from cosim import Result
from cosim.progress import bar

from . import fmus, iron, iron_plots, options
from .answer import Answer, Figure, Table, finish, parameters, question

RECORD = (
    "motor.tau", "motor.P", "iron.phi", "iron.w_cam", "iron.lift", "iron.v", "iron.tau_cam",
    "iron.N", "iron.T_iron", "iron.E_kin", "iron.E_pot", "iron.E_friction", "iron.motion",
    "iron.valid",
)  # fmt: skip


def ledger(result: Result) -> dict[str, iron.Samples]:
    """Work of the motor, energy stored since the start, friction, and what is missing [J]."""
    power = CubicSpline(result["time"], result["motor.P"])
    work = np.asarray(power.antiderivative()(result["time"]))
    stored = result["iron.E_kin"] + result["iron.E_pot"]
    stored = stored - stored[0]
    friction = result["iron.E_friction"]
    return {
        "E_in": work - work[0],
        "E_stored": stored,
        "E_friction": friction,
        "E_missing": work - work[0] - stored - friction,
    }


def verdict(result: Result, energy: dict[str, iron.Samples]) -> str:
    """The answer in plain words."""
    t, w, tau = (result[name] for name in ("time", "iron.w_cam", "motor.tau"))
    top, pull = int(np.argmax(w)), int(np.argmax(tau))
    turns = (result["iron.phi"][-1] - result["iron.phi"][0]) / (2 * math.pi)
    late = t > t[-1] / 2
    return "\n".join(
        [
            f"The cam shoots up to {w[top]:.4f} rad/s at {t[top]:.4f} s, the motor's torque to "
            f"{tau[pull]:.4f} N.m at {t[pull]:.4f} s.",
            f"In the second half it turns at {w[late].mean():.4g} rad/s "
            f"({iron.per_minute(w[late].mean()):.2f} cycles/min), {turns:.2f} turns in {t[-1]:g} s.",
            f"Of {energy['E_in'][-1]:.5g} J from the motor {energy['E_stored'][-1]:.5g} J are stored "
            f"and {energy['E_friction'][-1]:.5g} J went into friction; the coupling made or lost at "
            f"most {np.abs(energy['E_missing']).max():.2g} J.",
        ]
    )


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    for name, unit in (("A", "N.m"), ("B", "N.m.s/rad"), ("T", "s")):
        key = f"motor.{name}"
        add(f"--motor-{name}", type=float, default=iron.MOTOR[key], help=f"{key} [{unit}]")
    add("--stop", type=float, default=3.0, help="simulated time [s]")
    add("--step", type=float, default=5e-4, help="communication step [s]")
    add("--algorithm", choices=cosim.ALGORITHMS, default="strang", help="coupling algorithm")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/iron_start by default")
    options.add_start(parser, "iron.spring.side=-1")


def answer(
    motor_A: float = iron.MOTOR["motor.A"],
    motor_B: float = iron.MOTOR["motor.B"],
    motor_T: float = iron.MOTOR["motor.T"],
    stop: float = 3.0,
    step: float = 5e-4,
    algorithm: str = "strang",
    start: Sequence[str] = (),
    out: Path | None = None,
) -> Answer:
    """Start the mechanism from rest; rows are kept in `out` on the way."""
    changes = options.start_values(start)
    motor = dict(iron.MOTOR) | {"motor.A": motor_A, "motor.B": motor_B, "motor.T": motor_T}
    fmus.build("drive_motor", "iron_drive")
    system = iron.driven(motor, changes)
    with bar("start", 0.0, stop) as progress:
        result = cosim.run(
            system,
            stop=stop,
            step=step,
            algorithm=algorithm,
            record=RECORD,
            csv=out and out / "start.csv",
            progress=progress,
        )
    energy = ledger(result)
    return Answer(
        scenario="iron_start",
        question=question(__doc__),
        verdict=verdict(result, energy),
        figures=figures(result, energy),
        parameters=parameters(system),
        tables={
            "start.csv": Table(
                result.frame.assign(**energy), result.units | dict.fromkeys(energy, "J")
            )
        },
        provenance=result.provenance | {"flavour": fmus.flavour()},
        stem="start",
        files={"start.png": lambda path: iron_plots.start_up(path, result, energy)},
    )


def figures(result: Result, energy: dict[str, iron.Samples]) -> dict[str, Figure]:
    """Largest speed and torque with their times, the speed it settles at, energies at the end."""
    t, w, tau = (result[name] for name in ("time", "iron.w_cam", "motor.tau"))
    found = {
        "w_cam_max": (w.max(), "rad/s"),
        "w_cam_max_time": (t[np.argmax(w)], "s"),
        "tau_max": (tau.max(), "N.m"),
        "tau_max_time": (t[np.argmax(tau)], "s"),
        "w_cam_mean": (w[t > t[-1] / 2].mean(), "rad/s"),
        "turns": ((result["iron.phi"][-1] - result["iron.phi"][0]) / (2 * math.pi), "1"),
        "energy_in": (energy["E_in"][-1], "J"),
        "energy_stored": (energy["E_stored"][-1], "J"),
        "energy_friction": (energy["E_friction"][-1], "J"),
        "energy_missing_max": (np.abs(energy["E_missing"]).max(), "J"),
    }
    return {name: Figure(float(value), unit) for name, (value, unit) in found.items()}


def run(out: Path = Path("results/iron_start"), **settings: Any) -> None:
    """Write the answer and print the verdict."""
    finish(answer(out=out, **settings), out)
