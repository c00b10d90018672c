"""The orientator as lines in motion, from the outputs and parameters of its FMU; its y counts down."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import Result
from workbench.charts import motion as draw
from workbench.charts.model import Span
from workbench.charts.motion import Motion, Shape, line
from workbench.live import Caption, Coordinate, LiveMotion

from .machine import STAGES

COLUMNS = ("phi1", "phi2", "xc", "yc", "stage")


def motion(
    title: str, runs: Mapping[str, Result], last: float, ghosts: Sequence[Span] = ()
) -> Motion:
    """Catcher and cup of several runs of the same step side by side, up to a time [s]."""
    t = next(iter(runs.values()))["time"]
    picked = draw.rows(t, 0.0, last)
    shapes, stage_texts = [], []
    for k, (name, result) in enumerate(runs.items()):
        more, stages = draw_rows(result, picked)
        shapes += draw.shifted(more, 0.3 * k, 0.0)
        stage_texts.append([f"{name} {stage}".strip() for stage in stages])
    captions = [
        f"{now:.3f} s: {'; '.join(row_texts)}" for now, *row_texts in zip(t[picked], *stage_texts)
    ]
    still = {int(np.searchsorted(t[picked], span.first)): span.text for span in ghosts}
    if ghosts:
        still[len(picked) - 1] = stages[-1]
    return Motion(title, t[picked], 20.0, captions, shapes, ghosts=still)


def draw_rows(result: Result, picked: NDArray[np.int64]) -> tuple[list[Shape], list[str]]:
    """Wall, catcher and cup at some rows, and the stage of each; places are x - i y."""
    at = draw.columns(result, "orientator", COLUMNS, picked)
    p = result.provenance["parts"]["orientator"]["parameters"]
    return orientator(p, at), [STAGES[int(x)] for x in at["stage"]]


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
    """One product of a live page."""
    captions = [Caption("stage", "orientator.stage", texts=STAGES)]
    return LiveMotion(title, live_shapes(result), coordinates(result), captions, slow)


def live_shapes(result: Result) -> Callable[[draw.Columns], list[Shape]]:
    """The lines by columns with the names of the system."""
    p = result.provenance["parts"]["orientator"]["parameters"]
    names = ("phi1", "phi2", "xc", "yc")
    return lambda at: orientator(p, {name: at[f"orientator.{name}"] for name in names})


def coordinates(result: Result) -> list[Coordinate]:
    """What moves the lines, in the range that a run has."""
    turns = {"phi1": (1.0,), "phi2": (1.0,), "xc": (), "yc": ()}
    columns = {name: result[f"orientator.{name}"] for name in turns}
    return [
        Coordinate(f"orientator.{name}", float(x.min()), float(x.max()), turns[name])
        for name, x in columns.items()
    ]
