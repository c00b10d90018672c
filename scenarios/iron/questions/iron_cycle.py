"""What do motor, chain and cam of the sealing iron carry over one turn, and how fast may it run?

The cam turns at constant speed. The answer gives torque, forces and motion of the iron over the cam
angle, the work of friction per cycle, and the speeds at which follower or chain let go.

With `--compare dimensions` it also gives the transfer functions of rocker, link and chain and the terms of
A_1 eps + B_1 w^2 = M + C_1, and by how much each of them changes with each dimension.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from cosim import System
from cosim.metrics import Integral, TimeOfLargest, TimeOfSmallest
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
    Table,
    option,
)
from workbench.charts.model import FORCE, LIFT, SPEED, TORQUE
from workbench.figure import figure_of_figures, scaled
from workbench.judgement import Holds
from workbench.live import moved

from .. import machine as iron
from .. import transfer
from ..turn import Data, IronTurn

DIMENSIONS = "dimensions"
FORCES = {
    "iron.N": ("cam on follower", TORQUE),
    "iron.T_span": ("chain at the link", SPEED),
    "iron.T_iron": ("chain at the iron", LIFT),
}


class IronCycle(IronTurn):
    """The machines to compare with."""

    is_sequential = False  # the runs of the comparison are many

    compare: str = option(
        "none",
        "also compare machines whose dimensions differ slightly",
        choices=("none", DIMENSIONS),
    )

    numbers = (
        Number("tau_cam_min", Reader("min", "iron.tau_cam"), meaning="smallest torque at the cam shaft"),
        Number("tau_cam_min_angle", TimeOfSmallest("iron.tau_cam"), meaning="cam angle of the smallest torque"),
        Number("tau_cam_max", Reader("max", "iron.tau_cam"), meaning="largest torque at the cam shaft"),
        Number("tau_cam_max_angle", TimeOfLargest("iron.tau_cam"), meaning="cam angle of the largest torque"),
        Number(
            "tau_motor_max", Reader("max", "abs(iron.tau_cam) / iron.reducer.i_g"), "N.m", "largest torque of the motor"
        ),
        Number("stroke", Reader("max", "iron.lift"), meaning="stroke of the iron"),
        Number("friction_work", Reader("last", "iron.E_friction"), meaning="work of the guide friction per turn"),
        Number("work", Integral("iron.tau_cam"), meaning="work of the cam torque per turn"),
        *(
            Number(f"{name}_force_{kind}", Reader(kind, force), meaning=f"{size} {meaning}")
            for name, (force, _, meaning) in iron.LETS_GO.items()
            for kind, size in (("min", "smallest"), ("max", "largest"))
        ),
    )  # fmt: skip
    charts = (
        RunChart(
            "One turn of the cam",
            "cam angle [deg]",
            [
                RunPanel("forces", FORCES, levels={"0: contact or chain lets go": 0.0}, includes=(0.0,)),
                RunPanel("torque of the cam", {"iron.tau_cam": TORQUE}),
                RunPanel("lift", {"iron.lift": LIFT}, "mm"),
                RunPanel("velocity", {"iron.v": SPEED}),
                RunPanel("acceleration", {"iron.a": FORCE}),
            ],
            x="iron.phi * 180 / pi",
        ),
    )  # fmt: skip
    sliders = (
        Slider("speed", 1.0, 12.0),
        Slider("iron.iron.m", 1.0, 10.0),
        Slider("iron.spring.c", 0.0, 1200.0),
        Slider("iron.friction.K_up", 0.0, 0.3),
    )

    def further_runs(self, context: Context, plain: System) -> transfer.TransferFunctions | None:
        """Run turns of drives with other dimensions."""
        if self.compare != DIMENSIONS:
            return None
        return transfer.transfer_functions(context, plain, self.samples)

    def more_figures(self, f: Mapping[str, Figure], r: Data) -> dict[str, Figure]:
        """Return angles and work at the imposed speed, cycles per minute, limits, and the transfer functions."""
        angles = {
            name: scaled(f[name], math.degrees(self.speed), "deg", f[name].meaning)
            for name in ("tau_cam_min_angle", "tau_cam_max_angle")
        }
        work = scaled(f["work"], self.speed, "J", f["work"].meaning)
        (limit, _), meaning = iron.first_limit(r[1].limits), "speed as a share of the first limit"
        share = Figure.undetermined("%", "the first limit is 0", meaning)
        if limit.value:
            share = figure_of_figures(
                lambda x: 100.0 * self.speed / x, limit, unit="%", meaning=meaning
            )
        of_dimensions = r[1].more.figures() if r[1].more else {}
        read = {**f, **angles, "work": work}
        if self.speed > limit.value:
            read = {
                x: y._replace(meaning=f"{y.meaning}, of a drive that is held together")
                for x, y in read.items()
            }
        return {
            **read,
            "cycles": iron.cycles(self.speed),
            **r[1].limits,
            "share": share,
            **of_dimensions,
        }

    def tables(self, f: Mapping[str, Figure], r: Data) -> dict[str, Table]:
        """Return the transfer functions and the shares of the dimensions."""
        return r[1].more.tables() if r[1].more else {}

    def judgements(self, f: Mapping[str, Figure], r: Data) -> list[Judgement]:
        """Whether the speed is safe, what the drive carries, and which dimensions matter."""
        limit, event = iron.first_limit(f)
        at = iron.pace(self.speed)
        safe = Judgement(
            f"{at} is below the speed where {event}",
            Figure(self.speed, "rad/s", 0.0),
            most=limit,
            yes=f"{at} is safe",
            no=f"Avoid {at}",
            note=f"above that {event}",
        )
        carried = {
            "smallest torque of the cam shaft": f["tau_cam_min"],
            "largest torque of the cam shaft": f["tau_cam_max"],
            "largest pull of the chain": f["run_force_max"],
        }
        if safe.answer is Holds.NO:
            why = (
                f"{event} at this speed, and the figures are those of a drive that is held together"
            )
            carried = {what: Figure.undetermined(x.unit, why) for what, x in carried.items()}
        return [
            safe,
            *(Judgement(what, figure) for what, figure in carried.items()),
            *(r[1].more.judgements(f) if r[1].more else []),
        ]

    def show(self, f: Mapping[str, Figure], r: Data) -> Show:
        """Forces, torque and motion over the cam angle; the mechanism in motion."""
        more = r[1].more.charts() if r[1].more else []
        return Show([self.chart(f, r), *more], [moved(self.motion(f, r), r[0])])
