"""The fit made exact: the neighbourhood of the best minimum, and steps so short that the coupling does not matter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from ..accuracy.limit import likeliest
from .chi2 import chi2_band
from .fit import Fit, descend
from .noise import Noise
from .parameters import Array
from .problem import Evaluator, Problem

#: Probability with which an interval holds the true value. Convention: 95 %.
COVERAGE = 0.95
#: Half-width of an interval over the standard deviation of a normal distribution.
DEVIATIONS = float(stats.norm.ppf(0.5 + COVERAGE / 2))
#: Step of the central differences, over the size of a value. Chosen between the cube root of the precision of doubles,
#: 6e-6, and the nonlinearity, so that the rounding of an FMU's own integration does not show.
CENTRAL_STEP = 1e-4
#: Singular values below this share of the largest one count as this share. Chosen: values that the residuals do not
#: depend on get a huge covariance, not an infinite one.
SINGULAR = 1e-12
#: The least of the largest singular values. Derived: keeps the above above zero where nothing depends on anything.
SMALLEST_SINGULAR = 1e-300
#: Largest error of the coupling, over the half-width of an interval. Chosen: adds at most a tenth to it.
LARGEST_COUPLING_ERROR = 0.1
#: How often steps are halved or noise is corrected. Chosen: steps of 1/64 of the spacing of the rows.
MOST_REFINEMENTS = 6
#: Evaluations of the final fit, per free parameter. Chosen: it starts at its minimum, which moves little.
EVALUATIONS_PER_PARAMETER = 2


@dataclass(frozen=True)
class Linearisation:
    """A minimum and its neighbourhood.

    At the values p of the n free parameters: the m residuals, their Jacobian (m, n), the covariance of p, (n, n), k
    derived quantities with their gradients (k, n). `displacements`, shape (2, n), is how far p moves with a half
    and a quarter of the step, and `orders` are the powers of the step with which columns fall.
    """

    p: Array
    residuals: Array
    jacobian: Array
    covariance: Array
    derived: Array
    gradients: Array
    displacements: Array
    orders: Sequence[float]

    @property
    def chi2(self) -> float:
        """The sum of squared residuals."""
        return float(np.sum(self.residuals**2))

    def half_width(self, gradient: Array) -> float:
        """The half-width of the 95 % interval of a quantity with this gradient, (n,)."""
        return DEVIATIONS * math.sqrt(max(0.0, float(gradient @ self.covariance @ gradient)))

    def coupling_error(self, gradient: Array) -> float:
        """The error of that quantity from the coupling and from the spacing of the rows of the runs.

        What a quarter of the step changes, and what is left below it.
        """
        half, quarter = (self.displacements @ gradient).tolist()
        return float(abs(quarter) + likeliest([quarter, half, 0.0], self.orders).error)

    def is_resolved(self) -> bool:
        """Whether the coupling moves each value and derived quantity little, compared with its interval."""
        gradients = [*np.eye(len(self.p)), *self.gradients]
        return all(
            self.coupling_error(g) <= LARGEST_COUPLING_ERROR * self.half_width(g) for g in gradients
        )


@dataclass(frozen=True)
class Refinement:
    """A fit with its linearisation, of a problem with steps short enough and noise that the residuals confirm.

    `rejections` are reasons against it, `runs` how many runs it took.
    """

    problem: Problem
    linearisation: Linearisation
    rejections: Sequence[str]
    runs: int


def refine(fit: Fit) -> Refinement:
    """Fit again from the best minimum until the noise is confirmed and the coupling does not matter."""
    problem, p, runs = fit.problem, fit.minima[0].p, 0
    everything = range(len(problem.parameters))
    evaluations = EVALUATIONS_PER_PARAMETER * len(everything)
    rejections = list(fit.rejections)
    for refinements in range(MOST_REFINEMENTS + 1):
        evaluator = Evaluator(problem)
        p = descend(evaluator, p, everything, evaluations).p
        linearisation = linearise(evaluator, p)
        runs += evaluator.runs
        corrected = lower_estimated_noise(problem, linearisation)
        if corrected is problem and linearisation.is_resolved():
            break
        if refinements == MOST_REFINEMENTS:
            rejections.append(
                f"the coupling still moves the values by more than {LARGEST_COUPLING_ERROR:.0%} of their "
                f"intervals with steps of {problem.step:.3g} s"
            )
        elif corrected is not problem:
            problem = corrected
        else:
            problem = replace(problem, step=problem.step / 2.0)
    return Refinement(problem, linearisation, tuple(rejections), runs)


def linearise(evaluator: Evaluator, p: Array) -> Linearisation:
    """The neighbourhood of values p, from central differences; from one side where the FMUs refuse the other."""
    problem = evaluator.problem
    displaced: list[Array] = []
    for k, parameter in enumerate(problem.parameters):
        for sign in (-1.0, 1.0):
            step = sign * CENTRAL_STEP * parameter.size
            displaced.append(p.copy())
            displaced[-1][k] = min(max(p[k] + step, parameter.low), parameter.high)
    centre, samples = evaluator.evaluate(p), evaluator.evaluations(displaced)
    columns, gradients = [], []
    for k in range(len(p)):
        ends = zip(displaced[2 * k : 2 * k + 2], samples[2 * k : 2 * k + 2])
        (lower, below), (upper, above) = (
            (p[k], centre) if sample is None else (point[k], sample) for point, sample in ends
        )
        distance = (upper - lower) or 1.0
        columns.append((above.residuals - below.residuals) / distance)
        gradients.append((above.derived - below.derived) / distance)
    jacobian = np.stack(columns, axis=1)
    C = covariance(jacobian)
    finer = [evaluator.simulate(p, step=problem.step / n) for n in (2.0, 4.0)]
    changes = np.array(
        [
            centre.residuals - problem.residual_vector(p, problem.predict(p, result))
            for result in finer
        ]
    )
    provenance = finer[0].provenance
    order = float(provenance["convergence_order"])
    orders = {order} | ({min(order, 1.0)} if provenance.get("first_order") else set())
    return Linearisation(
        p,
        centre.residuals,
        jacobian,
        C,
        centre.derived,
        np.stack(gradients, axis=1),
        changes @ jacobian @ C,
        sorted(orders),
    )


def covariance(jacobian: Array) -> Array:
    """The covariance of the free parameters, shape (n, n), from the Jacobian of the residuals, (m, n).

    It is the inverse of the Fisher information, by singular values; huge for parameters that do not affect the
    residuals.
    """
    norms = np.linalg.norm(jacobian, axis=0)
    scale = 1.0 / np.where(norms > 0.0, norms, 1.0)
    _, singular_values, right = np.linalg.svd(jacobian * scale, full_matrices=False)
    least = SINGULAR * max(float(singular_values[0]), SMALLEST_SINGULAR)
    root = (right.T / np.maximum(singular_values, least)) * scale[:, None]
    return np.asarray(root @ root.T)


def lower_estimated_noise(problem: Problem, linearisation: Linearisation) -> Problem:
    """The problem with the noise of the residuals where these are clearly smaller than the noise estimated from the rows.

    That is so for a counter, whose errors alternate. The same problem if there are no such columns.
    """
    share = 1.0 - len(problem.parameters) / problem.rows
    columns, first = [], 0
    for column in problem.columns:
        residuals = linearisation.residuals[first : first + len(column.times)]
        first += len(residuals)
        dof, low, _ = chi2_band([column], 0, 0)
        variance = float(np.mean(residuals**2)) / share
        if not column.noise.is_stated and variance * dof < low:
            source = (
                "that of the residual, since the errors of neighbouring rows are not independent"
            )
            noise = Noise(column.noise.sigma * math.sqrt(variance), source)
            columns.append(replace(column, noise=noise))
        else:
            columns.append(column)
    unchanged = all(new is old for new, old in zip(columns, problem.columns))
    return problem if unchanged else replace(problem, columns=columns)
