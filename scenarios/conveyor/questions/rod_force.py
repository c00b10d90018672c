"""How hard does the rod push, and which spring unloads it at the operating speed?

Motor and conveyor are coupled at every point of a plane of speed and spring until their orbit is
steady. The rod force over the crank angle is compared with formula (17), which takes the speed as
constant, and with theory to first order in the speed ripple. The spring with the smallest peak of that
force is located, with its effect on the torque ripple and on the resonance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cosim import SetupError
from workbench import (
    Chart,
    Context,
    Figure,
    Findings,
    Judgement,
    Mark,
    Plan,
    PlanQuestion,
    Show,
    Table,
    option,
)
from workbench.answer import parameters
from workbench.charts.model import Curve, CurveLook, HeatMap, Level, Picture
from workbench.judgement import Holds
from workbench.orbits import (
    PEAK_ORDER,
    STEP_MULTIPLES,
    Motions,
    at_zero_step,
    figure_of,
    orbit_figure,
)
from workbench.plan import Measured, extreme
from workbench.steady import ORBIT_ANGLES
from workbench.study.charts import curves_over, heat_map

from .. import motion
from ..drive_orbits import require_enough_steps_per_rev
from ..first_order import NODE_ANGLES, SETS, Machine, rod_force
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive, machine_with_start_values
from ..options import RippleOptions, by_set
from ..orbit import OPERATING, Drive, plan_of, require_steady
from ..papers import cited
from ..rod_waveform import (
    CLOSE,
    ROD_FORCE,
    best_spring,
    best_spring_between,
    peak,
    springs_around,
    waveform,
)
from ..speed_sweep import LAG, LARGEST_PEAKED_ZETA, SpeedSweep, locate

Real = NDArray[np.float64]
TABLE = "rod_force.csv"
FAR = "it lies far from that of formula (17)"
SPRINGS = {"": "machine's spring", "_unloaded": "spring that unloads the rod"}
SPRING_COLORS = ("red", "blue")
#: Speeds of a curve of theory; chosen: more than the eye tells apart.
CURVE_SPEEDS = 100
INPUTS = {"speed": "nu", "conveyor.spring.c": "c"}
COLUMNS = {
    "f_rod_peak": "f_rod", "f_rod_formula": "f_rod_formula", "tau2": "tau2", "tau2_theory": "tau2_theory",
}  # fmt: skip
#: Fewest speeds and springs of a map, as many as a cubic needs.
FEWEST = 4
#: Rod force over the smallest one up to which the present spring is kept; a convention.
WELL = 1.02


class RodForce(PlanQuestion, RippleOptions):
    """The operating speed, the plane of speeds and springs, and the rows of a revolution."""

    parts = DRIVE
    fixed_starts = ("motor.A", "motor.tau", "motor.characteristic", "conveyor.phi", "conveyor.w")
    decisive = ("spring_unloaded",)
    sources = cited(17)

    speed: float | None = option(None, f"operating speed, {by_set(OPERATING)}", "rad/s", above=0.0)
    speeds: tuple[float, ...] = option("15:75:17", "speeds of the map", "rad/s", above=0.0)
    springs: tuple[float, ...] = option("0:1.2e6:11", "springs of the map", "N/m", least=0.0)
    steps_per_rev: int = option(256, "communication steps per revolution", least=1)

    @property
    def nu(self) -> float:
        """The operating speed [rad/s]."""
        return self.speed or OPERATING[self.set]

    def plans(self, context: Context) -> dict[str, Plan]:
        """Orbits over springs and speeds."""
        axes = (("speeds", "rad/s", self.speeds), ("springs", "N/m", self.springs))
        for name, unit, values in axes:
            if len(values) < FEWEST:
                raise SetupError(f"{name} = {values} {unit} must be {FEWEST} values or more")
        present = machine_with_start_values(context.fmus, SETS[self.set], self.start)
        slowest = min(self.nu, *self.speeds)
        require_enough_steps_per_rev(self, present, slowest, STEP_MULTIPLES[-1])
        grid = {"conveyor.spring.c": self.springs, "speed": self.speeds}
        return {TABLE: plan_of(present, self, grid, names=INPUTS, columns=COLUMNS)}

    def conclude(self, context: Context, measured: Mapping[str, Measured]) -> Findings:
        """The plane beside theory, and the spring that unloads the rod, from a search among more orbits."""
        (plane,), present, nu = measured.values(), SETS[self.set].follow(self.start), self.nu
        require_steady(plane.motions)
        system = conveyor_drive(context.fmus, present.start(nu))
        held = {key: parameter.value for key, parameter in parameters(system).items()}
        length = held["conveyor.rod.l"] if held["conveyor.rod.finite"] else math.inf
        drive, table = Drive.of(context, self), with_theory(plane.table, plane.motions, length)
        spring, machines = unloading_spring(drive, present, nu), {"": present}
        if spring.error is not None:
            machines["_unloaded"] = replace(present, c=spring.value)
        data = RodForceData(
            drive, length, nu, table, machines,
            {name: SpeedSweep(drive.motions(x, self.speeds, 1)) for name, x in machines.items()},
            {name: SpeedSweep(drive.motions(x, [nu])) for name, x in machines.items()},
        )  # fmt: skip
        return Findings(
            {
                **springs(data, spring),
                **load_and_resonance_figures(data, spring),
                **agreement(data),
            },
            data,
            system,
            tables={TABLE: table},
            facts={"operating_speed": nu, "rated_torque": self.rated_torque_or_default},
            defaults={"speed": nu, "rated_torque": self.rated_torque_or_default},
        )

    def judgements(self, f: Mapping[str, Figure], r: RodForceData) -> list[Judgement]:
        """The advice, what formula (17) says, and the effect on the resonance."""
        at = f"at {r.speed:g} rad/s ({r.speed * 30 / math.pi:.4g} rpm)"
        present, formula, spring = (f[f"spring{x}"] for x in ("", "_formula", "_unloaded"))
        by_formula = Judgement(
            "spring by the rod-force formula (17), which takes the speed as constant", formula
        )
        if spring.error is None:
            return [
                Judgement(f"spring with the least rod force {at}", spring),
                Judgement(
                    f"largest rod force with the machine's spring of {present.brief()}", f["f_rod"]
                ),
                by_formula,
            ]
        least = f["f_rod_unloaded"]
        error = None if least.error is None else WELL * least.error
        resonance = (
            "resonance"
            if r.machines[""].zeta <= LARGEST_PEAKED_ZETA
            else "90 degree lag, which is no resonance,"
        )
        nearly = Judgement(
            f"the spring of {present.brief()} gives nearly the least rod force {at}",
            f["f_rod"],
            most=least._replace(value=WELL * least.value, error=error),
            yes=f"Keep the spring of {present.brief()} {at}",
            no=f"Use a spring of {spring.text()} instead of {present.brief()} {at}",
            note=""
            if least.error is None
            else f"rod force {least.brief()} with {spring.text()}, {f['f_rod'].brief()} with {present.brief()}",
        )
        return [
            replace(
                nearly, is_so={Holds.YES: True, Holds.NO: False}.get(nearly.answer or Holds.OPEN)
            ),
            by_formula,
            Judgement(f"{resonance} with the machine's spring", f["nu_90"]),
            Judgement(f"{resonance} with the other spring", f["nu_90_unloaded"]),
        ]

    def show(self, f: Mapping[str, Figure], r: RodForceData) -> Show:
        """Force over crank angle and over speed, both maps, and one revolution with the best spring."""
        best = list(r.machines.values())[-1]
        pictures: list[Picture] = [
            over_angle(r),
            over_speed(r),
            *maps(r, self.torque_ripple_limit),
        ]
        return Show(pictures, *motion.revolution(r.drive, best, r.speed))


class RodForceData(NamedTuple):
    """How machines are run, the length of their rod, infinite if much longer than the crank [m], the operating speed
    [rad/s], and the table of the map; the machine with its spring and, if it is known, the one that unloads the rod, with
    their motions at the speeds of the map, and at the operating speed.
    """

    drive: Drive
    length: float
    speed: float
    table: Table
    machines: Mapping[str, Machine]
    sweeps: Mapping[str, SpeedSweep]
    operating: Mapping[str, SpeedSweep]


def unloading_spring(drive: Drive, machine: Machine, nu: float) -> Figure:
    """The spring with the least peak of the rod force at nu: between orbits around that of (17), and
    again with one more at the place.
    """
    meaning, springs = "spring with the smallest peak of the rod force", springs_around(machine, nu)
    guesses = np.full(len(STEP_MULTIPLES), np.nan)
    for _ in range(2):
        motions = drive.motions(replace(machine, c=springs), np.full(len(springs), nu))
        if problem := next(filter(None, motions.problems), ""):
            return Figure.undetermined("N/m", problem, meaning)
        found = np.array([best_spring(springs, x) for x in motions.turn[ROD_FORCE]])
        if np.isnan(found).any():
            return Figure.undetermined("N/m", FAR, meaning)
        guesses, before, springs = found, guesses, np.append(springs, found[0])
    noise = np.abs(guesses - before) + CLOSE * guesses
    return figure_of(at_zero_step(guesses, PEAK_ORDER, noise), (), "N/m", meaning)


def springs(r: RodForceData, spring: Figure) -> dict[str, Figure]:
    """The spring of the machine, and the one that unloads the rod: measured, by formula, by theory."""
    present, nu = r.machines[""], r.speed
    low, high = springs_around(present, nu)[[0, -1]].tolist()
    theory = best_spring_between(lambda c: waveform(replace(present, c=c), r.length, nu), low, high)
    meaning = "that by theory to first order in the speed ripple"
    return {
        "spring": Figure(present.c, "N/m", 0.0, "spring of the machine"),
        "spring_unloaded": spring,
        "spring_formula": Figure(present.m * nu**2, "N/m", 0.0, "that by formula (17)"),
        "spring_theory": Figure.undetermined("N/m", FAR, meaning)
        if math.isnan(theory)
        else Figure(theory, "N/m", CLOSE * theory, meaning),
    }


def load_and_resonance_figures(r: RodForceData, spring: Figure) -> dict[str, Figure]:
    """What rod and motor bear with either spring at the operating speed, and where it is resonant."""
    nu, all_figures = r.speed, dict[str, Figure]()
    speeds = r.table.columns["nu"]
    span = np.linspace(speeds.min(), speeds.max(), 1000)
    located = locate(r.drive.context, list(r.sweeps.values()))
    for (name, machine), features in zip(r.machines.items(), located):
        label, at = f"with the {SPRINGS[name]}", r.operating[name]
        more = (spring.error or 0.0) if name else 0.0
        shifted = replace(machine, c=machine.c + more)
        formula, other = (float(abs(rod_force(x, nu))) for x in (machine, shifted))
        ripple, top = (
            abs(float(abs(shifted.torque_ripple(x)).max() - abs(machine.torque_ripple(x)).max()))
            for x in (np.array([nu]), span)
        )
        _, height = features.peaks["tau2"]
        of_machine = {
            "f_rod": (at.figure("f_rod_peak", 0, ""), machine.r * (shifted.c - machine.c), "largest rod force"),
            "f_rod_formula": (Figure(formula, "N", 0.0), abs(other - formula), "that by formula (17)"),
            "tau2": (at.figure("tau2", 0, ""), ripple, "torque ripple"),
            "nu_90": (features.lag, 0.0, LAG),
            "tau2_peak": (height, top, "largest torque ripple"),
        }  # fmt: skip
        for key, (figure, more, what) in of_machine.items():
            error = None if figure.error is None else figure.error + more
            all_figures[f"{key}{name}"] = figure._replace(error=error, meaning=f"{what} {label}")
    located_names = ("nu_90", "tau2_peak")
    return dict(sorted(all_figures.items(), key=lambda x: x[0].startswith(located_names)))


def with_theory(table: Table, motions: Motions, length: float) -> Table:
    """The table with the largest rod force by theory to first order in the ripple."""
    force = [peak(waveform(o.machine, length, o.nu)) for o in motions.asked]
    columns = {**table.columns, "f_rod_theory": np.array(force)}
    return Table(columns, {**table.units, "f_rod_theory": "N"})


def agreement(r: RodForceData) -> dict[str, Figure]:
    """How far formula and theory are off anywhere on the map."""
    all_figures = {}
    for name, simulated, theory, what in (
        ("formula_off", "f_rod", "f_rod_formula", "rod force of formula (17)"),
        ("theory_off", "f_rod", "f_rod_theory", "rod force of theory with the ripple"),
        ("tau2_off", "tau2", "tau2_theory", "torque ripple of theory"),
    ):
        value, error = (r.table.columns[x] for x in (simulated, f"{simulated}_error"))
        ratio = r.table.columns[theory] / value
        size, unsure = extreme(100.0 * np.abs(ratio - 1.0), 100.0 * ratio * error / value)
        meaning = f"largest deviation of the {what} from co-simulation on the map"
        all_figures[name] = orbit_figure(size, unsure, "%", meaning, "")
    return all_figures


def over_angle(r: RodForceData) -> Chart:
    """The rod force over the crank angle at the operating speed with each spring: formula, theory, co-simulation."""
    step = len(NODE_ANGLES) // ORBIT_ANGLES
    columns, panels = {"crank angle": np.degrees(NODE_ANGLES[::step])}, {}
    for (name, machine), color in zip(r.machines.items(), SPRING_COLORS):
        for key, kind in (("formula", True), ("theory", False)):
            wave = waveform(machine, r.length, r.speed, at_constant_speed=kind)
            columns[f"{key}{name}"] = 1e-3 * wave[::step]
        columns[f"orbit{name}"] = 1e-3 * r.operating[name].motions.turn[ROD_FORCE][0, 0]
        panels[f"rod force, {1e-3 * machine.c:.4g} kN/m"] = {
            f"formula{name}": ("constant speed, formula (17)", "grey", "theory"),
            f"theory{name}": ("with the speed ripple", "green"),
            f"orbit{name}": ("co-simulation", color, "points"),
        }
    table = Table(columns, {"crank angle": "deg"} | dict.fromkeys([*columns][1:], "kN"))
    title = f"Rod force over a revolution at {r.speed:g} rad/s"
    return curves_over(table, "crank angle", panels, title)


def over_speed(r: RodForceData) -> Chart:
    """Rod force and torque ripple over the speed with each spring, and theory."""
    nus = np.array(r.sweeps[""].speeds)
    columns, units = {"nu": nus}, {"nu": "rad/s"}
    fine = {"nu": np.linspace(nus[0], nus[-1], CURVE_SPEEDS)}
    panels: dict[str, dict[str, CurveLook]] = {"largest rod force": {}, "torque ripple": {}}
    for (name, machine), color in zip(r.machines.items(), SPRING_COLORS):
        force = [peak(waveform(machine, r.length, nu)) for nu in fine["nu"].tolist()]
        ripple = np.abs(machine.torque_ripple(fine["nu"]))
        found = r.sweeps[name].motions.columns
        for names, x, unit, scale, theory in zip(
            panels.values(), ("f_rod_peak", "tau2"), ("kN", "N.m"), (1e-3, 1.0), (force, ripple)
        ):
            key, line = f"{x}{name}", f"{x}{name}_theory"
            columns[key], fine[line] = scale * found[x].steps[0], scale * np.array(theory)
            units[line] = unit
            names |= {
                line: (f"theory, {SPRINGS[name]}", color),
                key: (SPRINGS[name], color, "points"),
            }
    marks = [Mark(r.speed, f"operating speed {r.speed:g} rad/s"), resonance_mark(r)]
    title, x = "Rod force and torque ripple over the speed", "operating speed [rad/s]"
    return curves_over(
        Table(columns, units), "nu", panels, title, marks=marks, theory=Table(fine, units), x=x
    )


def resonance_mark(r: RodForceData) -> Mark:
    """The resonance with the machine's spring, by formula (22)."""
    nu = r.machines[""].nu_res
    return Mark(nu, f"resonance {nu:.4g} rad/s")


def maps(r: RodForceData, limit: float) -> list[HeatMap]:
    """Rod force and torque ripple over speed and spring, with formula (17), and the limit of the torque ripple [N.m]."""
    speed, spring, force = "operating speed", "stiffness of the spring", "largest rod force"
    table, ripple = r.table.frame, "torque ripple"
    frame = pd.DataFrame(
        {
            speed: table["nu"],
            spring: 1e-3 * table["c"],
            force: 1e-3 * table["f_rod"],
            ripple: table["tau2"],
        }
    )
    frame[[force, ripple]] = frame[[force, ripple]].where(lambda x: x > 0.0)
    units = {speed: "rad/s", spring: "kN/m", force: "kN", ripple: "N.m"}
    nu = np.linspace(frame[speed].min(), frame[speed].max(), CURVE_SPEEDS)
    formula = 1e-3 * r.machines[""].m * nu**2
    inside = (frame[spring].min() <= formula) & (formula <= frame[spring].max())
    curves = [
        Curve("formula (17)", nu[inside], formula[inside], "sky", "theory"),
        *(
            Curve(SPRINGS[name], [r.speed], [1e-3 * machine.c], color, "points")
            for (name, machine), color in zip(r.machines.items(), SPRING_COLORS)
        ),
    ]
    reached = frame[ripple].min() < limit < frame[ripple].max()
    level = [Level(limit, f"torque ripple of {limit:g} N.m")] if reached else []
    return [
        heat_map(frame, [speed, spring], name, units, title=name.capitalize(), curves=curves, log=True,
                 marks=[resonance_mark(r)], levels=levels)
        for name, levels in ((force, []), (ripple, level))
    ]  # fmt: skip
