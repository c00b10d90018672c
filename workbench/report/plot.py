"""Pictures in the words of plotly: data, and a layout for a wide and for a narrow screen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .chart import COLORS, SCALES, Chart, Curve, Field, Lanes, Picture, Samples, Span
from .layout import LINE, NARROW, Axis, Layout, colored, covered, fits, layout, lines, thinned

Words = dict[str, Any]
WIDE, INCH, BELOW, SECOND, TIGHT, FAINT = 130, 100, 52, 44, 6, "59"
LOOK = {
    "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)", "hoversubplots": "axis",
    "font": {"family": "system-ui, sans-serif", "size": 12},
    "margin": {"l": 60, "r": 14, "t": 0, "b": BELOW},
}  # fmt: skip
LEGEND = {"orientation": "h", "x": 0, "yanchor": "top", "tracegroupgap": 0}
GRID = {"gridcolor": "rgba(128,128,128,.25)", "zerolinecolor": "rgba(128,128,128,.5)"}
LOOKS: dict[str, Words] = {
    "line": {"mode": "lines"},
    "theory": {"mode": "lines", "line": {"dash": "dash"}},
    "level": {"mode": "lines", "line": {"dash": "dot"}, "hoverinfo": "skip"},
    "limit": {"mode": "lines", "line": {"dash": "dashdot"}, "hoverinfo": "skip"},
    "step": {"mode": "lines", "line": {"shape": "hvh"}},
    "area": {"mode": "lines", "stackgroup": "areas"},
    "points": {"mode": "markers"},
    "linked": {"mode": "lines+markers"},
    "bars": {"type": "bar"},
}


def figure(picture: Picture) -> Words:
    """The data, and the layouts by screen."""
    laid = layout(picture, NARROW)
    data = _field(picture) if isinstance(picture, Field) else _chart(picture, laid)
    layouts = {"narrow": laid, "wide": layout(picture, WIDE)}
    return {"data": data, **{screen: _layout(picture, each) for screen, each in layouts.items()}}


def _layout(picture: Picture, laid: Layout) -> Words:
    """Rows above each other, each below its legend, with marks and spans over all of them."""
    x, shapes, plane = laid.x, [], isinstance(picture, Field)
    below = SECOND if isinstance(picture, Chart) and picture.second else 0
    inside = top = below + INCH * sum(row.height + row.above for row in laid.rows)
    drawn: Words = LOOK | {
        "height": inside + BELOW, "hovermode": "closest" if plane else "x unified",
        "xaxis": _axis(x) | {
            "anchor": f"y{len(laid.rows)}", "spikethickness": 1,
            "unifiedhovertitle": {"text": f"{x.label} %{{x:.5g}}"}, "spikecolor": COLORS["grey"],
        },
        "annotations": [
            {
                "text": flag.text, "showarrow": False, "font": {"size": 11}, "yref": "y domain",
                "x": math.log10(flag.at) if x.log else flag.at, "xanchor": flag.anchor, "y": 1,
                "yanchor": "bottom", "yshift": INCH * LINE * flag.lane,
            }
            for flag in laid.flags
        ],
    }  # fmt: skip
    for k, row in enumerate(laid.rows, 1):
        low, high = top - INCH * (row.above + row.height), top - INCH * row.above
        drawn[f"legend{k + 1}"] = LEGEND | {"y": (top - TIGHT) / inside}
        grid = {"showgrid": not row.y.ticks, "zeroline": not row.y.ticks}
        domain = {"domain": [low / inside, high / inside], "anchor": "x"}
        drawn[f"yaxis{k}"] = _axis(row.y) | domain | grid
        place, top = {"yref": f"y{k} domain", "y0": 0, "y1": 1}, low
        for span in picture.spans:
            color, ends = COLORS[span.color], {"x0": span.first, "x1": span.last}
            edge = {"type": "rect", "line": {"color": color, "width": 2.5 if plane else 0.6}}
            fill = {} if plane else {"fillcolor": f"{color}24", "layer": "below"}
            shapes.append(place | ends | edge | fill)
        for mark in picture.marks:
            line = {"color": COLORS["grey"], "width": 1.6, "dash": "dot"}
            shapes.append(place | {"type": "line", "x0": mark.at, "x1": mark.at, "line": line})
    if isinstance(picture, Field):
        drawn["coloraxis"] = _colors(picture, (high - low) / inside)
    elif picture.second:
        unit, factor = picture.second
        drawn["meta"] = {"factor": factor}
        drawn["xaxis2"] = {
            "title": {"text": f"[{unit}]", "standoff": 2}, "overlaying": "x", "anchor": "free",
            "position": 0, "tickmode": "auto", "showgrid": False,
            "range": [factor * end for end in x.ends],
        }  # fmt: skip
    return drawn | {"shapes": shapes}


def _colors(field: Field, long: float) -> Words:
    """The scale of a field, and a bar of that length beside it."""
    axis, colors = colored(field), SCALES[field.scale]
    values = np.log10(list(axis.ticks)).tolist() if field.log else list(axis.ticks)
    ticks = {"tickvals": values, "ticktext": list(axis.ticks.values())} if values else {}
    place = {"thickness": 12, "len": long, "y": 0, "yanchor": "bottom"}
    bar = ticks | place | {"title": {"text": axis.label, "side": "right"}}
    steps = np.linspace(0, 1, len(colors)).tolist()
    return {"colorscale": list(zip(steps, colors)), "colorbar": bar}


def _axis(axis: Axis) -> Words:
    """Title, type, range and ticks of an axis."""
    ends = np.log10(axis.ends).tolist() if axis.log else list(axis.ends)
    ticks = {"tickvals": list(axis.ticks), "ticktext": list(axis.ticks.values())}
    return {
        "title": {"text": axis.label.replace("\n", "<br>"), "standoff": 4 + 14 * axis.label.count("\n")},
        "range": ends, "automargin": True,
        "type": "category" if axis.words else "log" if axis.log else "linear",
        **(ticks if axis.ticks and not axis.words else {}), **GRID,
    }  # fmt: skip


def _chart(chart: Chart, laid: Layout) -> list[Words]:
    """The curves of panels and the bars of lanes."""
    data: list[Words] = []
    for k, row in enumerate(laid.rows, 1):
        if isinstance(row.part, Lanes):
            traces = [_bar(lane, bar, fits(bar, laid.x)) for lane, bar in row.part.bars]
        elif not isinstance(row.part, Field):
            curves = lines(row.part, laid.x)
            look = {"hovertemplate": f"%{{y:.5g}} {row.part.unit}", "showlegend": bool(row.names)}
            each = zip(curves, covered(curves))
            traces = [look | trace for curve, ends in each for trace in _curve(curve, *ends)]
        data += [trace | {"yaxis": f"y{k}", "legend": f"legend{k + 1}"} for trace in traces]
    if chart.second:
        unseen = {"hoverinfo": "skip", "showlegend": False}
        data.append(
            {"x": [None], "y": [None], "xaxis": "x2", "yaxis": f"y{len(laid.rows)}"} | unseen
        )
    return data


def _bar(lane: int, bar: Span, inside: bool) -> Words:
    """A bar of a lane, named inside or in the legend; hovering tells how long it lasts."""
    long = bar.last - bar.first
    return {
        "type": "bar", "orientation": "h", "base": [bar.first], "x": [long], "y": [lane],
        "offset": -0.42, "width": 0.84, "name": bar.text, "showlegend": not inside,
        "text": bar.text if inside else "", "textposition": "inside", "insidetextanchor": "middle",
        "hovertemplate": f"{long:.4g}", "marker": {"color": COLORS[bar.color] + FAINT},
    }  # fmt: skip


def _curve(curve: Curve, low: Samples, high: Samples) -> list[Words]:
    """A curve, after the band of its error if it is a line."""
    color, look = COLORS[curve.color], LOOKS[curve.look]
    x, y = np.asarray(curve.x), np.asarray(curve.y, float)
    few = thinned(x, y) if curve.error is None else (x, y)
    group: Words = {"legendgroup": curve.name, "line": {"width": 0}}
    drawn = group | {"name": curve.name, "marker": {"color": color, "size": 6}} | look
    drawn["line"] = {"color": color, "width": 1.6} | look.get("line", {})
    drawn |= {"x": numbers(few[0]), "y": numbers(few[1])}
    if curve.error is None:
        return [drawn]
    if curve.look in ("bars", "points", "linked"):
        below, above = map(numbers, curve.errors)
        error = {"array": above, "arrayminus": below, "symmetric": False}
        return [drawn | {"error_y": {"type": "data", **error, "thickness": 1.2, "width": 3}}]
    band = group | {"mode": "lines", "hoverinfo": "skip", "showlegend": False, "x": numbers(x)}
    fill = {"fill": "tonexty", "fillcolor": f"{color}33"}
    return [band | {"y": numbers(low)}, band | {"y": numbers(high)} | fill, drawn]


def _field(field: Field) -> list[Words]:
    """A quantity in colour, with levels and curves over it."""
    values = np.asarray(field.values, float)
    at = {"x": numbers(np.asarray(field.x.values)), "y": numbers(np.asarray(field.y.values))}
    sides = (("x", field.x), ("y", field.y))
    places = [f"{side.quantity} %{{{name}:.4g}} {side.unit}" for name, side in sides]
    heat: Words = at | {
        "type": "heatmap", "coloraxis": "coloraxis", "customdata": list(map(numbers, values)),
        "z": list(map(numbers, np.log10(values) if field.log else values)),
        "hovertemplate": "<br>".join([*places, f"{field.quantity} %{{customdata:.4g}}<extra></extra>"]),
    }  # fmt: skip
    data = [heat]
    for level in field.levels:
        over = np.asarray(values if level.values is None else level.values, float)
        contour = at | {"type": "contour", "showscale": False, "hoverinfo": "skip"}
        contour |= {"name": level.text, "legend": "legend2", "z": list(map(numbers, over))}
        contour["contours"] = {"coloring": "none", "start": level.at, "end": level.at, "size": 1}
        for color, wide in (("#202020", 4.0), ("#ffffff", 1.6)):
            line = {"line": {"color": color, "width": wide}, "showlegend": wide > 2}
            data.append(contour | line)
    for curve in field.curves:
        (drawn,) = _curve(curve, *covered([curve])[0])
        drawn["line"]["width"] = 3
        drawn["marker"] |= {"size": 9, "line": {"color": "white", "width": 1.5}}
        drawn["legend"] = "legend2"
        data.append(drawn | {"hovertemplate": f"%{{y:.5g}} {field.y.unit}"})
    return data


def numbers(values: Any) -> list[Any]:
    """Seven digits, which are more than a screen shows; words as they are."""
    return [
        v if isinstance(v, str) else float(f"{v:.7g}") if math.isfinite(v) else None
        for v in values.tolist()
    ]
