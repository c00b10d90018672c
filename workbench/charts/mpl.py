"""Pictures and motions by matplotlib."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .model import COLORS, Picture
from .motion import Motion
from .plotly import BELOW, INCH, SCREENS, SECOND, Words, columns, figure, legend_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE: dict[Any, Any] = {
    "figure.dpi": 120, "font.size": 9, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.alpha": 0.3, "legend.frameon": False, "legend.fontsize": 8,
}  # fmt: skip
DASHES = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}
STEPS = {"linear": "default", "hvh": "steps-mid"}
BESIDE, WIDE, ALONE, SQUARE, POINT = 3, 6.5, 8.0, 5.2, 0.8


def style() -> AbstractContextManager[None]:
    """Our style for a while, whatever that of the user is; backend and pyplot are left alone.

    It takes half a second to import, which waits for a picture.
    """
    from matplotlib.style import context

    wanted: AbstractContextManager[None] = context(["default", STYLE])
    return wanted


def draw(pictures: Sequence[Picture | Motion], title: str, path: Path) -> list[str]:
    """Write pictures and the still frames of motions to a file; return its name, if there are any."""
    if not pictures:
        return []
    path.parent.mkdir(parents=True, exist_ok=True)
    with style():
        drawn(pictures, title).savefig(path)
    return [path.name]


def drawn(pictures: Sequence[Picture | Motion], title: str) -> Figure:
    """The figure, with one subfigure for each picture, beside each other and in rows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    across = len(pictures) if len(pictures) <= BESIDE else math.ceil(math.sqrt(len(pictures)))
    words = [None if isinstance(each, Motion) else figure(each) for each in pictures]
    heights = [SQUARE if each is None else each["paper"]["height"] / INCH + 0.5 for each in words]
    rows = [max(heights[k : k + across]) for k in range(0, len(pictures), across)]
    wide = WIDE * across if across > 1 else ALONE
    whole = Figure(figsize=(wide, sum(rows) + 0.5), layout="constrained")
    FigureCanvasAgg(whole)
    whole.suptitle(textwrap.fill(title, int(9 * wide)), fontweight="bold")
    grid = whole.subfigures(len(rows), across, height_ratios=rows, squeeze=False)
    for place, picture, each in zip(grid.flat, pictures, words):
        place.suptitle(textwrap.fill(picture.title, 85), fontsize=10)
        if isinstance(picture, Motion):
            ghosts(place.subplots(), picture)
        elif each is not None:
            _picture(place, each["data"], each["paper"])
    return whole


def _picture(place: Any, data: Sequence[Words], laid: Words) -> None:
    """Rows above each other with spans through all of them, their legends, and words on top."""
    from matplotlib.transforms import ScaledTranslation

    rows = [axis for name, axis in laid.items() if name.startswith("yaxis")]
    ratios = [high - low for low, high in (row["domain"] for row in rows)]
    grid = place.subplots(len(rows), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
    for k, (axes, row) in enumerate(zip(grid, rows), 1):
        traces = [trace for trace in data if trace["yaxis"] == f"y{k}" and "xaxis" not in trace]
        for below, trace in zip([{}, *traces], traces):
            _trace(axes, trace, below, laid)
        _axis(axes, "y", row)
        axes.grid(visible=row["showgrid"])
        for shape in (shape for shape in laid["shapes"] if shape["yref"] == f"y{k} domain"):
            axes.axvspan(shape["x0"], shape["x1"], facecolor=shape["fillcolor"],
                         edgecolor=shape["line"]["color"], **_look(shape["line"]))  # fmt: skip
        up = (laid[f"legend{k + 1}"]["y"] - row["domain"][1]) * (laid["height"] - BELOW) / INCH
        above = axes.transAxes + ScaledTranslation(0.0, up, place.dpi_scale_trans)
        if names := legend_names(traces):
            beside = min(columns(names, SCREENS["paper"]), len(names))
            axes.legend(loc="upper left", bbox_to_anchor=(0, 1), bbox_transform=above,
                        borderaxespad=0.0, ncols=beside)  # fmt: skip
    _axis(grid[-1], "x", laid["xaxis"])
    for flag in laid["annotations"]:
        at = 10 ** flag["x"] if laid["xaxis"]["type"] == "log" else flag["x"], 1.0
        shift = (
            {"left": 2, "right": -2, "center": 0}[flag["xanchor"]],
            3 + 72 * flag["yshift"] / INCH,
        )
        grid[0].annotate(flag["text"], at, shift, ha=flag["xanchor"], va="bottom", fontsize=8,
                         xycoords=("data", "axes fraction"), textcoords="offset points",
                         annotation_clip=False)  # fmt: skip
    if "xaxis2" in laid:
        factor = laid["meta"]["factor"]
        convert = (lambda x: x * factor, lambda x: x / factor)
        below = -SECOND / ((laid["height"] - BELOW) * ratios[-1])
        second = grid[-1].secondary_xaxis(1.4 * below, functions=convert)
        second.set_xlabel(laid["xaxis2"]["title"]["text"])


def _axis(axes: Axes, name: str, words: Words) -> None:
    """Label, limits and ticks of an axis."""
    drawn: Any = getattr(axes, f"{name}axis")
    ends = np.power(10.0, words["range"]) if words["type"] == "log" else words["range"]
    label = words["title"]["text"].replace("<br>", "\n")
    axes.set(**{f"{name}label": label, f"{name}scale": words["type"]})
    if "tickvals" in words:
        drawn.set_ticks(words["tickvals"], labels=words["ticktext"])
        drawn.set_ticks([], minor=True)
    axes.set(**{f"{name}lim": ends})


def _look(line: Words) -> Any:
    """Width and dashes of a line."""
    return {"linewidth": POINT * line["width"], "linestyle": DASHES[line.get("dash", "solid")]}


def _trace(axes: Axes, trace: Words, below: Words, laid: Words) -> None:
    """A quantity in colour, bars, what is filled down to the trace below, or a line with points."""
    from matplotlib.colors import LinearSegmentedColormap

    x, y, kind, figure = (
        np.array(trace["x"], float),
        np.array(trace["y"], float),
        trace.get("type"),
        axes.figure,
    )
    label: Any = {"label": trace.get("name", "") if trace.get("showlegend") else ""}
    if kind == "heatmap":
        colors = LinearSegmentedColormap.from_list("", laid["coloraxis"]["colorscale"])
        mesh = axes.pcolormesh(x, y, np.array(trace["z"], float), shading="nearest", cmap=colors)
        bar, place = laid["coloraxis"]["colorbar"], figure.colorbar(mesh, ax=axes, pad=0.02)
        place.set_label(bar["title"]["text"])
        if "tickvals" in bar:
            place.set_ticks(bar["tickvals"], labels=bar["ticktext"])
    elif kind == "bar":
        base = np.array(trace["base"], float)
        bars = axes.bar(x + trace["offset"], y, trace["width"], base, align="edge",
                        color=trace["marker"]["color"], edgecolor="white", **label)  # fmt: skip
        axes.bar_label(bars, [trace.get("text", "")] * len(x), label_type="center", fontsize=8)
    elif "fill" in trace:
        back = np.array([below["x"], below["y"]], float)[:, ::-1]
        around = np.concatenate([[x, y], back], axis=1)
        around = around[:, np.isfinite(around[1])]
        axes.fill(*around, color=trace["fillcolor"], linewidth=0.0, **label)
    else:
        line, marker = trace["line"], trace["marker"]
        look = _look(line) if "lines" in trace["mode"] else {"linestyle": "none"}
        size = POINT * marker["size"] if "markers" in trace["mode"] else 0.0
        step = STEPS[line.get("shape", "linear")]
        axes.plot(x, y, color=line["color"], drawstyle=step, marker="o", markersize=size, **look,
                  **label)  # fmt: skip


def outlines(axes: Axes, motion: Motion, frame: int, shade: float = 1.0) -> None:
    """The shapes of a motion at a frame; what moves is as dark as its shade."""
    axes.set_axis_off()
    for shape in motion.shapes:
        dark = shade if len(shape.points) > 1 else 1.0
        axes.plot(*shape.at(frame).T, color=COLORS[shape.color], linewidth=0.7 * shape.width,
                  alpha=dark, solid_capstyle="round")  # fmt: skip


def ghosts(axes: Axes, motion: Motion) -> None:
    """The ghosts of a motion, later ones darker, each with what is special about it."""
    moving = next(shape for shape in motion.shapes if len(shape.points) > 1)
    shades = np.linspace(0.25, 1.0, len(motion.ghosts))
    for (frame, text), shade in zip(motion.ghosts.items(), shades):
        outlines(axes, motion, frame, shade)
        at = motion.bounds[1][0], moving.at(frame)[:, 1].mean()
        axes.annotate(text, at, (10, 0), textcoords="offset points", fontsize=8, va="center")
    axes.set(aspect="equal")
