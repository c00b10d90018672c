"""The orientator as lines in motion, from the outputs and parameters of its FMU; its y counts down."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cosim import Result
from workbench.charts import motion as draw
from workbench.charts.model import Span
from workbench.charts.motion import Motion, Shape, line
from workbench.live import Caption, Coordinate, LiveMotion, moved

from .machine import STAGES, until_oriented_or_jammed

#: Angles and their multiples by which points turn, and places.
COORDINATES: Mapping[str, tuple[float, ...]] = {"phi1": (1.0,), "phi2": (1.0,), "xc": (), "yc": ()}
COLUMNS = (*COORDINATES, "stage")


def motion(title: str, runs: Mapping[str, Result], ghosts: Sequence[Span] = ()) -> Motion:
    """Catcher and cup of several runs of the same step side by side, until the last product ends."""
    results = [*runs.values()]
    last = max(float(until_oriented_or_jammed(result)["time"][-1]) for result in results)
    moving = moved(live_motion(title, results[0], 20.0), *results, names=[*runs], last=last)
    if not ghosts:
        return moving
    texts = {int(np.searchsorted(moving.times, span.first)): span.text for span in ghosts}
    end = np.searchsorted(results[0]["time"], moving.times[-1])
    texts[len(moving.times) - 1] = STAGES[int(results[0]["orientator.stage"][end])]
    return moving._replace(ghosts=texts)


def orientator(p: Mapping[str, Any], at: draw.Columns) -> list[Shape]:
    """Wall, catcher and cup, from columns with the names of the FMU."""
    r, back, front = p["cup.d"] / 2, p["cup.l"], p["cup.h"] - p["cup.l"]
    centre, turned = at["xc"] - 1j * at["yc"], np.exp(-1j * at["phi2"])
    bottom = front + r * np.exp(1j * np.linspace(-math.pi / 2, math.pi / 2, 25))
    outline = np.array([-back - 1j * r, *bottom, -back + 1j * r]).conj()
    arm = np.exp(-1j * at["phi1"])
    corner, hook = p["catcher.l"] * arm, (p["catcher.l"] + 1j * p["catcher.h"]) * arm
    wall = p["catcher.l"] * math.cos(p["catcher.phi"]) + p["cup.d"]
    falls = draw.arrow(line((wall - 3.2 * r, 0.07), (wall - 3.2 * r, 0.02)), 0.012)
    return [
        Shape("wall", draw.ground(wall, -0.3, wall, 0.07, 0.015), "grey", 1.5, label=0),
        Shape("pivot", draw.pivot(0.0, 0.0, 0.008), "grey", 1.5, label=1),
        Shape("falls", falls, "grey", 1.5, label=0),
        Shape("cup", line(*(centre + np.outer(outline, turned))), "red", 3.0, label=0),
        Shape("catcher", line(0.0, corner, hook), "blue", 4.0, label=1),
    ]


def live_motion(title: str, result: Result, slow: float) -> LiveMotion:
    """One product, and more of them beside it."""
    p = result.provenance["parts"]["orientator"]["parameters"]

    def shapes(at: draw.Columns) -> list[Shape]:
        return orientator(p, {name: at[f"orientator.{name}"] for name in COORDINATES})

    captions = [Caption("", "orientator.stage", texts=STAGES)]
    return LiveMotion(title, shapes, coordinates(result), captions, slow, offset=(0.3, 0.0))


def coordinates(result: Result) -> list[Coordinate]:
    """What moves the lines, in the range that a run has."""
    columns = {name: result[f"orientator.{name}"] for name in COORDINATES}
    return [
        Coordinate(f"orientator.{name}", float(x.min()), float(x.max()), COORDINATES[name])
        for name, x in columns.items()
    ]
