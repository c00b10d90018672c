"""What happens while the conveyor starts from rest and passes its resonance?

The same conveyor is started by a motor with a linear characteristic and by an induction motor with
Kloss's characteristic; with a nameplate by its motor alone, which is to reach its rated speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cosim import Result, System
from cosim.dense import Curves
from cosim.metrics import Mean, passings
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Number,
    Panel,
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
from workbench.figure import scaled
from workbench.judgement import in_time, share_text
from workbench.live import Live, LiveRun, drawn
from workbench.steady import TURN

from .. import live_theory
from ..first_order import SETS, Machine
from ..machine import KLOSS, conveyor_drive, machine_with_start_values
from ..machine import PARTS as DRIVE
from ..motion import live_motion, moving
from ..options import NameplateOptions
from ..papers import cited
from ..speed_sweep import LARGEST_PEAKED_ZETA

MOTORS = {"linear": 0, "kloss": 1}
#: Mean speed that the linear motor is set for [rad/s].
MEAN_SPEED = 60.0
LABELS = {"linear": "linear motor", "kloss": "induction motor"}
STYLES = {"linear": ("linear motor", "purple"), "kloss": ("induction motor (Kloss)", "gold")}
LOADS = {
    "w": ("conveyor.w", "speed of the crank", "rad/s"),
    "tau": ("motor.tau", "torque", "N.m"),
    "f_rod": ("conveyor.f_rod", "rod force", "N"),
}
#: Share of a run after which its end begins; a convention.
END_SHARE = 0.8
END = f"{END_SHARE} * stop"
#: Mean speed at the end over the largest there, below which the crank only rocks; 2 / pi where it turns forward.
ROCKING = 0.1
#: Largest speed at the end over that of the run, below which the crank stands still; a convention.
STANDING = 1e-3
#: Share of the resonance within which a speed is near it, a convention of this question.
NEAR_SHARE = 0.1
MOTION_TITLES = {1: "The conveyor from rest", 2: "Both conveyors from rest"}
TOO_SLOW = "the crank does not reach it"
BELOW = "the crank does not stay above the resonance for a whole turn"


class RunUp(Question, NameplateOptions, RunOptions):
    """The machine, the mean speed that its linear motor is set for or that of a nameplate is to reach, and how it is run."""

    parts = DRIVE
    fixed_starts = ("motor.characteristic",)
    sources = cited(22)
    record = (
        "motor.tau", "motor.tau_static", "motor.P", "conveyor.phi", "conveyor.w", "conveyor.x",
        "conveyor.tau_load", "conveyor.f_rod", "conveyor.P_loss",
    )  # fmt: skip
    labels = LABELS

    numbers = (
        *(
            Number(f"{name}_max", Reader("max", f"abs({column})"), unit, f"largest {what}")
            for name, (column, what, unit) in LOADS.items()
        ),
        *(
            Number(f"{name}_end_{kind}", Reader(kind, column, END), unit, f"{size} {what} at the end")
            for name, (column, what, unit) in LOADS.items()
            if name != "f_rod"
            for kind, size in (("min", "smallest"), ("max", "largest"))
        ),
    )  # fmt: skip
    charts = (
        RunChart(
            "Run-up from rest",
            "time [s]",
            [
                RunPanel("crank speed", {"conveyor.w": SPEED}, levels={"resonance by formula": "figures.nu_res"}),
                RunPanel("motor torque", {"motor.tau": TORQUE}),
                RunPanel("rod force", {"conveyor.f_rod": FORCE}, "kN"),
            ],
        ),
    )  # fmt: skip
    sliders = (
        Slider("speed", 30.0, 90.0),
        Slider("motor.T", 0.01, 0.15),
        Slider("conveyor.trough.m", 100.0, 400.0),
        Slider("conveyor.spring.c", 2e5, 1.2e6),
        Slider("conveyor.rotor.J", 0.2, 2.0),
    )

    set: str = option("B", "parameter set", choices=SETS)
    speed: float | None = option(
        None,
        f"mean speed of the linear motor, {MEAN_SPEED:g} rad/s by default; with a nameplate the speed of the crank that its "
        "motor is to reach, the rated one by default",
        "rad/s",
        above=0.0,
    )

    @property
    def speed_or_default(self) -> float:
        """The speed [rad/s]."""
        rated = self.plate.speed / self.plate.ratio if self.plate else MEAN_SPEED
        return self.speed or rated

    @property
    def runs(self) -> list[LiveRun]:
        """The motors that are run, that of a nameplate alone."""
        return [
            LiveRun(*STYLES[motor], {"motor.characteristic": MOTORS[motor]})
            for motor in self.motors
        ]

    @property
    def motors(self) -> Sequence[str]:
        """The names of the motors that are run."""
        return ["kloss"] if self.nameplate else [*MOTORS]

    def solve(self, context: Context) -> Findings:
        """Run and certify the drive with each motor, as every question does, and tell the speed."""
        return replace(super().solve(context), defaults={"speed": self.speed_or_default})

    def system(self, fmus: Mapping[str, Path]) -> dict[str, System]:
        """Return the drive at rest with each motor, the linear one set for its mean speed."""
        machine = machine_with_start_values(fmus, SETS[self.set], self.start)
        rest = {"motor.tau": 0.0, "conveyor.w": 0.0}
        return {
            motor: conveyor_drive(
                fmus,
                machine.start(self.speed_or_default)
                | rest
                | {"motor.characteristic": MOTORS[motor]}
                | dict(self.start),
            )
            for motor in self.motors
        }

    def figures(self, r: Result) -> dict[str, Figure]:
        """Return when the crank rises through the resonance for good, for how many revolutions it is near it, and when the
        motor of a nameplate reaches its speed.
        """
        nu, w, phi = machine_of(self).nu_res, r.solution("conveyor.w"), r["conveyor.phi"]
        meaning = "time when the crank has passed the resonance"
        times = passings(w, nu)
        passed = float(times[-1]) if len(times) else math.nan
        stays = w.x[0, -1] >= nu and phi[-1] - np.interp(passed, r["time"], phi) >= TURN
        passing = Figure.measured(passed, "s", meaning)
        near = revolutions_near(nu, r)
        figures = {
            "passing": passing if stays else Figure.undetermined("s", BELOW, meaning),
            "revolutions_near": Figure.measured(near, "1", "revolutions within 10 % of the resonance"),
        }  # fmt: skip
        if self.nameplate:
            figures["reach"] = reaching(self.speed_or_default, w)
        return figures

    def more_figures(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> dict[str, Figure]:
        """Return the resonance by formula and how fast it builds up."""
        machine = machine_of(self)
        build_up = 1 / (4 * math.pi * machine.zeta)
        of_plate = {}
        if self.plate:
            meaning = "largest torque of the motor at its own shaft"
            of_plate["tau_motor_max"] = scaled(
                f["kloss_tau_max"], 1.0 / self.plate.ratio, "N.m", meaning
            )
        return {
            **of_plate,
            "nu_res": Figure(machine.nu_res, "rad/s", 0.0, "resonance by formula (22)"),
            "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
            "build_up": Figure(build_up, "1", 0.0, "revolutions in which a resonance builds up"),
        }

    def judgements(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> list[Judgement]:
        """Whether each motor passes the resonance, and how large its torque gets."""
        name = f"the resonance at {f['nu_res'].brief()} by formula (22)"
        if f["zeta"].value > LARGEST_PEAKED_ZETA:
            name = f"the 90 degree lag at {f['nu_res'].brief()}, which is no resonance with this damping,"
        answers = []
        for motor in self.motors:
            word, passing, why = (
                LABELS[motor],
                f[f"{motor}_passing"],
                failure(self, f, r[motor], motor),
            )
            answers.append(
                in_time(
                    f"the {word} passes {name} within {self.stop:g} s",
                    f"the {word} does not pass {name} within {self.stop:g} s",
                    passing, self.stop, why=why,
                )
            )  # fmt: skip
        torques = [
            Judgement(f"largest torque of the {LABELS[motor]}", f[f"{motor}_tau_max"])
            for motor in self.motors
        ]
        if self.nameplate:  # below the resonance there is nothing to pass
            passes = answers if float(self.start["motor.kloss.w_s"]) > f["nu_res"].value else []
            answers, torques = [self.reaches(f), *passes], [self.torque(f)]
        return [*answers, *torques, *self.contradictions(), *self.taken(self.set)]

    def reaches(self, f: Mapping[str, Figure]) -> Judgement:
        """Return whether the motor of a nameplate reaches its speed."""
        speed, reach = self.speed_or_default, f["kloss_reach"]
        what = f"{'the rated speed, ' * (self.speed is None)}{speed:.4g} rad/s ({speed * 30 / math.pi:.4g} rpm) at the crank"
        why = f"the largest speed is {f['kloss_w_max'].brief()}" if reach.reason == TOO_SLOW else ""
        return in_time(
            f"the motor reaches {what}, within {self.stop:g} s",
            f"the motor does not reach {what}, within {self.stop:g} s",
            reach, self.stop, why=why, yes=f"the motor reaches {what}",
        )  # fmt: skip

    def torque(self, f: Mapping[str, Figure]) -> Judgement:
        """Return the largest torque of the motor of a nameplate, beside its breakdown torque and at its own shaft."""
        most, breakdown = f["kloss_tau_max"], float(self.start["motor.kloss.tau_b"])
        at_motor = f["tau_motor_max"].brief()
        note = (
            f"{share_text(most.value / breakdown)} of the breakdown torque of {breakdown:.4g} N.m; {at_motor} at the shaft of "
            "the motor; currents are not modelled"
        )
        return Judgement("largest torque of the motor at the crank", most, note=note)

    def show(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> Show:
        """Speed, torque and rod force over time, torque over speed, all motors on one scale, and the
        conveyors in motion, one above the other.
        """
        plane = []
        for motor, result in r.items():
            (name, color), w = STYLES[motor], result["conveyor.w"]
            order, static = np.argsort(w), result["motor.tau_static"]
            curves = [
                Curve("static characteristic", w[order], static[order], THEORY, "theory"),
                Curve("with its lag", w, result["motor.tau"], color),
            ]
            plane.append(Panel(f"torque, {name}", result.units["motor.tau"], curves))
        end = min(float(result["time"][-1]) for result in r.values())
        charts = [
            drawn(self.charts[0], [*r.values()], self, f, runs=self.runs),
            Chart("Torque over speed", "crank speed [rad/s]", plane),
        ]
        return Show(charts, [moving(MOTION_TITLES[len(r)], r, 0.0, end, 15.0)])

    def live(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> Live:
        """The motors from rest."""
        result = next(iter(r.values()))
        p = result.provenance["parts"]["conveyor"]["parameters"]
        numbers = [
            replace(x, name=f"{motor}_{x.name}", value=replace(x.value, run=STYLES[motor][0]))
            for motor in self.motors
            for x in self.numbers
            if isinstance(x.value, Reader) and "tau_end" not in x.name
        ]
        of_motor: dict[str, Any] = {"start": {"motor.A": live_theory.START["motor.A"]}}
        if self.nameplate:
            reach = Reader("first_crossing", "conveyor.w", level=self.speed_or_default)
            numbers.append(Number("kloss_reach", reach, otherwise=TOO_SLOW))
            slider = Slider("motor.kloss.tau_b", 100.0, 1000.0)
            of_motor = {"sliders": [slider, *self.sliders[1:]]}
        return self.page(
            f, r, values=live_theory.values(machine_of(self)), runs=self.runs, numbers=[Number("nu_res", "nu_res"), *numbers],
            motion=live_motion(MOTION_TITLES[len(r)], p, 15.0), **of_motor,
        )  # fmt: skip


def reaching(speed: float, w: Curves) -> Figure:
    """Return when the crank first reaches a speed [rad/s]."""
    meaning = f"time until the crank first reaches {speed:.4g} rad/s"
    times = passings(w, speed)
    if not len(times):
        return Figure.undetermined("s", TOO_SLOW, meaning)
    return Figure.measured(float(times[0]), "s", meaning)


def machine_of(o: RunUp) -> Machine:
    """Return the drive with its linear motor, as theory has it."""
    return SETS[o.set].follow(o.start)


def revolutions_near(nu: float, r: Result) -> float:
    """Revolutions of the crank while its speed is within 10 % of nu."""
    w, phi = r.solution("conveyor.w"), r.solution("conveyor.phi")
    limits = (1 - NEAR_SHARE) * nu, (1 + NEAR_SHARE) * nu
    ends = np.sort(np.concatenate([w.t[:1], *(passings(w, limit) for limit in limits), w.t[-1:]]))
    near = np.abs(w((ends[1:] + ends[:-1]) / 2)[0] / nu - 1.0) < NEAR_SHARE
    return float(np.diff(phi(ends)[0])[near].sum() / TURN)


def stalls(r: Result) -> bool:
    """Whether the crank stands still at the end of a run, or only rocks to and fro."""
    begin = END_SHARE * float(r["time"][-1])
    end, w = r.solution("conveyor.w").between(begin, math.inf), r["conveyor.w"]
    mean = Mean("").measure(end)[0]
    return bool(mean < ROCKING * end.x.max() or end.x.max() < STANDING * w.max())


def failure(o: RunUp, f: Mapping[str, Figure], r: Result, motor: str) -> str:
    """Return why a motor does not pass the resonance; "" if it does, or if that is not certain."""
    passing, machine = f[f"{motor}_passing"], machine_of(o)
    if passing.error is not None:
        return ""
    if stalls(r):
        return "it stalls: at the end the crank stands still or only rocks"
    if r["conveyor.phi"][-1] - r["conveyor.phi"][0] < TURN:
        return "it does not complete a turn"
    if passing.reason != BELOW:
        return ""
    speed = float(o.start.get("motor.A", machine.A(o.speed_or_default))) / machine.slope
    what = "it is set for a mean speed of"
    if motor == "kloss":
        speed = float(o.start.get("motor.kloss.w_s", KLOSS["motor.kloss.w_s"]))
        what = "its synchronous speed is"
    if speed >= machine.nu_res:
        return BELOW
    return f"{what} {speed:.4g} rad/s, below that: more time does not help"
