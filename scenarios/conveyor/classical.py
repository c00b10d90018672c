"""The classical calculation, with constant inertia and a load over time, beside orbits: how far it holds.

Its ripple of torque and speed and its rod force are compared with the orbits of a sweep: once with the
spring as the only load, as in the formula after (26), and once with the whole load at constant speed,
including the inertia of the trough. The speed at which each error leaves its bounds is located on orbits
there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from workbench import Chart, Context, Curve, Figure, Judgement, Mark, Panel, Table
from workbench.charts.model import FORCE, SPEED, TORQUE, SecondUnit
from workbench.figure import figure_of_figures
from workbench.find import Found, search
from workbench.orbits import FigureColumn
from workbench.study.charts import curves_over

from .first_order import Machine, Samples, classical, rod_force
from .orbit import DriveOrbit
from .speed_sweep import SPEEDS, SpeedSweep

if TYPE_CHECKING:
    from pandas import DataFrame

#: Speeds of set A below those of its resonance, where the spring alone is the load [rad/s].
SLOW = "6,8,10,12,14,16,18,"
SWEEPS = {"A": SLOW + SPEEDS["A"], "B": SPEEDS["B"]}
TABLE = "classical.csv"
#: Whether a calculation has the inertia of the trough in its load.
WITH_INERTIA = {"spring": False, "whole": True}
LOAD_TEXTS = {"spring": "with the spring alone", "whole": "with spring and inertia"}
STYLES = {
    "spring": ("classical, spring alone, after (26)", "purple"),
    "whole": ("classical, spring and inertia", "black"),
}
UNKNOWN = "the coupling error of an orbit is not known; take more steps per revolution"
AT_TOLERANCE = (
    "the error at the lowest speed of the sweep is that of the tolerance, within its own error"
)
JUST_REACHED = "the error just reaches the tolerance at a lower speed, within its own error"
NOWHERE = "not even at the lowest speed of the sweep"
RPM = SecondUnit("rpm", 30 / math.pi)


class CalculatedLoad(NamedTuple):
    """What is calculated: its column, name, unit and color."""

    column: str
    name: str
    unit: str
    color: str


LOADS = {
    "torque": CalculatedLoad("tau2", "torque ripple", "N.m", TORQUE),
    "speed": CalculatedLoad("w2", "speed ripple", "rad/s", SPEED),
    "force": CalculatedLoad("f_rod_peak", "largest rod force", "N", FORCE),
}


class Calculation(NamedTuple):
    """A calculation, by its load, and what it calculates."""

    method: str
    load: str

    @property
    def key(self) -> str:
        """The end of the names of its figures."""
        return f"{self.method}_{self.load}"

    def amplitude(self, machine: Machine, nu: Any) -> Any:
        """Return what the calculation says at nu [rad/s]."""
        loads = classical(machine, nu, inertia=WITH_INERTIA[self.method])
        return abs(getattr(loads, self.load))

    def theory(self, machine: Machine, nu: Any) -> Any:
        """Return what first-order theory says at nu [rad/s], which leaves out less."""
        if self.load == "force":
            return abs(rod_force(machine, nu))
        return abs(machine.torque_ripple(nu) if self.load == "torque" else machine.speed_ripple(nu))


CALCULATIONS = [Calculation(method, load) for method in WITH_INERTIA for load in LOADS]


class ClassicalOrbit(DriveOrbit):
    """An orbit with the errors of all calculations [%] as figures more."""

    @classmethod
    def more_columns(
        cls, asked: Sequence[DriveOrbit], columns: Mapping[str, FigureColumn]
    ) -> Mapping[str, Callable[[], FigureColumn]]:
        """Return how far calculations are above the orbits."""
        machine, nu = Machine.of([o.machine for o in asked]), np.array([o.nu for o in asked])

        def above(case: Calculation) -> FigureColumn:
            x, told = columns[LOADS[case.load].column], case.amplitude(machine, nu)
            slope = 100.0 * told / x.value**2
            return x.each(lambda y: 100.0 * (told / y - 1.0), "%", "", slope)

        more = {case.key: partial(above, case) for case in CALCULATIONS}
        return {**super().more_columns(asked, columns), **more}

    def guide(self, figure: str, over: str) -> Any:
        """The error of a calculation is guided by the ratio of orbits to theory, which is smooth."""
        case = next((x for x in CALCULATIONS if x.key == figure), None)
        return ErrorGuide([figure], case, self.given) if case else super().guide(figure, over)


class ErrorGuide(NamedTuple):
    """The error of a calculation over the speed [%], by the ratio of orbits to theory."""

    figures: Sequence[str]
    case: Calculation
    machine: Machine
    period: float = math.inf

    def theory(self, nu: Any) -> Any:
        """That of theory alone."""
        return 1.0 + 0.0 * nu

    def smooth(self, nu: Any, values: Any) -> Any:
        """The ratio of orbits to theory."""
        told = self.case.amplitude(self.machine, nu)
        return told / (1.0 + values[0] / 100.0) / self.case.theory(self.machine, nu)

    def figure(self, nu: Any, smooth: Any) -> Any:
        """The error of the calculation."""
        told = self.case.amplitude(self.machine, nu)
        return 100.0 * (told / (self.case.theory(self.machine, nu) * smooth) - 1.0)


class ClassicalComparison(NamedTuple):
    """The classical calculation beside a sweep: up to where it holds, and its errors over the speed."""

    figures: dict[str, Figure]
    table: Table
    machine: Machine
    tolerance: float
    slowest: float

    @property
    def frame(self) -> DataFrame:
        """The rows over the speed."""
        return self.table.frame


def compare(
    context: Context, machine: Machine, sweep: SpeedSweep, tolerance: float
) -> ClassicalComparison:
    """Compare the calculation with a sweep of ClassicalOrbit, and find where an error leaves the tolerance [%]."""
    searches = [
        [sweep.search(case.key, sense * tolerance) for sense in (1.0, -1.0)]
        for case in CALCULATIONS
    ]
    found = iter(search(context, [s for pair in searches for s in pair]))
    figures = {}
    for case in CALCULATIONS:
        what = f"{LOADS[case.load].name} {LOAD_TEXTS[case.method]}"
        meaning = f"speed up to which the {what} is accurate enough"
        errors = sweep.motions.columns[case.key]
        ends = [x for x in (*next(found), *next(found)) if math.isfinite(x.x)]
        end = limit_of(np.array(sweep.speeds), errors, tolerance, ends)
        figures[f"limit_{case.key}"] = end._replace(meaning=meaning)
        figures[f"worst_{case.key}"] = worst(errors.value, errors.error, f"largest error, {what}")
    figures["share"] = figure_of_figures(
        lambda nu: 100.0 * machine.m * nu**2 / machine.c,
        figures["limit_spring_torque"],
        unit="%",
        meaning="inertia force over spring force at the first limit",
    )
    names = [*(x.column for x in LOADS.values()), *(case.key for case in CALCULATIONS)]
    table = sweep.motions.table({"nu": ("rad/s", sweep.speeds)}, dict(zip(names, names)))
    return ClassicalComparison(figures, table, machine, tolerance, sweep.speeds[0])


def limit_of(nus: Samples, errors: FigureColumn, tolerance: float, ends: Sequence[Found]) -> Figure:
    """Return the lowest speed of the sweep at which an error leaves its tolerance, or why there is none."""
    size, unsure, reason = np.abs(errors.value), errors.error, ""
    first = min(ends, key=lambda x: x.x, default=None)
    before = nus < (first.x if first else math.inf)
    if np.isnan(size).any() or len(nus) <= 1:
        reason = "the sweep has fewer than two speeds, or one without a steady orbit"
    elif size[0] > tolerance:
        is_close = size[0] - unsure[0] <= tolerance
        reason = UNKNOWN if math.isnan(unsure[0]) else AT_TOLERANCE if is_close else NOWHERE
    elif (np.abs(size - tolerance) <= unsure)[before].any():
        reason = JUST_REACHED
    elif first is None:
        reason = f"the error stays below {tolerance:g} % at every speed of the sweep"
    if reason or first is None:
        return Figure.undetermined("rad/s", reason)
    return first.place


def worst(values: Samples, errors: Samples, meaning: str) -> Figure:
    """Return the largest of errors of either sign; its own error covers others that may be as large."""
    if np.isnan(values).any():
        return Figure.undetermined("%", "not every speed of the sweep has a steady orbit", meaning)
    if np.isnan(errors).any():
        return Figure.undetermined("%", UNKNOWN, meaning)
    sizes, top = np.abs(values), int(np.argmax(np.abs(values)))
    as_large = sizes + errors >= sizes[top] - errors[top]
    error = float((np.abs(values - values[top]) + errors)[as_large].max())
    return Figure(float(values[top]), "%", error, meaning)


def judgements(r: ClassicalComparison) -> list[Judgement]:
    """Return up to which speed both calculations hold."""
    return [holds(r, method) for method in WITH_INERTIA]


def holds(r: ClassicalComparison, method: str) -> Judgement:
    """Return up to which speed a calculation is within the tolerance."""
    what = f"classical calculation {LOAD_TEXTS[method]} as its load, within {r.tolerance:g} % up to"
    limits = {load: r.figures[f"limit_{method}_{load}"] for load in LOADS}
    inaccurate = [LOADS[load].name for load, end in limits.items() if end.reason == NOWHERE]
    if inaccurate:
        note = (
            f"no speed of the sweep: it is off by more for the {' and the '.join(inaccurate)} already at "
            f"{r.slowest:g} rad/s"
        )
        return Judgement(what, note=note)
    for load, end in limits.items():
        top = r.figures[f"worst_{method}_{load}"]
        is_within = top.error is not None and abs(top.value) + top.error <= r.tolerance
        if end.error is None and not is_within:
            return Judgement(what, Figure.undetermined("rad/s", top.reason or end.reason))
    ends = [end for end in limits.values() if end.error is not None]
    if not ends:
        return Judgement(what, note="every speed of the sweep")
    return Judgement(what, min(ends, key=lambda end: end.value))


def curves(machine: Machine, load: str, nu: Any) -> list[Curve]:
    """Return both calculations of a load over speeds nu [rad/s]."""
    return [
        Curve(label, nu, Calculation(method, load).amplitude(machine, nu), shade, "theory")
        for method, (label, shade) in STYLES.items()
    ]


def force_over_speed(r: ClassicalComparison, nu: Any) -> Panel:
    """Return the largest rod force by both calculations, over speeds nu [rad/s], and of the orbits."""
    column, name, unit, color = LOADS["force"]
    at, y, error = (r.frame[x].to_numpy() for x in ("nu", column, f"{column}_error"))
    points = Curve("co-simulation", at, y, color, "points", error)
    return Panel(name, unit, [*curves(r.machine, "force", nu), points], includes=(0.0,))


def error_chart(r: ClassicalComparison, marks: Sequence[Mark]) -> Chart:
    """Return the errors of both calculations over the speed."""
    panels = {
        f"error {LOAD_TEXTS[method]}": {
            f"{method}_{load}": (x.name, x.color, "linked") for load, x in LOADS.items()
        }
        for method in STYLES
    }
    levels = [Mark(s * r.tolerance, f"{s * r.tolerance:+g} %") for s in (1, -1)]
    title, x = "Errors of both classical calculations", "operating speed [rad/s]"
    return curves_over(
        r.table, "nu", panels, title, marks=marks, levels=dict.fromkeys(panels, levels), x=x
    )
