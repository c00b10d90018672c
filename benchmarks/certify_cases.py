"""Synthetic cases for benchmarks/certify.py: solutions that are known, and what of them can be determined.

Each is a function of time and of the step, whose limit for a step of zero is the truth. It says beforehand
which figures can be determined, and which cannot be, so that they must be refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from cosim import Result, System, run
from cosim.series import TIME, Column, Kind

Array = NDArray[np.float64]
Draw = Callable[[float, float], float]
POINTS = frozenset({"last", "largest", "smallest"})
MEANS = frozenset({"mean", "rms"})
TIMES = frozenset({"time of largest", "crossing"})
ALL = POINTS | MEANS | TIMES
NONE: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Case:
    """A system, its stop and its longest step [s], and the truth of some columns, x(t).

    `changes` has of discrete columns the level that they pass, and when first [s]; `promises` which figures must be
    stated and which refused; of the others either is right, as long as a stated error holds.
    """

    system: System
    stop: float
    step: float
    exact: Mapping[str, Callable[[Any], Any]]
    runner: Callable[..., Result] = run
    changes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    promises: Mapping[str, bool] = field(default_factory=dict)
    algorithms: Sequence[str] = ()


def synthetic(
    x: Callable[[Array, float], Array],
    stop: float = 1.0,
    step: float = 0.01,
    order: int = 1,
    determinable: frozenset[str] = ALL,
    undeterminable: frozenset[str] = NONE,
    *,
    events: tuple[float, ...] = (),
    kind: Kind = Kind.CONTINUOUS,
) -> Case:
    """A column x(t, h) over time t [s] and the step h [s], with x(t, 0) the truth; `events` have rows beside the grid."""

    def runner(_: System, *, step: float, **__: Any) -> Result:
        t = np.union1d(np.linspace(0.0, stop, round(stop / step) + 1), events)
        report = {"convergence_order": order, "warnings": []}
        return Result([TIME, Column("x", kind=kind)], report, [t, x(t, step)].__getitem__)

    def truth(t: Any) -> Array:
        return x(np.atleast_1d(np.asarray(t, dtype=float)), 0.0).reshape(np.shape(t))

    promises = dict.fromkeys(determinable, True) | dict.fromkeys(undeterminable, False)
    return Case(System({}), stop, step, {"x": truth}, runner, {}, promises, ("jacobi",))


def synthetic_cases(draw: Draw) -> dict[str, Case]:
    """Fifteen cases with parameters drawn between bounds."""
    a, w = draw(0.05, 0.2), draw(5.0, 9.0)
    first, rate, gain, bounce = draw(0.9, 1.1), draw(500.0, 1000.0), draw(1.5, 2.5), draw(0.5, 0.8)
    at, lag = draw(0.3, 0.6), draw(0.03, 0.08)
    rows = draw(33.1, 33.9)  # 33 is their number: the level is between two whole ones
    sine = lambda t, h: np.sin(w * t) * (1.0 + a * h)
    return {
        "chaotic": synthetic(
            _lorenz(first), 20.0, 0.01, 2, frozenset({"crossing"}), ALL - {"crossing", "smallest"}
        ),
        "no order": synthetic(
            lambda t, h: np.sin(w * t) + _slow(h) * (1.0 + t),
            determinable=NONE, undeterminable=POINTS | MEANS,
        ),
        "stiff": synthetic(partial(_stiff, rate=rate), determinable=MEANS | {"last"}),
        "dead time": synthetic(partial(_dead_time, gain=gain), 1.2, 0.02),
        "ties of peaks": synthetic(
            lambda t, h: np.abs(np.sin(2.0 * math.pi * t)) * (1.0 - a * h),
            determinable=POINTS | MEANS | {"crossing"},
        ),
        "hidden impacts": synthetic(
            partial(_ball, restitution=bounce, slope=a), determinable=MEANS | {"last"}
        ),
        "events beside rows": synthetic(sine, events=(round(at, 2) + 1e-6,)),
        "jump of an input": synthetic(
            lambda t, h: -np.expm1(-np.maximum(t - at - 0.5 * h, 0.0) / lag),
            determinable=POINTS | MEANS | {"crossing"},
        ),
        "play": synthetic(
            lambda t, h: np.maximum(sine(t, h) - 0.3, 0.0), determinable=POINTS | MEANS
        ),
        "beats": synthetic(
            lambda t, h: np.sin(5.0 * w * t * (1.0 + h * h)) + np.sin(5.2 * w * t),
            2.0, 0.005, 2, POINTS | MEANS,
        ),
        "small units": synthetic(lambda t, h: 3e-9 * sine(t, h)),
        "whole numbers": synthetic(lambda t, h: 160000.0 * t**2),
        "counted": synthetic(
            lambda t, h: np.floor(rows * t * (1.0 - 0.1 * a * h)),
            determinable=frozenset({"smallest"}), kind=Kind.INTEGER,
        ),
        "rounding": synthetic(
            lambda t, h: 1e8 + 1e-3 * (1.0 + h) * np.sin(w * t), determinable=NONE
        ),
        "solver noise": synthetic(
            lambda t, h: np.sin(w * t) * (1.0 + a * h * h) + 1e-7 * _noise(t, h),
            order=2, determinable=NONE,
        ),
    }  # fmt: skip


def _slow(h: float) -> float:
    """An error that falls with no order at all."""
    return 1.0 / math.log(1e3 / h) if h else 0.0


def _noise(t: Array, h: float) -> Array:
    """What the solver inside a part adds: as if at random, and none without steps."""
    return np.sin(1e5 * t * (1.0 + h) + 1e4 * h) * bool(h)


def _stiff(t: Array, h: float, rate: float) -> Array:
    """Solve x' = rate (cos t - x) - sin t from 0, by implicit Euler steps."""
    if not h:
        return np.cos(t) - np.exp(-rate * t)
    steps = round(1.0 / h)
    x = np.zeros(steps + 1)
    for k in range(steps):
        now = (k + 1) * h
        x[k + 1] = (x[k] + h * (rate * math.cos(now) - math.sin(now))) / (1.0 + rate * h)
    return np.interp(t, np.linspace(0.0, 1.0, steps + 1), x)


def _dead_time(t: Array, h: float, gain: float) -> Array:
    """Solve x' = -gain x(t - 0.4), 1 before the start; by Euler steps, or by the method of steps."""
    delay, stop = 0.4, 1.2
    if h:
        steps, behind = round(stop / h), round(delay / h)
        x = np.ones(steps + 1)
        for k in range(steps):
            x[k + 1] = x[k] - gain * h * (x[k - behind] if k >= behind else 1.0)
        return np.interp(t, np.linspace(0.0, stop, steps + 1), x)
    pieces = [np.polynomial.Polynomial([1.0])]
    for _ in range(round(stop / delay)):
        integral = (-gain * pieces[-1]).integ()
        pieces.append(
            integral + pieces[-1](delay) - integral(0.0) if len(pieces) > 1 else integral + 1.0
        )
    k = np.minimum((t / delay).astype(int), len(pieces) - 2)
    return np.array([pieces[1 + n](s - n * delay) for n, s in zip(k, t)])


def _ball(t: Array, h: float, restitution: float, slope: float) -> Array:
    """The speed of a ball dropped from 1 m onto the floor at a time that no row shows."""
    g = 9.81 * (1.0 + slope * h)
    fall = math.sqrt(2.0 / g)
    return np.where(t < fall, -g * t, restitution * g * fall - g * (t - fall))


def _lorenz(first: float) -> Callable[[Array, float], Array]:
    """Solve the Lorenz equations for x by Heun's method, and by DOP853."""

    def rate(_: float, x: Array) -> Array:
        return np.array(
            [10.0 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]]
        )

    begin = np.array([first, 1.0, 20.0])
    exact = solve_ivp(
        rate, (0.0, 20.0), begin, method="DOP853", rtol=1e-13, atol=1e-13, dense_output=True
    ).sol
    runs: dict[float, Array] = {}

    def heun(h: float) -> Array:
        rows = [begin]
        for _ in range(round(20.0 / h)):
            k = rate(0.0, rows[-1])
            rows.append(rows[-1] + h / 2.0 * (k + rate(0.0, rows[-1] + h * k)))
        return np.array(rows)[:, 0]

    def x(t: Array, h: float) -> Array:
        if not h:
            return np.asarray(exact(t)[0])
        if h not in runs:
            runs[h] = heun(h)
        return np.interp(t, np.linspace(0.0, 20.0, len(runs[h])), runs[h])

    return x


def state_at(solution: Callable[[Any], Any], k: int, t: Any) -> Any:
    """State number k at times t."""
    return solution(t)[k]
