"""How long does orienting a product take, and up to which rotor speed does the machine work?

The rotor's speed is swept for three coefficients of friction; each curve ends where products jam.
The limits are located by bisection.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

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

Frame = Any
Row = Any
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
        """The course of one product."""
        record = [f"orientator.{x}" for x in variables]
        return cosim.run(self.system, stop=orientator.LONGEST, step=self.step, record=record)


class Sweep(NamedTuple):
    """All products, of each friction the last that is oriented and the first that jams, and a case."""

    products: Frame
    limits: Mapping[float, tuple[Row, Row]]
    case: Case


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep, and halve the gaps between what works and what jams."""
    speeds = [orientator.rpm(w) for w in o.speeds]
    cases = [Case(bench.fmus, o.start, mu, n) for mu in o.frictions for n in speeds]
    connect(cases[0].system)
    rows: list[Sequence[float]] = []
    with stream(bench.out and bench.out / TABLE, list(UNITS)) as keep:
        for row in bench.each(simulate, cases, "sweep", probes=True):
            keep([row])
            rows.append(row)
        ends = limits(Table.of_rows(rows, UNITS).frame).items()
        tasks = [(cases[0]._replace(mu=mu), good.n, bad.n) for mu, (good, bad) in ends]
        for more in bench.each(bisect, tasks, "limits", probes=True):
            keep(more)
            rows += more
    table = Table.of_rows(rows, UNITS)
    sweep, steps = Sweep(table.frame, limits(table.frame), cases[0]), f"steps of {STEP} s"
    found = figures(o, sweep)
    return Findings(found, sweep, cases[0].system, {}, steps, tables={TABLE: table})


def simulate(case: Case) -> Sequence[float]:
    """How one product ends: a row of the table, nan for what it does not reach."""
    stage, reason, *times = case.run(list(UNITS)[2:]).data[-1, 1:].tolist()
    return case.mu, case.n, int(stage), int(reason), *(time or math.nan for time in times)


def bisect(task: tuple[Case, float, float]) -> list[Sequence[float]]:
    """Halve the gap between a speed that works and one that does not until it is narrower than NEAR;
    all products on the way, and some before."""
    case, good, bad = task
    first = 2 * good - bad
    rows: list[Sequence[float]] = []
    while bad - good > NEAR:
        middle = (good + bad) / 2
        rows.append(simulate(case._replace(n=middle)))
        good, bad = (middle, bad) if rows[-1][2] == orientator.ORIENTED else (good, middle)
    before = np.linspace(max(0.0, first), good, 12)[1:-1].tolist()
    return rows + [simulate(case._replace(n=n)) for n in before]


def limits(products: Frame) -> dict[float, tuple[Row, Row]]:
    """For each friction the first neighbours of which the slower works and the faster does not."""
    found: dict[float, tuple[Row, Row]] = {}
    for slow, fast in pairwise(products.sort_values(["mu", "n"]).itertuples(index=False)):
        works, fails = (p.stage == orientator.ORIENTED for p in (slow, fast))
        if slow.mu == fast.mu and works and not fails:
            found.setdefault(slow.mu, (slow, fast))
    return found


def figures(o: Options, r: Sweep) -> dict[str, Figure]:
    """For each friction the fastest rotor that works, as near as it was located, and its products."""
    found = {}
    for mu in o.frictions:
        name, friction = f"mu_{mu:g}".replace(".", "_"), f"friction {mu:g}"
        limit = f"fastest rotor that orients, {friction}"
        if mu not in r.limits:
            stages = r.products["stage"][r.products["mu"] == mu]
            which = "no product" if (stages == orientator.ORIENTED).any() else "every product"
            found[f"limit_{name}"] = Figure.refused("rpm", f"{which} of the sweep jams", limit)
            continue
        last, jam = r.limits[mu]
        wide, time = jam.n - last.n, last.orientation_time
        case = r.case._replace(mu=mu, n=last.n)
        others = [case._replace(n=max(0.0, last.n - wide)), case._replace(step=STEP / 2)]
        off = sum(abs(time - simulate(other)[4]) for other in others)
        limit += f"; beyond it: {orientator.REASONS[jam.reason]}"
        takes = f"time of orientation there, {friction}"
        pace = f"products per minute there from one catcher, {friction}"
        found[f"limit_{name}"] = Figure(last.n, "rpm", wide, limit)
        found[f"orientation_time_{name}"] = Figure(time, "s", off, takes)
        found[f"products_{name}"] = Figure(60 / time, "1/min", 60 / time**2 * off, pace)
    works = r.products[r.products["stage"] == orientator.ORIENTED]
    times = works.groupby("n")["orientation_time"].agg(["count", "min", "max"])
    times = times[times["count"] > 1]
    apart = times.index[times["max"] >= FAN * times["min"]]
    if len(apart):
        below = max(times.index[times.index < apart[0]], default=0.0)
        meaning = "first speed of the sweep where the frictions differ by 10 %"
        found["fan"] = Figure(apart[0], "rpm", apart[0] - below, meaning)
    return found


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
    works = r.products[r.products["stage"] == orientator.ORIENTED].sort_values("n")
    for mu, color in zip(o.frictions, SERIES * len(o.frictions)):
        most = r.limits[mu][0].n if mu in r.limits else math.inf
        mine = works[(works["mu"] == mu) & (works["n"] <= most)]
        n, time = mine[["n", "orientation_time"]].to_numpy().T
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
