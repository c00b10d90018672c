"""How does one product turn over, and how long does each stage take?

One cup from the drop to the end, with its trajectory, angles and speeds.
"""

from __future__ import annotations

from argparse import SUPPRESS, ArgumentParser
from pathlib import Path

import numpy as np

import cosim
from cosim import Result
from cosim.result import partial, write_json

from . import options, orientator, orientator_plots

RECORD = [
    "stage", "reason", "phi1", "phi2", "w1", "w2", "xc", "yc", "vxc", "vyc", "v_s", "N_K",
    "contact", "E_kin", "E_pot", "t_falling", "t_joint", "t_turning", "t_released",
    "orientation_time", "S_x", "S_y", "S_k", "P_B", "P_K",
]  # fmt: skip
STAGES = ("falling", "joint", "turning", "released")


def verdict(result: Result) -> str:
    """The answer in plain words."""
    last = {name: result[f"orientator.{name}"][-1] for name in RECORD}
    times = ", ".join(f"{stage} {1e3 * last[f't_{stage}']:.2f} ms" for stage in STAGES)
    if last["stage"] == orientator.ORIENTED:
        end = f"Oriented after {last['orientation_time']:.5f} s"
    elif last["stage"] == orientator.JAMMED:
        end = f"Jammed: {orientator.item_names('reason')[int(last['reason'])]}"
    else:
        stage, why = (orientator.item_names(x)[int(last[x])] for x in ("stage", "reason"))
        end = f"Not finished: {stage}, {why}"
    return (
        f"{end}; {times}.\nThe cup lands with {1e3 * last['S_y']:.3f} N.ms on the corner and "
        f"{1e3 * last['S_k']:.3f} N.ms on the wall, and meets the hook with {1e3 * last['P_B']:.3f} N.ms."
    )


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--speed", type=float, default=40.0, help="speed of the rotor [rpm]")
    add("--friction", type=float, default=0.35, help="friction between cup and wall")
    add("--stop", type=float, default=orientator.LONGEST, help="longest simulated time [s]")
    add("--step", type=float, default=1e-3, help="communication step [s]")
    add("--animate", action="store_true", help="also write the motion, cycle.gif")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/orientator_cycle by default")


def run(
    speed: float = 40.0,
    friction: float = 0.35,
    stop: float = orientator.LONGEST,
    step: float = 1e-3,
    animate: bool = False,
    out: Path = Path("results/orientator_cycle"),
) -> None:
    """Write cycle.csv, .json and .png (and .gif), print the verdict."""
    options.not_negative("speed", speed, "rpm")
    options.not_negative("friction", friction)
    orientator.built()
    result = shortened(orientator.product(speed, friction, step, stop, RECORD))
    out.mkdir(parents=True, exist_ok=True)
    orientator_plots.cycle(out / "cycle.png", result, speed, friction)
    if animate:
        orientator_plots.animation(out / "cycle.gif", result)
    write_json(out / "cycle.json", result.provenance | {"units": result.units})
    result.frame.to_csv(partial(out / "cycle.csv"), index=False)
    partial(out / "cycle.csv").replace(out / "cycle.csv")
    print(verdict(result))
    files = ["cycle.csv", "cycle.json", "cycle.png", *(["cycle.gif"] if animate else [])]
    print(f"{', '.join(files)} written to {out}")


def shortened(result: Result) -> Result:
    """The rows up to the first one after the end."""
    over = np.flatnonzero(result["orientator.stage"] >= orientator.ORIENTED)
    rows = over[0] + 1 if len(over) else len(result.data)
    data = result.data[:rows]
    return cosim.Result(result.columns, result.units, result.provenance, lambda: data)
