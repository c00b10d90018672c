"""The classical calculation, with constant inertia and a load over time, beside orbits: how far it holds.

Its ripple of torque and speed and its rod force are compared with the orbits of a sweep: once with the
spring as the only load, as in the formula after (26), and once with the whole load at constant speed,
including the inertia of the trough. The speed at which each error leaves its bounds is located on orbits
there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from workbench import Chart, Curve, Figure, Judgement, Mark, Panel, Table
from workbench.charts.model import FORCE, SPEED, TORQUE, SecondUnit
from workbench.figure import figure_of_figures
from workbench.roots import secant

from .first_order import Machine, Samples, classical, rod_force
from .speed_sweep import SPEEDS, SpeedSweep, columns_of

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
TOO_COARSE = "the sweep has too few speeds near the speed where the error passes the tolerance"
AT_TOLERANCE = (
    "the error at the lowest speed of the sweep is that of the tolerance, within its own error"
)
JUST_REACHED = "the error just reaches the tolerance at a lower speed, within its own error"
NOWHERE = "not even at the lowest speed of the sweep"
#: Points of an error curve between two speeds of a sweep: its extreme then has 1/64^2 of its height as its error.
CURVE_POINTS = 64
#: Most rounds in which orbits are added where an error may leave its tolerance between two speeds; each halves the
#: stretch around an extreme, or more, so that the doubt falls to a quarter.
MOST_ROUNDS = 4
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
        return abs({"torque": loads.torque, "speed": loads.speed, "force": loads.force}[self.load])

    def theory(self, machine: Machine, nu: Any) -> Any:
        """Return what first-order theory says at nu [rad/s], which leaves out less."""
        if self.load == "force":
            return abs(rod_force(machine, nu))
        return abs(machine.torque_ripple(nu) if self.load == "torque" else machine.speed_ripple(nu))


CALCULATIONS = [Calculation(method, load) for method in WITH_INERTIA for load in LOADS]


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


def compare(machine: Machine, sweep: SpeedSweep, tolerance: float) -> ClassicalComparison:
    """Compare the calculation with a sweep, and find where an error leaves the tolerance [%].

    Where an error may leave it between two speeds and come back, orbits are added to the sweep.
    """
    for _ in range(MOST_ROUNDS):
        more = {
            nu for case in CALCULATIONS for nu in doubtful_speeds(case, machine, sweep, tolerance)
        }
        if not more:
            break
        sweep = sweep.with_more(sorted(more))
    limits = limits_of(machine, sweep, tolerance)
    figures = {}
    for case in CALCULATIONS:
        what = f"{LOADS[case.load].name} {LOAD_TEXTS[case.method]}"
        meaning = f"speed up to which the {what} is accurate enough"
        figures[f"limit_{case.key}"] = limits[case]._replace(meaning=meaning)
        errors = percent_above_simulated(case, machine, sweep.columns)
        figures[f"worst_{case.key}"] = worst(*errors, f"largest error, {what}")
    figures["share"] = figure_of_figures(
        lambda nu: 100.0 * machine.m * nu**2 / machine.c,
        limits[Calculation("spring", "torque")],
        unit="%",
        meaning="inertia force over spring force at the first limit",
    )
    return ClassicalComparison(
        figures, table_of(machine, sweep), machine, tolerance, sweep.speeds[0]
    )


class Excess(NamedTuple):
    """A calculated amplitude over the simulated one, less 1, and the error of that [%]."""

    percent: Samples
    error: Samples


def percent_above_simulated(
    case: Calculation, machine: Machine, columns: Mapping[str, Samples]
) -> Excess:
    """Return how far the amplitude of a calculation is above the simulated one at each speed."""
    column = LOADS[case.load].column
    true, error = columns[column], columns[f"{column}_error"]
    ratio = case.amplitude(machine, columns["nu"]) / true
    return Excess(100 * (ratio - 1), 100 * ratio * error / true)


def table_of(machine: Machine, sweep: SpeedSweep) -> Table:
    """Return the quantities over the speed, and the error of each calculation."""
    units = {"nu": "rad/s"}
    for quantity in LOADS.values():
        units |= dict.fromkeys((quantity.column, f"{quantity.column}_error"), quantity.unit)
    columns = list(units)
    units |= {f"{case.key}{x}": "%" for case in CALCULATIONS for x in ("", "_error")}
    values = [sweep.columns[column] for column in columns]
    values += [
        x for case in CALCULATIONS for x in percent_above_simulated(case, machine, sweep.columns)
    ]
    return Table.of_rows(np.transpose(values).tolist(), units)


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


class ErrorCurve(NamedTuple):
    """The error [%] of a calculation at speeds between those of a sweep, and what is not known of it [%]."""

    nu: Samples
    error: Samples
    doubt: Samples


def error_curve(case: Calculation, machine: Machine, sweep: SpeedSweep) -> ErrorCurve:
    """Return the error of a calculation between the speeds of a sweep, which are among those of the curve.

    Both the calculation and first-order theory are known in closed form; only the ratio of orbits to theory, which
    is smooth, is interpolated. A straight line in place of the spline says what that leaves open.
    """
    nus = np.array(sweep.speeds)
    column = LOADS[case.load].column
    ratios = sweep.columns[column] / case.theory(machine, nus)
    parts = [np.linspace(a, b, CURVE_POINTS, endpoint=False) for a, b in pairwise(nus)]
    nu = np.concatenate([*parts, nus[-1:]])
    ratio = case.amplitude(machine, nu) / case.theory(machine, nu)
    smooth, straight = (
        100.0 * (ratio / x - 1.0)
        for x in (CubicSpline(nus, ratios)(nu), np.interp(nu, nus, ratios))
    )
    return ErrorCurve(nu, smooth, np.abs(smooth - straight))


def doubtful_speeds(
    case: Calculation, machine: Machine, sweep: SpeedSweep, tolerance: float
) -> Iterator[float]:
    """Yield speeds between those of a sweep at which an error may leave its tolerance and come back.

    They lie below the first speed of the sweep at which it has left it.
    """
    errors = np.abs(percent_above_simulated(case, machine, sweep.columns).percent)
    if len(errors) <= 1 or np.isnan(errors).any():
        return
    curve = error_curve(case, machine, sweep)
    beyond = np.flatnonzero(errors > tolerance)
    for k in range(int(beyond[0]) if len(beyond) else len(errors) - 1):
        inside = slice(k * CURVE_POINTS + 1, (k + 1) * CURVE_POINTS)
        if k + 1 < len(errors) and errors[k + 1] > tolerance:
            return
        most = np.abs(curve.error[inside]) + curve.doubt[inside]
        top = inside.start + int(np.argmax(most))
        is_inner = most.max() > max(errors[k], errors[k + 1])
        if is_inner and most.max() > tolerance:
            yield float(curve.nu[top])


class LimitGuess(NamedTuple):
    """Where the sweep has an error at its tolerance, with which sign, and the slope of the error there."""

    x: float
    level: float
    slope: float


def first_guess(
    case: Calculation, machine: Machine, sweep: SpeedSweep, tolerance: float
) -> LimitGuess | Figure:
    """Return where the sweep says that an error first leaves its tolerance, or the reason against one."""
    nus = np.array(sweep.speeds)
    errors, unsure = percent_above_simulated(case, machine, sweep.columns)
    if np.isnan(errors).any() or len(nus) <= 1:
        reason = "the sweep has fewer than two speeds, or one without a steady orbit"
        return Figure.undetermined("rad/s", reason)
    if abs(errors[0]) > tolerance:
        is_close = abs(errors[0]) - unsure[0] <= tolerance
        reason = UNKNOWN if math.isnan(unsure[0]) else AT_TOLERANCE if is_close else NOWHERE
        return Figure.undetermined("rad/s", reason)
    curve = error_curve(case, machine, sweep)
    spline = CubicSpline(curve.nu, curve.error)
    ends = [
        (float(x), s * tolerance)
        for s in (1, -1)
        for x in spline.solve(s * tolerance, extrapolate=False)
    ]
    before = nus < min(ends, default=(math.inf, 0.0))[0]
    if (np.abs(np.abs(errors) - tolerance) <= unsure)[before].any():
        return Figure.undetermined("rad/s", JUST_REACHED)
    if not ends:
        reason = f"the error stays below {tolerance:g} % at every speed of the sweep"
        return Figure.undetermined("rad/s", reason)
    x, level = min(ends)
    return LimitGuess(x, level, float(spline(x, 1)))


def limits_of(machine: Machine, sweep: SpeedSweep, tolerance: float) -> dict[Calculation, Figure]:
    """Return the lowest speed of the sweep at which each error leaves its tolerance, on orbits there."""
    guesses = {case: first_guess(case, machine, sweep, tolerance) for case in CALCULATIONS}
    figures = {case: x for case, x in guesses.items() if isinstance(x, Figure)}
    searched = {case: x for case, x in guesses.items() if isinstance(x, LimitGuess)}
    x, level, slope = np.array(list(searched.values())).reshape(-1, 3).T
    lost = np.zeros(len(x), bool)

    def residual(nu: Samples) -> tuple[Samples, Samples]:
        inside = (sweep.speeds[0] <= nu) & (nu <= sweep.speeds[-1])
        nu = np.where(inside, nu, np.nan)
        orbits = sweep.drive.orbits(machine, sweep.drive.for_each_step(nu), "limits")
        with np.errstate(invalid="ignore"):  # where no value is wanted
            columns = columns_of(sweep.drive, machine, nu, orbits)
            of_cases = [percent_above_simulated(case, machine, columns) for case in searched]
        value, error = np.array(of_cases)[np.arange(len(nu)), :, np.arange(len(nu))].T
        lost[inside & np.isnan(error)] = True
        return np.where(np.isnan(error), np.nan, value - level), error

    roots = secant(residual, x, slope)
    for k, case in enumerate(searched):
        reason = UNKNOWN if lost[k] else TOO_COARSE
        figures[case] = (
            Figure(float(roots.x[k]), "rad/s", float(roots.error[k]))
            if sweep.speeds[0] <= roots.x[k] <= sweep.speeds[-1]
            else Figure.undetermined("rad/s", reason)
        )
    return figures


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
    levels = [Mark(s * r.tolerance, f"{s * r.tolerance:+g} %") for s in (1, -1)]
    at, panels = r.frame["nu"].to_numpy(), []
    for method in STYLES:
        lines = [
            Curve(name, at, r.frame[f"{method}_{load}"].to_numpy(), color, "linked")
            for load, (_, name, _, color) in LOADS.items()
        ]
        text = LOAD_TEXTS[method].removeprefix("with ").removeprefix("the ")
        panels.append(Panel(f"error, {text}", "%", lines, levels))
    return Chart(
        "Errors of both classical calculations",
        "operating speed [rad/s]",
        panels,
        marks,
        second=RPM,
    )
