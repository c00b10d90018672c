"""Pictures as values: curves over an axis and quantities over a plane; `png` and `html` draw them alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..figure import Figure

if TYPE_CHECKING:
    from cosim import Result

Samples = NDArray[np.float64]
COLORS = {
    "red": "#c8500a", "blue": "#0072b2", "green": "#00916a", "gold": "#b07d00",
    "purple": "#a8478a", "sky": "#3f9fd6", "grey": "#76828c", "black": "#202020",
}  # fmt: skip
TORQUE, SPEED, LIFT, FORCE, POWER, THEORY = "red", "blue", "green", "gold", "purple", "grey"
SERIES = ("purple", "gold", "sky", "green", "red", "blue")
SCALES = {
    "size": ("#0b0724", "#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#fcfdbf"),
    "risk": ("#ffffff", "#fde3b0", "#f9b36b", "#ea7a3f", "#c23b2c", "#7f1128"),
}
SHOWN = {
    ("m", "mm"): 1e3, ("s", "ms"): 1e3, ("N", "kN"): 1e-3, ("rad", "deg"): 180 / math.pi,
    ("rad/s", "rpm"): 30 / math.pi,
}  # fmt: skip
MOST = 2000
ROOM = 0.05
LONG, FEW = 21, 6


class Curve(NamedTuple):
    """y over x, as many of both; nan in y is a gap.

    It looks like a "line", a dashed line of "theory", "points", "linked" points, a "step", or
    stands as "bars" or a stacked "area" on 0; x of bars may be words. `error`, of the shape of y or
    two of them, below and above, is drawn as a bar at points and as a band along a line.
    """

    name: str
    x: Sequence[float] | Sequence[str] | Samples
    y: Sequence[float] | Samples
    color: str
    look: str = "line"
    error: Sequence[float] | Samples | None = None


class Mark(NamedTuple):
    """A place on the x axis, or a level on the y axis of a panel, and what is there."""

    at: float
    text: str

    @classmethod
    def of(cls, text: str, figure: Figure) -> Mark:
        """Where a figure is, in as many digits as its error lets it have."""
        told = f"{figure.value:.4g} {figure.unit}" if figure.error is None else figure.text()
        return cls(figure.value, f"{text} {told}")


class Span(NamedTuple):
    """A stretch of the x axis, and what it is."""

    first: float
    last: float
    text: str
    color: str = "grey"


class Panel(NamedTuple):
    """Curves over one y axis of a quantity and its unit, which shows the values it `includes`."""

    quantity: str
    unit: str
    curves: Sequence[Curve]
    levels: Sequence[Mark] = ()
    includes: Sequence[float] = ()

    @property
    def label(self) -> str:
        return f"{self.quantity} [{self.unit}]"

    @property
    def lines(self) -> str:
        """The label in two lines, if it is long."""
        return self.label.replace(" [", "\n[") if len(self.label) > LONG else self.label


class Lanes(NamedTuple):
    """What lasts from when to when: a lane of bars by name."""

    rows: Mapping[str, Sequence[Span]]

    @property
    def bars(self) -> list[tuple[int, Span]]:
        """Every bar and the number of its lane, from the top."""
        return [(k, bar) for k, row in enumerate(self.rows.values()) for bar in row]


class Second(NamedTuple):
    """Another unit of the x axis, whose numbers are so many times as large."""

    unit: str
    factor: float


class Chart(NamedTuple):
    """Panels above each other over one x axis with its marks and spans."""

    title: str
    x: str
    panels: Sequence[Panel | Lanes]
    marks: Sequence[Mark] = ()
    spans: Sequence[Span] = ()
    second: Second | None = None
    log: bool = False


class Direction(NamedTuple):
    """An axis of a plane: quantity, unit, values, and whether they are drawn logarithmically."""

    quantity: str
    unit: str
    values: Samples
    log: bool = False

    @property
    def label(self) -> str:
        return f"{self.quantity} [{self.unit}]"

    @property
    def places(self) -> list[float]:
        """The values, if they are few enough for a tick at each."""
        return np.asarray(self.values, float).tolist() if len(self.values) <= FEW else []


class Level(NamedTuple):
    """The line on which values over a plane, those of its field by default, have a value."""

    at: float
    text: str
    values: Samples | None = None


class Field(NamedTuple):
    """Values of shape (len(y), len(x)), nan where there is none, with what is drawn over them.

    The colours are those of a scale, and follow the logarithm of the values where `log` is set,
    which are then above 0. Without a unit the values have the unit 1.
    """

    title: str
    x: Direction
    y: Direction
    quantity: str
    values: Samples
    curves: Sequence[Curve] = ()
    log: bool = False
    levels: Sequence[Level] = ()
    spans: Sequence[Span] = ()
    scale: str = "size"


Picture = Chart | Field


def recorded(
    quantity: str,
    result: Result,
    x: Samples,
    curves: Mapping[str, tuple[str, str]],
    unit: str = "",
    rows: Any = slice(None),
    includes: Sequence[float] = (),
    levels: Sequence[Mark] = (),
) -> Panel:
    """Columns of a result over x, each with its name and color, in their unit or in another.

    Raises KeyError for a column that is not there, or a unit that one does not convert to.
    """
    own = {column: result.units[column] for column in curves}
    unit = unit or next(iter(own.values()))
    scale = {column: 1.0 if u == unit else SHOWN[u, unit] for column, u in own.items()}
    drawn = [
        Curve(name, x, scale[column] * result[column][rows], color)
        for column, (name, color) in curves.items()
    ]
    return Panel(quantity, unit, drawn, levels, includes)


class Flag(NamedTuple):
    """Words above a picture: the middle of them on the x axis, and the lane they stand in."""

    at: float
    text: str
    lane: int


def stacked(panel: Panel) -> list[tuple[Curve, Samples, Samples]]:
    """Every curve with the lower and upper end of what it covers, errors and areas below included."""
    ends, base = [], 0.0
    for curve in panel.curves:
        y = np.asarray(curve.y, float)
        error = np.nan_to_num(np.asarray(0.0 if curve.error is None else curve.error, float))
        below, above = np.broadcast_to(error, (2, len(y)))
        if curve.look == "area":
            ends.append((curve, base + 0.0 * y, base + y))
            base = base + np.nan_to_num(y)
        elif curve.look == "bars":
            ends.append((curve, np.minimum(y - below, 0.0), np.maximum(y + above, 0.0)))
        else:
            ends.append((curve, y - below, y + above))
    return ends


def height(panel: Panel) -> tuple[float, float]:
    """The ends of a panel's y axis, with some room but where it ends at a value it includes."""
    fixed = [*panel.includes, *(level.at for level in panel.levels)]
    values = np.concatenate([fixed, *(end for _, *ends in stacked(panel) for end in ends)])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    room = ROOM * (high - low) or ROOM * abs(high) or 1.0
    stands = [*panel.includes, *(0.0 for curve in panel.curves if curve.look in ("bars", "area"))]
    return (low if low in stands else low - room), (high if high in panel.includes else high + room)


def width(picture: Picture) -> tuple[float, float] | None:
    """The ends of the x axis; None if it bears words."""
    if isinstance(picture, Field):
        return float(picture.x.values[0]), float(picture.x.values[-1])
    curves = [c for panel in picture.panels if isinstance(panel, Panel) for c in panel.curves]
    if any(len(c.x) and isinstance(c.x[0], str) for c in curves):
        return None
    lanes = [panel for panel in picture.panels if isinstance(panel, Lanes)]
    bars = [bar for lane in lanes for _, bar in lane.bars]
    ends = [mark.at for mark in picture.marks] + [x for bar in bars for x in (bar.first, bar.last)]
    places = np.concatenate([ends, *(np.asarray(c.x, float) for c in curves)])
    if not len(places):
        return 0.0, 1.0
    low, high = float(np.nanmin(places)), float(np.nanmax(places))
    if low == high:
        return (low / 2, high * 2) if picture.log else (low - 1.0, high + 1.0)
    if all(c.look in ("line", "theory", "area", "step") for c in curves):
        return low, high
    if picture.log:
        room = (high / low) ** 0.03
        return low / room, high * room
    return low - 0.03 * (high - low), high + 0.03 * (high - low)


def flags(picture: Picture, letters: float) -> list[Flag]:
    """The words of marks and spans in lanes, so that none covers another where so many letters of
    them fit side by side."""
    ends = width(picture)
    if ends is None:
        return []
    log = picture.x.log if isinstance(picture, Field) else picture.log
    scale = np.log10 if log else np.asarray
    low, high = (float(scale(end)) for end in ends)
    marks = () if isinstance(picture, Field) else picture.marks
    wanted = [(float(scale(mark.at)), mark.text) for mark in marks]
    for span in picture.spans:
        first, last = np.clip([scale(span.first), scale(span.last)], low, high)
        wanted.append((float(first + last) / 2, span.text))
    placed: list[Flag] = []
    lanes: list[float] = []
    for at, text in sorted(wanted):
        half = (len(text) + 2) / letters / 2
        middle = max(min((at - low) / (high - low), 1.0 - half), half) if half < 0.5 else 0.5
        lane = next((k for k, end in enumerate(lanes) if middle - half >= end), len(lanes))
        lanes[lane : lane + 1] = [middle + half]
        place = low + middle * (high - low)
        placed.append(Flag(10.0**place if log else place, text, lane))
    return placed


def fits(bar: Span, ends: tuple[float, float] | None, letters: float) -> bool:
    """Whether the words of a bar have room inside it, where so many letters span the axis."""
    low, high = ends or (0.0, 1.0)
    return len(bar.text) + 1 < letters * (bar.last - bar.first) / (high - low)


def decades(low: float, high: float) -> list[float]:
    """Numbers at the ticks of a logarithmic axis, closer where it spans less than two decades."""
    steps = (1.0, 2.0, 5.0) if high / low > 20 else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [x for k in powers for s in steps if low <= (x := float(f"{s * 10.0**k:.3g}")) <= high]


def thinned(x: Samples, y: Samples, most: int = MOST) -> tuple[Samples, Samples]:
    """At most so many points: the ends, and the smallest and largest of every stretch in order."""
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2).astype(int)
    kept = {0, len(x) - 1}
    for first, last in pairwise(edges.tolist()):
        kept |= {first + int(np.argmin(y[first:last])), first + int(np.argmax(y[first:last]))}
    rows = sorted(kept)
    return x[rows], y[rows]


def words(picture: Picture) -> str:
    """The picture in words, for those who do not see it."""
    if isinstance(picture, Field):
        low, high = np.nanmin(picture.values), np.nanmax(picture.values)
        over = f"{picture.x.label} and {picture.y.label}"
        return f"{picture.title}: {picture.quantity} from {low:.4g} to {high:.4g} over {over}."
    told = [text for panel in picture.panels for text in _panel_words(panel)]
    told += [span.text for span in picture.spans] + [mark.text for mark in picture.marks]
    return f"{picture.title}, over {picture.x}: {'; '.join(told)}."


def _panel_words(panel: Panel | Lanes) -> list[str]:
    if isinstance(panel, Lanes):
        return [f"{name}: {', '.join(x.text for x in bars)}" for name, bars in panel.rows.items()]
    curves = [(curve, np.asarray(curve.y, float)) for curve in panel.curves]
    return [
        f"{curve.name} from {np.nanmin(y):.4g} to {np.nanmax(y):.4g} ({panel.label})"
        for curve, y in curves
        if np.isfinite(y).any()
    ]
