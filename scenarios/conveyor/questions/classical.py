"""How far can the classical calculation, with constant inertia and a load over time, be trusted?

Its ripple of torque and speed and its rod force are compared with co-simulation at each speed: once
with the spring as the only load, as in the formula after (26), and once with the whole load at constant
speed, including the inertia of the trough. The speed at which each error leaves its bounds is located
on orbits there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from workbench import Chart, Context, Curve, Figure, Findings, Mark, Panel, Show, Table, option
from workbench.charts.model import FORCE, SPEED, TORQUE, SecondUnit
from workbench.figure import listed
from workbench.measure import Measured, crossing_times
from workbench.roots import NoRootError, SecantSearch

from .. import motion
from ..features import ResponseLine
from ..first_order import Machine, classical
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive
from ..options import LINEAR_MOTOR_STARTS, SweepOptions, linear_runner, speeds_of
from ..rows import SPEEDS, Row, SpeedSweep, rows_of, sweep_speeds

if TYPE_CHECKING:
    from pandas import DataFrame

PARTS = DRIVE
FIXED_STARTS = LINEAR_MOTOR_STARTS
PARALLEL = True
#: Speeds of set A below those of its resonance, where the spring alone is the load [rad/s].
SLOW = "6,8,10,12,14,16,18,"
SWEEPS = {"A": SLOW + SPEEDS["A"], "B": SPEEDS["B"]}
TABLE = "classical.csv"
#: Whether a calculation has the inertia of the trough in its load.
WITH_INERTIA = {"spring": False, "whole": True}
LOAD_TEXTS = {"spring": "with the spring alone", "whole": "with spring and inertia"}
STYLES = {
    "spring": ("spring alone, after (26)", "purple"),
    "whole": ("spring and inertia", "black"),
}
UNKNOWN = "the coupling error of an orbit is not known; take more steps per revolution"
TOO_COARSE = "the sweep has too few speeds near the speed where the error passes the tolerance"
AT_TOLERANCE = (
    "the error at the lowest speed of the sweep is that of the tolerance, within its own error"
)
NOWHERE = "not even at the lowest speed of the sweep"


@dataclass(frozen=True, kw_only=True)
class Options(SweepOptions):
    tolerance: float = option(5.0, "error that is accepted", "%", above=0.0)


class Quantity(NamedTuple):
    """What is calculated: its column, name, unit and color."""

    column: str
    name: str
    unit: str
    color: str


QUANTITIES = {
    "torque": Quantity("tau2", "torque ripple", "N.m", TORQUE),
    "speed": Quantity("w2", "speed ripple", "rad/s", SPEED),
    "force": Quantity("f_rod_peak", "largest rod force", "N", FORCE),
}


class Case(NamedTuple):
    """A calculation, by its load, and what it calculates."""

    method: str
    load: str

    @property
    def key(self) -> str:
        """The end of the names of its figures."""
        return f"{self.method}_{self.load}"

    def amplitude(self, machine: Machine, nu: Any) -> Any:
        """Return what the calculation says at nu [rad/s]."""
        loads = classical(machine, nu, WITH_INERTIA[self.method])
        return abs({"torque": loads.torque, "speed": loads.speed, "force": loads.force}[self.load])


CASES = [Case(method, load) for method in WITH_INERTIA for load in QUANTITIES]


class ClassicalData(NamedTuple):
    """The sweep, the machine, and the rows of the table."""

    sweep: SpeedSweep
    machine: Machine
    frame: DataFrame


def solve(o: Options, context: Context) -> Findings:
    """Sweep, compare, and find where an error is no longer accepted; raises cosim.SetupError."""
    machine, runner = linear_runner(o, context)
    nus = o.speeds or speeds_of(SWEEPS[o.set])
    for nu in nus:
        runner.check(machine, nu)
    multiples = runner.step_multiples(machine, nus[0])
    line = ResponseLine(lambda nu: (machine, nu), nus[0], nus[-1])
    sweep = sweep_speeds(runner, line, nus, multiples)
    limits = limits_of(machine, sweep, o.tolerance, multiples)
    figures = {}
    for case in CASES:
        what = f"{QUANTITIES[case.load].name} {LOAD_TEXTS[case.method]}"
        meaning = f"speed up to which the {what} is accurate enough"
        figures[f"limit_{case.key}"] = limits[case]._replace(meaning=meaning)
        errors = [deviation(case, machine, row) for row in sweep.rows]
        figures[f"worst_{case.key}"] = worst(errors, f"largest error, {what}")
    end = limits[Case("spring", "torque")]
    inertia = Figure.undetermined("%", end.reason)
    if end.error is not None:
        value = 100 * machine.m * end.value**2 / machine.c
        inertia = Figure(value, "%", 2 * value * end.error / end.value)
    figures["share"] = inertia._replace(
        meaning="inertia force over spring force at the first limit"
    )
    table = table_of(machine, sweep)
    return Findings(
        figures,
        ClassicalData(sweep, machine, table.frame),
        conveyor_drive(context.fmus, {**machine.start(nus[0]), **o.start}),
        communication=f"{o.steps_per_rev} steps per revolution",
        algorithm=o.algorithm,
        tables={TABLE: table},
        defaults={"speeds": nus},
    )


def deviation(case: Case, machine: Machine, row: Row) -> Measured:
    """Return how far a calculation is above what was simulated, in %."""
    column = QUANTITIES[case.load].column
    true, error = row[column], row[f"{column}_error"]
    ratio = case.amplitude(machine, row["nu"]) / true
    return Measured(100 * (ratio - 1), 100 * ratio * error / true)


def table_of(machine: Machine, sweep: SpeedSweep) -> Table:
    """Return the quantities over the speed, and the error of each calculation."""
    units = {"nu": "rad/s"}
    for quantity in QUANTITIES.values():
        units |= dict.fromkeys((quantity.column, f"{quantity.column}_error"), quantity.unit)
    columns = list(units)
    units |= {f"{case.key}{x}": "%" for case in CASES for x in ("", "_error")}
    rows = [
        [row[column] for column in columns]
        + [x for case in CASES for x in deviation(case, machine, row)]
        for row in sweep.rows
    ]
    return Table.of_rows(rows, units)


def worst(errors: Sequence[Measured], meaning: str) -> Figure:
    """Return the largest of errors of either sign; its own error covers others that may be as large."""
    top = max(errors, key=lambda x: math.inf if math.isnan(x.value) else abs(x.value))
    if math.isnan(top.value):
        return Figure.undetermined("%", "not every speed of the sweep has a steady orbit", meaning)
    if any(math.isnan(x.error) for x in errors):
        return Figure.undetermined("%", UNKNOWN, meaning)
    as_large = [x for x in errors if abs(x.value) + x.error >= abs(top.value) - top.error]
    error = max(abs(x.value - top.value) + x.error for x in as_large)
    return Figure(top.value, "%", error, meaning)


class LimitGuess(NamedTuple):
    """Where the sweep has an error at its tolerance, with which sign, and the slope of the error there."""

    x: float
    level: float
    slope: float


def first_guess(
    case: Case, machine: Machine, sweep: SpeedSweep, tolerance: float
) -> LimitGuess | Figure:
    """Return where the sweep says that an error first leaves its tolerance, or the reason against one."""
    nus = np.array(sweep.speeds)
    errors, unsure = np.array([deviation(case, machine, row) for row in sweep.rows]).T
    if np.isnan(errors).any() or len(nus) < 2:
        reason = "the sweep has fewer than two speeds, or one without a steady orbit"
        return Figure.undetermined("rad/s", reason)
    if abs(errors[0]) > tolerance:
        is_close = abs(errors[0]) - unsure[0] <= tolerance
        reason = UNKNOWN if math.isnan(unsure[0]) else AT_TOLERANCE if is_close else NOWHERE
        return Figure.undetermined("rad/s", reason)
    curve = CubicSpline(nus, errors)
    ends = [
        (float(x), s * tolerance)
        for s in (1, -1)
        for x in crossing_times(nus, errors, s * tolerance)
    ]
    if not ends:
        reason = f"the error stays below {tolerance:g} % at every speed of the sweep"
        return Figure.undetermined("rad/s", reason)
    x, level = min(ends)
    return LimitGuess(x, level, float(curve(x, 1)))


def limits_of(
    machine: Machine, sweep: SpeedSweep, tolerance: float, multiples: Sequence[int]
) -> dict[Case, Figure]:
    """Return the lowest speed of the sweep at which each error leaves its tolerance, on orbits there.

    The secant searches of all cases run side by side.
    """
    figures: dict[Case, Figure] = {}
    searches: dict[Case, tuple[SecantSearch, float]] = {}
    for case in CASES:
        guess = first_guess(case, machine, sweep, tolerance)
        if isinstance(guess, Figure):
            figures[case] = guess
        else:
            searches[case] = SecantSearch(guess.x, guess.slope), guess.level
    while searches:
        machines = [(machine, search.x) for search, _ in searches.values()]
        rows = list(rows_of(machines, sweep.runner, multiples))
        for case, row in zip(list(searches), rows, strict=True):
            search, level = searches[case]
            error = deviation(case, machine, row)
            if math.isnan(error.error):
                figures[case] = Figure.undetermined("rad/s", UNKNOWN)
            else:
                try:
                    root = search.update(error.value - level, error.error)
                except NoRootError:
                    figures[case] = Figure.undetermined("rad/s", TOO_COARSE)
                else:
                    inside = sweep.speeds[0] <= search.x <= sweep.speeds[-1]
                    if root is None and inside:
                        continue
                    figures[case] = (
                        Figure(root.x, "rad/s", root.error)
                        if root is not None and inside
                        else Figure.undetermined("rad/s", TOO_COARSE)
                    )
            del searches[case]
    return figures


def verdict(o: Options, f: Mapping[str, Figure], r: ClassicalData) -> str:
    """Up to which speed either calculation may be used, and how wrong it gets."""
    lines = [" ".join(sentences(o, f, r, method)) for method in LOAD_TEXTS]
    if f["share"].error is not None:
        lines.append(
            f"The spring alone no longer gives the torque ripple within {o.tolerance:g} % once the inertia force "
            f"of the trough is {f['share'].brief()} of the spring force."
        )
    return "\n".join(lines)


def sentences(o: Options, f: Mapping[str, Figure], r: ClassicalData, method: str) -> list[str]:
    """What one of the calculations is good for, what for not, and what is not determined."""
    good: list[str] = []
    bad: list[str] = []
    errors: list[str] = []
    reasons: dict[str, list[str]] = {}
    for load, (_, name, *_) in QUANTITIES.items():
        end, top = f[f"limit_{method}_{load}"], f[f"worst_{method}_{load}"]
        if end.reason == NOWHERE:
            bad.append(f"the {name}")
        elif end.error is not None:
            good.append(f"the {name} up to {end.brief()}")
        elif top.error is not None and abs(top.value) + top.error <= o.tolerance:
            good.append(f"the {name} at every speed of the sweep")
        else:
            reason = end.reason if top.error is not None else top.reason
            reasons.setdefault(reason, []).append(f"the {name}")
        if top.error is not None:
            errors.append(f"{top.brief()} for the {name}")
        elif end.error is not None or end.reason == NOWHERE:
            reasons.setdefault(top.reason, []).append(f"the largest error of the {name}")
    subject, lines = f"{LOAD_TEXTS[method].capitalize()} as its load, the calculation", []
    if good:
        lines.append(f"{subject} is within {o.tolerance:g} % for {listed(good)}.")
    if bad:
        who = "It" if good else subject
        lowest = f"already at {r.sweep.speeds[0]:g} rad/s, the lowest speed of the sweep"
        lines.append(f"{who} is off by more than {o.tolerance:g} % for {listed(bad)} {lowest}.")
    if errors:
        who = (
            "Its" if lines else f"{LOAD_TEXTS[method].capitalize()} as its load, the calculation's"
        )
        lines.append(f"{who} largest errors are {listed(errors)}.")
    for reason, names in reasons.items():
        what = f"How far the calculation {LOAD_TEXTS[method]} can be trusted"
        lines.append(f"{what} is not determined for {listed(names)}: {reason}.")
    return lines


def show(o: Options, f: Mapping[str, Figure], r: ClassicalData) -> Show:
    """Both calculations beside co-simulation, their errors, and a revolution near the resonance."""
    machine, at = r.machine, r.frame["nu"].to_numpy()
    nu = np.linspace(at.min(), at.max(), 400)
    loads = []
    for load, (column, name, unit, color) in QUANTITIES.items():
        curves = [
            Curve(label, nu, Case(method, load).amplitude(machine, nu), shade, "theory")
            for method, (label, shade) in STYLES.items()
        ]
        error = r.frame[f"{column}_error"].to_numpy()
        curves.append(
            Curve("co-simulation", at, r.frame[column].to_numpy(), color, "points", error)
        )
        loads.append(Panel(name, unit, curves, includes=(0.0,)))
    levels = [Mark(s * o.tolerance, f"{s * o.tolerance:+g} %") for s in (1, -1)]
    errors = []
    for method, (label, _) in STYLES.items():
        curves = [
            Curve(name, at, r.frame[f"{method}_{load}"].to_numpy(), color, "linked")
            for load, (_, name, _, color) in QUANTITIES.items()
        ]
        errors.append(Panel(f"error, {label}", "%", curves, levels))
    marks = [Mark(machine.nu_res, f"resonance {machine.nu_res:.4g} rad/s")]
    axis, second = "operating speed [rad/s]", SecondUnit("rpm", 30 / math.pi)
    good = f["limit_spring_torque"]
    title = "Torque ripple, speed ripple and rod force of both calculations"
    if good.error is not None:
        title = (
            f"The spring alone gives the torque ripple within {o.tolerance:g} % up to {good.value:.3g} rad/s; "
            f"inertia is {f['share'].brief()} of its force there"
        )
    elif good.reason == NOWHERE:
        title = f"The spring alone is off by more than {o.tolerance:g} % at the lowest speed of the sweep"
    charts = [
        Chart(title, axis, loads, marks, second=second),
        Chart("Errors of both calculations", axis, errors, marks, second=second),
    ]
    near = float(at[np.abs(at - machine.nu_res).argmin()])
    return Show(charts, *motion.revolution(r.sweep.runner.task(machine, near)))
