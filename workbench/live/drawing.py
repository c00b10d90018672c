"""A mechanism as a table: how each point of its drawing depends on lengths and turned angles.

The points of a linkage are sums of lengths and of radii that turn with an angle. As complex numbers they are
linear in the features 1, the lengths, and exp(+-i q angle). The coefficients follow from the drawing at
chosen coordinates, and the drawing at others checks them. So the browser moves the drawing that Python makes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..charts.motion import Columns, Motion, Shape
from ..charts.style import COLORS
from ..charts.svg import scaled_to_drawing
from .declare import Coordinate, LiveMotion

Samples = NDArray[np.float64]
#: a convention: the largest error of a point, in units of a drawing that is 1000 wide
LARGEST_ERROR = 1e-3
#: a convention: a coefficient below it moves no point visibly, in the same units
NEGLIGIBLE = 1e-4
#: decimals of the coefficients, for such points
DECIMALS = 4
#: samples for each feature, so that least squares has more equations than unknowns
SAMPLES = 4
#: a convention: any seed gives the same drawing
SEED = 1


class NonlinearDrawingError(ValueError):
    """The points of a drawing do not depend linearly on its features."""


def coefficient_table(motion: LiveMotion, runs: int) -> dict[str, Any]:
    """Return the shapes of a motion as coefficients of features, in units of the drawing.

    Parameters
    ----------
    motion : LiveMotion
        What the question declares.
    runs : int
        How many drawings stand beside each other.

    Raises
    ------
    NonlinearDrawingError
        If a point does not depend linearly on the features.
    """
    coordinates = motion.coordinates
    rng = np.random.default_rng(SEED)
    count = SAMPLES * (1 + sum(2 * max(1, len(x.turns)) for x in coordinates)) + 2
    columns = _columns(coordinates, rng.random((len(coordinates), count)))
    size, scale, shapes = _shapes_scaled_to_drawing(motion, columns, runs)
    features = _features(coordinates, columns)
    weights = np.maximum(np.abs(features).max(axis=0), 1e-300)
    fitted, checked = slice(0, None, 2), slice(1, None, 2)
    rows = []
    for shape, points in shapes:
        fit = np.zeros((features.shape[1], points.shape[1]), complex)
        fit[0] = points[0]
        if len(points) > 1:
            equations = features[fitted] / weights
            fit = np.linalg.lstsq(equations, points[fitted], rcond=1e-12)[0] / weights[:, None]
            error = float(np.abs(features[checked] @ fit - points[checked]).max())
            if error > LARGEST_ERROR:
                raise NonlinearDrawingError(
                    f"the live page does not show {motion.title!r}: with these dimensions the {shape.name} would be drawn "
                    f"up to {error / 10:.2g} % of the picture's width beside its place"
                )
        visible = np.flatnonzero((np.abs(fit) * weights[:, None]).max(axis=1) > NEGLIGIBLE)
        rows.append({
            "name": shape.name, "color": COLORS[shape.color], "width": shape.width,
            "closed": shape.closed, "label": shape.label,
            "terms": [[int(k), *(x.round(DECIMALS).tolist() for x in (fit[k].real, fit[k].imag))] for k in visible],
        })  # fmt: skip
    step = np.array(motion.offset) * [scale, -scale]
    return {"size": size, "shapes": rows, "offset": step.round(DECIMALS).tolist()}


def _columns(coordinates: Sequence[Coordinate], shares: Samples) -> Columns:
    """Columns within their ranges, of which the first two rows are the ends."""
    shares[:, :2] = 0.0, 1.0
    return {x.column: x.low + (x.high - x.low) * share for x, share in zip(coordinates, shares)}


def _features(coordinates: Sequence[Coordinate], columns: Columns) -> NDArray[np.complex128]:
    """The features, of shape (rows, features), in the sequence of js/motion.js."""
    count = len(next(iter(columns.values())))
    features = [np.ones(count, complex)]
    for coordinate in coordinates:
        x = columns[coordinate.column]
        for turn in coordinate.turns:
            features += [np.exp(1j * turn * x), np.exp(-1j * turn * x)]
        if not coordinate.turns:
            features.append(x.astype(complex))
    return np.stack(features, axis=1)


def _shapes_scaled_to_drawing(
    motion: LiveMotion, columns: Columns, runs: int
) -> tuple[list[float], float, list[tuple[Shape, NDArray[np.complex128]]]]:
    """Size and scale of the drawing, and its shapes with their points in it as x + i y.

    The drawing has room for all runs.
    """
    shapes = list(motion.draw(columns))
    far = np.array(motion.offset) * (runs - 1)
    room = [*shapes, *(shape._replace(points=shape.points + far) for shape in shapes)]
    size, scale, placed = scaled_to_drawing(Motion(motion.title, np.zeros(1), 1.0, [], room))
    points = [(shape, xy[..., 0] + 1j * xy[..., 1]) for shape, xy in placed[: len(shapes)]]
    return [round(float(x), 1) for x in size], scale, points
