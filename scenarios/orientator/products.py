"""Single products through the orientator: how each ends, and the fastest rotor that orients them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import dropwhile
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import cosim
from cosim import Result, System
from workbench import Figure

from . import machine as orientator
from .limit_formula import OrientatorParameters, rpm_of_squared

if TYPE_CHECKING:
    from pandas import DataFrame

#: Start values that a run of one product sets: friction on the wall, speed of the rotor, release.
PRODUCT_STARTS = ("orientator.chute.mu", "orientator.w", "orientator.release")
PRODUCT_UNITS = {
    "mu": "1", "n": "rpm", "stage": "1", "reason": "1", "orientation_time": "s", "t_falling": "s",
    "t_joint": "s", "t_turning": "s", "t_released": "s",
}  # fmt: skip
#: Communication step of a product [s]. The FMU locates its events inside a step; what half of it changes is in
#: the error of a time. A convention.
STEP = 0.02
#: Width to which the gap between a speed that works and one that jams is halved [rpm], a convention.
BRACKET = 0.01
#: Speeds below a limit at which products are tried again, since jams may come and go there; a convention.
CHECKS = 10
#: Spacing of the speeds at which a limit is sought, over the closed bound of stage joint; a convention, since the
#: bracket is halved afterwards.
SPACING = 0.03
#: The slowest of these speeds, over that bound; a convention.
SLOWEST_PRODUCT = 0.5


class Product(NamedTuple):
    """How one product ends: friction on the wall, rotor speed [rpm], stage and reason, and its times [s],
    nan for those that it does not reach.
    """

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
    def is_oriented(self) -> bool:
        """Whether it came out oriented."""
        return self.stage == orientator.ORIENTED


@dataclass(frozen=True)
class ProductsUntilJam:
    """Products of one friction by rising rotor speed: those that are oriented, and the first jam beyond."""

    oriented: Sequence[Product]
    jam: Product | None

    @classmethod
    def of(cls, products: Iterable[Product]) -> ProductsUntilJam:
        """Sort products by speed; those that jam below the first oriented one are left out."""
        oriented: list[Product] = []
        by_speed = sorted(products, key=lambda product: product.n)
        for product in dropwhile(lambda product: not product.is_oriented, by_speed):
            if not product.is_oriented:
                return cls(oriented, product)
            oriented.append(product)
        return cls(oriented, None)

    @classmethod
    def of_frame(cls, frame: DataFrame, mu: float) -> ProductsUntilJam:
        """Take the products of a friction from a table."""
        rows = frame[frame["mu"] == mu].itertuples(index=False)
        return cls.of(Product(*row) for row in rows)

    @property
    def gap_to_jam(self) -> float:
        """How far the first jam is above the last product that is oriented [rpm]; 0 without a jam."""
        return 0.0 if self.jam is None else self.jam.n - self.oriented[-1].n

    def limit(self) -> Figure:
        """Return the last speed that works; its error is the bracket."""
        which = "no product" if self.oriented else "every product"
        meaning = "largest rotor speed that works"
        if self.jam is None:
            return Figure.undetermined("rpm", f"{which} of the sweep jams", meaning)
        beyond = f"{meaning}; beyond it: {orientator.REASONS[self.jam.reason]}"
        return Figure(self.oriented[-1].n, "rpm", self.gap_to_jam, beyond)


def run_product(machine: System, mu: float, n: float, step: float) -> Result:
    """Run one product at a friction on the wall and a rotor speed [rpm]."""
    start = {**machine.start, **dict(zip(PRODUCT_STARTS, (mu, n * math.pi / 30)))}
    return cosim.run(replace(machine, start=start), stop=orientator.LONGEST, step=step)


def simulate(machine: System, mu: float, n: float, step: float = STEP) -> Product:
    """Return how one product ends."""
    result = run_product(machine, mu, n, step)
    stage, reason, *times = (float(result[f"orientator.{x}"][-1]) for x in [*PRODUCT_UNITS][2:])
    return Product(mu, n, int(stage), int(reason), *(time or math.nan for time in times))


def sweep(machine: System, speeds: Sequence[float], mu: float) -> list[Product]:
    """Return the products of a friction at these speeds [rpm], and those that locate the limit.

    The gap between the last speed that works and the first that jams is bisected. Some speeds below
    it are tried, too, and all is done again if one of these jams.
    """
    products = [simulate(machine, mu, n) for n in speeds]

    def works(n: float) -> bool:
        products.append(simulate(machine, mu, n))
        return products[-1].is_oriented

    while True:
        series = ProductsUntilJam.of(products)
        if series.jam is None or series.gap_to_jam <= BRACKET:
            return products
        low, high = series.oriented[-1].n, series.jam.n
        first = max(0.0, 2 * low - high)
        while high - low > BRACKET:
            middle = (low + high) / 2.0
            low, high = (middle, high) if works(middle) else (low, middle)
        tried = np.linspace(first, low, CHECKS + 2)[1:-1].tolist()
        products += [simulate(machine, mu, n) for n in tried]


def fastest(machine: System, speeds: Sequence[float], mu: float) -> Figure:
    """Return the fastest rotor that orients before the first of rising speeds [rpm] that jams, and why."""
    return ProductsUntilJam.of(sweep(machine, speeds, mu)).limit()


def simulated_limit(system: System, mu: float) -> tuple[OrientatorParameters, Figure]:
    """Return a machine with a friction, and its simulated limit, which the bound of stage joint is above."""
    machine = OrientatorParameters.of(
        replace(system, start={**system.start, "orientator.chute.mu": mu})
    )
    speeds = np.arange(SLOWEST_PRODUCT, 1.0 + SPACING, SPACING) * rpm_of_squared(
        machine.joint_limit
    )
    return machine, fastest(system, speeds.tolist(), mu)
