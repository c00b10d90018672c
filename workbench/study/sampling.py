"""Samples of the unit cube, and the distributions that they become."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

Samples = NDArray[np.float64]
LEAST = 2.0**-31


class Sampling(NamedTuple):
    """How tolerances are sampled: method, base number of samples, seed."""

    method: str
    number: int
    seed: int

    def cube(self, dimensions: int) -> Samples:
        """Samples of the unit cube, shape (rows, dimensions); the same for the same seed."""
        return METHODS[self.method](self.number, dimensions, self.seed)

    def problem(self) -> str | None:
        """What is wrong with the number of samples."""
        if self.method != "lhs" and self.number & (self.number - 1):
            below = 1 << (self.number.bit_length() - 1)
            return f"a power of 2 with {self.method!r}, for example {below} or {2 * below}"
        return None


def _lhs(number: int, dimensions: int, seed: int) -> Samples:
    return np.asarray(qmc.LatinHypercube(dimensions, rng=seed).random(number))


def _sobol(number: int, dimensions: int, seed: int) -> Samples:
    return np.asarray(qmc.Sobol(dimensions, rng=seed).random(number))


def _saltelli(number: int, dimensions: int, seed: int) -> Samples:
    """Saltelli's extension, number * (dimensions + 2) rows, for indices of first and total order."""
    from SALib.sample import sobol

    names = [str(i) for i in range(dimensions)]
    problem = {"num_vars": dimensions, "names": names, "bounds": [[0.0, 1.0]] * dimensions}
    return np.asarray(sobol.sample(problem, number, calc_second_order=False, seed=seed))


METHODS: Mapping[str, Callable[[int, int, int], Samples]] = {
    "lhs": _lhs,
    "sobol": _sobol,
    "saltelli": _saltelli,
}


class Distribution(NamedTuple):
    """A distribution by its name in scipy.stats and the parameters of its quantiles."""

    name: str
    parameters: Mapping[str, float]

    def quantiles(self, shares: Samples) -> Samples:
        """The values below which these shares of the distribution lie, same shape."""
        frozen: Any = getattr(stats, self.name)(**self.parameters)
        return np.asarray(frozen.ppf(np.clip(shares, LEAST, 1.0 - LEAST)))


def between(low: float, high: float) -> Distribution:
    """Uniform between two values."""
    return Distribution("uniform", {"loc": low, "scale": high - low})


def log_between(low: float, high: float) -> Distribution:
    """Uniform in the logarithm between two values above 0."""
    return Distribution("loguniform", {"a": low, "b": high})


def normal(nominal: float, deviation: float) -> Distribution:
    """Normal with this standard deviation."""
    return Distribution("norm", {"loc": nominal, "scale": deviation})


def truncated(nominal: float, deviation: float, limit: float) -> Distribution:
    """Normal, cut off at nominal - limit and nominal + limit."""
    cut = limit / deviation
    return Distribution("truncnorm", {"a": -cut, "b": cut, "loc": nominal, "scale": deviation})
