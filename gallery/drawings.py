"""The drawings of machines.

They are poses of the mechanisms that the pages of questions animate, with the symbols of the equations. A
machine that no question animates has a separate drawing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim import Result, System
from scenarios.conveyor.motion import crank_conveyor
from scenarios.exciter.motion import exciter
from scenarios.fmu_files import CLONE as ROOT
from scenarios.fmu_files import FMUS
from scenarios.iron import motion as iron
from scenarios.orientator import machine
from scenarios.orientator import motion as orientator
from workbench.charts import motion
from workbench.charts.motion import Motion, Shape
from workbench.charts.svg import Symbol, drawing
from workbench.live import LiveMotion

CONVEYOR = (
    Symbol("r", "crank", (0, 1), (-12, 2)),
    Symbol("l", "rod", (0, 1)),
    Symbol("m", "trough", (1, 3), (0, -6)),
    Symbol("c", "spring", (1, 14), (0, 20)),
    Symbol("α", "damper", (0, 1), (-6, -13)),
    Symbol("x", "moves", (0, 1)),
    Symbol("φ, ω, τ", "turns", (0,), (36, -8)),
)
EXCITER = (
    Symbol("c", "spring", (1, 12), (0, 34)),
    Symbol("d", "damper", (7, 8), (0, -44)),
    Symbol("m", "body", (0,), (18, 12)),
    Symbol("m_u", "mass", (0,), (22, 6)),
    Symbol("r", "arm", (0, 1), (-10, 4)),
    Symbol("x", "moves", (0, 1)),
    Symbol("φ, ω, τ", "turns", (24,)),
)
IRON = (
    Symbol("l", "rocker", (0, 1), (-16, -4)),
    Symbol("rocker, l_K", "rocker", (1, 2), (48, 0)),
    Symbol("link, l_T", "link", (0, 1), (0, 12)),
    Symbol("chain, H", "chain", (17,), (36, 150)),
    Symbol("φ, ω, τ", "turns", (48,), (0, 22)),
    Symbol("spring, c", "spring", (0, 13), (46, -8)),
)
ORIENTATOR = (
    Symbol("catcher, l_1", "catcher", (0, 1), (-48, -12)),
    Symbol("φ_1", "pivot", (1,), (52, -2)),
    Symbol("cup, φ_2", "cup", (0, 26), (-20, -40)),
)


def drawings() -> dict[Path, str]:
    """The drawings made from mechanisms, by the file in which each is kept."""
    texts = {
        "crank_conveyor": drawing(
            crank_at_angle("CrankConveyor", crank_conveyor, phi=2.3), CONVEYOR
        ),
        "unbalance_exciter": drawing(crank_at_angle("UnbalanceExciter", exciter, phi=0.7), EXCITER),
        "iron_drive": drawing(iron_lifting(), IRON),
        "gravity_orientator": drawing(cup_turning(), ORIENTATOR),
    }
    return {ROOT / "components" / name / "drawing.svg": text for name, text in texts.items()}


def crank_at_angle(
    fmu: str, shapes: Callable[[Any, motion.Columns], list[Shape]], phi: float
) -> Motion:
    """A machine with a crank at an angle [rad]."""
    _, r = started("part", fmu, {"part.phi": phi})
    positions = motion.columns(r, "part", ("phi", "x"), np.array([0]))
    return motion_of_pose(shapes(r.provenance["parts"]["part"]["parameters"], positions))


def iron_lifting() -> Motion:
    """The iron drive while the iron goes up."""
    system, r = started("iron", "IronDrive", {"iron.phi": 1.0})
    return motion_of_pose(shapes_at(iron.live_motion("", r, system, 1.0), r, np.array([0])))


def cup_turning() -> Motion:
    """The cup while it turns over, with the places where it lands and where it is oriented."""
    system = machine.system(
        {"orientator": FMUS / "native" / "GravityOrientator.fmu"}, 4.0, 0.35, {}
    )
    r = machine.until_oriented_or_jammed(cosim.run(system, stop=1.0, step=1e-3))
    spans = {span.text: span for span in machine.stages(r)}
    now = (spans["turning"].first + spans["turning"].last) / 2
    picked = np.searchsorted(r["time"], [now, spans["joint"].first, r["time"][-1]])
    shapes = shapes_at(orientator.live_motion("", r, 1.0), r, picked)
    return motion_of_pose(shapes, {1: "landing", 2: "oriented"})


def shapes_at(moving: LiveMotion, r: Result, picked: NDArray[np.intp]) -> Sequence[Shape]:
    """A mechanism at some rows."""
    return moving.draw({x.column: r[x.column][picked] for x in moving.coordinates})


def started(part: str, fmu: str, start: Mapping[str, float]) -> tuple[System, Result]:
    """A machine by itself, and its outputs at the start."""
    system = System({part: FMUS / "native" / f"{fmu}.fmu"}, start=start)
    return system, cosim.run(system, stop=1e-3, step=1e-3)


def motion_of_pose(
    shapes: Sequence[Shape], ghosts: Mapping[int, str] = MappingProxyType({})
) -> Motion:
    """Shapes as a motion that stands still."""
    return Motion("", np.zeros(1), 1.0, [""], shapes, ghosts=ghosts)
