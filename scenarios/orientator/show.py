"""What is shown of the gravity orientator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from workbench.report.chart import (
    FORCE,
    SERIES,
    SPEED,
    THEORY,
    TORQUE,
    Chart,
    Curve,
    Mark,
    Panel,
    Span,
    recorded,
)
from workbench.report.motion import Motion, Shape, columns, moved, rows

from . import machine as orientator
from . import mechanism

if TYPE_CHECKING:
    from cosim import Result

    from .orientation_time import Gap, Point

SEEN = ("phi1", "phi2", "xc", "yc", "stage")
STAGES = {0: "grey", 1: "sky", 2: "green", 3: "gold", 4: "grey", 5: "red"}


def orientation_time(points: Sequence[Point], gaps: Sequence[Gap]) -> Chart:
    """Time over rotor speed, a curve for each friction up to where products jam."""
    limits = {gap.mu: gap.good for gap in gaps}
    curves = []
    for k, mu in enumerate(sorted({p.mu for p in points})):
        works = sorted(
            (p.n, p.orientation_time)
            for p in points
            if p.mu == mu and p.works and p.n <= limits.get(mu, math.inf)
        )
        if works:
            n, time = np.array(works).T
            curves.append(Curve(f"friction {mu:g}", n, time, SERIES[k % len(SERIES)], "linked"))
    marks = [Mark(gap.good, f"friction {gap.mu:g} jams beyond {gap.good:.2f} rpm") for gap in gaps]
    return Chart(
        "The time of orientation, up to where products jam",
        "rotor speed [rpm]",
        [Panel("orientation time", "s", curves, includes=(0.0,))],
        marks,
    )


def stages(result: Result) -> list[Span]:
    """The stages of a product, from when to when [s]."""
    t, stage = result["time"], result["orientator.stage"].astype(int)
    begins = [0, *(np.flatnonzero(np.diff(stage)) + 1).tolist(), len(t) - 1]
    names = orientator.item_names("stage")
    return [
        Span(float(t[first]), float(t[last]), names[stage[first]], STAGES[stage[first]])
        for first, last in pairwise(begins)
        if last > first
    ]


def cycle(result: Result) -> Chart:
    """Angles, speeds and velocities over time; the stages as spans."""
    t = 1e3 * result["time"]

    def panel(quantity: str, unit: str = "", /, **names: tuple[str, str]) -> Panel:
        return recorded(quantity, result, t, {f"orientator.{x}": y for x, y in names.items()}, unit)

    wall = panel("reaction of the wall", N_K=("wall", FORCE))
    return Chart(
        "Angles, speeds and the wall",
        "time [ms]",
        [
            panel("angle", "deg", phi1=("catcher", SPEED), phi2=("cup", TORQUE)),
            panel("speed", w1=("catcher", SPEED), w2=("cup", TORQUE)),
            panel("centre of mass", vyc=("down", SPEED), vxc=("outwards", THEORY)),
            wall._replace(
                levels=[Mark(0.0, "below 0 a real cup leaves the wall")], includes=(0.0,)
            ),
        ],
        spans=[x._replace(first=1e3 * x.first, last=1e3 * x.last) for x in stages(result)],
    )


def motion(
    title: str, runs: Mapping[str, Result], last: float, ghosts: Sequence[Span] = ()
) -> Motion:
    """Catcher and cup of several runs of the same step side by side, up to a time [s]."""
    names = orientator.item_names("stage")
    picked = rows(next(iter(runs.values()))["time"], 0.0, last)
    shapes: list[Shape] = []
    told = [""] * len(picked)
    for k, (name, result) in enumerate(runs.items()):
        at = columns(result, "orientator", SEEN, picked)
        parameters = result.provenance["parts"]["orientator"]["parameters"]
        shapes += moved(mechanism.gravity_orientator(parameters, at), 0.3 * k, 0.0)
        told = [
            f"{text}; {name} {names[int(stage)]}".strip("; ")
            for text, stage in zip(told, at["stage"])
        ]
        t = result["time"][picked]
    captions = [f"{now:.3f} s: {text}" for now, text in zip(t, told)]
    still = {int(np.searchsorted(t, span.first)): span.text for span in ghosts}
    if ghosts:
        still[len(t) - 1] = told[-1]
    return Motion(title, t, 20.0, captions, shapes, ghosts=still)
