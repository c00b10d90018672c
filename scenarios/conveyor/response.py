"""How the coupled drive answers to its speed: steady orbits, and where their ripple is special.

At a speed nu the motor's line is set for the mean speed nu, motor and conveyor are coupled until their
orbit is steady, and the ripple of order 2 is read off the last revolution. The places where the torque
ripple lags its load by 90 degrees, and where the ripples are largest, are found on the response itself:
load over response, a smooth curve, is followed through orbits ever closer to the place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.optimize import brentq

import workbench
from cosim import ORDERS, SetupError, System
from cosim.system import Value
from workbench import Bench, Figure, option
from workbench.limit import limit
from workbench.measure import harmonics
from workbench.orbit import TURN, NotSteady, Turns, steady

from .drive import WIRES, start_values
from .theory import SETS, Machine, longest_step

Samples = NDArray[np.float64]
ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
RATED = {"A": 100.0, "B": 88.0}
RECORD = ("motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod")
HIGHEST, PER_ORDER, EDGE, SECTORS = 40, 3, 8, 16
FEWEST, COARSER = 18, (1, 2, 4)
FINE, VANISHING = 20_000, 0.02
NEAR, WIDEST, AROUND = 0.25, 0.05, (-2, -1, 0, 1, 2)
ROUNDS, INSIDE, CLOSE = 8, 0.75, 0.1
NONE = complex(math.nan, math.nan)


@dataclass(frozen=True, kw_only=True)
class Ripple(workbench.Options):
    """What is asked of the torque ripple, at one speed or in a plane."""

    set: str = option("A", "parameter set", choices=SETS)
    limit: float = option(
        50.0, "torque ripple that is too much, of the rated torque", "%", above=0.0
    )
    rated_torque: float | None = option(
        None, "rated motor torque at the crank, 100 in set A and 88 in set B by default", "N.m",
        above=0.0,
    )  # fmt: skip
    algorithm: str = option("strang", "coupling algorithm", choices=ALGORITHMS)

    @property
    def rated(self) -> float:
        """The rated torque [N.m]."""
        return self.rated_torque or RATED[self.set]

    @property
    def most(self) -> float:
        """The torque ripple above which it is too much [N.m]."""
        return self.limit / 100 * self.rated


class Case(NamedTuple):
    """One speed: FMUs, start values that make the machine run at nu [rad/s], steps and algorithm."""

    fmus: Mapping[str, Path]
    start: Mapping[str, Value]
    machine: Machine
    nu: float
    steps_per_rev: int
    algorithm: str


class Point(NamedTuple):
    """One steady orbit; `problem` says why there is none, the rest is nan then.

    Complex amplitudes of order 2 over the crank angle of torque [N.m] and speed [rad/s] with their
    settling errors, mean speed [rad/s], the largest rod forces of every sector of the crank angle, in
    either sense [N], and what the rows leave open of these.
    """

    nu: float
    torque: complex = NONE
    speed: complex = NONE
    mean: float = math.nan
    forces: Sequence[float] = (math.nan,)
    torque_error: float = math.nan
    speed_error: float = math.nan
    force_errors: Sequence[float] = (math.nan,)
    problem: str = ""


class Setup(NamedTuple):
    """How machines are run: on what, with which further start values, algorithm and steps."""

    bench: Bench
    start: Mapping[str, Value]
    algorithm: str
    steps_per_rev: int

    def case(self, machine: Machine, nu: float, coarser: int = 1) -> Case:
        """A machine at its nominal mean speed [rad/s], with `coarser` times fewer steps."""
        start = start_values(machine, self.start, nu)
        steps = self.steps_per_rev // coarser
        return Case(self.bench.fmus, start, machine, nu, steps, self.algorithm)

    def orbits(self, spots: Iterable[tuple[Machine, float, int]], title: str) -> list[Point]:
        """The orbits of cases."""
        return list(self.bench.each(simulate, [self.case(*spot) for spot in spots], title))

    def check(self, machine: Machine, nu: float, coarser: int = 1) -> None:
        """Raise SetupError for too few steps per revolution to fit orders or to stay stable at nu."""
        steps, longest = self.steps_per_rev // coarser, longest_step(machine, self.algorithm)
        if steps < FEWEST:
            raise SetupError(f"{steps} steps per revolution must be at least {FEWEST}")
        if steps <= TURN / (nu * longest):
            raise SetupError(
                f"{steps} steps per revolution are unstable with {self.algorithm} at {nu:g} rad/s: "
                f"its limit there is {TURN / (nu * longest):.2f} (a step of {longest:.3g} s)"
            )


def simulate(case: Case) -> Point:
    """The steady orbit of a case."""
    try:
        return read(orbit(case, RECORD), case.nu)
    except NotSteady as problem:
        return Point(case.nu, problem=str(problem))


def orbit(case: Case, record: Sequence[str]) -> Turns:
    """Whole revolutions on the steady orbit, started from first-order theory; raises NotSteady."""
    machine, nu = case.machine, case.nu
    near = {
        "conveyor.w": nu + machine.speed_ripple(nu).imag,
        "motor.tau": machine.load_slope * nu + machine.torque_ripple(nu).imag,
    }

    def system(at: Mapping[str, float]) -> System:
        return System(case.fmus, WIRES, {**case.start, **at, "conveyor.phi": 0.0})

    steps, angle = case.steps_per_rev, "conveyor.phi"
    return steady(system, near, angle, nu, steps, record, case.algorithm)


def read(turns: Turns, nu: float) -> Point:
    """The ripple of the last revolution, how far it may be from steady, and its rod forces."""

    def order_2(column: str) -> tuple[complex, float]:
        found = []
        for rows in (turns.window(), turns.window(1)):
            phi = turns.result[turns.angle][rows]
            most = min(HIGHEST, len(phi) // PER_ORDER)
            found.append(complex(harmonics(phi, turns.result[column][rows], most)[1]))
        return found[0], turns.remains(abs(found[0] - found[1]))

    torque, torque_error = order_2("motor.tau")
    speed, speed_error = order_2("conveyor.w")
    whole = turns.window()
    rows = slice(max(0, whole.start - EDGE), whole.stop + EDGE)  # a peak may lie at an end
    phi, force = turns.result[turns.angle][rows], turns.result["conveyor.f_rod"][rows]
    edges = np.linspace(turns.ends[-2], turns.ends[-1], SECTORS + 1)
    tops = sector_tops(phi, force, edges)
    halves = [sector_tops(phi[k::2], force[k::2], edges) for k in (0, 1)]
    left = np.abs(np.array(halves) - tops).max(axis=0) / 4
    mean = TURN / turns.period()
    return Point(nu, torque, speed, mean, tops.tolist(), torque_error, speed_error, left.tolist())


def sector_tops(phi: Samples, x: Samples, edges: Samples) -> Samples:
    """The largest x, then the largest -x, of every sector between edges, on the spline through rows.

    Which of two nearly equal peaks is the larger may change with the step; each by itself converges.
    """
    curve = CubicSpline(phi, x)
    at = np.concatenate([edges, curve.derivative().roots(extrapolate=False)])
    inside = [curve(at[(at >= first) & (at <= last)]) for first, last in pairwise(edges)]
    return np.array([(sense * values).max() for sense in (1, -1) for values in inside])


def largest_force(orbits: Iterable[Sequence[Point]]) -> tuple[float, float]:
    """The largest rod force of orbits, each with N, N/2 and N/4 steps, and its error [N], which
    reaches as far as that of any other peak does; nan where one is not known that may be the largest.
    """
    peaks = []
    for points in orbits:
        for values, left in zip(zip(*(p.forces for p in points)), points[0].force_errors):
            value, error, _ = limit(values, 1.0)
            reach = 2.0 * float(np.ptp(values)) if error is None else error + 2.0 * left
            peaks.append((value, reach, error is not None))
    best, error, _ = max(peaks, key=lambda peak: math.inf if math.isnan(peak[0]) else peak[0])
    above = [
        (value + reach - best, known) for value, reach, known in peaks if value + reach >= best
    ]
    return best, max([error, *(x for x, _ in above)]) if all(k for _, k in above) else math.nan


Known = Sequence[tuple[float, Point]]


class Place(NamedTuple):
    """A place of the response of a quantity, "torque" or "speed": where it lags its load by 90
    degrees, or is largest.
    """

    meaning: str
    quantity: str
    unit: str
    peak: bool = True

    def response(self, point: Point) -> complex:
        """The amplitude of order 2."""
        return complex(getattr(point, self.quantity))

    def settling(self, point: Point) -> float:
        """The settling error of that."""
        return float(getattr(point, f"{self.quantity}_error"))


LAG = Place("speed where the torque ripple lags its load by 90 deg", "torque", "N.m", False)
TORQUE = Place("speed of the largest torque ripple", "torque", "N.m")
SPEED = Place("speed of the largest speed ripple", "speed", "rad/s")


class Unclear(Exception):
    """A place that the response does not have, or that it does not show; says why."""


@dataclass(frozen=True, eq=False)
class Line:
    """Machines along x > 0, a speed or a parameter: `at` gives the machine and its mean speed
    [rad/s], of an array of x as well.
    """

    at: Callable[[Any], tuple[Machine, Any]]
    first: float
    last: float

    def load(self, x: Any) -> Any:
        """The load ripple at constant speed [N.m]."""
        machine, nu = self.at(x)
        return machine.load_ripple(nu) + 0.0 * x

    def ideal(self, place: Place, x: Any) -> Any:
        """Load over response by first-order theory."""
        machine, nu = self.at(x)
        return self.load(x) / getattr(machine, f"{place.quantity}_ripple")(nu)

    @cached_property
    def sense(self) -> float:
        """1 where the lag grows with x, -1 where it falls."""
        ends = [self.ideal(LAG, x).real for x in (self.first, self.last)]
        return 1.0 if ends[0] >= ends[1] else -1.0

    def theory(self, place: Place) -> float:
        """Where first-order theory has the place, formula (22) the lag; nan where it is not."""
        try:
            return self.expected(place)
        except Unclear:
            return math.nan

    @cached_property
    def spacing(self) -> float:
        """How far apart orbits around a place are: a share of the width of the resonance."""
        x = self.theory(LAG)
        x = math.sqrt(self.first * self.last) if math.isnan(x) else x
        (machine, nu), (beside, nu_beside) = self.at(x), self.at(1.001 * x)
        moved = abs(math.log(beside.nu_res / machine.nu_res * nu / nu_beside)) / 0.001
        return float(x * min(NEAR * machine.zeta / max(moved, 1e-9), WIDEST))

    def expected(self, place: Place, known: Known = ()) -> float:
        """Where the place is by theory, times what orbits at known x say of it. Raises Unclear."""
        x = np.geomspace(self.first, self.last, FINE)
        inverse, load = self.ideal(place, x), self.load(x)
        if known:
            steady = [(at, point) for at, point in known if not point.problem]
            if len(steady) < 2:
                raise Unclear("the sweep holds no two steady orbits")
            places = np.array([at for at, _ in steady])
            seen = [self.load(at) / place.response(point) for at, point in steady]
            ratio = np.array(seen) / self.ideal(place, places)
            degree = 3 if len(steady) > 3 else 1
            inverse = inverse * make_interp_spline(places, ratio, k=degree)(x)
        step = x[1] / x[0]
        if place.peak:
            ripple = np.abs(load / inverse)
            top = int(np.argmax(ripple))
            if top in (0, FINE - 1):
                raise Unclear("it is largest at an end of the sweep")
            before, most, after = ripple[top - 1 : top + 2]
            return float(x[top] * step ** ((after - before) / (2 * most - before - after) / 2))
        ahead = self.sense * inverse.real
        passed = (ahead[:-1] > 0.0) & (ahead[1:] <= 0.0) & (inverse.imag[:-1] > 0.0)
        if not passed.any():
            raise Unclear("no speed of the sweep has it")
        k = int(np.argmax(passed))
        if abs(load[k]) < VANISHING * np.abs(load).max():
            raise Unclear("the load ripple nearly vanishes there, and its phase means nothing")
        return float(x[k] * step ** (ahead[k] / (ahead[k] - ahead[k + 1])))

    def fitted(
        self, place: Place, x: Sequence[float], points: Sequence[Point]
    ) -> tuple[float, float, float]:
        """The place, the height there, and the slope of its condition, on the polynomial through
        orbits; of a place beyond them only the direction, an x outside, the rest is nan.
        """
        middle, reach = (min(x) + max(x)) / 2, (max(x) - min(x)) / 2
        inverse = [self.load(at) / place.response(point) for at, point in zip(x, points)]
        curve = np.polynomial.Polynomial.fit(x, inverse, len(x) - 1)
        slope = curve.deriv()

        def condition(x: Any) -> Any:
            if not place.peak:
                return self.sense * curve(x).real
            step = 1e-4 * reach
            change = (self.load(x + step) - self.load(x - step)) / (2 * step)
            return (change / self.load(x) - slope(x) / curve(x)).real

        fine = np.linspace(middle - 1.5 * reach, middle + 1.5 * reach, 61)
        values = condition(fine)
        passed = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
        if not len(passed):
            return float(fine[-1] if values[30] > 0.0 else fine[0]), math.nan, math.nan
        k = int(passed[np.argmin(np.abs(fine[passed] - middle))])
        at = float(brentq(condition, fine[k], fine[k + 1], xtol=1e-14 * middle))
        step = 1e-3 * reach
        bend = (condition(at + step) - condition(at - step)) / (2 * step)
        return at, float(abs(self.load(at) / curve(at))), float(bend)


class Found(NamedTuple):
    """Where a place is, how high the response is there, and what the orbits leave open of both."""

    x: float
    height: float
    x_error: float
    height_error: float


def search(line: Line, place: Place, known: Known) -> Generator[Sequence[float], Any, Found]:
    """A place from known orbits: through five on a lattice of the line until they surround it, and
    one more at it. Yields where it needs orbits; raises Unclear.
    """
    spacing = line.spacing
    center = round(line.expected(place, known) / spacing)
    for _ in range(ROUNDS):
        if center + AROUND[0] < 1:
            raise Unclear("it lies at standstill")
        x = [(center + k) * spacing for k in AROUND]
        points = yield x
        rough, rough_height, _ = line.fitted(place, x, points)
        if math.isnan(rough_height) or abs(rough / spacing - center) > INSIDE:
            center = round(rough / spacing)
            continue
        off = rough / spacing - round(rough / spacing)
        more = rough if abs(off) > CLOSE else rough + (0.5 - off) * spacing
        (point,) = yield [more]
        at, height, bend = line.fitted(place, [*x, more], [*points, point])
        if not math.isnan(height):
            noise, response = place.settling(point), abs(place.response(point))
            value = abs(line.load(more)) / response
            unsure = noise / response * (1 / spacing if place.peak else value)
            x_error = abs(at - rough) + abs(unsure / bend)
            return Found(at, height, x_error, abs(height - rough_height) + noise)
    raise Unclear("it does not stand still")


def locate(
    sought: Sequence[tuple[Line, Place, Known]], coarser: Sequence[int], setup: Setup
) -> list[list[Found | str]]:
    """Places from known orbits, each with so many times fewer steps; of one that is not there, why."""
    searches = {(n, k): search(*one) for n, one in enumerate(sought) for k in coarser}
    orbits: dict[tuple[Line, int, float], Point] = {}
    found: dict[tuple[int, int], Found | str] = {}
    asked: dict[tuple[int, int], list[tuple[Line, int, float]]] = {key: [] for key in searches}
    while asked:
        wanted = dict.fromkeys(one for ones in asked.values() for one in ones if one not in orbits)
        spots = [(*line.at(x), k) for line, k, x in wanted]
        orbits |= dict(zip(wanted, setup.orbits(spots, "places")))
        before, asked = asked, {}
        for (n, k), ones in before.items():
            points = [orbits[one] for one in ones]
            if problem := next((point.problem for point in points if point.problem), ""):
                found[n, k] = problem
                continue
            try:
                x = searches[n, k].send(points or None)
                asked[n, k] = [(sought[n][0], k, at) for at in x]
            except StopIteration as done:
                found[n, k] = done.value
            except Unclear as reason:
                found[n, k] = str(reason)
    return [[found[n, k] for k in coarser] for n in range(len(sought))]


def places(
    sought: Sequence[tuple[Line, Place, Known]], coarser: Sequence[int], unit: str, setup: Setup
) -> list[tuple[Figure, Figure]]:
    """Where places are and how high the response is there, from known orbits."""
    figures = []
    for (_, place, _), found in zip(sought, locate(sought, coarser, setup)):
        names = ((unit, place.meaning), (place.unit, f"{place.quantity} ripple there, order 2"))
        lost = next((one for one in found if isinstance(one, str)), "")
        known = [one for one in found if isinstance(one, Found)]
        for k, (own, meaning) in enumerate(names):
            value, error, reason = math.nan, None, lost
            if not lost:
                value, error, reason = limit([one[k] for one in known], ORDERS[setup.algorithm])
            if error is None:
                figures.append(Figure.refused(own, reason, meaning))
            else:
                left = 2.0 * max(one[k + 2] for one in known)
                figures.append(Figure(value, own, error + left, meaning))
    return list(zip(figures[::2], figures[1::2]))
