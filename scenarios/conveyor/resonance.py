"""Does the operating speed sit on the electromechanical resonance of the drive?

Motor and conveyor are coupled at each speed of a sweep until their orbit is steady; the ripple of
order 2 of speed and torque is compared with first-order theory, and the speed where the torque
ripple lags 90 degrees behind the load ripple with formula (22).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from cosim import ORDERS, SetupError
from workbench import Bench, Figure, Findings, Show, Table, option
from workbench.limit import limit
from workbench.orbit import NotSteady

from . import response
from . import show as pictures
from .drive import PARTS as DRIVE
from .drive import conveyor_drive, followed, linearised
from .response import COARSER, LAG, SPEED, TORQUE, Line, Point, Ripple, Setup
from .theory import SETS, Machine

PARTS = DRIVE
SPEEDS = {
    "A": "20,24,28,30,32,33,34,35,36,36.5,37,37.5,38,38.5,39,39.5,40,40.5,41,41.5,42,43,44,45,46,"
    "48,50,54,57,60,66",
    "B": "6,8,10,12,14,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,36,38,40,43,46,50,"
    "55,60,66",
}
OPERATING = {"A": 40.0, "B": 60.0}
TABLE = "resonance.csv"
UNITS = {
    "nu": "rad/s", "w2": "rad/s", "w2_error": "rad/s", "w2_phase": "deg", "tau2": "N.m",
    "tau2_error": "N.m", "tau2_phase": "deg", "w2_theory": "rad/s", "w2_phase_theory": "deg",
    "tau2_theory": "N.m", "tau2_phase_theory": "deg", "lag": "deg", "lag_error": "deg",
    "w_mean": "rad/s", "w_mean_error": "rad/s", "f_rod_peak": "N", "f_rod_peak_error": "N",
}  # fmt: skip
OWN = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")


@dataclass(frozen=True, kw_only=True)
class Options(Ripple):
    speed: float | None = option(
        None, "operating speed, 40 in set A and 60 in set B by default", "rad/s", above=0.0
    )
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)
    speeds: tuple[float, ...] = option((), "those of the set by default", "rad/s", above=0.0)


class Sweep(NamedTuple):
    """How machines were run, the machine at each speed, rows of the table, stretches to avoid."""

    setup: Setup
    line: Line
    points: Sequence[Any]
    operating: float
    avoid: Sequence[tuple[float, float]]


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep and locate; raises cosim.SetupError for settings that cannot give an answer."""
    nus = o.speeds or tuple(float(nu) for nu in SPEEDS[o.set].split(","))
    operating = o.speed or OPERATING[o.set]
    base = followed(bench.fmus, SETS[o.set], o.start)
    line = Line(lambda nu: (linearised(base, o.start, nu), nu), nus[0], nus[-1])
    setup = Setup(bench, o.start, o.algorithm, o.steps_per_rev)
    wanted = sorted({*nus, operating})
    for nu in wanted:
        setup.check(*line.at(nu))
    coarser = ladder(setup, line, wanted[0])
    orbits = setup.orbits([(*line.at(nu), k) for nu in wanted for k in coarser], "sweep")
    by_speed = {nu: orbits[n * len(coarser) :][: len(coarser)] for n, nu in enumerate(wanted)}
    problems = {point.nu: point.problem for point in orbits if point.problem}
    for nu, problem in problems.items():
        logging.getLogger("cosim").warning(f"No steady orbit at {nu:g} rad/s: {problem}")
    rows = [row(line.at(nu)[0], points, ORDERS[o.algorithm]) for nu, points in by_speed.items()]
    middle = line.at(nus[len(nus) // 2])[0].nu_res
    machine = line.at(middle)[0]
    known = [(nu, by_speed[nu][0]) for nu in nus]
    sought = [(line, place, known) for place in (LAG, TORQUE, SPEED)]
    (lag, _), (torque, tau2), (speed, w2) = response.places(sought, coarser, "rad/s", setup)
    force = response.largest_force(points for nu, points in by_speed.items() if nu in nus)
    standing = next((nu for nu in problems if nu in nus), nus[0])
    at = rows[wanted.index(operating)]
    figures = {
        "nu_res": Figure(machine.nu_res, "rad/s", 0.0, "resonance by formula (22)"),
        "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
        "nu_90": lag, "nu_peak_tau": torque, "tau2_peak": tau2, "nu_peak_w": speed, "w2_peak": w2,
        "tau2_operating": told(
            at["tau2"], at["tau2_error"], "N.m", "torque ripple at the operating speed", operating
        ),
        "f_rod_peak": told(*force, "N", "largest rod force of the sweep", standing),
    }  # fmt: skip
    avoid = band(line, rows, o.most)
    table = Table.of_rows(
        [[one[name] for name in UNITS] for one in rows if one["nu"] in nus], UNITS
    )
    return Findings(
        figures,
        Sweep(setup, line, list(table.frame.itertuples()), operating, avoid),
        conveyor_drive(bench.fmus, setup.case(*line.at(machine.nu_res)).start),
        communication=f"{o.steps_per_rev} steps per revolution",
        algorithm=o.algorithm,
        tables={TABLE: table},
        facts={"operating_speed": operating, "rated_torque": o.rated, "avoid": avoid},
    )


def ladder(setup: Setup, line: Line, slowest: float) -> Sequence[int]:
    """N, N/2 and N/4 steps per revolution; N alone where N/4 are not stable at the slowest speed."""
    try:
        setup.check(*line.at(slowest), COARSER[-1])
    except SetupError:
        return COARSER[:1]
    return COARSER


def row(machine: Machine, points: Sequence[Point], order: float) -> dict[str, float]:
    """The orbits of one speed with N, N/2, N/4 steps: SI units, phases and lag in degrees; nan where
    there is no orbit, and for errors that are not known.
    """
    nu, angle = points[0].nu, partial(np.angle, deg=True)
    row = {"nu": nu}
    theory = {"w2": (SPEED, machine.speed_ripple), "tau2": (TORQUE, machine.torque_ripple)}
    for name, (place, ripple) in theory.items():
        whole, error = extrapolated([place.response(point) for point in points], order)
        error += 2.0 * place.settling(points[0])
        row |= {name: abs(whole), f"{name}_error": error, f"{name}_phase": angle(whole)}
        row |= {f"{name}_theory": abs(ripple(nu)), f"{name}_phase_theory": angle(ripple(nu))}
    mean, error = extrapolated([point.mean for point in points], order)
    force, force_error = response.largest_force([points])
    return row | {
        "lag": (angle(machine.load_ripple(nu)) - row["tau2_phase"]) % 360.0,
        "lag_error": math.degrees(row["tau2_error"] / row["tau2"]),
        "w_mean": mean.real,
        "w_mean_error": error + 2e-9 * points[0].mean,
        "f_rod_peak": force,
        "f_rod_peak_error": force_error,
    }


def extrapolated(values: Sequence[complex], order: float) -> tuple[complex, float]:
    """Where values at steps h, 2 h, 4 h go, and the error of that, nan where it is not known."""
    parts = [limit([getattr(x, part) for x in values], order) for part in ("real", "imag")]
    errors = [math.nan if error is None else error for _, error, _ in parts]
    return complex(parts[0][0], parts[1][0]), math.hypot(*errors)


def told(value: float, error: float, unit: str, meaning: str, nu: float) -> Figure:
    """A figure of the orbit at nu, refused where that or the error is not known."""
    if math.isnan(error):
        why = f"there is no steady orbit at {nu:g} rad/s"
        reason = why if math.isnan(value) else "its coupling error is not known: more steps"
        return Figure.refused(unit, reason, meaning)
    return Figure(value, unit, error, meaning)


def band(line: Line, rows: Sequence[Mapping[str, float]], most: float) -> list[tuple[float, float]]:
    """Stretches of speed between the rows in which the torque ripple is above a limit [rad/s]."""
    known = [one for one in rows if not math.isnan(one["tau2"])]
    if not known:
        return []
    nu = np.array([one["nu"] for one in known])
    ratios = [one["tau2"] / one["tau2_theory"] for one in known]
    ratio = make_interp_spline(nu, ratios, k=3 if len(nu) > 3 else min(1, len(nu) - 1))
    fine = np.linspace(nu[0], nu[-1], 4001)
    machine, _ = line.at(fine)
    above = abs(machine.torque_ripple(fine)) * ratio(fine) > most
    edges = np.flatnonzero(np.diff(np.concatenate([[0], above, [0]]).astype(int)))
    return [(float(fine[a]), float(fine[b - 1])) for a, b in zip(edges[::2], edges[1::2])]


def verdict(o: Options, f: Mapping[str, Figure], r: Sweep) -> str:
    """The answer in plain words."""
    ripple, resonance, formula = f["tau2_operating"], f["nu_90"], f["nu_res"].value
    at = f"the operating speed of {r.operating:g} rad/s ({r.operating * 30 / math.pi:.0f} rpm)"
    first, last, away = r.line.first, r.line.last, resonance.value / r.operating - 1.0
    if ripple.error is None:
        answer = f"Whether {at} is on it is not told: {ripple.reason}"
    else:
        answer = (
            f"{'Yes' if ripple.value > o.most else 'No'}: at {at} the torque ripple is "
            f"{ripple.text()}, {ripple.value / o.rated:.0%} of the rated torque; the limit is {o.most:g} N.m"
        )
    if abs(away) < 5e-4:
        answer += f", and the resonance is there, at {resonance.text()}"
    elif resonance.error is not None:
        side = "above" if away > 0 else "below"
        answer += f", and the resonance at {resonance.text()} is {abs(away):.1%} {side} that speed"
    lines = [f"{answer}."]
    if r.avoid:
        where = " and ".join(
            f"{'below' if low <= first else f'from {low:.3g} to'} {high:.3g} rad/s"
            if high < last
            else f"above {low:.3g} rad/s"
            for low, high in r.avoid
        )
        lines.append(f"Avoid speeds {where}, where the torque ripple is above the limit.")
    elif not all(math.isnan(point.tau2) for point in r.points):
        lines.append("The torque ripple stays below the limit at every speed of the sweep.")
    if resonance.error is None:
        lines.append(f"No 90 degree lag of the torque ripple is told: {resonance.reason}.")
    if not first <= formula <= last:
        sweep = f"The sweep from {first:g} to {last:g} rad/s"
        lines[-1] += f" {sweep} does not hold the {formula:.3f} rad/s of formula (22)."
    return "\n".join(lines)


def show(o: Options, f: Mapping[str, Figure], r: Sweep) -> Show:
    """The sweep against theory, and one revolution at the operating speed."""
    machine, _ = r.line.at(f["nu_res"].value)
    chart = pictures.ripple(machine, r.points, f, r.operating, o.rated, o.most, r.avoid)
    try:
        turns = response.orbit(r.setup.case(*r.line.at(r.operating)), pictures.RECORD)
    except NotSteady:
        return Show([chart])
    course, motion = pictures.revolution(r.operating, turns.result)
    return Show([chart], [motion], [course])
