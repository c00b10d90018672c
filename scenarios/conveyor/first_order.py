r"""First-order theory of the crank conveyor with a lagging motor, the paper's formulas corrected.

Complex amplitudes follow the crank angle in the sine convention, X = Im(X_hat exp(i k phi)):
L_hat load torque, W_hat speed, M_hat motor torque, all of order 2, at mean speed nu. All is plain
arithmetic: machines whose fields are arrays, or an array of speeds, give arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from cosim.system import Value

Samples = NDArray[np.float64]
Amplitudes = NDArray[np.complex128]
Position = Callable[[Samples], Samples]
Path = tuple[Samples, Samples, Samples]
#: Highest order of the Fourier series of a mechanism, a convention; the series falls with a power of crank over rod.
HIGHEST = 16
#: Even angles of a revolution, eight for each period of the highest order; a power of 2 for the FFT.
NODES = 256
#: Relative step of a central difference in the speed; its error is of the order of its square.
SLOPE = 1e-3
NODE_ANGLES = np.linspace(0.0, 2 * math.pi, NODES, endpoint=False)
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
    """Motor line (B, T) and conveyor (theta1, m, r, c, d) in SI units, and further start values that theory does not know.

    Many machines are one whose fields and further start values are arrays where they differ.
    """

    B: Any
    T: Any
    theta1: Any = 0.49
    m: Any = 200.0
    r: Any = 0.010
    c: Any = 720000.0
    d: Any = 4000.0
    more: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @classmethod
    def of(cls, machines: Sequence[Machine]) -> Machine:
        """Return machines with further start values of the same names as one, with arrays for what differs."""

        def column(values: Sequence[Any]) -> Any:
            return values[0] if all(x == values[0] for x in values) else np.array(values)

        fields = {name: column([vars(x)[name] for x in machines]) for name in FIELDS.values()}
        more = {name: column([x.more[name] for x in machines]) for name in machines[0].more}
        return cls(**fields, more=more)

    def __getitem__(self, index: Any) -> Machine:
        """Return some of many machines."""

        def some(values: Mapping[str, Any]) -> dict[str, Any]:
            return {name: x[index] if np.ndim(x) else x for name, x in values.items()}

        return Machine(**some({**vars(self), "more": 0.0}) | {"more": some(self.more)})

    @property
    def theta0(self) -> Any:
        """Mean reduced inertia [kg.m2]."""
        return self.theta1 + self.m * self.r**2 / 2

    @property
    def load_slope(self) -> Any:
        """Mean load torque over speed, alpha r^2 / 2 [N.m.s/rad]."""
        return self.d * self.r**2 / 2

    @property
    def slope(self) -> Any:
        """B* = B + alpha r^2 / 2 [N.m.s/rad]."""
        return self.B + self.load_slope

    @property
    def J(self) -> Any:
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

    def A(self, nu: Any) -> Any:
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
        """The machine with start values of the FMUs, which refuse a text for a number."""
        numbers = {name: value for name, value in start.items() if not isinstance(value, str)}
        known = {FIELDS[name]: float(value) for name, value in numbers.items() if name in FIELDS}
        more = {name: value for name, value in start.items() if FIELDS.get(name) not in known}
        return replace(self, **known, more={**self.more, **more})

    def start(self, nu: Any) -> dict[str, Any]:
        """Start values of the two FMUs `motor` and `conveyor`, near the orbit of mean speed nu."""
        return {
            "motor.A": self.A(nu),
            "motor.tau": self.load_slope * nu,
            "conveyor.phi": 0.0,
            "conveyor.w": nu,
            **{name: vars(self)[field] for name, field in FIELDS.items()},
            **self.more,
        }


def rod_force(machine: Machine, nu: Any) -> Any:
    """Q exp(i gamma) of (17) [N]: the rod force of order 1 at constant speed."""
    return 2 * machine.load_ripple(nu) / machine.r


def crank(r: float, l: float = math.inf) -> Position:
    """The trough's position with a crank r and a rod l [m], by default much longer than the crank."""

    def position(phi: Samples) -> Samples:
        up = r * np.cos(phi)
        return np.asarray(r * np.sin(phi) - up**2 / (l * (1 + np.sqrt(1 - (up / l) ** 2))))

    return position


class Ripples(NamedTuple):
    """Complex amplitudes of the orders 1 .. HIGHEST: load torque at constant speed [N.m], speed [rad/s], motor torque [N.m]."""

    load: Amplitudes
    speed: Amplitudes
    torque: Amplitudes


@dataclass(frozen=True, eq=False)
class Mechanism:
    """The motor of a machine on any mechanism that is given by the reduced inertia theta(phi) [kg.m2]
    and the load torque M_c(phi, w, a) [N.m], with a = dw/dt, at the crank angles NODE_ANGLES.
    """

    machine: Machine
    theta: Samples
    load: Callable[[Any, Any], Samples]

    @classmethod
    def of(cls, machine: Machine, position: Position) -> Mechanism:
        """A mechanism that is given as a position function of the trough, x(phi): theta = theta1 + m x'^2, M_c = x' (c x + d x' w)."""
        x, dx, _ = at_angles(position)
        spring, drag = machine.c * x * dx, machine.d * dx**2
        return cls(machine, machine.theta1 + machine.m * dx**2, lambda w, _: spring + drag * w)

    def ripples(self, nu: float) -> Ripples:
        """The solution of (10) for every order at the mean speed nu, from Fourier coefficients.

        The load's mean slope by the acceleration counts as inertia, which (10) leaves out as small; its
        mean slope by the speed adds to that of the motor. Errors are of the second order in what swings.
        """
        k, m = np.arange(1, HIGHEST + 1), self.machine
        steady, step = self.load(nu, 0.0), SLOPE * nu
        slope = float(np.mean(self.load(nu + step, 0.0) - self.load(nu - step, 0.0))) / (2 * step)
        pulled = float(np.mean(self.load(nu, step) - self.load(nu, -step))) / (2 * step)
        inertia = float(np.mean(self.theta)) + pulled
        load = amplitudes(steady) + 1j * k * nu**2 / 2 * amplitudes(self.theta)
        lag = 1 + 1j * k * nu * m.T
        damped = m.B + lag * (slope + 1j * k * nu * inertia)
        return Ripples(load, np.asarray(-load * lag / damped), m.B * load / damped)

    def speed_and_acceleration(self, nu: float) -> tuple[Samples, Samples]:
        """Speed [rad/s] and acceleration [rad/s2] at NODE_ANGLES, to first order in the ripple."""
        k, speed = np.arange(1, HIGHEST + 1), self.ripples(nu).speed
        waves = np.exp(1j * np.outer(NODE_ANGLES, k))
        w = nu + (waves @ speed).imag
        return w, w * (waves @ (1j * k * speed)).imag


def push(machine: Machine, position: Position, w: Any, a: Any) -> Samples:
    """Force along x that the trough takes at NODE_ANGLES, at a speed [rad/s] and acceleration [rad/s2] [N]."""
    x, dx, _ = path = at_angles(position)
    return np.asarray(machine.m * acceleration(path, w, a) + machine.c * x + machine.d * dx * w)


def acceleration(path: Path, w: Any, a: Any) -> Samples:
    """Acceleration of the trough [m/s2]."""
    return np.asarray(path[1] * a + path[2] * w**2)


def at_angles(position: Position) -> Path:
    """x, dx/dphi and its derivative at NODE_ANGLES, by the Fourier series of x."""
    wave, k = np.fft.rfft(position(NODE_ANGLES)), 1j * np.arange(NODES // 2 + 1)
    k[-1] = 0.0
    x, dx, ddx = np.array([np.fft.irfft(k**n * wave, NODES) for n in range(3)])
    return x, dx, ddx


def amplitudes(x: Samples) -> Amplitudes:
    """Those of the orders 1 .. HIGHEST of values at NODE_ANGLES."""
    return np.asarray(2j * np.fft.rfft(x, norm="forward")[1 : HIGHEST + 1])


SETS: Mapping[str, Machine] = {"A": Machine(B=199.8, T=0.0625), "B": Machine(B=35.8, T=0.02)}


def coupling_map(machine: Machine, algorithm: str, h: Any) -> NDArray[np.float64]:
    """Small deviations (w, tau) one communication step of h seconds later, shape (..., 2, 2).

    Both units exact, inputs held, the inertia at its mean: the motor's step maps tau to
    e tau - B (1 - e) w, the conveyor's w to f w + (1 - f) tau / (alpha r^2 / 2).
    """

    def matrix(*entries: Any) -> NDArray[np.float64]:
        *of_all, _ = np.broadcast_arrays(*entries, h)
        return np.stack(of_all, axis=-1).reshape(*np.shape(h), 2, 2)

    def motor(h: Any) -> NDArray[np.float64]:
        e = np.exp(-h / machine.T)
        return matrix(1.0, 0.0, -machine.B * (1 - e), e)

    damping_step = machine.load_slope * h / machine.theta0
    with np.errstate(invalid="ignore"):
        share = np.where(damping_step > 0.0, -np.expm1(-damping_step) / damping_step, 1.0)
    conveyor = matrix(np.exp(-damping_step), share * h / machine.theta0, 0.0, 1.0)
    if algorithm == "jacobi":
        return np.stack([conveyor[..., 0, :], motor(h)[..., 1, :]], axis=-2)
    if algorithm == "gauss-seidel":
        return np.asarray(conveyor @ motor(h))
    return np.asarray(motor(h / 2) @ conveyor @ motor(h / 2))


def longest_step(machine: Machine, algorithm: str) -> float:
    """The communication step [s] beyond which the coupled oscillation of a machine grows by itself."""

    def growth(h: Any) -> Any:  # the larger root of x^2 - 2 half x + product, or the size of both
        (a, b), (c, d) = np.moveaxis(coupling_map(machine, algorithm, h), (-2, -1), (0, 1))
        half, product = (a + d) / 2.0, a * d - b * c
        apart = half**2 - product
        real = np.abs(half) + np.sqrt(np.maximum(apart, 0.0))
        return np.where(apart < 0.0, np.sqrt(np.abs(product)), real) - 1.0

    steps = np.geomspace(1e-5, 1e2, 700) / machine.nu_res
    unstable = np.flatnonzero(growth(steps) > 0.0)[:1]
    if not len(unstable):
        return math.inf
    at = int(unstable[0])
    return float(brentq(growth, steps[at - 1], steps[at], xtol=1e-12))


class Loads(NamedTuple):
    """Ripple of order 2 of torque [N.m] and speed [rad/s], and the largest rod force [N]."""

    torque: Any
    speed: Any
    force: Any


def classical(machine: Machine, nu: Any, *, inertia: bool) -> Loads:
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
