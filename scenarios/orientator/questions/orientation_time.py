"""How long does orienting a product take, and up to which rotor speed does the machine work?

The speed of the rotor is swept for three coefficients of friction. Each curve ends where products jam,
and these limits are located by bisection.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, dropwhile
from typing import Any

import numpy as np

import cosim
import workbench
from cosim import Result, System
from cosim.system import connect
from workbench import Bench, Chart, Curve, Figure, Findings, Mark, Panel, Show, Table, option
from workbench.charts.model import SERIES
from workbench.figure import refusals
from workbench.measure import ROUNDING, Measured

from .. import machine as orientator
from .. import motion

Frame = Any
Row = Any
Course = tuple[list[Row], Row]
PARTS = orientator.PARTS
OWN = ("orientator.chute.mu", "orientator.w", "orientator.release")
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


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep, and halve the gaps between what works and what jams."""
    machine = orientator.system(bench.fmus, 0.0, 0.0, o.start)
    connect(machine)
    speeds = [round(w * 30 / math.pi, 9) for w in o.speeds]  # so that 20 rpm stay 20
    run = partial(sweep, machine, speeds)
    rows = chain.from_iterable(bench.each(run, o.frictions, "frictions", probes=True))
    table, steps = bench.kept(TABLE, UNITS, rows), f"steps of {STEP} s"
    courses = {mu: course(table.frame, mu) for mu in o.frictions}
    found, data = figures(machine, table.frame, courses), (machine, courses)
    return Findings(found, data, machine, {}, steps, tables={TABLE: table})


def sweep(machine: System, speeds: Sequence[float], mu: float) -> list[Sequence[float]]:
    """The products of a friction: at these speeds; in the gap between what works and what jams, which
    is halved until it is narrower than NEAR; some before, and the same again if one of these jams."""
    rows = [simulate(machine, mu, n) for n in speeds]
    while True:
        oriented, jam = course(Table.of_rows(rows, UNITS).frame, mu)
        if jam is None or jam.n - oriented[-1].n <= NEAR:
            return rows
        good, bad = oriented[-1].n, jam.n
        first = max(0.0, 2 * good - bad)
        while bad - good > NEAR:
            middle = (good + bad) / 2
            rows.append(simulate(machine, mu, middle))
            good, bad = (middle, bad) if rows[-1][2] == orientator.ORIENTED else (good, middle)
        before = np.linspace(first, good, 12)[1:-1].tolist()
        rows += [simulate(machine, mu, n) for n in before]


def fastest(machine: System, speeds: Sequence[float], mu: float) -> Figure:
    """The fastest rotor that orients before the first of rising speeds [rpm] that jams, and why."""
    return limit(*course(Table.of_rows(sweep(machine, speeds, mu), UNITS).frame, mu))


def limit(oriented: Sequence[Row], jam: Row) -> Figure:
    """The last product that is oriented, and the first that jams beyond it."""
    which, meaning = "no product" if oriented else "every product", "largest rotor speed that works"
    if jam is None:
        return Figure.refused("rpm", f"{which} of the sweep jams", meaning)
    beyond = f"{meaning}; beyond it: {orientator.REASONS[jam.reason]}"
    return Figure(oriented[-1].n, "rpm", jam.n - oriented[-1].n, beyond)


def run(machine: System, mu: float, n: float, step: float) -> Result:
    """One product at a friction on the wall and a rotor speed [rpm]."""
    start = {**machine.start, **dict(zip(OWN, (mu, n * math.pi / 30)))}
    return cosim.run(replace(machine, start=start), stop=orientator.LONGEST, step=step)


def simulate(machine: System, mu: float, n: float, step: float = STEP) -> Sequence[float]:
    """How one product ends: a row of the table, nan for what it does not reach."""
    result = run(machine, mu, n, step)
    stage, reason, *times = (float(result[f"orientator.{x}"][-1]) for x in [*UNITS][2:])
    return mu, n, int(stage), int(reason), *(time or math.nan for time in times)


def course(products: Frame, mu: float) -> Course:
    """The products of a friction that are oriented, by speed, up to the first that jams, and that."""
    rows = products[products["mu"] == mu].sort_values("n").itertuples()
    oriented: list[Row] = []
    for p in dropwhile(lambda p: p.stage != orientator.ORIENTED, rows):
        if p.stage != orientator.ORIENTED:
            return oriented, p
        oriented.append(p)
    return oriented, None


def figures(machine: System, products: Frame, courses: Mapping[float, Course]) -> dict[str, Figure]:
    """The shortest time of orientation; for each friction the fastest rotor that works, as near as it
    was located, and its products; from where on friction matters.
    """

    def takes(p: Row, wide: float, meaning: str) -> Figure:
        """A time of orientation; its error is what half the step changes, and a rotor `wide` slower."""
        others = ((max(0.0, p.n - wide), STEP), (p.n, STEP / 2))
        times = [simulate(machine, p.mu, n, step)[4] for n, step in others]
        off = sum(abs(p.orientation_time - time) for time in times)
        return Measured(p.orientation_time, max(off, ROUNDING)).figure("s", meaning)

    works = products[products["stage"] == orientator.ORIENTED]
    found = {}
    for p in works.nsmallest(1, "orientation_time").itertuples():
        where = f"shortest orientation time, friction {p.mu:g} at {p.n:g} rpm"
        found["shortest_time"] = takes(p, 0.0, where)
    for mu, (oriented, jam) in courses.items():
        told = {"limit": limit(oriented, jam)}
        if jam is not None:
            time = takes(oriented[-1], jam.n - oriented[-1].n, "orientation time there")
            pace, off = 60 / time.value, 60 / time.value**2 * (time.error or 0.0)
            told["orientation_time"] = time
            told["products"] = Figure(
                pace, "1/min", off, "products per minute there, with one catcher"
            )
        for name, x in told.items():
            found[key(name, mu)] = x._replace(meaning=f"friction {mu:g}: {x.meaning}")
    times = works.groupby("n")["orientation_time"].agg(["count", "min", "max"]).query("count > 1")
    apart = times.index[times["max"] >= FAN * times["min"]]
    if len(apart):
        below = max(times.index[times.index < apart[0]], default=0.0)
        meaning = "first speed of the sweep where friction changes the orientation time by 10 %"
        found["fan"] = Figure(apart[0], "rpm", apart[0] - below, meaning)
    return found


def key(name: str, mu: float) -> str:
    """The name of a figure of a friction, "limit_mu_0_35"."""
    return f"{name}_mu_{mu:g}".replace(".", "_")


def verdict(o: Options, f: Mapping[str, Figure], r: object) -> str:
    """How long orienting takes, how fast the rotor may turn, and from where on friction matters."""
    told = {name: figure.text() for name, figure in f.items()}
    limits = {f"friction {mu:g}": key("limit", mu) for mu in o.frictions}
    works = [
        f"{told[name]} with {who}, where it takes {told[name.replace('limit', 'orientation_time')]}"
        for who, name in limits.items()
        if f[name].error is not None
    ]
    lines = refusals({who: f[name] for who, name in limits.items()})
    if works:
        lines.insert(0, f"The orientator works up to {'; '.join(works)}.")
    if "shortest_time" in f:
        lines.insert(0, f"Orienting a product takes at least {told['shortest_time']}.")
    if "fan" in f:
        lines.append(
            f"The orientation time hardly depends on friction up to {told['fan']}, where the "
            "slowest takes 10 % longer than the fastest."
        )
    return " ".join(lines)


def show(o: Options, f: Mapping[str, Figure], r: tuple[System, Mapping[float, Course]]) -> Show:
    """The curves, and for each limit the last product that is oriented beside the first that jams."""
    curves, marks, motions = [], [], []
    for (mu, (oriented, jam)), color in zip(r[1].items(), SERIES * len(r[1])):
        n, time = [p.n for p in oriented], [p.orientation_time for p in oriented]
        if oriented:
            curves.append(Curve(f"friction {mu:g}", n, time, color, "linked"))
        if jam is not None:
            marks.append(Mark(n[-1], f"friction {mu:g} jams beyond {n[-1]:.2f} rpm"))
            runs = {f"{x:.2f} rpm": run(r[0], mu, x, 1e-3) for x in (n[-1], jam.n)}
            last = max(float(orientator.shortened(x)["time"][-1]) for x in runs.values())
            title = f"Friction {mu:g}: {' works, '.join(runs)} does not"
            motions.append(motion.motion(title, runs, last))
    title = "The orientation time, up to the speed at which products jam"
    panel = Panel("orientation time", "s", curves, includes=(0.0,))
    chart = Chart(title, "rotor speed [rpm]", [panel], marks)
    return Show([chart] if curves else [], motions)
