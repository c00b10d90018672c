"""Steady motions of machines that turn: Newton's method on the return maps of many of them at once, or a refusal.

A revolution maps the states at one crank angle to the states a revolution later. The fixed point of this
return map P is the orbit. The few revolutions of one run give the Jacobian J of P on the deviations that
they have: each difference of two sections is J times the one before. With it, Newton's method for
P(s) - s = 0 steps from the last section by (I - J)^-1 (P(s) - s); for as many differences as states this
is minimal polynomial extrapolation (Cabay and Jackson, SIAM J. Numer. Anal. 13, 1976). What the last
revolution still changes, divided by what a revolution leaves of it, is the settling error. The first axis of every
array is that of the members, each of which has its own machine, speed, step and pace.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import System
from cosim.engine.settings import RunSettings
from cosim.ensemble import Ensemble
from cosim.prepared import How, Prepared

Array = NDArray[np.float64]
TURN = 2.0 * math.pi
#: Rows of the polynomial through which values are read between rows. Amid 2 n even rows, 2 pi / N apart, the
#: share of the order k that it misses is ((2 n)! / (4^n n!))^2 / (2 n)! (2 pi k / N)^(2 n) at most: with 16 rows and
#: N = 32 it is 1e-12 of the order 2 that rocks a drive, with 8 rows 6e-7, at which the search for an orbit stalls.
STENCIL = 16
#: Weights of even rows in the barycentric formula.
_BARYCENTRIC = np.array([(-1.0) ** k * math.comb(STENCIL - 1, k) for k in range(STENCIL)])
#: Distance from a row that stands for none: its weight is then all there is, to the last bit.
NEXT_TO_A_ROW = 1e-100
#: Secants by which the time of an angle is found between two rows, and their change, in steps, at which it is known.
#: Derived: within a step of an 18th of a turn a speed ripple of a tenth changes the speed by 7 %, so that the errors fall
#: as 1e-2, 3e-4, 2e-7, 5e-12 of a step; that after a change of 1e-7 is below 1e-15.
ANGLE_ROUNDS, MOST_CHANGE = 5, 1e-7
#: Even angles of a revolution at which values are kept; as many as the orders up to 31 need.
ORBIT_ANGLES = 64
#: Relative settling error of an orbit that is accepted at once. It is a convention, a thousandth of the
#: smallest coupling errors that the questions state.
SETTLED = 3e-9
#: Relative settling error that is accepted where rounding and the FMUs' own solvers let it fall no further.
NOISE_FLOOR = 1e-6
#: Ratio of two changes in sequence above which the orbit has stopped approaching; a Newton step that still
#: works lowers the change by far more.
STALLED_RATIO = 0.3
#: Relative change per revolution above which the Jacobian is taken anew; below it, rounding and the noise of rows would
#: tell it.
JACOBIAN_UPDATE = 1e-5
#: Share of its scale by which each state is displaced first, so that the changes of one that begins on its orbit tell a
#: Jacobian, too: ten times JACOBIAN_UPDATE.
DISPLACEMENT = 1e-4
#: Changes that rounding makes, which interpolation between rows multiplies by its weights: they tell no Jacobian.
CHANGE_BY_ROUNDING = 1e-11
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
GROWS = ": deviations from it grow"
UNSTABLE = f"the orbit is not stable{GROWS}"


@dataclass(frozen=True)
class LastTwoTurns:
    """The last two revolutions of n members on their orbits; nan where there is none.

    Attributes
    ----------
    columns
        The names of what is kept.
    values
        These at even crank angles of the revolution before the last and of the last, shape
        (n, 2, angles, columns).
    periods
        How long these two take, shape (n, 2) [s].
    contraction
        Share of a deviation from the orbit that a revolution leaves: the largest size of the return map's
        eigenvalues (Floquet multipliers) that the runs show, shape (n,).
    states
        The states at the end of the last, in their order, shape (n, states).
    problems
        Why there is no orbit, "" where there is one.
    """

    columns: Sequence[str]
    values: Array
    periods: Array
    contraction: Array
    states: Array
    problems: list[str]

    def of(self, column: str) -> Array:
        """Return the values of a column, shape (n, 2, angles)."""
        return np.asarray(self.values[..., self.columns.index(column)])

    def settling_error(self, of_both: Any) -> Any:
        """Return what settling leaves open of quantities of both revolutions, shape (n, 2), a value of shape (n,).

        The changes of the revolutions to come are a geometric series with the contraction as its ratio.
        """
        share = np.maximum(self.contraction / (1.0 - self.contraction), MIN_SETTLING_SHARE)
        return np.abs(of_both[:, 1] - of_both[:, 0]) * share


class _NewtonState:
    """The state of Newton's method of every member; sections are over the scale of each state."""

    def __init__(
        self, begin: Array, speed: Array, step: Array, columns: Sequence[str], angles: int
    ) -> None:
        n, states = begin.shape
        self.step = step
        self.scale = np.maximum(np.abs(begin), MIN_STATE_SCALE * speed[:, None])
        self.at, self.turned = begin + DISPLACEMENT * self.scale, np.full_like(begin, np.nan)
        self.pace, self.change = np.ones(n), np.full(n, np.inf)
        self.jacobian = np.full((n, states, states), np.nan)
        self.is_open = np.ones(n, bool)
        self.turns = LastTwoTurns(
            columns,
            np.full((n, 2, angles, len(columns)), np.nan),
            np.full((n, 2), np.nan),
            np.full(n, np.nan),
            np.full_like(begin, np.nan),
            [""] * n,
        )

    def refuse(self, members: NDArray[Any], why: Sequence[str]) -> None:
        """Give members up."""
        self.is_open[members] = False
        for member, text in zip(members.tolist(), why):
            self.turns.problems[member] = text

    def take_runs(self, m: NDArray[Any], phi: Array, data: Array, states: int, turns: int) -> None:
        """Take runs of members m that turn on: angles (rows,), and states, columns (rows, k) of each."""
        ends = TURN * np.arange(turns + 1)
        rows, at_ends = at_angles(
            phi, data[..., :states], np.broadcast_to(ends, (len(m), turns + 1))
        )
        times, sections = rows * self.step[m, None], at_ends / self.scale[m][:, None]
        sections[:, 0] = self.at[m] / self.scale[m]
        differences = np.diff(sections, axis=1)
        previous, self.change[m] = self.change[m], np.abs(differences[:, -1]).max(-1)
        is_new = np.isnan(self.turns.contraction[m])
        is_new |= np.abs(differences).max((1, 2)) > JACOBIAN_UPDATE
        resolved = np.where(np.abs(differences) > CHANGE_BY_ROUNDING, differences, 0.0)
        jacobian, contraction = return_maps(resolved[is_new])
        self.jacobian[m[is_new]], self.turns.contraction[m[is_new]] = jacobian, contraction

        left, change = self.turns.contraction[m], self.change[m]
        grows = left >= 1.0  # Newton's method also finds orbits that deviations leave
        error = change * np.maximum(left / np.where(grows, np.inf, 1.0 - left), 1.0)
        settled = (error < SETTLED) | ((error < NOISE_FLOOR) & (change > STALLED_RATIO * previous))
        grows &= settled
        self.refuse(m[grows], [UNSTABLE] * len(m))
        done = np.flatnonzero(settled & ~grows)
        if len(done):
            number = self.turns.values.shape[2]
            angles = TURN / number * np.arange(2 * number) + TURN * (turns - 2)
            wanted = np.broadcast_to(angles, (len(done), 2 * number))
            _, values = at_angles(phi[done], data[done], wanted)
            found = self.turns
            found.values[m[done]] = values.reshape(len(done), 2, number, -1)
            found.periods[m[done]] = np.diff(times[done], axis=1)[:, -2:]
            found.states[m[done]] = sections[done, -1] * self.scale[m[done]]
            self.is_open[m[done]] = False
        matrix = np.eye(states) - self.jacobian[m]
        step = np.linalg.pinv(matrix, rcond=1e-12) @ differences[:, -1, :, None]
        self.turned[m] = sections[:, -1] * self.scale[m]
        self.at[m] = self.turned[m] + (self.jacobian[m] @ step)[..., 0] * self.scale[m]


def steady_turns(
    system: System,
    cases: Mapping[str, Array],
    states: Sequence[str],
    angle: str,
    speed: Array,
    *,
    steps_per_rev: Any,
    record: Sequence[str],
    algorithm: str = "strang",
    angles: int = ORBIT_ANGLES,
    jobs: int | None = 1,
) -> LastTwoTurns:
    """Return the last two of several revolutions on the steady orbits near start values.

    A start from which the crank stalls is taken back halfway to where it turned.

    Parameters
    ----------
    system : System
        The machine, with the start values that all members share.
    cases : mapping
        The start values in which they differ, shape (n,) each; among them the states, near the orbit.
    states : sequence of str
        The states of a return map.
    angle : str
        Output that grows by 2 pi in a revolution, from 0 at the start.
    speed : ndarray, shape (n,)
        About its mean rate [rad/s]; with `steps_per_rev` it gives the communication step.
    steps_per_rev : int or ndarray, shape (n,)
        Communication steps per revolution.
    record : sequence of str
        What is kept besides the states.
    algorithm : str
        Coupling algorithm.
    angles : int
        Even crank angles of a revolution at which values are kept.
    jobs : int, optional
        Threads or processes that do the runs; None: a thread for each core where FMUs may have threads.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C.
    """
    columns = list(dict.fromkeys([*states, *record]))
    speed, turns = np.asarray(speed, float), len(states) + 1
    begin = np.stack([np.asarray(cases[name], float) for name in states], axis=1)
    step = TURN / (speed * steps_per_rev)
    search = _NewtonState(begin, speed, step, columns, angles)
    if not len(speed):
        return search.turns
    log = logging.getLogger("cosim")
    common = {**system.start, **{name: np.asarray(x)[0].item() for name, x in cases.items()}}
    system = System(**{**vars(system), "start": common})
    settings = RunSettings(
        float(step[0]) * 2, float(step[0]), algorithm=algorithm, record=[angle, *columns]
    )
    with Prepared.open(system, settings) as prepared:
        for _ in range(MAX_RUNS):
            m = np.flatnonzero(search.is_open)
            if not len(m):
                break
            values = {name: np.asarray(x)[m] for name, x in cases.items()}
            values |= dict(zip(states, search.at[m].T))
            count = (
                np.ceil(
                    turns
                    * np.broadcast_to(steps_per_rev, speed.shape)[m]
                    * RUN_MARGIN
                    / search.pace[m]
                )
                + STENCIL
            )
            how = How(jobs, steps=step[m].tolist(), stops=(count * step[m]).tolist())
            returned = 0
            for block in prepared.blocks(values, how):
                returned += len(block)
                for text in block.warnings:
                    log.warning(text)
                _read(search, m[block.members], block, speed, turns)
            if returned < len(m):
                raise KeyboardInterrupt
    m = np.flatnonzero(search.is_open)
    steps = np.broadcast_to(steps_per_rev, speed.shape)
    search.refuse(
        m,
        [
            f"no steady state after {MAX_RUNS * turns} revolutions of {steps[k]} steps (relative change "
            f"{search.change[k]:.1g} per revolution{GROWS if search.turns.contraction[k] >= 1.0 else ''}); "
            "more steps per revolution may settle it"
            for k in m
        ],
    )
    search.turns.contraction[[bool(x) for x in search.turns.problems]] = np.nan
    return search.turns


def _read(search: _NewtonState, m: NDArray[Any], block: Ensemble, speed: Array, turns: int) -> None:
    """Take the runs of members m: those that fail, stall or are too slow one by one, the others together."""
    wanted = TURN * turns
    failed = np.array([bool(reason) for reason in block.reasons])
    search.refuse(m[failed], [reason for reason in block.reasons if reason])
    t, phi = block.rows[:, :, 0], block.rows[:, :, 1]
    end = np.maximum(block.counts - 1, 0)
    rises = ((np.diff(phi, axis=1) > 0.0) | (np.arange(phi.shape[1] - 1) >= end[:, None])).all(1)
    stalled = ~failed & ~rises
    is_first = np.isnan(search.turned[m, 0])
    search.refuse(m[stalled & is_first], [STALLED] * len(m))
    back = m[stalled & ~is_first]
    search.at[back] = (search.at[back] + search.turned[back]) / 2.0
    k = np.arange(len(m))
    short = ~failed & rises & (phi[k, np.maximum(end - STENCIL // 2, 0)] < wanted)
    search.pace[m[short]] *= np.minimum(phi[k, end][short] / wanted, 1.0) / RUN_MARGIN
    slow = short & (search.pace[m] < SLOWEST_PACE)
    search.refuse(
        m[slow],
        [
            f"the crank turns at {phi[j, end[j]] / t[j, end[j]]:.3g} rad/s instead of {speed[m[j]]:g} rad/s"
            for j in np.flatnonzero(slow)
        ],
    )
    good = ~failed & rises & ~short
    if good.any():
        data = block.rows[good][..., 2:]
        states = search.at.shape[1]
        search.take_runs(m[good], phi[good], data, states, turns)


class ReturnMaps(NamedTuple):
    """Linear maps, shape (n, states, states), and their contractions: the largest sizes of eigenvalues, shape (n,)."""

    jacobian: Array
    contraction: Array


def return_maps(differences: Array) -> ReturnMaps:
    """Return the linear maps that take each difference between sections to the next.

    A map is 0 along directions in which it is not known.

    Parameters
    ----------
    differences : ndarray, shape (n, revolutions, states)
        Differences of states at one crank angle of revolutions in sequence.
    """
    size = np.maximum(np.abs(differences).max(axis=1, keepdims=True), 1e-300)
    scaled = differences / size
    fit = np.linalg.pinv(scaled[:, :-1], rcond=RANK_TOLERANCE) @ scaled[:, 1:]
    fit = np.swapaxes(fit, 1, 2)
    contraction = np.abs(np.linalg.eigvals(fit)).max(axis=-1)
    return ReturnMaps(fit * np.swapaxes(size, 1, 2) / size, contraction)


class InterpolatedRows(NamedTuple):
    """Numbers of rows with a fraction, shape (n, angles), and the values there, shape (n, angles, columns)."""

    rows: Array
    values: Array


def at_angles(phi: Array, values: Array, wanted: NDArray[Any]) -> InterpolatedRows:
    """Return where rows at even times pass wanted angles, and values there, on the polynomials through STENCIL rows.

    They meet smooth rows best in their middle, where no oscillation at the ends (Runge's) reaches; Berrut and
    Trefethen, SIAM Review 46 (2004), section 5. Where the angle passes is found by secants.

    Parameters
    ----------
    phi : ndarray, shape (n, rows)
        Angles of the rows, rising [rad].
    values : ndarray, shape (n, rows, columns)
        Values of the rows.
    wanted : ndarray, shape (n, angles)
        Angles [rad].
    """
    n, rows = phi.shape
    after = np.array([np.searchsorted(x, y) for x, y in zip(phi, wanted)])
    first = np.clip(after - STENCIL // 2, 0, rows - STENCIL)
    around = first[..., None] + np.arange(STENCIL)
    member = np.arange(n)[:, None, None]
    p = phi[member, around] - wanted[..., None]
    at = np.clip(after - first, 1, STENCIL - 1)
    right, left = (np.take_along_axis(p, (at - k)[..., None], -1)[..., 0] for k in (0, 1))
    before, s, miss, slope = at - 1.0, at - right / (right - left), left, right - left
    is_open = np.ones(s.shape, bool)  # each ends by itself, so that no bit depends on the others
    for _ in range(ANGLE_ROUNDS):
        value, change = (_stencil_weights_at(s) * p).sum(-1), s - before
        is_apart = np.abs(change) > MOST_CHANGE
        slope = np.divide(value - miss, change, out=slope.copy(), where=is_apart)
        step = np.where(is_open, value / slope, 0.0)
        before, miss, s = s, value, s - step
        is_open &= np.abs(step) > MOST_CHANGE
        if not is_open.any():
            break
    there = _stencil_weights_at(s)[..., None, :] @ values[member, around]
    return InterpolatedRows(first + s, np.asarray(there[..., 0, :]))


def _stencil_weights_at(positions: Array) -> Array:
    """The weights of STENCIL rows in the value at positions counted in rows, by the barycentric formula; one may be a row itself."""
    distance = positions[..., None] - np.arange(STENCIL)
    weights = _BARYCENTRIC / np.where(distance == 0.0, NEXT_TO_A_ROW, distance)
    return np.asarray(weights / weights.sum(-1, keepdims=True))
