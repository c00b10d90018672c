"""How long does orienting a product take, and up to which rotor speed does the machine work?

The rotor's speed is swept for three coefficients of friction; each curve ends where products jam.
The limits are located by bisection.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

import cosim
import workbench
from cosim import Result, System
from cosim.system import Value, connect
from workbench import Bench, Chart, Curve, Figure, Findings, Mark, Panel, Show, Table, option
from workbench.answer import stream
from workbench.report.chart import SERIES

from . import machine as orientator
from . import mechanism

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


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    frictions: tuple[float, ...] = option("0.2,0.35,0.5", "friction on the wall", "1", least=0.0)
    speeds: tuple[float, ...] = option("0:105rpm:43", "speeds of the rotor", "rad/s", least=0.0)


class Case(NamedTuple):
    """FMUs and start values, friction on the wall, rotor speed [rpm], communication step [s]."""

    fmus: Mapping[str, Path]
    start: Mapping[str, Value]
    mu: float
    n: float
    step: float = STEP

    @property
    def system(self) -> System:
        return orientator.system(self.fmus, self.n * math.pi / 30, self.mu, self.start)

    def run(self, variables: Sequence[str]) -> Result:
        """The course of the product."""
        record = [f"orientator.{x}" for x in variables]
        return cosim.run(self.system, stop=orientator.LONGEST, step=self.step, record=record)


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


class Sweep(NamedTuple):
    """All products, of each friction the last that is oriented and the first that jams, and a case."""

    points: Sequence[Point]
    limits: Mapping[float, tuple[Point, Point]]
    case: Case


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep, and halve the gaps between what works and what jams."""
    speeds = [orientator.rpm(w) for w in o.speeds]
    cases = [Case(bench.fmus, o.start, mu, n) for mu in o.frictions for n in speeds]
    connect(cases[0].system)
    points: list[Point] = []
    with stream(bench.out and bench.out / TABLE, Point._fields) as keep:
        for point in bench.each(simulate, cases, "sweep", probes=True):
            keep([point])
            points.append(point)
        tasks = [(cases[0], *limit) for limit in limits(points).values()]
        for more in bench.each(bisect, tasks, "limits", probes=True):
            keep(more)
            points += more
    sweep, tables = Sweep(points, limits(points), cases[0]), {TABLE: Table.of_rows(points, UNITS)}
    steps = f"steps of {STEP} s"
    return Findings(figures(sweep), sweep, cases[0].system, {}, steps, tables=tables)


def simulate(case: Case) -> Point:
    """One product."""
    stage, reason, *times = case.run(Point._fields[2:]).data[-1, 1:].tolist()
    times = [time or math.nan for time in times]
    return Point(case.mu, case.n, int(stage), int(reason), *times)


def bisect(task: tuple[Case, Point, Point]) -> list[Point]:
    """Halve the gap until it is narrower than NEAR; all products on the way, and some before."""
    case, good, bad = task[0]._replace(mu=task[1].mu), task[1].n, task[2].n
    first = 2 * good - bad
    points: list[Point] = []
    while bad - good > NEAR:
        middle = (good + bad) / 2
        points.append(simulate(case._replace(n=middle)))
        good, bad = (middle, bad) if points[-1].works else (good, middle)
    before = np.linspace(max(0.0, first), good, 12)[1:-1].tolist()
    return points + [simulate(case._replace(n=n)) for n in before]


def limits(points: Sequence[Point]) -> dict[float, tuple[Point, Point]]:
    """For each friction the first neighbours of which the slower works and the faster does not."""
    found: dict[float, tuple[Point, Point]] = {}
    for slow, fast in pairwise(sorted(points, key=lambda p: (p.mu, p.n))):
        if slow.mu == fast.mu and slow.works and not fast.works:
            found.setdefault(slow.mu, (slow, fast))
    return found


def figures(sweep: Sweep) -> dict[str, Figure]:
    """For each friction the fastest rotor that works, as near as it was located, and its products."""
    found = {}
    for mu in sorted({p.mu for p in sweep.points}):
        name, friction = f"mu_{mu:g}".replace(".", "_"), f"friction {mu:g}"
        limit = f"fastest rotor that orients, {friction}"
        if mu not in sweep.limits:
            works = any(p.works for p in sweep.points if p.mu == mu)
            which = "no product" if works else "every product"
            found[f"limit_{name}"] = Figure.refused("rpm", f"{which} of the sweep jams", limit)
            continue
        last, jam = sweep.limits[mu]
        wide, time = jam.n - last.n, last.orientation_time
        case = sweep.case._replace(mu=mu, n=last.n)
        others = [case._replace(n=max(0.0, last.n - wide)), case._replace(step=STEP / 2)]
        off = sum(abs(time - simulate(other).orientation_time) for other in others)
        limit += f"; beyond it: {orientator.REASONS[jam.reason]}"
        takes = f"time of orientation there, {friction}"
        pace = f"products per minute there from one catcher, {friction}"
        found[f"limit_{name}"] = Figure(last.n, "rpm", wide, limit)
        found[f"orientation_time_{name}"] = Figure(time, "s", off, takes)
        found[f"products_{name}"] = Figure(60 / time, "1/min", 60 / time**2 * off, pace)
    return found | fan(sweep.points)


def fan(points: Sequence[Point]) -> dict[str, Figure]:
    """The first speed of the sweep at which the frictions differ by 10 % or more, if there is one;
    its error is how far below it the speed before lies.
    """
    before, meaning = 0.0, "first speed of the sweep where the frictions differ by 10 %"
    for n in sorted({p.n for p in points}):
        times = [p.orientation_time for p in points if p.n == n and p.works]
        if len(times) > 1:
            if max(times) / min(times) >= FAN:
                return {"fan": Figure(n, "rpm", n - before, meaning)}
            before = n
    return {}


def verdict(o: Options, f: Mapping[str, Figure], r: Sweep) -> str:
    """How fast the rotor may turn with each friction, and from where on friction matters."""
    limits = {mu: f[f"limit_mu_{mu:g}".replace(".", "_")] for mu in o.frictions}
    told = [f"{x.text()} with friction {mu:g}" for mu, x in limits.items() if x.error is not None]
    lines = [f"The orientator works up to {', '.join(told)}."] if told else []
    for mu, limit in limits.items():
        if limit.error is None:
            lines.append(f"With friction {mu:g} {limit.reason}.")
    if "fan" in f:
        lines.append(
            f"The time of orientation hardly depends on friction up to {f['fan'].text()}, where the "
            "slowest takes 10 % longer than the fastest."
        )
    return " ".join(lines)


def show(o: Options, f: Mapping[str, Figure], r: Sweep) -> Show:
    """The curves, and for each limit the last product that is oriented beside the first that jams."""
    curves, marks, motions = [], [], []
    for mu, color in zip(o.frictions, SERIES * len(o.frictions)):
        most = r.limits[mu][0].n if mu in r.limits else math.inf
        works = [p for p in r.points if p.mu == mu and p.works and p.n <= most]
        if works:
            n, time = np.array(sorted((p.n, p.orientation_time) for p in works)).T
            curves.append(Curve(f"friction {mu:g}", n, time, color, "linked"))
    for mu, (good, bad) in r.limits.items():
        marks.append(Mark(good.n, f"friction {mu:g} jams beyond {good.n:.2f} rpm"))
        cases = [r.case._replace(mu=mu, n=p.n, step=1e-3) for p in (good, bad)]
        runs = {f"{case.n:.2f} rpm": case.run(mechanism.SEEN) for case in cases}
        last = max(orientator.shortened(run)["time"][-1] for run in runs.values())
        title = f"Friction {mu:g}: {' works, '.join(runs)} does not"
        motions.append(mechanism.motion(title, runs, float(last)))
    title = "The time of orientation, up to where products jam"
    panel = Panel("orientation time", "s", curves, includes=(0.0,))
    return Show([Chart(title, "rotor speed [rpm]", [panel], marks)], motions)
