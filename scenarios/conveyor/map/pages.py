"""What is shown of a resonance map: its rows, and one revolution where the torque is worst."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.report.chart import (
    TORQUE,
    Chart,
    Curve,
    Direction,
    Field,
    Level,
    Mark,
    Panel,
    Span,
)
from workbench.report.motion import Motion

from .. import show as conveyor_show
from ..response import orbit
from .plane import Axis, Setup
from .survey import Row, Survey

Real = NDArray[np.float64]
Within = tuple[float, float] | None
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
    "lag_90": ("90 deg lag", "sky", "points"),
    "peak": ("largest torque ripple", "red", "points"),
}


def maps(
    survey: Survey, rows: Sequence[Row], probability: Real, limit: float, within: Within
) -> list[Field]:
    """The gain in colour with the ridges over it; the probability of too much ripple; on both the
    line of the limit [N.m], and the operating range where the map is over the speed."""
    x, y = (_direction(axis) for axis in survey.plane[:2])
    ridges = [
        Curve(name, places, levels, color, look)
        for place, (name, color, look) in LOOKS.items()
        for levels, places in [_ridge(rows, place)]
        if places
    ]
    reached = np.nanmin(survey.ripple) < limit < np.nanmax(survey.ripple)
    line = [Level(limit, f"torque ripple of {limit:g} N.m", survey.ripple)] if reached else []
    bounds = [Span(*within, "operating range", "green")] if within else []
    formula = [curve for curve in ridges if curve.name == LOOKS["formula"][0]]
    return [
        Field("How much the drive magnifies the load's ripple", x, y,
              "torque ripple over load ripple", survey.gain, ridges, True, line, bounds),
        Field(f"Machines within tolerance whose torque ripple is above {limit:g} N.m", x, y,
              "share of the machines", probability, formula, levels=line, spans=bounds, scale="risk"),
    ]  # fmt: skip


def _direction(axis: Axis) -> Direction:
    return Direction(axis.label.rpartition(" [")[0], axis.unit, axis.values, axis.log)


def _ridge(rows: Sequence[Row], place: str) -> tuple[list[float], list[float]]:
    """Where the rows have a ridge: their y, and its x."""
    there = [(row.y, at) for row in rows if (at := getattr(row, place)) is not None]
    return [y for y, _ in there], [x for _, x in there]


def rows_chart(
    survey: Survey,
    rows: Sequence[Row],
    ripple: Real,
    probability: Real,
    limit: float,
    within: Within,
) -> Chart:
    """The ridges of every row; where there is an operating range, its ripple and probability."""
    x, y = survey.plane.x, survey.plane.y
    places = []
    for place, (name, color, look) in LOOKS.items():
        levels, across = _ridge(rows, place)
        if levels:
            places.append(Curve(name, levels, across, color, look))
    panels = [Panel(x.name, x.unit, places)] if places else []
    title = "The ridges"
    if within is not None:
        worst = Curve("nominal machine", y.values, ripple, TORQUE)
        share = Curve("machines above the limit", y.values, 100 * probability, "purple")
        panels = [
            Panel("machines above the limit", "%", [share], includes=(0.0, 100.0)),
            Panel("largest torque ripple", "N.m", [worst], [Mark(limit, f"limit {limit:g} N.m")],
                  includes=(0.0,)),
            *panels,
        ]  # fmt: skip
        title = f"Anywhere in {within[0]:g} to {within[1]:g} rad/s"
    return Chart(title, " ".join(y.label.split()), panels, log=y.log)


def worst(survey: Survey, setup: Setup) -> tuple[Chart, Motion]:
    """One revolution at the point of the largest torque ripple: its course, its motion."""
    n, k = np.unravel_index(np.nanargmax(survey.ripple), survey.ripple.shape)
    x, y = survey.plane.x, survey.plane.y
    case = setup.case(*survey.plane.at(float(x.values[k]), float(y.values[n])))
    return conveyor_show.revolution(case.nu, orbit(case, RECORD).result)
