"""Where is the electromechanical resonance of a measured drive, and what would get the drive clear of it?

The parameters of the drive, its supply and its state at the start are fitted to a record of its speed,
and of its torque if that was measured. The resonance follows with an interval, and so does the torque
ripple at the operating speed. A record that no drive of this kind fits is refused.

This question has a `solve` of its own because the answer comes from a fit to a record and from many
machines that fit it, not from one run that is certified.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import cosim
from cosim import Advice, Identified, SetupError
from cosim.system import Value
from cosim.units import multiples
from workbench import Chart, Context, Curve, Figure, Findings, Mark, Panel, Show, fitting, option
from workbench.charts import model as colors
from workbench.charts.model import SecondUnit, Span
from workbench.fitting import RecordOptions, figure_of
from workbench.measure import harmonics
from workbench.roots import roots_between

from ..first_order import FIELDS, SETS, Machine
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive, followed, induction, linearised
from ..motion import moving
from ..options import RippleOptions
from ..orbits import STEP_MULTIPLES, Orbit, OrbitRunner, simulate
from ..rows import speed_row

PARTS = DRIVE
FIXED_STARTS = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")
SPEED, TORQUE = "conveyor.w", "motor.tau"
STATES = ("conveyor.phi", SPEED, TORQUE)
LINEAR, KLOSS = ("motor.A", "motor.B"), ("motor.kloss.w_s", "motor.kloss.s_b")
FREE = ("motor.T", "conveyor.rotor.J", "conveyor.trough.d")
FROM_DRAWINGS = ("conveyor.crank.r", "conveyor.trough.m", "conveyor.spring.c")
CHANGE = "change of {} from its fitted value at which that torque ripple is at its limit"
CHANGED = {"conveyor.rotor.J": "rotor_j", "motor.T": "motor_t"}
#: Communication steps per revolution of the orbits of the fitted drive; a convention.
STEPS = 512
#: Speeds between which the limit of the ripple is sought, over the resonance; a convention.
SWEEP = (0.2, 2.5)
#: Factors of a parameter between which the limit of the ripple is sought; a convention.
FACTORS = (0.2, 5.0)
#: Points at which a sign is taken before Brent's method; two crossings within one step of 0.4 % are not told apart.
GRID = 600
#: Points of the curve with the band; a convention.
CURVE = 121
#: Noise of a torque that a further record would have, over the rated torque; a convention.
NOISE = 0.02
#: Relative step of a central difference. Its error, of the order of its square, is far below that of a fit.
SLIGHT = 1e-3


@dataclass(frozen=True, kw_only=True)
class Options(RecordOptions, RippleOptions):
    speed: float | None = option(
        None, "operating speed, the mean of the record by default", "rad/s", above=0.0
    )


class IdentifiedDrive(NamedTuple):
    """A fit, the machine it found, the operating speed [rad/s], stretches of speed to avoid with the
    figures of their ends, and what each further record would leave of the interval.
    """

    fit: Identified
    machine: Callable[[Mapping[str, float]], Machine]
    operating: float
    edges: Sequence[tuple[Figure, Figure]]
    advice: Sequence[Advice]


def solve(o: Options, context: Context) -> Findings:
    """Fit, and ask the machine that fits."""
    record = o.columns(SPEED)
    base = followed(context.fmus, SETS[o.set], o.start)
    w = np.array(record[SPEED].values) * multiples("rad/s").get(record[SPEED].unit, 1.0)
    nu = float(np.nanmean(w))
    operating = o.speed or nu
    supply, slope = KLOSS if induction(o.start) else LINEAR
    if not o.known and TORQUE not in record:
        raise SetupError(
            f"{o.data}: speed alone determines neither mass nor torque; give what is known, as in "
            "--known conveyor.trough.m=200+-5, or map a torque to motor.tau"
        )
    fit = o.identify(
        conveyor_drive(context.fmus, guess(o, base, record[SPEED])),
        record,
        [slope, *FREE, supply, *STATES],
        derived={"nu_res": lambda v, _: fitted_machine(o, base, nu, v).nu_res},
        units={"nu_res": "rad/s"},
        first=("conveyor.phi", supply),
        algorithm=o.algorithm,
    )
    machine = partial(fitted_machine, o, base, nu)
    drive_data = IdentifiedDrive(fit, machine, operating, edges(o, fit, machine), advice(o, fit))
    return Findings(
        figures(o, context, drive_data),
        drive_data,
        fit.problem.system,
        fit.result.provenance,
        tables=fitting.tables(fit, drive_data.advice, "identify", "rad/s"),
        facts=facts(o, drive_data),
        defaults={"speed": drive_data.operating, "rated_torque": o.rated},
    )


def guess(o: Options, base: Machine, speed: cosim.Table) -> dict[str, Value]:
    """Start values near the motion of a record: the angle at its start by the order 2 of its speed,
    the supply by its mean speed.
    """
    w, turned = o.turned(speed, "crank")
    nu = float(w.mean())
    machine = linearised(base, o.start, nu)
    swing = complex(harmonics(turned, w, 2)[1]) / machine.speed_ripple(nu)
    phi = float(np.angle(swing)) / 2
    tau = machine.load_slope * nu + (machine.torque_ripple(nu) * np.exp(2j * phi)).imag
    states = {"conveyor.phi": phi, "conveyor.w": float(np.median(w[:5])), "motor.tau": float(tau)}
    start: dict[str, Value] = {**base.start(nu), **o.start, **states}
    if induction(o.start):
        start["motor.kloss.w_s"] = 1.02 * nu
    return start


def fitted_machine(o: Options, base: Machine, nu: float, values: Mapping[str, float]) -> Machine:
    """The machine of these values; its motor's slope is that at the mean speed nu [rad/s]."""
    motor = {name: x for name, x in values.items() if name.startswith("motor.")}
    return linearised(base.follow(values), {**o.start, **motor}, nu)


def figures(o: Options, context: Context, drive_data: IdentifiedDrive) -> dict[str, Figure]:
    """The resonance, how far the operating speed is from it, the torque ripple there, the stretch of
    speed to avoid, what would change it, and all values that were free.
    """
    fit, machine, nu = drive_data.fit, drive_data.machine, drive_data.operating
    units = {
        "nu_res": "rad/s",
        "away": "%",
        "tau2": "N.m",
        "avoid_from": "rad/s",
        "avoid_to": "rad/s",
    }
    meanings = {
        "nu_res": "resonance by formula (22) of the fitted machine",
        "away": "operating speed above the resonance",
        "tau2": "torque ripple at the operating speed",
        "avoid_from": "speed above which the torque ripple exceeds its limit",
        "avoid_to": "speed below which the torque ripple exceeds its limit",
    }
    for name, key in CHANGED.items():
        meanings[f"clear_{key}"] = f"{name} at which that torque ripple is at its limit"
        meanings[f"change_{key}"] = CHANGE.format(name)
        units[f"clear_{key}"] = fit.problem.parameters[fit.names.index(name)].unit
        units[f"change_{key}"] = "%"
    if fit.misfit:
        why = "no machine of this kind fits the record"
        return {name: Figure.undetermined(units[name], why, meanings[name]) for name in units}
    all_figures = {"nu_res": figure_of(fit.derived["nu_res"], meanings["nu_res"])}
    gap = fit.interval(lambda v: 100.0 * (nu / machine(v).nu_res - 1.0), "%")
    all_figures["away"] = figure_of(gap, meanings["away"])
    all_figures["tau2"] = ripple(o, context, drive_data, meanings["tau2"])
    best = machine(fit.start_values)

    def changed(name: str, x: float) -> tuple[Machine, float]:
        many: dict[str, Any] = {FIELDS[name]: x}
        return replace(best, **many), nu

    near = min(drive_data.edges, key=partial(distance, nu), default=None)
    for name, k in (("avoid_from", 0), ("avoid_to", 1)):
        nowhere = Figure.undetermined("rad/s", "the torque ripple is below its limit everywhere")
        edge = (near[k] if near else nowhere)._replace(meaning=meanings[name])
        all_figures[name] = simulated(o, context, drive_data, edge, lambda x: (best, x))
    for name, key in CHANGED.items():
        clear = cleared(o, drive_data, name, units[f"clear_{key}"])
        all_figures[f"clear_{key}"] = simulated(
            o,
            context,
            drive_data,
            clear._replace(meaning=meanings[f"clear_{key}"]),
            partial(changed, name),
        )
        all_figures[f"change_{key}"] = change(
            o, drive_data, name, all_figures[f"clear_{key}"], clear
        )
    return all_figures | fitting.fitted_figures(fit)


def distance(nu: float, stretch: tuple[Figure, Figure]) -> float:
    """How far a speed is from a stretch of speeds, whose ends may not be told [rad/s]."""
    low, high = (end.value for end in stretch)
    return low - nu if nu < low else nu - high if nu > high else 0.0


def orbits(
    o: Options,
    context: Context,
    drive_data: IdentifiedDrive,
    machine: Machine,
    nu: float,
    step_multiples: Sequence[int],
) -> list[Orbit]:
    """Steady orbits of a machine like the one found at a mean speed nu [rad/s]."""
    values = drive_data.fit.start_values
    mine = {name: x for name, x in values.items() if name not in FIXED_STARTS and "(" not in name}
    mine |= {name: getattr(machine, field) for name, field in FIELDS.items() if name in mine}
    runner = OrbitRunner(context, {**o.start, **mine}, o.algorithm, STEPS)
    return [simulate(runner.task(machine, nu, k)) for k in step_multiples]


def ripple(o: Options, context: Context, drive_data: IdentifiedDrive, meaning: str) -> Figure:
    """The torque ripple of the machine found on its steady orbit at the operating speed."""
    fit, nu = drive_data.fit, drive_data.operating
    machine = drive_data.machine(fit.start_values)
    points = orbits(o, context, drive_data, machine, nu, STEP_MULTIPLES)
    if points[0].problem:
        return Figure.undetermined("N.m", points[0].problem, meaning)
    row = speed_row(machine, points, cosim.CONVERGENCE_ORDERS[o.algorithm])
    value, error = row["tau2"], row["tau2_error"]
    if math.isnan(error):
        return Figure.undetermined("N.m", "the coupling error is not known", meaning)
    wide = fit.interval(lambda v: float(abs(drive_data.machine(v).torque_ripple(nu)))).error
    return Figure(value, "N.m", error + wide, meaning)


def simulated(
    o: Options,
    context: Context,
    drive_data: IdentifiedDrive,
    figure: Figure,
    at: Callable[[float], tuple[Machine, float]],
) -> Figure:
    """A place where first-order theory has the torque ripple at its limit, and its error with what
    theory leaves out: the machine and speed `at` that place are run, and so far away is the limit.
    """
    if figure.error is None:
        return figure
    x = figure.value

    def theory(x: float) -> float:
        machine, nu = at(x)
        return float(np.log(np.abs(machine.torque_ripple(nu))))

    (point,) = orbits(o, context, drive_data, *at(x), STEP_MULTIPLES[-1:])
    if point.problem:
        return Figure.undetermined(figure.unit, point.problem, figure.meaning)
    slope = (theory(x * (1 + SLIGHT)) - theory(x * (1 - SLIGHT))) / (2 * SLIGHT * x)
    shift = abs((math.log(abs(point.torque)) - math.log(o.ripple_limit)) / slope)
    return figure._replace(error=figure.error + shift)


def edges(
    o: Options, fit: Identified, machine: Callable[[Mapping[str, float]], Machine]
) -> list[tuple[Figure, Figure]]:
    """The stretches of speed in which first-order theory has the torque ripple above its limit."""
    if fit.misfit:
        return []
    values = fit.start_values
    nus = machine(values).nu_res * np.geomspace(*SWEEP, GRID)

    def passed(v: Mapping[str, float]) -> list[float]:
        drive = machine(v)
        return roots_between(
            lambda nu: np.log(np.abs(drive.torque_ripple(nu)) / o.ripple_limit), nus
        )

    def edge(near: float, v: Mapping[str, float]) -> float:
        return float(min(passed(v), key=lambda x: abs(x - near), default=math.nan))

    ends = [figure_of(fit.interval(partial(edge, x), "rad/s"), "") for x in passed(values)]
    if abs(machine(values).torque_ripple(nus[0])) > o.ripple_limit:
        ends.insert(
            0,
            Figure.undetermined(
                "rad/s", "the torque ripple is above its limit at every lower speed"
            ),
        )
    if len(ends) % 2:
        ends.append(
            Figure.undetermined(
                "rad/s", "the torque ripple is above its limit at every higher speed"
            )
        )
    return list(zip(ends[::2], ends[1::2]))


def cleared(o: Options, drive_data: IdentifiedDrive, name: str, unit: str) -> Figure:
    """What a parameter would have to be for the torque ripple at the operating speed to be at its
    limit.
    """
    fit, nu = drive_data.fit, drive_data.operating
    values = fit.start_values
    if abs(drive_data.machine(values).torque_ripple(nu)) <= o.ripple_limit:
        return Figure.undetermined(unit, "the operating speed is already clear")
    if math.isnan(clearing(o, drive_data, name, values)):
        return Figure.undetermined(unit, f"no {name} from a fifth to five times its value does it")
    return figure_of(fit.interval(lambda v: v[name] * clearing(o, drive_data, name, v), unit), "")


def change(
    o: Options, drive_data: IdentifiedDrive, name: str, clear: Figure, by_theory: Figure
) -> Figure:
    """The same as a change from the fitted value [%], whose error is smaller than that of the value:
    what is not known of the drive moves both. What theory leaves out is that of the value.
    """
    meaning = CHANGE.format(name)
    if clear.error is None or by_theory.error is None:
        return Figure.undetermined("%", clear.reason, meaning)
    value = drive_data.fit.start_values[name]
    ratio = drive_data.fit.interval(lambda v: 100.0 * (clearing(o, drive_data, name, v) - 1.0), "%")
    figure = figure_of(ratio, meaning)
    if figure.error is None:
        return figure
    return figure._replace(error=figure.error + 100.0 * (clear.error - by_theory.error) / value)


def clearing(
    o: Options, drive_data: IdentifiedDrive, name: str, values: Mapping[str, float]
) -> float:
    """The nearest factor of a parameter's value with which the torque ripple at the operating speed is
    at its limit by first-order theory; nan if there is none.
    """
    nu, drive, field = drive_data.operating, drive_data.machine(values), FIELDS[name]

    def over_limit(factor: Any) -> Any:
        changed: dict[str, Any] = {field: values[name] * factor}
        return np.log(np.abs(replace(drive, **changed).torque_ripple(nu)) / o.ripple_limit)

    factors = roots_between(over_limit, np.geomspace(*FACTORS, GRID))
    return min(factors, key=lambda x: abs(math.log(x)), default=math.nan)


def advice(o: Options, fit: Identified) -> list[Advice]:
    """What further records would leave of the interval of the resonance, the best first."""
    if fit.misfit:
        return []
    values = fit.start_values
    base = SETS[o.set].follow(o.start)
    times = fit.problem.columns[0].times
    stop, last = float(times[-1] - times[0]), {name: float(fit.result[name][-1]) for name in STATES}
    noise = {column.name: column.noise.sigma for column in fit.problem.columns}
    torque = {TORQUE: NOISE * o.rated}
    supply = KLOSS[0] if induction(o.start) else LINEAR[0]
    rest = {"conveyor.phi": 0.0, SPEED: 0.0, TORQUE: 0.0}
    kinds: dict[str, Mapping[str, Value]] = {
        "the same again": last,
        "a run-up from rest": rest,
        "a step of the supply to 120 %": {**last, supply: 1.2 * values[supply]},
    }
    if not induction(o.start):
        kinds["a run-down with the supply off"] = {**last, supply: 0.0}
    nu = float(np.mean(fit.result[SPEED]))
    experiments = fitting.planned_experiments(kinds, supply, stop, noise, torque)
    return cosim.advise(fit, experiments, lambda v: fitted_machine(o, base, nu, v).nu_res)


def facts(o: Options, drive_data: IdentifiedDrive) -> dict[str, Any]:
    """What else stands in the JSON."""
    settings = {
        "operating_speed": drive_data.operating,
        "rated_torque": o.rated,
        "limit": o.ripple_limit,
    }
    return settings | fitting.facts(drive_data.fit, drive_data.advice, FROM_DRAWINGS)


def verdict(o: Options, f: Mapping[str, Figure], r: IdentifiedDrive) -> str:
    """The answer in plain words."""
    if r.fit.misfit:
        return "\n".join(["No drive of this kind fits this record:", *r.fit.misfit])
    gap, nu = f["away"], r.operating
    over = f["tau2"].value > o.ripple_limit
    lines = [
        f"The resonance is at {f['nu_res'].text()}, and the operating speed of {nu:.4g} rad/s "
        f"lies {gap._replace(value=abs(gap.value)).text()} "
        f"{'above' if gap.value > 0 else 'below'} it.",
        f"The torque ripple there is {f['tau2'].text()}; the limit is {o.ripple_limit:g} N.m.",
    ]
    ends = [f[name] for name in ("avoid_from", "avoid_to")]
    if over:
        near = sorted((e for e in ends if e.error is not None), key=lambda e: abs(e.value - nu))
        changes = [f"a speed of {end.text()}" for end in near[:1]]
        for name, key in CHANGED.items():
            if f[f"clear_{key}"].error is not None:
                changes.append(moving_clear(name, f[f"change_{key}"], f[f"clear_{key}"]))
        lines.append(
            f"The ripple is at its limit with {' or '.join(changes)}. These are limits, not targets."
            if changes
            else "No change gets it clear."
        )
    elif ends[0].error is not None and ends[1].error is not None:
        lines.append(f"Avoid speeds from {ends[0].text()} to {ends[1].text()}.")
    lines.extend(
        f"The record cannot tell {' and '.join(group)} apart." for group in r.fit.correlated_groups
    )
    now = f["nu_res"].error or math.inf
    lines.append(fitting.next_record(r.advice, now, "the resonance", "rad/s"))
    return "\n".join(lines)


def moving_clear(name: str, change: Figure, clear: Figure) -> str:
    """A change of a parameter and the value it leads to, in words."""
    if change.error is None:
        return f"{name} = {clear.text()}"
    if abs(change.value) <= change.error:
        return f"{name} within {change.text()} of its value, {clear.text()}"
    turned = "raised" if change.value > 0.0 else "lowered"
    return (
        f"{name} {turned} by {change._replace(value=abs(change.value)).text()}, to {clear.text()}"
    )


def show(o: Options, f: Mapping[str, Figure], r: IdentifiedDrive) -> Show:
    """Each column measured, fitted and what is between them; the resonance curve with its band; the
    conveyor in motion.
    """
    styles = {SPEED: ("speed", colors.SPEED), TORQUE: ("torque", colors.TORQUE)}
    charts = fitting.charts(r.fit, styles)
    if not r.fit.misfit:
        charts.insert(0, band(o, f, r))
    first, last = (float(t) for t in r.fit.result["time"][[0, -1]])
    return Show(charts, [moving("The fitted conveyor", {"": r.fit.result}, first, last, 25.0)])


def band(o: Options, f: Mapping[str, Figure], r: IdentifiedDrive) -> Chart:
    """The torque ripple over the speed of the machine found, with the band of its interval."""
    nus = np.linspace(0.4, 1.8, CURVE) * f["nu_res"].value

    def height(nu: float, v: Mapping[str, float]) -> float:
        return float(abs(r.machine(v).torque_ripple(nu)))

    each = [r.fit.interval(partial(height, nu), "N.m") for nu in nus.tolist()]
    curve = Curve(
        "first-order theory of the fitted machine", nus, [x.value for x in each], colors.TORQUE,
        "line", [x.error for x in each],
    )  # fmt: skip
    limit = Mark(o.ripple_limit, f"limit {o.ripple_limit:g} N.m")
    marks = [
        Mark.of("resonance", f["nu_res"]),
        Mark(r.operating, f"operating speed {r.operating:.4g} rad/s"),
    ]
    spans = [Span(a.value, b.value, "avoid", "red") for a, b in r.edges if a.error and b.error]
    return Chart(
        "Torque ripple of the fitted machine, with its 95 % band",
        "operating speed [rad/s]",
        [Panel("torque ripple", "N.m", [curve], [limit], (0.0,))],
        marks,
        spans,
        SecondUnit("rpm", 30 / math.pi),
    )
