"""What is shown of a study: figures over what varies, and what moves them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..answer import Table
from ..charts.model import (
    SERIES,
    Chart,
    Curve,
    CurveLook,
    GridAxis,
    HeatMap,
    Look,
    Mark,
    NamedLook,
    Panel,
    Picture,
    SecondUnit,
)
from ..plan import Plan

#: Figures of a study that are drawn; chosen: as many panels as a page shows.
MAX_CHARTS = 6
#: Inputs that a map is over: derived, a plane has two axes.
MAP_INPUTS = 2
#: Values of a curve that have points; chosen: more run into each other.
MOST_LINKED = 40
ERROR = "_error"
KINDS = {"S1": "S1, alone", "ST": "ST, with all interactions"}
Units = Mapping[str, str]


def overview(
    plan: Plan, table: pd.DataFrame, figures: Sequence[str], units: Units
) -> list[Picture]:
    """Figures over one input, maps over two, or every figure over every input; none without numbers."""
    names = [name for name in figures if table[name].notna().any()][:MAX_CHARTS]
    grid = [name for name in plan.grid if pd.api.types.is_numeric_dtype(table[name])]
    if not names:
        return []
    if len(grid) == len(plan.varied) == MAP_INPUTS:
        return [heat_map(table, grid, name, units) for name in names]

    def chart(title: str, x: str, curve: Callable[[str], Curve]) -> Chart:
        panels = []
        for name in names:
            curve_of_figure = curve(name)
            includes = (0.0, 1.0) if is_flag(curve_of_figure.y) else ()
            panels.append(Panel(name, units.get(name) or "1", [curve_of_figure], includes=includes))
        return Chart(title, x, panels)

    if not plan.varied:
        return []
    if plan.tolerances and not plan.grid:
        return [
            *(
                chart(f"Figures over {x}", _label(x, units), partial(_points, table, x))
                for x in plan.tolerances
            ),
            chart("Spread of the figures", "runs below [%]", partial(distribution_curve, table)),
        ]
    x = (grid or plan.varied)[0]
    curve = partial(_line if len(plan.varied) == 1 else _band, table, x)
    log = bool(grid) and is_geometric(table[x].unique())
    return [chart(f"Figures over {x}", _label(x, units), curve)._replace(log=log)]


def _label(name: str, units: Units) -> str:
    return f"{name} [{units.get(name) or '1'}]"


def is_geometric(values: npt.ArrayLike) -> bool:
    """Whether three values or more follow each other by one factor, as those of an axis with spacing "log" do."""
    x = np.unique(np.asarray(values, float))
    ratios = x[1:] / x[:-1] if x.size and x[0] > 0.0 else x[:0]
    return len(ratios) > 1 and bool(np.allclose(ratios, ratios[0], rtol=1e-6))


def is_flag(y: object) -> bool:
    """Whether all is yes or no."""
    values = np.asarray(y, float)
    return set(values[np.isfinite(values)]) <= {0.0, 1.0}


def _line(table: pd.DataFrame, x: str, name: str) -> Curve:
    """A figure with its errors over the only input, in its order; over names as bars."""
    numeric = pd.api.types.is_numeric_dtype(table[x])
    rows = table.sort_values(x) if numeric else table
    look: Look = "bars" if not numeric else "step" if is_flag(rows[name]) else "linked"
    error = rows[name + ERROR].fillna(0.0).to_numpy() if name + ERROR in rows else None
    return Curve(name, rows[x].to_list(), rows[name].to_numpy(), "blue", look, error)


def _band(table: pd.DataFrame, x: str, name: str) -> Curve:
    """Mean and 90 % band of a figure over an input."""
    groups = table.groupby(x, sort=False)[name]
    middle = groups.mean()
    ends = np.stack([middle - groups.quantile(0.05), groups.quantile(0.95) - middle])
    title = "mean, and 90 % of the runs"
    return Curve(title, list(middle.index), middle.to_numpy(), "blue", "line", ends)


def _points(table: pd.DataFrame, x: str, name: str) -> Curve:
    """A figure over an input."""
    return Curve(name, table[x].to_numpy(), table[name].to_numpy(), "blue", "points")


def distribution_curve(table: pd.DataFrame, name: str) -> Curve:
    """A figure over the share of runs below it."""
    y = np.sort(table[name].dropna().to_numpy(dtype=float))
    return Curve(name, 100 * (np.arange(len(y)) + 0.5) / len(y), y, "blue", "step")


def curves_over(
    table: Table,
    over: str,
    panels: Mapping[str, Mapping[str, CurveLook]],
    title: str,
    *,
    theory: Table | None = None,
    levels: Mapping[str, Sequence[Mark]] = MappingProxyType({}),
    **more: Any,
) -> Chart:
    """Return columns of a table over another one, as points where they have errors.

    Parameters
    ----------
    table
        The columns; those with errors are points.
    over
        The column on the axis; one in rad/s has rpm as its second unit.
    panels
        By quantity and column what each is: a text, which may have a colour and a look.
    title
        The title of the chart.
    theory
        Columns at more places, drawn as theory in place of those of the table.
    levels
        Those of panels by their quantity.
    more
        Further fields of the chart, such as its marks and the label `x` of its axis.
    """
    of_panels = []
    for quantity, names in panels.items():
        curves = []
        for (name, text), color in zip(names.items(), SERIES):
            source = theory if theory and name in theory.columns else table
            error = source.columns.get(f"{name}{ERROR}")
            look: Look = "line" if len(source) > MOST_LINKED else "linked"
            look = "theory" if source is theory else look if error is None else "points"
            given = (text,) if isinstance(text, str) else text
            named = NamedLook.of((*given, *(color, look)[len(given) - 1 :]), quantity)
            curves.append(
                Curve(
                    named.name, source.columns[over], source.columns[name], named.color, named.look,
                    None if named.look == "theory" else error,
                )
            )  # fmt: skip
        unit = table.units[next(iter(names))]
        of_panels.append(Panel(quantity, unit, curves, levels.get(quantity, ())))
    second = SecondUnit("rpm", 30.0 / math.pi) if table.units[over] == "rad/s" else None
    label = _label(over, table.units)
    return Chart(title, label, of_panels, second=second)._replace(**more)


def heat_map(
    table: pd.DataFrame, grid: Sequence[str], name: str, units: Units, **more: Any
) -> HeatMap:
    """Return a figure over two inputs, with `more` of a heat map."""
    square = table.pivot_table(index=grid[1], columns=grid[0], values=name, dropna=False)
    x, y = (
        GridAxis(at, units.get(at) or "1", values, is_geometric(values))
        for at, values in zip(
            grid, (axis.to_numpy(dtype=float) for axis in (square.columns, square.index))
        )
    )
    whole = {"title": name, "quantity": _label(name, units), **more}
    return HeatMap(x=x, y=y, values=square.to_numpy(), **whole)


def sensitivity(plan: Plan, indices: pd.DataFrame, units: Units) -> list[Picture]:
    """Return the shares of the inputs with 95 % confidence.

    They stand over the grid if it has one input, the last index of each; else as bars, a mean over it.
    """
    over = next(iter(plan.grid)) if len(plan.grid) == 1 else ""
    panels = []
    for name, figure_rows in list(indices.groupby("figure", sort=False))[:MAX_CHARTS]:
        if over:
            kind = figure_rows["kind"].iloc[-1]
            inputs = figure_rows[figure_rows["kind"] == kind].groupby("input", sort=False)
            curves = [
                _shares(f"{kind} of {x}", rows[over].to_list(), rows, color, "linked")
                for (x, rows), color in zip(inputs, SERIES)
            ]
        else:
            means = figure_rows.groupby(["kind", "input"])[["value", "confidence"]].mean()
            names = list(plan.tolerances)
            curves = [
                _shares(KINDS[kind], names, means.loc[kind].reindex(names), color, "bars")
                for kind, color in zip(figure_rows["kind"].unique(), ("blue", "gold"))
            ]
        panels.append(Panel(f"share of {name}", "1", curves, includes=(0.0,)))
    mean = f", mean over {', '.join(plan.grid)}" if len(plan.grid) > 1 else ""
    title = f"What moves the figures: shares of their variance{mean}"
    return [Chart(title, _label(over, units) if over else "input", panels)]


def _shares(name: str, x: Sequence[str], indices: pd.DataFrame, color: str, look: Look) -> Curve:
    """Shares with their intervals; an index is not below 0, though its estimate may be."""
    value = indices["value"].clip(lower=0.0).to_numpy()
    error = indices["confidence"].to_numpy()
    return Curve(name, x, value, color, look, np.stack([np.minimum(error, value), error]))
