"""A mechanism in motion as a value: outlines over time, and the lines that machines are drawn with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from cosim import Result

Samples = NDArray[np.float64]
Columns = Mapping[str, Samples]
Point = Any
#: Frames of a motion; chosen: one for each 1.5 degrees of a turn.
FRAMES = 240


class Shape(NamedTuple):
    """A line that moves: points [m] of shape (frames, n, 2), or (1, n, 2) if it is at rest; y is up.

    Its name is written beside the point of number `label`, if there is one.
    """

    name: str
    points: Samples
    color: str
    width: float = 3.0
    closed: bool = False
    label: int | None = None

    def at(self, frame: int) -> Samples:
        """The points of a frame, the first again at the end of a closed line."""
        points: Samples = self.points[min(frame, len(self.points) - 1)]
        return np.vstack([points, points[:1]]) if self.closed else points


class Motion(NamedTuple):
    """Shapes at times [s] of shape (frames,), a caption for each; `slow` times slower than real time.

    `ghosts` are frames that stay in sight, with their text; a motion that has some is also drawn as a
    still picture.
    """

    title: str
    times: Samples
    slow: float
    captions: Sequence[str]
    shapes: Sequence[Shape]
    note: str = ""
    ghosts: Mapping[int, str] = {}

    @property
    def bounds(self) -> tuple[Samples, Samples]:
        """The lower left and upper right corner of all that is drawn."""
        points = np.concatenate([shape.points.reshape(-1, 2) for shape in self.shapes])
        return points.min(axis=0), points.max(axis=0)


def rows_nearest_to_times(
    t: Samples, first: float, last: float, frames: int = FRAMES
) -> NDArray[np.int64]:
    """The rows nearest to evenly spaced times between two [s], each once."""
    wanted = np.linspace(first, last, frames)
    right = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    near = np.where(wanted - t[right - 1] < t[right] - wanted, right - 1, right)
    return np.unique(near)


def columns(
    result: Result, part: str, names: Sequence[str], picked: NDArray[np.int64]
) -> dict[str, Samples]:
    """Some outputs of a part at some rows, under their bare names."""
    return {name: result[f"{part}.{name}"][picked] for name in names}


def line(*points: Point) -> Samples:
    """Return points as an array of shape (frames or 1, n, 2).

    They are pairs or complex numbers x + i y, with one value or one per frame.
    """
    plane = [point[0] + 1j * point[1] if isinstance(point, tuple) else point for point in points]
    flat = np.stack(np.broadcast_arrays(*map(np.atleast_1d, plane)), axis=-1)
    return np.stack([flat.real, flat.imag], axis=-1)


def circle(x: float, y: float, r: float) -> Samples:
    """A circle that stands."""
    return arc(x, y, r, 0.0, 2 * math.pi)


def arc(x: float, y: float, r: float, first: float, last: float) -> Samples:
    """A part of a circle from one angle [rad] to another."""
    angle = np.linspace(first, last, 49)
    return np.stack([x + r * np.cos(angle), y + r * np.sin(angle)], axis=-1)[None]


def arrow(path: Samples, size: float) -> Samples:
    """A standing path with a head of that size at its end."""
    tip, back = path[0, -1], path[0, -2] - path[0, -1]
    angles = np.arctan2(back[1], back[0]) + np.array([0.45, -0.45])
    first, last = tip + size * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.concatenate([path, np.array([[first, tip, last]])], axis=1)


def ground(x: float, y: float, to_x: float, to_y: float, size: float) -> Samples:
    """What does not move: a line with strokes of that size on its right."""
    start, direction = np.array([x, y]), np.array([to_x - x, to_y - y])
    along = direction / np.hypot(*direction)
    stroke = size * (np.array([along[1], -along[0]]) - along) / math.sqrt(2)
    feet = [
        start + direction * share
        for share in np.linspace(0.0, 1.0, round(np.hypot(*direction) / size) + 1)
    ]
    return np.array([[point for foot in feet for point in (foot, foot + stroke, foot)]])


def pivot(x: float, y: float, size: float) -> Samples:
    """A bearing: a place on a foot on the ground."""
    foot = ground(x - 1.4 * size, y - 1.5 * size, x + 1.4 * size, y - 1.5 * size, 0.7 * size)
    legs = line((x + 0.8 * size, y - 1.5 * size), (x, y), (x - 0.8 * size, y - 1.5 * size))
    return np.concatenate([legs, foot], axis=1)


def spring(first: Point, last: Point, size: float, coils: int = 12) -> Samples:
    """A zigzag of that width between two places."""
    (x, y), (to_x, to_y) = first, last
    length = np.hypot(to_x - x, to_y - y)
    across = [0.0, *(size * (-1) ** k for k in range(coils)), 0.0]
    return line(
        *(
            (x + (to_x - x) * k / (coils + 1) - side * (to_y - y) / length,
             y + (to_y - y) * k / (coils + 1) + side * (to_x - x) / length)
            for k, side in enumerate(across)
        )
    )  # fmt: skip


def damper(first: Point, last: Point, size: float) -> Samples:
    """A piston in a cylinder of that width, between two places at one height."""
    (x, y), (to_x, _) = first, last
    head, foot, rim = ((x + to_x) / 2 + share * size for share in (0.0, 0.9, -0.9))
    return line(
        (x, y), (head, y), (head, y + 0.7 * size), (head, y - 0.7 * size), (head, y + 0.7 * size),
        (head, y + size), (rim, y + size), (foot, y + size), (foot, y - size), (rim, y - size),
        (foot, y - size), (foot, y), (to_x, y),
    )  # fmt: skip


def shifted(shapes: Sequence[Shape], x: float, y: float) -> list[Shape]:
    """The same elsewhere."""
    return [shape._replace(points=shape.points + np.array([x, y])) for shape in shapes]
