"""Pictures of the iron drive: its cycle, its start, its orders, and the mechanism in motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import iron
from .plots import MARK, SPEED, THEORY, TORQUE, pyplot, save

if TYPE_CHECKING:
    from cosim import Result

    from .iron_orders import Machine, Spectrum


def cycle(
    path: Path, result: Result, speed: float, limits: Mapping[str, tuple[float, float]]
) -> None:
    """Motion, torque and forces over the cam angle; the phases of the cam as a band."""
    phi = np.degrees(result["iron.phi"])
    figure, panels = pyplot().subplots(
        4, 1, figsize=(9, 10), sharex=True, layout="constrained", height_ratios=(2, 2, 3, 3)
    )
    motion, speed_axes, torque, force = panels
    motion.plot(phi, 1e3 * result["iron.lift"], color=MARK)
    motion.set_ylabel("lift of the iron  [mm]")
    speed_axes.plot(phi, result["iron.v"], color=SPEED, label="velocity  [m/s]")
    speed_axes.plot(phi, result["iron.a"] / 10, color=THEORY, label="acceleration  [10 m/s²]")
    speed_axes.set_ylabel("iron, upwards")
    torque.plot(phi, result["iron.tau_cam"], color=TORQUE)
    torque.axhline(0, color=THEORY, linewidth=0.8)
    torque.set_ylabel("torque at the\ncam's shaft  [N m]")
    for name, color, label in (
        ("N", TORQUE, "cam on follower"),
        ("T_span", SPEED, "chain, link's side"),
        ("T_iron", MARK, "chain at the iron"),
    ):
        force.plot(phi, result[f"iron.{name}"], color=color, label=label)
    force.axhline(0, color="black", linewidth=1.2)
    force.set_ylabel("forces  [N]\n(must stay positive)")
    force.set_xlabel("cam angle  [deg]")
    force.set(xlim=(0, 360), xticks=range(0, 361, 30))
    parameters = result.provenance["parts"]["iron"]["parameters"]
    edges = np.cumsum(
        [0.0, *(math.degrees(parameters[f"cam.{p}"]) for p in ("rise", "top", "ret"))]
    )
    for name, left, right in zip(
        ("rise", "top dwell", "return", "sealing"), edges, [*edges[1:], 360.0]
    ):
        motion.annotate(
            name, ((left + right) / 2, 1.03), xycoords=("data", "axes fraction"), ha="center"
        )
        for axes in panels:
            axes.axvline(right, color=THEORY, linewidth=0.6, linestyle=":")
    speed_axes.legend(loc="lower left")
    force.legend(loc="lower right", ncols=3)
    first = min(limits, key=lambda name: limits[name][0])
    figure.suptitle(
        f"Sealing iron at {iron.per_minute(speed):.1f} cycles/min; "
        f"limit {iron.per_minute(limits[first][0]):.1f} cycles/min"
    )
    save(figure, path)


def start_up(path: Path, result: Result, energy: Mapping[str, iron.Samples]) -> None:
    """Speed, torque and the energy ledger over time."""
    t = result["time"]
    figure, (top, middle, bottom) = pyplot().subplots(
        3, 1, figsize=(9, 8), sharex=True, layout="constrained"
    )
    top.plot(t, result["iron.w_cam"], color=SPEED)
    top.set_ylabel("cam speed  [rad/s]")
    lift = top.twinx()
    lift.fill_between(t, 1e3 * result["iron.lift"], color=MARK, alpha=0.15)
    lift.set_ylabel("lift  [mm]", color=MARK)
    lift.grid(False)
    middle.plot(t, result["motor.tau"], color=TORQUE)
    middle.set_ylabel("motor torque  [N m]")
    for name, color, label in (
        ("E_in", TORQUE, "from the motor"),
        ("E_stored", SPEED, "stored"),
        ("E_friction", MARK, "friction"),
    ):
        bottom.plot(t, energy[name], color=color, label=label)
    bottom.set_ylabel("energy  [J]")
    bottom.set_xlabel("time  [s]")
    bottom.legend(loc="upper left", ncols=3)
    figure.suptitle("Start of the sealing iron's drive from the middle of the bottom dwell")
    save(figure, path)


def orders(path: Path, machine: Machine, spectra: Sequence[Spectrum], limit: float) -> None:
    """Campbell maps: frequency k nu over speed, the torque of each order as the size of a dot."""
    lags = sorted({s.T for s in spectra})
    figure, panels = pyplot().subplots(
        1, len(lags), figsize=(4.6 * len(lags), 6), sharey=True, layout="constrained"
    )
    top = max(abs(s.torque).max() for s in spectra)
    dots: Any = None
    for axes, T in zip(np.atleast_1d(panels), lags):
        mine = [s for s in spectra if s.T == T]
        nus = np.array([s.nu for s in mine])
        torque = np.array([np.abs(s.torque) for s in mine])
        gain = torque / np.array([np.abs(s.excitation) for s in mine])
        for k in range(1, torque.shape[1] + 1):
            axes.plot(nus, k * nus, color=THEORY, linewidth=0.4)
            axes.annotate(f" {k}", (nus[-1], k * nus[-1]), va="center", fontsize=8, color=THEORY)
            dots = axes.scatter(
                nus,
                k * nus,
                s=250 * torque[:, k - 1] / top,
                c=gain[:, k - 1],
                cmap="coolwarm",
                vmin=0.0,
                vmax=2.0,
                edgecolors="none",
            )
        w_n = machine.w_n(T)
        axes.axhline(w_n, color=MARK, linestyle="--", label=f"formula: {w_n:.1f} rad/s")
        for k in range(1, torque.shape[1] + 1):
            if nus[0] <= w_n / k <= nus[-1]:
                axes.plot([w_n / k], [w_n], "x", color=MARK)
        if limit < nus[-1] * 1.1:
            axes.axvline(limit, color=TORQUE, linestyle=":", label="follower lifts off")
        axes.set_title(f"T = {1e3 * T:g} ms, damping {machine.zeta(T):.2f}")
        axes.set_xlabel("cam speed  [rad/s]")
        axes.legend(loc="upper left")
    np.atleast_1d(panels)[0].set_ylabel("frequency of order k  [rad/s]")
    figure.colorbar(dots, ax=panels, label="torque over excitation", extend="max", shrink=0.6)
    figure.suptitle("Orders of the cam torque (area of a dot) over the speed, three motor lags")
    save(figure, path)
