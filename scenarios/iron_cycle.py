"""What do motor, chain and cam of the sealing iron carry over one turn, and how fast may it run?

The cam turns at constant speed; torque, forces and motion of the iron over the cam angle, the work
friction costs per cycle, and the speeds at which follower or chain let go.
"""

from __future__ import annotations

import csv
import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.integrate import trapezoid

from cosim import Result
from cosim.result import partial, write_json

from . import fmus, iron, iron_plots, options

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


def write_turn(path: Path, result: Result) -> None:
    """The turn as CSV over the cam angle, under the FMU's own names."""
    with partial(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(result.data[:, 1:].tolist())
    partial(path).replace(path)


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--speed", type=float, default=iron.NOMINAL, help="speed of the cam [rad/s]")
    add("--samples", type=int, default=1440, help="communication steps per turn")
    add("--animate", action="store_true", help="also write the mechanism in motion, cycle.gif")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/iron_cycle by default")
    iron.add_start(parser)


def run(
    speed: float = iron.NOMINAL,
    samples: int = 1440,
    animate: bool = False,
    start: Sequence[str] = (),
    out: Path = Path("results/iron_cycle"),
) -> None:
    """Write cycle.csv, .json and .png (and .gif), print the verdict."""
    options.positive("speed", speed, "rad/s")
    options.at_least("samples", samples, 36)
    changes = iron.start_values(start)
    fmus.build("iron_drive")
    result = iron.turn(speed, changes, samples, iron.names(COLUMNS))
    limits = iron.speed_limits(changes)
    out.mkdir(parents=True, exist_ok=True)
    iron_plots.cycle(out / "cycle.png", result, speed, limits)
    if animate:
        iron_plots.animation(out / "cycle.gif", result)
    write_json(out / "cycle.json", {"speed": speed, "limits": limits} | result.provenance)
    write_turn(out / "cycle.csv", result)
    print(verdict(result, speed, limits))
    files = ["cycle.csv", "cycle.json", "cycle.png", *(["cycle.gif"] if animate else [])]
    print(f"{', '.join(files)} written to {out}")
