"""Does the packing line keep pace, what does a jam cost, and what does its supply have to bear?

One motor drives the sealing iron; its cam shaft turns the orientator's rotor through a gear and
releases a product at the start of each top dwell; a conveyor on its own motor feeds it. The
orientator takes no power from the shaft in its model, so that the supply gives that of two motors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cosim
from cosim import Result, System
from workbench import Bench, Figure, Findings, Run, Show, Table, option
from workbench.measure import largest, over_rows, smallest

from ..conveyor.theory import SETS
from ..iron import drive as iron
from ..orientator import machine as orientator
from . import line as packing
from . import show as pictures
from .line import Line

PARTS = packing.PARTS
TABLE, ORDERS = "packing_line.csv", "packing_line_orders.csv"
MEANING = {
    "cycle": ("s", "mean time from release to release"),
    "cam": ("rad/s", "mean speed of the cam"),
    "mean_iron": ("W", "mean power of the iron's motor"),
    "rms_iron": ("W", "its ripple"),
    "mean_conveyor": ("W", "mean power of the conveyor's motor"),
    "rms_conveyor": ("W", "its ripple"),
    "mean_supply": ("W", "mean power of the supply"),
    "rms_supply": ("W", "its ripple"),
    "orientation": ("s", "time of orientation of the last product"),
    "spare": ("s", "time to spare in a cycle"),
    "products": ("1/min", "oriented products"),
    "lost": ("1/min", "products lost to jams"),
    "work": ("J", "work of the supply in a cycle"),
    "main_iron": ("W", "largest order of the cam, in its motor's power"),
    "main_iron_frequency": ("Hz", "its frequency"),
    "main_conveyor": ("W", "largest order of the crank, in its motor's power"),
    "main_conveyor_frequency": ("Hz", "its frequency"),
    "gap": ("Hz", "distance of the nearest main orders of cam and crank"),
    "beat": ("1/min", "how often they beat"),
    "together": ("W", "what they add to at worst"),
    "correlation": ("1", "correlation of the powers of the two drives"),
}
AFTER_JAM = ("orientation", "spare")
SHAFTS = {"iron": "cam", "conveyor": "crank"}
MAIN, APART = 0.1, 0.05
UNITS = {"drive": "1", "order": "1", "frequency": "Hz", "own": "W", "supply": "W"}


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    gear: float = option(1.25, "speed of the rotor over speed of the cam", "1", above=0.0)
    iron_speed: float = option(iron.NOMINAL, "no-load speed of the cam", "rad/s", above=0.0)
    set: str = option("B", "parameter set of the conveyor's drive", choices=SETS)
    speed: float = option(60.0, "mean speed of the crank", "rad/s", above=0.0)
    stop: float = option(5.5, "simulated time", "s", above=0.0)
    step: float = option(5e-4, "finest of three communication steps", "s", above=0.0)


class Course(NamedTuple):
    """The run, its products, the orders of its powers, and the iron drive by itself."""

    result: Result
    pace: packing.Pace
    lines: Sequence[Line]
    alone: iron.Alone


def solve(o: Options, bench: Bench) -> Findings:
    """The line, long enough for two cycles."""
    least = (packing.FIRST_RELEASE - packing.START + 4.2 * math.pi) / o.iron_speed
    if o.stop < least:
        raise cosim.SetupError(
            f"stop = {o.stop:g} s must be at least {least:.3f} s, two cycles after the first release"
        )
    line = system(o, bench.fmus)
    result, found = bench.certify(line, figures, o, packing.RECORD, TABLE)
    lines = packing.ripple(result)
    frame = result.frame.assign(P_supply=packing.powers(result)["supply"])
    units = result.units | {"P_supply": result.units["iron_motor.P"]}
    alone = iron.own(bench.fmus, line.start)
    return Findings(
        found,
        Course(result, packing.pace(result), lines, alone),
        line,
        result.provenance,
        tables={TABLE: Table(frame, units), ORDERS: Table.of_rows(lines, UNITS)},
        files={"line.ssp": partial(_ssp, line, o.stop)},
    )


def system(o: Options, fmus: Mapping[str, Path]) -> System:
    """The line."""
    return packing.system(fmus, o.gear, o.iron_speed, o.set, o.speed, o.start)


def _ssp(line: System, stop: float, path: Path) -> None:
    cosim.write_ssp(line, path, stop=stop)


def figures(r: Result) -> dict[str, Figure]:
    """Pace, cost of jams, powers and their ripple; no time of orientation after a jam."""
    pace, units = packing.pace(r), MEANING
    jam = f"the orientator jams: {orientator.ITEMS['reason'][pace.reason]}"
    found = {
        "released": Figure(float(pace.released), "1", 0.0, "products released in the whole cycles"),
        "oriented": Figure(float(pace.oriented), "1", 0.0, "products oriented of these"),
    }
    for name, value in over_rows(averages, r).items():
        found[name] = value.figure(*units[name])
        if name in AFTER_JAM and pace.oriented < pace.released:
            found[name] = Figure.refused(units[name][0], jam, units[name][1])
    rows = packing.window(r)
    for name, power in packing.powers(r).items():
        t, unit, whose = r["time"][rows], r.units["iron_motor.P"], f"power of the {name}"
        found[f"least_{name}"] = smallest(t, power[rows]).figure(unit, f"least {whose}")
        found[f"most_{name}"] = largest(t, power[rows]).figure(unit, f"largest {whose}")
    return found


def averages(r: Result) -> dict[str, float]:
    """What the rows tell of the whole cycles."""
    pace, lines, found = packing.pace(r), packing.ripple(r), packing.averages(r)
    orientation, rate = packing.orientation(r), 60 / found["cycle"]
    cam, crank = nearest(lines)
    gap = abs(cam.frequency - crank.frequency)
    for drive in SHAFTS:
        main = max((x for x in lines if x.drive == drive), key=lambda x: x.own)
        found |= {f"main_{drive}": main.own, f"main_{drive}_frequency": main.frequency}
    return found | {
        "orientation": orientation,
        "spare": found["cycle"] - orientation,
        "products": rate * pace.oriented / pace.released,
        "lost": rate * (1 - pace.oriented / pace.released),
        "work": found["mean_supply"] * found["cycle"],
        "gap": gap,
        "beat": 60 * gap,
        "together": cam.own + crank.own,
        "correlation": packing.correlation(r),
    }


def nearest(lines: Sequence[Line]) -> tuple[Line, Line]:
    """Of the strong orders of cam and crank the two that are nearest to each other in frequency."""
    strong = {
        drive: [x for x in lines if x.drive == drive and x.own > MAIN * most]
        for drive in SHAFTS
        for most in [max(x.own for x in lines if x.drive == drive)]
    }
    return min(
        ((a, b) for a in strong["iron"] for b in strong["conveyor"]),
        key=lambda pair: abs(pair[0].frequency - pair[1].frequency),
    )


def verdict(o: Options, f: Mapping[str, Figure], r: Course) -> str:
    """Whether the line keeps pace, what a jam costs, and what the supply bears."""
    told = {name: figure.text() for name, figure in f.items()}
    if r.pace.oriented == r.pace.released:
        pace = (
            f"The line keeps pace: every product is oriented in {told['orientation']} and the next "
            f"comes after {told['cycle']}, {told['spare']} to spare."
        )
    else:
        missed = r.result["orientator.missed"][r.pace.releases[-1]]
        under_way = f"; {missed:.0f} of the releases find it under way" if missed else ""
        pace = (
            f"The line does not keep pace: {r.pace.oriented} of {r.pace.released} products are "
            f"oriented, {f['orientation'].reason}{under_way}."
        )
    products, lost = f["products"].text("products/min"), f["lost"].text("products/min")
    lines = [
        f"{pace} The line makes {products} and jams cost {lost}. The supply gives "
        f"{told['mean_supply']} with a ripple of {told['rms_supply']} rms, between "
        f"{told['least_supply']} and {told['most_supply']}.",
        f"A jam costs its product and the {told['work']} that the supply gives in a cycle; each minute "
        "of clearing, a minute's products more.",
    ]
    for drive, shaft in SHAFTS.items():
        main = max((x for x in r.lines if x.drive == drive), key=lambda x: x.own)
        lines.append(
            f"Power of the {drive}: mean {told[f'mean_{drive}']}, ripple {told[f'rms_{drive}']} rms, "
            f"between {told[f'least_{drive}']} and {told[f'most_{drive}']}; most of it in order "
            f"{main.order} of the {shaft}, {told[f'main_{drive}']} at "
            f"{told[f'main_{drive}_frequency']}."
        )
    return "\n".join([*lines, together(f, r.lines)])


def together(f: Mapping[str, Figure], lines: Sequence[Line]) -> str:
    """Whether the ripples of the two drives add."""
    cam, crank = nearest(lines)
    if f["gap"].value < cam.frequency / cam.order / 2:
        return (
            f"The ripples meet: order {cam.order} of the cam and order {crank.order} of the crank "
            f"are {f['gap'].text()} apart and beat {f['beat'].text('times a minute')}; at worst they "
            f"add to {f['together'].text()}."
        )
    r = f["correlation"]
    sums = "add in squares" if abs(r.value) < APART else f"add with correlation {r.text()}"
    return (
        f"The ripples sit apart in frequency, the nearest main orders (cam {cam.order}, crank "
        f"{crank.order}) by {f['gap'].text()}: their rms values {sums}."
    )


def show(o: Options, f: Mapping[str, Figure], r: Course) -> Show:
    """The whole cycles, and the last of them in motion."""
    return Show([pictures.line(r.result, r.pace)], [pictures.motion(r.result, r.pace, r.alone)])
