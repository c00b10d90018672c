"""Steady orbits of the coupled drive: machines at mean speeds, run until their motion repeats.

At a speed nu the motor's line is set for the mean speed nu, motor and conveyor are coupled until their
orbit is steady, and the ripple of order 2 is read off the last revolution. Arrays have the step size as their
first axis: row 0 is that of the communication step h, rows 1 and 2 those of 2 h and 4 h, which give the errors.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import CONVERGENCE_ORDERS, SetupError
from cosim.accuracy.limit import Limit, Reason, limit
from workbench import Context, Figure
from workbench.steady import ORBIT_ANGLES, TURN, LastTwoTurns, steady_turns

from .first_order import Machine, longest_step
from .machine import conveyor_drive, start_values

Array = NDArray[np.float64]
ORBIT_ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
STATES, FORCE = ("conveyor.w", "motor.tau"), "conveyor.f_rod"
#: Communication steps of a run over the shortest one. Three runs give value, error and observed order.
STEP_MULTIPLES = (1, 2, 4)
#: Fewest steps per revolution: rows for orders up to 6, so that order 2 is not aliased by the next ones.
FEWEST_STEPS = 18
#: Sectors of a revolution, of each of which the largest rod forces are kept; a convention, finer than the peaks
#: of the orders 1 to 7 are apart.
SECTORS = 16
#: Even angles between which the largest force of a sector is interpolated by a parabola; sixteen for each of ORBIT_ANGLES.
FINE_ANGLES = 16 * ORBIT_ANGLES
#: Orbits that are run side by side before they are kept. Chosen: half a second of work.
AT_ONCE = 256
#: Convergence order of the rod force, which follows the torque of half a step before at once.
FORCE_ORDER = 1.0
UNSTABLE = "the run with four times the step is unstable, so that no error can be estimated"
NO_COUPLING_ERROR = "the coupling error is not known; take more steps per revolution"


@dataclass(frozen=True)
class Orbits:
    """Steady orbits, in arrays of one shape; nan where there is none.

    Attributes
    ----------
    torque, speed
        Complex amplitudes of order 2 over the crank angle of motor torque [N.m] and crank speed [rad/s].
    mean
        Mean speed over time [rad/s].
    torque_error, speed_error
        Settling errors of the amplitudes.
    waveform
        Rod force at ORBIT_ANGLES even crank angles, a last axis more [N].
    contraction
        Share of a deviation from the orbit that a revolution leaves.
    states
        Those at the crank angle 0, in the order of STATES, a last axis more.
    problem
        Why there is no orbit, "" where there is one.
    """

    torque: NDArray[np.complex128]
    speed: NDArray[np.complex128]
    mean: Array
    torque_error: Array
    speed_error: Array
    waveform: Array
    contraction: Array
    states: Array
    problem: NDArray[np.object_]

    @classmethod
    def of(cls, turns: LastTwoTurns) -> Orbits:
        """Return what the last revolutions say."""
        torque, speed = (turns.sine_amplitudes(name, 2) for name in ("motor.tau", "conveyor.w"))
        return cls(
            torque[:, 1],
            speed[:, 1],
            TURN / turns.periods[:, 1],
            turns.settling_error(torque),
            turns.settling_error(speed),
            turns.of(FORCE)[:, 1],
            turns.contraction,
            turns.states,
            np.array(turns.problems, object),
        )

    def __getitem__(self, index: Any) -> Orbits:
        return Orbits(*(getattr(self, x.name)[index] for x in fields(self)))

    def beside(self, other: Orbits) -> Orbits:
        """Return these orbits and others, along their second axis."""
        pairs = ((getattr(self, x.name), getattr(other, x.name)) for x in fields(self))
        return Orbits(*(np.concatenate(pair, axis=1) for pair in pairs))

    def spread(self, run: NDArray[np.bool_]) -> Orbits:
        """Return these orbits, shape (n,), where n elements of `run` are true, and nothing elsewhere."""
        arrays = []
        for x in fields(self):
            part = getattr(self, x.name)
            blank = "" if x.name == "problem" else np.nan
            arrays.append(np.full(run.shape + part.shape[1:], blank, part.dtype))
            arrays[-1][run] = part
        return Orbits(*arrays)


@dataclass(frozen=True)
class Drive:
    """How machines are run: on what, with which algorithm and steps, with how many of STEP_MULTIPLES; and the
    number of orbits by what they were run for.
    """

    context: Context
    algorithm: str
    steps_per_rev: int
    multiples: int = len(STEP_MULTIPLES)
    counts: Counter[str] = field(default_factory=Counter)

    @property
    def convergence_order(self) -> float:
        """The order with which errors fall."""
        return CONVERGENCE_ORDERS[self.algorithm]

    def near(self, machine: Machine, nu: Any) -> dict[str, Any]:
        """Return start values of machines, by first-order theory on their orbits of mean speeds [rad/s]."""
        states = zip(STATES, np.moveaxis(near(machine, nu), -1, 0))
        return start_values(machine, nu) | {"conveyor.phi": 0.0} | dict(states)

    def turns(
        self,
        machine: Machine,
        nu: Any,
        record: Sequence[str] = (FORCE,),
        *,
        steps_per_rev: Any = None,
        states: Array | None = None,
    ) -> LastTwoTurns:
        """Return the last revolutions of machines at mean speeds [rad/s], arrays of shape (n,), or one of both.

        The search begins at states of shape (n, 2), by default those of first-order theory.
        """
        starts = self.near(machine, np.asarray(nu, float))
        if states is not None:
            starts |= zip(STATES, states.T)
        arrays = {name: x for name, x in starts.items() if np.ndim(x)}
        n = max((len(x) for x in arrays.values()), default=1)
        speed = np.broadcast_to(np.asarray(nu, float), n)
        steps = self.steps_per_rev if steps_per_rev is None else steps_per_rev
        steps = np.broadcast_to(steps, n)
        cases = {name: np.broadcast_to(starts[name], n) for name in (*STATES, *arrays)}
        shared = {name: x for name, x in starts.items() if name not in cases}
        system, threads = conveyor_drive(self.context.fmus, shared), self.context.jobs

        def block(some: NDArray[Any]) -> tuple[Any, ...]:
            turns = steady_turns(
                system, {name: x[some] for name, x in cases.items()}, STATES, "conveyor.phi", speed[some],
                steps_per_rev=steps[some], record=record, algorithm=self.algorithm, jobs=threads,
            )  # fmt: skip
            return tuple(vars(turns).values())

        blocks = np.array_split(np.arange(n), max(1, math.ceil(n / AT_ONCE)))
        done = list(self.context.each(block, blocks, "orbits", here=True))
        columns, *of_blocks, problems = zip(*done)
        values, periods, left, ends = map(np.concatenate, of_blocks)
        return LastTwoTurns(columns[0], values, periods, left, ends, [*chain(*problems)])

    def steps(self, shape: tuple[int, ...], multiple: Any = None) -> NDArray[np.int64]:
        """Return the steps per revolution with STEP_MULTIPLES of these numbers, by default the j-th in row j."""
        if multiple is None:
            multiple = np.arange(shape[0]).reshape(-1, *(1,) * (len(shape) - 1))
        multiples = np.array(STEP_MULTIPLES)[np.broadcast_to(multiple, shape)]
        return np.asarray(self.steps_per_rev // multiples)

    def orbits(
        self,
        machine: Machine,
        nu: Array,
        title: str,
        multiple: Any = None,
        states: Array | None = None,
    ) -> Orbits:
        """Return the steady orbits of machines, whose fields are arrays or not, at mean speeds [rad/s].

        Parameters
        ----------
        machine : Machine
            Its fields are numbers, or arrays that go with `nu`.
        nu : ndarray
            What is nan is not run, nor a motor that the load pulls out.
        title : str
            What they are counted as.
        multiple : ndarray of int, optional
            Which of STEP_MULTIPLES each is run with, by default the j-th for the rows j of `nu`.
        states : ndarray, optional
            Where the searches begin, a last axis more, by default on the orbits of first-order theory.
        """
        run = np.isfinite(nu + 0.0 * machine.B)
        self.counts[title] += int(run.sum())
        steps = self.steps(nu.shape, multiple)
        turns = self.turns(
            picked(machine, nu.shape, run),
            nu[run],
            steps_per_rev=steps[run],
            states=None if states is None else states[run],
        )
        return Orbits.of(turns).spread(run)

    def require_enough_steps_per_rev(
        self, machine: Machine, mean_speed: float, coarsening: int = 1
    ) -> None:
        """Raise SetupError for too few steps per revolution to fit orders or to stay stable at a mean speed [rad/s].

        The longest steps are `coarsening` times as long as those of the drive.
        """
        setting, most = f"{self.steps_per_rev} steps per revolution", STEP_MULTIPLES[-1]
        longest = longest_step(machine, self.algorithm)
        fewest = coarsening * TURN / (mean_speed * longest)
        why = (
            f", because runs with {coarsening} times fewer give the errors"
            if coarsening > 1
            else ""
        )
        if self.steps_per_rev // coarsening < FEWEST_STEPS:
            raise SetupError(f"{setting} must be at least {coarsening * FEWEST_STEPS}{why}")
        if self.steps_per_rev <= fewest:
            slowest = mean_speed * fewest / self.steps_per_rev
            raise SetupError(
                f"{setting} are unstable with {self.algorithm} at {mean_speed:g} rad/s: the step must stay below "
                f"{longest / coarsening:.3g} s, and a revolution takes {TURN / mean_speed:.4g} s{why}. Take "
                f"{most * math.ceil((math.floor(fewest) + 1) / most)} or more steps per revolution, or a speed above "
                f"{slowest:.3g} rad/s"
            )
        if self.steps_per_rev % most:
            raise SetupError(
                f"{setting} must be a multiple of {most}: steps that are exactly 2 and {most} times longer give the "
                f"errors. Take {most * math.ceil(self.steps_per_rev / most)}"
            )

    def with_stable_multiples(self, machine: Machine, nu: float) -> Drive:
        """Return how to run with 1, 2 and 4 times the step; with 1 alone where 4 times is not stable at nu."""
        try:
            self.require_enough_steps_per_rev(machine, nu, STEP_MULTIPLES[-1])
        except SetupError:
            return replace(self, multiples=1)
        return self

    def for_each_step(self, x: Any) -> Array:
        """Return x once for each step multiple, shape (multiples, ...)."""
        return np.repeat(np.asarray(x, float)[None], self.multiples, axis=0)


def near(machine: Machine, nu: Any) -> Array:
    """Return the states at the crank angle 0 of the orbits of first-order theory, shape (..., 2)."""
    speed = nu + machine.speed_ripple(nu).imag
    torque = machine.load_slope * nu + machine.torque_ripple(nu).imag
    return np.stack(np.broadcast_arrays(speed, torque), axis=-1)


def picked(machine: Machine, shape: tuple[int, ...], index: Any) -> Machine:
    """Return some of machines whose fields are numbers, or arrays that broadcast to a shape."""
    return machine.changed(lambda x: np.broadcast_to(x, shape)[index] if np.ndim(x) else x)


def at_zero_step(values: Array, order: float, noise: Array | float = 0.0) -> Limit:
    """Return where values of shape (k, ...) go, whose rows are those of the first k of STEP_MULTIPLES."""
    missing = ((0, len(STEP_MULTIPLES) - len(values)), *((0, 0),) * (values.ndim - 1))
    runs = np.pad(values, missing, constant_values=np.nan)
    noises = np.pad(np.broadcast_to(noise, values.shape), missing, constant_values=np.nan)
    return limit(runs, order, noise=noises)


def extrapolated(values: Any, order: float, noise: Array | float = 0.0) -> tuple[Any, Array]:
    """Return where values go, real or complex, and the errors of that, nan where they are not known."""
    found = at_zero_step(values, order, noise)
    return found.extrapolated, np.where(found.is_stated, found.extrapolated_error, np.nan)


def sector_peaks(waveform: Array) -> Array:
    """Return the largest value of every sector of a turn, then the largest of the other sense.

    Which of two nearly equal peaks is the larger may change with the step; each by itself converges. Between FINE_ANGLES
    points of the Fourier series a parabola is laid; its error is that of the fourth derivative, over FINE_ANGLES^4.

    Parameters
    ----------
    waveform : ndarray, shape (..., angles)
        Values at even angles.

    Returns
    -------
    ndarray, shape (..., 2 * SECTORS)
    """
    fine = np.fft.irfft(np.fft.rfft(waveform), FINE_ANGLES) * (FINE_ANGLES / waveform.shape[-1])
    before, after = np.roll(fine, 1, -1), np.roll(fine, -1, -1)
    bend, rise = before - 2.0 * fine + after, after - before
    is_turn = np.abs(rise) < np.abs(2.0 * bend)
    lift = np.where(is_turn, -(rise**2) / (8.0 * np.where(is_turn, bend, 1.0)), 0.0)
    both = []
    for sense in (1.0, -1.0):
        top = np.where(sense * bend < 0.0, sense * (fine + lift), sense * fine)
        sectors = top.reshape(*waveform.shape[:-1], SECTORS, -1)
        both.append(np.maximum(sectors.max(-1), np.roll(sectors[..., 0], -1, -1)))
    return np.concatenate(both, -1)


@dataclass(frozen=True)
class Peaks:
    """Rod forces of all sectors at a step of zero, up to where each may reach [N], and whether that is known."""

    value: Array
    reach: Array
    is_known: NDArray[np.bool_]

    def each(self, function: Callable[[Any], Any]) -> Peaks:
        """Return a function of each array."""
        return Peaks(*map(function, vars(self).values()))

    def largest(self) -> tuple[Array, Array]:
        """Return the largest force, over the last axis, and its error.

        The error reaches as far as that of any other peak does; it is nan where one is not known that may
        be the largest.
        """
        best = self.value.max(-1)
        error = self.reach.max(-1) - best
        doubtful = (~self.is_known & ~(self.reach < best[..., None])).any(-1)
        return best, np.where(doubtful, np.nan, error)


def force_peaks(waveform: Array) -> Peaks:
    """Return the peaks of waveforms, shape (k, ..., ORBIT_ANGLES), of the first k of STEP_MULTIPLES."""
    peaks = sector_peaks(waveform)
    rows = np.abs(sector_peaks(waveform[..., ::2]) - peaks) / 4.0
    of_all = at_zero_step(peaks, FORCE_ORDER)
    reach = of_all.extrapolated + of_all.extrapolated_error + 2.0 * rows[0]
    reach = np.where(np.isfinite(reach), reach, np.inf)
    return Peaks(of_all.extrapolated, reach, of_all.is_stated)


def figure_of(found: Limit, k: Any, unit: str, meaning: str, why: str = "") -> Figure:
    """Return the limit of element k as a figure; `why` says why there is no value."""
    one = Limit(*(np.asarray(x)[k] for x in vars(found).values()))
    if why or not one.is_stated:
        lost = UNSTABLE if one.reason == Reason.MISSING else one.sentence()
        return Figure.undetermined(unit, why or lost, meaning)
    return Figure(float(one.extrapolated), unit, float(one.extrapolated_error), meaning)


def orbit_figure(value: float, error: float, unit: str, meaning: str, why: str) -> Figure:
    """Return a figure of an orbit, refused where the error is not known; `why` says why there is no orbit."""
    if math.isnan(error):
        reason = why if math.isnan(value) else NO_COUPLING_ERROR
        return Figure.undetermined(unit, reason, meaning)
    return Figure(float(value), unit, float(error), meaning)
