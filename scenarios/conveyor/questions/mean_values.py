"""How does the ripple change the mean values, how much more must the motor give, and where does it go?

Mean speed and torque of steady orbits are compared with (18), (19) and (24), which neglect the ripple,
and with second-order theory. The power of the supply is followed into trough and motor. The drift of
the mean speed after a change of the supply is compared with (16), over starts at evenly spaced crank
angles.
"""

from __future__ import annotations

from collections.abc import Mapping
from operator import sub
from typing import NamedTuple

import numpy as np

from workbench import (
    Context,
    Figure,
    Findings,
    Judgement,
    Mark,
    Plan,
    PlanQuestion,
    Show,
    Table,
    option,
)
from workbench.charts import model as colors
from workbench.figure import figure_of_figures
from workbench.plan import Measured
from workbench.study.charts import curves_over

from .. import motion
from ..drive_orbits import ORBIT_ALGORITHMS, require_enough_steps_per_rev
from ..first_order import SETS, Machine
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive, machine_with_start_values
from ..options import LINEAR_MOTOR_STARTS, speeds_of
from ..orbit import MEANS, Drive, plan_of
from ..papers import cited
from ..second_order import means
from ..speed_sweep import SPEEDS
from ..step_response import DRIFT, STARTS, drifts

TABLE, STEP_TABLE = "mean_values.csv", "drift.csv"
#: What is drawn of both tables.
ABOVE = {
    quantity: {
        f"{x}{end}": (f"{text}, {kind}", color)
        for x, (text, color) in names.items()
        for end, kind in (("_theory", "second-order theory"), ("", "co-simulation"))
    }
    for quantity, names in (
        ("mean torque", {"torque": ("with ripple", colors.TORQUE)}),
        ("mean speed above nominal",
         {"speed": ("over time", colors.SPEED), "angle": ("over the angle", "sky")}),
        ("power above that without ripple",
         {"supply": ("from the supply", colors.POWER), "motor": ("heat in the motor", colors.TORQUE),
          "trough": ("into the trough", "green")}),
    )
}  # fmt: skip
ABOVE["mean torque"]["torque_plain"] = ("without ripple, formula (24)", colors.THEORY)
STEP_CURVES = {
    "w": ("one of the starts", "sky"), "mean": (f"mean of {STARTS} starts", colors.SPEED),
    "mean_16": ("settling formula (16)", colors.TORQUE, "theory"),
    "mean_whole": ("with the term it neglects", "black", "theory"),
}  # fmt: skip
#: Speeds of a curve of theory; chosen: more than a screen shows.
CURVE_SPEEDS = 400
#: Band of a settled step response [%], by which textbooks of control define its settling time.
SETTLED = 2.0


class MeanValues(PlanQuestion):
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

    @property
    def nus(self) -> tuple[float, ...]:
        """The speeds of the table [rad/s]."""
        return self.speeds or speeds_of(SPEEDS[self.set])

    def plans(self, context: Context) -> dict[str, Plan]:
        """Orbits over the speed, and at the operating speed."""
        machine = machine_with_start_values(context.fmus, SETS[self.set], self.start)
        every = sorted({*self.nus, self.speed or float(machine.nu_res)})
        for nu in every:
            require_enough_steps_per_rev(self, machine, nu)
        columns = {name + end: name + end for name in MEANS for end in ("", "_theory", "_plain")}
        return {
            TABLE: plan_of(machine, self, {"speed": every}, names={"speed": "nu"}, columns=columns)
        }

    def conclude(self, context: Context, measured: Mapping[str, Measured]) -> Findings:
        """The means at the operating speed, and the drift to it, from several starts that are averaged."""
        (found,), drive = measured.values(), Drive.of(context, self)
        machine: Machine = found.motions.asked[0].given
        operating = self.speed or float(machine.nu_res)
        frame = found.table.frame
        table = Table.of_frame(frame[frame["nu"].isin(self.nus)], found.table.units)
        at = found.motions.motion(found.plan.grid["speed"].index(operating)).figures
        step_response, figures = drifts(machine, drive, operating)
        torque = at["torque"]
        for name in DRIFT:
            if torque.error is None:  # nothing that the mean speed could settle at
                figures[name] = Figure.undetermined("%", torque.reason, figures[name].meaning)
        return Findings(
            figures_against_no_ripple(at) | figures,
            MeanData(machine, drive, operating, table, step_response),
            conveyor_drive(context.fmus, {**machine.start(operating), **self.start}),
            tables={TABLE: table, STEP_TABLE: step_response},
            facts={"operating_speed": operating},
            defaults={"speed": operating, "speeds": self.nus},
        )

    def judgements(self, f: Mapping[str, Figure], r: MeanData) -> list[Judgement]:
        """What the ripple costs, and how accurate the settling formula (16) is."""
        rises = (
            f"it still rises at the end of the run at {r.step_response.columns['time'][-1]:.3g} s"
        )
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
        at = Mark(r.operating, f"operating speed {r.operating:g} rad/s")
        title = f"Mean speed after the supply is raised for {r.operating:g} rad/s"
        charts = [
            curves_over(
                above_plain(r.means),
                "nu",
                ABOVE,
                "Means over the speed",
                marks=[at],
                theory=above_plain(r.theory),
                x="nominal mean speed [rad/s]",
            ),
            curves_over(r.step_response, "time", {"crank speed": STEP_CURVES}, title),
        ]
        return Show(charts, *motion.revolution(r.drive, r.machine, r.operating))


class MeanData(NamedTuple):
    """The machine and how it is run, the operating speed [rad/s], both tables."""

    machine: Machine
    drive: Drive
    operating: float
    means: Table
    step_response: Table

    @property
    def theory(self) -> Table:
        """The means by theory between the speeds of the table."""
        first, last = self.means.columns["nu"][[0, -1]]
        nu = np.linspace(first, last, CURVE_SPEEDS)
        columns = {"nu": nu}
        for end, ripple in (("_theory", True), ("_plain", False)):
            of_theory = means(self.machine, nu, ripple=ripple)._asdict()
            columns |= {f"{name}{end}": x + 0.0 * nu for name, x in of_theory.items()}
        return Table(columns, self.means.units)

    @property
    def still_rises(self) -> bool:
        """Whether the mean speed is above that of the new supply, and largest, at the end of the step response."""
        mean = self.step_response.columns["mean"]
        return bool(mean[-1] > self.operating and np.argmax(mean) == len(mean) - 1)


def figures_against_no_ripple(at: Mapping[str, Figure]) -> dict[str, Figure]:
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


def above_plain(table: Table) -> Table:
    """Return the table less the means without ripple, but for the torque."""
    columns = {
        name: x
        if name.startswith(("nu", "torque")) or name.endswith("_error")
        else x - table.columns[f"{name.partition('_')[0]}_plain"]
        for name, x in table.columns.items()
    }
    return Table(columns, table.units)
