"""Steady motions of the exciter's drive at an imposed mean speed, and the folds of their supply voltage.

A steady motion repeats after one revolution. At a mean speed nu its period is 2 pi / nu, and one
revolution is run with a voltage and with states at phi = 0 as unknowns, until the states return
and the angle has grown by 2 pi (shooting; Seydel, Practical Bifurcation and Stability Analysis,
section 7.3). Over the mean speed the voltage is single-valued, on unstable motions too. Where it has
an extremum, two steady motions meet and end: there the speed jumps when the voltage passes slowly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import Prepared, RunSettings, System
from workbench.answer import parameters
from workbench.orbits import STEP_MULTIPLES
from workbench.roots import roots_between, secant
from workbench.steady import TURN

Array = NDArray[np.float64]
STATES = ("motor.i", "exciter.w", "exciter.x", "exciter.v")
PHI, SUPPLY = "exciter.phi", "motor.v"
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
#: Imaginary step that gives the slope of a formula without a difference (Squire and Trapp, SIAM Review 40, 1998) [rad/s].
TINY = 1e-30
#: Relative change of the unknowns at which Newton's method has converged; its next one is the square.
CONVERGED = 1e-8
#: Relative change of the unknowns at which Newton's method has left the initial guess; a convention.
DIVERGED = 3.0
#: Rounds after which Newton's method and the search for a voltage give up; they usually take three.
MAX_ROUNDS = 20
#: Relative error of a root that this accuracy leaves; derived from CONVERGED.
ROOT_ROUNDING = 1e-8
#: Largest distance of a fold from that of averaged theory, over the smaller of its half width and the distance of both
#: folds; a convention.
MOST_SHIFT = 1.3
#: Points of the averaged curve on either side of the resonance, at distances in geometric series.
AVERAGED_POINTS = 2001
#: Their least distance from the resonance, over its half width; a convention.
NEAREST = 1e-3
#: Lowest and highest speed of the averaged curve, over the resonance.
AVERAGED_RANGE = (0.02, 40.0)
#: Speeds at which the stability of a branch is examined, each half as far from the fold as the last.
PROBES = 6


class Averaged(NamedTuple):
    """Averaged theory: the resonance of the mount and its half width [rad/s], speeds [rad/s] with the
    voltages [V] at which they are steady, and the folds as rows of speed, voltage and bend [V.s2/rad2].
    """

    resonance: float
    width: float
    speeds: Array
    supplies: Array
    folds: Array


@dataclass(frozen=True)
class ExciterOrbits:
    """Steady motions of shape (n,): mean speed [rad/s], voltage [V], its slope over the speed [V.s/rad], the Floquet
    multipliers by their distance from 1, shape (n, 4); nan where there is none, and why.
    """

    speed: Array
    supply: Array
    slope: Array
    multipliers: NDArray[np.complex128]
    problems: NDArray[np.object_]

    def growth(self, first: int = 0) -> Array:
        """Return what a revolution leaves at most of a deviation; without its nearest to 1 at a fold."""
        return np.asarray(np.abs(self.multipliers[:, first:]).max(axis=1))


class Jumps(NamedTuple):
    """Voltages of folds [V], the speeds before and after them [rad/s], or the reasons why not; all of shape (n,)."""

    supply: Array
    before: Array
    after: Array
    reason: NDArray[np.object_]


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
        return np.imag(supply(w + 1j * TINY)) / TINY

    resonance = math.sqrt(c / M)
    if d == 0.0 or resonance == 0.0:
        speeds = np.linspace(1.0, 1000.0, AVERAGED_POINTS)
        supplies = R / k * d_r * speeds + k * speeds
        return Averaged(resonance, 0.0, speeds, supplies, np.empty((0, 3)))
    width, (low, high) = d / (2 * M), AVERAGED_RANGE
    nearest = min(NEAREST * width / resonance, NEAREST)
    below, above = (np.geomspace(end, nearest, AVERAGED_POINTS) for end in (1.0 - low, high - 1.0))
    speeds = resonance * np.concatenate([1.0 - below, 1.0 + above[::-1]])
    at = np.array(roots_between(slope, speeds))
    shift = PERTURBATION * at
    bends = (slope(at + shift) - slope(at - shift)) / (2 * shift)
    return Averaged(resonance, width, speeds, supply(speeds), np.transpose([at, supply(at), bends]))


def first_guesses(system: System, speed: Array) -> Array:
    """Return initial guesses of the unknowns at mean speeds [rad/s], by averaged theory, shape (n, 5)."""
    R, k, d_r, U, M, c, d = constants(system)
    with np.errstate(invalid="ignore"):  # a speed that is not asked for is nan
        x = U * speed**2 / (c - M * speed**2 + 1j * d * speed)
    tau = d_r * speed + d * speed * abs(x) ** 2 / 2
    return np.transpose([tau / k, speed, x.real, -speed * x.imag, R / k * tau + k * speed])


def scales_of(z: Array, speed: Array) -> Array:
    """Return the sizes of the unknowns: those of the mount over a revolution, not at phi = 0."""
    amplitude = np.maximum(np.hypot(z[:, 2], z[:, 3] / speed), LEAST_AMPLITUDE)
    current, supply = (
        np.maximum(np.abs(z[:, k]), least) for k, least in ((0, LEAST_CURRENT), (4, LEAST_SUPPLY))
    )
    return np.transpose([current, speed, amplitude, amplitude * speed, supply])


@dataclass(frozen=True)
class Shooting:
    """A system that is made ready to be run many times, and its averaged theory."""

    prepared: Prepared
    system: System
    theory: Averaged

    @classmethod
    @contextmanager
    def of(cls, system: System, theory: Averaged) -> Iterator[Shooting]:
        """Make a system ready for revolutions that begin at phi = 0."""
        system = replace(system, start={**system.start, PHI: 0.0})
        settings = RunSettings(1.0, 1.0, record=(PHI, *STATES))
        with Prepared.open(system, settings) as prepared:
            yield cls(prepared, system, theory)

    def ends(self, begins: Array, steps: NDArray[np.intp]) -> Array:
        """Return angle and states, shape (..., 5), after runs that begin with the states and the supply and last so long
        [s], shape (..., 6); nan where a run fails.
        """
        *columns, times = begins.reshape(-1, 6).T
        each = (times / np.broadcast_to(steps, begins.shape[:-1]).ravel()).tolist()
        cases = dict(zip((*STATES, SUPPLY), columns))
        ensemble = self.prepared.map(cases, steps=each, stops=times.tolist())
        last = ensemble.rows[np.arange(len(times)), np.maximum(ensemble.counts - 1, 0), 1:]
        last[[bool(reason) for reason in ensemble.reasons]] = np.nan
        return np.asarray(last.reshape(*begins.shape[:-1], 5))

    def orbits(self, speed: Array, steps: NDArray[np.intp]) -> ExciterOrbits:
        """Find the steady motions of mean speeds [rad/s] by Newton's method, from the response of averaged theory.

        Parameters
        ----------
        speed : ndarray, shape (n,)
            What is nan is not sought.
        steps : ndarray, shape (n,)
            Communication steps per revolution.
        """
        n = len(speed)
        z, period = first_guesses(self.system, speed), TURN / speed
        slope, multipliers = np.full(n, np.nan), np.full((n, 4), np.nan, complex)
        is_open, is_found = np.isfinite(speed), np.zeros(n, bool)
        shifts = PERTURBATION * np.vstack([np.zeros(6), np.kron(np.eye(6), [[1.0], [-1.0]])])
        for _ in range(MAX_ROUNDS):
            m = np.flatnonzero(is_open)
            if not len(m):
                break
            scales = np.column_stack([scales_of(z[m], speed[m]), period[m]])
            begins = np.column_stack([z[m], period[m]])[:, None] + shifts * scales[:, None]
            ends = self.ends(begins, steps[m, None])
            slopes = (ends[:, 1::2] - ends[:, 2::2]) / (2 * PERTURBATION * scales[..., None])
            flow, rates = np.swapaxes(slopes[:, :5], 1, 2), slopes[:, 5]
            back = flow.copy()
            back[:, 1:, :4] -= np.eye(4)
            left = np.concatenate([np.full((len(m), 1), TURN), z[m, :4]], axis=1) - ends[:, 0]
            step = np.linalg.solve(back, left[..., None])[..., 0]
            z[m] += step
            change = (np.abs(step) / scales[:, :5]).max(axis=1)
            done = change < CONVERGED
            of_period = np.linalg.solve(back, -rates[..., None])[:, 4, 0]
            slope[m[done]] = (of_period * -period[m] / speed[m])[done]
            sections = flow[:, 1:, :4] - rates[:, 1:, None] * flow[:, :1, :4] / rates[:, :1, None]
            found = np.linalg.eigvals(sections[done])
            order = np.argsort(np.abs(found - 1.0), axis=1)
            multipliers[m[done]] = np.take_along_axis(found, order, axis=1)
            is_found[m[done]] = True
            is_open[m] = ~done & (change <= DIVERGED)
        problems = np.array([f"no steady motion was found at {w:.6g} rad/s" for w in speed], object)
        problems[is_found] = ""
        return ExciterOrbits(
            speed, np.where(is_found, z[:, 4], np.nan), slope, multipliers, problems
        )

    def folds(self, which: NDArray[np.intp], steps: NDArray[np.intp]) -> ExciterOrbits:
        """Find the extrema of the voltage over the mean speed near those of averaged theory."""
        at, _, bends = self.theory.folds[which].T

        def residual(speed: Array) -> tuple[Array, Array]:
            is_near = np.abs(speed - at) <= most
            slopes = self.orbits(np.where(is_near, speed, np.nan), steps).slope
            return slopes, CONVERGED * np.abs(bends * at)

        most = MOST_SHIFT * min(self.theory.width, float(np.ptp(self.theory.folds[:, 0])))
        found = secant(residual, at, bends)
        edges = self.orbits(found.x, steps)
        lost = np.isnan(found.x)
        edges.problems[lost] = [
            f"the steady motions have no extreme voltage near {w:.6g} rad/s" for w in at[lost]
        ]
        return edges

    def after_jump(
        self, which: NDArray[np.intp], supply: Array, steps: NDArray[np.intp]
    ) -> ExciterOrbits:
        """Find the steady motions at voltages [V] on the branches to which folds throw the motor."""
        theory, (first, last) = self.theory, self.theory.folds[:, 0]
        distances = np.abs(theory.supplies - supply[:, None])
        side = np.where((which == 0)[:, None], theory.speeds > last, theory.speeds < first)
        speed = theory.speeds[np.where(side, distances, np.inf).argmin(axis=1)]
        speed = np.where(np.isfinite(supply), speed, np.nan)

        def residual(x: Array) -> tuple[Array, Array]:
            return self.orbits(x, steps).supply - supply, np.zeros(len(x))

        found = secant(residual, speed, self.orbits(speed, steps).slope)
        motions = self.orbits(found.x, steps)
        lost = np.isfinite(speed) & np.isnan(found.x)
        motions.problems[lost] = [
            f"no steady motion was found at {v:.6g} V after the jump" for v in supply[lost]
        ]
        return motions

    def jumps(self, which: NDArray[np.intp], steps: NDArray[np.intp]) -> Jumps:
        """Locate folds, and the motions to which the motor jumps when their voltages are passed slowly.

        At a fold one Floquet multiplier is 1. Where another one is beyond 1 the motion has lost its
        stability before, and the fold is not where the motor jumps. Those with the most steps are examined for
        this at speeds along the branch, too.
        """
        edges = self.folds(which, steps)
        growth = edges.growth(1)
        finest = np.flatnonzero(steps == [steps[which == k].max() for k in which])
        others = 1 - which[finest]
        begins = self.after_jump(others, self.theory.folds[others, 1], steps[finest])
        shares = 0.5 ** np.arange(PROBES)[:, None]
        probes = edges.speed[finest] + (begins.speed - edges.speed[finest]) * shares
        every = self.orbits(probes.ravel(), np.tile(steps[finest], PROBES))
        growth[finest] = np.maximum(growth[finest], every.growth().reshape(PROBES, -1).max(axis=0))
        lost = edges.problems.copy()
        probed = np.concatenate([begins.problems[None], every.problems.reshape(PROBES, -1)])
        lost[finest] = [
            next(filter(None, (why, *of_one)), "") for why, of_one in zip(lost[finest], probed.T)
        ]
        early = (lost == "") & (growth >= 1.0)
        lost[early] = [
            f"the motion is unstable before the fold of its voltage at {v:.6g} V"
            for v in edges.supply[early]
        ]
        landing = self.after_jump(which, np.where(lost == "", edges.supply, np.nan), steps)
        lost = np.where(lost == "", landing.problems, lost)
        supply, before = (np.where(lost == "", x, np.nan) for x in (edges.supply, edges.speed))
        unstable = (lost == "") & (landing.growth() >= 1.0)
        lost[unstable] = "the motion after the jump is unstable"
        return Jumps(supply, before, np.where(lost == "", landing.speed, np.nan), lost)


def steps_at_folds(theory: Averaged, step: float) -> NDArray[np.intp]:
    """Return the steps in a revolution at each fold with STEP_MULTIPLES of the finest, no longer than `step` [s]."""
    needed = np.maximum(TURN / (theory.folds[:, 0] * step), STEPS_PER_REV)
    return np.asarray(4 * np.ceil(needed / 4).astype(np.intp)[:, None] // np.array(STEP_MULTIPLES))
