"""The transfer functions of the sealing iron's mechanism, and how they change with its dimensions.

These are the functions of rocker, link and chain, and the terms of A_1 eps + B_1 w^2 = M + C_1 over the cam
angle. Machines that differ slightly show by how much each of them changes with each dimension.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, SetupError, System
from cosim.dense import Array as Samples
from cosim.metrics import largest, time_of_largest
from workbench import Chart, Context, Curve, Figure, Judgement, Panel, Table
from workbench.answer import parameters
from workbench.charts.model import FORCE, LIFT, POWER, SPEED, TORQUE
from workbench.figure import figure_of_columns
from workbench.study.charts import curves_over

from . import machine as iron

TABLE, SHARES = "iron_kinematics.csv", "iron_kinematics_shares.csv"
FUNCTIONS = {
    "alpha_1": ("alpha'", SPEED), "alpha_2": ("alpha''", TORQUE), "beta_1": ("beta'", SPEED),
    "beta_2": ("beta''", TORQUE), "H_1": ("H'", SPEED), "H_2": ("H''", TORQUE),
    "A_1": ("A_1", LIFT), "B_1": ("B_1", FORCE), "C_1": ("C_1", POWER),
}  # fmt: skip
GROUPS = {
    "rocker": ("alpha_1", "alpha_2"), "link": ("beta_1", "beta_2"), "chain": ("H_1", "H_2"),
    "acceleration's coefficient A_1": ("A_1",), "squared speed's coefficient B_1": ("B_1",),
    "torque of weights, spring, friction C_1": ("C_1",),
}  # fmt: skip
DIMENSIONS = {
    "cam.R_b": "cam to roller", "cam.h": "rise of the cam", "rocker.L": "cam to rocker",
    "rocker.l": "small arm", "rocker.l_K": "large arm", "rocker.alpha0": "angle of the arms",
    "link.l": "link", "chain.l": "chain", "sprocket.A": "sprocket, height",
    "sprocket.C": "sprocket, distance", "sprocket.R": "sprocket, radius",
}  # fmt: skip
#: The function whose changes rank the dimensions in the chart, that of the verdict; the table has the changes of all.
RANKING_FUNCTION = "H_1"
#: Inertia of a rotor that imposes the speed to 1e-5 [kg.m2]; it is taken out of A_1 again.
ROTOR = 1e3
#: Speed of the cam [rad/s], which the transfer functions do not depend on; a convention.
PACE = 4.0
#: Relative change of a dimension, whose halving shows the error of the derivative; a convention.
CHANGE = 2e-3
UNITS = {"dimension": "1", "function": "1", "change": "%", "change_error": "%"}


class DimensionEffect(NamedTuple):
    """By how much of its largest value [%] a function changes at most with a dimension 1 % longer."""

    dimension: str
    function: str
    change: float
    error: float


@dataclass(frozen=True)
class TransferFunctions:
    """The functions over the cam angle [deg], of shape (functions, rows), the share of each dimension, and of each
    function the largest absolute value and its angle.
    """

    result: Result
    phi: Samples
    values: Samples
    shares: Sequence[DimensionEffect]
    tops: Sequence[tuple[Figure, Figure]]

    @property
    def units(self) -> dict[str, str]:
        """The units of the functions."""
        return {name: self.result.units[f"iron.{name}"] for name in FUNCTIONS}

    def figures(self) -> dict[str, Figure]:
        """Return the largest value of each function, its angle, and the largest change."""
        all_figures = {}
        for name, (top, angle) in zip(FUNCTIONS, self.tops):
            key, what = name.lower(), f"largest absolute value of {FUNCTIONS[name][0]}"
            all_figures[f"{key}_max"] = top._replace(unit=self.units[name], meaning=what)
            all_figures[f"{key}_angle"] = angle._replace(meaning=f"cam angle of the {what}")
            all_figures[f"{key}_change"] = change(self.shares, name, 0)
        return all_figures | {"h_1_next": change(self.shares, "H_1", 1)}

    def tables(self) -> dict[str, Table]:
        """Return the functions over the cam angle, and the shares of the dimensions."""
        columns = {"phi": self.phi, **dict(zip(FUNCTIONS, self.values))}
        return {
            TABLE: Table(columns, {"phi": "deg"} | self.units),
            SHARES: Table.of_rows(self.shares, UNITS),
        }

    def judgements(self, f: Mapping[str, Figure]) -> list[Judgement]:
        """Return how the iron follows the cam, and which dimensions to make with care."""
        first, second = (DIMENSIONS[x.dimension] for x in ranked(self.shares, "H_1")[:2])
        return [
            Judgement("largest travel of the iron for a radian of the cam", f["h_1_max"]),
            Judgement(
                f"1 % of {first}, the dimension that changes it most, changes it by",
                f["h_1_change"],
            ),
            Judgement(f"1 % of {second}, the next, by", f["h_1_next"]),
        ]

    def charts(self) -> list[Chart]:
        """Return the functions over the cam angle, and which dimensions move the iron, the largest first."""
        panels = {x: {name: FUNCTIONS[name] for name in names} for x, names in GROUPS.items()}
        by_size = ranked(self.shares, RANKING_FUNCTION)
        labels = [DIMENSIONS[x.dimension] for x in by_size]
        changes, errors = zip(*((x.change, x.error) for x in by_size))
        bars = Curve("chain", labels, changes, LIFT, "bars", errors)
        spans = iron.phases(self.result.provenance["parts"]["iron"]["parameters"])
        over = "What a radian of the cam moves, and the terms of A_1 eps + B_1 w^2 = M + C_1"
        by = "What the iron's motion changes by for 1 % of a dimension"
        return [
            curves_over(
                self.tables()[TABLE], "phi", panels, over, x="cam angle [deg]", spans=spans
            ),
            Chart(by, "dimension", [Panel("largest change of H'", "%", [bars], includes=(0.0,))]),
        ]


def transfer_functions(context: Context, system: System, samples: int) -> TransferFunctions:
    """Run a turn, and four more for each dimension: by 0.2 % and by 0.4 % longer and shorter.

    Raises
    ------
    cosim.SetupError
        For a cam without a rise.
    """
    values = {x: float(parameters(system)[f"iron.{x}"].value) for x in DIMENSIONS}
    result, run = iron.turn(system, PACE, samples, ROTOR), partial(varied, system, samples)
    cases = [(x, k * CHANGE * values[x]) for x in DIMENSIONS for k in (1, -1, 2, -2)]
    turns = context.each(run, cases, "dimensions", probes=True)
    phi, function_values = np.linspace(0.0, 360.0, samples + 1), functions(system, result)
    tops = [
        (
            figure_of_columns(largest, phi, abs(y), unit="1"),
            figure_of_columns(time_of_largest, phi, abs(y), unit="deg"),
        )
        for y in function_values
    ]
    if not all(top.value for top, _ in tops):
        raise SetupError("iron.cam.h = 0 m: a cam without a rise moves nothing")
    shares = []
    for dimension in DIMENSIONS:
        near, far = (abs(next(turns) - next(turns)) / (2 * k * CHANGE) for k in (1, 2))
        for name, (top, _), fine, coarse in zip(FUNCTIONS, tops, near, far):
            share = figure_of_columns(largest, phi, fine, unit="1")
            error = abs(share.value - largest(phi, coarse)) + (share.error or 0.0)
            shares.append(
                DimensionEffect(dimension, name, share.value / top.value, error / top.value)
            )
    return TransferFunctions(result, phi, function_values, shares, tops)


def varied(system: System, samples: int, case: tuple[str, float]) -> Samples:
    """The functions of a machine with a dimension that is longer by so much [m or rad]."""
    name, longer = f"iron.{case[0]}", case[1]
    value = float(parameters(system)[name].value) + longer
    other = replace(system, start={**system.start, name: value})
    return functions(other, iron.turn(other, PACE, samples, ROTOR))


def functions(system: System, r: Result) -> Samples:
    """Evenly over the cam angle, of shape (functions, rows); A_1 with the machine's own rotor."""
    rotor, i_g = (float(parameters(system)[f"iron.reducer.{x}"].value) for x in ("J", "i_g"))
    columns = np.array([r[f"iron.{name}"] for name in FUNCTIONS])
    columns[list(FUNCTIONS).index("A_1")] -= (ROTOR - rotor) * i_g * i_g
    even = np.linspace(0.0, 2 * math.pi, columns.shape[1])
    return np.asarray(CubicSpline(r["iron.phi"], columns, axis=1)(even))


def ranked(shares: Sequence[DimensionEffect], name: str) -> list[DimensionEffect]:
    """The dimensions of a function, the one that changes it most first."""
    return sorted((x for x in shares if x.function == name), key=lambda x: -x.change)


def change(shares: Sequence[DimensionEffect], name: str, rank: int) -> Figure:
    """The change of a function by the dimension at this place of the ranking."""
    of_function, text = ranked(shares, name), FUNCTIONS[name][0]
    meaning = f"largest change of {text} for 1 % of {DIMENSIONS[of_function[rank].dimension]}"
    return Figure(of_function[rank].change, "%", of_function[rank].error, meaning)
