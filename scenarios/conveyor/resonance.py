"""Does the operating speed sit on the electromechanical resonance of the drive?

Motor and conveyor are coupled at each speed of a sweep until their orbit is steady. The ripple of
order 2 of speed and torque is compared with first-order theory. The speed at which the torque ripple
lags 90 degrees behind the load ripple is compared with formula (22).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cosim import ORDERS, SetupError
from workbench import Bench, Chart, Curve, Figure, Findings, Mark, Panel, Show, Table, option
from workbench.answer import parameters
from workbench.limit import limit
from workbench.live import (
    REVOLUTION,
    Live,
    LiveChart,
    LivePanel,
    LiveSweep,
    Number,
    Reader,
    Slider,
    Steady,
)
from workbench.report import chart as colors
from workbench.report.chart import Second, Span

from . import live_theory, mechanism, response
from .drive import PARTS as DRIVE
from .drive import conveyor_drive, followed, induction, linearised, start_values
from .response import COARSER, LAG, SPEED, TORQUE, Known, Line, Place, Point, Ripple, Setup
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
MARKS = {"nu_90": "90 deg lag", "nu_peak_tau": "torque peak", "nu_peak_w": "speed peak"}
OWN = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")


@dataclass(frozen=True, kw_only=True)
class Options(Ripple):
    speed: float | None = option(
        None, "operating speed, 40 in set A and 60 in set B by default", "rad/s", above=0.0
    )
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)
    speeds: tuple[float, ...] = option(
        (), "speeds of the sweep, those of the set by default", "rad/s", above=0.0
    )


Edge = tuple[Place, Figure]
Row = Mapping[str, tuple[float, str]]


class Sweep(NamedTuple):
    """How machines were run, the machine at each speed, the speeds of the sweep and of operation; what
    orbits tell at all of them, and those that are steady; stretches of speed to avoid [rad/s], and
    where these end but for the ends of the sweep.
    """

    setup: Setup
    line: Line
    nus: Sequence[float]
    speed: float
    rows: Mapping[float, Row]
    known: Known
    avoid: Sequence[tuple[float, float]]
    edges: Sequence[Edge]


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
    spots = [(*line.at(nu), k) for k in reversed(coarser) for nu in wanted]
    runs: dict[float, list[Point]] = {nu: [] for nu in wanted}
    for point, (_, nu, _) in zip(setup.each(spots, "sweep"), spots):
        runs[nu].insert(0, point)
    problems = {x.nu: x.problem for points in runs.values() for x in points if x.problem}
    for nu, problem in problems.items():
        logging.getLogger("cosim").warning(f"No steady orbit at {nu:g} rad/s: {problem}")
    sweep = swept(o, setup, line, nus, operating, runs)
    passed = [place for place, _ in sweep.edges]
    sought = [(line, place, sweep.known) for place in (LAG, TORQUE, SPEED, *passed)]
    (lag, _), (torque, tau2), (speed, w2), *more = response.places(sought, coarser, "rad/s", setup)
    edges = [(place, figure) for place, (figure, _) in zip(passed, more)]
    sweep = sweep._replace(avoid=stretches(o, line, sweep.known, edges), edges=edges)
    force = response.largest_force(runs[nu] for nu in nus)
    standing = next((nu for nu in problems if nu in nus), nus[0])
    figures = formulas(sweep) | {
        "nu_90": lag, "nu_peak_tau": torque, "tau2_peak": tau2, "nu_peak_w": speed, "w2_peak": w2,
        "tau2_operating": at_speed(sweep),
        "f_rod_peak": told(*force, "N", "largest rod force of the sweep", standing),
    }  # fmt: skip
    below = bool(edges) and edges[0][0].sort == "fall"
    for k, (place, figure) in enumerate(edges, below):
        name = "avoid_from" if place.sort == "rise" else "avoid_to"
        figures[f"{name}_{k // 2 + 1}" if k > 1 else name] = figure
    machine, units = middle(sweep), {name: x for name, (_, x) in sweep.rows[operating].items()}
    return Findings(
        figures,
        sweep,
        conveyor_drive(bench.fmus, start_values(machine, o.start, machine.nu_res)),
        communication=f"{o.steps_per_rev} steps per revolution",
        algorithm=o.algorithm,
        tables={
            TABLE: Table.of_rows([[x for x, _ in sweep.rows[nu].values()] for nu in nus], units)
        },
        facts={"operating_speed": operating, "rated_torque": o.rated},
    )


def swept(
    o: Options,
    setup: Setup,
    line: Line,
    nus: Sequence[float],
    speed: float,
    runs: Mapping[float, Sequence[Point]],
) -> Sweep:
    """What orbits tell that were run so far; the ends of stretches to avoid without their errors."""
    order = ORDERS[o.algorithm]
    rows = {nu: row(line.at(nu)[0], points, order) for nu, points in runs.items()}
    known = [(nu, runs[nu][0]) for nu in nus if not runs[nu][0].problem]
    passed = line.edges(o.most, known) if len(known) > 1 else []
    edges = [(place, Figure.refused("rad/s", "it is still sought")) for place in passed]
    avoid = stretches(o, line, known, edges)
    return Sweep(setup, line, nus, speed, rows, known, avoid, edges)


def middle(r: Sweep) -> Machine:
    """The machine at the resonance that the one in the middle of the sweep has by formula (22)."""
    machine, _ = r.line.at(r.line.at(r.nus[len(r.nus) // 2])[0].nu_res)
    return machine


def formulas(r: Sweep) -> dict[str, Figure]:
    """What formulas tell."""
    machine = middle(r)
    return {
        "nu_res": Figure(machine.nu_res, "rad/s", 0.0, "resonance by formula (22)"),
        "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
    }


def at_speed(r: Sweep) -> Figure:
    """The torque ripple at the operating speed."""
    (value, unit), (error, _) = (r.rows[r.speed][name] for name in ("tau2", "tau2_error"))
    return told(value, error, unit, "torque ripple at the operating speed", r.speed)


def ladder(setup: Setup, line: Line, slowest: float) -> Sequence[int]:
    """N, N/2 and N/4 steps per revolution; N alone where N/4 are not stable at the slowest speed."""
    try:
        setup.check(*line.at(slowest), COARSER[-1])
    except SetupError:
        return COARSER[:1]
    return COARSER


def row(machine: Machine, points: Sequence[Point], order: float) -> dict[str, tuple[float, str]]:
    """What orbits of one speed with N, N/2, N/4 steps tell, beside theory, and its units; nan where
    there is no orbit, and for errors that are not known.
    """
    nu, deg = points[0].nu, partial(np.angle, deg=True)
    found: dict[str, tuple[float, str]] = {"nu": (nu, "rad/s")}
    theory: dict[str, tuple[float, str]] = {}
    ripples = {"w2": (SPEED, machine.speed_ripple(nu)), "tau2": (TORQUE, machine.torque_ripple(nu))}
    for name, (place, ripple) in ripples.items():
        whole, error = extrapolated([place.response(point) for point in points], order)
        error += 2.0 * place.settling(points[0])
        found |= {name: (abs(whole), place.unit), f"{name}_error": (error, place.unit)}
        found |= {f"{name}_phase": (deg(whole), "deg")}
        theory |= {f"{name}_theory": (abs(ripple), place.unit)}
        theory |= {f"{name}_phase_theory": (deg(ripple), "deg")}
    lag = (deg(machine.load_ripple(nu)) - deg(whole)) % 360.0
    mean, mean_error = extrapolated([point.mean for point in points], order)
    force, force_error = response.largest_force([points])
    return found | theory | {
        "lag": (lag, "deg"),
        "lag_error": (math.degrees(error / abs(whole)), "deg"),
        "w_mean": (mean.real, "rad/s"),
        "w_mean_error": (mean_error + 2e-9 * points[0].mean, "rad/s"),
        "f_rod_peak": (force, "N"),
        "f_rod_peak_error": (force_error, "N"),
    }  # fmt: skip


def extrapolated(values: Sequence[complex], order: float) -> tuple[complex, float]:
    """Where values at steps h, 2 h, 4 h go, and the error of that, nan where it is not known."""
    parts = [limit([getattr(x, part) for x in values], order) for part in ("real", "imag")]
    errors = [math.nan if error is None else error for _, error, _ in parts]
    return complex(parts[0][0], parts[1][0]), math.hypot(*errors)


def told(value: float, error: float, unit: str, meaning: str, nu: float) -> Figure:
    """A figure of the orbit at nu, refused where that or the error is not known."""
    if math.isnan(error):
        why = f"there is no steady orbit at {nu:g} rad/s"
        reason = (
            why
            if math.isnan(value)
            else "the coupling error is not known; take more steps per revolution"
        )
        return Figure.refused(unit, reason, meaning)
    return Figure(value, unit, error, meaning)


def stretches(
    o: Options, line: Line, known: Known, edges: Sequence[Edge]
) -> list[tuple[float, float]]:
    """The stretches of a line in which the torque ripple is above its limit, by its edges and, where
    it has none, by known orbits.
    """
    ends = [place.near if f.error is None else f.value for place, f in edges]
    above = any(abs(point.torque) > o.most for _, point in known)
    if edges[0][0].sort == "fall" if edges else above:
        ends.insert(0, line.first)
    return list(zip(ends[::2], [*ends[1::2], line.last]))


def verdict(o: Options, f: Mapping[str, Figure], r: Sweep) -> str:
    """The answer in plain words."""
    ripple, resonance, formula = f["tau2_operating"], f["nu_90"], f["nu_res"].value
    at = f"the operating speed of {r.speed:g} rad/s ({r.speed * 30 / math.pi:.0f} rpm)"
    first, last, away = r.line.first, r.line.last, resonance.value / r.speed - 1.0
    if ripple.error is None:
        answer = f"Whether {at} is on the resonance is not determined: {ripple.reason}"
    else:
        answer = (
            f"{'Yes' if ripple.value > o.most else 'No'}: at {at} the torque ripple is "
            f"{ripple.text()}, {ripple.value / o.rated:.0%} of the rated torque, and the limit is "
            f"{o.most:g} N.m"
        )
    if abs(away) < 5e-4:
        answer += f". The resonance is at that speed, {resonance.text()}"
    elif resonance.error is not None:
        side = "above" if away > 0 else "below"
        answer += f". The resonance is at {resonance.text()}, {abs(away):.1%} {side} that speed"
    lines = [f"{answer}."]
    if r.edges:
        why = [
            f"; their error is not determined: {f.reason}" for _, f in r.edges if f.error is None
        ]
        where = f"{avoided(r.edges)}, where the torque ripple is above the limit"
        lines.append(f"Avoid speeds {where}{''.join(why[:1])}.")
    elif r.avoid:
        lines.append("The torque ripple is above the limit at every speed of the sweep.")
    elif not all(math.isnan(r.rows[nu]["tau2"][0]) for nu in r.nus):
        lines.append("The torque ripple stays below the limit at every speed of the sweep.")
    if resonance.error is None:
        lag = "The speed at which the torque ripple lags by 90 degrees"
        lines.append(f"{lag} is not determined: {resonance.reason}.")
    if not first <= formula <= last:
        sweep = f"The sweep from {first:g} to {last:g} rad/s"
        lines[-1] += f" {sweep} does not include the {formula:.3f} rad/s of formula (22)."
    return "\n".join(lines)


def avoided(edges: Sequence[Edge]) -> str:
    """The stretches between edges in words, with the digits that hold."""
    told, last = [], len(edges) - 1
    for k, (place, figure) in enumerate(edges):
        about = f"about {float(f'{place.near:.2g}'):g} rad/s"
        where = about if figure.error is None else figure.text()
        if place.sort == "rise":
            told.append(f"{'from' if k < last else 'above'} {where}")
        else:
            told.append(f"{'to' if k else 'below'} {where}{' and' if k < last else ''}")
    return " ".join(told)


def show(o: Options, f: Mapping[str, Figure], r: Sweep) -> Show:
    """The sweep against theory, and one revolution at the operating speed."""
    return Show([ripple(o, f, r)], *mechanism.revolution(r.setup.case(*r.line.at(r.speed))))


def ripple(o: Options, f: Mapping[str, Figure], r: Sweep) -> Chart:
    """Ripple of torque and speed and the lag over the speed, theory as lines; the title answers."""
    nu = np.linspace(r.nus[0], r.nus[-1], 400)
    machine, _ = r.line.at(f["nu_res"].value)
    torque, omega = machine.torque_ripple(nu), machine.speed_ripple(nu)
    lag = np.angle(machine.load_ripple(nu) / torque, deg=True) % 360.0

    def panel(quantity: str, unit: str, name: str, theory: Any, color: str, *levels: Mark) -> Panel:
        at, y, errors = (
            [r.rows[x][column][0] for x in r.nus] for column in ("nu", name, f"{name}_error")
        )
        seen = Curve("co-simulation", at, y, color, "points", errors)
        line = Curve("first-order theory", nu, theory, colors.THEORY, "theory")
        return Panel(
            quantity, unit, [line, seen], levels, includes=(0.0, *(180.0,) * (unit == "deg"))
        )

    tau2, w2 = TORQUE.unit, SPEED.unit
    rated, limit = f"rated torque {o.rated:g} N.m", f"limit {o.most:g} N.m"
    there = {MARKS[name]: x for name, x in f.items() if name in MARKS and math.isfinite(x.value)}
    over = f["tau2_operating"].value > o.most or any(x <= r.speed <= y for x, y in r.avoid)
    where = " and ".join(f"{x:.1f} to {y:.1f} rad/s" for x, y in r.avoid) or "no speed"
    return Chart(
        f"{'Yes' if over else 'No'} at {r.speed:g} rad/s: the torque ripple is above {o.most:g} N.m at {where}",
        "operating speed [rad/s]",
        [
            panel("torque ripple", tau2, "tau2", abs(torque), colors.TORQUE,
                  Mark(o.rated, rated), Mark(o.most, limit)),
            panel("speed ripple", w2, "w2", abs(omega), colors.SPEED),
            panel("lag behind the load", "deg", "lag", lag, colors.LIFT, Mark(90.0, "90 deg")),
        ],
        [Mark(machine.nu_res, f"formula {machine.nu_res:.2f} rad/s"),
         *(Mark.of(text, figure) for text, figure in there.items()),
         Mark(r.speed, f"operating speed {r.speed:g} rad/s")],
        [Span(*band, "avoid", "red") for band in r.avoid],
        Second("rpm", 30 / math.pi),
    )  # fmt: skip


#: steps per revolution of the live sweep, of which a ripple of order 2 needs a few dozen
SWEEP_STEPS = 128
#: the share to which live revolutions repeat, below the step differences of 512 and of 128 steps
ORBIT, SWEEP_ORBIT = Steady(1e-6, 200), Steady(1e-4, 80)


def live_part(o: Options, f: Mapping[str, Figure], r: Sweep) -> Live:
    """The orbit at the speed of the slider, and the ripple over the speeds of the sweep."""
    is_linear = not induction(o.start)
    torque = Reader("amplitude", "motor.tau", REVOLUTION, 2)
    speed = Reader("amplitude", "conveyor.w", REVOLUTION, 2)
    phase = Number(
        "tau2_phase",
        Reader("phase", "motor.tau", REVOLUTION, 2),
        "deg",
        "phase of the torque ripple",
        is_shown=False,
    )
    lag = "mod(atan2(load_im, load_re) * 180 / pi - figures.tau2_phase, 360)"
    limits = {f"rated torque {o.rated:g} N.m": o.rated, f"limit {o.most:g} N.m": o.most}
    ripple = [
        ("torque ripple", TORQUE.unit, "figures.tau2", "torque_ripple", colors.TORQUE, limits),
        ("speed ripple", SPEED.unit, "figures.w2", "speed_ripple", colors.SPEED, {}),
        ("lag behind the load", "deg", lag, "torque_lag", colors.LIFT, {"90 deg": 90.0}),
    ]
    over_speed = [
        LivePanel(
            quantity,
            {
                theory: ("first-order theory", colors.THEORY, "theory"),
                run: ("co-simulation", color, "linked"),
            },
            unit,
            levels,
            (0.0,),
        )
        for quantity, unit, run, theory, color, levels in ripple
    ]
    marks = {"operating speed": ("speed", "rad/s")}
    if is_linear:
        marks["formula"] = ("nu_res", "rad/s")
    course = [
        LivePanel(
            "torque",
            {"motor.tau": ("motor", colors.TORQUE), "conveyor.tau_load": ("load", colors.THEORY)},
        ),
        LivePanel("speed", {"conveyor.w": colors.SPEED}),
        LivePanel("rod force", {"conveyor.f_rod": colors.FORCE}, "kN"),
    ]
    system = conveyor_drive(r.setup.bench.fmus, start_values(middle(r), o.start, r.speed))
    p = {name.removeprefix("conveyor."): x.value for name, x in parameters(system).items()}
    return Live(
        sliders=(
            Slider("conveyor.spring.c", 2e5, 1.4e6),
            Slider("speed", 20.0, 66.0),
            Slider("conveyor.trough.m", 80.0, 400.0),
            Slider("conveyor.rotor.J", 0.2, 1.2),
            Slider("motor.T", 0.02, 0.2),
            Slider("motor.B", 50.0, 500.0),
            Slider("conveyor.trough.d", 1000.0, 12000.0),
        ),
        values=live_theory.values(o.start),
        start=live_theory.START | ({} if is_linear else live_theory.KLOSS_START),
        stop="2 * pi / speed",
        step="2 * pi / (speed * steps_per_rev)",
        angle="conveyor.phi",
        steady=ORBIT,
        numbers=[
            Number("tau2_operating", torque),
            Number("w2", speed, "rad/s", "speed ripple at the operating speed"),
            phase,
            Number("lag", lag, "deg", "lag of the torque behind the load ripple"),
            *(live_theory.NUMBERS if is_linear else ()),
        ],
        charts=[
            LiveChart(
                "One revolution at the operating speed",
                "crank angle [deg]",
                course,
                "crank_angle * 180 / pi",
                REVOLUTION,
            )
        ],
        motion=mechanism.live_motion("The conveyor in this revolution", p, 25.0, REVOLUTION),
        sweep=LiveSweep(
            over="speed",
            values=r.nus,
            step=f"2 * pi / (speed * {SWEEP_STEPS})",
            steady=SWEEP_ORBIT,
            numbers=[
                Number("tau2", torque, "N.m", "torque ripple"),
                Number("w2", speed, "rad/s", "speed ripple"),
                phase,
            ],
            chart=LiveChart(
                "Ripple over the operating speed",
                "operating speed [rad/s]",
                over_speed,
                marks=marks,
            ),
        ),
    )


LIVE = live_part
