"""What the page shows of the gravity orientator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from . import orientator
from .page import mechanisms
from .page.charts import Chart, Curve, Mark, Panel
from .page.motion import Motion, Samples, Shape, columns, moved, rows

if TYPE_CHECKING:
    from cosim import Result

    from .orientation_time import Gap, Point

SEEN = ("phi1", "phi2", "xc", "yc", "stage")
COLORS = ("blue", "green", "red", "purple", "gold", "grey")


def orientation_time(points: Sequence[Point], gaps: Sequence[Gap]) -> Chart:
    """Time over rotor speed, a curve for each friction up to where products jam."""
    limits = {gap.mu: gap.good for gap in gaps}
    curves = []
    for k, mu in enumerate(sorted({p.mu for p in points})):
        works = sorted(
            (p.n, 1e3 * p.orientation_time)
            for p in points
            if p.mu == mu and p.works and p.n <= limits.get(mu, math.inf)
        )
        if works:
            n, time = np.array(works).T
            curves.append(Curve(f"friction {mu:g}", n, time, COLORS[k % len(COLORS)]))
    return Chart(
        "Orientation of a cup",
        "rotor speed [rpm]",
        [Panel("orientation time", "ms", curves)],
        [Mark(gap.good, f"friction {gap.mu:g} jams beyond {gap.good:.1f}") for gap in gaps],
    )


def cycle(result: Result) -> Chart:
    """Angles, speeds and velocities over time; marks where a stage begins."""
    t = 1e3 * result["time"]
    names = orientator.item_names("stage")
    stages = result["orientator.stage"].astype(int)

    def panel(quantity: str, unit: str, *curves: tuple[str, Samples, str]) -> Panel:
        return Panel(quantity, unit, [Curve(name, t, y, color) for name, y, color in curves])

    column = {name.partition(".")[2]: result[name] for name in result.columns[1:]}
    return Chart(
        "One product",
        "time [ms]",
        [
            panel(
                "angle",
                "deg",
                ("angle of the catcher", np.degrees(column["phi1"]), "blue"),
                ("angle of the product", np.degrees(column["phi2"]), "red"),
            ),
            panel(
                "speed",
                "rad/s",
                ("speed of the catcher", column["w1"], "blue"),
                ("speed of the product", column["w2"], "red"),
            ),
            panel(
                "centre of mass",
                "m/s",
                ("down", column["vyc"], "green"),
                ("outwards", column["vxc"], "grey"),
            ),
            panel("wall reaction", "N", ("reaction of the wall", column["N_K"], "purple")),
        ],
        [Mark(float(t[i + 1]), names[stages[i + 1]]) for i in np.flatnonzero(np.diff(stages))],
    )


def motion(title: str, runs: Mapping[str, Result], last: float) -> Motion:
    """Catcher and cup of several runs of the same step side by side, up to a time [s]."""
    names = orientator.item_names("stage")
    picked = rows(next(iter(runs.values()))["time"], 0.0, last)
    shapes: list[Shape] = []
    told = [""] * len(picked)
    for k, (name, result) in enumerate(runs.items()):
        at = columns(result, "orientator", SEEN, picked)
        parameters = result.provenance["parts"]["orientator"]["parameters"]
        shapes += moved(mechanisms.gravity_orientator(parameters, at), 0.3 * k, 0.0)
        told = [
            f"{text}; {name} {names[int(stage)]}".strip("; ")
            for text, stage in zip(told, at["stage"])
        ]
        t = result["time"][picked]
    captions = [f"{now:.3f} s: {text}" for now, text in zip(t, told)]
    return Motion(title, t, 20.0, captions, shapes)
