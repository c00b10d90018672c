"""Does the packing line keep pace, what does a jam cost, and what does its supply have to bear?

One motor drives the sealing iron; its cam shaft turns the orientator's rotor through a gear and
releases a product at the start of each top dwell; a conveyor on its own motor feeds it. The
orientator takes no power from the shaft in its model, so that the supply gives that of two motors.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress
from scipy.interpolate import CubicSpline

import cosim
from cosim import Estimate, Result, System
from cosim.result import partial, write_json

from . import fmus, iron, options, orientator, packing_plot
from .orders import harmonics
from .theory import SETS

PARTS = {
    "iron_motor": "drive_motor",
    "iron": "iron_drive",
    "orientator": "gravity_orientator",
    "conveyor_motor": "drive_motor",
    "conveyor": "crank_conveyor",
}
WIRES = (
    "iron_motor.tau -> iron.tau",
    "iron.w -> iron_motor.w",
    "iron.top_dwell -> orientator.release",
    "conveyor_motor.tau -> conveyor.tau",
    "conveyor.w -> conveyor_motor.w",
)
RECORD = (
    "iron_motor.P", "iron_motor.tau", "iron.phi", "iron.w_cam", "iron.lift", "iron.top_dwell",
    "iron.E_kin", "iron.E_pot", "iron.E_friction",
    "orientator.stage", "orientator.reason", "orientator.orientation_time", "orientator.phi2",
    "orientator.oriented", "orientator.jammed", "orientator.missed",
    "conveyor_motor.P", "conveyor_motor.tau", "conveyor.phi", "conveyor.w", "conveyor.x",
    "conveyor.E_kin", "conveyor.E_pot", "conveyor.P_loss",
)  # fmt: skip
DRIVES = {"iron": "iron.phi", "conveyor": "conveyor.phi"}
HIGHEST = {"iron": 12, "conveyor": 4}
START, FIRST_RELEASE = math.radians(-60.0), math.radians(100.0)
MAIN, APART = 0.1, 0.05
UNITS = {"orientation": "s", "cycle": "s", "cam": "rad/s", "mean": "W", "rms": "W"}


class Pace(NamedTuple):
    """What became of the products between the first release and the last: row numbers of the
    releases, products released and oriented, the reason of the last failure."""

    releases: list[int]
    released: int
    oriented: int
    reason: int


class Line(NamedTuple):
    """One order of the ripple: the drive whose angle counts it, frequency [Hz], amplitudes [W]."""

    drive: str
    order: int
    frequency: float
    own: float
    supply: float


def system(gear: float, iron_speed: float, conveyor_set: str, speed: float) -> System:
    """The line; all start values are parameters, because some hosts set no other ones."""
    start: dict[str, float | int | bool | str] = {
        "iron_motor.A": no_speed_torque(iron_speed),
        "iron_motor.B": iron.MOTOR["motor.B"],
        "iron_motor.T": iron.MOTOR["motor.T"],
    }
    for name, value in SETS[conveyor_set].start(speed).items():
        if name not in ("motor.tau", "conveyor.phi", "conveyor.w"):
            start[name.replace("motor.", "conveyor_motor.")] = value
    wires = [*WIRES, f"iron.w_cam * {gear!r} -> orientator.w"]
    return System({part: fmus.fmu(name) for part, name in PARTS.items()}, wires, start)


def no_speed_torque(speed: float) -> float:
    """A of the iron's motor for a mean speed of the cam [rad/s], which carries the friction [N.m]."""
    turn = iron.turn(1.0, {}, 360, iron.names(("E_friction",)))
    i_g = float(turn.provenance["parts"]["iron"]["parameters"]["reducer.i_g"])
    friction = float(turn["iron.E_friction"][-1]) / (2 * math.pi * i_g)
    return iron.MOTOR["motor.B"] * i_g * speed + friction


def powers(result: Result) -> dict[str, iron.Samples]:
    """Mechanical power of each motor and of the supply [W]."""
    parts = {drive: result[f"{drive}_motor.P"] for drive in DRIVES}
    return parts | {"supply": parts["iron"] + parts["conveyor"]}


def pace(result: Result) -> Pace:
    """Count the products of the whole cycles; raises SetupError where the cam does not keep turning."""
    if (
        result["iron.phi"][-1] < FIRST_RELEASE + 2 * math.pi
        or np.diff(result["iron.phi"]).min() <= 0.0
    ):
        raise cosim.SetupError(
            f"the cam stands or turns back, at iron.phi = {result['iron.phi'][-1]:.4g} rad in the "
            "end: at this iron speed its motor cannot lift the iron"
        )
    releases = (np.flatnonzero(np.diff(result["iron.top_dwell"]) > 0.5) + 1).tolist()
    first, last = releases[0], releases[-1]
    oriented = result["orientator.oriented"]
    reason = int(result["orientator.reason"][last - 1])
    return Pace(releases, len(releases) - 1, int(oriented[last] - oriented[first]), reason)


def window(result: Result) -> slice:
    """The rows of the whole cycles."""
    releases = pace(result).releases
    return slice(releases[0], releases[-1] + 1)


def figures(result: Result) -> dict[str, float]:
    """Cycle, mean speed of the cam, mean and rms ripple of the powers over whole turns."""
    pace(result)
    angle = result["iron.phi"]
    when = CubicSpline(angle, result["time"])
    turns = int((angle[-1] - FIRST_RELEASE) / (2 * math.pi))
    began, ended = (float(when(FIRST_RELEASE + 2 * math.pi * k)) for k in (0, turns))
    found = {
        "cycle": (ended - began) / turns,
        "cam": 2 * math.pi * turns / (ended - began),
    }
    for name, P in powers(result).items():
        course = CubicSpline(result["time"], P)
        mean = float(course.integrate(began, ended)) / (ended - began)
        square = CubicSpline(result["time"], (P - mean) ** 2)
        found[f"mean {name}"] = mean
        found[f"rms {name}"] = math.sqrt(float(square.integrate(began, ended)) / (ended - began))
    return found


def orientation(result: Result) -> float:
    """How long the last product of the whole cycles took, 0 if it jammed [s]."""
    return float(result["orientator.orientation_time"][window(result)][-2])


def ripple(result: Result) -> list[Line]:
    """The orders of cam and crank over the whole cycles, in their drive's power and the supply's."""
    rows, power = window(result), powers(result)
    t = result["time"][rows]
    lines = []
    for drive, angle in DRIVES.items():
        phi = result[angle][rows]
        rate = float((phi[-1] - phi[0]) / (2 * math.pi * (t[-1] - t[0])))
        sizes = (np.abs(harmonics(phi, power[x][rows], HIGHEST[drive])) for x in (drive, "supply"))
        for k, (own, supply) in enumerate(zip(*sizes), 1):
            lines.append(Line(drive, k, k * rate, float(own), float(supply)))
    return lines


def verdict(result: Result, found: Mapping[str, Estimate]) -> str:
    """The answer in plain words."""
    told = {name: value.text(UNITS[name.split()[0]]) for name, value in found.items()}
    return "\n".join([_pace(result, found, told), _jam(result, found), _supply(result, told)])


def _pace(result: Result, found: Mapping[str, Estimate], told: Mapping[str, str]) -> str:
    count = pace(result)
    cycle = f"the next release comes after {told['cycle']}"
    if count.oriented < count.released:
        why = orientator.item_names("reason")[count.reason]
        missed = result["orientator.missed"][count.releases[-1]]
        end = f", and {missed:.0f} releases find it under way" if missed else ""
        return (
            f"{count.oriented} of {count.released} products are oriented: the orientator jams "
            f"({why}){end}; {cycle}."
        )
    spare = found["cycle"].value - found["orientation"].value
    return (
        f"Every product is oriented in {told['orientation']}; {cycle}: {spare:.3f} s to spare, "
        f"{spare / found['cycle'].value:.0%} of the cycle."
    )


def _jam(result: Result, found: Mapping[str, Estimate]) -> str:
    count = pace(result)
    rate = 60 / found["cycle"].value
    work = found["mean supply"].value * found["cycle"].value
    lost = rate * (1 - count.oriented / count.released)
    return (
        f"Of {rate:.2f} products/min jams cost {lost:.2f}. Each costs its product and the "
        f"{work:.4g} J that the supply gives in a cycle; each minute of clearing, {rate:.2f} more."
    )


def _supply(result: Result, told: Mapping[str, str]) -> str:
    rows, power, lines = window(result), powers(result), ripple(result)
    text = []
    for name in ("iron", "conveyor", "supply"):
        swing = power[name][rows]
        main = [x for x in sorted(lines, key=lambda x: -x.own) if x.drive == name][:3]
        orders = ", ".join(f"{x.order} ({x.frequency:.2f} Hz) {x.own:.4g} W" for x in main)
        shaft = "cam" if name == "iron" else "crank"
        end = f"; main orders of the {shaft}: {orders}" if main else ""
        text.append(
            f"Power of the {name}: mean {told[f'mean {name}']}, ripple {told[f'rms {name}']} rms, "
            f"{swing.min():.4g} .. {swing.max():.4g} W{end}."
        )
    return "\n".join([*text, together(result, lines)])


def correlation(result: Result) -> float:
    """Of the two powers over the whole cycles: 0 apart, 1 in phase, -1 against each other."""
    rows, power = window(result), powers(result)
    return float(np.corrcoef(power["iron"][rows], power["conveyor"][rows])[0, 1])


def together(result: Result, lines: list[Line]) -> str:
    """Whether the ripples of the two drives add."""
    strong = {
        drive: [x for x in lines if x.drive == drive and x.own > MAIN * most]
        for drive in DRIVES
        for most in [max(x.own for x in lines if x.drive == drive)]
    }
    cam, crank = min(
        ((a, b) for a in strong["iron"] for b in strong["conveyor"]),
        key=lambda pair: abs(pair[0].frequency - pair[1].frequency),
    )
    gap = abs(cam.frequency - crank.frequency)
    r = correlation(result)
    if gap < cam.frequency / cam.order / 2:
        return (
            f"The ripples meet: order {cam.order} of the cam and order {crank.order} of the crank "
            f"are {gap:.3g} Hz apart and beat; at worst they add to {cam.own + crank.own:.4g} W."
        )
    sums = "add in squares" if abs(r) < APART else f"add with correlation {r:.2f}"
    return (
        f"The ripples sit apart in frequency, the nearest main orders (cam {cam.order}, crank "
        f"{crank.order}) by {gap:.2f} Hz: their rms values {sums}."
    )


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--gear", type=float, default=1.25, help="speed of the rotor over speed of the cam")
    add("--iron-speed", type=float, default=iron.NOMINAL, help="mean speed of the cam [rad/s]")
    add("--conveyor-set", choices=SETS, default="B", help="parameter set of the conveyor's drive")
    add("--speed", type=float, default=60.0, help="mean speed of the crank [rad/s]")
    add("--stop", type=float, default=5.5, help="simulated time [s]")
    add("--step", type=float, default=2e-3, help="coarsest of three communication steps [s]")
    add("--algorithm", choices=cosim.ALGORITHMS, default="strang", help="coupling algorithm")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/packing_line by default")


def run(
    gear: float = 1.25,
    iron_speed: float = iron.NOMINAL,
    conveyor_set: str = "B",
    speed: float = 60.0,
    stop: float = 5.5,
    step: float = 2e-3,
    algorithm: str = "strang",
    out: Path = Path("results/packing_line"),
) -> None:
    """Write packing_line.csv, .json, .png and line.ssp, print the verdict."""
    options.positive("gear", gear, "turns of the rotor per turn of the cam")
    options.positive("iron speed", iron_speed, "rad/s")
    options.positive("speed", speed, "rad/s")
    least = (FIRST_RELEASE - START + 4.2 * math.pi) / iron_speed
    if not least <= stop < math.inf:
        raise cosim.SetupError(
            f"stop = {stop!r} s must be at least {least:.3f} s, two cycles after the first release"
        )
    fmus.build(*dict.fromkeys(PARTS.values()))
    line = system(gear, iron_speed, conveyor_set, speed)
    times: list[float] = []

    def seen(result: Result) -> dict[str, float]:
        found = figures(result)
        times.append(orientation(result))
        return found

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("line", total=1.0)
        result, found = cosim.certify(
            line,
            seen,
            stop=stop,
            step=step,
            algorithm=algorithm,
            record=RECORD,
            csv=out / "packing_line.csv",
            progress=lambda share: bar.update(task, completed=share),
        )
    # Releases fall on communication points, so that this error falls in no order: it is the spread.
    found["orientation"] = Estimate(times[-1], max(times) - min(times), 0.0)
    table = out / "packing_line.csv"
    result.frame.assign(P_supply=powers(result)["supply"]).to_csv(partial(table), index=False)
    partial(table).replace(table)
    write_json(out / "packing_line.json", facts(result, found) | {"gear": gear})
    packing_plot.timing(out / "packing_line.png", result, pace(result), gear)
    cosim.write_ssp(line, out / "line.ssp", stop=stop)
    print(verdict(result, found))
    print(f"packing_line.csv, .json and .png, and line.ssp written to {out}")


def facts(result: Result, found: Mapping[str, Estimate]) -> dict[str, Any]:
    """Provenance, units, the figures with their coupling errors, products and ripple."""
    count = pace(result)
    return result.provenance | {
        "units": result.units | {"P_supply": "W"},
        "figures": {
            name: value._asdict() | {"unit": UNITS[name.split()[0]]}
            for name, value in found.items()
        },
        "products": {"released": count.released, "oriented": count.oriented},
        "reason": orientator.item_names("reason")[count.reason],
        "ripple": [x._asdict() for x in ripple(result)],
        "correlation": correlation(result),
    }
