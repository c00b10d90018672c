"""Pictures in the words of plotly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .chart import (
    COLORS,
    SCALES,
    Chart,
    Curve,
    Direction,
    Field,
    Lanes,
    Panel,
    Picture,
    Samples,
    decades,
    fits,
    flags,
    height,
    stacked,
    thinned,
    width,
)

Words = dict[str, Any]
Ends = tuple[float, float] | None
HEIGHT, GAP, LANE, LINE, BELOW, SECOND = 190, 16, 30, 19, 52, 44
TALL = {1: 320, 2: 240}
LETTERS, ENTRY, SMALL, FAINT = 44.0, 8, 40, 0.4
GRID = {"gridcolor": "rgba(128,128,128,.25)", "zerolinecolor": "rgba(128,128,128,.5)"}
LOOK = {
    "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)",
    "font": {"family": "system-ui, sans-serif", "size": 12},
}  # fmt: skip


def figure(picture: Picture) -> Words:
    """Data and layout."""
    layout: Words = LOOK | {"shapes": [], "annotations": []}
    draw: Any = _field if isinstance(picture, Field) else _chart
    return {"data": draw(picture, layout), "layout": layout}


def _chart(chart: Chart, layout: Words) -> list[Words]:
    """Panels above each other, with room for the legend of each on a small screen."""
    raised, below = _raised(chart), SECOND if chart.second else 0
    ends, count = width(chart), len(chart.panels)
    sizes = [
        LANE * len(panel.rows) if isinstance(panel, Lanes) else TALL.get(count, HEIGHT)
        for panel in chart.panels
    ]
    gaps = [GAP + _entries(_named(panel, ends)) for panel in chart.panels]
    inside = sum(sizes) + sum(gaps) + raised + below
    layout |= {
        "height": inside + BELOW, "margin": {"l": 66, "r": 14, "t": 0, "b": BELOW},
        "barmode": "group", "hovermode": "x unified", "hoversubplots": "axis",
        "xaxis": {
            "title": {"text": chart.x, "standoff": 4}, "anchor": f"y{count}", "spikethickness": 1,
            "unifiedhovertitle": {"text": f"{chart.x} %{{x:.5g}}"}, "spikecolor": COLORS["grey"],
            **_axis(chart.log, ends), **GRID,
        },
    }  # fmt: skip
    data: list[Words] = []
    top = inside - raised
    for k, (panel, size, gap) in enumerate(zip(chart.panels, sizes, gaps), 1):
        top -= gap
        axis = {"domain": [(top - size) / inside, top / inside], "anchor": "x", **GRID}
        legend = (top + (raised if k == 1 else 0)) / inside
        layout[_at(k)["legend"]] = _legend(legend)
        if isinstance(panel, Lanes):
            layout[f"yaxis{k}"] = axis | _lanes(panel, k, ends, layout, data)
        else:
            title = {"text": panel.lines.replace("\n", "<br>"), "standoff": 4}
            layout[f"yaxis{k}"] = axis | {"title": title, "range": list(height(panel))}
            shown = len(_named(panel, ends)) > 1
            data += [trace for curve in panel.curves for trace in traces(curve, k, panel, shown)]
            data += _levels(panel, k, ends)
        top -= size
    if chart.second is not None and ends is not None:
        factor = chart.second.factor
        layout["meta"] = {"factor": factor}
        layout["xaxis2"] = {
            "title": {"text": f"[{chart.second.unit}]", "standoff": 2}, "overlaying": "x",
            "anchor": "free", "position": 0, "tickmode": "auto", "showgrid": False,
            "range": [factor * end for end in ends],
        }  # fmt: skip
        data.append({"x": [None], "y": [None], "xaxis": "x2", "yaxis": f"y{count}",
                     "hoverinfo": "skip", "showlegend": False})  # fmt: skip
    _flagged(chart, layout, (inside - gaps[0] - raised) / inside, below / inside)
    return data


def _at(panel: int) -> Words:
    """The axes and the legend of a panel."""
    legend = "legend" if panel == 1 else f"legend{panel}"
    return {"xaxis": "x", "yaxis": f"y{panel}", "legend": legend}


def _legend(y: float) -> Words:
    font = {"size": 12}
    return {"orientation": "h", "y": y, "yanchor": "bottom", "x": 0, "font": font}


def _raised(picture: Picture) -> int:
    """How high the words above a picture are."""
    return LINE * max((flag.lane + 1 for flag in flags(picture, LETTERS)), default=0)


def _named(panel: Panel | Lanes, ends: Ends) -> list[str]:
    """What a legend has to name."""
    if isinstance(panel, Lanes):
        return [bar.text for _, bar in panel.bars if not fits(bar, ends, LETTERS)]
    return [curve.name for curve in panel.curves] + [level.text for level in panel.levels]


def _entries(names: Sequence[str]) -> int:
    """The height of a legend on a small screen."""
    if len(names) < 2:
        return 0
    beside = max(1, int(SMALL / (max(map(len, names)) + ENTRY)))
    return LINE * math.ceil(len(names) / beside)


def _axis(log: bool, ends: Ends, places: Sequence[float] = ()) -> Words:
    """Type, range and ticks of an axis."""
    if ends is None:
        return {"type": "category"}
    ticks = decades(*ends) if log else list(places)
    told = {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]} if ticks else {}
    scaled = [math.log10(end) for end in ends] if log else list(ends)
    return {"type": "log" if log else "linear", "range": scaled, **told}


def _flagged(picture: Picture, layout: Words, top: float, bottom: float) -> None:
    """Spans and marks over the panels, their words above the first."""
    plane = isinstance(picture, Field)
    log = picture.x.log if isinstance(picture, Field) else picture.log
    upright = {"y0": bottom, "y1": top, "yref": "paper", "xref": "x"}
    for span in picture.spans:
        edge = {"line": {"color": COLORS[span.color], "width": 2.5 if plane else 0}}
        filled = {} if plane else {"fillcolor": COLORS[span.color], "opacity": 0.14}
        rect = {"type": "rect", "layer": "above" if plane else "below"} | edge | filled
        layout["shapes"].append({**rect, "x0": span.first, "x1": span.last, **upright})
    for mark in () if isinstance(picture, Field) else picture.marks:
        stroke = {"line": {"color": COLORS["grey"], "width": 1.6, "dash": "dot"}}
        layout["shapes"].append({"type": "line", **stroke, "x0": mark.at, "x1": mark.at, **upright})
    for flag in flags(picture, LETTERS):
        place = {"x": math.log10(flag.at) if log else flag.at, "xref": "x", "yref": "paper"}
        above = {"y": top, "yanchor": "bottom", "yshift": LINE * flag.lane}
        layout["annotations"].append(_words(flag.text) | place | above)


def _words(text: str) -> Words:
    return {"text": text, "showarrow": False, "font": {"size": 11}}


def _lanes(panel: Lanes, number: int, ends: Ends, layout: Words, data: list[Words]) -> Words:
    """Lanes of bars, the first on top, named inside where there is room, else in the legend; the
    middle of each tells on hovering how long it is. The axis of the panel."""
    last = len(panel.rows) - 1
    for row, bar in panel.bars:
        at, middle, inside = last - row, (bar.first + bar.last) / 2, fits(bar, ends, LETTERS)
        color, place = COLORS[bar.color], {"xref": "x", "yref": f"y{number}"}
        sides = {"x0": bar.first, "x1": bar.last, "y0": at - 0.42, "y1": at + 0.42}
        look = {"opacity": FAINT, "fillcolor": color, "line": {"width": 0}}
        layout["shapes"].append({"type": "rect", **sides, **place, **look})
        if inside:
            layout["annotations"].append(_words(bar.text) | {"x": middle, "y": at, **place})
        data.append(
            {
                "mode": "markers", "x": [middle], "y": [at], "name": bar.text, **_at(number),
                "showlegend": not inside, "hovertemplate": f"{bar.last - bar.first:.4g}",
                "marker": {"opacity": 0 if inside else FAINT, "color": color, "symbol": "square"},
            }
        )  # fmt: skip
    ticks = {"tickvals": list(range(last + 1)), "ticktext": list(panel.rows)[::-1]}
    return ticks | {"range": [-0.5, last + 0.5], "showgrid": False, "zeroline": False}


def _levels(panel: Panel, number: int, ends: Ends) -> list[Words]:
    """The levels of a panel from end to end."""
    places: list[Any] = [*ends] if ends else [panel.curves[0].x[0], panel.curves[0].x[-1]]
    return [
        {
            "mode": "lines", "name": level.text, "x": places, "y": [level.at, level.at],
            "hoverinfo": "skip", **_at(number),
            "line": {"color": COLORS["grey"], "width": 1.6, "dash": ("dot", "dashdot")[k % 2]},
        }
        for k, level in enumerate(panel.levels)
    ]  # fmt: skip


def traces(curve: Curve, number: int, panel: Panel, shown: bool) -> list[Words]:
    """A curve of a panel, with the unit that hovering tells, after the band of its error."""
    color, line = COLORS[curve.color], {"color": COLORS[curve.color], "width": 1.6}
    place = _at(number) | {"legendgroup": curve.name}
    told = place | {
        "name": curve.name, "showlegend": shown, "hovertemplate": f"%{{y:.5g}} {panel.unit}",
    }  # fmt: skip
    if curve.look == "bars":
        bars = {"type": "bar", "x": list(curve.x), "y": numbers(np.asarray(curve.y, float))}
        return [told | bars | {"marker": {"color": color}, **_error(curve)}]
    x, y = thinned(np.asarray(curve.x, float), np.asarray(curve.y, float))
    modes = {"points": "markers", "linked": "lines+markers"}
    drawn = told | {
        "mode": modes.get(curve.look, "lines"), "x": numbers(x), "y": numbers(y), "line": line,
        "marker": {"color": color, "size": 6},
    }  # fmt: skip
    if curve.look == "theory":
        drawn["line"] = line | {"dash": "dash"}
    elif curve.look == "step":
        drawn["line"] = line | {"shape": "hvh"}
    elif curve.look == "area":
        drawn |= {"stackgroup": f"stack{number}", "fillcolor": f"{color}59"}
    if curve.look in modes:
        return [drawn | _error(curve)]
    if curve.error is None:
        return [drawn]
    _, *ends = next(each for each in stacked(panel) if each[0] is curve)
    band = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
    there = {"x": numbers(np.asarray(curve.x, float)), **place}
    low, high = (band | there | {"y": numbers(end)} for end in ends)
    return [low, high | {"fill": "tonexty", "fillcolor": f"{color}33"}, drawn]


def _error(curve: Curve) -> Words:
    """The bars of errors."""
    if curve.error is None:
        return {}
    below, above = np.broadcast_to(np.asarray(curve.error, float), (2, len(curve.y)))
    ends = {"array": numbers(above), "arrayminus": numbers(below), "symmetric": False}
    return {"error_y": {"type": "data", **ends, "thickness": 1.2, "width": 3}}


def numbers(values: Samples) -> list[float | None]:
    """Seven digits are more than a screen shows."""
    return [float(f"{v:.7g}") if math.isfinite(v) else None for v in values.tolist()]


def _field(field: Field, layout: Words) -> list[Words]:
    """A quantity in colour, with levels and curves over it."""
    values = np.asarray(field.values, float)
    shown = np.log10(values) if field.log else values
    low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
    ticks = decades(10**low, 10**high) if field.log else np.linspace(low, high, 6).tolist()
    raised, inside = _raised(field), 2 * HEIGHT
    named = [level.text for level in field.levels] + [curve.name for curve in field.curves]
    above = GAP + _entries(named) + raised
    layout |= {
        "height": inside + above + BELOW, "margin": {"l": 66, "r": 12, "t": above, "b": BELOW},
        "hovermode": "closest", "legend": _legend(1 + raised / inside),
        "xaxis": _direction(field.x), "yaxis": _direction(field.y),
    }  # fmt: skip
    places = [
        f"{at.quantity} %{{{name}:.4g}} {at.unit}" for name, at in (("x", field.x), ("y", field.y))
    ]
    there = {"x": numbers(np.asarray(field.x.values)), "y": numbers(np.asarray(field.y.values))}
    colors = SCALES[field.scale]
    heat: Words = {
        "type": "heatmap", **there, "z": [numbers(row) for row in shown],
        "customdata": [numbers(row) for row in values],
        "colorscale": [[k / (len(colors) - 1), color] for k, color in enumerate(colors)],
        "colorbar": {
            "title": {"text": field.quantity, "side": "right"}, "thickness": 12,
            "tickvals": np.log10(ticks).tolist() if field.log else ticks,
            "ticktext": [f"{tick:.3g}" for tick in ticks],
        },
        "hovertemplate": f"{'<br>'.join(places)}<br>{field.quantity} %{{customdata:.4g}}<extra></extra>",
    }  # fmt: skip
    lines = [
        {
            "type": "contour", **there, "name": level.text, "showscale": False, "hoverinfo": "skip",
            "z": [numbers(row) for row in np.asarray(over, float)], "showlegend": wide > 2,
            "contours": {"coloring": "none", "start": level.at, "end": level.at, "size": 1},
            "line": {"color": color, "width": wide},
        }
        for level in field.levels
        for over in [field.values if level.values is None else level.values]
        for color, wide in (("#202020", 4.0), ("#ffffff", 1.6))
    ]  # fmt: skip
    panel = Panel(field.y.quantity, field.y.unit, field.curves)
    drawn = [trace for curve in field.curves for trace in traces(curve, 1, panel, True)]
    for trace in drawn:
        trace["line"]["width"] = 3
        trace["marker"] |= {"line": {"color": "white", "width": 1.5}}
    _flagged(field, layout, 1.0, 0.0)
    return [heat, *lines, *drawn]


def _direction(along: Direction) -> Words:
    ends = float(along.values[0]), float(along.values[-1])
    title = {"text": along.label.replace("\n", " ")}
    return {"title": title, "showgrid": False, **_axis(along.log, ends, along.places)}
