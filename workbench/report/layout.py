"""How a picture is laid out: all that its renderers decide alike, so that each of them but draws it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import count, cycle
from typing import Any, NamedTuple

import numpy as np

from .chart import Chart, Curve, Direction, Field, Lanes, Panel, Picture, Samples, Span

MOST, ROOM, LONG, FEW = 2000, 0.05, 21, 6
NARROW, ENTRY = 44, 8
LINE, GAP, LANE, PLANE, PANELS = 0.19, 0.18, 0.3, 3.8, {1: 3.3, 2: 2.5}


class Axis(NamedTuple):
    """An axis with its ends and the texts of its ticks, where a renderer may not choose them.

    Words stand at 0, 1, 2 and so on.
    """

    label: str
    ends: tuple[float, float]
    log: bool = False
    ticks: Mapping[float, str] = {}
    words: bool = False

    def share(self, at: Any) -> Any:
        """Where numbers are between the ends, which are 0 and 1."""
        scale = np.log10 if self.log else np.asarray
        low, high = scale(self.ends)
        return (scale(at) - low) / (high - low)

    def number(self, share: float) -> float:
        """The number at a place between the ends."""
        low, high = self.ends
        return low * (high / low) ** share if self.log else low + share * (high - low)


class Row(NamedTuple):
    """A part of a picture: its y axis, the names in its legend, and in inches its height and the
    room above it for legend and flags."""

    part: Panel | Lanes | Field
    y: Axis
    names: Sequence[str]
    height: float
    above: float


class Flag(NamedTuple):
    """Words above a picture in a lane: at a place they begin ("left"), end ("right"), or have their
    middle ("center")."""

    at: float
    text: str
    lane: int
    anchor: str


class Layout(NamedTuple):
    """A picture where so many letters stand side by side: rows over one axis, and flags between
    the first row and its legend, whose lanes are so many inches high."""

    x: Axis
    rows: Sequence[Row]
    flags: Sequence[Flag]
    raised: float


def layout(picture: Picture, letters: int) -> Layout:
    """Where everything stands, so that no legend and no words cover anything else."""
    x = along(picture.x) if isinstance(picture, Field) else across(picture)
    parts: Sequence[Any] = [picture] if isinstance(picture, Field) else picture.panels
    above = flags(picture, x, letters)
    raised = LINE * max((flag.lane + 1 for flag in above), default=0)
    rows: list[Row] = []
    for part in parts:
        if isinstance(part, Field):
            y, high = along(part.y), PLANE
            names = [drawn.name for drawn in part.curves] + [level.text for level in part.levels]
        elif isinstance(part, Lanes):
            y = Axis("", (len(part.rows) - 0.5, -0.5), ticks=dict(enumerate(part.rows)))
            names, high = [b.text for _, b in part.bars if not fits(b, x)], LANE * len(part.rows)
        else:
            label = part.label.replace(" [", "\n[") if len(part.label) > LONG else part.label
            y, high = Axis(label, height(part)), PANELS.get(len(parts), 1.9)
            names = [curve.name for curve in lines(part, x)]
            names = names if len(names) > 1 else []
        above_it = GAP + LINE * math.ceil(len(names) / columns(names, letters))
        rows.append(Row(part, y, names, high, above_it + (0.0 if rows else raised)))
    return Layout(x, rows, above, raised)


def columns(names: Sequence[str], letters: int) -> int:
    """How many of these names stand beside each other in a legend."""
    return max(1, letters // (max(map(len, names), default=0) + ENTRY))


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


def across(chart: Chart) -> Axis:
    """The x axis of a chart, with room beside points."""
    curves = [c for panel in chart.panels if isinstance(panel, Panel) for c in panel.curves]
    words = next((c.x for c in curves if len(c.x) and isinstance(c.x[0], str)), None)
    if words is not None:
        names = {float(k): str(word) for k, word in enumerate(words)}
        return Axis(chart.x, (-0.5, len(names) - 0.5), False, names, True)
    bars = [b for panel in chart.panels if isinstance(panel, Lanes) for _, b in panel.bars]
    ends = [mark.at for mark in chart.marks] + [x for b in bars for x in (b.first, b.last)]
    places = np.concatenate([ends, *(np.asarray(c.x, float) for c in curves)])
    low, high = (float(np.nanmin(places)), float(np.nanmax(places))) if len(places) else (0.0, 1.0)
    if low == high:
        low, high = (low / 2, high * 2) if chart.log else (low - 1.0, high + 1.0)
    elif any(c.look in ("points", "linked") for c in curves):
        tight = Axis("", (low, high), chart.log)
        low, high = tight.number(-0.03), tight.number(1.03)
    return axis(chart.x, low, high, chart.log)


def lines(panel: Panel, x: Axis) -> list[Curve]:
    """The curves of a panel, and its levels as curves from end to end."""
    places: Any = list(x.ticks.values()) if x.words else list(x.ends)
    looks = cycle(("level", "limit"))
    return [
        *panel.curves,
        *(
            Curve(level.text, places, [level.at] * len(places), "grey", look)
            for level, look in zip(panel.levels, looks)
        ),
    ]


def covered(curves: Sequence[Curve]) -> list[tuple[Samples, Samples]]:
    """The lower and upper end of what each curve covers, with its errors or the areas below it."""
    ends, base = [], 0.0
    for curve in curves:
        y = np.asarray(curve.y, float)
        low, high = y - curve.errors[0], y + curve.errors[1]
        if curve.look == "area":
            low, high = base + 0.0 * y, base + y
            base = base + np.nan_to_num(y)
        elif curve.look == "bars":
            low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
        ends.append((low, high))
    return ends


def height(panel: Panel) -> tuple[float, float]:
    """The ends of a panel's y axis, with some room but where it ends at a value it includes."""
    fixed = [*panel.includes, *(level.at for level in panel.levels)]
    values = np.concatenate([fixed, *(end for ends in covered(panel.curves) for end in ends)])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    room = ROOM * (high - low) or ROOM * abs(high) or 1.0
    stands = [*panel.includes, *(0.0 for curve in panel.curves if curve.look in ("bars", "area"))]
    return (low if low in stands else low - room), (high if high in panel.includes else high + room)


def flags(picture: Picture, x: Axis, letters: int) -> list[Flag]:
    """The words of spans above their middle and those of marks beside their lines, in lanes so that
    none covers another."""
    spans = [(np.clip(x.share([s.first, s.last]), 0, 1).mean(), s.text) for s in picture.spans]
    marks = sorted(((x.share(mark.at), mark.text) for mark in picture.marks), reverse=True)
    placed: list[Flag] = []
    taken: list[tuple[int, float, float]] = []
    for at, text in [*spans, *marks]:
        long = min((len(text) + 2) / letters, 1.0)
        beside = {"left": at, "right": at - long} if (at, text) in marks else {}
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
        placed.append(Flag(x.number(at), text, lane, anchor))
    return placed


def fits(bar: Span, x: Axis) -> bool:
    """Whether the words of a bar have room inside it on a small screen too."""
    return len(bar.text) + 1 < NARROW * float(np.diff(x.share([bar.first, bar.last]))[0])


def decades(low: float, high: float) -> list[float]:
    """Numbers at the ticks of a logarithmic axis, closer where it spans less than two decades."""
    steps = (1.0, 2.0, 5.0) if high / low > 20 else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [x for k in powers for s in steps if low <= (x := float(f"{s * 10.0**k:.3g}")) <= high]


def thinned(x: Samples, y: Samples) -> tuple[Samples, Samples]:
    """At most MOST points: the ends, and the smallest and largest of every stretch in order."""
    if len(x) <= MOST:
        return x, y
    kept = {0, len(x) - 1}
    for stretch in np.array_split(np.arange(len(x)), MOST // 2 - 1):
        kept |= {int(stretch[np.argmin(y[stretch])]), int(stretch[np.argmax(y[stretch])])}
    return x[sorted(kept)], y[sorted(kept)]
