"""The fourth step: intervals of all values and of what follows from them, and values that cannot be distinguished."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.sparse.csgraph import connected_components

from ..errors import SetupError
from ..result import SimulationError
from ..rounding import with_error
from .chi2 import SIGNIFICANCE
from .fit import Minimum
from .linearisation import DEVIATIONS, Linearisation, Refinement, covariance
from .parameters import Array
from .problem import Evaluator
from .validation import Validation

#: How far chi2 rises to the end of a 95 % interval. Derived: the square of DEVIATIONS.
RISE = DEVIATIONS**2
#: Two values are not distinguished if they are correlated by more than this. Chosen: one is known three times
#: better where the other is.
LARGEST_CORRELATION = 0.95
#: Iterations of a fit with a quantity held. Chosen: linear problems take two.
MOST_ITERATIONS = 4
#: Targets on the way to an end of an interval. Chosen: the secant of a parabola needs one.
MOST_TARGETS = 3
#: Largest half-width of a profile over that of the covariance. Chosen: what is wider is hardly determined.
WIDEST_PROFILE = 8.0
#: An end is found when chi2 changes by less, and the half-width by less than this share of it. Chosen: intervals
#: have two digits.
END_TOLERANCE = 0.03
#: Largest rise of chi2 at a target that still tells where the end is. Chosen: a parabola is long left there.
LARGEST_RISE = 1e3
#: Largest ratio of a half-width to that of the target before. Chosen: a step stays near what the last one explored.
LARGEST_RATIO = 4.0
#: Smallest ratio of a half-width to that of the target before.
SMALLEST_RATIO = 1.0 / LARGEST_RATIO
#: Another minimum fits equally well if its chi2 is above by less.
AMBIGUOUS_RISE = float(stats.chi2.isf(SIGNIFICANCE, 1))
#: Two machines are different if a derived quantity differs by more than so many half-widths. Chosen: intervals that
#: do not touch by as much as either is wide.
DIFFERENT_HALF_WIDTHS = 3.0


class Interval(NamedTuple):
    """A value with the ends of its 95 % interval and its standard deviation, in its unit.

    The ends are those of the profile likelihood where it was followed, else of the covariance. They
    include the coupling error.
    """

    value: float
    low: float
    high: float
    deviation: float
    unit: str = ""

    @property
    def error(self) -> float:
        """The farther of the ends from the value."""
        return max(self.high - self.value, self.value - self.low)

    def text(self) -> str:
        """The value and its interval, rounded to two digits of this."""
        if not 0.0 < self.error < math.inf:
            return f"{self.value:.6g} {self.unit} (not determined)".replace("  ", " ")
        return with_error(self.value, self.error, self.unit)


@dataclass(frozen=True)
class Quantity:
    """A free parameter, or a derived quantity, of this index; its value at the fit, gradient (n,) and unit."""

    index: int
    is_derived: bool
    value: float
    gradient: Array
    unit: str

    def evaluate(self, p: Array, derived: Array) -> float:
        """Its value for values p of the free parameters and the derived quantities of these."""
        return float((derived if self.is_derived else p)[self.index])


@dataclass(frozen=True)
class Intervals:
    """Intervals of free values and derived quantities by name, none if `misfit` has a reason against the fit.

    `correlations` of the n free values have shape (n, n); `correlated_groups` cannot be distinguished.
    """

    values: Mapping[str, Interval]
    derived: Mapping[str, Interval]
    misfit: Sequence[str]
    correlations: Array
    correlated_groups: Sequence[Sequence[str]]
    runs: int


def estimate_intervals(
    refinement: Refinement, validation: Validation, minima: Sequence[Minimum]
) -> Intervals:
    """The intervals of a fit, unless it is refused or another one of the minima is as good."""
    problem, fit = refinement.problem, refinement.linearisation
    correlations = correlation(fit.covariance)
    groups = correlated_groups(problem.names, correlations)
    misfit = list(validation.misfit)
    if misfit:
        return Intervals({}, {}, misfit, correlations, groups, 0)
    evaluator = Evaluator(problem)
    derived = {
        quantity.name: _interval(
            evaluator,
            fit,
            Quantity(
                k,
                is_derived=True,
                value=float(fit.derived[k]),
                gradient=fit.gradients[k],
                unit=quantity.unit,
            ),
            is_curved=bool(groups),
        )
        for k, quantity in enumerate(problem.derived)
    }
    unit_vectors = np.eye(len(problem.parameters))
    correlated = {name for group in groups for name in group}
    values = {
        parameter.name: _interval(
            evaluator,
            fit,
            Quantity(
                k,
                is_derived=False,
                value=float(fit.p[k]),
                gradient=unit_vectors[k],
                unit=parameter.unit,
            ),
            is_curved=parameter.name in correlated,
        )
        for k, parameter in enumerate(problem.parameters)
    }
    misfit += _ambiguous(evaluator, minima, derived, fit)
    if misfit:
        values, derived = {}, {}
    return Intervals(values, derived, misfit, correlations, groups, evaluator.runs)


def _interval(
    evaluator: Evaluator, fit: Linearisation, quantity: Quantity, *, is_curved: bool
) -> Interval:
    """The interval of a quantity, by its profile where the covariance would not do."""
    half_width = fit.half_width(quantity.gradient)
    coupling_error = fit.coupling_error(quantity.gradient)
    low, high = quantity.value - half_width, quantity.value + half_width
    if is_curved:
        low, high = profile(evaluator, fit, quantity)
    return Interval(
        quantity.value,
        low - coupling_error,
        high + coupling_error,
        half_width / DEVIATIONS,
        quantity.unit,
    )


def correlation(covariance: Array) -> Array:
    """The correlations of a covariance, both of shape (n, n)."""
    deviations = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(deviations, deviations))


def correlated_groups(names: Sequence[str], correlations: Array) -> list[list[str]]:
    """Groups of free values that a record cannot distinguish: each is almost a function of the others."""
    count, labels = connected_components(np.abs(correlations) > LARGEST_CORRELATION)
    groups = [[name for name, label in zip(names, labels) if label == k] for k in range(count)]
    return [group for group in groups if len(group) > 1]


def profile(evaluator: Evaluator, fit: Linearisation, quantity: Quantity) -> tuple[float, float]:
    """The ends of the interval of a quantity by its profile likelihood.

    Between them chi2 rises by no more than RISE while everything else is fitted again (Venzon and Moolgavkar, Appl.
    Statist. 37, 1988). Near the minimum the rise is a parabola, so that the square root of it gives the next target.
    An end that is not found stays at the last value that was tried.
    """
    reach = fit.half_width(quantity.gradient)
    ends = []
    for sign in (-1.0, 1.0):
        distance = reach
        for _ in range(MOST_TARGETS):
            target = quantity.value + sign * distance
            rise = _constrained_chi2(evaluator, fit, quantity, target) - fit.chi2
            if not 0.0 < rise < LARGEST_RISE:
                break
            ratio = math.sqrt(RISE / rise)
            scale = min(max(ratio, SMALLEST_RATIO), LARGEST_RATIO)
            distance = min(distance * scale, WIDEST_PROFILE * reach)
            if abs(ratio - 1.0) < END_TOLERANCE:
                break
        ends.append(quantity.value + sign * distance)
    return ends[0], ends[1]


def _constrained_chi2(
    evaluator: Evaluator, fit: Linearisation, quantity: Quantity, target: float
) -> float:
    """The least chi2 with a quantity held at its target, by Gauss-Newton; inf where the FMUs refuse."""
    p, residuals, jacobian, C = fit.p, fit.residuals, fit.jacobian, fit.covariance
    low, high = evaluator.problem.bounds
    gradient, value, best = quantity.gradient, quantity.value, math.inf
    for iteration in range(MOST_ITERATIONS):
        direction = C @ gradient
        step = direction * (target - value) / (gradient @ direction)
        if iteration:
            descent = -C @ (jacobian.T @ residuals)
            step += descent - direction * (gradient @ descent) / (gradient @ direction)
        p = np.clip(p + step, low, high)
        try:
            residuals, derived = evaluator.evaluate(p)
        except (SimulationError, SetupError):
            return math.inf
        value, chi2 = quantity.evaluate(p, derived), float(np.sum(residuals**2))
        if not math.isfinite(value):
            return math.inf
        if abs(chi2 - best) < END_TOLERANCE:
            break
        best = min(best, chi2)
        if iteration == 1:
            jacobian = evaluator.jacobian(p)
            C = covariance(jacobian)
    return min(best, chi2)


def _ambiguous(
    evaluator: Evaluator,
    minima: Sequence[Minimum],
    derived: Mapping[str, Interval],
    fit: Linearisation,
) -> list[str]:
    """Another minimum that fits equally well but gives a different machine, in a sentence; else nothing."""
    for other in minima[1:]:
        if other.chi2 > fit.chi2 + AMBIGUOUS_RISE:
            break
        for (name, interval), value in zip(derived.items(), evaluator.evaluate(other.p).derived):
            if abs(value - interval.value) > DIFFERENT_HALF_WIDTHS * interval.error:
                return [
                    f"two machines fit equally well: {name} = {interval.value:.5g} and {value:.5g} "
                    f"{interval.unit} with chi2 = {fit.chi2:.5g} and {other.chi2:.5g}"
                ]
    return []
