"""Machines as they are built, every part anywhere within its tolerance, equally likely: how likely
their torque ripple is above a limit.

First-order theory, times what co-simulation made of it at the nominal machine, judges thousands of
machines; co-simulation judges some of them again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, qmc

from .plane import Plane
from .response import Point, Setup
from .theory import FIELDS, Machine

Real = NDArray[np.float64]
SEED = 1
CONFIDENCE = 0.95
EDGE = (0.05, 0.95)


def factors(tolerances: Mapping[str, float], samples: int) -> dict[str, Real]:
    """What each part's nominal value is multiplied with, as many scrambled Sobol points, a power of 2.

    A tolerance of 0.05 spreads a part's parameter evenly over 0.95 .. 1.05 times its value.
    """
    unit = qmc.Sobol(len(tolerances), rng=SEED).random(samples)
    return {
        name: 1.0 + share * (2.0 * column - 1.0)
        for (name, share), column in zip(tolerances.items(), unit.T)
    }


class Sample(NamedTuple):
    """Machines of a place, each with the speed [rad/s] that is worst for it there and the ripple [N.m]
    expected at that, of shape (samples,).
    """

    place: dict[str, float]
    machines: Machine
    nu: Real
    expected: Real

    def probability(self, limit: float) -> float:
        """Share of the machines whose ripple is above the limit [N.m]; nan where none is known."""
        if np.isnan(self.expected).any():
            return float("nan")
        return float((self.expected > limit).mean())

    def machine(self, number: int) -> tuple[Machine, float]:
        """One of the machines and its speed."""
        values = {f.name: np.ravel(getattr(self.machines, f.name)) for f in fields(Machine)}
        one = {name: float(x[number % len(x)]) for name, x in values.items()}
        return Machine(**one), float(self.nu[number])


def built(plane: Plane, x: Real, y: float, ratio: Real, factors: Mapping[str, Real]) -> Sample:
    """Machines like the one at a point, or at several speeds x, whose co-simulated ripple is theory's
    times a ratio, which is given at the values of the plane's x.
    """
    machine, nu = plane.at(x, y)
    changed: dict[str, Any] = {
        FIELDS[name]: getattr(machine, FIELDS[name]) * factor[:, None]
        for name, factor in factors.items()
    }
    machines = replace(machine, **changed)
    expected = np.abs(machines.torque_ripple(nu)) * np.interp(x, plane.x.values, ratio)
    place = {plane.x.name: float(x[0])} if len(x) == 1 else {}
    worst = np.broadcast_to(nu, x.shape)[expected.argmax(axis=1)]
    return Sample(place | {plane.y.name: y}, machines, worst, expected.max(axis=1))


def on_edge(probabilities: Real, count: int) -> list[int]:
    """Numbers of places where the outcome is open, spread over them all."""
    open_ = np.flatnonzero((probabilities > EDGE[0]) & (probabilities < EDGE[1]))
    chosen = np.linspace(0, len(open_) - 1, min(count, len(open_))).round().astype(int)
    return sorted({int(open_[k]) for k in chosen})


def check(samples: Sequence[Sample], runs: int, limit: float, setup: Setup) -> list[dict[str, Any]]:
    """Co-simulate the first machines of each sample."""
    spots = [(*sample.machine(k), 1) for sample in samples for k in range(runs)]
    orbits = setup.orbits(spots, "check of the probability")
    groups = [orbits[n * runs : (n + 1) * runs] for n in range(len(samples))]
    return [
        judged(sample, group, limit)
        for sample, group in zip(samples, groups)
        if any(not orbit.problem for orbit in group)
    ]


def judged(sample: Sample, orbits: Sequence[Point], limit: float) -> dict[str, Any]:
    """What co-simulation makes of the first machines of a sample; those without an orbit are left out.

    By brute force the probability lies in the interval with CONFIDENCE; corrected is the prediction
    with what co-simulation judges otherwise on the same machines.
    """
    steady = np.array([not orbit.problem for orbit in orbits])
    expected = sample.expected[: len(orbits)][steady]
    found = np.abs([orbit.torque for orbit in orbits])[steady]
    above = int(((found > limit) & (expected <= limit)).sum())
    below = int(((found <= limit) & (expected > limit)).sum())
    hits, total, predicted = int((found > limit).sum()), len(found), sample.probability(limit)
    return {
        "place": sample.place,
        "probability": predicted,
        "brute_force": hits / total,
        "interval": interval(hits, total),
        "corrected": predicted + (above - below) / total,
        "samples": total,
        "judged_above": above,
        "judged_below": below,
        "not_steady": len(orbits) - total,
        "off_rms": float(np.sqrt(np.mean((found / expected - 1.0) ** 2))),
        "off_max": float(np.abs(found / expected - 1.0).max()),
    }


def interval(hits: int, samples: int) -> tuple[float, float]:
    """Of a share that was counted, with CONFIDENCE, by Wilson."""
    bounds = binomtest(hits, samples).proportion_ci(CONFIDENCE, "wilson")
    return float(bounds.low), float(bounds.high)
