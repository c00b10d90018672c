"""A picture in the words of plotly: all that is decided about it, which `png` reads as well."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from itertools import count, cycle
from typing import Any, NamedTuple

import numpy as np

from .layout import Axis, across, along, colored, flags, upwards
from .model import COLORS, SCALES, Curve, Field, Lanes, Panel, Picture, Samples, Span

Words = dict[str, Any]
MOST, NARROW, ENTRY, UPWARDS = 2000, 44, 8, 13
SCREENS = {"narrow": NARROW, "wide": 130, "paper": 100}
INCH, BELOW, SECOND, TIGHT, PAPER = 100, 52, 44, 6, 680
LINE, GAP, LANE, PLANE, LEAST, PANELS = 0.19, 0.18, 0.3, 3.8, 0.3, {1: 3.3, 2: 2.5}
LOOK = {
    "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)", "hoversubplots": "axis",
    "font": {"family": "system-ui, sans-serif", "size": 12},
    "margin": {"l": 60, "r": 14, "t": 0, "b": BELOW},
}  # fmt: skip
LEGEND = {"orientation": "h", "x": 0, "yanchor": "top", "tracegroupgap": 0}
GRID = {"gridcolor": "rgba(128,128,128,.25)", "zerolinecolor": "rgba(128,128,128,.5)"}
UNSEEN = {"hoverinfo": "skip", "showlegend": False}
LOOKS: dict[str, Words] = {
    "theory": {"dash": "dash"}, "step": {"shape": "hvh"}, "points": {"mode": "markers"},
    "linked": {"mode": "lines+markers"},
}  # fmt: skip


class Row(NamedTuple):
    """A part of a picture: y axis, traces, height [inches], scale of its colours, if any."""

    y: Axis
    traces: Sequence[Words]
    height: float
    colors: Words | None = None


def figure(picture: Picture, most: float = math.inf) -> Words:
    """The data, and layouts for screens and for paper, there at most so many inches high."""
    x, second = across(picture), getattr(picture, "second", None)
    parts: Sequence[Any] = [picture] if isinstance(picture, Field) else picture.panels
    kinds: Any = {Panel: _panel, Lanes: _lanes, Field: _field}
    rows = [kinds[type(part)](part, x, PANELS.get(len(parts), 1.9)) for part in parts]
    data = [
        trace | {"yaxis": f"y{k}", "legend": f"legend{k + 1}"}
        for k, row in enumerate(rows, 1)
        for trace in row.traces
    ]
    if second:
        data.append({"x": [None], "y": [None], "xaxis": "x2", "yaxis": f"y{len(rows)}"} | UNSEEN)
    laid = {
        screen: _layout(picture, x, rows, letters, most if screen == "paper" else math.inf)
        for screen, letters in SCREENS.items()
    }
    laid["paper"]["width"] = PAPER
    return {"data": data, **laid}


def _layout(picture: Picture, x: Axis, rows: Sequence[Row], letters: int, most: float) -> Words:
    """Rows above each other, each below its legend; spans through all of them, words on top."""
    second, plane = getattr(picture, "second", None), isinstance(picture, Field)
    mark, edge = {"dash": "dot", "width": 1.6}, {"width": 2.5 if plane else 0.6}
    spans = [*picture.spans, *(Span(mark.at, mark.at, mark.text) for mark in picture.marks)]
    words, names = flags(spans, x, letters), [legend_names(row.traces) for row in rows]
    above = [GAP + LINE * math.ceil(len(each) / columns(each, letters)) for each in names]
    above[0] += LINE * max((lane + 1 for _, _, lane, _ in words), default=0)
    heights, below = [row.height for row in rows], (SECOND if second else 0) / INCH
    panels = sum(row.height for row in rows if row.y.label)
    over = max(0.0, sum(above + heights) + below + BELOW / INCH - most)
    share = max(LEAST, 1.0 - over / panels) if over else 1.0
    heights = [row.height * (share if row.y.label else 1.0) for row in rows]
    top = inside = sum(above + heights) + below
    drawn: Words = LOOK | {
        "height": INCH * inside + BELOW, "hovermode": "closest" if plane else "x unified",
        "xaxis": _axis(x) | {
            "anchor": f"y{len(rows)}", "spikethickness": 1, "spikecolor": COLORS["grey"],
        },
        "annotations": [
            {
                "text": text, "showarrow": False, "font": {"size": 11}, "yref": "y domain", "y": 1,
                "x": math.log10(at) if x.log else at, "xanchor": anchor, "yanchor": "bottom",
                "yshift": INCH * LINE * lane,
            }
            for at, text, lane, anchor in words
        ],
        "shapes": [
            {
                "type": "rect", "yref": f"y{k} domain", "y0": 0, "y1": 1, "x0": first, "x1": last,
                "fillcolor": COLORS[color] + ("00" if plane else "24"),
                "layer": "above" if plane else "below",
                "line": {"color": COLORS[color]} | (mark if first == last else edge),
            }
            for k in range(1, len(rows) + 1)
            for first, last, _, color in spans
        ],
    }  # fmt: skip
    if x.log or not x.ticks:
        drawn["xaxis"]["unifiedhovertitle"] = {"text": f"{x.label} %{{x:.5g}}"}
    for k, (row, room, high) in enumerate(zip(rows, above, heights), 1):
        drawn[f"legend{k + 1}"] = LEGEND | {"y": (top - TIGHT / INCH) / inside}
        top -= room + high
        ends = [top / inside, (top + high) / inside]
        label = textwrap.fill(row.y.label, max(1, int(UPWARDS * high)), break_long_words=False)
        grid = {"showgrid": not row.y.ticks, "zeroline": not row.y.ticks, "anchor": "x"}
        drawn[f"yaxis{k}"] = _axis(row.y._replace(label=label)) | grid | {"domain": ends}
        if row.colors:
            bar = row.colors["colorbar"] | {"len": ends[1] - ends[0], "y": ends[0]}
            drawn["coloraxis"] = row.colors | {"colorbar": bar}
    if second:
        drawn["meta"] = {"factor": second.factor}
        drawn["xaxis2"] = {
            "title": {"text": f"[{second.unit}]", "standoff": 2}, "overlaying": "x",
            "anchor": "free", "position": 0, "tickmode": "auto", "showgrid": False,
            "range": [second.factor * end for end in x.ends],
        }  # fmt: skip
    return drawn


def alt_text(picture: Picture, drawn: Words) -> str:
    """The picture in words, for those who do not see it."""
    laid, parts = drawn["wide"], []
    for trace in (trace for trace in drawn["data"] if trace.get("hoverinfo") != "skip"):
        values = np.array(trace.get("customdata", trace["y"]), float)
        label = laid[f"yaxis{trace['yaxis'][1:]}"]["title"]["text"].replace("<br>", " ")
        if label and np.isfinite(values).any():
            reach = f"from {np.nanmin(values):.4g} to {np.nanmax(values):.4g} ({label})"
            parts.append(f"{trace['name']} {reach}")
        else:
            parts.append(trace["name"])
    parts += [flag["text"] for flag in laid["annotations"]]
    return f"{picture.title}, over {laid['xaxis']['title']['text']}: {'; '.join(parts)}."


def legend_names(traces: Sequence[Words]) -> list[str]:
    """The names in a legend."""
    return [trace["name"] for trace in traces if trace.get("showlegend")]


def columns(names: Sequence[str], letters: int) -> int:
    """How many of these names stand beside each other in a legend."""
    return max(1, letters // (max(map(len, names), default=0) + ENTRY))


def _axis(axis: Axis) -> Words:
    """Title, type, range and ticks of an axis."""
    title = {"text": axis.label.replace("\n", "<br>"), "standoff": 4 + 14 * axis.label.count("\n")}
    ends = np.log10(axis.ends) if axis.log else axis.ends
    ticks = {"tickvals": list(axis.ticks), "ticktext": list(axis.ticks.values())}
    return {
        "title": title, "range": list(map(float, ends)), "automargin": True,
        "type": "log" if axis.log else "linear", **(ticks if axis.ticks else {}), **GRID,
    }  # fmt: skip


def _panel(panel: Panel, x: Axis, high: float) -> Row:
    """Curves over their errors, areas on each other, bars beside each other, levels end to end."""
    bars = sum(curve.look == "bars" for curve in panel.curves)
    wide, base, traces = 0.8 / max(1, bars), np.zeros(1), list[Words]()
    covered, beside = [np.zeros(min(1, bars))], count(-0.4, wide)
    hover = {"hovertemplate": "%{y}" if panel.flag else f"%{{y:.5g}} {panel.unit}"}
    for curve in panel.curves:
        at, y, ends = curve.places, np.asarray(curve.y, float), curve.ends
        line = _line(curve.name, at, y, curve.color, **LOOKS.get(curve.look, {}))
        if curve.look == "area":
            ends, base = np.stack([base + 0 * y, base + y]), base + np.nan_to_num(y)
            below, area = _filled(curve, ends, "59")
            values = numbers(y[thinned(ends[1])])
            own = {"customdata": values, "hoverinfo": "all", "showlegend": True}
            traces += [below, area | own | {"hovertemplate": f"%{{customdata:.5g}} {panel.unit}"}]
        elif curve.look == "bars":
            first = next(beside)
            bar = _bars(curve.name, at, np.stack([0 * y, y]), COLORS[curve.color], first, wide)
            traces += [bar, *_errors(curve, at + first + wide / 2)]
        elif curve.error is not None and curve.look in ("line", "theory", "step"):
            traces += [*_filled(curve, ends, "33"), line]
        else:
            traces += [*_errors(curve, at), line]
        covered += [*ends]
    for level, dash in zip(panel.levels, cycle(("dot", "dashdot"))):
        line = _line(level.text, np.array(x.ends), np.full(2, level.at), "grey", dash=dash)
        traces.append(line | {"hoverinfo": "skip"})
    if len(legend_names(traces)) == 1:
        traces = [trace | {"showlegend": False} for trace in traces]
    return Row(upwards(panel, covered), [hover | trace for trace in traces], high)


def _lanes(lanes: Lanes, x: Axis, _: float) -> Row:
    """A lane of bars for every name, with their words inside where these fit on a small screen."""
    traces = []
    for lane, bar in lanes.bars:
        long, ends = bar.last - bar.first, np.array([[lane - 0.42], [lane + 0.42]])
        drawn = _bars(bar.text, np.array([bar.first]), ends, COLORS[bar.color] + "59", 0.0, long)
        if len(bar.text) + 1 < NARROW * float(np.diff(x.share([bar.first, bar.last]))[0]):
            drawn |= {"text": bar.text, "showlegend": False}
        traces.append(drawn | {"hovertemplate": f"{long:.4g}"})
    y = Axis("", (len(lanes.rows) - 0.5, -0.5), ticks=dict(enumerate(lanes.rows)))
    return Row(y, traces, LANE * len(lanes.rows))


def _field(field: Field, *_: object) -> Row:
    """Levels and curves over a quantity in colour, with a rim that shows them on every colour."""
    from contourpy import LineType, contour_generator

    axis, colors, values = colored(field), SCALES[field.scale], np.asarray(field.values, float)
    sides = (("x", field.x), ("y", field.y))
    hover = [f"{side.quantity} %{{{name}:.4g}} {side.unit}" for name, side in sides]
    hover.append(f"{field.quantity} %{{customdata:.4g}}<extra></extra>")
    at = [np.asarray(side.values, float) for _, side in sides]
    heat = {
        "type": "heatmap", "name": field.quantity, "coloraxis": "coloraxis",
        "x": numbers(at[0]), "y": numbers(at[1]),
        "z": list(map(numbers, np.log10(values) if field.log else values)),
        "customdata": list(map(numbers, values)),
        "hovertemplate": "<br>".join(hover),
    }  # fmt: skip
    traces: list[Words] = [heat]
    for level in field.levels:
        over = np.ma.masked_invalid(values if level.values is None else level.values)
        drawer = contour_generator(at[0], at[1], over, line_type=LineType.ChunkCombinedNan)
        line: Any = drawer.lines(level.at)[0][0]
        x, y = np.empty((2, 0)) if line is None else line.T
        rim = _line(level.text, x, y, "black", 4.0) | {"hoverinfo": "skip"}
        traces += [rim, _line(level.text, x, y, "white") | UNSEEN]
    for curve in field.curves:
        points, look = (curve.places, np.asarray(curve.y, float)), LOOKS.get(curve.look, {})
        own = {"hovertemplate": f"%{{y:.5g}} {field.y.unit}"}
        traces.append(_line(curve.name, *points, "white", 4.0, 9.0, **look) | UNSEEN)
        traces.append(_line(curve.name, *points, curve.color, 2.4, 7.0, **look) | own)
    ticks = [math.log10(tick) if field.log else tick for tick in axis.ticks]
    title = {"text": axis.label, "side": "right"}
    bar: Words = {"thickness": 12, "yanchor": "bottom", "title": title}
    bar |= {"tickvals": ticks, "ticktext": list(axis.ticks.values())} if ticks else {}
    scale = list(zip(np.linspace(0, 1, len(colors)).tolist(), colors))
    return Row(along(field.y), traces, PLANE, {"colorscale": scale, "colorbar": bar})


def _line(
    name: str, x: Samples, y: Samples, color: str, width: float = 1.6, size: float = 5.0,
    mode: str = "lines", dash: str = "solid", shape: str = "linear",
) -> Words:  # fmt: skip
    """A line, points, or both."""
    keep = thinned(y)
    return {
        "name": name, "legendgroup": name, "showlegend": True, "mode": mode,
        "x": numbers(x[keep]), "y": numbers(y[keep]),
        "line": {"color": COLORS[color], "width": width, "dash": dash, "shape": shape},
        "marker": {"color": COLORS[color], "size": size},
    }  # fmt: skip


def _bars(name: str, x: Samples, ends: Samples, color: str, first: float, wide: float) -> Words:
    """Bars between two ends that begin so far from x and are so wide."""
    return {
        "type": "bar", "name": name, "legendgroup": name, "showlegend": True, "x": numbers(x),
        "y": numbers(ends[1] - ends[0]), "base": numbers(ends[0]), "offset": first, "width": wide,
        "marker": {"color": color}, "insidetextanchor": "middle", "textangle": 0,
    }  # fmt: skip


def _filled(curve: Curve, ends: Samples, dark: str) -> list[Words]:
    """What lies between two lines."""
    edge = {"line": {"width": 0, "color": COLORS[curve.color]}} | UNSEEN
    low, top = (_line(curve.name, curve.places, end, curve.color) | edge for end in ends)
    return [low, top | {"fill": "tonexty", "fillcolor": COLORS[curve.color] + dark}]


def _errors(curve: Curve, x: Samples) -> list[Words]:
    """A bar for the error at every point."""
    if curve.error is None:
        return []
    y = np.stack([*curve.ends, np.full(len(x), np.nan)], axis=1).ravel()
    color = "black" if curve.look == "bars" else curve.color
    return [_line(curve.name, np.repeat(x, 3), y, color, 1.2) | UNSEEN]


def thinned(y: Samples) -> Any:
    """At most MOST rows: the ends, and the smallest and largest of every stretch in order."""
    if len(y) <= MOST:
        return slice(None)
    kept = {0, len(y) - 1}
    for stretch in np.array_split(np.arange(len(y)), MOST // 2 - 1):
        kept |= {int(stretch[np.argmin(y[stretch])]), int(stretch[np.argmax(y[stretch])])}
    return sorted(kept)


def numbers(values: Samples) -> list[float | None]:
    """Seven digits, which are more than a screen shows."""
    return [float(f"{value:.7g}") if math.isfinite(value) else None for value in values.tolist()]
