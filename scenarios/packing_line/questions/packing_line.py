"""Does the packing line keep pace, what does a jam cost, and what must its supply deliver?

One motor drives the sealing iron. Its cam shaft turns the orientator's rotor through a gear and
releases a product at the start of each top dwell. A conveyor with its own motor feeds the orientator.
The model of the orientator takes no power from the shaft, so the supply gives that of two motors.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

import cosim
from cosim import Result, System
from workbench import (
    Chart,
    Context,
    Figure,
    Judgement,
    Mark,
    Number,
    Panel,
    Question,
    Reader,
    RunChart,
    RunOptions,
    RunPanel,
    Show,
    Slider,
    Table,
    option,
)
from workbench.charts.model import LIFT, Lanes, Span
from workbench.live import REVOLUTION, Live, LiveMotion, drawn, moved
from workbench.options import Start

from ...conveyor.first_order import SETS
from ...iron import machine as iron
from ...orientator import machine as orientator
from .. import line, motion
from ..line import I_G, POWERS, WIRES, add_supply_power
from ..power import (
    HIGHEST,
    MEASURED,
    ORDER_UNITS,
    are_close_in_frequency,
    cycle_figures,
    nearest,
    releases,
    turns_of_drives,
    with_supply_power,
)

#: Time before and after a cycle that a chart shows, over the cycle; a convention.
AROUND = 0.05
#: Frames of a cycle; a convention.
FRAMES = 360
#: Time of a cycle on the live page [s].
CYCLE = "2 * pi / iron_speed"


class PackingLine(Question, RunOptions):
    """The speeds of rotor, cam and crank on one line, and how the run is made."""

    parts = line.PARTS
    record = line.RECORD

    gear: float = option(1.25, "speed of the rotor over speed of the cam", "1", above=0.0)
    iron_speed: float = option(iron.NOMINAL, "no-load speed of the cam", "rad/s", above=0.0)
    set: str = option("B", "parameter set of the conveyor's drive", choices=SETS)
    speed: float = option(60.0, "mean speed of the crank", "rad/s", above=0.0)
    stop: float = option(5.5, "simulated time", "s", above=0.0)
    step: float = option("0.5ms", "finest of three communication steps", "s", above=0.0)

    def system(self, fmus: Mapping[str, Path]) -> System:
        """The line, its motors set for their speeds; all start values are parameters, because some hosts
        set no other ones.
        """
        slope = self.start.get("iron_motor.B", iron.MOTOR["motor.B"])
        ratio = self.start.get("iron.reducer.i_g", I_G)
        values: Start = {
            "iron_motor.A": float(slope) * float(ratio) * self.iron_speed,
            "iron_motor.B": slope,
            "iron_motor.T": iron.MOTOR["motor.T"],
            "iron.reducer.i_g": ratio,
        }
        alone = {x.replace("conveyor_motor.", "motor."): value for x, value in self.start.items()}
        for name, value in SETS[self.set].follow(alone).start(self.speed).items():
            if name not in ("motor.tau", "conveyor.phi", "conveyor.w"):
                values[name.replace("motor.", "conveyor_motor.")] = value
        wires = [*WIRES, f"iron.w_cam * {self.gear!r} -> orientator.w"]
        return System(fmus, wires, {**values, **self.start})

    def process(self, r: Result) -> Result:
        """Return the run with the power of the supply."""
        return add_supply_power(r)

    def figures(self, r: Result) -> dict[str, Figure]:
        """Return counts of products, and pace and powers of the last cycles."""
        return cycle_figures(r)

    def more_runs(self, context: Context, system: System) -> System:
        """Return the line, which the drawing needs."""
        return system

    def tables(self, f: Mapping[str, Figure], r: tuple[Result, System]) -> dict[str, Table]:
        """Return the orders of both drives."""
        return {
            "packing_line_orders.csv": Table.of_rows(
                with_supply_power(turns_of_drives(r[0])), ORDER_UNITS
            )
        }

    def files(self, r: tuple[Result, System]) -> dict[str, partial[None]]:
        """Write the line as an SSP."""
        return {"line.ssp": partial(cosim.write_ssp, r[1], stop=self.stop)}

    def judgements(self, f: Mapping[str, Figure], r: tuple[Result, System]) -> list[Judgement]:
        """Whether the line keeps pace, what a jam costs, and what the supply gives."""
        keeps, why = f["oriented"].value >= f["released"].value, f["orientation"].reason
        counted = f"{f['oriented'].brief()} of {f['released'].brief()} released products oriented"
        (cam, crank), distance = nearest(with_supply_power(turns_of_drives(r[0]))), f["gap"]
        return [
            Judgement(
                "the line keeps pace",
                f["oriented"],
                least=f["released"],
                is_so=keeps,
                no="The line does not keep pace",
                note=counted if keeps else f"{counted}; {why}",
            ),
            *(
                [
                    Judgement("orienting a product takes", f["orientation"]),
                    Judgement("spare time of a cycle", f["spare"]),
                ]
                if keeps
                else [Judgement("products lost by jams", f["lost"])]
            ),
            Judgement("products per minute", f["products"]),
            Judgement("work from the supply per cycle, with or without a product", f["work"]),
            Judgement(
                "mean power of the supply",
                f["mean_supply"],
                note=f"with a ripple of {f['rms_supply'].brief()} rms",
            ),
            *(
                [
                    Judgement(
                        f"cam order {cam.order} and crank order {crank.order} are apart by",
                        distance,
                    )
                ]
                if are_close_in_frequency(cam, crank)
                else []
            ),
        ]

    def show(self, f: Mapping[str, Figure], r: tuple[Result, System]) -> Show:
        """The last whole cycle from release to release: cam, orientator, powers; and in motion."""
        window, _ = r
        first, last = releases(window)[-2:]
        zero = float(window["time"][first])
        result = window.with_columns_from(lambda k: window.load(k) - zero * (k == 0))
        t, bars = result["time"], lanes(result, first, last)
        period = float(t[last])
        in_window = (t >= -AROUND * period) & (t <= (1 + AROUND) * period)
        cycle = drawn(RunChart("", "", [LIFTS, *POWER_PANELS]), result.select(in_window))
        lift, *powers = cycle.panels
        pace = bars.pop("pace")
        panels: list[Panel | Lanes] = [lift, Lanes(bars)]
        for name, power in zip(COLUMNS, powers):
            assert isinstance(power, Panel)
            panels.append(power._replace(levels=[Mark.of("mean", f[f"mean_{name}"])]))
        quantities = ", ".join(bar.text for bar in pace)
        title = f"One cycle of {period:.3f} s, {60 / period:.2f} releases/min: {quantities}"
        marks = [Mark(0.0, "release"), Mark(period, "next release")]
        dwell = first + np.flatnonzero(result["iron.top_dwell"][first : last + 1] == 0.0)[0]
        spans = [Span(0.0, float(t[dwell]), "top dwell", "green")]
        chart = Chart(title, "time since the release [s]", panels, marks, spans)
        moving = moved(self.motion(f, r), result, first=0.0, last=period, frames=FRAMES)
        return Show([chart], [moving])

    def motion(self, f: Mapping[str, Figure], r: tuple[Result, System]) -> LiveMotion:
        """Iron and orientator side by side."""
        return motion.live_motion(*r, f"stop - {CYCLE}")

    def live(self, f: Mapping[str, Figure], r: tuple[Result, System]) -> Live:
        """The line over all of its time; its motors follow their speeds as `system` sets them."""
        measured_from = f"stop - {MEASURED} * {CYCLE}"
        panels = [LIFTS, PRODUCTS, *POWER_PANELS]
        crank = "conveyor.crank.r**2 / 2"
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
                        f"mean_{name}",
                        Reader("mean", POWERS[name][0], REVOLUTION, angle=f"{name}.phi"),
                    )
                    for name in HIGHEST
                ),
                Number("mean_supply", "figures.mean_iron + figures.mean_conveyor"),
                *(
                    Number(f"most_{name}", Reader("max", POWERS[name][0], measured_from))
                    for name in HIGHEST
                ),
            ],
            charts=[RunChart("The last whole cycles", "time [s]", panels, window=measured_from)],
            motion=self.motion(f, r),
        )


LIFTS = RunPanel("lift of the iron", {"iron.lift": ("iron", LIFT)}, "mm")
COLUMNS = {
    "supply": "iron_motor.P + conveyor_motor.P",
    "iron": "iron_motor.P",
    "conveyor": "conveyor_motor.P",
}
PRODUCTS = RunPanel(
    "products",
    {
        "orientator.oriented": ("oriented", "green", "step"),
        "orientator.jammed": ("jammed", "red", "step"),
    },
    "1",
)
POWER_PANELS = [
    RunPanel(f"power, {name}", {column: (name, POWERS[name][2])}, "W", includes=(0.0,))
    for name, column in COLUMNS.items()
]


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
