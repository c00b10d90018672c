"""Pictures that answer the question of a scenario at a glance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .theory import Machine

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cosim import Result

    from .resonance import Found, Point

TORQUE, SPEED, THEORY, MARK = "#c0392b", "#1f5fa8", "#555555", "#2e8b57"
STYLE: dict[Any, Any] = {
    "figure.dpi": 120,
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
}


@cache
def pyplot() -> Any:
    """matplotlib's pyplot for files, in our style; a second to import, which waits for a picture."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams.update(STYLE)
    from matplotlib import pyplot as plt

    return plt


def resonance(
    path: Path,
    name: str,
    machine: Machine,
    points: Sequence[Point],
    found: Mapping[str, Found],
) -> None:
    """Ripple of torque and speed, and the lag, over speed: theory as line, co-simulation as points."""
    nu = np.array([p.nu for p in points])
    fine = np.linspace(nu.min(), nu.max(), 600) if len(nu) > 1 else nu
    figure, (top, middle, bottom) = pyplot().subplots(
        3, 1, figsize=(8, 9), sharex=True, height_ratios=(3, 2, 2), layout="constrained"
    )
    theory = [abs(machine.torque_ripple(x)) for x in fine]
    _curve(top, fine, theory, nu, [p.tau2 for p in points], TORQUE)
    top.set_ylabel("torque ripple, order 2  [N m]")
    theory = [abs(machine.speed_ripple(x)) for x in fine]
    _curve(middle, fine, theory, nu, [p.w2 for p in points], SPEED)
    middle.set_ylabel("speed ripple, order 2  [rad/s]")
    lag = [_lag(machine, x) for x in fine]
    _curve(bottom, fine, lag, nu, [p.lag for p in points], MARK)
    bottom.set_ylabel("lag of torque behind\nload ripple  [deg]")
    bottom.set(ylim=(0, 185), yticks=[0, 45, 90, 135, 180])
    bottom.axhline(90, color=MARK, linewidth=0.8)
    bottom.set_xlabel("operating speed  [rad/s]")
    for axes in (top, middle, bottom):
        axes.axvline(machine.nu_res, color=MARK, linestyle="--", linewidth=1.4)
    for axes, key in ((top, "nu_peak_tau"), (middle, "nu_peak_w")):
        axes.margins(y=0.15)
        if key in found:
            at, height = found[key].nu.value, found[key].value.value
            _mark(axes, at, height, f"peak {at:.2f} rad/s")
    top.plot([], [], color=MARK, linestyle="--", label=f"formula (22): {machine.nu_res:.2f} rad/s")
    if "nu_90" in found:
        at = found["nu_90"].nu.value
        _mark(bottom, at, 90.0, f"90° at {at:.3f} rad/s")
    top.legend(loc="upper right")
    rpm = top.secondary_xaxis(
        "top", functions=(lambda w: w * 30 / math.pi, lambda n: n * math.pi / 30)
    )
    rpm.set_xlabel("[rpm]")
    figure.suptitle(f"Electromechanical resonance of the conveyor drive, set {name}")
    save(figure, path)


def run_up(
    path: Path, machine: Machine, runs: Mapping[str, Result], passing: Mapping[str, float | None]
) -> None:
    """Speed, torque and rod force over time; one column per motor that starts the conveyor."""
    figure, panels = pyplot().subplots(
        3, len(runs), figsize=(11, 8), sharex=True, layout="constrained"
    )
    rows = (
        ("conveyor.w", "crank speed  [rad/s]", 1.0, SPEED),
        ("motor.tau", "motor torque  [N m]", 1.0, TORQUE),
        ("conveyor.f_rod", "axial rod force  [kN]", 1e-3, THEORY),
    )
    for column, (motor, result) in zip(panels.T, runs.items()):
        column[0].set_title(f"{motor} characteristic")
        for axes, (name, label, scale, color) in zip(column, rows):
            axes.plot(result["time"], result[name] * scale, color=color, linewidth=1.2)
            axes.set_ylabel(label)
            if passing[motor] is not None:
                axes.axvline(passing[motor], color=MARK, linestyle=":", label="passing it")
        level = f"formula (22): {machine.nu_res:.1f} rad/s"
        column[0].axhline(machine.nu_res, color=MARK, linestyle="--", label=level)
        column[0].legend(loc="lower right")
        column[-1].set_xlabel("time  [s]")
    figure.suptitle("Run-up of the conveyor from rest through its electromechanical resonance")
    save(figure, path)


def _curve(
    axes: Axes, fine: Any, theory: Sequence[float], nu: Any, values: Sequence[float], color: str
) -> None:
    axes.plot(fine, theory, color=THEORY, linewidth=1.2, label="first-order theory")
    axes.plot(nu, values, "o", color=color, markersize=4.5, label="co-simulation")


def _lag(machine: Machine, nu: float) -> float:
    return math.degrees(np.angle(machine.load_ripple(nu) / machine.torque_ripple(nu))) % 360.0


def _mark(axes: Axes, x: float, y: float, text: str) -> None:
    axes.annotate(
        text,
        (x, y),
        xytext=(-45, 14),
        textcoords="offset points",
        ha="right",
        va="center",
        arrowprops={"arrowstyle": "->", "color": "black", "shrinkB": 4},
    )


def save(figure: Figure, path: Path) -> None:
    """Write and close a figure."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    pyplot().close(figure)
