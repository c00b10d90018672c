"""Which motors, flywheels and springs keep the operating range clear of resonance, and how reliably?

Motor and conveyor are coupled at every point of a plane of two parameters until their orbit is
steady. The map shows by how much the drive magnifies the load ripple of order 2. It shows the ridge
where the torque ripple lags the load ripple by 90 degrees, next to formula (22), and the ridge where the
torque ripple is largest. It also shows how likely the torque ripple is to exceed a limit when every part
may be off within its tolerance.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import SetupError
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Plan,
    PlanQuestion,
    Show,
    Table,
    option,
)
from workbench.charts.model import CurveLook, GridAxis, HeatMap, Level, Mark, NamedLook, Span
from workbench.options import check_fixed_starts
from workbench.orbits import STEP_MULTIPLES, orbit_figure
from workbench.plan import Measured, extreme
from workbench.study.charts import curves_over, heat_map
from workbench.study.words import interval, stretches_of

from .. import motion
from ..drive_orbits import require_enough_steps_per_rev
from ..first_order import FIELDS, SETS
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive, machine_with_start_values
from ..options import RippleOptions
from ..orbit import Drive, require_steady
from ..papers import cited
from ..parameter_plane import (
    SPEED_NAME,
    BuiltMachines,
    Plane,
    Sample,
    axis,
    on_edge,
    shares,
    span,
)
from ..speed_sweep import first_lag

if TYPE_CHECKING:
    from pandas import DataFrame

Real = NDArray[np.float64]
X, Y = "speed=15:80:60", "motor.T=0.015:0.16:40:log"
#: Default operating range [rad/s], above the resonance of set A; a convention.
RANGE = "45:60"
#: Default operating speed of maps whose x is not the speed [rad/s]; a convention.
FIXED = 60.0
TOLERANCES = {
    "motor.T": 0.10,
    "motor.B": 0.05,
    "conveyor.rotor.J": 0.03,
    "conveyor.spring.c": 0.05,
    "conveyor.trough.m": 0.02,
    "conveyor.trough.d": 0.20,
}
#: Speeds of the operating range at which built machines are judged, 0.25 rad/s apart by default; a convention.
SPEEDS = 61
TABLE, ROWS_TABLE = "resonance_map.csv", "resonance_map_rows.csv"
COLUMNS = {"tau2": "ripple", "gain": "gain", "lag": "lag", "tau2_theory": "ripple_theory"}
UNITS = {"ripple": "N.m", "ripple_error": "N.m", "gain": "1", "gain_error": "1", "lag": "deg", "lag_error": "deg",
         "ripple_theory": "N.m", "probability": "1", "ripple_in_range": "N.m", "probability_in_range": "1"}  # fmt: skip
#: What a row is searched for.
SOUGHT: dict[str, tuple[str, float | str]] = {"lag_90": ("lag", 90.0), "peak": ("tau2", "largest")}
#: Probability up to which nearly all machines stay clear; a convention.
SURE = 0.01
NEARLY_ALL = f"in at least {1 - SURE:.0%} of the machines"
RIDGE_LOOKS = {
    "formula": NamedLook("formula (22)", "grey", "theory"),
    "lag_90": NamedLook("90 deg lag", "sky", "points"),
    "peak": NamedLook("largest torque ripple", "red", "points"),
}
RIDGES = ("lag_90", "lag_90_error", "formula", "peak", "peak_error", "peak_theory")
RANGES = ("ripple_in_range", "probability_in_range")


class ResonanceMap(PlanQuestion, RippleOptions):
    """The axes of the map, what stays fixed, and how many machines are drawn and checked."""

    parts = DRIVE
    fixed_starts = ("motor.A", "motor.tau", "motor.characteristic", "conveyor.phi", "conveyor.w")
    sources = cited(22)

    x: str = option(X, f"NAME=FROM:TO:NUMBER[:log] of `speed` [rad/s], {', '.join(FIELDS)}")
    y: str = option(Y, "the same for the other axis, without `speed`")
    speed: float | None = option(
        None, f"operating speed where x is not the speed, {FIXED:g} by default", "rad/s", above=0.0
    )
    range: str | None = option(
        None, f"FROM:TO, operating range where x is the speed, {RANGE} [rad/s] by default"
    )
    tolerance: tuple[str, ...] = option(
        (),
        "NAME=PERCENT, tolerance within which a parameter is evenly distributed, instead of "
        + ", ".join(f"{name}={100 * share:g}" for name, share in TOLERANCES.items())
        + " (repeatable)",
    )
    samples: int = option(4096, "machines per point, a power of 2", least=2)
    checks: int = option(
        8, "number of map points verified by co-simulation; rows are half as many", least=0
    )
    check_runs: int = option(128, "machines to co-simulate at each check", least=1)
    steps_per_rev: int = option(256, "communication steps per revolution", least=1)

    def plans(self, context: Context) -> dict[str, Plan]:
        """Orbits at every point of the plane, and in each row of it where their ridges are."""
        plane, _ = plane_of(self, context)
        if self.samples & (self.samples - 1):
            raise SetupError(f"samples = {self.samples} must be a power of 2, at least 2")
        if self.check_runs > self.samples:
            raise SetupError(
                f"check_runs = {self.check_runs} must be at most samples = {self.samples}"
            )
        shares(context.fmus, "tolerance", self.tolerance, TOLERANCES)
        machine, nu = plane.points()
        worst = int(np.argmax(machine.nu_res / nu))
        require_enough_steps_per_rev(self, machine[worst], float(nu[worst]), STEP_MULTIPLES[-1])
        return {TABLE: plane.plan(self, SOUGHT, COLUMNS)}

    def conclude(self, context: Context, measured: Mapping[str, Measured]) -> Findings:
        """The ridges of the map and its risk: that of a theory over machines, some of which are run."""
        (plane, within), (map_points,) = plane_of(self, context), measured.values()
        require_steady(map_points.motions)
        drive = Drive.of(context, self)
        spread = shares(context.fmus, "tolerance", self.tolerance, TOLERANCES)
        points, rows = map_points.table.frame, ridges(plane, map_points)
        warn_of_unsteady(plane, points)
        error = float((points["ripple_error"] / points["ripple"]).max())
        map_ = Map(plane, drive, points, rows.assign(**dict.fromkeys(RANGES, math.nan)), within)
        ratio = map_.field("ripple") / map_.field("ripple_theory")
        built = BuiltMachines.within(plane, ratio, spread, self.samples)
        checks = built.check(
            add_risk(map_, built, self.checks, self.torque_ripple_limit),
            self.check_runs,
            self.torque_ripple_limit,
            drive,
        )
        return Findings(
            figures(points, rows) | check_figures(checks, error),
            map_,
            conveyor_drive(context.fmus, plane.machine.start(plane.speed)),
            tables={
                TABLE: Table.of_frame(points, map_.units),
                ROWS_TABLE: Table.of_frame(map_.rows, map_.units),
            },
            facts={
                "range": within,
                "limit": self.torque_ripple_limit,
                "rated_torque": self.rated_torque_or_default,
                "tolerances": spread,
                "distribution": "uniform within the tolerance, speed held",
                "checks": checks,
            },
            defaults={
                "rated_torque": self.rated_torque_or_default,
                "tolerance": tuple(f"{name}={100 * share:g}" for name, share in spread.items()),
                **(
                    {"speed": plane.speed}
                    if within is None
                    else {"range": f"{within[0]:g}:{within[1]:g}"}
                ),
            },
        )

    def judgements(self, f: Mapping[str, Figure], r: Map) -> list[Judgement]:
        """Which part of the map stays clear, with the machine as it is and with all parts within tolerance."""
        above = f"a torque ripple above {self.torque_ripple_limit:g} N.m"
        built = f"with all parts within tolerance, clear of it {NEARLY_ALL}"
        if r.within is None:
            ripple = r.points["ripple"].dropna()
            clear = Figure(100.0 * float(np.mean(ripple <= self.torque_ripple_limit)), "%", 0.0)
            sure = np.nanmean(r.points["probability"] <= SURE)
            points = f"of {len(ripple)} points with a steady orbit, out of {len(r.points)}"
            answers = [
                Judgement(
                    f"at {r.plane.speed:g} rad/s the map is clear of {above} in", clear, note=points
                ),
                Judgement(built, note=f"{sure:.0%} of the map"),
            ]
        else:
            name = r.plane.y.quantity.replace("motor.T", "motor time constant")
            span = f"{r.within[0]:g} to {r.within[1]:g} rad/s"
            nominal = r.clear("ripple_in_range", self.torque_ripple_limit)
            nearly_all = r.clear("probability_in_range", SURE)
            answers = [
                Judgement(
                    f"{span} is clear of {above}",
                    is_so=bool(nominal),
                    yes=f"{span} is clear of {above} with a {name} of {nominal}",
                    no=f"{span} is clear of {above} with no {name} of the map",
                ),
                Judgement(
                    built,
                    is_so=bool(nearly_all),
                    note=f"with a {name} of {nearly_all}"
                    if nearly_all
                    else f"with no {name} of the map",
                ),
            ]
        return answers

    def show(self, f: Mapping[str, Figure], r: Map) -> Show:
        """Both maps, the rows, and one revolution where the torque swings most."""
        worst = int(r.points["ripple"].argmax())
        machine, nu = r.plane.points()
        turn = motion.revolution(r.drive, machine[worst], float(nu[worst]))
        return Show(
            [*maps(r, self.torque_ripple_limit), chart_of_rows(r, self.torque_ripple_limit)], *turn
        )


class Map(NamedTuple):
    """The machines, how they are run, the tables of their points and rows, the operating range [rad/s]."""

    plane: Plane
    drive: Drive
    points: DataFrame
    rows: DataFrame
    within: tuple[float, float] | None

    @property
    def units(self) -> dict[str, str]:
        """Those of all columns."""
        return self.plane.units | UNITS | dict.fromkeys(RIDGES, self.plane.x.unit)

    def field(self, column: str) -> Real:
        """A column of the points over the plane, shape (rows, columns)."""
        return self.points[column].to_numpy().reshape(len(self.rows), -1)

    def clear(self, column: str, most: float) -> str:
        """The values of y for which the operating range keeps a column of the rows below a value."""
        return stretches(self.plane.y, (self.rows[column] <= most).to_numpy())


def stretches(along: GridAxis, good: NDArray[np.bool_]) -> str:
    """The values of an axis that are good, as from .. to of those next to each other."""
    return " and ".join(
        " .. ".join(f"{x:.3g}" for x in dict.fromkeys(along.values[[*ends]].tolist()))
        + f" {along.unit}"
        for ends in stretches_of(good)
    )


def maps(r: Map, limit: float) -> list[HeatMap]:
    """The gain and the probability of too much ripple, with ridges, the line of the limit [N.m] and the operating range."""
    grid, y = [r.plane.x.quantity, r.plane.y.quantity], r.rows[r.plane.y.quantity].to_numpy()
    curves = [
        Curve(look.name, r.rows[name].to_numpy(), y, look.color, look.look)
        for name, look in RIDGE_LOOKS.items()
        if r.rows[name].notna().any()
    ]
    ripple = r.field("ripple")
    reached = np.nanmin(ripple) < limit < np.nanmax(ripple)
    more = {
        "levels": [Level(limit, f"torque ripple of {limit:g} N.m", ripple)] if reached else [],
        "spans": [Span(*r.within, "operating range", "green")] if r.within else [],
    }
    gain = "Gain: torque ripple over load ripple"
    risk = f"Share of machines within tolerance whose torque ripple is above {limit:g} N.m"
    return [
        heat_map(r.points, grid, "gain", r.units, title=gain, curves=curves, log=True, **more),
        heat_map(r.points, grid, "probability", r.units, title=risk, scale="risk", **more),
    ]


def chart_of_rows(r: Map, limit: float) -> Chart:
    """The ridges of every row; where there is an operating range, its ripple with the limit [N.m], and probability."""
    panels: dict[str, Mapping[str, CurveLook]] = {r.plane.x.quantity: RIDGE_LOOKS}
    title = "The ridges"
    if r.within:
        title = f"Anywhere in {r.within[0]:g} to {r.within[1]:g} rad/s"
        panels = {
            "share of machines above the limit": {"probability_in_range": "all parts within tolerance"},
            "largest torque ripple": {"ripple_in_range": ("nominal machine", "red")},
            **panels,
        }  # fmt: skip
    level, y = [Mark(limit, f"limit {limit:g} N.m")], r.plane.y
    return curves_over(
        Table.of_frame(r.rows, r.units), y.quantity, panels, title,
        levels={"largest torque ripple": level}, log=y.log,
    )  # fmt: skip


def plane_of(o: ResonanceMap, context: Context) -> tuple[Plane, tuple[float, float] | None]:
    """The plane, and the operating range if x is the speed; raises SetupError."""
    across, up = axis(context.fmus, "x", o.x, 4), axis(context.fmus, "y", o.y, 2)
    if across.quantity == up.quantity:
        raise SetupError(f"--x and --y are both {up.quantity}")
    check_fixed_starts(o.start, (across.quantity, up.quantity))
    plane = Plane(
        across, up, machine_with_start_values(context.fmus, SETS[o.set], o.start), o.speed or FIXED
    )
    if across.quantity != SPEED_NAME:
        if o.range is not None:
            raise SetupError("--range is for maps whose x is the speed")
        return plane, None
    if o.speed is not None:
        raise SetupError("--speed is for maps whose x is not the speed")
    return plane, span("range", o.range or RANGE, across)


def warn_of_unsteady(plane: Plane, points: DataFrame) -> None:
    """Warn of points without a steady orbit."""
    for y, row in points.groupby(plane.y.quantity):
        if (unsteady := row["ripple"].isna().to_numpy()).any():
            ridge_name = f"{plane.y.quantity} = {y:.3g} {plane.y.unit}, {plane.x.quantity}"
            logging.getLogger("cosim").warning(
                f"No steady orbit at {ridge_name} of {stretches(plane.x, unsteady)}"
            )


def ridges(plane: Plane, measured: Measured) -> DataFrame:
    """Where every row has its ridges, with their errors, beside formula (22) and theory; nan where it has none."""
    of_lag, of_peak = (
        [*zip(x, y)] for x, y in zip(measured.searches.values(), measured.found.values())
    )
    rows = []
    for y, lag, (peak, (top,)) in zip(plane.y.values, of_lag, of_peak):
        at, formulas = first_lag([lag]), (lag[0].by_guide(), peak.by_guide())
        rows.append(
            (
                y,
                at.value,
                at.known_error,
                formulas[0],
                top.place.value,
                top.place.known_error,
                formulas[1],
            )
        )
    return Table.of_rows(rows, dict.fromkeys([plane.y.quantity, *RIDGES], plane.x.unit)).frame


def add_risk(r: Map, built: BuiltMachines, count: int, most: float) -> list[Sample]:
    """Put probabilities and the ripple in the range into the tables; the machines of so many points,
    and of half as many rows, where the outcome is open.
    """
    x, rows = r.plane.x.values, range(len(r.rows))
    cells = [(n, x[k : k + 1]) for n in rows for k in range(len(x))]
    r.points["probability"] = [built.sample(*cell).probability(most) for cell in cells]
    samples = [built.sample(*cells[k]) for k in on_edge(r.points["probability"], count)]
    if r.within is not None:
        nus, nominal = np.linspace(*r.within, SPEEDS), built._replace(factors={})
        over = [built.sample(n, nus) for n in rows]
        r.rows["ripple_in_range"] = [nominal.sample(n, nus).expected[0] for n in rows]
        r.rows["probability_in_range"] = [sample.probability(most) for sample in over]
        samples += [over[n] for n in on_edge(r.rows["probability_in_range"], count // 2)]
    return samples


def figures(points: DataFrame, rows: DataFrame) -> dict[str, Figure]:
    """The largest gain and torque ripple, and how far theory and the ridges are off."""
    over = "torque ripple by co-simulation over that of first-order theory"
    theory = points["ripple_theory"]
    all_figures = {}
    for name, column, base, sense, unit, meaning in (
        ("gain_max", "gain", 1.0, 1.0, "1",
         "largest gain at a point: torque ripple over load ripple, order 2"),
        ("ripple_max", "ripple", 1.0, 1.0, "N.m", "largest torque ripple at a point, order 2"),
        ("ratio_min", "ripple", theory, -1.0, "1", f"smallest at a point: {over}"),
        ("ratio_max", "ripple", theory, 1.0, "1", f"largest at a point: {over}"),
    ):  # fmt: skip
        value, error = ((points[x] / base).to_numpy() for x in (column, f"{column}_error"))
        all_figures[name] = orbit_figure(*extreme(value, error, sense), unit, meaning, "")
    for ridge_name, other, what in (
        ("lag_90", "formula", "deviation of the 90 deg lag from formula (22)"),
        ("peak", "formula", "deviation of the largest torque ripple from formula (22)"),
        (
            "peak",
            "peak_theory",
            "deviation of the largest torque ripple from that of first-order theory",
        ),
    ):
        deviations = 100 * abs(rows[ridge_name] / rows[other] - 1.0).dropna()
        if len(deviations):
            left = float((100 * rows[f"{ridge_name}_error"] / rows[other]).max())
            rms = math.sqrt((deviations**2).mean())
            what = f"{what}, {len(deviations)} of {len(rows)} rows"
            name = f"{ridge_name}_off_{other}"
            all_figures[f"{name}_max"] = Figure(
                float(deviations.max()), "%", left, f"{what}, at most"
            )
            all_figures[f"{name}_rms"] = Figure(rms, "%", left, f"{what}, rms")
    return all_figures


def check_figures(checks: Sequence[Mapping[str, Any]], error: float) -> dict[str, Figure]:
    """How far probabilities may be off, by the machines that were co-simulated."""
    wrong, deviations, other_starts = (
        "co-simulated machines that theory judges differently",
        "deviation of the torque ripple of these machines from theory, rms",
        "probability from these machines minus that of the map, at most",
    )
    steady = [check for check in checks if check["samples"]]
    if not steady:
        why = "no machine that is co-simulated has a steady orbit"
        reason = why if checks else "no machine is co-simulated"
        return {"misjudged": Figure.undetermined("%", reason, wrong)}
    samples = [x["samples"] for x in steady]
    otherwise = sum(x["judged_above"] + x["judged_below"] for x in steady)
    share, ends = otherwise / sum(samples), interval(otherwise, sum(samples))
    rms = math.sqrt(np.average([x["off_rms"] ** 2 for x in steady], weights=samples))
    worst = max(steady, key=lambda check: abs(check["brute_force"] - check["probability"]))
    brute, chance = worst["brute_force"], worst["probability"]
    reach = max(abs(end - brute) for end in worst["interval"])
    return {
        "misjudged": Figure(100 * share, "%", 100 * max(abs(end - share) for end in ends), wrong),
        "machines_off_rms": orbit_figure(100 * rms, 100 * error, "%", deviations, ""),
        "probability_off_max": Figure(brute - chance, "1", reach, other_starts),
    }
