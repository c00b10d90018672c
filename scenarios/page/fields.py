"""A quantity in colour over a plane, for a page, in the words of plotly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .charts import HEIGHT, Curve, numbers, trace
from .motion import Samples


class Direction(NamedTuple):
    """An axis of the plane: quantity, unit, values, and whether they are drawn logarithmically."""

    quantity: str
    unit: str
    values: Samples
    log: bool = False

    @property
    def label(self) -> str:
        return f"{self.quantity} [{self.unit}]"


class Field(NamedTuple):
    """Values of shape (len(y), len(x)), nan where there is none, with curves drawn over them.

    The colours follow the logarithm of the values where `log` is set, which are then above 0.
    """

    title: str
    x: Direction
    y: Direction
    quantity: str
    values: Samples
    curves: Sequence[Curve] = ()
    log: bool = False


def told(field: Field) -> str:
    """The field in words, for those who do not see it."""
    low, high = np.nanmin(field.values), np.nanmax(field.values)
    over = f"{field.x.label} and {field.y.label}"
    return f"{field.title}: {field.quantity} from {low:.4g} to {high:.4g} over {over}."


def figure(field: Field) -> dict[str, Any]:
    """Data and layout for plotly."""
    values = np.asarray(field.values, float)
    shown = np.log10(values) if field.log else values
    rows = [numbers(row) for row in values]
    ticks = np.linspace(np.nanmin(shown), np.nanmax(shown), 6)
    words = [f"{10**tick if field.log else tick:.2g}" for tick in ticks]
    places = (
        f"{at.quantity} %{{{name}:.4g}} {at.unit}" for name, at in (("x", field.x), ("y", field.y))
    )
    layout: dict[str, Any] = {
        "height": 2.4 * HEIGHT,
        "margin": {"l": 64, "r": 12, "t": 8, "b": 50},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": "system-ui, sans-serif", "size": 13},
        "hovermode": "closest",
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    }
    for name, at in (("xaxis", field.x), ("yaxis", field.y)):
        kind = "log" if at.log else "linear"
        layout[name] = {"title": {"text": at.label}, "type": kind, "showgrid": False}
    heat = {
        "type": "heatmap",
        "x": numbers(np.asarray(field.x.values)),
        "y": numbers(np.asarray(field.y.values)),
        "z": [numbers(row) for row in shown],
        "customdata": rows,
        "colorscale": "Viridis",
        "colorbar": {
            "title": {"text": field.quantity, "side": "right"},
            "thickness": 12,
            "tickvals": ticks.tolist(),
            "ticktext": words,
        },
        "hovertemplate": f"{'<br>'.join(places)}<br>{field.quantity} %{{customdata:.4g}}<extra></extra>",
    }
    lines = [trace(curve, 1, field.y.unit, True) for curve in field.curves]
    for line in lines:
        line["line"]["width"] = 3
        line["marker"] |= {"line": {"color": "white", "width": 1.5}}
    return {"data": [heat, *lines], "layout": layout, "told": told(field), "title": field.title}
