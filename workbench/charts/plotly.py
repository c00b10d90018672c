"""A layout as a figure of plotly, for pages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from cosim.json_values import Json

from .axes import Axis
from .elements import Band, Bars, Element, Heat, Line
from .layout import ChartLayout, layout_of
from .model import Picture, Samples
from .style import COLORS, LETTERS_BY_SCREEN, STYLE, SYMBOLS, Dash, Marker, hex_color

PlotlyDict = dict[str, Json]

#: Digits of numbers on a page; chosen: more than a screen shows.
DIGITS = 7
#: The shades of a channel of a colour; a convention of CSS.
SHADES = 255
#: What all pictures of pages have.
BASE: PlotlyDict = {
    "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)", "hoversubplots": "axis",
    "font": {"family": "system-ui, sans-serif", "size": STYLE.axis_text_px},
}  # fmt: skip
#: The lines of the grid and those at 0.
GRID: PlotlyDict = {
    "gridcolor": f"rgba(128,128,128,{STYLE.grid_opacity})",
    "zerolinecolor": f"rgba(128,128,128,{2 * STYLE.grid_opacity})",
}
#: What the mouse does not show.
SILENT: PlotlyDict = {"hoverinfo": "skip"}
#: Where a label is from its line, by the end of it that is there.
SIDES = {"left": 1, "center": 0, "right": -1}
#: The symbols of plotly for shapes of points that have another name there.
PLOTLY_SYMBOLS = {"cross": "x"}


def figure(
    picture: Picture, max_paper_height_px: float = math.inf, *, has_data: bool = True
) -> dict[str, Json]:
    """Return a picture as plotly draws it: the traces as "data", and a layout for each kind of screen and for paper.

    Parameters
    ----------
    picture : Picture
        What to draw.
    max_paper_height_px : float
        Its height on paper at most.
    has_data : bool
        Whether it has data and ranges; a live page fills them in.
    """
    most = {"paper": max_paper_height_px}
    layouts = {x: layout_of(picture, x, most.get(x, math.inf)) for x in LETTERS_BY_SCREEN}
    by_screen = {str(x): plotly_layout(y, has_ranges=has_data) for x, y in layouts.items()}
    by_screen["paper"]["width"] = STYLE.paper_width_px
    empty: PlotlyDict = {} if has_data else {"x": [], "y": []}
    return {"data": [trace | empty for trace in traces(layouts["wide"])], **by_screen}


def traces(layout: ChartLayout) -> list[PlotlyDict]:
    """Return the traces of a layout, each on the axis of its row."""
    traces_of_rows = [
        trace | {"yaxis": f"y{k}"}
        for k, placed in enumerate(layout.rows, 1)
        for element in placed.row.elements
        for trace in element_traces(element)
    ]
    if layout.second:  # plotly draws an axis only for a trace
        axis_trace: PlotlyDict = {
            "x": [None],
            "y": [None],
            "xaxis": "x2",
            "yaxis": f"y{len(layout.rows)}",
        }
        traces_of_rows.append(axis_trace | SILENT)
    return traces_of_rows


def plotly_layout(layout: ChartLayout, *, has_ranges: bool = True) -> PlotlyDict:
    """Return the layout of plotly; without ranges of the axes for a picture that is filled in later."""
    last = f"y{len(layout.rows)}"
    x: PlotlyDict = _axis(layout.x, layout.x.label, has_range=has_ranges) | {
        "anchor": last, "spikethickness": 1, "spikecolor": COLORS["grey"],
    }  # fmt: skip
    if layout.x.is_log or not layout.x.ticks:
        x["unifiedhovertitle"] = {"text": f"{layout.x.label} %{{x:.5g}}"}
    parts = BASE | {
        "height": layout.height_px, "showlegend": False,
        "margin": {"l": STYLE.left_px, "r": STYLE.right_px + layout.names_px, "t": 0, "b": STYLE.below_px},
        "hovermode": "closest" if layout.is_plane else "x unified",
        "xaxis": x,
        "annotations": [*_labels(layout), *_name_annotations(layout), *_arrows(layout)],
        "shapes": list(_shapes(layout)) if has_ranges else [],
    }  # fmt: skip
    for k, placed in enumerate(layout.rows, 1):
        has_grid = not placed.row.y.ticks
        axis_settings: PlotlyDict = {
            "showgrid": has_grid, "zeroline": has_grid, "anchor": "x", "domain": layout.foot_and_top(placed)
        }  # fmt: skip
        parts[f"yaxis{k}"] = _axis(placed.row.y, placed.label, has_range=has_ranges) | axis_settings
        for heat in (each for each in placed.row.elements if isinstance(each, Heat)):
            parts["coloraxis"] = _color_axis(heat, layout.foot_and_top(placed))
    if layout.second:
        factor = layout.second.factor
        parts["meta"] = {"factor": factor}
        parts["xaxis2"] = {
            "title": {"text": f"[{layout.second.unit}]", "standoff": 2}, "overlaying": "x",
            "anchor": "free", "position": 0, "tickmode": "auto", "showgrid": False,
            **({"range": [factor * end for end in layout.x.ends]} if has_ranges else {}),
        }  # fmt: skip
    return parts


def alt_text(picture: Picture) -> str:
    """Return a picture in words, for those who do not see it."""
    layout = layout_of(picture)
    parts = []
    for placed in layout.rows:
        for element in placed.row.elements:
            if element.hover is None and not element.is_named:
                continue
            values = element.told
            if placed.row.y.label and np.isfinite(values).any():
                ends = f"from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"
                parts.append(f"{element.name} {ends} ({placed.row.y.label})")
            else:
                parts.append(element.name)
    parts += [label.text for label in layout.labels]
    return f"{picture.title}, over {layout.x.label}: {'; '.join(parts)}."


def element_traces(element: Element) -> list[PlotlyDict]:
    """Return the traces that draw an element."""
    match element:
        case Line():
            return [_line(element)]
        case Band():
            return _band(element)
        case Bars():
            return [_bars(element)]
        case Heat():
            return [_heat(element)]


def _line(line: Line) -> PlotlyDict:
    """A line, points, or both."""
    rows = rows_to_draw(line.y)
    sizes = {"lines": line.width_px, "markers": line.marker_px}
    modes = [mode for mode, size in sizes.items() if size > 0.0]
    return {
        **_named(line), "mode": "+".join(modes), "x": numbers(line.x[rows]), "y": numbers(line.y[rows]),
        "line": {
            "color": line.color, "width": line.width_px, "dash": line.dash,
            "shape": "hvh" if line.is_step else "linear",
        },
        "marker": {
            "color": line.color, "size": line.marker_px,
            "symbol": PLOTLY_SYMBOLS.get(line.marker, line.marker),
        },
    }  # fmt: skip


def _band(band: Band) -> list[PlotlyDict]:
    """Two lines without width, between which it is filled."""
    edges = []
    for y in (band.low, band.high):
        line = Line(band.name, band.x, y, band.color, is_named=False)
        edges.append(_line(line) | {"line": {"width": 0, "color": band.color}} | SILENT)
    upper = edges[1] | {"fill": "tonexty", "fillcolor": _faint(band.color, band.opacity)}
    if band.values is not None:
        values = numbers(band.values[rows_to_draw(band.high)])
        upper |= _named(band) | {"customdata": values, "hoverinfo": "all"}
    return [edges[0], upper]


def _bars(bars: Bars) -> PlotlyDict:
    """Bars, with their text inside."""
    color = bars.color if bars.opacity == 1.0 else _faint(bars.color, bars.opacity)
    text: PlotlyDict = {"text": bars.text} if bars.text else {}
    return {
        "type": "bar", **_named(bars), "x": numbers(bars.x), "y": numbers(bars.high - bars.low),
        "base": numbers(bars.low), "offset": bars.offset, "width": bars.width,
        "marker": {"color": color, "pattern": {"shape": "/" if bars.is_hatched else ""}}, "insidetextanchor": "middle", "textangle": 0, **text,
    }  # fmt: skip


def _heat(heat: Heat) -> PlotlyDict:
    """A plane in colour."""
    return {
        "type": "heatmap", **_named(heat), "coloraxis": "coloraxis", "x": numbers(heat.x),
        "y": numbers(heat.y), "z": list(map(numbers, heat.levels)),
        "customdata": list(map(numbers, heat.told)),
    }  # fmt: skip


def _color_axis(heat: Heat, shares: Sequence[float]) -> PlotlyDict:
    """The colours of a plane, and the bar that explains them beside it."""
    foot, top = shares
    bar: PlotlyDict = {
        "thickness": STYLE.color_bar_px, "yanchor": "bottom", "y": foot, "len": top - foot,
        "title": {"text": heat.axis.label, "side": "right"},
    }  # fmt: skip
    if heat.axis.ticks:
        ticks = np.array(list(heat.axis.ticks))
        bar["tickvals"] = (np.log10(ticks) if heat.axis.is_log else ticks).tolist()
        bar["ticktext"] = list(heat.axis.ticks.values())
    shades = np.linspace(0, 1, len(heat.colors)).tolist()
    return {"colorscale": list(zip(shades, heat.colors)), "colorbar": bar}


def _named(element: Element) -> PlotlyDict:
    """The name of an element and what the mouse tells of it."""
    named: PlotlyDict = {"name": element.name}
    if element.hover is None:
        return named | {"hoverinfo": "skip"}
    text = element.hover.replace("{value", "{customdata").replace("{", "%{")
    return named | {"hovertemplate": text + "<extra></extra>" * isinstance(element, Heat)}


def _axis(axis: Axis, label: str, *, has_range: bool) -> PlotlyDict:
    """Title, type, range and ticks of an axis."""
    ends = np.log10(axis.ends) if axis.is_log else axis.ends
    texts = [text.replace("\n", "<br>") for text in axis.ticks.values()]
    ticks: PlotlyDict = {"tickvals": list(axis.ticks), "ticktext": texts}
    standoff = 4 + 14 * label.count("\n")
    return {
        "title": {"text": label.replace("\n", "<br>"), "standoff": standoff},
        **({"range": list(map(float, ends))} if has_range else {}), "automargin": True,
        "type": "log" if axis.is_log else "linear", **(ticks if axis.ticks else {}), **GRID,
    }  # fmt: skip


def _labels(layout: ChartLayout) -> Iterable[PlotlyDict]:
    """The texts above the first row."""
    for label in layout.labels:
        yield {
            "text": label.text, "showarrow": False, "font": {"size": STYLE.label_text_px},
            "yref": "y domain", "y": 1, "xref": "x",
            "x": math.log10(label.at) if layout.x.is_log else label.at, "xanchor": label.anchor,
            "yanchor": "bottom", "yshift": STYLE.text_line_px * label.line,
            "xshift": STYLE.label_shift_px * SIDES[label.anchor],
        }  # fmt: skip


def _name_annotations(layout: ChartLayout) -> Iterable[PlotlyDict]:
    """The names of elements beside their ends; a click on one hides what it names."""
    for k, placed in enumerate(layout.rows, 1):
        for name in placed.names:
            look = name.element
            key: Dash | Marker = "square"
            if isinstance(look, Line):
                key = look.marker if look.marker_px else look.dash
            symbol = f'<span style="color:{look.color}">{SYMBOLS[key]}</span>'
            yield {
                "text": f"{symbol} {name.text}".replace("\n", "<br>"), "name": look.name,
                "showarrow": False, "align": "left", "captureevents": True,
                "font": {"size": STYLE.label_text_px}, "xref": "x domain", "x": name.x,
                "xanchor": "left", "xshift": STYLE.label_shift_px, "yref": f"y{k} domain",
                "y": name.y, "yanchor": "middle",
            }  # fmt: skip


def _arrows(layout: ChartLayout) -> Iterable[PlotlyDict]:
    """The arrows of jumps."""
    for k, placed in enumerate(layout.rows, 1):
        for arrow in placed.row.arrows:
            x = math.log10(arrow.x) if layout.x.is_log else arrow.x
            yield {
                "text": "", "showarrow": True, "arrowhead": 2, "arrowcolor": hex_color(arrow.color),
                "arrowwidth": STYLE.line_width_px, "x": x, "xref": "x", "y": arrow.end,
                "yref": f"y{k}", "ax": x, "axref": "x", "ay": arrow.start, "ayref": f"y{k}",
            }  # fmt: skip


def _shapes(layout: ChartLayout) -> Iterable[PlotlyDict]:
    """Spans and marks through all rows; the lines of marks lead up to their texts."""
    plane = layout.is_plane
    edge = STYLE.plane_span_edge_px if plane else STYLE.span_edge_px
    opacity = 0.0 if plane else STYLE.span_opacity
    spans: list[tuple[float, float, str, float, PlotlyDict]] = [
        (span.first, span.last, span.color, 0.0, {"width": edge}) for span in layout.picture.spans
    ]
    line: PlotlyDict = {"dash": "dot", "width": STYLE.mark_width_px}
    spans += [
        (mark.at, mark.at, "grey", layout.leader_px(mark), line) for mark in layout.picture.marks
    ]
    for k, placed in enumerate(layout.rows, 1):
        for first, last, color, leader, look in spans:
            top = 1 + (leader / placed.height_px if k == 1 else 0.0)
            yield {
                "type": "rect", "yref": f"y{k} domain", "y0": 0, "y1": top, "x0": first, "x1": last,
                "fillcolor": _faint(hex_color(color), opacity), "layer": "above" if plane else "below",
                "line": {"color": hex_color(color), **look},
            }  # fmt: skip


def _faint(color: str, opacity: float) -> str:
    """A colour that lets others through."""
    return f"{color}{round(opacity * SHADES):02x}"


def rows_to_draw(y: Samples) -> list[int]:
    """Return at most `max_points` rows in order: the ends, and of every stretch the smallest and the largest number.

    A stretch with rows that are no finite number keeps one of them, so that its gap is seen.
    """
    if len(y) <= STYLE.max_points:
        return list(range(len(y)))
    gaps = ~np.isfinite(y)
    rows = {0, len(y) - 1}
    for stretch in np.array_split(
        np.arange(len(y)), (STYLE.max_points - 2) // (3 if gaps.any() else 2)
    ):
        known = stretch[~gaps[stretch]]
        if len(known):
            rows |= {int(known[np.argmin(y[known])]), int(known[np.argmax(y[known])])}
        if len(known) < len(stretch):
            rows.add(int(stretch[np.argmax(gaps[stretch])]))
    return sorted(rows)


def numbers(values: Samples) -> list[float | None]:
    """Return values with a few digits, and None for those that are not finite."""
    rounded = (float(f"{value:.{DIGITS}g}") for value in values.tolist())
    return [value if math.isfinite(value) else None for value in rounded]
