"""What is shown of the packing line."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from workbench.report.chart import LIFT, POWER, Chart, Curve, Lanes, Mark, Panel, Span, recorded
from workbench.report.motion import Motion, columns, moved, rows

from ..iron import mechanism as iron_mechanism
from ..iron import show as iron_show
from ..iron.drive import Alone
from ..orientator import machine as orientator
from ..orientator import mechanism as orientator_mechanism
from ..orientator import show as orientator_show
from . import line as packing

if TYPE_CHECKING:
    from cosim import Result

    from .line import Pace

AROUND = 0.05


def line(result: Result, pace: Pace) -> Chart:
    """The last whole cycle from release to release: cam, orientator, powers."""
    first, last = pace.releases[-2:]
    t = result["time"] - result["time"][first]
    period = float(t[last])
    seen = (t >= -AROUND * period) & (t <= (1 + AROUND) * period)
    power = {name: values[seen] for name, values in packing.powers(result).items()}
    told = ", ".join(bar.text for bar in lanes(result, first, last)["pace"])
    dwell = np.flatnonzero(result["iron.top_dwell"][first : last + 1] < 0.5)[0]

    def panel(name: str, color: str) -> Panel:
        return Panel(f"power, {name}", "W", [Curve(name, t[seen], power[name], color)])

    return Chart(
        f"One cycle of {period:.3f} s, {60 / period:.2f} releases/min: {told}",
        "time since the release [s]",
        [
            recorded(
                "lift of the iron", result, t[seen], {"iron.lift": ("iron", LIFT)}, "mm", seen
            ),
            Lanes(lanes(result, first, last)),
            panel("iron", "gold"),
            panel("conveyor", "sky"),
            panel("supply", POWER),
        ],
        [Mark(0.0, "release"), Mark(period, "next release")],
        [Span(0.0, float(t[first + dwell]), "top dwell", "green")],
    )


def lanes(result: Result, first: int, last: int) -> dict[str, list[Span]]:
    """The stages of the product from a release to the next, and how long it all took."""
    names, colors = orientator.item_names("stage"), orientator_show.STAGES
    t = result["time"] - result["time"][first]
    stage = result["orientator.stage"].astype(int)
    begins = [first + 1, *(np.flatnonzero(np.diff(stage[first + 1 : last])) + first + 2), last]
    bars = [
        Span(float(t[a]) if a > first + 1 else 0.0, float(t[b]), names[stage[a]], colors[stage[a]])
        for a, b in pairwise(begins)
    ]
    over, end = stage[last - 1] == orientator.ORIENTED, bars[-1].first
    why = orientator.item_names("reason")[int(result["orientator.reason"][last - 1])]
    until = "oriented" if over else "jammed"
    rest = f"{t[last] - end:.3f} s to spare" if over else f"lost: {why}"
    return {
        "orientator": bars,
        "pace": [
            Span(0.0, end, f"{until} after {end:.3f} s", "blue"),
            Span(end, float(t[last]), rest, "green" if over else "red"),
        ],
    }


def motion(result: Result, pace: Pace, start: Alone) -> Motion:
    """Iron and orientator side by side over the last whole cycle."""
    t = result["time"]
    first, last = (float(t[row]) for row in pace.releases[-2:])
    picked = rows(t, first, last, 360)
    told = {name: part["parameters"] for name, part in result.provenance["parts"].items()}
    at = columns(result, "iron", iron_show.SEEN, picked)
    iron = iron_mechanism.iron_drive(told["iron"], at, iron_show.cam(start))
    cup = columns(result, "orientator", orientator_show.SEEN, picked)
    turned = orientator_mechanism.gravity_orientator(told["orientator"], cup)
    names = orientator.item_names("stage")
    captions = [
        f"{caption}; orientator {names[int(stage)]}"
        for caption, stage in zip(iron_show.captions(t[picked] - first, at), cup["stage"])
    ]
    return Motion(
        "One cycle: the iron drive and the orientator it releases",
        t[picked],
        4.0,
        captions,
        [*iron, *moved(turned, 0.5, 0.2)],
        "The conveyor, which shakes too fast to be seen here, is left out.",
    )
