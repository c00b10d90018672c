"""How does the ripple change the mean values, how much more must the motor give, and where does it go?

Mean speed and torque of steady orbits are compared with (18), (19) and (24), which neglect the ripple,
and with second-order theory. The power of the supply is followed into trough and motor. The drift of
the mean speed after a change of the supply is compared with (16), over starts at evenly spaced crank
angles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import sub
from typing import Any, NamedTuple

import numpy as np

from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Mark,
    Panel,
    Question,
    Show,
    Table,
    option,
)
from workbench.charts.model import POWER, SPEED, THEORY, TORQUE, SecondUnit
from workbench.figure import figure_of_figures
from workbench.orbits import table_of

from .. import motion
from ..drive_orbits import ORBIT_ALGORITHMS, require_enough_steps_per_rev
from ..first_order import SETS, Machine
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive, followed
from ..options import LINEAR_MOTOR_STARTS, speeds_of
from ..orbit import MEANS, Drive
from ..papers import cited
from ..second_order import means
from ..speed_sweep import SPEEDS
from ..step_response import DRIFT, STARTS, drifts

TABLE, STEP_TABLE = "mean_values.csv", "drift.csv"
#: Band of a settled step response [%], by which textbooks of control define its settling time.
SETTLED = 2.0


class MeanValues(Question):
    """The sweep over speeds, and the speed of the tables."""

    parts = DRIVE
    fixed_starts = LINEAR_MOTOR_STARTS
    decisive = ("torque", "supply_more")
    sources = cited(16, 18, 19, 22, 24)
    is_parallel = True

    set: str = option("A", "parameter set", choices=SETS)
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)
    algorithm: str = option("strang", "coupling algorithm", choices=ORBIT_ALGORITHMS)
    speeds: tuple[float, ...] = option(
        (), "speeds of the sweep, those of the set by default", "rad/s", above=0.0
    )
    speed: float | None = option(
        None, "operating speed, the resonance (22) by default", "rad/s", above=0.0
    )

    def solve(self, context: Context) -> Findings:
        """Orbits over the speed, and the drift to the operating speed; raises cosim.SetupError.

        This replaces the single certified run, because the figures come from steady orbits at many speeds, and
        those of the step from several starts that are averaged.
        """
        machine, drive = followed(context.fmus, SETS[self.set], self.start), Drive.of(context, self)
        nus = self.speeds or speeds_of(SPEEDS[self.set])
        operating = self.speed or float(machine.nu_res)
        for nu in (*nus, operating):
            require_enough_steps_per_rev(self, machine, nu)
        every = sorted({*nus, operating})
        columns = {name + end: name + end for name in MEANS for end in ("", "_theory", "_plain")}
        inputs = {"nu": ("rad/s", every)}
        table, found = table_of(context, TABLE, drive.asked(machine, every), inputs, columns)
        table = Table.of_frame(table.frame[table.frame["nu"].isin(nus)], table.units)
        at = found.motion(every.index(operating)).figures
        step_response, figures = drifts(machine, drive, operating)
        torque = at["torque"]
        for name in DRIFT:
            if torque.error is None:  # nothing that the mean speed could settle at
                figures[name] = Figure.undetermined("%", torque.reason, figures[name].meaning)
        return Findings(
            compared(at) | figures,
            MeanData(machine, drive, operating, table.frame, step_response.frame),
            conveyor_drive(context.fmus, {**machine.start(operating), **self.start}),
            communication=f"{self.steps_per_rev} steps per revolution",
            algorithm=self.algorithm,
            tables={TABLE: table, STEP_TABLE: step_response},
            facts={"operating_speed": operating},
            defaults={"speed": operating, "speeds": nus},
        )

    def judgements(self, f: Mapping[str, Figure], r: MeanData) -> list[Judgement]:
        """What the ripple costs, and how accurate the settling formula (16) is."""
        rises = f"it still rises at the end of the run at {r.step_response['time'].iloc[-1]:.3g} s"
        return [
            Judgement(
                f"mean torque at {r.operating:g} rad/s",
                f["torque"],
                note=f"{f['torque_plain'].brief()} by the mean-torque formula (24), which neglects the ripple",
            ),
            Judgement("mean torque above that formula", f["more"]),
            Judgement("power from the supply, above that without ripple", f["supply_more"]),
            Judgement(
                f"after a step of the supply the mean speed overshoots by at most {SETTLED:g} % of the step",
                f["overshoot"],
                most=SETTLED,
                note=rises if r.still_rises else "",
            ),
            Judgement("error of the settling formula (16), over the step", f["off_16"]),
        ]

    def show(self, f: Mapping[str, Figure], r: MeanData) -> Show:
        """Means over the speed beside theory, the drift of the mean, one revolution."""
        charts = [over_speed(f, r), step_response(f, r)]
        return Show(
            charts,
            *motion.revolution(
                r.drive,
                r.machine,
                r.operating,
            ),
        )


class MeanData(NamedTuple):
    """The machine and how it is run, the operating speed [rad/s], rows of both tables."""

    machine: Machine
    drive: Drive
    operating: float
    rows: Any
    step_response: Any

    @property
    def still_rises(self) -> bool:
        """Whether the mean speed is above that of the new supply, and largest, at the end of the step response."""
        mean = self.step_response["mean"].to_numpy()
        return bool(mean[-1] > self.operating and np.argmax(mean) == len(mean) - 1)


def compared(at: Mapping[str, Figure]) -> dict[str, Figure]:
    """The means at the operating speed, and how far they are from those without ripple."""
    all_figures = {name: at[name] for name in ("speed", "angle", "torque")}
    plain, above = at["torque_plain"].value, "mean torque above that"
    all_figures["torque_plain"] = at["torque_plain"]._replace(meaning="mean torque by formula (24)")
    all_figures["more"] = (
        figure_of_figures(
            lambda x: 100.0 * (x / plain - 1.0), at["torque"], unit="%", meaning=above
        )
        if plain
        else Figure.undetermined("%", "without resistance that torque is 0", above)
    )
    for name in ("supply", "motor", "trough"):
        what = f"{MEANS[name][1]}, above that without ripple"
        all_figures[f"{name}_more"] = figure_of_figures(
            sub, at[name], at[f"{name}_plain"], unit="W", meaning=what
        )
    all_figures["missing"] = figure_of_figures(
        lambda supply, motor, trough: supply - motor - trough,
        *(at[name] for name in ("supply", "motor", "trough")),
        unit="W",
        meaning="power not accounted for",
    )
    return all_figures


def over_speed(f: Mapping[str, Figure], r: MeanData) -> Chart:
    """Mean torque, mean speeds from the nominal one, powers above those without ripple."""
    nu = np.linspace(r.rows["nu"].min(), r.rows["nu"].max(), 400)
    theory, plain = means(r.machine, nu), means(r.machine, nu, ripple=False)

    def pair(label: str, name: str, color: str, less: Any = None) -> list[Curve]:
        base = 0.0 if less is None else r.rows[less]
        without = {None: 0.0, "nu": nu}.get(less, plain._asdict()[name])
        line = theory._asdict()[name] - without
        points = r.rows[name] - base
        return [
            Curve(f"{label}, second-order theory", nu, line, color, "theory"),
            Curve(
                f"{label}, co-simulation",
                r.rows["nu"],
                points,
                color,
                "points",
                r.rows[f"{name}_error"],
            ),
        ]

    torque = pair("with ripple", "torque", TORQUE)
    torque.insert(0, Curve("without ripple, formula (24)", nu, plain.torque, THEORY, "theory"))
    speed = [
        *pair("over time", "speed", SPEED, "nu"),
        *pair("over the angle", "angle", "sky", "nu"),
    ]
    power = [
        curve
        for name, label, color in (
            ("supply", "from the supply", POWER),
            ("motor", "heat in the motor", TORQUE),
            ("trough", "into the trough", "green"),
        )
        for curve in pair(label, name, color, f"{name}_plain")
    ]
    return Chart(
        "Means over the speed",
        "nominal mean speed [rad/s]",
        [
            Panel("mean torque", "N.m", torque, includes=(0.0,)),
            Panel("mean speed above nominal", "rad/s", speed),
            Panel("power above that without ripple", "W", power),
        ],
        [Mark(r.operating, f"operating speed {r.operating:g} rad/s")],
        second=SecondUnit("rpm", 30 / math.pi),
    )


def step_response(f: Mapping[str, Figure], r: MeanData) -> Chart:
    """The mean speed after a step of the supply, and what both equations make of it."""
    t = 1e3 * r.step_response["time"]
    curves = [
        Curve("one of the starts", t, r.step_response["w"], "sky"),
        Curve(f"mean of {STARTS} starts", t, r.step_response["mean"], SPEED),
        Curve("settling formula (16)", t, r.step_response["mean_16"], TORQUE, "theory"),
        Curve("with the term it neglects", t, r.step_response["mean_whole"], "black", "theory"),
    ]
    title = f"Mean speed after the supply is raised for {r.operating:g} rad/s"
    level = Mark(r.operating, f"nominal {r.operating:g} rad/s")
    return Chart(title, "time [ms]", [Panel("crank speed", "rad/s", curves, [level])])
