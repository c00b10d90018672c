"""The live part of `resonance`: the orbit at the speed of a slider, and the ripple over the speeds of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from workbench.answer import parameters
from workbench.charts import model as colors
from workbench.live import (
    REVOLUTION,
    Live,
    LiveSweep,
    Number,
    Reader,
    RunChart,
    RunPanel,
    Slider,
    Steady,
)

from . import live_theory, motion
from .drive_orbits import Drive
from .first_order import Machine
from .machine import conveyor_drive, induction, start_values
from .response import QUANTITIES, Lines

#: Steps per revolution of the live sweep, of which a ripple of order 2 needs a few dozen; a convention.
SWEEP_STEPS = 256
#: Points of the live sweep, so that a peak anywhere has several of them; a convention.
SWEEP_POINTS = 60
#: The shares to which live revolutions repeat, below the step differences of 512 and of 256 steps.
ORBIT, SWEEP_ORBIT = Steady(1e-6, 200), Steady(1e-4, 80)
TORQUE = Reader("amplitude", "motor.tau", REVOLUTION, 2)
SPEED = Reader("amplitude", "conveyor.w", REVOLUTION, 2)
PHASE = Number(
    "tau2_phase",
    Reader("phase", "motor.tau", REVOLUTION, 2),
    "deg",
    "phase of the torque ripple",
    is_visible=False,
)
LAG = "mod(atan2(load_im, load_re) * 180 / pi - figures.tau2_phase, 360)"


@dataclass(frozen=True)
class LiveDrive:
    """What the live part of a drive starts from: how it was run, the machine at each speed, the machine at
    its resonance, the operating speed [rad/s], and levels of the torque ripple by their names [N.m].
    """

    drive: Drive
    lines: Lines
    machine: Machine
    speed: float
    levels: Mapping[str, float]

    def live(self) -> Live:
        """Return the live part."""
        start, is_linear = self.drive.start, not induction(self.drive.start)
        return Live(
            sliders=(
                Slider("conveyor.spring.c", 2e5, 1.4e6),
                Slider("speed", 20.0, 66.0),
                Slider("conveyor.trough.m", 80.0, 400.0),
                Slider("conveyor.rotor.J", 0.2, 1.2),
                Slider("motor.T", 0.02, 0.2),
                Slider("motor.B", 50.0, 500.0),
                Slider("conveyor.trough.d", 1000.0, 12000.0),
            ),
            values=live_theory.values(start),
            start={**live_theory.START, **({} if is_linear else live_theory.KLOSS_START)},
            stop="2 * pi / speed",
            step="2 * pi / (speed * steps_per_rev)",
            angle="conveyor.phi",
            steady=ORBIT,
            numbers=[
                Number("tau2_operating", TORQUE),
                Number("w2", SPEED, "rad/s", "speed ripple at the operating speed"),
                PHASE,
                Number("lag_operating", LAG),
                *(live_theory.NUMBERS if is_linear else ()),
            ],
            charts=[motion.REVOLUTION_CHART],
            motion=motion.live_motion(
                "The conveyor in this revolution", self.parameters(), 25.0, REVOLUTION
            ),
            sweep=self.sweep(is_linear=is_linear) if len(self.lines.x) > 1 else None,
        )

    def parameters(self) -> dict[str, float]:
        """Return the parameters of the conveyor."""
        start = start_values(self.machine, self.drive.start, self.speed)
        values = parameters(conveyor_drive(self.drive.context.fmus, start))
        return {name.removeprefix("conveyor."): x.value for name, x in values.items()}

    def sweep(self, *, is_linear: bool) -> LiveSweep:
        """Return the sweep over the speeds; the formula for the resonance is that of a linear motor."""
        marks = {"operating speed": ("speed", "rad/s")}
        if is_linear:
            marks["formula"] = ("nu_res", "rad/s")
        return LiveSweep(
            over="speed",
            values=np.linspace(self.lines.x[0], self.lines.x[-1], SWEEP_POINTS).tolist(),
            step=f"2 * pi / (speed * {SWEEP_STEPS})",
            steady=SWEEP_ORBIT,
            numbers=[
                Number("tau2", TORQUE, "N.m", "torque ripple"),
                Number("w2", SPEED, "rad/s", "speed ripple"),
                PHASE,
            ],
            chart=RunChart(
                "Ripple over the operating speed",
                "operating speed [rad/s]",
                self.panels(),
                marks=marks,
            ),
        )

    def panels(self) -> list[RunPanel]:
        """Return ripple and lag over the speed, each beside first-order theory."""
        (_, tau2), (_, w2) = QUANTITIES
        return [
            theory_panel(
                "torque ripple",
                tau2,
                "figures.tau2",
                "torque_ripple",
                colors.TORQUE,
                levels=self.levels,
            ),
            theory_panel("speed ripple", w2, "figures.w2", "speed_ripple", colors.SPEED, levels={}),
            theory_panel(
                "lag behind the load",
                "deg",
                LAG,
                "torque_lag",
                colors.LIFT,
                levels={"90 deg": 90.0},
            ),
        ]


def theory_panel(
    quantity: str, unit: str, run: str, theory: str, color: str, *, levels: Mapping[str, float]
) -> RunPanel:
    """Return a panel of what runs give beside a formula of first-order theory."""
    curves = {
        theory: ("first-order theory", colors.THEORY, "theory"),
        run: ("co-simulation", color, "linked"),
    }
    return RunPanel(quantity, curves, unit, levels, (0.0,))
