"""Features of the response over a speed or a parameter: 90 degrees lag, largest ripples, limits passed.

All are looked for on load over response, 1 / H, which is smooth even where the response has a sharp
resonance: by first-order theory it is a quadratic polynomial of the speed for the torque ripple, and that over
a linear one for the speed ripple. Theory, corrected by a spline through the orbits of a sweep, gives first guesses and
slopes; secants, and Chebyshev nodes for a peak, then take orbits of their own, those of all features and step sizes
together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cosim.accuracy.limit import Limit
from workbench import Figure
from workbench.orbits import at_zero_step, figure_of
from workbench.roots import (
    NO_VALUE,
    Estimates,
    LocatedPeaks,
    ZeroCrossing,
    falling_roots,
    peaks,
    secant,
)

from .drive_orbits import Drive, Orbits, near
from .first_order import Machine
from .machine import linearised

Array = NDArray[np.float64]
#: Points of a line, about, at which an interpolant is looked at, between the speeds of a sweep: a cubic spline through
#: so many leaves 1e-9 of a polynomial of degree five over a decade.
LINE_POINTS = 1000
#: Chords by which a crossing is polished between two points of a line; each leaves a thousandth of its error.
POLISHES = 3
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
RIPPLES = (("torque", "N.m"), ("speed", "rad/s"))
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
LEVEL_PASSED = {
    1.0: "speed below which the torque ripple exceeds its limit",
    -1.0: "speed above which the torque ripple exceeds its limit",
}


@dataclass(frozen=True, eq=False)
class MachineLines:
    """Machines along lines of x > 0, a speed or a parameter.

    Attributes
    ----------
    at : callable
        The machines and their mean speeds [rad/s] at x on lines of these numbers, arrays that broadcast.
    swept : mapping of int to ndarray
        Where each line is swept, rising.
    """

    at: Callable[[Any, Any], tuple[Machine, Any]]
    swept: Mapping[int, Array]

    @classmethod
    def of(cls, machine: Machine, swept: Mapping[int, Array]) -> MachineLines:
        """Return the machines of an array over their speeds [rad/s], each with the slope that its motor has there."""
        return cls(lambda nu, line: (linearised(machine[line], nu), nu), swept)

    def load_ripple_at(self, x: Any, line: Any) -> Any:
        """Return the load ripple at constant speed [N.m]."""
        machine, nu = self.at(x, line)
        return machine.load_ripple(nu) + 0.0 * x

    def load_over_theory(self, x: Any, line: Any) -> Any:
        """Return load over response of both RIPPLES by first-order theory, the same for every load.

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
        passed = np.abs(self.load_ripple_at(x, line)) ** 2 - (sought.level * np.abs(inverse)) ** 2
        return sought.sense * np.where(np.isnan(sought.level), inverse.real, passed)


@dataclass(frozen=True, eq=False)
class Response:
    """Load over response along one line: theory, and a spline through what the orbits of a sweep differ by from it.

    Attributes
    ----------
    lines : MachineLines
        The lines.
    line : int
        The number of this one.
    orbits : Orbits, optional
        Those of the sweep with the shortest step, shape (m,); without them, it is that of theory.
    """

    lines: MachineLines
    line: int = 0
    orbits: Orbits | None = None

    @property
    def x(self) -> Array:
        """Where the line is swept."""
        return self.lines.swept[self.line]

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
        x, orbits = self.x[self.steady], self.orbits[self.steady]
        inverse = self.lines.load_ripple_at(x, self.line) / np.stack([orbits.torque, orbits.speed])
        return CubicSpline(x, inverse - self.lines.load_over_theory(x, self.line), axis=1)

    @cached_property
    def _states(self) -> CubicSpline:
        """What the states of orbits differ by from theory, over x."""
        assert self.orbits is not None
        x, states = self.x[self.steady], self.orbits.states[self.steady]
        return CubicSpline(x, states - near(*self.lines.at(x, self.line)))

    def start_states(self, x: Any) -> Array:
        """Return the states of orbits at the crank angle 0, shape (..., 2)."""
        return np.asarray(near(*self.lines.at(x, self.line)) + self._states(x))

    def load_over_response(self, x: Any) -> Any:
        """Return load over response of both quantities, shape (2, ...)."""
        correction = self._correction
        theory = self.lines.load_over_theory(x, self.line)
        return theory if correction is None else theory + correction(x)

    @cached_property
    def grid(self) -> Array:
        """All of the line, evenly between the places of the sweep."""
        x, per = self.x, max(8, LINE_POINTS // max(1, len(self.x) - 1))
        if len(x) == 1:
            return x
        parts = x[:-1] + np.diff(x) * np.linspace(0.0, 1.0, per, endpoint=False)[:, None]
        return np.append(parts.T.ravel(), x[-1])

    @cached_property
    def _on_grid(self) -> Any:
        return self.load_over_response(self.grid)

    def falling_crossings(self, sought: Sought) -> list[ZeroCrossing]:
        """Return where the residual of a feature that is no peak falls through 0, with its slope there."""

        def residual(x: Any, inverse: Any) -> Any:
            return self.lines.residual(sought, x, self.line, inverse[TORQUE])

        found = []
        for x, slope in falling_roots(self.grid, residual(self.grid, self._on_grid)):
            for _ in range(POLISHES):
                x -= float(residual(x, self.load_over_response(x))) / slope
            found.append(ZeroCrossing(x, slope))
        return found

    def lag(self) -> Sought:
        """Return where the torque ripple lags its load by 90 degrees, where x is least of such places."""
        if reason := self._lacks():
            return LAG._replace(line=self.line, reason=reason)
        first, last = self.lines.load_over_theory(self.x[[0, -1]], self.line)[TORQUE].real
        sought = LAG._replace(line=self.line, sense=1.0 if first >= last else -1.0)
        found = [
            c
            for c in self.falling_crossings(sought)
            if self.load_over_response(c.x)[TORQUE].imag > 0.0
        ]
        if not found:
            return sought._replace(reason=NOT_IN_RANGE)
        load = np.abs(self.lines.load_ripple_at(self.grid, self.line)).max()
        if abs(self.lines.load_ripple_at(found[0].x, self.line)) < VANISHING * load:
            return sought._replace(reason=PHASE_UNDEFINED.format("there"))
        return sought._replace(x=found[0].x, slope=found[0].slope)

    def passed(self, level: float) -> list[Sought]:
        """Return where the torque ripple passes a level [N.m], in order."""
        if self._lacks():
            return []
        kinds = [Sought(text, self.line, level=level, sense=s) for s, text in LEVEL_PASSED.items()]
        found = [x._replace(x=c.x, slope=c.slope) for x in kinds for c in self.falling_crossings(x)]
        return sorted(found, key=lambda sought: sought.x)

    def peak(self, quantity: int) -> Sought:
        """Return where the ripple of a quantity is largest on the line."""
        return self.highest(quantity)[1]

    def highest(self, quantity: int) -> tuple[float, Sought]:
        """Return the largest ripple of a quantity on the line, and where it is.

        The derivative of its square, |load|^2 / |1 / H|^2, falls through 0 there.
        """
        sought = PEAKS[quantity]._replace(line=self.line)
        if reason := self._lacks():
            return 0.0, sought._replace(reason=reason)
        above = np.abs(self.lines.load_ripple_at(self.grid, self.line)) ** 2
        below = np.abs(self._on_grid[quantity]) ** 2
        rise, growth = (np.gradient(x, self.grid) for x in (above, below))
        tops = [c.x for c in falling_roots(self.grid, rise * below - above * growth)]
        places = np.array([self.x[0], self.x[-1], *tops])
        with np.errstate(divide="ignore"):
            heights = np.abs(
                self.lines.load_ripple_at(places, self.line)
                / self.load_over_response(places)[quantity]
            )
        top = float(places[np.argmax(heights)])
        reason = AT_EDGE if top in (self.x[0], self.x[-1]) else ""
        return float(heights.max()), sought._replace(x=top, reason=reason)

    def _lacks(self) -> str:
        count = len(self.x) if self.orbits is None else np.count_nonzero(self.steady)
        return NEED_TWO_SPEEDS if count <= 1 else ""


def node_half_widths(lines: MachineLines, x: Array, line: Any) -> Array:
    """Return half the ranges of the nodes around peaks at x: PEAK_WIDTH of the width of the resonance there.

    That width is zeta x / |d ln(nu_res / nu) / d ln x|; a neighbour 0.1 % away gives the derivative.
    """
    (machine, nu), (neighbour, nu_neighbour) = lines.at(x, line), lines.at(1.001 * x, line)
    tuning = np.abs(np.log(neighbour.nu_res / machine.nu_res * nu / nu_neighbour)) / 0.001
    share = PEAK_WIDTH * machine.zeta / np.maximum(tuning, 1e-9)
    return np.asarray(x * np.minimum(share, WIDEST_PEAK))


class Located(NamedTuple):
    """Where features are, and how high the response is at peaks; limits of arrays of shape (n,), and why not."""

    x: Limit
    height: Limit
    reasons: list[str]

    def figures(self, sought: Sequence[Sought], unit: str) -> list[tuple[Figure, Figure]]:
        """Return place and height of each feature."""
        pairs = []
        for k, (feature, why) in enumerate(zip(sought, self.reasons)):
            name, of_height = RIPPLES[feature.quantity]
            meaning = f"{name} ripple there, order 2"
            height = figure_of(self.height, k, of_height, meaning, why)
            pairs.append((figure_of(self.x, k, unit, feature.meaning, why), height))
        return pairs


def locate(drive: Drive, responses: Sequence[Response], sought: Sequence[Sought]) -> Located:
    """Locate features on orbits of their own, with each step size.

    Parameters
    ----------
    drive : Drive
        How machines are run.
    responses : sequence of Response
        Those of all lines.
    sought : sequence of Sought
        The features, with first guesses.
    """
    shape = drive.multiples, len(sought)
    x, error, height, height_error = np.full((4, *shape), np.nan)
    reasons = np.array([feature.reason for feature in sought], object) + np.full(shape, "", object)
    for is_peak in (False, True):
        some = np.array([f.is_peak == is_peak and not f.reason for f in sought], bool)
        if some.any():
            multiple, which = at = tuple(k.ravel() for k in np.indices(shape)[:, :, some])
            search = _FeatureSearch(drive, responses, [sought[k] for k in which], multiple)
            if is_peak:
                places, heights = _peaks(search)
                height[at], height_error[at] = heights.x, heights.error
            else:
                places = _roots(search)
            x[at], error[at] = places.x, places.error
            lost = (places.reasons == NO_VALUE) & (search.problems != "")
            reasons[at] = np.where(lost, search.problems, places.reasons)
    why = [next((reason for reason in column if reason), "") for column in reasons.T.tolist()]
    order = drive.convergence_order
    return Located(at_zero_step(x, order, error), at_zero_step(height, order, height_error), why)


class _FeatureSearch:
    """Features of one kind, each with a step multiple: arrays of shape (n,)."""

    def __init__(
        self, drive: Drive, responses: Sequence[Response], sought: Sequence[Sought], multiple: Any
    ) -> None:
        self.drive, self.multiple = drive, multiple
        self.responses = {response.line: response for response in responses}
        self.lines = responses[0].lines
        columns = np.array([s[1:-1] for s in sought], float).T
        self.line, self.quantity = columns[:2].astype(np.intp)
        self.x, self.slope, self.level, self.sense = columns[2:]
        self.problems = np.full(len(sought), "", object)

    def load_over_response(self, x: Array) -> tuple[Array, Array]:
        """Return load over response of orbits at x, shape (..., n), and the share that settling leaves of it."""
        run, filled = np.isfinite(x), np.where(np.isfinite(x), x, self.x)
        machine, nu = self.lines.at(filled, self.line)
        nus, states = np.where(run, nu, np.nan), np.empty((*x.shape, 2))
        for line in np.unique(self.line).tolist():
            of_line = self.line == line
            states[..., of_line, :] = self.responses[line].start_states(filled[..., of_line])
        orbits = self.drive.orbits(machine, nus, "features", self.multiple, states)
        for k in np.argwhere(orbits.problem != ""):
            self.problems[k[-1]] = orbits.problem[tuple(k)]
        amplitude = self.of_quantity(orbits.torque, orbits.speed)
        with np.errstate(all="ignore"):
            share = self.of_quantity(orbits.torque_error, orbits.speed_error) / np.abs(amplitude)
            return (machine.load_ripple(nu) + 0.0 * filled) / amplitude, share

    def of_quantity(self, torque: Any, speed: Any, *, of: Any = slice(None)) -> Any:
        """Return for each of the features what belongs to its quantity."""
        return np.where(self.quantity[of] == TORQUE, torque, speed)


def _roots(search: _FeatureSearch) -> Estimates:
    """Return where features are that are no peaks."""

    def residual(x: Array) -> tuple[Array, Array]:
        inverse, share = search.load_over_response(x)
        size = np.abs(inverse)
        slope = np.where(np.isnan(search.level), size, 2.0 * (search.level * size) ** 2)
        return search.lines.residual(search, x, search.line, inverse), share * slope

    return secant(residual, search.x, search.slope)


def _peaks(search: _FeatureSearch) -> LocatedPeaks:
    """Return where ripples are largest, and how large."""
    half = np.minimum(node_half_widths(search.lines, search.x, search.line), 0.9 * search.x)

    def correction(nodes: Array) -> tuple[NDArray[Any], Array]:
        inverse, share = search.load_over_response(nodes)
        theory = search.lines.load_over_theory(
            np.where(np.isfinite(nodes), nodes, search.x), search.line
        )
        return inverse - search.of_quantity(*theory), share.max(axis=0)

    def height(x: Array, correction: NDArray[Any], k: NDArray[np.intp]) -> Array:
        line = search.line[k]
        inverse = search.of_quantity(*search.lines.load_over_theory(x, line), of=k) + correction
        size = np.abs(search.lines.load_ripple_at(x, line) / inverse)
        return np.asarray(np.maximum(size, np.finfo(float).tiny))

    return peaks(correction, height, search.x, half)
