"""What the questions about turns of the iron's cam at constant speed have in common."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

from cosim import Result, System
from workbench import Chart, Context, Figure, Question, RunOptions, option
from workbench.live import Formulas, Live, LiveMotion, drawn

from . import machine as iron
from . import motion


class ConstantSpeed(NamedTuple):
    """What stands beside the turns: the drive, the speeds at which something lets go, and further runs."""

    system: System
    limits: Mapping[str, Figure]
    more: Any


Data = tuple[Result, ConstantSpeed]


class IronTurn(Question):
    """The speed of the cam, and the rows of a turn."""

    parts: ClassVar[Mapping[str, str]] = {"iron": "IronDrive"}
    fixed_starts: ClassVar[Sequence[str]] = iron.IMPOSED
    start_values: ClassVar[Formulas] = {
        "iron.on_invalid": 1, "iron.tau": 0.0, "iron.phi": 0.0, "iron.w_cam": "speed", "iron.reducer.J": iron.FLYWHEEL,
    }  # fmt: skip
    #: What of a run is read, and by which angle it is told.
    window: ClassVar[str] = ""
    angle: ClassVar[str] = ""

    speed: float = option(iron.NOMINAL, "speed of the cam", "rad/s", above=0.0)
    samples: int = option(1440, "rows per turn", least=180)

    def run_options(self) -> RunOptions:
        """Return those of a turn."""
        period = 2 * math.pi / self.speed
        return RunOptions(stop=period, step=period / self.samples)

    def more_runs(self, context: Context, system: System) -> ConstantSpeed:
        """Run two turns for the limits, and what the question has besides."""
        plain = System(context.fmus, start=self.start)
        return ConstantSpeed(plain, iron.limits(plain), self.further_runs(context, plain))

    def further_runs(self, context: Context, plain: System) -> Any:
        """Do further runs of the drive."""

    def turn(self, r: Data) -> Result:
        """Return the last turn."""
        return r[0].select(slice(-1 - self.samples, None))

    def chart(self, f: Mapping[str, Figure], r: Data) -> Chart:
        """Return the last turn over the cam angle, its phases as spans."""
        turn = self.turn(r)
        spans = iron.phases(turn.provenance["parts"]["iron"]["parameters"])
        title = f"A turn of the cam at {f['cycles'].brief('cycles/min')}"
        return drawn(self.charts[0], turn, angle=self.angle)._replace(title=title, spans=spans)

    def motion(self, f: Mapping[str, Figure], r: Data) -> LiveMotion:
        """The mechanism."""
        return motion.live_motion("A turn of the cam", self.turn(r), r[1].system, 4.0, self.window)

    def live(self, f: Mapping[str, Figure], r: Data) -> Live:
        """The turns at the speed of the slider."""
        start = {x: y for x, y in self.start_values.items() if x not in self.start}
        turns, step = round((len(r[0]["time"]) - 1) / self.samples), "2 * pi / (speed * samples)"
        return self.page(
            f, r, start=start, stop=f"{turns} * 2 * pi / speed", step=step, angle=self.angle
        )
