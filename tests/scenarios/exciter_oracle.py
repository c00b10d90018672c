"""Periodic orbits of the unbalanced rotor and their folds, from its equations, by SciPy; without FMUs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

DEFAULT = {"R": 5.0, "k": 0.2, "L": 2e-3, "J": 0.02, "m_u": 0.5, "r": 0.05, "d_r": 0.005,
           "m": 19.5, "c": 5e4, "d": 80.0}  # fmt: skip
NAMES = {
    "R": "motor.R", "k": "motor.k", "L": "motor.L", "J": "exciter.rotor.J", "m_u": "exciter.rotor.m",
    "r": "exciter.rotor.r", "d_r": "exciter.rotor.d", "m": "exciter.mount.m", "c": "exciter.mount.c",
    "d": "exciter.mount.d",
}  # fmt: skip


def rates(machine: Mapping[str, float], supply: float, y: Any) -> list[float]:
    """The rates of angle, current, speed, displacement and velocity."""
    R, k, L, J, m_u, r, d_r, m, c, d = (machine[name] for name in DEFAULT)
    U, (phi, i, w, x, v) = m_u * r, y
    s = U * math.sin(phi)
    force, torque = U * w * w * math.cos(phi) - d * v - c * x, k * i - d_r * w
    M, theta = m + m_u, J + U * r
    dv, dw = (theta * force + s * torque), (s * force + M * torque)
    dv, dw = dv / (M * theta - s * s), dw / (M * theta - s * s)
    return [w, (supply - R * i - k * w) / L, dw, v, dv]


def returned(machine: Mapping[str, float], supply: float, y: Any) -> tuple[Any, float]:
    """Current, speed, displacement and velocity one revolution after phi = 0, and the period."""

    def rhs(_: float, y: Any) -> list[float]:
        return rates(machine, supply, y)

    def turned(_: float, y: Any) -> float:
        return float(y[0] - 2 * math.pi)

    turned.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(
        rhs, (0.0, 9.0), [0.0, *y], method="DOP853", rtol=1e-11, atol=1e-13, events=turned
    )
    return run.y[1:, -1], float(run.t[-1])


def linearised(machine: Mapping[str, float], supply: float, y: Any) -> Any:
    """The map of a revolution, differentiated by central differences."""
    shifts = np.diag(1e-5 * np.maximum(abs(y), [0.1, 10.0, 1e-2, 0.5]))
    pairs = [
        (returned(machine, supply, y + s)[0], returned(machine, supply, y - s)[0]) for s in shifts
    ]
    return np.stack([(a - b) / (2 * s.sum()) for (a, b), s in zip(pairs, shifts)], axis=-1)


def guess(machine: Mapping[str, float], w: float) -> tuple[Any, float]:
    """States at phi = 0 and the voltage by averaged theory."""
    U, M = machine["m_u"] * machine["r"], machine["m"] + machine["m_u"]
    x = U * w**2 / (machine["c"] - M * w**2 + 1j * machine["d"] * w)
    tau = machine["d_r"] * w + machine["d"] * w * abs(x) ** 2 / 2
    supply = machine["R"] / machine["k"] * tau + machine["k"] * w
    return np.array([tau / machine["k"], w, x.real, -w * x.imag]), supply


def fold(machine: Mapping[str, float], w: float) -> tuple[float, float]:
    """Voltage and mean speed at which a periodic orbit near w has the Floquet multiplier 1."""

    def equations(z: Any) -> list[float]:
        y, supply = z[:4], float(z[4])
        multiplier = np.linalg.det(linearised(machine, supply, y) - np.eye(4))
        return [*(returned(machine, supply, y)[0] - y), multiplier]

    y, supply = guess(machine, w)
    z = np.array([*y, supply])
    for _ in range(5):  # Powell's method may stop early; it begins again with a new Jacobian
        z = root(equations, z, method="hybr", tol=1e-9).x
        if np.abs(equations(z)).max() < 1e-6:
            break
    assert np.abs(equations(z)).max() < 1e-6
    return float(z[4]), 2 * math.pi / returned(machine, float(z[4]), z[:4])[1]


def steady(machine: Mapping[str, float], supply: float, w: float) -> float:
    """Mean speed of the periodic orbit at a voltage."""

    def equations(y: Any) -> Any:
        return returned(machine, supply, y)[0] - y

    y = root(equations, guess(machine, w)[0], method="hybr", tol=1e-10).x
    assert np.abs(equations(y)).max() < 1e-7
    return 2 * math.pi / returned(machine, supply, y)[1]
