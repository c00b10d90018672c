"""The texts of spans and marks above a picture, placed so that none covers another."""

from __future__ import annotations

import math
import string
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Literal

import numpy as np

from .axes import Axis
from .model import Mark, Span
from .style import STYLE

Anchor = Literal["left", "center", "right"]


@dataclass(frozen=True)
class Label:
    """A text above a picture.

    Attributes
    ----------
    at : float
        Where it is on the x axis; a share of the axis in a key.
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
class Labels:
    """All texts above a picture: those at values of the x axis, and the key of the letters among them."""

    at_values: tuple[Label, ...]
    key: tuple[Label, ...] = ()

    @property
    def lines(self) -> int:
        """The lines that they need."""
        return max((label.line + 1 for label in (*self.at_values, *self.key)), default=0)


def labels_of(
    spans: Sequence[Span], marks: Sequence[Mark], x: Axis, letters: int, *, has_key: bool = True
) -> Labels:
    """Return the texts above a picture.

    They stand at what they name while that takes few lines. Otherwise each mark gets a letter, and a key
    says what the letters mean, in lines like those of a text.

    Parameters
    ----------
    spans, marks
        What has a text.
    x
        The x axis.
    letters
        How many letters fit across the picture.
    has_key
        Whether there may be a key.
    """
    direct = Labels(placed_labels(spans, marks, x, letters))
    if direct.lines <= STYLE.max_label_lines or not (marks and has_key):
        return direct
    ordered = sorted(marks)
    names = dict(zip(string.ascii_lowercase, ordered))
    labels = placed_labels(spans, merged(names, x, letters), x, letters, is_centered=True)
    lines = Labels(labels).lines
    texts = [f"{letter}  {mark.text}" for letter, mark in names.items()]
    across = max(1, letters // (max(map(len, texts)) + STYLE.key_gap_letters))
    rows = math.ceil(len(texts) / across)
    key = (
        Label(k % across / across, text, lines + rows - 1 - k // across, "left")
        for k, text in enumerate(texts)
    )
    return Labels(labels, tuple(key))


def merged(names: dict[str, Mark], x: Axis, letters: int) -> list[Mark]:
    """Return marks with letters as texts; those whose letters would cover each other share one text."""
    groups: list[tuple[list[float], list[str]]] = []
    for letter, mark in names.items():
        share = float(x.share(mark.at))
        reach = (1 + STYLE.label_gap_letters) / letters
        if groups and share - groups[-1][0][-1] < reach:
            groups[-1][0].append(share)
            groups[-1][1].append(letter)
        else:
            groups.append(([share], [letter]))
    return [Mark(x.value(float(np.mean(shares))), " ".join(group)) for shares, group in groups]


def placed_labels(
    spans: Sequence[Span],
    marks: Sequence[Mark],
    x: Axis,
    letters: int,
    *,
    is_centered: bool = False,
) -> tuple[Label, ...]:
    """Return texts of spans above their middle, and texts of marks beside their lines or above them."""
    labels = []
    taken: list[tuple[int, float, float]] = []
    points = [Span(mark.at, mark.at, mark.text) for mark in marks]
    points.sort(reverse=True)
    for start, end, text, _ in [*points, *spans] if is_centered else [*spans, *points]:
        length = min((len(text) + STYLE.label_gap_letters) / letters, 1.0)
        at = float(np.clip(x.share([start, end]), 0, 1).mean())
        sides: dict[Anchor, float] = {"left": at, "right": at - length}
        if start != end or is_centered:
            sides = {}
        starts = {anchor: first for anchor, first in sides.items() if 0 <= first <= 1 - length}
        if not starts:
            at = max(min(at, 1 - length / 2), length / 2)
            starts = {"center": at - length / 2}
        line, anchor, first = next(
            (line, anchor, first)
            for line in count()
            for anchor, first in starts.items()
            if all(k != line or first >= end or first + length <= start for k, start, end in taken)
        )
        taken.append((line, first, first + length))
        labels.append(Label(x.value(at), text, line, anchor))
    return tuple(labels)
