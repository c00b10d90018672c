"""How does a controlled drive reach a new speed through an elastic shaft?

A motor with a speed controller and a gearbox brings a slotted link from rest to its set speed. An
elastic shaft with backlash connects gearbox and link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from cosim import Result
from cosim.metrics import (
    TURN,
    Largest,
    Mean,
    Settled,
    StrongestOrder,
    Swing,
    TimeOfLargest,
    TurnMean,
)
from workbench import (
    Figure,
    Judgement,
    Number,
    Question,
    Reader,
    RunChart,
    RunOptions,
    RunPanel,
    Slider,
    option,
)
from workbench.charts.model import FORCE, LIFT, SPEED, THEORY, TORQUE
from workbench.figure import figure_of_figures, scaled
from workbench.judgement import in_time
from workbench.live import LiveMotion

from ..motion import live_motion

#: Share of the set speed that the load must reach; a convention of step responses.
NEAR = 0.9
#: Smallest overshoot of the mean, over the set speed, whose time is named; a flat top has none.
LEAST_OVERSHOOT = 1e-3
STILL_RISES = "the mean still rises"
#: Smallest ripple, over the mean speed, that is named; a convention.
LEAST_RIPPLE = 1e-4
#: Frequencies over a natural one between which an undamped oscillator responds at least twice: derived
#: from 1 / |1 - x^2| = 2.
AMPLIFIED = (math.sqrt(0.5), math.sqrt(1.5))
MEAN_OF_TURN = TurnMean("load.w", over="load.phi")
LAST = "in the last turn before {stop:g} s"


class SpeedStep(Question, RunOptions):
    """The step of the set speed, the gear ratio, and how the run is made."""

    parts = {
        "controller": "SpeedController",
        "motor": "DCMotor",
        "gear": "Gearbox",
        "shaft": "ShaftLink",
        "load": "SlottedLink",
    }
    wires = (
        "controller.tau * 2.5 => motor.v",
        "gear.w_a -> motor.w",
        "gear.w_a -> controller.w",
        "motor.tau -> gear.tau_a",
        "shaft.tau_a -> gear.tau_b",
        "gear.w_b -> shaft.w_a",
        "load.w -> shaft.w_b",
        "shaft.tau_b -> load.tau",
    )
    fixed_starts = ("controller.w_ref", "gear.i")
    start_values = {
        "controller.w_ref": "ratio * speed",
        "gear.i": "ratio",
        "controller.T_i": 0.2,
        "gear.w_a": 0.0,
        "shaft.b": 0.002,
        "shaft.twist": 0.0,
        "load.crank.r": 0.004,
        "load.w": 0.0,
    }

    speed: float = option(20.0, "set speed of the load", "rad/s", above=0.0)
    ratio: float = option(5.0, "ratio of the gearbox", "1", above=0.0)
    stop: float = option(3.0, "simulated time", "s", above=0.0)
    step: float = option("0.5ms", "finest of three communication steps", "s", above=0.0)

    numbers = (
        Number(
            "near_time", Reader("first_crossing", "load.w", level=f"{NEAR} * speed"),
            meaning=f"time until the load first reaches {100 * NEAR:g} % of its set speed",
        ),
        Number("w_max", Reader("max", "load.w"), meaning="largest speed of the load up to {stop:g} s"),
        Number(
            "mean_max", Largest(MEAN_OF_TURN), meaning="largest mean speed of the load over a turn, up to {stop:g} s"
        ),
        Number("mean_max_time", TimeOfLargest(MEAN_OF_TURN), meaning="end of the turn with this mean"),
        Number("mean", Settled(Mean("load.w"), over="load.phi"), meaning=f"mean speed of the load {LAST}"),
        Number(
            "ripple", Settled(Swing("load.w"), over="load.phi"),
            meaning=f"ripple of the speed {LAST}, half of largest less smallest",
        ),
        Number(
            "ripple_order", StrongestOrder("load.w", over="load.phi"),
            meaning="strongest order of this ripple, over the angle of the crank",
        ),
        Number("tau_max", Reader("max", "shaft.tau_b"), meaning="largest torque in the shaft"),
        Number("tau_max_time", Reader("time_of_max", "shaft.tau_b"), meaning="time of the largest torque in the shaft"),
        Number("tau_min", Reader("min", "shaft.tau_b"), meaning="smallest torque in the shaft"),
        Number("i_max", Reader("max", "motor.i"), meaning="largest current"),
    )  # fmt: skip
    charts = (
        RunChart(
            "From rest to the set speed",
            "time [s]",
            [
                RunPanel(
                    "speed", {"gear.w_b": ("gearbox", SPEED), "load.w": ("load", LIFT)}, levels={"set speed": "speed"}
                ),
                RunPanel("torque in the shaft", {"shaft.tau_b": FORCE}),
                RunPanel(
                    "torque of the motor",
                    {"controller.tau": ("requested", THEORY, "theory"), "motor.tau": ("motor", TORQUE)},
                ),
                RunPanel("current", {"motor.i": TORQUE}),
            ],
        ),
    )  # fmt: skip
    sliders = (
        Slider("speed", 10.0, 40.0),
        Slider("ratio", 3.0, 8.0),
        Slider("controller.K", 0.5, 5.0),
        Slider("controller.T_i", 0.05, 1.0),
        Slider("shaft.c", 300.0, 4000.0),
        Slider("shaft.b", 0.0, 0.05),
    )

    def more_figures(self, f: Mapping[str, Figure], r: Result) -> dict[str, Figure]:
        """Return the natural frequencies, and what is certain of the largest mean and of the ripple."""
        top, at, mean = f["mean_max"], f["mean_max_time"], f["mean"]
        ripple = scaled(f["ripple"], 0.5, f["ripple"].unit, f["ripple"].meaning)
        refused = {}
        if top.error is not None:
            if top.value <= (1.0 + LEAST_OVERSHOOT) * self.speed:
                refused["mean_max_time"] = "the mean does not overshoot"
            elif at.value == r["time"][-1] or at.error is None:
                refused["mean_max_time"] = f"{STILL_RISES} at {self.stop:g} s"
        if ripple.error is None or mean.error is None:
            refused["ripple_order"] = ripple.reason or mean.reason
        elif ripple.value < LEAST_RIPPLE * mean.value:
            refused["ripple_order"] = "there is no ripple"
        steady = {"ripple": ripple, "ripple_order": f["ripple_order"]}
        steady |= {
            name: Figure.undetermined(f[name].unit, why, f[name].meaning)
            for name, why in refused.items()
        }
        frequency = figure_of_figures(
            lambda order, mean: order * mean / TURN,
            steady["ripple_order"],
            mean,
            unit="Hz",
            meaning="frequency of this order",
        )
        return natural_frequencies(r) | steady | {"ripple_frequency": frequency}

    def judgements(self, f: Mapping[str, Figure], r: Result) -> list[Judgement]:
        """How the load reaches its speed, what is left at the end, and what that takes."""
        near, fast, mean, ripple = (
            f[name] for name in ("near_time", "w_max", "mean_max", "ripple")
        )
        is_too_slow = near.error is None and fast.value + (fast.error or 0.0) < NEAR * self.speed
        still_rises = f["mean_max_time"].reason.startswith(STILL_RISES)
        low, high = AMPLIFIED
        share = f"{100 * NEAR:g} % of its set speed of {self.speed:g} rad/s"
        swings = {"free": "gearbox and load", "held": "the load with the gearbox held"}
        return [
            in_time(
                f"the load reaches {share}",
                f"the load does not reach {share}",
                near,
                self.stop,
                why=f"its largest speed up to {self.stop:g} s is {fast.brief()}"
                if is_too_slow
                else "",
            ),
            Judgement(
                f"the mean speed over a turn overshoots its set speed by less than {100 * LEAST_OVERSHOOT:g} %",
                mean,
                most=(1.0 + LEAST_OVERSHOOT) * self.speed,
                note=f"it still rises at {self.stop:g} s"
                if still_rises and mean.error is not None
                else "",
            ),
            Judgement("mean speed in the last turn", f["mean"]),
            Judgement("ripple of the speed in the last turn", ripple),
            *(
                Judgement(
                    f"that ripple is near the natural frequency of {swings[key]}",
                    f["ripple_frequency"],
                    low * f[f"{key}_frequency"].value,
                    high * f[f"{key}_frequency"].value,
                    is_wanted=False,
                )
                for key in swings
                if ripple.error is not None
            ),
            Judgement("largest torque in the shaft", f["tau_max"]),
            Judgement("largest current of the motor", f["i_max"]),
        ]

    def motion(self, f: Mapping[str, Figure], r: Result) -> LiveMotion:
        """Both ends of the shaft."""
        return live_motion(r)


def natural_frequencies(r: Result) -> dict[str, Figure]:
    """At which gearbox and load swing against each other on the undamped shaft, pressed to one flank,
    and the load alone while the controller holds the gearbox [Hz], with the mean inertia of the load.
    """
    gear, shaft, load = (r.provenance["parts"][x]["parameters"] for x in ("gear", "shaft", "load"))
    J_1 = gear["J"] * gear["i"] ** 2
    J_2 = load["rotor.J"] + (load["trough.m"] + load["load.m"]) * mean_square_travel(load)
    free, held = math.sqrt(shaft["c"] * (1 / J_1 + 1 / J_2)), math.sqrt(shaft["c"] / J_2)
    meanings = {"free": "gearbox and load on the shaft", "held": "the load with the gearbox held"}
    fixed, mean = "natural frequency of", "at the load's mean inertia over a turn"
    return {
        f"{word}_frequency": Figure(w / TURN, "Hz", 0.0, f"{fixed} {meanings[word]}, {mean}")
        for word, w in (("free", free), ("held", held))
    }


def mean_square_travel(load: Mapping[str, float]) -> float:
    """The mean over a turn of the square of the trough's travel per angle of the crank [m2/rad2].

    With cos(psi) = (cos(phi) + e) / (1 + e cos(phi)), e = r / l, as between two anomalies of Kepler's orbits, it is the mean of
    r^2 cos(psi)^2 (1 - e cos(psi)) / (1 - e^2)^1.5 over psi.
    """
    r = load["crank.r"]
    e = r / load["link.l"] if load["link.swings"] else 0.0
    return r * r / 2.0 / math.sqrt(1.0 - e * e) ** 3
