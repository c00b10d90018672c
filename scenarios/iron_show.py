"""What the page shows of the iron drive."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from . import iron
from .options import Start
from .page import mechanisms
from .page.charts import Chart, Curve, Mark, Panel
from .page.motion import Columns, Motion, Samples, columns, rows

if TYPE_CHECKING:
    from cosim import Result

    from .iron_orders import Machine, Spectrum

SEEN = ("phi", "alpha", "beta", "H", "lift", "motion")
PHASES = ("dwell", "up", "down", "stuck")
SMALL = 0.1
COLORS = ("blue", "gold", "red")
FORCES = (
    ("N", "cam on follower", "red"),
    ("T_span", "chain, link's side", "blue"),
    ("T_iron", "chain at the iron", "green"),
)


def cycle(result: Result) -> Chart:
    """Motion, torque and forces over the cam angle."""
    phi = np.degrees(result["iron.phi"])

    def panel(quantity: str, unit: str, *curves: tuple[str, Samples, str]) -> Panel:
        return Panel(quantity, unit, [Curve(name, phi, y, color) for name, y, color in curves])

    parameters = result.provenance["parts"]["iron"]["parameters"]
    ends = np.cumsum([math.degrees(parameters[f"cam.{x}"]) for x in ("rise", "top", "ret")])
    return Chart(
        "One turn of the cam",
        "cam angle [deg]",
        [
            panel("lift", "mm", ("lift", 1e3 * result["iron.lift"], "green")),
            panel("velocity", "m/s", ("velocity of the iron", result["iron.v"], "blue")),
            panel("acceleration", "m/s2", ("acceleration of the iron", result["iron.a"], "grey")),
            panel("torque", "N.m", ("torque at the cam's shaft", result["iron.tau_cam"], "red")),
            panel("forces", "N", *((text, result[f"iron.{x}"], color) for x, text, color in FORCES)),
        ],
        [Mark(end, text) for end, text in zip(ends, ("top dwell", "return", "sealing"))],
    )  # fmt: skip


def start_up(result: Result, energy: Mapping[str, Samples]) -> Chart:
    """Speed, lift, torque and the energy ledger over time."""
    t = result["time"]
    ledger = (
        ("E_in", "from the motor", "red"),
        ("E_stored", "stored", "blue"),
        ("E_friction", "friction", "green"),
    )
    return Chart(
        "Start from the middle of the bottom dwell",
        "time [s]",
        [
            Panel("cam speed", "rad/s", [Curve("speed of the cam", t, result["iron.w_cam"], "blue")]),
            Panel("lift", "mm", [Curve("lift", t, 1e3 * result["iron.lift"], "green")]),
            Panel("motor torque", "N.m", [Curve("torque", t, result["motor.tau"], "red")]),
            Panel("energy", "J", [Curve(text, t, energy[x], color) for x, text, color in ledger]),
            Panel("missing", "mJ", [
                Curve("made or lost by the coupling", t, 1e3 * energy["E_missing"], "grey")
            ]),
        ],
    )  # fmt: skip


def orders(machine: Machine, by_lag: Mapping[float, Sequence[Spectrum]]) -> list[Chart]:
    """Gain over frequency for all orders at once, and the torque of each order over the speed."""
    charts = [gain(machine, by_lag)]
    for T, spectra in by_lag.items():
        nus = [s.nu for s in spectra]
        palette = ("red", "blue", "green", "gold", "purple", "grey")
        curves = [
            Curve(f"order {k + 1}", nus, [abs(s.torque[k]) for s in spectra], color)
            for k, color in enumerate(palette)
        ]
        charts.append(
            Chart(
                f"Torque by order, motor lag {1e3 * T:g} ms; marks where the formula puts an order",
                "cam speed [rad/s]",
                [Panel("amplitude", "N.m", curves)],
                [
                    Mark(machine.w_n(T) / k, f"order {k}")
                    for k in range(1, len(palette) + 1)
                    if nus[0] <= machine.w_n(T) / k <= nus[-1]
                ],
            )
        )
    return charts


def gain(machine: Machine, by_lag: Mapping[float, Sequence[Spectrum]]) -> Chart:
    """Torque over excitation; orders whose excitation is small say nothing and are left out."""
    curves = []
    for (T, spectra), color in zip(by_lag.items(), COLORS):
        largest = max(np.abs(s.excitation).max() for s in spectra)
        seen = sorted(
            (k * s.nu, abs(s.torque[k - 1]) / abs(s.excitation[k - 1]))
            for s in spectra
            for k in range(1, len(s.torque) + 1)
            if abs(s.excitation[k - 1]) > SMALL * largest
        )
        fine = np.linspace(seen[0][0], seen[-1][0], 300)
        theory = [abs(machine.gain(x, T)) for x in fine]
        name = f"lag {1e3 * T:g} ms"
        curves.append(Curve(f"{name}, theory", fine, theory, color, "theory"))
        frequency, height = np.array(seen).T
        curves.append(Curve(name, frequency, height, color, "points"))
    return Chart(
        f"Torque of an order over its excitation, if above {SMALL:.0%} of the largest",
        "frequency of the order [rad/s]",
        [Panel("gain", "1", curves, [Mark(1.0, "1")])],
    )


def motion(
    result: Result, start: Start, title: str, first: float, last: float, slow: float
) -> Motion:
    """The mechanism between two times [s] of a run; `start` is that of the iron drive."""
    picked = rows(result["time"], first, last)
    at = columns(result, "iron", SEEN, picked)
    parameters = result.provenance["parts"]["iron"]["parameters"]
    t = result["time"][picked]
    return Motion(
        title,
        t,
        slow,
        captions(t - first, at),
        mechanisms.iron_drive(parameters, at, pitch_curve(start)),
        "The cam is drawn as the path of the roller's centre about it.",
    )


def pitch_curve(start: Start) -> Samples:
    """From a turn of the cam."""
    turn = iron.turn(1.0, start, 180, iron.names(("phi", "alpha")))
    parameters = turn.provenance["parts"]["iron"]["parameters"]
    return mechanisms.pitch_curve(parameters, turn["iron.phi"][:-1], turn["iron.alpha"][:-1])


def captions(t: Samples, at: Columns) -> list[str]:
    """Cam, phase and lift at every time."""
    return [
        f"{now:.3f} s: cam {math.degrees(phi) % 360:.1f} deg, iron {PHASES[int(phase)]}, "
        f"lift {1e3 * lift:.1f} mm"
        for now, phi, phase, lift in zip(t, at["phi"], at["motion"], at["lift"])
    ]
