"""How long does orienting a product take, and up to which rotor speed does the machine work?

The rotor's speed is swept for three coefficients of friction; each curve ends where products jam.
The limits are located by bisection.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

import workbench
from cosim.system import Value, connect
from workbench import Bench, Figure, Findings, Show, Table, option
from workbench.answer import stream

from . import machine as orientator
from . import show as pictures

PARTS = orientator.PARTS
OWN = ("orientator.w", "orientator.chute.mu", "orientator.release")
TABLE = "orientation_time.csv"
UNITS = {
    "mu": "1", "n": "rpm", "stage": "1", "reason": "1", "orientation_time": "s", "t_falling": "s",
    "t_joint": "s", "t_turning": "s", "t_released": "s",
}  # fmt: skip
STEP = 0.02
NEAR = 0.01
FAN = 1.1
RECORD = ("stage", "reason", "orientation_time", "t_falling", "t_joint", "t_turning", "t_released")


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    frictions: tuple[float, ...] = option("0.2,0.35,0.5", "friction on the wall", "1", least=0.0)
    speeds: tuple[float, ...] = option("0:105rpm:43", "speeds of the rotor", "rad/s", least=0.0)


class Case(NamedTuple):
    """FMUs, friction on the wall, rotor speed [rpm], start values, communication step [s]."""

    fmus: Mapping[str, Path]
    mu: float
    n: float
    start: Mapping[str, Value]
    step: float = STEP


class Point(NamedTuple):
    """One product: friction, rotor speed [rpm], end, durations [s], nan where there is none."""

    mu: float
    n: float
    stage: int
    reason: int
    orientation_time: float
    t_falling: float
    t_joint: float
    t_turning: float
    t_released: float

    @property
    def works(self) -> bool:
        """Whether the product is oriented."""
        return self.stage == orientator.ORIENTED


class Gap(NamedTuple):
    """Between the last speed that works and the first that does not [rpm]."""

    mu: float
    good: float
    bad: float


class Sweep(NamedTuple):
    """All products, the limits, and the FMUs."""

    points: Sequence[Point]
    gaps: Sequence[Gap]
    fmus: Mapping[str, Path]

    def at(self, mu: float, n: float) -> Point:
        """The product of this friction and rotor speed [rpm]."""
        return next(p for p in self.points if (p.mu, p.n) == (mu, n))


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep, and halve the gaps between what works and what jams."""
    system = orientator.system(bench.fmus, o.speeds[0], o.frictions[0], o.start)
    connect(system)
    points: list[Point] = []
    with stream(bench.out and bench.out / TABLE, Point._fields) as keep:
        cases = [
            Case(bench.fmus, mu, orientator.rpm(w), o.start) for mu in o.frictions for w in o.speeds
        ]
        for point in bench.each(simulate, cases, "sweep", probes=True):
            keep([point])
            points.append(point)
        tasks = [(gap, cases[0]) for gap in gaps(points)]
        for more in bench.each(bisect, tasks, "limits", probes=True):
            keep(more)
            points += more
    sweep = Sweep(points, gaps(points), bench.fmus)
    return Findings(
        figures(sweep, o.start),
        sweep,
        system,
        communication=f"steps of {STEP} s",
        tables={TABLE: Table.of_rows(points, UNITS)},
    )


def simulate(case: Case) -> Point:
    """One product."""
    fmus, mu, n, start, step = case
    system = orientator.system(fmus, orientator.rad_per_s(n), mu, start)
    result = orientator.product(system, step, RECORD)
    stage, reason, *times = result.data[-1, 1:].tolist()
    return Point(mu, n, int(stage), int(reason), *(time or math.nan for time in times))


def bisect(task: tuple[Gap, Case]) -> list[Point]:
    """Halve the gap until it is narrower than NEAR; all products on the way, and some before."""
    (mu, good, bad), case = task
    first = 2 * good - bad
    points: list[Point] = []
    while bad - good > NEAR:
        middle = (good + bad) / 2
        points.append(simulate(case._replace(mu=mu, n=middle)))
        good, bad = (middle, bad) if points[-1].works else (good, middle)
    before = np.linspace(max(0.0, first), good, 12)[1:-1]
    return points + [simulate(case._replace(mu=mu, n=float(n))) for n in before]


def gaps(points: Sequence[Point]) -> list[Gap]:
    """For each friction the first pair of speeds between which the machine stops working."""
    found = []
    for mu in sorted({p.mu for p in points}):
        mine = sorted((p for p in points if p.mu == mu), key=lambda p: p.n)
        for left, right in pairwise(mine):
            if left.works and not right.works:
                found.append(Gap(mu, left.n, right.n))
                break
    return found


def figures(sweep: Sweep, start: Mapping[str, Value]) -> dict[str, Figure]:
    """For each friction the fastest rotor that works, as near as it was located, and its products."""
    found = {}
    for mu in sorted({p.mu for p in sweep.points}):
        name = f"mu_{mu:g}".replace(".", "_")
        limit = f"fastest rotor that orients, friction {mu:g}"
        takes = f"time of orientation there, friction {mu:g}"
        pace = f"products per minute there from one catcher, friction {mu:g}"
        gap = next((gap for gap in sweep.gaps if gap.mu == mu), None)
        if gap is None:
            none = "the sweep does not hold a speed where the machine stops working"
            found[f"limit_{name}"] = Figure.refused("rpm", none, limit)
            continue
        last, wide = sweep.at(mu, gap.good), gap.bad - gap.good
        slower = Case(sweep.fmus, mu, max(0.0, gap.good - wide), start)
        finer = slower._replace(n=gap.good, step=STEP / 2)
        off = [abs(last.orientation_time - simulate(x).orientation_time) for x in (slower, finer)]
        rate = 60 / last.orientation_time
        found[f"limit_{name}"] = Figure(gap.good, "rpm", wide, limit)
        found[f"orientation_time_{name}"] = Figure(last.orientation_time, "s", sum(off), takes)
        error = rate * sum(off) / last.orientation_time
        found[f"products_{name}"] = Figure(rate, "1/min", error, pace)
    spread = fan(sweep.points)
    meaning = "first speed of the sweep where the frictions differ by 10 %"
    if spread is not None:
        found["fan"] = Figure(*spread, meaning)
    return found


def fan(points: Sequence[Point]) -> tuple[float, str, float] | None:
    """The first speed of the sweep at which the frictions differ by 10 % or more, its unit, and how
    far below it the speed before lies.
    """
    before = 0.0
    for n in sorted({p.n for p in points}):
        times = [p.orientation_time for p in points if p.n == n and p.works]
        if len(times) > 1:
            if max(times) / min(times) >= FAN:
                return n, "rpm", n - before
            before = n
    return None


def verdict(o: Options, f: Mapping[str, Figure], r: Sweep) -> str:
    """How fast the rotor may turn with each friction, how long that takes, and what stops it."""
    limits = [f"{f[_name('limit', gap)].text()} with friction {gap.mu:g}" for gap in r.gaps]
    lines = [
        f"The orientator works up to {', '.join(limits)}."
        if limits
        else "At no speed of the sweep does the orientator begin to jam."
    ]
    if "fan" in f:
        lines[0] += (
            f" The time of orientation hardly depends on friction up to {f['fan'].text()}, where the "
            "slowest takes 10 % longer than the fastest."
        )
    for gap in r.gaps:
        reason = orientator.ITEMS["reason"][r.at(gap.mu, gap.bad).reason]
        lines.append(
            f"With friction {gap.mu:g} orienting takes {f[_name('orientation_time', gap)].text()} at "
            f"the limit, {f[_name('products', gap)].text('products/min')}; beyond it products jam: {reason}."
        )
    for mu in sorted({p.mu for p in r.points} - {gap.mu for gap in r.gaps}):
        works = any(p.works for p in r.points if p.mu == mu)
        word = "no product of the sweep jams" if works else "every product of the sweep jams"
        lines.append(f"With friction {mu:g} {word}.")
    return "\n".join(lines)


def _name(what: str, gap: Gap) -> str:
    return f"{what}_mu_{gap.mu:g}".replace(".", "_")


def show(o: Options, f: Mapping[str, Figure], r: Sweep) -> Show:
    """The curves, and for each limit the last product that is oriented beside the first that jams."""
    motions = []
    for mu, *speeds in r.gaps:
        runs = {}
        for n in speeds:
            system = orientator.system(r.fmus, orientator.rad_per_s(n), mu, o.start)
            runs[f"{n:.2f} rpm"] = orientator.product(system, 1e-3, pictures.SEEN)
        ends = [orientator.shortened(run)["time"][-1] for run in runs.values()]
        title = f"Friction {mu:g}: {' works, '.join(runs)} does not"
        motions.append(pictures.motion(title, runs, float(max(ends))))
    return Show([pictures.orientation_time(r.points, r.gaps)], motions)
