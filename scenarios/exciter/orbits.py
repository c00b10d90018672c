"""Steady motions of the exciter's drive at an imposed mean speed, and the folds of their supply voltage.

A steady motion repeats after one revolution. At a mean speed nu its period is 2 pi / nu, and one
revolution is run with a voltage and with states at phi = 0 as unknowns, until the states return
and the angle has grown by 2 pi (shooting; Seydel, Practical Bifurcation and Stability Analysis,
section 7.3). Over the mean speed the voltage is single-valued, on unstable motions too. Where it has
an extremum, two steady motions meet and end: there the speed jumps when the voltage passes slowly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

import cosim
from cosim import SimulationError, System
from cosim.dense import Array as Samples
from workbench.answer import parameters

STATES = ("motor.i", "exciter.w", "exciter.x", "exciter.v")
PHI, SUPPLY = "exciter.phi", "motor.v"
TURN = 2 * math.pi
#: Communication steps of the three searches for a fold, over the finest.
STEP_MULTIPLES = (1, 2, 4)

#: Steps in a revolution at least; measured: the default folds then have a coupling error below 1e-5.
STEPS_PER_REV = 64
#: Scale of a current that vanishes [A]; a convention.
LEAST_CURRENT = 1e-2
#: Scale of an amplitude of the mount that vanishes [m]; a convention.
LEAST_AMPLITUDE = 1e-6
#: Scale of a voltage that vanishes [V]; a convention.
LEAST_SUPPLY = 1e-2
#: Relative perturbation for central differences; derived from the cube root of the machine precision.
PERTURBATION = 1e-5
#: Relative change of the unknowns at which Newton's method has converged; its next one is the square.
CONVERGED = 1e-8
#: Relative change of the unknowns at which Newton's method has left the initial guess; a convention.
DIVERGED = 3.0
#: Rounds after which Newton's method and the search for a voltage give up; they usually take three.
MAX_ROUNDS = 20
#: Relative error of a root that this accuracy leaves; derived from CONVERGED.
ROUNDING = 1e-8
#: First half width of the bracket of a fold, over the half width of the resonance; a convention.
BRACKET = 0.02
#: Number of times that the bracket is doubled, to 1.3 times that half width.
MAX_WIDENINGS = 7
#: Points of the averaged curve on either side of the resonance, at distances in geometric series.
AVERAGED_POINTS = 2001
#: Their least distance from the resonance, over its half width; a convention.
NEAREST = 1e-3
#: Lowest and highest speed of the averaged curve, over the resonance.
AVERAGED_RANGE = (0.02, 40.0)
#: Speeds at which the stability of a branch is examined, each half as far from the fold as the last.
PROBES = 6


class NoOrbitError(Exception):
    """There is no such steady motion; says why in a sentence."""


class Averaged(NamedTuple):
    """Averaged theory: the resonance of the mount and its half width [rad/s], speeds [rad/s] with the
    voltages [V] at which they are steady, and the folds as pairs of speed and voltage.
    """

    resonance: float
    width: float
    speeds: Samples
    supplies: Samples
    folds: Sequence[tuple[float, float]]


class Orbit(NamedTuple):
    """A steady motion: mean speed [rad/s], voltage [V], its slope over the speed [V.s/rad], the Floquet
    multipliers by their distance from 1.
    """

    speed: float
    supply: float
    slope: float
    multipliers: Sequence[complex]

    def growth(self, first: int = 0) -> float:
        """Return what a revolution leaves at most of a deviation; without its nearest to 1 at a fold."""
        return max(abs(x) for x in self.multipliers[first:])


class Jump(NamedTuple):
    """The voltage of a fold [V], the speeds before and after it [rad/s], or the reason why not."""

    supply: float
    before: float
    after: float
    reason: str = ""


class Search(NamedTuple):
    """The search for a fold: the system, its averaged theory, which of its folds, the number of
    communication steps per revolution, and whether it examines the stability along the branch.
    """

    system: System
    theory: Averaged
    which: int
    steps: int
    examines: bool


def constants(system: System) -> tuple[float, ...]:
    """R, k, d_r, U, M, c, d of the equations on the exciter's page, in SI units."""
    values = parameters(system)
    names = ("motor.R", "motor.k", "exciter.rotor.d", "exciter.rotor.m", "exciter.rotor.r")
    R, k, d_r, m_u, r = (float(values[name].value) for name in names)
    m, c, d = (float(values[f"exciter.mount.{name}"].value) for name in "mcd")
    return R, k, d_r, m_u * r, m + m_u, c, d


def averaged(system: System) -> Averaged:
    """Return the averaged theory of the exciter's page for a system."""
    R, k, d_r, U, M, c, d = constants(system)

    def supply(w: Any) -> Any:
        distance = (c - M * w**2) ** 2 + (d * w) ** 2
        return R / k * (d_r * w + d * U**2 * w**5 / (2 * distance)) + k * w

    def slope(w: Any) -> Any:
        distance = (c - M * w**2) ** 2 + (d * w) ** 2
        growth = -4 * M * w * (c - M * w**2) + 2 * d**2 * w
        rise = w**4 * (5 * distance - w * growth) / distance**2
        return R / k * (d_r + d * U**2 / 2 * rise) + k

    resonance = math.sqrt(c / M)
    if d == 0.0 or resonance == 0.0:
        speeds = np.linspace(1.0, 1000.0, AVERAGED_POINTS)
        return Averaged(resonance, 0.0, speeds, R / k * d_r * speeds + k * speeds, ())
    width, (low, high) = d / (2 * M), AVERAGED_RANGE
    nearest = min(NEAREST * width / resonance, NEAREST)
    below, above = (np.geomspace(end, nearest, AVERAGED_POINTS) for end in (1.0 - low, high - 1.0))
    speeds = resonance * np.concatenate([1.0 - below, 1.0 + above[::-1]])
    slopes = slope(speeds)
    folds = []
    for at in np.flatnonzero(slopes[1:] * slopes[:-1] < 0.0).tolist():
        speed = brentq(slope, float(speeds[at]), float(speeds[at + 1]))
        folds.append((float(speed), float(supply(speed))))
    return Averaged(resonance, width, speeds, supply(speeds), folds)


def response(system: System, speed: float) -> Samples:
    """Return an initial guess of the unknowns at a mean speed [rad/s], by averaged theory."""
    R, k, d_r, U, M, c, d = constants(system)
    x = U * speed**2 / (c - M * speed**2 + 1j * d * speed)
    tau = d_r * speed + d * speed * abs(x) ** 2 / 2
    return np.array([tau / k, speed, x.real, -speed * x.imag, R / k * tau + k * speed])


def scales_of(z: Samples, speed: float) -> Samples:
    """Return the sizes of the unknowns: those of the mount over a revolution, not at phi = 0."""
    amplitude = max(math.hypot(float(z[2]), float(z[3]) / speed), LEAST_AMPLITUDE)
    current, supply = max(abs(float(z[0])), LEAST_CURRENT), max(abs(float(z[4])), LEAST_SUPPLY)
    return np.array([current, speed, amplitude, amplitude * speed, supply])


def orbit(system: System, speed: float, guess: Samples, steps: int) -> Orbit:
    """Find the steady motion of a mean speed by Newton's method.

    Parameters
    ----------
    system : System
        The motor and the exciter.
    speed : float
        The mean speed [rad/s].
    guess : array of shape (5,)
        Current, speed, displacement and velocity at phi = 0, and the voltage, in SI units.
    steps : int
        Communication steps per revolution.

    Raises
    ------
    NoOrbitError
        If Newton's method does not converge, or leads to states from which no run is possible.
    """
    period, z = TURN / speed, guess

    def end(z: Samples, duration: float) -> Samples:
        states = dict(zip((*STATES, SUPPLY), z.tolist()))
        start = {**system.start, **states, PHI: 0.0}
        run = cosim.run(
            replace(system, start=start),
            stop=duration,
            step=duration / steps,
            record=(PHI, *STATES),
        )
        return np.array([run[name][-1] for name in (PHI, *STATES)])

    for _ in range(MAX_ROUNDS):
        scales = scales_of(z, speed)
        try:
            reached = end(z, period)
            columns = []
            for k in range(len(z)):
                shift = np.zeros(len(z))
                shift[k] = PERTURBATION * scales[k]
                columns.append((end(z + shift, period) - end(z - shift, period)) / (2 * shift[k]))
            end_after, early = (end(z, period * (1 + x)) for x in (PERTURBATION, -PERTURBATION))
        except SimulationError as error:
            raise NoOrbitError(f"no steady motion was found at {speed:.6g} rad/s") from error
        flow = np.stack(columns, axis=-1)
        returned = flow.copy()
        returned[1:, :4] -= np.eye(4)
        newton_step = np.linalg.solve(returned, np.array([TURN, *z[:4]]) - reached)
        z, change = z + newton_step, float((abs(newton_step) / scales).max())
        if change < CONVERGED:
            break
        if change > DIVERGED:
            raise NoOrbitError(f"no steady motion was found at {speed:.6g} rad/s")
    else:
        raise NoOrbitError(f"no steady motion was found at {speed:.6g} rad/s")
    rates = (end_after - early) / (2 * PERTURBATION * period)
    slope = np.linalg.solve(returned, -rates)[4] * -period / speed
    section = flow[1:, :4] - np.outer(rates[1:], flow[0, :4]) / rates[0]
    multipliers = sorted(np.linalg.eigvals(section).tolist(), key=lambda x: abs(x - 1.0))
    return Orbit(speed, float(z[4]), float(slope), multipliers)


def branch(system: System, steps: int) -> Callable[[float], Orbit]:
    """Return a function that finds the orbit of a mean speed, from the response of averaged theory."""

    @cache
    def at(speed: float) -> Orbit:
        return orbit(system, speed, response(system, speed), steps)

    return at


def fold(at: Callable[[float], Orbit], theory: Averaged, which: int) -> Orbit:
    """Find the extremum of the voltage over the mean speed near one of averaged theory.

    Raises NoOrbitError if the steady motions have none there.
    """
    (first, _), (last, _) = theory.folds
    speed, width = theory.folds[which][0], BRACKET * min(theory.width, last - first)
    for _ in range(MAX_WIDENINGS):
        low, high = speed - width, speed + width
        if at(low).slope * at(high).slope < 0.0:
            return at(float(brentq(lambda w: at(w).slope, low, high)))
        width *= 2
    raise NoOrbitError(f"the steady motions have no extreme voltage near {speed:.6g} rad/s")


def beyond(at: Callable[[float], Orbit], theory: Averaged, which: int, supply: float) -> Orbit:
    """Find the steady motion at a voltage [V] on the branch to which a fold throws the motor."""
    first, last = (speed for speed, _ in theory.folds)
    side = theory.speeds > last if which == 0 else theory.speeds < first
    distances = abs(theory.supplies[side] - supply)
    speed = float(theory.speeds[side][np.argmin(distances)])
    for _ in range(MAX_ROUNDS):
        motion = at(speed)
        change = (supply - motion.supply) / motion.slope
        speed += min(max(change, -speed / 4), speed / 4)
        if abs(change) < ROUNDING * speed:
            return motion
    raise NoOrbitError(f"no steady motion was found at {supply:.6g} V after the jump")


def jump(search: Search) -> Jump:
    """Locate a fold, and the motion to which the motor jumps when its voltage is passed slowly.

    At the fold one Floquet multiplier is 1. Where another one is beyond 1 the motion has lost its
    stability before, and the fold is not where the motor jumps. The search with the most steps
    examines this at speeds along the branch, too.
    """
    system, theory, which, steps, examines = search
    at = branch(system, steps)
    try:
        edge = fold(at, theory, which)
        growths = [edge.growth(1)]
        if examines:
            begin = beyond(at, theory, 1 - which, theory.folds[1 - which][1]).speed
            growths += [
                at(edge.speed + (begin - edge.speed) / 2**k).growth() for k in range(PROBES)
            ]
        if max(growths) >= 1.0:
            why = f"the motion is unstable before the fold of its voltage at {edge.supply:.6g} V"
            return Jump(math.nan, math.nan, math.nan, why)
        landing = beyond(at, theory, which, edge.supply)
    except NoOrbitError as error:
        return Jump(math.nan, math.nan, math.nan, str(error))
    if landing.growth() >= 1.0:
        return Jump(edge.supply, edge.speed, math.nan, "the motion after the jump is unstable")
    return Jump(edge.supply, edge.speed, landing.speed)


def steps_per_revolution(theory: Averaged, which: int, step: float) -> int:
    """Return the number of steps no longer than `step` [s] in a revolution at a fold, a multiple of 4."""
    needed = TURN / (theory.folds[which][0] * step)
    return 4 * math.ceil(max(needed, STEPS_PER_REV) / 4)


def searches(system: System, theory: Averaged, step: float) -> list[list[Search]]:
    """Return for each fold its searches with all, half and a quarter of the steps."""
    return [
        [
            Search(system, theory, which, steps_per_revolution(theory, which, step) // n, n == 1)
            for n in STEP_MULTIPLES
        ]
        for which in range(len(theory.folds))
    ]
