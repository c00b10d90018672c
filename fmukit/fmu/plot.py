"""The default experiment as a picture: a panel for every output, the same bytes at every build."""

import math
from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from operator import itemgetter

from ..declare.interface import Interface
from .reference import Rows, outputs

#: Panels in a row; like all sizes below, in SVG units, a convention of this kit.
COLUMNS = 3
#: Width of a panel.
PICTURE_WIDTH = 190
#: Height of a panel.
HEIGHT = 60
#: Space to the left of a panel, for its scale.
ACROSS = 60
#: Space above a panel, for its name.
DOWN = 36


def svg(interface: Interface, rows: Rows) -> str:
    """Small multiples of the rows of the experiment."""
    time, *columns = zip(*rows)
    width = COLUMNS * (PICTURE_WIDTH + ACROSS) + 10
    height = math.ceil(len(columns) / COLUMNS) * (HEIGHT + DOWN) + DOWN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        'font-family="sans-serif" font-size="11">',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
    ]
    for n, (output, values) in enumerate(zip(outputs(interface), columns)):
        row, column = divmod(n, COLUMNS)
        x, y = ACROSS + column * (PICTURE_WIDTH + ACROSS), DOWN + row * (HEIGHT + DOWN)
        label = f"{output.name} [{output.unit}]" if output.unit else output.name
        parts += panel(x, y, label, values)
    last = f'<text x="{ACROSS}" y="{height - 14}" fill="#555">time from 0 to {time[-1]:g} s</text>'
    return "\n".join([*parts, last, "</svg>\n"])


def panel(x: int, y: int, label: str, values: Sequence[float]) -> Iterable[str]:
    """One output with its name, its range and its course."""
    low, high = min(values), max(values)
    scale = HEIGHT / (high - low) if high > low else 0.0
    top = HEIGHT / 2 if low == high else HEIGHT
    step = PICTURE_WIDTH / (len(values) - 1)
    dots = [(round(step * n), round(top - scale * (v - low))) for n, v in enumerate(values)]
    path = " ".join(f"{x + across},{y + down}" for across, down in thinned(dots))
    yield f'<text x="{x}" y="{y - 8}" font-weight="bold">{escape(label)}</text>'
    yield f'<rect x="{x}" y="{y}" width="{PICTURE_WIDTH}" height="{HEIGHT}" fill="none" stroke="#ddd"/>'
    yield f'<polyline points="{path}" fill="none" stroke="#1f5fa8" stroke-width="1.3"/>'
    for value, down in {high: HEIGHT - top, low: top}.items():
        at = f'x="{x - 3}" y="{y + down + 4:g}"'
        yield f'<text {at} text-anchor="end" fill="#555">{value:.4g}</text>'


def thinned(dots: Sequence[tuple[int, int]]) -> Iterable[tuple[int, int]]:
    """Of the dots in every column the first, the lowest, the highest and the last."""
    for _, group in groupby(dots, key=itemgetter(0)):
        column = list(group)
        heights = [down for _, down in column]
        indices = {0, heights.index(min(heights)), heights.index(max(heights)), len(column) - 1}
        yield from dict.fromkeys(column[n] for n in sorted(indices))
