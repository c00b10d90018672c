"""Where does an induction motor put the resonance, given its data sheet, its slip and its load?

The lag of (2) is that of the rotor flux, T = 1 / (2 pi f s_b), and its slope is that of Kloss's
characteristic at the working point. The speed of the 90 degree lag with the full characteristic is
compared with that of a linear motor of this slope, over the load and over the breakdown slip.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from cosim import SetupError
from cosim.system import Value
from workbench import (
    Context,
    Figure,
    Findings,
    Judgement,
    Mark,
    Question,
    Show,
    Table,
    option,
)
from workbench.charts.model import CurveLook
from workbench.figure import figure_of_figures
from workbench.find import Find, find
from workbench.orbits import STEP_MULTIPLES, measured
from workbench.roots import roots_between
from workbench.study.charts import curves_over

from .. import motion
from ..drive_orbits import ORBIT_ALGORITHMS, require_enough_steps_per_rev
from ..first_order import SETS, Machine, Samples, flux_lag
from ..machine import (
    KLOSS,
    conveyor_drive,
    kloss_slips,
    linearised,
    machine_with_start_values,
    require_torque,
)
from ..machine import PARTS as DRIVE
from ..options import NameplateOptions
from ..orbit import Drive, DriveOrbit, RippleGuide
from ..papers import cited
from ..speed_sweep import LARGEST_PEAKED_ZETA, NOT_IN_RANGE, PHASE_UNDEFINED, VANISHING

TABLE, SWEEP = "induction_motor.csv", "induction_motor_speeds.csv"
#: Speeds between which the lag is sought, over the resonance of the motor without slip; a convention.
RANGE = (0.6, 1.4)
#: Speeds between them at which theory is looked at.
CURVE_POINTS = 100
#: Half the speeds of the table, about; a convention.
GUIDE_SPEEDS = 5
#: Supply frequency where nothing is said [Hz].
SUPPLY = 50.0
MOTORS = {"linear": "linear motor", "kloss": "full characteristic"}
LAGS: dict[str, dict[str, CurveLook]] = {
    "speed of 90 deg lag": {
        **{f"nu_{x}": text for x, text in MOTORS.items()},
        "nu_res": ("formula (22), slope at the slip", "grey", "theory"),
        "nu_flux": ("rotor flux instead of (2)", "black", "theory"),
    },
    "damping ratio": {"zeta": ("formula", "green")},
}  # fmt: skip
COLUMNS = {
    "resistance": "N.s/m", "breakdown_slip": "1", "load": "N.m", "slip": "1", "slope": "N.m.s/rad",
    "lag": "s", "zeta": "1", "nu_res": "rad/s", "nu_flux": "rad/s", "nu_linear": "rad/s",
    "nu_linear_error": "rad/s", "nu_kloss": "rad/s", "nu_kloss_error": "rad/s",
}  # fmt: skip


class InductionMotor(Question, NameplateOptions):
    """The supply, and the points of the two series: resistances and breakdown slips."""

    parts = DRIVE
    fixed_starts = (
        "motor.characteristic",
        "motor.A",
        "motor.B",
        "motor.tau",
        "conveyor.phi",
        "conveyor.w",
    )
    decisive = ("nu_kloss",)
    sources = cited(2, 22)

    of_question = ("motor.T",)  # the lag follows from each slip

    frequency: float = option(
        SUPPLY, "supply frequency that gives motor.kloss.w_s without load", "Hz", above=0.0
    )
    resistances: tuple[float, ...] = option(
        "4000:40000:5", "resistances of the trough", "N.s/m", above=0.0
    )
    slips: tuple[float, ...] = option(
        "0.08,0.1,0.13,0.16,0.22,0.35", "breakdown slips", "1", above=0.0
    )
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)
    algorithm: str = option("strang", "coupling algorithm", choices=ORBIT_ALGORITHMS)

    def solve(self, context: Context) -> Findings:
        """All motors together, and the one of the data sheet over the speed.

        This replaces the single certified run, because the figures come from steady orbits at many speeds of
        many motors.
        """
        start = {**KLOSS, **self.start, "motor.characteristic": 1}
        frequency = self.plate.frequency if self.plate else self.frequency
        if self.frequency not in (frequency, SUPPLY):
            raise SetupError(
                f"frequency = {self.frequency:g} Hz contradicts the nameplate, which says {frequency:g} Hz: leave one out"
            )

        def motor(changed: Mapping[str, Value]) -> Motor:
            start_ = {**start, **changed}
            lag = 1 / (2 * math.pi * frequency * float(start_["motor.kloss.s_b"]))
            found = Motor(replace(SETS["B"], T=lag).follow(start_))
            require_torque(found.machine, found.speeds_around_resonance)
            return found

        machine_with_start_values(context.fmus, SETS["B"], start)
        sheet = motor({})
        loads = [motor({"conveyor.trough.d": d}) for d in self.resistances]
        slips = [motor({"motor.kloss.s_b": s}) for s in self.slips]
        each = [sheet, *loads, *slips]
        drive = Drive.of(context, self)
        of_kloss = lag_speeds(drive, [(x.machine, x.speeds_around_resonance) for x in each])
        lag_speeds_ = list(
            zip(of_kloss, lag_speeds(drive, [(x.line, x.speeds_around_resonance) for x in each]))
        )
        table = Table.of_rows([row(x, *pair) for x, pair in zip(each, lag_speeds_)], COLUMNS)
        speeds = ripple_and_lag_over_speed(drive, sheet)
        heavy = max(zip(each, lag_speeds_), key=lambda it: it[0].machine.d)
        small = min(
            zip(each, lag_speeds_), key=lambda it: kloss_slips(it[0].machine, 0.0).at_breakdown
        )
        return Findings(
            sheet_figures(sheet, *lag_speeds_[0]) | extremes(heavy, small),
            MotorData(drive, sheet, len(loads), table, speeds),
            conveyor_drive(context.fmus, sheet.machine.start(sheet.nu_res)),
            tables={TABLE: table, SWEEP: speeds},
        )

    def judgements(self, f: Mapping[str, Figure], r: MotorData) -> list[Judgement]:
        """Where the resonance is, how far the data sheet's formula is off, and what moves it."""
        name = "resonance"
        if f["zeta"].value > LARGEST_PEAKED_ZETA:
            name = (
                f"90 degree lag, which is no resonance with a damping ratio of {f['zeta'].brief()},"
            )
        cases = {
            "heavy_kloss": f"with a trough resistance of {f['most_resistance'].brief()}",
            "small_kloss": f"with a breakdown slip of {f['least_slip'].brief()}",
        }
        of_sheet = {
            "heavy_kloss": f["most_resistance"].value == r.motor.machine.d,
            "small_kloss": f["least_slip"].value == r.motor.machine.more["motor.kloss.s_b"],
        }
        return [
            Judgement(f"{name} with the full characteristic", f["nu_kloss"]),
            Judgement("formula (22) is above that by", percent_above(f["nu_res"], f["nu_kloss"])),
            *(
                Judgement(f"{name} {text}", f[key])
                for key, text in cases.items()
                if not of_sheet[key]
            ),
            *self.contradictions(),
            *self.taken("B"),
        ]

    def show(self, f: Mapping[str, Figure], r: MotorData) -> Show:
        """What load and breakdown slip do, ripple and lag over the speed, a revolution at the resonance."""
        parts = {
            "load": (slice(1, r.loads + 1), "mean load torque at the resonance [N.m]"),
            "breakdown_slip": (slice(r.loads + 1, None), "breakdown slip [1]"),
        }
        charts = [
            curves_over(
                Table.of_frame(r.table.frame[rows].sort_values(x), r.table.units),
                x,
                LAGS,
                f"The 90 degree lag over the {x.replace('_', ' ')}",
                x=label,
            )
            for x, (rows, label) in parts.items()
        ]
        marks = [
            Mark.of(text, f[f"nu_{x}"])
            for x, text in MOTORS.items()
            if f[f"nu_{x}"].error is not None
        ]
        ripples: dict[str, dict[str, CurveLook]] = {
            quantity: {
                **{f"{name}_{x}": text for x, text in MOTORS.items()},
                name: ("first-order theory", "grey"),
            }
            for name, quantity in (("tau2", "torque ripple"), ("lag", "lag behind the load"))
        }
        title = "The full characteristic and a linear motor of its slope"
        charts.append(
            curves_over(
                r.speeds, "nu", ripples, title, marks=marks, theory=first_order_theory(r.motor),
                levels={"lag behind the load": [Mark(90.0, "90 deg")]}, x="operating speed [rad/s]",
            )
        )  # fmt: skip
        return Show(charts, *motion.revolution(r.drive, r.motor.tangent, r.motor.nu_res))


class Motor(NamedTuple):
    """A machine with an induction motor and its lag."""

    machine: Machine

    @property
    def stiff(self) -> Machine:
        """The machine with the slope without slip."""
        tau_b, slip, _ = kloss_slips(self.machine, 0.0)
        return replace(self.machine, B=2 * tau_b / slip)

    @property
    def speeds_around_resonance(self) -> Samples:
        """Speeds around the resonance without slip [rad/s]."""
        first, last = (share * float(self.stiff.nu_res) for share in RANGE)
        return np.linspace(first, last, GUIDE_SPEEDS)

    def slip(self, nu: Any) -> Any:
        """The slip at the load of nu [rad/s], in shares of the breakdown slip."""
        _, at_breakdown, under_load = kloss_slips(self.machine, nu)
        return under_load / at_breakdown

    @property
    def nu_res(self) -> float:
        """The speed [rad/s] where (22) holds with the slope at the slip; raises SetupError for none."""
        first, last = self.speeds_around_resonance[[0, -1]]
        nus = np.linspace(first, last, CURVE_POINTS)
        course = RippleGuide("lag", self.machine, 0.0, "speed")
        inside = roots_between(lambda nu: course.theory(nu).real, nus)
        load = np.abs(self.machine.load_ripple(np.append(nus, inside[:1])))
        vanishes = load[-1] < VANISHING * load.max()
        if not inside or vanishes:
            reason = PHASE_UNDEFINED.format("there") if inside else NOT_IN_RANGE
            raise SetupError(
                f"formula (22) gives no lag of 90 deg in {first:.4g} .. {last:.4g} rad/s: {reason}"
            )
        return inside[0]

    @property
    def tangent(self) -> Machine:
        """The machine with the slope at that speed."""
        return linearised(self.machine, self.nu_res)

    @property
    def line(self) -> Machine:
        """The machine with a linear motor of this slope."""
        more = {x: y for x, y in self.machine.more.items() if not x.startswith("motor.")}
        return replace(self.tangent, more=more)

    def flux_lag_speed(self) -> float:
        """The speed of 90 degrees lag with the rotor's flux in the place of (2) [rad/s]; nan for none."""
        m, stiff = self.machine, self.stiff.B

        def behind(nu: float) -> float:
            through = flux_lag(m, self.slip(nu), stiff, nu)
            return float((1 + (2j * nu * m.theta0 + m.load_slope) / through).real)

        first, last = self.speeds_around_resonance[[0, -1]].tolist()
        return brentq(behind, first, last) if behind(first) > 0 > behind(last) else math.nan


LagSpeeds = tuple[Figure, Figure]


def lag_speeds(drive: Drive, machines: Sequence[tuple[Machine, Samples]]) -> list[Figure]:
    """The speeds of 90 degrees lag of machines, each sought among some speeds [rad/s]."""
    searches = []
    for machine, nus in machines:
        first, last = nus[[0, -1]].tolist()
        for nu in (first, last):
            require_enough_steps_per_rev(drive, linearised(machine, nu), nu, STEP_MULTIPLES[-1])
        sought = Find("speed", first, last, "lag", 90.0, unit="rad/s")
        searches.append((DriveOrbit.of(machine, first, drive), sought))
    return [place for place, *_ in find(drive.context, searches)]


class MotorData(NamedTuple):
    """How motors are run, the motor of the data sheet, how many rows follow it over the load before those over the
    breakdown slip, and rows over the speed.
    """

    drive: Drive
    motor: Motor
    loads: int
    table: Table
    speeds: Table


def row(motor: Motor, kloss: Figure, line: Figure) -> list[float]:
    """A motor in the table."""
    nu, machine = motor.nu_res, motor.tangent
    return [
        machine.d, machine.more["motor.kloss.s_b"], machine.load_slope * nu, motor.slip(nu),
        machine.B, machine.T, machine.zeta, nu, motor.flux_lag_speed(),
        line.value, line.known_error, kloss.value, kloss.known_error,
    ]  # fmt: skip


def ripple_and_lag_over_speed(drive: Drive, motor: Motor) -> Table:
    """Ripple and lag over the speed, with the characteristic and with the line of its slope."""
    nus = np.linspace(
        motor.speeds_around_resonance[0], motor.speeds_around_resonance[-1], 2 * GUIDE_SPEEDS + 1
    )
    kloss, line = (
        measured(drive.context, drive.asked(machine, nus)).table(
            {"nu": ("rad/s", nus.tolist())}, {x: f"{x}_{name}" for x in ("tau2", "lag")}
        )
        for name, machine in (("kloss", motor.machine), ("linear", motor.line))
    )
    return Table({**kloss.columns, **line.columns}, {**kloss.units, **line.units})


def first_order_theory(motor: Motor) -> Table:
    """Ripple and lag over the speed by first-order theory, with the slope at the resonance."""
    first, last = motor.speeds_around_resonance[[0, -1]]
    nu = np.linspace(first, last, CURVE_POINTS)
    machine = motor.tangent
    torque = machine.torque_ripple(nu)
    lag = np.degrees(np.angle(machine.load_ripple(nu) / torque)) % 360.0
    units = {"nu": "rad/s", "tau2": "N.m", "lag": "deg"}
    return Table({"nu": nu, "tau2": np.abs(torque), "lag": lag}, units)


def sheet_figures(motor: Motor, kloss: Figure, line: Figure) -> dict[str, Figure]:
    """The figures of the motor of the data sheet."""
    nu, machine = motor.nu_res, motor.tangent
    return {
        "motor_lag": Figure(machine.T, "s", 0.0, "lag T of (2)"),
        "slope": Figure(machine.B, "N.m.s/rad", 0.0, "slope B at the slip of the resonance"),
        "slip": Figure(
            100 * motor.slip(nu), "%", 0.0, "slip there, as a share of the breakdown slip"
        ),
        "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
        "nu_res": Figure(nu, "rad/s", 0.0, "resonance by formula (22) with this slope"),
        "nu_flux": flux_lag_figure(motor, "first order"),
        "nu_linear": line._replace(meaning="speed of 90 deg lag, linear motor of this slope"),
        "nu_kloss": kloss._replace(meaning="speed of 90 deg lag, full characteristic"),
        "shift": percent_above(kloss, line)._replace(
            meaning="shift due to the curvature of the characteristic"
        ),
    }


def extremes(heavy: tuple[Motor, LagSpeeds], small: tuple[Motor, LagSpeeds]) -> dict[str, Figure]:
    """The figures of the motors with the most load and with the least breakdown slip."""
    (loaded, (full, _)), (stiff, (sharp, _)) = heavy, small
    most, least = loaded.machine.d, stiff.machine.more["motor.kloss.s_b"]
    condition = f"with {most:g} N.s/m"
    return {
        "most_resistance": Figure(most, "N.s/m", 0.0, "largest resistance of the trough"),
        "heavy_res": Figure(loaded.nu_res, "rad/s", 0.0, f"resonance by formula (22), {condition}"),
        "heavy_flux": flux_lag_figure(loaded, condition),
        "heavy_kloss": full._replace(
            meaning=f"speed of 90 deg lag, full characteristic, {condition}"
        ),
        "least_slip": Figure(least, "1", 0.0, "smallest breakdown slip"),
        "small_kloss": sharp._replace(
            meaning="speed of 90 deg lag, full characteristic, with that slip"
        ),
    }


def flux_lag_figure(motor: Motor, where: str) -> Figure:
    """The speed of 90 degrees lag with the rotor's flux in the place of (2)."""
    nu, meaning = motor.flux_lag_speed(), f"speed of 90 deg lag, rotor flux instead of (2), {where}"
    if math.isnan(nu):
        return Figure.undetermined("rad/s", "no speed near (22) has it", meaning)
    return Figure(nu, "rad/s", 0.0, meaning)


def percent_above(x: Figure, base: Figure) -> Figure:
    """Return how far a figure is above another [%]."""
    return figure_of_figures(lambda x, base: 100.0 * (x / base - 1.0), x, base, unit="%")
