"""At which speed does the follower of the sealing iron bounce, for how long, and how hard does it land?

The cam turns at constant speed, and the follower may leave it. A sweep gives flight, landings and
their cost; at one speed every figure has its error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

import cosim
from cosim import Result, System
from cosim.metrics import largest
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Mark,
    Number,
    Panel,
    Question,
    Reader,
    RunChart,
    RunPanel,
    Show,
    Slider,
    Table,
    option,
)
from workbench.answer import parameters
from workbench.charts.model import FORCE, LIFT, POWER, SPEED, TORQUE
from workbench.figure import ROUNDING, figure_of_figures, scaled
from workbench.judgement import Holds
from workbench.live import REVOLUTION, Live, LiveMotion, drawn, moved

from .. import machine as iron
from .. import motion

#: Turns of a run, of which the last two show whether they repeat; a convention.
TURNS = 3
#: By how many times slower the impacts are at which bounces end, in the run that shows the error; a convention.
FINER = 4
TABLE = "iron_bounce.csv"
UNITS = {
    "nu": "rad/s", "flight": "s", "landings": "1", "gap": "rad", "speed": "m/s", "impulse": "N.s",
    "loss": "J",
}  # fmt: skip
MEANINGS = {
    "flight": "time off the cam per turn",
    "landings": "landings per turn",
    "gap": "largest angle of the rocker from contact with the cam",
    "speed": "speed of the hardest landing, along the normal",
    "impulse": "impulse of the hardest landing",
    "loss": "energy lost in the landings per turn",
}
AXES = {
    "flight": ("off the cam", LIFT, 1e3, "ms"),
    "gap": ("gap of the rocker", FORCE, 180 / math.pi, "deg"),
    "speed": ("landing", SPEED, 1.0, "m/s"),
    "impulse": ("impulse", TORQUE, 1.0, "N.s"),
    "loss": ("lost per turn", POWER, 1.0, "J"),
}
UNLIKE = "one turn is not like the next"
HIDDEN = "several landings fall between two rows; more samples are needed to separate them"


class Flight(NamedTuple):
    """A turn at a speed, in the words of UNITS; whether no harder landing hides between two rows."""

    nu: float
    flight: float
    landings: float
    gap: float
    speed: float
    impulse: float
    loss: float
    are_distinct: bool


class IronBounce(Question):
    """The speeds, the stiffness of the contact, and the rows of a turn."""

    parts = {"iron": "IronDrive"}
    fixed_starts = (*iron.IMPOSED, "iron.follower.lifts", "iron.gap", "iron.w_gap")

    speed: float = option("90rpm", "speed of the cam, for the figures", "rad/s", above=0.0)
    speeds: tuple[float, ...] = option("70:120rpm:11", "speeds of the sweep", "rad/s", above=0.0)
    stiffness: float = option("10000N/mm", "stiffness of the contact", "N/m", above=0.0)
    samples: int = option(1440, "rows per turn", least=360)

    numbers = (
        Number("flight", Reader("change", "iron.t_flight", REVOLUTION)),
        Number("landings", Reader("change", "iron.landings", REVOLUTION)),
        Number("gap", Reader("max", "iron.gap", REVOLUTION)),
        Number("speed", Reader("max", "iron.v_landing", REVOLUTION)),
        Number("impulse", Reader("max", "iron.S_landing", REVOLUTION)),
        Number("loss", Reader("change", "iron.E_landing", REVOLUTION)),
        Number("force", "sqrt(stiffness * figures.speed * figures.impulse / (1 + iron.follower.e))"),
    )  # fmt: skip
    charts = (
        RunChart(
            "The last of three turns",
            "cam angle [deg]",
            [
                RunPanel("gap of the rocker", {"iron.gap": FORCE}, "deg"),
                RunPanel("force of the cam", {"iron.N": TORQUE}, includes=(0.0,)),
                RunPanel("lift of the iron", {"iron.lift": LIFT}, "mm"),
                RunPanel("velocity", {"iron.v": SPEED}),
            ],
            "crank_angle * 180 / pi",
            REVOLUTION,
        ),
    )
    sliders = (
        Slider("speed", 7.0, 13.0),
        Slider("stiffness", 1e5, 1e8),
        Slider("iron.follower.e", 0.0, 0.9),
        Slider("iron.spring.c", 0.0, 1200.0),
        Slider("iron.iron.m", 1.0, 10.0),
    )
    start_values = {
        "iron.tau": 0.0,
        "iron.phi": 0.0,
        "iron.w_cam": "speed",
        "iron.reducer.J": iron.FLYWHEEL,
        "iron.follower.lifts": 1,
    }

    def solve(self, context: Context) -> Findings:
        """A sweep; and one speed, again with twice the rows and bounces that end four times as slow.

        This replaces the single certified run, because the error is that of bounces which end sooner, and a run
        with another step does not show it.
        """
        system = System(context.fmus, start=self.start)
        e, v = (float(parameters(system)[f"iron.follower.{x}"].value) for x in ("e", "v"))
        flights = context.each(
            partial(last_flight, system, self.samples), self.speeds, "speeds", probes=True
        )
        table = context.record_rows(TABLE, UNITS, (flight[:-1] for flight in flights))
        result = turns_with_flight(system, self.samples, self.speed)
        before, now = (
            flight(result, self.samples, self.speed, turn) for turn in (TURNS - 2, TURNS - 1)
        )
        finer = replace(system, start={**system.start, "iron.follower.v": v / FINER})
        other = last_flight(finer, 2 * self.samples, self.speed)
        reason = "" if now.are_distinct else HIDDEN
        if now.landings != before.landings:
            reason = UNLIKE
        figures = {x: y for x, y in iron.limits(system).items() if x.startswith("follower")}
        for name, meaning in MEANINGS.items():
            x, earlier, fine = (getattr(turn, name) for turn in (now, before, other))
            error = abs(x - earlier) + 2 * abs(x - fine) + ROUNDING * x
            if name == "landings":  # of which slower ends make more
                error = 0.0
            figures[name] = (
                Figure.undetermined(UNITS[name], reason, meaning)
                if reason
                else Figure(x, UNITS[name], error, meaning)
            )
        figures["force"] = (
            figure_of_figures(  # on a spring, sqrt(c m) v, with the mass that has this impulse
                lambda v, S: np.sqrt(np.maximum(0.0, self.stiffness * v * S / (1.0 + e))),
                figures["speed"],
                figures["impulse"],
                unit="N",
                meaning="force of the hardest landing on a contact of that stiffness",
            )
        )
        figures["cycles"] = Figure(self.speed * iron.PER_MINUTE, "1/min", 0.0, "cycles per minute")
        turn = result.select(slice((TURNS - 1) * self.samples, None))
        step, data = f"{self.samples} steps in a turn", (turn, system, table)
        return Findings(figures, data, system, result.provenance, step, tables={TABLE: table})

    def judgements(self, f: Mapping[str, Figure], r: object) -> list[Judgement]:
        """Whether the follower stays on its cam at the speed, and what it does if not."""
        at = f"{self.speed:.4g} rad/s ({f['cycles'].brief('cycles/min')})"
        limit = f["follower_limit"]
        cycles = scaled(limit, iron.PER_MINUTE, "cycles/min", "")
        stays = Judgement(
            f"the follower stays on the cam at {at}",
            Figure(self.speed, "rad/s", 0.0),
            most=limit,
            yes=f"The follower stays on the cam at {at}",
            no=f"Stay below {limit.brief()} ({cycles.brief()}), or the follower leaves the cam"
            if limit.value > 0.0
            else f"The follower leaves the cam at {at}, as at any speed",
        )
        if stays.answer is Holds.YES:
            return [stays]
        landing = (
            ("landings", "speed", "force")
            if f["landings"].error is None or f["landings"].value
            else ("landings",)
        )
        return [stays, *(Judgement(f[name].meaning, f[name]) for name in ("flight", *landing))]

    def show(self, f: Mapping[str, Figure], r: tuple[Result, System, Table]) -> Show:
        """A turn with its landings, the sweep, and the mechanism in motion."""
        turn, _, table = r
        phi = np.degrees(turn["iron.phi"]) - 360.0 * (TURNS - 1)
        hit = np.append(False, np.diff(turn["iron.landings"]) > 0)
        chart = drawn(self.charts[0], turn, angle="iron.phi")
        panels = list(chart.panels)
        if hit.any():
            blows = Curve("landing", phi[hit], turn["iron.S_landing"][hit], TORQUE, "points")
            panels.insert(2, Panel("impulse", "N.s", [blows], includes=(0.0,)))
        spans = iron.phases(turn.provenance["parts"]["iron"]["parameters"])
        title = f"A turn at {f['cycles'].text('cycles/min')}"
        frame, limit = table.frame, f["follower_limit"].value * iron.PER_MINUTE
        pace = frame["nu"].to_numpy() * iron.PER_MINUTE
        over = [
            Panel(text, unit, [Curve(text, pace, scale * frame[name].to_numpy(), color, "linked")])
            for name, (text, color, scale, unit) in AXES.items()
        ]
        marks = [Mark(limit, "lifts off")] if pace[0] <= limit <= pace[-1] else []
        charts = [
            chart._replace(title=title, panels=panels, spans=spans),
            Chart("Flight and landings over the speed", "speed of the cam [1/min]", over, marks),
        ]
        return Show(charts, [moved(self.motion(f, r), turn)])

    def motion(self, f: Mapping[str, Figure], r: tuple[Result, System, Table]) -> LiveMotion:
        """The mechanism."""
        return motion.live_motion("The mechanism in this turn", *r[:2], 4.0, REVOLUTION)

    def live(self, f: Mapping[str, Figure], r: tuple[Result, System, Table]) -> Live:
        """The last of three turns at the speed of the slider, as `turns_with_flight` has them."""
        warns = {} if "iron.on_invalid" in self.start else {"iron.on_invalid": 1}
        return self.page(
            f, r, start=self.start_values | warns, stop=f"{TURNS} * 2 * pi / speed", step="2 * pi / (speed * samples)",
            angle="iron.phi",
        )  # fmt: skip


def turns_with_flight(system: System, samples: int, speed: float) -> Result:
    """Turns at constant speed [rad/s], from phi = 0, with a follower that may lift off."""
    turning = iron.imposed(system, speed)
    turning = replace(turning, start={**turning.start, "iron.follower.lifts": True})
    h = 2 * math.pi / (speed * samples)
    return cosim.run(turning, stop=h * samples * TURNS, step=h)


def last_flight(system: System, samples: int, speed: float) -> Flight:
    """The last of these turns."""
    return flight(turns_with_flight(system, samples, speed), samples, speed, TURNS - 1)


def flight(r: Result, samples: int, speed: float, turn: int) -> Flight:
    """What a turn tells. Each landing is at least 1/e as hard as the next one."""
    rows = slice(turn * samples, (turn + 1) * samples + 1)
    names = ("t_flight", "landings", "E_landing", "gap", "v_landing", "S_landing")
    t, n, E, gap, v, S = (r[f"iron.{name}"][rows] for name in names)
    new = np.diff(n)
    hardest, impulse = (float(x[1:][new > 0].max(initial=0.0)) for x in (v, S))
    e = r.provenance["parts"]["iron"]["parameters"]["follower.e"]
    are_distinct = not (v[1:][new > 1] > e * hardest / 2).any()
    flight_time, landings, loss = (float(x[-1] - x[0]) for x in (t, n, E))
    widest = largest(r["time"][rows], gap)
    return Flight(speed, flight_time, landings, widest, hardest, impulse, loss, are_distinct)
