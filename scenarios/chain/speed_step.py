"""How does a controlled drive reach a new speed through an elastic shaft?

A motor with a speed controller and a gearbox brings a slotted link from rest to its set speed. An
elastic shaft with backlash connects gearbox and link.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cosim import Result, System
from workbench import Bench, Chart, Figure, Findings, Mark, Run, Show, Table, option
from workbench.live import (
    Caption,
    Coordinate,
    Live,
    LiveChart,
    LiveMotion,
    LivePanel,
    Number,
    Reader,
    Slider,
)
from workbench.measure import crossing, largest, smallest
from workbench.report import motion
from workbench.report.chart import FORCE, LIFT, SPEED, THEORY, TORQUE, recorded
from workbench.report.motion import Motion, Shape, line

PARTS = {
    "controller": "SpeedController",
    "motor": "DCMotor",
    "gear": "Gearbox",
    "shaft": "ShaftLink",
    "load": "SlottedLink",
}
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
OWN = ("controller.w_ref", "gear.i")
MACHINE = {
    "controller.T_i": 0.2,
    "gear.w_a": 0.0,
    "shaft.b": 0.002,
    "shaft.twist": 0.0,
    "load.crank.r": 0.004,
    "load.w": 0.0,
}
NEAR = 0.9
TITLE = "Both ends of the shaft"
NOTE = "The thin hand is the gearbox end of the shaft, the crank the load end. Their angle is the twist."


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    speed: float = option(20.0, "set speed of the load", "rad/s", above=0.0)
    ratio: float = option(5.0, "ratio of the gearbox", "1", above=0.0)
    step: float = option("0.5ms", "finest of three communication steps", "s", above=0.0)


def solve(o: Options, bench: Bench) -> Findings:
    """One start."""
    drive = system(o, bench.fmus)
    result, found = bench.certify(drive, partial(figures, o), o, None, "speed_step.csv")
    tables = {"speed_step.csv": Table.of(result)}
    return Findings(found | frequencies(result), result, drive, result.provenance, tables=tables)


def system(o: Options, fmus: Mapping[str, Path]) -> System:
    """The drive at rest, with the shaft in the middle of its play."""
    own = {"controller.w_ref": o.ratio * o.speed, "gear.i": o.ratio}
    return System(fmus, WIRES, {**MACHINE, **own, **o.start})


def figures(o: Options, r: Result) -> dict[str, Figure]:
    """How fast, how far beyond, at which torque and current."""
    t, torque, rad = r["time"], r.units["shaft.tau_b"], r.units["load.w"]
    fast, shaft = largest(t, r["load.w"]), largest(t, r["shaft.tau_b"])
    return {
        "near_time": crossing(t, r["load.w"], NEAR * o.speed).figure(
            "s", f"time until the load first reaches {NEAR:.0%} of its set speed"
        ),
        "w_max": fast.figure(rad, "largest speed of the load"),
        "tau_max": shaft.figure(torque, "largest torque in the shaft"),
        "tau_max_time": shaft.at.figure("s", "time of the largest torque in the shaft"),
        "tau_min": smallest(t, r["shaft.tau_b"]).figure(torque, "smallest torque in the shaft"),
        "i_max": largest(t, r["motor.i"]).figure(r.units["motor.i"], "largest current"),
    }


def frequencies(r: Result) -> dict[str, Figure]:
    """At which gearbox and load swing against each other on the undamped shaft, pressed to one flank,
    and the load alone while the controller holds the gearbox [Hz]; the inertia of the load is that
    of a Scotch yoke, its mean over a turn.
    """
    gear, shaft, load = (r.provenance["parts"][x]["parameters"] for x in ("gear", "shaft", "load"))
    J_1 = gear["J"] * gear["i"] ** 2
    J_2 = load["rotor.J"] + (load["trough.m"] + load["load.m"]) * load["crank.r"] ** 2 / 2
    free, held = math.sqrt(shaft["c"] * (1 / J_1 + 1 / J_2)), math.sqrt(shaft["c"] / J_2)
    meanings = {"free": "gearbox and load on the shaft", "held": "the load with the gearbox held"}
    own = "natural frequency of"
    return {
        f"{word}_frequency": Figure(w / (2 * math.pi), "Hz", 0.0, f"{own} {meanings[word]}")
        for word, w in (("free", free), ("held", held))
    }


def verdict(o: Options, f: Mapping[str, Figure], r: Result) -> str:
    """How the load reaches its speed, what that takes, and how the shaft may oscillate."""
    told = {name: figure.text() for name, figure in f.items()}
    set_speed = f"{NEAR:.0%} of its set speed of {o.speed:g} rad/s"
    comes = f"The load does not reach {set_speed}; its largest speed is {told['w_max']}"
    if f["w_max"].value > NEAR * o.speed:
        first = f"the time at which it first reaches {set_speed} is {told['near_time']}"
        comes = f"The largest speed of the load is {told['w_max']}; {first}"
    if f["near_time"].error is not None:
        beyond = "overshoots to" if f["w_max"].value > o.speed else "does not exceed"
        comes = (
            f"The load reaches {set_speed} after {told['near_time']} and {beyond} {told['w_max']}"
        )
    return (
        f"{comes}. The shaft carries up to {told['tau_max']}, and the motor draws up to "
        f"{told['i_max']}. Gearbox and load oscillate on the shaft at {told['free_frequency']}; while "
        f"the controller holds the gearbox, the load oscillates alone at {told['held_frequency']}."
    )


def show(o: Options, f: Mapping[str, Figure], r: Result) -> Show:
    """Speeds, torques and current over time, and both ends of the shaft in motion."""
    panel = partial(recorded, result=r, x=r["time"])
    speeds = {"gear.w_b": ("gearbox", SPEED), "load.w": ("load", LIFT)}
    torques = {"controller.tau": ("requested", THEORY, "theory"), "motor.tau": ("motor", TORQUE)}
    wanted = [Mark(o.speed, "set speed")]
    panels = [
        panel("speed", curves=speeds, levels=wanted),
        panel("torque in the shaft", curves={"shaft.tau_b": FORCE}),
        panel("torque of the motor", curves=torques),
        panel("current", curves={"motor.i": TORQUE}),
    ]
    chart = Chart(f"From rest to {o.speed:g} rad/s", "time [s]", panels)
    return Show([chart], [moving(r)])


def moving(r: Result) -> Motion:
    """The crank and the link that it moves, and the other end of the shaft as a second hand."""
    t = r["time"]
    picked = motion.rows(t, 0.0, float(t[-1]), 480)
    at = {
        name: r[name][picked] for name in ("load.phi", "load.w", "load.x", "gear.phi_b", "gear.w_b")
    }
    rows = zip(t[picked], at["gear.w_b"], at["load.w"])
    captions = [f"{s:.3f} s: gearbox {w:.1f} rad/s; load {v:.1f} rad/s" for s, w, v in rows]
    return Motion(
        TITLE,
        t[picked],
        5.0,
        captions,
        drawn(r.provenance["parts"]["load"]["parameters"], at),
        NOTE,
    )


def drawn(p: Mapping[str, Any], at: motion.Columns) -> list[Shape]:
    """The lines by columns with the names of the system, and the parameters of the load."""
    a, x, phi, ahead = p["crank.r"], at["load.x"], at["load.phi"], at["gear.phi_b"]
    tilt = 1.0 / p["link.l"] if p["link.swings"] else 0.0
    pin, high = (a * np.sin(phi), a * np.cos(phi)), 1.4 * a
    slot = line((x * (1.0 - high * tilt), -high), (x * (1.0 + high * tilt), high))
    near, far = x + 3.0 * a, x + 6.0 * a
    trough = line((near, -a), (far, -a), (far, a), (near, a))
    hand = line((0.0, 0.0), (1.8 * a * np.sin(ahead), 1.8 * a * np.cos(ahead)))
    return [
        Shape("ground", motion.ground(1.6 * a, -1.2 * a, 7.4 * a, -1.2 * a, 0.3 * a), "grey", 1.5),
        Shape("slot", slot, "green", 5.0),
        Shape("rod", line((x, 0.0), (near, 0.0)), "green", 3.0),
        Shape("trough", trough, "green", 3.0, closed=True, label=2),
        Shape("gearbox", hand, "blue", 2.0, label=1),
        Shape("crank", line((0.0, 0.0), pin), "red", 4.0),
        Shape("pin", line(pin, pin), "red", 12.0),
    ]


def live_part(o: Options, f: Mapping[str, Figure], r: Result) -> Live:
    """The start from rest."""
    p = r.provenance["parts"]["load"]["parameters"]
    a = p["crank.r"]
    panels = [
        LivePanel(
            "speed",
            {"gear.w_b": ("gearbox", SPEED), "load.w": ("load", LIFT)},
            levels={"set speed": "speed"},
        ),
        LivePanel("torque in the shaft", {"shaft.tau_b": FORCE}),
        LivePanel(
            "torque of the motor",
            {"controller.tau": ("requested", THEORY, "theory"), "motor.tau": ("motor", TORQUE)},
        ),
        LivePanel("current", {"motor.i": TORQUE}),
    ]
    moving_part = LiveMotion(
        TITLE,
        partial(drawn, p),
        [
            Coordinate("load.phi", 0.0, 2 * math.pi, (1.0,)),
            Coordinate("load.x", -a, a),
            Coordinate("gear.phi_b", 0.0, 2 * math.pi, (1.0,)),
        ],
        [Caption("gearbox", "gear.w_b", "rad/s"), Caption("load", "load.w", "rad/s")],
        5.0,
        NOTE,
    )
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
        charts=[LiveChart("From rest to the set speed", "time [s]", panels)],
        motion=moving_part,
    )


LIVE = live_part
