"""What a question declares to be live: sliders, runs, curves, numbers, a motion, a sweep.

All values are formulas, see `formula`. They may contain options and start values by name, as the sliders have
them, the `values` of the page, and numbers that were read before, as `figures.NAME`. Formulas of curves may
also contain outputs of the FMUs, `time`, and `crank_angle` [rad], which is 0 where the last revolution begins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from cosim import SetupError
from cosim.metrics import (
    Change,
    Crossing,
    Largest,
    Last,
    LastTurn,
    Mean,
    Metric,
    Smallest,
    TimeOfLargest,
    TimeOfSmallest,
)

from ..charts.model import CurveLook, NamedLook
from ..charts.motion import Columns, Shape
from ..dimensions import check_unit, conversion
from ..formula import Formula

Text = str | float
Formulas = Mapping[str, Text]
#: Formulas by what they may name, as `encoder` encodes them: values; numbers read before, too; columns; and a window,
#: which is a time, `REVOLUTION`, or empty.
ValuesText = Annotated[Text, "formula_of_values"]
NumbersText = Annotated[Text, "formula_of_numbers"]
ColumnText = Annotated[str, "formula_of_columns"]
Window = Annotated[Text, "window_formula"]
#: the window of the last revolution of `Live.angle`
REVOLUTION = "revolution"
#: How a number may be read from a column: a function of js/readers.js, and the metric that it has in an answer.
READERS: Mapping[str, type[Metric] | None] = {
    "last": Last, "change": Change, "max": Largest, "min": Smallest, "mean": Mean, "first_crossing": Crossing,
    "time_of_max": TimeOfLargest, "time_of_min": TimeOfSmallest, "amplitude": None, "phase": None,
}  # fmt: skip
#: Those whose number has the unit of the column; the others are times, or an angle.
UNIT_OF_COLUMN = ("last", "change", "max", "min", "mean", "amplitude")


@dataclass(frozen=True)
class Slider:
    """A slider.

    Attributes
    ----------
    name : str
        An option of the question or a start value of an FMU, "motor.T".
    low, high : float
        Its range, which contains the original value, and is widened to include a requested one outside it.
    """

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class Reader:
    """How a number is read from a column of the run.

    Attributes
    ----------
    kind : str
        One of `READERS`.
    column : str
        A formula of outputs, such as "abs(motor.tau)".
    window : str or float
        The rows that count: all by default, those from a time [s] on, or "revolution", the last one.
    order : int
        The order of the crank angle, for amplitude and phase.
    level : str or float
        The level of first_crossing.
    run : str
        The run, the first by default.
    angle : str
        The output that is the crank angle [rad], `Live.angle` by default.
    """

    kind: str
    column: ColumnText
    window: Window = ""
    order: int = 1
    level: NumbersText = 0.0
    run: str = ""
    angle: str = ""

    def metric(self, values: Mapping[str, float]) -> Metric:
        """Return the same as a metric of the column of its formula, with the values of options and parameters.

        Raises
        ------
        SetupError
            For a kind that no metric has.
        """
        kind = READERS.get(self.kind)
        if kind is None:
            names = ", ".join(name for name, metric in READERS.items() if metric)
            raise SetupError(f"reader {self.kind!r} of {self.column} must be one of {names}")
        level = {"level": Formula.read(self.level)(values)} if kind is Crossing else {}
        if self.window == REVOLUTION:
            return LastTurn(kind(self.column, **level), over=self.angle)
        begin = {} if self.window == "" else {"begin": Formula.read(self.window)(values)}
        return kind(self.column, **level, **begin)

    def factor(self, from_unit: str, to_unit: str, where: str) -> float:
        """Return the factor between units of a column; raises SetupError where there is none, and for a time or phase in another."""
        if self.kind in UNIT_OF_COLUMN:
            return conversion(from_unit, to_unit or from_unit, f"{where}: {self.column}")
        quantity, own = ("an angle", "deg") if self.kind == "phase" else ("a time", "s")
        if to_unit not in ("", own):
            raise SetupError(f"{where}: {self.kind} is {quantity} in {own}, not in {to_unit}")
        return 1.0


@dataclass(frozen=True)
class Number:
    """A number of a run, which is read from it or follows from others.

    Attributes
    ----------
    name : str
        That of the figure of the answer which it is, or which stands beside it on the live page; any other identifier
        if there is none.
    value : Reader, Metric, str or float
        How it is read from the run, or a formula. What only a metric reads is in the answer, but not on the live page.
    unit, meaning : str
        Those of the figure by default; the unit of a `Question.numbers` is by default that of its column, which is
        converted to another one, and its meaning may name options, "up to {stop:g} s".
    when : str
        A formula; where it is 0 the number is not there, and `otherwise` says why.
    is_visible : bool
        Whether it is shown, or only used by other formulas.
    """

    name: str
    value: Annotated[Reader | Metric | Text, "formula_of_numbers"]
    unit: str = ""
    meaning: str = ""
    when: NumbersText = 1.0
    otherwise: str = ""
    is_visible: bool = True


@dataclass(frozen=True)
class RunPanel:
    """Curves of columns on one axis, for the picture and the live page.

    Attributes
    ----------
    quantity : str
        What the axis shows.
    curves : mapping of str to str or tuple
        By formula, "motor.tau", the color, or name, color and perhaps look, as `NamedLook.of` reads them.
    unit : str
        The unit of the axis, by default that of the first column. A column alone is converted to it.
    levels : mapping of str to str or float
        Lines across the panel, by their text.
    includes : sequence of float
        Values that the axis shows in any case.
    """

    quantity: str
    curves: Mapping[str, CurveLook]
    unit: str = ""
    levels: Formulas = field(default_factory=dict)
    includes: Sequence[float] = ()

    def looks(self, runs: Sequence[LiveRun]) -> list[NamedLook]:
        """Return name, color and look of every curve of every run; several runs give their curves name and color."""
        looks = [NamedLook.of(texts, self.quantity) for texts in self.curves.values()]
        if len(runs) <= 1:
            return looks
        return [
            look._replace(name=x.name, color=x.color or look.color) for x in runs for look in looks
        ]

    def units(
        self, columns: Mapping[str, str], known: Mapping[str, str], where: str
    ) -> tuple[str, dict[str, float]]:
        """Return the unit of the axis, and by curve the factor to it: that of a column alone, or 1.

        Parameters
        ----------
        columns, known
            The units of columns, and of all that formulas may name.
        where
            What messages begin with.

        Raises
        ------
        SetupError
            If there is no unit, and for what is in another one.
        """
        unit = self.unit or columns.get(next(iter(self.curves)), "")
        if not unit:
            raise SetupError(f"{where} needs a unit, as in unit='m'")
        for formula in (*self.levels.values(), *(x for x in self.curves if x not in columns)):
            check_unit(formula, unit, known, where)
        own = {text: columns.get(text, "") for text in self.curves}
        return unit, {text: conversion(x, unit, f"{where}: {text}") for text, x in own.items()}


@dataclass(frozen=True)
class RunChart:
    """Panels over one axis, for the picture and the live page.

    Attributes
    ----------
    title, label : str
        Title of the chart and label of its x axis, "time [s]".
    panels : sequence of RunPanel
        From top to bottom.
    x : str
        The formula of the x axis.
    window : str or float
        The rows that are drawn, as in `Reader`.
    marks : mapping of str to (formula, unit)
        Vertical lines, by their text, which is followed by the value.
    """

    title: str
    label: str
    panels: Sequence[RunPanel]
    x: ColumnText = "time"
    window: Window = ""
    marks: Mapping[str, tuple[Text, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Coordinate:
    """A column that moves a drawing.

    Attributes
    ----------
    column : str
        The output, "conveyor.phi".
    low, high : float
        The range in which the drawing is made.
    turns : tuple of float
        Empty for a length, on which points depend linearly. For an angle, the multiples of it by which
        points turn.
    """

    column: str
    low: float
    high: float
    turns: tuple[float, ...] = ()


@dataclass(frozen=True)
class Caption:
    """A value below the drawing: its text, formula, unit and decimals, or the texts of 0, 1, 2 .."""

    text: str
    value: ColumnText
    unit: str = ""
    decimals: int = 1
    texts: tuple[str, ...] = ()

    def told(self, value: float) -> str:
        """Return the text with a value."""
        number = self.texts[round(value)] if self.texts else f"{value:.{self.decimals}f}"
        return f"{self.text} {number} {self.unit}".strip()


@dataclass(frozen=True)
class LiveMotion:
    """A mechanism in motion.

    Attributes
    ----------
    title, note : str
        Title and what is said below.
    draw : callable
        Columns by name, of shape (frames,), to shapes, as for a still motion. Points must depend linearly
        on lengths and on sine and cosine of the turned angles, and otherwise on nothing that a slider moves.
    coordinates : sequence of Coordinate
        The columns that `draw` needs.
    captions : sequence of Caption
        What stands below.
    slow : float
        How many times slower than real time it is shown.
    window : str or float
        The rows that are shown, as in `Reader`.
    offset : tuple of float
        How far the drawing of each further run is moved, right and up [m].
    """

    title: str
    draw: Callable[[Columns], Sequence[Shape]]
    coordinates: Sequence[Coordinate]
    captions: Sequence[Caption]
    slow: float
    note: str = ""
    window: Window = ""
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class LiveRun:
    """A run: its name and color where there are several, and start values of its own."""

    name: str = ""
    color: str = ""
    start: Formulas = field(default_factory=dict)


@dataclass(frozen=True)
class Steady:
    """A run that goes on until its revolutions repeat.

    Attributes
    ----------
    tolerance : float
        The share by which a number may still change between two pairs of revolutions.
    longest : int
        The number of revolutions after which it ends in any case.
    """

    tolerance: float
    longest: int


@dataclass(frozen=True)
class LiveSweep:
    """Runs over a speed or a parameter.

    Attributes
    ----------
    over : str
        The option or start value that is swept; its slider marks its own value.
    values : sequence of float
        The values of the sweep.
    step : str or float
        The communication step [s] of its runs.
    steady : Steady, optional
        As in `Live`.
    numbers : sequence of Number
        What each run gives.
    chart : RunChart
        Curves over the swept value. Those with numbers are points of the sweep, others are drawn finely.
    """

    over: str
    values: Sequence[float]
    step: ValuesText
    numbers: Sequence[Number]
    chart: RunChart
    steady: Steady | None = None


@dataclass(frozen=True, kw_only=True)
class Live:
    """The live part of a question's page.

    Attributes
    ----------
    sliders : sequence of Slider
        What the user may move.
    charts, numbers, motion
        What is shown of the run.
    values : mapping of str to str or float
        Names for intermediate values, each of which may use those before.
    start : mapping of str to str or float
        Start values that follow options. One that the user sets comes first, unless its formula contains it.
    factors : mapping of str to str or float
        Factors of wires, by the input that they drive.
    runs : sequence of LiveRun
        One by default.
    stop, step : str or float
        Simulated time and communication step [s], by default the options of these names. Where there are no
        such options, formulas know them by these names. A steady run ends after whole pairs of revolutions
        of `stop` each.
    angle : str
        The output that is the crank angle [rad], for revolutions.
    steady : Steady, optional
        Whether the run goes on until it repeats.
    until : str or float
        The time [s] up to which rows are shown, all where it is not a number.
    sweep : LiveSweep, optional
        Runs over a speed or a parameter.
    """

    sliders: Sequence[Slider]
    charts: Sequence[RunChart]
    numbers: Sequence[Number] = ()
    motion: LiveMotion | None = None
    values: Formulas = field(default_factory=dict)
    start: Formulas = field(default_factory=dict)
    factors: Formulas = field(default_factory=dict)
    runs: Sequence[LiveRun] = (LiveRun(),)
    stop: ValuesText = "stop"
    step: ValuesText = "step"
    angle: str = ""
    steady: Steady | None = None
    until: Window = ""
    sweep: LiveSweep | None = None
