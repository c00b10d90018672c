"""What do motor, chain and cam of the sealing iron carry over one turn, and how fast may it run?

The cam turns at constant speed; torque, forces and motion of the iron over the cam angle, the work
friction costs per cycle, and the speeds at which follower or chain let go.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

import workbench
from cosim import Result, System
from workbench import Bench, Chart, Figure, Findings, Mark, Panel, Run, Show, Table, option
from workbench.measure import integral, largest, smallest
from workbench.report.chart import FORCE, LIFT, SPEED, TORQUE, Span, recorded

from . import drive as iron
from . import mechanism

PARTS = {"iron": "IronDrive"}
OWN = iron.IMPOSED
RECORD = (
    "iron.phi", "iron.lift", "iron.v", "iron.a", "iron.tau_cam", "iron.T_iron", "iron.T_hang",
    "iron.T_span", "iron.M_rocker", "iron.N", "iron.pressure", "iron.alpha", "iron.beta", "iron.H",
    "iron.E_friction", "iron.motion",
)  # fmt: skip
FORCES = {
    "iron.N": ("cam on follower", TORQUE),
    "iron.T_span": ("chain at the link", SPEED),
    "iron.T_iron": ("chain at the iron", LIFT),
}


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    speed: float = option(iron.NOMINAL, "speed of the cam", "rad/s", above=0.0)
    samples: int = option(1440, "rows of the turn", least=36)


def solve(o: Options, bench: Bench) -> Findings:
    """One turn at the speed, and two more for the limits."""
    alone, whole = iron.alone(bench.fmus, o.start), 2 * math.pi / o.speed
    system, run = iron.imposed(o.speed, alone), Run(stop=whole, step=whole / o.samples)
    result, found = bench.certify(system, figures, run, RECORD, "iron_cycle.csv")
    found["cycles"] = Figure(o.speed * iron.PER_MINUTE, "1/min", 0.0, "cycles per minute")
    found |= iron.limits(alone)
    meaning, limit = "speed, in shares of the first limit", found[f"{lowest(found)}_limit"]
    found["share"] = Figure.refused("%", "the first limit is 0", meaning)
    if limit.value:
        share = 100 * o.speed / limit.value
        found["share"] = Figure(share, "%", share * (limit.error or 0.0) / limit.value, meaning)
    tables = {"iron_cycle.csv": Table.of(result)}
    return Findings(found, (result, alone), system, result.provenance, tables=tables)


def figures(r: Result) -> dict[str, Figure]:
    """Torque, stroke, work of friction and least forces of a turn."""
    angle, torque, unit = np.degrees(r["iron.phi"]), r["iron.tau_cam"], r.units["iron.tau_cam"]
    i_g = r.provenance["parts"]["iron"]["parameters"]["reducer.i_g"]
    low, high, motor = (
        smallest(angle, torque), largest(angle, torque), largest(angle, abs(torque) / i_g),
    )  # fmt: skip
    lift, friction = largest(angle, r["iron.lift"]), float(r["iron.E_friction"][-1])
    work = integral(r["iron.phi"], torque)
    found = {
        "tau_cam_min": low.figure(unit, "least torque at the cam's shaft"),
        "tau_cam_min_angle": low.at.figure("deg", "cam angle of the least torque"),
        "tau_cam_max": high.figure(unit, "largest torque at the cam's shaft"),
        "tau_cam_max_angle": high.at.figure("deg", "cam angle of the largest torque"),
        "tau_motor_max": motor.figure(unit, "largest torque of the motor"),
        "stroke": lift.figure(r.units["iron.lift"], "stroke of the iron"),
        "friction_work": Figure(friction, "J", 0.0, "friction of the guide in a turn"),
        "work": work.figure("J", "work of the torque in a turn"),
    }
    for name, (force, _, meaning) in iron.LETS_GO.items():
        found[f"{name}_force_min"] = smallest(angle, r[force]).figure(r.units[force], meaning)
    return found


def lowest(f: Mapping[str, Figure]) -> str:
    """What lets go first."""
    return min(iron.LETS_GO, key=lambda name: f[f"{name}_limit"].value)


def verdict(o: Options, f: Mapping[str, Figure], r: object) -> str:
    """Whether the speed is safe, and what the drive carries."""
    pace = f"{o.speed:.5g} rad/s ({f['cycles'].text('cycles/min')})"
    limit, event = f[f"{lowest(f)}_limit"], iron.LETS_GO[lowest(f)][1]
    answer = f"{pace} is NOT possible: {event} at {limit.text()} already."
    if o.speed < limit.value:
        share = f["share"].text()
        answer = f"{pace} is safe: it is {share} of {limit.text()}, where {event}."
    return (
        f"{answer} The cam's shaft carries between {f['tau_cam_min'].text()} and "
        f"{f['tau_cam_max'].text()}, the motor up to {f['tau_motor_max'].text()}. Friction takes "
        f"{f['friction_work'].text()} in a cycle."
    )


def show(o: Options, f: Mapping[str, Figure], r: tuple[Result, System]) -> Show:
    """Forces, torque and motion over the cam angle, its phases as spans; the mechanism in motion."""
    result, alone = r
    phi = np.degrees(result["iron.phi"])
    p = result.provenance["parts"]["iron"]["parameters"]
    parts = [math.degrees(p[f"cam.{x}"]) for x in ("rise", "top", "ret")]
    ends = pairwise([0.0, *accumulate(parts), 360.0])
    phases = {"rise": "grey", "top dwell": "green", "return": "grey", "sealing": "gold"}

    def panel(quantity: str, column: str, color: str, unit: str = "") -> Panel:
        return recorded(quantity, result, phi, {column: (quantity, color)}, unit)

    pace, event = iron.PER_MINUTE * f[f"{lowest(f)}_limit"].value, iron.LETS_GO[lowest(f)][1]
    now = f"One turn of the cam at {f['cycles'].value:.1f} cycles/min"
    title = f"{now}; {event} at {pace:.1f} cycles/min"
    zero = [Mark(0.0, "0: contact or chain lets go")]
    panels = [
        recorded("forces", result, phi, FORCES, includes=(0.0,), levels=zero),
        panel("torque of the cam", "iron.tau_cam", TORQUE),
        panel("lift", "iron.lift", LIFT, "mm"),
        panel("velocity", "iron.v", SPEED),
        panel("acceleration", "iron.a", FORCE),
    ]
    spans = [Span(*end, name, color) for end, (name, color) in zip(ends, phases.items())]
    moving = mechanism.motion("One turn of the cam", result, alone, result["time"][-1], 4.0)
    return Show([Chart(title, "cam angle [deg]", panels, spans=spans)], [moving])
