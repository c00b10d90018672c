"""How does the sealing iron's drive start, and where does the motor's work go?

A motor with lag starts the mechanism from rest in the middle of the bottom dwell; the energy
ledger (work in = stored + friction) stands in the CSV, with what the coupling lost or made.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result
from workbench import Bench, Figure, Findings, Run, Show, Table, option
from workbench.measure import Samples, integral, largest, measured

from . import drive as iron
from . import show as pictures

PARTS = iron.PARTS
STANDS = 0.01
RECORD = (
    "motor.tau", "motor.P", "iron.phi", "iron.w_cam", "iron.lift", "iron.v", "iron.tau_cam",
    "iron.N", "iron.T_iron", "iron.E_kin", "iron.E_pot", "iron.E_friction", "iron.motion",
    "iron.valid", "iron.alpha", "iron.beta", "iron.H",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    motor_A: float = option(4.0, "torque of the motor at rest", "N.m")
    motor_B: float = option(0.025, "slope of the motor's line", "N.m.s/rad", least=0.0)
    motor_T: float = option("12ms", "lag of the motor", "s", above=0.0)
    stop: float = option(3.0, "simulated time", "s", above=0.0)
    step: float = option(5e-4, "finest of three communication steps", "s", above=0.0)


class Start(NamedTuple):
    """The run, the energy ledger beside it, and the iron drive by itself."""

    result: Result
    energy: Mapping[str, Samples]
    alone: iron.Alone


def solve(o: Options, bench: Bench) -> Findings:
    """One start."""
    motor = iron.MOTOR | {"motor.A": o.motor_A, "motor.B": o.motor_B, "motor.T": o.motor_T}
    system = iron.driven(bench.fmus, motor, o.start)
    result, found = bench.certify(system, figures, o, RECORD, "iron_start.csv")
    energy, unit = ledger(result), result.units["iron.E_kin"]
    units = result.units | dict.fromkeys(energy, unit)
    return Findings(
        found,
        Start(result, energy, iron.own(bench.fmus, o.start)),
        system,
        result.provenance,
        tables={"iron_start.csv": Table(result.frame.assign(**energy), units)},
    )


def ledger(r: Result) -> dict[str, Samples]:
    """Work of the motor, energy stored since the start, friction, and what is missing [J]."""
    power = CubicSpline(r["time"], r["motor.P"])
    work = np.asarray(power.antiderivative()(r["time"]))
    stored = r["iron.E_kin"] + r["iron.E_pot"]
    stored, friction = stored - stored[0], r["iron.E_friction"]
    work = work - work[0]
    missing = work - stored - friction
    return {"E_in": work, "E_stored": stored, "E_friction": friction, "E_missing": missing}


def figures(r: Result) -> dict[str, Figure]:
    """Largest speed and torque with their times, the speed it settles at, energies at the end."""
    t, phi, rad, J = r["time"], r["iron.phi"], r.units["iron.w_cam"], r.units["iron.E_kin"]
    w, tau = largest(t, r["iron.w_cam"]), largest(t, r["motor.tau"])
    energy = ledger(r)
    work = integral(t, r["motor.P"])
    missing = float(np.abs(energy["E_missing"]).max())
    return {
        "w_cam_max": w.figure(rad, "largest speed of the cam"),
        "w_cam_max_time": w.at.figure("s", "when the cam is fastest"),
        "tau_max": tau.figure(r.units["motor.tau"], "largest torque of the motor"),
        "tau_max_time": tau.at.figure("s", "when the torque is largest"),
        "w_cam_mean": measured(late, t, phi).figure(rad, "mean speed in the second half"),
        "cycles": measured(lambda t, phi: iron.per_minute(late(t, phi)), t, phi).figure(
            "1/min", "cycles per minute in the second half"
        ),
        "turns": Figure(float(np.ptp(phi[[0, -1]]) / (2 * math.pi)), "1", 0.0, "turns of the cam"),
        "energy_in": work.figure(J, "work of the motor"),
        "energy_stored": Figure(float(energy["E_stored"][-1]), J, 0.0, "stored in the end"),
        "energy_friction": Figure(float(energy["E_friction"][-1]), J, 0.0, "lost to friction"),
        "energy_missing_max": Figure(missing, J, work.error, "most that the coupling made or lost"),
    }


def late(t: Samples, phi: Samples) -> float:
    """Mean speed in the second half."""
    half = (t[0] + t[-1]) / 2
    return float((phi[-1] - CubicSpline(t, phi)(half)) / (t[-1] - half))


def stalls(r: Result, fastest: float) -> bool:
    """Whether the cam hardly turns in the last tenth of the run."""
    last = r["time"] >= 0.9 * r["time"][-1]
    t, phi = r["time"][last], r["iron.phi"][last]
    return bool(phi[-1] - phi[0] < STANDS * fastest * (t[-1] - t[0]))


def verdict(o: Options, f: Mapping[str, Figure], r: Start) -> str:
    """How the cam starts, how it goes on, and the ledger."""
    told = {name: figure.text() for name, figure in f.items()}
    if stalls(r.result, f["w_cam_max"].value):
        goes_on = f"The motor stalls: the cam has made {told['turns']} turns and does not turn on."
    else:
        pace = f["cycles"].text("cycles/min")
        goes_on = f"In the second half it turns at {told['w_cam_mean']} ({pace})."
    return "\n".join(
        [
            f"The cam shoots up to {told['w_cam_max']} after {told['w_cam_max_time']}. {goes_on} Of "
            f"{told['energy_in']} from the motor, friction takes {told['energy_friction']} and "
            f"{told['energy_stored']} are stored in the end.",
            f"The motor's torque is largest after {told['tau_max_time']}, {told['tau_max']}; in "
            f"{o.stop:g} s the cam makes {told['turns']} turns.",
            f"The coupling made or lost at most {told['energy_missing_max']}.",
        ]
    )


def show(o: Options, f: Mapping[str, Figure], r: Start) -> Show:
    """Speed, lift, torque and ledger over time, and the mechanism in motion."""
    moving = pictures.motion(r.result, r.alone, "The start", 0.0, o.stop, 2.0)
    return Show(pictures.start_up(r.result, r.energy), [moving])
