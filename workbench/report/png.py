"""Pictures by matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .chart import (
    COLORS,
    SCALES,
    Chart,
    Curve,
    Field,
    Lanes,
    Panel,
    Picture,
    decades,
    fits,
    flags,
    height,
    stacked,
    width,
)
from .motion import Motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..answer import Show

STYLE: dict[Any, Any] = {
    "figure.dpi": 120,
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.titlesize": 10,
    "grid.alpha": 0.3,
    "legend.frameon": False,
}
LOOKS: dict[str, dict[str, Any]] = {
    "line": {"linewidth": 1.3},
    "theory": {"linewidth": 1.3, "linestyle": "--"},
    "points": {"linestyle": "none", "marker": "o", "markersize": 3.5},
    "linked": {"linewidth": 1.0, "marker": "o", "markersize": 3.0},
    "step": {"linewidth": 1.3, "drawstyle": "steps-mid"},
}
BESIDE, WIDE, LANE, LINE = 3, 6.5, 0.28, 0.17
LETTERS, ENTRY = 110.0, 8


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
    heights = [max(_tall(picture) for picture in row) for row in rows]
    figure: Figure = pyplot().figure(
        figsize=(WIDE * across if across > 1 else 8.0, sum(heights) + 0.5), layout="constrained"
    )
    grid = figure.subfigures(len(rows), across, height_ratios=heights, squeeze=False)
    for place, picture in zip(grid.flat, pictures):
        place.suptitle(_wrapped(picture.title, 85), fontsize=10)
        if isinstance(picture, Motion):
            _ghosts(place, picture)
        elif isinstance(picture, Field):
            _field(place, picture)
        else:
            _chart(place, picture)
    figure.suptitle(_wrapped(title, 9 * int(figure.get_figwidth())), fontweight="bold")
    return figure


def _wrapped(text: str, letters: int) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, letters))


def _tall(picture: Picture | Motion) -> float:
    """Inches."""
    if not isinstance(picture, Chart):
        return 5.2
    sizes = [_size(panel, len(picture.panels)) for panel in picture.panels]
    return sum(sizes) + 1.0 + LINE * max((f.lane + 1 for f in flags(picture, LETTERS)), default=0)


def _size(panel: Panel | Lanes, among: int) -> float:
    if isinstance(panel, Lanes):
        return LANE * len(panel.rows) + 0.2
    return {1: 3.4, 2: 2.5}.get(among, 1.9)


def _chart(place: Any, chart: Chart) -> None:
    """Panels above each other over one axis."""
    grid = place.subplots(
        len(chart.panels), 1, sharex=True, squeeze=False,
        height_ratios=[_size(panel, len(chart.panels)) for panel in chart.panels],
    )  # fmt: skip
    every = list(grid[:, 0])
    for axes, panel in zip(every, chart.panels):
        if isinstance(panel, Lanes):
            _lanes(axes, panel, width(chart))
            continue
        _curves(axes, panel)
        for level, dash in zip(panel.levels, cycle((":", "-."))):
            look = {"color": COLORS["black"], "linestyle": dash, "linewidth": 1.2}
            axes.axhline(level.at, label=level.text, **look)
        axes.set_ylabel(panel.lines)
        axes.set_ylim(*height(panel))
    raised = _flagged(every, chart)
    for axes, panel in zip(every, chart.panels):
        if isinstance(panel, Lanes) or len(panel.curves) + len(panel.levels) > 1:
            _legend(axes, raised if axes is every[0] else 0.0)
    _scaled(every[-1], "x", chart.log, width(chart))
    every[-1].set_xlabel(chart.x)
    if chart.second is not None:
        factor = chart.second.factor
        other = every[-1].secondary_xaxis(
            -0.32, functions=(lambda x: x * factor, lambda x: x / factor)
        )
        other.set_xlabel(f"[{chart.second.unit}]")


def _curves(axes: Axes, panel: Panel) -> None:
    """Bars beside each other, areas upon each other, all else as lines and points."""
    bars = [curve for curve in panel.curves if curve.look == "bars"]
    for curve, low, high in stacked(panel):
        color = COLORS[curve.color]
        if curve.look == "area":
            axes.fill_between(np.asarray(curve.x, float), low, high, color=color, alpha=0.35,
                              linewidth=0.0, label=curve.name)  # fmt: skip
        elif curve.look == "bars":
            _bars(axes, curve, bars.index(curve), len(bars))
        else:
            axes.plot(curve.x, curve.y, color=color, label=curve.name, **LOOKS[curve.look])
            if curve.error is not None and curve.look in ("points", "linked"):
                axes.vlines(curve.x, low, high, color=color, linewidth=1.0)
            elif curve.error is not None:
                axes.fill_between(np.asarray(curve.x, float), low, high, color=color, alpha=0.2)


def _bars(axes: Axes, curve: Curve, number: int, count: int) -> None:
    shift = (number - (count - 1) / 2) * 0.8 / count
    places = np.arange(len(curve.x)) + shift
    axes.bar(places, np.asarray(curve.y), 0.8 / count, color=COLORS[curve.color], label=curve.name,
             yerr=curve.error, capsize=3)  # fmt: skip
    axes.set_xticks(np.arange(len(curve.x)), list(map(str, curve.x)))


def _lanes(axes: Axes, panel: Lanes, ends: tuple[float, float] | None) -> None:
    """Lanes of bars, the first on top, with what they are inside."""
    names = list(panel.rows)
    for row, bar in panel.bars:
        long = bar.last - bar.first
        inside = fits(bar, ends, LETTERS)
        axes.barh(row, long, left=bar.first, height=0.8, color=COLORS[bar.color], alpha=0.35,
                      edgecolor="white", label="" if inside else bar.text)  # fmt: skip
        if inside:
            axes.annotate(bar.text, (bar.first + long / 2, row), ha="center", va="center",
                              fontsize=8)  # fmt: skip
    axes.set(ylim=(len(names) - 0.5, -0.5))
    axes.set_yticks(range(len(names)), names)
    axes.grid(visible=False)


def _flagged(every: Sequence[Axes], picture: Picture) -> float:
    """Marks, spans and their words above the first panel; how high these reach [pt]."""
    for axes in every:
        for span in picture.spans:
            color, over = COLORS[span.color], isinstance(picture, Field)
            if not over:
                axes.axvspan(span.first, span.last, color=color, alpha=0.12, linewidth=0)
            for end in (span.first, span.last):
                axes.axvline(end, color=color, linewidth=2.0 if over else 0.6)
        for mark in () if isinstance(picture, Field) else picture.marks:
            axes.axvline(mark.at, color=COLORS["black"], linestyle=":", linewidth=1.2)
    raised = 0.0
    for flag in flags(picture, LETTERS):
        above = 3 + 72 * LINE * flag.lane
        raised = max(raised, above + 72 * LINE)
        every[0].annotate(flag.text, (flag.at, 1.0), (0, above), ha="center", va="bottom",
                          xycoords=("data", "axes fraction"), textcoords="offset points",
                          fontsize=8, annotation_clip=False)  # fmt: skip
    return raised


def _legend(axes: Axes, raised: float) -> None:
    """Above the axes, never over a curve."""
    from matplotlib.transforms import ScaledTranslation

    figure: Any = axes.figure
    lift = ScaledTranslation(0, raised / 72, figure.dpi_scale_trans)
    entries = axes.get_legend_handles_labels()[1]
    if not entries:
        return
    columns = max(1, int(LETTERS / (max(map(len, entries)) + ENTRY)))
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), bbox_transform=axes.transAxes + lift,
                borderaxespad=0.2, ncols=min(columns, len(entries)), fontsize=8)  # fmt: skip


def _scaled(axes: Axes, name: str, log: bool, ends: tuple[float, float] | None) -> None:
    """The limits of an axis, and written out ticks on a logarithmic one."""
    from matplotlib.ticker import NullLocator

    if ends is None:
        return
    if log:
        getattr(axes, f"set_{name}scale")("log")
        ticks = decades(*ends)
        getattr(axes, f"set_{name}ticks")(ticks, [f"{tick:g}" for tick in ticks])
        getattr(axes, f"{name}axis").set_minor_locator(NullLocator())
    getattr(axes, f"set_{name}lim")(*ends)


def _field(place: Any, field: Field) -> None:
    """A quantity in colour, with levels and curves over it."""
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    axes = place.subplots()
    colors = LinearSegmentedColormap.from_list(field.scale, SCALES[field.scale])
    x, y = field.x.values, field.y.values
    mesh = axes.pcolormesh(x, y, field.values, shading="nearest", cmap=colors,
                           norm=LogNorm() if field.log else None)  # fmt: skip
    bar = place.colorbar(mesh, ax=axes, label=field.quantity, pad=0.02)
    if field.log:
        _scaled(bar.ax, "y", True, (np.nanmin(field.values), np.nanmax(field.values)))
    for level in field.levels:
        values = field.values if level.values is None else level.values
        for color, wide in (("black", 3.2), ("white", 1.4)):
            axes.contour(x, y, values, [level.at], colors=COLORS.get(color, color), linewidths=wide)
        axes.plot([], [], color=COLORS["black"], linewidth=2.4, label=level.text)
    for curve in field.curves:
        looks = LOOKS[curve.look] | {"linewidth": 2.0, "markersize": 5.0}
        axes.plot(curve.x, curve.y, color=COLORS[curve.color], label=curve.name, **looks)
    raised = _flagged([axes], field)
    for name, at in (("x", field.x), ("y", field.y)):
        if at.places and not at.log:
            getattr(axes, f"set_{name}ticks")(at.places)
        _scaled(axes, name, at.log, (float(at.values[0]), float(at.values[-1])))
        getattr(axes, f"set_{name}label")(at.label)
    axes.grid(visible=False)
    if field.curves or field.levels:
        _legend(axes, raised)


def _ghosts(place: Any, motion: Motion) -> None:
    """The ghosts of a motion, later ones darker, each with what is special about it."""
    axes = place.subplots()
    shades = np.linspace(0.25, 1.0, len(motion.ghosts))
    for shape in motion.shapes:
        for frame, shade in zip(motion.ghosts, shades):
            still = len(shape.points) == 1
            axes.plot(*shape.at(frame).T, color=COLORS[shape.color], linewidth=0.6 * shape.width,
                      alpha=1.0 if still else shade, solid_capstyle="round")  # fmt: skip
            if still:
                break
    moving = next(shape for shape in motion.shapes if len(shape.points) > 1)
    edge = motion.bounds[1][0]
    for frame, text in motion.ghosts.items():
        axes.annotate(text, (edge, moving.at(frame)[:, 1].mean()), (10, 0), textcoords="offset points",
                      fontsize=8, va="center")  # fmt: skip
    axes.set(aspect="equal")
    axes.set_axis_off()
