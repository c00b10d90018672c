"""A table over the speed: what orbits of each speed say, beside first-order theory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from cosim import CONVERGENCE_ORDERS
from cosim.accuracy.extrapolation import extrapolate
from workbench import Figure, Table
from workbench.figure import listed
from workbench.periodic import STALLED

from .features import (
    AT_EDGE,
    NEED_TWO_SPEEDS,
    NOT_IN_RANGE,
    SPEED_PEAK,
    TORQUE_PEAK,
    ResponseLine,
    Sweep,
)
from .first_order import Machine
from .orbits import OperatingPoint, Orbit, OrbitRunner, largest_force

if TYPE_CHECKING:
    from pandas import DataFrame, Series

Row = dict[str, float]
#: The speeds over which the resonance of a set is swept by default, denser around it [rad/s].
SPEEDS = {
    "A": "20,24,28,30,32,33,34,35,36,36.5,37,37.5,38,38.5,39,39.5,40,40.5,41,41.5,42,43,44,45,46,"
    "48,50,54,57,60,66",
    "B": "6,8,10,12,14,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,36,38,40,43,46,50,"
    "55,60,66",
}
#: Operating speeds of the sets [rad/s].
OPERATING = {"A": 40.0, "B": 60.0}
#: Damping ratio above which torque over load, 1 / (1 - x^2 + 2 i zeta x), has no peak at any x > 0.
LARGEST_PEAKED_ZETA = math.sqrt(0.5)
#: Relative error of the mean speed of an orbit, which settling leaves.
MEAN_SPEED_ERROR = 2e-9
#: Most speeds that a sentence names one by one; a convention.
MOST_NAMED = 3
NO_COUPLING_ERROR = "the coupling error is not known; take more steps per revolution"
UNITS = {
    "nu": "rad/s", "w2": "rad/s", "w2_error": "rad/s", "w2_phase": "deg", "tau2": "N.m",
    "tau2_error": "N.m", "tau2_phase": "deg", "w2_theory": "rad/s", "w2_phase_theory": "deg",
    "tau2_theory": "N.m", "tau2_phase_theory": "deg", "lag": "deg", "lag_error": "deg",
    "w_mean": "rad/s", "w_mean_error": "rad/s", "f_rod_peak": "N", "f_rod_peak_error": "N",
}  # fmt: skip


@dataclass(frozen=True)
class SpeedSweep:
    """Orbits of a drive at the speeds of a sweep, with all step multiples.

    Attributes
    ----------
    runner : OrbitRunner
        How they were run.
    line : ResponseLine
        The machine at each speed.
    speeds : tuple of float
        Nominal mean speeds [rad/s].
    orbits : tuple of sequence of Orbit
        For each speed the orbits with 1, 2, 4 times the step.
    """

    runner: OrbitRunner
    line: ResponseLine
    speeds: tuple[float, ...]
    orbits: tuple[Sequence[Orbit], ...]

    @cached_property
    def rows(self) -> list[Row]:
        """What the orbits of each speed say."""
        order = CONVERGENCE_ORDERS[self.runner.algorithm]
        return [
            speed_row(self.line.at(nu)[0], orbits, order)
            for nu, orbits in zip(self.speeds, self.orbits)
        ]

    @cached_property
    def frame(self) -> DataFrame:
        """The rows as a frame whose columns are those of UNITS."""
        return self.table.frame

    @cached_property
    def table(self) -> Table:
        """The rows as a table."""
        return Table.of_rows([list(row.values()) for row in self.rows], UNITS)

    @property
    def steady(self) -> Sweep:
        """Speeds and orbits with the shortest step that are steady, and say something of load over response.

        A load ripple of exactly 0 leaves no ripple, and says nothing.
        """
        return [
            (nu, orbits[0])
            for nu, orbits in zip(self.speeds, self.orbits)
            if abs(orbits[0].torque) > 0.0
        ]

    @property
    def stalled(self) -> list[float]:
        """The speeds at which the motor does not take the crank through a turn, with the shortest step."""
        return [nu for nu, orbits in zip(self.speeds, self.orbits) if orbits[0].problem == STALLED]

    @property
    def unsteady(self) -> list[float]:
        """The other speeds without a steady orbit."""
        lost = [nu for nu, row in zip(self.speeds, self.rows) if math.isnan(row["tau2"])]
        return [nu for nu in lost if nu not in self.stalled]

    def named(self, speeds: Sequence[float]) -> str:
        """Return speeds of the sweep in words, by their number where they are many."""
        if len(speeds) == len(self.speeds) > 1:
            return "every speed of the sweep"
        if len(speeds) > MOST_NAMED:
            return f"{len(speeds)} of the {len(self.speeds)} speeds"
        return f"{listed([f'{nu:.4g}' for nu in speeds])} rad/s"

    def no_orbit(self, speeds: Sequence[float] | None = None) -> str:
        """Return why those of the speeds that have no steady orbit, by default all, have none; "" without any."""
        reasons = {"the motor stalls": self.stalled, "no steady orbit is found": self.unsteady}
        return listed([
            f"{reason} at {self.named(those)}"
            for reason, lost in reasons.items()
            if (those := [nu for nu in lost if speeds is None or nu in speeds])
        ])  # fmt: skip

    def explained(self, figure: Figure) -> Figure:
        """Return a feature of the response, refused for the orbits that the sweep lacks where it is for these."""
        why = self.no_orbit()
        ends = self.no_orbit((self.speeds[0], self.speeds[-1]))
        if figure.error is not None or not why:
            return figure
        if figure.reason == NEED_TWO_SPEEDS:
            found = (
                ""
                if all(math.isnan(row["tau2"]) for row in self.rows)
                else f", and {NEED_TWO_SPEEDS}"
            )
            return figure._replace(reason=f"{why}{found}")
        if figure.reason == NOT_IN_RANGE or (figure.reason == AT_EDGE and ends):
            return figure._replace(reason=f"{why}, and the other speeds do not show it")
        return figure

    def at(self, nu: float) -> Series[float]:
        """Return the row of a speed of the sweep."""
        return self.frame.iloc[self.speeds.index(nu)]

    def force_figure(self) -> Figure:
        """Return the largest rod force of the sweep."""
        nu = next(
            (nu for nu, orbits in zip(self.speeds, self.orbits) if any(x.problem for x in orbits)),
            self.speeds[0],
        )
        value, error = largest_force(self.orbits)
        meaning = "largest rod force of the sweep"
        return orbit_figure(value, error, "N", meaning, self.no_orbit((nu,)))


def sweep_speeds(
    runner: OrbitRunner, line: ResponseLine, speeds: Sequence[float], step_multiples: Sequence[int]
) -> SpeedSweep:
    """Run the orbits of speeds with all step multiples, those with the longest step first."""
    points = [line.point(nu, k) for k in reversed(step_multiples) for nu in speeds]
    orbits = list(runner.each(points, "sweep"))
    by_multiple = [orbits[k : k + len(speeds)] for k in range(0, len(orbits), len(speeds))]
    return SpeedSweep(runner, line, tuple(speeds), tuple(zip(*reversed(by_multiple))))


def rows_of(
    machines: Sequence[tuple[Machine, float]], runner: OrbitRunner, step_multiples: Sequence[int]
) -> Iterator[Row]:
    """Yield the rows of machines at mean speeds."""
    points = [OperatingPoint(*operating, k) for operating in machines for k in step_multiples]
    orbits = runner.orbits(points, "orbits")
    for machine, _ in machines:
        multiples = list(islice(orbits, len(step_multiples)))
        yield speed_row(machine, multiples, CONVERGENCE_ORDERS[runner.algorithm])


def speed_row(machine: Machine, orbits: Sequence[Orbit], order: float) -> Row:
    """Return what orbits of one speed with 1, 2, 4 times the step say, beside theory, in UNITS.

    It is nan where there is no orbit, and for errors that are not known.
    """
    nu, deg = orbits[0].nu, partial(np.angle, deg=True)
    row: Row = {"nu": nu}
    theory: Row = {}
    for name, feature in (("w2", SPEED_PEAK), ("tau2", TORQUE_PEAK)):
        amplitude, error = extrapolated([feature.amplitude(orbit) for orbit in orbits], order)
        error += 2.0 * feature.settling_error(orbits[0])
        row |= {name: abs(amplitude), f"{name}_error": error, f"{name}_phase": deg(amplitude)}
        expected = feature.theory(machine, nu)
        theory |= {f"{name}_theory": abs(expected), f"{name}_phase_theory": deg(expected)}
    mean, mean_error = extrapolated([orbit.mean for orbit in orbits], order)
    force, force_error = largest_force([orbits])
    return row | theory | {
        "lag": (deg(machine.load_ripple(nu)) - deg(amplitude)) % 360.0,
        "lag_error": math.degrees(error / abs(amplitude)) if amplitude else math.nan,
        "w_mean": mean.real,
        "w_mean_error": mean_error + MEAN_SPEED_ERROR * orbits[0].mean,
        "f_rod_peak": force,
        "f_rod_peak_error": force_error,
    }  # fmt: skip


def extrapolated(values: Sequence[complex], order: float) -> tuple[complex, float]:
    """Return where values at steps h, 2 h, 4 h go, and the error of that, nan where it is not known."""
    parts = [
        extrapolate(part, order)
        for part in ([complex(x).real for x in values], [complex(x).imag for x in values])
    ]
    errors = [math.nan if part.error is None else part.error for part in parts]
    return complex(parts[0].value, parts[1].value), math.hypot(*errors)


def no_orbit(orbit: Orbit) -> str:
    """Return why there is no orbit at its nominal speed, in a sentence."""
    what = "the motor stalls" if orbit.problem == STALLED else "no steady orbit is found"
    return f"{what} at {orbit.nu:g} rad/s"


def orbit_figure(value: float, error: float, unit: str, meaning: str, why: str) -> Figure:
    """Return a figure of an orbit, refused where the error is not known; `why` says why there is no orbit."""
    if math.isnan(error):
        reason = why if math.isnan(value) else NO_COUPLING_ERROR
        return Figure.undetermined(unit, reason, meaning)
    return Figure(value, unit, error, meaning)


def row_figure(
    row: Mapping[str, float] | Series[float], column: str, meaning: str, why: str = ""
) -> Figure:
    """Return a column of a row that has an error beside it, as a figure; `why` says why there is no orbit."""
    value, error, nu = (float(row[name]) for name in (column, f"{column}_error", "nu"))
    why = why or f"no steady orbit is found at {nu:g} rad/s"
    return orbit_figure(value, error, UNITS[column], meaning, why)
