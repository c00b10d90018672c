"""The timing diagram of the packing line."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from . import orientator
from .plots import MARK, SPEED, THEORY, TORQUE, pyplot, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cosim import Result

    from .packing import Pace

COLORS = ("#7fb3d5", "#82c99d", "#f0b27a", "#bb9fd0", "#dfe6e9", "#e08283", "#f4f4f4")


def timing(path: Path, result: Result, pace: Pace, gear: float) -> None:
    """The last whole cycle from release to release: cam, orientator, power of the supply."""
    first, last = pace.releases[-2:]
    origin = result["time"][first]
    period = result["time"][last] - origin
    t = result["time"] - origin
    seen = (t >= -0.05 * period) & (t <= 1.05 * period)
    figure, (cam, stages, supply, motor) = pyplot().subplots(
        4, 1, figsize=(11, 9), sharex=True, layout="constrained", height_ratios=(2, 1.7, 2.4, 2)
    )
    cam.plot(t[seen], 1e3 * result["iron.lift"][seen], color=SPEED)
    cam.fill_between(
        t[seen],
        0,
        1,
        where=result["iron.top_dwell"][seen] > 0.5,
        transform=cam.get_xaxis_transform(),
        color="#dbe9f6",
        step="post",
    )
    cam.annotate(
        "top dwell",
        (0.01 * period, 0.5),
        xycoords=("data", "axes fraction"),
        va="center",
        color=SPEED,
    )
    cam.set_ylabel("lift of the iron  [mm]")
    _stages(stages, result, first, last)
    P = {part: result[f"{part}_motor.P"][seen] for part in ("iron", "conveyor")}
    supply.plot(t[seen], P["conveyor"], color=MARK, linewidth=0.9, label="motor of the conveyor")
    total = P["iron"] + P["conveyor"]
    supply.plot(t[seen], total, color="black", linewidth=1.1, label="supply, sum of both")
    supply.set_ylabel("mechanical power  [W]")
    low, high = supply.get_ylim()
    supply.set_ylim(low, high + 0.25 * (high - low))
    supply.legend(loc="upper center", ncols=2)
    motor.plot(t[seen], P["iron"], color=TORQUE, label="motor of the iron")
    motor.axhline(0, color=THEORY, linewidth=0.8)
    motor.set_ylabel("mechanical power  [W]")
    motor.legend(loc="upper center")
    motor.set_xlabel("time since the release  [s]")
    for axes in (cam, stages, supply, motor):
        axes.axvline(0.0, color=THEORY, linestyle="--", linewidth=1.0)
        axes.axvline(period, color=THEORY, linestyle="--", linewidth=1.0)
    motor.set_xlim(-0.05 * period, 1.05 * period)
    figure.suptitle(
        f"One cycle of the packing line: {60 / period:.2f} releases/min, "
        f"rotor {gear:g} times as fast as the cam"
    )
    save(figure, path)


def _stages(axes: Axes, result: Result, first: int, last: int) -> None:
    """Bands of the orientator's stages, and below them its time against the next release."""
    names, reasons = orientator.item_names("stage"), orientator.item_names("reason")
    t = result["time"] - result["time"][first]
    stage = result["orientator.stage"].astype(int)
    begins = [first + 1, *(np.flatnonzero(np.diff(stage[first + 1 : last])) + first + 2), last]
    for row, after in pairwise(begins):
        x, now = float(t[row]) if row > first + 1 else 0.0, stage[row]
        width = float(t[after]) - x
        axes.barh(1.0, width, left=x, height=0.7, color=COLORS[now], edgecolor="white")
        short = width < 0.06 * t[last]
        axes.annotate(
            names[now],
            (x + width / 2, 1.0),
            ha="center",
            va="center",
            rotation=90 if short else 0,
            fontsize=8 if short else 10,
        )
    period = float(t[last])
    over = stage[last - 1] == orientator.ORIENTED
    end = float(t[begins[-2]]) if over or len(begins) > 2 else 0.0
    why = reasons[int(result["orientator.reason"][last - 1])]
    spans = [
        (0.0, end, f"orientation {end:.3f} s" if over else f"until it jams {end:.3f} s"),
        (end, period, f"to spare {period - end:.3f} s" if over else f"lost: {why}"),
    ]
    for left, right, text in spans:
        if right > left:
            axes.annotate("", (left, 0.35), (right, 0.35), arrowprops={"arrowstyle": "<->"})
            axes.annotate(text, ((left + right) / 2, 0.28), ha="center", va="top")
    axes.annotate(" release", (0.0, 1.5), ha="left", va="center", color=THEORY)
    axes.annotate("next release ", (period, 1.5), ha="right", va="center", color=THEORY)
    axes.set(ylim=(-0.05, 1.65), yticks=[])
    axes.set_ylabel("orientator")
    axes.grid(visible=False)
