"""Pace and power of the packing line in its last whole cycles, and the orders of its two drives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, SetupError
from cosim.metrics import TURN, Largest, Mean, Rms, Smallest, harmonics
from workbench import Figure
from workbench.figure import ROUNDING

from ..orientator import machine as orientator
from .line import POWERS

STATISTICS = {
    "mean": "mean power",
    "rms": "ripple of the power",
    "least": "smallest power",
    "most": "largest power",
}
#: Highest order of each drive: that of the cam has the orders of its phases, the crank even ones; a convention.
HIGHEST = {"iron": 12, "conveyor": 4}
#: Whole cycles at the end over which powers are measured; a convention, two show whether they repeat.
MEASURED = 2
#: Even angles of a turn at which a power is taken, ten for each of the orders; a convention.
EVEN = 120
ORDER_UNITS = {"drive": "1", "order": "1", "frequency": "Hz", "own": "W", "supply": "W"}
#: Amplitude of an order over the largest one of its drive above which it counts as strong; a convention.
MAIN = 0.1
Quantities = dict[str, tuple[float, str, str]]


def releases(r: Result) -> list[int]:
    """The rows of the releases, whole cycles apart; raises SetupError where the cam does not keep
    turning.
    """
    phi = r["iron.phi"]
    if np.diff(phi).min() <= 0.0:
        raise SetupError(
            f"the cam stops or turns back, and ends at iron.phi = {phi[-1]:.4g} rad: at this "
            "speed its motor cannot lift the iron"
        )
    rows: list[int] = (np.flatnonzero(np.diff(r["iron.top_dwell"]) > 0.0) + 1).tolist()
    return rows


class Order(NamedTuple):
    """An order of the angle of a drive: its frequency [Hz], its amplitude in the power of the drive's
    motor, and with all of the other drive that it beats with, as the supply has it at worst [W].
    """

    drive: str
    order: int
    frequency: float
    order_power: float
    supply: float


class LastTurns(NamedTuple):
    """The last whole turns of a drive: how long they last [s], their number; power of the motor [W]:
    mean, ripple, least, most, orders.
    """

    lasted: float
    number: int
    power: list[float]
    orders: list[Order]


def turns(r: Result, drive: str) -> LastTurns:
    """Those of the last cycles, of the cam from release to release, of the crank from where the trough is
    farthest; raises SetupError where there are none.
    """
    ends, begin = releases(r), 0.0
    if drive == "iron":
        begin = r.provenance["parts"]["iron"]["parameters"]["cam.rise"]
    rows = slice(ends[-1 - MEASURED] - 1, ends[-1] + 1)
    t, phi = (r[x][rows] for x in ("time", f"{drive}.phi"))
    first, last = math.ceil((phi[0] - begin) / TURN), math.floor((phi[-1] - begin) / TURN)
    if np.diff(phi).min() <= 0.0 or first >= last:
        raise SetupError(
            f"{drive}.phi goes from {phi[0]:.4g} to {phi[-1]:.4g} rad in the last {MEASURED} cycles, but "
            "must advance by a whole turn: the drive is too slow"
        )
    began, ended = CubicSpline(phi, t)(begin + TURN * np.array([first, last])).tolist()
    lasted, number = ended - began, last - first
    course = r.solution(POWERS[drive][0])
    power = course.between(began, ended)
    mean, rms, low, high = (x("").measure(power)[0] for x in (Mean, Rms, Smallest, Largest))
    angles = begin + TURN * np.arange(first * EVEN, last * EVEN) / EVEN
    at_angles = course(CubicSpline(phi, t)(angles))[0]
    sizes = np.abs(harmonics(angles, at_angles, HIGHEST[drive])).tolist()
    orders = [Order(drive, k, k * number / lasted, x, x) for k, x in enumerate(sizes, 1)]
    return LastTurns(lasted, number, [mean, math.sqrt(rms**2 - mean**2), low, high], orders)


def cycle_figures(r: Result) -> dict[str, Figure]:
    """Counts of products, and what the last cycles tell, with what they differ from those that end a cycle before,
    which is not settled. Raises SetupError where there are too few.
    """
    begins = releases(r)
    if len(begins) < MEASURED + 2:
        raise SetupError(
            f"stop = {r['time'][-1]:g} s is too short: it covers {len(begins)} of the {MEASURED + 2} "
            f"releases needed. The figures are those of the last {MEASURED} cycles, and the cycle before "
            "them shows how settled they are"
        )
    window = slice(begins[0], begins[-1] + 1)
    counts = {
        "released": (len(begins) - 1, "products released in the whole cycles"),
        "oriented": (np.ptp(r["orientator.oriented"][window]), "products oriented among these"),
        "missed": (
            r["orientator.missed"][window][-2],
            "products released while another was under way",
        ),
    }
    before = cycles(r.select(slice(begins[-2] + 1)))
    figures = {name: Figure(float(x), "1", 0.0, meaning) for name, (x, meaning) in counts.items()}
    for name, x in cycles(r).items():
        shifted = abs(x.value - before[name].value)
        error = None if x.error is None else shifted + ROUNDING * abs(x.value)
        figures[name] = x._replace(error=error)
    return figures


def cycles(r: Result) -> dict[str, Figure]:
    """Pace, cost of jams, powers and their ripple; no time of orientation after a jam."""
    both = turns_of_drives(r)
    iron, _ = both
    cycle = iron.lasted / iron.number
    quantities: Quantities = {
        "cycle": (cycle, "s", "mean time from release to release"),
        "cam": (TURN / cycle, "rad/s", "mean speed of the cam"),
        **power_figures(both),
        **strongest_orders(both),
    }
    quantities["work"] = quantities["mean_supply"][0] * cycle, "J", "work of the supply in a cycle"
    figures = {n: Figure(float(x), unit, 0.0, what) for n, (x, unit, what) in quantities.items()}
    return figures | product_figures(r, cycle)


def power_figures(both: Sequence[LastTurns]) -> Quantities:
    """Return the powers of the drives and of their supply.

    Cam and crank have no common period, so that their powers add in the long run: means and ends as they
    are, ripples as mean squares.
    """
    iron, conveyor = both
    supply = [a + b for a, b in zip(iron.power, conveyor.power)]
    supply[1] = math.hypot(iron.power[1], conveyor.power[1])
    ends = {"iron": iron.power, "conveyor": conveyor.power, "supply": supply}
    return {
        f"{word}_{name}": (value, "W", f"{meaning} of {POWERS[name][1]}")
        for name, values in ends.items()
        for (word, meaning), value in zip(STATISTICS.items(), values)
    }


def strongest_orders(both: Sequence[LastTurns]) -> Quantities:
    """Return the largest order of each drive, and the two strong ones that are nearest in frequency."""
    orders, quantities = with_supply_power(both), Quantities()
    for drive in sorted(HIGHEST):
        main, who = largest_order(orders, drive), POWERS[drive][1]
        quantities[f"main_{drive}"] = main.order_power, "W", f"largest order in the power of {who}"
        meaning = f"frequency of that order of {who}"
        quantities[f"main_{drive}_frequency"] = main.frequency, "Hz", meaning
    x, y = nearest(orders)
    gap, worst = abs(x.frequency - y.frequency), x.order_power + y.order_power
    return quantities | {
        "gap": (gap, "Hz", "distance between the nearest main orders of cam and crank"),
        "beat": (60 * gap, "1/min", "beats of these two orders"),
        "together": (worst, "W", "amplitude of these two orders together, at worst"),
    }


def product_figures(r: Result, cycle: float) -> dict[str, Figure]:
    """Return the pace of the products, and the time of the last one; none after a jam."""
    begins = releases(r)
    time, reason = (r[f"orientator.{x}"][begins[-1] - 1] for x in ("orientation_time", "reason"))
    oriented = np.ptp(r["orientator.oriented"][begins[0] : begins[-1] + 1])
    share = float(oriented) / (len(begins) - 1)
    times = {
        "orientation": (float(time), "orientation time of the last product"),
        "spare": (float(cycle - time), "time to spare in a cycle"),
    }
    why = "a product is still under way when the next is released"
    if reason:
        why = f"the orientator jams: {orientator.REASONS[int(reason)]}"
    figures = {
        name: Figure(x, "s", 0.0, meaning)
        if share == 1.0
        else Figure.undetermined("s", why, meaning)
        for name, (x, meaning) in times.items()
    }
    return figures | {
        "products": Figure(60 / cycle * share, "1/min", 0.0, "oriented products"),
        "lost": Figure(60 / cycle * (1 - share), "1/min", 0.0, "products lost to jams"),
    }


def turns_of_drives(r: Result) -> list[LastTurns]:
    """The cam and the crank in the last cycles."""
    return [turns(r, drive) for drive in HIGHEST]


def with_supply_power(both: Sequence[LastTurns]) -> list[Order]:
    """The orders of cam and crank."""
    orders = [x for drive in both for x in drive.orders]
    return [
        x._replace(
            supply=x.order_power
            + sum(
                y.order_power for y in orders if y.drive != x.drive and are_close_in_frequency(x, y)
            )
        )
        for x in orders
    ]


def are_close_in_frequency(x: Order, y: Order) -> bool:
    """Whether they are less than half a turn of the slower drive apart."""
    slower = min(z.frequency / z.order for z in (x, y))
    return abs(x.frequency - y.frequency) < slower / 2


def largest_order(orders: Sequence[Order], drive: str) -> Order:
    """The order of a drive that its motor feels most."""
    return max((x for x in orders if x.drive == drive), key=lambda x: x.order_power)


def nearest(orders: Sequence[Order]) -> tuple[Order, Order]:
    """Of the strong orders of cam and crank the two nearest in frequency."""
    strong = [
        x for x in orders if x.order_power > MAIN * largest_order(orders, x.drive).order_power
    ]
    cam, crank = ([x for x in strong if x.drive == drive] for drive in HIGHEST)
    return min(
        ((x, y) for x in cam for y in crank),
        key=lambda pair: abs(pair[0].frequency - pair[1].frequency),
    )
