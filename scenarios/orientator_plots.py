"""Pictures of the gravity orientator: its time over the speed, one cycle, the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes

from . import orientator
from .plots import MARK, SPEED, THEORY, TORQUE, save

if TYPE_CHECKING:
    from cosim import Result

    from .orientation_time import Gap, Point

COLORS = (SPEED, MARK, TORQUE, "#8e44ad", "#d68910")
BANDS = ("#eef3f9", "#e3f1e7", "#fbeee6", "#f3ecf7")


def orientation_time(path: Path, points: Sequence[Point], gaps: Sequence[Gap]) -> None:
    """Time over rotor speed, a curve per friction, with a cross where products begin to jam."""
    figure, axes = plt.subplots(figsize=(8, 6), layout="constrained")
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
    figure = plt.figure(figsize=(12, 7), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1, 1.6))
    scene = figure.add_subplot(grid[:, 0])
    stages = column["stage"].astype(int)
    starts = [0, *(np.flatnonzero(np.diff(stages)) + 1), len(t) - 1]
    for i, shade in zip(starts, np.linspace(0.35, 1.0, len(starts))):
        draw_scene(scene, result, int(i), float(shade))
    scene.plot(column["xc"], column["yc"], color=TORQUE, linewidth=1.0)
    frame(scene, result)
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


def draw_scene(axes: Axes, result: Result, i: int, shade: float = 1.0) -> list[Any]:
    """Catcher and cup at row i."""
    p = result.provenance["parts"]["orientator"]["parameters"]
    phi1, phi2, xc, yc = (
        float(result[f"orientator.{name}"][i]) for name in ("phi1", "phi2", "xc", "yc")
    )
    r, back, front = p["cup.d"] / 2, p["cup.l"], p["cup.h"] - p["cup.l"]
    axis = np.array([math.cos(phi2), math.sin(phi2)])
    normal = np.array([-math.sin(phi2), math.cos(phi2)])
    centre = np.array([xc, yc])
    bend = np.linspace(-math.pi / 2, math.pi / 2, 25)
    bottom = (
        centre + front * axis + r * (np.cos(bend)[:, None] * axis + np.sin(bend)[:, None] * normal)
    )
    rim = centre - back * axis
    outline = np.vstack([rim - r * normal, bottom, rim + r * normal])
    corner = p["catcher.l"] * np.array([math.cos(phi1), math.sin(phi1)])
    tip = corner + p["catcher.h"] * np.array([math.sin(phi1), -math.cos(phi1)])
    return [
        *axes.plot(*outline.T, color=TORQUE, alpha=shade, linewidth=1.8),
        *axes.plot(*np.vstack([[0, 0], corner, tip]).T, color=SPEED, alpha=shade, linewidth=2.4),
    ]


def frame(axes: Axes, result: Result) -> None:
    """Wall, pivot, and what the eye needs; y points down."""
    p = result.provenance["parts"]["orientator"]["parameters"]
    wall = p["catcher.l"] * math.cos(p["catcher.phi"]) + p["cup.d"]
    axes.axvline(wall, color="black", linewidth=3)
    axes.plot([0], [0], "o", color=SPEED)
    axes.set(aspect="equal", xlim=(-0.02, wall + 0.01), ylim=(0.3, -0.07))
    axes.set_axis_off()


def animation(path: Path, result: Result) -> None:
    """The motion as a GIF, ten times slower than real."""
    figure, axes = plt.subplots(figsize=(5, 7), layout="constrained")
    frame(axes, result)
    text = axes.text(0.02, 0.98, "", transform=axes.transAxes, va="top")
    names = orientator.item_names("stage")
    rows = np.unique(np.linspace(0, len(result.data) - 1, 110).astype(int))
    lines: list[Any] = []

    def draw(frame_number: int) -> list[Any]:
        while lines:
            lines.pop().remove()
        i = int(rows[frame_number])
        lines.extend(draw_scene(axes, result, i))
        stage = names[int(result["orientator.stage"][i])]
        text.set_text(f"{1e3 * result['time'][i]:.0f} ms, {stage}")
        return lines

    interval = 10 * float(result["time"][-1]) / len(rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = PillowWriter(fps=max(1, round(1 / interval)))
    FuncAnimation(figure, draw, frames=len(rows)).save(path, writer=writer)
    plt.close(figure)
