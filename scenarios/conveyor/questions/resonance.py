"""Does the operating speed sit on the electromechanical resonance of the drive?

Motor and conveyor are coupled at each speed of a sweep until their orbit is steady. The ripple of
order 2 of speed and torque is compared with first-order theory. The resonance is the speed at which the
torque ripple lags 90 degrees behind the load ripple; it is compared with formula (22). The operating
speed is on the resonance if the lag there is from 45 to 135 degrees, which is the half-power band. A
drive whose damping ratio is above 0.7071 amplifies the load ripple most at standstill and has no
resonance. Whether the torque ripple is above its limit is a question of its own.

With `--theory classical` the answer also says up to which speed the classical calculation, with constant
inertia and a load over time, may be trusted: once with the spring as its only load, once with the inertia of
the trough. The lowest speed at which one of its errors leaves the tolerance is located on orbits there.

An induction motor (`--start motor.characteristic=kloss`) is fed by an inverter that sets its synchronous speed anew
for each speed; with `--supply mains` it has that of its start values, and the operating speed follows from the torques.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cosim import SetupError
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Mark,
    Panel,
    Question,
    Show,
    option,
)
from workbench.charts import model as colors
from workbench.charts.model import Span
from workbench.figure import figure_of_figures, listed, scaled
from workbench.find import Found
from workbench.live import Live
from workbench.options import check_fixed_starts
from workbench.orbits import STEP_MULTIPLES
from workbench.question import Probe

from .. import classical, motion
from ..drive_orbits import require_enough_steps_per_rev
from ..first_order import SETS, Machine
from ..live_ripple import PANELS, RipplePanel, live_part
from ..machine import PARTS as DRIVE
from ..machine import (
    conveyor_drive,
    has_kloss_characteristic,
    kloss,
    kloss_slips,
    linearised,
    refusals,
    require_torque,
    speed_on_mains,
    start_values,
)
from ..options import NameplateOptions, RippleOptions, by_set, speeds_of
from ..orbit import OPERATING, Drive
from ..papers import cited
from ..speed_sweep import (
    LARGEST_PEAKED_ZETA,
    PHASE_UNDEFINED,
    SPEEDS,
    VANISHING,
    Features,
    SpeedSweep,
    locate,
    run_sweeps,
)

TABLE, MOTIONS = "resonance.csv", "resonance_motions.csv"
#: Rounds of the fixed point of formula (22): the slope of a motor changes little with the speed, so each round leaves a
#: small share of the distance.
FIXED_POINT_ROUNDS = 20
#: Lags [deg] at the two ends of the half-power band. There the real and the imaginary part of load over
#: response are equal. With little damping load and imaginary part hardly change within the band, so that the
#: power that the ripple dissipates is half of that at 90 degrees.
BAND = (45.0, 135.0)
#: Points of a curve of theory, of which a line of 1 px needs about as many as the chart is wide; a convention.
CURVE_POINTS = 400
CLASSICAL_LOADS = {"tau2": "torque", "w2": "speed"}
MARKS = {"nu_90": "90 deg lag", "nu_peak_tau": "torque peak", "nu_peak_w": "speed peak"}
INVERTER, MAINS = "inverter", "mains"
FIRST_ORDER, CLASSICAL = "first-order", "classical"


class Resonance(Question, NameplateOptions, RippleOptions):
    """The operating speed, the speeds of the sweep, and the theory to compare with."""

    parts = DRIVE
    fixed_starts = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")
    decisive = ("lag_operating", "tau2_operating")
    sources = cited(22, 26)
    at_once = 64

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
    supply: str = option(
        INVERTER,
        "supply of an induction motor: an inverter sets its synchronous speed anew for each speed and keeps the slip "
        "speed at breakdown; on the mains motor.kloss.w_s stays, and the operating speed follows from the torques",
        choices=(INVERTER, MAINS),
    )
    theory: str = option(
        FIRST_ORDER, "theory that is drawn and compared with", choices=(FIRST_ORDER, CLASSICAL)
    )
    accepted_error: float = option(
        5.0, "error that is accepted of classical theory", "%", above=0.0
    )

    @property
    def rated_torque_or_default(self) -> float:
        """The rated torque [N.m], that of the nameplate where none is given."""
        if self.rated_torque is None and self.plate:
            return self.plate.torque * self.plate.ratio
        return super().rated_torque_or_default

    @property
    def default_rating_note(self) -> str:
        """Where the limit of the torque ripple comes from, if neither a rated torque nor a nameplate is given."""
        return "" if self.nameplate else super().default_rating_note

    def probe(self, context: Context, found: Findings) -> Probe:
        """The operating speed alone, without a sweep."""
        speed = self.speed or OPERATING[self.set]
        return Probe(replace(self, speeds=(speed,), theory=FIRST_ORDER))

    @classmethod
    def solve_all(
        cls, context: Context, questions: Sequence[Resonance]
    ) -> list[Findings | SetupError]:
        """Return what many questions of this kind find, or why one is refused, in their order.

        This replaces single certified runs, because the figures come from steady orbits, which are sought at many
        speeds: of all questions together, whose features are then located, and whose operating speeds are judged.
        """
        found: dict[int, Findings | SetupError] = {}
        plans: dict[int, SweepPlan] = {}
        machines = [SETS[question.set].follow(question.start) for question in questions]
        refused = refusals(context.fmus, machines)
        for k, (question, machine, why) in enumerate(zip(questions, machines, refused)):
            try:
                plans[k] = plan_sweep(question, machine, why)
            except SetupError as error:
                found[k] = error
        if plans:
            found |= zip(plans, solve_sweeps(context, list(plans.values())))
        return [found[k] for k in range(len(questions))]

    def judgements(self, f: Mapping[str, Figure], r: ResonanceData) -> list[Judgement]:
        """Whether the operating speed is safe for torque, whether it is on the resonance, and which speeds are not."""
        left = left_out(f, r)
        has_peak = f["zeta"].value <= LARGEST_PEAKED_ZETA
        damping = Judgement("damping ratio", f["zeta"], most=LARGEST_PEAKED_ZETA)
        return [
            self.ripple_below_limit(f["tau2_operating"], r.speed),
            Judgement(
                "on resonance",
                is_wanted=False,
                also=[
                    Judgement("lag", f["lag_operating"], *BAND),
                    Judgement("torque over load ripple", f["gain_operating"], least=1.0),
                    *([] if has_peak else [damping]),
                ],
            ),
            Judgement(
                "resonance"
                if has_peak
                else "90 degree lag, which is no resonance with this damping",
                f["nu_90"],
                note=resonance_side_and_distance(f["nu_90_away"]),
            ),
            *two_motions(r),
            *([] if r.classical else [where_above(r, self.torque_ripple_limit)]),
            *(classical.judgements(r.classical) if r.classical else []),
            *([Judgement("the sweep leaves out", note=listed(left))] if left else []),
            *stalls(r),
            *self.contradictions(),
            *self.taken(self.set, *([] if self.rated_torque or self.plate else ["rated torque"])),
            *fed_with(self, f, r),
        ]

    def show(self, f: Mapping[str, Figure], r: ResonanceData) -> Show:
        """The sweep against theory, and one revolution at the operating speed."""
        chart = ripple(self, f, r)
        charts = [chart]
        if r.classical:
            nu = np.linspace(r.sweep.speeds[0], r.sweep.speeds[-1], CURVE_POINTS)
            force = classical.force_over_speed(r.classical, nu)
            charts = [
                chart._replace(panels=[*chart.panels, force]),
                classical.error_chart(r.classical, chart.marks),
            ]
        return Show(
            charts,
            *motion.revolution(r.drive, r.at(r.speed), r.speed),
        )

    def live(self, f: Mapping[str, Figure], r: ResonanceData) -> Live | str:
        """The orbit at the speed of the slider, and the ripple over the speeds of the sweep."""
        if self.supply == MAINS:
            return "on the mains the operating speed follows from the machine; ask again for another one"
        if r.sweep.branches:
            return "the drive has two steady motions, of which a page would follow one"
        return live_part(r.drive.context, r.sweep, r.machine, r.speed, levels(self))


class SweepPlan(NamedTuple):
    """A question with its machine, over which speeds it is swept, at which it operates [rad/s]."""

    question: Resonance
    machine: Machine
    speeds: Sequence[float]
    speed: float


@dataclass(frozen=True)
class ResonanceData:
    """The drive, its machine, the sweep, the operating speed [rad/s] with its row, between which speeds the torque ripple is
    above its limit, if that is known, and the classical calculation.
    """

    drive: Drive
    base: Machine
    sweep: SpeedSweep
    speed: float
    operating: SpeedSweep
    avoid: Sequence[tuple[float, float]]
    classical: classical.ClassicalComparison | None = None

    @property
    def machine(self) -> Machine:
        """The machine at the resonance that the one in the middle of the sweep has by formula (22)."""
        return self.at(self.at(self.sweep.speeds[len(self.sweep.speeds) // 2]).nu_res)

    def at(self, nu: float) -> Machine:
        """The machine at a speed [rad/s], with the slope that its motor has there."""
        return linearised(self.base, nu)


def plan_sweep(o: Resonance, base: Machine, why: str) -> SweepPlan:
    """Return how the machine of a question is swept.

    Raises SetupError for a machine that is refused, which says why, and for settings that cannot give an answer.
    """
    if why:
        raise SetupError(why)
    if o.theory == CLASSICAL:
        check_fixed_starts(o.start, ("motor.characteristic",))  # it knows a linear motor only
    by_default = classical.SWEEPS if o.theory == CLASSICAL else SPEEDS
    speeds = o.speeds or centred(o, speeds_of(by_default[o.set]), base)
    speed = operating_speed_of(o, base)
    require_torque(base, [*speeds, speed])
    every = sorted({*speeds, speed})
    for nu in every if has_kloss_characteristic(base) else every[:1]:
        require_enough_steps_per_rev(o, linearised(base, nu), nu)
    return SweepPlan(o, base, speeds, speed)


def solve_sweeps(context: Context, plans: Sequence[SweepPlan]) -> Iterator[Findings]:
    """Yield what each of many machines gives: all are swept together, and all features located."""
    drives = [Drive.of(context, plan.question) for plan in plans]
    every = [np.array(sorted({*plan.speeds, plan.speed})) for plan in plans]
    asked = [
        drive.asked(plan.machine, x, classical.ClassicalOrbit)
        for drive, plan, x in zip(drives, plans, every)
    ]
    swept = run_sweeps(context, asked)
    inside = [sweep.at(plan.speeds) for plan, sweep in zip(plans, swept)]
    located = locate(context, inside, [plan.question.torque_ripple_limit for plan in plans])
    for drive, plan, sweep, features in zip(drives, plans, swept, located):
        yield findings(drive, plan, sweep, features)


def findings(drive: Drive, plan: SweepPlan, every: SpeedSweep, features: Features) -> Findings:
    """Return what a machine gives: its orbits at every speed, and its features, each with its place and its height."""
    o, speed = plan.question, plan.speed
    sweep, operating = every.at(plan.speeds), every.at([speed])
    avoid = stretches_above(sweep, o.torque_ripple_limit, features.passed)
    r = ResonanceData(drive, plan.machine, sweep, speed, operating, avoid)
    tables = {TABLE: sweep.table}
    if sweep.branches:
        tables[MOTIONS] = sweep.several
    if o.theory == CLASSICAL:
        compared = classical.compare(drive.context, plan.machine, sweep, o.accepted_error)
        r, tables = replace(r, classical=compared), {classical.TABLE: compared.table, **tables}
    (torque, tau2), (omega, w2) = features.peaks.values()
    figures = {
        **formula_figures(r.machine),
        "nu_90": features.lag, "nu_peak_tau": torque, "tau2_peak": tau2, "nu_peak_w": omega, "w2_peak": w2,
        **operating_figures(r), "nu_90_away": figure_of_figures(
            lambda x: x - speed, features.lag, unit="rad/s", meaning="distance of the 90 deg lag from the operating speed"
        ),
        "f_rod_peak": sweep.force_figure(), **ends_of_stretches(features.passed),
        **(r.classical.figures if r.classical else {}),
    }  # fmt: skip
    mains = kloss(plan.machine) if o.supply == MAINS else {}
    start = start_values(r.at(speed), speed) | mains
    lost = every.columns["nu"][np.isnan(every.columns["tau2"])]
    return Findings(
        figures,
        r,
        conveyor_drive(drive.context.fmus, start),
        tables=tables,
        facts={
            "operating_speed": speed,
            "rated_torque": o.rated_torque_or_default,
            "orbits": {"sweep": len(STEP_MULTIPLES) * len(every.speeds)},
        },
        warnings=[
            f"No steady orbit at {nu:g} rad/s: {x}"
            for nu, x in zip(every.speeds, every.motions.problems)
            if x and nu in lost
        ],  # where one of two motions is lost the other one is told
        defaults={"speed": speed, "rated_torque": o.rated_torque_or_default, "speeds": plan.speeds},
    )


def operating_speed_of(o: Resonance, base: Machine) -> float:
    """Return the operating speed [rad/s]: as given, or on the mains that at which the torques balance."""
    if o.supply != MAINS:
        return o.speed or OPERATING[o.set]
    speed = speed_on_mains(base)
    if o.speed is not None:
        raise SetupError(
            f"speed = {o.speed:g} rad/s cannot be chosen with supply = 'mains': the drive runs at {speed:.4g} rad/s "
            "there. Leave the speed out, or take supply = 'inverter'"
        )
    return speed


def centred(o: Resonance, speeds: Sequence[float], base: Machine) -> Sequence[float]:
    """Return the speeds of the set, moved as the resonance of the machine by formula (22) is from that of the set."""
    of_set = float(SETS[o.set].nu_res)
    nu = of_set
    for _ in range(FIXED_POINT_ROUNDS):  # the slope of an induction motor is that at the speed
        nu = float(linearised(base, nu).nu_res)
    share = nu / of_set
    if math.isnan(share) or math.isclose(share, 1.0, rel_tol=1e-9):
        return speeds  # the load may pull the motor out there: the sweep says so
    return [share * x for x in speeds]


def formula_figures(machine: Machine) -> dict[str, Figure]:
    """Return the figures of formulas."""
    name = "resonance" if machine.zeta <= LARGEST_PEAKED_ZETA else "90 deg lag"
    return {
        "nu_res": Figure(machine.nu_res, "rad/s", 0.0, f"{name} by formula (22)"),
        "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
    }


def operating_figures(r: ResonanceData) -> dict[str, Figure]:
    """Return torque ripple, lag and mean speed at the operating speed, and the ripple over that of the load.

    The larger load counts, there or of a slow turn: where spring and inertia of the trough nearly cancel, a ripple
    may be many times that of the load and yet small.
    """
    at, machine, nu = r.operating, r.at(r.speed), r.speed
    meaning = "lag of the torque ripple behind its load at the operating speed"
    lag = at.figure("lag", 0, meaning)
    parts = machine.r**2 / 2 * (machine.c + machine.m * nu**2 + machine.d * nu)
    if not math.isnan(lag.value) and abs(machine.load_ripple(nu)) < VANISHING * parts:
        lag = Figure.undetermined("deg", PHASE_UNDEFINED.format(f"at {r.speed:g} rad/s"), meaning)
    ripple = at.figure("tau2", 0, "torque ripple at the operating speed")
    mean = at.figure("speed", 0, "mean speed of the orbit at the operating speed")
    load = max(abs(machine.load_ripple(nu)), abs(machine.load_ripple(0.0)))
    meaning = "torque ripple over load ripple at the operating speed"
    gain = (
        scaled(ripple, 1.0 / load, "1", meaning)
        if load
        else Figure.undetermined("1", "the load has no ripple", meaning)
    )
    return {
        "tau2_operating": ripple,
        "gain_operating": gain,
        "lag_operating": lag,
        "w_operating": mean,
    }


def stretches_above(
    sweep: SpeedSweep, limit: float, passed: Sequence[Found]
) -> list[tuple[float, float]]:
    """Return between which speeds [rad/s] the torque ripple is above its limit; none where an end is not known."""
    ripple, error = (sweep.columns[x] for x in ("tau2", "tau2_error"))
    if any(x.place.error is None for x in passed):
        return []
    ends = [x.place.value for x in passed]
    if not passed[0].rises if passed else (ripple - error > limit).all():
        ends.insert(0, sweep.speeds[0])
    return list(zip(ends[::2], [*ends[1::2], sweep.speeds[-1]]))


def ends_of_stretches(passed: Sequence[Found]) -> dict[str, Figure]:
    """Return where the torque ripple passes its limit, by number from the second stretch on."""
    figures = {}
    for k, x in enumerate(passed, 1 if passed and not passed[0].rises else 0):
        number = f"_{k // 2 + 1}" if k > 1 else ""
        figures[f"avoid_{'from' if x.rises else 'to'}{number}"] = x.place
    return figures


def where_above(r: ResonanceData, limit: float) -> Judgement:
    """Return between which speeds the torque ripple is above its limit."""
    known = r.sweep.columns["tau2"] + r.sweep.columns["tau2_error"]
    nowhere = "at no speed of the sweep" if (known <= limit).all() else "not determined"
    texts = [f"from {a:.4g} to {b:.4g} rad/s" for a, b in r.avoid]
    return Judgement("torque ripple above its limit", note=listed(texts) or nowhere)


def resonance_side_and_distance(gap: Figure) -> str:
    """Return on which side of the operating speed the resonance is, and how far."""
    if gap.error is None:
        return ""
    if abs(gap.value) <= gap.error:
        return "that is the operating speed, within its error"
    return f"{gap._replace(value=abs(gap.value)).brief()} {'above' if gap.value > 0.0 else 'below'} the operating speed"


def stalls(r: ResonanceData) -> list[Judgement]:
    """Return at which speeds the motor stalls, since nothing else is to be known there."""
    stalled, where = r.sweep.stalled, []
    if stalled:
        where.append(r.sweep.named(stalled))
    if r.operating.stalled and r.speed not in stalled:
        where.append(f"the operating speed of {r.speed:g} rad/s")
    note = f"{' and at '.join(where)}: started near its steady motion, the crank does not complete a turn"
    return [Judgement("the motor stalls at", note=note)] if where else []


def two_motions(r: ResonanceData) -> list[Judgement]:
    """Return between which speeds the drive has two steady motions, and the other ones at the operating speed.

    What it does there depends on how it came there. All that is judged is that with the larger torque ripple.
    """
    if not r.sweep.branches:
        return []
    folds = [fold for part in r.sweep.branches for fold in part.ends if not math.isnan(fold[0])]
    notes = [f"a branch ends between {a:.4g} and {b:.4g} rad/s" for a, b in sorted(set(folds))]
    several = r.operating.several.frame
    notes += [
        f"at {x.nu:.4g} rad/s it runs with {x.tau2:.4g} N.m and a lag of {x.lag:.3g} deg"
        for x in several.itertuples()
    ]
    what = "the drive has two steady motions, of which that with the larger torque ripple is judged"
    return [Judgement(what, note="; ".join(notes))]


def fed_with(o: Resonance, f: Mapping[str, Figure], r: ResonanceData) -> list[Judgement]:
    """Return how an induction motor is fed, since no motor has the synchronous speed of another supply."""
    if not has_kloss_characteristic(r.machine):
        return []
    machine = r.at(r.speed)
    slips, given = kloss_slips(machine, r.speed), kloss(machine)["motor.kloss.w_s"]
    slip_text = f"its slip speed at breakdown stays {slips.at_breakdown:.4g} rad/s"
    if o.supply == MAINS:
        note = f"other speeds of the sweep are those of another frequency of the mains; {slip_text}"
        what = f"speed on the mains, whose synchronous speed is {given:.4g} rad/s"
        return [Judgement(what, f["w_operating"], note=note)]
    told = "given" if "motor.kloss.w_s" in o.start else "of the FMU"
    note = (
        f"in place of the {given:.4g} rad/s {told}, as an inverter sets it for each speed; {slip_text}; "
        f"--supply mains keeps {given:.4g} rad/s, and the operating speed follows from it"
    )
    synchronous = Figure(r.speed + float(slips.under_load), "rad/s", 0.0)
    return [Judgement("synchronous speed at the operating speed", synchronous, note=note)]


def left_out(f: Mapping[str, Figure], r: ResonanceData) -> list[str]:
    """What the reader asks for and the sweep does not have: the operating speed, the resonance."""
    first, last = r.sweep.speeds[0], r.sweep.speeds[-1]
    left = []
    if not first <= r.speed <= last:
        left.append(f"the operating speed of {r.speed:g} rad/s")
    formula, has_peak = f["nu_res"].value, f["zeta"].value <= LARGEST_PEAKED_ZETA
    if has_peak and f["nu_90"].error is None and not first <= formula <= last:
        left.append(f"the resonance, at {formula:.4g} rad/s by formula (22)")
    return left


def ripple(o: Resonance, f: Mapping[str, Figure], r: ResonanceData) -> Chart:
    """Ripple of torque and speed and the lag over the speed, theory as lines."""
    nu = np.linspace(r.sweep.speeds[0], r.sweep.speeds[-1], CURVE_POINTS)
    machine = r.at(f["nu_res"].value)
    torque = machine.torque_ripple(nu)
    theory = {
        "tau2": abs(torque),
        "w2": abs(machine.speed_ripple(nu)),
        "lag": np.angle(machine.load_ripple(nu) / torque, deg=True) % 360.0,
    }
    across = levels(o)

    def panel(x: RipplePanel) -> Panel:
        at, y, errors = (r.sweep.columns[name] for name in ("nu", x.column, f"{x.column}_error"))
        unsure = np.isfinite(y) & ~np.isfinite(errors)
        points = [
            Curve(
                name, at[rows], y[rows], color, "points", None if rows is unsure else errors[rows]
            )
            for name, rows, color in (
                ("co-simulation", ~unsure, x.color),
                ("co-simulation, error not known", unsure, colors.THEORY),
            )
            if rows.any()
        ]
        line = Curve("first-order theory", nu, theory[x.column], colors.THEORY, "theory")
        load = CLASSICAL_LOADS.get(x.column, "")
        more = classical.curves(machine, load, nu) if r.classical and load else []
        marks = [Mark(float(level), text) for text, level in across.get(x.column, {}).items()]
        return Panel(x.quantity, x.unit, [line, *more, *points], marks, includes=x.includes)

    located = {MARKS[name]: x for name, x in f.items() if name in MARKS and math.isfinite(x.value)}
    return Chart(
        "Ripple and lag over the speed",
        "operating speed [rad/s]",
        [*map(panel, PANELS)],
        [Mark(machine.nu_res, f"formula {machine.nu_res:.2f} rad/s"),
         *(Mark.of(text, figure) for text, figure in located.items()),
         Mark(r.speed, f"operating speed {r.speed:g} rad/s")],
        [Span(*band, "avoid", "red") for band in r.avoid],
        classical.RPM,
    )  # fmt: skip


def levels(o: Resonance) -> dict[str, dict[str, float]]:
    """Return what is drawn across the panels of ripple and lag, by column and text."""
    rated, limit = o.rated_torque_or_default, o.torque_ripple_limit
    ends = {f"{x:g} deg, half power": x for x in BAND}
    return {
        "tau2": {f"rated torque {rated:g} N.m": rated, f"limit {limit:g} N.m": limit},
        "lag": {"90 deg": 90.0, **ends},
    }
