"""What happens while the conveyor starts from rest and passes its resonance?

The same conveyor is started by a motor with a linear characteristic and by an induction motor with
Kloss's characteristic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from cosim import Result, System
from cosim.metrics import Mean, passings
from workbench import (
    Chart,
    Curve,
    Figure,
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
from workbench.live import Live, LiveRun, drawn
from workbench.steady import TURN

from .. import live_theory
from ..first_order import SETS, Machine
from ..machine import KLOSS, conveyor_drive, followed
from ..machine import PARTS as DRIVE
from ..motion import live_motion, moving
from ..options import NameplateOptions
from ..papers import cited
from ..speed_sweep import LARGEST_PEAKED_ZETA

MOTORS = {"linear": 0, "kloss": 1}
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
BELOW = "the crank does not stay above the resonance for a whole turn"


class RunUp(Question, NameplateOptions, RunOptions):
    """The machine, the mean speed that its linear motor is set for, and how the run is made."""

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
    speed: float = option(60.0, "mean speed of the linear motor", "rad/s", above=0.0)

    def system(self, fmus: Mapping[str, Path]) -> dict[str, System]:
        """Return the drive at rest with both motors, the linear one set for its mean speed."""
        machine = followed(fmus, SETS[self.set], self.start)
        rest = {"motor.tau": 0.0, "conveyor.w": 0.0}
        return {
            motor: conveyor_drive(
                fmus,
                machine.start(self.speed)
                | rest
                | {"motor.characteristic": characteristic}
                | dict(self.start),
            )
            for motor, characteristic in MOTORS.items()
        }

    def figures(self, r: Result) -> dict[str, Figure]:
        """Return when the crank rises through the resonance for good, and for how many revolutions it is near it."""
        nu, w, phi = machine_of(self).nu_res, r.solution("conveyor.w"), r["conveyor.phi"]
        meaning = "time when the crank has passed the resonance"
        times = passings(w, nu)
        passed = float(times[-1]) if len(times) else math.nan
        stays = w.x[0, -1] >= nu and phi[-1] - np.interp(passed, r["time"], phi) >= TURN
        passing = Figure.measured(passed, "s", meaning)
        near = revolutions_near(nu, r)
        return {
            "passing": passing if stays else Figure.undetermined("s", BELOW, meaning),
            "revolutions_near": Figure.measured(near, "1", "revolutions within 10 % of the resonance"),
        }  # fmt: skip

    def more_figures(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> dict[str, Figure]:
        """Return the resonance by formula and how fast it builds up."""
        machine = machine_of(self)
        build_up = 1 / (4 * math.pi * machine.zeta)
        return {
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
        for motor, word in LABELS.items():
            passing, why = f[f"{motor}_passing"], failure(self, f, r[motor], motor)
            answers.append(
                Judgement(
                    f"the {word} passes {name} within {self.stop:g} s",
                    passing,
                    most=self.stop,
                    is_so=False if why else None,
                    yes=f"The {word} passes {name} within {self.stop:g} s",
                    no=f"The {word} does not pass {name} within {self.stop:g} s",
                    note=why,
                )
            )
        torques = [
            Judgement(f"largest torque of the {word}", f[f"{motor}_tau_max"])
            for motor, word in LABELS.items()
        ]
        return [*answers, *torques, *self.contradictions()]

    def show(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> Show:
        """Speed, torque and rod force over time, torque over speed, both motors on one scale, and both
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
            drawn(self.charts[0], [r[motor] for motor in MOTORS], self, f, runs=RUNS),
            Chart("Torque over speed", "crank speed [rad/s]", plane),
        ]
        return Show(charts, [moving("Both conveyors from rest", r, 0.0, end, 15.0)])

    def live(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> Live:
        """Both motors from rest."""
        p = r["linear"].provenance["parts"]["conveyor"]["parameters"]
        numbers = [
            replace(x, name=f"{motor}_{x.name}", value=replace(x.value, run=STYLES[motor][0]))
            for motor in MOTORS
            for x in self.numbers
            if isinstance(x.value, Reader) and "tau_end" not in x.name
        ]
        return self.page(
            f, r, values=live_theory.values(machine_of(self)), start={"motor.A": live_theory.START["motor.A"]}, runs=RUNS,
            numbers=[Number("nu_res", "nu_res"), *numbers], motion=live_motion("Both conveyors from rest", p, 15.0),
        )  # fmt: skip


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
    speed = float(o.start.get("motor.A", machine.A(o.speed))) / machine.slope
    what = "it is set for a mean speed of"
    if motor == "kloss":
        speed = float(o.start.get("motor.kloss.w_s", KLOSS["motor.kloss.w_s"]))
        what = "its synchronous speed is"
    if speed >= machine.nu_res:
        return BELOW
    return f"{what} {speed:.4g} rad/s, below that: more time does not help"


RUNS = [
    LiveRun(*STYLES[motor], {"motor.characteristic": characteristic})
    for motor, characteristic in MOTORS.items()
]
