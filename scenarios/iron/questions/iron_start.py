"""How does the sealing iron's drive start, and where does the motor's work go?

A motor with lag starts the mechanism from rest in the middle of the bottom dwell. The CSV contains the
energy ledger (work in = stored + friction), with the energy that the coupling removed or created.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, System
from workbench import Context, Figure, Judgement, Question, Run, Show, option
from workbench.charts.model import LIFT, POWER, SPEED, THEORY, TORQUE
from workbench.live import Live, Number, Reader, RunChart, RunPanel, Slider, drawn
from workbench.measure import Measured, Samples, extended, integral, largest, measured, with_rows

from .. import machine as iron
from .. import motion

#: Largest share of the whole way that a cam at rest makes in the last tenth of a run, a convention.
STANDS = 0.01
#: Rows of a slow turn.
SAMPLES = 720
#: Time that the first chart shows [s]; a convention.
FIRST = 0.3


class IronStart(Question, Run):
    """The motor that starts the drive, and how the run is made."""

    parts = iron.PARTS

    motor_A: float = option(4.0, "torque of the motor at rest", "N.m")
    motor_B: float = option(0.025, "slope of the motor line", "N.m.s/rad", least=0.0)
    motor_T: float = option("12ms", "lag of the motor", "s", above=0.0)
    stop: float = option(3.0, "simulated time", "s", above=0.0)
    step: float = option("0.5ms", "finest of three communication steps", "s", above=0.0)

    def system(self, fmus: Mapping[str, Path]) -> System:
        """Return the drive at rest."""
        motor = iron.MOTOR | {
            "motor.A": self.motor_A,
            "motor.B": self.motor_B,
            "motor.T": self.motor_T,
        }
        return System(fmus, iron.WIRES, motor | dict(self.start))

    def process(self, r: Result) -> Result:
        """Return the run with its ledger."""
        return ledger(r)

    def more_runs(self, context: Context, system: System) -> Start:
        """Run two slow turns."""
        return Start(system, slow_torque(system))

    def more_figures(self, f: Mapping[str, Figure], r: Data) -> dict[str, Figure]:
        """Return the largest torque that a slow turn takes at the cam, and what the motor gives at rest."""
        gear = r[0].provenance["parts"]["iron"]["parameters"]["reducer.i_g"]
        motor = float(r[0]["motor.tau_static"][0])
        meaning = "torque of the motor at the start, at the cam"
        at_rest = Figure(gear * motor, r[1].slow_torque.unit, 0.0, meaning)
        return {"tau_cam_max": r[1].slow_torque, "tau_cam_rest": at_rest}

    def figures(self, r: Result) -> dict[str, Figure]:
        """Largest speed and torque with their times, the speed it settles at, energies at the end."""
        t, phi = r["time"], r["iron.phi"]
        rad, torque, J = (r.units[x] for x in ("iron.w_cam", "motor.tau", "E_in"))
        w, tau, mean = (
            largest(t, r["iron.w_cam"]),
            largest(t, r["motor.tau"]),
            measured(pace, t, phi),
        )
        cycles, work = Measured(*(iron.PER_MINUTE * x for x in mean)), integral(t, r["motor.P"])
        turns = float(phi[-1] - phi[0]) / (2 * math.pi)
        missing = float(np.abs(r["E_missing"]).max())
        meaning = "cycles per minute in the second half"
        return {
            "w_cam_max": w.figure(rad, "largest speed of the cam"),
            "w_cam_max_time": w.at.figure("s", "time of the largest speed of the cam"),
            "tau_max": tau.figure(torque, "largest torque of the motor"),
            "tau_max_time": tau.at.figure("s", "time of the largest torque"),
            "w_cam_mean": mean.figure(rad, "mean speed in the second half"),
            "cycles": cycles.figure("1/min", meaning)
            if abs(turns) >= 1.0
            else Figure.undetermined("1/min", NO_TURN, meaning),
            "turns": Figure(turns, "1", 0.0, "turns of the cam"),
            "energy_in": work.figure(J, "work of the motor"),
            "energy_stored": Figure(float(r["E_stored"][-1]), J, 0.0, "stored at the end"),
            "energy_friction": Figure(float(r["E_friction"][-1]), J, 0.0, "lost to friction"),
            "energy_missing_max": Figure(
                missing, J, work.error, "largest energy that the coupling created or removed"
            ),
        }

    def judgements(self, f: Mapping[str, Figure], r: Data) -> list[Judgement]:
        """How the cam starts, how it goes on, and the ledger."""
        turns, peak = f["turns"], f"after {f['w_cam_max_time'].brief()}"
        if still_rises(r[0]):
            peak = f"at {self.stop:g} s, the end of the run; it still gets faster"
        why = ""
        if stands(r[0]["time"], r[0]["iron.phi"]):
            why = f"the motor stalls after {turns.brief()} turns"
        elif f["w_cam_mean"].value < 0.0:
            why = f"the cam turns backwards, {turns.brief()} turns up to {self.stop:g} s"
        weak = Judgement(
            "the motor turns the cam slowly through a whole turn, by its torque at the start",
            f["tau_cam_rest"],
            least=f["tau_cam_max"],
        )
        has_cycles = turns.value >= 1.0 and f["cycles"].error is not None
        return [
            Judgement(
                f"the cam completes a turn within {self.stop:g} s",
                turns,
                least=1.0,
                is_so=False if why else None,
                yes="The motor starts the drive",
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
        result, turns = r
        first = with_rows(result, result.data[result["time"] <= FIRST])
        charts = [
            drawn(RunChart("The first moments", LABEL, [*START, LEDGER]), first),
            drawn(RunChart(TITLE, LABEL, [*START, LEDGER, LIFTS, MISSING]), result),
        ]
        return Show(charts, [motion.motion("The start", result, turns.system, self.stop, 2.0)])

    def live(self, f: Mapping[str, Figure], r: Data) -> Live:
        """The start."""
        half = "stop / 2"
        return Live(
            sliders=(
                Slider("motor_A", 1.0, 8.0),
                Slider("motor_T", 0.002, 0.1),
                Slider("iron.iron.m", 1.0, 10.0),
                Slider("iron.spring.c", 0.0, 1200.0),
                Slider("iron.reducer.J", 0.0, 0.003),
            ),
            start={"motor.A": "motor_A", "motor.B": "motor_B", "motor.T": "motor_T"},
            numbers=[
                Number("w_cam_max", Reader("max", "iron.w_cam")),
                Number("tau_max", Reader("max", "motor.tau")),
                Number("w_cam_mean", Reader("change", f"iron.phi / ({half})", half)),
                Number("cycles", f"figures.w_cam_mean * {iron.PER_MINUTE!r}"),
                Number("turns", Reader("change", "iron.phi / (2 * pi)")),
                Number("P_mean", Reader("mean", "motor.P"), "W", "mean power of the motor"),
                Number("energy_in", "figures.P_mean * stop"),
                Number("energy_stored", Reader("change", "iron.E_kin + iron.E_pot")),
                Number("energy_friction", Reader("last", "iron.E_friction")),
            ],
            charts=[RunChart(TITLE, LABEL, [*START, LIFTS, ENERGY])],
            motion=motion.live_motion("The start", r[0], r[1].system, 2.0),
        )


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
    return extended(r, r.units["iron.E_kin"], more)


def slow_torque(system: System) -> Figure:
    """Return the largest torque that a slow turn takes at the cam.

    Torques of turns at constant speed are f_0 + f_2 w^2, and two turns give f_0.
    """
    slow, fast = (iron.turn(system, w, SAMPLES) for w in (1.0, 2.0))
    torque, unit = slow["iron.tau_cam"], slow.units["iron.tau_cam"]
    still = torque - (fast["iron.tau_cam"] - torque) / 3
    meaning = "largest torque at the cam in a slow turn"
    return largest(slow["iron.phi"], still).figure(unit, meaning)


def pace(t: Samples, phi: Samples, since: float = 0.5) -> float:
    """Mean speed after that share of the run."""
    began = t[0] + since * (t[-1] - t[0])
    return float((phi[-1] - CubicSpline(t, phi)(began)) / (t[-1] - began))


def still_rises(r: Result) -> bool:
    """Whether the largest speed of a run is that of its end, and so no peak."""
    w = r["iron.w_cam"]
    return int(np.argmax(w)) == len(w) - 1


def stands(t: Samples, phi: Samples) -> bool:
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
        "iron.E_kin + iron.E_pot": ("kinetic and potential", POWER),
        "iron.E_friction": ("friction", THEORY),
    },
    "J",
)
