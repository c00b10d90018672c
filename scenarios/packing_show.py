"""What the page shows of the packing line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import iron_show, orientator, orientator_show, packing
from .options import Start
from .page import mechanisms
from .page.charts import Chart, Curve, Mark, Panel
from .page.motion import Motion, columns, moved, rows

if TYPE_CHECKING:
    from cosim import Result

    from .packing import Pace


def line(result: Result, pace: Pace) -> Chart:
    """Iron, orientator and powers over the whole cycles; marks at the releases."""
    seen = packing.window(result)
    t, power = result["time"][seen], packing.powers(result)
    return Chart(
        "The line in its whole cycles",
        "time [s]",
        [
            Panel("lift", "mm", [Curve("lift of the iron", t, 1e3 * result["iron.lift"][seen], "green")]),
            Panel("product", "deg", [
                Curve("angle of the product", t, np.degrees(result["orientator.phi2"][seen]), "red")
            ]),
            Panel("power", "W", [Curve("motor of the iron", t, power["iron"][seen], "gold")]),
            Panel("power", "W", [
                Curve("motor of the conveyor", t, power["conveyor"][seen], "blue"),
                Curve("supply", t, power["supply"][seen], "grey"),
            ]),
        ],
        [Mark(float(result["time"][row]), "release") for row in pace.releases],
    )  # fmt: skip


def motion(result: Result, pace: Pace, start: Start) -> Motion:
    """Iron and orientator side by side over the last whole cycle."""
    t = result["time"]
    first, last = (float(t[row]) for row in pace.releases[-2:])
    picked = rows(t, first, last, 360)
    told = {name: part["parameters"] for name, part in result.provenance["parts"].items()}
    at = columns(result, "iron", iron_show.SEEN, picked)
    iron = mechanisms.iron_drive(told["iron"], at, iron_show.pitch_curve(start))
    cup = columns(result, "orientator", orientator_show.SEEN, picked)
    turned = mechanisms.gravity_orientator(told["orientator"], cup)
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
