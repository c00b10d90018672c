"""Machines as they are built, every part anywhere within its tolerance, equally likely: how likely
their torque ripple is above a limit.

First-order theory, times what co-simulation made of it at the nominal machine, judges thousands of
machines; co-simulation judges some of them again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, qmc

from .plane import Plane
from .response import Point, Setup, Spot
from .theory import FIELDS

Real = NDArray[np.float64]
SEED = 1
CONFIDENCE = 0.95
EDGE = (0.05, 0.95)


class Sample(NamedTuple):
    """Built machines of a row: the x that is worst for each, and the torque ripple [N.m] expected
    there, of shape (samples,).
    """

    place: dict[str, float]
    y: float
    x: Real
    expected: Real

    def probability(self, limit: float) -> float:
        """Share of the machines whose ripple is above the limit [N.m]; nan where none is known."""
        if np.isnan(self.expected).any():
            return float("nan")
        return float((self.expected > limit).mean())


class Built(NamedTuple):
    """Machines like those of a plane: what each part's nominal value is multiplied with, of shape
    (samples,).
    """

    plane: Plane
    factors: Mapping[str, Real]

    @classmethod
    def within(cls, plane: Plane, tolerances: Mapping[str, float], samples: int) -> Built:
        """As many as scrambled Sobol points, a power of 2; a tolerance of 0.05 spreads a part's
        parameter evenly over 0.95 .. 1.05 times its value.
        """
        columns = qmc.Sobol(len(tolerances), rng=SEED).random(samples).T
        spread = zip(tolerances.items(), columns)
        return cls(plane, {name: 1.0 + share * (2.0 * x - 1.0) for (name, share), x in spread})

    def at(self, x: Any, y: float, number: Any) -> Spot:
        """One of the machines at a point and its mean speed, or several at an array of x."""
        machine, nu = self.plane.at(x, y)
        parts = {FIELDS[name]: factor[number] for name, factor in self.factors.items()}
        changed: dict[str, Any] = {name: getattr(machine, name) * x for name, x in parts.items()}
        return replace(machine, **changed), nu, 1

    def sample(self, x: Real, y: float, ratio: Real) -> Sample:
        """All machines, each at its worst x, where the co-simulated ripple of the nominal one is
        theory's times a ratio.
        """
        machines, nu, _ = self.at(x, y, (slice(None), None))
        expected = np.atleast_2d(np.abs(machines.torque_ripple(nu)) * ratio)
        place = {self.plane.x.name: float(x[0])} if len(x) == 1 else {}
        worst = x[expected.argmax(axis=1)]
        return Sample(place | {self.plane.y.name: y}, y, worst, expected.max(axis=1))

    def check(
        self, samples: Sequence[Sample], runs: int, limit: float, setup: Setup
    ) -> list[dict[str, Any]]:
        """Co-simulate the first machines of each sample."""
        spots = [self.at(float(one.x[k]), one.y, k) for one in samples for k in range(runs)]
        orbits = list(setup.orbits(spots, "check of the probability"))
        groups = [orbits[n * runs : (n + 1) * runs] for n in range(len(samples))]
        return [
            judged(sample, group, limit)
            for sample, group in zip(samples, groups)
            if any(not orbit.problem for orbit in group)
        ]


def on_edge(probabilities: Real, count: int) -> list[int]:
    """Numbers of places where the outcome is open, spread over them all."""
    open_ = np.flatnonzero((probabilities > EDGE[0]) & (probabilities < EDGE[1]))
    chosen = np.linspace(0, len(open_) - 1, min(count, len(open_))).round().astype(int)
    return sorted({int(open_[k]) for k in chosen})


def judged(sample: Sample, orbits: Sequence[Point], limit: float) -> dict[str, Any]:
    """What co-simulation makes of the first machines of a sample; those without an orbit are left out.

    By brute force the probability lies in the interval with CONFIDENCE.
    """
    steady = np.array([not orbit.problem for orbit in orbits])
    expected = sample.expected[: len(orbits)][steady]
    found = np.abs([orbit.torque for orbit in orbits])[steady]
    hits, total = int((found > limit).sum()), len(found)
    off = found / expected - 1.0
    return {
        "place": sample.place,
        "probability": sample.probability(limit),
        "brute_force": hits / total,
        "interval": interval(hits, total),
        "samples": total,
        "judged_above": int(((found > limit) & (expected <= limit)).sum()),
        "judged_below": int(((found <= limit) & (expected > limit)).sum()),
        "not_steady": len(orbits) - total,
        "off_rms": float(np.sqrt(np.mean(off**2))),
        "off_max": float(np.abs(off).max()),
    }


def interval(hits: int, samples: int) -> tuple[float, float]:
    """Of a share that was counted, with CONFIDENCE, by Wilson."""
    bounds = binomtest(hits, samples).proportion_ci(CONFIDENCE, "wilson")
    return float(bounds.low), float(bounds.high)
