"""What do motor, chain and cam of the sealing iron carry over one turn, and how fast may it run?

The cam turns at constant speed; torque, forces and motion of the iron over the cam angle, the work
friction costs per cycle, and the speeds at which follower or chain let go.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from cosim import Result

from . import fmus, iron, iron_plots, iron_show, options
from .answer import Answer, Figure, Show, Table, finish, parameters, question
from .page import motion

PARTS = {"iron": iron.PARTS["iron"]}
COLUMNS = (
    "phi", "lift", "v", "a", "tau_cam", "T_iron", "T_hang", "T_span", "M_rocker", "N", "pressure",
    "alpha", "beta", "H", "E_friction", "motion",
)  # fmt: skip
WHAT = {
    "N": "the follower lifts off",
    "T_span": "the run goes slack",
    "T_iron": "the iron hangs free",
}


def verdict(result: Result, speed: float, limits: dict[str, tuple[float, float]]) -> str:
    """The answer in plain words."""
    phi, torque = result["iron.phi"], result["iron.tau_cam"]
    low, high = int(np.argmin(torque)), int(np.argmax(torque))
    i_g = result.provenance["parts"]["iron"]["parameters"]["reducer.i_g"]
    work = float(trapezoid(torque, phi))
    lines = [
        f"At {speed:.4g} rad/s ({iron.per_minute(speed):.1f} cycles/min) the cam's shaft needs "
        f"{torque[low]:.4g} N.m (at {math.degrees(phi[low]):.1f} deg) to {torque[high]:+.4g} N.m "
        f"(at {math.degrees(phi[high]):.1f} deg), the motor {np.abs(torque).max() / i_g:.3g} N.m.",
        f"The iron strokes {1e3 * result['iron.lift'].max():.2f} mm; its friction costs "
        f"{result['iron.E_friction'][-1]:.5g} J per cycle, the torque's work is {work:.5g} J.",
        f"The least loads on the way: follower {result['iron.N'].min():.4g} N, run of the chain "
        f"{result['iron.T_span'].min():.4g} N, chain at the iron {result['iron.T_iron'].min():.4g} N.",
    ]
    first = min(limits, key=lambda name: limits[name][0])
    for name, (limit, angle) in sorted(limits.items(), key=lambda item: item[1][0]):
        start = "Faster" if name == first else "Then"
        lines.append(
            f"{start}: {WHAT[name]} at {limit:.4f} rad/s ({iron.per_minute(limit):.1f} cycles/min), "
            f"at {math.degrees(angle):.1f} deg."
        )
    safe = "safe" if speed < limits[first][0] else "NOT possible"
    lines.append(f"This speed is {safe}: {speed / limits[first][0]:.0%} of the first limit.")
    return "\n".join(lines)


def figures(result: Result, limits: dict[str, tuple[float, float]]) -> dict[str, Figure]:
    """Torque, stroke, work of friction, least loads and limits of the speed; nothing is coupled."""
    torque = result["iron.tau_cam"]
    i_g = result.provenance["parts"]["iron"]["parameters"]["reducer.i_g"]
    found = {
        "tau_cam_min": (torque.min(), "N.m", "least torque at the cam's shaft"),
        "tau_cam_max": (torque.max(), "N.m", "largest torque at the cam's shaft"),
        "tau_motor_max": (np.abs(torque).max() / i_g, "N.m", "largest torque of the motor"),
        "stroke": (result["iron.lift"].max(), "m", "stroke of the iron"),
        "friction_work": (result["iron.E_friction"][-1], "J", "friction of the guide in a turn"),
        "work": (trapezoid(torque, result["iron.phi"]), "J", "work of the torque in a turn"),
        "follower_force_min": (
            result["iron.N"].min(),
            "N",
            "least force of the cam on its follower",
        ),
        "run_force_min": (result["iron.T_span"].min(), "N", "least pull in the run of the chain"),
        "iron_force_min": (result["iron.T_iron"].min(), "N", "least pull of the chain on the iron"),
        "follower_limit": (limits["N"][0], "rad/s", "cam speed where the follower lifts off"),
        "run_limit": (limits["T_span"][0], "rad/s", "cam speed where the run goes slack"),
        "iron_limit": (limits["T_iron"][0], "rad/s", "cam speed where the iron hangs free"),
    }
    return {
        name: Figure(float(value), unit, 0.0, meaning=meaning)
        for name, (value, unit, meaning) in found.items()
    }


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--speed", type=float, default=iron.NOMINAL, help="speed of the cam [rad/s]")
    add("--samples", type=int, default=1440, help="communication steps per turn")
    add("--animate", action="store_true", help="also write the mechanism in motion, cycle.gif")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/iron_cycle by default")
    options.add_start(parser, "iron.spring.side=-1")


def answer(
    speed: float = iron.NOMINAL,
    samples: int = 1440,
    animate: bool = False,
    start: Sequence[str] = (),
    out: Path | None = None,
) -> Answer:
    """One turn of the cam and the limits of its speed; a turn takes a second, `out` keeps nothing."""
    options.positive("speed", speed, "rad/s")
    options.at_least("samples", samples, 36)
    changes = options.start_values(start, iron.IMPOSED)
    fmus.build(*PARTS.values())
    result = iron.turn(speed, changes, samples, iron.names(COLUMNS))
    limits = iron.speed_limits(changes)

    def seen() -> motion.Motion:
        last = float(result["time"][-1])
        return iron_show.motion(result, changes, "One turn of the cam", 0.0, last, 4.0)

    files: dict[str, Callable[[Path], None]] = {
        "cycle.png": lambda path: iron_plots.cycle(path, result, speed, limits)
    }
    if animate:
        files["cycle.gif"] = lambda path: motion.gif(path, seen())
    table = result.frame[iron.names(COLUMNS)].set_axis(list(COLUMNS), axis="columns")
    units = {name: result.units[f"iron.{name}"] for name in COLUMNS}
    return Answer(
        scenario="iron_cycle",
        question=question(__doc__),
        verdict=verdict(result, speed, limits),
        figures=figures(result, limits),
        parameters=parameters(iron.imposed(speed, changes)),
        tables={"cycle.csv": Table(table, units)},
        provenance=result.provenance | {"flavour": fmus.flavour()},
        stem="cycle",
        facts={"speed": speed, "limits": limits},
        files=files,
        show=lambda: Show([iron_show.cycle(result)], [seen()]),
    )


def run(out: Path = Path("results/iron_cycle"), **settings: Any) -> None:
    """Write the answer and print the verdict."""
    finish(answer(out=out, **settings), out)
