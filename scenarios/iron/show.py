"""What is shown of the iron drive."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.report.chart import (
    FORCE,
    LIFT,
    SERIES,
    SPEED,
    THEORY,
    TORQUE,
    Chart,
    Curve,
    Mark,
    Panel,
    Span,
    recorded,
)
from workbench.report.motion import Columns, Motion, Samples, columns, rows

from . import drive as iron
from . import mechanism

if TYPE_CHECKING:
    from cosim import Result

    from .iron_orders import Machine, Spectrum

SEEN = ("phi", "alpha", "beta", "H", "lift", "motion")
PHASES = ("dwell", "up", "down", "stuck")
SMALL, FIRST = 0.1, 0.3
FORCES = {
    "iron.N": ("cam on follower", TORQUE),
    "iron.T_span": ("chain at the link", SPEED),
    "iron.T_iron": ("chain at the iron", LIFT),
}


def cycle(result: Result, speed: float, limit: float) -> Chart:
    """Motion, torque and forces over the cam angle, the phases of the cam as spans."""
    phi = np.degrees(result["iron.phi"])
    parameters = result.provenance["parts"]["iron"]["parameters"]
    parts = [math.degrees(parameters[f"cam.{x}"]) for x in ("rise", "top", "ret")]
    ends = [0.0, *np.cumsum(parts).tolist(), 360.0]

    def panel(quantity: str, column: str, color: str, unit: str = "") -> Panel:
        return recorded(quantity, result, phi, {f"iron.{column}": (quantity, color)}, unit)

    return Chart(
        f"One turn of the cam at {iron.per_minute(speed):.1f} cycles/min; the first force vanishes "
        f"at {iron.per_minute(limit):.1f} cycles/min",
        "cam angle [deg]",
        [
            panel("lift", "lift", LIFT, "mm"),
            panel("velocity", "v", SPEED),
            panel("acceleration", "a", FORCE),
            panel("torque of the cam", "tau_cam", TORQUE),
            recorded("forces", result, phi, FORCES, includes=(0.0,),
                     levels=[Mark(0.0, "0: contact or chain lets go")]),
        ],
        spans=[
            Span(first, last, text, color)
            for first, last, text, color in zip(
                ends, ends[1:], ("rise", "top dwell", "return", "sealing"),
                ("grey", "green", "grey", "gold"),
            )
        ],
    )  # fmt: skip


def start_up(result: Result, energy: Mapping[str, Samples]) -> list[Chart]:
    """Speed, lift, torque and the energy ledger over time; the first moments by themselves."""
    return [
        _start_up(result, energy, "The first moments", result["time"] <= FIRST),
        _start_up(result, energy, "The start from the middle of the bottom dwell", slice(None)),
    ]


def _start_up(result: Result, energy: Mapping[str, Samples], title: str, rows: Any) -> Chart:
    t = result["time"][rows]
    parts = [
        Curve("friction", t, energy["E_friction"][rows], "grey", "area"),
        Curve("stored", t, energy["E_stored"][rows], "sky", "area"),
        Curve("from the motor", t, energy["E_in"][rows], TORQUE),
    ]
    missing = Curve(
        "made or lost by the coupling", t, 1e3 * energy["E_missing"][rows], THEORY, "line"
    )

    def panel(quantity: str, column: str, color: str, unit: str = "") -> Panel:
        return recorded(quantity, result, t, {column: (quantity, color)}, unit, rows)

    return Chart(
        title,
        "time [s]",
        [
            panel("cam speed", "iron.w_cam", SPEED),
            panel("lift", "iron.lift", LIFT, "mm"),
            panel("motor torque", "motor.tau", TORQUE),
            Panel("energy", "J", parts, includes=(0.0,)),
            Panel("energy missing", "mJ", [missing]),
        ],
    )


def orders(
    machine: Machine, by_lag: Mapping[float, Sequence[Spectrum]], limit: float
) -> list[Chart]:
    """Gain over frequency for all orders at once, and the torque of each order over the speed."""
    charts = [gain(machine, by_lag)]
    for T, spectra in by_lag.items():
        nus = np.array([s.nu for s in spectra])
        curves = [
            Curve(f"order {k}", nus, [abs(s.torque[k - 1]) for s in spectra], color, "linked")
            for k, color in enumerate(SERIES, 1)
        ]
        met = {k: machine.w_n(T) / k for k in range(1, len(SERIES) + 1)}
        marks = [Mark(nu, f"w_n / {k}") for k, nu in met.items() if nus[0] <= nu <= nus[-1]]
        if nus[0] <= limit <= nus[-1]:
            marks.append(Mark(limit, "follower lifts off"))
        charts.append(
            Chart(
                f"Torque by order, motor lag {1e3 * T:g} ms: damping {machine.zeta(T):.2f}, w_n = "
                f"{machine.w_n(T):.1f} rad/s",
                "cam speed [rad/s]",
                [Panel("amplitude", "N.m", curves, includes=(0.0,))],
                marks,
            )
        )
    return charts


def gain(machine: Machine, by_lag: Mapping[float, Sequence[Spectrum]]) -> Chart:
    """Torque over excitation; orders whose excitation is small say nothing and are left out."""
    curves, marks = [], []
    for (T, spectra), color in zip(by_lag.items(), SERIES):
        largest = max(np.abs(s.excitation).max() for s in spectra)
        seen = sorted(
            (k * s.nu, abs(s.torque[k - 1]) / abs(s.excitation[k - 1]))
            for s in spectra
            for k in range(1, len(s.torque) + 1)
            if abs(s.excitation[k - 1]) > SMALL * largest
        )
        frequency, height = np.array(seen).T
        fine = np.linspace(frequency[0], frequency[-1], 300)
        theory = [abs(machine.gain(x, T)) for x in fine]
        name = f"lag {1e3 * T:g} ms"
        curves.append(Curve(f"{name}, theory", fine, theory, color, "theory"))
        curves.append(Curve(name, frequency, height, color, "points"))
        if frequency[0] <= machine.w_n(T) <= frequency[-1]:
            marks.append(Mark(machine.w_n(T), f"{name}: w_n {machine.w_n(T):.1f} rad/s"))
    return Chart(
        f"What the drive makes of an order's excitation, if above {SMALL:.0%} of the largest",
        "frequency of the order [rad/s]",
        [Panel("gain", "1", curves, [Mark(1.0, "1: torque = excitation")], includes=(0.0,))],
        marks,
    )


def motion(
    result: Result, start: iron.Alone, title: str, first: float, last: float, slow: float
) -> Motion:
    """The mechanism between two times [s] of a run; `start` is the iron drive by itself."""
    picked = rows(result["time"], first, last)
    at = columns(result, "iron", SEEN, picked)
    parameters = result.provenance["parts"]["iron"]["parameters"]
    t = result["time"][picked]
    drawn = mechanism.iron_drive(parameters, at, cam(start))
    note = f"The radius of the roller, {1e3 * mechanism.ROLLER:g} mm, is chosen for the drawing."
    return Motion(title, t, slow, captions(t - first, at), drawn, note)


def cam(start: iron.Alone) -> Samples:
    """The cam, from a turn of it."""
    turn = iron.turn(1.0, start, 180, iron.names(("phi", "alpha")))
    parameters = turn.provenance["parts"]["iron"]["parameters"]
    return mechanism.working_profile(parameters, turn["iron.phi"][:-1], turn["iron.alpha"][:-1])


def captions(t: Samples, at: Columns) -> list[str]:
    """Cam, phase and lift at every time."""
    return [
        f"{now:.3f} s: cam {math.degrees(phi) % 360:.1f} deg, iron {PHASES[int(phase)]}, "
        f"lift {1e3 * lift:.1f} mm"
        for now, phi, phase, lift in zip(t, at["phi"], at["motion"], at["lift"])
    ]
