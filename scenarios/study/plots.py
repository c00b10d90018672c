"""Pictures of a study: figures over what varies, and what moves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ..plots import MARK, SPEED, THEORY, TORQUE, pyplot, save
from .plan import Study
from .table import ERROR

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST = 6
COLORS = (SPEED, TORQUE, MARK, THEORY)


def draw(
    folder: Path,
    study: Study,
    table: pd.DataFrame,
    figures: Sequence[str],
    units: Mapping[str, str],
    found: pd.DataFrame,
) -> list[str]:
    """Write the pictures that this study allows; their names."""
    drawn = [name for name in figures if table[name].notna().any()][:MOST]
    if not drawn:
        return []
    numeric = [name for name in study.varied if pd.api.types.is_numeric_dtype(table[name])]
    grid = [name for name in study.grid if name in numeric]
    if study.tolerances and not study.grid:
        picture = _scatter(table, list(study.tolerances), drawn, units)
    elif len(grid) == 2 == len(study.varied):
        picture = _maps(table, grid, drawn, units)
    else:
        picture = _curves(table, (grid or study.varied)[0], study.varied, drawn, units)
    picture.suptitle(f"{study.name}: {study.scenario}, {len(table)} runs")
    save(picture, folder / "overview.png")
    if found.empty:
        return ["overview.png"]
    save(_sensitivity(study, found, drawn, units), folder / "sensitivity.png")
    return ["overview.png", "sensitivity.png"]


def _label(name: str, units: Mapping[str, str]) -> str:
    return f"{name}  [{units[name]}]" if units.get(name, "1") not in ("", "1") else name


def _curves(
    table: pd.DataFrame,
    x: str,
    varied: Sequence[str],
    figures: Sequence[str],
    units: Mapping[str, str],
) -> Any:
    """Figures over one input: with coupling errors if it varies alone, else mean and 90 % band."""
    picture, axes = pyplot().subplots(
        len(figures), 1, figsize=(8, 1.5 + 2.4 * len(figures)), sharex=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for axis, name in zip(axes[:, 0], figures):
        if len(varied) == 1:
            error = table.get(name + ERROR)
            axis.errorbar(table[x], table[name], error, fmt="o-", color=SPEED, markersize=4)
        else:
            groups = table.groupby(x, sort=False)[name]
            low, middle, high = groups.quantile(0.05), groups.mean(), groups.quantile(0.95)
            places = list(middle.index)
            axis.fill_between(places, low, high, color=SPEED, alpha=0.25, label="90 % of the runs")
            axis.plot(places, middle, "o-", color=SPEED, markersize=4, label="mean")
            axis.legend()
        axis.set_ylabel(_label(name, units))
    axes[-1, 0].set_xlabel(_label(x, units))
    return picture


def _maps(
    table: pd.DataFrame, grid: Sequence[str], figures: Sequence[str], units: Mapping[str, str]
) -> Any:
    """Figures over two inputs."""
    columns = min(len(figures), 2)
    lines = -(-len(figures) // columns)
    picture, axes = pyplot().subplots(
        lines, columns, figsize=(5.5 * columns, 0.6 + 4.2 * lines), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for axis in axes.flat[len(figures) :]:
        axis.set_visible(False)
    for axis, name in zip(axes.flat, figures):
        square = table.pivot_table(index=grid[1], columns=grid[0], values=name, dropna=False)
        x, y = square.columns.to_numpy(dtype=float), square.index.to_numpy(dtype=float)
        mesh = axis.pcolormesh(x, y, square.to_numpy(), shading="nearest")
        axis.set(xlabel=_label(grid[0], units), ylabel=_label(grid[1], units))
        axis.grid(visible=False)
        picture.colorbar(mesh, ax=axis, label=_label(name, units))
    return picture


def _scatter(
    table: pd.DataFrame, inputs: Sequence[str], figures: Sequence[str], units: Mapping[str, str]
) -> Any:
    """Every figure over every input, and its distribution."""
    count = len(inputs)
    picture, axes = pyplot().subplots(
        len(figures), count + 1, figsize=(1.5 + 2.4 * (count + 1), 1 + 2.2 * len(figures)),
        sharey="row", squeeze=False, layout="constrained",
    )  # fmt: skip
    for line, name in zip(axes, figures):
        for axis, x in zip(line, inputs):
            axis.plot(table[x], table[name], ".", color=SPEED, markersize=3, alpha=0.5)
        line[-1].hist(table[name].dropna(), bins=24, orientation="horizontal", color=SPEED)
        line[0].set_ylabel(_label(name, units))
    for axis, x in zip(axes[-1], inputs):
        axis.set_xlabel(_label(x, units))
    axes[-1, -1].set_xlabel("runs")
    return picture


def _sensitivity(
    study: Study, found: pd.DataFrame, figures: Sequence[str], units: Mapping[str, str]
) -> Any:
    """Shares with 95 % confidence: over the grid if it has one input, else as bars."""
    drawn = [name for name in figures if (found["figure"] == name).any()]
    inputs = list(study.tolerances)
    over = next(iter(study.grid)) if len(study.grid) == 1 else None
    picture, axes = pyplot().subplots(
        len(drawn), 1, figsize=(max(7.0, 2 + 1.4 * len(inputs)), 1.2 + 2.2 * len(drawn)),
        sharex=True, squeeze=False, layout="constrained",
    )  # fmt: skip
    for axis, name in zip(axes[:, 0], drawn):
        own = found[found["figure"] == name]
        if over is None:
            _bars(axis, own, inputs)
        else:
            _lines(axis, own, over, inputs)
        axis.axhline(0.0, color="black", linewidth=0.8)
        axis.set_ylabel(f"share of variance\nof {name}")
    axes[0, 0].legend()
    if over is None:
        axes[-1, 0].set_xticks(np.arange(len(inputs)), inputs)
    else:
        axes[-1, 0].set_xlabel(_label(over, units))
    mean = f"\nmean over {', '.join(study.grid)}" if len(study.grid) > 1 else ""
    picture.suptitle(f"{study.name}: what moves the figures{mean}")
    return picture


def _bars(axis: Axes, found: pd.DataFrame, inputs: Sequence[str]) -> None:
    """A bar per index and input."""
    kinds = list(found["kind"].unique())
    width = 0.8 / len(kinds)
    for k, kind in enumerate(kinds):
        own = found[found["kind"] == kind].groupby("input")[["value", "confidence"]]
        told = own.mean().reindex(inputs)
        places = np.arange(len(inputs)) + (k - (len(kinds) - 1) / 2) * width
        label = {"S1": "S1, alone", "ST": "ST, with all it acts together with"}[kind]
        axis.bar(
            places, told["value"], width, yerr=told["confidence"], capsize=3, color=COLORS[k],
            label=label,
        )  # fmt: skip


def _lines(axis: Axes, found: pd.DataFrame, over: str, inputs: Sequence[str]) -> None:
    """The last index of each input over one of the grid."""
    kind = found["kind"].iloc[-1]
    for name in inputs:
        own = found[(found["kind"] == kind) & (found["input"] == name)]
        axis.errorbar(
            own[over], own["value"], own["confidence"], fmt="o-", markersize=4, capsize=3,
            label=f"{kind} of {name}",
        )  # fmt: skip
