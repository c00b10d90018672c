"""Does the operating speed sit on the electromechanical resonance of the drive?

Motor and conveyor are coupled at each speed of a sweep until their orbit is steady; the ripple of
order 2 of speed and torque is compared with first-order theory, and the speed where the torque
ripple lags 90 degrees behind the load ripple with formula (22).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

import cosim
import workbench
from workbench import Bench, Figure, Findings, Show, Table, option
from workbench.limit import limit

from . import response
from . import show as conveyor_show
from .drive import PARTS as DRIVE
from .drive import Drive, conveyor_drive, followed
from .response import Case, Point, simulate
from .theory import SETS, Machine, longest_step

PARTS = DRIVE
SPEEDS = {
    "A": "20,24,28,30,32,33,34,35,36,36.5,37,37.5,38,38.5,39,39.5,40,40.5,41,41.5,42,43,44,45,46,"
    "48,50,54,57,60,66",
    "B": "6,8,10,12,14,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,36,38,40,43,46,50,"
    "55,60,66",
}
OPERATING = {"A": 40.0, "B": 60.0}
RATED = {"A": 100.0, "B": 88.0}
TABLE = "resonance.csv"
UNITS = {
    "nu": "rad/s", "w2": "rad/s", "w2_error": "rad/s", "w2_phase": "deg", "tau2": "N.m",
    "tau2_error": "N.m", "tau2_phase": "deg", "w2_theory": "rad/s", "w2_phase_theory": "deg",
    "tau2_theory": "N.m", "tau2_phase_theory": "deg", "lag": "deg", "lag_error": "deg",
    "w_mean": "rad/s", "w_mean_error": "rad/s", "f_rod_peak": "N", "f_rod_peak_error": "N",
}  # fmt: skip
OWN = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")
ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
LADDER = (1, 2, 4)
FEWEST = 18


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    set: str = option("A", "parameter set", choices=SETS)
    speed: float | None = option(
        None, "operating speed, 40 in set A and 60 in set B by default", "rad/s", above=0.0
    )
    limit: float = option(
        50.0, "torque ripple that is too much, of the rated torque", "%", above=0.0
    )
    rated_torque: float | None = option(
        None, "rated motor torque at the crank, 100 in set A and 88 in set B by default", "N.m",
        above=0.0,
    )  # fmt: skip
    algorithm: str = option("strang", "coupling algorithm", choices=ALGORITHMS)
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)
    speeds: tuple[float, ...] = option((), "those of the set by default", "rad/s", above=0.0)


class Row(NamedTuple):
    """One speed of the sweep: SI units, phases and lag in degrees; nan where there is no orbit, and
    for errors that are not known.
    """

    nu: float
    w2: float
    w2_error: float
    w2_phase: float
    tau2: float
    tau2_error: float
    tau2_phase: float
    w2_theory: float
    w2_phase_theory: float
    tau2_theory: float
    tau2_phase_theory: float
    lag: float
    lag_error: float
    w_mean: float
    w_mean_error: float
    f_rod_peak: float
    f_rod_peak_error: float


def row(machine: Machine, points: Sequence[Point], order: float) -> Row:
    """What the orbits of one speed with N, N/2, N/4 steps tell."""
    nu = points[0].nu

    def told(values: Sequence[float], settling: float, order: float = order) -> tuple[float, float]:
        value, error, _ = limit(values, order)
        return value, math.nan if error is None else error + 2.0 * settling

    def amplitude(values: Sequence[complex], settling: float) -> tuple[float, float, float]:
        """Amplitude, its error, phase in degrees."""
        parts = [told([pick(value) for value in values], settling) for pick in (_re, _im)]
        whole = complex(parts[0][0], parts[1][0])
        return abs(whole), math.hypot(parts[0][1], parts[1][1]), math.degrees(cmath.phase(whole))

    first = points[0]
    w2, w2_error, w2_phase = amplitude([p.speed for p in points], first.speed_error)
    tau2, tau2_error, tau2_phase = amplitude([p.torque for p in points], first.torque_error)
    load = math.degrees(cmath.phase(machine.load_ripple(nu)))
    return Row(
        nu, w2, w2_error, w2_phase, tau2, tau2_error, tau2_phase,
        *polar(machine.speed_ripple(nu)), *polar(machine.torque_ripple(nu)),
        (load - tau2_phase) % 360.0, math.degrees(tau2_error / tau2),
        *told([p.mean for p in points], first.mean * 1e-9),
        *either(*(told(x, first.force_error, 1.0) for x in zip(*((p.push, p.pull) for p in points)))),
    )  # fmt: skip


def either(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    """The larger of two values with its error, or with that of the other where this reaches higher.

    Which of two nearly equal peaks is the larger may change with the step; each by itself converges.
    """
    (low, low_error), (high, high_error) = sorted((one, other))
    reach = math.nan if math.isnan(low_error) else max(high_error, low + low_error - high)
    return high, reach


def _re(value: complex) -> float:
    return value.real


def _im(value: complex) -> float:
    return value.imag


def polar(z: complex) -> tuple[float, float]:
    """Amplitude, and phase in degrees."""
    return abs(z), math.degrees(cmath.phase(z))


def check_steps(machine: Machine, algorithm: str, steps_per_rev: int, nu: float) -> None:
    """Raise SetupError for too few steps per revolution to fit orders or to stay stable at nu."""
    if steps_per_rev < FEWEST:
        raise cosim.SetupError(f"{steps_per_rev} steps per revolution must be at least {FEWEST}")
    limit = 2 * math.pi / (nu * longest_step(machine, algorithm))
    if steps_per_rev <= limit:
        raise cosim.SetupError(
            f"{steps_per_rev} steps per revolution are unstable with {algorithm} at {nu:g} rad/s: "
            f"its limit there is {limit:.2f} (a step of {longest_step(machine, algorithm):.3g} s)"
        )


def ladder(machine: Machine, algorithm: str, steps_per_rev: int, slowest: float) -> list[int]:
    """N, N/2 and N/4 steps per revolution; N alone where N/4 are not stable at the slowest speed."""
    try:
        check_steps(machine, algorithm, steps_per_rev // LADDER[-1], slowest)
    except cosim.SetupError:
        return [steps_per_rev]
    return [steps_per_rev // share for share in LADDER]


class Sweep(NamedTuple):
    """What was asked and found: the drive, rows, figures, why orbits are missing, a case like all."""

    drive: Drive
    rows: Sequence[Row]
    figures: Mapping[str, Figure]
    problems: Mapping[float, str]
    like: Case
    operating: float
    limit: float
    rated: float


def case(like: Case, drive: Drive, nu: float, steps_per_rev: int) -> Case:
    """The case of a speed, with so many steps per revolution."""
    start = {k: v for k, v in drive.start(nu).items() if k not in response.STATES}
    return like._replace(start=start, machine=drive.machine(nu), nu=nu, steps_per_rev=steps_per_rev)


def survey(
    drive: Drive,
    nus: Sequence[float],
    like: Case,
    each: response.Each,
    operating: float,
    limit: float,
    rated: float,
) -> Sweep:
    """The orbits of a sweep, and on them the places where the response is special."""
    numbers = ladder(
        drive.machine(nus[0]), like.algorithm, like.steps_per_rev, min(nus[0], operating)
    )
    order = cosim.ORDERS[like.algorithm]
    wanted = sorted({*nus, operating})
    swept = each(simulate, [case(like, drive, nu, n) for n in numbers for nu in wanted], "sweep")
    by_steps = [swept[k * len(wanted) : (k + 1) * len(wanted)] for k in range(len(numbers))]
    problems = {p.nu: p.problem for points in by_steps for p in points if p.problem}
    rows = {nu: row(drive.machine(nu), points, order) for nu, *points in zip(wanted, *by_steps)}
    start: dict[str, float] = {}
    lost: dict[str, response.Found | str] = {}
    finest = [point for point in by_steps[0] if point.nu in nus]
    for place in response.PLACES:
        try:
            start[place.name] = response.candidate(place, drive.machine, finest)
        except response.Unclear as reason:
            lost[place.name] = str(reason)
    middle = drive.machine(nus[len(nus) // 2]).nu_res
    machine = drive.machine(middle)
    spacing = min(response.NEAR * machine.zeta, 0.05) * machine.nu_res
    found = []
    for n in numbers:
        measure = partial(_measure, drive, like, n, each)
        found.append(lost | response.locate(start, drive.machine, spacing, measure))
    figures = {
        "nu_res": Figure(machine.nu_res, "rad/s", 0.0, "resonance by formula (22)"),
        "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
        **response.figures(found, order),
        "tau2_operating": _at(
            rows[operating], "tau2", "N.m", "torque ripple at the operating speed"
        ),
    }
    swept_rows = [rows[nu] for nu in nus]
    hardest = max(swept_rows, key=lambda r: math.inf if math.isnan(r.f_rod_peak) else r.f_rod_peak)
    figures["f_rod_peak"] = _at(hardest, "f_rod_peak", "N", "largest rod force of the sweep")
    return Sweep(drive, swept_rows, figures, problems, like, operating, limit, rated)


def _measure(
    drive: Drive, like: Case, steps_per_rev: int, each: response.Each, nus: Sequence[float]
) -> Sequence[Point]:
    return each(simulate, [case(like, drive, nu, steps_per_rev) for nu in nus], "places")


def _at(row: Row, column: str, unit: str, meaning: str) -> Figure:
    """A figure from a row and its error."""
    value, error = getattr(row, column), getattr(row, f"{column}_error")
    if math.isnan(value):
        return Figure.refused(unit, f"no steady orbit at {row.nu:g} rad/s", meaning)
    if math.isnan(error):
        return Figure.refused(unit, "its coupling error is not known: more steps", meaning)
    return Figure(value, unit, error, meaning)


def band(sweep: Sweep) -> list[tuple[float, float]]:
    """Stretches of speed in which the torque ripple is above the limit [rad/s], within the sweep."""
    rows = [row for row in sweep.rows if not math.isnan(row.tau2)]
    if len(rows) < 4:
        return []
    nu = np.array([row.nu for row in rows])
    ratio = make_interp_spline(nu, [row.tau2 / row.tau2_theory for row in rows], k=3)
    fine = np.linspace(nu[0], nu[-1], 4001)
    ripple = np.array([abs(sweep.drive.machine(x).torque_ripple(x)) for x in fine]) * ratio(fine)
    above = np.concatenate([[False], ripple > sweep.limit * sweep.rated, [False]])
    edges = np.flatnonzero(np.diff(above.astype(int)))
    return [(float(fine[a]), float(fine[b - 1])) for a, b in zip(edges[::2], edges[1::2])]


def verdict(o: Options, f: Mapping[str, Figure], sweep: Sweep) -> str:
    """The answer in plain words."""
    nu = sweep.operating
    resonance, ripple = f["nu_90"], f["tau2_operating"]
    at = f"{nu:g} rad/s ({nu * 30 / math.pi:.0f} rpm)"
    most = sweep.limit * sweep.rated
    stretches = band(sweep)
    inside = any(low <= nu <= high for low, high in stretches)
    share = (
        "" if ripple.error is None else f", {ripple.value / sweep.rated:.0%} of the rated torque"
    )
    lines = [
        f"{'Yes' if inside else 'No'}: at the operating speed of {at} the torque ripple is "
        f"{ripple.text()}{share}; the limit is {most:g} N.m."
    ]
    if resonance.error is not None:
        away = resonance.value / nu - 1.0
        lines[0] = lines[0][:-1] + (
            f", and the resonance at {resonance.text()} is {abs(away):.1%} "
            f"{'above' if away > 0 else 'below'} that speed."
            if abs(away) >= 5e-4
            else f", and the resonance is there, at {resonance.text()}."
        )
    if stretches:
        first, last = sweep.rows[0].nu, sweep.rows[-1].nu
        told = " and ".join(
            f"{'below' if low == first else f'from {low:.3g} to'} {high:.3g} rad/s"
            if high < last
            else f"above {low:.3g} rad/s"
            for low, high in stretches
        )
        lines.append(f"Avoid speeds {told}, where the torque ripple is above the limit.")
    else:
        lines.append("The torque ripple stays below the limit at every speed of the sweep.")
    return "\n".join([*lines, "", *details(sweep)])


def details(sweep: Sweep) -> list[str]:
    """What stands behind the answer."""
    f = sweep.figures
    formula = f["nu_res"].value
    first, last = sweep.rows[0].nu, sweep.rows[-1].nu
    lines = [
        f"Formula (22) puts the resonance at {formula:.3f} rad/s ({formula * 30 / math.pi:.0f} rpm), "
        f"damping ratio {f['zeta'].value:.4g}."
    ]
    if not first <= formula <= last:
        lines[-1] += f" The sweep from {first:g} to {last:g} rad/s does not hold it."
    where = f["nu_90"]
    if where.error is None:
        lines.append(f"No 90 degree lag of the torque ripple is told: {where.reason}.")
    else:
        lines.append(
            f"In simulation the torque ripple lags the load ripple by 90 degrees at {where.text()}, "
            f"{where.value / formula - 1:+.3%} from the formula."
        )
    for name, key, what in (
        ("nu_peak_tau", "tau2_peak", "torque"),
        ("nu_peak_w", "w2_peak", "speed"),
    ):
        where, height = f[name], f[key]
        if where.error is None:
            lines.append(f"No peak of the {what} ripple is told: {where.reason}.")
        else:
            lines.append(
                f"The {what} ripple is largest at {where.text()}, {where.value / formula - 1:+.1%} "
                f"from the formula: {height.text()}."
            )
    machine = sweep.drive.machine(formula)
    lines.append(
        "These speeds differ because (22) marks a phase, which neither damping nor the load moves; "
        "the amplitudes are largest where the drive's gain times the load ripple is"
        + (
            f", and that falls towards sqrt(c/m) = {math.sqrt(machine.c / machine.m):.1f} rad/s."
            if machine.c
            else "."
        )
    )
    lines.append(f"Over the sweep the rod carries at most {f['f_rod_peak'].text()}.")
    for nu, problem in list(sweep.problems.items())[:4]:
        lines.append(f"No steady orbit at {nu:g} rad/s: {problem}.")
    return lines


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep and locate; raises cosim.SetupError for settings that cannot give an answer."""
    nus = o.speeds or tuple(float(nu) for nu in SPEEDS[o.set].split(","))
    operating = o.speed or OPERATING[o.set]
    rated = o.rated_torque or RATED[o.set]
    drive = Drive(followed(bench.fmus, SETS[o.set], o.start), o.start)
    for nu in (nus[0], nus[-1], operating):
        check_steps(drive.machine(nu), o.algorithm, o.steps_per_rev, nu)
    like = Case(bench.fmus, {}, drive.base, nus[0], o.steps_per_rev, o.algorithm)

    def each(function: Any, cases: Sequence[Case], title: str) -> list[Point]:
        return list(bench.each(function, cases, title))

    found = survey(drive, nus, like, each, operating, o.limit / 100, rated)
    return Findings(
        found.figures,
        found,
        conveyor_drive(bench.fmus, drive.start(found.figures["nu_res"].value)),
        communication=f"{o.steps_per_rev} steps per revolution",
        algorithm=o.algorithm,
        tables={TABLE: Table.of_rows(found.rows, UNITS)},
        facts={
            "operating_speed": operating,
            "rated_torque": rated,
            "avoid": band(found),
            "not_steady": {f"{nu:g}": problem for nu, problem in found.problems.items()},
        },
    )


def show(o: Options, f: Mapping[str, Figure], sweep: Sweep) -> Show:
    """The sweep against theory, and one revolution at the operating speed."""
    like, drive = sweep.like, sweep.drive
    record = (*response.RECORD, "conveyor.x", "conveyor.tau_load")
    machine, most = drive.machine(f["nu_res"].value), sweep.limit * sweep.rated
    chart = conveyor_show.ripple(
        machine, sweep.rows, f, sweep.operating, sweep.rated, most, band(sweep)
    )
    if sweep.operating in sweep.problems:
        return Show([chart], [])
    turns = response.orbit(case(like, drive, sweep.operating, like.steps_per_rev), record)
    course, motion = conveyor_show.revolution(sweep.operating, turns.result)
    return Show([chart], [motion], [course])
