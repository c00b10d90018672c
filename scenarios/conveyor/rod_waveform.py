"""The rod force over the crank angle, by theory and of orbits, and the spring that makes its peak least."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from workbench import Figure
from workbench.measure import Measured

from .features import converged
from .first_order import ANGLES, Machine, Mechanism, crank, push
from .orbits import STEP_MULTIPLES, OperatingPoint, Orbit, OrbitRunner

#: Springs around that of formula (17), over it.
AROUND = (0.5, 0.75, 1.0, 1.25, 1.5)
#: Even angles from the best of which Newton's method begins; a period of order 32 has 128 of them.
FINE = 4096
#: Relative error to which a spring is located; a convention, below the coupling errors of a force.
CLOSE = 1e-6
#: Newton's steps from one of FINE angles to a peak, which leaves an error of the order of 1e-3^8; then rounding.
NEWTON_STEPS = 4
#: Convergence order of the rod force, which follows the torque of half a step before at once.
ORDER = 1.0


def waveform(
    machine: Machine, length: float, nu: float, *, steady: bool = False
) -> NDArray[np.float64]:
    """The force of a rod of that length [m] at ANGLES [N], to first order in the ripple of the speed;
    without it at a `steady` speed. The length may be infinite.
    """
    position = crank(machine.r, length)
    motion = (nu, 0.0) if steady else Mechanism.of(machine, position).motion(nu)
    tilt = machine.r / length * np.cos(ANGLES)
    return np.asarray(push(machine, position, *motion) / np.sqrt(1 - tilt**2))


def peak(waveform: Any) -> float:
    """The largest size of values at even angles of a turn, on the Fourier series through them.

    From the best of FINE angles, Newton's method goes to where the slope of the series is 0.
    """
    wave = np.fft.rfft(waveform, norm="forward")
    fine = np.abs(np.fft.irfft(wave, FINE, norm="forward"))
    at = int(fine.argmax())
    best, angle, k = float(fine[at]), 2 * math.pi * at / FINE, np.arange(len(wave))
    wave[1:] *= 2.0
    if len(waveform) % 2 == 0:
        wave[-1] /= 2.0
    for _ in range(NEWTON_STEPS):
        turned = wave * np.exp(1j * k * angle)
        value, slope, bend = (
            float((x * turned).sum().real) for x in (1.0 + 0.0 * k, 1j * k, -(k**2))
        )
        best = max(best, abs(value))
        if bend * value >= 0.0:
            break
        angle -= slope / bend
    return best


def largest_force_of(orbit: Orbit) -> float:
    """The largest rod force of an orbit [N]."""
    return peak(orbit.waveform)


def least(waveform_of: Callable[[float], Any], low: float, high: float) -> float:
    """The spring between two [N/m] with the least peak of the rod force; nan where that is at an end.

    A force is nearly linear in the spring at every angle, and its peak nearly convex.
    """
    optimum = minimize_scalar(
        lambda c: peak(waveform_of(c)),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 0.1 * CLOSE * high},
    )
    c = float(optimum.x)
    room = 1e-3 * (high - low)
    return c if low + room < c < high - room else math.nan


def around(machine: Machine, nu: float) -> list[float]:
    """Springs around that of (17) [N/m]."""
    return [share * machine.m * nu**2 for share in AROUND]


def between(springs: Sequence[float], orbits: Sequence[Orbit]) -> float | str:
    """The spring with the least peak among some whose orbits are known [N/m], or why it is not determined."""
    if problem := next((orbit.problem for orbit in orbits if orbit.problem), ""):
        return problem
    c, orbits_by_multiple = zip(*sorted(zip(springs, orbits), key=lambda pair: pair[0]))
    optimum = least(CubicSpline(c, [orbit.waveform for orbit in orbits_by_multiple]), c[0], c[-1])
    return "it lies far from that of formula (17)" if math.isnan(optimum) else optimum


def unloading_points(machine: Machine, nu: float) -> list[OperatingPoint]:
    """The orbits from which the search starts."""
    return [
        OperatingPoint(replace(machine, c=c), nu, k)
        for k in STEP_MULTIPLES
        for c in around(machine, nu)
    ]


def unloading(runner: OrbitRunner, machine: Machine, nu: float) -> Figure:
    """The spring with the least peak of the rod force at nu: between orbits around that of (17), and
    again with one more at the place.
    """
    meaning, springs = "spring with the smallest peak of the rod force", around(machine, nu)
    points = list(runner.orbits(unloading_points(machine, nu), "springs"))
    orbits_by_multiple = [points[k : k + len(springs)] for k in range(0, len(points), len(springs))]
    first_optima = [between(springs, orbits_) for orbits_ in orbits_by_multiple]
    if reasons := [c for c in first_optima if isinstance(c, str)]:
        return Figure.undetermined("N/m", reasons[0], meaning)
    guesses = [c for c in first_optima if isinstance(c, float)]
    more_points = [
        OperatingPoint(replace(machine, c=c), nu, k) for c, k in zip(guesses, STEP_MULTIPLES)
    ]
    more = runner.orbits(more_points, "springs")
    fine = [
        between([*springs, c], [*orbits_, x])
        for c, orbits_, x in zip(guesses, orbits_by_multiple, more)
    ]
    runs = [
        c if isinstance(c, str) else Measured(c, abs(c - first) + CLOSE * c)
        for c, first in zip(fine, guesses)
    ]
    return converged(runs, ORDER, "N/m", meaning)
