"""Periodic orbits of motor and crank conveyor, exact: the independent reference of the resonance.

The crank angle takes the place of time: with w = nu + v(phi) and ' = d/dphi the machine reads

    M = theta w w' + theta' w^2 / 2 + c x x' + d x'^2 w,    T w M' + M = A - B w

for one unknown function v of period 2 pi, solved by collocation in Fourier series. Complex
amplitudes follow the crank angle in the sine convention, X = Im(X_hat exp(i k phi)).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

Samples = NDArray[np.float64]
STARTS, MOST = (33, 129, 513), 1025
TAIL = 1e-12
RIDGE = 0.02
NAMES = {
    "motor.B": "B",
    "motor.T": "T",
    "conveyor.rotor.J": "J",
    "conveyor.crank.r": "r",
    "conveyor.trough.m": "m",
    "conveyor.trough.d": "d",
    "conveyor.spring.c": "c",
    "conveyor.rod.l": "l",
    "conveyor.rod.finite": "finite",
}


class NoOrbitError(ValueError):
    """There is no orbit, or none that a machine would stay on."""


@dataclass(frozen=True)
class Drive:
    """Motor line (B, T) and conveyor in SI units; set A where nothing is said."""

    B: float = 199.8
    T: float = 0.0625
    J: float = 0.49
    m: float = 200.0
    r: float = 0.010
    c: float = 720e3
    d: float = 4000.0
    l: float = 0.4
    finite: bool = False

    @classmethod
    def of(cls, start: Mapping[str, Any]) -> Drive:
        """The drive of start values of the FMUs; other names are passed over."""
        return cls(**{NAMES[name]: value for name, value in start.items() if name in NAMES})

    @property
    def start(self) -> dict[str, Any]:
        """Start values of the FMUs."""
        return {name: getattr(self, field) for name, field in NAMES.items()}

    @property
    def theta0(self) -> float:
        """Mean inertia with a long rod [kg.m2]."""
        return self.J + self.m * self.r**2 / 2

    @property
    def slope(self) -> float:
        """A over nu [N.m.s/rad]."""
        return self.B + self.d * self.r**2 / 2

    @property
    def nu_res(self) -> float:
        """Resonance of the small ripple [rad/s]."""
        return math.sqrt(self.slope / (self.theta0 * self.T)) / 2

    @property
    def zeta(self) -> float:
        """Damping ratio of the small ripple."""
        damping = self.theta0 + self.T * self.d * self.r**2 / 2
        return damping / (4 * self.theta0 * self.T * self.nu_res)

    def load_ripple(self, nu: float) -> complex:
        """L_hat of order 2 at constant speed, rod infinitely long [N.m]."""
        return self.r**2 / 2 * (self.c - self.m * nu**2 + 1j * self.d * nu)

    def trough(self, phi: Any) -> tuple[Any, Any, Any, Any]:
        """Position x, its first two derivatives by phi, and l/R of the rod."""
        r, l = self.r, self.l
        s, c = np.sin(phi), np.cos(phi)
        if not self.finite:
            return r * s, r * c, -r * s, np.ones_like(s)
        R = np.sqrt(l**2 - (r * c) ** 2)
        dR = r**2 * s * c / R
        ddR = (r**2 * (c**2 - s**2) - dR**2) / R
        return r * s + R - l, r * c + dR, -r * s + ddR, l / R

    def acceleration(self, phi: Any, w: Any, torque: Any) -> Any:
        """The rate of the speed under a torque [rad/s2]."""
        x, dx, ddx, _ = self.trough(phi)
        load = self.c * x * dx + self.d * dx**2 * w + self.m * dx * ddx * w**2
        return (torque - load) / (self.J + self.m * dx**2)


@dataclass(frozen=True)
class Orbit:
    """The orbit of nominal speed nu: ripple v of the speed, torque M, and their derivatives by nu.

    The four have shape (n,), at equally spaced crank angles from 0.
    """

    drive: Drive
    nu: float
    v: Samples
    M: Samples
    v_nu: Samples
    M_nu: Samples

    @property
    def w2(self) -> complex:
        """Amplitude of order 2 of the speed [rad/s]."""
        return order2(self.v)

    @property
    def tau2(self) -> complex:
        """Amplitude of order 2 of the motor torque [N.m]."""
        return order2(self.M)

    @property
    def w2_slope(self) -> float:
        """d|w2|/dnu."""
        return (self.w2.conjugate() * order2(self.v_nu)).real / abs(self.w2)

    @property
    def tau2_slope(self) -> float:
        """d|tau2|/dnu [N.m.s/rad]."""
        return (self.tau2.conjugate() * order2(self.M_nu)).real / abs(self.tau2)

    @property
    def gain(self) -> complex:
        """L_hat / M_hat; its angle is the lag of the torque behind its load."""
        return self.drive.load_ripple(self.nu) / self.tau2

    @property
    def lag(self) -> float:
        """Lag of the torque behind its load, 0..360 [deg]."""
        return math.degrees(cmath.phase(self.gain)) % 360.0

    @property
    def mean_speed(self) -> float:
        """Mean speed in time [rad/s]."""
        return float(1 / np.mean(1 / (self.nu + self.v)))

    def f_rod(self, phi: Any) -> Any:
        """Axial force of the rod at any crank angle [N]."""
        drive = self.drive
        coefficients = np.fft.fft(self.v, norm="forward")
        k = np.fft.fftfreq(len(self.v), 1 / len(self.v))
        waves = np.exp(1j * np.multiply.outer(phi, k))
        v, dv = (waves @ coefficients).real, (waves @ (1j * k * coefficients)).real
        x, dx, ddx, axial = drive.trough(phi)
        w = self.nu + v
        inertia = drive.m * (dx * w * dv + ddx * w**2)
        return axial * (inertia + drive.c * x + drive.d * dx * w)

    @cached_property
    def f_rod_max(self) -> float:
        """Largest absolute force of the rod [N]."""
        phi = angles(4 * len(self.v))
        force = abs(self.f_rod(phi))
        tops = (force >= np.roll(force, 1)) & (force >= np.roll(force, -1))
        peaks = []
        for at in phi[tops & (force > 0.99 * force.max())]:
            top = minimize_scalar(
                lambda phi: -abs(self.f_rod(phi)),
                bounds=(at - phi[1], at + phi[1]),
                method="bounded",
                options={"xatol": 1e-9},
            )
            peaks.append(-float(top.fun))
        return max(peaks)

    @cached_property
    def multipliers(self) -> NDArray[np.complex128]:
        """Factors by which deviations (w, M) from the orbit change within a revolution."""
        return np.linalg.eigvals(self.transition())

    def transition(self, parts: int = 1) -> Samples:
        """The matrix by which deviations (w, M) change from angle 0 on, in a revolution or in one of 2^k parts of it."""
        drive, n = self.drive, max(1024, 4 * (len(self.v) - 1))
        phi = angles(n)
        _, dx, ddx, _ = drive.trough(phi)
        w = self.nu + resampled(self.v, n)
        dw, dM = (resampled(differentiated(x), n) for x in (self.v, self.M))
        theta = drive.J + drive.m * dx**2
        drag = drive.d * dx**2 + 2 * drive.m * dx * ddx * w
        rates = np.array(
            [
                [-(drag / theta + dw) / w, 1 / (theta * w)],
                [-(drive.B / drive.T + dM) / w, -1 / (drive.T * w)],
            ]
        )
        steps = exponentials(np.moveaxis(rates, -1, 0) * phi[1])[: n // parts]
        while len(steps) > 1:
            steps = steps[1::2] @ steps[::2]
        return np.asarray(steps[0])

    @property
    def stable(self) -> bool:
        """Whether deviations die out."""
        return bool(abs(self.multipliers).max() < 1.0)


def angles(n: int) -> Samples:
    """Crank angles of n nodes [rad]."""
    return np.asarray(2 * np.pi / n * np.arange(n))


def order2(x: Samples) -> complex:
    """Complex amplitude of order 2 of samples at the nodes."""
    return complex(2j * np.fft.rfft(x, norm="forward")[2])


def resampled(x: Samples, n: int) -> Samples:
    """The Fourier series through x at n nodes."""
    return np.asarray(np.fft.irfft(np.fft.rfft(x, norm="forward"), n, norm="forward"))


def differentiated(x: Samples) -> Samples:
    """d/dphi of the series through x at an odd number of nodes; rounds less than the matrix."""
    k = np.arange((len(x) + 1) // 2)
    return np.asarray(np.fft.irfft(1j * k * np.fft.rfft(x), len(x)))


@cache
def derivative(n: int) -> Samples:
    """The matrix of d/dphi at an odd number of nodes."""
    return np.array([differentiated(x) for x in np.eye(n)]).T


def exponentials(a: Samples) -> Samples:
    """exp of 2 x 2 matrices, shape (n, 2, 2)."""
    mean = np.trace(a, axis1=1, axis2=2)[:, None, None] / 2
    rest = a - mean * np.eye(2)
    q = np.sqrt(-np.linalg.det(rest).astype(complex))[:, None, None]
    up, down = np.exp(mean + q), np.exp(mean - q)
    share = np.where(abs(q) < 1e-6, np.exp(mean), (up - down) / np.where(q == 0, 1, 2 * q))
    return np.asarray(((up + down) / 2 * np.eye(2) + share * rest).real)


def collocated(drive: Drive, nu: float, v: Samples) -> Orbit:
    """The orbit of the nodes of v, which is where Newton's method starts.

    Raises NoOrbitError where it does not arrive or the crank would not turn on.
    """
    n = len(v)
    D, unit = derivative(n), np.eye(n)
    x, dx, ddx, _ = drive.trough(angles(n))
    theta, growth = drive.J + drive.m * dx**2, drive.m * dx * ddx
    spring, drag = drive.c * x * dx, drive.d * dx**2
    excess = drive.slope - drive.B

    def residual(v: Samples) -> tuple[Samples, Samples]:
        w = nu + v
        M = theta * w * differentiated(v) + growth * w**2 + spring + drag * w
        return M, drive.T * w * differentiated(M) + M - excess * nu + drive.B * v

    size = math.inf
    M, rest = residual(v)
    for _ in range(40):
        w = nu + v
        M_w = theta * differentiated(v) + 2 * growth * w + drag
        M_v = (theta * w)[:, None] * D + np.diag(M_w)
        turn = drive.T * differentiated(M)
        R_v = np.diag(turn) + (drive.T * w)[:, None] * (D @ M_v) + M_v + drive.B * unit
        if size < 1e-9 * abs(v).max():
            R_nu = turn + drive.T * w * differentiated(M_w) + M_w - excess
            v_nu = -np.linalg.solve(R_v, R_nu)
            return Orbit(drive, nu, v, M, v_nu, M_w + M_v @ v_nu)
        step = -np.linalg.solve(R_v, rest)
        share = 1.0
        while share > 1e-3:
            M, ahead = residual(v + share * step)
            turns = (w + share * step).min() > 0
            if turns and (size < 1e-3 * nu or np.linalg.norm(ahead) < np.linalg.norm(rest)):
                break
            share /= 2
        else:
            break
        v, rest, size = v + share * step, ahead, abs(step).max()
    raise NoOrbitError(f"no orbit found at {nu!r} rad/s")


def converged(drive: Drive, nu: float, v: Samples) -> Orbit:
    """The orbit near v with as many nodes as it needs, doubled until the series has ended."""
    while len(v) <= MOST:
        solution = collocated(drive, nu, v)
        if enough(solution.v, len(v)):
            if resampled(solution.v, 4 * len(v)).min() <= -nu:
                break
            return solution
        v = resampled(solution.v, 2 * len(v) - 1)
    raise NoOrbitError(f"no orbit found at {nu!r} rad/s")


def enough(v: Samples, n: int) -> bool:
    """Whether the series of dv/dphi ends before the last quarter of what n nodes tell."""
    rates = abs(np.fft.rfft(differentiated(v)))
    return bool(rates[3 * n // 8 :].max() <= TAIL * rates.max())


def orbit(drive: Drive, nu: float, near: Orbit | None = None) -> Orbit:
    """The orbit of nominal speed nu [rad/s], on the branch of one nearby if given.

    Raises NoOrbitError.
    """
    if near is None:
        for n in STARTS:
            with suppress(NoOrbitError):
                return converged(drive, nu, np.zeros(n))
        raise NoOrbitError(f"no orbit found at {nu!r} rad/s")
    n = len(near.v)
    half = max(STARTS[0], (n + 1) // 2)
    guess = resampled(near.v + (nu - near.nu) * near.v_nu, half if enough(near.v, half) else n)
    try:
        return converged(drive, nu, guess)
    except NoOrbitError:
        if abs(nu - near.nu) < 1e-4 * nu:
            raise
        return orbit(drive, nu, orbit(drive, (nu + near.nu) / 2, near))


def branch(drive: Drive, lowest: float, highest: float) -> list[Orbit]:
    """Stable orbits of ascending speeds, close enough that cubics between them show every ridge.

    Raises NoOrbitError.
    """
    width = min((highest - lowest) / 48, drive.zeta * drive.nu_res / 2)
    speeds = np.linspace(lowest, highest, math.ceil((highest - lowest) / width) + 1).tolist()
    coarse = [orbit(drive, speeds[0])]
    for nu in speeds[1:]:
        coarse.append(orbit(drive, nu, coarse[-1]))
    top = max(abs(sample.w2) for sample in coarse), max(abs(sample.tau2) for sample in coarse)
    orbits = [coarse[0]]
    for right in coarse[1:]:
        orbits += between(orbits[-1], right, top)
    for sample in orbits:
        if not sample.stable:
            raise NoOrbitError(f"the orbit at {sample.nu!r} rad/s is unstable")
    return orbits


def between(left: Orbit, right: Orbit, top: tuple[float, float]) -> list[Orbit]:
    """Orbits after left and up to right, halved until a cubic meets the one in the middle."""
    width = right.nu - left.nu
    middle = orbit(left.drive, left.nu + width / 2, left)
    ends = [
        (sample.w2, sample.tau2, order2(sample.v_nu), order2(sample.M_nu))
        for sample in (left, right)
    ]
    for i, true in enumerate((middle.w2, middle.tau2)):
        cubic = (ends[0][i] + ends[1][i]) / 2 + width * (ends[0][i + 2] - ends[1][i + 2]) / 8
        if abs(cubic - true) > RIDGE * top[i] and width > 1e-6 * right.nu:
            return between(left, middle, top) + between(middle, right, top)
    return [middle, right]


def features(drive: Drive, lowest: float, highest: float) -> dict[str, float | None]:
    """Figures of the orbits between two speeds, None where these do not hold one.

    nu_90, where the lag first rises through 90 deg; nu_peak_tau with tau2_peak and nu_peak_w with
    w2_peak, the largest ripples unless those at an end are larger. Raises NoOrbitError.
    """
    orbits = branch(drive, lowest, highest)
    lagging = roots(orbits, lambda sample: sample.gain.real)
    figures: dict[str, float | None] = {
        "nu_90": next((sample.nu for sample in lagging if sample.gain.imag > 0), None)
    }
    for name, curve in (("tau", "tau2"), ("w", "w2")):
        ends = max(abs(getattr(sample, curve)) for sample in (orbits[0], orbits[-1]))
        tops = roots(orbits, attrgetter(f"{curve}_slope"))
        best = max(tops, key=lambda sample: abs(getattr(sample, curve)), default=orbits[0])
        height = abs(getattr(best, curve))
        inside = height > ends
        figures[f"nu_peak_{name}"] = best.nu if inside else None
        figures[f"{curve}_peak"] = height if inside else None
    return figures


def roots(orbits: list[Orbit], value: Callable[[Orbit], float]) -> list[Orbit]:
    """The orbits where a value falls through zero."""
    crossings = []
    for left, right in pairwise(orbits):
        if value(left) > 0 >= value(right):
            at = brentq(
                lambda nu: value(orbit(left.drive, nu, left)),  # noqa: B023
                left.nu,
                right.nu,
                xtol=1e-12 * right.nu,
            )
            crossings.append(orbit(left.drive, at, left))
    return crossings


def edges(drive: Drive, lowest: float, highest: float, level: float) -> list[float]:
    """Nominal speeds at which the amplitude of order 2 of the torque passes a level [N.m], in order.

    Raises NoOrbitError.
    """
    orbits = branch(drive, lowest, highest)
    passed = [roots(orbits, lambda sample, s=s: s * (abs(sample.tau2) - level)) for s in (1, -1)]
    return sorted(sample.nu for crossings in passed for sample in crossings)


def f_rod_peak(drive: Drive, speeds: Iterable[float]) -> float:
    """Largest force of the rod on the orbits of these speeds [N]. Raises NoOrbitError."""
    near, peaks = None, []
    for nu in sorted(speeds):
        near = orbit(drive, nu, near)
        peaks.append(near.f_rod_max)
    return max(peaks)


def random_drive(rng: np.random.Generator) -> Drive:
    """A drive whose first-order ripple at resonance is at most 0.6 of the speed."""

    def spread(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    while True:
        zeta, nu = spread(0.01, 0.7), spread(5.0, 150.0)
        ripple = rng.choice([spread(1e-4, 0.6), rng.uniform(0.02, 0.6)])
        damping, kappa = ripple * spread(1e-3, 1.0), spread(0.2, 3.0) * rng.integers(2)
        T = 1 / (4 * zeta * nu * (1 - damping))
        drag = 4 * zeta * nu * damping
        gain = math.hypot(1, 2 * T * nu) / (2 * nu**2 * (1 + T * drag))
        stirred = math.sqrt(max(0.0, (ripple / gain) ** 2 - (drag * nu) ** 2)) / nu**2
        share = max(1e-5, stirred / max(abs(kappa**2 - 1), 0.01))
        if 1e-3 < T < 1.0 and share < 0.95:
            break
    theta0, r = spread(0.01, 50.0), spread(0.002, 0.1)
    m = 2 * share * theta0 / r**2
    slope = 4 * nu**2 * theta0 * T
    values = {
        "B": slope - drag * theta0,
        "T": T,
        "J": (1 - share) * theta0,
        "m": m,
        "r": r,
        "c": m * (kappa * nu) ** 2,
        "d": 2 * drag * theta0 / r**2,
        "l": r * spread(4.0, 40.0),
    }
    rounded = {name: float(f"{value:.4g}") for name, value in values.items()}
    return Drive(**rounded, finite=bool(rng.integers(2)))


def question(rng: np.random.Generator, drive: Drive) -> tuple[float, float, int]:
    """A sweep as somebody would choose it who knows formula (22): from, to, number."""
    low, high = rng.uniform(0.5, 0.7), rng.uniform(1.3, 1.7)
    first, last = (float(f"{share * drive.nu_res:.3g}") for share in (low, high))
    return first, last, int(rng.integers(9, 32))
