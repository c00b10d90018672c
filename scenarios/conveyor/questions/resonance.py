"""Does the operating speed sit on the electromechanical resonance of the drive?

Motor and conveyor are coupled at each speed of a sweep until their orbit is steady. The ripple of
order 2 of speed and torque is compared with first-order theory. The resonance is the speed at which the
torque ripple lags 90 degrees behind the load ripple; it is compared with formula (22). The operating
speed is on the resonance if the lag there is from 45 to 135 degrees, which is the half-power band. A
drive whose damping ratio is above 0.7071 amplifies the load ripple most at standstill and has no
resonance. Whether the torque ripple is above its limit is a question of its own.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cosim import CONVERGENCE_ORDERS, SetupError
from workbench import Bench, Chart, Curve, Figure, Findings, Mark, Panel, Show, Table, option
from workbench.answer import parameters
from workbench.charts import model as colors
from workbench.charts.model import Second, Span
from workbench.figure import SENTENCE_DIGITS, SHARE_DIGITS, concise, percent
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

from .. import features, live_theory, motion
from ..features import (
    COARSER,
    LAG,
    SPEED,
    TORQUE,
    VANISHING,
    Known,
    Line,
    Place,
    Point,
    Ripple,
    Setup,
)
from ..first_order import SETS, Machine
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive, followed, induction, linearised, start_values

PARTS = DRIVE
SPEEDS = {
    "A": "20,24,28,30,32,33,34,35,36,36.5,37,37.5,38,38.5,39,39.5,40,40.5,41,41.5,42,43,44,45,46,"
    "48,50,54,57,60,66",
    "B": "6,8,10,12,14,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,36,38,40,43,46,50,"
    "55,60,66",
}
OPERATING = {"A": 40.0, "B": 60.0}
TABLE = "resonance.csv"
DECISIVE = ("lag_operating", "tau2_operating")
#: Lags [deg] at the two ends of the half-power band. At 90 degrees -+ 45 degrees the two parts of load
#: over response are equal, so the power that the ripple dissipates is half of that at 90 degrees.
BAND = (45.0, 135.0)
#: Damping ratio above which torque over load, 1 / (1 - x^2 + 2 i zeta x), has no peak at any x > 0.
OVERDAMPED = math.sqrt(0.5)
UNDETERMINED = "not determined"
MARKS = {"nu_90": "90 deg lag", "nu_peak_tau": "torque peak", "nu_peak_w": "speed peak"}
OWN = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")


@dataclass(frozen=True, kw_only=True)
class Options(Ripple):
    speed: float | None = option(
        None,
        "operating speed, 40 in set A and 60 in set B by default; it is on the resonance if the torque "
        "ripple lags its load by 45 to 135 degrees (half-power band)",
        "rad/s",
        above=0.0,
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
    (lag, _), (torque, tau2), (speed, w2), *more = features.places(sought, coarser, "rad/s", setup)
    edges = [(place, figure) for place, (figure, _) in zip(passed, more)]
    sweep = sweep._replace(avoid=stretches(o, line, nus, sweep.rows, edges), edges=edges)
    force = features.largest_force(runs[nu] for nu in nus)
    standing = next((nu for nu in problems if nu in nus), nus[0])
    figures = formulas(sweep) | {
        "nu_90": lag, "nu_peak_tau": torque, "tau2_peak": tau2, "nu_peak_w": speed, "w2_peak": w2,
        **at_speed(sweep), "nu_90_away": distance(lag, operating),
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
        defaults={"speed": operating, "rated_torque": o.rated, "speeds": nus},
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
    order = CONVERGENCE_ORDERS[o.algorithm]
    rows = {nu: row(line.at(nu)[0], points, order) for nu, points in runs.items()}
    # a load of exactly 0 leaves no ripple, and nothing to learn of load over response
    known = [(nu, runs[nu][0]) for nu in nus if abs(runs[nu][0].torque) > 0.0]
    passed = line.edges(o.most, known) if len(known) > 1 else []
    edges = [(place, Figure.refused("rad/s", "it is still sought")) for place in passed]
    avoid = stretches(o, line, nus, rows, edges)
    return Sweep(setup, line, nus, speed, rows, known, avoid, edges)


def middle(r: Sweep) -> Machine:
    """The machine at the resonance that the one in the middle of the sweep has by formula (22)."""
    machine, _ = r.line.at(r.line.at(r.nus[len(r.nus) // 2])[0].nu_res)
    return machine


def formulas(r: Sweep) -> dict[str, Figure]:
    """What formulas tell."""
    machine = middle(r)
    name = "resonance" if machine.zeta <= OVERDAMPED else "90 deg lag"
    return {
        "nu_res": Figure(machine.nu_res, "rad/s", 0.0, f"{name} by formula (22)"),
        "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
    }


def at_speed(r: Sweep) -> dict[str, Figure]:
    """Torque ripple and lag at the operating speed."""
    (ripple, unit), (ripple_error, _) = (r.rows[r.speed][x] for x in ("tau2", "tau2_error"))
    (lag, degrees), (lag_error, _) = (r.rows[r.speed][x] for x in ("lag", "lag_error"))
    ripple_meaning = "torque ripple at the operating speed"
    lag_meaning = "lag of the torque ripple behind its load at the operating speed"
    lag_figure = told(lag, lag_error, degrees, lag_meaning, r.speed)
    machine, nu = r.line.at(r.speed)
    parts = machine.r**2 / 2 * (machine.c + machine.m * nu**2 + machine.d * nu)
    if not math.isnan(lag) and abs(machine.load_ripple(nu)) < VANISHING * parts:
        reason = f"the load ripple nearly vanishes at {r.speed:g} rad/s, so its phase means nothing"
        lag_figure = Figure.refused(degrees, reason, lag_meaning)
    return {
        "tau2_operating": told(ripple, ripple_error, unit, ripple_meaning, r.speed),
        "lag_operating": lag_figure,
    }


def distance(lag: Figure, speed: float) -> Figure:
    """How far the speed of the 90 degree lag is above the operating speed."""
    meaning = "distance of the 90 deg lag from the operating speed"
    if lag.error is None:
        return Figure.refused("rad/s", lag.reason, meaning)
    return Figure(lag.value - speed, "rad/s", lag.error, meaning)


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
    force, force_error = features.largest_force([points])
    return found | theory | {
        "lag": (lag, "deg"),
        "lag_error": (math.degrees(error / abs(whole)) if whole else math.nan, "deg"),
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
        why = f"no steady orbit is found at {nu:g} rad/s"
        reason = (
            why
            if math.isnan(value)
            else "the coupling error is not known; take more steps per revolution"
        )
        return Figure.refused(unit, reason, meaning)
    return Figure(value, unit, error, meaning)


def stretches(
    o: Options, line: Line, nus: Sequence[float], rows: Mapping[float, Row], edges: Sequence[Edge]
) -> list[tuple[float, float]]:
    """The stretches of a line in which the torque ripple is above its limit, by its edges and, where
    it has none, by the rows of all speeds.
    """
    ends = [place.near if f.error is None else f.value for place, f in edges]
    if (
        edges[0][0].sort == "fall"
        if edges
        else all(above_limit(o, rows[nu]) == "yes" for nu in nus)
    ):
        ends.insert(0, line.first)
    return list(zip(ends[::2], [*ends[1::2], line.last]))


def above_limit(o: Options, row: Row) -> str:
    """Whether the torque ripple of a speed is above its limit: yes, no, or not determined."""
    (value, _), (error, _) = row["tau2"], row["tau2_error"]
    if value - error > o.most:
        return "yes"
    return "no" if value + error <= o.most else UNDETERMINED


def on_resonance(f: Mapping[str, Figure]) -> str:
    """Whether the operating speed is on the resonance: yes, no, or not determined."""
    if f["zeta"].value > OVERDAMPED:
        return "no"
    lag, (first, last) = f["lag_operating"], BAND
    if lag.error is None:
        return UNDETERMINED
    low, high = lag.value - lag.error, lag.value + lag.error
    if first <= low and high <= last:
        return "yes"
    return "no" if high < first or low > last else UNDETERMINED


def verdict(o: Options, f: Mapping[str, Figure], r: Sweep) -> str:
    """The answer in plain words: on the resonance, above the limit, speeds to avoid."""
    return "\n".join([about_resonance(f, r), about_limit(o, f, r), *about_sweep(o, r)])


def about_resonance(f: Mapping[str, Figure], r: Sweep) -> str:
    """Whether the operating speed is on the resonance, and how far it is from it."""
    lag, resonance, answer = f["lag_operating"], f["nu_90"], on_resonance(f)
    formula, first, last = f["nu_res"].value, r.line.first, r.line.last
    sentences = [f"On resonance: {answer}"]
    at = operating_speed(r)
    behind = ""
    where = "" if resonance.error is None else f"at {resonance.brief()}, {side(f, r)}"
    if f["zeta"].value > OVERDAMPED:
        sentences.append(
            f"The drive has no resonance: by formula its damping ratio is {f['zeta'].brief()}, and above "
            f"{OVERDAMPED:.4f} the ratio of torque to load has no peak over the speed"
        )
        where = f"The torque ripple lags its load by 90 degrees {where}; that is no resonance"
    else:
        if lag.error is None:
            sentences[0] += f", because {lag.reason}"
        else:
            place = {"yes": "within", "no": "outside"}.get(
                answer, "and that may be inside or outside"
            )
            band = f"the half-power band of {BAND[0]:g} to {BAND[1]:g} degrees"
            behind = f"the torque ripple lags its load by {lag.brief('degrees')}, {place} {band}"
        where = f"The resonance is {where}{behind and f'; there {behind}'}"
    if resonance.error is None:
        lag_speed = "The speed at which the torque ripple lags by 90 degrees"
        if behind:
            sentences.append(f"At {at} {behind}")
        where = f"{lag_speed} is not determined: {resonance.reason}"
        if not first <= formula <= last:
            sweep = f"The sweep from {first:g} to {last:g} rad/s"
            where += (
                f". {sweep} does not include the {formula:.4g} rad/s of the resonance formula (22)"
            )
    return f"{'. '.join([*sentences, where])}."


def operating_speed(r: Sweep) -> str:
    """The operating speed in words."""
    return f"the operating speed of {r.speed:g} rad/s ({r.speed * 30 / math.pi:.0f} rpm)"


def side(f: Mapping[str, Figure], r: Sweep) -> str:
    """How far the resonance is from the operating speed, in words: in percent and, where the two speeds
    differ in the digits of a sentence, in rad/s, with the digits that are certain.
    """
    away, resonance = f["nu_90_away"], f["nu_90"]
    error = away.error or 0.0
    if abs(away.value) <= error:
        return f"which is {operating_speed(r)} within its error of {error:.1g} {away.unit}"
    size = abs(away.value)
    share = concise(Figure(100.0 * size / r.speed, "%", 100.0 * error / r.speed), SHARE_DIGITS)
    where = f"{'above' if away.value > 0.0 else 'below'} {operating_speed(r)}"
    if f"{resonance.value:.{SENTENCE_DIGITS}g}" == f"{r.speed:.{SENTENCE_DIGITS}g}":
        return f"{share} {where}"
    distant = concise(Figure(size, away.unit, error), SENTENCE_DIGITS)
    return f"{distant} {where}" if size > r.speed else f"{distant} ({share}) {where}"


def about_limit(o: Options, f: Mapping[str, Figure], r: Sweep) -> str:
    """Whether the torque ripple at the operating speed is above its limit."""
    ripple, answer = f["tau2_operating"], above_limit(o, r.rows[r.speed])
    sentence = f"Torque ripple above its limit: {answer}"
    if ripple.error is None:
        return f"{sentence}, because {ripple.reason}."
    if answer == UNDETERMINED:
        sentence += ", because the limit lies within the error"
    return (
        f"{sentence}. At the operating speed it is {ripple.brief()}, {percent(ripple.value / o.rated)} of the rated "
        f"torque; the limit is {o.most:g} N.m."
    )


def about_sweep(o: Options, r: Sweep) -> list[str]:
    """Speeds to avoid, with the digits that hold, and at how many speeds nothing is known."""
    total = len(r.nus)
    steady = len([nu for nu in r.nus if not math.isnan(r.rows[nu]["tau2"][0])])
    answers = [above_limit(o, r.rows[nu]) for nu in r.nus]
    above, below = answers.count("yes"), answers.count("no")
    lines = []
    where = f"the torque ripple is above the limit {avoided(r.edges)}"
    reasons = [figure.reason for _, figure in r.edges if figure.error is None]
    if r.edges and not reasons:
        lines.append(
            f"Avoid speeds {avoided(r.edges)}, where the torque ripple is above the limit."
        )
    elif r.edges:
        steps = f"With {o.steps_per_rev} steps per revolution {where}"
        lines.append(f"{steps}. How far that is from the truth is not determined: {reasons[0]}.")
    elif above + below:
        at = f"each of the {above + below} of {total} speeds at which it is determined"
        if above + below == total:
            at = "every speed of the sweep"
        elif above + below == steady:
            at = f"each of the {steady} of {total} speeds that have a steady orbit"
        if above + below == 1 < total:
            at = f"the only one of {total} speeds at which it is determined"
        if above and below:
            lines.append(f"The torque ripple is above the limit at {above} of {total} speeds.")
        else:
            verb = "is above" if above else "stays below"
            lines.append(f"The torque ripple {verb} the limit at {at}.")
    if steady < total:
        lines.append(f"No steady orbit is found at {total - steady} of the {total} speeds.")
    return lines


def avoided(edges: Sequence[Edge]) -> str:
    """The stretches between edges in words, with the digits that hold."""
    parts, last = [], len(edges) - 1
    for k, (place, figure) in enumerate(edges):
        about = f"about {float(f'{place.near:.2g}'):g} rad/s"
        where = about if figure.error is None else figure.brief()
        if place.sort == "rise":
            parts.append(f"{'from' if k < last else 'above'} {where}")
        else:
            parts.append(f"{'to' if k else 'below'} {where}{' and' if k < last else ''}")
    return " ".join(parts)


def headline(o: Options, f: Mapping[str, Figure], r: Sweep) -> str:
    """Both answers in one line, for the picture: those of the verdict, with the reason of a refusal."""
    ripple, lag = f["tau2_operating"], f["lag_operating"]
    title = f"On resonance at {r.speed:g} rad/s: {on_resonance(f)}"
    if lag.error is None and on_resonance(f) == UNDETERMINED and lag.reason != ripple.reason:
        title += f" ({lag.reason})"
    title += f". Torque ripple above {o.most:g} N.m: {above_limit(o, r.rows[r.speed])}"
    return title if ripple.error is not None else f"{title} ({ripple.reason})"


def show(o: Options, f: Mapping[str, Figure], r: Sweep) -> Show:
    """The sweep against theory, and one revolution at the operating speed."""
    return Show(
        [ripple(o, f, r, headline(o, f, r))],
        *motion.revolution(r.setup.case(*r.line.at(r.speed))),
    )


def ripple(o: Options, f: Mapping[str, Figure], r: Sweep, title: str) -> Chart:
    """Ripple of torque and speed and the lag over the speed, theory as lines."""
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
    ends = [Mark(x, f"{x:g} deg, half power") for x in BAND]
    certain = all(figure.error is not None for _, figure in r.edges)
    return Chart(
        title,
        "operating speed [rad/s]",
        [
            panel("torque ripple", tau2, "tau2", abs(torque), colors.TORQUE,
                  Mark(o.rated, rated), Mark(o.most, limit)),
            panel("speed ripple", w2, "w2", abs(omega), colors.SPEED),
            panel("lag behind the load", "deg", "lag", lag, colors.LIFT, Mark(90.0, "90 deg"), *ends),
        ],
        [Mark(machine.nu_res, f"formula {machine.nu_res:.2f} rad/s"),
         *(Mark.of(text, figure) for text, figure in there.items()),
         Mark(r.speed, f"operating speed {r.speed:g} rad/s")],
        [Span(*band, "avoid", "red") for band in r.avoid if certain],
        Second("rpm", 30 / math.pi),
    )  # fmt: skip


#: steps per revolution of the live sweep, of which a ripple of order 2 needs a few dozen
SWEEP_STEPS = 256
#: points of the live sweep, so that a peak anywhere has several of them
SWEEP_POINTS = 60
#: the share to which live revolutions repeat, below the step differences of 512 and of 256 steps
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
        is_visible=False,
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
    sweep = LiveSweep(
        over="speed",
        values=np.linspace(r.nus[0], r.nus[-1], SWEEP_POINTS).tolist(),
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
    )
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
        start={**live_theory.START, **({} if is_linear else live_theory.KLOSS_START)},
        stop="2 * pi / speed",
        step="2 * pi / (speed * steps_per_rev)",
        angle="conveyor.phi",
        steady=ORBIT,
        numbers=[
            Number("tau2_operating", torque),
            Number("w2", speed, "rad/s", "speed ripple at the operating speed"),
            phase,
            Number("lag_operating", lag),
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
        motion=motion.live_motion("The conveyor in this revolution", p, 25.0, REVOLUTION),
        sweep=sweep if r.nus[0] < r.nus[-1] else None,
    )


LIVE = live_part
