"""The layout of a picture: all that is decided about it before a renderer draws it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .axes import Axis, x_axis
from .elements import Row, row_of
from .labels import Labels, labels_of
from .model import Chart, Field, Mark, Picture, SecondUnit, Span
from .style import LETTERS_BY_SCREEN, STYLE, Screen


@dataclass(frozen=True)
class PlacedRow:
    """A row with where it and its legend are, in px from the top of the picture.

    Attributes
    ----------
    row : Row
        What is drawn.
    label : str
        The label of its y axis, broken into lines that fit beside it.
    legend_px : float
        The top of its legend.
    top_px, height_px : float
        Its own top and height.
    """

    row: Row
    label: str
    legend_px: float
    top_px: float
    height_px: float


@dataclass(frozen=True)
class Layout:
    """A picture for one kind of screen or for paper.

    Attributes
    ----------
    title : str
        The title of the picture, which stands above it.
    x : Axis
        The x axis below the last row.
    second : SecondUnit or None
        The unit of a second axis below it.
    rows : tuple of PlacedRow
        Rows from top to bottom, each below its legend.
    labels : Labels
        The texts above the first row.
    spans : tuple of Span
        Spans through all rows.
    marks : tuple of Mark
        Lines through all rows.
    is_plane : bool
        Whether it is a plane, over which spans have only edges.
    letters : int
        How many letters fit across it.
    plot_px : float
        Its height down to the x axis.
    """

    title: str
    x: Axis
    second: SecondUnit | None
    rows: tuple[PlacedRow, ...]
    labels: Labels
    spans: tuple[Span, ...]
    marks: tuple[Mark, ...]
    is_plane: bool
    letters: int
    plot_px: float

    @property
    def height_px(self) -> float:
        """Its whole height."""
        return self.plot_px + STYLE.below_px

    def shares(self, placed: PlacedRow) -> tuple[float, float]:
        """Return foot and top of a row as shares of the height down to the x axis, from below."""
        foot = 1 - (placed.top_px + placed.height_px) / self.plot_px
        return foot, 1 - placed.top_px / self.plot_px


def layout_of(
    picture: Picture,
    screen: Screen = "wide",
    max_height_px: float = math.inf,
    *,
    has_key: bool = True,
) -> Layout:
    """Return the layout of a picture.

    Parameters
    ----------
    picture
        What to draw.
    screen
        Where it is drawn.
    max_height_px
        Its height at most, for which panels become lower, but not below a share of their height.
    has_key
        Whether labels that take many lines become letters with a key.
    """
    letters = LETTERS_BY_SCREEN[screen]
    x = with_short_ticks(x_axis(picture), letters)
    parts = [picture] if isinstance(picture, Field) else picture.panels
    panel_px = {1: STYLE.single_panel_px, 2: STYLE.double_panel_px}.get(len(parts), STYLE.panel_px)
    rows = [row_of(part, x, panel_px) for part in parts]
    labels = labels_of(picture.spans, picture.marks, x, letters, has_key=has_key)
    line = STYLE.text_line_px
    above = [STYLE.gap_px + line * legend_lines(row.legend, letters) for row in rows]
    above[0] += line * labels.lines
    second = picture.second if isinstance(picture, Chart) else None
    below = STYLE.second_axis_px if second else 0.0
    heights = shrunk(rows, max_height_px - sum(above) - below - STYLE.below_px)
    return Layout(
        picture.title,
        x,
        second,
        tuple(placed_rows(rows, above, heights)),
        labels,
        tuple(picture.spans),
        tuple(picture.marks),
        isinstance(picture, Field),
        letters,
        sum(above) + sum(heights) + below,
    )


def with_short_ticks(x: Axis, letters: int) -> Axis:
    """Return an axis whose tick texts are broken into lines, if these have some length."""
    width = letters // max(1, len(x.ticks)) - 1
    if width < STYLE.min_tick_letters:
        return x
    texts = {at: textwrap.fill(text, width, break_long_words=False) for at, text in x.ticks.items()}
    return replace(x, ticks=texts)


def placed_rows(
    rows: Sequence[Row], above: Sequence[float], heights: Sequence[float]
) -> Iterable[PlacedRow]:
    """Return rows below each other, with the heights above and of each [px]."""
    top = 0.0
    for row, free, height in zip(rows, above, heights):
        letters = max(1, int(height / STYLE.rotated_letter_px))
        label = textwrap.fill(row.y.label, letters, break_long_words=False)
        yield PlacedRow(row, label, top + STYLE.legend_gap_px, top + free, height)
        top += free + height


def shrunk(rows: Sequence[Row], max_height_px: float) -> list[float]:
    """Return the heights of rows [px], those that may shrink lower where all are higher together."""
    heights = np.array([row.height_px for row in rows])
    may_shrink = np.array([row.may_shrink for row in rows])
    over = heights.sum() - max_height_px
    if over > 0.0 and may_shrink.any():
        share = max(STYLE.least_panel_share, 1.0 - over / heights[may_shrink].sum())
        heights = np.where(may_shrink, share * heights, heights)
    return [float(height) for height in heights]


def legend_columns(names: Sequence[str], letters: int) -> int:
    """Return how many of these names stand beside each other in a legend."""
    longest = max(map(len, names), default=0)
    return max(1, letters // (longest + STYLE.legend_symbol_letters))


def legend_lines(names: Sequence[str], letters: int) -> int:
    """Return the lines of a legend."""
    return math.ceil(len(names) / legend_columns(names, letters))
