"""The picture of a resonance map: gain and ridges, probability of too much ripple, the range."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..plots import pyplot, save
from .plane import Axis
from .survey import Row, Survey

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Real = NDArray[np.float64]
LIMIT, RANGE, RISK = "white", "#2e8b57", "#c0392b"
GAINS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)
SHARES = (0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 1.0)
RIDGES = {
    "formula": ("black", "--", "formula (22): 90° lag"),
    "lag_90": ("#00a5e0", "o", "90° lag, co-simulated"),
    "peak": ("black", "^", "largest torque ripple, co-simulated"),
}


def resonance_map(
    path: Path,
    survey: Survey,
    rows: Sequence[Row],
    probability: Real,
    in_range: Real,
    limit: float,
    within: tuple[float, float] | None,
    headline: str,
) -> None:
    """Gain with its ridges; probability at each point; and, over speed, in the operating range."""
    plane, widths = survey.plane, (5, 5, 1.6) if within else (1, 1)
    figure, panels = pyplot().subplots(
        1, len(widths), figsize=(11, 5.5), sharey=True, width_ratios=widths, layout="constrained"
    )
    gain(panels[0], survey, rows)
    risk(panels[1], survey, rows, probability, limit)
    for axes in panels[:2]:
        ripple(axes, survey, limit)
        axes.set_xlabel(plane.x.label)
        axes.grid(False)
        scale(axes, plane.x, "x")
        for end in within or ():
            axes.axvline(end, color=RANGE, linewidth=2)
        if within:
            text = f"operating range {within[0]:g} .. {within[1]:g} rad/s"
            axes.plot([], [], color=RANGE, linewidth=2, label=text)
        axes.legend(
            loc="upper right", fontsize=8, frameon=True, facecolor="#d9d4df", framealpha=0.9
        )
    if within:
        beside(panels[2], plane.y.values, in_range, within)
    panels[0].set_ylabel(plane.y.label)
    scale(panels[0], plane.y, "y")
    figure.suptitle(headline, fontsize=12, fontweight="bold")
    save(figure, path)


def gain(axes: Axes, survey: Survey, rows: Sequence[Row]) -> None:
    """The gain in colour, and the three ridges."""
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FuncFormatter, NullLocator

    values = survey.gain
    levels = np.geomspace(np.nanmin(values), np.nanmax(values), 25)
    x, y = survey.plane.x.values, survey.plane.y.values
    shown = axes.contourf(x, y, values, levels, norm=LogNorm(), cmap="magma")
    bar = axes.figure.colorbar(shown, ax=axes, location="bottom", shrink=0.9, aspect=35)
    bar.set_ticks([g for g in GAINS if levels[0] <= g <= levels[-1]])
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda g, _: f"{g:g}"))
    bar.ax.xaxis.set_minor_locator(NullLocator())
    bar.set_label("torque ripple over load ripple, order 2")
    axes.set_title("How much the drive magnifies the load's ripple")
    for place in RIDGES:
        ridge(axes, rows, place)


def risk(axes: Axes, survey: Survey, rows: Sequence[Row], probability: Real, limit: float) -> None:
    """The probability in colour; what is below the first level stays white."""
    from matplotlib.ticker import PercentFormatter

    x, y = survey.plane.x.values, survey.plane.y.values
    shown = axes.contourf(x, y, probability, SHARES, cmap="YlOrRd")
    bar = axes.figure.colorbar(
        shown, ax=axes, location="bottom", shrink=0.9, aspect=35, spacing="uniform", ticks=SHARES
    )
    bar.ax.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    bar.set_label(f"machines within tolerance whose torque ripple is above {limit:g} N m")
    axes.set_title("How likely a machine as built passes the limit")
    ridge(axes, rows, "formula")


def ripple(axes: Axes, survey: Survey, limit: float) -> None:
    """The line on which the torque ripple of the nominal machine meets the limit."""
    values = survey.ripple
    if not np.nanmin(values) < limit < np.nanmax(values):
        return
    x, y = survey.plane.x.values, survey.plane.y.values
    for color, width in (("black", 3.2), (LIMIT, 1.8)):
        axes.contour(x, y, values, [limit], colors=color, linewidths=width)
    axes.plot([], [], color=LIMIT, linewidth=1.8, label=f"torque ripple of {limit:g} N m")


def beside(axes: Axes, y: Real, in_range: Real, within: tuple[float, float]) -> None:
    """The probability anywhere in the operating range; what is below the first level in green."""
    from matplotlib.ticker import PercentFormatter

    axes.fill_betweenx(y, 0, in_range, color=RISK, alpha=0.3)
    axes.plot(in_range, y, color=RISK, linewidth=1.8)
    clear = in_range <= SHARES[0]
    axes.fill_betweenx(y, 0, 1, where=list(clear), color=RANGE, alpha=0.25, label="clear")
    axes.set(xlim=(0, 1), xlabel="machines above\nthe limit")
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.set_title(f"anywhere in\n{within[0]:g} .. {within[1]:g} rad/s")
    axes.legend(loc="upper right", fontsize=8)


def ridge(axes: Axes, rows: Sequence[Row], place: str) -> None:
    """One ridge, where the rows have it."""
    color, style, label = RIDGES[place]
    there = [(getattr(row, place), row.y) for row in rows if getattr(row, place) is not None]
    if there:
        axes.plot(*zip(*there), style, color=color, markersize=4, linewidth=1.8, label=label)


def scale(axes: Axes, along: Axis, name: str) -> None:
    """Limits of an axis, and plain numbers on a logarithmic one."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    getattr(axes, f"set_{name}lim")(along.values[0], along.values[-1])
    if along.log:
        getattr(axes, f"set_{name}scale")("log")
        ticks = getattr(axes, f"{name}axis")
        ticks.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
        ticks.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ticks.set_minor_locator(NullLocator())
