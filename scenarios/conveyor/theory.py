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
from typing import Any, NamedTuple

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


class Means(NamedTuple):
    """Means of the steady orbit to second order, in time but for `angle`: speed, its mean over the
    crank angle [rad/s], torque [N.m], and power from the supply, into trough and motor [W].

    The supply turns the field at the speed without load, A / B; what motor and shaft do not share,
    tau (A / B - w) = tau^2 / B, heats the motor. Without ripple they are those of (18) and (24).
    """

    speed: Any
    angle: Any
    torque: Any
    supply: Any
    trough: Any
    motor: Any


def means(machine: Machine, nu: Any, ripple: bool = True) -> Means:
    """What ripple makes of the means at the nominal mean speed nu [rad/s], to second order."""
    W, M = (ripple * x(nu) for x in (machine.speed_ripple, machine.torque_ripple))
    lag, a = 2 * machine.T * nu, machine.load_slope
    back = machine.B * lag**2 * abs(W) ** 2 / (2 * nu * (1 + lag**2))
    angle = nu + (back - a * W.imag / 2) / machine.slope
    speed = angle - abs(W) ** 2 / (2 * nu)
    torque = machine.A(nu) - machine.B * speed
    trough = a * (angle + W.imag / 2) * speed
    supply = machine.A(nu) / machine.B * torque
    return Means(speed, angle, torque, supply, trough, (torque**2 + abs(M) ** 2 / 2) / machine.B)


def settling(machine: Machine) -> Any:
    """The two rates of theta0 T nu'' + J nu' + B* nu = A, complex, shape (2,) [1/s]."""
    return np.roots([machine.theta0 * machine.T, machine.J, machine.slope]).astype(complex)


def drift(machine: Machine, t: Any) -> tuple[Any, Any]:
    """What is left of a deviation of the mean speed, at rest at first, after t seconds: by (16), and
    with the term theta0 T nu'' that (16) leaves out.
    """
    rates = settling(machine)
    whole = (rates[1] * np.exp(rates[0] * t) - rates[0] * np.exp(rates[1] * t)) / np.diff(rates)[0]
    return np.exp(-t * machine.slope / machine.J), whole.real


class Loads(NamedTuple):
    """Ripple of order 2 of torque [N.m] and speed [rad/s], and the largest rod force [N]."""

    torque: Any
    speed: Any
    force: Any


def classical(machine: Machine, nu: Any, inertia: bool) -> Loads:
    """The calculation with theta = theta0 and a load torque that is a function of time: the formula
    after (26), whose load is the spring's alone, or with `inertia` all that there is at constant speed.
    """
    load = machine.load_ripple(nu) if inertia else machine.r**2 / 2 * machine.c + 0 * nu
    push = machine.c - inertia * machine.m * nu**2 + 1j * machine.d * nu
    below = machine.B - 4 * machine.theta0 * machine.T * nu**2 + 2j * nu * machine.theta0
    speed = -load * (1 + 2j * machine.T * nu) / below
    return Loads(machine.B * load / below, speed, machine.r * abs(push))


def flux_lag(machine: Machine, slip: Any, stiff: float, nu: Any) -> Any:
    """Torque ripple over speed ripple, -M_hat / W_hat, of an induction motor whose stator flux is
    constant, with the flux of its rotor for a state in the place of (2) [N.m.s/rad].

    `slip` is in shares of the breakdown slip, `stiff` the slope of the characteristic at no slip. It
    is (2) without slip, and Kloss's slope at nu = 0.
    """
    p = 2j * nu * machine.T
    return stiff * (1 - slip**2 + p) / ((1 + slip**2) * ((1 + p) ** 2 + slip**2))
