"""Which motors, flywheels and springs keep the operating range clear of resonance, and how surely?

Motor and conveyor are coupled at every point of a plane of two parameters until their orbit is
steady. The map shows by how much the drive magnifies the load's ripple of order 2, the ridge where
the torque ripple lags it by 90 degrees beside formula (22), the ridge where the torque ripple is
largest, and how likely it is above a limit when every part may be off within its tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import workbench
from cosim import SetupError
from workbench import Bench, Figure, Findings, Show, Table, option
from workbench.options import refuse

from .drive import PARTS as DRIVE
from .drive import conveyor_drive, followed
from .map import pages, tolerances, zone
from .map.pages import LOOKS
from .map.plane import Plane, Setup, axis, shares, span
from .map.survey import Coupling, Row, Survey, columns, coupling, locate, sweep
from .map.tolerances import CONFIDENCE, Check
from .resonance import ALGORITHMS, check_steps
from .theory import FIELDS, SETS

Real = NDArray[np.float64]
PARTS = DRIVE
FLAVOUR = "native"
X, Y = "speed=15:80:60", "motor.T=0.015:0.16:40:log"
RANGE, FIXED = "45:60", 60.0
RATED = {"A": 100.0, "B": 88.0}
TOLERANCES = {
    "motor.T": 0.10,
    "motor.B": 0.05,
    "conveyor.rotor.J": 0.03,
    "conveyor.spring.c": 0.05,
    "conveyor.trough.m": 0.02,
    "conveyor.trough.d": 0.20,
}
SURE = 0.01
NO_ORDER = "runs with coarser steps converge in no order, so that its error is not known"
OFF = {
    ("lag_90", "formula"): "formula (22)",
    ("peak", "formula"): "formula (22)",
    ("peak", "peak_theory"): "that of first-order theory",
}
TABLE, ROWS_TABLE = "resonance_map.csv", "resonance_map_rows.csv"
OWN = ("motor.A", "motor.tau", "motor.characteristic", "conveyor.phi", "conveyor.w")


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    set: str = option("A", "parameter set", choices=SETS)
    x: str = option(X, f"NAME=FROM:TO:NUMBER[:log] of `speed` [rad/s], {', '.join(FIELDS)}")
    y: str = option(Y, "the same without `speed`")
    speed: float | None = option(
        None, f"operating speed where x is not the speed, {FIXED:g} by default", "rad/s", above=0.0
    )
    range: str | None = option(
        None, f"FROM:TO, operating range where x is the speed, {RANGE} [rad/s] by default"
    )
    limit: float = option(
        50.0, "torque ripple that is too much, of the rated torque", "%", above=0.0
    )
    rated_torque: float | None = option(
        None,
        "rated motor torque at the crank, by default "
        + ", ".join(f"{torque:g} in set {name}" for name, torque in RATED.items()),
        "N.m",
        above=0.0,
    )
    tolerance: tuple[str, ...] = option(
        (),
        "NAME=PERCENT, within which a part's parameter lies evenly, above "
        + ", ".join(f"{name}={100 * share:g}" for name, share in TOLERANCES.items())
        + " (repeatable)",
    )
    samples: int = option(4096, "machines per point, a power of 2", least=2)
    checks: int = option(8, "points to check by co-simulation, half as many rows", least=0)
    check_runs: int = option(128, "machines to co-simulate at each", least=1)
    algorithm: str = option("strang", "coupling algorithm", choices=ALGORITHMS)
    steps_per_rev: int = option(256, "communication steps per revolution", least=1)


class Map(NamedTuple):
    """The survey, its ridges, their errors, the risk; limit and rated torque [N.m], the range [rad/s]."""

    survey: Survey
    rows: Sequence[Row]
    errors: Coupling
    risk: Risk
    limit: float
    rated: float
    within: tuple[float, float] | None
    setup: Setup


class Risk(NamedTuple):
    """Probability of a torque ripple above the limit at every point; in the range for every row,
    with the largest ripple there of the nominal machine [N.m]. What co-simulation said of samples.
    """

    points: Real
    rows: Real
    nominal: Real
    checks: Sequence[Check]
    range_checks: Sequence[Check]
    samples: int


class Off(NamedTuple):
    """How far places are from others, relative: the largest, the row it is in, the root mean square,
    and in how many rows there are both.
    """

    largest: float
    at: float
    rms: float
    rows: int

    def text(self, form: str, unit: str) -> str:
        """As the verdict has it."""
        return (
            f"{self.rms:{form}} (rms) over {self.rows} rows, at most {self.largest:+{form}} "
            f"at {self.at:.3g} {unit}"
        )


def off(rows: Iterable[Row], place: str, other: str) -> Off:
    """Of one ridge from another."""
    pairs = [(row.y, getattr(row, place), getattr(row, other)) for row in rows]
    shares = [(a / b - 1.0, y) for y, a, b in pairs if a is not None and b is not None]
    if not shares:
        return Off(math.nan, math.nan, math.nan, 0)
    largest, at = max(shares, key=lambda share: abs(share[0]))
    rms = math.sqrt(sum(share**2 for share, _ in shares) / len(shares))
    return Off(largest, at, rms, len(shares))


def assess(
    survey: Survey,
    limit: float,
    within: tuple[float, float] | None,
    tolerance: dict[str, float],
    exponent: int,
    checks: int,
    runs: int,
    setup: Setup,
) -> Risk:
    """Probabilities by corrected theory over the map, and what co-simulation says at its edge."""
    plane, ratio = survey.plane, survey.ratio
    factors = tolerances.factors(tolerance, exponent)
    nominal = {name: np.ones(1) for name in factors}
    height, width = plane.shape
    points = np.array(
        [
            [
                zone.probability(zone.at_point(plane, ratio, factors, n, k), limit)
                for k in range(width)
            ]
            for n in range(height)
        ]
    )
    some = [zone.at_point(plane, ratio, factors, n, k) for n, k in zone.on_edge(points, checks)]
    rows = worst = np.full(height, math.nan)
    few = []
    if within is not None:
        over = [zone.in_range(plane, ratio, factors, n, within) for n in range(height)]
        rows = np.array([zone.probability(sample, limit) for sample in over])
        plain = [zone.in_range(plane, ratio, nominal, n, within) for n in range(height)]
        worst = np.array([sample.expected[0] for sample in plain])
        few = [over[n] for (n,) in zone.on_edge(rows, checks // 2)]
    return Risk(
        points,
        rows,
        worst,
        zone.check(some, runs, limit, setup),
        zone.check(few, runs, limit, setup),
        2**exponent,
    )


def stretches(values: Real, good: NDArray[np.bool_], unit: str) -> str:
    """The values that are good, as from .. to of those next to each other."""
    runs = [[v for _, v in group] for ok, group in groupby(zip(good, values), lambda p: p[0]) if ok]
    return (
        " and ".join(f"{run[0]:.3g} .. {run[-1]:.3g} {unit}" for run in runs)
        or "no value of the map"
    )


def headline(plane: Plane, risk: Risk, within: tuple[float, float] | None) -> str:
    """The answer as the picture's title has it."""
    sure = f"in at least {1 - SURE:.0%} of the machines"
    if within is None:
        share = np.nanmean(risk.points <= SURE)
        return f"At {plane.speed:g} rad/s {share:.0%} of the map stays clear of resonance {sure}"
    clear = stretches(plane.y.values, risk.rows <= SURE, plane.y.unit)
    return (
        f"{within[0]:g} .. {within[1]:g} rad/s stays clear of resonance "
        f"{sure} with {plane.y.name} of {clear}"
    )


def verdict(o: Options, f: Mapping[str, Figure], r: Map) -> str:
    """The answer in plain words."""
    survey, rows, errors, risk, limit, rated, within, _ = r
    plane = survey.plane
    x, y = plane.x, plane.y
    lines = []
    if within is not None:
        bounds = f"{within[0]:g} .. {within[1]:g} rad/s"
        lines.append(
            f"The operating range {bounds} stays clear of a torque ripple above {limit:g} N.m "
            f"({limit / rated:.0%} of the rated torque of {rated:g} N.m) with {y.name} of "
            f"{stretches(y.values, risk.nominal <= limit, y.unit)}; with every part within its "
            f"tolerance, in at least {1 - SURE:.0%} of the machines, with "
            f"{stretches(y.values, risk.rows <= SURE, y.unit)}."
        )
    else:
        lines.append(
            f"At {plane.speed:g} rad/s a torque ripple above {limit:g} N.m ({limit / rated:.0%} of "
            f"the rated torque of {rated:g} N.m) is in {np.nanmean(survey.ripple > limit):.0%} of "
            f"the map; {np.nanmean(risk.points <= SURE):.0%} of it stays clear in at least "
            f"{1 - SURE:.0%} of the machines with every part within its tolerance."
        )
    phase = off(rows, "lag_90", "formula")
    if phase.rows:
        lines.append(
            "Phase: the torque ripple lags by 90 degrees on formula (22), off by "
            f"{phase.text('.2%', y.unit)}; {coupled(errors.lag_90)}."
        )
    else:
        lines.append("Phase: no row of the map holds a 90 degree lag.")
    amplitude, theory = (off(rows, "peak", other) for other in ("formula", "peak_theory"))
    if amplitude.rows:
        lines.append(
            f"Amplitude: the torque ripple is largest off formula (22), by "
            f"{amplitude.text('.1%', y.unit)}; it is off first-order theory's own peak by "
            f"{theory.text('.2%', y.unit)}; {coupled(errors.peak)}."
        )
    peakless = sum(row.peak is None for row in rows)
    if peakless:
        lines.append(
            f"In {peakless} of {len(rows)} rows the torque ripple has no peak between the ends."
        )
    lines.append(
        "They differ because (22) marks a phase, which neither damping nor load moves, while the "
        "torque ripple is the drive's gain times the load ripple, which "
        + (
            "falls over the speed towards sqrt(c/m) and rises beyond."
            if plane.over_speed
            else "need not be largest there."
        )
    )
    n, k = np.unravel_index(np.nanargmax(abs(survey.ratio - 1.0)), survey.ratio.shape)
    lines.append(
        "Theory is of first order in the ripple: co-simulation makes the torque ripple "
        f"{np.nanmin(survey.ratio):.3f} to {np.nanmax(survey.ratio):.3f} times as large, farthest "
        f"off at {x.name} = {x.values[k]:.3g} {x.unit}, {y.name} = {y.values[n]:.3g} {y.unit}, "
        f"where the torque swings by {survey.ripple[n, k]:.0f} N.m."
    )
    error = "not known" if errors.gain is None else f"at most {errors.gain:.2g} of it"
    lines.append(
        f"The coupling error of the gain is {error}, from runs with a half and a quarter of the "
        f"steps at {errors.points} points, of which {errors.converged} converge as they should"
        + (
            f"; halving the step moves the others by up to {errors.last:.2g}."
            * (errors.converged < errors.points)
            or "."
        )
    )
    restless = int((~survey.steady).sum())
    lines.append(
        "All orbits are steady."
        if not restless
        else f"{restless} of {survey.torque.size} orbits are not steady, and left out: "
        f"{'; '.join(restless_places(survey))}."
    )
    lines += told_checks(risk)
    return "\n".join(lines)


def coupled(error: float | None) -> str:
    """The coupling error of a ridge as the verdict has it."""
    return "coupling error " + ("not known" if error is None else f"up to {error:.3%}")


def restless_places(survey: Survey) -> list[str]:
    """Points without a steady orbit, row by row."""
    x, y = survey.plane.x, survey.plane.y
    return [
        f"{y.name} = {value:.3g} {y.unit} at {x.name} {stretches(x.values, ~steady, x.unit)}"
        for value, steady in zip(y.values, survey.steady)
        if not steady.all()
    ]


def told_checks(risk: Risk) -> list[str]:
    """What co-simulation said of the probabilities."""
    checks = [*risk.checks, *risk.range_checks]
    error = tolerances.sampling_error(risk.points, risk.samples)
    first = (
        f"The probabilities come from {risk.samples} machines per point, judged by theory times the "
        f"ratio measured at the point; standard error of sampling at most {error:.2%}."
    )
    if not checks:
        return [first, "No point of the map was checked by co-simulating machines."]
    total = sum(check.samples for check in checks)
    restless = sum(check.restless for check in checks)
    wrong = sum(check.above + check.below for check in checks)
    outside = sum(not c.interval[0] <= c.predicted <= c.interval[1] for c in checks)
    spread = np.concatenate([check.off for check in checks])
    return [
        first,
        f"Co-simulating {total} of these machines at {len(checks)} places on the edge changes the "
        f"judgement of {wrong} ({wrong / total:.1%}, at most "
        f"{tolerances.interval(wrong, total)[1]:.1%} with {CONFIDENCE:.0%} confidence); their "
        f"ripples are off by {np.sqrt(np.mean(spread**2)):.2%} (rms), at most "
        f"{np.abs(spread).max():.1%}. The probability is off by at most "
        f"{max(abs(c.counted - c.predicted) for c in checks):.3f} from brute force, of which "
        f"{max(abs(c.corrected - c.predicted) for c in checks):.3f} is theory and the rest the "
        f"sampling of {checks[0].samples} machines; {outside} of {len(checks)} places lie outside "
        f"the {CONFIDENCE:.0%} interval of brute force."
        + (f" {restless} further orbits are not steady." if restless else ""),
    ]


def figures(survey: Survey, rows: Sequence[Row], errors: Coupling) -> dict[str, Figure]:
    """The largest gain and torque ripple, deviations of the ridges in %."""
    told = {}
    for name, values, unit, meaning in (
        ("gain_max", survey.gain, "1", "largest gain: torque ripple over load ripple, order 2"),
        ("ripple_max", survey.ripple, "N.m", "largest torque ripple, order 2"),
    ):
        largest = float(np.nanmax(values))
        error = None if errors.gain is None else errors.gain * largest
        told[name] = _told(largest, unit, error, meaning)
    for (place, other), named in OFF.items():
        found = off(rows, place, other)
        if found.rows:
            error = getattr(errors, place)
            error = None if error is None else 100 * error
            what = f"{LOOKS[place][0]} beside {named}"
            for name, value, word in (("max", found.largest, "at most"), ("rms", found.rms, "rms")):
                told[f"{place}_off_{other}_{name}"] = _told(
                    100 * value, "%", error, f"{what}, {word}"
                )
    return told


def _told(value: float, unit: str, error: float | None, meaning: str) -> Figure:
    """A figure, refused where its error is not known."""
    if error is None:
        return Figure.refused(unit, NO_ORDER, meaning)
    return Figure(value, unit, error, meaning)


def solve(o: Options, bench: Bench) -> Findings:
    """Run the map, find its ridges and its risk; rows of the map are kept on the way.

    Raises cosim.SetupError for settings that cannot give an answer.
    """
    across, up = axis(bench.fmus, "x", o.x, 4), axis(bench.fmus, "y", o.y, 2)
    if across.name == up.name:
        raise SetupError(f"--x and --y are both {up.name}")
    refuse(o.start, (across.name, up.name))
    machine = followed(bench.fmus, SETS[o.set], o.start)
    if across.name == "speed" and o.speed is not None:
        raise SetupError("--speed is for maps whose x is not the speed")
    if across.name != "speed" and o.range is not None:
        raise SetupError("--range is for maps whose x is the speed")
    nu = FIXED if o.speed is None else o.speed
    plane = Plane(across, up, machine, nu)
    bounds = span("range", o.range or RANGE, across) if plane.over_speed else None
    rated = RATED[o.set] if o.rated_torque is None else o.rated_torque
    ripple = o.limit / 100 * rated
    spread = shares(bench.fmus, "tolerance", o.tolerance, TOLERANCES)
    if o.samples & (o.samples - 1):
        raise SetupError(f"samples = {o.samples} must be a power of 2, at least 2")
    if o.check_runs > o.samples:
        raise SetupError(f"check_runs = {o.check_runs} must be at most samples = {o.samples}")
    fastest, at = max(plane.points(), key=lambda p: p[0].nu_res / p[1])
    check_steps(fastest, o.algorithm, o.steps_per_rev // 4, at)
    beside = {key: value for key, value in o.start.items() if key not in FIELDS}
    setup = Setup(beside, o.algorithm, o.steps_per_rev, bench)

    survey, points = sweep(plane, setup, bench.out and bench.out / TABLE)
    if not survey.steady.any():
        raise SetupError("no orbit of the map is steady")
    rows = locate(survey, setup)
    errors = coupling(survey, rows, setup)
    exponent = o.samples.bit_length() - 1
    risk = assess(survey, ripple, bounds, spread, exponent, o.checks, o.check_runs, setup)
    import pandas as pd

    frame = pd.DataFrame(points, columns=list(columns(plane)))
    lines = pd.DataFrame(rows).assign(ripple_in_range=risk.nominal, probability_in_range=risk.rows)
    unit = across.unit
    units = {up.name: up.unit, "lag_90": unit, "formula": unit, "peak": unit, "peak_theory": unit,
             "ripple_in_range": "N.m", "probability_in_range": "1"}  # fmt: skip
    return Findings(
        figures(survey, rows, errors),
        Map(survey, rows, errors, risk, ripple, rated, bounds, setup),
        conveyor_drive(bench.fmus, {**machine.start(nu), **beside}),
        communication=f"{o.steps_per_rev} steps per revolution",
        algorithm=o.algorithm,
        tables={
            TABLE: Table(
                frame.assign(probability=risk.points.ravel()),
                {**columns(plane), "probability": "1"},
            ),
            ROWS_TABLE: Table(lines.rename(columns={"y": up.name}), units),
        },
        facts={
            "x": {"name": across.name, "unit": across.unit, "log": across.log},
            "y": {"name": up.name, "unit": up.unit, "log": up.log},
            "shape": {"rows": plane.shape[0], "columns": plane.shape[1]},
            "range": bounds,
            "limit": ripple,
            "rated_torque": rated,
            "tolerances": spread,
            "distribution": "uniform within the tolerance, speed held",
            "coupling": errors._asdict(),
            "not_steady": restless_places(survey),
            "checks": [told(check) for check in risk.checks],
            "range_checks": [told(check) for check in risk.range_checks],
            "sampling_error": tolerances.sampling_error(risk.points, o.samples),
        },
    )  # fmt: skip


def show(o: Options, f: Mapping[str, Figure], r: Map) -> Show:
    """Both maps, the rows, and one revolution where the torque swings most."""
    survey, rows, _, risk, limit, _, within, setup = r
    course, motion = pages.worst(survey, setup)
    maps = pages.maps(survey, rows, risk.points, limit, within)
    lines = pages.rows_chart(survey, rows, risk.nominal, risk.rows, limit, within)
    title = headline(survey.plane, risk, within)
    return Show([*maps, *([lines] if lines.panels else [])], [motion], [course], title)


def told(check: Check) -> dict[str, Any]:
    """A check as the JSON has it."""
    return {
        "place": check.place,
        "probability": check.predicted,
        "brute_force": check.counted,
        "interval": check.interval,
        "corrected": check.corrected,
        "samples": check.samples,
        "judged_above": check.above,
        "judged_below": check.below,
        "not_steady": check.restless,
        "ripple_off_rms": float(np.sqrt(np.mean(check.off**2))),
        "ripple_off_max": float(np.abs(check.off).max()),
    }
