"""The conveyor as lines in motion, from the outputs and parameters of its FMU."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

import cosim
from workbench import Chart, RunChart, RunPanel
from workbench.charts import model as chart
from workbench.charts import motion
from workbench.charts.motion import Columns, Motion, Shape, line
from workbench.live import REVOLUTION, Caption, Coordinate, LiveMotion, drawn
from workbench.steady import TURN

from .drive_orbits import ORBIT_STATES
from .first_order import Machine
from .machine import conveyor_drive, start_values
from .orbit import Drive

if TYPE_CHECKING:
    from cosim import Result

Parameters = Mapping[str, Any]
#: How many times too long crank and stroke are drawn relative to the rod; a convention, so that they are seen.
ENLARGED = 4.0
RECORD = (
    "motor.tau", "conveyor.phi", "conveyor.w", "conveyor.x", "conveyor.tau_load", "conveyor.f_rod",
)  # fmt: skip
CAPTIONS = (
    Caption("crank", "conveyor.w", "rad/s"),
    Caption("trough", "1e3 * conveyor.x", "mm", 2),
    Caption("torque", "motor.tau", "N.m", 0),
)
NOTE = f"Relative to the rod, crank and stroke are drawn {ENLARGED:g} times too long."


REVOLUTION_CHART = RunChart(
    "One revolution at the operating speed",
    "crank angle [deg]",
    [
        RunPanel(
            "torque",
            {
                "motor.tau": ("motor", chart.TORQUE),
                "conveyor.tau_load": ("load", chart.THEORY, "theory"),
            },
        ),
        RunPanel("speed", {"conveyor.w": chart.SPEED}),
        RunPanel("rod force", {"conveyor.f_rod": chart.FORCE}, "kN"),
    ],
    "crank_angle * 180 / pi",
    REVOLUTION,
)


def revolution(drive: Drive, machine: Machine, nu: float) -> tuple[list[Motion], list[Chart]]:
    """The motion and the course of a revolution of a machine on its orbit at a speed; none where there is no orbit."""
    turn = drive.motions(machine, [nu], 1)
    if turn.problems[0]:
        return [], []
    start = start_values(machine, nu) | {"conveyor.phi": 0.0}
    start |= zip(ORBIT_STATES, turn.states[0].tolist())
    step = TURN / float(turn.columns["speed"].steps[0, 0]) / drive.steps_per_rev
    result = cosim.run(
        conveyor_drive(drive.context.fmus, start),
        stop=(drive.steps_per_rev + 1) * step,
        step=step,
        algorithm=drive.algorithm,
        record=RECORD,
    )
    waveforms = drawn(REVOLUTION_CHART, result, angle="conveyor.phi")
    waveforms = waveforms._replace(title=f"One revolution at {nu:g} rad/s")
    title = f"Crank conveyor at {nu:g} rad/s"
    return [moving(title, {"": result}, step, float(result["time"][-1]), 25.0)], [waveforms]


def moving(
    title: str, runs: Mapping[str, Result], first: float, last: float, slow: float
) -> Motion:
    """Conveyors of several runs of the same step between two times [s], the first on top."""
    results = list(runs.values())
    turns = float(np.ptp(results[0]["conveyor.phi"])) / (2 * math.pi)
    picked = motion.rows_nearest_to_times(
        results[0]["time"], first, last, int(np.clip(24 * turns, 120, 480))
    )
    times, shapes = results[0]["time"][picked], []
    captions = [f"{t - first:.3f} s: " for t in times]
    for k, (name, result) in enumerate(runs.items()):
        p = result.provenance["parts"]["conveyor"]["parameters"]
        at = motion.columns(result, "conveyor", ("phi", "x", "w"), picked)
        shapes += motion.shifted(crank_conveyor(p, at), 0.0, -0.8 * k * p["rod.l"])
        label = f"{name} ".lstrip()
        captions = [
            f"{before}{label}{w:.1f} rad/s, {1e3 * x:+.2f} mm, {tau:.0f} N.m; "
            for before, w, x, tau in zip(captions, at["w"], at["x"], result["motor.tau"][picked])
        ]
    captions = [text.strip("; ") for text in captions]
    return Motion(title, times, slow, captions, shapes, NOTE)


def crank_conveyor(p: Parameters, at: Columns) -> list[Shape]:
    """Crank, rod, trough, spring and damper, the crank drawn ENLARGED times as long as it is."""
    phi, l = at["phi"], p["rod.l"]
    r = ENLARGED * p["crank.r"]
    pin = (r * np.sin(phi), -r * np.cos(phi))
    x = l + ENLARGED * at["x"]
    end, height, wall = 1.1 * l, 0.12 * l, 2.7 * l
    trough = line((x, 0), (x, height), (x + end, height), (x + end, -height), (x, -height), (x, 0))
    coil = motion.spring((x + end, 0.05 * l), (wall, 0.05 * l), 0.05 * l, 14)
    damper = motion.damper((x + end, -0.07 * l), (wall, -0.07 * l), 0.035 * l)
    arrows = motion.arrow(line((1.9 * l, 2.0 * height), (2.2 * l, 2.0 * height)), 0.05 * l)
    floor = -1.35 * height
    turns = motion.arrow(motion.arc(0.0, 0.0, 1.3 * r, -0.3 * math.pi, 0.2 * math.pi), 0.3 * r)
    return [
        Shape("floor", motion.ground(0.8 * l, floor, wall, floor, 0.05 * l), "grey", 1.5),
        Shape("wall", motion.ground(wall, height, wall, floor, 0.05 * l), "grey", 1.5),
        Shape("bearing", motion.pivot(0.0, 0.0, 0.6 * r), "grey", 1.5),
        Shape("circle of the crank", motion.circle(0.0, 0.0, r), "grey", 1.0),
        Shape("spring", coil, "green", 2.0, label=3),
        Shape("damper", damper, "purple", 1.5),
        Shape("trough", trough, "blue", 4.0, label=1),
        Shape("rod", line(pin, (x, 0.0)), "gold", 4.0),
        Shape("crank", line((0.0, 0.0), pin), "red", 6.0),
        Shape("turns", turns, "red", 1.5),
        Shape("moves", arrows, "blue", 1.5),
    ]


def live_motion(title: str, p: Parameters, slow: float, window: str = "") -> LiveMotion:
    """The conveyors of the runs of a live page, the first on top; `p` are the parameters of the conveyor."""
    r = p["crank.r"]
    return LiveMotion(
        title,
        lambda at: crank_conveyor(p, {"phi": at["conveyor.phi"], "x": at["conveyor.x"]}),
        [Coordinate("conveyor.phi", 0.0, 2 * math.pi, (1.0,)), Coordinate("conveyor.x", -r, r)],
        CAPTIONS,
        slow,
        NOTE,
        window,
        (0.0, -0.8 * p["rod.l"]),
    )
