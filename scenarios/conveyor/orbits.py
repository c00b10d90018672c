"""Steady orbits of the coupled drive: a machine at a mean speed, run until its motion repeats.

At a speed nu the motor's line is set for the mean speed nu, motor and conveyor are coupled until their
orbit is steady, and the ripple of order 2 is read off the last revolution.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cosim import SetupError, System
from cosim.accuracy.extrapolation import extrapolate
from cosim.system import Value
from workbench import Context
from workbench.measure import harmonics
from workbench.periodic import TURN, NoOrbitError, Revolutions, periodic_orbit

from .drive_orbits import Drive
from .first_order import Machine, longest_step
from .machine import WIRES, start_values

Array = NDArray[np.float64]
ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
RECORD = ("motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod")
#: Communication steps of a run over the shortest one. Three runs give value, error and observed order.
STEP_MULTIPLES = (1, 2, 4)
#: Highest order fitted to a revolution, where it has rows for them; a convention.
HIGHEST_ORDER = 40
#: Rows per revolution and fitted order, more than the two that an order needs.
ROWS_PER_ORDER = 3
#: Fewest steps per revolution: rows for orders up to 6, so that order 2 is not aliased by the next ones.
FEWEST_STEPS = 18
#: Rows beyond each end of a revolution on which its splines stand, since a peak may lie at an end.
EDGE_ROWS = 8
#: Sectors of a revolution, of each of which the largest rod forces are kept; a convention, finer than the peaks
#: of the orders 1 to 7 are apart.
SECTORS = 16
#: Even crank angles at which an orbit keeps its rod force; as many as orders up to 31 need.
WAVEFORM_ANGLES = 64
NO_AMPLITUDE = complex(math.nan, math.nan)


class OperatingPoint(NamedTuple):
    """A machine at a nominal mean speed [rad/s], with steps that are so many times longer."""

    machine: Machine
    nu: float
    step_multiple: int = 1


class OrbitTask(NamedTuple):
    """One run: FMUs, start values near the orbit of the mean speed nu [rad/s], steps, algorithm."""

    fmus: Mapping[str, Path]
    start: Mapping[str, Value]
    nu: float
    steps_per_rev: int
    algorithm: str


class Orbit(NamedTuple):
    """One steady orbit.

    Attributes
    ----------
    nu : float
        Nominal mean speed [rad/s].
    torque, speed : complex
        Amplitudes of order 2 over the crank angle of motor torque [N.m] and crank speed [rad/s].
    mean : float
        Mean speed over time [rad/s].
    forces : sequence of float
        Largest rod forces of every sector of the crank angle, then those of the other sense [N].
    torque_error, speed_error : float
        Settling errors of the amplitudes.
    force_errors : sequence of float
        What the rows leave open of the forces [N].
    waveform : sequence of float
        Rod force at WAVEFORM_ANGLES even crank angles [N].
    contraction : float
        Share of a deviation from the orbit that a revolution leaves.
    problem : str
        Why there is no orbit; all else but `nu` is nan then.
    """

    nu: float
    torque: complex = NO_AMPLITUDE
    speed: complex = NO_AMPLITUDE
    mean: float = math.nan
    forces: Sequence[float] = (math.nan,)
    torque_error: float = math.nan
    speed_error: float = math.nan
    force_errors: Sequence[float] = (math.nan,)
    waveform: Sequence[float] = (math.nan,) * WAVEFORM_ANGLES
    contraction: float = math.nan
    problem: str = ""


@dataclass(frozen=True)
class OrbitRunner:
    """How machines are run: on what, with which further start values, algorithm and steps; and the
    orbits that were run, with their number by what they were run for.
    """

    context: Context
    start: Mapping[str, Value]
    algorithm: str
    steps_per_rev: int
    cache: dict[OperatingPoint, Orbit] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)

    @property
    def drive(self) -> Drive:
        """The same for orbits side by side."""
        return Drive(self.context, self.start, self.algorithm, self.steps_per_rev)

    def task(self, machine: Machine, nu: float, step_multiple: int = 1) -> OrbitTask:
        """Return the run of a machine at its nominal mean speed [rad/s], by first-order theory on its orbit."""
        states = {
            "conveyor.phi": 0.0,
            "conveyor.w": nu + machine.speed_ripple(nu).imag,
            "motor.tau": machine.load_slope * nu + machine.torque_ripple(nu).imag,
        }
        start = start_values(machine, self.start, nu) | states
        return OrbitTask(
            self.context.fmus, start, nu, self.steps_per_rev // step_multiple, self.algorithm
        )

    def each(self, points: Sequence[OperatingPoint], title: str) -> Iterator[Orbit]:
        """Yield the steady orbits of operating points, one by one in their order; none is run twice."""
        new = [point for point in dict.fromkeys(points) if point not in self.cache]
        self.counts[title] += len(new)
        runs = self.context.each(simulate, [self.task(*point) for point in new], title)
        for point in points:
            if point not in self.cache:
                self.cache[point] = next(runs)
            yield self.cache[point]
        next(runs, None)

    def orbits(self, points: Sequence[OperatingPoint], title: str) -> Iterator[Orbit]:
        """Return the same when all of them are run."""
        return iter(list(self.each(points, title)))

    def check(self, machine: Machine, nu: float, step_multiple: int = 1) -> None:
        """Raise SetupError for too few steps per revolution to fit orders or to stay stable at nu."""
        setting, most = f"{self.steps_per_rev} steps per revolution", STEP_MULTIPLES[-1]
        longest = longest_step(machine, self.algorithm)
        fewest = step_multiple * TURN / (nu * longest)
        why = ""
        if step_multiple > 1:
            why = f", because runs with {step_multiple} times fewer give the errors"
        if self.steps_per_rev // step_multiple < FEWEST_STEPS:
            raise SetupError(f"{setting} must be at least {step_multiple * FEWEST_STEPS}{why}")
        if self.steps_per_rev <= fewest:
            slowest = nu * fewest / self.steps_per_rev
            raise SetupError(
                f"{setting} are unstable with {self.algorithm} at {nu:g} rad/s: the step must stay below "
                f"{longest / step_multiple:.3g} s, and a revolution takes {TURN / nu:.4g} s{why}. Take "
                f"{most * math.ceil((math.floor(fewest) + 1) / most)} or more steps per revolution, or a speed above "
                f"{slowest:.3g} rad/s"
            )
        if self.steps_per_rev % most:
            raise SetupError(
                f"{setting} must be a multiple of {most}: steps that are exactly 2 and {most} times longer give the "
                f"errors. Take {most * math.ceil(self.steps_per_rev / most)}"
            )

    def step_multiples(self, machine: Machine, nu: float) -> Sequence[int]:
        """Return 1, 2 and 4 times the step; 1 alone where 4 times is not stable at the slowest speed."""
        try:
            self.check(machine, nu, STEP_MULTIPLES[-1])
        except SetupError:
            return STEP_MULTIPLES[:1]
        return STEP_MULTIPLES


def simulate(task: OrbitTask) -> Orbit:
    """Return the steady orbit of a task, or one whose problem says why there is none."""
    try:
        return read_orbit(run_to_orbit(task, RECORD), task.nu)
    except NoOrbitError as problem:
        return Orbit(task.nu, problem=str(problem))


def run_to_orbit(task: OrbitTask, record: Sequence[str]) -> Revolutions:
    """Return whole revolutions on the steady orbit; raises NoOrbitError."""

    def system(at: Mapping[str, float]) -> System:
        return System(task.fmus, WIRES, {**task.start, **at})

    states = {name: float(task.start[name]) for name in ("conveyor.w", "motor.tau")}
    return periodic_orbit(
        system,
        states,
        "conveyor.phi",
        task.nu,
        task.steps_per_rev,
        record=record,
        algorithm=task.algorithm,
    )


def read_orbit(turns: Revolutions, nu: float) -> Orbit:
    """Return the ripple of the last revolution, its settling error, and its rod forces."""
    now, before = (order_2(turns, back) for back in (0, 1))
    torque_error, speed_error = map(turns.settling_error, np.abs(now - before).tolist())
    window = turns.window()
    rows = slice(max(0, window.start - EDGE_ROWS), window.stop + EDGE_ROWS)
    phi, force = turns.result[turns.angle][rows], turns.result["conveyor.f_rod"][rows]
    edges = np.linspace(turns.ends[-2], turns.ends[-1], SECTORS + 1)
    peaks = sector_peaks(phi, force, edges)
    halves = [sector_peaks(phi[k::2], force[k::2], edges) for k in (0, 1)]
    angles = turns.ends[-2] + TURN / WAVEFORM_ANGLES * np.arange(WAVEFORM_ANGLES)
    torque, speed = now.tolist()
    return Orbit(
        nu,
        torque,
        speed,
        TURN / turns.period(),
        peaks.tolist(),
        torque_error,
        speed_error,
        (np.abs(np.array(halves) - peaks).max(axis=0) / 4).tolist(),
        CubicSpline(phi, force)(angles).tolist(),
        turns.contraction,
    )


def order_2(turns: Revolutions, back: int) -> NDArray[np.complex128]:
    """Return the amplitudes of order 2 of torque and speed in the last revolution or one before it."""
    rows = turns.window(back)
    phi = turns.result[turns.angle][rows]
    columns = [turns.result[name][rows] for name in ("motor.tau", "conveyor.w")]
    highest = min(HIGHEST_ORDER, len(phi) // ROWS_PER_ORDER)
    return np.asarray(harmonics(phi, np.stack(columns, axis=1), highest)[1])


def sector_peaks(phi: Array, x: Array, edges: Array) -> Array:
    """Return the largest x, then the largest -x, of every sector between edges, on the spline through rows.

    Which of two nearly equal peaks is the larger may change with the step; each by itself converges.
    """
    curve = CubicSpline(phi, x)
    at = np.concatenate([edges, curve.derivative().roots(extrapolate=False)])
    values = curve(at)
    sectors = [values[(at >= first) & (at <= last)] for first, last in pairwise(edges)]
    return np.array([(sense * sector).max() for sense in (1, -1) for sector in sectors])


def largest_force(orbits: Iterable[Sequence[Orbit]]) -> tuple[float, float]:
    """Return the largest rod force of orbits, each with all step multiples, and its error [N].

    The error reaches as far as that of any other peak does; it is nan where one is not known that may
    be the largest.
    """
    peaks = []
    for multiples in orbits:
        for values, row_error in zip(
            zip(*(orbit.forces for orbit in multiples)), multiples[0].force_errors
        ):
            peak = extrapolate(values, 1.0)
            error = peak.error
            reach = 2.0 * float(np.ptp(values)) if error is None else error + 2.0 * row_error
            peaks.append((peak.value, peak.value + reach, error is None))
    value, reach, unknown = np.array(peaks).T
    best = float(value.max())
    if math.isnan(best) or unknown[reach >= best].any():
        return best, math.nan
    return best, float(reach.max()) - best


def torque_amplitude(orbit: Orbit) -> float:
    """Return the torque ripple, order 2 [N.m]."""
    return abs(orbit.torque)
