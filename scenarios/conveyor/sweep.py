"""Options of the questions that sweep the speed of a linear motor, and how they begin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import workbench
from workbench import Bench, option

from .features import ALGORITHMS, Line, Setup
from .first_order import SETS, Machine
from .machine import followed
from .questions.resonance import ladder

HELD = ("motor.characteristic", "motor.A", "motor.tau", "conveyor.phi", "conveyor.w")


@dataclass(frozen=True, kw_only=True)
class Swept(workbench.Options):
    """The machine, its speeds, and how it is run."""

    set: str = option("A", "parameter set", choices=SETS)
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)
    algorithm: str = option("strang", "coupling algorithm", choices=ALGORITHMS)
    speeds: tuple[float, ...] = option(
        (), "speeds of the sweep, those of the set by default", "rad/s", above=0.0
    )


class Sweep(NamedTuple):
    """A machine, how it is run, its speeds [rad/s], and how many times fewer steps there are."""

    machine: Machine
    setup: Setup
    nus: Sequence[float]
    coarser: Sequence[int]


def begun(o: Swept, bench: Bench, speeds: Mapping[str, str]) -> Sweep:
    """The requested sweep; raises SetupError for what FMUs, theory or coupling refuse."""
    machine = followed(bench.fmus, SETS[o.set], o.start)
    setup = Setup(bench, o.start, o.algorithm, o.steps_per_rev)
    nus = o.speeds or tuple(float(nu) for nu in speeds[o.set].split(","))
    for nu in nus:
        setup.check(machine, nu)
    line = Line(lambda nu: (machine, nu), nus[0], nus[-1])
    return Sweep(machine, setup, nus, ladder(setup, line, nus[0]))
