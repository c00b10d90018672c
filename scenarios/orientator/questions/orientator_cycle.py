"""How does one product turn over, and how long does each stage take?

One cup is followed from the drop to the end, with its trajectory, angles and speeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

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
    Reader,
    RunChart,
    RunPanel,
    Show,
    Slider,
)
from workbench.charts.model import FORCE, SPEED, THEORY, TORQUE
from workbench.figure import figure_of_columns
from workbench.judgement import Holds
from workbench.live import Live, LiveMotion, drawn

from .. import machine as orientator
from .. import motion
from ..passage import STAGES_PASSED, Passage, ending

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
    *(f"orientator.t_{x}" for x in STAGES_PASSED),
)
#: A product, and the smallest reaction of the wall.
Data = tuple[Result, Figure]


#: Longest step for the reaction of the wall [s], the default.
LONGEST_STEP = 1e-3


class OrientatorCycle(Passage):
    """Those of a product; its wall besides."""

    sliders = (
        Slider("speed", 0.5, 12.0),
        Slider("friction", 0.0, 1.0),
        Slider("orientator.spring.c", 4.0, 40.0),
        Slider("orientator.chute.H", 0.01, 0.1),
    )
    charts = (CHART,)

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
        """Return the smallest reaction of the wall besides, and whether the product is oriented without a pull of it."""
        meaning, wall = "oriented by a wall that only pushes: 1, or not: 0", r[1]
        pushed = Figure(float(f["oriented"].value and wall.value >= 0.0), "1", 0.0, meaning)
        if f["oriented"].value and (wall.error is None or abs(wall.value) < wall.error):
            pushed = Figure.undetermined(
                "1", wall.reason or "the force is 0 within its error", meaning
            )
        return {**super().more_figures(f, r[0]), "wall_least": wall, "oriented_by_pushing": pushed}

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
                for x in STAGES_PASSED
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

    def motion(self, f: Mapping[str, Figure], r: Data) -> LiveMotion:
        """The cup on its catcher."""
        return motion.live_motion("One product", r[0], 20.0)

    def live(self, f: Mapping[str, Figure], r: Data) -> Live:
        """One product, up to its end."""
        over = Reader("first_crossing", "orientator.stage", level=orientator.ORIENTED - 0.5)
        end = Number("end", over, "s", "time of the end", is_visible=False)
        start = {"orientator.w": "speed", "orientator.chute.mu": "friction"}
        return self.page(f, r, more=[end], start=start, until="figures.end")


def smallest_reaction(r: Result) -> Figure:
    """The smallest reaction of the wall until the product is oriented or jams; below 0 it pulls.

    The reaction jumps from stage to stage, so that each stage has a spline of its own, up to its ends.
    """
    unit, meaning = r.units["orientator.N_K"], "smallest reaction of the wall, a pull if negative"
    end, least = 0.0, []
    for k, name in enumerate(STAGES_PASSED):
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
