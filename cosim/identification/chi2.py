"""The sum of squared residuals, chi2, of records that a machine of the right kind made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from scipy import stats

from .noise import CHI2_VARIANCE
from .record import Measurement

#: Share of the records of a machine of the right kind that are refused all the same. Convention: a level of
#: significance of one in a thousand.
SIGNIFICANCE = 1e-3


class Chi2Band(NamedTuple):
    """Degrees of freedom, and the band in which chi2 lies for all but a share SIGNIFICANCE of the records."""

    dof: int
    low: float
    high: float


def chi2_band(columns: Sequence[Measurement], priors: int, parameters: int) -> Chi2Band:
    """The band of chi2 of these columns with white noise, with so many values with a prior and free parameters.

    The noise of a column is an estimate from its own rows, so that chi2 varies more than the chi-square distribution
    says. The band is that of a scaled chi-square distribution with the same mean and variance (Satterthwaite,
    Biometrics Bulletin 2, 1946).
    """
    rows = sum(len(column.times) for column in columns)
    dof = rows + priors - parameters
    variance = sum(len(c.times) * c.noise.chi2_variance for c in columns)
    variance += CHI2_VARIANCE * (priors - parameters)
    effective_dof = 2.0 * dof**2 / max(variance, 1.0)
    scale = dof / effective_dof
    low, high = (
        float(stats.chi2.ppf(q, effective_dof)) * scale
        for q in (SIGNIFICANCE / 2, 1 - SIGNIFICANCE / 2)
    )
    return Chi2Band(dof, low, high)
