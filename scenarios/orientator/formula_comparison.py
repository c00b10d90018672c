"""The fastest rotor for each cup and friction: the formula and its closed bound beside simulated limits, and
which dimension raises the limit most.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from cosim import SetupError, System
from cosim.dense import Array
from cosim.system import Value
from workbench import Chart, Context, Curve, Figure, Judgement, Panel, Table
from workbench.answer import parameters
from workbench.charts.motion import Motion
from workbench.figure import figure_of_figures, scaled
from workbench.orbits import orbit_figure
from workbench.plan import extreme

from .limit_formula import OrientatorParameters, rpm_of_squared
from .products import RPM, fastest, pair, simulated_limit

PLANE, RAISE = "orientator_limit.csv", "orientator_limit_dimensions.csv"
LIMIT_COLUMNS = {
    "d": "m", "h": "m", "mu": "1", "limit": "rpm", "error": "rpm", "formula": "rpm", "joint": "rpm",
}  # fmt: skip
RAISED = {"dimension": "1", "gain": "%", "gain_error": "%"}
LABELS = {
    "cup.d": "diameter of the cup", "cup.h": "height of the cup", "cup.l": "centre of mass",
    "catcher.l": "arm of the catcher", "catcher.h": "hook of the catcher",
    "catcher.phi": "angle of the catcher", "chute.R": "distance of the wall",
    "chute.H": "height of the fall",
}  # fmt: skip
LENGTHS = tuple(LABELS)
#: Relative change of a dimension on either side, whose halving shows the error of the derivative; a convention.
CHANGE = 0.02
#: Speeds at which the limit of a changed dimension is sought, over the unchanged limit, and their number; a
#: convention.
NEAR_LIMIT = (0.94, 1.06, 5)


def shell_cup(d: float, h: float) -> dict[str, Value]:
    """A drawn cup of this diameter and height of its cylinder [m]: a shell, its bottom thrice as thick
    as its wall, which is the one that gives 40 g to a cup of 40 mm and 48 mm.
    """
    r = d / 2
    m = 0.04 * r * (h + 3 * r) / (0.02 * 0.108)
    wall, end = m * h / (h + 3 * r), m * 3 * r / (h + 3 * r)
    l = (wall * h / 2 + end * (h + r / 2)) / m
    J = wall * (r * r / 2 + h * h / 12 + (l - h / 2) ** 2)
    J += end * (5 / 12 * r * r + (h + r / 2 - l) ** 2)
    return {f"orientator.cup.{name}": value for name, value in zip("dhlmJ", (d, h, l, m, J))}


CUPS: dict[str, tuple[dict[str, Value], str]] = {
    "cup of the FMU": ({}, "blue"),
    "short cup": (shell_cup(0.044, 0.040), "red"),
    "tall cup": (shell_cup(0.036, 0.056), "green"),
}


@dataclass(frozen=True)
class FormulaComparison:
    """Limits by formula and simulation: figures, the plane of cups and frictions, gains of the dimensions."""

    base: System
    friction: float
    frictions: Sequence[float]
    figures: Mapping[str, Figure]
    tables: Mapping[str, Table]

    def judgements(self) -> list[Judgement]:
        """Return how fast the rotor may turn, how well the formula gives it, and what moves it most."""
        f, located = self.figures, self.tables[PLANE].frame["limit"].notna()
        pairs = f"{located.sum()} of {len(located)} pairs of cup and friction that have a limit"
        gains = {name: f[gain_name(name)] for name in LENGTHS}
        name, most = max(gains.items(), key=lambda item: np.nan_to_num(abs(item[1].value)))
        what = f"1 % more of {name}, the dimension that moves the limit most, changes it by"
        if most.error is None:
            what = "dimension that moves the limit most"
            most = Figure.undetermined("%", f"no limit of {', '.join(LENGTHS)} was found")
        return [
            Judgement(f"with friction {self.friction:g} the rotor may turn at up to", f["limit"]),
            Judgement("by the limit formula", f["formula"]),
            Judgement(f"largest error of the formula for {pairs}", f["off"]),
            Judgement(what, most),
        ]

    def charts(self) -> list[Chart]:
        """Return the limits over friction, how far the formula is off, and what each dimension gains."""
        return [self.limit_chart(), self.gain_chart()]

    def limit_chart(self) -> Chart:
        """Return the limits over friction, and how far the formula is off."""
        plane, size = self.tables[PLANE].frame, len(self.frictions)
        speeds, offs = [], []
        for k, (name, (_, color)) in enumerate(CUPS.items()):
            x = plane[k * size : (k + 1) * size]
            mu, n = x["mu"].to_numpy(), x["limit"].to_numpy()
            speeds += [
                Curve(name, mu, n, color, "points", x["error"].to_numpy()),
                Curve(f"{name}, formula", mu, x["formula"].to_numpy(), color),
                Curve(f"{name}, bound", mu, x["joint"].to_numpy(), color, "theory"),
            ]
            difference, wide = 100 * (x["formula"] / n - 1), 100 * x["error"] / n
            offs.append(Curve(name, mu, difference.to_numpy(), color, "linked", wide.to_numpy()))
        panels = [
            Panel("fastest rotor", "rpm", speeds, includes=(0.0,)),
            Panel("error of the formula", "%", offs),
        ]
        return Chart("Rotor speed up to which cups are oriented", "friction on the wall", panels)

    def gain_chart(self) -> Chart:
        """Return what each dimension gains."""
        frame = self.tables[RAISE].frame
        frame = frame.sort_values("gain", key=abs, ascending=False)
        names, gains, errors = (frame[x].to_list() for x in RAISED)
        names = [LABELS[name] for name in names]
        bars = Curve("simulated", names, gains, "blue", "bars", errors)
        title = f"Gain from 1 % more of each dimension at friction {self.friction:g}"
        return Chart(title, "dimension", [Panel("change of the limit", "%", [bars])])

    def motions(self) -> list[Motion]:
        """Return the last cup that is oriented beside the first that jams."""
        limit = self.figures["limit"]
        if limit.error is None:
            return []
        return [pair(self.base, self.friction, limit.value, limit.value + limit.error)]


def compare_with_formula(
    context: Context, base: System, friction: float, frictions: Sequence[float]
) -> FormulaComparison:
    """Compare limits over the plane, and those with every dimension a little smaller and larger."""
    cups = [replace(base, start={**base.start, **cup}) for cup, _ in CUPS.values()]
    cases = [(system, mu) for system in cups for mu in frictions]
    rows = context.each(limit_row, cases, "limits", probes=True)
    plane = context.record_rows(PLANE, LIMIT_COLUMNS, rows)
    ((machine, located),) = context.each(
        partial(simulated_limit, base), [friction], "limit", probes=True
    )
    if located.error is None:
        raise SetupError(f"friction = {friction:g}: {located.reason}: there is no limit to compare")
    around = partial(gain_of, base, friction, np.linspace(*NEAR_LIMIT) * located.value / RPM)
    gains = dict(zip(LENGTHS, context.each(around, LENGTHS, "dimensions", probes=True)))
    by_dimension: Any = ((name, x.value, x.known_error) for name, x in gains.items())
    tables = {PLANE: plane, RAISE: Table.of_rows(by_dimension, RAISED)}
    all_figures = figures(plane.frame, machine, located)
    all_figures |= {gain_name(name): x for name, x in gains.items()}
    return FormulaComparison(base, friction, frictions, all_figures, tables)


def limit_row(case: tuple[System, float]) -> Sequence[float]:
    """A row of the plane; a limit that is not found is nan."""
    system, mu = case
    machine, limit_figure = simulated_limit(system, mu)
    formula, joint = rpm_of_squared(machine.limit()[0]), rpm_of_squared(machine.joint_limit)
    return machine.d, machine.h, mu, limit_figure.value, limit_figure.known_error, formula, joint


def gain_of(base: System, mu: float, speeds: Array, name: str) -> Figure:
    """By how much the limit rises for 1 % more of a dimension; the limits are sought at these speeds [rad/s]."""
    key = f"orientator.{name}"
    value = float(parameters(base)[key].value)

    def slope(change: float) -> Figure:
        up, down = (
            fastest(replace(base, start={**base.start, key: value * x}), mu, speeds)
            for x in (1 + change, 1 - change)
        )
        width = math.log((1 + change) / (1 - change))
        return figure_of_figures(lambda a, b: np.log(a / b) / width, up, down, unit="%")

    wide, narrow = slope(CHANGE), slope(CHANGE / 2)
    meaning = f"change of the limit for 1 % more of {name}"
    if wide.error is None or narrow.error is None:
        return Figure.undetermined("%", "one of the limits was not found", meaning)
    error = wide.error + abs(wide.value - narrow.value)
    return wide._replace(error=error, meaning=meaning)


def figures(plane: Any, machine: OrientatorParameters, limit_figure: Figure) -> dict[str, Figure]:
    """The limit of the FMU's cup, how far formula and bound are off, and the closed bound."""
    formula, bound = (100 * (plane[x] / plane["limit"] - 1) for x in ("formula", "joint"))
    off, over = (
        100 * plane[x] * plane["error"] / plane["limit"] ** 2 for x in ("formula", "joint")
    )
    by_formula = Figure(rpm_of_squared(machine.limit()[0]), "rpm", 0.0, "the same by the formula")
    if not by_formula.value > 0.0:
        why = "the formula finds none"
        by_formula = Figure.undetermined("rpm", why, by_formula.meaning)
    joint = rpm_of_squared(machine.joint_limit)
    return {
        "limit": limit_figure,
        "formula": by_formula,
        "joint": Figure(joint, "rpm", 0.0, "closed bound: stage joint comes to its end"),
        "off": largest_of(formula.abs(), off, "largest difference between formula and simulation"),
        "above_least": scaled(
            largest_of(-bound, over, ""), -1.0, "%", "smallest excess of the closed bound over the limits"
        ),
        "above_most": largest_of(bound, over, "largest excess of the closed bound over the limits"),
    }  # fmt: skip


def gain_name(dimension: str) -> str:
    """The name of the figure of a dimension, "gain_cup_d"."""
    return f"gain_{dimension.replace('.', '_').lower()}"


def largest_of(values: Any, errors: Any, meaning: str) -> Figure:
    """The largest of these values; its error is how much each of them might be further out."""
    largest = extreme(values.to_numpy(), errors.to_numpy())
    return orbit_figure(*largest, "%", meaning, "no limit was found")
