"""Where the parts of a picture stand: axes with their ends and ticks, and words above a picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from .model import Direction, Field, Lanes, Panel, Picture, Samples, Span

ROOM, FEW = 0.05, 6


class Axis(NamedTuple):
    """An axis with its ends and the texts of its ticks, where a renderer may not choose them."""

    label: str
    ends: tuple[float, float]
    log: bool = False
    ticks: Mapping[float, str] = {}

    def share(self, at: Any) -> Any:
        """Where numbers are between the ends, which are 0 and 1."""
        scale = np.log10 if self.log else np.asarray
        low, high = scale(self.ends)
        return (scale(at) - low) / (high - low)

    def number(self, share: float) -> float:
        """The number at a place between the ends."""
        low, high = self.ends
        return low * (high / low) ** share if self.log else low + share * (high - low)


def across(picture: Picture) -> Axis:
    """The x axis of a picture, with room beside points; words stand at 0, 1, 2 and so on."""
    if isinstance(picture, Field):
        return along(picture.x)
    curves = [c for panel in picture.panels if isinstance(panel, Panel) for c in panel.curves]
    if names := next((curve.names for curve in curves if curve.names), None):
        return Axis(picture.x, (-0.5, len(names) - 0.5), ticks=dict(enumerate(names)))
    bars = [b for panel in picture.panels if isinstance(panel, Lanes) for _, b in panel.bars]
    ends = [mark.at for mark in picture.marks] + [x for b in bars for x in (b.first, b.last)]
    places = np.concatenate([ends, *(c.places for c in curves)])
    low, high = (float(np.nanmin(places)), float(np.nanmax(places))) if len(places) else (0.0, 1.0)
    if low == high:
        low, high = (low / 2, high * 2) if picture.log else (low - 1.0, high + 1.0)
    elif any(c.look in ("points", "linked") for c in curves):
        tight = Axis("", (low, high), picture.log)
        low, high = tight.number(-0.03), tight.number(1.03)
    return axis(picture.x, low, high, picture.log)


def axis(label: str, low: float, high: float, log: bool, places: Sequence[float] = ()) -> Axis:
    """An axis whose ticks are at the numbers that a logarithm needs, or at some places if few."""
    ticks = decades(low, high) if log else places if len(places) <= FEW else ()
    return Axis(label, (low, high), log, {float(tick): f"{tick:g}" for tick in ticks})


def along(way: Direction) -> Axis:
    """The axis of a plane."""
    values = np.asarray(way.values, float)
    return axis(way.label, float(values[0]), float(values[-1]), way.log, values.tolist())


def colored(field: Field) -> Axis:
    """The axis of a field's colours."""
    low, high = float(np.nanmin(field.values)), float(np.nanmax(field.values))
    return axis(field.quantity, low, high, field.log)


def upwards(panel: Panel, covered: Sequence[Samples]) -> Axis:
    """The y axis of a panel over all that its curves cover, with some room but where it ends at a
    value that it includes; of no and yes where all is a flag."""
    if panel.flag:
        return Axis(panel.quantity, (-ROOM, 1 + ROOM), ticks={0.0: "no", 1.0: "yes"})
    fixed = [*panel.includes, *(level.at for level in panel.levels)]
    values = np.concatenate([fixed, *covered])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    room = ROOM * (high - low) or ROOM * abs(high) or 1.0
    stands = [*panel.includes, *(0.0 for curve in panel.curves if curve.look in ("bars", "area"))]
    ends = low if low in stands else low - room, high if high in panel.includes else high + room
    return Axis(panel.label, ends)


def flags(spans: Sequence[Span], x: Axis, letters: int) -> list[tuple[float, str, int, str]]:
    """The words of spans above their middle and those of marks, spans without width, beside their
    lines, in lanes so that none covers another: place, text, lane, and what is at the place, the
    "left" or "right" end or the "center"."""
    placed = []
    taken: list[tuple[int, float, float]] = []
    wide = [span for span in spans if span.first != span.last]
    marks = [span for span in spans if span.first == span.last]
    for start, end, text, _ in [*wide, *sorted(marks, reverse=True)]:
        long = min((len(text) + 2) / letters, 1.0)
        at = float(np.clip(x.share([start, end]), 0, 1).mean())
        beside = {"left": at, "right": at - long} if start == end else {}
        begins = {anchor: first for anchor, first in beside.items() if 0 <= first <= 1 - long}
        if not begins:
            at = max(min(at, 1 - long / 2), long / 2)
            begins = {"center": at - long / 2}
        lane, anchor, first = next(
            (lane, anchor, first)
            for lane in count()
            for anchor, first in begins.items()
            if all(k != lane or first >= end or first + long <= begin for k, begin, end in taken)
        )
        taken.append((lane, first, first + long))
        placed.append((x.number(at), text, lane, anchor))
    return placed


def decades(low: float, high: float) -> list[float]:
    """Numbers at the ticks of a logarithmic axis, closer where it spans less than two decades."""
    steps = (1.0, 2.0, 5.0) if high / low > 20 else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [x for k in powers for s in steps if low <= (x := float(f"{s * 10.0**k:.3g}")) <= high]
