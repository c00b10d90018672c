"""What the page shows of a resonance map: its rows, and one revolution where the torque is worst."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .. import conveyor_show
from ..page.charts import Chart, Curve, Mark, Panel
from ..page.fields import Direction, Field
from ..page.motion import Motion
from .plane import Axis
from .steady import Case, Setup, run
from .survey import Row, Survey

Real = NDArray[np.float64]
RECORD = (
    "motor.tau",
    "conveyor.phi",
    "conveyor.w",
    "conveyor.x",
    "conveyor.tau_load",
    "conveyor.f_rod",
)
LOOKS = {
    "formula": ("formula (22)", "grey", "theory"),
    "lag_90": ("90 deg lag", "blue", "points"),
    "peak": ("largest torque ripple", "red", "points"),
}


def gain(survey: Survey, rows: Sequence[Row]) -> Field:
    """The gain in colour, the ridges over it."""
    over = [
        Curve(name, places, levels, color, look)
        for place, (name, color, look) in LOOKS.items()
        for levels, places in [_ridge(rows, place)]
        if places
    ]
    x, y = (_direction(axis) for axis in survey.plane[:2])
    quantity = "torque ripple over load ripple"
    return Field(
        "How much the drive magnifies the load's ripple", x, y, quantity, survey.gain, over, True
    )


def risk(survey: Survey, probability: Real, limit: float) -> Field:
    """The probability of too much ripple in colour."""
    x, y = (_direction(axis) for axis in survey.plane[:2])
    title = f"Machines within tolerance whose torque ripple is above {limit:g} N m"
    return Field(title, x, y, "share of the machines", probability)


def _direction(axis: Axis) -> Direction:
    return Direction(axis.name, axis.unit, axis.values, axis.log)


def _ridge(rows: Sequence[Row], place: str) -> tuple[list[float], list[float]]:
    """Where the rows have a ridge: their y, and its x."""
    there = [(row.y, at) for row in rows if (at := getattr(row, place)) is not None]
    return [y for y, _ in there], [x for _, x in there]


def rows_chart(
    survey: Survey, rows: Sequence[Row], ripple: Real, probability: Real, limit: float
) -> Chart:
    """The ridges of every row; where there is an operating range, its ripple and probability."""
    x, y = survey.plane.x, survey.plane.y
    places = []
    for place, (name, color, look) in LOOKS.items():
        levels, across = _ridge(rows, place)
        if levels:
            places.append(Curve(name, levels, across, color, look))
    panels = [Panel(x.name, x.unit, places)] if places else []
    if survey.plane.over_speed:
        mark = [Mark(limit, "limit")]
        worst = Curve("nominal machine", y.values, ripple, "red")
        share = Curve("machines above the limit", y.values, probability, "purple")
        panels.append(Panel("torque ripple", "N.m", [worst], mark))
        panels.append(Panel("probability", "1", [share]))
    return Chart(
        "Ridges; largest torque ripple and its probability in the operating range",
        " ".join(y.label.split()),
        panels,
    )


def worst(survey: Survey, setup: Setup) -> tuple[Chart, Motion]:
    """One revolution at the point of the largest torque ripple: its course, its motion."""
    n, k = np.unravel_index(np.nanargmax(survey.ripple), survey.ripple.shape)
    x, y = survey.plane.x, survey.plane.y
    case = Case(*survey.plane.at(float(x.values[k]), float(y.values[n])), setup)
    return conveyor_show.revolution(case.nu, run(case, RECORD))
