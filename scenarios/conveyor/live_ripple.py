"""The live part of `resonance`: the orbit at the speed of a slider, and the ripple over the speeds of a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from workbench import Context, Number, Reader, RunChart, RunPanel, Slider
from workbench.answer import parameters
from workbench.charts import model as colors
from workbench.live import REVOLUTION, Formulas, Live, LiveSweep, Steady

from . import live_theory, motion
from .first_order import Machine
from .machine import conveyor_drive, has_kloss_characteristic, start_values
from .speed_sweep import SpeedSweep

#: Steps per revolution of the live sweep, of which a ripple of order 2 needs a few dozen; a convention.
SWEEP_STEPS = 256
#: Points of the live sweep, so that a peak anywhere has several of them; a convention.
SWEEP_POINTS = 60
#: The shares to which live revolutions repeat, below the step differences of 512 and of 256 steps.
ORBIT, SWEEP_ORBIT = Steady(1e-6, 200), Steady(1e-4, 80)
SLIDERS = (
    Slider("conveyor.spring.c", 2e5, 1.4e6),
    Slider("speed", 20.0, 66.0),
    Slider("conveyor.trough.m", 80.0, 400.0),
    Slider("conveyor.rotor.J", 0.2, 1.2),
    Slider("motor.T", 0.02, 0.2),
    Slider("conveyor.trough.d", 1000.0, 12000.0),
)
TORQUE_RIPPLE = Reader("amplitude", "motor.tau", REVOLUTION, 2)
SPEED_RIPPLE = Reader("amplitude", "conveyor.w", REVOLUTION, 2)
PHASE = Number(
    "tau2_phase",
    Reader("phase", "motor.tau", REVOLUTION, 2),
    "deg",
    "phase of the torque ripple",
    is_visible=False,
)
OTHER_MOTION = (
    "An induction motor may have a second steady motion, which only the command above seeks."
)
LIVE_LAG = "mod(atan2(load_im, load_re) * 180 / pi - figures.tau2_phase, 360)"


class RipplePanel(NamedTuple):
    """A panel over the speed, which shows all that it `includes`: the column of a sweep that the picture has, and for the
    live page formulas of run and theory.
    """

    quantity: str
    unit: str
    column: str
    run: str
    theory: str
    color: str
    includes: Sequence[float] = (0.0,)


PANELS = (
    RipplePanel("torque ripple", "N.m", "tau2", "figures.tau2", "torque_ripple", colors.TORQUE),
    RipplePanel("speed ripple", "rad/s", "w2", "figures.w2", "speed_ripple", colors.SPEED),
    RipplePanel(
        "lag behind the load", "deg", "lag", LIVE_LAG, "torque_lag", colors.LIFT, (0.0, 180.0)
    ),
)


def live_part(
    context: Context,
    sweep: SpeedSweep,
    machine: Machine,
    speed: float,
    levels: Mapping[str, Formulas],
) -> Live:
    """Return the live part of a sweep, from the machine at its resonance, the operating speed [rad/s], and levels by
    column and name.
    """
    is_linear = not has_kloss_characteristic(machine)
    values = parameters(conveyor_drive(context.fmus, start_values(machine, speed)))
    moving = motion.live_motion(
        "The conveyor in this revolution",
        {name.removeprefix("conveyor."): x.value for name, x in values.items()},
        25.0,
        REVOLUTION,
    )
    return Live(
        sliders=(
            *SLIDERS,
            Slider("motor.B", 50.0, 500.0)
            if is_linear
            else Slider("motor.kloss.tau_b", 50.0, 500.0),
        ),
        values=live_theory.values(machine),
        start={**live_theory.START, **({} if is_linear else live_theory.KLOSS_START)},
        stop="2 * pi / speed",
        step="2 * pi / (speed * steps_per_rev)",
        angle="conveyor.phi",
        steady=ORBIT,
        numbers=[
            Number("tau2_operating", TORQUE_RIPPLE),
            Number("w2", SPEED_RIPPLE, "rad/s", "speed ripple at the operating speed"),
            PHASE,
            Number("lag_operating", LIVE_LAG),
            *(live_theory.NUMBERS if is_linear else ()),
        ],
        charts=[motion.REVOLUTION_CHART],
        motion=moving
        if is_linear
        else replace(moving, note=f"{moving.note} {OTHER_MOTION}".strip()),
        sweep=live_sweep(sweep.speeds, levels, is_linear=is_linear)
        if len(sweep.speeds) > 1
        else None,
    )


def live_sweep(
    speeds: Sequence[float], levels: Mapping[str, Formulas], *, is_linear: bool
) -> LiveSweep:
    """Return the sweep over speeds [rad/s]; the formula for the resonance is that of a linear motor."""
    marks = {"operating speed": ("speed", "rad/s")}
    if is_linear:
        marks["formula"] = ("nu_res", "rad/s")
    panels = [
        RunPanel(
            x.quantity,
            {
                x.theory: ("first-order theory", colors.THEORY, "theory"),
                x.run: ("co-simulation", x.color, "linked"),
            },
            x.unit,
            levels.get(x.column, {}),
            x.includes,
        )
        for x in PANELS
    ]
    return LiveSweep(
        over="speed",
        values=np.linspace(speeds[0], speeds[-1], SWEEP_POINTS).tolist(),
        step=f"2 * pi / (speed * {SWEEP_STEPS})",
        steady=SWEEP_ORBIT,
        numbers=[
            Number("tau2", TORQUE_RIPPLE, "N.m", "torque ripple"),
            Number("w2", SPEED_RIPPLE, "rad/s", "speed ripple"),
            PHASE,
        ],
        chart=RunChart(
            "Ripple over the operating speed", "operating speed [rad/s]", panels, marks=marks
        ),
    )
