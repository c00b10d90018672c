"""Which tolerance moves a figure: shares of its variance, with 95 % confidence intervals.

Saltelli's samples give Sobol's indices of first order, S1, and total, ST. Latin hypercube and Sobol
samples give S1 by RBD-FAST. What a row lacks, its samples lack: of Saltelli's groups of dimensions +
2 runs only whole ones count.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .sampling import Sampling

HARMONICS = 6
LEAST = {"lhs": 64, "sobol": 64, "saltelli": 16}
FLAT = 1e-12
Samples = NDArray[np.float64]


class Index(NamedTuple):
    """An index of an input for a figure, half its 95 % interval, from so many runs."""

    figure: str
    input: str
    kind: str
    value: float
    confidence: float
    runs: int


def indices(
    sampling: Sampling, inputs: Sequence[str], x: Samples, figure: str, y: Samples
) -> list[Index] | str:
    """The indices of all inputs, x of shape (runs, inputs), y of shape (runs,); or why there are none."""
    whole = np.isfinite(y)
    group = len(inputs) + 2 if sampling.method == "saltelli" else 1
    whole = np.repeat(whole.reshape(-1, group).all(axis=1), group)
    x, y = x[whole], y[whole]
    count, least = len(y) // group, LEAST[sampling.method]
    if count < least:
        return f"{count} whole samples are too few, it takes {least}"
    if np.ptp(y) <= FLAT * np.abs(y).max():
        return "it does not vary"
    analysis = _saltelli if sampling.method == "saltelli" else _rbd_fast
    with np.errstate(invalid="ignore", divide="ignore"):
        found = [
            Index(figure, name, kind, float(value), float(confidence), len(y))
            for kind, values, confidences in analysis(sampling, inputs, x, y)
            for name, value, confidence in zip(inputs, values, confidences)
        ]
    if not all(np.isfinite([index.value, index.confidence]).all() for index in found):
        return "too few runs differ to tell a confidence interval"
    return found


def _problem(inputs: Sequence[str]) -> dict[str, Any]:
    return {"num_vars": len(inputs), "names": list(inputs), "bounds": [[0.0, 1.0]] * len(inputs)}


def _saltelli(
    sampling: Sampling, inputs: Sequence[str], _: Samples, y: Samples
) -> Iterator[tuple[str, Samples, Samples]]:
    from SALib.analyze import sobol

    told = sobol.analyze(_problem(inputs), y, calc_second_order=False, seed=sampling.seed)
    for kind in ("S1", "ST"):
        yield kind, told[kind], told[f"{kind}_conf"]


def _rbd_fast(
    sampling: Sampling, inputs: Sequence[str], x: Samples, y: Samples
) -> Iterator[tuple[str, Samples, Samples]]:
    from SALib.analyze import rbd_fast

    told = rbd_fast.analyze(_problem(inputs), x, y, M=HARMONICS, seed=sampling.seed)
    yield "S1", told["S1"], told["S1_conf"]


def analyse(
    sampling: Sampling,
    grid: Sequence[str],
    inputs: Sequence[str],
    figures: Sequence[str],
    table: pd.DataFrame,
) -> tuple[pd.DataFrame, dict[str, str]]:
    """The indices at every point of the grid as a table, and why some figures have none."""
    found: list[dict[str, Any]] = []
    missing: dict[str, str] = {}
    for place, rows in _points(grid, table):
        x = rows[list(inputs)].to_numpy(dtype=float)
        for figure in figures:
            told = indices(sampling, inputs, x, figure, rows[figure].to_numpy(dtype=float))
            if isinstance(told, str):
                at = ", ".join(f"{name} = {value}" for name, value in place.items())
                missing[f"{figure} at {at}" if at else figure] = told
            else:
                found += [{**place, **index._asdict()} for index in told]
    return pd.DataFrame(found, columns=[*grid, *Index._fields]), missing


def _points(
    grid: Sequence[str], table: pd.DataFrame
) -> Iterator[tuple[Mapping[str, Any], pd.DataFrame]]:
    """Each point of the grid and its rows."""
    if not grid:
        yield {}, table
        return
    for values, rows in table.groupby(list(grid), sort=False):
        yield dict(zip(grid, values)), rows
