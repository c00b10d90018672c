"""The iron drive at constant speed, and the speeds at which follower and chain let go."""

import math
from collections.abc import Mapping
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np

import cosim
from cosim import Result, SetupError, System
from cosim.dense import Array
from cosim.metrics import largest, time_of_largest
from workbench import Figure
from workbench.charts.model import Span
from workbench.figure import figure_of_columns, figure_of_figures
from workbench.options import Start

#: Inertia of a rotor that imposes a constant speed [kg.m2]; the acceleration left is below 1e-11 rad/s2.
FLYWHEEL = 1e9
#: Distance from the ends of rise and return within which rows are left out [rad]; rows of two turns are at the
#: same angles within 1e-11 rad.
EDGE = 1e-6
NOMINAL = "40rpm"
PER_MINUTE = 30 / math.pi
PARTS = {"motor": "DriveMotor", "iron": "IronDrive"}
MOTOR: Start = {"motor.A": 4.0, "motor.B": 0.025, "motor.T": 0.012, "motor.tau": 0.0}
WIRES = ("motor.tau -> iron.tau", "iron.w -> motor.w")
PHASES = {"rise": "grey", "top dwell": "green", "return": "grey", "sealing": "gold"}
IMPOSED = ("iron.tau", "iron.phi", "iron.w_cam", "iron.reducer.J")
LETS_GO = {
    "follower": ("iron.N", "the follower lifts off", "force of the cam on its follower"),
    "run": ("iron.T_span", "the run of the chain goes slack", "pull in the run of the chain"),
    "iron": ("iron.T_iron", "the iron hangs free", "pull of the chain on the iron"),
}


def imposed(system: System, speed: float, rotor: float = FLYWHEEL) -> System:
    """The iron drive of a system by itself, at a practically constant cam speed [rad/s], from phi = 0.

    A rotor far heavier than any motor's imposes the speed: the acceleration left is below 1e-11
    rad/s2, so that forces and cam torque are the kinetostatic ones. A stiff motor would need
    communication steps below 0.1 us to stay stable.
    """
    other_parts = tuple(f"{part}." for part in system.parts if part != "iron")
    start = {x: value for x, value in system.start.items() if not x.startswith(other_parts)}
    fixed = dict(zip(IMPOSED, (0.0, 0.0, speed, rotor)))
    return System({"iron": system.parts["iron"]}, start={"iron.on_invalid": 1, **start, **fixed})


def turn(system: System, speed: float, samples: int = 1440, rotor: float = FLYWHEEL) -> Result:
    """One turn at constant speed, sampled evenly over the cam angle; its last row is its first."""
    h = 2 * math.pi / (speed * samples)
    return cosim.run(imposed(system, speed, rotor), stop=h * samples, step=h)


def cycles(speed: float) -> Figure:
    """The cycles per minute of a speed of the cam [rad/s]."""
    return Figure(speed * PER_MINUTE, "1/min", 0.0, "cycles per minute")


def pace(speed: float) -> str:
    """A speed of the cam [rad/s] in words, with its cycles."""
    return f"{speed:.4g} rad/s ({cycles(speed).brief('cycles/min')})"


def phases(parameters: Mapping[str, Any]) -> list[Span]:
    """The parts of a turn over the cam angle [deg]."""
    widths = [math.degrees(parameters[f"cam.{x}"]) for x in ("rise", "top", "ret")]
    ends = pairwise([0.0, *accumulate(widths), 360.0])
    return [Span(*end, *phase) for end, phase in zip(ends, PHASES.items())]


class TwoTurns(NamedTuple):
    """Turns at 1 and 2 rad/s, with their rows at the same angles within 1e-11 rad."""

    slow: Result
    fast: Result

    def parts(self, column: str) -> tuple[Array, Array]:
        """Return f_0 and f_2 of a column, which at a constant speed w is f_0 + f_2 w^2, shape (rows,) each."""
        moving = (self.fast[column] - self.slow[column]) / 3.0
        return self.slow[column] - moving, moving


def two_turns(system: System, samples: int = 1440) -> TwoTurns:
    """Run both turns."""
    return TwoTurns(turn(system, 1.0, samples), turn(system, 2.0, samples))


def limits(system: System) -> dict[str, Figure]:
    """The constant cam speed at which each force vanishes first, and the cam angle where; 0 for a
    force that is not there at rest.

    A force f_0(phi) + f_2(phi) w^2 vanishes where -f_2 / f_0 is largest. It does somewhere, because accelerations have
    both signs in a turn. Friction changes at the ends of rise and return, where nothing accelerates: rows there are left
    out, lest one turn be on one side and the other beyond.
    """
    turns = two_turns(system)
    phi = turns.slow["iron.phi"]
    spans = phases(turns.slow.provenance["parts"]["iron"]["parameters"])
    clear = np.min([abs(phi - math.radians(x.last)) for x in spans], axis=0) > EDGE
    angle, all_figures = np.degrees(phi[clear]), {}
    for name, (force, event, _) in LETS_GO.items():
        f_0, f_2 = (x[clear] for x in turns.parts(force))
        limit = Figure(0.0, "rad/s", 0.0, f"cam speed where {event}")
        if f_0.min() > 0.0:
            ratio = -f_2 / f_0
            top = figure_of_columns(largest, angle, ratio, unit="s2/rad2")
            if not top.value > 0.0:
                raise SetupError(
                    "iron.cam.h = 0 m: a cam without a rise unloads neither follower nor chain"
                )
            limit = figure_of_figures(
                lambda x: x**-0.5, top, unit=limit.unit, meaning=limit.meaning
            )
            all_figures[f"{name}_limit_angle"] = figure_of_columns(
                time_of_largest,
                angle,
                ratio,
                unit="deg",
                meaning=f"cam angle where {event} at that speed",
            )
        all_figures[f"{name}_limit"] = limit
    return all_figures


def first_limit(f: Mapping[str, Figure]) -> tuple[Figure, str]:
    """The lowest of these speeds, and what happens there; one that is not determined may be the lowest."""
    limits = ((f[f"{name}_limit"], event) for name, (_, event, _) in LETS_GO.items())
    return min(limits, key=lambda x: -math.inf if x[0].error is None else x[0].value)
