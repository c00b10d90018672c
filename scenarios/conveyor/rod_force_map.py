"""The rod force over speed and spring: the orbits of a plane, and their pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench import Chart, Curve, Figure, Mark, Panel
from workbench.charts import model as colors
from workbench.charts.model import GridAxis, HeatMap, Level, SecondUnit
from workbench.orbits import PEAK_ORDER, STEP_MULTIPLES, Motions, at_zero_step, figure_of

from .first_order import NODE_ANGLES, Machine
from .orbit import Drive
from .parameter_plane import Plane
from .rod_waveform import CLOSE, ROD_FORCE, best_spring, peak, springs_around, waveform

if TYPE_CHECKING:
    from pandas import DataFrame

FAR = "it lies far from that of formula (17)"
Real = NDArray[np.float64]
SPRINGS = {"": ("machine's spring", "red"), "_unloaded": ("spring that unloads the rod", "blue")}
#: Speeds at which a curve of theory is drawn, 0.5 rad/s apart over the default map; a convention.
CURVE_SPEEDS = 121


class RodForceData(NamedTuple):
    """How machines are run, the length of their rod, infinite if much longer than the crank [m]; the
    plane, its table and its motions, of shape (points,); the machine with its spring and, if it is known, the one that
    unloads the rod, with their motions at the speeds of the plane, and at the operating speed.
    """

    drive: Drive
    length: float
    plane: Plane
    points: DataFrame
    motions: Motions
    machines: Mapping[str, Machine]
    sweeps: Mapping[str, Motions]
    operating: Mapping[str, Motions]

    @property
    def speeds(self) -> list[float]:
        """Those of the plane [rad/s]."""
        return [float(nu) for nu in self.plane.x.along.values]

    def field(self, column: str) -> Real:
        """A column of the table over the plane, shape (springs, speeds); nan where it is 0."""
        values = self.points[column].to_numpy().reshape(-1, len(self.speeds))
        return np.where(values > 0.0, values, math.nan)

    def valley(self) -> list[tuple[float, float]]:
        """Speeds of the plane, and the springs of the plane that unload the rod there [N/m]."""
        springs, width = self.plane.y.along.values, len(self.speeds)
        force = self.motions.turn[ROD_FORCE][0]
        optima = [best_spring(springs, force[k::width]) for k in range(width)]
        return [(nu, c) for nu, c in zip(self.speeds, optima) if math.isfinite(c)]


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


def over_angle(r: RodForceData) -> Chart:
    """The rod force over the crank angle at the operating speed: formula, theory, co-simulation."""
    nu, deg, panels = r.plane.speed, np.degrees(NODE_ANGLES), []
    for name, machine in r.machines.items():
        steady, swinging = (
            1e-3 * waveform(machine, r.length, nu, at_constant_speed=kind) for kind in (True, False)
        )
        simulated = 1e-3 * r.operating[name].turn[ROD_FORCE][0, 0, ::2]
        curves = [
            Curve("constant speed, formula (17)", deg, steady, colors.THEORY, "theory"),
            Curve("with the speed ripple", deg, swinging, "green"),
            Curve(
                "co-simulation",
                deg[:: len(deg) // len(simulated)],
                simulated,
                SPRINGS[name][1],
                "points",
            ),
        ]
        panels.append(Panel(f"rod force, {1e-3 * machine.c:.4g} kN/m", "kN", curves))
    return Chart(f"Rod force over a revolution at {nu:g} rad/s", "crank angle [deg]", panels)


def over_speed(r: RodForceData) -> Chart:
    """Rod force and torque ripple over the speed with either spring, theory as lines."""
    fine, forces, ripples = np.linspace(r.speeds[0], r.speeds[-1], CURVE_SPEEDS), [], []
    for name, machine in r.machines.items():
        columns, (label, color) = r.sweeps[name].columns, SPRINGS[name]
        theory = [1e-3 * peak(waveform(machine, r.length, nu)) for nu in fine.tolist()]
        ripple, line = abs(machine.torque_ripple(fine)), f"theory, {label}"
        forces += [
            Curve(line, fine, theory, color, "theory"),
            Curve(label, r.speeds, 1e-3 * columns["f_rod_peak"].steps[0], color, "points"),
        ]
        ripples += [
            Curve(line, fine, ripple, color, "theory"),
            Curve(label, r.speeds, columns["tau2"].steps[0], color, "points"),
        ]
    nu, nu_res = r.plane.speed, r.plane.machine.nu_res
    return Chart(
        "Rod force and torque ripple over the speed", "operating speed [rad/s]",
        [Panel("largest rod force", "kN", forces, includes=(0.0,)),
         Panel("torque ripple", "N.m", ripples, includes=(0.0,))],
        [Mark(nu, f"operating speed {nu:g} rad/s"), Mark(nu_res, f"resonance {nu_res:.4g} rad/s")],
        second=SecondUnit("rpm", 30 / math.pi),
    )  # fmt: skip


def maps(r: RodForceData, limit: float) -> list[HeatMap]:
    """Rod force and torque ripple over speed and spring, with the springs that unload the rod, and the limit of
    the torque ripple [N.m].
    """
    x, present, title = r.plane.x.along, r.plane.machine, "The torque ripple"
    y = GridAxis("stiffness of the spring", "kN/m", 1e-3 * r.plane.y.along.values)
    nu = np.linspace(x.values[0], x.values[-1], CURVE_SPEEDS)
    formula = 1e-3 * present.m * nu**2
    inside = (y.values[0] <= formula) & (formula <= y.values[-1])
    curves = [Curve("formula (17)", nu[inside], formula[inside], "sky", "theory")]
    valley = r.valley()
    if valley:
        speeds, optima = zip(*valley)
        curves.append(Curve("smallest rod force", speeds, 1e-3 * np.array(optima), "sky", "points"))
    for name, machine in r.machines.items():
        label, color = SPRINGS[name]
        curves.append(Curve(label, [r.plane.speed], [1e-3 * machine.c], color, "points"))
    mark, ripple = [Mark(present.nu_res, f"resonance {present.nu_res:.4g} rad/s")], r.field("tau2")
    reached = np.nanmin(ripple) < limit < np.nanmax(ripple)
    level = [Level(limit, f"torque ripple of {limit:g} N.m")] if reached else []
    if valley:
        along = [float(abs(replace(present, c=c).torque_ripple(nu))) for nu, c in valley]
        title = f"With the springs that unload the rod the torque ripple is at most {max(along):.3g} N.m "
        title += f"by theory; on the map it is up to {np.nanmax(ripple):.3g} N.m"
    return [
        HeatMap(f"A spring of the map unloads the rod at {len(valley)} of {len(r.speeds)} speeds", x, y, "largest rod force [kN]",
              1e-3 * r.field("f_rod"), curves, log=True, marks=mark),
        HeatMap(title, x, y,
              "torque ripple [N.m]", ripple, curves, log=True, levels=level, marks=mark),
    ]  # fmt: skip
