"""How long does orienting a product take, and up to which rotor speed does the machine work?

The speed of the rotor is swept for several coefficients of friction. Each curve ends where products jam,
and these limits are located by a search.

With `--compare formula` the answer also says how well the formula for the limit and the closed bound of stage
joint meet the simulated limits of three cups, and which dimension raises the limit most. With
`--compare neglected` it says what the effects that the paper neglects cost: Coriolis forces, friction at the
catcher, the direction of the spring.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

from cosim import SetupError, System
from cosim.system import connect
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Mark,
    Panel,
    Question,
    Show,
    option,
)
from workbench.charts.model import SERIES
from workbench.figure import figure_of_figures, percent
from workbench.options import check_fixed_starts

from .. import formula_comparison, neglected
from .. import machine as orientator
from ..products import (
    PRODUCT_STARTS,
    PRODUCT_UNITS,
    RPM,
    STEP,
    Product,
    limit_of,
    oriented_and_jam,
    pair,
    until_jam,
)

Frame = Any
TABLE = "orientation_time.csv"
#: Slowest over fastest time of orientation from which on friction is said to change it; a convention.
SPREAD = 1.1


FORMULA, NEGLECTED = "formula", "neglected"
#: Frictions on the wall that are swept by default, by what is compared; with the effects it is that at all walls.
FRICTIONS = {"none": (0.2, 0.35, 0.5), FORMULA: tuple(x / 20 for x in range(1, 13))}
#: Speeds of the rotor that are swept by default [rpm]: to where the least friction of a sweep jams.
SPEEDS = tuple(2.5 * k for k in range(43))
#: Those at which effects are compared, below the limit with any of them.
SLOW_SPEEDS = tuple(5.0 * k for k in range(15))


class OrientationTime(Question):
    """The frictions and speeds of the series, and what else they are compared with."""

    parts = orientator.PARTS
    fixed_starts = PRODUCT_STARTS

    frictions: tuple[float, ...] = option(
        (), "friction on the wall, by default 0.2, 0.35 and 0.5, or as the comparison needs it", "1",
        least=0.0,
    )  # fmt: skip
    speeds: tuple[float, ...] = option(
        (), f"speeds of the rotor, by default {len(SPEEDS)} up to {SPEEDS[-1]:g} rpm, or "
        f"{len(SLOW_SPEEDS)} up to {SLOW_SPEEDS[-1]:g} rpm with what is neglected", "rad/s", least=0.0,
    )  # fmt: skip
    compare: str = option(
        "none", "also compare with the formula for the limit, or with what the paper neglects",
        choices=("none", FORMULA, NEGLECTED),
    )  # fmt: skip
    friction: float = option(0.35, "friction of the wall for the comparison", "1", above=0.0)
    speed: float = option("40rpm", "speed of the rotor for what is neglected", "rad/s", least=0.0)
    catcher: float = option(
        0.35, "friction between cup and catcher, which is neglected", "1", least=0.0, most=1.0
    )
    rim: float = option("0.5mm", "radius of the rim's edge, which is neglected", "m", least=0.0)
    length: float = option("100mm", "length of the spring at the stop", "m", above=0.0)

    def solve(self, context: Context) -> Findings:
        """Sweep, and halve the gaps between what works and what jams; compare.

        This replaces the single certified run, because the answer follows hundreds of products, and the limits are
        brackets of a search.

        Raises
        ------
        cosim.SetupError
            For options that the comparison cannot take.
        """
        frictions, speeds = frictions_and_speeds(self)
        machine = orientator.system(context.fmus, 0.0, self.friction, self.start)
        connect(machine)
        series = [Product.of(machine, mu, speeds) for mu in frictions]
        found = context.each(partial(until_jam, context.fmus), series, "frictions", probes=True)
        rows = chain.from_iterable(x.itertuples(index=False) for x in found)
        table, steps = context.record_rows(TABLE, PRODUCT_UNITS, rows), f"steps of {STEP} s"
        all_figures, tables = figures(machine, table.frame), {TABLE: table}
        comparison = compared(self, context, machine, frictions, speeds)
        if comparison:
            all_figures |= comparison.figures
            tables = {**comparison.tables, **tables}
        of_frictions: Any = table.frame.groupby("mu", sort=False)
        data = OrientationData(machine, dict(iter(of_frictions)), comparison)
        defaults = {"frictions": frictions, "speeds": speeds}
        return Findings(all_figures, data, machine, {}, steps, tables=tables, defaults=defaults)

    def judgements(self, f: Mapping[str, Figure], r: OrientationData) -> list[Judgement]:
        """How fast the rotor may turn, how long orienting takes, and from where on friction matters."""
        if r.comparison:
            return r.comparison.judgements()
        what = "friction changes the orientation time by less than " + percent(SPREAD - 1.0)
        judgements = [
            Judgement(f"with friction {mu:g} the rotor may turn at up to", f[key("limit", mu)])
            for mu in sorted(r.series, reverse=True)
        ]
        if "shortest_time" in f:
            judgements.append(Judgement("orienting a product takes at least", f["shortest_time"]))
        if "fan" in f:
            note = f"{f['fan'].value:.4g} rpm"
            judgements.append(Judgement(f"{what} at the speeds of the sweep below", note=note))
        return judgements

    def show(self, f: Mapping[str, Figure], r: OrientationData) -> Show:
        """The curves, and for each limit the last product that is oriented beside the first that jams."""
        curves, marks, motions = [], [], []
        for (mu, products), color in zip(r.series.items(), SERIES * len(r.series)):
            oriented, jam = oriented_and_jam(products)
            n, time = (oriented[x].to_list() for x in ("n", "orientation_time"))
            if n:
                curves.append(Curve(f"friction {mu:g}", n, time, color, "linked"))
            if n and not jam.empty:
                marks.append(Mark(n[-1], f"friction {mu:g} jams beyond {n[-1]:.2f} rpm"))
                if not r.comparison:
                    motions.append(pair(r.machine, mu, n[-1], float(jam["n"].iloc[0])))
        title = "The orientation time over the speed of the rotor"
        panel = Panel("orientation time", "s", curves, includes=(0.0,))
        chart = Chart(title, "rotor speed [rpm]", [panel], [] if r.comparison else marks)
        charts = [chart] if curves else []
        if r.comparison:
            return Show([*r.comparison.charts(), *charts], r.comparison.motions())
        return Show(charts, motions)


OrientationComparison = formula_comparison.FormulaComparison | neglected.NeglectedComparison


class OrientationData(NamedTuple):
    """The machine, its products for each friction, and what they are compared with."""

    machine: System
    series: Mapping[float, Frame]
    comparison: OrientationComparison | None


def frictions_and_speeds(o: OrientationTime) -> tuple[Sequence[float], Sequence[float]]:
    """Return the frictions and the speeds [rad/s] of the sweep; raises SetupError for what cannot be compared."""
    if o.compare == NEGLECTED:
        check_fixed_starts(o.start, neglected.NEGLECTED_STARTS)
    frictions = o.frictions or FRICTIONS.get(o.compare, (o.friction,))
    if o.compare == FORMULA and min(frictions) <= 0.0:
        raise SetupError(
            f"frictions = {min(frictions):g} must be a finite number above 0: without friction the formula "
            "finds no limit"
        )
    some = [n / RPM for n in (SLOW_SPEEDS if o.compare == NEGLECTED else SPEEDS)]
    return frictions, sorted(o.speeds or some)


def compared(
    o: OrientationTime,
    context: Context,
    machine: System,
    frictions: Sequence[float],
    speeds: Sequence[float],
) -> OrientationComparison | None:
    """Return the comparison that the options choose."""
    if o.compare == FORMULA:
        return formula_comparison.compare_with_formula(context, machine, o.friction, frictions)
    if o.compare == NEGLECTED:
        kinds = neglected.machines(machine, o.friction, o.catcher, o.rim, o.length)
        return neglected.compare_with_effects(context, kinds, o.friction, o.speed, speeds)
    return None


def orientation_at(machine: System, row: Any, width: float, meaning: str) -> Figure:
    """The time of the product of a row; its error holds what a rotor slower by a width [rpm] changes."""
    products = Product.of(machine, row.mu, [row.n / RPM, max(0.0, row.n - width) / RPM])
    context = Context(machine.parts)
    at, slower = (x.solve(context).figures["orientation_time"] for x in products)
    changed = figure_of_figures(lambda x, y: x - y, at, slower, unit="s")
    if changed.error is None:
        return Figure.undetermined("s", changed.reason, meaning)
    return at._replace(error=(at.error or 0.0) + abs(changed.value), meaning=meaning)


def figures(machine: System, products: Frame) -> dict[str, Figure]:
    """The shortest time of orientation; for each friction the fastest rotor that works, as near as it
    was located, and its products; from where on friction matters.
    """
    works = products[products["stage"] == orientator.ORIENTED]
    all_figures = {}
    for row in works.nsmallest(1, "orientation_time").itertuples():
        where = f"shortest orientation time, friction {row.mu:g} at {row.n:g} rpm"
        all_figures["shortest_time"] = orientation_at(machine, row, 0.0, where)
    for mu, some in products.groupby("mu", sort=False):
        limit, (oriented, _) = limit_of(some), oriented_and_jam(some)
        of_friction = {"limit": limit}
        if limit.error is not None:
            (last,) = oriented.tail(1).itertuples()
            time = orientation_at(machine, last, limit.error, "orientation time there")
            of_friction["orientation_time"] = time
            of_friction["products"] = figure_of_figures(
                lambda x: 60.0 / x,
                time,
                unit="1/min",
                meaning="products per minute there, with one catcher",
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
