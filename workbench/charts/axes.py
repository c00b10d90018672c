"""Axes of pictures: their ends, and their ticks where a renderer may not choose them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from .model import GridAxis, HeatMap, Lanes, Panel, Picture, Samples
from .style import STYLE

#: Widest ratio of the ends of a logarithmic axis whose ticks need steps between 1, 2 and 5; chosen: with
#: fewer than four ticks nobody reads a value.
NARROW_RATIO = 20.0


@dataclass(frozen=True)
class Axis:
    """An axis of a picture.

    Attributes
    ----------
    label : str
        The quantity and its unit; empty for lanes.
    ends : tuple of float
        The values at both ends; the first is larger where the axis points down.
    is_log : bool
        Whether it is logarithmic.
    ticks : mapping of float to str
        The texts of its ticks; empty where a renderer chooses them.
    """

    label: str
    ends: tuple[float, float]
    is_log: bool = False
    ticks: Mapping[float, str] = field(default_factory=dict)

    def share(self, values: ArrayLike) -> Samples:
        """Return where values are between the ends, which are 0 and 1."""
        scale = np.log10 if self.is_log else np.asarray
        low, high = scale(self.ends)
        shares: Samples = (scale(np.asarray(values, float)) - low) / (high - low)
        return shares

    def value(self, share: float) -> float:
        """Return the value at a share of the way between the ends."""
        low, high = self.ends
        return low * (high / low) ** share if self.is_log else low + share * (high - low)


def x_axis(picture: Picture) -> Axis:
    """Return the x axis of a picture, with free length beside points; texts are at 0, 1, 2 and so on."""
    if isinstance(picture, HeatMap):
        return grid_axis(picture.x)
    curves = [c for panel in picture.panels if isinstance(panel, Panel) for c in panel.curves]
    if names := next((curve.categories for curve in curves if curve.categories), None):
        return Axis(picture.x, (-0.5, len(names) - 0.5), ticks=dict(enumerate(names)))
    bars = [b for panel in picture.panels if isinstance(panel, Lanes) for _, b in panel.bars]
    ends = [mark.at for mark in picture.marks] + [x for b in bars for x in (b.first, b.last)]
    values = np.concatenate([ends, *(c.positions for c in curves)])
    low, high = (float(np.nanmin(values)), float(np.nanmax(values))) if len(values) else (0.0, 1.0)
    if low == high:
        low, high = (low / 2, high * 2) if picture.log else (low - 1.0, high + 1.0)
    elif any(c.look in ("points", "linked") for c in curves):
        tight, free = Axis("", (low, high), picture.log), STYLE.free_at_points_share
        low, high = tight.value(-free), tight.value(1 + free)
    return _axis(picture.x, low, high, is_log=picture.log)


def grid_axis(direction: GridAxis) -> Axis:
    """Return the axis of a plane."""
    values = np.asarray(direction.values, float)
    ends = float(values[0]), float(values[-1])
    return _axis(direction.label, *ends, is_log=direction.log, values=values.tolist())


def color_axis(heat_map: HeatMap) -> Axis:
    """Return the axis of a heat map's colours."""
    low, high = float(np.nanmin(heat_map.values)), float(np.nanmax(heat_map.values))
    return _axis(heat_map.quantity, low, high, is_log=heat_map.log)


def y_axis(panel: Panel, ranges: Sequence[Samples]) -> Axis:
    """Return the y axis of a panel over all that its curves cover.

    It has free length at both ends, except where it ends at a value that the panel includes; the axis of a
    flag has the ticks "no" and "yes".
    """
    free = STYLE.free_share
    if panel.is_flag:
        return Axis(panel.quantity, (-free, 1 + free), ticks={0.0: "no", 1.0: "yes"})
    fixed = [*panel.includes, *(level.at for level in panel.levels)]
    values = np.concatenate([fixed, *ranges])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    length = free * (high - low) or free * abs(high) or 1.0
    feet = [*panel.includes, *(0.0 for curve in panel.curves if curve.look in ("bars", "area"))]
    ends = (
        low if low in feet else low - length,
        high if high in panel.includes else high + length,
    )
    return Axis(panel.label, ends)


def log_ticks(low: float, high: float) -> list[float]:
    """Return the ticks of a logarithmic axis, closer where the ratio of its ends is at most NARROW_RATIO."""
    is_narrow = high / low <= NARROW_RATIO
    steps = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if is_narrow else (1.0, 2.0, 5.0)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [x for k in powers for s in steps if low <= (x := float(f"{s * 10.0**k:.3g}")) <= high]


def _axis(
    label: str, low: float, high: float, *, is_log: bool, values: Sequence[float] = ()
) -> Axis:
    """Return an axis with the ticks that a logarithm needs, or at grid values if these are few."""
    grid = values if len(values) <= STYLE.max_grid_ticks else ()
    ticks = log_ticks(low, high) if is_log else grid
    return Axis(label, (low, high), is_log, {float(tick): f"{tick:g}" for tick in ticks})
