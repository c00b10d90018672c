"""Products at many speeds of the rotor: how each ends, and the fastest rotor that orients them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

import cosim
from cosim import Result, System
from workbench import Context, Figure, Number
from workbench.charts.motion import Motion
from workbench.find import Find, LineSearch, search
from workbench.orbits import Motions, measured

from . import machine as orientator
from . import motion
from .limit_formula import OrientatorParameters
from .passage import STAGES_PASSED, Passage, last

if TYPE_CHECKING:
    from pandas import DataFrame

#: Start values that a run of one product sets: friction on the wall, speed of the rotor, release.
PRODUCT_STARTS = ("orientator.chute.mu", "orientator.w", "orientator.release")
PRODUCT_UNITS = {
    "mu": "1", "n": "rpm", "stage": "1", "reason": "1", "orientation_time": "s",
    **{f"t_{x}": "s" for x in STAGES_PASSED},
}  # fmt: skip
RPM = 30 / math.pi
#: Communication step of a product [s]. The FMU locates its events inside a step; what half of it changes is in
#: the error of a time. A convention.
STEP = 0.02
#: Spacing of the speeds at which a limit is sought, over the closed bound of stage joint; a convention, since the
#: bracket is narrowed afterwards.
SPACING = 0.03
#: The slowest of these speeds, over that bound; a convention.
SLOWEST_PRODUCT = 0.5

#: Speeds below a limit at which products are tried again; a convention.
CHECKS = 10


class Product(Passage):
    """One of many products: which stage it comes to, and why it jams."""

    numbers: ClassVar[Any] = (
        *(Number(x, last(x), meaning=f"{x} at the end") for x in ("stage", "reason")),
        *Passage.numbers,
    )

    @classmethod
    def of(
        cls, machine: System, friction: float, speeds: Iterable[float], step: float = STEP
    ) -> list[Product]:
        """Return products of a machine at a friction on the wall and rising speeds of the rotor [rad/s]."""
        start = {x: value for x, value in machine.start.items() if x not in PRODUCT_STARTS}
        return [
            cls.parse(
                {"start": start, "speed": float(w), "friction": float(friction), "step": step}
            )
            for w in speeds
        ]


def run_product(machine: System, mu: float, n: float, step: float) -> Result:
    """Run one product at a friction on the wall and a rotor speed [rpm]."""
    (product,) = Product.of(machine, mu, [n / RPM])
    return cosim.run(product.system(machine.parts), stop=product.stop, step=step)


def pair(machine: System, mu: float, works: float, jams: float) -> Motion:
    """Return the last product that is oriented beside the first that jams, by their rotor speeds [rpm]."""
    runs = {f"{n:.7g} rpm": run_product(machine, mu, n, 1e-3) for n in (works, jams)}
    return motion.motion(f"Friction {mu:g}: {' works, '.join(runs)} does not", runs)


def table_of(products: Motions) -> DataFrame:
    """Return a row for each product, with nan for the times of stages that it does not reach."""
    from pandas import DataFrame

    columns = {name: products.columns[name].value for name in [*PRODUCT_UNITS][2:]}
    mu, n = zip(*((o.friction, round(o.speed * RPM, 9)) for o in products.asked))  # 20 rpm stay 20
    return DataFrame({"mu": mu, "n": n, **columns}).sort_values("n")


def until_jam(fmus: Mapping[str, Path], products: Sequence[Product]) -> DataFrame:
    """Return products at rising speeds, and those between and beside them that locate where the first of them jams.

    Some speeds below are tried, too, since jams may come and go there, and all is done again if one of these jams.
    """
    context = Context(fmus, certifies=False)
    speeds = np.array([o.speed for o in products])
    sought = Find("speed", speeds[0], speeds[-1], "oriented", 0.5, "all", "rad/s")
    line = LineSearch.along(measured(context, products), sought, speeds)
    while True:
        (places,) = search(context, [line])
        assert line.known is not None
        falls = [x.place for x in places if x.place.error is not None and not x.rises]
        if not falls:
            return table_of(line.known)
        at, width = falls[0].value, falls[0].error or 0.0
        above = int(np.searchsorted(line.x, at))
        first = max(0.0, at - width - float(line.x[above] - line.x[above - 1]))
        tried = np.array([*np.linspace(first, at - width, CHECKS + 2)[1:], at + width])
        ends = measured(context, [line.at(x) for x in tried.tolist()])
        line.take(tried, ends)
        if ends.columns["oriented"].value[:CHECKS].all():
            return table_of(line.known)


def oriented_and_jam(products: DataFrame) -> tuple[DataFrame, DataFrame]:
    """Return the products that are oriented up to the first jam beyond them, and that, if there is any."""
    works = (products["stage"] == orientator.ORIENTED).to_numpy()
    first = int(works.argmax()) if works.any() else len(works)
    jams = np.flatnonzero(~works[first:])
    end = first + int(jams[0]) if len(jams) else len(works)
    return products.iloc[first:end], products.iloc[end : end + 1]


def limit_of(products: DataFrame) -> Figure:
    """Return the last speed that works, with the distance of the jam as its error."""
    oriented, jam = oriented_and_jam(products)
    meaning = "largest rotor speed that works"
    if jam.empty or oriented.empty:
        which = "every product" if oriented.empty else "no product"
        return Figure.undetermined("rpm", f"{which} of the sweep jams", meaning)
    n, beyond = float(oriented["n"].iloc[-1]), jam.iloc[0]
    reason = orientator.REASONS[int(beyond["reason"])]
    return Figure(n, "rpm", float(beyond["n"]) - n, f"{meaning}; beyond it: {reason}")


def fastest(machine: System, mu: float, speeds: Iterable[float]) -> Figure:
    """Return the fastest rotor that orients before the first of rising speeds [rad/s] that jams, and why."""
    return limit_of(until_jam(machine.parts, Product.of(machine, mu, speeds)))


def simulated_limit(system: System, mu: float) -> tuple[OrientatorParameters, Figure]:
    """Return a machine with a friction, and its simulated limit, which the bound of stage joint is above."""
    machine = OrientatorParameters.of(
        System(system.parts, start={**system.start, "orientator.chute.mu": mu})
    )
    if not machine.joint_limit > 0.0:
        return machine, Figure.undetermined("rpm", "no product reaches the hook at any speed")
    shares = np.arange(SLOWEST_PRODUCT, 1.0 + SPACING, SPACING)
    return machine, fastest(system, mu, shares * math.sqrt(machine.joint_limit))
