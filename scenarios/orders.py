"""Order tracking: harmonics over the crank angle by least squares on the raw samples."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Samples = NDArray[np.float64]
HIGHEST = 8


def last_revolutions(phi: Samples, count: int) -> NDArray[np.bool_]:
    """The samples of the last `count` whole revolutions."""
    return np.asarray(phi >= phi[-1] - 2 * math.pi * count)


def harmonics(phi: Samples, x: Samples, highest: int = HIGHEST) -> NDArray[np.complex128]:
    """Complex amplitudes of the orders 1..highest, X = Im(X_hat exp(i k phi)), fitted together.

    phi [rad] and x have shape (n,); needs more than 2 * highest samples per revolution. Over whole
    revolutions the normal equations are nearly diagonal.
    """
    angles = np.outer(phi, np.arange(1, highest + 1))
    design = np.hstack([np.ones((len(phi), 1)), np.sin(angles), np.cos(angles)])
    fit = np.linalg.solve(design.T @ design, design.T @ x)
    return np.asarray(fit[1 : highest + 1] + 1j * fit[highest + 1 :])


def order(phi: Samples, x: Samples, k: int) -> complex:
    """Complex amplitude of order k."""
    return complex(harmonics(phi, x)[k - 1])


def mean_speed(t: Samples, phi: Samples, count: int) -> float:
    """Time mean of the speed over the last `count` whole revolutions [rad/s]."""
    angle = 2 * math.pi * count
    began = float(CubicSpline(phi, t)(phi[-1] - angle))
    return float(angle / (t[-1] - began))
