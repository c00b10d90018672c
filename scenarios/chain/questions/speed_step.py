"""How does a controlled drive reach a new speed through an elastic shaft?

A motor with a speed controller and a gearbox brings a slotted link from rest to its set speed. An
elastic shaft with backlash connects gearbox and link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cosim import Result, System
from workbench import Figure, Judgement, Question, Run, Show, option
from workbench.charts.model import FORCE, LIFT, SPEED, THEORY, TORQUE
from workbench.live import Live, Number, Reader, RunChart, RunPanel, Slider, drawn
from workbench.measure import (
    Measured,
    Samples,
    clearance,
    crossing,
    harmonics,
    largest,
    measured,
    passed_for_certain,
    smallest,
)

from ..motion import live_motion, moving

WIRES = (
    "controller.tau * 2.5 => motor.v",
    "gear.w_a -> motor.w",
    "gear.w_a -> controller.w",
    "motor.tau -> gear.tau_a",
    "shaft.tau_a -> gear.tau_b",
    "gear.w_b -> shaft.w_a",
    "load.w -> shaft.w_b",
    "shaft.tau_b -> load.tau",
)
MACHINE = {
    "controller.T_i": 0.2,
    "gear.w_a": 0.0,
    "shaft.b": 0.002,
    "shaft.twist": 0.0,
    "load.crank.r": 0.004,
    "load.w": 0.0,
}
#: Share of the set speed that the load must reach; a convention of step responses.
NEAR = 0.9
TURN = 2 * math.pi
#: Largest change of the ripple or the mean over the last turn, over the set speed, of a steady motion.
STEADY = 0.01
#: Largest share of a change that is taken to be left after a turn; changes of rounding have any share.
SLOWEST = 0.9
#: Smallest overshoot of the mean, over the set speed, whose time is named; a flat top has none.
LEAST_OVERSHOOT = 1e-3
STILL_RISES = "the mean still rises"
#: Fewest rows whose peak is named: derived from its error, for which every second row must hold a cubic, of
#: four points.
LEAST_ROWS = 2 * 4
#: Smallest ripple, over the mean speed, that is named; a convention.
LEAST_RIPPLE = 1e-4
#: Frequencies over a natural one between which an undamped oscillator responds at least twice: derived
#: from 1 / |1 - x^2| = 2.
AMPLIFIED = (math.sqrt(0.5), math.sqrt(1.5))
#: Angles for the mean inertia of the load, which is smooth over a turn.
ANGLES = 720


class SpeedStep(Question, Run):
    """The step of the set speed, the gear ratio, and how the run is made."""

    parts = {
        "controller": "SpeedController",
        "motor": "DCMotor",
        "gear": "Gearbox",
        "shaft": "ShaftLink",
        "load": "SlottedLink",
    }
    fixed_starts = ("controller.w_ref", "gear.i")

    speed: float = option(20.0, "set speed of the load", "rad/s", above=0.0)
    ratio: float = option(5.0, "ratio of the gearbox", "1", above=0.0)
    stop: float = option(3.0, "simulated time", "s", above=0.0)
    step: float = option("0.5ms", "finest of three communication steps", "s", above=0.0)

    def system(self, fmus: Mapping[str, Path]) -> System:
        """The drive at rest, with the shaft in the middle of its play."""
        fixed = {"controller.w_ref": self.ratio * self.speed, "gear.i": self.ratio}
        return System(fmus, WIRES, {**MACHINE, **fixed, **self.start})

    def figures(self, r: Result) -> dict[str, Figure]:
        """How fast, how far beyond, at which torque and current, and what is left at the end."""
        t, torque, rad = r["time"], r.units["shaft.tau_b"], r.units["load.w"]
        clear = clearance(t, r["load.w"], NEAR * self.speed)
        back = (
            {}
            if math.isnan(clear.value)
            else {
                "near_clearance": clear.figure(
                    rad,
                    f"distance of {NEAR:.0%} of its set speed from the nearest turn of the speed around that time",
                )
            }
        )
        fast, shaft = largest(t, r["load.w"]), largest(t, r["shaft.tau_b"])
        return {
            "near_time": crossing(t, r["load.w"], NEAR * self.speed).figure(
                "s", f"time until the load first reaches {NEAR:.0%} of its set speed"
            ),
            **back,
            "w_max": fast.figure(rad, f"largest speed of the load up to {self.stop:g} s"),
            **means(self, r),
            **ripples(self, r),
            "tau_max": shaft.figure(torque, "largest torque in the shaft"),
            "tau_max_time": shaft.at.figure("s", "time of the largest torque in the shaft"),
            "tau_min": smallest(t, r["shaft.tau_b"]).figure(torque, "smallest torque in the shaft"),
            "i_max": largest(t, r["motor.i"]).figure(r.units["motor.i"], "largest current"),
        }

    def more_figures(self, f: Mapping[str, Figure], r: Result) -> dict[str, Figure]:
        """Return the natural frequencies of the drive, and when it is near its speed, if that is certain."""
        near = passed_for_certain(f["near_time"], f.get("near_clearance"))
        return {"near_time": near, **frequencies(r)}

    def judgements(self, f: Mapping[str, Figure], r: Result) -> list[Judgement]:
        """How the load reaches its speed, what is left at the end, and what that takes."""
        near, fast, mean, ripple = (
            f[name] for name in ("near_time", "w_max", "mean_max", "ripple")
        )
        is_too_slow = near.error is None and fast.value + (fast.error or 0.0) < NEAR * self.speed
        still_rises = f["mean_max_time"].reason.startswith(STILL_RISES)
        low, high = AMPLIFIED
        swings = {"free": "gearbox and load", "held": "the load with the gearbox held"}
        return [
            Judgement(
                f"the load reaches {NEAR:.0%} of its set speed of {self.speed:g} rad/s",
                near,
                most=self.stop,
                is_so=False if is_too_slow else None,
                yes=f"The load reaches {NEAR:.0%} of its set speed of {self.speed:g} rad/s",
                no=f"The load does not reach {NEAR:.0%} of its set speed of {self.speed:g} rad/s",
                note=f"its largest speed up to {self.stop:g} s is {fast.brief()}"
                if near.error is None
                else "",
            ),
            Judgement(
                "the mean speed over a turn stays below its set speed",
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

    def show(self, f: Mapping[str, Figure], r: Result) -> Show:
        """Speeds, torques and current over time, and both ends of the shaft in motion."""
        return Show([drawn(CHART, r, self)], [moving(r)])

    def live(self, f: Mapping[str, Figure], r: Result) -> Live:
        """The start from rest."""
        return Live(
            sliders=(
                Slider("speed", 10.0, 40.0),
                Slider("ratio", 3.0, 8.0),
                Slider("controller.K", 0.5, 5.0),
                Slider("controller.T_i", 0.05, 1.0),
                Slider("shaft.c", 300.0, 4000.0),
                Slider("shaft.b", 0.0, 0.05),
            ),
            start={"controller.w_ref": "ratio * speed", "gear.i": "ratio"},
            numbers=[
                Number("near_time", Reader("first_crossing", "load.w", level=f"{NEAR} * speed")),
                Number("w_max", Reader("max", "load.w")),
                Number("tau_max", Reader("max", "shaft.tau_b")),
                Number("tau_min", Reader("min", "shaft.tau_b")),
                Number("i_max", Reader("max", "motor.i")),
            ],
            charts=[CHART],
            motion=live_motion(r),
        )


class CrankTurn(NamedTuple):
    """A turn of the crank: mean speed, ripple (half of largest less smallest speed) [rad/s], and the
    strongest order of the ripple.
    """

    mean: float
    ripple: float
    order: int


def turning(r: Result) -> tuple[Samples, Samples, Samples]:
    """Time, angle and speed of the load in the rows since it last stood or turned back."""
    t, phi, w = r["time"], r["load.phi"], r["load.w"]
    first = int(np.flatnonzero(w <= 0.0).max(initial=0))
    return t[first:], phi[first:], w[first:]


def means(o: SpeedStep, r: Result) -> dict[str, Figure]:
    """The largest mean speed over a turn, which has no ripple of whole orders, and when that turn ends."""
    t, phi, _ = turning(r)
    rad = r.units["load.w"]
    meaning = f"largest mean speed of the load over a turn, up to {o.stop:g} s"
    ending = "end of the turn with this mean"
    later = phi >= phi[0] + TURN
    if np.count_nonzero(later) < LEAST_ROWS:
        why = f"the load does not make a whole turn up to {o.stop:g} s"
        if later.any():
            why = f"the load makes its first whole turn only just before {o.stop:g} s"
        return {
            "mean_max": Figure.undetermined(rad, why, meaning),
            "mean_max_time": Figure.undetermined("s", why, ending),
        }
    mean = TURN / (t[later] - CubicSpline(phi, t)(phi[later] - TURN))
    peak = largest(t[later], mean)
    at = peak.at.figure("s", ending)
    if int(np.argmax(mean)) == len(mean) - 1:
        at = Figure.undetermined("s", f"{STILL_RISES} at {o.stop:g} s", ending)
    if peak.value <= (1.0 + LEAST_OVERSHOOT) * o.speed:
        at = Figure.undetermined("s", "the mean does not overshoot", ending)
    return {"mean_max": peak.figure(rad, meaning), "mean_max_time": at}


def last_turn(t: Samples, phi: Samples, w: Samples, back: int) -> CrankTurn:
    """What the last turn of the crank, or one so many before it, shows."""
    ends = phi[-1] - TURN * np.array([back + 1.0, float(back)])
    began, ended = CubicSpline(phi, t)(ends).tolist()
    inside = (phi >= ends[0]) & (phi <= ends[1])
    sizes = np.abs(harmonics(phi[inside], w[inside]))
    high, low = largest(t[inside], w[inside]).value, smallest(t[inside], w[inside]).value
    return CrankTurn(TURN / (ended - began), (high - low) / 2, 1 + int(np.argmax(sizes)))


def ripples(o: SpeedStep, r: Result) -> dict[str, Figure]:
    """Mean and ripple of the speed in the last turn, its strongest order and frequency.

    What the last turn still changes, taken as a geometric series with the change of the turn before, is
    what may follow. A motion that changes by more than STEADY is not steady, and has no such figures.
    """
    t, phi, w = turning(r)
    rad, when = r.units["load.w"], f"in the last turn before {o.stop:g} s"
    meanings = {
        "mean": (rad, f"mean speed of the load {when}"),
        "ripple": (rad, f"ripple of the speed {when}, half of largest less smallest"),
        "ripple_order": ("1", "strongest order of this ripple, over the angle of the crank"),
        "ripple_frequency": ("Hz", "frequency of this order"),
    }
    why = f"the motion is not steady at {o.stop:g} s"
    if phi[-1] - phi[0] <= 3 * TURN:
        why = f"the load turns less than three times up to {o.stop:g} s"
        return {
            name: Figure.undetermined(unit, why, text) for name, (unit, text) in meanings.items()
        }
    last, before, first = (last_turn(t, phi, w, back) for back in (0, 1, 2))
    rests = [
        rest(last.mean, before.mean, first.mean),
        rest(last.ripple, before.ripple, first.ripple),
    ]
    if max(rests) > STEADY * o.speed:
        return {
            name: Figure.undetermined(unit, why, text) for name, (unit, text) in meanings.items()
        }
    pace = measured(lambda t, phi, w: last_turn(t, phi, w, 0).mean, t, phi, w)
    size = measured(lambda t, phi, w: last_turn(t, phi, w, 0).ripple, t, phi, w)
    scale = last.order / TURN
    peaks = {
        "mean": Measured(pace.value, pace.error + rests[0]),
        "ripple": Measured(size.value, size.error + rests[1]),
        "ripple_order": Measured(float(last.order), 0.0),
        "ripple_frequency": Measured(scale * pace.value, scale * (pace.error + rests[0])),
    }
    figures = {name: peaks[name].figure(*meanings[name]) for name in peaks}
    if last.ripple < LEAST_RIPPLE * last.mean:
        for name in ("ripple_order", "ripple_frequency"):
            figures[name] = Figure.undetermined(
                meanings[name][0], "there is no ripple", meanings[name][1]
            )
    return figures


def rest(last: float, before: float, first: float) -> float:
    """What a value may still change that took these values in three turns, as a geometric series."""
    change, earlier = abs(last - before), abs(before - first)
    share = min(change / earlier, SLOWEST) if earlier > 0.0 else SLOWEST
    return change * max(1.0, share / (1.0 - share))


def frequencies(r: Result) -> dict[str, Figure]:
    """At which gearbox and load swing against each other on the undamped shaft, pressed to one flank,
    and the load alone while the controller holds the gearbox [Hz], with the mean inertia of the load.
    """
    gear, shaft, load = (r.provenance["parts"][x]["parameters"] for x in ("gear", "shaft", "load"))
    J_1 = gear["J"] * gear["i"] ** 2
    J_2 = load["rotor.J"] + (load["trough.m"] + load["load.m"]) * mean_square(load)
    free, held = math.sqrt(shaft["c"] * (1 / J_1 + 1 / J_2)), math.sqrt(shaft["c"] / J_2)
    meanings = {"free": "gearbox and load on the shaft", "held": "the load with the gearbox held"}
    fixed, mean = "natural frequency of", "at the load's mean inertia over a turn"
    return {
        f"{word}_frequency": Figure(w / TURN, "Hz", 0.0, f"{fixed} {meanings[word]}, {mean}")
        for word, w in (("free", free), ("held", held))
    }


def mean_square(load: Mapping[str, float]) -> float:
    """The mean over a turn of the square of the trough's travel per angle of the crank [m2/rad2]."""
    phi, tilt = np.arange(ANGLES) * TURN / ANGLES, 0.0
    if load["link.swings"]:
        tilt = load["crank.r"] / load["link.l"]
    travel = load["crank.r"] * (np.cos(phi) + tilt) / (1.0 + tilt * np.cos(phi)) ** 2
    return float((travel**2).mean())


CHART = RunChart(
    "From rest to the set speed",
    "time [s]",
    [
        RunPanel(
            "speed",
            {"gear.w_b": ("gearbox", SPEED), "load.w": ("load", LIFT)},
            levels={"set speed": "speed"},
        ),
        RunPanel("torque in the shaft", {"shaft.tau_b": FORCE}),
        RunPanel(
            "torque of the motor",
            {"controller.tau": ("requested", THEORY, "theory"), "motor.tau": ("motor", TORQUE)},
        ),
        RunPanel("current", {"motor.i": TORQUE}),
    ],
)
