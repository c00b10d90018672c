"""Pictures of the gravity orientator: its time over the speed, one cycle, the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from . import orientator
from .page import mechanisms
from .plots import MARK, SPEED, THEORY, TORQUE, pyplot, save

if TYPE_CHECKING:
    from cosim import Result

    from .orientation_time import Gap, Point

COLORS = (SPEED, MARK, TORQUE, "#8e44ad", "#d68910")
COLOR = {"red": TORQUE, "blue": SPEED, "grey": "black"}
BANDS = ("#eef3f9", "#e3f1e7", "#fbeee6", "#f3ecf7")


def orientation_time(path: Path, points: Sequence[Point], gaps: Sequence[Gap]) -> None:
    """Time over rotor speed, a curve per friction, with a cross where products begin to jam."""
    figure, axes = pyplot().subplots(figsize=(8, 6), layout="constrained")
    ends = {gap.mu: gap for gap in gaps}
    for mu, color in zip(sorted({p.mu for p in points}), COLORS):
        mine = sorted((p for p in points if p.mu == mu), key=lambda p: p.n)
        limit = ends[mu].good if mu in ends else math.inf
        works = [p for p in mine if p.works and p.n <= limit]
        axes.plot(
            [p.n for p in works],
            [p.orientation_time for p in works],
            ".-",
            color=color,
            markersize=4,
            label=f"friction {mu:g}",
        )
        if mu in ends:
            last = works[-1]
            axes.plot([last.n], [last.orientation_time], "x", color=color, markersize=11, mew=2.5)
            axes.annotate(
                f"jams beyond {last.n:.1f} rpm",
                (last.n, last.orientation_time),
                xytext=(0, 10),
                textcoords="offset points",
                ha="center",
                color=color,
            )
    axes.set_xlabel("rotor speed  [rpm]")
    axes.set_ylabel("orientation time  [s]")
    axes.margins(x=0.1, y=0.1)
    axes.legend(loc="upper left")
    axes.set_title("Orientation of a cup in the gravity orientator")
    save(figure, path)


def cycle(path: Path, result: Result, n: float, mu: float) -> None:
    """Path of the cup beside its angles and speeds over time; the stages as bands."""
    t = 1e3 * result["time"]
    column = {name.partition(".")[2]: result[name] for name in result.columns[1:]}
    figure = pyplot().figure(figsize=(12, 7), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1, 1.6))
    scene = figure.add_subplot(grid[:, 0])
    stages = column["stage"].astype(int)
    starts = [0, *(np.flatnonzero(np.diff(stages)) + 1), len(t) - 1]
    at = {name: column[name][starts] for name in ("phi1", "phi2", "xc", "yc")}
    parameters = result.provenance["parts"]["orientator"]["parameters"]
    for shape in mechanisms.gravity_orientator(parameters, at):
        for outline, shade in zip(shape.points, np.linspace(0.35, 1.0, len(starts))):
            scene.plot(*outline.T, color=COLOR[shape.color], alpha=shade, linewidth=2.0)
    scene.plot(column["xc"], -column["yc"], color=TORQUE, linewidth=1.0)
    scene.set(aspect="equal")
    scene.set_axis_off()
    panels = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    for angle, color, label in (("phi1", SPEED, "catcher"), ("phi2", TORQUE, "product")):
        panels[0].plot(t, np.degrees(column[angle]), color=color, label=label)
    panels[0].set_ylabel("angle  [deg]")
    for speed, color, label in (("w1", SPEED, "catcher"), ("w2", TORQUE, "product")):
        panels[1].plot(t, column[speed], color=color, label=label)
    panels[1].set_ylabel("speed  [rad/s]")
    for velocity, color, label in (("vyc", MARK, "down"), ("vxc", THEORY, "outwards")):
        panels[2].plot(t, column[velocity], color=color, label=label)
    panels[2].set_ylabel("centre of mass  [m/s]")
    panels[2].set_xlabel("time  [ms]")
    names = orientator.item_names("stage")
    for axes in panels:
        for first, last, band in zip(starts, starts[1:], BANDS):
            axes.axvspan(t[first], t[last], color=band, zorder=0)
        axes.legend(loc="upper left")
    for first, last in pairwise(starts):
        panels[0].annotate(
            names[int(stages[first])],
            ((t[first] + t[last]) / 2, 1.03),
            xycoords=("data", "axes fraction"),
            ha="center",
        )
    figure.suptitle(f"One product at {n:g} rpm, friction {mu:g}")
    save(figure, path)
