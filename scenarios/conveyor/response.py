"""How the coupled drive answers to its speed: steady orbits, and where their ripple is special.

At a speed nu the motor's line is set for the mean speed nu, motor and conveyor are coupled until their
orbit is steady, and the ripple of order 2 is read off the last revolution. The places where the torque
ripple lags its load by 90 degrees, and where the ripples are largest, are found on the response itself:
what load over response is, a smooth curve, is followed through orbits ever closer to the place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq

from cosim import System
from cosim.system import Value
from workbench.figure import Figure
from workbench.limit import limit
from workbench.measure import harmonics, largest
from workbench.orbit import NotSteady, Turns, steady

from .drive import WIRES
from .theory import Machine

Samples = NDArray[np.float64]
Complex = NDArray[np.complex128]
Each = Callable[[Callable[["Case"], "Point"], Sequence["Case"], str], Sequence["Point"]]
STATES = ("conveyor.w", "motor.tau")
RECORD = ("motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod")
HIGHEST, PER_ORDER, EDGE = 40, 3, 8
NEAR, AROUND = 0.25, (-2, -1, 0, 1, 2)
ROUNDS, FINE = 8, 2000
INSIDE, CLOSE = 0.75, 0.1
VANISHING = 0.02
MEANING = {
    "nu_90": ("speed where the torque ripple lags its load by 90 deg", ""),
    "nu_peak_tau": ("speed of the largest torque ripple", "torque ripple there, order 2"),
    "nu_peak_w": ("speed of the largest speed ripple", "speed ripple there, order 2"),
}
PEAKS = {"nu_peak_tau": ("tau2_peak", "N.m"), "nu_peak_w": ("w2_peak", "rad/s")}


class Case(NamedTuple):
    """One speed: FMUs, start values that make the machine run at nu [rad/s], steps and algorithm."""

    fmus: Mapping[str, Path]
    start: Mapping[str, Value]
    machine: Machine
    nu: float
    steps_per_rev: int
    algorithm: str


class Point(NamedTuple):
    """What one steady orbit tells; `problem` says why there is none, the rest is nan then.

    Complex amplitudes of order 2 over the crank angle of torque [N.m] and speed [rad/s] with their
    settling errors, mean speed [rad/s], largest rod force in either sense [N] with the error of its
    place.
    """

    nu: float
    torque: complex
    speed: complex
    mean: float
    push: float
    pull: float
    torque_error: float
    speed_error: float
    force_error: float
    problem: str = ""


NONE = complex(math.nan, math.nan)


def simulate(case: Case) -> Point:
    """The steady orbit of a case."""
    try:
        return read(orbit(case, RECORD), case.nu)
    except NotSteady as problem:
        return Point(case.nu, NONE, NONE, *(math.nan,) * 6, problem=str(problem))


def orbit(case: Case, record: Sequence[str]) -> Turns:
    """Whole revolutions on the steady orbit, started from first-order theory; raises NotSteady."""
    machine, nu = case.machine, case.nu
    near = {
        "conveyor.w": nu + machine.speed_ripple(nu).imag,
        "motor.tau": machine.load_slope * nu + machine.torque_ripple(nu).imag,
    }
    return steady(
        partial(coupled, case.fmus, case.start),
        near,
        "conveyor.phi",
        nu,
        case.steps_per_rev,
        record,
        case.algorithm,
    )


def coupled(
    fmus: Mapping[str, Path], start: Mapping[str, Value], at: Mapping[str, float]
) -> System:
    """Motor and conveyor from these start values."""
    return System(fmus, WIRES, {**start, **at, "conveyor.phi": 0.0})


def read(turns: Turns, nu: float) -> Point:
    """What the last revolution tells, and how far it may be from steady."""

    def order_2(column: str, back: int) -> complex:
        rows = turns.window(back)
        phi = turns.result[turns.angle][rows]
        most = min(HIGHEST, len(phi) // PER_ORDER)
        return complex(harmonics(phi, turns.result[column][rows], most)[1])

    def settled(column: str) -> tuple[complex, float]:
        now, before = order_2(column, 0), order_2(column, 1)
        return now, turns.remains(abs(now - before))

    torque, torque_error = settled("motor.tau")
    speed, speed_error = settled("conveyor.w")
    whole = turns.window()
    rows = slice(max(0, whole.start - EDGE), whole.stop + EDGE)  # a peak may lie at an end
    t, force = turns.result["time"][rows], turns.result["conveyor.f_rod"][rows]
    push, push_error = _highest(t, force)
    pull, pull_error = _highest(t, -force)
    mean = 2 * math.pi / turns.period()
    place_error = max(push_error, pull_error)
    return Point(nu, torque, speed, mean, push, pull, torque_error, speed_error, place_error)


def _highest(t: Samples, x: Samples) -> tuple[float, float]:
    """The largest value between the rows, and what every second row says of its error."""
    most = largest(t, x)[0]
    coarse = [largest(t[k::2], x[k::2])[0] for k in (0, 1)]
    return most, max(abs(value - most) for value in coarse) / 4


@dataclass(frozen=True)
class Place:
    """A place of the response: a root of `condition` on the smooth curve load over `part`."""

    name: str
    part: Callable[[Point], complex]
    settling: Callable[[Point], float]
    condition: Callable[[complex, complex, complex, complex], float]
    peak: bool


def _quadrature(load: complex, slope: complex, inverse: complex, inverse_slope: complex) -> float:
    """Zero where the response lags the load by 90 degrees."""
    return inverse.real


def _flat(load: complex, slope: complex, inverse: complex, inverse_slope: complex) -> float:
    """Zero where the amplitude |load / inverse| is stationary: half of its relative slope."""
    return (slope / load - inverse_slope / inverse).real


LAG = Place("nu_90", lambda p: p.torque, lambda p: p.torque_error, _quadrature, False)
TORQUE = Place("nu_peak_tau", lambda p: p.torque, lambda p: p.torque_error, _flat, True)
SPEED = Place("nu_peak_w", lambda p: p.speed, lambda p: p.speed_error, _flat, True)
PLACES = (LAG, TORQUE, SPEED)


class Found(NamedTuple):
    """Where a place is at one number of steps [rad/s], how high the response is there, and what the
    orbits around it leave open of both.
    """

    nu: float
    height: float
    nu_error: float
    height_error: float


class Unclear(Exception):
    """A place that the response does not have, or that it does not tell; says why."""


def candidate(place: Place, machine: Callable[[float], Machine], points: Sequence[Point]) -> float:
    """About where the place is, from the orbits of a sweep: theory, times what they say of it [rad/s].

    Raises Unclear.
    """
    known = [point for point in points if not point.problem]
    if len(known) < 2:
        raise Unclear("the sweep holds no two steady orbits")
    nu = np.array([point.nu for point in known])
    theory = _theory(place, machine)
    ratio = np.array([_load(machine, p.nu) / place.part(p) / theory(p.nu) for p in known])
    curve = make_interp_spline(nu, ratio, k=min(3, len(nu) - 1) if len(nu) != 3 else 1)
    center = machine(float(nu.mean())).nu_res
    width = machine(center).zeta * center
    dense = center + width * np.sinh(np.linspace(-8, 8, FINE))
    fine = np.unique(np.concatenate([np.linspace(nu[0], nu[-1], FINE), dense, nu]))
    fine = fine[(fine >= nu[0]) & (fine <= nu[-1])]
    inverse = np.array([theory(float(x)) for x in fine]) * curve(fine)
    load = np.array([_load(machine, float(x)) for x in fine])
    if place.peak:
        top = int(np.argmax(np.abs(load / inverse)))
        if top in (0, len(fine) - 1):
            raise Unclear("it is largest at an end of the sweep")
        return float(fine[top])
    below = (inverse.real > 0.0) & (inverse.imag > 0.0)
    passed = np.flatnonzero(below[:-1] & (inverse.real[1:] <= 0.0) & (inverse.imag[1:] > 0.0))
    if not len(passed):
        raise Unclear("no speed of the sweep has it")
    at = int(passed[0])
    if abs(load[at]) < VANISHING * np.abs(load).max():
        raise Unclear("the load ripple nearly vanishes there, and its phase means nothing")
    return float(fine[at])


def _load(machine: Callable[[float], Machine], nu: float) -> complex:
    return machine(nu).load_ripple(nu)


def _theory(place: Place, machine: Callable[[float], Machine]) -> Callable[[float], complex]:
    """Load over response by first-order theory."""
    ripple = Machine.speed_ripple if place is SPEED else Machine.torque_ripple
    return lambda nu: _load(machine, nu) / ripple(machine(nu), nu)


def between(nu: float, points: Sequence[Point]) -> float:
    """The place itself for one more orbit, or half a spacing aside where one is there already."""
    spacing = points[1].nu - points[0].nu
    nearest = min((point.nu for point in points), key=lambda at: abs(at - nu))
    return nu if abs(nu - nearest) > CLOSE * spacing else nearest + spacing / 2


def located(
    place: Place, machine: Callable[[float], Machine], points: Sequence[Point], more: Point
) -> Found:
    """The place on the polynomial through orbits around it and one more at it.

    What that one changed, and what settling leaves, is the error.
    """
    nu, height, bend = _on(place, machine, sorted([*points, more]))
    rough, rough_height, _ = _on(place, machine, points)
    noise = place.settling(more) / abs(place.part(more))
    spacing = points[1].nu - points[0].nu
    value = abs(_load(machine, more.nu) / place.part(more))
    unsure = noise / spacing if place.peak else noise * value
    return Found(
        nu,
        height,
        abs(nu - rough) + abs(unsure / bend),
        abs(height - rough_height) + place.settling(more),
    )


def _on(
    place: Place, machine: Callable[[float], Machine], points: Sequence[Point]
) -> tuple[float, float, float]:
    """Place, height there, and slope of the condition, on the polynomial through some orbits."""
    x = np.array([point.nu for point in points])
    middle, reach = (x[0] + x[-1]) / 2, (x[-1] - x[0]) / 2
    inverse = np.array([_load(machine, p.nu) / place.part(p) for p in points])
    curve = np.polynomial.Polynomial.fit(x, inverse, len(x) - 1, domain=[x[0], x[-1]])
    slope = curve.deriv()

    def condition(nu: float) -> float:
        load = _load(machine, nu)
        step = 1e-4 * reach
        change = (_load(machine, nu + step) - _load(machine, nu - step)) / (2 * step)
        return place.condition(load, change, complex(curve(nu)), complex(slope(nu)))

    fine = np.linspace(middle - 1.5 * reach, middle + 1.5 * reach, 61)
    values = np.array([condition(float(nu)) for nu in fine])
    passed = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if not len(passed):
        uphill = values[len(values) // 2] > 0.0
        raise Beyond(float(fine[-1] if uphill else fine[0]))
    k = int(passed[np.argmin(np.abs(fine[passed] - middle))])
    nu = float(brentq(condition, fine[k], fine[k + 1], xtol=1e-14 * middle))
    step = 1e-3 * reach
    bend = (condition(nu + step) - condition(nu - step)) / (2 * step)
    return nu, abs(_load(machine, nu) / complex(curve(nu))), bend


class Beyond(Exception):
    """A place that is not among the orbits but in the direction of this speed [rad/s]."""

    def __init__(self, nu: float) -> None:
        super().__init__(nu)
        self.nu = nu


def locate(
    start: Mapping[str, float],
    machine: Callable[[float], Machine],
    spacing: float,
    measure: Callable[[Sequence[float]], Sequence[Point]],
) -> dict[str, Found | str]:
    """Each place from about where it is, through orbits on a lattice of speeds `spacing` apart.

    `measure` gives the orbits of speeds. A place that escapes is told by a sentence.
    """
    places = {place.name: place for place in PLACES if place.name in start}
    centers = {name: round(at / spacing) for name, at in start.items()}
    known: dict[int, Point] = {}
    found: dict[str, Found | str] = {}
    for _ in range(ROUNDS):
        open_ = [name for name in places if name not in found]
        wanted = sorted({centers[name] + k for name in open_ for k in AROUND} - known.keys())
        if min(wanted, default=1) < 1:
            for name in open_:
                if centers[name] + AROUND[0] < 1:
                    found[name] = "it lies at standstill"
            continue
        known |= dict(zip(wanted, measure([k * spacing for k in wanted])))
        near: dict[str, float] = {}
        for name in open_:
            points = [known[centers[name] + k] for k in AROUND]
            problem = next((point.problem for point in points if point.problem), "")
            if problem:
                found[name] = problem
                continue
            try:
                nu = _on(places[name], machine, points)[0]
            except Beyond as beyond:
                centers[name] = round(beyond.nu / spacing)
                continue
            if abs(nu / spacing - centers[name]) <= INSIDE:
                near[name] = between(nu, points)
            else:
                centers[name] = round(nu / spacing)
        for (name, _), more in zip(near.items(), measure(list(near.values())) if near else ()):
            points = [known[centers[name] + k] for k in AROUND]
            if more.problem:
                found[name] = more.problem
            else:
                with suppress(Beyond):
                    found[name] = located(places[name], machine, points, more)
    return {name: found.get(name, "it does not stand still") for name in places}


def figure(
    unit: str, meaning: str, values: Sequence[float], errors: Sequence[float], order: float
) -> Figure:
    """A figure from runs with N, N/2 and N/4 steps, each with what its orbits leave open."""
    value, error, reason = limit(values, order)
    if error is None:
        return Figure.refused(unit, reason, meaning)
    return Figure(value, unit, error + 2.0 * max(errors), meaning)


def figures(found: Sequence[Mapping[str, Found | str]], order: float) -> dict[str, Figure]:
    """Places and heights from what was found with N, N/2 and N/4 steps."""
    told = {}
    for place in PLACES:
        name, (where, height) = place.name, MEANING[place.name]
        mine = [some.get(name, "the sweep does not hold it") for some in found]
        lost = next((one for one in mine if isinstance(one, str)), None)
        known = [one for one in mine if isinstance(one, Found)]
        if lost is not None:
            told[name] = Figure.refused("rad/s", lost, where)
        else:
            nus, widths = [one.nu for one in known], [one.nu_error for one in known]
            told[name] = figure("rad/s", where, nus, widths, order)
        if place.peak:
            key, unit = PEAKS[name]
            if lost is not None:
                told[key] = Figure.refused(unit, lost, height)
            else:
                tops, widths = [one.height for one in known], [one.height_error for one in known]
                told[key] = figure(unit, height, tops, widths, order)
    return told
