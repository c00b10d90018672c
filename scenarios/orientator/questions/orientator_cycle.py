"""How does one product turn over, and how long does each stage take?

One cup is followed from the drop to the end, with its trajectory, angles and speeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, System
from cosim.accuracy.judge import SOME_RUNS
from cosim.dense import Array as Samples
from workbench import (
    Context,
    Figure,
    Judgement,
    Number,
    Question,
    Reader,
    RunChart,
    RunOptions,
    RunPanel,
    Show,
    Slider,
    option,
)
from workbench.charts.model import FORCE, SPEED, THEORY, TORQUE
from workbench.figure import figure_of_columns
from workbench.judgement import Holds
from workbench.live import Live, drawn

from .. import machine as orientator
from .. import motion

STAGES = orientator.STAGES[: orientator.ORIENTED]
IMPULSES = {
    "corner_impulse": ("S_y", "impulse of the landing on the catcher's corner, down", "falling"),
    "wall_impulse": ("S_k", "impulse of the landing on the wall", "falling"),
    "hook_impulse": ("P_B", "impulse of the contact with the hook", "joint"),
}
"""Impulses: output, meaning, and the stage that ends with it."""
#: The reason of a jam in which the catcher stops before the product reaches the hook.
STOPPED = orientator.REASONS.index("catcher stopped")
#: Fewest rows of a stage, derived from the four coefficients of a cubic.
LEAST_ROWS = 4
FEW_ROWS = f"a stage has fewer than {LEAST_ROWS} rows, even with much shorter steps"
#: Most steps of a run for the reaction of the wall: a stage that is shorter than some of them is not resolved.
MOST_STEPS = 100_000
CHART = RunChart(
    "Angles, speeds and the wall",
    "time [ms]",
    [
        RunPanel(
            "angle",
            {"orientator.phi1": ("catcher", SPEED), "orientator.phi2": ("cup", TORQUE)},
            "deg",
        ),
        RunPanel("speed", {"orientator.w1": ("catcher", SPEED), "orientator.w2": ("cup", TORQUE)}),
        RunPanel(
            "centre of mass",
            {"orientator.vyc": ("down", SPEED), "orientator.vxc": ("outwards", THEORY)},
        ),
        RunPanel(
            "reaction of the wall",
            {"orientator.N_K": ("wall", FORCE)},
            levels={"below 0 a real cup leaves the wall": 0.0},
            includes=(0.0,),
        ),
    ],
    "1e3 * time",
)
WALL_RECORD = (
    "orientator.N_K",
    "orientator.stage",
    "orientator.reason",
    *(f"orientator.t_{x}" for x in STAGES),
)
#: A product, and the smallest reaction of the wall.
Data = tuple[Result, Figure]


#: Longest step for the reaction of the wall [s], the default.
LONGEST_STEP = 1e-3


class OrientatorCycle(Question, RunOptions):
    """The rotor's speed, the friction of its wall, and how the run is made."""

    parts = orientator.PARTS
    fixed_starts = ("orientator.release",)

    speed: float = option("40rpm", "speed of the rotor", "rad/s", least=0.0)
    friction: float = option(0.35, "friction between cup and wall", "1", least=0.0)
    stop: float = option(orientator.LONGEST, "longest simulated time", "s", above=0.0)
    step: float = option("1ms", "finest of three communication steps", "s", above=0.0)

    def system(self, fmus: Mapping[str, Path]) -> System:
        """Return the orientator that turns at the speed of the options."""
        return orientator.system(fmus, self.speed, self.friction, self.start)

    def more_runs(self, context: Context, system: System) -> Figure:
        """Return the smallest reaction of the wall, from steps so short that each stage has the rows of a cubic.

        They are no longer than the default. Everything else is told by the FMU itself, whatever the step.
        """
        step = min(self.step, LONGEST_STEP)
        while True:
            run = replace(self, step=step)
            _, read = context.certify(
                system, {"wall": lambda r: {"wall_least": smallest_reaction(r)}}, run, WALL_RECORD
            )
            figure = read["wall_least"]
            if figure.reason not in (FEW_ROWS, SOME_RUNS) or self.stop / step > MOST_STEPS:
                return figure
            step /= 4.0

    def more_figures(self, f: Mapping[str, Figure], r: Data) -> dict[str, Figure]:
        """Return the smallest reaction of the wall, and whether the product is oriented without a pull of it."""
        meaning, wall = "oriented by a wall that only pushes: 1, or not: 0", r[1]
        pushed = Figure(float(f["oriented"].value and wall.value >= 0.0), "1", 0.0, meaning)
        if f["oriented"].value and (wall.error is None or abs(wall.value) < wall.error):
            pushed = Figure.undetermined(
                "1", wall.reason or "the force is 0 within its error", meaning
            )
        return {"wall_least": wall, "oriented_by_pushing": pushed}

    def figures(self, r: Result) -> dict[str, Figure]:
        """End, durations as far as they were reached, and impulses; the FMU tells them at the end."""

        def last(name: str, meaning: str, why: str = "") -> Figure:
            value, unit = float(r[f"orientator.{name}"][-1]), r.units[f"orientator.{name}"]
            if why:
                return Figure.undetermined(unit, why, meaning)
            return Figure(value, unit, 0.0, meaning)

        end, oriented = ending(r), r["orientator.stage"][-1] == orientator.ORIENTED
        reached = {x: r[f"orientator.t_{x}"][-1] > 0.0 for x in STAGES}
        all_figures = {
            "oriented": Figure(float(oriented), "1", 0.0, "oriented: 1, or not: 0"),
            "orientation_time": last(
                "orientation_time", "time from drop to end", "" if oriented else end
            ),
        }
        for x, is_reached in reached.items():
            all_figures[f"t_{x}"] = last(
                f"t_{x}", f"duration of the stage {x}", "" if is_reached else end
            )
        for name, (column, meaning, landing) in IMPULSES.items():
            landed = reached[landing]
            landed &= name != "hook_impulse" or int(r["orientator.reason"][-1]) != STOPPED
            why = "" if landed else f"it does not come to that: {end}"
            all_figures[name] = last(column, meaning, why)
        return all_figures

    def judgements(self, f: Mapping[str, Figure], r: Data) -> list[Judgement]:
        """What becomes of the product, how long each stage takes, and whether its wall only pushes."""
        oriented = bool(f["oriented"].value)
        wall = Judgement(
            "the wall pushes at all times, as a real one must", f["wall_least"], least=0.0
        )
        pulls = (
            "The product is oriented only if its wall can pull on the cup, which a real wall cannot"
        )
        is_so = {Holds.YES: True, Holds.NO: False}.get(wall.answer or Holds.OPEN)
        turned = Judgement(  # once it is oriented, all that is left to know is the wall's force
            "the product is oriented by a wall that only pushes",
            f["wall_least" if oriented else "orientation_time"],
            least=0.0 if oriented else -np.inf,
            is_so=is_so if oriented else False,
            yes="The product is oriented",
            no=pulls if oriented else "The product is not oriented",
            note=f"after {f['orientation_time'].brief()}" if oriented else ending(r[0]),
        )
        return [
            turned,
            wall,
            *(
                Judgement(f"duration of the stage {x}", f[f"t_{x}"])
                for x in STAGES
                if f[f"t_{x}"].error is not None
            ),
        ]

    def show(self, f: Mapping[str, Figure], r: Data) -> Show:
        """Angles, speeds and velocities over time, the stages as spans, and the cup in motion."""
        until_end = orientator.until_oriented_or_jammed(r[0])
        stages = orientator.stages(until_end)
        spans = [x._replace(first=1e3 * x.first, last=1e3 * x.last) for x in stages]
        chart = drawn(CHART, until_end)._replace(spans=spans)
        moving = motion.motion("One product", {"": until_end}, stages)
        return Show([chart], [moving])

    def live(self, f: Mapping[str, Figure], r: Data) -> Live:
        """One product, up to its end."""
        last = float(orientator.ORIENTED)
        ended = "figures.stage == " + repr(last)
        return Live(
            sliders=(
                Slider("speed", 0.5, 12.0),
                Slider("friction", 0.0, 1.0),
                Slider("orientator.spring.c", 4.0, 40.0),
                Slider("orientator.chute.H", 0.01, 0.1),
            ),
            start={"orientator.w": "speed", "orientator.chute.mu": "friction"},
            until="figures.end",
            numbers=[
                Number(
                    "end",
                    Reader("first_crossing", "orientator.stage", level=last - 0.5),
                    "s",
                    "time of the end",
                    is_visible=False,
                ),
                Number(
                    "stage",
                    Reader("last", "orientator.stage"),
                    "1",
                    "stage at the end",
                    is_visible=False,
                ),
                Number("oriented", ended),
                Number(
                    "orientation_time",
                    Reader("last", "orientator.orientation_time"),
                    when=ended,
                    otherwise="not oriented",
                ),
                *(
                    Number(
                        f"t_{x}",
                        Reader("last", f"orientator.t_{x}"),
                        when=f"figures.t_{x} > 0",
                        otherwise="not reached",
                    )
                    for x in STAGES
                ),
                *(
                    Number(name, Reader("last", f"orientator.{column}"))
                    for name, (column, _, _) in IMPULSES.items()
                ),
            ],
            charts=[CHART],
            motion=motion.live_motion("One product", r[0], 20.0),
        )


def smallest_reaction(r: Result) -> Figure:
    """The smallest reaction of the wall until the product is oriented or jams; below 0 it pulls.

    The reaction jumps from stage to stage, so that each stage has a spline of its own, up to its ends.
    """
    unit, meaning = r.units["orientator.N_K"], "smallest reaction of the wall, a pull if negative"
    end, least = 0.0, []
    for k, name in enumerate(STAGES):
        inside = r["orientator.stage"] == k
        t, force = r["time"][inside], r["orientator.N_K"][inside]
        lasts = float(r[f"orientator.t_{name}"][-1])
        ends = np.array([end, end + lasts if lasts else t.max(initial=end)])
        if ends[1] > end and len(t) < LEAST_ROWS:
            return Figure.undetermined(unit, FEW_ROWS, meaning)
        if ends[1] > end:
            least.append(
                figure_of_columns(partial(least_of_spline, ends=ends), t, force, unit=unit)
            )
        end = float(ends[1])
    if not least:
        return Figure.undetermined(unit, ending(r), meaning)
    low = min(least, key=lambda x: x.value)
    widths = [(x.value, x.error or 0.0) for x in least]
    error = max(width for value, width in widths if value - width <= low.value + (low.error or 0.0))
    return Figure(low.value, unit, error, meaning)


def least_of_spline(t: Samples, force: Samples, ends: Samples) -> float:
    """The least value between both ends of the spline through rows."""
    curve = CubicSpline(t, force)
    turns = curve.derivative().roots(extrapolate=False)
    level = turns[np.isfinite(turns)]  # a constant piece has nan
    return float(curve(np.concatenate([t, level, ends])).min())


def ending(r: Result) -> str:
    """What became of the product, in words."""
    stage, reason = (int(r[f"orientator.{name}"][-1]) for name in ("stage", "reason"))
    if reason:
        return f"the product jams: {orientator.REASONS[reason]}"
    still = "" if stage == orientator.ORIENTED else "still in the stage "
    return f"the product is {still}{orientator.STAGES[stage]}"
