"""How does one product turn over, and how long does each stage take?

One cup from the drop to the end, with its trajectory, angles and speeds.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import cosim
from cosim import Result

from . import fmus, options, orientator, orientator_plots, orientator_show
from .answer import Answer, Figure, Show, Table, finish, parameters, question
from .page import motion

PARTS = orientator.PARTS
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
    options.add_start(parser, "orientator.cup.m=0.05")


def answer(
    speed: float = 40.0,
    friction: float = 0.35,
    stop: float = orientator.LONGEST,
    step: float = 1e-3,
    animate: bool = False,
    start: Sequence[str] = (),
    out: Path | None = None,
) -> Answer:
    """One product; it takes a second, `out` keeps nothing on the way."""
    options.not_negative("speed", speed, "rpm")
    options.not_negative("friction", friction)
    changes = options.start_values(start, ("orientator.release",))
    fmus.build(*PARTS.values())
    result = shortened(orientator.product(speed, friction, changes, step, stop, RECORD))
    given = parameters(orientator.system(speed, friction, changes))
    n, mu = (float(given[f"orientator.{name}"].value) for name in ("w", "chute.mu"))
    n *= 30 / math.pi

    def seen() -> motion.Motion:
        last = float(result["time"][-1])
        return orientator_show.motion("One product", {"": result}, last)

    files: dict[str, Callable[[Path], None]] = {
        "cycle.png": lambda path: orientator_plots.cycle(path, result, n, mu)
    }
    if animate:
        files["cycle.gif"] = lambda path: motion.gif(path, seen())
    return Answer(
        scenario="orientator_cycle",
        question=question(__doc__),
        verdict=verdict(result),
        figures=figures(result),
        parameters=given,
        tables={"cycle.csv": Table.of(result)},
        provenance=result.provenance | {"flavour": fmus.flavour()},
        stem="cycle",
        files=files,
        show=lambda: Show([orientator_show.cycle(result)], [seen()]),
    )


def figures(result: Result) -> dict[str, Figure]:
    """End, durations as far as they were reached, and impulses; nothing is coupled."""
    last = {name: float(result[f"orientator.{name}"][-1]) for name in RECORD}
    ends = last["stage"] == orientator.ORIENTED
    found = {
        "oriented": (float(ends), "1", "1 if the product is oriented"),
        "orientation_time": (last["orientation_time"], "s", "from drop to end"),
        **{f"t_{x}": (last[f"t_{x}"], "s", f"duration of the stage {x}") for x in STAGES},
        "corner_impulse": (last["S_y"], "N.s", "landing on the corner of the catcher, down"),
        "wall_impulse": (last["S_k"], "N.s", "landing on the wall"),
        "hook_impulse": (last["P_B"], "N.s", "contact with the hook"),
    }
    return {
        name: Figure(value, unit, 0.0, meaning=meaning)
        for name, (value, unit, meaning) in found.items()
        if unit != "s" or value > 0.0
    }


def run(out: Path = Path("results/orientator_cycle"), **settings: Any) -> None:
    """Write the answer and print the verdict."""
    finish(answer(out=out, **settings), out)


def shortened(result: Result) -> Result:
    """The rows up to the first one after the end."""
    over = np.flatnonzero(result["orientator.stage"] >= orientator.ORIENTED)
    rows = over[0] + 1 if len(over) else len(result.data)
    data = result.data[:rows]
    return cosim.Result(result.columns, result.units, result.provenance, lambda: data)
