"""A plane of two parameters of motor and conveyor: every point is a machine at a speed, and machines
like it as they are built, every part anywhere within its tolerance, equally likely.

First-order theory, times what co-simulation made of it at the nominal machine, judges thousands of
built machines; co-simulation judges some of them again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import SetupError
from workbench import Plan
from workbench.answer import GivenValue, parameters
from workbench.charts.model import GridAxis
from workbench.find import Find
from workbench.options import Option, at_least
from workbench.plan import Sampling
from workbench.study.words import interval

from .first_order import FIELDS, Machine
from .machine import conveyor_drive
from .orbit import Drive, plan_of

Real = NDArray[np.float64]
SPEED_NAME = "speed"
#: Seed of the scrambled Sobol points, a convention: the same machines in every run.
SEED = 1
#: Probabilities between which the outcome at a point is open.
OPEN = (0.05, 0.95)
#: Largest tolerance of a part [%]: it stays above 0.
MOST_TOLERANCE = 99.0


class Plane(NamedTuple):
    """Two axes; all else is as in `machine`, which turns at `speed` [rad/s] unless x is the speed."""

    x: GridAxis
    y: GridAxis
    machine: Machine
    speed: float

    @property
    def units(self) -> dict[str, str]:
        """Those of both axes, by name."""
        return {axis.quantity: axis.unit for axis in (self.x, self.y)}

    def at(self, x: Any, y: Any) -> tuple[Machine, Any]:
        """The machine at a point, or machines at arrays of points, and its mean speed [rad/s]."""
        coordinates = {self.x.quantity: x, self.y.quantity: y}
        nu = coordinates.pop(SPEED_NAME, self.speed)
        return replace(self.machine, **{FIELDS[name]: v for name, v in coordinates.items()}), nu

    def points(self) -> tuple[Machine, Real]:
        """The machines of all points, row by row, and their mean speeds [rad/s], shape (points,)."""
        x, y = (values.ravel() for values in np.meshgrid(self.x.values, self.y.values))
        machine, nu = self.at(x, y)
        return machine, np.broadcast_to(nu, x.shape)

    def plan(
        self, o: Any, sought: Mapping[str, tuple[str, float | str]], columns: Mapping[str, str]
    ) -> Plan:
        """The orbits at all points, row by row, run as a question says, and where figures reach levels along each row."""
        grid = {axis.quantity: axis.values.tolist() for axis in (self.y, self.x)}
        low, high = self.x.values[[0, -1]].tolist()
        find = {name: Find(self.x.quantity, low, high, *level) for name, level in sought.items()}
        names = {axis.quantity: axis.quantity for axis in (self.x, self.y)}
        plan = plan_of(self.machine, o, grid, find=find, names=names, columns=columns)
        speed = {SPEED_NAME: self.speed} if SPEED_NAME not in grid else {}
        return replace(plan, fixed={**plan.fixed, **speed})


class Sample(NamedTuple):
    """Built machines of a row: the x that is worst for each, and the torque ripple [N.m] expected
    there, of shape (samples,).
    """

    position: dict[str, float]
    row: int
    x: Real
    expected: Real

    def probability(self, limit: float) -> float:
        """Share of the machines whose ripple is above the limit [N.m]; nan where none is known."""
        if np.isnan(self.expected).any():
            return float("nan")
        return float((self.expected > limit).mean())


class BuiltMachines(NamedTuple):
    """Machines like those of a plane: the co-simulated ripple of these over that of theory, of shape
    (rows, columns), and what each part's nominal value is multiplied with, of shape (samples,).
    """

    plane: Plane
    ratio: Real
    factors: Mapping[str, Real]

    @classmethod
    def within(
        cls, plane: Plane, ratio: Real, tolerances: Mapping[str, float], samples: int
    ) -> BuiltMachines:
        """As many as scrambled Sobol points, a power of 2; a tolerance of 0.05 spreads a part's
        parameter evenly over 0.95 .. 1.05 times its value.
        """
        spread = zip(tolerances.items(), Sampling("sobol", samples, SEED).cube(len(tolerances)).T)
        factors = {name: 1.0 + share * (2.0 * x - 1.0) for (name, share), x in spread}
        return cls(plane, ratio, factors)

    def at(self, row: int, x: Any, number: Any) -> tuple[Machine, Any]:
        """Some of the machines at an array of x, and their mean speeds [rad/s]."""
        machine, nu = self.plane.at(x, float(self.plane.y.values[row]))
        parts = {FIELDS[name]: factor[number] for name, factor in self.factors.items()}
        changed: dict[str, Any] = {name: vars(machine)[name] * x for name, x in parts.items()}
        return replace(machine, **changed), nu

    def sample(self, row: int, x: Real) -> Sample:
        """All machines of a row, each at its worst x."""
        machines, nu = self.at(row, x, (slice(None), None))
        ratio = np.interp(x, self.plane.x.values, self.ratio[row])
        expected = np.atleast_2d(np.abs(machines.torque_ripple(nu)) * ratio)
        position = {self.plane.x.quantity: float(x[0])} if len(x) == 1 else {}
        position[self.plane.y.quantity] = float(self.plane.y.values[row])
        return Sample(position, row, x[expected.argmax(axis=1)], expected.max(axis=1))

    def check(
        self, samples: Sequence[Sample], runs: int, limit: float, drive: Drive
    ) -> list[dict[str, Any]]:
        """Co-simulate the first machines of each sample."""
        checks = []
        for sample in samples:
            machines, nu = self.at(sample.row, sample.x[:runs], slice(runs))
            motions = drive.motions(machines, np.broadcast_to(nu, runs), 1)
            checks.append(compared_with_orbits(sample, motions.columns["tau2"].steps[0], limit))
        return checks


def on_edge(probabilities: Any, count: int) -> list[int]:
    """Numbers of places where the outcome is open, spread over them all."""
    open_ = np.flatnonzero((probabilities > OPEN[0]) & (probabilities < OPEN[1]))
    chosen = np.linspace(0, len(open_) - 1, min(count, len(open_))).round().astype(int)
    return sorted(set(open_[chosen].tolist()))


def compared_with_orbits(sample: Sample, torques: Any, limit: float) -> dict[str, Any]:
    """What co-simulation makes of the first machines of a sample, by their torque ripple; without an orbit it is nan.

    By brute force the probability lies in the interval. Where no machine has an orbit, all but the counts is nan.
    """
    steady = np.isfinite(torques)
    expected = sample.expected[: len(torques)][steady]
    ripples = torques[steady]
    hits, total = int((ripples > limit).sum()), len(ripples)
    deviation = ripples / expected - 1.0
    return {
        "place": sample.position,
        "probability": sample.probability(limit),
        "brute_force": hits / total if total else math.nan,
        "interval": interval(hits, total) if total else (math.nan, math.nan),
        "samples": total,
        "judged_above": int(((ripples > limit) & (expected <= limit)).sum()),
        "judged_below": int(((ripples <= limit) & (expected > limit)).sum()),
        "not_steady": len(torques) - total,
        "off_rms": float(np.sqrt(np.mean(deviation**2))) if total else math.nan,
        "off_max": float(np.abs(deviation).max()) if total else math.nan,
    }


def parameter(fmus: Mapping[str, Path], name: str) -> GivenValue:
    """A parameter as its FMU has it; raises SetupError for names not in FIELDS."""
    if name not in FIELDS:
        raise SetupError(f"{name!r} is not a parameter of the drive, only {', '.join(FIELDS)}")
    return parameters(conveyor_drive(fmus, {}))[name]


def axis(fmus: Mapping[str, Path], option: str, text: str, least: int) -> GridAxis:
    """Read NAME=FROM:TO:NUMBER[:log], at least so many values; raises SetupError."""
    name, _, numbers = text.partition("=")
    if name == SPEED_NAME and option != "x":
        raise SetupError(f"--{option} {text}: the speed belongs on x")
    unit = "rad/s" if name == SPEED_NAME else parameter(fmus, name).unit
    log = numbers.endswith(":log")
    given = Option(name, float, many=True, unit=unit, bounds={"above": 0.0})
    values = np.array(given.read(numbers.removesuffix(":log"), f"--{option} {name}"))
    at_least(f"--{option} number of values of {name}", len(values), least)
    if log:
        values = np.geomspace(values[0], values[-1], len(values))
    return GridAxis(name, unit, values, log)


def shares(
    fmus: Mapping[str, Path], option: str, texts: Sequence[str], default: Mapping[str, float]
) -> dict[str, float]:
    """Read NAME=PERCENT, several, over the defaults, as shares of 1; raises SetupError."""
    ripples = dict(default)
    for text in texts:
        name, _, percent = text.partition("=")
        parameter(fmus, name)
        given = Option(name, float, unit="%", bounds={"at least": 0.0, "at most": MOST_TOLERANCE})
        ripples[name] = given.read(percent, f"--{option} {name}") / 100.0
    return ripples


def span(option: str, text: str, within: GridAxis) -> tuple[float, float]:
    """Read FROM:TO inside an axis; raises SetupError."""
    given = Option(option, float, many=True, unit=within.unit)
    ends = given.read(text.replace(":", ","), f"--{option}")
    first, last = within.values[[0, -1]]
    if not first <= ends[0] < ends[-1] <= last:
        raise SetupError(
            f"--{option} {text} {within.unit} must read FROM:TO, rise and lie inside the map, "
            f"{first:g} .. {last:g} {within.unit}"
        )
    return ends[0], ends[-1]
