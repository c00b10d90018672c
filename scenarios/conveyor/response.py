"""Features of the response over a speed or a parameter: 90 degrees lag, largest ripples, limits passed.

All are looked for on load over response, 1 / H, which is smooth even where the response has a sharp
resonance: by first-order theory it is a quadratic polynomial of the speed for the torque ripple, and that over
a linear one for the speed ripple. Theory, corrected by a spline through the orbits of a sweep, gives first guesses and
slopes; secants, and Chebyshev nodes for a peak, then take orbits of their own, those of all features and step sizes
together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cosim.accuracy.limit import Limit
from workbench import Figure
from workbench.roots import NO_VALUE, Crossing, Roots, falling_roots, peaks, secant

from .drive_orbits import Drive, Orbits, at_zero_step, figure_of
from .first_order import Machine

Array = NDArray[np.float64]
#: Points of a line, about, at which an interpolant is looked at, between the speeds of a sweep: a cubic spline through
#: so many leaves 1e-9 of a polynomial of degree five over a decade.
GRID = 1000
#: Load ripple over its largest one on the line below which its phase is not defined well enough.
VANISHING = 0.02
#: Half width of the nodes around a peak, over damping ratio and speed. The part of the height that four of
#: five nodes miss falls with its fourth power: 1.3e-5 of the torque peak of set A with 0.5, 8e-7 with 0.25.
PEAK_WIDTH = 0.25
#: Largest half width over x, for drives with much damping.
WIDEST_PEAK = 0.1
NEED_TWO_SPEEDS = "fewer than two speeds reached a steady state"
AT_EDGE = "the maximum lies at the edge of the swept range; extend the speeds"
NOT_IN_RANGE = "the swept range does not contain it"
PHASE_UNDEFINED = "the load ripple is almost zero {}, so its phase is undefined"
#: The quantities whose ripple is sought, with their units, and their numbers.
QUANTITIES = (("torque", "N.m"), ("speed", "rad/s"))
TORQUE, SPEED = range(2)


class Sought(NamedTuple):
    """A feature of the response on one of several lines, and where it is by theory and a sweep.

    Attributes
    ----------
    meaning
        What it is.
    line
        The number of the line.
    quantity
        TORQUE or SPEED, whose largest ripple is sought where `slope` is nan.
    x, slope
        Where it is about, and the slope of its residual there.
    level
        The ripple that is passed; nan for a lag of 90 degrees.
    sense
        What the residual is multiplied with, so that it falls.
    reason
        Why it is not there.
    """

    meaning: str
    line: int = 0
    quantity: int = TORQUE
    x: float = math.nan
    slope: float = math.nan
    level: float = math.nan
    sense: float = 1.0
    reason: str = ""

    @property
    def is_peak(self) -> bool:
        """Whether it is a largest ripple."""
        return math.isnan(self.slope)


LAG = Sought("speed where the torque ripple lags its load by 90 deg", slope=-1.0)
PEAKS = (
    Sought("speed of the largest torque ripple"),
    Sought("speed of the largest speed ripple", quantity=SPEED),
)
#: A level that the ripple passes falling, and rising, by the sense of its residual.
PASSED = {
    1.0: "speed below which the torque ripple exceeds its limit",
    -1.0: "speed above which the torque ripple exceeds its limit",
}


@dataclass(frozen=True, eq=False)
class Lines:
    """Machines along lines of x > 0, a speed or a parameter.

    Attributes
    ----------
    at : callable
        The machines and their mean speeds [rad/s] at x on lines of these numbers, both arrays.
    x : ndarray, shape (m,)
        Where the lines are swept, rising.
    """

    at: Callable[[Any, Any], tuple[Machine, Any]]
    x: Array

    def load(self, x: Any, line: Any) -> Any:
        """Return the load ripple at constant speed [N.m]."""
        machine, nu = self.at(x, line)
        return machine.load_ripple(nu) + 0.0 * x

    def theory(self, x: Any, line: Any) -> Any:
        """Return load over response of both QUANTITIES by first-order theory, the same for every load.

        It is taken without a spring, which may cancel the load ripple and leave 0 / 0.
        """
        machine, nu = self.at(x, line)
        free = replace(machine, c=0.0)
        load = free.load_ripple(nu) + 0.0 * x
        return np.stack([load / free.torque_ripple(nu), load / free.speed_ripple(nu)])

    def residual(self, sought: Any, x: Any, line: Any, inverse: Any) -> Any:
        """Return what falls through 0 at a feature that is no peak; it is smooth as load over response is.

        A lag of 90 degrees has no real part of load over response. A level L is passed where
        |load|^2 - L^2 |1 / H|^2 changes its sign. `sought` has level and sense, numbers or arrays.
        """
        passed = np.abs(self.load(x, line)) ** 2 - (sought.level * np.abs(inverse)) ** 2
        return sought.sense * np.where(np.isnan(sought.level), inverse.real, passed)


@dataclass(frozen=True, eq=False)
class Response:
    """Load over response along one line: theory, and a spline through what the orbits of a sweep differ by from it.

    Attributes
    ----------
    lines : Lines
        The lines.
    line : int
        The number of this one.
    orbits : Orbits, optional
        Those of the sweep with the shortest step, shape (m,); without them, it is that of theory.
    """

    lines: Lines
    line: int = 0
    orbits: Orbits | None = None

    @cached_property
    def steady(self) -> NDArray[np.bool_]:
        """Which orbits say something of load over response; a load ripple of exactly 0 says nothing."""
        assert self.orbits is not None
        return np.asarray(np.abs(self.orbits.torque) > 0.0)

    @cached_property
    def _correction(self) -> CubicSpline | None:
        """What orbits add to theory, shape (2, ...)."""
        if self.orbits is None:
            return None
        x, orbits = self.lines.x[self.steady], self.orbits[self.steady]
        inverse = self.lines.load(x, self.line) / np.stack([orbits.torque, orbits.speed])
        return CubicSpline(x, inverse - self.lines.theory(x, self.line), axis=1)

    def inverse(self, x: Any) -> Any:
        """Return load over response of both quantities, shape (2, ...)."""
        correction = self._correction
        theory = self.lines.theory(x, self.line)
        return theory if correction is None else theory + correction(x)

    @cached_property
    def grid(self) -> Array:
        """All of the line, evenly between the places of the sweep."""
        x, per = self.lines.x, max(8, GRID // max(1, len(self.lines.x) - 1))
        if len(x) == 1:
            return x
        parts = x[:-1] + np.diff(x) * np.linspace(0.0, 1.0, per, endpoint=False)[:, None]
        return np.append(parts.T.ravel(), x[-1])

    @cached_property
    def _on_grid(self) -> Any:
        return self.inverse(self.grid)

    def crossings(self, sought: Sought) -> list[Crossing]:
        """Return where the response has a feature that is no peak, with the slope of its residual."""

        def residual(x: Any, inverse: Any) -> Any:
            return self.lines.residual(sought, x, self.line, inverse[TORQUE])

        found = falling_roots(self.grid, residual(self.grid, self._on_grid))
        polished = []
        for x, slope in found:
            nearer = x - float(residual(x, self.inverse(x))) / slope
            polished.append(Crossing(nearer, slope))
        return polished

    def lag(self) -> Sought:
        """Return where the torque ripple lags its load by 90 degrees, where x is least of such places."""
        if reason := self._lacks():
            return LAG._replace(line=self.line, reason=reason)
        first, last = self.lines.theory(self.lines.x[[0, -1]], self.line)[TORQUE].real
        sought = LAG._replace(line=self.line, sense=1.0 if first >= last else -1.0)
        found = [c for c in self.crossings(sought) if self.inverse(c.x)[TORQUE].imag > 0.0]
        if not found:
            return sought._replace(reason=NOT_IN_RANGE)
        load = np.abs(self.lines.load(self.grid, self.line)).max()
        if abs(self.lines.load(found[0].x, self.line)) < VANISHING * load:
            return sought._replace(reason=PHASE_UNDEFINED.format("there"))
        return sought._replace(x=found[0].x, slope=found[0].slope)

    def passed(self, level: float) -> list[Sought]:
        """Return where the torque ripple passes a level [N.m], in order."""
        if self._lacks():
            return []
        kinds = [Sought(text, self.line, level=level, sense=s) for s, text in PASSED.items()]
        found = [x._replace(x=c.x, slope=c.slope) for x in kinds for c in self.crossings(x)]
        return sorted(found, key=lambda sought: sought.x)

    def peak(self, quantity: int) -> Sought:
        """Return where the ripple of a quantity is largest on the line.

        The derivative of its square, |load|^2 / |1 / H|^2, falls through 0 there.
        """
        sought = PEAKS[quantity]._replace(line=self.line)
        if reason := self._lacks():
            return sought._replace(reason=reason)
        above = np.abs(self.lines.load(self.grid, self.line)) ** 2
        below = np.abs(self._on_grid[quantity]) ** 2
        rise, growth = (CubicSpline(self.grid, x)(self.grid, 1) for x in (above, below))
        tops = [c.x for c in falling_roots(self.grid, rise * below - above * growth)]
        places = np.array([self.lines.x[0], self.lines.x[-1], *tops])
        with np.errstate(divide="ignore"):
            heights = np.abs(self.lines.load(places, self.line) / self.inverse(places)[quantity])
        top = float(places[np.argmax(heights)])
        if top in (self.lines.x[0], self.lines.x[-1]):
            return sought._replace(reason=AT_EDGE)
        return sought._replace(x=top)

    def _lacks(self) -> str:
        count = len(self.lines.x) if self.orbits is None else np.count_nonzero(self.steady)
        return NEED_TWO_SPEEDS if count <= 1 else ""


def peak_half_width(lines: Lines, line: int) -> float:
    """Return half the range of the nodes around a peak: PEAK_WIDTH of the width of the resonance in x.

    That width is zeta x / |d ln(nu_res / nu) / d ln x|; a neighbour 0.1 % away gives the derivative.
    """
    lag = Response(lines, line).lag()
    x = math.sqrt(lines.x[0] * lines.x[-1]) if lag.reason else lag.x
    (machine, nu), (neighbour, nu_neighbour) = lines.at(x, line), lines.at(1.001 * x, line)
    tuning = abs(math.log(neighbour.nu_res / machine.nu_res * nu / nu_neighbour)) / 0.001
    return float(x * min(PEAK_WIDTH * machine.zeta / max(tuning, 1e-9), WIDEST_PEAK))


class Located(NamedTuple):
    """Where features are, and how high the response is at peaks; limits of arrays of shape (n,), and why not."""

    x: Limit
    height: Limit
    reasons: list[str]

    def figures(self, sought: Sequence[Sought], unit: str) -> list[tuple[Figure, Figure]]:
        """Return place and height of each feature."""
        pairs = []
        for k, (feature, why) in enumerate(zip(sought, self.reasons)):
            name, of_height = QUANTITIES[feature.quantity]
            meaning = f"{name} ripple there, order 2"
            height = figure_of(self.height, k, of_height, meaning, why)
            pairs.append((figure_of(self.x, k, unit, feature.meaning, why), height))
        return pairs


def locate(drive: Drive, lines: Lines, sought: Sequence[Sought]) -> Located:
    """Locate features on orbits of their own, with each step size.

    Parameters
    ----------
    drive : Drive
        How machines are run.
    lines : Lines
        On which lines.
    sought : sequence of Sought
        The features, with first guesses.
    """
    n, k = len(sought), drive.multiples
    x, error, height, height_error = (np.full((k, n), np.nan) for _ in range(4))
    reasons = np.full((k, n), "", object)
    for is_peak in (False, True):
        some = [j for j, x in enumerate(sought) if x.is_peak == is_peak and not x.reason]
        if not some:
            continue
        search = _Search(drive, lines, [sought[j] for j in some])
        places, heights = search.peaks() if is_peak else (search.roots(), None)
        x[:, some], error[:, some], reasons[:, some] = places.x, places.error, places.reasons
        if heights is not None:
            height[:, some], height_error[:, some] = heights.x, heights.error
    why = [
        feature.reason or next((r for r in column if r), "")
        for feature, column in zip(sought, reasons.T.tolist())
    ]
    order = drive.order
    return Located(at_zero_step(x, order, error), at_zero_step(height, order, height_error), why)


class _Search:
    """Features of one kind, each with all step multiples: arrays of shape (multiples, features)."""

    def __init__(self, drive: Drive, lines: Lines, sought: Sequence[Sought]) -> None:
        self.drive, self.lines = drive, lines
        each = drive.each
        self.x, self.slope = each([s.x for s in sought]), each([s.slope for s in sought])
        self.level, self.sense = each([s.level for s in sought]), each([s.sense for s in sought])
        self.line = each([s.line for s in sought]).astype(np.intp)
        self.quantity = each([s.quantity for s in sought]).astype(np.intp)
        self.problems = np.full(self.x.shape, "", object)

    def orbits(self, x: Array) -> tuple[Array, Array, Any, Any]:
        """Return load over response of orbits at x, shape (multiples, ..., features), and the share that settling
        leaves of it, beside load and x without gaps.
        """
        line = np.broadcast_to(self.line.reshape(len(x), *(1,) * (x.ndim - 2), -1), x.shape)
        quantity = np.broadcast_to(
            self.quantity.reshape(line.shape[0], *(1,) * (x.ndim - 2), -1), x.shape
        )
        run = np.isfinite(x)
        filled = np.where(run, x, x[run][0])
        machine, nu = self.lines.at(filled, line)
        orbits = self.drive.orbits(machine, np.where(run, nu, np.nan), "features")
        axes = tuple(range(1, x.ndim - 1))
        for j in np.ndindex(*x.shape):
            if orbits.problem[j]:
                self.problems[j[0], j[-1]] = orbits.problem[j]
        amplitude = np.where(quantity == TORQUE, orbits.torque, orbits.speed)
        left = np.where(quantity == TORQUE, orbits.torque_error, orbits.speed_error)
        load = machine.load_ripple(nu) + 0.0 * filled
        with np.errstate(all="ignore"):
            share = left / np.abs(amplitude)
            inverse = load / amplitude
        return inverse, share.max(axis=axes) if axes else share, line, filled

    def roots(self) -> Roots:
        """Return where the features are."""

        def residual(x: Array) -> tuple[Array, Array]:
            inverse, share, line, filled = self.orbits(x)
            size = np.abs(inverse)
            size = np.where(np.isnan(self.level), size, 2.0 * (self.level * size) ** 2)
            return self.lines.residual(self, filled, line, inverse), share * size

        return self._explained(secant(residual, self.x, self.slope))

    def peaks(self) -> tuple[Roots, Roots]:
        """Return where the ripples are largest, and how large."""
        half = np.array([peak_half_width(self.lines, line) for line in self.line[0].tolist()])
        half = np.minimum(self.drive.each(half), 0.9 * self.x)
        shape, lines, quantity = self.x.shape, self.line.ravel(), self.quantity.ravel()

        def correction(nodes: Array) -> tuple[NDArray[Any], Array]:
            x = np.moveaxis(nodes.reshape(-1, *shape), 0, 1)
            inverse, share, line, filled = self.orbits(x)
            pick = np.broadcast_to(self.quantity[:, None], x.shape) == TORQUE
            torque, speed = self.lines.theory(filled, line)
            values = inverse - np.where(pick, torque, speed)
            return np.moveaxis(values, 1, 0).reshape(nodes.shape), share.ravel()

        def height(x: Array, correction: NDArray[Any], k: NDArray[np.intp]) -> Array:
            torque, speed = self.lines.theory(x, lines[k])
            inverse = np.where(quantity[k] == TORQUE, torque, speed) + correction
            size = np.abs(self.lines.load(x, lines[k]) / inverse)
            return np.asarray(np.maximum(size, np.finfo(float).tiny))

        places, heights = peaks(correction, height, self.x.ravel(), half.ravel())
        first, second = (
            Roots(r.x.reshape(shape), r.error.reshape(shape), r.reasons.reshape(shape))
            for r in (places, heights)
        )
        return self._explained(first), self._explained(second)

    def _explained(self, roots: Roots) -> Roots:
        """Return roots that say why an orbit is missing where that is why they are."""
        lost = (roots.reasons == NO_VALUE) & (self.problems != "")
        return replace(roots, reasons=np.where(lost, self.problems, roots.reasons))
