"""Layouts and the still frames of motions as an image, by matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .axes import Axis
from .elements import Band, Bars, Element, Heat, Line
from .labels import Label, Name, wrapped
from .layout import ChartLayout, PlacedRow, layout_of
from .model import Arrow, Picture
from .motion import Motion
from .style import COLORS, PT_PER_INCH, PX_PER_INCH, STYLE, hex_color

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

RC_PARAMETERS: dict[str, object] = {
    "figure.dpi": STYLE.image_dpi, "font.size": STYLE.image_text_pt, "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "grid.alpha": STYLE.grid_opacity,
}  # fmt: skip
#: The dashes of matplotlib; a long dash is 8 times as long as the line is wide, and so is no dash of theory.
DASHES = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-.", "longdash": (0, (8, 2))}
HATCH = "//"
MATPLOTLIB_MARKERS = {
    "circle": "o", "square": "s", "diamond": "D", "triangle-up": "^", "triangle-down": "v",
    "pentagon": "p", "cross": "X",
}  # fmt: skip
#: Points in a pixel of the layout; derived from both units.
PT_PER_PX = PT_PER_INCH / PX_PER_INCH


def style() -> AbstractContextManager[None]:
    """Return a context with our style, whatever that of the user is; backend and pyplot are left alone.

    It takes half a second to import, which waits for a picture.
    """
    from matplotlib.style import context

    with_style: AbstractContextManager[None] = context(["default", RC_PARAMETERS])
    return with_style


def draw(pictures: Sequence[Picture | Motion], title: str, path: Path) -> None:
    """Write pictures and the still frames of motions to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with style():
        render(pictures, title).savefig(path)


def render(pictures: Sequence[Picture | Motion], title: str) -> Figure:
    """Return the figure, with one subfigure for each picture, beside each other and in rows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fits_in_row = len(pictures) <= STYLE.max_pictures_across
    across = len(pictures) if fits_in_row else math.ceil(math.sqrt(len(pictures)))
    layouts = [None if isinstance(each, Motion) else layout_of(each, "paper") for each in pictures]
    heights = [
        layout.height_px / PX_PER_INCH + STYLE.title_height_in if layout else STYLE.still_height_in
        for layout in layouts
    ]
    rows = [max(heights[k : k + across]) for k in range(0, len(pictures), across)]
    width = STYLE.image_width_in * across if across > 1 else STYLE.single_image_width_in
    size = width, sum(rows) + STYLE.title_height_in
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    letters = int(STYLE.title_letters_per_in * width)
    figure.suptitle("\n".join(wrapped(title, letters)), fontweight="bold")
    grid = figure.subfigures(len(rows), across, height_ratios=rows, squeeze=False)
    for subfigure, picture, layout in zip(grid.flat, pictures, layouts):
        lines = "\n".join(wrapped(picture.title, STYLE.picture_title_letters))
        subfigure.suptitle(lines, fontsize=STYLE.image_title_pt)
        if isinstance(picture, Motion):
            ghosts(subfigure.subplots(), picture)
        elif layout:
            _picture(subfigure, layout)
    return figure


def _picture(subfigure: SubFigure, layout: ChartLayout) -> None:
    """Rows below each other with spans through all of them, and labels on top."""
    heights = [placed.height_px for placed in layout.rows]
    count = len(heights)
    grid = subfigure.subplots(count, 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axes, placed in zip(grid, layout.rows):
        _row(axes, placed, layout)
    _axis(grid[-1], "x", layout.x, layout.x.label)
    for label in layout.labels:
        _label(grid[0], label)
    if layout.second:
        factor = layout.second.factor
        convert = (lambda x: x * factor, lambda x: x / factor)
        # the second axis stands below the label of the first, which constrained layout makes room for
        below = -1.4 * STYLE.second_axis_px / heights[-1] * sum(heights) / layout.plot_px
        second = grid[-1].secondary_xaxis(below, functions=convert)
        second.set_xlabel(f"[{layout.second.unit}]")


def _row(axes: Axes, placed: PlacedRow, layout: ChartLayout) -> None:
    """Draw the elements, arrows, spans, marks and names of a row."""
    row = placed.row
    for element in row.elements:
        _element(axes, element)
    for arrow in row.arrows:
        _arrow(axes, arrow)
    _axis(axes, "y", row.y, placed.label)
    axes.grid(visible=not row.y.ticks)
    is_plane = layout.is_plane
    width = STYLE.plane_span_edge_px if is_plane else STYLE.span_edge_px
    for span in layout.picture.spans:
        color = hex_color(span.color)
        face = (color, 0.0 if is_plane else STYLE.span_opacity)
        axes.axvspan(span.first, span.last, facecolor=face, edgecolor=color, linewidth=_pt(width))
    for mark in layout.picture.marks:
        top = layout.leader_px(mark) / placed.height_px if placed is layout.rows[0] else 0.0
        axes.axvline(
            mark.at, ymax=1.0 + top, color=COLORS["grey"], linewidth=_pt(STYLE.mark_width_px),
            linestyle=":", clip_on=False,
        )  # fmt: skip
    for name in placed.names:
        _name(axes, name)


def _name(axes: Axes, name: Name) -> None:
    """Write the name of an element beside its end, behind a piece of it."""
    from matplotlib.lines import Line2D
    from matplotlib.offsetbox import AnnotationBbox, DrawingArea
    from matplotlib.patches import Rectangle
    from matplotlib.patheffects import withStroke

    gap, long, high = (_pt(x) for x in (STYLE.label_shift_px, STYLE.handle_px, STYLE.arrow_head_px))
    x = name.element
    if isinstance(x, Line):
        ends = [0.0, long / 2, long], [high / 2] * 3
        piece: Artist = Line2D(*ends, color=x.color, markevery=[1], **_line_look(x))
    else:
        hatch = HATCH if isinstance(x, Bars) and x.is_hatched else None
        face = (x.color, x.opacity)
        piece = Rectangle((0.0, 0.0), long, high, facecolor=face, edgecolor="white", hatch=hatch)
    area = DrawingArea(long, high)
    area.add_artist(piece)
    at = name.x, name.y
    axes.add_artist(AnnotationBbox(
        area, at, (gap, 0.0), "axes fraction", boxcoords="offset points", box_alignment=(0.0, 0.5),
        frameon=False, pad=0.0, annotation_clip=False,
    ))  # fmt: skip
    axes.annotate(
        name.text, at, (gap + _pt(STYLE.symbol_px), 0.0), va="center", fontsize=STYLE.image_label_pt,
        xycoords="axes fraction", textcoords="offset points", annotation_clip=False, linespacing=1.0,
        path_effects=[withStroke(linewidth=_pt(STYLE.halo_px), foreground="white")],
    )  # fmt: skip


def _label(axes: Axes, label: Label) -> None:
    """Write a label above the first row."""
    sideways = {"left": 1, "center": 0, "right": -1}[label.anchor]
    up = STYLE.label_shift_px + STYLE.text_line_px * label.line
    shift = _pt(STYLE.label_shift_px * sideways), _pt(up)
    axes.annotate(
        label.text, (label.at, 1.0), shift, ha=label.anchor, va="bottom",
        fontsize=STYLE.image_label_pt, xycoords=("data", "axes fraction"), textcoords="offset points",
        annotation_clip=False,
    )  # fmt: skip


def _axis(axes: Axes, name: str, axis: Axis, label: str) -> None:
    """Label, limits and ticks of an axis."""
    of_axes = axes.xaxis if name == "x" else axes.yaxis
    scale = "log" if axis.is_log else "linear"
    axes.set(**{f"{name}label": label, f"{name}scale": scale})
    if axis.ticks:
        texts = list(axis.ticks.values())
        of_axes.set_ticks(list(axis.ticks), labels=texts, fontsize=STYLE.image_label_pt)
        of_axes.set_ticks([], minor=True)
    axes.set(**{f"{name}lim": axis.ends})


def _pt(length_px: float) -> float:
    """A length in points."""
    return PT_PER_PX * length_px


def _element(axes: Axes, element: Element) -> None:
    """Draw an element."""
    match element:
        case Line():
            _line(axes, element)
        case Band():
            _band(axes, element)
        case Bars():
            _bars(axes, element)
        case Heat():
            _heat(axes, element)


def _line(axes: Axes, line: Line) -> None:
    """Draw a line, points, or both."""
    step = "steps-mid" if line.is_step else "default"
    axes.plot(line.x, line.y, color=line.color, label=line.name, drawstyle=step, **_line_look(line))


def _line_look(line: Line) -> dict[str, Any]:
    """Width and dash of a line, and shape and size of its points."""
    return {
        "linewidth": _pt(line.width_px), "linestyle": DASHES[line.dash] if line.width_px else "none",
        "marker": MATPLOTLIB_MARKERS[line.marker], "markersize": _pt(line.marker_px),
    }  # fmt: skip


def _band(axes: Axes, band: Band) -> None:
    """Fill what lies between two lines."""
    axes.fill_between(
        band.x, band.low, band.high, color=(band.color, band.opacity), linewidth=0.0,
        label=band.name,
    )  # fmt: skip


def _bars(axes: Axes, bars: Bars) -> None:
    """Draw bars, with their text inside."""
    artist = axes.bar(
        bars.x + bars.offset, bars.high - bars.low, bars.width, bars.low, align="edge",
        color=(bars.color, bars.opacity), edgecolor="white", label=bars.name,
        hatch=HATCH if bars.is_hatched else None,
    )  # fmt: skip
    texts = [bars.text] * len(bars.x)
    axes.bar_label(artist, texts, label_type="center", fontsize=STYLE.image_label_pt)


def _heat(axes: Axes, heat: Heat) -> None:
    """Draw a plane in colour, and the bar that explains the colours beside it."""
    from matplotlib.colors import LinearSegmentedColormap

    colors = LinearSegmentedColormap.from_list("", list(heat.colors))
    mesh = axes.pcolormesh(heat.x, heat.y, heat.levels, shading="nearest", cmap=colors)
    bar = axes.figure.colorbar(mesh, ax=axes, pad=0.02)
    bar.set_label(heat.axis.label)
    if heat.axis.ticks:
        ticks = np.array(list(heat.axis.ticks))
        levels = np.log10(ticks) if heat.axis.is_log else ticks
        bar.set_ticks(levels.tolist(), labels=list(heat.axis.ticks.values()))


def _arrow(axes: Axes, arrow: Arrow) -> None:
    """Draw an arrow."""
    axes.annotate(
        "", (arrow.x, arrow.end), (arrow.x, arrow.start),
        arrowprops={
            "arrowstyle": "-|>", "color": hex_color(arrow.color), "shrinkA": 0.0, "shrinkB": 0.0,
            "linewidth": _pt(STYLE.line_width_px), "mutation_scale": STYLE.arrow_head_px,
        },
    )  # fmt: skip


def outlines(axes: Axes, motion: Motion, frame: int, opacity: float = 1.0) -> None:
    """Draw the shapes of a motion at a frame; what moves is as opaque as asked for."""
    axes.axis("off")
    for shape in motion.shapes:
        is_moving = len(shape.points) > 1
        axes.plot(
            *shape.at(frame).T, color=COLORS[shape.color], alpha=opacity if is_moving else 1.0,
            linewidth=_pt(shape.width), solid_capstyle="round",
        )  # fmt: skip


def ghosts(axes: Axes, motion: Motion) -> None:
    """Draw the ghosts of a motion, later ones darker, each with what is special about it."""
    moving = next(shape for shape in motion.shapes if len(shape.points) > 1)
    shades = np.linspace(STYLE.faintest_ghost, 1.0, len(motion.ghosts))
    for (frame, text), shade in zip(motion.ghosts.items(), shades):
        outlines(axes, motion, frame, shade)
        at = motion.bounds[1][0], float(moving.at(frame)[:, 1].mean())
        axes.annotate(
            text,
            at,
            (10, 0),
            textcoords="offset points",
            fontsize=STYLE.image_label_pt,
            va="center",
        )
    axes.set(aspect="equal")
