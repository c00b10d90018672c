"""The layout of a picture: all that is decided about it before a renderer draws it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .axes import Axis, x_axis
from .elements import DrawnRow, drawn_row
from .labels import Label, Name, labels_above, lines_of, names_of, width_px
from .model import Chart, HeatMap, Mark, Picture, SecondUnit
from .style import LETTERS_BY_SCREEN, NAME_LETTERS, STYLE, Screen


@dataclass(frozen=True)
class PlacedRow:
    """A row with where it is, in px from the top of the picture.

    Attributes
    ----------
    row : DrawnRow
        What is drawn.
    label : str
        The label of its y axis, broken into lines that fit beside it.
    top_px, height_px : float
        Its top and height.
    names : sequence of Name
        The names of its elements.
    """

    row: DrawnRow
    label: str
    top_px: float
    height_px: float
    names: Sequence[Name]


@dataclass(frozen=True)
class ChartLayout:
    """A picture for one kind of screen or for paper.

    Attributes
    ----------
    picture : Picture
        What is drawn, with its title, marks and spans.
    x : Axis
        The x axis below the last row.
    rows : tuple of PlacedRow
        Rows from top to bottom.
    labels : tuple of Label
        The texts above the first row.
    plot_px : float
        Its height down to the x axis.
    names_px : float
        The width that names take on the right of its rows.
    """

    picture: Picture
    x: Axis
    rows: tuple[PlacedRow, ...]
    labels: tuple[Label, ...]
    plot_px: float
    names_px: float

    @property
    def is_plane(self) -> bool:
        """Whether it is a plane, over which spans have only edges."""
        return isinstance(self.picture, HeatMap)

    @property
    def second(self) -> SecondUnit | None:
        """The unit of a second axis below the first."""
        return None if isinstance(self.picture, HeatMap) else self.picture.second

    @property
    def height_px(self) -> float:
        """Its whole height."""
        return self.plot_px + STYLE.below_px

    def leader_px(self, mark: Mark) -> float:
        """Return how far above the first row the line of a mark leads to its text [px]."""
        lines = [each.line for each in self.labels if each.text == mark.text]
        return STYLE.text_line_px * (max(lines, default=0) + 0.8) if lines else 0.0

    def foot_and_top(self, placed: PlacedRow) -> tuple[float, float]:
        """Return foot and top of a row as shares of the height down to the x axis, from below."""
        foot = 1 - (placed.top_px + placed.height_px) / self.plot_px
        return foot, 1 - placed.top_px / self.plot_px


def layout_of(
    picture: Picture, screen: Screen = "wide", max_height_px: float = math.inf
) -> ChartLayout:
    """Return the layout of a picture.

    Parameters
    ----------
    picture
        What to draw.
    screen
        Where it is drawn.
    max_height_px
        Its height at most, for which panels become lower, but not below a share of their height.
    """
    letters = LETTERS_BY_SCREEN[screen]
    x = with_wrapped_ticks(x_axis(picture), letters)
    parts = [picture] if isinstance(picture, HeatMap) else picture.panels
    panel_px = {1: STYLE.single_panel_px, 2: STYLE.double_panel_px}.get(len(parts), STYLE.panel_px)
    rows = [drawn_row(part, x, panel_px) for part in parts]
    is_plane = isinstance(picture, HeatMap)
    names = [lines for row in rows for lines in lines_of(row, NAME_LETTERS[screen])]
    names_px = 0.0 if is_plane else max(map(width_px, names), default=0.0)
    beside = names_px / STYLE.name_letter_px
    labels = labels_above(picture.spans, picture.marks, x, letters - beside, beside)
    above = [STYLE.gap_px] * len(rows)
    above[0] += STYLE.text_line_px * max((label.line + 1 for label in labels), default=0)
    below = STYLE.second_axis_px if isinstance(picture, Chart) and picture.second else 0.0
    heights = heights_that_fit(rows, max_height_px - sum(above) - below - STYLE.below_px)
    placed, top = [], 0.0
    for row, free, height in zip(rows, above, heights):
        label = textwrap.fill(
            row.y.label, max(1, int(height / STYLE.rotated_letter_px)), break_long_words=False
        )
        beside_row = names_of(row, x, height, NAME_LETTERS[screen], is_plane=is_plane)
        placed.append(PlacedRow(row, label, top + free, height, beside_row))
        top += free + height
    return ChartLayout(
        picture,
        x,
        tuple(placed),
        labels,
        sum(above) + sum(heights) + below,
        names_px,
    )


def with_wrapped_ticks(x: Axis, letters: int) -> Axis:
    """Return an axis whose tick texts are broken into lines, if these have some length."""
    width = letters // max(1, len(x.ticks)) - 1
    if width < STYLE.min_tick_letters:
        return x
    texts = {at: textwrap.fill(text, width, break_long_words=False) for at, text in x.ticks.items()}
    return replace(x, ticks=texts)


def heights_that_fit(rows: Sequence[DrawnRow], max_height_px: float) -> list[float]:
    """Return the heights of rows [px], those that may shrink lower where all are higher together."""
    heights = np.array([row.height_px for row in rows])
    may_shrink = np.array([row.may_shrink for row in rows])
    over = heights.sum() - max_height_px
    if over > 0.0 and may_shrink.any():
        share = max(STYLE.least_panel_share, 1.0 - over / heights[may_shrink].sum())
        heights = np.where(may_shrink, share * heights, heights)
    return [float(height) for height in heights]
