"""Curves for a page: panels above each other over one axis, in the words of plotly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from .motion import COLORS, Samples

MOST = 2000
HEIGHT, GAP, BELOW = 190, 42, 50


class Curve(NamedTuple):
    """y over x, drawn as a "line", as "points" or, dashed, as "theory"."""

    name: str
    x: Sequence[float] | Samples
    y: Sequence[float] | Samples
    color: str
    look: str = "line"


class Mark(NamedTuple):
    """A place on the x axis, or on the y axis of a panel, and what is there."""

    at: float
    text: str


class Panel(NamedTuple):
    """Curves over one y axis of a quantity and its unit; `levels` are marks on it."""

    quantity: str
    unit: str
    curves: Sequence[Curve]
    levels: Sequence[Mark] = ()

    @property
    def label(self) -> str:
        return f"{self.quantity} [{self.unit}]"


class Chart(NamedTuple):
    """Panels over one x axis; `marks` are places on it."""

    title: str
    x: str
    panels: Sequence[Panel]
    marks: Sequence[Mark] = ()


def thinned(x: Samples, y: Samples, most: int = MOST) -> tuple[Samples, Samples]:
    """At most so many points: the ends, and the smallest and largest of every stretch in order."""
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2).astype(int)
    kept = {0, len(x) - 1}
    for first, last in pairwise(edges.tolist()):
        kept |= {first + int(np.argmin(y[first:last])), first + int(np.argmax(y[first:last]))}
    rows = sorted(kept)
    return x[rows], y[rows]


def told(chart: Chart) -> str:
    """The chart in words, for those who do not see it."""
    spans = [
        f"{curve.name} from {np.nanmin(curve.y):.4g} to {np.nanmax(curve.y):.4g} ({panel.label})"
        for panel in chart.panels
        for curve in panel.curves
    ]
    return f"{chart.title}, over {chart.x}: {'; '.join(spans)}."


def figure(chart: Chart) -> dict[str, Any]:
    """Data and layout for plotly."""
    count = len(chart.panels)
    inside = (HEIGHT + GAP) * count
    grid = {"gridcolor": "rgba(128,128,128,.25)", "zerolinecolor": "rgba(128,128,128,.5)"}
    layout: dict[str, Any] = {
        "height": inside + BELOW,
        "margin": {"l": 64, "r": 12, "t": 0, "b": BELOW},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": "system-ui, sans-serif", "size": 13},
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "xaxis": {
            "title": {"text": chart.x},
            "anchor": f"y{count}",
            "unifiedhovertitle": {"text": f"{chart.x} %{{x:.5g}}"},
            "spikethickness": 1,
            "spikecolor": COLORS["grey"],
            **grid,
        },
        "shapes": [],
        "annotations": _marks(chart),
    }
    data = []
    for k, panel in enumerate(chart.panels, 1):
        bottom = (count - k) * (HEIGHT + GAP) / inside
        top, y = bottom + HEIGHT / inside, f"y{k}"
        layout[f"yaxis{k}"] = {
            "title": {"text": panel.label, "standoff": 6},
            "domain": [bottom, top],
            "anchor": "x",
            **grid,
        }
        layout[_legend(k)] = {"orientation": "h", "y": top, "yanchor": "bottom", "x": 0}
        data += [trace(curve, k, panel.unit, len(panel.curves) > 1) for curve in panel.curves]
        for level in panel.levels:
            layout["shapes"].append(
                _stroke(x0=0, x1=1, xref="paper", y0=level.at, y1=level.at, yref=y)
            )
            layout["annotations"].append(
                _label(
                    level, x=1, xref="paper", xanchor="right", y=level.at, yref=y, yanchor="bottom"
                )
            )
    for mark in chart.marks:
        layout["shapes"].append(
            _stroke(x0=mark.at, x1=mark.at, y0=0, y1=1 - GAP / inside, yref="paper")
        )
    return {"data": data, "layout": layout, "told": told(chart), "title": chart.title}


def _marks(chart: Chart) -> list[dict[str, Any]]:
    """The words of the marks along their lines; those close together in one panel each."""
    count = len(chart.panels)
    ends = [
        end
        for panel in chart.panels
        for curve in panel.curves
        for end in (np.nanmin(curve.x), np.nanmax(curve.x))
    ]
    near = 0.03 * (max(ends) - min(ends))
    labels: list[dict[str, Any]] = []
    before, lane = -math.inf, 0
    for mark in sorted(chart.marks):
        lane = lane + 1 if mark.at - before < near else 0
        before = mark.at
        bottom = (count - 1 - lane % count) / count
        place = {
            "x": mark.at,
            "xanchor": "right",
            "y": bottom,
            "yref": "paper",
            "yanchor": "bottom",
        }
        labels.append(_label(mark, textangle=-90, yshift=HEIGHT / 2 * (lane // count), **place))
    return labels


def _legend(panel: int) -> str:
    """What plotly calls the legend of a panel."""
    return "legend" if panel == 1 else f"legend{panel}"


def trace(curve: Curve, panel: int, unit: str, legend: bool) -> dict[str, Any]:
    """A curve of a panel, with the unit that hovering tells."""
    x, y = thinned(np.asarray(curve.x, float), np.asarray(curve.y, float))
    return {
        "type": "scatter",
        "name": curve.name,
        "legend": _legend(panel),
        "legendgroup": curve.name,
        "showlegend": legend,
        "mode": "markers" if curve.look == "points" else "lines",
        "x": numbers(x),
        "y": numbers(y),
        "xaxis": "x",
        "yaxis": f"y{panel}",
        "hovertemplate": f"%{{y:.5g}} {unit}",
        "line": {
            "color": COLORS[curve.color],
            "width": 1.6,
            "dash": "dash" if curve.look == "theory" else "solid",
        },
        "marker": {"color": COLORS[curve.color], "size": 7},
    }


def numbers(values: Samples) -> list[float | None]:
    """Seven digits are more than a screen shows."""
    return [float(f"{v:.7g}") if math.isfinite(v) else None for v in values.tolist()]


def _stroke(**places: Any) -> dict[str, Any]:
    return {
        "type": "line",
        "line": {"color": COLORS["green"], "width": 1.2, "dash": "dot"},
        **places,
    }


def _label(mark: Mark, **places: Any) -> dict[str, Any]:
    return {
        "text": mark.text,
        "showarrow": False,
        "font": {"size": 11},
        **places,
    }
