"""Machines as they are built: every part anywhere within its tolerance, equally likely."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, qmc

from ..theory import FIELDS, Machine

Real = NDArray[np.float64]
SEED = 1
CONFIDENCE = 0.95


def factors(tolerances: Mapping[str, float], exponent: int) -> dict[str, Real]:
    """What each part's nominal value is multiplied with, 2**exponent scrambled Sobol points.

    A tolerance of 0.05 spreads a part's parameter evenly over 0.95 .. 1.05 times its value.
    """
    unit = qmc.Sobol(len(tolerances), rng=SEED).random_base2(exponent)
    return {
        name: 1.0 + share * (2.0 * column - 1.0)
        for (name, share), column in zip(tolerances.items(), unit.T)
    }


def built(machine: Machine, factors: Mapping[str, Real]) -> Machine:
    """The machine with an array of every toleranced parameter, shape (samples,)."""
    changed: dict[str, Any] = {
        FIELDS[name]: getattr(machine, FIELDS[name]) * factor for name, factor in factors.items()
    }
    return replace(machine, **changed)


def one(machines: Machine, number: int) -> Machine:
    """The machine of one sample."""
    values = {f.name: np.atleast_1d(getattr(machines, f.name)) for f in fields(Machine)}
    return Machine(**{name: float(x[number % len(x)]) for name, x in values.items()})


def ripple(machines: Machine, nu: float | Real) -> Real:
    """Amplitude of the torque ripple of first-order theory [N.m], as numpy broadcasts."""
    return np.asarray(np.abs(machines.torque_ripple(nu)))  # type: ignore[arg-type]


class Check(NamedTuple):
    """Samples that theory judged and co-simulation judged again, at one place of a map.

    `above` and `below` count those that co-simulation alone puts above or below the limit, `restless`
    those left out because their orbit is not steady. `off` are the relative differences of the
    ripple, shape (samples,).
    """

    place: dict[str, float]
    predicted: float
    hits: int
    above: int
    below: int
    restless: int
    off: Real

    @property
    def samples(self) -> int:
        return len(self.off)

    @property
    def counted(self) -> float:
        """The probability by brute force."""
        return self.hits / self.samples

    @property
    def interval(self) -> tuple[float, float]:
        """In which the brute-force probability lies with CONFIDENCE, by Wilson."""
        return interval(self.hits, self.samples)

    @property
    def corrected(self) -> float:
        """The prediction corrected by what co-simulation judges otherwise on the same samples."""
        return self.predicted + (self.above - self.below) / self.samples


def interval(hits: int, samples: int) -> tuple[float, float]:
    """Of a share that was counted, with CONFIDENCE."""
    bounds = binomtest(hits, samples).proportion_ci(CONFIDENCE, "wilson")
    return float(bounds.low), float(bounds.high)


def sampling_error(probability: Real, samples: int) -> float:
    """The largest standard error of probabilities from independent samples; Sobol's is smaller."""
    return float(np.sqrt(np.nanmax(probability * (1.0 - probability)) / samples))
