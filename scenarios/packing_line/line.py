"""What a run of the packing line tells: its releases, and what its powers are made of."""

import math
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, SetupError
from workbench import Table
from workbench.measure import Samples, harmonics

Frame = Any
HIGHEST = {"iron": 12, "conveyor": 4}
MAIN = 0.1
UNITS = {"drive": "1", "order": "1", "frequency": "Hz", "own": "W", "supply": "W"}
FIRST_RELEASE = math.radians(100.0)


def powers(r: Result) -> dict[str, Samples]:
    """Mechanical power of each motor and of the supply [W]."""
    parts = {drive: r[f"{drive}_motor.P"] for drive in HIGHEST}
    return parts | {"supply": parts["iron"] + parts["conveyor"]}


def releases(r: Result) -> list[int]:
    """The rows of the releases, whole cycles apart; raises SetupError where the cam does not keep
    turning."""
    phi = r["iron.phi"]
    if phi[-1] < FIRST_RELEASE + 2 * math.pi or np.diff(phi).min() <= 0.0:
        raise SetupError(
            f"the cam stands or turns back, at iron.phi = {phi[-1]:.4g} rad in the end: at this "
            "speed its motor cannot lift the iron"
        )
    found: list[int] = (np.flatnonzero(np.diff(r["iron.top_dwell"]) > 0.5) + 1).tolist()
    if len(found) < 2:
        raise SetupError(f"{len(found)} top dwells begin until t = {r['time'][-1]:g} s, two must")
    return found


def window(r: Result) -> slice:
    """The rows of the whole cycles."""
    return slice(releases(r)[0], releases(r)[-1] + 1)


def averages(r: Result) -> dict[str, float]:
    """Of the powers over whole turns of the cam, mean and rms ripple; the cycle, and the cam's speed."""
    when = CubicSpline(r["iron.phi"], r["time"])
    turns = int((r["iron.phi"][-1] - FIRST_RELEASE) / (2 * math.pi))
    began, ended = (float(when(FIRST_RELEASE + 2 * math.pi * k)) for k in (0, turns))
    time = ended - began
    found = {"cycle": time / turns, "cam": 2 * math.pi * turns / time}
    for name, P in powers(r).items():
        mean = float(CubicSpline(r["time"], P).integrate(began, ended)) / time
        square = CubicSpline(r["time"], (P - mean) ** 2)
        found[f"mean_{name}"] = mean
        found[f"rms_{name}"] = math.sqrt(float(square.integrate(began, ended)) / time)
    return found


def ripple(r: Result) -> Frame:
    """The orders of cam and crank over the whole cycles, a row each: the drive whose angle counts
    it, frequency [Hz], amplitude in its motor's power and in the supply's [W]."""
    rows, power, orders = window(r), powers(r), []
    for drive, highest in HIGHEST.items():
        phi = r[f"{drive}.phi"][rows]
        rate = float(np.ptp(phi) / (2 * math.pi * np.ptp(r["time"][rows])))
        sizes = [np.abs(harmonics(phi, power[x][rows], highest)) for x in (drive, "supply")]
        orders += [(drive, k, k * rate, *size) for k, size in enumerate(zip(*sizes), 1)]
    return Table.of_rows(orders, UNITS).frame


def nearest(orders: Frame) -> Frame:
    """Of the strong orders of cam and crank, "_x" and "_y", the two nearest in frequency."""
    strong = orders[orders["own"] > MAIN * orders.groupby("drive")["own"].transform("max")]
    iron, conveyor = (strong[strong["drive"] == drive] for drive in HIGHEST)
    pairs = iron.merge(conveyor, how="cross")
    gaps = (pairs["frequency_x"] - pairs["frequency_y"]).abs()
    return pairs.assign(gap=gaps).loc[gaps.idxmin()]
