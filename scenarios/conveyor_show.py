"""What the page shows of the crank conveyor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .page import mechanisms
from .page.charts import Chart, Curve, Mark, Panel
from .page.motion import Motion, Samples, columns, moved, rows
from .theory import Machine

if TYPE_CHECKING:
    from cosim import Result

    from .resonance import Found, Point

SEEN = ("phi", "x", "w")
NOTE = (
    f"Crank and stroke are drawn {mechanisms.ENLARGED:g} times as long as they are against the rod."
)


def ripple(machine: Machine, points: Sequence[Point], found: Mapping[str, Found]) -> Chart:
    """Ripple of torque and speed, and the lag, over the speed; theory as lines."""
    nu = np.array([p.nu for p in points])
    fine = np.linspace(nu.min(), nu.max(), 400)
    theory = [(machine.torque_ripple(x), machine.speed_ripple(x)) for x in fine]
    lag = [
        np.degrees(np.angle(machine.load_ripple(x) / t)) % 360 for x, (t, _) in zip(fine, theory)
    ]
    marks = [Mark(machine.nu_res, f"formula (22) {machine.nu_res:.2f}")]
    for name, text in (("nu_peak_tau", "torque peak"), ("nu_peak_w", "speed peak")):
        if name in found:
            marks.append(Mark(found[name].nu.value, f"{text} {found[name].nu.value:.2f}"))
    return Chart(
        "Ripple of order 2 over the operating speed",
        "operating speed [rad/s]",
        [
            Panel(name, unit, [Curve("theory", fine, line, "grey", "theory"),
                               Curve("co-simulation", nu, dots, color, "points")], levels)
            for name, unit, line, dots, color, levels in (
                ("torque", "N.m", [abs(t) for t, _ in theory], [p.tau2 for p in points], "red", []),
                ("speed", "rad/s", [abs(w) for _, w in theory], [p.w2 for p in points], "blue", []),
                ("lag behind load", "deg", lag, [p.lag for p in points], "green",
                 [Mark(90.0, "90 deg")]),
            )
        ],
        marks,
    )  # fmt: skip


def revolution(nu: float, result: Result) -> tuple[Chart, Motion]:
    """The last revolution of a steady run at the mean speed nu [rad/s]: its course, its motion."""
    t, phi = result["time"], result["conveyor.phi"]
    first = float(np.interp(phi[-1] - 2 * math.pi, phi, t))
    late = t >= first
    since = 1e3 * (t[late] - first)
    chart = Chart(
        f"One revolution at {nu:g} rad/s",
        "time [ms]",
        [
            Panel("torque", "N.m", [
                Curve("motor", since, result["motor.tau"][late], "red"),
                Curve("load", since, result["conveyor.tau_load"][late], "grey"),
            ]),
            Panel("speed", "rad/s", [Curve("crank", since, result["conveyor.w"][late], "blue")]),
            Panel("rod force", "kN", [
                Curve("rod", since, 1e-3 * result["conveyor.f_rod"][late], "gold")
            ]),
        ],
    )  # fmt: skip
    return chart, _motion(
        f"Crank conveyor at {nu:g} rad/s", {"": result}, first, float(t[-1]), 25.0
    )


def run_up(machine: Machine, runs: Mapping[str, Result]) -> list[Chart]:
    """Speed, torque and rod force over time, for both motors."""
    colors = {"linear": "blue", "kloss": "red"}

    def curves(name: str, scale: float = 1.0) -> list[Curve]:
        return [
            Curve(motor, result["time"], scale * result[name], colors[motor])
            for motor, result in runs.items()
        ]

    level = Mark(machine.nu_res, f"resonance by formula (22), {machine.nu_res:.1f} rad/s")
    panels = [
        Panel("crank speed", "rad/s", curves("conveyor.w"), [level]),
        Panel("motor torque", "N.m", curves("motor.tau")),
        Panel("rod force", "kN", curves("conveyor.f_rod", 1e-3)),
    ]
    plane = [
        Panel(f"torque, {motor}", "N.m", [
            Curve("static characteristic", *static(result), "theory"),
            Curve("with lag", result["conveyor.w"], result["motor.tau"], colors[motor]),
        ])
        for motor, result in runs.items()
    ]  # fmt: skip
    return [
        Chart("Run-up from rest", "time [s]", panels),
        Chart("Torque over speed: the lag of the motor", "crank speed [rad/s]", plane),
    ]


def static(result: Result) -> tuple[Samples, Samples, str]:
    """The static characteristic in the order of the speed, in its color."""
    order = np.argsort(result["conveyor.w"])
    return result["conveyor.w"][order], result["motor.tau_static"][order], "grey"


def run_up_motion(runs: Mapping[str, Result]) -> Motion:
    """Both conveyors, one above the other."""
    end = min(float(result["time"][-1]) for result in runs.values())
    return _motion("Both conveyors from rest", runs, 0.0, end, 15.0)


def _motion(
    title: str, runs: Mapping[str, Result], first: float, last: float, slow: float
) -> Motion:
    """Conveyors of several runs of the same step, with the first on top."""
    results = list(runs.values())
    turns = float(np.ptp(results[0]["conveyor.phi"])) / (2 * math.pi)
    picked = rows(results[0]["time"], first, last, int(np.clip(24 * turns, 120, 480)))
    shapes, told = [], [""] * len(picked)
    for k, (name, result) in enumerate(runs.items()):
        p = result.provenance["parts"]["conveyor"]["parameters"]
        at = columns(result, "conveyor", SEEN, picked)
        drawn = mechanisms.crank_conveyor(p, at)
        shapes += moved(drawn, 0.0, -0.8 * k * p["rod.l"])
        tau = result["motor.tau"][picked]
        told = [
            f"{before}{name} {w:.1f} rad/s, {1e3 * x:+.2f} mm, {m:.0f} N.m; "
            for before, w, x, m in zip(told, at["w"], at["x"], tau)
        ]
    t = results[0]["time"][picked]
    captions = [f"{x - first:.3f} s: {text.strip('; ')}" for x, text in zip(t, told)]
    return Motion(title, t, slow, captions, shapes, NOTE)
