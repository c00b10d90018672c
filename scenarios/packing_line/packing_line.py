"""Does the packing line keep pace, what does a jam cost, and what does its supply have to bear?

One motor drives the sealing iron; its cam shaft turns the orientator's rotor through a gear and
releases a product at the start of each top dwell; a conveyor on its own motor feeds it. The
orientator takes no power from the shaft in its model, so that the supply gives that of two motors.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import cosim
from cosim import Result, System
from workbench import Bench, Chart, Curve, Figure, Findings, Mark, Panel, Run, Show, Table, option
from workbench.measure import largest, over_rows, smallest
from workbench.options import Start
from workbench.report.chart import LIFT, POWER, Lanes, Span, recorded
from workbench.report.motion import Motion, moved, rows

from ..conveyor.theory import SETS
from ..iron import drive as iron
from ..iron import mechanism as iron_mechanism
from ..orientator import machine as orientator
from ..orientator import mechanism as orientator_mechanism
from . import line as packing

PARTS = {
    "iron_motor": "DriveMotor",
    "iron": "IronDrive",
    "orientator": "GravityOrientator",
    "conveyor_motor": "DriveMotor",
    "conveyor": "CrankConveyor",
}
WIRES = (
    "iron_motor.tau -> iron.tau",
    "iron.w -> iron_motor.w",
    "iron.top_dwell -> orientator.release",
    "conveyor_motor.tau -> conveyor.tau",
    "conveyor.w -> conveyor_motor.w",
)
I_G, START = 36.0, math.radians(-60.0)
TABLE, ORDERS = "packing_line.csv", "packing_line_orders.csv"
RECORD = (
    "iron_motor.P", "iron_motor.tau", "iron.phi", "iron.w_cam", "iron.lift", "iron.top_dwell",
    "iron.E_kin", "iron.E_pot", "iron.E_friction", "iron.alpha", "iron.beta", "iron.H",
    "iron.motion", "orientator.phi1", "orientator.xc", "orientator.yc", "orientator.stage",
    "orientator.reason", "orientator.orientation_time", "orientator.phi2", "orientator.oriented",
    "orientator.jammed", "orientator.missed", "conveyor_motor.P", "conveyor_motor.tau",
    "conveyor.phi", "conveyor.w", "conveyor.x", "conveyor.E_kin", "conveyor.E_pot",
    "conveyor.P_loss",
)  # fmt: skip
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
AROUND = 0.05


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    gear: float = option(1.25, "speed of the rotor over speed of the cam", "1", above=0.0)
    iron_speed: float = option(iron.NOMINAL, "no-load speed of the cam", "rad/s", above=0.0)
    set: str = option("B", "parameter set of the conveyor's drive", choices=SETS)
    speed: float = option(60.0, "mean speed of the crank", "rad/s", above=0.0)
    stop: float = option(5.5, "simulated time", "s", above=0.0)
    step: float = option(5e-4, "finest of three communication steps", "s", above=0.0)


def system(o: Options, fmus: Mapping[str, Path]) -> System:
    """The line, its motors set for their speeds; all start values are parameters, because some hosts
    set no other ones."""
    slope = o.start.get("iron_motor.B", iron.MOTOR["motor.B"])
    ratio = o.start.get("iron.reducer.i_g", I_G)
    values: Start = {
        "iron_motor.A": float(slope) * float(ratio) * o.iron_speed,
        "iron_motor.B": slope,
        "iron_motor.T": iron.MOTOR["motor.T"],
        "iron.reducer.i_g": ratio,
    }
    own = {name.replace("conveyor_motor.", "motor."): value for name, value in o.start.items()}
    for name, value in SETS[o.set].follow(own).start(o.speed).items():
        if name not in ("motor.tau", "conveyor.phi", "conveyor.w"):
            values[name.replace("motor.", "conveyor_motor.")] = value
    wires = [*WIRES, f"iron.w_cam * {o.gear!r} -> orientator.w"]
    return System(fmus, wires, {**values, **o.start})


def solve(o: Options, bench: Bench) -> Findings:
    """The line, long enough for two cycles."""
    least = (packing.FIRST_RELEASE - START + 4.2 * math.pi) / o.iron_speed
    if o.stop < least:
        raise cosim.SetupError(
            f"stop = {o.stop:g} s must be at least {least:.3f} s, two cycles after the first release"
        )
    line = system(o, bench.fmus)
    r, found = bench.certify(line, figures, o, RECORD, TABLE)
    rows = r.frame.assign(P_supply=packing.powers(r)["supply"])
    units = r.units | {"P_supply": r.units["iron_motor.P"]}
    tables = {TABLE: Table(rows, units), ORDERS: Table(packing.ripple(r), packing.UNITS)}
    files = {"line.ssp": partial(cosim.write_ssp, line, stop=o.stop)}
    data = r, iron.alone(bench.fmus, line.start)
    return Findings(found, data, line, r.provenance, tables=tables, files=files)


def figures(r: Result) -> dict[str, Figure]:
    """Pace, cost of jams, powers and their ripple; no time of orientation after a jam."""
    releases, rows, unit = packing.releases(r), packing.window(r), r.units["iron_motor.P"]
    oriented = float(np.ptp(r["orientator.oriented"][rows]))
    missed, released = float(r["orientator.missed"][releases[-1]]), len(releases) - 1.0
    reason = int(r["orientator.reason"][rows][-2])
    jam = f"the orientator jams: {orientator.REASONS[reason]}"
    why = jam if reason else "a product is still under way when the next is released"
    found = {
        "released": Figure(released, "1", 0.0, "products released in the whole cycles"),
        "oriented": Figure(oriented, "1", 0.0, "products oriented of these"),
        "missed": Figure(missed, "1", 0.0, "releases that came while a product was under way"),
    }
    for name, value in over_rows(averages, r).items():
        found[name] = value.figure(*MEANING[name])
        if name in AFTER_JAM and oriented < released:
            found[name] = Figure.refused(MEANING[name][0], why, MEANING[name][1])
    for name, power in packing.powers(r).items():
        low, high = (end(r["time"][rows], power[rows]) for end in (smallest, largest))
        found[f"least_{name}"] = low.figure(unit, f"least power of the {name}")
        found[f"most_{name}"] = high.figure(unit, f"largest power of the {name}")
    return found


def averages(r: Result) -> dict[str, float]:
    """What the rows tell of the whole cycles."""
    rows, orders, found = packing.window(r), packing.ripple(r), packing.averages(r)
    orientation = float(r["orientator.orientation_time"][rows][-2])
    released, oriented = len(packing.releases(r)) - 1, np.ptp(r["orientator.oriented"][rows])
    iron, conveyor, _ = (x[rows] for x in packing.powers(r).values())
    near, rate = packing.nearest(orders), 60 / found["cycle"]
    for _, main in orders.loc[orders.groupby("drive")["own"].idxmax()].iterrows():
        found[f"main_{main['drive']}"] = main["own"]
        found[f"main_{main['drive']}_frequency"] = main["frequency"]
    return found | {
        "orientation": orientation,
        "spare": found["cycle"] - orientation,
        "products": rate * oriented / released,
        "lost": rate * (1 - oriented / released),
        "work": found["mean_supply"] * found["cycle"],
        "gap": near["gap"],
        "beat": 60 * near["gap"],
        "together": near["own_x"] + near["own_y"],
        "correlation": float(np.corrcoef(iron, conveyor)[0, 1]),
    }


def verdict(o: Options, f: Mapping[str, Figure], r: tuple[Result, System]) -> str:
    """Whether the line keeps pace, what a jam costs, and what the supply bears."""
    told = {name: figure.text() for name, figure in f.items()}
    pace = (
        f"The line keeps pace: every product is oriented in {told['orientation']} and the next "
        f"comes after {told['cycle']}, {told['spare']} to spare."
    )
    if f["oriented"].value < f["released"].value:
        pace = (
            f"The line does not keep pace: {told['oriented']} of {told['released']} products are "
            f"oriented, {f['orientation'].reason}."
        )
    near, meets = packing.nearest(packing.ripple(r[0])), ""
    if near["gap"] < near["frequency_x"] / near["order_x"] / 2:
        meets = (
            f", where order {near['order_x']} of the cam and order {near['order_y']} of the crank "
            f"meet and beat {f['beat'].text('times a minute')}"
        )
    return (
        f"{pace} It makes {f['products'].text('products/min')}; jams cost "
        f"{f['lost'].text('products/min')}, and each the {told['work']} of a cycle. The supply gives "
        f"{told['mean_supply']} with a ripple of {told['rms_supply']} rms, between "
        f"{told['least_supply']} and {told['most_supply']}{meets}."
    )


def show(o: Options, f: Mapping[str, Figure], r: tuple[Result, System]) -> Show:
    """The last whole cycle from release to release: cam, orientator, powers; and in motion."""
    result, alone = r
    first, last = packing.releases(result)[-2:]
    t = result["time"] - result["time"][first]
    period, bars = float(t[last]), lanes(result, first, last)
    seen = (t >= -AROUND * period) & (t <= (1 + AROUND) * period)
    dwell = first + np.flatnonzero(result["iron.top_dwell"][first : last + 1] < 0.5)[0]
    lift = recorded("lift of the iron", result, t[seen], {"iron.lift": ("iron", LIFT)}, "mm", seen)
    panels: list[Panel | Lanes] = [lift, Lanes(bars)]
    for name, color in {"supply": POWER, "iron": "gold", "conveyor": "sky"}.items():
        course = Curve(name, t[seen], packing.powers(result)[name][seen], color)
        mean = [Mark.of("mean", f[f"mean_{name}"])]
        panels.append(Panel(f"power, {name}", "W", [course], mean))
    told = ", ".join(bar.text for bar in bars["pace"])
    title = f"One cycle of {period:.3f} s, {60 / period:.2f} releases/min: {told}"
    marks = [Mark(0.0, "release"), Mark(period, "next release")]
    spans = [Span(0.0, float(t[dwell]), "top dwell", "green")]
    chart = Chart(title, "time since the release [s]", panels, marks, spans)
    return Show([chart], [motion(result, alone, first, last)])


def lanes(r: Result, first: int, last: int) -> dict[str, list[Span]]:
    """The stages of the product from a release to the next, and how long it all took."""
    since = r["time"][first]
    bars = [
        x._replace(first=x.first - since, last=x.last - since)
        for x in orientator.stages(r, first + 1, last)
    ]
    bars[0] = bars[0]._replace(first=0.0)
    end, period, over = bars[-1].first, bars[-1].last, bars[-1].text
    works = over == orientator.STAGES[orientator.ORIENTED]
    why = orientator.REASONS[int(r["orientator.reason"][last - 1])]
    rest = f"{period - end:.3f} s to spare" if works else f"lost: {why}"
    pace = [Span(0.0, end, f"{over} after {end:.3f} s", "blue")] if end > 0.0 else []
    pace.append(Span(end, period, rest, "green" if works else "red"))
    return {"orientator": bars, "pace": pace}


def motion(r: Result, alone: System, first: int, last: int) -> Motion:
    """Iron and orientator side by side between two rows."""
    picked = rows(r["time"], float(r["time"][first]), float(r["time"][last]), 360)
    shapes, captions = iron_mechanism.drawn(r, alone, picked)
    more, stages = orientator_mechanism.drawn(r, picked)
    captions = [f"{caption}; orientator {stage}" for caption, stage in zip(captions, stages)]
    title = "One cycle: the iron drive and the orientator it releases"
    note = "The conveyor, which shakes too fast to be seen here, is left out."
    return Motion(title, r["time"][picked], 4.0, captions, [*shapes, *moved(more, 0.5, 0.2)], note)
