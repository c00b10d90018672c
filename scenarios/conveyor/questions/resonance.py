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
from typing import Any

import numpy as np

from workbench import Chart, Context, Curve, Figure, Findings, Mark, Panel, Show, option
from workbench.answer import parameters
from workbench.charts import model as colors
from workbench.charts.model import SecondUnit, Span
from workbench.figure import SENTENCE_DIGITS, SHARE_DIGITS, concise, percent
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

from .. import live_theory, motion
from ..features import (
    LAG,
    PHASE_UNDEFINED,
    SPEED_PEAK,
    TORQUE_PEAK,
    VANISHING,
    Feature,
    Kind,
    ResponseLine,
    locate,
)
from ..first_order import SETS, Machine
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive, followed, induction, linearised, start_values
from ..options import RippleOptions, by_set, speeds_of
from ..orbits import OrbitRunner
from ..rows import OPERATING, OVERDAMPED, SPEEDS, SpeedSweep, row_figure, sweep_speeds

PARTS = DRIVE
TABLE = "resonance.csv"
DECISIVE = ("lag_operating", "tau2_operating")
#: Lags [deg] at the two ends of the half-power band. At 90 degrees -+ 45 degrees the two parts of load
#: over response are equal, so the power that the ripple dissipates is half of that at 90 degrees.
BAND = (45.0, 135.0)
UNDETERMINED = "not determined"
MARKS = {"nu_90": "90 deg lag", "nu_peak_tau": "torque peak", "nu_peak_w": "speed peak"}
FIXED_STARTS = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")


@dataclass(frozen=True, kw_only=True)
class Options(RippleOptions):
    speed: float | None = option(
        None,
        f"operating speed, {by_set(OPERATING)}; it is on the resonance if the torque ripple lags its load by "
        f"{BAND[0]:g} to {BAND[1]:g} degrees (half-power band)",
        "rad/s",
        above=0.0,
    )
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)
    speeds: tuple[float, ...] = option(
        (), "speeds of the sweep, those of the set by default", "rad/s", above=0.0
    )


@dataclass(frozen=True)
class LimitCrossing:
    """A speed at which the torque ripple passes its limit: as the sweep says, and as a figure."""

    feature: Feature
    figure: Figure

    @property
    def is_upward(self) -> bool:
        """Whether the ripple is above its limit beyond it."""
        return self.feature.kind is Kind.RISE

    @property
    def speed(self) -> float:
        """The speed as far as it is known [rad/s]."""
        return self.feature.near if self.figure.error is None else self.figure.value


@dataclass(frozen=True)
class ResonanceData:
    """The sweep, the operating speed [rad/s] with its row, and the speeds at which the limit is passed."""

    sweep: SpeedSweep
    speed: float
    operating: SpeedSweep
    crossings: Sequence[LimitCrossing]
    is_above_throughout: bool

    @property
    def line(self) -> ResponseLine:
        """The machine at each speed."""
        return self.sweep.line

    @property
    def machine(self) -> Machine:
        """The machine at the resonance that the one in the middle of the sweep has by formula (22)."""
        middle, _ = self.line.at(self.sweep.speeds[len(self.sweep.speeds) // 2])
        machine, _ = self.line.at(middle.nu_res)
        return machine

    @property
    def avoid(self) -> list[tuple[float, float]]:
        """The stretches of the sweep in which the torque ripple is above its limit [rad/s]."""
        ends = [crossing.speed for crossing in self.crossings]
        starts_above = (
            not self.crossings[0].is_upward if self.crossings else self.is_above_throughout
        )
        if starts_above:
            ends.insert(0, self.line.first)
        return list(zip(ends[::2], [*ends[1::2], self.line.last]))


def solve(o: Options, context: Context) -> Findings:
    """Sweep the speed, locate the features of the response, and judge the operating speed.

    Raises
    ------
    cosim.SetupError
        For settings that cannot give an answer.
    """
    speeds, speed = o.speeds or speeds_of(SPEEDS[o.set]), o.speed or OPERATING[o.set]
    base = followed(context.fmus, SETS[o.set], o.start)
    line = ResponseLine(lambda nu: (linearised(base, o.start, nu), nu), speeds[0], speeds[-1])
    runner = OrbitRunner(context, o.start, o.algorithm, o.steps_per_rev)
    all_speeds = sorted({*speeds, speed})
    for nu in all_speeds:
        runner.check(*line.at(nu))
    multiples = runner.step_multiples(*line.at(all_speeds[0]))
    warn_unsteady(sweep_speeds(runner, line, all_speeds, multiples))
    sweep = sweep_speeds(runner, line, speeds, multiples)
    operating = sweep_speeds(runner, line, [speed], multiples)

    steady = sweep.steady
    passed = line.limits_passed(o.ripple_limit, steady) if len(steady) > 1 else []
    sought = [(line, feature, steady) for feature in (LAG, TORQUE_PEAK, SPEED_PEAK, *passed)]
    (lag, _), (torque, tau2), (omega, w2), *ends = locate(sought, multiples, "rad/s", runner)
    crossings = [LimitCrossing(feature, end) for feature, (end, _) in zip(passed, ends)]
    is_above = all(above_limit(o, row) == "yes" for row in sweep.rows)
    data = ResonanceData(sweep, speed, operating, crossings, is_above)
    figures = {
        **formula_figures(data.machine),
        "nu_90": lag, "nu_peak_tau": torque, "tau2_peak": tau2, "nu_peak_w": omega, "w2_peak": w2,
        **operating_figures(data), "nu_90_away": distance(lag, speed),
        "f_rod_peak": sweep.force_figure(), **limit_figures(crossings),
    }  # fmt: skip
    return Findings(
        figures,
        data,
        conveyor_drive(context.fmus, start_values(data.machine, o.start, data.machine.nu_res)),
        communication=f"{o.steps_per_rev} steps per revolution",
        algorithm=o.algorithm,
        tables={TABLE: sweep.table},
        facts={"operating_speed": speed, "rated_torque": o.rated},
        defaults={"speed": speed, "rated_torque": o.rated, "speeds": speeds},
    )


def warn_unsteady(sweep: SpeedSweep) -> None:
    """Warn of each speed at which an orbit is not steady."""
    for nu, orbits in zip(sweep.speeds, sweep.orbits):
        if problem := next((orbit.problem for orbit in orbits if orbit.problem), ""):
            logging.getLogger("cosim").warning(f"No steady orbit at {nu:g} rad/s: {problem}")


def formula_figures(machine: Machine) -> dict[str, Figure]:
    """Return the figures of formulas."""
    name = "resonance" if machine.zeta <= OVERDAMPED else "90 deg lag"
    return {
        "nu_res": Figure(machine.nu_res, "rad/s", 0.0, f"{name} by formula (22)"),
        "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
    }


def operating_figures(r: ResonanceData) -> dict[str, Figure]:
    """Return torque ripple and lag at the operating speed."""
    (row,) = r.operating.rows
    meaning = "lag of the torque ripple behind its load at the operating speed"
    lag = row_figure(row, "lag", meaning)
    machine, nu = r.line.at(r.speed)
    parts = machine.r**2 / 2 * (machine.c + machine.m * nu**2 + machine.d * nu)
    if not math.isnan(row["lag"]) and abs(machine.load_ripple(nu)) < VANISHING * parts:
        lag = Figure.undetermined("deg", PHASE_UNDEFINED.format(f"at {r.speed:g} rad/s"), meaning)
    ripple = row_figure(row, "tau2", "torque ripple at the operating speed")
    return {"tau2_operating": ripple, "lag_operating": lag}


def distance(lag: Figure, speed: float) -> Figure:
    """Return how far the speed of the 90 degree lag is above the operating speed."""
    meaning = "distance of the 90 deg lag from the operating speed"
    if lag.error is None:
        return Figure.undetermined("rad/s", lag.reason, meaning)
    return Figure(lag.value - speed, "rad/s", lag.error, meaning)


def limit_figures(crossings: Sequence[LimitCrossing]) -> dict[str, Figure]:
    """Return the ends of the stretches to avoid, by number from the second stretch on."""
    figures = {}
    first = 1 if crossings and not crossings[0].is_upward else 0
    for k, crossing in enumerate(crossings, first):
        name = "avoid_from" if crossing.is_upward else "avoid_to"
        figures[f"{name}_{k // 2 + 1}" if k > 1 else name] = crossing.figure
    return figures


def above_limit(o: Options, row: Mapping[str, float]) -> str:
    """Say whether the torque ripple of a speed is above its limit: yes, no, or not determined."""
    value, error = row["tau2"], row["tau2_error"]
    if value - error > o.ripple_limit:
        return "yes"
    return "no" if value + error <= o.ripple_limit else UNDETERMINED


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


def verdict(o: Options, f: Mapping[str, Figure], r: ResonanceData) -> str:
    """The answer in plain words: on the resonance, above the limit, speeds to avoid."""
    return "\n".join([about_resonance(f, r), about_limit(o, f, r), *about_sweep(o, r)])


def about_resonance(f: Mapping[str, Figure], r: ResonanceData) -> str:
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
            position = {"yes": "within", "no": "outside"}.get(
                answer, "and that may be inside or outside"
            )
            band = f"the half-power band of {BAND[0]:g} to {BAND[1]:g} degrees"
            behind = f"the torque ripple lags its load by {lag.brief('degrees')}, {position} {band}"
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


def operating_speed(r: ResonanceData) -> str:
    """The operating speed in words."""
    return f"the operating speed of {r.speed:g} rad/s ({r.speed * 30 / math.pi:.0f} rpm)"


def side(f: Mapping[str, Figure], r: ResonanceData) -> str:
    """How far the resonance is from the operating speed, in words: in percent and, where the two speeds
    differ in the digits of a sentence, in rad/s, with the digits that are certain.
    """
    gap, resonance = f["nu_90_away"], f["nu_90"]
    error = gap.error or 0.0
    if abs(gap.value) <= error:
        return f"which is {operating_speed(r)} within its error of {error:.1g} {gap.unit}"
    size = abs(gap.value)
    share = concise(Figure(100.0 * size / r.speed, "%", 100.0 * error / r.speed), SHARE_DIGITS)
    where = f"{'above' if gap.value > 0.0 else 'below'} {operating_speed(r)}"
    if f"{resonance.value:.{SENTENCE_DIGITS}g}" == f"{r.speed:.{SENTENCE_DIGITS}g}":
        return f"{share} {where}"
    distant = concise(Figure(size, gap.unit, error), SENTENCE_DIGITS)
    return f"{distant} {where}" if size > r.speed else f"{distant} ({share}) {where}"


def about_limit(o: Options, f: Mapping[str, Figure], r: ResonanceData) -> str:
    """Whether the torque ripple at the operating speed is above its limit."""
    ripple, answer = f["tau2_operating"], above_limit(o, r.operating.rows[0])
    sentence = f"Torque ripple above its limit: {answer}"
    if ripple.error is None:
        return f"{sentence}, because {ripple.reason}."
    if answer == UNDETERMINED:
        sentence += ", because the limit lies within the error"
    return (
        f"{sentence}. At the operating speed it is {ripple.brief()}, {percent(ripple.value / o.rated)} of the rated "
        f"torque; the limit is {o.ripple_limit:g} N.m."
    )


def about_sweep(o: Options, r: ResonanceData) -> list[str]:
    """Speeds to avoid, with the digits that hold, and at how many speeds nothing is known."""
    total = len(r.sweep.speeds)
    steady = len([row for row in r.sweep.rows if not math.isnan(row["tau2"])])
    answers = [above_limit(o, row) for row in r.sweep.rows]
    above, below = answers.count("yes"), answers.count("no")
    lines = []
    where = f"the torque ripple is above the limit {avoided(r.crossings)}"
    reasons = [figure.reason for figure in (x.figure for x in r.crossings) if figure.error is None]
    if r.crossings and not reasons:
        lines.append(
            f"Avoid speeds {avoided(r.crossings)}, where the torque ripple is above the limit."
        )
    elif r.crossings:
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


def avoided(crossings: Sequence[LimitCrossing]) -> str:
    """The stretches between crossings in words, with the digits that hold."""
    parts, last = [], len(crossings) - 1
    for k, crossing in enumerate(crossings):
        about = f"about {float(f'{crossing.feature.near:.2g}'):g} rad/s"
        where = about if crossing.figure.error is None else crossing.figure.brief()
        if crossing.is_upward:
            parts.append(f"{'from' if k < last else 'above'} {where}")
        else:
            parts.append(f"{'to' if k else 'below'} {where}{' and' if k < last else ''}")
    return " ".join(parts)


def headline(o: Options, f: Mapping[str, Figure], r: ResonanceData) -> str:
    """Both answers in one line, for the picture: those of the verdict, with the reason of a refusal."""
    ripple, lag = f["tau2_operating"], f["lag_operating"]
    title = f"On resonance at {r.speed:g} rad/s: {on_resonance(f)}"
    if lag.error is None and on_resonance(f) == UNDETERMINED and lag.reason != ripple.reason:
        title += f" ({lag.reason})"
    title += f". Torque ripple above {o.ripple_limit:g} N.m: {above_limit(o, r.operating.rows[0])}"
    return title if ripple.error is not None else f"{title} ({ripple.reason})"


def show(o: Options, f: Mapping[str, Figure], r: ResonanceData) -> Show:
    """The sweep against theory, and one revolution at the operating speed."""
    return Show(
        [ripple(o, f, r, headline(o, f, r))],
        *motion.revolution(r.sweep.runner.task(*r.line.at(r.speed))),
    )


def ripple(o: Options, f: Mapping[str, Figure], r: ResonanceData, title: str) -> Chart:
    """Ripple of torque and speed and the lag over the speed, theory as lines."""
    nu = np.linspace(r.line.first, r.line.last, 400)
    machine, _ = r.line.at(f["nu_res"].value)
    torque, omega = machine.torque_ripple(nu), machine.speed_ripple(nu)
    lag = np.angle(machine.load_ripple(nu) / torque, deg=True) % 360.0

    def panel(quantity: str, unit: str, name: str, theory: Any, color: str, *levels: Mark) -> Panel:
        at, y, errors = (
            r.sweep.frame[column].to_numpy() for column in ("nu", name, f"{name}_error")
        )
        points = Curve("co-simulation", at, y, color, "points", errors)
        line = Curve("first-order theory", nu, theory, colors.THEORY, "theory")
        return Panel(
            quantity, unit, [line, points], levels, includes=(0.0, *(180.0,) * (unit == "deg"))
        )

    tau2, w2 = TORQUE_PEAK.unit, SPEED_PEAK.unit
    rated, limit = f"rated torque {o.rated:g} N.m", f"limit {o.ripple_limit:g} N.m"
    located = {MARKS[name]: x for name, x in f.items() if name in MARKS and math.isfinite(x.value)}
    ends = [Mark(x, f"{x:g} deg, half power") for x in BAND]
    is_certain = all(crossing.figure.error is not None for crossing in r.crossings)
    return Chart(
        title,
        "operating speed [rad/s]",
        [
            panel("torque ripple", tau2, "tau2", abs(torque), colors.TORQUE,
                  Mark(o.rated, rated), Mark(o.ripple_limit, limit)),
            panel("speed ripple", w2, "w2", abs(omega), colors.SPEED),
            panel("lag behind the load", "deg", "lag", lag, colors.LIFT, Mark(90.0, "90 deg"), *ends),
        ],
        [Mark(machine.nu_res, f"formula {machine.nu_res:.2f} rad/s"),
         *(Mark.of(text, figure) for text, figure in located.items()),
         Mark(r.speed, f"operating speed {r.speed:g} rad/s")],
        [Span(*band, "avoid", "red") for band in r.avoid if is_certain],
        SecondUnit("rpm", 30 / math.pi),
    )  # fmt: skip


#: steps per revolution of the live sweep, of which a ripple of order 2 needs a few dozen
SWEEP_STEPS = 256
#: points of the live sweep, so that a peak anywhere has several of them
SWEEP_POINTS = 60
#: the share to which live revolutions repeat, below the step differences of 512 and of 256 steps
ORBIT, SWEEP_ORBIT = Steady(1e-6, 200), Steady(1e-4, 80)


def live_part(o: Options, f: Mapping[str, Figure], r: ResonanceData) -> Live:
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
    limits = {
        f"rated torque {o.rated:g} N.m": o.rated,
        f"limit {o.ripple_limit:g} N.m": o.ripple_limit,
    }
    ripple = [
        ("torque ripple", TORQUE_PEAK.unit, "figures.tau2", "torque_ripple", colors.TORQUE, limits),
        ("speed ripple", SPEED_PEAK.unit, "figures.w2", "speed_ripple", colors.SPEED, {}),
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
    waveforms = [
        LivePanel(
            "torque",
            {"motor.tau": ("motor", colors.TORQUE), "conveyor.tau_load": ("load", colors.THEORY)},
        ),
        LivePanel("speed", {"conveyor.w": colors.SPEED}),
        LivePanel("rod force", {"conveyor.f_rod": colors.FORCE}, "kN"),
    ]
    system = conveyor_drive(r.sweep.runner.context.fmus, start_values(r.machine, o.start, r.speed))
    p = {name.removeprefix("conveyor."): x.value for name, x in parameters(system).items()}
    sweep = LiveSweep(
        over="speed",
        values=np.linspace(r.line.first, r.line.last, SWEEP_POINTS).tolist(),
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
                waveforms,
                "crank_angle * 180 / pi",
                REVOLUTION,
            )
        ],
        motion=motion.live_motion("The conveyor in this revolution", p, 25.0, REVOLUTION),
        sweep=sweep if r.line.first < r.line.last else None,
    )


LIVE = live_part
