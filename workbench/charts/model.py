"""Pictures as values: curves over an axis and quantities over a plane, drawn by `plot` and `png`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
    "white": "#ffffff",
}  # fmt: skip
TORQUE, SPEED, LIFT, FORCE, POWER, THEORY = "red", "blue", "green", "gold", "purple", "grey"
SERIES = ("purple", "gold", "sky", "green", "red", "blue")
SCALES = {
    "size": ("#0b0724", "#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#fcfdbf"),
    "risk": ("#ffffff", "#fde3b0", "#f9b36b", "#ea7a3f", "#c23b2c", "#7f1128"),
}
DISPLAY_FACTORS = {
    ("m", "mm"): 1e3, ("s", "ms"): 1e3, ("N", "kN"): 1e-3, ("J", "mJ"): 1e3,
    ("rad", "deg"): 180 / math.pi, ("rad/s", "rpm"): 30 / math.pi,
}  # fmt: skip


class Curve(NamedTuple):
    """y over x, of equal length; nan in y is a gap.

    Its `look` is a "line", a dashed line of "theory", "points", "linked" points, a "step", "bars" or a
    stacked "area" from 0; x of bars may be words. `error` has the shape of y, or is a pair of them, below
    and above. It is drawn as a bar at points and as a band along a line.
    """

    name: str
    x: Sequence[float] | Sequence[str] | Samples
    y: Sequence[float] | Samples
    color: str
    look: str = "line"
    error: Sequence[float] | Samples | None = None

    @property
    def names(self) -> list[str]:
        """The words that x may be."""
        return [x for x in self.x if isinstance(x, str)]

    @property
    def places(self) -> Samples:
        """x as numbers: words stand at 0, 1, 2 and so on."""
        return np.asarray(np.arange(len(self.x)) if self.names else self.x, float)

    @property
    def ends(self) -> Samples:
        """y less its error, which is 0 where there is none, and plus it, of shape (2, len(y))."""
        error = np.nan_to_num(np.asarray(0.0 if self.error is None else self.error, float))
        below, above = np.broadcast_to(error, (2, len(self.y)))
        y = np.asarray(self.y, float)
        return np.stack([y - below, y + above])


class Mark(NamedTuple):
    """A place on the x axis, or a level on the y axis of a panel, and its text."""

    at: float
    text: str

    @classmethod
    def of(cls, text: str, figure: Figure) -> Mark:
        """A mark at a figure, with as many digits as its error allows."""
        value = f"{figure.value:.4g} {figure.unit}" if figure.error is None else figure.text()
        return cls(figure.value, f"{text} {value}")


class Span(NamedTuple):
    """A stretch of the x axis, and its text."""

    first: float
    last: float
    text: str
    color: str = "grey"


class Panel(NamedTuple):
    """Curves on one y axis of a quantity and its unit; the axis shows all the values it `includes`."""

    quantity: str
    unit: str
    curves: Sequence[Curve]
    levels: Sequence[Mark] = ()
    includes: Sequence[float] = ()

    @property
    def label(self) -> str:
        return f"{self.quantity} [{self.unit}]"

    @property
    def flag(self) -> bool:
        """Whether all that it shows steps between 0 and 1, which are no and yes."""
        values = np.concatenate([np.empty(0), *(np.asarray(c.y, float) for c in self.curves)])
        steps = {curve.look for curve in self.curves} == {"step"}
        return steps and bool(np.isin(values[np.isfinite(values)], [0.0, 1.0]).all())


class Lanes(NamedTuple):
    """Stretches of time as bars, in a lane for each name, the first on top."""

    rows: Mapping[str, Sequence[Span]]

    @property
    def bars(self) -> list[tuple[int, Span]]:
        """Every bar and the number of its lane."""
        return [(k, bar) for k, row in enumerate(self.rows.values()) for bar in row]


class SecondUnit(NamedTuple):
    """A second unit of the x axis, whose numbers are larger by a factor."""

    unit: str
    factor: float


class Chart(NamedTuple):
    """Panels stacked over one x axis with its marks and spans."""

    title: str
    x: str
    panels: Sequence[Panel | Lanes]
    marks: Sequence[Mark] = ()
    spans: Sequence[Span] = ()
    second: SecondUnit | None = None
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


class Level(NamedTuple):
    """A contour line of values over a plane, by default those of its field."""

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
    marks: Sequence[Mark] = ()


Picture = Chart | Field


def result_panel(
    quantity: str,
    result: Result,
    x: Samples,
    curves: Mapping[str, tuple[str, ...] | str],
    unit: str = "",
    rows: Any = slice(None),
    includes: Sequence[float] = (),
    levels: Sequence[Mark] = (),
) -> Panel:
    """Columns of a result over x, in their unit or in another. Each has a name, a color and perhaps a
    look, or only a color, and then the name of the quantity.

    Raises KeyError for a column that does not exist or a unit that it does not convert to.
    """
    own = {column: result.units[column] for column in curves}
    unit = unit or next(iter(own.values()))
    scale = {column: 1.0 if u == unit else DISPLAY_FACTORS[u, unit] for column, u in own.items()}
    drawn = []
    for column, told in curves.items():
        name, color, *look = (quantity, told) if isinstance(told, str) else told
        y = scale[column] * result[column][rows]
        drawn.append(Curve(name, x, y, color, look[0] if look else "line"))
    return Panel(quantity, unit, drawn, levels, includes)
