"""Pictures as values: curves over an axis and quantities over a plane. How they are drawn is not said here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from ..figure import Figure

Samples = NDArray[np.float64]
Rows = slice | NDArray[np.bool_] | NDArray[np.int64]
Look = Literal["line", "theory", "points", "linked", "step", "bars", "area"]
CurveLook = tuple[str, ...] | str

#: Colour of torques, and of what was measured or is exceeded.
TORQUE = "red"
#: Colour of speeds.
SPEED = "blue"
#: Colour of lifts, angles and lags.
LIFT = "green"
#: Colour of forces.
FORCE = "gold"
#: Colour of powers.
POWER = "purple"
#: Colour of theory, which is no result of a simulation.
THEORY = "grey"
#: Colours of one quantity for several machines or settings, in this order.
SERIES = ("purple", "gold", "sky", "green", "red", "blue")


class Curve(NamedTuple):
    """y over x.

    Attributes
    ----------
    name : str
        What is written beside it.
    x : sequence of float or of str
        Where the curve is; texts are at 0, 1, 2 and so on.
    y : sequence of float
        Values, as many as x. NaN in a line is a gap; NaN in points and bars is a value that is not
        determined, which the picture says.
    color : str
        A key of `style.COLORS`; points have the shape of their colour.
    look : str
        A "line", a dashed line of "theory", "points", "linked" points, a "step", "bars" or a stacked "area"
        from 0.
    error : sequence of float, optional
        Errors in the shape of y, or a pair of these, below and above. They are drawn as bars at points and as
        a band along a line.
    breaks : sequence of int
        Positions of values to which no line leads from the value before, since y jumps between them.
    """

    name: str
    x: Sequence[float] | Sequence[str] | Samples
    y: Sequence[float] | Samples
    color: str
    look: Look = "line"
    error: Sequence[float] | Samples | None = None
    breaks: Sequence[int] = ()

    @property
    def categories(self) -> list[str]:
        """The texts that x may consist of."""
        return [x for x in self.x if isinstance(x, str)]

    @property
    def positions(self) -> Samples:
        """Positions x as numbers: texts are at 0, 1, 2 and so on."""
        return np.asarray(np.arange(len(self.x)) if self.categories else self.x, float)

    @property
    def bounds(self) -> Samples:
        """Values less their error, which is 0 where there is none, and plus it; of shape (2, len(y))."""
        error = np.nan_to_num(np.asarray(0.0 if self.error is None else self.error, float))
        below, above = np.broadcast_to(error, (2, len(self.y)))
        y = np.asarray(self.y, float)
        return np.stack([y - below, y + above])


class NamedLook(NamedTuple):
    """The name of a curve beside it, its colour and its look."""

    name: str
    color: str
    look: Look = "line"

    @classmethod
    def of(cls, texts: CurveLook, quantity: str) -> NamedLook:
        """Return the look that a question declares for a curve.

        Parameters
        ----------
        texts
            Name, colour and perhaps look; or only a colour.
        quantity
            The name where there is only a colour.

        Raises
        ------
        ValueError
            For a look that does not exist.
        """
        if isinstance(texts, str):
            return cls(quantity, texts)
        name, color, *rest = texts
        for look in get_args(Look):
            if rest in ([], [look]):
                return cls(name, color, look)
        raise ValueError(
            f"curve {name!r}: {', '.join(rest)!r} must be one of {', '.join(get_args(Look))}"
        )


class Mark(NamedTuple):
    """A value on the x axis, or a level on the y axis of a panel, and its text."""

    at: float
    text: str

    @classmethod
    def of(cls, text: str, figure: Figure) -> Mark:
        """Return a mark at a figure, with as many digits as its error allows.

        Parameters
        ----------
        text : str
            What the mark is called.
        figure : Figure
            Where it is.
        """
        value = f"{figure.value:.4g} {figure.unit}" if figure.error is None else figure.text()
        return cls(figure.value, f"{text} {value}")


class Arrow(NamedTuple):
    """An arrow at x from one y to another: a quantity jumps there."""

    x: float
    start: float
    end: float
    color: str = "grey"


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
    arrows: Sequence[Arrow] = ()

    @property
    def label(self) -> str:
        """The quantity with its unit."""
        return f"{self.quantity} [{self.unit}]"

    @property
    def is_flag(self) -> bool:
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


class GridAxis(NamedTuple):
    """An axis of a plane: quantity, unit, values, and whether they are drawn logarithmically."""

    quantity: str
    unit: str
    values: Samples
    log: bool = False

    @property
    def label(self) -> str:
        """The quantity with its unit."""
        return f"{self.quantity} [{self.unit}]"


class Level(NamedTuple):
    """A contour line of values over a plane, by default those of its heat map."""

    at: float
    text: str
    values: Samples | None = None


class HeatMap(NamedTuple):
    """Values of shape (len(y), len(x)), NaN where there is none, with what is drawn over them.

    The colours are those of a scale, and follow the logarithm of the values where `log` is set,
    which are then above 0. Without a unit the values have the unit 1.
    """

    title: str
    x: GridAxis
    y: GridAxis
    quantity: str
    values: Samples
    curves: Sequence[Curve] = ()
    log: bool = False
    levels: Sequence[Level] = ()
    spans: Sequence[Span] = ()
    scale: str = "size"
    marks: Sequence[Mark] = ()


Picture = Chart | HeatMap
