"""How does the sealing iron's drive start, and where does the motor's work go?

A motor with lag starts the mechanism from rest in the middle of the bottom dwell. The CSV contains the
energy ledger (work in = stored + friction), with the energy that the coupling removed or created.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, System
from cosim.dense import Array
from cosim.metrics import Integral, largest
from cosim.series import Column
from workbench import (
    Context,
    Figure,
    Judgement,
    Number,
    Question,
    Reader,
    RunChart,
    RunOptions,
    RunPanel,
    Show,
    Slider,
    option,
)
from workbench.charts.model import LIFT, POWER, SPEED, THEORY, TORQUE
from workbench.figure import figure_of_columns, scaled
from workbench.live import Live, LiveMotion, drawn, moved

from .. import machine as iron
from .. import motion

#: Largest share of the whole way that a cam at rest makes in the last tenth of a run, a convention.
STANDS = 0.01
#: Rows of a slow turn.
SAMPLES = 720
#: Time that the first chart shows [s]; a convention.
FIRST = 0.3
HALF = "stop / 2"
#: That of a weight is 0 at the height of the rocker's or the cam's pivot, and the iron hangs below: the sum begins at
#: -4.2 J, so that what is shown is counted from the start.
ENERGY_NOW = "iron.E_kin + iron.E_pot"


class IronStart(Question, RunOptions):
    """The motor that starts the drive, and how the run is made."""

    parts = iron.PARTS
    wires = iron.WIRES
    start_values = {
        "motor.A": "motor_A",
        "motor.B": "motor_B",
        "motor.T": "motor_T",
        "motor.tau": 0.0,
    }

    motor_A: float = option(4.0, "torque of the motor at rest", "N.m")
    motor_B: float = option(0.025, "slope of the motor line", "N.m.s/rad", least=0.0)
    motor_T: float = option("12ms", "lag of the motor", "s", above=0.0)
    stop: float = option(3.0, "simulated time", "s", above=0.0)
    step: float = option("0.5ms", "finest of three communication steps", "s", above=0.0)

    numbers = (
        Number("w_cam_max", Reader("max", "iron.w_cam"), meaning="largest speed of the cam"),
        Number("w_cam_max_time", Reader("time_of_max", "iron.w_cam"), meaning="time of the largest speed of the cam"),
        Number("tau_max", Reader("max", "motor.tau"), meaning="largest torque of the motor"),
        Number("tau_max_time", Reader("time_of_max", "motor.tau"), meaning="time of the largest torque"),
        Number(
            "w_cam_mean", Reader("change", f"iron.phi / ({HALF})", HALF), "rad/s", "mean speed in the second half"
        ),
        Number("turns", Reader("change", "iron.phi / (2 * pi)"), "1", "turns of the cam"),
        Number("energy_in", Integral("motor.P"), "J", "work of the motor"),
        Number("energy_stored", Reader("change", ENERGY_NOW), "J", "stored at the end"),
        Number("energy_friction", Reader("last", "iron.E_friction"), meaning="lost to friction"),
    )  # fmt: skip
    sliders = (
        Slider("motor_A", 1.0, 8.0),
        Slider("motor_T", 0.002, 0.1),
        Slider("iron.iron.m", 1.0, 10.0),
        Slider("iron.spring.c", 0.0, 1200.0),
        Slider("iron.reducer.J", 0.0, 0.003),
    )

    def process(self, r: Result) -> Result:
        """Return the run with its ledger."""
        return ledger(r)

    def more_runs(self, context: Context, system: System) -> Start:
        """Run two slow turns."""
        return Start(system, slow_torque(system))

    def more_figures(self, f: Mapping[str, Figure], r: Data) -> dict[str, Figure]:
        """Return the stall torque at the cam beside that of a slow turn, cycles per minute, and what the ledger lacks."""
        result, mean = r[0], f["w_cam_mean"]
        gear = result.provenance["parts"]["iron"]["parameters"]["reducer.i_g"]
        motor = float(result["motor.tau_static"][0])
        meaning = "stall torque of the motor, referred to the cam"
        at_rest = Figure(gear * motor, r[1].slow_torque.unit, 0.0, meaning)
        cycles = scaled(mean, iron.PER_MINUTE, "1/min", "cycles per minute in the second half")
        if abs(f["turns"].value) < 1.0:
            cycles = Figure.undetermined("1/min", NO_TURN, cycles.meaning)
        missing = Figure(
            float(np.abs(result["E_missing"]).max()), "J", f["energy_in"].error,
            "largest energy that the coupling created or removed", f["energy_in"].reason,
        )  # fmt: skip
        return {
            "cycles": cycles,
            "energy_missing_max": missing,
            "tau_cam_max": r[1].slow_torque,
            "tau_cam_rest": at_rest,
        }

    def judgements(self, f: Mapping[str, Figure], r: Data) -> list[Judgement]:
        """How the cam starts, how it goes on, and the ledger."""
        turns, peak = f["turns"], f"after {f['w_cam_max_time'].brief()}"
        if f["w_cam_max_time"].value == r[0]["time"][-1]:
            peak = f"at {self.stop:g} s, the end of the run; it still gets faster"
        why = ""
        if stands(r[0]["time"], r[0]["iron.phi"]):
            why = f"the motor stalls after {turns.brief()} turns"
        elif f["w_cam_mean"].value < 0.0:
            why = f"the cam turns backwards, {turns.brief()} turns up to {self.stop:g} s"
        weak = Judgement(
            "the stall torque of the motor, referred to the cam, turns it slowly through a whole turn",
            f["tau_cam_rest"],
            least=f["tau_cam_max"],
        )
        has_cycles = turns.value >= 1.0 and f["cycles"].error is not None
        return [
            Judgement(
                f"the cam completes a turn within {self.stop:g} s",
                turns._replace(unit="turns"),
                least=1.0,
                is_so=False if why else None,
                yes=f"The motor starts the drive within {self.stop:g} s",
                no=f"The cam does not complete a turn within {self.stop:g} s"
                if abs(turns.value) < 1.0
                else "The motor does not keep the drive turning forwards",
                note=why,
            ),
            *([weak] if f["tau_cam_rest"].value > 0.0 else []),
            Judgement("largest speed of the cam", f["w_cam_max"], note=peak),
            Judgement(
                "mean speed of the cam in the second half",
                f["w_cam_mean"],
                note=f["cycles"].brief("cycles/min") if has_cycles else "",
            ),
            Judgement(
                "work of the motor",
                f["energy_in"],
                note=f"friction takes {f['energy_friction'].brief()}, and {f['energy_stored'].brief()} is stored at the end",
            ),
        ]

    def show(self, f: Mapping[str, Figure], r: Data) -> Show:
        """The first moments, the whole start with its ledger, and the mechanism in motion."""
        first = r[0].select(r[0]["time"] <= FIRST)
        charts = [
            drawn(RunChart("The first moments", LABEL, [*START, LEDGER]), first),
            drawn(RunChart(TITLE, LABEL, [*START, LEDGER, LIFTS, MISSING]), r[0]),
        ]
        return Show(charts, [moved(self.motion(f, r), r[0])])

    def motion(self, f: Mapping[str, Figure], r: Data) -> LiveMotion:
        """The mechanism."""
        return motion.live_motion("The start", r[0], r[1].system, 2.0)

    def live(self, f: Mapping[str, Figure], r: Data) -> Live:
        """The start; its work is that of the mean power."""
        more = (
            Number("cycles", f"figures.w_cam_mean * {iron.PER_MINUTE!r}"),
            Number("P_mean", Reader("mean", "motor.P"), "W", "mean power of the motor"),
            Number("energy_in", "figures.P_mean * stop"),
            Number(
                "energy_end", Reader("last", ENERGY_NOW), "J", "energy at the end", is_visible=False
            ),
        )
        return self.page(f, r, charts=[RunChart(TITLE, LABEL, [*START, LIFTS, ENERGY])], more=more)


class Start(NamedTuple):
    """What stands beside the run: the system, and the largest torque of a slow turn."""

    system: System
    slow_torque: Figure


Data = tuple[Result, Start]


NO_TURN = "the cam does not complete a turn"


def ledger(r: Result) -> Result:
    """The run with work of the motor, energy stored since the start, friction, what is missing [J]."""
    work = np.asarray(CubicSpline(r["time"], r["motor.P"]).antiderivative()(r["time"]))
    energy, friction = r["iron.E_kin"] + r["iron.E_pot"], r["iron.E_friction"]
    stored = energy - energy[0]
    missing = work - stored - friction
    more = {"E_in": work, "E_stored": stored, "E_friction": friction, "E_missing": missing}
    columns = {Column(name, r.units["iron.E_kin"]): x for name, x in more.items()}
    return r.with_columns(columns, ("motor.P", "iron.E_kin", "iron.E_pot", "iron.E_friction"))


def slow_torque(system: System) -> Figure:
    """Return the largest torque that a slow turn takes at the cam."""
    turns = iron.two_turns(system, SAMPLES)
    still, _ = turns.parts("iron.tau_cam")
    unit, meaning = turns.slow.units["iron.tau_cam"], "largest torque at the cam in a slow turn"
    return figure_of_columns(largest, turns.slow["iron.phi"], still, unit=unit, meaning=meaning)


def stands(t: Array, phi: Array) -> bool:
    """Whether the cam hardly moves in the last tenth of a run, to either side."""
    last = t >= t[-1] - 0.1 * (t[-1] - t[0])
    return bool(np.ptp(phi[last]) < STANDS * np.ptp(phi))


TITLE, LABEL = "The start from the middle of the bottom dwell", "time [s]"
START = [
    RunPanel("cam speed", {"iron.w_cam": SPEED}),
    RunPanel("motor torque", {"motor.tau": TORQUE}),
]
LIFTS = RunPanel("lift", {"iron.lift": LIFT}, "mm")
LEDGER = RunPanel(
    "energy",
    {
        "E_friction": ("friction", "grey", "area"),
        "E_stored": ("stored", "sky", "area"),
        "E_in": ("from the motor", TORQUE),
    },
    includes=(0.0,),
)
MISSING = RunPanel("made or lost by the coupling", {"E_missing": ("missing", THEORY)}, "mJ")
ENERGY = RunPanel(
    "energy",
    {
        f"{ENERGY_NOW} - (figures.energy_end - figures.energy_stored)": ("stored", POWER),
        "iron.E_friction": ("friction", THEORY),
    },
    "J",
)
