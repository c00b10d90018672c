"""The response of the coupled drive over its speed: steady orbits, and where their ripple is special.

At a speed nu the motor's line is set for the mean speed nu, motor and conveyor are coupled until their
orbit is steady, and the ripple of order 2 is read off the last revolution. The places where the torque
ripple lags its load by 90 degrees, and where the ripples are largest, are found on the response itself:
load over response, a smooth curve, is followed through orbits ever closer to the place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly

import workbench
from cosim import CONVERGENCE_ORDERS, SetupError, System
from cosim.system import Value
from workbench import Bench, Figure, option
from workbench.limit import limit
from workbench.measure import Measured, harmonics
from workbench.periodic import TURN, NotSteady, Turns, steady

from .first_order import SETS, Machine, longest_step
from .machine import WIRES, start_values

Samples = NDArray[np.float64]
ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
RATED = {"A": 100.0, "B": 88.0}
RECORD = ("motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod")
HIGHEST, PER_ORDER, EDGE, SECTORS, COURSE = 40, 3, 8, 16, 64
FEWEST, COARSER = 18, (1, 2, 4)
FINE, CLOSELY, VANISHING, TINY = 8_000, 601, 0.02, 1e-300
NEAR, WIDEST, AROUND = 0.25, 0.05, (-2, -1, 0, 1, 2)
ROUNDS, INSIDE, CLOSE = 8, 0.75, 0.1
NONE, NO_SWEEP = complex(math.nan, math.nan), "the sweep has fewer than two steady orbits"
Spot = tuple[Machine, float, int]


@dataclass(frozen=True, kw_only=True)
class Ripple(workbench.Options):
    """Options of the torque ripple, at one speed or in a plane."""

    set: str = option("A", "parameter set", choices=SETS)
    limit: float = option(
        50.0, "limit of the torque ripple, as a share of the rated torque", "%", above=0.0
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
        """The limit of the torque ripple [N.m]."""
        return self.limit / 100 * self.rated


class Case(NamedTuple):
    """One speed: FMUs, start values near the orbit of the mean speed nu [rad/s], steps, algorithm."""

    fmus: Mapping[str, Path]
    start: Mapping[str, Value]
    nu: float
    steps_per_rev: int
    algorithm: str


class Point(NamedTuple):
    """One steady orbit; `problem` says why there is none, the rest is nan then.

    Complex amplitudes of order 2 over the crank angle of torque [N.m] and speed [rad/s] with their
    settling errors, mean speed [rad/s], the largest rod forces of every sector of the crank angle, in
    either sense [N], what the rows leave open of these, and the rod force at COURSE even angles.
    """

    nu: float
    torque: complex = NONE
    speed: complex = NONE
    mean: float = math.nan
    forces: Sequence[float] = (math.nan,)
    torque_error: float = math.nan
    speed_error: float = math.nan
    force_errors: Sequence[float] = (math.nan,)
    course: Sequence[float] = (math.nan,) * COURSE
    problem: str = ""


@dataclass(frozen=True)
class Setup:
    """How machines are run: on what, with which further start values, algorithm and steps; and the
    orbits of machines at a mean speed [rad/s] with `coarser` times fewer steps that were run.
    """

    bench: Bench
    start: Mapping[str, Value]
    algorithm: str
    steps_per_rev: int
    known: dict[Spot, Point] = field(default_factory=dict)

    def case(self, machine: Machine, nu: float, coarser: int = 1) -> Case:
        """A machine at its nominal mean speed [rad/s], by first-order theory on its orbit, with
        `coarser` times fewer steps.
        """
        near = {
            "conveyor.phi": 0.0,
            "conveyor.w": nu + machine.speed_ripple(nu).imag,
            "motor.tau": machine.load_slope * nu + machine.torque_ripple(nu).imag,
        }
        start = start_values(machine, self.start, nu) | near
        return Case(self.bench.fmus, start, nu, self.steps_per_rev // coarser, self.algorithm)

    def each(self, spots: Sequence[Spot], title: str) -> Iterator[Point]:
        """The steady orbits of spots, one by one in their order; none is run twice."""
        new = [spot for spot in dict.fromkeys(spots) if spot not in self.known]
        runs = self.bench.each(simulate, [self.case(*spot) for spot in new], title)
        for spot in spots:
            if spot not in self.known:
                self.known[spot] = next(runs)
            yield self.known[spot]
        next(runs, None)

    def orbits(self, spots: Sequence[Spot], title: str) -> Iterator[Point]:
        """The same when all of them are run."""
        return iter(list(self.each(spots, title)))

    def check(self, machine: Machine, nu: float, coarser: int = 1) -> None:
        """Raise SetupError for too few steps per revolution to fit orders or to stay stable at nu."""
        said, longest = (
            f"{self.steps_per_rev} steps per revolution",
            longest_step(machine, self.algorithm),
        )
        fewest = coarser * TURN / (nu * longest)
        why = f", because runs with {coarser} times fewer give the errors" if coarser > 1 else ""
        if self.steps_per_rev // coarser < FEWEST:
            raise SetupError(f"{said} must be at least {coarser * FEWEST}{why}")
        if self.steps_per_rev <= fewest:
            slowest = nu * fewest / self.steps_per_rev
            raise SetupError(
                f"{said} are unstable with {self.algorithm} at {nu:g} rad/s: the step must stay below "
                f"{longest / coarser:.3g} s, and a revolution takes {TURN / nu:.4g} s{why}. Take "
                f"{math.floor(fewest) + 1} or more steps per revolution, or a speed above {slowest:.3g} rad/s"
            )


def simulate(case: Case) -> Point:
    """The steady orbit of a case."""
    try:
        return read(orbit(case, RECORD), case.nu)
    except NotSteady as problem:
        return Point(case.nu, problem=str(problem))


def orbit(case: Case, record: Sequence[str]) -> Turns:
    """Whole revolutions on the steady orbit; raises NotSteady."""

    def system(at: Mapping[str, float]) -> System:
        return System(case.fmus, WIRES, {**case.start, **at})

    near = {name: float(case.start[name]) for name in ("conveyor.w", "motor.tau")}
    return steady(system, near, "conveyor.phi", case.nu, case.steps_per_rev, record, case.algorithm)


def read(turns: Turns, nu: float) -> Point:
    """The ripple of the last revolution, how far it may be from steady, and its rod forces."""

    ripples = []
    for rows in (turns.window(), turns.window(1)):
        phi = turns.result[turns.angle][rows]
        columns = [turns.result[name][rows] for name in ("motor.tau", "conveyor.w")]
        most = min(HIGHEST, len(phi) // PER_ORDER)
        ripples.append(harmonics(phi, np.stack(columns, axis=1), most)[1])
    torque, speed = ripples[0].tolist()
    moved = np.abs(ripples[0] - ripples[1]).tolist()
    torque_error, speed_error = [turns.remains(x) for x in moved]
    whole = turns.window()
    rows = slice(max(0, whole.start - EDGE), whole.stop + EDGE)  # a peak may lie at an end
    phi, force = turns.result[turns.angle][rows], turns.result["conveyor.f_rod"][rows]
    edges = np.linspace(turns.ends[-2], turns.ends[-1], SECTORS + 1)
    tops = sector_tops(phi, force, edges)
    halves = [sector_tops(phi[k::2], force[k::2], edges) for k in (0, 1)]
    left = np.abs(np.array(halves) - tops).max(axis=0) / 4
    mean = TURN / turns.period()
    course = CubicSpline(phi, force)(turns.ends[-2] + TURN / COURSE * np.arange(COURSE)).tolist()
    errors = torque_error, speed_error, left.tolist()
    return Point(nu, torque, speed, mean, tops.tolist(), *errors, course)


def sector_tops(phi: Samples, x: Samples, edges: Samples) -> Samples:
    """The largest x, then the largest -x, of every sector between edges, on the spline through rows.

    Which of two nearly equal peaks is the larger may change with the step; each by itself converges.
    """
    curve = CubicSpline(phi, x)
    at = np.concatenate([edges, curve.derivative().roots(extrapolate=False)])
    values = curve(at)
    inside = [values[(at >= first) & (at <= last)] for first, last in pairwise(edges)]
    return np.array([(sense * some).max() for sense in (1, -1) for some in inside])


def largest_force(orbits: Iterable[Sequence[Point]]) -> tuple[float, float]:
    """The largest rod force of orbits, each with N, N/2 and N/4 steps, and its error [N], which
    reaches as far as that of any other peak does; nan where one is not known that may be the largest.
    """
    peaks = []
    for points in orbits:
        for values, left in zip(zip(*(p.forces for p in points)), points[0].force_errors):
            value, error, _ = limit(values, 1.0)
            reach = 2.0 * float(np.ptp(values)) if error is None else error + 2.0 * left
            peaks.append((value, value + reach, error is None))
    value, reach, unknown = np.array(peaks).T
    best = float(value.max())
    if math.isnan(best) or unknown[reach >= best].any():
        return best, math.nan
    return best, float(reach.max()) - best


Known = Sequence[tuple[float, Point]]
Curve = Callable[[Any], Any]


class Lost(Exception):
    """A place that the response does not have, or that it does not show; says why."""


class Place(NamedTuple):
    """What is sought on the response of a quantity, "torque" or "speed": where its "lag" behind the
    load is 90 degrees, its "peak", or where near some x it passes a level, by a "rise" or a "fall".
    """

    meaning: str
    quantity: str
    unit: str
    sort: str = "peak"
    level: float = 1.0
    near: float = math.nan

    def response(self, point: Point) -> complex:
        """The amplitude of order 2."""
        return complex(getattr(point, self.quantity))

    def settling(self, point: Point) -> float:
        """The settling error of that."""
        return float(getattr(point, f"{self.quantity}_error"))


LAG = Place("speed where the torque ripple lags its load by 90 deg", "torque", "N.m", "lag")
TORQUE = Place("speed of the largest torque ripple", "torque", "N.m")
SPEED = Place("speed of the largest speed ripple", "speed", "rad/s")
FROM = Place("speed above which the torque ripple exceeds its limit", "torque", "N.m", "rise")
TO = Place("speed below which the torque ripple exceeds its limit", "torque", "N.m", "fall")


class Zero(NamedTuple):
    """Where the condition of a place falls through zero, how high the response is there, and the
    slope of the condition; nan for both where x is only the direction in which to look.
    """

    x: float
    height: float
    bend: float


@dataclass(frozen=True, eq=False)
class Line:
    """Machines along x > 0, a speed or a parameter: `at` gives the machine and its mean speed
    [rad/s], of an array of x as well.

    The response is told by a curve over x, load over response, which is smooth at a resonance.
    """

    at: Callable[[Any], tuple[Machine, Any]]
    first: float
    last: float

    def load(self, x: Any) -> Any:
        """The load ripple at constant speed [N.m]."""
        machine, nu = self.at(x)
        return machine.load_ripple(nu) + 0.0 * x

    def ideal(self, place: Place, x: Any) -> Any:
        """Load over response by first-order theory, the same for every load: the spring's may cancel it."""
        machine, nu = self.at(x)
        free = replace(machine, c=0.0)
        return (free.load_ripple(nu) + 0.0 * x) / getattr(free, f"{place.quantity}_ripple")(nu)

    def curve(self, place: Place, known: Known) -> Curve:
        """Load over response by theory, and what orbits at known x say beside it: one polynomial
        through a few, cubics between those of a sweep. Raises Lost.
        """
        if not known:
            return lambda x: self.ideal(place, x)
        if problem := next((point.problem for _, point in known if point.problem), ""):
            raise Lost(problem)
        x = np.array([at for at, _ in known])
        beside = self.load(x) / [place.response(one) for _, one in known] - self.ideal(place, x)
        few = len(x) <= len(AROUND) + 1
        more = Polynomial.fit(x, beside, len(x) - 1) if few else CubicSpline(x, beside)
        return lambda x: self.ideal(place, x) + more(x)

    @cached_property
    def whole(self) -> Samples:
        """All of the line."""
        return np.geomspace(self.first, self.last, FINE)

    @cached_property
    def sense(self) -> float:
        """1 where the lag grows with x, -1 where it falls."""
        first, last = (self.ideal(LAG, x).real for x in (self.first, self.last))
        return 1.0 if first >= last else -1.0

    def zeros(self, place: Place, curve: Curve, x: Samples) -> tuple[list[Zero], PPoly]:
        """Where a curve has a place, looked at on x, and the condition that falls through zero there."""
        inverse = curve(x)
        if place.sort == "lag":
            condition = CubicSpline(x, self.sense * inverse.real / np.abs(inverse))
        else:
            sign = -1.0 if place.sort == "rise" else 1.0
            height = np.maximum(np.abs(self.load(x) / inverse), TINY)
            size = CubicSpline(x, sign * np.log(height / place.level))
            condition = size.derivative() if place.sort == "peak" else size
        at = condition.roots(extrapolate=False)
        bend = condition.derivative()
        falling = at[bend(at) < 0.0].tolist()
        found = [Zero(x, abs(self.load(x) / curve(x)), float(bend(x))) for x in falling]
        return found, condition

    def expected(self, place: Place, known: Known = ()) -> float:
        """Where the place is by theory and what known orbits say beside it. Raises Lost."""
        if not math.isnan(place.near):
            return place.near
        curve, ends = self.curve(place, known), self.whole[[0, -1]]
        found, _ = self.zeros(place, curve, self.whole)
        if place.sort == "peak":
            top = max(found, key=lambda zero: zero.height, default=Zero(0.0, 0.0, 0.0))
            if top.height < np.abs(self.load(ends) / curve(ends)).max():
                raise Lost("it is largest at an end of the sweep")
            return top.x
        behind = [zero.x for zero in found if curve(zero.x).imag > 0.0]
        if not behind:
            raise Lost("no speed of the sweep has it")
        if abs(self.load(behind[0])) < VANISHING * np.abs(self.load(self.whole)).max():
            raise Lost("the load ripple nearly vanishes there, so its phase means nothing")
        return behind[0]

    def edges(self, level: float, known: Known) -> list[Place]:
        """Where the torque ripple passes a level [N.m], in order, as two or more known orbits say."""
        curve, found = self.curve(TORQUE, known), []
        for end in (FROM._replace(level=level), TO._replace(level=level)):
            zeros, _ = self.zeros(end, curve, self.whole)
            found += [end._replace(near=zero.x) for zero in zeros]
        return sorted(found, key=lambda end: end.near)

    def theory(self, place: Place) -> float:
        """Where first-order theory has the place, formula (22) the lag; nan where it is not."""
        try:
            return self.expected(place)
        except Lost:
            return math.nan

    @cached_property
    def spacing(self) -> float:
        """How far apart orbits around a place are: a share of the width of the resonance."""
        x = self.theory(LAG)
        x = math.sqrt(self.first * self.last) if math.isnan(x) else x
        (machine, nu), (beside, nu_beside) = self.at(x), self.at(1.001 * x)
        moved = abs(math.log(beside.nu_res / machine.nu_res * nu / nu_beside)) / 0.001
        return float(x * min(NEAR * machine.zeta / max(moved, 1e-9), WIDEST))

    def fitted(self, place: Place, known: Known) -> Zero:
        """The place on the polynomial through orbits; of one beyond them only the direction."""
        x = np.array([at for at, _ in known])
        middle, reach = (x.min() + x.max()) / 2, 0.75 * np.ptp(x)
        fine = np.linspace(middle - reach, middle + reach, CLOSELY)
        found, condition = self.zeros(place, self.curve(place, known), fine)
        beyond = fine[-1] if condition(middle) > 0.0 else fine[0]
        nowhere = Zero(float(beyond), math.nan, math.nan)
        return min(found, key=lambda zero: abs(zero.x - middle), default=nowhere)


Found = tuple[Measured | str, Measured | str]
Search = Generator[list[Spot], Any, Found]


def search(line: Line, place: Place, start: float | str, coarser: int) -> Search:
    """A place and the height there, from where it is expected, or lost: through five orbits on a lattice
    of the line until they surround it, and one more at it. Yields where it needs orbits; raises Lost.
    """
    if isinstance(start, str):
        raise Lost(start)
    spacing = line.spacing
    center = round(start / spacing)
    for _ in range(ROUNDS):
        if center + AROUND[0] < 1:
            raise Lost("it lies at standstill")
        x = [(center + k) * spacing for k in AROUND]
        near = list(zip(x, (yield [(*line.at(one), coarser) for one in x])))
        rough = line.fitted(place, near)
        if math.isnan(rough.height) or abs(rough.x / spacing - center) > INSIDE:
            center = round(rough.x / spacing)
            continue
        off = rough.x / spacing - round(rough.x / spacing)
        more = rough.x if abs(off) > CLOSE else rough.x + (0.5 - off) * spacing
        (point,) = yield [(*line.at(more), coarser)]
        at, height, bend = line.fitted(place, [*near, (more, point)])
        if not math.isnan(height):
            noise = place.settling(point)
            unsure = abs(noise / place.response(point) / bend)
            x_error = abs(at - rough.x) + (unsure / spacing if place.sort == "peak" else unsure)
            return Measured(at, x_error), Measured(height, abs(height - rough.height) + noise)
    raise Lost("the search for it does not converge")


def begun(line: Line, place: Place, known: Known) -> float | str:
    """Where a search begins, as known steady orbits say, or why it cannot."""
    try:
        return line.expected(place, known) if len(known) > 1 else NO_SWEEP
    except Lost as reason:
        return str(reason)


def together(searches: Sequence[Search], setup: Setup) -> list[Found]:
    """What searches find whose orbits are run round by round, side by side, or why not."""
    found: dict[int, Found] = {}
    asked: dict[int, list[Spot]] = {n: [] for n in range(len(searches))}
    while asked:
        orbits = setup.orbits([spot for spots in asked.values() for spot in spots], "places")
        seen = {n: list(islice(orbits, len(spots))) for n, spots in asked.items()}
        asked = {}
        for n, points in seen.items():
            try:
                asked[n] = searches[n].send(points or None)
            except StopIteration as done:
                found[n] = done.value
            except Lost as reason:
                found[n] = str(reason), str(reason)
    return [found[n] for n in range(len(searches))]


def places(
    sought: Sequence[tuple[Line, Place, Known]], coarser: Sequence[int], unit: str, setup: Setup
) -> list[tuple[Figure, Figure]]:
    """Where places are and how high the response is there, from known steady orbits."""
    starts = [(line, place, begun(line, place, known)) for line, place, known in sought]
    found = together([search(*start, k) for start in starts for k in coarser], setup)
    figures, order = [], CONVERGENCE_ORDERS[setup.algorithm]
    for n, (_, place, _) in enumerate(sought):
        x, heights = zip(*found[n * len(coarser) : (n + 1) * len(coarser)])
        meaning = f"{place.quantity} ripple there, order 2"
        height = converged(heights, order, place.unit, meaning)
        figures.append((converged(x, order, unit, place.meaning), height))
    return figures


def converged(runs: Sequence[Measured | str], order: float, unit: str, meaning: str) -> Figure:
    """Where values at steps h, 2 h, 4 h go that have errors of their own, or are lost."""
    if lost := [run for run in runs if isinstance(run, str)]:
        return Figure.refused(unit, lost[0], meaning)
    values, errors = np.array(runs).T
    value, error, reason = limit(values.tolist(), order)
    if error is None:
        return Figure.refused(unit, reason, meaning)
    return Figure(value, unit, error + 2.0 * float(errors.max()), meaning)
