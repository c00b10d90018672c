"""What happens while the conveyor starts from rest and passes its resonance?

The same conveyor is started by a motor with a linear characteristic and by an induction motor with
Kloss's characteristic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, System
from workbench import Chart, Curve, Figure, Judgement, Panel, Question, Run, Show, option
from workbench.charts.model import FORCE, SPEED, THEORY, TORQUE
from workbench.live import Live, LiveRun, Number, Reader, RunChart, RunPanel, Slider, drawn
from workbench.measure import (
    Samples,
    clearance,
    crossing,
    crossing_times,
    largest,
    measured,
    passed_for_certain,
    since,
    smallest,
)
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
    "w": ("conveyor.w", "speed of the crank"),
    "tau": ("motor.tau", "torque"),
    "f_rod": ("conveyor.f_rod", "rod force"),
}
#: Share of a run after which its end begins; a convention.
END = 0.8
#: Mean speed at the end over the largest there, below which the crank only rocks; 2 / pi where it turns forward.
ROCKING = 0.1
#: Largest speed at the end over that of the run, below which the crank stands still; a convention.
STANDING = 1e-3
#: Share of the resonance within which a speed is near it, a convention of this question.
NEAR_SHARE = 0.1
BELOW = "the crank does not stay above the resonance for a whole turn"


class RunUp(Question, NameplateOptions, Run):
    """The machine, the mean speed that its linear motor is set for, and how the run is made."""

    parts = DRIVE
    fixed_starts = ("motor.characteristic",)
    sources = cited(22)
    record = (
        "motor.tau", "motor.tau_static", "motor.P", "conveyor.phi", "conveyor.w", "conveyor.x",
        "conveyor.tau_load", "conveyor.f_rod", "conveyor.P_loss",
    )  # fmt: skip
    labels = LABELS

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

    def more_figures(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> dict[str, Figure]:
        """Return the resonance by formula, how fast it builds up, and the times of passing that are certain."""
        machine = machine_of(self)
        build_up = 1 / (4 * math.pi * machine.zeta)
        passings = {
            f"{motor}_passing": passed_for_certain(
                f[f"{motor}_passing"], f.get(f"{motor}_clearance")
            )
            for motor in MOTORS
        }
        return passings | {
            "nu_res": Figure(machine.nu_res, "rad/s", 0.0, "resonance by formula (22)"),
            "zeta": Figure(machine.zeta, "1", 0.0, "damping ratio by formula"),
            "build_up": Figure(build_up, "1", 0.0, "revolutions in which a resonance builds up"),
        }

    def figures(self, r: Result) -> dict[str, Figure]:
        """When the crank rises through the resonance for good, revolutions near it, the largest loads,
        where it all ends.
        """
        t, w, second = r["time"], r["conveyor.w"], r.units["time"]
        machine, meaning = machine_of(self), "time when the crank has passed the resonance"
        phi = r["conveyor.phi"]
        passed = crossing(t, w, machine.nu_res, -1)
        stays = w[-1] >= machine.nu_res and phi[-1] - np.interp(passed.value, t, phi) >= TURN
        clear = clearance(t, w, machine.nu_res, -1)
        near = measured(partial(revolutions_near, machine.nu_res), t, w, r["conveyor.phi"])
        all_figures = {
            "passing": Figure.undetermined(second, BELOW, meaning)
            if not stays
            else passed.figure(second, meaning),
            "revolutions_near": near.figure("1", "revolutions within 10 % of the resonance"),
        }
        if stays and not math.isnan(clear.value):
            least = "distance of the resonance from the nearest turn of the speed around that time"
            all_figures["clearance"] = clear.figure(r.units["conveyor.w"], least)
        for name, (column, what) in LOADS.items():
            x, unit = r[column], r.units[column]
            all_figures[f"{name}_max"] = largest(t, np.abs(x)).figure(unit, f"largest {what}")
            if name != "f_rod":
                end = since(t, x, END * t[-1])
                low, high = smallest(*end), largest(*end)
                all_figures[f"{name}_end_min"] = low.figure(unit, f"smallest {what} at the end")
                all_figures[f"{name}_end_max"] = high.figure(unit, f"largest {what} at the end")
        return all_figures

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
                    yes=f"The {word} passes {name}",
                    no=f"The {word} does not pass {name} within {self.stop:g} s",
                    note=why,
                )
            )
        torques = [
            Judgement(f"largest torque of the {word}", f[f"{motor}_tau_max"])
            for motor, word in LABELS.items()
        ]
        return [*answers, *torques]

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
            drawn(CHART, [r[motor] for motor in MOTORS], self, f, runs=RUNS),
            Chart("Torque over speed", "crank speed [rad/s]", plane),
        ]
        return Show(charts, [moving("Both conveyors from rest", r, 0.0, end, 15.0)])

    def live(self, f: Mapping[str, Figure], r: Mapping[str, Result]) -> Live:
        """Both motors from rest."""
        p = r["linear"].provenance["parts"]["conveyor"]["parameters"]
        peaks = [
            Number(f"{motor}_{name}_max", Reader("max", f"abs({column})", run=STYLES[motor][0]))
            for motor in MOTORS
            for name, (column, _) in LOADS.items()
        ]
        ends = [
            Number(
                f"{motor}_w_end_{kind}",
                Reader(kind, "conveyor.w", f"{END} * stop", run=STYLES[motor][0]),
            )
            for motor in MOTORS
            for kind in ("min", "max")
        ]
        return Live(
            sliders=(
                Slider("speed", 30.0, 90.0),
                Slider("motor.T", 0.01, 0.15),
                Slider("conveyor.trough.m", 100.0, 400.0),
                Slider("conveyor.spring.c", 2e5, 1.2e6),
                Slider("conveyor.rotor.J", 0.2, 2.0),
            ),
            values=live_theory.values({}),
            start={"motor.A": live_theory.START["motor.A"]},
            runs=RUNS,
            numbers=[Number("nu_res", "nu_res"), *peaks, *ends],
            charts=[CHART],
            motion=live_motion("Both conveyors from rest", p, 15.0),
        )


def machine_of(o: RunUp) -> Machine:
    """Return the drive with its linear motor, as theory has it."""
    return SETS[o.set].follow(o.start)


def revolutions_near(nu: float, t: Samples, w: Samples, phi: Samples) -> float:
    """Revolutions of the crank while its speed is within 10 % of nu."""
    speed = CubicSpline(t, w)
    limits = (1 - NEAR_SHARE) * nu, (1 + NEAR_SHARE) * nu
    ends = np.sort(
        np.concatenate([t[:1], *(crossing_times(t, w, limit) for limit in limits), t[-1:]])
    )
    middle = np.abs(speed((ends[1:] + ends[:-1]) / 2) / nu - 1.0) < NEAR_SHARE
    return float(np.diff(CubicSpline(t, phi)(ends))[middle].sum() / (2 * math.pi))


def stalls(r: Result) -> bool:
    """Whether the crank stands still at the end of a run, or only rocks to and fro."""
    t, w = r["time"], r["conveyor.w"]
    times, angles = since(t, r["conveyor.phi"], END * t[-1])
    _, speeds = since(t, w, END * t[-1])
    mean = (angles[-1] - angles[0]) / (times[-1] - times[0])
    return bool(mean < ROCKING * speeds.max() or speeds.max() < STANDING * w.max())


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


CHART = RunChart(
    "Run-up from rest",
    "time [s]",
    [
        RunPanel(
            "crank speed", {"conveyor.w": SPEED}, levels={"resonance by formula": "figures.nu_res"}
        ),
        RunPanel("motor torque", {"motor.tau": TORQUE}),
        RunPanel("rod force", {"conveyor.f_rod": FORCE}, "kN"),
    ],
)
RUNS = [
    LiveRun(*STYLES[motor], {"motor.characteristic": characteristic})
    for motor, characteristic in MOTORS.items()
]
