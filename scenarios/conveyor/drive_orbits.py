"""Steady orbits of the coupled drive: machines at mean speeds, run until their motion repeats.

At a speed nu the motor's line is set for the mean speed nu, motor and conveyor are coupled until their
orbit is steady, and the ripple of order 2 is read off the last revolution. Arrays have the step size as their
first axis: row 0 is that of the communication step h, rows 1 and 2 those of 2 h and 4 h, which give the errors.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import CONVERGENCE_ORDERS, SetupError
from workbench import Context
from workbench.orbits import STEP_MULTIPLES, Orbit, SteadyMotion
from workbench.steady import TURN, LastTwoTurns

from .first_order import Machine, longest_step
from .machine import conveyor_drive, start_values

Array = NDArray[np.float64]
ORBIT_ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
STATES, FORCE = ("conveyor.w", "motor.tau"), "conveyor.f_rod"
CRANK_TURN = Orbit("conveyor.phi", rate="conveyor.w", states=STATES, worst="tau2")
#: Fewest steps per revolution: rows for orders up to 6, so that order 2 is not aliased by the next ones.
FEWEST_STEPS = 18


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

    @classmethod
    def of_motions(cls, motions: Sequence[SteadyMotion]) -> Orbits:
        """Return what motions say of ripple and rod force; the rest is not known."""
        torque, speed = (
            2j / x.shape[-1] * (x @ np.exp(-4j * math.pi / x.shape[-1] * np.arange(x.shape[-1])))
            for x in (
                np.array([m.turn[name] for m in motions]) for name in ("motor.tau", "conveyor.w")
            )
        )
        unknown, contraction = (
            np.full(len(motions), np.nan),
            np.array([m.multiplier for m in motions]),
        )
        force, states = (np.array([*x]) for x in zip(*((m.turn[FORCE], m.states) for m in motions)))
        problem = np.array(["" if np.isfinite(x) else "?" for x in speed.real], object)
        return cls(torque, speed, unknown, unknown, unknown, force, contraction, states, problem)

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
        steps = self.steps_per_rev if steps_per_rev is None else steps_per_rev
        cases = {name: np.broadcast_to(starts[name], n) for name in (*STATES, *arrays)}
        shared = {name: x for name, x in starts.items() if name not in cases}
        return CRANK_TURN.turns(
            self.context, conveyor_drive(self.context.fmus, shared), cases,
            np.broadcast_to(np.asarray(nu, float), n), steps_per_rev=np.broadcast_to(steps, n), record=record,
            algorithm=self.algorithm,
        )  # fmt: skip

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
