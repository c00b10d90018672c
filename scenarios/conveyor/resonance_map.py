"""Which motors, flywheels and springs keep the operating range clear of resonance, and how surely?

Motor and conveyor are coupled at every point of a plane of two parameters until their orbit is
steady. The map shows by how much the drive magnifies the load's ripple of order 2, the ridge where
the torque ripple lags it by 90 degrees beside formula (22), the ridge where the torque ripple is
largest, and how likely it is above a limit when every part may be off within its tolerance.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import ORDERS, SetupError
from cosim.result import partial
from workbench import Bench, Figure, Findings, Show, Table, option
from workbench.answer import stream
from workbench.limit import coupling
from workbench.options import refuse

from . import show as pictures
from . import tolerances
from .drive import PARTS as DRIVE
from .drive import conveyor_drive, followed
from .plane import Axis, Plane, axis, shares, span
from .response import (
    COARSER,
    LAG,
    TORQUE,
    Point,
    Ripple,
    Setup,
    orbit,
    places,
    simulate,
)
from .theory import FIELDS, SETS
from .tolerances import Sample

if TYPE_CHECKING:
    from pandas import DataFrame

Real = NDArray[np.float64]
PARTS = DRIVE
FLAVOUR = "native"
X, Y = "speed=15:80:60", "motor.T=0.015:0.16:40:log"
RANGE, FIXED = "45:60", 60.0
TOLERANCES = {
    "motor.T": 0.10,
    "motor.B": 0.05,
    "conveyor.rotor.J": 0.03,
    "conveyor.spring.c": 0.05,
    "conveyor.trough.m": 0.02,
    "conveyor.trough.d": 0.20,
}
SURE, SPEEDS, GRID = 0.01, 61, 5
TABLE, ROWS_TABLE = "resonance_map.csv", "resonance_map_rows.csv"
VALUES = {"ripple": "N.m", "gain": "1", "lag": "deg", "settling": "1", "ripple_theory": "N.m"}
RIDGES = ("lag_90", "lag_90_error", "formula", "peak", "peak_error", "peak_theory")
RANGES = {"ripple_in_range": "N.m", "probability_in_range": "1"}
OWN = ("motor.A", "motor.tau", "motor.characteristic", "conveyor.phi", "conveyor.w")


@dataclass(frozen=True, kw_only=True)
class Options(Ripple):
    x: str = option(X, f"NAME=FROM:TO:NUMBER[:log] of `speed` [rad/s], {', '.join(FIELDS)}")
    y: str = option(Y, "the same without `speed`")
    speed: float | None = option(
        None, f"operating speed where x is not the speed, {FIXED:g} by default", "rad/s", above=0.0
    )
    range: str | None = option(
        None, f"FROM:TO, operating range where x is the speed, {RANGE} [rad/s] by default"
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
    steps_per_rev: int = option(256, "communication steps per revolution", least=1)


class Map(NamedTuple):
    """The machines, how they are run, the tables of their points and rows, the operating range [rad/s]."""

    plane: Plane
    setup: Setup
    points: DataFrame
    rows: DataFrame
    within: tuple[float, float] | None

    def field(self, column: str) -> Real:
        """A column of the points over the plane, shape (rows, columns)."""
        return self.points[column].to_numpy().reshape(len(self.rows), -1)

    def clear(self, column: str, most: float) -> str:
        """The values of y for which the operating range keeps a column of the rows below a value."""
        return stretches(self.plane.y, (self.rows[column] <= most).to_numpy())


def solve(o: Options, bench: Bench) -> Findings:
    """Run the map, find its ridges and its risk; rows of the map are kept on the way.

    Raises cosim.SetupError for settings that cannot give an answer.
    """
    plane, within = planned(o, bench)
    spread = shares(bench.fmus, "tolerance", o.tolerance, TOLERANCES)
    if o.samples & (o.samples - 1):
        raise SetupError(f"samples = {o.samples} must be a power of 2, at least 2")
    if o.check_runs > o.samples:
        raise SetupError(f"check_runs = {o.check_runs} must be at most samples = {o.samples}")
    beside = {key: value for key, value in o.start.items() if key not in FIELDS}
    setup = Setup(bench, beside, o.algorithm, o.steps_per_rev)
    spots = [plane.at(*node) for node in plane.nodes()]
    setup.check(*max(spots, key=lambda spot: spot[0].nu_res / spot[1]), COARSER[-1])

    orbits, points = swept(plane, setup, bench.out and bench.out / TABLE)
    rows = ridges(plane, orbits, setup)
    error = coupling_error(plane, orbits, setup)
    rows = rows.assign(**dict.fromkeys(RANGES, math.nan))
    x, y, levels = plane.x.values, plane.y, plane.y.values.tolist()
    ratio = (points["ripple"] / points["ripple_theory"]).to_numpy().reshape(len(levels), -1)
    drawn = tolerances.factors(spread, o.samples)

    def built(n: int, x: Real, factors: Mapping[str, Real] = drawn) -> Sample:
        return tolerances.built(plane, x, levels[n], ratio[n], factors)

    cells = [(n, x[k : k + 1]) for n in range(len(levels)) for k in range(len(x))]
    points["probability"] = [built(*cell).probability(o.most) for cell in cells]
    edge = tolerances.on_edge(points["probability"].to_numpy(), o.checks)
    samples = [built(*cells[k]) for k in edge]
    if within is not None:
        nus, nominal = np.linspace(*within, SPEEDS), {name: np.ones(1) for name in drawn}
        rows["ripple_in_range"] = [built(n, nus, nominal).expected[0] for n in range(len(levels))]
        over = [built(n, nus) for n in range(len(levels))]
        rows["probability_in_range"] = [sample.probability(o.most) for sample in over]
        edge = tolerances.on_edge(rows["probability_in_range"].to_numpy(), o.checks // 2)
        samples += [over[n] for n in edge]
    checks = tolerances.check(samples, o.check_runs, o.most, setup)
    return Findings(
        figures(points, rows, error) | judgement(checks, error),
        Map(plane, setup, points, rows, within),
        conveyor_drive(bench.fmus, {**plane.machine.start(plane.speed), **beside}),
        communication=f"{o.steps_per_rev} steps per revolution",
        algorithm=o.algorithm,
        tables={
            TABLE: Table(points, plane.units | VALUES | {"probability": "1"}),
            ROWS_TABLE: Table(
                rows, {y.name: y.unit} | dict.fromkeys(RIDGES, plane.x.unit) | RANGES
            ),
        },
        facts={
            "range": within,
            "limit": o.most,
            "rated_torque": o.rated,
            "tolerances": spread,
            "distribution": "uniform within the tolerance, speed held",
            "checks": checks,
        },
    )


def planned(o: Options, bench: Bench) -> tuple[Plane, tuple[float, float] | None]:
    """The plane, and the operating range if x is the speed; raises SetupError."""
    across, up = axis(bench.fmus, "x", o.x, 4), axis(bench.fmus, "y", o.y, 2)
    if across.name == up.name:
        raise SetupError(f"--x and --y are both {up.name}")
    refuse(o.start, (across.name, up.name))
    plane = Plane(across, up, followed(bench.fmus, SETS[o.set], o.start), o.speed or FIXED)
    if plane.over_speed and o.speed is not None:
        raise SetupError("--speed is for maps whose x is not the speed")
    if not plane.over_speed and o.range is not None:
        raise SetupError("--range is for maps whose x is the speed")
    return plane, span("range", o.range or RANGE, across) if plane.over_speed else None


def swept(plane: Plane, setup: Setup, path: Path | None) -> tuple[list[Point], DataFrame]:
    """The orbits of all points and the rows of their table, which are kept on the way, too.

    Raises SetupError where none is steady.
    """
    nodes, units = plane.nodes(), plane.units | VALUES
    spots = [plane.at(*node) for node in nodes]
    orbits: list[Point] = []
    rows: list[tuple[float, ...]] = []
    with stream(path, list(units)) as keep:
        try:
            each = setup.bench.each(simulate, [setup.case(*spot) for spot in spots], "map")
            for node, (machine, nu), orbit in zip(nodes, spots, each):
                load, ripple = machine.load_ripple(nu), abs(orbit.torque)
                lag = float(np.angle(load / orbit.torque, deg=True)) % 360.0
                theory, left = abs(machine.torque_ripple(nu)), orbit.torque_error / ripple
                rows.append((*node, ripple, ripple / abs(load), lag, left, theory))
                keep(rows[-1:])
                orbits.append(orbit)
        except KeyboardInterrupt:
            kept = f" in {partial(path)}" if path else ""
            raise KeyboardInterrupt(f"{len(rows)} of {len(spots)} points{kept}") from None
    steady = np.array([not orbit.problem for orbit in orbits]).reshape(len(plane.y.values), -1)
    if not steady.any():
        raise SetupError("no orbit of the map is steady")
    for y, there in zip(plane.y.values, steady):
        if not there.all():
            place = f"{plane.y.name} = {y:.3g} {plane.y.unit}, {plane.x.name}"
            logging.getLogger("cosim").warning(
                f"No steady orbit at {place} of {stretches(plane.x, ~there)}"
            )
    return orbits, Table.of_rows(rows, units).frame


def ridges(plane: Plane, orbits: Sequence[Point], setup: Setup) -> DataFrame:
    """Where every row has its ridges, with their errors, beside formula (22) and theory; nan where it
    has none.
    """
    x, y = plane.x.values.tolist(), plane.y.values.tolist()
    lines = [plane.line(level) for level in y]
    known = [list(zip(x, orbits[n * len(x) :])) for n in range(len(y))]
    sought = [(line, place, at) for line, at in zip(lines, known) for place in (LAG, TORQUE)]
    found = [
        (figure.value, math.nan if figure.error is None else figure.error)
        for figure, _ in places(sought, COARSER, plane.x.unit, setup)
    ]
    theory = [line.theory(place) for line, place, _ in sought]
    rows = [
        (level, *found[k], theory[k], *found[k + 1], theory[k + 1])
        for level, k in zip(y, range(0, len(found), 2))
    ]
    return Table.of_rows(rows, dict.fromkeys([plane.y.name, *RIDGES], plane.x.unit)).frame


def coupling_error(plane: Plane, orbits: Sequence[Point], setup: Setup) -> float:
    """The largest relative coupling error of the torque ripple, from coarser runs all over the map."""
    height, width = len(plane.y.values), len(plane.x.values)
    rows, columns = (
        sorted({round(k) for k in np.linspace(0, n - 1, GRID).tolist()}) for n in (height, width)
    )
    grid = [k for n in rows for k in (n * width + c for c in columns) if not orbits[k].problem]
    nodes = plane.nodes()
    spots = [(*plane.at(*nodes[k]), coarser) for coarser in COARSER[1:] for k in grid]
    coarse = [abs(orbit.torque) for orbit in setup.orbits(spots, "coupling error")]
    runs = zip((abs(orbits[k].torque) for k in grid), coarse, coarse[len(grid) :])
    order = ORDERS[setup.algorithm]
    errors = [coupling(values, order) / values[0] for values in runs if not np.isnan(values).any()]
    if not errors:
        raise SetupError("no orbit is steady with a quarter of the steps per revolution: take more")
    return float(max(errors))


def figures(points: DataFrame, rows: DataFrame, error: float) -> dict[str, Figure]:
    """The largest gain and torque ripple, and how far theory and the ridges are off."""
    over = "torque ripple by co-simulation over that of first-order theory"
    ratio = points["ripple"] / points["ripple_theory"]
    found = {
        name: Figure(float(value), unit, error * float(value), meaning)
        for name, value, unit, meaning in (
            ("gain_max", points["gain"].max(), "1",
             "largest gain: torque ripple over load ripple, order 2"),
            ("ripple_max", points["ripple"].max(), "N.m", "largest torque ripple, order 2"),
            ("ratio_min", ratio.min(), "1", f"least {over}"),
            ("ratio_max", ratio.max(), "1", f"largest {over}"),
        )
    }  # fmt: skip
    for place, other, what in (
        ("lag_90", "formula", "90 deg lag beside formula (22)"),
        ("peak", "formula", "largest torque ripple beside formula (22)"),
        ("peak", "peak_theory", "largest torque ripple beside that of first-order theory"),
    ):
        off = (100 * (rows[place] / rows[other] - 1.0)).dropna()
        if len(off):
            left = float((100 * rows[f"{place}_error"] / rows[other]).max())
            farthest, rms = max(off, key=abs), math.sqrt((off**2).mean())
            what = f"{what}, {len(off)} of {len(rows)} rows"
            name = f"{place}_off_{other}"
            found[f"{name}_max"] = Figure(float(farthest), "%", left, f"{what}, at most")
            found[f"{name}_rms"] = Figure(rms, "%", left, f"{what}, rms")
    return found


def judgement(checks: Sequence[Mapping[str, Any]], error: float) -> dict[str, Figure]:
    """How far probabilities may be off, by the machines that were co-simulated."""
    wrong, off, beside = (
        "co-simulated machines that theory judges otherwise",
        "torque ripple of these machines beside theory's, rms",
        "probability by these machines less that of the map, at most",
    )
    if not checks:
        return {"misjudged": Figure.refused("%", "no machine is co-simulated", wrong)}
    total = sum(check["samples"] for check in checks)
    otherwise = sum(check["judged_above"] + check["judged_below"] for check in checks)
    share, ends = otherwise / total, tolerances.interval(otherwise, total)
    rms = math.sqrt(sum(check["samples"] * check["off_rms"] ** 2 for check in checks) / total)
    worst = max(checks, key=lambda check: abs(check["brute_force"] - check["probability"]))
    brute = worst["brute_force"]
    return {
        "misjudged": Figure(100 * share, "%", 100 * max(abs(end - share) for end in ends), wrong),
        "machines_off_rms": Figure(100 * rms, "%", 100 * error, off),
        "probability_off_max": Figure(
            brute - worst["probability"],
            "1",
            max(abs(x - brute) for x in worst["interval"]),
            beside,
        ),
    }


def stretches(along: Axis, good: NDArray[np.bool_]) -> str:
    """The values of an axis that are good, as from .. to of those next to each other."""
    runs = [
        [x for _, x in group]
        for ok, group in groupby(zip(good, along.values), lambda p: p[0])
        if ok
    ]
    told = [f"{run[0]:.3g} .. {run[-1]:.3g} {along.unit}" for run in runs]
    return " and ".join(told) or "no value of the map"


def verdict(o: Options, f: Mapping[str, Figure], r: Map) -> str:
    """The answer in plain words."""
    above = (
        f"a torque ripple above {o.most:g} N.m ({o.most / o.rated:.0%} of the rated torque of "
        f"{o.rated:g} N.m)"
    )
    built = f"with every part within its tolerance, in at least {1 - SURE:.0%} of the machines"
    if r.within is None:
        over = np.nanmean(r.points["ripple"] > o.most)
        clear = np.nanmean(r.points["probability"] <= SURE)
        return (
            f"At {r.plane.speed:g} rad/s {above} is in {over:.0%} of the map; {built}, {clear:.0%} of "
            "it stays clear."
        )
    return (
        f"The operating range {r.within[0]:g} .. {r.within[1]:g} rad/s stays clear of {above} with "
        f"{r.plane.y.name} of {r.clear('ripple_in_range', o.most)}; {built}, with "
        f"{r.clear('probability_in_range', SURE)}."
    )


def show(o: Options, f: Mapping[str, Figure], r: Map) -> Show:
    """Both maps, the rows, and one revolution where the torque swings most."""
    worst = r.plane.nodes()[int(r.points["ripple"].argmax())]
    case = r.setup.case(*r.plane.at(*worst))
    course, motion = pictures.revolution(case.nu, orbit(case, pictures.RECORD).result)
    sure = f"in at least {1 - SURE:.0%} of the machines"
    if r.within is None:
        share = np.nanmean(r.points["probability"] <= SURE)
        title = f"At {r.plane.speed:g} rad/s {share:.0%} of the map stays clear of resonance {sure}"
    else:
        title = (
            f"{r.within[0]:g} .. {r.within[1]:g} rad/s stays clear of resonance {sure} with "
            f"{r.plane.y.name} of {r.clear('probability_in_range', SURE)}"
        )
    return Show(
        [*pictures.maps(r, o.most), *pictures.map_rows(r, o.most)], [motion], [course], title
    )
