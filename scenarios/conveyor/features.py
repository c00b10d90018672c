"""Features of the response over a speed or a parameter: 90 degrees lag, largest ripples, limits passed.

All are looked for on load over response, 1 / H, which is smooth even where the response has a sharp
resonance: by first-order theory it is a quadratic polynomial of the speed for the torque ripple, and that over
a linear one for the speed ripple. A spline through the orbits of a sweep gives a first guess and a slope; a
secant search, or Chebyshev nodes for a peak, then asks for orbits of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cosim import CONVERGENCE_ORDERS
from cosim.accuracy.extrapolation import extrapolate
from workbench import Figure
from workbench.measure import Measured
from workbench.roots import (
    Crossing,
    NoRootError,
    PeakSearch,
    Root,
    SecantSearch,
    falling_roots,
)

from .first_order import Machine
from .orbits import OperatingPoint, Orbit, OrbitRunner

Array = NDArray[np.float64]
#: Points of the grid on which an interpolant is searched, even in log x: 100 or more within the width of a
#: resonance whose damping ratio is 0.01, over a decade.
GRID = 8_000
#: Load ripple over its largest one on the line below which its phase is not defined well enough.
VANISHING = 0.02
#: Floor of a height, whose logarithm is taken, where the load vanishes.
SMALLEST_HEIGHT = 1e-300
#: Half width of the nodes around a peak, over damping ratio and speed. The part of the height that four of
#: five nodes miss falls with its fourth power: 1.3e-5 of the torque peak of set A with 0.5, 8e-7 with 0.25.
PEAK_WIDTH = 0.25
#: Largest half width over x, for drives with much damping.
WIDEST_PEAK = 0.1
NEED_TWO_SPEEDS = "fewer than two speeds reached a steady state"
AT_EDGE = "the maximum lies at the edge of the swept range; extend the speeds"
NOT_IN_RANGE = "the swept range does not contain it"
PHASE_UNDEFINED = "the load ripple is almost zero {}, so its phase is undefined"

Sweep = Sequence[tuple[float, Orbit]]
Curve = Callable[[Any], Any]


class NoFeatureError(Exception):
    """A feature that the response does not have, or that it does not show; says why."""


class Kind(Enum):
    """What is sought: 90 degrees lag behind the load, the largest ripple, or a level that is passed."""

    LAG = "lag"
    PEAK = "peak"
    RISE = "rise"
    FALL = "fall"


class Feature(NamedTuple):
    """What is sought on the response of a quantity, "torque" or "speed", in its unit.

    A level is sought near some x, which the sweep gives.
    """

    meaning: str
    quantity: str
    unit: str
    kind: Kind = Kind.PEAK
    level: float = 1.0
    near: float = math.nan

    def amplitude(self, orbit: Orbit) -> complex:
        """Return the amplitude of order 2."""
        return orbit.torque if self.quantity == "torque" else orbit.speed

    def settling_error(self, orbit: Orbit) -> float:
        """Return the settling error of that."""
        return orbit.torque_error if self.quantity == "torque" else orbit.speed_error

    def theory(self, machine: Machine, nu: Any) -> Any:
        """Return the amplitude by first-order theory."""
        return machine.torque_ripple(nu) if self.quantity == "torque" else machine.speed_ripple(nu)


LAG = Feature("speed where the torque ripple lags its load by 90 deg", "torque", "N.m", Kind.LAG)
TORQUE_PEAK = Feature("speed of the largest torque ripple", "torque", "N.m")
SPEED_PEAK = Feature("speed of the largest speed ripple", "speed", "rad/s")
LIMIT_FROM = Feature(
    "speed above which the torque ripple exceeds its limit", "torque", "N.m", Kind.RISE
)
LIMIT_TO = Feature(
    "speed below which the torque ripple exceeds its limit", "torque", "N.m", Kind.FALL
)


@dataclass(frozen=True, eq=False)
class ResponseLine:
    """Machines along x > 0, a speed or a parameter, between two ends.

    Attributes
    ----------
    at : callable
        The machine and its mean speed [rad/s] at x; of an array of x as well.
    first, last : float
        The ends.
    """

    at: Callable[[Any], tuple[Machine, Any]]
    first: float
    last: float

    def point(self, x: float, step_multiple: int = 1) -> OperatingPoint:
        """Return the operating point at x."""
        return OperatingPoint(*self.at(x), step_multiple)

    def load(self, x: Any) -> Any:
        """Return the load ripple at constant speed [N.m]."""
        machine, nu = self.at(x)
        return machine.load_ripple(nu) + 0.0 * x

    def theory_inverse(self, feature: Feature, x: Any) -> Any:
        """Return load over response by first-order theory, the same for every load.

        It is taken without a spring, which may cancel the load ripple and leave 0 / 0.
        """
        machine, nu = self.at(x)
        free = replace(machine, c=0.0)
        return (free.load_ripple(nu) + 0.0 * x) / feature.theory(free, nu)

    def correction(self, feature: Feature, x: Any, orbits: Sequence[Orbit]) -> Any:
        """Return load over response of orbits at x, minus that by theory."""
        inverse = self.load(x) / [feature.amplitude(orbit) for orbit in orbits]
        return inverse - self.theory_inverse(feature, x)

    def inverse_response(self, feature: Feature, sweep: Sweep) -> Curve:
        """Return load over response as a function of x: theory, plus a spline through the differences of orbits."""
        if not sweep:
            return lambda x: self.theory_inverse(feature, x)
        if problem := next((orbit.problem for _, orbit in sweep if orbit.problem), ""):
            raise NoFeatureError(problem)
        x = np.array([at for at, _ in sweep])
        spline = CubicSpline(x, self.correction(feature, x, [orbit for _, orbit in sweep]))
        return lambda x: self.theory_inverse(feature, x) + spline(x)

    @cached_property
    def grid(self) -> Array:
        """All of the line, even in log x."""
        return np.geomspace(self.first, self.last, GRID)

    @cached_property
    def lag_sense(self) -> float:
        """1 where the lag grows with x, -1 where it falls."""
        first, last = (self.theory_inverse(LAG, x).real for x in (self.first, self.last))
        return 1.0 if first >= last else -1.0

    @cached_property
    def peak_half_width(self) -> float:
        """Half the range of the nodes around a peak: PEAK_WIDTH of the width of the resonance in x.

        That width is zeta x / |d ln(nu_res / nu) / d ln x|; a neighbour 0.1 % away gives the derivative.
        """
        x = self.theory(LAG)
        x = math.sqrt(self.first * self.last) if math.isnan(x) else x
        (machine, nu), (neighbour, nu_neighbour) = self.at(x), self.at(1.001 * x)
        tuning = abs(math.log(neighbour.nu_res / machine.nu_res * nu / nu_neighbour)) / 0.001
        return float(x * min(PEAK_WIDTH * machine.zeta / max(tuning, 1e-9), WIDEST_PEAK))

    def height(self, x: Any, inverse: Any) -> Any:
        """Return the size of the response, from load over response."""
        return np.maximum(np.abs(self.load(x) / inverse), SMALLEST_HEIGHT)

    def residual(self, feature: Feature, x: Any, inverse: Any) -> Any:
        """Return what falls through 0 at a feature that is no peak; it is smooth as load over response is.

        A lag of 90 degrees has no real part of load over response. A level L is passed where
        |load|^2 - L^2 |1 / H|^2 changes its sign.
        """
        if feature.kind is Kind.LAG:
            return self.lag_sense * inverse.real
        sign = -1.0 if feature.kind is Kind.RISE else 1.0
        return sign * (np.abs(self.load(x)) ** 2 - (feature.level * np.abs(inverse)) ** 2)

    def crossings(self, feature: Feature, curve: Curve) -> list[Crossing]:
        """Return where a curve of load over response has the feature, with the slope of its residual."""
        inverse = curve(self.grid)
        if feature.kind is Kind.PEAK:
            heights = np.log(self.height(self.grid, inverse))
            return falling_roots(self.grid, heights, derivative=True)
        return falling_roots(self.grid, self.residual(feature, self.grid, inverse))

    def expected(self, feature: Feature, sweep: Sweep = ()) -> Crossing:
        """Return where the feature is by theory, corrected by the orbits of a sweep.

        Raises
        ------
        NoFeatureError
            If it is not there.
        """
        curve = self.inverse_response(feature, sweep)
        crossings = self.crossings(feature, curve)

        def height(x: float) -> float:
            return float(self.height(x, curve(x)))

        if feature.kind is Kind.PEAK:
            top = max(crossings, key=lambda crossing: height(crossing.x), default=None)
            if top is None or height(top.x) < max(map(height, (self.first, self.last))):
                raise NoFeatureError(AT_EDGE)
            return top
        if feature.kind is not Kind.LAG:
            crossings.sort(key=lambda crossing: abs(crossing.x - feature.near))
        else:
            crossings = [crossing for crossing in crossings if curve(crossing.x).imag > 0.0]
        if not crossings:
            raise NoFeatureError(NOT_IN_RANGE)
        load = np.abs(self.load(self.grid)).max()
        if feature.kind is Kind.LAG and abs(self.load(crossings[0].x)) < VANISHING * load:
            raise NoFeatureError(PHASE_UNDEFINED.format("there"))
        return crossings[0]

    def theory(self, feature: Feature) -> float:
        """Return where first-order theory has the feature, formula (22) the lag; nan where it is not."""
        try:
            return self.expected(feature).x
        except NoFeatureError:
            return math.nan

    def limits_passed(self, level: float, sweep: Sweep) -> list[Feature]:
        """Return where the torque ripple passes a level [N.m], in order, as two or more orbits say."""
        curve = self.inverse_response(TORQUE_PEAK, sweep)
        ends = [end._replace(level=level) for end in (LIMIT_FROM, LIMIT_TO)]
        passed = [
            end._replace(near=crossing.x) for end in ends for crossing in self.crossings(end, curve)
        ]
        return sorted(passed, key=lambda feature: feature.near)


Outcome = Measured | str


class FeatureSearch:
    """The search for one feature with one step multiple, round by round."""

    def __init__(
        self, line: ResponseLine, feature: Feature, sweep: Sweep, step_multiple: int
    ) -> None:
        """Start from what the orbits of a sweep say; raises NoFeatureError."""
        if len(sweep) <= 1:
            raise NoFeatureError(NEED_TWO_SPEEDS)
        guess = line.expected(feature, sweep)
        self.line, self.feature, self.step_multiple = line, feature, step_multiple
        self.method: SecantSearch | PeakSearch = SecantSearch(guess.x, guess.slope)
        if feature.kind is Kind.PEAK:
            half_width = min(line.peak_half_width, 0.9 * guess.x)
            self.method = PeakSearch(guess.x, half_width, self._height)

    def _height(self, x: Any, correction: Any) -> Any:
        return self.line.height(x, self.line.theory_inverse(self.feature, x) + correction)

    @property
    def _x(self) -> list[float]:
        method = self.method
        return method.nodes if isinstance(method, PeakSearch) else [method.x]

    @property
    def wanted(self) -> list[OperatingPoint]:
        """Where orbits are wanted next."""
        return [self.line.point(x, self.step_multiple) for x in self._x]

    def update(self, orbits: Sequence[Orbit]) -> tuple[Root, Root] | None:
        """Take the orbits; return place and height, or None to go on.

        Raises
        ------
        NoFeatureError
            If an orbit is not steady.
        NoRootError
            If the search fails.
        """
        if problem := next((orbit.problem for orbit in orbits if orbit.problem), ""):
            raise NoFeatureError(problem)
        feature, x = self.feature, np.array(self._x)
        noise = max(
            feature.settling_error(sample) / abs(feature.amplitude(sample)) for sample in orbits
        )
        correction = self.line.correction(feature, x, orbits)
        if isinstance(self.method, PeakSearch):
            return self.method.update(correction.tolist(), noise)
        inverse = self.line.theory_inverse(feature, x) + correction
        size = float(np.abs(inverse[0]))
        if feature.kind is not Kind.LAG:
            size = 2.0 * (feature.level * size) ** 2
        residual = float(self.line.residual(feature, x, inverse)[0])
        root = self.method.update(residual, noise * size)
        return None if root is None else (root, Root(math.nan, math.nan))


def search_together(
    searches: Sequence[FeatureSearch | str], runner: OrbitRunner
) -> list[tuple[Outcome, Outcome]]:
    """Return places and heights of searches whose orbits are run round by round, side by side.

    A search that fails, or a text in its place, gives the reason for both.
    """
    results: dict[int, tuple[Outcome, Outcome]] = {}
    pending: dict[int, FeatureSearch] = {}
    for n, search in enumerate(searches):
        if isinstance(search, str):
            results[n] = search, search
        else:
            pending[n] = search
    while pending:
        wanted = {n: search.wanted for n, search in pending.items()}
        orbits = runner.orbits(
            [point for points in wanted.values() for point in points], "features"
        )
        batches = {n: list(islice(orbits, len(points))) for n, points in wanted.items()}
        for n, batch in batches.items():
            try:
                roots = pending[n].update(batch)
            except (NoFeatureError, NoRootError) as reason:
                results[n] = str(reason), str(reason)
            else:
                if roots is None:
                    continue
                results[n] = Measured(*roots[0]), Measured(*roots[1])
            del pending[n]
    return [results[n] for n in range(len(searches))]


def locate(
    sought: Sequence[tuple[ResponseLine, Feature, Sweep]],
    step_multiples: Sequence[int],
    unit: str,
    runner: OrbitRunner,
) -> list[tuple[Figure, Figure]]:
    """Return where features are, and how high the response is at a peak, from sweeps of steady orbits.

    Parameters
    ----------
    sought : sequence of tuple
        For each feature its line, the feature, and the orbits of a sweep over x.
    step_multiples : sequence of int
        With which steps; three give an error.
    unit : str
        The unit of x.
    runner : OrbitRunner
        Runs the orbits that the searches want.
    """
    searches: list[FeatureSearch | str] = []
    for line, feature, sweep in sought:
        for multiple in step_multiples:
            try:
                searches.append(FeatureSearch(line, feature, sweep, multiple))
            except NoFeatureError as reason:
                searches.append(str(reason))
    results = search_together(searches, runner)
    figures, order = [], CONVERGENCE_ORDERS[runner.algorithm]
    for n, (_, feature, _) in enumerate(sought):
        x, heights = zip(*results[n * len(step_multiples) : (n + 1) * len(step_multiples)])
        meaning = f"{feature.quantity} ripple there, order 2"
        height = converged(heights, order, feature.unit, meaning)
        figures.append((converged(x, order, unit, feature.meaning), height))
    return figures


def converged(runs: Sequence[Outcome], order: float, unit: str, meaning: str) -> Figure:
    """Return where values at 1, 2, 4 times the step go that have errors of their own, or reasons."""
    if reasons := [run for run in runs if isinstance(run, str)]:
        return Figure.undetermined(unit, reasons[0], meaning)
    values, errors = np.array(runs).T
    limit = extrapolate(values.tolist(), order, errors.tolist())
    if limit.error is None:
        return Figure.undetermined(unit, limit.reason, meaning)
    return Figure(limit.value, unit, limit.error, meaning)
