"""The sealing iron as lines in motion, from the outputs and parameters of its FMU.

Places in the plane are complex numbers x + i y [m], seen from the axis of the rocker.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import Result, System
from workbench.charts import motion as draw
from workbench.charts.motion import Shape, line
from workbench.live import Caption, Coordinate, LiveMotion

from .machine import turn

Positions = NDArray[np.complex128]
AXIS = math.radians(-35.0)
#: Radius of the roller [m], chosen for the drawing.
ROLLER = 0.012
COLUMNS = ("phi", "alpha", "beta", "H", "lift", "motion")
ANGLES = ("phi", "alpha", "beta")
#: points of the chain on its sprocket
ARC = 16
MOTION_PHASES = ("dwell", "up", "down", "stuck")
NOTE = f"The radius of the roller, {1e3 * ROLLER:g} mm, is chosen for the drawing."
CAPTIONS = (
    Caption("cam", "mod(iron.phi * 180 / pi, 360)", "deg"),
    Caption("iron", "iron.motion", texts=MOTION_PHASES),
    Caption("lift", "1e3 * iron.lift", "mm"),
)


def iron_drive(p: Mapping[str, Any], at: draw.Columns, cam: Positions) -> list[Shape]:
    """Cam, rocker with its roller, link, chain over its sprocket, iron in its guide above the product."""
    C, A, R = p["sprocket.C"], p["sprocket.A"], p["sprocket.R"]
    phi, alpha, beta, H = (at[name] for name in ("phi", "alpha", "beta", "H"))
    hub, roller = _centres(p, alpha)
    body = line(*(hub + np.outer(cam, np.exp(1j * phi))))
    D = p["rocker.l_K"] * np.exp(1j * alpha)
    joint = D + p["link.l"] * np.exp(1j * beta)
    leaves = beta - math.pi / 2 if p["wrap"] else np.full_like(beta, math.pi / 2)
    around = np.linspace(leaves, math.pi, ARC)
    x, y, half = -C - R, A - H, 0.05
    left, right, bottom, top = x - half, x + half, y - half, float(np.max(y)) + 0.12
    low = float(np.min(bottom))
    table, aside, rail = low - 0.09, x + 0.7 * half, half + 0.008
    above = p["spring.side"] < 0
    fixed, coil = ((aside, top), (aside, y)) if above else ((aside, table), (aside, bottom))
    ceiling = [Shape("ceiling", draw.ground(right, top, x, top, 0.02), "grey", 1.5)]
    turns = draw.arrow(draw.arc(hub.real, hub.imag, 0.05, -0.4, 1.2), 0.015)
    return [
        Shape("table", draw.ground(x - 0.08, table, x + 0.08, table, 0.02), "grey", 1.5),
        Shape("sprocket", draw.circle(-C, A, R), "gold", 1.5, label=42),
        Shape("bearing of the sprocket", draw.pivot(-C, A, 0.012), "grey", 1.5),
        Shape("bearing of the rocker", draw.pivot(0.0, 0.0, 0.012), "grey", 1.5),
        Shape("bearing of the cam", draw.pivot(hub.real, hub.imag, 0.012), "grey", 1.5),
        Shape("cam", body, "red", 3.0, closed=True, label=0),
        Shape("turns", turns, "red", 1.5),
        Shape("mark of the cam", line(hub, hub + cam[0] * np.exp(1j * phi)), "red", 1.0),
        Shape("rocker", line(roller, 0.0, D), "grey", 6.0, label=1),
        Shape("roller", line(roller) + draw.circle(0.0, 0.0, ROLLER), "black", 2.0, label=6),
        Shape("link", line(D, joint), "blue", 4.0, label=1),
        Shape("chain", line(joint, *(-C + 1j * A + R * np.exp(1j * around)), (x, y)), "gold", 2.5,
              label=1),
        Shape("spring", draw.spring(coil, fixed, 0.012), "purple", 1.5, label=6),
        Shape("product", line((left, low), (x, low), (x, table), (left, table)), "sky", 2.0,
              closed=True, label=3),
        *(Shape("guide", line((at, top), (at, low)), "grey", 1.5) for at in (x - rail, x + rail)),
        Shape("iron", line((left, y), (right, y), (right, bottom), (left, bottom)), "green", 5.0,
              closed=True, label=2),
        *(ceiling if above else []),
    ]  # fmt: skip


def cam(p: Mapping[str, Any], system: System) -> Positions:
    """The working profile at phi = 0, seen from its axis, from a turn: the path of the roller's
    centre, nearer by the roller's radius.
    """
    slow_turn = turn(system, 1.0, 180)
    hub, roller = _centres(p, slow_turn["iron.alpha"][:-1])
    path = (roller - hub) * np.exp(-1j * slow_turn["iron.phi"][:-1])
    along = np.roll(path, -1) - np.roll(path, 1)
    normal = 1j * along / abs(along)
    return np.asarray(path - ROLLER * np.sign((normal * path.conj()).real) * normal)


def live_motion(
    title: str, result: Result, system: System, slow: float, window: str = ""
) -> LiveMotion:
    """The mechanism, in the range of angles and heights that a run has."""
    p = result.provenance["parts"]["iron"]["parameters"]
    profile = cam(p, system)

    def shapes(at: draw.Columns) -> list[Shape]:
        return iron_drive(p, {name: at[f"iron.{name}"] for name in (*ANGLES, "H")}, profile)

    return LiveMotion(title, shapes, coordinates(result), CAPTIONS, slow, NOTE, window)


def coordinates(result: Result) -> list[Coordinate]:
    """What moves the lines: angles, of which the link turns the points of the chain by shares, and the height."""
    H = result["iron.H"]
    shares = tuple(float(x) for x in np.linspace(1.0, 0.0, ARC)[:-1])
    angles = [
        Coordinate(
            f"iron.{name}", *_range(result[f"iron.{name}"]), shares if name == "beta" else (1.0,)
        )
        for name in ANGLES
    ]
    return [*angles, Coordinate("iron.H", float(H.min()), float(H.max()))]


def _range(angle: Any) -> tuple[float, float]:
    """The range of an angle, at most a turn."""
    low = float(angle.min())
    return low, min(float(angle.max()), low + 2 * math.pi)


def _centres(p: Mapping[str, Any], alpha: Any) -> tuple[Any, Any]:
    """The cam's axis, and the roller's centre, shape (frames,)."""
    roller = p["rocker.l"] * np.exp(1j * (AXIS - p["rocker.alpha0"] + alpha))
    return p["rocker.L"] * np.exp(1j * AXIS), roller
