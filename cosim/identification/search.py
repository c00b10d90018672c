"""The least squares of a model: from several starts, some free values before the rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from .model import Model, Vector

Loss = Literal["linear", "huber"]
DRAWS, ENOUGH, SAME, UNLIKE = 24, 3, 0.5, 100.0
FIRST, REST = 12, 40
TIGHT, LOOSE = 1e-9, 1e-5


class Minimum(NamedTuple):
    """Where a start ended: free values and twice the cost, the sum of squared residuals."""

    p: Vector
    chi2: float


def descend(
    model: Model, p: Vector, which: Sequence[int], most: int, rough: Loss | None = None
) -> Minimum:
    """The least squares over some free values, from p, in at most `most` steps; roughly if with a loss."""
    tight = TIGHT if rough is None else LOOSE
    which = list(which)

    def whole(x: Vector) -> Vector:
        moved = p.copy()
        moved[which] = x
        return moved

    low, high = (bound[which] for bound in model.bounds)

    def residuals(x: Vector) -> Vector:
        return model.residuals(whole(x))

    def jacobian(x: Vector) -> Vector:
        return model.jacobian(whole(x), which)

    found = least_squares(
        residuals, np.clip(p[which], low, high),
        jac=jacobian, bounds=(low, high), x_scale="jac", loss=rough or "linear",
        ftol=tight, xtol=1e-3 * tight, gtol=None, max_nfev=most,
    )  # fmt: skip
    end = whole(np.asarray(found.x))
    return Minimum(end, float(np.sum(model.residuals(end) ** 2)))


def search(
    model: Model, first: Sequence[int], starts: int, enough: float, seed: int, loss: Loss
) -> list[Minimum]:
    """Where starts end, the best first: the guess, then others that are drawn.

    From each, the `first` free values are fitted on their own, from the best of DRAWS draws of them. The
    search is over when ENOUGH starts have ended at the same minimum with chi2 below `enough`, or nearly
    twice as many at one with a larger chi2. Many machines look nearly the same half a turn further on, so
    the fit is tried there too, unless it looks quite different.
    """
    rows = sum(len(column.times) for column in model.columns)
    rng = np.random.default_rng(seed)
    low, high = np.array([f.drawn for f in model.free]).T
    every = range(len(model.free))
    found: list[Minimum] = []
    for k in range(starts):
        p = model.guess if k == 0 else rng.uniform(low, high)
        if first:
            drawn = [p]
            for _ in range(DRAWS if k else DRAWS // 2):
                other = p.copy()
                other[list(first)] = rng.uniform(low, high)[list(first)]
                drawn.append(other)
            p = min(drawn, key=lambda x: float(np.sum(model.residuals(x) ** 2)))
            p = descend(model, p, first, FIRST, loss).p
        found.append(descend(model, p, every, REST, loss))
        found.sort(key=lambda minimum: minimum.chi2)
        best = found[0].chi2
        alike = best + SAME * max(1.0, best / rows)
        agree = sum(minimum.chi2 <= alike for minimum in found)
        if agree >= (ENOUGH if best <= enough else 2 * ENOUGH - 1):
            break
    for k in (k for k in first if model.free[k].turns):
        p = found[0].p.copy()
        p[k] += math.pi if p[k] < model.free[k].guess else -math.pi
        turned = descend(model, p, first, FIRST, loss)
        if turned.chi2 < UNLIKE * found[0].chi2:
            found.append(descend(model, turned.p, every, REST, loss))
    return sorted(found, key=lambda minimum: minimum.chi2)
