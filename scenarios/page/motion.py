"""A mechanism in motion: outlines over time, for a page that plays them and for a GIF."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..plots import pyplot

if TYPE_CHECKING:
    from cosim import Result

Samples = NDArray[np.float64]
Columns = Mapping[str, Samples]

COLORS = {
    "red": "#d1495b", "blue": "#2f7ec4", "green": "#2e9e6b", "gold": "#c08a1e",
    "purple": "#8e5bb5", "grey": "#7f8c8d",
}  # fmt: skip
FRAMES = 240


class Shape(NamedTuple):
    """A line that moves: points [m] of shape (frames, n, 2), or (1, n, 2) if it stands; y up."""

    name: str
    points: Samples
    color: str
    width: float = 3.0
    closed: bool = False


class Motion(NamedTuple):
    """Shapes at times [s] of shape (frames,), a caption for each; `slow` times slower than real."""

    title: str
    times: Samples
    slow: float
    captions: Sequence[str]
    shapes: Sequence[Shape]
    note: str = ""


def rows(t: Samples, first: float, last: float, frames: int = FRAMES) -> NDArray[np.int64]:
    """The rows nearest to so many even times between two [s], each once."""
    wanted = np.linspace(first, last, frames)
    right = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    near = np.where(wanted - t[right - 1] < t[right] - wanted, right - 1, right)
    return np.unique(near)


def columns(
    result: Result, part: str, names: Sequence[str], picked: NDArray[np.int64]
) -> dict[str, Samples]:
    """Some outputs of a part at some rows, under their bare names."""
    return {name: result[f"{part}.{name}"][picked] for name in names}


def line(*points: tuple[Any, Any]) -> Samples:
    """Points whose coordinates are numbers or have a value per frame, shape (frames or 1, n, 2)."""
    flat = np.broadcast_arrays(*(np.atleast_1d(x) for point in points for x in point))
    return np.stack(flat, axis=-1).reshape(len(flat[0]), len(points), 2)


def circle(x: float, y: float, r: float) -> Samples:
    """A circle that stands."""
    angle = np.linspace(0.0, 2 * math.pi, 49)
    return np.stack([x + r * np.cos(angle), y + r * np.sin(angle)], axis=-1)[None]


def moved(shapes: Sequence[Shape], x: float, y: float) -> list[Shape]:
    """The same elsewhere."""
    return [shape._replace(points=shape.points + np.array([x, y])) for shape in shapes]


def gif(path: Path, motion: Motion) -> None:
    """The motion as a GIF."""
    from matplotlib.animation import FuncAnimation, PillowWriter

    low, high = bounds(motion)
    width, height = (high - low) * 1.06
    scale = 7.0 / max(width, height)
    figure, axes = pyplot().subplots(
        figsize=(width * scale, height * scale + 0.6), layout="constrained"
    )
    edge = 0.03 * max(high - low)
    axes.set(aspect="equal", xlim=(low[0] - edge, high[0] + edge))
    axes.set(ylim=(low[1] - edge, high[1] + edge))
    axes.set_axis_off()
    drawn = [
        axes.plot(
            *_outline(shape, 0).T,
            color=COLORS[shape.color],
            linewidth=shape.width * 0.7,
            solid_capstyle="round",
        )[0]
        for shape in motion.shapes
    ]
    text = axes.set_title("", loc="left", fontsize=10)
    figure.canvas.draw()
    figure.set_layout_engine("none")
    count = min(len(motion.times), 110)
    chosen = np.unique(np.linspace(0, len(motion.times) - 1, count).astype(int))

    def draw(frame: int) -> list[Any]:
        i = int(chosen[frame])
        for artist, shape in zip(drawn, motion.shapes):
            artist.set_data(*_outline(shape, i).T)
        text.set_text(motion.captions[i])
        return [*drawn, text]

    lasts = float(motion.times[-1] - motion.times[0]) * motion.slow
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = PillowWriter(fps=max(1, round(len(chosen) / lasts)))
    FuncAnimation(figure, draw, frames=len(chosen)).save(path, writer=writer)
    pyplot().close(figure)


def bounds(motion: Motion) -> tuple[Samples, Samples]:
    """The lower left and upper right corner of all that is drawn."""
    points = np.concatenate([shape.points.reshape(-1, 2) for shape in motion.shapes])
    return points.min(axis=0), points.max(axis=0)


def _outline(shape: Shape, frame: int) -> Samples:
    """The points of a frame, the first again at the end of a closed line."""
    points: Samples = shape.points[min(frame, len(shape.points) - 1)]
    return np.vstack([points, points[:1]]) if shape.closed else points
