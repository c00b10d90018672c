"""A plane of machines co-simulated point by point, its ridges, and what the coupling did to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim.result import partial
from workbench.answer import stream

from ..response import Case, Point, simulate
from . import ridges
from .plane import Plane, Setup

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
VALUES = {
    "ripple": "N.m",
    "gain": "1",
    "lag": "deg",
    "w_mean": "rad/s",
    "settling": "1",
    "ripple_theory": "N.m",
    "gain_theory": "1",
    "lag_theory": "deg",
    "ratio": "1",
}
ROWS, GRID = 8, 5
RIDGES = ("lag_90", "peak")
ROUNDS, NEAR, FINE = 5, 0.01, 400


class Survey(NamedTuple):
    """Order 2 of the motor torque and of the load torque at constant speed [N.m], by co-simulation
    and by first-order theory; all arrays have the shape of the plane, and `torque` is nan where the
    orbit is not steady.
    """

    plane: Plane
    torque: Complex
    theory: Complex
    load: Complex

    @property
    def ripple(self) -> Real:
        """Amplitude of the torque ripple [N.m]."""
        return np.abs(self.torque)

    @property
    def gain(self) -> Real:
        """Amplitude of the torque ripple over that of the load ripple."""
        return np.abs(self.torque / self.load)

    @property
    def ratio(self) -> Real:
        """Torque ripple by co-simulation over that of theory."""
        return np.abs(self.torque / self.theory)

    @property
    def steady(self) -> NDArray[np.bool_]:
        return ~np.isnan(self.torque)


def columns(plane: Plane) -> dict[str, str]:
    """Names and units of the values in a row of the table."""
    return {plane.x.name: plane.x.unit, plane.y.name: plane.y.unit, **VALUES}


def told(x: float, y: float, case: Case, orbit: Point) -> tuple[float, ...]:
    """The row of one point: what its run tells, and first-order theory; the lag from 0 to 360."""
    load, theory = (f(case.nu) for f in (case.machine.load_ripple, case.machine.torque_ripple))
    values = []
    for torque in (orbit.torque, theory):
        lag = math.degrees(np.angle(load / torque)) % 360.0
        values.append((abs(torque), abs(torque / load), lag))
    settling = orbit.torque_error / abs(orbit.torque)
    return x, y, *values[0], orbit.mean, settling, *values[1], abs(orbit.torque / theory)


def sweep(plane: Plane, setup: Setup, table: Path | None) -> tuple[Survey, list[tuple[float, ...]]]:
    """Run all points; their rows go to NAME.partial.csv one by one, too."""
    places = [(float(x), float(y)) for y in plane.y.values for x in plane.x.values]
    cases = [setup.case(*plane.at(*place)) for place in places]
    orbits: list[Point] = []
    rows: list[tuple[float, ...]] = []
    with stream(table, list(columns(plane))) as keep:
        try:
            for orbit in setup.bench.each(simulate, cases, "map"):
                number = len(rows)
                rows.append(told(*places[number], cases[number], orbit))
                keep([rows[-1]])
                orbits.append(orbit)
        except KeyboardInterrupt:
            kept = f" in {partial(table)}" if table else ""
            raise KeyboardInterrupt(f"{len(rows)} of {len(cases)} points{kept}") from None
    torque = [orbit.torque for orbit in orbits]
    theory = [case.machine.torque_ripple(case.nu) for case in cases]
    load = [case.machine.load_ripple(case.nu) for case in cases]
    arrays = (np.array(values).reshape(plane.shape) for values in (torque, theory, load))
    return Survey(plane, *arrays), rows


class Row(NamedTuple):
    """Where the row at y has its ridges, in units of x; None where it has none."""

    y: float
    lag_90: float | None
    formula: float | None
    peak: float | None
    peak_theory: float | None


class Trace(NamedTuple):
    """The torque's order 2 along a row [N.m], at ascending x; both of shape (n,)."""

    y: float
    x: Real
    torque: Complex


def locate(survey: Survey, setup: Setup) -> list[Row]:
    """The ridges of every row, with runs at them until a run is within NEAR of a step of x.

    A row that is not steady throughout has none.
    """
    plane, x = survey.plane, survey.plane.x.values
    near = NEAR * float(np.diff(x).min())
    traces = [
        Trace(float(y), x, torque) for y, torque in zip(plane.y.values, survey.torque, strict=True)
    ]
    for _ in range(ROUNDS):
        rows = [find_row(plane, trace) for trace in traces]
        wanted = [
            (n, at)
            for n, (row, trace) in enumerate(zip(rows, traces))
            for at in {row.lag_90, row.peak} - {None}
            if at is not None and np.abs(trace.x - at).min() > near
        ]
        if not wanted:
            break
        cases = [setup.case(*plane.at(at, traces[n].y)) for n, at in wanted]
        for (n, at), orbit in zip(wanted, setup.bench.each(simulate, cases, "ridges")):
            y, known, torque = traces[n]
            k = int(np.searchsorted(known, at))
            traces[n] = Trace(y, np.insert(known, k, at), np.insert(torque, k, orbit.torque))
    return [find_row(plane, trace) for trace in traces]


def find_row(plane: Plane, trace: Trace) -> Row:
    """The 90 degree crossing and the largest peak of the torque ripple, and what theory says."""
    y, x, torque = trace

    def load(at: float) -> complex:
        machine, nu = plane.at(at, y)
        return machine.load_ripple(nu)

    def ideal(at: float) -> complex:
        machine, nu = plane.at(at, y)
        return machine.torque_ripple(nu)

    fine = np.interp(np.linspace(0, 1, FINE), np.linspace(0, 1, len(x)), x)
    theory = np.array([load(float(at)) / ideal(float(at)) for at in fine])
    formula = first(ridges.crossings(fine, theory))
    if np.isnan(torque).any():
        return Row(y, None, formula, None, None)
    inverse = np.array([load(float(at)) for at in x]) / torque
    along = ridges.curve(x, inverse)
    peak = first(ridges.peaks(x, lambda at: abs(load(at) / complex(along(at)))))
    near = (
        None if peak is None else ridges.nearest(ridges.peaks(x, lambda at: abs(ideal(at))), peak)
    )
    return Row(y, first(ridges.crossings(x, inverse)), formula, peak, near)


def first(places: Sequence[float]) -> float | None:
    """The first place; None if there is none."""
    return next(iter(places), None)


class Coupling(NamedTuple):
    """Largest relative coupling errors: of the gain, of x at the two ridges.

    None where nothing converged. `converged` counts the gains that converge at the order of the
    algorithm, out of `points`; `last` is how far halving the step moves the others at most.
    """

    gain: float | None
    lag_90: float | None
    peak: float | None
    points: int
    converged: int
    last: float


def coupling(survey: Survey, rows: Sequence[Row], setup: Setup) -> Coupling:
    """From runs with a half and a quarter of the steps, all over and at the ridges of ROWS rows."""
    plane = survey.plane
    x, y, (height, width) = plane.x.values, plane.y.values, plane.shape
    spread = float(np.diff(x).min()) * np.linspace(-0.5, 0.5, 5)
    ridge = [
        (place, row.y, at + spread)
        for row in (rows[n] for n in evenly(height, ROWS))
        for place in RIDGES
        if (at := getattr(row, place)) is not None
    ]
    places = [
        (float(x[k]), float(y[n]))
        for n in evenly(height, GRID)
        for k in evenly(width, GRID)
        if survey.steady[n, k]
    ]
    wanted = places + [(float(at), level) for _, level, five in ridge for at in five]
    cases = [setup.case(*plane.at(*at), coarser) for coarser in (1, 2, 4) for at in wanted]
    orbits = setup.bench.each(simulate, cases, "coupling error")
    torques = np.array([orbit.torque for orbit in orbits]).reshape(3, -1)
    order = cosim.ORDERS[setup.algorithm]
    gains = [cosim.estimate(three, order) for three in np.abs(torques).T.tolist()]
    moved: dict[str, list[float]] = {place: [] for place in RIDGES}
    local = torques[:, len(places) :].reshape(3, -1, 5)
    for n, (place, level, five) in enumerate(ridge):
        found = [getattr(find_row(plane, Trace(level, five, t[n])), place) for t in local]
        if None not in found:
            at = cosim.estimate(found, order)
            if at.error is not None:
                moved[place].append(at.error / at.value)
    unsure = [three for three, gain in zip(np.abs(torques).T, gains) if gain.error is None]
    return Coupling(
        max((gain.error / gain.value for gain in gains if gain.error is not None), default=None),
        max(moved["lag_90"], default=None),
        max(moved["peak"], default=None),
        len(gains),
        len(gains) - len(unsure),
        max((float(abs(fine / middle - 1)) for fine, middle, _ in unsure), default=0.0),
    )


def evenly(length: int, count: int) -> list[int]:
    """Indices from the first to the last, at most so many."""
    return sorted({round(k) for k in np.linspace(0, length - 1, count).tolist()})
