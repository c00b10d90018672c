"""What is shown of the crank conveyor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench import Chart, Curve, Figure, Mark, Panel
from workbench.report import chart
from workbench.report.chart import THEORY, TORQUE, Field, Level, Second, Span, recorded
from workbench.report.motion import Motion, columns, moved, rows

from . import mechanism
from .theory import Machine

if TYPE_CHECKING:
    from cosim import Result

    from .resonance_map import Map

RECORD = (
    "motor.tau", "conveyor.phi", "conveyor.w", "conveyor.x", "conveyor.tau_load", "conveyor.f_rod",
)  # fmt: skip
NOTE = (
    f"Crank and stroke are drawn {mechanism.ENLARGED:g} times as long as they are against the rod."
)
RPM = Second("rpm", 30 / math.pi)
MOTORS = {"linear": ("linear motor", "purple"), "kloss": ("induction motor (Kloss)", "gold")}
RIDGES = (
    ("formula", "formula (22)", "grey", "theory"),
    ("lag_90", "90 deg lag", "sky", "points"),
    ("peak", "largest torque ripple", "red", "points"),
)
MARKS = {"nu_90": "90 deg lag", "nu_peak_tau": "torque peak", "nu_peak_w": "speed peak"}


def ripple(
    machine: Machine,
    points: Sequence[Any],
    figures: Mapping[str, Figure],
    speed: float,
    rated: float,
    limit: float,
    avoid: Sequence[tuple[float, float]],
) -> Chart:
    """Ripple of torque and speed and the lag over the speed, theory as lines; the title answers.

    Points have nu, tau2, w2 and lag, with tau2_error, w2_error and lag_error; `speed` is that of
    operation [rad/s]; the motor's `rated` torque, and the `limit` [N.m] that the torque ripple is
    above in the stretches to `avoid` [rad/s].
    """
    nu = np.array([p.nu for p in points])
    fine = np.linspace(nu.min(), nu.max(), 400)
    torque, omega = machine.torque_ripple(fine), machine.speed_ripple(fine)
    lag = np.angle(machine.load_ripple(fine) / torque, deg=True) % 360.0

    def panel(quantity: str, unit: str, name: str, theory: Any, color: str, **rest: Any) -> Panel:
        y, errors = ([getattr(p, column) for p in points] for column in (name, f"{name}_error"))
        seen = Curve("co-simulation", nu, y, color, "points", errors)
        line = Curve("first-order theory", fine, theory, THEORY, "theory")
        return Panel(quantity, unit, [line, seen], **rest)

    levels = [Mark(rated, f"rated torque {rated:g} N.m"), Mark(limit, f"limit {limit:g} N.m")]
    marks = [Mark(machine.nu_res, f"formula {machine.nu_res:.2f} rad/s")]
    marks += [
        Mark.of(text, figures[name])
        for name, text in MARKS.items()
        if name in figures and math.isfinite(figures[name].value)
    ]
    return Chart(
        headline(speed, limit, avoid),
        "operating speed [rad/s]",
        [
            panel("torque ripple", "N.m", "tau2", abs(torque), TORQUE, includes=(0.0,), levels=levels),
            panel("speed ripple", "rad/s", "w2", abs(omega), chart.SPEED, includes=(0.0,)),
            panel("lag behind the load", "deg", "lag", lag, chart.LIFT, includes=(0.0, 180.0),
                  levels=[Mark(90.0, "90 deg")]),
        ],
        [*marks, Mark(speed, f"operating speed {speed:g} rad/s")],
        [Span(*band, "avoid", "red") for band in avoid],
        RPM,
    )  # fmt: skip


def headline(speed: float, limit: float, avoid: Sequence[tuple[float, float]]) -> str:
    """Whether the torque ripple is above its limit at the operating speed, and where else."""
    over = any(low <= speed <= high for low, high in avoid)
    where = " and ".join(f"{low:.1f} to {high:.1f} rad/s" for low, high in avoid) or "no speed"
    return f"{'Yes' if over else 'No'} at {speed:g} rad/s: the torque ripple is above {limit:g} N.m at {where}"


def revolution(nu: float, result: Result) -> tuple[Chart, Motion]:
    """The last revolution of a steady run at the mean speed nu [rad/s]: its course, its motion."""
    t, phi = result["time"], result["conveyor.phi"]
    first = float(np.interp(phi[-1] - 2 * math.pi, phi, t))
    late = t >= first
    since = 1e3 * (t[late] - first)

    def panel(quantity: str, curves: Mapping[str, tuple[str, str]], unit: str = "") -> Panel:
        return recorded(quantity, result, since, curves, unit, late)

    torque = {"motor.tau": ("motor", TORQUE), "conveyor.tau_load": ("load", THEORY)}
    course = Chart(
        f"One revolution at {nu:g} rad/s",
        "time [ms]",
        [
            panel("torque", torque),
            panel("speed", {"conveyor.w": ("crank", chart.SPEED)}),
            panel("rod force", {"conveyor.f_rod": ("rod", chart.FORCE)}, "kN"),
        ],
    )
    return course, _motion(
        f"Crank conveyor at {nu:g} rad/s", {"": result}, first, float(t[-1]), 25.0
    )


def run_up(machine: Machine, runs: Mapping[str, Result]) -> list[Chart]:
    """Speed, torque and rod force over time, and torque over speed, for both motors on one scale."""

    def panel(quantity: str, column: str, unit: str = "", levels: Sequence[Mark] = ()) -> Panel:
        each = [
            recorded(quantity, result, result["time"], {column: MOTORS[motor]}, unit)
            for motor, result in runs.items()
        ]
        curves = [curve for panel in each for curve in panel.curves]
        return each[0]._replace(curves=curves, levels=levels)

    level = Mark(machine.nu_res, f"resonance {machine.nu_res:.1f} rad/s")
    panels = [
        panel("crank speed", "conveyor.w", levels=[level]),
        panel("motor torque", "motor.tau"),
        panel("rod force", "conveyor.f_rod", "kN"),
    ]
    plane = []
    for motor, result in runs.items():
        name, color = MOTORS[motor]
        w, order = result["conveyor.w"], np.argsort(result["conveyor.w"])
        static = Curve("static characteristic", w[order], result["motor.tau_static"][order],
                       THEORY, "theory")  # fmt: skip
        lagging = Curve("with its lag", w, result["motor.tau"], color)
        plane.append(Panel(f"torque, {name}", result.units["motor.tau"], [static, lagging]))
    return [
        Chart("Run-up from rest", "time [s]", panels),
        Chart("Torque over speed: the lag of the motor", "crank speed [rad/s]", plane),
    ]


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
        at = columns(result, "conveyor", ("phi", "x", "w"), picked)
        drawn = mechanism.crank_conveyor(p, at)
        shapes += moved(drawn, 0.0, -0.8 * k * p["rod.l"])
        tau = result["motor.tau"][picked]
        told = [
            f"{before}{name} {w:.1f} rad/s, {1e3 * x:+.2f} mm, {m:.0f} N.m; "
            for before, w, x, m in zip(told, at["w"], at["x"], tau)
        ]
    t = results[0]["time"][picked]
    captions = [f"{x - first:.3f} s: {text.strip('; ')}" for x, text in zip(t, told)]
    return Motion(title, t, slow, captions, shapes, NOTE)


def maps(r: Map, limit: float) -> list[Field]:
    """The gain in colour with the ridges over it; the probability of too much ripple; on both the
    line of the limit [N.m], and the operating range where the map is over the speed.
    """
    x, y, ripple = r.plane.x.direction, r.plane.y.direction, r.field("ripple")
    over = ridges(r, "x")
    reached = np.nanmin(ripple) < limit < np.nanmax(ripple)
    line = [Level(limit, f"torque ripple of {limit:g} N.m", ripple)] if reached else []
    bounds = [Span(*r.within, "operating range", "green")] if r.within else []
    formula = [curve for curve in over if curve.look == "theory"]
    return [
        Field("How much the drive magnifies the load's ripple", x, y,
              "torque ripple over load ripple", r.field("gain"), over, True, line, bounds),
        Field(f"Machines within tolerance whose torque ripple is above {limit:g} N.m", x, y,
              "share of the machines", r.field("probability"), formula, levels=line, spans=bounds,
              scale="risk"),
    ]  # fmt: skip


def ridges(r: Map, along: str) -> list[Curve]:
    """The ridges of the rows that have them, their places on the axis "x" or "y" of the picture."""
    curves = []
    for column, name, color, look in RIDGES:
        there = r.rows[np.isfinite(r.rows[column])]
        x, y = there[column].to_numpy(), there[r.plane.y.name].to_numpy()
        if len(there):
            curves.append(Curve(name, *((x, y) if along == "x" else (y, x)), color, look))
    return curves


def map_rows(r: Map, limit: float) -> list[Chart]:
    """The ridges of every row; where there is an operating range, its ripple and probability."""
    x, y, curves, title = r.plane.x, r.plane.y, ridges(r, "y"), "The ridges"
    panels = [Panel(x.name, x.unit, curves)] if curves else []
    if r.within:
        title = f"Anywhere in {r.within[0]:g} to {r.within[1]:g} rad/s"
        share = 100 * r.rows["probability_in_range"].to_numpy()
        above = Curve("machines above the limit", y.values, share, "purple")
        ripple = r.rows["ripple_in_range"].to_numpy()
        worst = Curve("nominal machine", y.values, ripple, TORQUE)
        level = [Mark(limit, f"limit {limit:g} N.m")]
        panels = [
            Panel("machines above the limit", "%", [above], includes=(0.0, 100.0)),
            Panel("largest torque ripple", "N.m", [worst], level, includes=(0.0,)),
            *panels,
        ]
    label = " ".join(y.direction.label.split())
    return [Chart(title, label, panels, log=y.log)] if panels else []
