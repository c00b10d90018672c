r"""First-order theory of the crank conveyor with a lagging motor, the paper's formulas corrected.

Complex amplitudes follow the crank angle in the sine convention, X = Im(X_hat exp(i k phi)):
L_hat load torque, W_hat speed, M_hat motor torque, all of order 2, at mean speed nu. All is plain
arithmetic: machines whose fields are arrays, or an array of speeds, give arrays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from cosim.system import Value

FIELDS = {
    "motor.B": "B",
    "motor.T": "T",
    "conveyor.rotor.J": "theta1",
    "conveyor.crank.r": "r",
    "conveyor.trough.m": "m",
    "conveyor.spring.c": "c",
    "conveyor.trough.d": "d",
}


@dataclass(frozen=True)
class Machine:
    """Motor line (B, T) and conveyor (theta1, m, r, c, d) in SI units."""

    B: float
    T: float
    theta1: float = 0.49
    m: float = 200.0
    r: float = 0.010
    c: float = 720000.0
    d: float = 4000.0

    @property
    def theta0(self) -> float:
        """Mean reduced inertia [kg.m2]."""
        return self.theta1 + self.m * self.r**2 / 2

    @property
    def load_slope(self) -> float:
        """Mean load torque over speed, alpha r^2 / 2 [N.m.s/rad]."""
        return self.d * self.r**2 / 2

    @property
    def slope(self) -> float:
        """B* = B + alpha r^2 / 2 [N.m.s/rad]."""
        return self.B + self.load_slope

    @property
    def J(self) -> float:
        """theta0 + T alpha r^2 / 2 [kg.m2]."""
        return self.theta0 + self.T * self.load_slope

    @property
    def nu_res(self) -> Any:
        """Phase resonance (22) [rad/s]."""
        return (self.slope / (self.theta0 * self.T)) ** 0.5 / 2

    @property
    def zeta(self) -> Any:
        """Damping ratio of the torque ripple."""
        return self.J / (2 * (self.slope * self.theta0 * self.T) ** 0.5)

    def A(self, nu: float) -> float:
        """No-speed torque of the motor line that gives the mean speed nu, from (18) [N.m]."""
        return self.slope * nu

    def load_ripple(self, nu: Any) -> Any:
        """L_hat at constant speed [N.m]."""
        return self.r**2 / 2 * (self.c - self.m * nu**2 + 1j * self.d * nu)

    def _denominator(self, nu: Any) -> Any:
        return self.slope - 4 * self.theta0 * self.T * nu**2 + 2j * nu * self.J

    def speed_ripple(self, nu: Any) -> Any:
        """W_hat of (20) [rad/s]."""
        return -self.load_ripple(nu) * (1 + 2j * self.T * nu) / self._denominator(nu)

    def torque_ripple(self, nu: Any) -> Any:
        """M_hat of (26) [N.m]."""
        return self.B * self.load_ripple(nu) / self._denominator(nu)

    def follow(self, start: Mapping[str, Value]) -> Machine:
        """The machine with start values of the FMUs, as far as the theory knows them."""
        known = {FIELDS[name]: float(value) for name, value in start.items() if name in FIELDS}
        return replace(self, **known)

    def start(self, nu: float) -> dict[str, float]:
        """Start values of the two FMUs `motor` and `conveyor`, near the orbit of mean speed nu."""
        return {
            "motor.A": self.A(nu),
            "motor.tau": self.load_slope * nu,
            "conveyor.phi": 0.0,
            "conveyor.w": nu,
            **{name: getattr(self, field) for name, field in FIELDS.items()},
        }


SETS: Mapping[str, Machine] = {"A": Machine(B=199.8, T=0.0625), "B": Machine(B=35.8, T=0.02)}


def coupling_map(machine: Machine, algorithm: str, h: float) -> NDArray[np.float64]:
    """Small deviations (w, tau) one communication step of h seconds later, shape (2, 2).

    Both units exact, inputs held, the inertia at its mean: the motor's step maps tau to
    e tau - B (1 - e) w, the conveyor's w to f w + (1 - f) tau / (alpha r^2 / 2).
    """

    def motor(h: float) -> NDArray[np.float64]:
        e = math.exp(-h / machine.T)
        return np.array([[1.0, 0.0], [-machine.B * (1 - e), e]])

    lost = machine.load_slope * h / machine.theta0
    share = -math.expm1(-lost) / lost if lost else 1.0
    conveyor = np.array([[math.exp(-lost), share * h / machine.theta0], [0.0, 1.0]])
    if algorithm == "jacobi":
        return np.vstack([conveyor[0], motor(h)[1]])
    if algorithm == "gauss-seidel":
        return np.asarray(conveyor @ motor(h))
    return np.asarray(motor(h / 2) @ conveyor @ motor(h / 2))


@cache
def longest_step(machine: Machine, algorithm: str) -> float:
    """The communication step [s] beyond which the coupled oscillation grows by itself."""

    def growth(h: float) -> float:
        return float(max(abs(np.linalg.eigvals(coupling_map(machine, algorithm, h))))) - 1.0

    steps = np.geomspace(1e-5, 1e2, 700) / machine.nu_res
    unstable = next((i for i, h in enumerate(steps) if growth(h) > 0.0), None)
    if unstable is None:
        return math.inf
    return float(brentq(growth, steps[unstable - 1], steps[unstable], xtol=1e-12))
