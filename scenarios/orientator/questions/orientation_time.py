"""How long does orienting a product take, and up to which rotor speed does the machine work?

The speed of the rotor is swept for three coefficients of friction. Each curve ends where products jam,
and these limits are located by bisection.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import workbench
from cosim import System
from cosim.system import connect
from workbench import Chart, Context, Curve, Figure, Findings, Mark, Panel, Show, option
from workbench.charts.model import SERIES
from workbench.figure import percent, refusals
from workbench.measure import ROUNDING, Measured

from .. import machine as orientator
from .. import motion
from ..products import (
    PRODUCT_STARTS,
    STEP,
    UNITS,
    Product,
    ProductsUntilJam,
    run_product,
    simulate,
    sweep,
)

Frame = Any
PARTS = orientator.PARTS
FIXED_STARTS = PRODUCT_STARTS
TABLE = "orientation_time.csv"
#: Slowest over fastest time of orientation from which on friction is said to change it; a convention.
SPREAD = 1.1


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    frictions: tuple[float, ...] = option("0.2,0.35,0.5", "friction on the wall", "1", least=0.0)
    speeds: tuple[float, ...] = option("0:105rpm:43", "speeds of the rotor", "rad/s", least=0.0)


def solve(o: Options, context: Context) -> Findings:
    """Sweep, and halve the gaps between what works and what jams."""
    machine = orientator.system(context.fmus, 0.0, 0.0, o.start)
    connect(machine)
    speeds = [round(w * 30 / math.pi, 9) for w in o.speeds]  # so that 20 rpm stay 20
    run = partial(sweep, machine, speeds)
    rows = chain.from_iterable(context.each(run, o.frictions, "frictions", probes=True))
    table, steps = context.record_rows(TABLE, UNITS, rows), f"steps of {STEP} s"
    series = {mu: ProductsUntilJam.of_frame(table.frame, mu) for mu in o.frictions}
    all_figures, data = figures(machine, table.frame, series), (machine, series)
    return Findings(all_figures, data, machine, {}, steps, tables={TABLE: table})


def figures(
    machine: System, products: Frame, series: Mapping[float, ProductsUntilJam]
) -> dict[str, Figure]:
    """The shortest time of orientation; for each friction the fastest rotor that works, as near as it
    was located, and its products; from where on friction matters.
    """

    def takes(p: Product, wide: float, meaning: str) -> Figure:
        """A time of orientation; its error is what half the step changes, and a rotor `wide` slower."""
        variants = ((max(0.0, p.n - wide), STEP), (p.n, STEP / 2))
        times = [simulate(machine, p.mu, n, step).orientation_time for n, step in variants]
        change = sum(abs(p.orientation_time - time) for time in times)
        return Measured(p.orientation_time, max(change, ROUNDING)).figure("s", meaning)

    works = products[products["stage"] == orientator.ORIENTED]
    all_figures = {}
    for row in works.nsmallest(1, "orientation_time").itertuples(index=False):
        p = Product(*row)
        where = f"shortest orientation time, friction {p.mu:g} at {p.n:g} rpm"
        all_figures["shortest_time"] = takes(p, 0.0, where)
    for mu, products_of in series.items():
        of_friction = {"limit": products_of.limit()}
        if products_of.jam is not None:
            time = takes(products_of.oriented[-1], products_of.bracket, "orientation time there")
            pace, change = 60 / time.value, 60 / time.value**2 * (time.error or 0.0)
            of_friction["orientation_time"] = time
            of_friction["products"] = Figure(
                pace, "1/min", change, "products per minute there, with one catcher"
            )
        for name, x in of_friction.items():
            all_figures[key(name, mu)] = x._replace(meaning=f"friction {mu:g}: {x.meaning}")
    times = works.groupby("n")["orientation_time"].agg(["count", "min", "max"]).query("count > 1")
    spread_speeds = times.index[times["max"] >= SPREAD * times["min"]]
    if len(spread_speeds):
        below = max(times.index[times.index < spread_speeds[0]], default=0.0)
        meaning = "first speed of the sweep where friction changes the orientation time by "
        meaning += percent(SPREAD - 1.0)
        all_figures["fan"] = Figure(spread_speeds[0], "rpm", spread_speeds[0] - below, meaning)
    return all_figures


def key(name: str, mu: float) -> str:
    """The name of a figure of a friction, "limit_mu_0_35"."""
    return f"{name}_mu_{mu:g}".replace(".", "_")


def verdict(o: Options, f: Mapping[str, Figure], r: object) -> str:
    """How long orienting takes, how fast the rotor may turn, and from where on friction matters."""
    texts = {name: figure.text() for name, figure in f.items()}
    limits = {f"friction {mu:g}": key("limit", mu) for mu in o.frictions}
    works = [
        f"{texts[name]} with {who}, where it takes {texts[name.replace('limit', 'orientation_time')]}"
        for who, name in limits.items()
        if f[name].error is not None
    ]
    lines = refusals({who: f[name] for who, name in limits.items()})
    if works:
        lines.insert(0, f"The orientator works up to {'; '.join(works)}.")
    if "shortest_time" in f:
        lines.insert(0, f"Orienting a product takes at least {texts['shortest_time']}.")
    if "fan" in f:
        lines.append(
            f"At the speeds of the sweep below {f['fan'].value:.4g} rpm friction changes the orientation time by "
            f"less than {percent(SPREAD - 1.0)}."
        )
    return " ".join(lines)


def show(
    o: Options, f: Mapping[str, Figure], r: tuple[System, Mapping[float, ProductsUntilJam]]
) -> Show:
    """The curves, and for each limit the last product that is oriented beside the first that jams."""
    curves, marks, motions = [], [], []
    for (mu, series), color in zip(r[1].items(), SERIES * len(r[1])):
        oriented, jam = series.oriented, series.jam
        n, time = [p.n for p in oriented], [p.orientation_time for p in oriented]
        if oriented:
            curves.append(Curve(f"friction {mu:g}", n, time, color, "linked"))
        if jam is not None:
            marks.append(Mark(n[-1], f"friction {mu:g} jams beyond {n[-1]:.2f} rpm"))
            runs = {f"{x:.2f} rpm": run_product(r[0], mu, x, 1e-3) for x in (n[-1], jam.n)}
            last = max(float(orientator.shortened(x)["time"][-1]) for x in runs.values())
            title = f"Friction {mu:g}: {' works, '.join(runs)} does not"
            motions.append(motion.motion(title, runs, last))
    title = "The orientation time over the speed of the rotor"
    if marks:
        title = "The orientation time, up to the speed at which products jam"
    panel = Panel("orientation time", "s", curves, includes=(0.0,))
    chart = Chart(title, "rotor speed [rpm]", [panel], marks)
    return Show([chart] if curves else [], motions)
