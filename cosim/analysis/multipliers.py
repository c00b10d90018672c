"""The multipliers of a coupled step from deviations after perturbations.

Windows of the deviations at several delays stand for the state, and one linear map takes each window
to the next step's. Its eigenvalues are the multipliers of the coupled step, artificial damping and all:
the eigensystem realisation of Juang and Pappa (J. Guidance 8, 1985), with a perturbation for each wire.
Along a motion that repeats with the frequency W the deviations are sums of exp((s + i k W) t), with the
Floquet exponents s (Floquet's theorem); these are found in the same way, with their sidebands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig, svd

from .perturbation import Array, Deviations

Complex = NDArray[np.complex128]

#: Delays in a window: with two signals it has 32 rows, derived from MAX_MODES modes and a margin.
WINDOWS = 16
#: Windows of each perturbation: a convention, ten times the rank that a map has at most.
COLUMNS = 256
#: Least singular value that counts, relative to the largest: a convention.
MIN_SINGULAR_VALUE = 1e-9
#: Singular values below this multiple of the noise are noise: a convention, three standard deviations.
NOISE_MARGIN = 3.0
#: Most modes: derived from three states with four sidebands either way, less than the rows of a window.
MAX_MODES = 24
#: Multipliers below this have died out within a step and have no logarithm worth stating: a convention.
MIN_MULTIPLIER = 1e-6
#: Powers of a multiplier below this do not stand out in the map over several steps: a convention.
MIN_LASTING = 1e-3
#: Amplitudes that several modes add and take away again, relative to what they leave, are no share of
#: either: a convention.
MIN_INDEPENDENT_SHARE = 1e-4
#: Most growth or decay over the record of a mode that is a shift of the motion in time: a convention.
MAX_SHIFT_DECAY = 0.1
#: Most difference of such a mode from the rate of the motion, relative to the mode: a convention.
MAX_SHIFT_DIFFERENCE = 0.02


@dataclass(frozen=True)
class Multiplier:
    """A mode exp(s t) of the coupled steps, with s in 1/s.

    `error` is that of s, relative to |s|. `share` is its part of the energy of the deviation that shows
    it most. A mode that `is_shift` is the motion itself, a little earlier or later, as a machine that
    turns goes on after a push.
    """

    s: complex
    error: float
    share: float
    is_shift: bool = False

    @property
    def frequency(self) -> float:
        """Natural frequency abs(s) [rad/s]."""
        return abs(self.s)

    @property
    def damping(self) -> float:
        """Damping ratio, negative if the mode grows."""
        return -self.s.real / abs(self.s) if self.s else 0.0


@dataclass(frozen=True)
class Spectrum:
    """Modes, a conjugate pair as one. `residual` is the share of the deviations that they leave unexplained."""

    modes: tuple[Multiplier, ...]
    residual: float


@dataclass(frozen=True)
class MapEigenvalues:
    """The eigenvalues of a map from windows to the next, and the condition number of each."""

    values: Complex
    conditions: Array


def step_spectrum(deviations: Deviations) -> Spectrum:
    """Return the modes of the coupled steps.

    The error of a multiplier is its difference between the two halves of the record, plus the noise
    times the condition of the eigenvalue (Golub and Van Loan, Matrix Computations, section 7.2).

    Parameters
    ----------
    deviations : Deviations
        At least 32 rows.
    """
    y, h = deviations.values, deviations.step
    if not y.any():
        return Spectrum((), 0.0)
    count = y.shape[1]
    delay = max(1, count // 2 // WINDOWS)
    begins = np.linspace(0, count - 1 - WINDOWS * delay, COLUMNS).astype(int)
    begins = np.unique(begins)
    single, several = (_map_and_halves(y, begins, delay, k, deviations.noise) for k in (1, delay))
    entire = single[0]
    with np.errstate(invalid="ignore"):
        lasting = np.abs(entire.values) > MIN_MULTIPLIER
    if not lasting.any():
        return Spectrum((), 1.0)
    z, conditions = entire.values[lasting], entire.conditions[lasting]
    waves = _unit_powers(z, count)
    exact, independent = (
        np.linalg.lstsq(waves, _side_by_side(y) + 0j, rcond=limit)[0].astype(complex)
        for limit in (None, MIN_INDEPENDENT_SHARE)
    )
    energy = np.sum(_side_by_side(y) ** 2, axis=0)
    energy[energy == 0.0] = math.inf
    shares = (np.abs(independent) ** 2 / energy).max(axis=1)
    rest = np.sum((_side_by_side(y) - (waves @ exact).real) ** 2, axis=0)
    shifts = _are_shifts_in_time(deviations, waves, exact) & (
        np.abs(np.log(np.abs(z))) * count < MAX_SHIFT_DECAY
    )
    modes = []
    for k in np.flatnonzero(z.imag >= 0.0).tolist():
        estimates = [_logarithm(complex(z[k]), delay, *maps) for maps in zip(single, several)]
        log = estimates[0]
        spread = max(abs(half - log) for half in estimates[1:])
        error = spread + deviations.noise * float(conditions[k]) / delay
        share = float(shares[k]) * (2.0 if z[k].imag else 1.0)
        relative = error / abs(log) if log else math.inf
        modes.append(Multiplier(log / h, relative, share, bool(shifts[k])))
    return Spectrum(tuple(modes), float(np.sqrt(np.max(rest / energy))))


def _map_and_halves(
    y: Array, begins: NDArray[np.int_], delay: int, lag: int, noise: float
) -> list[MapEigenvalues]:
    """The maps over `lag` steps of all windows, of the early ones and of the late ones."""
    now, later = (_windows(y, begins + k, delay) for k in (0, lag))
    is_early = np.tile(begins < np.median(begins), len(y))
    choices = (np.ones(len(is_early), bool), is_early, ~is_early)
    return [_map_eigenvalues(now[:, columns], later[:, columns], noise) for columns in choices]


def _logarithm(z: complex, lag: int, single: MapEigenvalues, several: MapEigenvalues) -> complex:
    """The logarithm of the multiplier that is next to z, from the map over several steps.

    That of one step chooses the branch. A mode that dies out within these steps has none there, and
    keeps the logarithm from one step.
    """
    near = complex(min(single.values, key=lambda value: abs(value - z), default=0.0))
    if not near:
        return complex(-math.inf)
    log = complex(np.log(near))
    power = complex(np.exp(lag * log))
    if abs(power) < MIN_LASTING:
        return log
    image = complex(min(several.values, key=lambda value: abs(value - power), default=0.0))
    return log + complex(np.log(image / power)) / lag if image else log


def _windows(y: Array, begins: NDArray[np.int_], delay: int) -> Array:
    """Windows of all perturbations side by side, shape (WINDOWS * outputs, columns)."""
    at = begins[:, None] + delay * np.arange(WINDOWS)
    return y[:, at].reshape(len(y) * len(begins), -1).T


def _side_by_side(y: Array) -> Array:
    """The deviations with time down and all perturbations and outputs side by side."""
    return np.moveaxis(y, 1, 0).reshape(y.shape[1], -1)


def _unit_powers(z: Complex, count: int) -> Complex:
    """The powers z^n, each column of unit size; those that grow count from the end."""
    times = np.arange(count)[:, None] - np.where(np.abs(z) > 1.0, count - 1, 0)
    waves = np.exp(times * np.log(z))
    unit: Complex = waves / np.linalg.norm(waves, axis=0)
    return unit


def _map_eigenvalues(now: Array, later: Array, noise_share: float) -> MapEigenvalues:
    """The eigenvalues of the map that takes each column of `now` to that of `later`.

    `noise_share` is relative to the largest singular value of `now`.
    """
    left, sigma, right = svd(now, full_matrices=False)
    floor = max(MIN_SINGULAR_VALUE, NOISE_MARGIN * noise_share)
    rank = min(MAX_MODES, int(np.sum(sigma > floor * sigma[0])))
    matrix = left[:, :rank].T @ later @ right[:rank].T / sigma[:rank]
    values, w, v = eig(matrix, left=True, right=True)  # type: ignore[misc]
    with np.errstate(divide="ignore"):
        conditions = 1.0 / np.abs(np.sum(w.conj() * v, axis=0))
    return MapEigenvalues(values.astype(complex), conditions)


def _are_shifts_in_time(
    deviations: Deviations, waves: Complex, amplitudes: Complex
) -> NDArray[np.bool_]:
    """Which modes have after each perturbation a real multiple of the amplitudes of the motion's rate."""
    perturbations, _, outputs = deviations.values.shape
    rate = np.gradient(deviations.motion / deviations.sizes, axis=0)
    b = np.linalg.lstsq(waves, rate + 0j, rcond=None)[0][:, None, :]
    a = amplitudes.reshape(-1, perturbations, outputs)
    size = np.sum(np.abs(b) ** 2, axis=2, keepdims=True)
    size[size == 0.0] = math.inf
    multiple = np.sum(b.conj() * a, axis=2, keepdims=True).real / size
    rest = np.linalg.norm((a - multiple * b).reshape(len(a), -1), axis=1)
    shift: NDArray[np.bool_] = rest < MAX_SHIFT_DIFFERENCE * np.linalg.norm(
        a.reshape(len(a), -1), axis=1
    )
    return shift
