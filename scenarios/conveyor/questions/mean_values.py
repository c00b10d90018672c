"""How does the ripple change the mean values, how much more must the motor give, and where does it go?

Mean speed and torque of steady orbits are compared with (18), (19) and (24), which neglect the ripple,
and with second-order theory. The power of the supply is followed into trough and motor. The drift of
the mean speed after a change of the supply is compared with (16), over starts at evenly spaced crank
angles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
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
from workbench.measure import Measured, Samples, measured
from workbench.periodic import TURN, NoOrbitError, Revolutions

from .. import motion
from ..features import converged
from ..first_order import Machine
from ..machine import PARTS as DRIVE
from ..machine import conveyor_drive
from ..options import LINEAR_MOTOR_STARTS, SweepOptions, linear_runner, speeds_of
from ..orbits import EDGE_ROWS, OrbitRunner, OrbitTask, run_to_orbit
from ..papers import cited
from ..rows import SPEEDS
from ..second_order import Means, means
from ..step_response import DRIFT, STARTS, drifts

TABLE, STEP_TABLE = "mean_values.csv", "drift.csv"
RECORD = ("motor.tau", "conveyor.phi", "conveyor.w", "conveyor.P_loss")
#: Band of a settled step response [%], by which textbooks of control define its settling time.
SETTLED = 2.0
MEANT = {
    "speed": ("rad/s", "mean speed over time"),
    "angle": ("rad/s", "mean speed over the crank angle"),
    "torque": ("N.m", "mean torque"),
    "supply": ("W", "power from the supply"),
    "trough": ("W", "power into the resistance of the trough"),
    "motor": ("W", "power into heat in the motor"),
}


class MeanValues(Question, SweepOptions):
    """The sweep over speeds, and the speed of the tables."""

    parts = DRIVE
    fixed_starts = LINEAR_MOTOR_STARTS
    decisive = ("torque", "supply_more")
    sources = cited(16, 18, 19, 22, 24)
    is_parallel = True
    record = RECORD

    speed: float | None = option(
        None, "operating speed, the resonance (22) by default", "rad/s", above=0.0
    )

    def solve(self, context: Context) -> Findings:
        """Orbits over the speed, and the drift to the operating speed; raises cosim.SetupError.

        This replaces the single certified run, because the figures come from steady orbits at many speeds, and
        those of the step from several starts that are averaged.
        """
        machine, runner = linear_runner(self, context)
        nus, operating = (
            self.speeds or speeds_of(SPEEDS[self.set]),
            self.speed or float(machine.nu_res),
        )
        for nu in nus:
            runner.check(machine, nu)
        multiples = runner.step_multiples(machine, nus[0])
        runner.check(machine, operating, multiples[-1])
        wanted = sorted({*nus, operating})
        cases = [runner.task(machine, nu, k) for nu in wanted for k in multiples]
        orbits = context.each(balance, cases, "orbits")
        rows = {
            nu: mean_figures(list(islice(orbits, len(multiples))), self.algorithm) for nu in wanted
        }
        units = {"nu": "rad/s"}
        for name, (unit, _) in MEANT.items():
            units |= {
                name: unit,
                f"{name}_error": unit,
                f"{name}_theory": unit,
                f"{name}_plain": unit,
            }
        table = Table.of_rows([row(machine, nu, rows[nu]) for nu in nus], units)
        step_response, figures = drifts(machine, runner, multiples, operating)
        torque = rows[operating]["torque"]
        for name in DRIFT:
            if torque.error is None:  # nothing that the mean speed could settle at
                figures[name] = Figure.undetermined("%", torque.reason, figures[name].meaning)
        return Findings(
            compared(machine, operating, rows[operating]) | figures,
            MeanData(machine, runner, operating, table.frame, step_response.frame),
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
                "the mean speed stays within its settling band after a step of the supply: overshoot",
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
                r.runner.drive,
                r.machine,
                r.operating,
            ),
        )


class MeanData(NamedTuple):
    """The machine and how it is run, the operating speed [rad/s], rows of both tables."""

    machine: Machine
    runner: OrbitRunner
    operating: float
    rows: Any
    step_response: Any

    @property
    def still_rises(self) -> bool:
        """Whether the mean speed is above that of the new supply, and largest, at the end of the step response."""
        mean = self.step_response["mean"].to_numpy()
        return bool(mean[-1] > self.operating and np.argmax(mean) == len(mean) - 1)


def balance(task: OrbitTask) -> dict[str, Measured] | str:
    """The means of a steady orbit by name, with what rows and settling leave open, or why none is."""
    try:
        turns = run_to_orbit(task, RECORD)
    except NoOrbitError as problem:
        return str(problem)
    now, before = (revolution(turns, task.start, back) for back in (0, 1))
    left = {name: turns.settling_error(abs(now[name].value - before[name].value)) for name in now}
    return {name: Measured(x, error + left[name]) for name, (x, error) in now.items()}


def revolution(turns: Revolutions, start: Mapping[str, Any], back: int) -> dict[str, Measured]:
    """The means of the last revolution, or of one so many before it."""
    second_order, r = turns.window(back), turns.result
    rows = slice(max(0, second_order.start - EDGE_ROWS), second_order.stop + EDGE_ROWS)
    t, tau, phi, w, loss = (r[name][rows] for name in ("time", *RECORD))
    B, times = float(start["motor.B"]), turns.times[[-2 - back, -1 - back]]

    def over(x: Samples, ends: Any, y: Samples) -> Measured:
        return measured(lambda x, y: CubicSpline(x, y).integrate(*ends) / np.ptp(ends), x, y)

    torque = over(t, times, tau)
    field = float(start["motor.A"]) / B
    return {
        "speed": Measured(TURN / turns.period(back), 2e-9 * TURN / turns.period(back)),
        "angle": over(phi, turns.ends[[-2 - back, -1 - back]], w),
        "torque": torque,
        "supply": Measured(field * torque.value, field * torque.error),
        "trough": over(t, times, loss),
        "motor": over(t, times, tau**2 / B),
    }


def mean_figures(runs: Sequence[dict[str, Measured] | str], algorithm: str) -> dict[str, Figure]:
    """The figures of orbits of one speed with N, N/2, N/4 steps."""
    return {
        name: converged(
            [x if isinstance(x, str) else x[name] for x in runs],
            cosim.CONVERGENCE_ORDERS[algorithm],
            *meant,
        )
        for name, meant in MEANT.items()
    }


def row(machine: Machine, nu: float, figures: Mapping[str, Figure]) -> list[float]:
    """What the table tells of a speed: each mean with its error, with ripple and without by theory."""
    theory, plain = means(machine, nu), means(machine, nu, ripple=False)
    cells = [nu]
    for name, figure in figures.items():
        error = math.nan if figure.error is None else figure.error
        cells += [figure.value, error, theory._asdict()[name], plain._asdict()[name]]
    return cells


def compared(machine: Machine, nu: float, figures: Mapping[str, Figure]) -> dict[str, Figure]:
    """The means at the operating speed, and how far they are from those without ripple."""
    plain: Means = means(machine, nu, ripple=False)
    all_figures = {name: figures[name] for name in ("speed", "angle", "torque")}
    all_figures["torque_plain"] = Figure(plain.torque, "N.m", 0.0, "mean torque by formula (24)")
    torque = figures["torque"]
    above = "mean torque above that"
    all_figures["more"] = (
        excess(torque, plain.torque, above, 100 / plain.torque, "%")
        if plain.torque
        else Figure.undetermined("%", "without resistance that torque is 0", above)
    )
    for name in ("supply", "motor", "trough"):
        what = f"{MEANT[name][1]}, above that without ripple"
        all_figures[f"{name}_more"] = excess(figures[name], plain._asdict()[name], what)
    parts = [figures[name] for name in ("supply", "motor", "trough")]
    errors = [figure.error for figure in parts if figure.error is not None]
    gap = "power not accounted for"
    all_figures["missing"] = (
        Figure(parts[0].value - parts[1].value - parts[2].value, "W", sum(errors), gap)
        if len(errors) == len(parts)
        else Figure.undetermined("W", torque.reason, gap)
    )
    return all_figures


def excess(
    figure: Figure, plain: float, meaning: str, scale: float = 1.0, unit: str = ""
) -> Figure:
    """How far a figure is above a value, perhaps in another unit."""
    unit = unit or figure.unit
    if figure.error is None:
        return Figure.undetermined(unit, figure.reason, meaning)
    return Figure(scale * (figure.value - plain), unit, scale * figure.error, meaning)


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
