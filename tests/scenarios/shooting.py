"""Steady motions of a drive with Kloss's characteristic by shooting: Newton's method on the map of a revolution.

The crank angle takes the place of time, as in orbit_oracle.py. Many motions are integrated side by side: states are the
speed w and the torque M, shape (2, n).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.scenarios.orbit_oracle import Drive, order2

Samples = NDArray[np.float64]
TURN = 2.0 * math.pi
#: Speeds below this share of the synchronous one stop a motion: nobody would call that a steady one.
STOPPED = 0.02
#: Differences of states for the derivative of the map, and between two that are one motion; relative.
DIFFERENCE, SAME = 1e-6, 1e-5
#: Revolutions that half of the starts run before Newton's method, and most of its steps.
TURNS, STEPS = 40, 20
#: Longest step, and the last, over synchronous speed and breakdown torque.
LONGEST, ARRIVED = 0.3, 1e-8
#: Angles of a revolution at which its torque is read.
ROWS = 256


class Motor(NamedTuple):
    """Kloss's characteristic: breakdown torque [N.m], its slip, and synchronous speed [rad/s], shape (n,)."""

    tau_b: Any
    s_b: Any
    w_s: Any

    @classmethod
    def of(cls, start: Mapping[str, Any]) -> Motor:
        """That of start values of the FMUs."""
        values = [start[f"motor.kloss.{name}"] for name in cls._fields]
        return cls(*np.broadcast_arrays(*map(np.atleast_1d, values)))

    @property
    def size(self) -> Samples:
        """What states are compared with, shape (2, n)."""
        return np.array([self.w_s, self.tau_b])

    def torque(self, w: Any) -> Any:
        """The steady torque at a speed [N.m]."""
        s = 1.0 - w / self.w_s
        return 2.0 * self.tau_b * s * self.s_b / (s**2 + self.s_b**2)


def revolved(drive: Drive, motor: Motor, states: Samples, turns: int = 1, rows: int = 0) -> Samples:
    """The states after so many revolutions, or at so many even angles of the last one, shape (2, n, rows); nan if stopped."""

    def rates(phi: float, y: Samples) -> Samples:
        w, M = y.reshape(2, -1)
        runs = w > STOPPED * motor.w_s
        change = drive.acceleration(phi, w, M), (motor.torque(w) - M) / drive.T
        return np.concatenate(change) * np.tile(runs / np.where(runs, w, 1.0), 2)

    last = turns * TURN
    angles = np.linspace(last - TURN, last, rows + 1)[:-1] if rows else [last]
    done = solve_ivp(rates, (0.0, last), states.ravel(), "DOP853", angles, rtol=1e-10, atol=1e-10)
    ends = done.y.reshape(2, -1, len(angles))
    ends = np.where(
        (ends[0] > 2.0 * STOPPED * motor.w_s[:, None]).all(-1)[None, :, None], ends, math.nan
    )
    return ends if rows else ends[..., 0]


def derivative(drive: Drive, motor: Motor, states: Samples) -> tuple[Samples, Samples]:
    """The map of a revolution at states, and its derivative by differences, shape (n, 2, 2)."""
    size = DIFFERENCE * motor.size
    beside = [states + size * np.eye(2)[:, [k]] for k in (0, 1)]
    every = Motor(*(np.tile(x, 3) for x in motor))
    here, *ends = np.split(revolved(drive, every, np.hstack([states, *beside])), 3, 1)
    columns = [(x - here) / h for x, h in zip(ends, size)]
    return here, np.moveaxis(np.array(columns), (0, 1, 2), (2, 1, 0))


def repeated(drive: Drive, motor: Motor, states: Samples) -> tuple[Samples, Samples]:
    """The states of repeating motions, and their largest multiplier; nan where a start leads to none.

    Of the starts every second runs some revolutions first, by which it is drawn to a stable motion.
    """
    states, size = states.copy(), motor.size
    states[:, 1::2] = revolved(drive, Motor(*(x[1::2] for x in motor)), states[:, 1::2], TURNS)
    for _ in range(STEPS):
        ends, slopes = derivative(drive, motor, np.where(np.isnan(states), size, states))
        good = np.isfinite(states + ends).all(0) & np.isfinite(slopes).all((1, 2))
        step = np.full_like(states, math.nan)
        step[:, good] = np.linalg.solve(
            np.eye(2) - slopes[good], (ends - states)[:, good].T[..., None]
        )[..., 0].T
        states = states + step * np.minimum(
            1.0, LONGEST * size / np.maximum(np.abs(step), 1e-300)
        ).min(0)
    arrived = (np.abs(step) < ARRIVED * size).all(0)
    multipliers = np.full(len(arrived), math.nan)
    multipliers[arrived] = np.abs(np.linalg.eigvals(slopes[arrived])).max(1)
    return states, multipliers


class Motion(NamedTuple):
    """A stable motion: its state (w, M) at the crank angle 0, largest multiplier, and torque ripple of order 2 [N.m]."""

    state: Samples
    multiplier: float
    tau2: complex


def stable_motions(drive: Drive, motor: Motor, starts: Samples) -> list[list[Motion]]:
    """The different stable motions of a drive with several motors, shape (motors,), to which starts lead, shape
    (2, motors, starts): of each those with a large torque ripple first.
    """
    every = Motor(*(np.repeat(x, starts.shape[2]) for x in motor))
    states, multipliers = repeated(drive, every, starts.reshape(2, -1))
    found = [np.empty(0, int) for _ in motor.w_s]
    for k in np.flatnonzero(multipliers < 1.0):
        own = k // starts.shape[2]
        beside = np.abs(states[:, found[own]] - states[:, [k]]) / every.size[:, [k]]
        if not (beside.max(0) < SAME).any():
            found[own] = np.append(found[own], k)
    some = np.concatenate(found)
    turns = revolved(drive, Motor(*(x[some] for x in every)), states[:, some], rows=ROWS)[1]
    motions = {
        k: Motion(states[:, k], float(multipliers[k]), order2(x)) for k, x in zip(some, turns)
    }
    return [sorted((motions[k] for k in of_one), key=lambda x: -abs(x.tau2)) for of_one in found]
