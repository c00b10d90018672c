"""Does the packing line keep pace, what does a jam cost, and what does its supply have to bear?

One motor drives the sealing iron; its cam shaft turns the orientator's rotor through a gear and
releases a product at the start of each top dwell; a conveyor on its own motor feeds it. The
orientator takes no power from the shaft in its model, so that the supply gives that of two motors.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cosim
from cosim import Estimate, Result
from cosim.progress import bar

from . import fmus, iron, options, orientator, packing, packing_plot, packing_show
from .answer import Answer, Figure, Show, Table, finish, parameters, question
from .packing import Line
from .theory import SETS

PARTS = packing.PARTS
MEANING = {
    "cycle": "mean time from release to release",
    "cam": "mean speed of the cam",
    "mean_iron": "mean power of the iron's motor",
    "rms_iron": "its ripple",
    "mean_conveyor": "mean power of the conveyor's motor",
    "rms_conveyor": "its ripple",
    "mean_supply": "mean power of the supply",
    "rms_supply": "its ripple",
    "orientation": "time of orientation of the last product",
}
SHAFTS = {"iron": "cam", "conveyor": "crank"}
MAIN, APART = 0.1, 0.05
TABLE = "packing_line.csv"
UNITS = {"orientation": "s", "cycle": "s", "cam": "rad/s", "mean": "W", "rms": "W"}


def verdict(result: Result, found: Mapping[str, Estimate]) -> str:
    """The answer in plain words."""
    told = {name: value.text(UNITS[name.partition("_")[0]]) for name, value in found.items()}
    return "\n".join([_pace(result, found, told), _jam(result, found), _supply(result, told)])


def _pace(result: Result, found: Mapping[str, Estimate], told: Mapping[str, str]) -> str:
    count = packing.pace(result)
    cycle = f"the next release comes after {told['cycle']}"
    if count.oriented < count.released:
        why = orientator.item_names("reason")[count.reason]
        missed = result["orientator.missed"][count.releases[-1]]
        end = f", {missed:.0f} of the releases find it under way" if missed else ""
        return (
            f"{count.oriented} of {count.released} products are oriented: the orientator jams "
            f"({why}){end}; {cycle}."
        )
    spare = found["cycle"].value - found["orientation"].value
    return (
        f"Every product is oriented in {told['orientation']}; {cycle}: {spare:.3f} s to spare, "
        f"{spare / found['cycle'].value:.0%} of the cycle."
    )


def _jam(result: Result, found: Mapping[str, Estimate]) -> str:
    count = packing.pace(result)
    rate = 60 / found["cycle"].value
    work = found["mean_supply"].value * found["cycle"].value
    lost = rate * (1 - count.oriented / count.released)
    return (
        f"Of {rate:.2f} products/min jams cost {lost:.2f}. Each costs its product and the "
        f"{work:.4g} J that the supply gives in a cycle; each minute of clearing, {rate:.2f} more."
    )


def _supply(result: Result, told: Mapping[str, str]) -> str:
    rows, power, lines = packing.window(result), packing.powers(result), packing.ripple(result)
    text = []
    for name in ("iron", "conveyor", "supply"):
        swing = power[name][rows]
        sizes = {x: x.supply if name == "supply" else x.own for x in lines}
        main = [x for x in sorted(lines, key=lambda x: -sizes[x]) if name in (x.drive, "supply")]
        orders = ", ".join(
            f"{SHAFTS[x.drive]} {x.order} ({x.frequency:.2f} Hz) {sizes[x]:.4g} W" for x in main[:3]
        )
        text.append(
            f"Power of the {name}: mean {told[f'mean_{name}']}, ripple {told[f'rms_{name}']} rms, "
            f"{swing.min():.4g} .. {swing.max():.4g} W; main orders: {orders}."
        )
    return "\n".join([*text, together(result, lines)])


def together(result: Result, lines: Sequence[Line]) -> str:
    """Whether the ripples of the two drives add."""
    strong = {
        drive: [x for x in lines if x.drive == drive and x.own > MAIN * most]
        for drive in packing.DRIVES
        for most in [max(x.own for x in lines if x.drive == drive)]
    }
    cam, crank = min(
        ((a, b) for a in strong["iron"] for b in strong["conveyor"]),
        key=lambda pair: abs(pair[0].frequency - pair[1].frequency),
    )
    gap = abs(cam.frequency - crank.frequency)
    r = packing.correlation(result)
    if gap < cam.frequency / cam.order / 2:
        return (
            f"The ripples meet: order {cam.order} of the cam and order {crank.order} of the crank "
            f"are {gap:.3g} Hz apart and beat {60 * gap:.3g} times a "
            f"minute; at worst they add to {cam.own + crank.own:.4g} W."
        )
    sums = "add in squares" if abs(r) < APART else f"add with correlation {r:.2f}"
    return (
        f"The ripples sit apart in frequency, the nearest main orders (cam {cam.order}, crank "
        f"{crank.order}) by {gap:.2f} Hz: their rms values {sums}."
    )


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--gear", type=float, default=1.25, help="speed of the rotor over speed of the cam")
    add("--iron-speed", type=float, default=iron.NOMINAL, help="no-load speed of the cam [rad/s]")
    add("--conveyor-set", choices=SETS, default="B", help="parameter set of the conveyor's drive")
    add("--speed", type=float, default=60.0, help="mean speed of the crank [rad/s]")
    add("--stop", type=float, default=5.5, help="simulated time [s]")
    add("--step", type=float, default=2e-3, help="coarsest of three communication steps [s]")
    add("--algorithm", choices=cosim.ALGORITHMS, default="strang", help="coupling algorithm")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/packing_line by default")
    options.add_start(parser, "conveyor_motor.T=0.05")


def answer(
    gear: float = 1.25,
    iron_speed: float = iron.NOMINAL,
    conveyor_set: str = "B",
    speed: float = 60.0,
    stop: float = 5.5,
    step: float = 2e-3,
    algorithm: str = "strang",
    start: Sequence[str] = (),
    out: Path | None = None,
) -> Answer:
    """Certify the line's figures with three runs; rows of the last are kept in `out` on the way."""
    options.positive("gear", gear, "turns of the rotor per turn of the cam")
    options.positive("iron speed", iron_speed, "rad/s")
    options.positive("speed", speed, "rad/s")
    least = (packing.FIRST_RELEASE - packing.START + 4.2 * math.pi) / iron_speed
    if not least <= stop < math.inf:
        raise cosim.SetupError(
            f"stop = {stop!r} s must be at least {least:.3f} s, two cycles after the first release"
        )
    changes = options.start_values(start)
    fmus.build(*PARTS.values())
    line = packing.system(gear, iron_speed, conveyor_set, speed, changes)
    times: list[float] = []

    def seen(result: Result) -> dict[str, float]:
        found = packing.averages(result)
        times.append(packing.orientation(result))
        return found

    with bar("line", 0.0, stop) as progress:
        result, found = cosim.certify(
            line,
            seen,
            stop=stop,
            step=step,
            algorithm=algorithm,
            record=packing.RECORD,
            csv=out and out / TABLE,
            progress=progress,
        )
    # Releases fall on communication points, so that this error falls in no order: it is the spread.
    found["orientation"] = Estimate(times[-1], max(times) - min(times), 0.0)
    count = packing.pace(result)
    frame = result.frame.assign(P_supply=packing.powers(result)["supply"])
    return Answer(
        scenario="packing_line",
        question=question(__doc__),
        verdict=verdict(result, found),
        figures=figures(found, count),
        parameters=parameters(line),
        tables={TABLE: Table(frame, result.units | {"P_supply": "W"})},
        provenance=result.provenance | {"flavour": fmus.flavour()},
        stem="packing_line",
        facts={
            "gear": gear,
            "products": {"released": count.released, "oriented": count.oriented},
            "reason": orientator.item_names("reason")[count.reason],
            "ripple": [x._asdict() for x in packing.ripple(result)],
            "correlation": packing.correlation(result),
        },
        files={
            "packing_line.png": lambda path: packing_plot.timing(path, result, count, gear),
            "line.ssp": lambda path: cosim.write_ssp(line, path, stop=stop),
        },
        show=lambda: Show(
            [packing_show.line(result, count)],
            [packing_show.motion(result, count, iron.own(dict(line.start)))],
        ),
    )


def figures(found: Mapping[str, Estimate], count: packing.Pace) -> dict[str, Figure]:
    """What three runs tell, and the products that leave the line; no orientation after a jam."""
    told = {
        name: Figure.of(value, UNITS[name.partition("_")[0]], MEANING[name])
        for name, value in found.items()
        if name != "orientation" or value.value > 0.0
    }
    cycle = found["cycle"]
    rate = 60 / cycle.value * count.oriented / count.released
    error = None if cycle.error is None else rate * cycle.error / cycle.value
    return told | {"products": Figure(rate, "1/min", error, meaning="oriented products")}


def run(out: Path = Path("results/packing_line"), **settings: Any) -> None:
    """Write the answer and print the verdict."""
    finish(answer(out=out, **settings), out)
