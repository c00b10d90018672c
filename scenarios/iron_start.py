"""How does the sealing iron's drive start, and where does the motor's work go?

A motor with lag starts the mechanism from rest in the middle of the bottom dwell; the energy
ledger (work in = stored + friction) stands in the CSV, with what the coupling lost or made.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
from cosim import Result

from . import coupled, fmus, iron, iron_plots, iron_show, options
from .answer import Answer, Figure, Show, Table, finish, parameters, question
from .coupled import largest

PARTS = iron.PARTS
RECORD = (
    "motor.tau", "motor.P", "iron.phi", "iron.w_cam", "iron.lift", "iron.v", "iron.tau_cam",
    "iron.N", "iron.T_iron", "iron.E_kin", "iron.E_pot", "iron.E_friction", "iron.motion",
    "iron.valid", "iron.alpha", "iron.beta", "iron.H",
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


def figures(result: Result) -> dict[str, tuple[float, str, str]]:
    """Largest speed and torque with their times, the speed it settles at, energies at the end."""
    t, w, tau, phi = (result[n] for n in ("time", "iron.w_cam", "motor.tau", "iron.phi"))
    energy = ledger(result)
    (w_max, w_at), (tau_max, tau_at) = largest(t, w), largest(t, tau)
    half = t[-1] / 2
    late = float(phi[-1] - CubicSpline(t, phi)(half)) / (t[-1] - half)
    return {
        "w_cam_max": (w_max, "rad/s", "largest speed of the cam"),
        "w_cam_max_time": (w_at, "s", "when the cam is fastest"),
        "tau_max": (tau_max, "N.m", "largest torque of the motor"),
        "tau_max_time": (tau_at, "s", "when the torque is largest"),
        "w_cam_mean": (late, "rad/s", "mean speed in the second half"),
        "turns": (float(phi[-1] - phi[0]) / (2 * math.pi), "1", "turns of the cam"),
        "energy_in": (float(energy["E_in"][-1]), "J", "work of the motor"),
        "energy_stored": (float(energy["E_stored"][-1]), "J", "stored in the end"),
        "energy_friction": (float(energy["E_friction"][-1]), "J", "lost to friction"),
        "energy_missing_max": (
            float(np.abs(energy["E_missing"]).max()), "J", "most that the coupling made or lost"
        ),
    }  # fmt: skip


def verdict(stop: float, found: Mapping[str, Figure]) -> str:
    """The answer in plain words."""
    told = {name: figure.text() for name, figure in found.items()}
    mean = found["w_cam_mean"].value
    return "\n".join(
        [
            f"The cam shoots up to {told['w_cam_max']} at {told['w_cam_max_time']}, the motor's "
            f"torque to {told['tau_max']} at {told['tau_max_time']}.",
            f"In the second half it turns at {told['w_cam_mean']} "
            f"({iron.per_minute(mean):.2f} cycles/min), {found['turns'].value:.2f} turns in {stop:g} s.",
            f"Of {told['energy_in']} from the motor {told['energy_stored']} are stored and "
            f"{told['energy_friction']} went into friction; the coupling made or lost at most "
            f"{found['energy_missing_max'].value:.2g} J.",
        ]
    )


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    for name, unit in (("A", "N.m"), ("B", "N.m.s/rad"), ("T", "s")):
        key = f"motor.{name}"
        add(f"--motor-{name}", type=float, default=iron.MOTOR[key], help=f"{key} [{unit}]")
    add("--stop", type=float, default=3.0, help="simulated time [s]")
    add("--step", type=float, default=5e-4, help="finest of three communication steps [s]")
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
    fmus.build(*PARTS.values())
    system = iron.driven(motor, changes)
    result, found = coupled.run(
        "start",
        system,
        figures,
        stop=stop,
        step=step,
        algorithm=algorithm,
        record=RECORD,
        csv=out and out / "start.csv",
    )
    energy = ledger(result)
    return Answer(
        scenario="iron_start",
        question=question(__doc__),
        verdict=verdict(stop, found),
        figures=found,
        parameters=parameters(system),
        tables={
            "start.csv": Table(
                result.frame.assign(**energy), result.units | dict.fromkeys(energy, "J")
            )
        },
        provenance=result.provenance | {"flavour": fmus.flavour()},
        stem="start",
        files={"start.png": lambda path: iron_plots.start_up(path, result, energy)},
        show=lambda: Show(
            [iron_show.start_up(result, energy)],
            [iron_show.motion(result, iron.own(changes), "The start", 0.0, stop, 2.0)],
        ),
    )


def run(out: Path = Path("results/iron_start"), **settings: Any) -> None:
    """Write the answer and print the verdict."""
    finish(answer(out=out, **settings), out)
