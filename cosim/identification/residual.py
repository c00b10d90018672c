"""The residual of a column and its spectrum, which shows where a model lacks something."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lombscargle

from .parameters import Array

#: The frequency up to which a machine like the fitted one may move a column, over that of the fit. Chosen: a machine
#: that oscillates three times as fast is another one.
FREQUENCY_MARGIN = 3.0
#: Largest deviation of a spacing from the mean one, over this, of rows that a Fourier transform takes as even. Chosen:
#: rounding of times in a file.
LARGEST_UNEVENNESS = 1e-3


@dataclass(frozen=True)
class ColumnResidual:
    """A column and its fit.

    It has times [s]; measured values, fitted values and noise in the unit of the column; where the
    noise is from; and the spectrum of the residual over frequencies [Hz], in units of that of the noise.
    """

    unit: str
    times: Array
    measured: Array
    fitted: Array
    sigma: float
    noise: str
    frequencies: Array
    power: Array

    @property
    def normalised(self) -> Array:
        """The residual in standard deviations of the noise, shape (n,)."""
        return (self.fitted - self.measured) / self.sigma

    @property
    def motion_bandwidth(self) -> float:
        """The frequency [Hz] above which neither the machine nor a similar one moves the column.

        It is a multiple of the frequency up to which the fitted values stand out from the noise.
        """
        t = (self.times - self.times[0]) / float(np.ptp(self.times))
        window = np.sin(math.pi * t) ** 2
        motion = window * (self.fitted - np.average(self.fitted, weights=window)) / self.sigma
        power = spectrum(self.times, motion)[1] / float(np.mean(window**2))
        return FREQUENCY_MARGIN * float(
            self.frequencies[power > 1.0].max(initial=self.frequencies[0])
        )

    @property
    def chi2(self) -> float:
        """The sum of squares of the residual over the noise."""
        return float(np.sum(self.normalised**2))


def spectrum(times: Array, residual: Array) -> tuple[Array, Array]:
    """Frequencies [Hz] and the power of a residual there, which is 1 on average for white noise of variance 1.

    Over even rows it is the periodogram, over uneven ones that of Lomb (Astrophys. Space Sci. 39, 1976) and Scargle
    (Astrophys. J. 263, 1982).
    """
    gaps = np.diff(times)
    is_even = bool(np.abs(gaps / gaps.mean() - 1.0).max() < LARGEST_UNEVENNESS)
    spacing = float(gaps.mean() if is_even else np.median(gaps))
    span = float(times[-1] - times[0]) + spacing
    number = (min(len(times), round(span / spacing)) + 1) // 2
    frequencies = np.arange(1, max(2, number)) / span
    if is_even:
        power = np.abs(np.fft.rfft(residual)) ** 2 / len(times)
        return frequencies, np.asarray(power[1 : len(frequencies) + 1], float)
    return frequencies, np.asarray(lombscargle(times, residual, 2 * math.pi * frequencies), float)
