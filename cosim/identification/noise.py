"""The noise of a measured column, from its own rows: differences remove what is smooth and leave the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ..errors import SetupError

Samples = NDArray[np.float64]
#: Orders of the differences, tried in this sequence. Chosen: each removes two more powers of the time.
DIFFERENCE_ORDERS = (2, 4, 6, 8)
#: Fewest differences that give an estimate. Chosen: a standard deviation from 30 values is known to 13 %.
FEWEST_DIFFERENCES = 30
#: Largest deviation of a spacing from the median one, over this, that counts as even. Chosen: it changes a
#: difference of white noise not at all, and what is left of a smooth signal by little.
UNEVENNESS = 0.02
#: Differences beyond so many standard deviations are outliers. Derived: 7 in a million of a normal distribution.
OUTLIER_DEVIATIONS = 4.5
#: Estimates of two orders agree within so many standard deviations of an estimate. Convention: 95 %.
AGREEMENT_DEVIATIONS = 2.0
#: The standard deviation of a normal distribution over the median of its absolute values.
DEVIATION_OVER_MEDIAN = 1.0 / float(stats.norm.ppf(0.75))
#: What a row with Gaussian noise of known deviation adds to the variance of chi2. Derived: the variance of a squared
#: standard normal variable.
CHI2_VARIANCE = 2.0
#: Levels closer than this share of the largest value differ by rounding of doubles only. Chosen: above 1e-16 by much,
#: below the resolution of any converter.
LEAST_GRID = 1e-9
#: How far a distance of levels may be from a multiple of the spacing, over this multiple. Chosen: decimals of a file
#: round a spacing by less, and random levels differ by more.
GRID_TOLERANCE = 0.05


@dataclass(frozen=True)
class Noise:
    """White noise on a column: its standard deviation `sigma` in the unit of the column, and where this is from.

    `chi2_variance` is what a row adds to the variance of chi2: 2 if sigma is known, more if it is an estimate.
    `is_stated` says that a user gave it.
    """

    sigma: float
    source: str
    chi2_variance: float = CHI2_VARIANCE
    is_stated: bool = False


class DifferenceEstimate(NamedTuple):
    """A standard deviation from differences of this order, and its `Noise.chi2_variance`."""

    sigma: float
    order: int
    chi2_variance: float


def estimate_noise(times: Samples, values: Samples, source: str) -> Noise:
    """The noise of a column from differences of neighbouring rows.

    Differences of order k remove what is smooth over k + 1 rows and leave white noise with
    (2k over k) times its variance: the mean square successive difference of von Neumann, Kent, Bellinson and Hart
    (Ann. Math. Statist. 12, 1941) and, of order 2, the Allan variance of a clock's phase. The step to higher orders
    is that of Gasser, Sroka and Jennen-Steinmetz (Biometrika 73, 1986). Of several orders, the first one is taken
    with which the next agrees. Outliers are ignored. A column whose values lie on a grid of spacing q has at least
    the noise of rounding, q / sqrt(12).

    Parameters
    ----------
    times, values:
        The rows, times [s] that rise and finite values in the unit of the column, both of shape (n,).
    source:
        The file and the column, for the message.

    Raises
    ------
    SetupError
        If the signal is not smooth enough over a few rows to separate it from noise. The estimate fails silently for
        noise of which neighbouring rows are correlated: it is then too small or, for alternating errors, too large.
    """
    spacing = _grid_spacing(values)
    rounding = spacing / math.sqrt(12.0)
    estimates = _difference_estimates(times, values, rounding)
    for (sigma, order, variance), (next_sigma, *_) in pairwise(estimates):
        tolerance = AGREEMENT_DEVIATIONS * math.sqrt(variance / len(values))
        if sigma <= max(next_sigma, rounding) * (1.0 + tolerance):
            if sigma < rounding:
                return Noise(rounding, f"that of rounding to {spacing:.4g}")
            grid = f", on a grid of {spacing:.4g}" if spacing else ""
            return Noise(sigma, f"from differences of order {order} of the rows{grid}", variance)
    raise SetupError(
        f"{source}: its rows are too few, too uneven or too far apart to separate noise from signal; "
        "give the noise"
    )


def _difference_estimates(
    times: Samples, values: Samples, rounding: float
) -> list[DifferenceEstimate]:
    """Estimates of all orders for which there are rows enough, evenly spaced."""
    gaps = np.diff(times)
    is_even = np.abs(gaps / np.median(gaps) - 1.0) <= UNEVENNESS
    estimates = []
    for order in DIFFERENCE_ORDERS:
        usable = np.array(
            [is_even[k : k + order].all() for k in range(len(is_even) - order + 1)], bool
        )
        weights = np.array([(-1) ** k * comb(order, k) for k in range(order + 1)])
        weights = weights / math.sqrt(comb(2 * order, order))
        differences = np.convolve(values, weights, "valid")[usable] if usable.any() else np.empty(0)
        if len(differences) < FEWEST_DIFFERENCES:
            break
        scale = max(DEVIATION_OVER_MEDIAN * float(np.median(np.abs(differences))), rounding)
        inliers = differences[np.abs(differences) <= OUTLIER_DEVIATIONS * scale]
        autocorrelation = np.array([comb(2 * order, order + k) for k in range(order + 1)])
        autocorrelation = autocorrelation / comb(2 * order, order)
        # Squares of the noise vary by 2 a row, their estimate by 2 + 4 S with S the sum below, and the covariance of
        # both is 2: what their ratio varies by is 2 + (2 + 4 S) - 2 * 2 = 4 S.
        variance = 2.0 * CHI2_VARIANCE * float((autocorrelation[1:] ** 2).sum())
        sigma = float(np.sqrt(np.mean(inliers**2)))
        estimates.append(DifferenceEstimate(sigma, order, variance))
    return estimates


def _grid_spacing(values: Samples) -> float:
    """The distance of the grid on which values stand; 0 if there is none that is much of the noise."""
    levels = np.unique(values)
    distances = np.diff(levels)
    spacing = float(distances.min())
    if spacing <= LEAST_GRID * float(np.abs(values).max()) or len(levels) > len(values) / 2:
        return 0.0
    multiples = distances / spacing
    nearest = np.round(multiples)
    return spacing if (np.abs(multiples - nearest) < GRID_TOLERANCE * nearest).all() else 0.0
