"""The map of machines that keep an operating range clear of resonance: its points, its ridges, its pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench import Chart, Curve, Mark, Panel
from workbench.charts import model as colors
from workbench.charts.model import GridAxis, HeatMap, Level, Look, Span
from workbench.study.words import stretches_of

from .orbit import Drive
from .parameter_plane import Plane

if TYPE_CHECKING:
    from pandas import DataFrame

Real = NDArray[np.float64]
#: Probability up to which nearly all machines stay clear; a convention.
SURE = 0.01
NEARLY_ALL = f"in at least {1 - SURE:.0%} of the machines"
RIDGE_STYLES: tuple[tuple[str, str, str, Look], ...] = (
    ("formula", "formula (22)", "grey", "theory"),
    ("lag_90", "90 deg lag", "sky", "points"),
    ("peak", "largest torque ripple", "red", "points"),
)


class Map(NamedTuple):
    """The machines, how they are run, the tables of their points and rows, the operating range [rad/s]."""

    plane: Plane
    drive: Drive
    points: DataFrame
    rows: DataFrame
    within: tuple[float, float] | None

    def field(self, column: str) -> Real:
        """A column of the points over the plane, shape (rows, columns)."""
        return self.points[column].to_numpy().reshape(len(self.rows), -1)

    def clear(self, column: str, most: float) -> str:
        """The values of y for which the operating range keeps a column of the rows below a value."""
        return stretches(self.plane.y.along, (self.rows[column] <= most).to_numpy())

    def ridges(self, along: str) -> list[Curve]:
        """The ridges of the rows that have them, their places on the axis "x" or "y" of a picture."""
        curves = []
        for column, name, color, look in RIDGE_STYLES:
            present = self.rows[np.isfinite(self.rows[column])]
            ends = present[column].to_numpy(), present[self.plane.y.name].to_numpy()
            if len(present):
                x, y = ends if along == "x" else ends[::-1]
                curves.append(Curve(name, x, y, color, look))
        return curves

    def sure(self) -> str:
        """The share of the map that nearly all machines stay clear of."""
        return f"{np.nanmean(self.points['probability'] <= SURE):.0%}"


def stretches(along: GridAxis, good: NDArray[np.bool_]) -> str:
    """The values of an axis that are good, as from .. to of those next to each other."""
    return " and ".join(
        " .. ".join(f"{x:.3g}" for x in dict.fromkeys(along.values[[*ends]].tolist()))
        + f" {along.unit}"
        for ends in stretches_of(good)
    )


def maps(r: Map, limit: float) -> list[HeatMap]:
    """The gain in colour with the ridges over it; the probability of too much ripple; on both the
    line of the limit [N.m], and the operating range where the map is over the speed.
    """
    x, y, ripple = r.plane.x.along, r.plane.y.along, r.field("ripple")
    over = r.ridges("x")
    reached = np.nanmin(ripple) < limit < np.nanmax(ripple)
    line = [Level(limit, f"torque ripple of {limit:g} N.m", ripple)] if reached else []
    bounds = [Span(*r.within, "operating range", "green")] if r.within else []
    formula = [curve for curve in over if curve.look == "theory"]
    return [
        HeatMap("Gain: torque ripple over load ripple", x, y,
              "torque ripple over load ripple", r.field("gain"), over, log=True, levels=line, spans=bounds),
        HeatMap(f"Machines within tolerance whose torque ripple is above {limit:g} N.m", x, y,
              "share of the machines", r.field("probability"), formula, levels=line, spans=bounds,
              scale="risk"),
    ]  # fmt: skip


def chart_of_rows(r: Map, limit: float) -> list[Chart]:
    """The ridges of every row; where there is an operating range, its ripple and probability."""
    x, y, curves, title = r.plane.x, r.plane.y.along, r.ridges("y"), "The ridges"
    panels = [Panel(x.name, x.along.unit, curves)] if curves else []
    if r.within:
        title = f"Anywhere in {r.within[0]:g} to {r.within[1]:g} rad/s"
        share, ripple = 100 * r.rows["probability_in_range"], r.rows["ripple_in_range"]
        above = Curve("machines above the limit", y.values, share.to_numpy(), "purple")
        worst = Curve("nominal machine", y.values, ripple.to_numpy(), colors.TORQUE)
        level = [Mark(limit, f"limit {limit:g} N.m")]
        panels = [
            Panel("machines above the limit", "%", [above], includes=(0.0, 100.0)),
            Panel("largest torque ripple", "N.m", [worst], level, includes=(0.0,)),
            *panels,
        ]
    return [Chart(title, " ".join(y.label.split()), panels, log=y.log)] if panels else []
