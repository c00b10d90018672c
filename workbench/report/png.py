"""Pictures by matplotlib."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .chart import COLORS, SCALES, Chart, Field, Lanes, Panel, Picture
from .layout import LINE, Axis, colored, columns, covered, fits, layout, lines
from .motion import Motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..answer import Show

STYLE: dict[Any, Any] = {
    "figure.dpi": 120, "font.size": 9, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.alpha": 0.3, "legend.frameon": False, "legend.fontsize": 8,
}  # fmt: skip
LOOKS: dict[str, dict[str, Any]] = {
    "line": {"linewidth": 1.3},
    "theory": {"linewidth": 1.3, "linestyle": "--"},
    "level": {"linewidth": 1.3, "linestyle": ":"},
    "limit": {"linewidth": 1.3, "linestyle": "-."},
    "points": {"linestyle": "none", "marker": "o", "markersize": 3.5},
    "linked": {"linewidth": 1.0, "marker": "o", "markersize": 3.0},
    "step": {"linewidth": 1.3, "drawstyle": "steps-mid"},
}
BESIDE, WIDE, ALONE, SQUARE, LETTERS = 3, 6.5, 8.0, 5.2, 110


@cache
def pyplot() -> Any:
    """matplotlib's pyplot for files, in our style; a second to import, which waits for a picture."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams.update(STYLE)
    from matplotlib import pyplot as plt

    return plt


def draw(show: Show, title: str, path: Path) -> list[str]:
    """Write what is worth a picture: the ghosts of motions and the charts; the file's name, if any."""
    pictures = [*(motion for motion in show.motions if motion.ghosts), *show.charts]
    if not pictures:
        return []
    path.parent.mkdir(parents=True, exist_ok=True)
    figure = drawn(pictures, show.title or title)
    figure.savefig(path)
    pyplot().close(figure)
    return [path.name]


def drawn(pictures: Sequence[Picture | Motion], title: str) -> Figure:
    """The figure, with one subfigure for each picture, beside each other and in rows."""
    across = len(pictures) if len(pictures) <= BESIDE else math.ceil(math.sqrt(len(pictures)))
    rows = [pictures[k : k + across] for k in range(0, len(pictures), across)]
    heights = [max(map(_tall, row)) for row in rows]
    wide = WIDE * across if across > 1 else ALONE
    figure: Figure = pyplot().figure(figsize=(wide, sum(heights) + 0.5), layout="constrained")
    figure.suptitle(textwrap.fill(title, int(9 * wide)), fontweight="bold")
    grid = figure.subfigures(len(rows), across, height_ratios=heights, squeeze=False)
    for place, picture in zip(grid.flat, pictures):
        place.suptitle(textwrap.fill(picture.title, 85), fontsize=10)
        if isinstance(picture, Motion):
            _ghosts(place.subplots(), picture)
        else:
            _picture(place, picture)
    return figure


def _tall(picture: Picture | Motion) -> float:
    """Inches."""
    if isinstance(picture, Motion):
        return SQUARE
    return 1.0 + sum(row.height + row.above for row in layout(picture, LETTERS).rows)


def _picture(place: Any, picture: Picture) -> None:
    """The rows of a picture above each other, marks and spans over them, their words on top."""
    x, rows, flags, raised = layout(picture, LETTERS)
    ratios = [row.height for row in rows]
    grid = place.subplots(len(rows), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
    for axes, row in zip(grid, rows):
        draws: Any = {Panel: _curves, Lanes: _lanes, Field: _field}[type(row.part)]
        draws(axes, row.part, x)
        _axis(axes, "y", row.y)
        for span in picture.spans:
            filled = 0.0 if isinstance(picture, Field) else 0.13
            axes.axvspan(span.first, span.last, color=COLORS[span.color], alpha=filled, linewidth=0)
            for end in (span.first, span.last):
                axes.axvline(end, color=COLORS[span.color], linewidth=0.6 if filled else 2.0)
        for mark in picture.marks:
            axes.axvline(mark.at, color=COLORS["black"], linestyle=":", linewidth=1.2)
        if row.names:
            _legend(axes, row.names, raised if axes is grid[0] else 0.0)
    for flag in flags:
        shift = {"left": 2, "right": -2, "center": 0}[flag.anchor], 3 + 72 * LINE * flag.lane
        grid[0].annotate(flag.text, (flag.at, 1.0), shift, ha=flag.anchor, va="bottom",
                         xycoords=("data", "axes fraction"), textcoords="offset points",
                         fontsize=8, annotation_clip=False)  # fmt: skip
    _axis(grid[-1], "x", x)
    if isinstance(picture, Chart) and picture.second is not None:
        factor = picture.second.factor
        convert = (lambda x: x * factor, lambda x: x / factor)
        grid[-1].secondary_xaxis(-0.27, functions=convert).set_xlabel(f"[{picture.second.unit}]")


def _axis(axes: Axes, name: str, axis: Axis) -> None:
    """Label, limits and ticks of an axis."""
    drawn: Any = getattr(axes, f"{name}axis")
    axes.set(**{f"{name}label": axis.label, f"{name}scale": "log" if axis.log else "linear"})
    if axis.ticks:
        drawn.set_ticks(list(axis.ticks), labels=list(axis.ticks.values()))
        drawn.set_ticks([], minor=True)
    axes.set(**{f"{name}lim": axis.ends})


def _legend(axes: Axes, names: Sequence[str], raised: float) -> None:
    """Above the axes and the flags, never over a curve."""
    from matplotlib.transforms import ScaledTranslation

    figure: Any = axes.figure
    above = axes.transAxes + ScaledTranslation(0, raised, figure.dpi_scale_trans)
    beside = min(columns(names, LETTERS), len(names))
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), bbox_transform=above, borderaxespad=0.2,
                ncols=beside)  # fmt: skip


def _curves(axes: Axes, panel: Panel, x: Axis) -> None:
    """Bars beside each other, areas upon each other, all else as lines and points."""
    curves = lines(panel, x)
    bars = [curve for curve in curves if curve.look == "bars"]
    for curve, (low, high) in zip(curves, covered(curves)):
        places: Any = np.arange(len(curve.x)) if x.words else np.asarray(curve.x, float)
        name: Any = {"color": COLORS[curve.color], "label": curve.name}
        faint: Any = {"color": COLORS[curve.color], "linewidth": 0.0}
        if curve.look == "area":
            axes.fill_between(places, low, high, alpha=0.35, label=curve.name, **faint)
        elif curve.look == "bars":
            wide = 0.8 / len(bars)
            shifted = places + (bars.index(curve) - (len(bars) - 1) / 2) * wide
            axes.bar(shifted, np.asarray(curve.y), wide, yerr=curve.errors, capsize=3, **name)
        else:
            axes.plot(places, curve.y, **name, **LOOKS[curve.look])
            if curve.error is not None and curve.look in ("points", "linked"):
                axes.vlines(places, low, high, color=COLORS[curve.color], linewidth=1.0)
            elif curve.error is not None:
                axes.fill_between(places, low, high, alpha=0.2, **faint)


def _lanes(axes: Axes, lanes: Lanes, x: Axis) -> None:
    """Lanes of bars, with what they are inside or in the legend."""
    for row, bar in lanes.bars:
        inside = fits(bar, x)
        drawn = axes.barh(row, bar.last - bar.first, left=bar.first, color=COLORS[bar.color],
                          alpha=0.35, edgecolor="white", label="" if inside else bar.text)  # fmt: skip
        axes.bar_label(drawn, [bar.text if inside else ""], label_type="center", fontsize=8)
    axes.grid(visible=False)


def _field(axes: Axes, field: Field, _: Axis) -> None:
    """A quantity in colour, with levels and curves over it."""
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    colors = LinearSegmentedColormap.from_list(field.scale, SCALES[field.scale])
    x, y = field.x.values, field.y.values
    mesh = axes.pcolormesh(x, y, field.values, shading="nearest", cmap=colors,
                           norm=LogNorm() if field.log else None)  # fmt: skip
    figure: Any = axes.figure
    bar = figure.colorbar(mesh, ax=axes, pad=0.02)
    _axis(bar.ax, "y", colored(field))
    for level in field.levels:
        values = field.values if level.values is None else level.values
        for color, wide in (("black", 3.2), ("white", 1.4)):
            axes.contour(x, y, values, [level.at], colors=color, linewidths=wide)
        axes.plot([], [], color="black", linewidth=2.4, label=level.text)
    for curve in field.curves:
        looks = LOOKS[curve.look] | {"linewidth": 2.0, "markersize": 5.0, "clip_on": False}
        axes.plot(curve.x, curve.y, color=COLORS[curve.color], label=curve.name, **looks)
    axes.grid(visible=False)


def outlines(axes: Axes, motion: Motion, frame: int, shade: float = 1.0) -> None:
    """The shapes of a motion at a frame; what moves is as dark as its shade."""
    axes.set_axis_off()
    for shape in motion.shapes:
        dark = shade if len(shape.points) > 1 else 1.0
        axes.plot(*shape.at(frame).T, color=COLORS[shape.color], linewidth=0.7 * shape.width,
                  alpha=dark, solid_capstyle="round")  # fmt: skip


def _ghosts(axes: Axes, motion: Motion) -> None:
    """The ghosts of a motion, later ones darker, each with what is special about it."""
    moving = next(shape for shape in motion.shapes if len(shape.points) > 1)
    shades = np.linspace(0.25, 1.0, len(motion.ghosts))
    for (frame, text), shade in zip(motion.ghosts.items(), shades):
        outlines(axes, motion, frame, shade)
        at = motion.bounds[1][0], moving.at(frame)[:, 1].mean()
        axes.annotate(text, at, (10, 0), textcoords="offset points", fontsize=8, va="center")
    axes.set(aspect="equal")
