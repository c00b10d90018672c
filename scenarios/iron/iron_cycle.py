"""What do motor, chain and cam of the sealing iron carry over one turn, and how fast may it run?

The cam turns at constant speed; torque, forces and motion of the iron over the cam angle, the work
friction costs per cycle, and the speeds at which follower or chain let go.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import workbench
from cosim import Result
from workbench import Bench, Figure, Findings, Run, Show, Table, option
from workbench.measure import integral, largest, smallest

from . import drive as iron
from . import show as pictures

PARTS = {"iron": iron.PARTS["iron"]}
OWN = iron.IMPOSED
COLUMNS = (
    "phi", "lift", "v", "a", "tau_cam", "T_iron", "T_hang", "T_span", "M_rocker", "N", "pressure",
    "alpha", "beta", "H", "E_friction", "motion",
)  # fmt: skip
LETS_GO = {
    "N": ("follower", "the follower lifts off", "least force of the cam on its follower"),
    "T_span": ("run", "the run of the chain goes slack", "least pull in the run of the chain"),
    "T_iron": ("iron", "the iron hangs free", "least pull of the chain on the iron"),
}


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    speed: float = option(iron.NOMINAL, "speed of the cam", "rad/s", above=0.0)
    samples: int = option(1440, "rows of the turn", least=36)


class Turn(NamedTuple):
    """A turn at constant speed, and the drive that made it."""

    result: Result
    alone: iron.Alone


def solve(o: Options, bench: Bench) -> Findings:
    """One turn at the speed, and two more for the limits."""
    alone = iron.Alone(bench.fmus["iron"], dict(o.start))
    system, whole = iron.imposed(o.speed, alone), 2 * math.pi / o.speed
    one = Run(stop=whole, step=whole / o.samples)
    result, found = bench.certify(system, figures, one, iron.names(COLUMNS), "iron_cycle.csv")
    found["cycles"] = Figure(iron.per_minute(o.speed), "1/min", 0.0, "cycles per minute")
    for force, limit in iron.speed_limits(alone).items():
        name, event, _ = LETS_GO[force]
        found |= limit.figures(f"{name}_limit", event)
    first = min((found[x].value for x in limits(found)), default=math.inf)
    error = max((found[x].error or 0.0 for x in limits(found)), default=0.0)
    share = 100 * o.speed / first
    found["share"] = Figure(
        share, "%", share * error / first, "speed, in shares of the first limit"
    )
    tables = {"iron_cycle.csv": Table.of(result)}
    return Findings(found, Turn(result, alone), system, result.provenance, tables=tables)


def figures(r: Result) -> dict[str, Figure]:
    """Torque, stroke, work of friction and least loads of a turn."""
    angle, torque = np.degrees(r["iron.phi"]), r["iron.tau_cam"]
    i_g = r.provenance["parts"]["iron"]["parameters"]["reducer.i_g"]
    low, high, most = smallest(angle, torque), largest(angle, torque), largest(angle, abs(torque))
    unit, friction = r.units["iron.tau_cam"], r["iron.E_friction"]
    work = integral(r["iron.phi"], torque)
    found = {
        "tau_cam_min": low.figure(unit, "least torque at the cam's shaft"),
        "tau_cam_min_angle": low.at.figure("deg", "cam angle of the least torque"),
        "tau_cam_max": high.figure(unit, "largest torque at the cam's shaft"),
        "tau_cam_max_angle": high.at.figure("deg", "cam angle of the largest torque"),
        "tau_motor_max": Figure(
            most.value / i_g, unit, most.error / i_g, "largest torque of the motor"
        ),
        "stroke": largest(angle, r["iron.lift"]).figure(r.units["iron.lift"], "stroke of the iron"),
        "friction_work": Figure(
            float(friction[-1]), r.units["iron.E_friction"], 0.0, "friction of the guide in a turn"
        ),
        "work": work.figure("J", "work of the torque in a turn"),
    }
    for force, (name, _, least) in LETS_GO.items():
        column = f"iron.{force}"
        found[f"{name}_force_min"] = smallest(angle, r[column]).figure(r.units[column], least)
    return found


def limits(f: Mapping[str, Figure]) -> list[str]:
    """The names of the limits that there are, the lowest first."""
    there = [f"{name}_limit" for name, *_ in LETS_GO.values()]
    return sorted((x for x in there if f[x].error is not None), key=lambda x: f[x].value)


def verdict(o: Options, f: Mapping[str, Figure], r: Turn) -> str:
    """Whether the speed is safe, what it costs, and what would let go beyond it."""
    told, order = {name: figure.text() for name, figure in f.items()}, limits(f)
    events = {f"{name}_limit": event for name, event, _ in LETS_GO.values()}
    pace = f"{o.speed:.5g} rad/s ({f['cycles'].text('cycles/min')})"
    if not order:
        first = f"{pace} is safe: no speed of the cam makes follower or chain let go."
    elif o.speed < f[order[0]].value:
        first = (
            f"{pace} is safe: it is {told['share']} of the first limit, {told[order[0]]}, where "
            f"{events[order[0]]}."
        )
    else:
        first = f"{pace} is NOT possible: {events[order[0]]} at {told[order[0]]} already."
    lines = [
        f"{first} The cam's shaft carries between {told['tau_cam_min']} and {told['tau_cam_max']}, "
        f"the motor up to {told['tau_motor_max']}. Friction takes {told['friction_work']} in a "
        f"cycle, in which the iron strokes {told['stroke']}.",
        f"The torque is least at {told['tau_cam_min_angle']} of the cam and largest at "
        f"{told['tau_cam_max_angle']}; its work in a cycle is {told['work']}.",
        f"The least loads on the way: {told['follower_force_min']} on the follower, "
        f"{told['run_force_min']} in the run of the chain, {told['iron_force_min']} at the iron.",
    ]
    lines += [
        f"At {told[name]} {events[name]}, at {told[f'{name}_angle']} of the cam." for name in order
    ]
    return "\n".join(lines)


def show(o: Options, f: Mapping[str, Figure], r: Turn) -> Show:
    """Motion, torque and forces over the cam angle, and the mechanism in motion."""
    last = float(r.result["time"][-1])
    moving = pictures.motion(r.result, r.alone, "One turn of the cam", 0.0, last, 4.0)
    return Show([pictures.cycle(r.result, o.speed, f[limits(f)[0]].value)], [moving])
