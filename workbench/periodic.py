"""The steady orbit of a coupled machine that turns: found, checked, and refused where there is none.

A revolution maps the states at one crank angle to the states a revolution later. Its fixed point is
the orbit. The first revolutions from a start show that map; where it is nearly linear, they tell the
fixed point, from where the run starts again. What the last revolution still moves, divided by what a
revolution leaves of it, is the settling error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim import Result, SimulationError, System

Samples = NDArray[np.floating[Any]]
TURN = 2 * math.pi
NEAR = 8
SETTLED, NOISE = 3e-9, 1e-6
TOLD, CLEAR = 1e-6, 5e-3
ROUNDS = 16
SLACK = 1.02


class NotSteady(Exception):
    """There is no steady orbit from which to take a figure; says why in a sentence."""


class Turns(NamedTuple):
    """Whole revolutions of a run: columns by name and the rows of the last and the one before.

    `left` is the share of a deviation from the orbit that a revolution leaves.
    """

    result: Result
    angle: str
    ends: Samples
    times: Samples
    left: float
    states: Mapping[str, float]

    def window(self, back: int = 0) -> slice:
        """The rows of the last revolution, or of one so many before it."""
        phi = self.result[self.angle]
        first, last = self.ends[-2 - back], self.ends[-1 - back]
        return slice(int(np.searchsorted(phi, first)), int(np.searchsorted(phi, last)) + 1)

    def period(self, back: int = 0) -> float:
        """How long that revolution takes [s]."""
        return float(self.times[-1 - back] - self.times[-2 - back])

    def remains(self, moved: float) -> float:
        """What settling still leaves of a figure that moved so far over the last revolution."""
        return moved * max(self.left / (1.0 - self.left), 0.1)


def steady(
    system: Callable[[Mapping[str, float]], System],
    states: Mapping[str, float],
    angle: str,
    speed: float,
    steps_per_rev: int,
    record: Sequence[str],
    algorithm: str = "strang",
) -> Turns:
    """Whole revolutions on the steady orbit near the start values `states` of the system.

    `system` makes the system of start values; `angle` is the output that grows by 2 pi in a
    revolution, from 0 at the start; `speed` is about its mean rate [rad/s], which with
    `steps_per_rev` gives the communication step. A start from which the crank stalls is taken back
    halfway to where it turned. Raises NotSteady.
    """
    names = list(states)
    columns = list(dict.fromkeys([angle, *names, *record]))
    scale = np.array([max(abs(states[name]), 1e-3 * speed) for name in names])
    count = len(names) + 1
    h = TURN / (speed * steps_per_rev)
    at = np.array([states[name] for name in names])
    pace, moved, safe = 1.0, math.inf, None
    known: tuple[Samples, float] | None = None
    for _ in range(ROUNDS):
        steps = math.ceil(count * steps_per_rev * SLACK / pace) + NEAR
        start = dict(zip(names, at.tolist()))
        try:
            result = cosim.run(
                system(start), stop=steps * h, step=h, algorithm=algorithm, record=columns
            )
        except SimulationError as error:
            raise NotSteady(str(error)) from error
        phi = result[angle]
        if not (np.diff(phi) > 0.0).all():
            if safe is None:
                raise NotSteady("the crank does not complete a turn")
            at = (at + safe) / 2
            continue
        if phi[-1] < TURN * count:
            pace = phi[-1] / (TURN * count) * pace / SLACK
            if pace < 0.05:
                raise NotSteady(
                    f"the crank turns at {phi[-1] / result['time'][-1]:.3g} rad/s instead of {speed:g} rad/s"
                )
            continue
        ends = TURN * np.arange(count + 1)
        values = np.stack([result["time"], *(result[name] for name in names)])
        times, *sections = at_angles(phi, values, ends)
        sections = np.array(sections).T / scale
        sections[0] = at / scale
        last = sections[-1] - sections[-2]
        before, moved = moved, float(np.abs(last).max())
        if known is None or np.abs(np.diff(sections, axis=0)).max() > TOLD:
            known = return_map(sections)
        map_, left = known
        turns = Turns(
            result, angle, ends, times, left, dict(zip(names, (sections[-1] * scale).tolist()))
        )
        far = moved * max(left / max(1.0 - left, 1e-12), 1.0)
        if far < SETTLED or (far < NOISE and moved > 0.3 * before):
            if left >= 1.0:
                raise NotSteady("the orbit is not stable: deviations from it grow")
            return turns
        ahead = np.linalg.lstsq(np.eye(len(names)) - map_, last, rcond=1e-12)[0]
        safe = sections[-1] * scale
        at = safe + map_ @ ahead * scale
    raise NotSteady(
        f"after {ROUNDS * count} revolutions of {steps_per_rev} steps the orbit still changes by a share "
        f"of {moved:.1g}; more steps per revolution may settle it"
    )


def return_map(sections: Samples) -> tuple[Samples, float]:
    """The linear map that takes each deviation between sections to the next, and its largest rate.

    Sections have the shape (revolutions + 1, states). Of a direction in which deviations hardly
    point the map is not known, and left at 0.
    """
    d = np.diff(sections, axis=0)
    size = np.maximum(np.abs(d).max(axis=0), 1e-300)
    found = np.linalg.lstsq(d[:-1] / size, d[1:] / size, rcond=CLEAR)[0].T
    return found * size[:, None] / size, float(np.abs(np.linalg.eigvals(found)).max())


def at_angles(phi: Samples, values: Samples, wanted: Samples) -> Samples:
    """Values, of shape (columns, rows), at wanted angles, on polynomials through NEAR rows."""
    found = np.empty((len(values), len(wanted)))
    same = np.eye(NEAR)
    for k, angle in enumerate(wanted):
        i = int(np.clip(np.searchsorted(phi, angle) - NEAR // 2, 0, len(phi) - NEAR))
        near = slice(i, i + NEAR)
        apart = phi[near][:, None] - phi[near] + same
        lagrange = np.where(same, 1.0, (angle - phi[near]) / apart).prod(axis=1)
        found[:, k] = values[:, near] @ lagrange
    return found
