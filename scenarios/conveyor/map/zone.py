"""How likely a machine built within its tolerances has a torque ripple above the limit.

First-order theory, corrected by what the map's co-simulation made of it at the nominal machine,
judges thousands of machines at every point; co-simulation judges some of them again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..response import Point, simulate
from ..theory import Machine
from .plane import Plane, Setup
from .tolerances import Check, built, one, ripple

Real = NDArray[np.float64]
EDGE = (0.05, 0.95)
SPEEDS = 61


class Sample(NamedTuple):
    """Machines at one place of the map, each with its speed [rad/s] and the ripple expected [N.m]."""

    place: dict[str, float]
    machines: Machine
    nu: Real
    expected: Real


def at_point(
    plane: Plane, ratio: Real, factors: Mapping[str, Real], row: int, column: int
) -> Sample:
    """Machines like the one at a point, which turn at its speed."""
    x, y = float(plane.x.values[column]), float(plane.y.values[row])
    machine, nu = plane.at(x, y)
    machines = built(machine, factors)
    expected = ripple(machines, nu) * ratio[row, column]
    return Sample(
        {plane.x.name: x, plane.y.name: y}, machines, np.full(expected.shape, nu), expected
    )


def in_range(
    plane: Plane, ratio: Real, factors: Mapping[str, Real], row: int, span: tuple[float, float]
) -> Sample:
    """Machines like those of a row, each at the speed of an operating range that is worst for it."""
    y = float(plane.y.values[row])
    nus = np.linspace(*span, SPEEDS)
    machines = built(plane.at(span[0], y)[0], factors)
    column = built(plane.at(span[0], y)[0], {k: v[:, None] for k, v in factors.items()})
    expected = ripple(column, nus) * np.interp(nus, plane.x.values, ratio[row])
    worst = expected.argmax(axis=1)
    return Sample({plane.y.name: y}, machines, nus[worst], expected.max(axis=1))


def probability(sample: Sample, limit: float) -> float:
    """Share of the machines whose ripple is above the limit [N.m]; nan where none is known."""
    if np.isnan(sample.expected).any():
        return float("nan")
    return float((sample.expected > limit).mean())


def on_edge(probabilities: Real, count: int) -> list[tuple[int, ...]]:
    """Indices of places where the outcome is open, spread over them all."""
    open_ = np.argwhere((probabilities > EDGE[0]) & (probabilities < EDGE[1]))
    chosen = np.unique(np.linspace(0, len(open_) - 1, min(count, len(open_))).round().astype(int))
    return [tuple(int(i) for i in open_[k]) for k in chosen]


def check(samples: Sequence[Sample], runs: int, limit: float, setup: Setup) -> list[Check]:
    """Co-simulate the first machines of each sample; samples without a steady orbit are left out."""
    cases = [setup.case(one(s.machines, k), float(s.nu[k])) for s in samples for k in range(runs)]
    orbits = list(setup.bench.each(simulate, cases, "check of the probability"))
    checks = [judged(s, orbits[n * runs : (n + 1) * runs], limit) for n, s in enumerate(samples)]
    return [check for check in checks if check.samples]


def judged(sample: Sample, orbits: Sequence[Point], limit: float) -> Check:
    """What co-simulation says of the first machines of a sample."""
    steady = np.array([not orbit.problem for orbit in orbits])
    expected = sample.expected[: len(orbits)][steady]
    found = np.abs([orbit.torque for orbit in orbits])[steady]
    return Check(
        sample.place,
        probability(sample, limit),
        int((found > limit).sum()),
        int(((found > limit) & (expected <= limit)).sum()),
        int(((found <= limit) & (expected > limit)).sum()),
        int((~steady).sum()),
        found / expected - 1.0,
    )
