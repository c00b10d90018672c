"""The orbits of a drive over the speed, branch by branch, and the features of its response: 90 degrees lag, largest ripples,
limits passed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.accuracy.limit import UNCONFIRMED_FACTOR
from workbench import Context, Figure, Table
from workbench.branches import BEYOND, first_of_same
from workbench.figure import listed
from workbench.find import Find, Found, LineSearch, search
from workbench.orbits import Motions, orbit_figure
from workbench.steady import STALLED

from .drive_orbits import CRANK_TURN
from .orbit import DriveOrbit

Array = NDArray[np.float64]
#: The speeds over which the resonance of a set is swept by default, denser around it [rad/s].
SPEEDS = {
    "A": "20,24,28,30,32,33,34,35,36,36.5,37,37.5,38,38.5,39,39.5,40,40.5,41,41.5,42,43,44,45,46,"
    "48,50,54,57,60,66",
    "B": "6,8,10,12,14,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,36,38,40,43,46,50,"
    "55,60,66",
}
#: Damping ratio above which torque over load, 1 / (1 - x^2 + 2 i zeta x), has no peak at any x > 0.
LARGEST_PEAKED_ZETA = math.sqrt(0.5)
#: Load ripple over its largest one on the line below which its phase is not defined well enough.
VANISHING = 0.02
FOLD = "one of two steady motions ends between {:.4g} and {:.4g} rad/s, and the ripple jumps there"
NEED_TWO_SPEEDS = "fewer than two speeds reached a steady state"
AT_EDGE = "the maximum lies at the edge of the swept range; extend the speeds"
NOT_IN_RANGE = "the swept range does not contain it"
PHASE_UNDEFINED = "the load ripple is almost zero {}, so its phase is undefined"
#: Most speeds that a sentence names one by one; a convention.
MOST_NAMED = 3
#: Columns of the table, and the figures in them.
COLUMNS = {
    "w2": "w2", "w2_phase": "w2_phase", "tau2": "tau2", "tau2_phase": "tau2_phase", "w2_theory": "w2_theory",
    "w2_phase_theory": "w2_phase_theory", "tau2_theory": "tau2_theory", "tau2_phase_theory": "tau2_phase_theory",
    "lag": "lag", "speed": "w_mean", "f_rod_peak": "f_rod_peak",
}  # fmt: skip
#: What is sought: its meaning, the figure, its level, and the meaning of its height.
LAG = "speed where the torque ripple lags its load by 90 deg"
PEAKS = {
    "tau2": ("speed of the largest torque ripple", "torque ripple there, order 2"),
    "w2": ("speed of the largest speed ripple", "speed ripple there, order 2"),
}
#: A level that the ripple passes falling, or rising.
PASSED = (
    "speed below which the torque ripple exceeds its limit",
    "speed above which the torque ripple exceeds its limit",
)


@dataclass(frozen=True)
class SpeedSweep:
    """Motions of a drive, one at each of several speeds.

    Attributes
    ----------
    motions : Motions
        One at each speed, by rising speed.
    branches : tuple of SpeedSweep
        The branches of its motions where there are several; at each speed the sweep then has the motion of the one with
        the largest torque ripple.
    ends : pair
        Between which two speeds below, and above, a branch ends; nan where the sweep does.
    """

    motions: Motions
    branches: tuple[SpeedSweep, ...] = ()
    ends: tuple[tuple[float, float], tuple[float, float]] = (BEYOND, BEYOND)

    def __getitem__(self, rows: Any) -> SpeedSweep:
        """Return some rows of the sweep."""
        return replace(self, motions=self.motions[rows])

    @cached_property
    def speeds(self) -> tuple[float, ...]:
        """Nominal mean speeds [rad/s]."""
        return tuple(o.nu for o in self.motions.asked)

    @cached_property
    def table(self) -> Table:
        """What the orbits say, speed by speed."""
        return self.motions.table({"nu": ("rad/s", self.speeds)}, COLUMNS)

    @property
    def columns(self) -> Mapping[str, Array]:
        """Its columns."""
        return self.table.columns

    def figure(self, name: str, k: int, meaning: str) -> Figure:
        """Return a figure at the k-th speed."""
        figure = self.motions.figure(name, k)._replace(meaning=meaning)
        return (
            figure
            if figure.error is not None
            else figure._replace(reason=self.no_orbit() or figure.reason)
        )

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
    def span(self) -> tuple[float, float]:
        """The speeds between which a branch lies, where it ends by the middle of what is known of its end."""
        first, last = (sum(fold) / 2.0 for fold in self.ends)
        return (
            self.speeds[0] if math.isnan(first) else first,
            self.speeds[-1] if math.isnan(last) else last,
        )

    def search(self, figure: str, level: float | str) -> LineSearch:
        """Return the search for a feature along the sweep, a branch."""
        speeds = np.array(self.speeds)
        sought = Find("speed", speeds[0], speeds[-1], figure, level, "all", "rad/s")
        return LineSearch.along(self.motions, sought, speeds, self.motions.states)

    @property
    def several(self) -> Table:
        """All motions at speeds that have several of them, those of the largest torque ripple first."""
        import pandas as pd

        frames = [
            part.table.frame.assign(multiplier=part.motions.multipliers) for part in self.branches
        ]
        every = pd.concat(frames).sort_values(["nu", "tau2"], ascending=[True, False])
        several = every[every.duplicated("nu", keep=False)]
        return Table.of_frame(several, {**self.table.units, "multiplier": "1"})

    @property
    def stalled(self) -> list[float]:
        """The speeds at which the motor does not take the crank through a turn."""
        return [nu for nu, why in zip(self.speeds, self.motions.problems) if why == STALLED]

    @property
    def unsteady(self) -> list[float]:
        """The other speeds without a steady orbit."""
        lost = [nu for nu, x in zip(self.speeds, self.columns["tau2"].tolist()) if math.isnan(x)]
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
            return figure._replace(
                reason=f"{why}, and {NEED_TWO_SPEEDS}" if self.is_steady else why
            )
        if figure.reason == NOT_IN_RANGE or (figure.reason == AT_EDGE and ends):
            return figure._replace(reason=f"{why}, and the other speeds do not show it")
        return figure

    def force_figure(self) -> Figure:
        """Return the largest rod force of the sweep; without an error where one without may be it, even off by so much
        as the runs differ.
        """
        force = self.motions.columns["f_rod_peak"]
        apart, best = UNCONFIRMED_FACTOR * np.ptp(force.steps, axis=0), force.value.max()
        is_known = np.isfinite(force.error) | (force.value + apart < best)
        reach = np.fmax.reduce(force.value + force.error)
        lost = [nu for nu, why in zip(self.speeds, self.motions.problems) if why]
        why = self.no_orbit(lost[:1])
        error = float(reach - best) if is_known.all() else math.nan
        return orbit_figure(float(best), error, "N", "largest rod force of the sweep", why)


def run_sweeps(context: Context, asked: Sequence[Sequence[DriveOrbit]]) -> list[SpeedSweep]:
    """Run the orbits of all lines of speeds together, and return what they say of each line.

    Of a motor whose characteristic is no line every branch of its motions is run. The sweep then has, at each speed,
    the motion with the largest torque ripple.
    """
    motions, branches = CRANK_TURN.branches(context, [o for of_line in asked for o in of_line])
    ends = np.cumsum([0, *(len(b.x) for b in branches)])
    number = {id(o): k for k, of_line in enumerate(asked) for o in of_line}
    line = np.array([number[id(o)] for o in motions.asked])
    is_own = first_of_same([(k, o.nu) for k, o in zip(line, motions.asked)], motions.states)
    parts = [
        (line[a], SpeedSweep(motions[np.arange(a, b)[is_own[a:b]]], ends=one.ends))
        for a, b, one in zip(ends, ends[1:], branches)
    ]
    sweeps = []
    for k in range(len(asked)):
        some = np.flatnonzero(line == k)
        nus = np.array([motions.asked[j].nu for j in some.tolist()])
        worst = some[CRANK_TURN.worst_of(np.searchsorted(np.unique(nus), nus), motions[some])]
        own = tuple(
            part for of_line, part in parts if of_line == k and part.speeds and part.is_steady
        )
        is_several = len(own) > 1 and are_side_by_side(own)
        sweeps.append(SpeedSweep(motions[worst], own if is_several else ()))
    return sweeps


def are_side_by_side(branches: Sequence[SpeedSweep]) -> bool:
    """Whether a branch begins before another has ended; between others there is a gap without any motion."""
    spans = sorted(branch.span for branch in branches)
    return any(after[0] < before[1] for before, after in pairwise(spans))


class Features(NamedTuple):
    """Where a torque ripple lags by 90 degrees, where both are largest, and how large, and where the torque passes a limit."""

    lag: Figure
    peaks: Mapping[str, tuple[Figure, Figure]]
    passed: Sequence[Found]


def locate(
    context: Context, sweeps: Sequence[SpeedSweep], limits: Sequence[float] = ()
) -> list[Features]:
    """Locate the features of sweeps, and where the torque ripple of each passes its limit [N.m], all together."""
    kinds: list[tuple[str, float | str]] = [("lag", 90.0), *((name, "largest") for name in PEAKS)]
    of_each = [[*kinds, *(("tau2", x) for x in limits[k : k + 1])] for k in range(len(sweeps))]
    searches = [
        [[part.search(*kind) for part in sweep.parts] for kind in own]
        for sweep, own in zip(sweeps, of_each)
    ]
    flat = [s for of_sweep in searches for of_kind in of_sweep for s in of_kind]
    found = iter(search(context, flat))
    features = []
    for k, (sweep, of_sweep) in enumerate(zip(sweeps, searches)):
        lag, torque, speed, *passed = ([(s, next(found)) for s in own] for own in of_sweep)
        peaks = {name: peak_of(sweep, name, x) for name, x in zip(PEAKS, (torque, speed))}
        ends = [passed_of(sweep, limits[k], [x for _, x in own]) for own in passed]
        features.append(Features(lag_of(sweep, lag), peaks, ends[0] if ends else []))
    return features


FoundBy = tuple[LineSearch, Sequence[Found]]


def lag_of(sweep: SpeedSweep, found: Sequence[FoundBy]) -> Figure:
    """Return where the torque ripple lags its load by 90 degrees, at the least speed of all branches."""
    return sweep.explained(first_lag(found))


def first_lag(found: Sequence[FoundBy]) -> Figure:
    """Return the least place of searches on all branches, or why there is none."""
    there = [(s, x) for s, of_part in found for x in of_part if math.isfinite(x.x)]
    if not there:
        reason = NEED_TWO_SPEEDS if all(len(s.seen) <= 1 for s, _ in found) else NOT_IN_RANGE
        return Figure.undetermined("rad/s", reason, LAG)
    s, first = min(there, key=lambda pair: pair[1].x)
    load = np.abs(s.guide.load(np.append(s.fine(s.seen), first.x)))
    if load[-1] < VANISHING * load.max():
        return Figure.undetermined("rad/s", PHASE_UNDEFINED.format("there"), LAG)
    return first.place._replace(meaning=LAG)


def peak_of(sweep: SpeedSweep, name: str, found: Sequence[FoundBy]) -> tuple[Figure, Figure]:
    """Return where a ripple is largest, and how large; where a branch ends there, the reason against a peak."""
    meaning, of_height = PEAKS[name]
    (s, (top,)), part = max(zip(found, sweep.parts), key=lambda pair: pair[0][0].highest)
    place, height = top.place, top.height
    assert height is not None
    if len(s.seen) <= 1:
        place = place._replace(reason=NEED_TWO_SPEEDS)
    elif s.reason:
        fold = part.ends[0 if top.x <= part.speeds[0] else 1]
        place = place._replace(reason=AT_EDGE if math.isnan(fold[0]) else FOLD.format(*fold))
    place = sweep.explained(place._replace(meaning=meaning))
    height = height._replace(unit=sweep.motions.columns[name].unit, meaning=of_height)
    return place, height._replace(reason=place.reason)


def passed_of(sweep: SpeedSweep, limit: float, found: Sequence[Sequence[Found]]) -> list[Found]:
    """Return where the largest torque ripple of all branches passes a limit, in order."""
    above: list[tuple[Found, Found]] = []
    for part, of_part in zip(sweep.parts, found):
        ends = [x for x in of_part if math.isfinite(x.x)]
        if not ends and not part.is_steady:
            continue
        levels = part.columns["tau2"] > limit
        seen = np.isfinite(part.columns["tau2"])
        if levels[seen][0]:
            ends.insert(0, end_of(part, 0))
        if levels[seen][-1]:
            ends.append(end_of(part, 1))
        above += zip(ends[::2], ends[1::2])
    above.sort(key=lambda stretch: stretch[0].x)
    joined = above[:1]
    for first, last in above[1:]:
        if first.x > joined[-1][1].x:
            joined.append((first, last))
        elif last.x > joined[-1][1].x:
            joined[-1] = (joined[-1][0], last)
    ends = [end for pair in joined for end in pair if math.isfinite(end.x)]
    return [
        x._replace(place=sweep.explained(x.place._replace(meaning=PASSED[x.rises]))) for x in ends
    ]


def end_of(part: SpeedSweep, side: int) -> Found:
    """Return the end of a branch on one side as a place where the ripple passes a level; infinite where the sweep ends."""
    fold, rises = part.ends[side], side == 0
    if math.isnan(fold[0]):
        return Found(math.inf if side else -math.inf, Figure.undetermined("rad/s", "?"), rises)
    return Found(sum(fold) / 2.0, Figure.undetermined("rad/s", FOLD.format(*fold)), rises)
