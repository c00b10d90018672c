"""How does the sealing iron's mechanism transmit the motion of its cam, and which dimension matters?

The answer gives the transfer functions of rocker, link and chain and the terms of
A_1 eps + B_1 w^2 = M + C_1 over the cam angle. Machines that differ slightly show by how much each of
them changes with each dimension.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
import workbench
from cosim import Result, SetupError, System
from workbench import Chart, Context, Curve, Figure, Findings, Panel, Show, Table, option
from workbench.answer import parameters
from workbench.charts.model import FORCE, LIFT, POWER, SPEED, TORQUE
from workbench.measure import Samples, largest

from .. import machine as iron
from .. import motion

PARTS = {"iron": "IronDrive"}
FIXED_STARTS = iron.IMPOSED
FUNCTIONS = {
    "alpha_1": ("alpha'", SPEED), "alpha_2": ("alpha''", TORQUE), "beta_1": ("beta'", SPEED),
    "beta_2": ("beta''", TORQUE), "H_1": ("H'", SPEED), "H_2": ("H''", TORQUE),
    "A_1": ("A_1", LIFT), "B_1": ("B_1", FORCE), "C_1": ("C_1", POWER),
}  # fmt: skip
GROUPS = {
    "rocker": ("alpha_1", "alpha_2"), "link": ("beta_1", "beta_2"), "chain": ("H_1", "H_2"),
    "A_1": ("A_1",), "B_1": ("B_1",), "C_1": ("C_1",),
}  # fmt: skip
DIMENSIONS = {
    "cam.R_b": "R_b", "cam.h": "h", "rocker.L": "L", "rocker.l": "l", "rocker.l_K": "l_K",
    "rocker.alpha0": "alpha0", "link.l": "l_T", "chain.l": "l_c", "sprocket.A": "A",
    "sprocket.C": "C", "sprocket.R": "R_z",
}  # fmt: skip
#: Inertia of a rotor that imposes the speed [kg.m2]; it is taken out of A_1 again.
ROTOR = 1e3
#: Speed of the cam [rad/s], which the transfer functions do not depend on; a convention.
PACE = 4.0
#: Relative change of a dimension, whose halving shows the error of the derivative; a convention.
CHANGE = 2e-3
UNITS = {"dimension": "1", "function": "1", "change": "%", "change_error": "%"}


class Share(NamedTuple):
    """By how much of its largest value [%] a function changes at most with a dimension 1 % longer."""

    dimension: str
    function: str
    change: float
    error: float


Data = tuple[Result, System, Samples, Samples, list[Share]]


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    samples: int = option(720, "rows per turn", least=72)


def solve(o: Options, context: Context) -> Findings:
    """A turn, and four more for each dimension: by 0.2 % and by 0.4 % longer and shorter."""
    system = System(context.fmus, start=o.start)
    values = {x: float(parameters(system)[f"iron.{x}"].value) for x in DIMENSIONS}
    result, run = turn(system, o.samples), partial(varied, system, o.samples)
    cases = [(x, k * CHANGE * values[x]) for x in DIMENSIONS for k in (1, -1, 2, -2)]
    turns = context.each(run, cases, "dimensions", probes=True)
    phi, function_values = np.linspace(0.0, 360.0, o.samples + 1), functions(system, result)
    tops = [largest(phi, abs(y)) for y in function_values]
    if not all(top.value for top in tops):
        raise SetupError("iron.cam.h = 0 m: a cam without a rise moves nothing")
    shares = []
    for dimension in DIMENSIONS:
        near, far = (abs(next(turns) - next(turns)) / (2 * k * CHANGE) for k in (1, 2))
        for name, top, fine, coarse in zip(FUNCTIONS, tops, near, far):
            share, coarse_share = (largest(phi, y) for y in (fine, coarse))
            error = abs(share.value - coarse_share.value) + share.error
            shares.append(Share(dimension, name, share.value / top.value, error / top.value))
    units, all_figures = {name: result.units[f"iron.{name}"] for name in FUNCTIONS}, {}
    for name, top in zip(FUNCTIONS, tops):
        key, what = name.lower(), f"largest absolute value of {FUNCTIONS[name][0]}"
        all_figures[f"{key}_max"] = top.figure(units[name], what)
        all_figures[f"{key}_angle"] = top.at.figure("deg", f"cam angle of the {what}")
        all_figures[f"{key}_change"] = change(shares, name, 0)
    all_figures["h_1_next"] = change(shares, "H_1", 1)
    rows = Table.of_rows(np.column_stack([phi, *function_values]).tolist(), {"phi": "deg"} | units)
    tables = {
        "iron_kinematics.csv": rows,
        "iron_kinematics_shares.csv": Table.of_rows(shares, UNITS),
    }
    step, data = f"{o.samples} steps in a turn", (result, system, phi, function_values, shares)
    return Findings(all_figures, data, system, result.provenance, step, tables=tables)


def turn(system: System, samples: int) -> Result:
    """A turn with a rotor of 1000 kg.m2, which keeps it even to 1e-5."""
    h = 2 * math.pi / (PACE * samples)
    return cosim.run(iron.imposed(system, PACE, ROTOR), stop=h * samples, step=h)


def varied(system: System, samples: int, case: tuple[str, float]) -> Samples:
    """The functions of a machine with a dimension that is longer by so much [m or rad]."""
    name, longer = f"iron.{case[0]}", case[1]
    value = float(parameters(system)[name].value) + longer
    other = replace(system, start={**system.start, name: value})
    return functions(other, turn(other, samples))


def functions(system: System, r: Result) -> Samples:
    """Evenly over the cam angle, of shape (functions, rows); A_1 with the machine's own rotor."""
    rotor, i_g = (float(parameters(system)[f"iron.reducer.{x}"].value) for x in ("J", "i_g"))
    columns = np.array([r[f"iron.{name}"] for name in FUNCTIONS])
    columns[list(FUNCTIONS).index("A_1")] -= (ROTOR - rotor) * i_g * i_g
    even = np.linspace(0.0, 2 * math.pi, columns.shape[1])
    return np.asarray(CubicSpline(r["iron.phi"], columns, axis=1)(even))


def ranked(shares: Sequence[Share], name: str) -> list[Share]:
    """The dimensions of a function, the one that changes it most first."""
    return sorted((x for x in shares if x.function == name), key=lambda x: -x.change)


def change(shares: Sequence[Share], name: str, rank: int) -> Figure:
    """The change of a function by the dimension at this place of the ranking."""
    of_function, text = ranked(shares, name), FUNCTIONS[name][0]
    meaning = f"largest change of {text} for 1 % of {of_function[rank].dimension}"
    return Figure(of_function[rank].change, "%", of_function[rank].error, meaning)


def verdict(o: Options, f: Mapping[str, Figure], r: Data) -> str:
    """How the iron follows the cam, and which dimension to make with care."""
    texts = {name: figure.text() for name, figure in f.items()}
    first, second = ranked(r[4], "H_1")[:2]
    return (
        f"A radian of the cam moves the iron by up to {texts['h_1_max']}, at a cam angle of "
        f"{texts['h_1_angle']}, and turns the rocker by up to {texts['alpha_1_max']} rad. The motion of the "
        f"iron depends most on {first.dimension}: 1 % of it changes the motion by up to "
        f"{texts['h_1_change']} of its largest value. Next is {second.dimension}, with {texts['h_1_next']}."
    )


def show(o: Options, f: Mapping[str, Figure], r: Data) -> Show:
    """The functions over the cam angle, the shares of the dimensions, the mechanism in motion."""
    result, system, phi, function_values, shares = r
    rows, panels, bars = dict(zip(FUNCTIONS, function_values)), [], []
    for group, names in GROUPS.items():
        lines, columns = [], []
        for name in names:
            text, color = FUNCTIONS[name]
            of_function = [x for x in shares if x.function == name]
            where = [DIMENSIONS[x.dimension] for x in of_function]
            changes, errors = [x.change for x in of_function], [x.error for x in of_function]
            lines.append(Curve(text, phi, rows[name], color))
            columns.append(Curve(text, where, changes, color, "bars", errors))
        panels.append(Panel(group, result.units[f"iron.{names[0]}"], lines))
        bars.append(Panel(group, "%", columns, includes=(0.0,)))
    spans = iron.phases(result.provenance["parts"]["iron"]["parameters"])
    title = "What a radian of the cam moves, and the terms of A_1 eps + B_1 w^2 = M + C_1"
    over = Chart(title, "cam angle [deg]", panels, spans=spans)
    title = "Largest change for 1 % of a dimension, as a share of the largest value"
    moving = motion.motion("One turn of the cam", result, system, result["time"][-1], 2.0)
    return Show([over, Chart(title, "dimension", bars)], [moving])
