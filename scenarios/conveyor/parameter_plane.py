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
from scipy.stats import qmc

from cosim import SetupError
from workbench.answer import GivenValue, Table, parameters
from workbench.charts.model import GridAxis
from workbench.options import at_least
from workbench.plan import GridPlan
from workbench.study.words import interval

from .drive_orbits import Drive, Orbits
from .first_order import FIELDS, Machine
from .machine import conveyor_drive
from .orbit import DriveOrbit
from .response import MachineLines

Real = NDArray[np.float64]
SPEED_NAME = "speed"
#: Seed of the scrambled Sobol points, a convention: the same machines in every run.
SEED = 1
#: Probabilities between which the outcome at a point is open.
OPEN = (0.05, 0.95)
#: A safety margin by convention.
MARGIN = 3.0


class ParameterAxis(NamedTuple):
    """A parameter and its values."""

    name: str
    along: GridAxis


class Plane(NamedTuple):
    """Two axes; all else is as in `machine`, which turns at `speed` [rad/s] unless x is the speed."""

    x: ParameterAxis
    y: ParameterAxis
    machine: Machine
    speed: float

    @property
    def units(self) -> dict[str, str]:
        """Those of both axes, by name."""
        return {axis.name: axis.along.unit for axis in (self.x, self.y)}

    def at(self, x: Any, y: Any) -> tuple[Machine, Any]:
        """The machine at a point, or machines at arrays of points, and its mean speed [rad/s]."""
        coordinates = {self.x.name: x, self.y.name: y}
        nu = coordinates.pop(SPEED_NAME, self.speed)
        return replace(self.machine, **{FIELDS[name]: v for name, v in coordinates.items()}), nu

    def nodes(self) -> list[tuple[float, float]]:
        """Coordinates x and y of all points, row by row."""
        x, y = self.x.along.values.tolist(), self.y.along.values.tolist()
        return [(column, level) for level in y for column in x]

    def points(self) -> tuple[Machine, Real]:
        """The machines of these and their mean speeds [rad/s], shape (points,)."""
        x, y = np.transpose(self.nodes())
        machine, nu = self.at(x, y)
        return machine, np.broadcast_to(nu, x.shape)

    def plan(self, drive: Drive) -> GridPlan:
        """The turns of all points, row by row."""
        grid = {axis.name: axis.along.values.tolist() for axis in (self.y, self.x)}
        base = DriveOrbit.of(self.machine, drive, self.speed)
        options = {name: getattr(base, name) for name in ("speed", "algorithm", "steps_per_rev")}
        fixed = {name: x for name, x in {**options, **base.start}.items() if name not in grid}
        return GridPlan(DriveOrbit, fixed, grid)

    @property
    def lines_of_rows(self) -> MachineLines:
        """The machines of equal y, a line for each."""
        x, y = self.x.along.values, self.y.along.values
        return MachineLines(lambda at, line: self.at(at, y[line]), dict.fromkeys(range(len(y)), x))


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
        columns = qmc.Sobol(len(tolerances), rng=SEED).random(samples).T
        spread = zip(tolerances.items(), columns)
        factors = {name: 1.0 + share * (2.0 * x - 1.0) for (name, share), x in spread}
        return cls(plane, ratio, factors)

    def at(self, row: int, x: Any, number: Any) -> tuple[Machine, Any]:
        """Some of the machines at an array of x, and their mean speeds [rad/s]."""
        machine, nu = self.plane.at(x, float(self.plane.y.along.values[row]))
        parts = {FIELDS[name]: factor[number] for name, factor in self.factors.items()}
        changed: dict[str, Any] = {name: vars(machine)[name] * x for name, x in parts.items()}
        return replace(machine, **changed), nu

    def sample(self, row: int, x: Real) -> Sample:
        """All machines of a row, each at its worst x."""
        machines, nu = self.at(row, x, (slice(None), None))
        ratio = np.interp(x, self.plane.x.along.values, self.ratio[row])
        expected = np.atleast_2d(np.abs(machines.torque_ripple(nu)) * ratio)
        position = {self.plane.x.name: float(x[0])} if len(x) == 1 else {}
        position[self.plane.y.name] = float(self.plane.y.along.values[row])
        return Sample(position, row, x[expected.argmax(axis=1)], expected.max(axis=1))

    def check(
        self, samples: Sequence[Sample], runs: int, limit: float, drive: Drive
    ) -> list[dict[str, Any]]:
        """Co-simulate the first machines of each sample."""
        checks = []
        for sample in samples:
            machines, nu = self.at(sample.row, sample.x[:runs], slice(runs))
            speeds = np.broadcast_to(nu, (1, runs))
            (torques,) = drive.orbits(machines, speeds, "check of the probability").torque
            checks.append(compared_with_orbits(sample, torques, limit))
        return checks


def torque_ripple(orbits: Orbits) -> Real:
    """The torque ripple of orbits, order 2 [N.m]."""
    return np.abs(orbits.torque)


def run_plane(
    plane: Plane, drive: Drive, csv: str, figures: Mapping[str, str], **axes: str
) -> tuple[Table, Orbits]:
    """Run a drive at all points of a plane, whose rows are kept on the way.

    Parameters
    ----------
    plane, drive
        Its machines, and how they are run.
    csv
        The file of the table.
    figures
        Those of `DriveOrbit`, and what they are called in the table.
    axes
        What the axes are called there, by "x" and "y", by default as they are.

    Raises
    ------
    SetupError
        If no orbit is steady.
    """
    inputs = {x.name: axes.get(key, x.name) for key, x in (("x", plane.x), ("y", plane.y))}
    table, found = plane.plan(drive).table(drive.context, csv, inputs, figures)
    orbits = Orbits.of_motions([x.data[0] for x in found])
    if np.isnan(orbits.contraction).all():
        raise SetupError("no orbit of the map is steady")
    return table, orbits


def extreme(values: Real, errors: Real, sense: float = 1.0) -> tuple[float, float]:
    """Return the largest of values, or with a sense of -1 the least, and its error, which reaches as far as any does.

    An error that is not known counts as MARGIN times the largest that is.
    """
    if np.isnan(errors).all():
        return math.nan, math.nan
    reach = sense * values + np.where(np.isnan(errors), MARGIN * np.nanmax(errors), errors)
    best = float(np.nanmax(sense * values))
    return sense * best, float(np.nanmax(reach)) - best


def on_edge(probabilities: Any, count: int) -> list[int]:
    """Numbers of places where the outcome is open, spread over them all."""
    open_ = np.flatnonzero((probabilities > OPEN[0]) & (probabilities < OPEN[1]))
    chosen = np.linspace(0, len(open_) - 1, min(count, len(open_))).round().astype(int)
    return sorted({int(open_[k]) for k in chosen})


def compared_with_orbits(sample: Sample, torques: Any, limit: float) -> dict[str, Any]:
    """What co-simulation makes of the first machines of a sample, by their torque ripple; without an orbit it is nan.

    By brute force the probability lies in the interval. Where no machine has an orbit, all but the counts is nan.
    """
    steady = np.isfinite(torques)
    expected = sample.expected[: len(torques)][steady]
    ripples = np.abs(torques)[steady]
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


def axis(fmus: Mapping[str, Path], option: str, text: str, least: int) -> ParameterAxis:
    """Read NAME=FROM:TO:NUMBER[:log], at least so many values; raises SetupError."""
    name, _, numbers = text.partition("=")
    if name == SPEED_NAME and option != "x":
        raise SetupError(f"--{option} {text}: the speed belongs on x")
    label, unit = "operating speed", "rad/s"
    if name != SPEED_NAME:
        _, unit, meaning = parameter(fmus, name)
        label = f"{meaning[:1].lower()}{meaning[1:]}\n{name}"
    log = numbers.endswith(":log")
    form = "NAME=FROM:TO:NUMBER or NAME=FROM:TO:NUMBER:log"
    low, high, number = read(option, text, numbers.removesuffix(":log"), form, float, float, int)
    for value in (low, high):
        if not 0.0 < value < math.inf:
            raise SetupError(
                f"--{option} {name} = {value!r} {unit} must be a finite number above 0"
            )
    if high <= low:
        raise SetupError(f"--{option} {name} must rise: {low:g} .. {high:g} {unit} does not")
    at_least(f"--{option} number of values of {name}", number, least)
    values = np.geomspace(low, high, number) if log else np.linspace(low, high, number)
    return ParameterAxis(name, GridAxis(label, unit, values, log))


def shares(
    fmus: Mapping[str, Path], option: str, texts: Sequence[str], default: Mapping[str, float]
) -> dict[str, float]:
    """Read NAME=PERCENT, several, over the defaults, as shares of 1; raises SetupError."""
    ripples = dict(default)
    for text in texts:
        name, _, percent = text.partition("=")
        parameter(fmus, name)
        (value,) = read(option, text, percent, "NAME=PERCENT", float)
        ripples[name] = value / 100.0
        if not 0.0 <= ripples[name] < 1.0:
            raise SetupError(f"--{option} {name} = {value!r} % must be at least 0 and below 100")
    return ripples


def span(option: str, text: str, within: GridAxis) -> tuple[float, float]:
    """Read FROM:TO inside an axis; raises SetupError."""
    low, high = read(option, text, text, "FROM:TO", float, float)
    first, last = within.values[[0, -1]]
    if not first <= low < high <= last:
        raise SetupError(
            f"--{option} {low:g}:{high:g} {within.unit} must rise and lie inside the map, "
            f"{first:g} .. {last:g} {within.unit}"
        )
    return low, high


def read(option: str, text: str, numbers: str, form: str, *kinds: type) -> list[Any]:
    """Numbers between colons; raises SetupError for others than these kinds of them."""
    try:
        return [kind(number) for kind, number in zip(kinds, numbers.split(":"), strict=True)]
    except ValueError:
        raise SetupError(f"--{option} {text!r} must read {form}") from None
