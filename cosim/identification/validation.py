"""The third step: whether a machine of this kind can have made the record, and if not, where it differs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import stats

from ..result import Result
from .chi2 import SIGNIFICANCE, Chi2Band, chi2_band
from .linearisation import Linearisation, Refinement
from .noise import CHI2_VARIANCE, Samples
from .parameters import Array
from .problem import Evaluator, Problem
from .record import Measurement
from .residual import ColumnResidual, spectrum

#: Largest distance of a value from its prior, in standard deviations.
LARGEST_PRIOR_DEVIATION = float(stats.norm.isf(SIGNIFICANCE / 2))
#: Pieces of a record in which a misfit is located. Chosen: an eighth of a record is a place that one can look at.
SEGMENTS = 8
#: chi2 of such a piece stands out if it is so many of its standard deviations above its mean. Chosen: 3 in 100 000 of a
#: normal distribution, since the pieces only locate what is known to misfit.
SEGMENT_DEVIATIONS = 4.0


@dataclass(frozen=True)
class Validation:
    """The run of the fit, the residuals of its columns, the band of chi2, and the reasons against the fit."""

    result: Result
    residuals: Mapping[str, ColumnResidual]
    band: Chi2Band
    misfit: Sequence[str]
    runs: int


class ResidualFinding(NamedTuple):
    """Where a residual is not white noise, in a sentence, and whether this counts against the fit by itself."""

    sentence: str
    is_certain: bool


def validate(refinement: Refinement) -> Validation:
    """Judge a fit by its residuals: their sum of squares, their spectra, and the distance from the prior."""
    problem, linearisation = refinement.problem, refinement.linearisation
    evaluator = Evaluator(problem)
    result = evaluator.simulate(linearisation.p, all_outputs=True)
    residuals = column_residuals(problem, problem.predict(linearisation.p, result))
    band = chi2_band(problem.columns, len(problem.prior.names), len(problem.parameters))
    misfit = [*refinement.rejections, *_misfits(problem, linearisation, residuals, band)]
    return Validation(result, residuals, band, misfit, evaluator.runs)


def column_residuals(problem: Problem, predictions: Sequence[Array]) -> dict[str, ColumnResidual]:
    """The columns beside what the fit predicts of them."""
    residuals = {}
    for column, x in zip(problem.columns, predictions):
        noise = column.noise
        power = spectrum(column.times, (x - column.values) / noise.sigma)
        residuals[column.port.name] = ColumnResidual(
            column.port.unit, column.times, column.values, x, noise.sigma, noise.source, *power
        )
    return residuals


def _misfits(
    problem: Problem,
    linearisation: Linearisation,
    residuals: Mapping[str, ColumnResidual],
    band: Chi2Band,
) -> Iterator[str]:
    """Why no machine of this kind fits, and where the misfit is; empty if one does."""
    chi2 = linearisation.chi2
    if chi2 > band.high:
        yield (
            f"chi2 = {chi2:.4g} for {band.dof} degrees of freedom is above its 99.9 % band, which "
            f"ends at {band.high:.4g}"
        )
    yield from _excess_power(problem, residuals)
    if chi2 < band.low:
        yield (
            f"chi2 = {chi2:.4g} for {band.dof} degrees of freedom is below its 99.9 % band, which "
            f"begins at {band.low:.4g}: the noise is smaller"
        )
    for column in problem.columns:
        for finding in locate_misfit(column, residuals[column.port.name]):
            if finding.is_certain or chi2 > band.high:
                yield finding.sentence
    yield from _far_from_prior(problem, linearisation)


def _excess_power(problem: Problem, residuals: Mapping[str, ColumnResidual]) -> Iterator[str]:
    """The column of which the residual has most power where the machine moves, if there is too much in all."""
    powers = [x.power[x.frequencies <= x.motion_bandwidth] for x in residuals.values()]
    fitted = len(problem.parameters) - len(problem.prior.names)
    frequencies = sum(map(len, powers)) - fitted / 2
    total = sum(float(power.sum()) for power in powers)
    if total > float(stats.gamma.isf(SIGNIFICANCE, max(frequencies, 1.0))):
        k = int(np.argmax([power.mean() for power in powers]))
        name, residual = list(residuals.items())[k]
        yield (
            f"{name}: up to {residual.motion_bandwidth:.4g} Hz, where the machine moves, the residual has "
            f"{powers[k].mean():.3g} times the power of the noise"
        )


def _far_from_prior(problem: Problem, linearisation: Linearisation) -> Iterator[str]:
    """Values that are farther from their prior than chance allows."""
    prior = problem.prior
    for name, mean, sigma in zip(prior.names, prior.mean, prior.deviations):
        k = problem.names.index(name)
        value = linearisation.p[k]
        distance = abs(value - mean) / sigma
        if distance > LARGEST_PRIOR_DEVIATION:
            yield (
                f"{name} would be {value:.5g} {problem.parameters[k].unit}, {distance:.1f} standard "
                f"deviations from the known {mean:.5g}"
            )


def locate_misfit(column: Measurement, residual: ColumnResidual) -> Iterator[ResidualFinding]:
    """The frequency at which a residual oscillates, and the pieces of the record in which it is large.

    The power of white noise at a frequency is exponentially distributed, so that its maximum over n frequencies
    exceeds log(n / SIGNIFICANCE) in a share SIGNIFICANCE of all records.
    """
    name, normalised = column.port.name, residual.normalised
    k = int(np.argmax(residual.power * (residual.frequencies <= residual.motion_bandwidth)))
    if residual.power[k] > math.log(len(residual.power) / SIGNIFICANCE):
        f = float(residual.frequencies[k])
        amplitude = 2.0 * math.sqrt(float(residual.power[k]) / len(normalised))
        oscillation = f"oscillates at {f:.4g} Hz ({2 * math.pi * f:.4g} rad/s) with an amplitude of"
        size = f"{residual.sigma * amplitude:.3g} {residual.unit}".rstrip()
        yield ResidualFinding(f"{name}: the residual {oscillation} {size}", is_certain=True)
    variance = max(column.noise.chi2_variance, CHI2_VARIANCE)
    for rows in segments(column.times, SEGMENTS):
        x = normalised[rows]
        excess = (float(np.sum(x**2)) - len(x)) / math.sqrt(len(x) * variance)
        if excess > SEGMENT_DEVIATIONS:
            first, last = column.times[rows][[0, -1]]
            ratio, span = math.sqrt(float(np.mean(x**2))), f"from {first:.4g} s to {last:.4g} s"
            yield ResidualFinding(
                f"{name}: {span} the residual is {ratio:.1f} times the noise", is_certain=False
            )


def segments(times: Samples, number: int) -> Iterator[slice[int, int, None]]:
    """A record in at most so many pieces of equal duration that hold rows."""
    edges = np.searchsorted(times, np.linspace(times[0], times[-1], number + 1)[1:-1])
    for first, last in pairwise([0, *edges.tolist(), len(times)]):
        if last > first:
            yield slice(first, last)
