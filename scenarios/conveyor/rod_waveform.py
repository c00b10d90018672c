"""The rod force over the crank angle, by theory and of orbits, and the spring that makes its peak least."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from .first_order import NODE_ANGLES, Machine, Mechanism, crank, push

ROD_FORCE = "conveyor.f_rod"
#: Springs around that of formula (17), over it.
AROUND = (0.5, 0.75, 1.0, 1.25, 1.5)
#: Angles from the best of which a peak is looked for; a period of order 32 has 128 of them.
FIRST_ANGLES = 4096
#: How close the top is come to, over their distance: the height is then right but for rounding.
TOP_TOLERANCE = 1e-5
#: Relative error to which a spring is located; a convention, below the coupling errors of a force.
CLOSE = 1e-6


def waveform(
    machine: Machine, length: float, nu: float, *, at_constant_speed: bool = False
) -> NDArray[np.float64]:
    """The force of a rod of that length [m] at NODE_ANGLES [N], to first order in the ripple of the speed;
    without it at a constant speed. The length may be infinite.
    """
    position = crank(machine.r, length)
    motion = (
        (nu, 0.0)
        if at_constant_speed
        else Mechanism.of(machine, position).speed_and_acceleration(nu)
    )
    tilt = machine.r / length * np.cos(NODE_ANGLES)
    return np.asarray(push(machine, position, *motion) / np.sqrt(1 - tilt**2))


def peak(waveform: Any) -> float:
    """The largest size of values at an even number of even angles of a turn, on the Fourier series through them.

    From the best of FIRST_ANGLES angles Brent's method goes to the top: a search for the least peak sees how flat it is.
    """
    wave = np.fft.rfft(waveform, norm="forward")
    at = int(np.abs(np.fft.irfft(wave, FIRST_ANGLES, norm="forward")).argmax())
    k = np.arange(len(wave))
    wave[1:-1] *= 2.0
    top = minimize_scalar(
        lambda x: -abs(float((wave * np.exp(2j * math.pi / FIRST_ANGLES * k * x)).sum().real)),
        bounds=(at - 1.0, at + 1.0), method="bounded", options={"xatol": TOP_TOLERANCE},
    )  # fmt: skip
    return -float(top.fun)


def best_spring_between(waveform_of: Callable[[float], Any], low: float, high: float) -> float:
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


def springs_around(machine: Machine, nu: float) -> NDArray[np.float64]:
    """Springs around that of (17) [N/m]."""
    return np.asarray(np.array(AROUND) * machine.m * nu**2)


def best_spring(springs: NDArray[np.float64], waveforms: NDArray[np.float64]) -> float:
    """The spring with the least peak among some whose forces over a turn are known [N/m]; nan for none."""
    if not np.isfinite(waveforms).all():
        return math.nan
    c, order = np.sort(springs), np.argsort(springs)
    return best_spring_between(CubicSpline(c, waveforms[order]), c[0], c[-1])
