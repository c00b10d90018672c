"""The second step: least squares from several starts, some values before the rest; outliers are left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats.qmc import LatinHypercube

from .chi2 import chi2_band
from .noise import OUTLIER_DEVIATIONS
from .parameters import Array
from .problem import Evaluator, Problem

Loss = Literal["linear", "huber"]
#: Draws of the values that are fitted first, of which the best one is a start. Chosen: there
#: is a draw of an unknown angle in every 15 degrees.
DRAWS = 24
#: Starts that must end at the same minimum, if noise explains this. Chosen: two could agree by chance.
AGREEING_STARTS = 3
#: Starts that must end at the same minimum, if noise does not explain it. Chosen: nearly twice as many, since there
#: is a better minimum or none.
AGREEING_STARTS_OF_MISFIT = 2 * AGREEING_STARTS - 1
#: Two minima are the same if chi2 differs by less than this many times its mean over the rows, at least 1. Chosen:
#: below the rise of 1 of a standard deviation.
SAME_MINIMUM = 0.5
#: A fit half a turn further on is followed unless its chi2 is so many times larger. Chosen: the other values, fitted
#: again, can gain no more.
UNLIKE_CHI2 = 100.0
#: Evaluations for the values that are fitted first. Chosen: a start needs no more than a few digits.
FIRST_EVALUATIONS = 12
#: Evaluations for all values. Chosen: room for a start far from its minimum; one that is not there by then is given up.
ALL_EVALUATIONS = 40
#: Relative change of chi2 at which the final fit ends. Chosen: far below 1 over the number of rows.
FINAL_TOLERANCE = 1e-9
#: The same of a start. Chosen: the final fit follows.
START_TOLERANCE = 1e-5
#: The relative change of values at which a fit ends, over that of chi2. Chosen: chi2 is flat at its minimum, so that it
#: decides first.
STEP_OVER_TOLERANCE = 1e-3


class Minimum(NamedTuple):
    """Where a start ended: values of the free parameters, shape (n,), and the sum of squared residuals."""

    p: Array
    chi2: float


@dataclass(frozen=True)
class SearchPlan:
    """How starts are made: indices of the values `first` fitted, largest number of starts, and seed."""

    first: Sequence[int]
    starts: int
    seed: int


@dataclass(frozen=True)
class Fit:
    """The minima that starts reached, the best first, of a problem without its outliers.

    `notes` are remarks, `rejections` reasons against the fit, and `runs` how many runs it took.
    """

    problem: Problem
    minima: Sequence[Minimum]
    notes: Sequence[str]
    rejections: Sequence[str]
    runs: int


def fit(problem: Problem, plan: SearchPlan, outliers: float = 0.0) -> Fit:
    """Search the minima of a problem; `outliers` is the share of rows of a column that may be outliers.

    With outliers the search takes Huber's loss, which weighs residuals beyond one standard deviation by their size
    and not by their square (Huber, Ann. Math. Statist. 35, 1964).
    """
    evaluator = Evaluator(problem)
    _, _, enough = chi2_band(problem.columns, len(problem.prior.names), len(problem.parameters))
    if not outliers:
        return Fit(problem, search(evaluator, plan, enough, "linear"), (), (), evaluator.runs)
    minima = search(evaluator, plan, math.inf, "huber")
    return _without_outliers(evaluator, minima, outliers)


def search(evaluator: Evaluator, plan: SearchPlan, enough: float, loss: Loss) -> list[Minimum]:
    """Where starts end, the best first: the guess, then others that are drawn.

    The starts are a Latin hypercube, which puts one into each of as many equal strata of every value (McKay,
    Beckman and Conover, Technometrics 21, 1979). From each, the values to be fitted first are fitted on their own,
    from the best of DRAWS draws of them, which are a Latin hypercube too. The search is over when AGREEING_STARTS
    have ended at the same minimum with chi2 below `enough`, or nearly twice as many at one with a larger chi2. Many
    machines look nearly the same half a turn further on, so the fit is tried there too, unless it looks quite
    different.
    """
    problem = evaluator.problem
    rng = np.random.default_rng(plan.seed)
    low, high = np.array([(f.start_low, f.start_high) for f in problem.parameters]).T
    everything, first = range(len(problem.parameters)), list(plan.first)
    minima: list[Minimum] = []
    for p in [problem.guess, *latin_hypercube(plan.starts - 1, low, high, rng)]:
        if first:
            draws = latin_hypercube(DRAWS, low[first], high[first], rng)
            p = evaluator.best([p, *(_with_values(p, first, draw) for draw in draws)])
            p = descend(evaluator, p, plan.first, FIRST_EVALUATIONS, loss).p
        minima.append(descend(evaluator, p, everything, ALL_EVALUATIONS, loss))
        minima.sort(key=lambda minimum: minimum.chi2)
        if _is_agreed(minima, problem.rows, enough):
            break
    for k in plan.first:
        if problem.parameters[k].is_angle:
            minima += _half_a_turn_further(evaluator, minima[0], k, plan, loss)
    return sorted(minima, key=lambda minimum: minimum.chi2)


def latin_hypercube(number: int, low: Array, high: Array, rng: np.random.Generator) -> Array:
    """Draw so many points between low and high, both of shape (n,): a Latin hypercube of shape (number, n)."""
    fractions = LatinHypercube(len(low), rng=rng).random(number)
    return np.asarray(low + (high - low) * fractions)


def _with_values(p: Array, indices: Sequence[int], values: Array) -> Array:
    """Values p of the free parameters, with others at these indices."""
    changed = p.copy()
    changed[list(indices)] = values
    return changed


def _is_agreed(minima: Sequence[Minimum], rows: int, enough: float) -> bool:
    """Whether enough starts have ended at the best minimum."""
    best = minima[0].chi2
    limit = best + SAME_MINIMUM * max(1.0, best / rows)
    agreeing = sum(minimum.chi2 <= limit for minimum in minima)
    return agreeing >= (AGREEING_STARTS if best <= enough else AGREEING_STARTS_OF_MISFIT)


def _half_a_turn_further(
    evaluator: Evaluator, best: Minimum, index: int, plan: SearchPlan, loss: Loss
) -> list[Minimum]:
    """The minimum from where an angle is half a turn further on, or none if it looks quite different there."""
    parameters = evaluator.problem.parameters
    p = best.p.copy()
    p[index] += math.pi if p[index] < parameters[index].guess else -math.pi
    opposite = descend(evaluator, p, plan.first, FIRST_EVALUATIONS, loss)
    if opposite.chi2 >= UNLIKE_CHI2 * best.chi2:
        return []
    return [descend(evaluator, opposite.p, range(len(parameters)), ALL_EVALUATIONS, loss)]


def descend(
    evaluator: Evaluator,
    p: Array,
    indices: Sequence[int],
    evaluations: int,
    loss: Loss | None = None,
) -> Minimum:
    """The least squares over the free parameters of these indices, from values p.

    A descent with a loss is one of a start and ends earlier. The method is the trust region reflective one of
    `scipy.optimize.least_squares` (Branch, Coleman and Li, SIAM J. Sci. Comput. 21, 1999), with at most so many
    evaluations.
    """
    tolerance = FINAL_TOLERANCE if loss is None else START_TOLERANCE
    selected = list(indices)
    low, high = (bound[selected] for bound in evaluator.problem.bounds)

    def complete(x: Array) -> Array:
        values = p.copy()
        values[selected] = x
        return values

    def residuals(x: Array) -> Array:
        return evaluator.residuals(complete(x))

    def jacobian(x: Array) -> Array:
        return evaluator.jacobian(complete(x), selected)

    solution = least_squares(
        residuals, np.clip(p[selected], low, high),
        jac=jacobian, bounds=(low, high), x_scale="jac", loss=loss or "linear",
        ftol=tolerance, xtol=STEP_OVER_TOLERANCE * tolerance, gtol=None, max_nfev=evaluations,
    )  # fmt: skip
    end = complete(np.asarray(solution.x))
    return Minimum(end, evaluator.chi2(end))


def _without_outliers(evaluator: Evaluator, minima: Sequence[Minimum], allowed: float) -> Fit:
    """The problem without rows far from its best fit; a reason against it where these are too many."""
    problem, p = evaluator.problem, minima[0].p
    predictions = problem.predict(p, evaluator.simulate(p))
    columns, notes, rejections = [], [], []
    for column, x in zip(problem.columns, predictions):
        inside = np.abs(x - column.values) <= OUTLIER_DEVIATIONS * column.noise.sigma
        outside, rows = int((~inside).sum()), len(inside)
        if outside > allowed * rows:
            rejections.append(
                f"{column.port.name}: {outside} of {rows} rows lie beyond {OUTLIER_DEVIATIONS:g} times the noise"
            )
            inside[:] = True
        elif outside:
            notes.append(
                f"{column.port.name}: {outside} of {rows} rows are outliers and are left out."
            )
        columns.append(replace(column, times=column.times[inside], values=column.values[inside]))
    return Fit(replace(problem, columns=columns), minima, notes, rejections, evaluator.runs)
