"""How long does orienting a product take, and up to which rotor speed does the machine work?

The rotor's speed is swept for three coefficients of friction; each curve ends where products jam.
The limits are located by bisection.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import fmus, options, orientator, orientator_plots, orientator_show, pool
from .answer import Answer, Figure, Show, Table, finish, parameters, question, stream

PARTS = orientator.PARTS
FRICTIONS = "0.2,0.35,0.5"
SPEEDS = "0:105:43"
TABLE = "orientation_time.csv"
SWEPT = ("orientator.w", "orientator.chute.mu", "orientator.release")
UNITS = {
    "mu": "1", "n": "rpm", "stage": "", "reason": "", "orientation_time": "s", "t_falling": "s",
    "t_joint": "s", "t_turning": "s", "t_released": "s",
}  # fmt: skip
STEP = 0.02
NEAR = 0.01
RECORD = ["stage", "reason", "orientation_time", "t_falling", "t_joint", "t_turning", "t_released"]


class Case(NamedTuple):
    """Friction on the wall, rotor speed [rpm], start values of the orientator."""

    mu: float
    n: float
    start: options.Start


class Point(NamedTuple):
    """One product: friction, rotor speed [rpm], end, and durations [s] (0 where not reached)."""

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
        return self.stage == orientator.ORIENTED


class Gap(NamedTuple):
    """Between the last speed that works and the first that does not [rpm]."""

    mu: float
    good: float
    bad: float


def simulate(case: Case) -> Point:
    """One product."""
    mu, n, start = case
    result = orientator.product(n, mu, start, STEP, orientator.LONGEST, RECORD)
    stage, reason, *times = result.data[-1, 1:].tolist()
    return Point(mu, n, int(stage), int(reason), *times)


def bisect(task: tuple[Gap, options.Start]) -> list[Point]:
    """Halve the gap until it is narrower than NEAR; all products on the way, and some before."""
    gap, start = task
    mu, good, bad = gap
    points: list[Point] = []
    while bad - good > NEAR:
        middle = (good + bad) / 2
        points.append(simulate(Case(mu, middle, start)))
        good, bad = (middle, bad) if points[-1].works else (good, middle)
    before = np.linspace(max(0.0, 2 * gap.good - gap.bad), good, 12)[1:-1]
    return points + [simulate(Case(mu, float(n), start)) for n in before]


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


def verdict(points: Sequence[Point]) -> str:
    """The answer in plain words."""
    reasons = orientator.item_names("reason")
    lines = []
    for gap in gaps(points):
        mine = {p.n: p for p in points if p.mu == gap.mu}
        last, first = mine[gap.good], mine[gap.bad]
        still = min(mine.values(), key=lambda p: p.n)
        lines.append(
            f"mu = {gap.mu:g}: works up to {gap.good:.2f} +- {gap.bad - gap.good:.2f} rpm, where "
            f"orienting takes {last.orientation_time:.4f} s ({60 / last.orientation_time:.0f} "
            f"products/min from one catcher, {60 / still.orientation_time:.0f} at {still.n:g} rpm); "
            f"beyond it {reasons[first.reason]}."
        )
    for mu in sorted({p.mu for p in points} - {gap.mu for gap in gaps(points)}):
        lines.append(
            f"mu = {mu:g}: the sweep does not hold a speed where the machine stops working."
        )
    spread = fan(points)
    if spread:
        lines.append(
            f"The curves nearly coincide below {spread:g} rpm, where the slowest takes 10 % longer "
            "than the fastest, and fan out beyond."
        )
    return "\n".join(lines)


def fan(points: Sequence[Point]) -> float | None:
    """The first speed of the sweep at which the frictions differ by 10 % or more [rpm]."""
    for n in sorted({p.n for p in points}):
        times = [p.orientation_time for p in points if p.n == n and p.works]
        if len(times) > 1 and max(times) / min(times) >= 1.1:
            return n
    return None


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--frictions", default=FRICTIONS, help="coefficients of friction, a,b,c")
    add("--speeds", default=SPEEDS, help="from:to:number or a,b,c of the rotor [rpm]")
    add("--jobs", type=int, default=pool.available_cores(), help="parallel processes")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/orientation_time by default")
    options.add_start(parser, "orientator.cup.m=0.05")


def answer(
    frictions: str = FRICTIONS,
    speeds: str = SPEEDS,
    start: Sequence[str] = (),
    jobs: int = 1,
    out: Path | None = None,
) -> Answer:
    """Sweep and locate the limits; rows are kept in `out` on the way."""
    mus, ns = options.numbers("frictions", frictions), options.numbers("speeds", speeds)
    for mu in mus:
        options.not_negative("friction", mu)
    for n in ns:
        options.not_negative("speed", n, "rpm")
    options.at_least("jobs", jobs, 1)
    changes = options.start_values(start, SWEPT)
    fmus.build(*PARTS.values())
    system = orientator.system(ns[0], mus[0], changes)
    given = parameters(system)
    points: list[Point] = []
    with stream(out and out / TABLE, Point._fields) as keep:
        cases = [Case(mu, n, changes) for mu in mus for n in ns]
        for point in pool.each(simulate, cases, jobs, "sweep"):
            keep([point])
            points.append(point)
        open_gaps = [(gap, changes) for gap in gaps(points)]
        for more in pool.each(bisect, open_gaps, jobs, "limits"):
            keep(more)
            points += more
    found = gaps(points)
    return Answer(
        scenario="orientation_time",
        question=question(__doc__),
        verdict=verdict(points),
        figures=figures(points, found),
        parameters={name: value for name, value in given.items() if name not in SWEPT[:2]},
        tables={TABLE: Table.of_rows(points, UNITS)},
        provenance=fmus.provenance(system, None, f"steps of {STEP} s"),
        stem="orientation_time",
        facts={
            "limits_rpm": {str(gap.mu): {"works": gap.good, "jams": gap.bad} for gap in found},
            "step": STEP,
            "rad_per_s_per_rpm": math.pi / 30,
        },
        files={
            "orientation_time.png": lambda path: orientator_plots.orientation_time(
                path, points, found
            )
        },
        show=lambda: show(points, found, changes),
    )


def show(points: Sequence[Point], found: Sequence[Gap], start: options.Start) -> Show:
    """The curves, and for each limit the last product that is oriented beside the first that jams."""
    motions = []
    record = list(orientator_show.SEEN)
    for mu, *speeds in found:
        runs = {
            f"{n:.2f} rpm": orientator.product(n, mu, start, 1e-3, orientator.LONGEST, record)
            for n in speeds
        }
        ends = [
            run["time"][np.argmax(run["orientator.stage"] >= orientator.ORIENTED)]
            for run in runs.values()
        ]
        title = f"Friction {mu:g}: {' works, '.join(runs)} does not"
        motions.append(orientator_show.motion(title, runs, float(max(ends))))
    return Show([orientator_show.orientation_time(points, found)], motions)


def figures(points: Sequence[Point], found: Sequence[Gap]) -> dict[str, Figure]:
    """For each friction the fastest rotor that works, as near as it was located, and its time."""
    told = {}
    for gap in found:
        last = next(p for p in points if (p.mu, p.n) == (gap.mu, gap.good))
        name = f"mu_{gap.mu:g}".replace(".", "_")
        jams = f"fastest rotor that orients, friction {gap.mu:g}"
        takes = f"time of orientation there, friction {gap.mu:g}"
        told[f"limit_{name}"] = Figure(gap.good, "rpm", gap.bad - gap.good, meaning=jams)
        told[f"orientation_time_{name}"] = Figure(last.orientation_time, "s", 0.0, meaning=takes)
    return told


def run(out: Path = Path("results/orientation_time"), **settings: Any) -> None:
    """Write the answer and print the verdict."""
    finish(answer(out=out, **settings), out)
