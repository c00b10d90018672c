"""The texts of a picture: those of marks and spans above it, and the names of curves beside their ends."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .axes import Axis
from .elements import Band, Bars, DrawnRow, Line
from .model import Mark, Span
from .style import STYLE

Anchor = Literal["left", "center", "right"]
#: The spaces between a number, its error and their unit.
UNIT = r"(?<=\d) (?=[^\W\d]|%)|(?<=±) "


@dataclass(frozen=True)
class Label:
    """A text above a picture.

    Attributes
    ----------
    at : float
        Where it is on the x axis.
    text : str
        What it says.
    line : int
        The line above the picture, 0 for the lowest.
    anchor : str
        What of the text is there: its "left" or "right" end or its "center".
    """

    at: float
    text: str
    line: int
    anchor: Anchor


@dataclass(frozen=True)
class Name:
    """The name of an element beside its end.

    Attributes
    ----------
    element : Element
        What is named.
    text : str
        Its name in lines.
    x, y : float
        Where it is: the shares of the width and height of the row, of its left end and its middle.
    """

    element: Line | Band | Bars
    text: str
    x: float
    y: float


def labels_above(
    spans: Sequence[Span], marks: Sequence[Mark], x: Axis, letters: float, beside: float = 0.0
) -> tuple[Label, ...]:
    """Return texts of spans above their middle, and of marks at the ends of their lines.

    The lines of marks lead up to their texts: a text is above those whose lines it would cross. Texts of the left half
    stand to the left of their lines and those of the right half to the right, where there is room. A mark at nan, whose
    place follows later, has a line of its own.

    Parameters
    ----------
    spans, marks
        What has a text.
    x
        The x axis.
    letters
        How many letters fit across the rows.
    beside
        How many more there are on their right.
    """
    left, right = -STYLE.left_px / STYLE.name_letter_px / letters, 1.0 + beside / letters
    ends = left, right
    placed = [
        _place_beside_line(
            s.text, float(np.clip(x.share([s.first, s.last]), 0, 1).mean()), (), letters, ends
        )
        for s in spans
    ]
    ordered = sorted(marks)
    for k, mark in enumerate(ordered):
        sides: tuple[Anchor, ...] = (
            ("right", "left") if k < len(ordered) // 2 else ("left", "right")
        )
        placed.append(_place_beside_line(mark.text, float(x.share(mark.at)), sides, letters, ends))
    labels, line, rest = [], 0, placed
    while rest:
        now: list[_Placed] = []
        for each in rest:
            lines = [x.at for x in rest if x not in now and x is not each and x.anchor != "center"]
            meets = any(each.first < other.end and other.first < each.end for other in now)
            crosses = any(each.first < at < each.end for at in lines)
            if not (meets or crosses):
                now.append(each)
        now = now or rest[:1]
        labels += [Label(x.value(each.at), each.text, line, each.anchor) for each in now]
        rest, line = [each for each in rest if each not in now], line + 1
    return tuple(labels)


@dataclass(frozen=True, eq=False)
class _Placed:
    """A text from one share of the axis to another; the line of a mark leads to its left or right end."""

    text: str
    at: float
    first: float
    end: float
    anchor: Anchor


def _place_beside_line(
    text: str, at: float, sides: Sequence[Anchor], letters: float, ends: tuple[float, float]
) -> _Placed:
    """Return a text on the first side of its line where it fits between both ends, or else across it."""
    left, right = ends
    length = min((len(text) + STYLE.label_gap_letters) / letters, right - left)
    if math.isnan(at):
        at, length = 0.5, right - left
    for anchor in sides:
        first = at - (length if anchor == "right" else 0.0)
        if left <= first <= right - length:
            return _Placed(text, at, first, first + length, anchor)
    middle = max(min(at, right - length / 2), left + length / 2)
    return _Placed(text, middle, middle - length / 2, middle + length / 2, "center")


def lines_of(row: DrawnRow, letters: int) -> list[list[str]]:
    """Return the names of a row, each in lines of so many letters."""
    return [wrapped(element.name, letters) for element in row.named]


def wrapped(text: str, letters: int) -> list[str]:
    """Return a text in lines of so many letters; a number stays with its unit."""
    text = re.sub(UNIT, "\N{NO-BREAK SPACE}", text)
    return textwrap.wrap(text, letters, break_long_words=False, break_on_hyphens=False) or [""]


def width_px(lines: Sequence[str]) -> float:
    """Return the width of a name with its symbol."""
    return STYLE.symbol_px + STYLE.name_letter_px * max(map(len, lines))


def names_of(
    row: DrawnRow, x: Axis, height_px: float, letters: int, *, is_plane: bool
) -> list[Name]:
    """Return the names of a row, each beside the end of its curve; those that would meet are moved apart.

    They stand on the right of the row; over a plane, whose right side explains the colours, inside.

    Parameters
    ----------
    row
        What is drawn.
    x
        The x axis.
    height_px
        The height of the row.
    letters
        How many letters of a name stand in a line.
    is_plane
        Whether the row is a plane.
    """
    texts, ends = lines_of(row, letters), [last_point(element) for element in row.named]
    wanted = [1.0 - float(row.y.share(y)) if np.isfinite(y) else 1.0 for _, y in ends]
    sizes = [STYLE.name_line_px * len(lines) / height_px for lines in texts]
    names = []
    for element, lines, (end, _), y in zip(row.named, texts, ends, separate_places(wanted, sizes)):
        inside = min(float(x.share(end)), 1.0 - width_px(lines) / STYLE.plane_width_px)
        place = (inside if is_plane else 1.0), 1.0 - y
        names.append(Name(element, "\n".join(lines), *place))
    return names


def separate_places(wanted: Sequence[float], sizes: Sequence[float]) -> list[float]:
    """Return places from 0 to 1 near the wanted ones, so far apart that no two of these sizes meet."""
    order = sorted(range(len(wanted)), key=lambda k: wanted[k])
    places, edge = dict[int, float](), 0.0
    for k in order:
        places[k] = max(wanted[k], edge + sizes[k] / 2)
        edge = places[k] + sizes[k] / 2
    edge = max(1.0, sum(sizes))
    for k in reversed(order):
        places[k] = min(places[k], edge - sizes[k] / 2)
        edge = places[k] - sizes[k] / 2
    return [places[k] for k in range(len(wanted))]


def last_point(element: Line | Band | Bars) -> tuple[float, float]:
    """Return x and y of the last value of an element; that of an area or a bar is in its middle."""
    match element:
        case Line():
            x, y = element.x, element.y
        case Band() | Bars():
            x, y = element.x, (element.low + element.high) / 2
    finite = np.flatnonzero(np.isfinite(y))
    return (float(x[finite[-1]]), float(y[finite[-1]])) if len(finite) else (math.nan, math.nan)
