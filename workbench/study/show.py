"""What is shown of a study: figures over what varies, and what moves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from ..report.chart import SERIES, Chart, Curve, Direction, Field, Panel, Picture
from .plan import Study
from .table import ERROR

MOST = 6
KINDS = {"S1": "S1, alone", "ST": "ST, with all it acts together with"}


def overview(
    study: Study, table: pd.DataFrame, figures: Sequence[str], units: Mapping[str, str]
) -> list[Picture]:
    """Figures over one input, maps over two, or every figure over every input; none without numbers."""
    drawn = [name for name in figures if table[name].notna().any()][:MOST]
    numeric = [name for name in study.varied if pd.api.types.is_numeric_dtype(table[name])]
    grid = [name for name in study.grid if name in numeric]
    if not drawn:
        return []
    if study.tolerances and not study.grid:
        return [
            *(_scatter(table, x, drawn, units) for x in study.tolerances),
            _spread(table, drawn, units),
        ]
    if len(grid) == 2 == len(study.varied):
        return [_map(table, grid, name, units) for name in drawn]
    return [_curves(table, (grid or study.varied)[0], study.varied, drawn, units)]


def _label(name: str, units: Mapping[str, str]) -> str:
    return f"{name} [{units.get(name) or '1'}]"


def _panel(name: str, units: Mapping[str, str], curves: Sequence[Curve]) -> Panel:
    """A panel of a figure; 0 belongs to what lies between 0 and 1."""
    return Panel(name, units.get(name) or "1", curves, includes=(0.0, 1.0) if _flag(curves) else ())


def _flag(curves: Sequence[Curve]) -> bool:
    """Whether all is yes or no."""
    return all(
        set(np.asarray(curve.y, float)[np.isfinite(curve.y)]) <= {0.0, 1.0} for curve in curves
    )


def _curves(
    table: pd.DataFrame,
    x: str,
    varied: Sequence[str],
    figures: Sequence[str],
    units: Mapping[str, str],
) -> Chart:
    """Figures over one input: with their errors if it varies alone, else mean and 90 % band."""
    panels = []
    for name in figures:
        if len(varied) == 1:
            rows = table.sort_values(x)
            error = rows[name + ERROR].fillna(0.0).to_numpy() if name + ERROR in rows else None
            words = not pd.api.types.is_numeric_dtype(rows[x])
            places = [str(value) for value in rows[x]] if words else rows[x].to_list()
            curve = Curve(name, places, rows[name].to_numpy(), "blue", "linked", error)
            look = "bars" if words else "step" if _flag([curve]) else "linked"
            curves = [curve._replace(look=look)]
        else:
            groups = table.groupby(x, sort=False)[name]
            low, middle, high = groups.quantile(0.05), groups.mean(), groups.quantile(0.95)
            ends = np.stack([middle - low, high - middle])
            curves = [Curve("mean, and 90 % of the runs", list(middle.index), middle.to_numpy(), "blue",
                            "line", ends)]  # fmt: skip
        panels.append(_panel(name, units, curves))
    return Chart(f"Figures over {x}", _label(x, units), panels)


def _map(table: pd.DataFrame, grid: Sequence[str], name: str, units: Mapping[str, str]) -> Field:
    """A figure over two inputs."""
    square = table.pivot_table(index=grid[1], columns=grid[0], values=name, dropna=False)
    x, y = (
        Direction(at, units.get(at) or "1", values.to_numpy(dtype=float))
        for at, values in zip(grid, (square.columns, square.index))
    )
    return Field(name, x, y, _label(name, units), square.to_numpy())


def _scatter(
    table: pd.DataFrame, x: str, figures: Sequence[str], units: Mapping[str, str]
) -> Chart:
    """Every figure over an input."""
    panels = [
        _panel(
            name,
            units,
            [Curve(name, table[x].to_numpy(), table[name].to_numpy(), "blue", "points")],
        )
        for name in figures
    ]
    return Chart(f"Figures over {x}", _label(x, units), panels)


def _spread(table: pd.DataFrame, figures: Sequence[str], units: Mapping[str, str]) -> Chart:
    """How the runs are spread: every figure over the share of runs below it."""
    panels = []
    for name in figures:
        y = np.sort(table[name].dropna().to_numpy(dtype=float))
        share = 100 * (np.arange(len(y)) + 0.5) / len(y)
        panels.append(_panel(name, units, [Curve(name, share, y, "blue", "step")]))
    return Chart("Spread of the figures", "runs below [%]", panels)


def sensitivity(study: Study, found: pd.DataFrame, units: Mapping[str, str]) -> list[Picture]:
    """Shares with 95 % confidence: over the grid if it has one input, else as bars."""
    names = list(found["figure"].unique())[:MOST]
    over = next(iter(study.grid)) if len(study.grid) == 1 else ""
    panels = [
        Panel(f"share of {name}", "1", _shares(found[found["figure"] == name], over, list(study.tolerances)),
              includes=(0.0,))
        for name in names
    ]  # fmt: skip
    mean = f", mean over {', '.join(study.grid)}" if len(study.grid) > 1 else ""
    x = _label(over, units) if over else "input"
    return (
        [Chart(f"What moves the figures: shares of their variance{mean}", x, panels)]
        if names
        else []
    )


def _shares(found: pd.DataFrame, over: str, inputs: Sequence[str]) -> list[Curve]:
    """A bar per index and input, or the last index of each input over one of the grid; an index is
    a share, and not below 0 though its estimate may be."""
    curves = []
    if not over:
        for kind, color in zip(found["kind"].unique(), ("blue", "gold")):
            own = found[found["kind"] == kind].groupby("input")[["value", "confidence"]]
            told = own.mean().reindex(inputs)
            curves.append(_share(KINDS[kind], inputs, told, color, "bars"))
        return curves
    kind = found["kind"].iloc[-1]
    for name, color in zip(inputs, SERIES):
        own = found[(found["kind"] == kind) & (found["input"] == name)]
        curves.append(_share(f"{kind} of {name}", own[over].to_list(), own, color, "linked"))
    return curves


def _share(name: str, x: Sequence[str], told: pd.DataFrame, color: str, look: str) -> Curve:
    value = told["value"].clip(lower=0.0).to_numpy()
    error = told["confidence"].to_numpy()
    return Curve(name, x, value, color, look, np.stack([np.minimum(error, value), error]))
