"""Where is the electromechanical resonance of a measured drive, and what would get the drive clear of it?

The parameters of the drive, its supply and its state at the start are fitted to a record of its speed,
and of its torque if that was measured. The resonance follows with an interval, and so does the torque
ripple at the operating speed. A record that no drive of this kind fits is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

import cosim
from cosim import Identified, SetupError
from cosim.metrics import harmonics
from cosim.system import Value
from cosim.units import multiples
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
    option,
)
from workbench.charts import model as colors
from workbench.charts.model import SecondUnit
from workbench.fit import (
    FIT_ERROR_SCOPE,
    Fitted,
    Followed,
    Guess,
    RecordFit,
    RecordOptions,
    fitted_charts,
    further_records,
    misfit,
    next_record,
)
from workbench.question import Probe

from ..first_order import SETS, Machine
from ..fitted_drive import DRIVE_QUANTITIES, IdentifiedDrive, figures
from ..live_ripple import SLIDERS
from ..machine import PARTS as DRIVE
from ..machine import (
    conveyor_drive,
    has_kloss_characteristic,
    linearised,
    machine_with_start_values,
    require_torque,
)
from ..motion import moving
from ..options import RippleOptions
from ..orbit import DriveOrbit
from ..papers import cited

SPEED, TORQUE = "conveyor.w", "motor.tau"
STATES = ("conveyor.phi", SPEED, TORQUE)
LINEAR, KLOSS = ("motor.A", "motor.B"), ("motor.kloss.w_s", "motor.kloss.s_b")
FREE = ("motor.T", "conveyor.rotor.J", "conveyor.trough.d")
#: Start values that an orbit sets itself.
OF_ORBIT = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")
#: Points of the curve with the band; a convention.
CURVE = 121
#: Noise of a torque that a further record would have, over the rated torque; a convention.
NOISE = 0.02


class Identify(Question, RecordOptions, RippleOptions):
    """The record to fit, and the speed at which the machine that fits is judged."""

    parts = DRIVE
    sources = cited(22)
    error_scope = FIT_ERROR_SCOPE
    method = RecordFit(
        kind="machine of this kind",
        quantities=DRIVE_QUANTITIES,
        exact=("conveyor.crank.r", "conveyor.trough.m", "conveyor.spring.c"),
        unit="rad/s",
    )

    speed: float | None = option(
        None, "operating speed, the mean of the record by default", "rad/s", above=0.0
    )

    def guess(self, context: Context) -> Guess:
        """Return the drive near the motion of the record."""
        record = self.columns(SPEED)
        base = machine_with_start_values(context.fmus, SETS[self.set], self.start)
        w = record[SPEED].numbers(gaps=True)
        w = w * multiples("rad/s").get(record[SPEED].signal.unit, 1.0)
        nu = float(np.nanmean(w))
        supply, slope = KLOSS if has_kloss_characteristic(base) else LINEAR
        if not self.known and TORQUE not in record:
            raise SetupError(
                f"{self.data}: speed alone determines neither mass nor torque; give what is known, as in "
                "--known conveyor.trough.m=200+-5, or map a torque to motor.tau"
            )
        settings = {
            "derived": {"nu_res": lambda v, _: fitted_machine(base, nu, v).nu_res},
            "units": {"nu_res": "rad/s"},
            "first": ("conveyor.phi", supply),
            "algorithm": self.algorithm,
        }
        operating, rated = self.speed or nu, self.rated_torque_or_default
        limit = self.torque_ripple_limit
        return Guess(
            conveyor_drive(context.fmus, nearest_drive(self, base, record[SPEED])),
            record,
            [slope, *FREE, supply, *STATES],
            settings,
            {"operating_speed": operating, "rated_torque": rated, "limit": limit},
            {"speed": operating, "rated_torque": rated},
            partial(fitted_machine, base, nu),
        )

    def follow(self, context: Context, guess: Guess, fit: Identified) -> Followed:
        """Return the resonance and the ripple, and records like this one, from rest, and with steps."""
        operating, machine = guess.defaults["speed"], guess.more
        drive_data = IdentifiedDrive(fit, machine, operating)
        is_induction = has_kloss_characteristic(SETS[self.set].follow(self.start))
        records = further_records(
            fit,
            STATES,
            rest={"conveyor.phi": 0.0, SPEED: 0.0, TORQUE: 0.0},
            supply=(KLOSS if is_induction else LINEAR)[0],
            steps={"a step of the supply to 120 %": 1.2}
            | ({} if is_induction else {"a run-down with the supply off": 0.0}),
            torque={TORQUE: NOISE * self.rated_torque_or_default},
        )
        found = figures(self, context, drive_data)
        return Followed(found, lambda v: machine(v).nu_res, records, more=drive_data)

    def judgements(self, f: Mapping[str, Figure], r: Fitted) -> list[Judgement]:
        """Whether the ripple is above its limit, where the resonance is, what to record next."""
        if r.fit.misfit:
            return misfit("a drive of this kind fits this record", r.fit.misfit)
        gap = f["away"]
        side = f"{gap._replace(value=abs(gap.value)).brief()} {'below' if gap.value > 0 else 'above'} the operating speed"
        return [
            self.ripple_below_limit(f["tau2"], r.more.operating),
            Judgement("resonance", f["nu_res"], note=side if gap.error is not None else ""),
            next_record(r.advice, f["nu_res"], "the resonance", "rad/s"),
        ]

    def probe(self, context: Context, found: Findings) -> Probe:
        """The orbit of the drive found, whose ripple has the interval of the fit."""
        drive = found.data.more
        if found.data.fit.misfit:
            return super().probe(context, found)

        def judge(o: Question, of_orbit: Findings) -> list[Judgement]:
            assert isinstance(o, DriveOrbit)
            return [self.ripple_below_limit(drive.torque_ripple(o, of_orbit.figures), o.nu)]

        return Probe(drive.orbit(self, context), judge, SLIDERS)

    def show(self, f: Mapping[str, Figure], r: Fitted) -> Show:
        """Each column measured, fitted and what is between them; the resonance curve with its band; the
        conveyor in motion.
        """
        styles = {SPEED: ("speed", colors.SPEED), TORQUE: ("torque", colors.TORQUE)}
        charts = fitted_charts(r.fit, styles)
        if not r.fit.misfit:
            charts.insert(0, band(self, f, r))
        first, last = (float(t) for t in r.fit.result["time"][[0, -1]])
        return Show(charts, [moving("The fitted conveyor", {"": r.fit.result}, first, last, 25.0)])


def nearest_drive(o: Identify, base: Machine, speed: cosim.Series) -> dict[str, Value]:
    """Start values near the motion of a record: the angle at its start by the order 2 of its speed,
    the supply by its mean speed.
    """
    w, turned = o.speeds_and_angles(speed, "crank")
    nu = float(w.mean())
    require_torque(base, nu)
    machine = linearised(base, nu)
    swing = complex(harmonics(turned, w, 2)[1]) / machine.speed_ripple(nu)
    phi = float(np.angle(swing)) / 2
    tau = machine.load_slope * nu + (machine.torque_ripple(nu) * np.exp(2j * phi)).imag
    states = {"conveyor.phi": phi, "conveyor.w": float(np.median(w[:5])), "motor.tau": float(tau)}
    start: dict[str, Value] = {**base.start(nu), **states}
    if has_kloss_characteristic(base):
        start["motor.kloss.w_s"] = 1.02 * nu
    return start


def fitted_machine(base: Machine, nu: float, values: Mapping[str, float]) -> Machine:
    """The machine of these values; its motor's slope is that at the mean speed nu [rad/s]."""
    machine = base.follow({name: x for name, x in values.items() if "(" not in name})
    more = {name: x for name, x in machine.more.items() if name not in OF_ORBIT}
    return linearised(replace(machine, more=more), nu)


def band(o: Identify, f: Mapping[str, Figure], r: Fitted) -> Chart:
    """The torque ripple over the speed of the machine found, with the band of its interval."""
    nus = np.linspace(0.4, 1.8, CURVE) * f["nu_res"].value

    def height(nu: float, v: Mapping[str, float]) -> float:
        return float(abs(r.more.machine(v).torque_ripple(nu)))

    each = [r.fit.interval(partial(height, nu), "N.m") for nu in nus.tolist()]
    curve = Curve(
        "first-order theory of the fitted machine", nus, [x.value for x in each], colors.TORQUE,
        "line", [x.error for x in each],
    )  # fmt: skip
    limit = Mark(o.torque_ripple_limit, f"limit {o.torque_ripple_limit:g} N.m")
    marks = [
        Mark.of("resonance", f["nu_res"]),
        Mark(r.more.operating, f"operating speed {r.more.operating:.4g} rad/s"),
    ]
    return Chart(
        "Torque ripple of the fitted machine, with its 95 % band",
        "operating speed [rad/s]",
        [Panel("torque ripple", "N.m", [curve], [limit], (0.0,))],
        marks,
        [],
        SecondUnit("rpm", 30 / math.pi),
    )
