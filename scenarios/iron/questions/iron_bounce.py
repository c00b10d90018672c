"""At which speed does the follower of the sealing iron bounce, for how long, and how hard does it land?

The cam turns at constant speed, and the follower may leave it. A sweep gives flight, landings and
their cost; at one speed every figure has its error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cosim import System
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
    Reader,
    RunChart,
    RunOptions,
    RunPanel,
    Show,
    Slider,
    Table,
    option,
)
from workbench.charts.model import FORCE, LIFT, POWER, SPEED, TORQUE
from workbench.figure import scaled
from workbench.judgement import Holds
from workbench.live import REVOLUTION, moved
from workbench.method import Run, certify
from workbench.question import Probe

from .. import machine as iron
from ..turn import Data, IronTurn

TABLE = "iron_bounce.csv"
AXES = {
    "flight": ("off the cam", LIFT, 1e3, "ms"),
    "gap": ("gap of the rocker", FORCE, 180 / math.pi, "deg"),
    "speed": ("landing", SPEED, 1.0, "m/s"),
    "impulse": ("impulse", TORQUE, 1.0, "N.s"),
    "loss": ("lost per turn", POWER, 1.0, "J"),
}
UNLIKE = "one turn is not like the next"
HIDDEN = "several landings fall between two rows; more samples are needed to separate them"


def of_turn(kind: str, output: str) -> Reader:
    """Return a reader of the last turn of the cam."""
    return Reader(kind, f"iron.{output}", REVOLUTION, angle="iron.phi")


class IronBounce(IronTurn):
    """The speeds, the stiffness of the contact, and the turns."""

    fixed_starts = (*iron.IMPOSED, "iron.follower.lifts", "iron.gap", "iron.w_gap")
    window, angle = REVOLUTION, "iron.phi"

    speed: float = option("90rpm", "speed of the cam, for the figures", "rad/s", above=0.0)
    speeds: tuple[float, ...] = option("70:120rpm:11", "speeds of the sweep", "rad/s", above=0.0)
    stiffness: float = option("10000N/mm", "stiffness of the contact", "N/m", above=0.0)
    samples: int = option(1440, "rows per turn", least=360)
    turns: int = option(3, "turns from rest of the follower, of which the last is read", least=2)

    numbers = (
        Number("flight", of_turn("change", "t_flight"), meaning="time off the cam per turn"),
        Number("landings", of_turn("change", "landings"), meaning="landings per turn"),
        Number("gap", of_turn("max", "gap"), meaning="largest angle of the rocker from contact with the cam"),
        Number("speed", of_turn("max", "v_landing"), meaning="speed of the hardest landing, along the normal"),
        Number("impulse", of_turn("max", "S_landing"), meaning="impulse of the hardest landing"),
        Number("loss", of_turn("change", "E_landing"), meaning="energy lost in the landings per turn"),
        Number(
            "force", "sqrt(stiffness * figures.speed * figures.impulse / (1 + iron.follower.e))", "N",
            "force of the hardest landing on a contact of that stiffness",
        ),
    )  # fmt: skip
    #: The error is that of bounces which end sooner, of rows, and of a turn more, which another step does not show.
    method = Run(
        finer=(
            {"samples": "2 * samples", "iron.follower.v": "iron.follower.v / 4"},
            {"turns": "turns + 1"},
        )
    )
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
    start_values = {**IronTurn.start_values, "iron.follower.lifts": 1}

    def run_options(self) -> RunOptions:
        """Return those of the turns."""
        of_one = super().run_options()
        return replace(of_one, stop=self.turns * of_one.stop)

    def further_runs(self, context: Context, plain: System) -> Table:
        """Sweep the speed."""
        run = partial(last_turn, self, plain.parts)
        rows = context.each(run, self.speeds, "speeds", probes=True)
        return context.record_rows(TABLE, UNITS, rows)

    def probe(self, context: Context, found: Findings) -> Probe:
        """The speed alone, without a sweep."""
        return Probe(replace(self, speeds=(self.speed,)))

    def more_figures(self, f: Mapping[str, Figure], r: Data) -> dict[str, Figure]:
        """Return what is refused where a turn is not like the one before, or landings are not told apart, and the limit.

        Each landing is at least 1/e as hard as the next one. Bounces that end slower make more landings, so that their
        number is one of these ends, and has no error.
        """
        result, rate = r[0], 1 + self.samples
        landed, v = result["iron.landings"], result["iron.v_landing"][-rate:]
        new, before = (np.diff(landed[end - rate : end]) for end in (len(landed), 1 - rate))
        e = result.provenance["parts"]["iron"]["parameters"]["follower.e"]
        several = v[1:][new > 1]
        reason = HIDDEN if (several > e * v[1:][new > 0].max(initial=0.0) / 2).any() else ""
        if new.sum() != before.sum():
            reason = UNLIKE
        turn = {x.name: f[x.name] for x in self.numbers}
        if reason:
            turn = {x: Figure.undetermined(y.unit, reason, y.meaning) for x, y in turn.items()}
        else:
            turn["landings"] = f["landings"]._replace(error=0.0)
        limits = {x: y for x, y in r[1].limits.items() if x.startswith("follower")}
        return {**limits, **turn, "cycles": iron.cycles(self.speed)}

    def tables(self, f: Mapping[str, Figure], r: Data) -> dict[str, Table]:
        """Return the sweep."""
        return {TABLE: r[1].more}

    def judgements(self, f: Mapping[str, Figure], r: object) -> list[Judgement]:
        """Whether the follower stays on its cam at the speed, and what it does if not."""
        at = iron.pace(self.speed)
        limit = f["follower_limit"]
        cycles = scaled(limit, iron.PER_MINUTE, "cycles/min", "")
        stays = Judgement(
            f"the follower stays on the cam at {at}",
            Figure(self.speed, "rad/s", 0.0),
            most=limit,
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

    def show(self, f: Mapping[str, Figure], r: Data) -> Show:
        """A turn with its landings, the sweep, and the mechanism in motion."""
        turn, table = self.turn(r), r[1].more
        phi = np.degrees(turn["iron.phi"]) - 360.0 * (self.turns - 1)
        hit = np.append(False, np.diff(turn["iron.landings"]) > 0)
        chart = self.chart(f, r)
        panels = list(chart.panels)
        if hit.any():
            blows = Curve("landing", phi[hit], turn["iron.S_landing"][hit], TORQUE, "points")
            panels.insert(2, Panel("impulse", "N.s", [blows], includes=(0.0,)))
        frame, limit = table.frame, f["follower_limit"].value * iron.PER_MINUTE
        pace = frame["nu"].to_numpy() * iron.PER_MINUTE
        over = [
            Panel(text, unit, [Curve(text, pace, scale * frame[name].to_numpy(), color, "linked")])
            for name, (text, color, scale, unit) in AXES.items()
        ]
        marks = [Mark(limit, "lifts off")] if pace[0] <= limit <= pace[-1] else []
        charts = [
            chart._replace(panels=panels),
            Chart("Flight and landings over the speed", "speed of the cam [1/min]", over, marks),
        ]
        return Show(charts, [moved(self.motion(f, r), turn)])


UNITS = {
    "nu": "rad/s", "flight": "s", "landings": "1", "gap": "rad", "speed": "m/s", "impulse": "N.s",
    "loss": "J",
}  # fmt: skip


def last_turn(o: IronBounce, fmus: Mapping[str, Path], speed: float) -> list[float]:
    """Return a row of the sweep: the speed [rad/s], and what the last turn has at it."""
    at: Any = replace(o, speed=speed)
    _, f = certify(at, at.system(fmus), Context(fmus, certifies=False), "")
    return [speed, *(f[name].value for name in [*UNITS][1:])]
