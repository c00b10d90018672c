"""Modes of a free response: frequency and damping from samples at equal distances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOWS, COLUMNS = 16, 256
SIGNIFICANT, MOST_MODES = 1e-9, 24
DEAD, CANCELLING = 1e-6, 1e-4
STAYS, ALIKE = 0.1, 0.02


class Mode(NamedTuple):
    """exp(s t) with s in 1/s; `share` is its part of the energy of the signal that shows it most.

    `moved` is by how much of |s| it differs from what the first three quarters of the time show:
    nothing, where the system is linear and does not change. `shift` says that the mode is the motion
    itself, a little earlier or later, as a turning machine goes on after a push.
    """

    s: complex
    share: float
    moved: float
    shift: bool = False

    @property
    def frequency(self) -> float:
        """Natural frequency |s| [rad/s]."""
        return abs(self.s)

    @property
    def damping(self) -> float:
        """Damping ratio, negative if the mode grows."""
        return -self.s.real / abs(self.s)


class Fit(NamedTuple):
    """The modes, a conjugate pair as one; `residual` is the rms share that they do not explain."""

    modes: list[Mode]
    residual: float


def fit(samples: Array, h: float, motion: Array | None = None) -> Fit:
    """The modes of samples of shape (times, signals) that are h [s] apart, in no order.

    `motion`, of the same shape, is that from which the samples deviate.

    Eigensystem realisation (Juang and Pappa 1985): windows of the response at many delays stand
    side by side, their strongest directions are the state, and a step h maps it linearly. Exact for
    a linear system without noise, also over part of a period and for modes that grow. The shares
    leave aside what several modes add and take away again.
    """
    largest = np.abs(samples).max(axis=0)
    seen = largest > 0.0
    y = samples[:, seen] / largest[seen]
    if y.size == 0:
        return Fit([], 0.0)
    count = len(y)
    z = eigenvalues(y)
    z = z[np.abs(z) > DEAD]
    times = np.arange(count)[:, None] - np.where(np.abs(z) > 1.0, count - 1, 0)
    powers = np.exp(times * np.log(z))
    powers = powers / np.linalg.norm(powers, axis=0)
    exact, amplitudes = (
        np.linalg.lstsq(powers, y.astype(complex), rcond=limit)[0] for limit in (None, CANCELLING)
    )
    energy = np.sum(y**2, axis=0)
    shares = (np.abs(amplitudes) ** 2 / energy).max(axis=1)
    shorter = eigenvalues(y[: 3 * count // 4])
    before = np.log(shorter[np.abs(shorter) > DEAD])
    moved = [np.abs(before - s).min(initial=np.inf) / abs(s) for s in np.log(z)]
    shifts = np.zeros(len(z), bool)
    if motion is not None:
        rates = np.gradient(motion[:, seen], axis=0) / largest[seen]
        shifts = _shifts(
            np.log(z) * count, exact, np.linalg.lstsq(powers, rates + 0j, rcond=None)[0]
        )
    modes = [
        Mode(complex(np.log(v)) / h, float(2.0 * share if v.imag else share), float(change), shift)
        for v, share, change, shift in zip(z, shares, moved, shifts.tolist())
        if v.imag >= 0.0
    ]
    rest = np.sum((y - (powers @ exact).real) ** 2, axis=0)
    return Fit(modes, float(np.sqrt(np.max(rest / energy))))


def _shifts(
    decay: NDArray[np.complex128], a: NDArray[np.complex128], b: NDArray[np.complex128]
) -> NDArray[np.bool_]:
    """Which modes neither grow nor decay over the record and have in all signals the same real multiple
    of the amplitudes b of the motion's rates.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        multiple = np.sum(b.conj() * a, axis=1) / np.sum(np.abs(b) ** 2, axis=1)
    rest = np.linalg.norm(a - multiple.real[:, None] * b, axis=1)
    shifts: NDArray[np.bool_] = rest < ALIKE * np.linalg.norm(a, axis=1)
    return shifts & (np.abs(decay.real) < STAYS)


def eigenvalues(y: Array) -> NDArray[np.complex128]:
    """The factors by which modes of y, shape (times, signals), change from one sample to the next."""
    windows = min(WINDOWS, len(y) // 2)
    delay = len(y) // 2 // windows
    begins = np.linspace(0, len(y) - 2 - (windows - 1) * delay, COLUMNS).astype(int)
    places = np.unique(begins) + delay * np.arange(windows)[:, None]
    now, then = (np.moveaxis(y[places + k], 2, 0).reshape(-1, places.shape[1]) for k in (0, 1))
    left, sigma, right = np.linalg.svd(now, full_matrices=False)
    order = min(MOST_MODES, int(np.sum(sigma > SIGNIFICANT * sigma[0])))
    step = left[:, :order].T @ then @ right[:order].T / sigma[:order]
    return np.linalg.eigvals(step).astype(complex)
