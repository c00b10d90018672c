"""Which tolerance moves a figure: shares of its variance, with 95 % confidence intervals.

Saltelli's samples give Sobol's indices of first order, S1, and total, ST. Latin hypercube and Sobol
samples give S1: where a straight line through the inputs explains the figure (adjusted R2 of 0.9 and
more) by its squared standardised coefficients, else by RBD-FAST. Runs without the figure are left out;
of Saltelli's groups of dimensions + 2 runs only complete ones count. Estimates below 0 are given as 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ..plan import Samples, Sampling, salib_problem
from .file import SALIB, Study

#: Harmonics of RBD-FAST; chosen: FAST is usually run with 4 or 6 (Saltelli, Tarantola and Chan, 1999), and more
#: harmonics add noise to few samples.
HARMONICS = 6
#: Adjusted R2 above which a straight line explains a figure; chosen: 10 % may be left, which the interval has.
STRAIGHT = 0.9
#: Resamples of a bootstrap interval; derived from sqrt(0.025 * 0.975 / 400) / 0.058 standard
#: deviations, 4 % of the interval, by which its ends then vary.
RESAMPLES = 400
LEAST_SAMPLES = {"lhs": 64, "sobol": 64, "saltelli": 16}
#: Samples beyond those through which a plane over all inputs always goes. Derived: a figure of noise alone then has an
#: adjusted R2 above STRAIGHT, where chi-square with 20 degrees of freedom is below 2, once in ten million.
FREEDOM = 20
#: Relative spread of a figure that does not vary; derived from the rounding of a sum of many values.
FLAT = 1e-12


class Index(NamedTuple):
    """An index of an input for a figure, half its 95 % interval, from so many runs.

    The method is "linear", "rbd-fast" or "saltelli"; `r2` is the share of the figure's variance that a
    straight line through the inputs explains, adjusted for their number.
    """

    figure: str
    input: str
    kind: str
    value: float
    confidence: float
    runs: int
    method: str
    r2: float


@np.errstate(invalid="ignore", divide="ignore")
def indices(
    sampling: Sampling, inputs: Sequence[str], x: Samples, figure: str, y: Samples
) -> list[Index] | str:
    """The indices of all inputs, x of shape (runs, inputs), y of shape (runs,); or why there are none."""
    saltelli = sampling.method == "saltelli"
    group = sampling.group(len(inputs))
    is_complete = np.repeat(np.isfinite(y).reshape(-1, group).all(axis=1), group)
    x, y = x[is_complete], y[is_complete]
    count = len(y) // group
    least = max(LEAST_SAMPLES[sampling.method], len(inputs) + 1 + FREEDOM if not saltelli else 0)
    if count < least:
        return f"{count} complete samples are too few; at least {least} are needed"
    if np.ptp(y) <= FLAT * np.abs(y).max():
        return "it does not vary"
    shares, r2 = _linear_shares(x, y)
    names, seed = salib_problem(inputs), sampling.seed
    result: dict[str, Any]
    if saltelli:
        from SALib.analyze import sobol

        method, result = "saltelli", sobol.analyze(names, y, calc_second_order=False, seed=seed)
    elif r2 >= STRAIGHT:
        half = _interval(x, y, shares, seed) + max(1.0 - r2, 0.0)
        method, result = "linear", {"S1": shares, "S1_conf": half}
    else:
        try:
            from SALib.analyze import rbd_fast
        except ImportError:
            return f"no straight line explains it, and RBD-FAST needs the package {SALIB}"
        method, result = "rbd-fast", rbd_fast.analyze(names, x, y, M=HARMONICS, seed=seed)
    estimates = [
        Index(figure, name, kind, max(float(value), 0.0), float(half), len(y), method, r2)
        for kind in ("S1", "ST")[: 1 + saltelli]
        for name, value, half in zip(inputs, result[kind], result[f"{kind}_conf"])
    ]
    if not all(np.isfinite([index.value, index.confidence]).all() for index in estimates):
        return "too few runs differ to determine a confidence interval"
    return estimates


def _linear_shares(x: Samples, y: Samples) -> tuple[Samples, float]:
    """Squared standardised coefficients of the linear fit, and its adjusted R2."""
    count, dimensions = x.shape
    spread = x.std(axis=0)
    z = (x - x.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    v = (y - y.mean()) / y.std()
    slopes = np.linalg.lstsq(z, v)[0]
    rest = float(np.square(v - z @ slopes).mean())
    return slopes**2, 1.0 - rest * (count - 1) / (count - dimensions - 1)


def _interval(x: Samples, y: Samples, shares: Samples, seed: int) -> Samples:
    """Half the interval of the shares of a line: the distance to its farther end by bootstrap.

    What the line leaves over comes on top: all of that may be the share of one input.
    """
    samples = np.random.default_rng(seed).integers(len(y), size=(RESAMPLES, len(y)))
    again = np.array([_linear_shares(x[rows], y[rows])[0] for rows in samples])
    ends = np.quantile(again, (0.025, 0.975), axis=0)
    return np.asarray(np.abs(ends - shares).max(axis=0))


def analyse(
    study: Study, figures: Sequence[str], table: pd.DataFrame
) -> tuple[pd.DataFrame, dict[str, str]]:
    """The indices at every point of the grid as a table, and why some figures have none."""
    rows_of_indices: list[dict[str, Any]] = []
    missing: dict[str, str] = {}
    grid, inputs, sampling = list(study.grid), list(study.tolerances), study.sampling
    if sampling is None:
        return pd.DataFrame(), missing
    points = table.groupby(grid, sort=False) if grid else [((), table)]
    for values, rows in points:
        point = dict(zip(grid, values))
        x = rows[inputs].to_numpy(dtype=float)
        for figure in figures:
            outcome = indices(sampling, inputs, x, figure, rows[figure].to_numpy(dtype=float))
            if isinstance(outcome, str):
                at = ", ".join(f"{name} = {value}" for name, value in point.items())
                missing[f"{figure} at {at}" if at else figure] = outcome
            else:
                rows_of_indices += [{**point, **index._asdict()} for index in outcome]
    return pd.DataFrame(rows_of_indices, columns=[*grid, *Index._fields]), missing
