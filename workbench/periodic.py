"""Periodic orbits of a coupled machine that turns: located by Newton's method, checked, or refused.

A revolution maps the states at one crank angle to the states a revolution later. The fixed point of this
return map P is the orbit. The few revolutions of one run give the Jacobian J of P on the deviations that
they have: each difference of two sections is J times the one before. With it, Newton's method for
P(s) - s = 0 steps from the last section by (I - J)^-1 (P(s) - s); for as many differences as states this
is minimal polynomial extrapolation (Cabay and Jackson, SIAM J. Numer. Anal. 13, 1976). What the last
revolution still changes, divided by what a revolution leaves of it, is the settling error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim import Result, SimulationError, System

Array = NDArray[np.floating[Any]]
TURN = 2.0 * math.pi
#: Rows of the polynomial through which values are read between rows. Amid 2 n even rows, 2 pi / N apart, the
#: share of the order k that it misses is ((2 n)! / (4^n n!))^2 / (2 n)! (2 pi k / N)^(2 n) at most: with 16 rows and
#: N = 32 it is 1e-12 of the order 2 that rocks a drive, with 8 rows 6e-7, at which the search for an orbit stalls.
STENCIL = 16
#: Relative settling error of an orbit that is accepted at once. It is a convention, a thousandth of the
#: smallest coupling errors that the questions state.
SETTLED = 3e-9
#: Relative settling error that is accepted where rounding and the FMUs' own solvers let it fall no further.
NOISE_FLOOR = 1e-6
#: Ratio of two changes in sequence above which the orbit has stopped approaching; a Newton step that still
#: works lowers the change by far more.
STALLED_RATIO = 0.3
#: Relative change per revolution above which the Jacobian is taken anew; below it, rounding would tell it.
JACOBIAN_UPDATE = 1e-6
#: Singular values, over the largest, below which the Jacobian along a direction is not known. It is a
#: convention: differences that are 200 times smaller than the others show the curvature of P, not its slope.
RANK_TOLERANCE = 5e-3
#: Runs before an orbit is given up. Newton's method takes three or four of them.
MAX_RUNS = 16
#: Steps of a run over those of its revolutions at the expected speed, since a ripple makes them longer.
RUN_MARGIN = 1.02
#: Mean speed over the expected one below which the crank counts as stalled.
SLOWEST_PACE = 0.05
#: Smallest share of the last change that is stated as settling error; a contraction that seems to be
#: faster is not known to be so.
MIN_SETTLING_SHARE = 0.1
#: Deviations over the mean speed that give a state its scale where its own value is close to zero.
MIN_STATE_SCALE = 1e-3
#: Why there is no orbit of a crank that turns back before its first revolutions are complete.
STALLED = "the crank does not complete a turn"


class NoOrbitError(Exception):
    """There is no steady orbit from which to take a figure; says why in a sentence."""


@dataclass(frozen=True)
class Revolutions:
    """Whole revolutions of a run on a periodic orbit.

    Attributes
    ----------
    result : Result
        The run, with its columns by name.
    angle : str
        Column of the crank angle [rad].
    ends : ndarray, shape (revolutions + 1,)
        Crank angles at which revolutions begin and end [rad].
    times : ndarray, shape (revolutions + 1,)
        Times of these [s].
    contraction : float
        Share of a deviation from the orbit that a revolution leaves: the largest size of the return map's
        eigenvalues (Floquet multipliers) that the run shows.
    states : mapping
        The states at the end, by name.
    """

    result: Result
    angle: str
    ends: Array
    times: Array
    contraction: float
    states: Mapping[str, float]

    def window(self, back: int = 0) -> slice:
        """Return the rows of the last revolution, or of the one so many before it."""
        phi = self.result[self.angle]
        first, last = self.ends[-2 - back], self.ends[-1 - back]
        return slice(int(np.searchsorted(phi, first)), int(np.searchsorted(phi, last)) + 1)

    def period(self, back: int = 0) -> float:
        """Return how long that revolution takes [s]."""
        return float(self.times[-1 - back] - self.times[-2 - back])

    def settling_error(self, change: float) -> float:
        """Return what settling leaves open of a value that changed so much over the last revolution.

        The changes of the revolutions to come are a geometric series with the contraction as its ratio.
        """
        return change * max(self.contraction / (1.0 - self.contraction), MIN_SETTLING_SHARE)


@dataclass(frozen=True)
class ReturnMap:
    """The linear part of a return map between scaled states.

    Attributes
    ----------
    jacobian : ndarray, shape (states, states)
        Takes a deviation to that a revolution later; 0 along directions in which it is not known.
    contraction : float
        The largest size of its eigenvalues.
    """

    jacobian: Array
    contraction: float

    def newton_step(self, change: Array) -> Array:
        """Return (I - J)^-1 times the last change P(s) - s, which leads from s to the fixed point."""
        matrix = np.eye(len(change)) - self.jacobian
        return np.asarray(np.linalg.lstsq(matrix, change, rcond=1e-12)[0])


@dataclass(frozen=True)
class _Shooting:
    """What every run of a search for an orbit shares; arguments as of `periodic_orbit`."""

    system: Callable[[Mapping[str, float]], System]
    names: Sequence[str]
    angle: str
    speed: float
    steps_per_rev: int
    columns: Sequence[str]
    algorithm: str

    @property
    def revolutions(self) -> int:
        """As many as give a square Jacobian, and one more."""
        return len(self.names) + 1

    @property
    def step(self) -> float:
        """The communication step [s]."""
        return TURN / (self.speed * self.steps_per_rev)

    def run(self, states: Array, pace: float) -> Result:
        """Run from states, for the revolutions if the crank turns at `pace` times its expected speed."""
        steps = math.ceil(self.revolutions * self.steps_per_rev * RUN_MARGIN / pace) + STENCIL
        start = dict(zip(self.names, states.tolist()))
        try:
            return cosim.run(
                self.system(start), stop=steps * self.step, step=self.step, algorithm=self.algorithm,
                record=self.columns,
            )  # fmt: skip
        except SimulationError as error:
            raise NoOrbitError(str(error)) from error

    def sections(self, result: Result) -> tuple[Array, Array, Array]:
        """Return the angles between revolutions, the times there, and the states, a row each."""
        ends = TURN * np.arange(self.revolutions + 1)
        values = np.stack([result["time"], *(result[name] for name in self.names)])
        times, *states = at_angles(result[self.angle], values, ends)
        return ends, times, np.array(states).T


def periodic_orbit(
    system: Callable[[Mapping[str, float]], System],
    states: Mapping[str, float],
    angle: str,
    speed: float,
    steps_per_rev: int,
    *,
    record: Sequence[str],
    algorithm: str = "strang",
) -> Revolutions:
    """Return whole revolutions on the steady orbit near start values.

    A start from which the crank stalls is taken back halfway to where it turned.

    Parameters
    ----------
    system : callable
        Makes the system of start values.
    states : mapping
        Start values of the states, near the orbit.
    angle : str
        Output that grows by 2 pi in a revolution, from 0 at the start.
    speed : float
        About its mean rate [rad/s]; with `steps_per_rev` it gives the communication step.
    steps_per_rev : int
        Communication steps per revolution.
    record : sequence of str
        Further columns of the result.
    algorithm : str
        Coupling algorithm.

    Raises
    ------
    NoOrbitError
        If there is no such orbit, or none that the machine stays on.
    """
    columns = list(dict.fromkeys([angle, *states, *record]))
    shooting = _Shooting(system, list(states), angle, speed, steps_per_rev, columns, algorithm)
    scale = np.array([max(abs(x), MIN_STATE_SCALE * speed) for x in states.values()])
    at, turned_from = np.array(list(states.values())), None
    pace, change, map_ = 1.0, math.inf, None
    for _ in range(MAX_RUNS):
        result = shooting.run(at, pace)
        phi = result[angle]
        if not (np.diff(phi) > 0.0).all():
            if turned_from is None:
                raise NoOrbitError(STALLED)
            at = (at + turned_from) / 2.0
            continue
        if phi[-1 - STENCIL // 2] < TURN * shooting.revolutions:
            pace *= phi[-1] / (TURN * shooting.revolutions) / RUN_MARGIN
            if pace < SLOWEST_PACE:
                rate = phi[-1] / result["time"][-1]
                raise NoOrbitError(
                    f"the crank turns at {rate:.3g} rad/s instead of {speed:g} rad/s"
                )
            continue
        ends, times, sections = shooting.sections(result)
        sections = sections / scale
        sections[0] = at / scale
        differences = np.diff(sections, axis=0)
        previous, change = change, float(np.abs(differences[-1]).max())
        if map_ is None or np.abs(differences).max() > JACOBIAN_UPDATE:
            map_ = return_map(sections)
        if _is_settled(map_.contraction, change, previous):
            if map_.contraction >= 1.0:
                raise NoOrbitError("the orbit is not stable: deviations from it grow")
            final = dict(zip(states, (sections[-1] * scale).tolist()))
            return Revolutions(result, angle, ends, times, map_.contraction, final)
        turned_from = sections[-1] * scale
        at = turned_from + map_.jacobian @ map_.newton_step(differences[-1]) * scale
    raise NoOrbitError(
        f"no steady state after {MAX_RUNS * shooting.revolutions} revolutions of {steps_per_rev} steps "
        f"(relative change {change:.1g} per revolution); more steps per revolution may settle it"
    )


def _is_settled(contraction: float, change: float, previous: float) -> bool:
    """Whether a relative change over the last revolution leaves no more than the accepted error."""
    error = change * max(contraction / max(1.0 - contraction, 1e-12), 1.0)
    return error < SETTLED or (error < NOISE_FLOOR and change > STALLED_RATIO * previous)


def return_map(sections: Array) -> ReturnMap:
    """Return the linear map that takes each difference between sections to the next.

    Parameters
    ----------
    sections : ndarray, shape (revolutions + 1, states)
        States at one crank angle of revolutions in sequence.
    """
    differences = np.diff(sections, axis=0)
    size = np.maximum(np.abs(differences).max(axis=0), 1e-300)
    fit = np.linalg.lstsq(differences[:-1] / size, differences[1:] / size, rcond=RANK_TOLERANCE)
    scaled = fit[0].T
    contraction = float(np.abs(np.linalg.eigvals(scaled)).max())
    return ReturnMap(scaled * size[:, None] / size, contraction)


def at_angles(phi: Array, values: Array, wanted: Array) -> Array:
    """Return values at wanted angles, on the polynomials through the STENCIL rows around each.

    They meet smooth rows best in their middle, where no oscillation at the ends (Runge's) reaches; Berrut and
    Trefethen, SIAM Review 46 (2004), section 5.

    Parameters
    ----------
    phi : ndarray, shape (rows,)
        Angles of the rows, rising [rad].
    values : ndarray, shape (columns, rows)
        Values of the rows.
    wanted : ndarray, shape (angles,)
        Angles [rad].

    Returns
    -------
    ndarray, shape (columns, angles)
    """
    result = np.empty((len(values), len(wanted)))
    same = np.eye(STENCIL)
    for k, angle in enumerate(wanted):
        i = int(np.clip(np.searchsorted(phi, angle) - STENCIL // 2, 0, len(phi) - STENCIL))
        rows = slice(i, i + STENCIL)
        spacing = phi[rows][:, None] - phi[rows] + same
        lagrange = np.where(same, 1.0, (angle - phi[rows]) / spacing).prod(axis=1)
        result[:, k] = values[:, rows] @ lagrange
    return result
