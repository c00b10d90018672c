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

from .features import COARSER, Point, Setup, Spot, converged
from .first_order import ANGLES, Machine, Mechanism, crank, push

AROUND = (0.5, 0.75, 1.0, 1.25, 1.5)
FINE, CLOSE = 4096, 1e-6
#: Newton's steps from one of FINE angles to a peak, which leaves an error of the order of 1e-3^8; then rounding.
NEWTON_STEPS = 4
ORDER = 1.0  # of the force that an FMU tells of a torque that was given half a step before


def course(machine: Machine, length: float, nu: float, steady: bool = False) -> NDArray[np.float64]:
    """The force of a rod of that length [m] at ANGLES [N], to first order in the ripple of the speed;
    without it at a `steady` speed. The length may be infinite.
    """
    position = crank(machine.r, length)
    motion = (nu, 0.0) if steady else Mechanism.of(machine, position).motion(nu)
    tilt = machine.r / length * np.cos(ANGLES)
    return np.asarray(push(machine, position, *motion) / np.sqrt(1 - tilt**2))


def peak(course: Any) -> float:
    """The largest size of values at even angles of a turn, on the Fourier series through them.

    From the best of FINE angles, Newton's method goes to where the slope of the series is 0.
    """
    wave = np.fft.rfft(course, norm="forward")
    fine = np.abs(np.fft.irfft(wave, FINE, norm="forward"))
    at = int(fine.argmax())
    best, angle, k = float(fine[at]), 2 * math.pi * at / FINE, np.arange(len(wave))
    wave[1:] *= 2.0
    if len(course) % 2 == 0:
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


def largest(point: Point) -> float:
    """The largest rod force of an orbit [N]."""
    return peak(point.course)


def least(told: Callable[[float], Any], low: float, high: float) -> float:
    """The spring between two [N/m] with the least peak of the rod force; nan where that is at an end.

    A force is nearly linear in the spring at every angle, and its peak nearly convex.
    """
    found = minimize_scalar(
        lambda c: peak(told(c)),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 0.1 * CLOSE * high},
    )
    c = float(found.x)
    room = 1e-3 * (high - low)
    return c if low + room < c < high - room else math.nan


def around(machine: Machine, nu: float) -> list[float]:
    """Springs around that of (17) [N/m]."""
    return [share * machine.m * nu**2 for share in AROUND]


def between(springs: Sequence[float], points: Sequence[Point]) -> float | str:
    """The spring with the least peak among some whose orbits are known [N/m], or why it is not determined."""
    if problem := next((point.problem for point in points if point.problem), ""):
        return problem
    c, known = zip(*sorted(zip(springs, points), key=lambda one: one[0]))
    found = least(CubicSpline(c, [point.course for point in known]), c[0], c[-1])
    return "it lies far from that of formula (17)" if math.isnan(found) else found


def search(machine: Machine, nu: float) -> list[Spot]:
    """The orbits from which the search starts."""
    return [(replace(machine, c=c), nu, k) for k in COARSER for c in around(machine, nu)]


def unloading(setup: Setup, machine: Machine, nu: float) -> Figure:
    """The spring with the least peak of the rod force at nu: between orbits around that of (17), and
    again with one more at the place.
    """
    meaning, springs = "spring with the smallest peak of the rod force", around(machine, nu)
    points = list(setup.orbits(search(machine, nu), "springs"))
    known = [points[k : k + len(springs)] for k in range(0, len(points), len(springs))]
    rough = [between(springs, one) for one in known]
    if lost := [c for c in rough if isinstance(c, str)]:
        return Figure.refused("N/m", lost[0], meaning)
    near = [c for c in rough if isinstance(c, float)]
    spots = [(replace(machine, c=c), nu, k) for c, k in zip(near, COARSER)]
    more = setup.orbits(spots, "springs")
    fine = [between([*springs, c], [*one, x]) for c, one, x in zip(near, known, more)]
    runs = [
        c if isinstance(c, str) else Measured(c, abs(c - first) + CLOSE * c)
        for c, first in zip(fine, near)
    ]
    return converged(runs, ORDER, "N/m", meaning)
