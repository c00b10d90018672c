"""Does the packing line keep pace, what does a jam cost, and what must its supply deliver?

One motor drives the sealing iron. Its cam shaft turns the orientator's rotor through a gear and
releases a product at the start of each top dwell. A conveyor with its own motor feeds the orientator.
The model of the orientator takes no power from the shaft, so the supply gives that of two motors.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
from cosim import Result, SetupError, System
from workbench import Chart, Context, Figure, Findings, Mark, Panel, Run, Show, Table, option
from workbench.charts.model import LIFT, POWER, Lanes, Span, result_panel
from workbench.charts.motion import Motion, rows, shifted
from workbench.live import (
    REVOLUTION,
    Caption,
    Live,
    LiveChart,
    LiveMotion,
    LivePanel,
    Number,
    Reader,
    Slider,
)
from workbench.measure import extended, harmonics, with_row_errors, with_rows
from workbench.options import Start

from ...conveyor.first_order import SETS
from ...iron import machine as iron
from ...iron import motion as iron_motion
from ...orientator import machine as orientator
from ...orientator import motion as orientator_motion

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
#: Gear ratio of the reducer of the iron drive, the default of its FMU.
I_G = 36.0
RECORD = (
    "iron_motor.P", "iron_motor.tau", *(f"iron.{x}" for x in iron_motion.COLUMNS), "iron.w_cam",
    "iron.top_dwell", "iron.E_kin", "iron.E_pot", "iron.E_friction",
    *(f"orientator.{x}" for x in orientator_motion.COLUMNS), "orientator.reason",
    "orientator.orientation_time", "orientator.oriented", "orientator.jammed", "orientator.missed",
    "conveyor_motor.P", "conveyor_motor.tau", "conveyor.phi", "conveyor.w", "conveyor.x",
    "conveyor.E_kin", "conveyor.E_pot", "conveyor.P_loss",
)  # fmt: skip
POWERS = {
    "iron": ("iron_motor.P", "the iron's motor", "gold"),
    "conveyor": ("conveyor_motor.P", "the conveyor's motor", "sky"),
    "supply": ("P_supply", "the supply", POWER),
}
STATISTICS = {
    "mean": "mean power",
    "rms": "ripple of the power",
    "least": "smallest power",
    "most": "largest power",
}
HIGHEST = {"iron": 12, "conveyor": 4}
TURN = 2 * math.pi
#: Whole cycles at the end over which powers are measured; a convention, two show whether they repeat.
MEASURED = 2
#: Even angles of a turn at which a power is taken, ten for each of the orders; a convention.
EVEN = 120
UNITS = {"drive": "1", "order": "1", "frequency": "Hz", "own": "W", "supply": "W"}
#: Amplitude of an order over the largest one of its drive above which it counts as strong; a convention.
MAIN = 0.1
#: Time before and after a cycle that a chart shows, over the cycle; a convention.
AROUND = 0.05


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    gear: float = option(1.25, "speed of the rotor over speed of the cam", "1", above=0.0)
    iron_speed: float = option(iron.NOMINAL, "no-load speed of the cam", "rad/s", above=0.0)
    set: str = option("B", "parameter set of the conveyor's drive", choices=SETS)
    speed: float = option(60.0, "mean speed of the crank", "rad/s", above=0.0)
    stop: float = option(5.5, "simulated time", "s", above=0.0)
    step: float = option("0.5ms", "finest of three communication steps", "s", above=0.0)


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
    order_power = {
        name.replace("conveyor_motor.", "motor."): value for name, value in o.start.items()
    }
    for name, value in SETS[o.set].follow(order_power).start(o.speed).items():
        if name not in ("motor.tau", "conveyor.phi", "conveyor.w"):
            values[name.replace("motor.", "conveyor_motor.")] = value
    wires = [*WIRES, f"iron.w_cam * {o.gear!r} -> orientator.w"]
    return System(fmus, wires, {**values, **o.start})


def solve(o: Options, context: Context) -> Findings:
    """The line, with its rows, its orders and its SSP."""
    line = system(o, context.fmus)
    result, all_figures = context.certify(line, figures, o, RECORD, "packing_line.csv")
    r = supplied(result)
    orders = Table.of_rows(ripple(drives(r)), UNITS)
    tables = {"packing_line.csv": Table.of(r), "packing_line_orders.csv": orders}
    files = {"line.ssp": partial(cosim.write_ssp, line, stop=o.stop)}
    return Findings(all_figures, (r, line), line, r.provenance, tables=tables, files=files)


def supplied(r: Result) -> Result:
    """The run with the power of the supply, which is that of both motors."""
    power = r["iron_motor.P"] + r["conveyor_motor.P"]
    return extended(r, r.units["iron_motor.P"], {"P_supply": power})


def releases(r: Result) -> list[int]:
    """The rows of the releases, whole cycles apart; raises SetupError where the cam does not keep
    turning."""
    phi = r["iron.phi"]
    if np.diff(phi).min() <= 0.0:
        raise SetupError(
            f"the cam stops or turns back, and ends at iron.phi = {phi[-1]:.4g} rad: at this "
            "speed its motor cannot lift the iron"
        )
    all_figures: list[int] = (np.flatnonzero(np.diff(r["iron.top_dwell"]) > 0.5) + 1).tolist()
    return all_figures


class Order(NamedTuple):
    """An order of the angle of a drive: its frequency [Hz], its amplitude in the power of the drive's
    motor, and with all of the other drive that it beats with, as the supply has it at worst [W]."""

    drive: str
    order: int
    frequency: float
    order_power: float
    supply: float


class Turns(NamedTuple):
    """The last whole turns of a drive: how long they last [s], their number; power of the motor [W]:
    mean, ripple, least, most, orders."""

    lasted: float
    number: int
    power: list[float]
    orders: list[Order]


def turns(r: Result, drive: str) -> Turns:
    """Those of the last cycles, of the cam from release to release, of the crank from where the trough is
    farthest; raises SetupError where there are none."""
    ends, begin = releases(r), 0.0
    if drive == "iron":
        begin = r.provenance["parts"]["iron"]["parameters"]["cam.rise"]
    rows = slice(ends[-1 - MEASURED] - 1, ends[-1] + 1)
    t, phi, power = (r[x][rows] for x in ("time", f"{drive}.phi", POWERS[drive][0]))
    first, last = math.ceil((phi[0] - begin) / TURN), math.floor((phi[-1] - begin) / TURN)
    if np.diff(phi).min() <= 0.0 or first >= last:
        raise SetupError(
            f"{drive}.phi goes from {phi[0]:.4g} to {phi[-1]:.4g} rad in the last {MEASURED} cycles, but "
            "must advance by a whole turn: the drive is too slow"
        )
    began, ended = CubicSpline(phi, t)(begin + TURN * np.array([first, last])).tolist()
    lasted, inside, number = ended - began, (t >= began) & (t <= ended), last - first
    mean = float(CubicSpline(t, power).integrate(began, ended) / lasted)
    square = float(CubicSpline(t, (power - mean) ** 2).integrate(began, ended) / lasted)
    low, high = (s * cosim.metrics.largest(t[inside], s * power[inside]) for s in (-1.0, 1.0))
    angles = begin + TURN * np.arange(first * EVEN, last * EVEN) / EVEN
    sizes = np.abs(harmonics(angles, CubicSpline(phi, power)(angles), HIGHEST[drive])).tolist()
    orders = [Order(drive, k, k * number / lasted, x, x) for k, x in enumerate(sizes, 1)]
    return Turns(lasted, number, [mean, math.sqrt(square), low, high], orders)


def figures(r: Result) -> dict[str, Figure]:
    """Counts of products, and what the last cycles tell; what is not settled in them is at most what
    they differ from those that end a cycle before. Raises SetupError where there are too few."""
    r, begins = supplied(r), releases(r)
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
    all_figures = {
        name: Figure(float(x), "1", 0.0, meaning) for name, (x, meaning) in counts.items()
    }
    before = cycles(with_rows(r, r.data[: begins[-2] + 1]))
    for name, figure in with_row_errors(cycles, r).items():
        all_figures[name] = figure
        if figure.error is not None:
            shifted = abs(figure.value - before[name].value)
            all_figures[name] = figure._replace(error=figure.error + shifted)
    return all_figures


def cycles(r: Result) -> dict[str, Figure]:
    """Pace, cost of jams, powers and their ripple; no time of orientation after a jam.

    Cam and crank have no common period, so that their powers add in the long run: means and ends as they
    are, ripples as mean squares.
    """
    begins, (iron, conveyor) = releases(r), drives(r)
    orders, cycle = ripple([iron, conveyor]), iron.lasted / iron.number
    quantities: dict[str, tuple[float, str, str]] = {
        "cycle": (cycle, "s", "mean time from release to release"),
        "cam": (TURN / cycle, "rad/s", "mean speed of the cam"),
    }
    supply = [a + b for a, b in zip(iron.power, conveyor.power)]
    supply[1] = math.hypot(iron.power[1], conveyor.power[1])
    ends = {"iron": iron.power, "conveyor": conveyor.power, "supply": supply}
    for name, values in ends.items():
        who = POWERS[name][1]
        for (word, meaning), value in zip(STATISTICS.items(), values):
            quantities[f"{word}_{name}"] = value, "W", f"{meaning} of {who}"
    for drive in sorted(HIGHEST):
        main, who = largest_order(orders, drive), POWERS[drive][1]
        quantities[f"main_{drive}"] = main.order_power, "W", f"largest order in the power of {who}"
        meaning = f"frequency of that order of {who}"
        quantities[f"main_{drive}_frequency"] = main.frequency, "Hz", meaning
    x, y = nearest(orders)
    gap = abs(x.frequency - y.frequency)
    orientation, reason = (
        r[f"orientator.{x}"][begins[-1] - 1] for x in ("orientation_time", "reason")
    )
    oriented_share = np.ptp(r["orientator.oriented"][begins[0] : begins[-1] + 1]) / (
        len(begins) - 1
    )
    quantities |= {
        "orientation": (orientation, "s", "orientation time of the last product"),
        "spare": (cycle - orientation, "s", "time to spare in a cycle"),
        "products": (60 / cycle * oriented_share, "1/min", "oriented products"),
        "lost": (60 / cycle * (1 - oriented_share), "1/min", "products lost to jams"),
        "work": (quantities["mean_supply"][0] * cycle, "J", "work of the supply in a cycle"),
        "gap": (gap, "Hz", "distance between the nearest main orders of cam and crank"),
        "beat": (60 * gap, "1/min", "beats of these two orders"),
        "together": (
            x.order_power + y.order_power,
            "W",
            "amplitude of these two orders together, at worst",
        ),
    }
    all_figures = {
        name: Figure(float(x), unit, 0.0, what) for name, (x, unit, what) in quantities.items()
    }
    why = f"the orientator jams: {orientator.REASONS[int(reason)]}"
    if not reason:
        why = "a product is still under way when the next is released"
    for name in ("orientation", "spare") if oriented_share < 1.0 else ():
        all_figures[name] = Figure.undetermined("s", why, all_figures[name].meaning)
    return all_figures


def drives(r: Result) -> list[Turns]:
    """The cam and the crank in the last cycles."""
    return [turns(r, drive) for drive in HIGHEST]


def ripple(both: Sequence[Turns]) -> list[Order]:
    """The orders of cam and crank."""
    orders = [x for drive in both for x in drive.orders]
    return [
        x._replace(
            supply=x.order_power
            + sum(y.order_power for y in orders if y.drive != x.drive and meet(x, y))
        )
        for x in orders
    ]


def meet(x: Order, y: Order) -> bool:
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


def verdict(o: Options, f: Mapping[str, Figure], r: tuple[Result, System]) -> str:
    """Whether the line keeps pace, what a jam costs, and what the supply gives."""
    quantities = {name: figure.text() for name, figure in f.items()}
    pace = (
        f"The line keeps pace: every product is oriented in {quantities['orientation']}, and the next "
        f"comes after {quantities['cycle']}, which leaves {quantities['spare']} to spare."
    )
    if f["oriented"].value < f["released"].value:
        pace = (
            f"The line does not keep pace: {quantities['oriented']} of {quantities['released']} products are "
            f"oriented, because {f['orientation'].reason}."
        )
    (cam, crank), beat_text = nearest(ripple(drives(r[0]))), ""
    if meet(cam, crank):
        beat_text = (
            f", where order {cam.order} of the cam and order {crank.order} of the crank "
            f"meet and beat {f['beat'].text('times a minute')}"
        )
    jams = "No product jams in the whole cycles."
    if f["lost"].value > 0.0:
        jams = f"Jams cost {f['lost'].text('products/min')}."
    share = 100 * f["mean_conveyor"].value / f["mean_supply"].value
    return (
        f"{pace} It makes {f['products'].text('products/min')}. {jams} A cycle without a product takes "
        f"{quantities['work']} from the supply as well, {share:.3g} % of it for the conveyor. The supply gives {quantities['mean_supply']} with a ripple of {quantities['rms_supply']} rms, between "
        f"{quantities['least_supply']} and {quantities['most_supply']}{beat_text}."
    )


def show(o: Options, f: Mapping[str, Figure], r: tuple[Result, System]) -> Show:
    """The last whole cycle from release to release: cam, orientator, powers; and in motion."""
    window, line = r
    first, last = releases(window)[-2:]
    data = window.data.copy()
    data[:, 0] -= data[first, 0]
    result = with_rows(window, data)
    t, bars = result["time"], lanes(result, first, last)
    period = float(t[last])
    in_window = (t >= -AROUND * period) & (t <= (1 + AROUND) * period)
    panel = partial(result_panel, result=result, x=t[in_window], rows=in_window)
    lift = panel("lift of the iron", curves={"iron.lift": ("iron", LIFT)}, unit="mm")
    pace = bars.pop("pace")
    panels: list[Panel | Lanes] = [lift, Lanes(bars)]
    for name in ("supply", "iron", "conveyor"):
        column, _, color = POWERS[name]
        mean = [Mark.of("mean", f[f"mean_{name}"])]
        curve = {column: (name, color)}
        panels.append(panel(f"power, {name}", curves=curve, levels=mean, includes=(0.0,)))
    quantities = ", ".join(bar.text for bar in pace)
    title = f"One cycle of {period:.3f} s, {60 / period:.2f} releases/min: {quantities}"
    marks = [Mark(0.0, "release"), Mark(period, "next release")]
    dwell = first + np.flatnonzero(result["iron.top_dwell"][first : last + 1] < 0.5)[0]
    spans = [Span(0.0, float(t[dwell]), "top dwell", "green")]
    chart = Chart(title, "time since the release [s]", panels, marks, spans)
    return Show([chart], [motion(result, line, first, last)])


def lanes(r: Result, first: int, last: int) -> dict[str, list[Span]]:
    """The stages of the product from a release to the next, and how long it all took."""
    bars = orientator.stages(r, first + 1, last)
    bars[0] = bars[0]._replace(first=0.0)
    end, period, over = bars[-1].first, bars[-1].last, bars[-1].text
    works = over == orientator.STAGES[orientator.ORIENTED]
    why = orientator.REASONS[int(r["orientator.reason"][last - 1])]
    rest = f"{period - end:.3f} s to spare" if works else f"lost: {why}"
    pace = [Span(0.0, end, f"{over} after {end:.3f} s", "blue")] if end > 0.0 else []
    pace.append(Span(end, period, rest, "green" if works else "red"))
    return {"orientator": bars, "pace": pace}


def motion(r: Result, line: System, first: int, last: int) -> Motion:
    """Iron and orientator side by side between two rows."""
    picked = rows(r["time"], float(r["time"][first]), float(r["time"][last]), 360)
    shapes, captions = iron_motion.draw_rows(r, line, picked)
    more, stages = orientator_motion.draw_rows(r, picked)
    captions = [f"{caption}; orientator {stage}" for caption, stage in zip(captions, stages)]
    title = "One cycle: the iron drive and the orientator it releases"
    note = "The conveyor is left out."
    return Motion(
        title, r["time"][picked], 4.0, captions, [*shapes, *shifted(more, 0.5, 0.2)], note
    )


def live_part(o: Options, f: Mapping[str, Figure], r: tuple[Result, System]) -> Live:
    """The line over all of its time; its motors follow their speeds as `system` sets them."""
    result, line = r
    powers = {
        "iron": "iron_motor.P",
        "conveyor": "conveyor_motor.P",
        "supply": "iron_motor.P + conveyor_motor.P",
    }
    cycle = "2 * pi / iron_speed"
    measured_from = f"stop - {MEASURED} * {cycle}"
    panels = [
        LivePanel("lift of the iron", {"iron.lift": ("iron", LIFT)}, "mm"),
        LivePanel(
            "products",
            {
                "orientator.oriented": ("oriented", "green", "step"),
                "orientator.jammed": ("jammed", "red", "step"),
            },
            "1",
        ),
        *(
            LivePanel(f"power, {name}", {column: (name, POWERS[name][2])}, "W")
            for name, column in powers.items()
        ),
    ]
    draw_iron = iron_motion.live_shapes(result, line)
    draw_orientator = orientator_motion.live_shapes(result)
    crank = "conveyor.crank.r**2 / 2"
    motion = LiveMotion(
        "The last cycle: the iron drive and the orientator it releases",
        lambda at: [*draw_iron(at), *shifted(draw_orientator(at), 0.5, 0.2)],
        [*iron_motion.coordinates(result), *orientator_motion.coordinates(result)],
        [
            *iron_motion.CAPTIONS,
            Caption("orientator", "orientator.stage", texts=orientator.STAGES),
        ],
        4.0,
        "The conveyor is left out.",
        f"stop - {cycle}",
    )
    return Live(
        sliders=(
            Slider("gear", 0.5, 3.0),
            Slider("iron_speed", 4.0, 8.0),
            Slider("iron.iron.m", 1.0, 10.0),
            Slider("orientator.chute.mu", 0.0, 1.0),
            Slider("speed", 30.0, 80.0),
        ),
        start={
            "iron_motor.A": "iron_motor.B * iron.reducer.i_g * iron_speed",
            "conveyor_motor.A": f"(conveyor_motor.B + conveyor.trough.d * {crank}) * speed",
        },
        factors={"orientator.w": "gear"},
        numbers=[
            Number(
                "products_oriented",
                Reader("last", "orientator.oriented"),
                "1",
                "products oriented in all",
            ),
            Number(
                "products_jammed",
                Reader("last", "orientator.jammed"),
                "1",
                "products jammed in all",
            ),
            Number(
                "orientation",
                Reader("last", "orientator.orientation_time"),
                when="figures.products_jammed == 0",
                otherwise="the orientator jams",
            ),
            Number("cycle", Reader("change", "time", REVOLUTION, angle="iron.phi")),
            Number("cam", "2 * pi / figures.cycle"),
            *(
                Number(
                    f"mean_{name}", Reader("mean", POWERS[name][0], REVOLUTION, angle=f"{name}.phi")
                )
                for name in HIGHEST
            ),
            Number("mean_supply", "figures.mean_iron + figures.mean_conveyor"),
            *(
                Number(f"most_{name}", Reader("max", POWERS[name][0], measured_from))
                for name in HIGHEST
            ),
        ],
        charts=[LiveChart("The whole run", "time [s]", panels)],
        motion=motion,
    )


LIVE = live_part
