"""Samples of the unit cube, the same for the same seed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

METHODS = ("lhs", "sobol", "saltelli")
LEAST = 2.0**-31
Samples = NDArray[np.float64]


class Sampling(NamedTuple):
    """How tolerances are sampled: method, base number of samples, seed."""

    method: str
    number: int
    seed: int

    def cube(self, dimensions: int) -> Samples:
        """Samples of the unit cube but for its faces, shape (rows, dimensions).

        Saltelli's extension, number * (dimensions + 2) rows, is for indices of first and total order.
        """
        if self.method == "lhs":
            cube = qmc.LatinHypercube(dimensions, rng=self.seed).random(self.number)
        elif self.method == "sobol":
            cube = qmc.Sobol(dimensions, rng=self.seed).random(self.number)
        else:
            from SALib.sample import sobol

            cube = sobol.sample(
                problem(list(map(str, range(dimensions)))),
                self.number,
                calc_second_order=False,
                seed=self.seed,
            )
        return np.clip(cube, LEAST, 1.0 - LEAST)


def problem(inputs: Sequence[str]) -> dict[str, Any]:
    """Inputs between 0 and 1, as SALib wants them."""
    return {"num_vars": len(inputs), "names": list(inputs), "bounds": [[0.0, 1.0]] * len(inputs)}
