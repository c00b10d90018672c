"""How far can the classical calculation, with constant inertia and a load over time, be trusted?

Its ripple of torque and speed and its rod force are compared with co-simulation at each speed: once
with the spring as the only load, as in the formula after (26), and once with the whole load at constant
speed, including the inertia of the trough. The speed at which each error leaves its bounds is located
on orbits there.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import CONVERGENCE_ORDERS
from workbench import Bench, Chart, Curve, Figure, Findings, Mark, Panel, Show, Table, option
from workbench.charts.model import FORCE, SPEED, TORQUE, Second
from workbench.figure import listed
from workbench.measure import Measured, passes

from .. import motion
from ..first_order import Machine, classical
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive
from ..sweep import HELD, Sweep, Swept, begun
from . import resonance

PARTS = DRIVE
PARALLEL = True
OWN = HELD
SLOW = "6,8,10,12,14,16,18,"
SPEEDS = {"A": SLOW + resonance.SPEEDS["A"], "B": resonance.SPEEDS["B"]}
TABLE = "classical.csv"
WAYS = {"spring": False, "whole": True}
WORDS = {"spring": "with the spring alone", "whole": "with spring and inertia"}
LOOKS = {"spring": ("spring alone, after (26)", "purple"), "whole": ("spring and inertia", "black")}
TOLD = {
    "torque": ("tau2", "torque ripple", "N.m", TORQUE),
    "speed": ("w2", "speed ripple", "rad/s", SPEED),
    "force": ("f_rod_peak", "largest rod force", "N", FORCE),
}
ROUNDS, CLOSE = 12, 1e-9
UNKNOWN = "the coupling error of an orbit is not known; take more steps per revolution"
FEW = "the sweep has too few speeds near the speed where the error passes the tolerance"
JUST = "the error at the lowest speed of the sweep is that of the tolerance, within its own error"
NOWHERE = "not even at the lowest speed of the sweep"


@dataclass(frozen=True, kw_only=True)
class Options(Swept):
    tolerance: float = option(5.0, "error that is accepted", "%", above=0.0)


class Case(NamedTuple):
    """A way to calculate and what it calculates."""

    way: str
    load: str

    @property
    def key(self) -> str:
        return f"{self.way}_{self.load}"

    def of(self, machine: Machine, nu: Any) -> Any:
        """What the calculation says at nu [rad/s], an amplitude."""
        return abs(getattr(classical(machine, nu, WAYS[self.way]), self.load))


CASES = [Case(way, load) for way in WAYS for load in TOLD]
Row = Mapping[str, tuple[float, str]]


class Found(NamedTuple):
    """The sweep and the rows of its table."""

    sweep: Sweep
    rows: Any


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep, compare, and find where an error is no longer accepted; raises cosim.SetupError."""
    machine, setup, nus, coarser = sweep = begun(o, bench, SPEEDS)

    def simulated(nus: Sequence[float]) -> list[Row]:
        orbits = setup.orbits([(machine, nu, k) for nu in nus for k in coarser], "orbits")
        points = [list(islice(orbits, len(coarser))) for _ in nus]
        return [resonance.row(machine, one, CONVERGENCE_ORDERS[o.algorithm]) for one in points]

    rows = simulated(nus)
    limits = passed(machine, nus, rows, o.tolerance, simulated)
    figures = {}
    for case in CASES:
        what = f"{TOLD[case.load][1]} {WORDS[case.way]}"
        meaning = f"speed up to which the {what} is accurate enough"
        figures[f"limit_{case.key}"] = limits[case]._replace(meaning=meaning)
        errors = [off(case, machine, nu, row) for nu, row in zip(nus, rows)]
        figures[f"worst_{case.key}"] = worst(errors, f"largest error, {what}")
    end = limits[Case("spring", "torque")]
    share = Figure.refused("%", end.reason)
    if end.error is not None:
        value = 100 * machine.m * end.value**2 / machine.c
        share = Figure(value, "%", 2 * value * end.error / end.value)
    figures["share"] = share._replace(meaning="inertia force over spring force at the first limit")
    units = {"nu": "rad/s"}
    for column, _, unit, _ in TOLD.values():
        units |= {column: unit, f"{column}_error": unit}
    units |= {f"{case.key}{x}": "%" for case in CASES for x in ("", "_error")}
    table = Table.of_rows([cells(machine, nu, row) for nu, row in zip(nus, rows)], units)
    return Findings(
        figures,
        Found(sweep, table.frame),
        conveyor_drive(bench.fmus, {**machine.start(nus[0]), **o.start}),
        communication=f"{o.steps_per_rev} steps per revolution",
        algorithm=o.algorithm,
        tables={TABLE: table},
        defaults={"speeds": nus},
    )


def off(case: Case, machine: Machine, nu: float, row: Row) -> Measured:
    """How far a calculation is above what was simulated, in %."""
    column = TOLD[case.load][0]
    (true, _), (error, _) = row[column], row[f"{column}_error"]
    ratio = case.of(machine, nu) / true
    return Measured(100 * (ratio - 1), 100 * ratio * error / true)


def cells(machine: Machine, nu: float, row: Row) -> list[float]:
    """A row of the table."""
    columns = [x for column, *_ in TOLD.values() for x in (column, f"{column}_error")]
    errors = [x for case in CASES for x in off(case, machine, nu, row)]
    return [nu, *(row[column][0] for column in columns), *errors]


def worst(errors: Sequence[Measured], meaning: str) -> Figure:
    """The largest of errors of either sign; what it may be covers others that are as large."""
    top = max(errors, key=lambda x: math.inf if math.isnan(x.value) else abs(x.value))
    if math.isnan(top.value):
        return Figure.refused("%", "not every speed of the sweep has a steady orbit", meaning)
    if any(math.isnan(x.error) for x in errors):
        return Figure.refused("%", UNKNOWN, meaning)
    as_large = [x for x in errors if abs(x.value) + x.error >= abs(top.value) - top.error]
    error = max(abs(x.value - top.value) + x.error for x in as_large)
    return Figure(top.value, "%", error, meaning)


def passed(
    machine: Machine,
    nus: Sequence[float],
    rows: Sequence[Row],
    most: float,
    simulated: Callable[[Sequence[float]], list[Row]],
) -> dict[Case, Figure]:
    """The lowest speed of the sweep at which each error leaves its bounds, on orbits there."""
    found: dict[Case, Figure] = {}
    sought: dict[Case, tuple[float, float, float]] = {}
    for case in CASES:
        errors, unsure = np.array([off(case, machine, nu, row) for nu, row in zip(nus, rows)]).T
        if np.isnan(errors).any() or len(nus) < 2:
            reason = "the sweep has fewer than two speeds, or one without a steady orbit"
            found[case] = Figure.refused("rad/s", reason)
        elif abs(errors[0]) > most and math.isnan(unsure[0]):
            found[case] = Figure.refused("rad/s", UNKNOWN)
        elif abs(errors[0]) > most:
            within = abs(errors[0]) - unsure[0] <= most
            found[case] = Figure.refused("rad/s", JUST if within else NOWHERE)
        else:
            curve = CubicSpline(nus, errors)
            ends = [(x, s) for s in (1, -1) for x in passes(np.array(nus), errors, s * most)]
            if ends:
                x, s = min(ends)
                sought[case] = (float(x), s * most, float(curve(x, 1)))
            else:
                reason = f"the error stays below {most:g} % at every speed of the sweep"
                found[case] = Figure.refused("rad/s", reason)
    few = Figure.refused("rad/s", FEW)
    before: dict[Case, tuple[float, float]] = {}
    for _ in range(ROUNDS):
        seen = simulated([x for x, _, _ in sought.values()])
        for (case, (x, level, slope)), row in zip(list(sought.items()), seen):
            at = off(case, machine, x, row)
            if case in before:
                slope = (at.value - before[case][1]) / (x - before[case][0])
            step = (level - at.value) / slope if slope else math.inf
            if math.isnan(at.error):
                found[case] = Figure.refused("rad/s", UNKNOWN)
            elif not nus[0] <= x + step <= nus[-1]:
                found[case] = few
            else:
                error = at.error / abs(slope)
                found[case] = Figure(x + step, "rad/s", abs(step) + error)
                before[case] = (x, at.value)
                if abs(step) > max(error, CLOSE * x):
                    sought[case] = (x + step, level, slope)
                    continue
            del sought[case]
        if not sought:
            return found
    return {**found, **dict.fromkeys(sought, few)}


def verdict(o: Options, f: Mapping[str, Figure], r: Found) -> str:
    """Up to which speed either calculation may be used, and how wrong it gets."""
    lines = [" ".join(sentences(o, f, r, way)) for way in WORDS]
    if f["share"].error is not None:
        lines.append(
            f"The spring alone no longer gives the torque ripple within {o.tolerance:g} % once the inertia force "
            f"of the trough is {f['share'].brief()} of the spring force."
        )
    return "\n".join(lines)


def sentences(o: Options, f: Mapping[str, Figure], r: Found, way: str) -> list[str]:
    """What one of the calculations is good for, what for not, and what is not determined."""
    good: list[str] = []
    bad: list[str] = []
    errors: list[str] = []
    reasons: dict[str, list[str]] = {}
    for load, (_, name, *_) in TOLD.items():
        end, top = f[f"limit_{way}_{load}"], f[f"worst_{way}_{load}"]
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
    subject, lines = f"{WORDS[way].capitalize()} as its load, the calculation", []
    if good:
        lines.append(f"{subject} is within {o.tolerance:g} % for {listed(good)}.")
    if bad:
        who = "It" if good else subject
        lowest = f"already at {r.sweep.nus[0]:g} rad/s, the lowest speed of the sweep"
        lines.append(f"{who} is off by more than {o.tolerance:g} % for {listed(bad)} {lowest}.")
    if errors:
        who = "Its" if lines else f"{WORDS[way].capitalize()} as its load, the calculation's"
        lines.append(f"{who} largest errors are {listed(errors)}.")
    for reason, names in reasons.items():
        what = f"How far the calculation {WORDS[way]} can be trusted"
        lines.append(f"{what} is not determined for {listed(names)}: {reason}.")
    return lines


def show(o: Options, f: Mapping[str, Figure], r: Found) -> Show:
    """Both calculations beside co-simulation, their errors, and a revolution near the resonance."""
    machine, setup, *_ = r.sweep
    at, nu = r.rows["nu"], np.linspace(r.rows["nu"].min(), r.rows["nu"].max(), 400)
    loads = []
    for load, (column, name, unit, color) in TOLD.items():
        curves = [
            Curve(words, nu, Case(way, load).of(machine, nu), shade, "theory")
            for way, (words, shade) in LOOKS.items()
        ]
        error = r.rows[f"{column}_error"]
        curves.append(Curve("co-simulation", at, r.rows[column], color, "points", error))
        loads.append(Panel(name, unit, curves, includes=(0.0,)))
    levels = [Mark(s * o.tolerance, f"{s * o.tolerance:+g} %") for s in (1, -1)]
    errors = []
    for way, (words, _) in LOOKS.items():
        curves = [
            Curve(name, at, r.rows[f"{way}_{load}"], color, "linked")
            for load, (_, name, _, color) in TOLD.items()
        ]
        errors.append(Panel(f"error, {words}", "%", curves, levels))
    marks = [Mark(machine.nu_res, f"resonance {machine.nu_res:.4g} rad/s")]
    axis, second = "operating speed [rad/s]", Second("rpm", 30 / math.pi)
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
    near = float(at[(at - machine.nu_res).abs().idxmin()])
    return Show(charts, *motion.revolution(setup.case(machine, near)))
