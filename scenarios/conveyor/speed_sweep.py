"""A table over the speed: what orbits of each speed say, beside first-order theory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench import Figure, Table
from workbench.branches import BEYOND, Branch, first_of_same
from workbench.figure import listed
from workbench.orbits import MEAN_ERROR, extrapolated, force_peaks, orbit_figure
from workbench.steady import STALLED

from .drive_orbits import CRANK_TURN, Drive, Orbits, near
from .first_order import Machine
from .machine import has_kloss_characteristic
from .orbit import DriveOrbit
from .response import (
    AT_EDGE,
    LEVEL_PASSED,
    NEED_TWO_SPEEDS,
    NOT_IN_RANGE,
    MachineLines,
    Response,
    Sought,
)

Array = NDArray[np.float64]
Row = Mapping[str, float]
#: The speeds over which the resonance of a set is swept by default, denser around it [rad/s].
SPEEDS = {
    "A": "20,24,28,30,32,33,34,35,36,36.5,37,37.5,38,38.5,39,39.5,40,40.5,41,41.5,42,43,44,45,46,"
    "48,50,54,57,60,66",
    "B": "6,8,10,12,14,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,36,38,40,43,46,50,"
    "55,60,66",
}
#: Damping ratio above which torque over load, 1 / (1 - x^2 + 2 i zeta x), has no peak at any x > 0.
LARGEST_PEAKED_ZETA = math.sqrt(0.5)
FOLD = "one of two steady motions ends between {:.4g} and {:.4g} rad/s, and the ripple jumps there"
#: Most speeds that a sentence names one by one; a convention.
MOST_NAMED = 3
UNITS = {
    "nu": "rad/s", "w2": "rad/s", "w2_error": "rad/s", "w2_phase": "deg", "tau2": "N.m",
    "tau2_error": "N.m", "tau2_phase": "deg", "w2_theory": "rad/s", "w2_phase_theory": "deg",
    "tau2_theory": "N.m", "tau2_phase_theory": "deg", "lag": "deg", "lag_error": "deg",
    "w_mean": "rad/s", "w_mean_error": "rad/s", "f_rod_peak": "N", "f_rod_peak_error": "N",
}  # fmt: skip


def columns_of(drive: Drive, machine: Machine, nu: Array, orbits: Orbits) -> dict[str, Array]:
    """Return what orbits of shape (multiples, n) say of machines at speeds, beside theory, in UNITS, shape (n,) each.

    It is nan where there is no orbit, and for errors that are not known.
    """
    columns = {"nu": nu}
    theory: dict[str, Array] = {}
    for name, amplitudes, left, expected in (
        ("w2", orbits.speed, orbits.speed_error, machine.speed_ripple(nu)),
        ("tau2", orbits.torque, orbits.torque_error, machine.torque_ripple(nu)),
    ):
        value, error = extrapolated(amplitudes, drive.convergence_order, left)
        phase = np.angle(value, deg=True)
        columns |= {name: np.abs(value), f"{name}_error": error, f"{name}_phase": phase}
        phase = np.angle(expected, deg=True)
        theory |= {f"{name}_theory": np.abs(expected), f"{name}_phase_theory": phase}
    lag = np.angle(machine.load_ripple(nu), deg=True) - columns["tau2_phase"]
    with np.errstate(all="ignore"):
        lag_error = np.degrees(columns["tau2_error"] / columns["tau2"])
    mean, mean_error = extrapolated(orbits.mean, drive.convergence_order, MEAN_ERROR * orbits.mean)
    force, force_error = force_peaks(orbits.waveform).largest()
    return columns | theory | {
        "lag": lag % 360.0,
        "lag_error": np.where(np.isfinite(lag_error), lag_error, np.nan),
        "w_mean": mean,
        "w_mean_error": mean_error,
        "f_rod_peak": force,
        "f_rod_peak_error": force_error,
    }  # fmt: skip


def run_sweeps(drive: Drive, lines: MachineLines) -> list[SpeedSweep]:
    """Run the orbits of all lines of speeds together, and return what they say of each line.

    Of a motor whose characteristic is no line every branch of its motions is run. The sweep then has, at each speed,
    the motion with the largest torque ripple.
    """
    found = [Branch(k, x, near(*lines.at(x, k)), (BEYOND, BEYOND)) for k, x in lines.swept.items()]
    if has_kloss_characteristic(lines.at(found[0].x, found[0].line)[0]):
        found = branches_of(drive, lines)
        for k, x in lines.swept.items():  # what has no motion is run to say why
            if len(lost := np.setdiff1d(x, [y for b in found if b.line == k for y in b.x])):
                found.append(Branch(k, lost, near(*lines.at(lost, k)), (BEYOND, BEYOND)))
    line_of = np.array([b.line for b in found])
    of_branches = MachineLines(
        lambda x, k: lines.at(x, line_of[k]), {k: b.x for k, b in enumerate(found)}
    )
    number = np.repeat(np.arange(len(found)), [len(b.x) for b in found])
    nus = np.concatenate([b.x for b in found])
    states = np.repeat(np.concatenate([b.states for b in found])[None], drive.multiples, axis=0)
    orbits = drive.orbits(*of_branches.at(drive.for_each_step(nus), number), "sweep", states=states)
    columns = columns_of(drive, *of_branches.at(nus, number), orbits)
    every = SpeedSweep(drive, of_branches, 0, orbits, columns)
    is_own = first_of_same([*zip(line_of[number].tolist(), nus.tolist())], orbits.states[0])
    parts = [
        replace(every[np.flatnonzero((number == k) & is_own)], line=k, ends=b.ends)
        for k, b in enumerate(found)
    ]
    sweeps = []
    for key, x in lines.swept.items():
        some = np.flatnonzero(line_of[number] == key)
        height = np.nan_to_num(columns["tau2"][some], nan=-1.0)
        worst = [some[np.argmax(np.where(nus[some] == nu, height, -2.0))] for nu in x]
        several = tuple(part for part, b in zip(parts, found) if b.line == key and part.is_steady)
        line = int(number[worst[0]])
        sweeps.append(
            replace(every[worst], line=line, branches=several if are_side_by_side(several) else ())
        )
    return sweeps


def are_side_by_side(branches: Sequence[SpeedSweep]) -> bool:
    """Whether a branch begins before another has ended; between others there is a gap without any motion."""
    spans = sorted(branch.span for branch in branches)
    return any(after[0] < before[1] for before, after in pairwise(spans))


def branches_of(drive: Drive, lines: MachineLines) -> list[Branch]:
    """Return the branches of the motions of induction motors, on lines of their numbers."""
    places = [(k, x) for k, swept in lines.swept.items() for x in swept.tolist()]
    machines = [lines.at(x, k) for k, x in places]
    good = [j for j, (machine, _) in enumerate(machines) if np.isfinite(machine.B)]
    asked = [DriveOrbit.of(machines[j][0], drive, machines[j][1]) for j in good]
    found = CRANK_TURN.branches(drive.context, asked) if asked else []
    return [b._replace(line=places[good[numbers[0]]][0]) for numbers, b in found]


@dataclass(frozen=True)
class SpeedSweep:
    """Orbits of a drive at the speeds of a sweep, with all step multiples.

    Attributes
    ----------
    drive : Drive
        How they were run.
    lines : MachineLines
        The machine at each speed, on one of several lines.
    line : int
        The number of the line.
    orbits : Orbits
        Shape (multiples, speeds).
    columns : dict
        What the orbits say, by the names of UNITS, shape (speeds,) each.
    branches : tuple of SpeedSweep
        The branches of its motions where there are several; at each speed the sweep then has the motion of the one with
        the largest torque ripple.
    ends : pair
        Between which two speeds below, and above, a branch ends; nan where the sweep does.
    """

    drive: Drive
    lines: MachineLines
    line: int
    orbits: Orbits
    columns: Mapping[str, Array]
    branches: tuple[SpeedSweep, ...] = ()
    ends: tuple[tuple[float, float], tuple[float, float]] = (BEYOND, BEYOND)

    def __getitem__(self, rows: Any) -> SpeedSweep:
        """Return some rows of the sweep."""
        columns = {name: x[rows] for name, x in self.columns.items()}
        return replace(self, orbits=self.orbits[:, rows], columns=columns)

    @cached_property
    def speeds(self) -> tuple[float, ...]:
        """Nominal mean speeds [rad/s]."""
        return tuple(self.columns["nu"].tolist())

    def machine(self, nu: Any) -> Machine:
        """The machine at speeds [rad/s]."""
        return self.lines.at(nu, self.line)[0]

    def with_more(self, speeds: Sequence[float]) -> SpeedSweep:
        """Return the sweep with orbits at more speeds."""
        (more,) = run_sweeps(self.drive, MachineLines(self.lines.at, {self.line: np.array(speeds)}))
        order = np.argsort([*self.speeds, *speeds])
        columns = {name: np.append(x, more.columns[name]) for name, x in self.columns.items()}
        orbits = self.orbits.beside(more.orbits)
        return replace(self, orbits=orbits, columns=columns)[order]

    def at(self, speeds: Sequence[float]) -> SpeedSweep:
        """Return the sweep over some of its speeds, and its branches over those that they have."""
        parts = (b.at([nu for nu in speeds if nu in b.speeds]) for b in self.branches)
        some = self[[self.speeds.index(nu) for nu in speeds]]
        return replace(some, branches=tuple(b for b in parts if b.speeds))

    @property
    def is_steady(self) -> bool:
        """Whether any of its speeds has a steady orbit."""
        return bool(np.isfinite(self.columns["tau2"]).any())

    @property
    def parts(self) -> tuple[SpeedSweep, ...]:
        """The branches of its motions; the sweep itself where there is one."""
        return self.branches or (self,)

    @property
    def response(self) -> Response:
        """Load over response, by the orbits with the shortest step."""
        lines = MachineLines(self.lines.at, {self.line: self.columns["nu"]})
        return Response(lines, self.line, self.orbits[0])

    def lag(self) -> Sought:
        """Return where the torque ripple lags its load by 90 degrees, at the least speed of all branches."""
        found = [part.response.lag() for part in self.parts]
        there = [sought for sought in found if not sought.reason]
        return min(there, key=lambda sought: sought.x) if there else found[0]

    def peak(self, quantity: int) -> Sought:
        """Return where the ripple of a quantity is largest; where a branch ends there, the reason against a peak."""
        return self._highest(quantity)[1]

    def _highest(self, quantity: int) -> tuple[float, Sought]:
        """The largest ripple of all branches, and where it is."""
        highest = [(*part.response.highest(quantity), part) for part in self.parts]
        height, sought, part = max(highest, key=lambda x: x[0])
        fold = part.ends[0 if sought.x == part.speeds[0] else 1]
        if sought.reason == AT_EDGE and not math.isnan(fold[0]):
            sought = sought._replace(reason=FOLD.format(*fold))
        return height, sought

    def passed(self, level: float) -> list[Sought]:
        """Return where the largest torque ripple of all branches passes a level [N.m], in order."""
        if not self.branches:
            return self.response.passed(level)
        above = [x for part in self.branches for x in part.stretches_above(level)]
        above.sort(key=lambda stretch: stretch[0].x)
        joined = above[:1]
        for first, last in above[1:]:
            if first.x > joined[-1][1].x:
                joined.append((first, last))
            elif last.x > joined[-1][1].x:
                joined[-1] = (joined[-1][0], last)
        return [end for pair in joined for end in pair if math.isfinite(end.x)]

    def stretches_above(self, level: float) -> list[tuple[Sought, Sought]]:
        """Return the ends of the stretches in which the torque ripple is above a level, infinite where the sweep ends."""
        ends, above = self.response.passed(level), self.columns["tau2"] > level
        if above[0]:
            ends.insert(0, self._end(0, -1.0))
        if above[-1]:
            ends.append(self._end(1, 1.0))
        return list(zip(ends[::2], ends[1::2]))

    @property
    def span(self) -> tuple[float, float]:
        """The speeds between which a branch lies, where it ends by the middle of what is known of its end."""
        first, last = (sum(fold) / 2.0 for fold in self.ends)
        return (
            self.speeds[0] if math.isnan(first) else first,
            self.speeds[-1] if math.isnan(last) else last,
        )

    def _end(self, side: int, sense: float) -> Sought:
        """The end of a branch on one side, as a place where the ripple passes a level."""
        fold = self.ends[side]
        if math.isnan(fold[0]):
            return Sought(LEVEL_PASSED[sense], self.line, x=sense * math.inf, sense=sense)
        why = FOLD.format(*fold)
        return Sought(LEVEL_PASSED[sense], self.line, x=sum(fold) / 2.0, sense=sense, reason=why)

    @cached_property
    def rows(self) -> list[Row]:
        """What the orbits say, speed by speed."""
        return [
            dict(zip(self.columns, row))
            for row in zip(*map(np.ndarray.tolist, self.columns.values()))
        ]

    @property
    def table(self) -> Table:
        """The same as a table."""
        return Table(self.columns, UNITS)

    @property
    def motions(self) -> Table:
        """All motions at speeds that have several of them, those of the largest torque ripple first."""
        import pandas as pd

        frames = [
            part.table.frame.assign(multiplier=part.orbits.contraction[0]) for part in self.branches
        ]
        every = pd.concat(frames).sort_values(["nu", "tau2"], ascending=[True, False])
        several = every[every.duplicated("nu", keep=False)]
        return Table.of_frame(several, {**UNITS, "multiplier": "1"})

    @property
    def stalled(self) -> list[float]:
        """The speeds at which the motor does not take the crank through a turn, with the shortest step."""
        return [nu for nu, why in zip(self.speeds, self.orbits.problem[0]) if why == STALLED]

    @property
    def unsteady(self) -> list[float]:
        """The other speeds without a steady orbit."""
        lost = [nu for nu, x in zip(self.speeds, self.columns["tau2"].tolist()) if math.isnan(x)]
        return [nu for nu in lost if nu not in self.stalled]

    def problems(self) -> dict[float, str]:
        """Return why orbits are missing, with any of the steps, by speed."""
        of_each = zip(self.speeds, self.orbits.problem.T.tolist())
        found = {nu: next(filter(None, reasons), "") for nu, reasons in of_each}
        return {nu: why for nu, why in found.items() if why}

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
            is_some = np.isfinite(self.columns["tau2"]).any()
            return figure._replace(reason=why + f", and {NEED_TWO_SPEEDS}" * bool(is_some))
        if figure.reason == NOT_IN_RANGE or (figure.reason == AT_EDGE and ends):
            return figure._replace(reason=f"{why}, and the other speeds do not show it")
        return figure

    def force_figure(self) -> Figure:
        """Return the largest rod force of the sweep."""
        force, error = (self.columns[x] for x in ("f_rod_peak", "f_rod_peak_error"))
        # not a number where any is not known
        value, reach = float(force.max()), float((force + error).max())
        why = self.no_orbit(list(self.problems())[:1])
        return orbit_figure(value, reach - value, "N", "largest rod force of the sweep", why)


def no_orbit(problem: str, nu: float) -> str:
    """Return why there is no orbit at a nominal speed, in a sentence."""
    what = "the motor stalls" if problem == STALLED else "no steady orbit is found"
    return f"{what} at {nu:g} rad/s"


def row_figure(row: Row, column: str, meaning: str, why: str = "") -> Figure:
    """Return a column of a row that has an error beside it, as a figure; `why` says why there is no orbit."""
    value, error, nu = (row[name] for name in (column, f"{column}_error", "nu"))
    why = why or f"no steady orbit is found at {nu:g} rad/s"
    return orbit_figure(value, error, UNITS[column], meaning, why)
