"""What is drawn in a panel, as elements that a renderer draws one after the other without a decision."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count, cycle

import numpy as np

from .axes import Axis, color_axis, grid_axis, y_axis
from .model import Arrow, Curve, HeatMap, Lanes, Panel, Samples
from .style import (
    COLOR_SCALES,
    COLORS,
    CURVE_DASHES,
    LETTERS_BY_SCREEN,
    LEVEL_DASHES,
    MARKERS,
    STYLE,
    Dash,
    Marker,
    hex_color,
)

#: Name of what is drawn where there is no value.
UNDETERMINED = "not determined"
#: Points of a curve above which they are small, as nobody sees single ones; chosen.
MANY_POINTS = 200


@dataclass(frozen=True)
class Line:
    """A line, points, or both; NaN in y is a gap.

    `hover` is what the mouse tells, a format of "{x}" and "{y}"; None tells nothing.
    """

    name: str
    x: Samples
    y: Samples
    color: str
    width_px: float = STYLE.line_width_px
    dash: Dash = "solid"
    is_step: bool = False
    marker: Marker = "circle"
    marker_px: float = 0.0
    is_named: bool = True
    hover: str | None = None

    @property
    def told(self) -> Samples:
        """The values that the mouse tells."""
        return self.y


@dataclass(frozen=True)
class Band:
    """What lies between two lines; `values` are told by the mouse in place of the upper one."""

    name: str
    x: Samples
    low: Samples
    high: Samples
    color: str
    opacity: float
    values: Samples | None = None
    is_named: bool = False
    hover: str | None = None

    @property
    def told(self) -> Samples:
        """The values that the mouse tells."""
        return self.high if self.values is None else self.values


@dataclass(frozen=True)
class Bars:
    """Bars between two values; they begin at x + offset and are `width` wide. A text is written inside."""

    name: str
    x: Samples
    low: Samples
    high: Samples
    color: str
    offset: float
    width: float
    opacity: float = 1.0
    text: str = ""
    is_named: bool = True
    is_hatched: bool = False
    hover: str | None = None

    @property
    def told(self) -> Samples:
        """The values that the mouse tells."""
        return self.high


@dataclass(frozen=True)
class Heat:
    """Values over a plane in colour; `levels` are what the colours follow, `told` what the mouse tells, `axis` explains them."""

    name: str
    x: Samples
    y: Samples
    levels: Samples
    told: Samples
    colors: tuple[str, ...]
    axis: Axis
    is_named: bool = False
    hover: str | None = None


Element = Line | Band | Bars | Heat


@dataclass(frozen=True)
class DrawnRow:
    """A part of a picture: y axis, elements, arrows, and a height that may shrink or not."""

    y: Axis
    elements: tuple[Element, ...]
    height_px: float
    arrows: Sequence[Arrow] = ()
    may_shrink: bool = True

    @property
    def named(self) -> list[Line | Band | Bars]:
        """The elements whose names stand in the picture; the colours of a plane are explained beside it."""
        return [x for x in self.elements if x.is_named and not isinstance(x, Heat)]


def drawn_row(part: Panel | Lanes | HeatMap, x: Axis, height_px: float) -> DrawnRow:
    """Return what is drawn of a part of a picture over an x axis; only a panel takes the height."""
    match part:
        case Panel():
            return drawn_panel(part, x, height_px)
        case Lanes():
            return drawn_lanes(part, x)
        case HeatMap():
            return drawn_heat_map(part)


def drawn_panel(panel: Panel, x: Axis, height_px: float) -> DrawnRow:
    """Draw curves over their errors, areas on each other, bars beside each other, levels end to end."""
    bars = sum(curve.look == "bars" for curve in panel.curves)
    width = STYLE.bars_share / max(1, bars)
    offsets, dashes = count(-STYLE.bars_share / 2, width), cycle(CURVE_DASHES)
    base, elements, ranges = np.zeros(1), list[Element](), [np.zeros(min(1, bars))]
    hover = "{y}" if panel.is_flag else f"{{y:.5g}} {panel.unit}"
    for curve in panel.curves:
        if curve.look == "area":
            values, color = np.asarray(curve.y, float), hex_color(curve.color)
            low, base = base + 0 * values, base + np.nan_to_num(values)
            told = f"{{value:.5g}} {panel.unit}"
            band = Band(curve.name, curve.positions, low, base, color, STYLE.area_opacity, values)
            elements.append(replace(band, is_named=True, hover=told))
            ranges += [low, base]
            continue
        if curve.look == "bars":
            is_hatched = any(isinstance(element, Bars) for element in elements)
            elements += _bars(curve, next(offsets), width, hover, is_hatched=is_hatched)
        else:
            dash: Dash = next(dashes) if curve.look in ("line", "step") else "solid"
            elements += _curve(curve, dash, hover)
        ranges += [*curve.bounds]
    for level, dash in zip(panel.levels, cycle(LEVEL_DASHES)):
        at = np.full(2, level.at)
        elements.append(Line(level.text, np.array(x.ends), at, COLORS["grey"], dash=dash))
    y = y_axis(panel, [*ranges, *(np.array([each.start, each.end]) for each in panel.arrows)])
    elements += _undetermined(panel, y)
    if sum(element.is_named for element in elements) == 1:
        elements = [replace(element, is_named=False) for element in elements]
    return DrawnRow(y, tuple(elements), height_px, panel.arrows)


def drawn_lanes(lanes: Lanes, x: Axis) -> DrawnRow:
    """Draw a lane of bars for every name, with their texts inside where these fit on a small screen."""
    elements = []
    half = STYLE.lane_bar_share / 2
    for lane, bar in lanes.bars:
        length, room = bar.last - bar.first, float(np.diff(x.share([bar.first, bar.last]))[0])
        fits = len(bar.text) + 1 < LETTERS_BY_SCREEN["narrow"] * room
        elements.append(
            Bars(
                bar.text,
                np.array([bar.first]),
                np.array([lane - half]),
                np.array([lane + half]),
                hex_color(bar.color),
                0.0,
                length,
                STYLE.area_opacity,
                bar.text if fits else "",
                not fits,
                hover=f"{length:.4g}",
            )
        )
    y = Axis("", (len(lanes.rows) - 0.5, -0.5), ticks=dict(enumerate(lanes.rows)))
    return DrawnRow(y, tuple(elements), STYLE.lane_px * len(lanes.rows), may_shrink=False)


def drawn_heat_map(heat_map: HeatMap) -> DrawnRow:
    """Draw levels and curves over a quantity in colour, with a rim that shows them on every colour."""
    elements: list[Element] = [_heat(heat_map)]
    for level in heat_map.levels:
        x, y = contour(heat_map, level.at, level.values)
        rim = Line(level.text, x, y, COLORS["black"], STYLE.rim_width_px)
        elements += [
            rim,
            replace(rim, color=COLORS["white"], width_px=STYLE.line_width_px, is_named=False),
        ]
    for curve in heat_map.curves:
        line, *_ = _curve(curve, "solid", f"{{y:.5g}} {heat_map.y.unit}")
        assert isinstance(line, Line)
        size = STYLE.plane_marker_px if line.marker_px else 0.0
        width = STYLE.plane_line_width_px if line.width_px else 0.0
        elements.append(
            replace(
                line,
                color=COLORS["white"],
                width_px=STYLE.rim_width_px if width else 0.0,
                marker_px=size + STYLE.rim_marker_px if size else 0.0,
                is_named=False,
                hover=None,
            )
        )
        elements.append(replace(line, width_px=width, marker_px=size))
    return DrawnRow(grid_axis(heat_map.y), tuple(elements), STYLE.plane_px)


def contour(heat_map: HeatMap, at: float, values: Samples | None) -> Samples:
    """Return the contour line of values over a heat map's plane, shape (2, n), with NaN between its pieces."""
    from contourpy import LineType, contour_generator

    over = np.ma.masked_invalid(np.asarray(heat_map.values if values is None else values, float))
    x, y = (np.asarray(side.values, float) for side in (heat_map.x, heat_map.y))
    drawer = contour_generator(x, y, over, line_type=LineType.ChunkCombinedNan)
    (line,), *_ = drawer.lines(at)
    return np.empty((2, 0)) if line is None else np.asarray(line, float).T


def _curve(curve: Curve, dash: Dash, hover: str) -> list[Element]:
    """Draw a line or points over their errors; theory has a dash of its own."""
    x, y = curve.positions, np.asarray(curve.y, float)
    has_points = curve.look in ("points", "linked")
    size = STYLE.marker_px if len(x) <= MANY_POINTS else STYLE.many_markers_px
    if curve.look == "linked":
        x, y = broken(x, y, curve.breaks)
    line = Line(
        curve.name, x, y, hex_color(curve.color),
        0.0 if curve.look == "points" else STYLE.line_width_px,
        "dash" if curve.look == "theory" else dash,
        curve.look == "step",
        MARKERS[curve.color],
        size if has_points else 0.0,
        hover=hover,
    )  # fmt: skip
    if has_points or curve.error is None:
        return [*_errors(curve, curve.positions), line]
    low, high = curve.bounds
    color, opacity = hex_color(curve.color), STYLE.band_opacity
    return [Band(curve.name, curve.positions, low, high, color, opacity), line]


def broken(x: Samples, y: Samples, breaks: Sequence[int]) -> tuple[Samples, Samples]:
    """Return a curve with a gap before each of some positions."""
    at = list(breaks)
    return np.insert(x, at, x[at]), np.insert(y, at, math.nan)


def _bars(
    curve: Curve, offset: float, width: float, hover: str, *, is_hatched: bool
) -> list[Element]:
    """Draw bars from 0, with their errors over them."""
    x, y = curve.positions, np.asarray(curve.y, float)
    color = hex_color(curve.color)
    bars = Bars(curve.name, x, 0 * y, y, color, offset, width, is_hatched=is_hatched, hover=hover)
    return [bars, *_errors(curve, x + offset + width / 2)]


def _errors(curve: Curve, x: Samples) -> list[Element]:
    """Draw a bar for the error at every point."""
    if curve.error is None:
        return []
    y = np.stack([*curve.bounds, np.full(len(x), np.nan)], axis=1).ravel()
    color = hex_color("black" if curve.look == "bars" else curve.color)
    width = STYLE.error_width_px
    return [Line(curve.name, np.repeat(x, 3), y, color, width, is_named=False)]


def _undetermined(panel: Panel, y: Axis) -> list[Element]:
    """Draw a cross at the foot of a panel for every point and bar that has no value."""
    pointed = [curve for curve in panel.curves if curve.look in ("points", "linked", "bars")]
    missing = [c.positions[~np.isfinite(np.asarray(c.y, float))] for c in pointed]
    x = np.unique(np.concatenate([np.empty(0), *missing]))
    if not len(x):
        return []
    foot = np.full(len(x), y.value(STYLE.undetermined_share))
    size, hover = STYLE.undetermined_marker_px, UNDETERMINED
    color = COLORS["black"]
    return [Line(UNDETERMINED, x, foot, color, 0.0, marker="cross", marker_px=size, hover=hover)]


def _heat(heat_map: HeatMap) -> Heat:
    """Draw the values of a heat map in colour."""
    values = np.asarray(heat_map.values, float)
    sides = zip("xy", (heat_map.x, heat_map.y))
    hover = [f"{side.quantity} {{{name}:.4g}} {side.unit}" for name, side in sides]
    hover.append(f"{heat_map.quantity} {{value:.4g}}")
    x, y = (np.asarray(side.values, float) for side in (heat_map.x, heat_map.y))
    levels = np.log10(values) if heat_map.log else values
    colors, text = COLOR_SCALES[heat_map.scale], "<br>".join(hover)
    return Heat(heat_map.quantity, x, y, levels, values, colors, color_axis(heat_map), hover=text)
