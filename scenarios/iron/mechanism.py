"""The sealing iron as lines in motion, from the outputs and parameters of its FMU."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import Result, System
from workbench.report import motion as draw
from workbench.report.motion import Motion, Samples, Shape, line

from .drive import turn

AXIS = math.radians(-35.0)
ROLLER = 0.012
SEEN = ("phi", "alpha", "beta", "H", "lift", "motion")
PHASES = ("dwell", "up", "down", "stuck")
NOTE = f"The radius of the roller, {1e3 * ROLLER:g} mm, is chosen for the drawing."


def motion(title: str, result: Result, alone: System, last: float, slow: float) -> Motion:
    """The mechanism up to a time [s] of a run; `alone` is the iron drive by itself."""
    picked = draw.rows(result["time"], 0.0, last)
    shapes, captions = drawn(result, alone, picked)
    return Motion(title, result["time"][picked], slow, captions, shapes, NOTE)


def drawn(
    result: Result, alone: System, picked: NDArray[np.int64]
) -> tuple[list[Shape], list[str]]:
    """The lines at some rows, and what is to be said of each: time, cam, phase and lift."""
    at = draw.columns(result, "iron", SEEN, picked)
    parameters = result.provenance["parts"]["iron"]["parameters"]
    captions = [
        f"{t:.3f} s: cam {phi % 360:.1f} deg, iron {PHASES[int(phase)]}, lift {1e3 * lift:.1f} mm"
        for t, phi, phase, lift in zip(
            result["time"][picked] - result["time"][picked[0]],
            np.degrees(at["phi"]), at["motion"], at["lift"],
        )
    ]  # fmt: skip
    return iron_drive(parameters, at, cam(parameters, alone)), captions


def iron_drive(p: Mapping[str, Any], at: draw.Columns, cam: Samples) -> list[Shape]:
    """Cam, rocker with its roller, link, chain over its sprocket, iron in its guide above the product."""
    C, A, R = p["sprocket.C"], p["sprocket.A"], p["sprocket.R"]
    l_K, l_T = p["rocker.l_K"], p["link.l"]
    phi, alpha, beta, H = (at[name] for name in ("phi", "alpha", "beta", "H"))
    hub, roller = _hub(p), _roller(p, alpha)
    x_hub, y_hub = hub.tolist()
    c, s = np.cos(phi)[:, None], np.sin(phi)[:, None]
    body = hub + np.stack([cam[0] * c - cam[1] * s, cam[0] * s + cam[1] * c], axis=-1)
    D = (l_K * np.cos(alpha), l_K * np.sin(alpha))
    joint = (D[0] + l_T * np.cos(beta), D[1] + l_T * np.sin(beta))
    leaves = beta - math.pi / 2 if p["wrap"] else np.full_like(beta, math.pi / 2)
    around = [leaves + (math.pi - leaves) * share for share in np.linspace(0.0, 1.0, 16)]
    over = [(-C + R * np.cos(angle), A + R * np.sin(angle)) for angle in around]
    x, y, half = -C - R, A - H, 0.05
    left, right, bottom, top = x - half, x + half, y - half, float(np.max(y)) + 0.12
    low = float(np.min(bottom))
    table, aside, rail = low - 0.09, x + 0.7 * half, half + 0.008
    above = p["spring.side"] < 0
    fixed, coil = ((aside, top), (aside, y)) if above else ((aside, table), (aside, bottom))
    ceiling = [Shape("ceiling", draw.ground(right, top, x, top, 0.02), "grey", 1.5)]
    return [
        Shape("table", draw.ground(x - 0.08, table, x + 0.08, table, 0.02), "grey", 1.5),
        Shape("sprocket", draw.circle(-C, A, R), "gold", 1.5, label=42),
        Shape("bearing of the sprocket", draw.pivot(-C, A, 0.012), "grey", 1.5),
        Shape("bearing of the rocker", draw.pivot(0.0, 0.0, 0.012), "grey", 1.5),
        Shape("bearing of the cam", draw.pivot(x_hub, y_hub, 0.012), "grey", 1.5),
        Shape("cam", body, "red", 3.0, closed=True, label=0),
        Shape("turns", draw.arrow(draw.arc(x_hub, y_hub, 0.05, -0.4, 1.2), 0.015), "red", 1.5),
        Shape("mark of the cam", line(tuple(hub), (body[:, 0, 0], body[:, 0, 1])), "red", 1.0),
        Shape("rocker", line(tuple(roller.T), (0.0, 0.0), D), "grey", 6.0, label=1),
        Shape("roller", roller[:, None] + draw.circle(0.0, 0.0, ROLLER), "black", 2.0, label=6),
        Shape("link", line(D, joint), "blue", 4.0, label=1),
        Shape("chain", line(joint, *over, (x, y)), "gold", 2.5, label=1),
        Shape("spring", draw.spring(coil, fixed, 0.012), "purple", 1.5, label=6),
        Shape("product", line((left, low), (x, low), (x, table), (left, table)), "sky", 2.0,
              closed=True, label=3),
        Shape("guide", line((x - rail, top), (x - rail, low)), "grey", 1.5),
        Shape("guide", line((x + rail, top), (x + rail, low)), "grey", 1.5),
        Shape("iron", line((left, y), (right, y), (right, bottom), (left, bottom)), "green", 5.0,
              closed=True, label=2),
        *(ceiling if above else []),
    ]  # fmt: skip


def cam(p: Mapping[str, Any], alone: System) -> Samples:
    """The working profile at phi = 0, shape (2, n), from a turn: the path of the roller's centre
    about the cam, nearer by the roller's radius."""
    one = turn(1.0, alone, 180, ("iron.phi", "iron.alpha"))
    phi, alpha = one["iron.phi"][:-1], one["iron.alpha"][:-1]
    reach = (_roller(p, alpha) - _hub(p)).T
    distance, bearing = np.hypot(*reach), np.arctan2(reach[1], reach[0]) - phi
    path = np.stack([distance * np.cos(bearing), distance * np.sin(bearing)])
    along = np.roll(path, -1, axis=1) - np.roll(path, 1, axis=1)
    normal = np.stack([-along[1], along[0]]) / np.hypot(*along)
    inwards = -np.sign(np.sum(normal * path))
    return np.asarray(path + ROLLER * inwards * normal)


def _hub(p: Mapping[str, Any]) -> Samples:
    """The cam's axis, seen from the rocker's, shape (2,)."""
    return np.asarray(p["rocker.L"] * np.array([math.cos(AXIS), math.sin(AXIS)]))


def _roller(p: Mapping[str, Any], alpha: Samples) -> Samples:
    """The roller's centre, shape (frames, 2)."""
    angle = AXIS - (p["rocker.alpha0"] - alpha)
    return np.asarray(p["rocker.l"] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
