"""The steady orbit of motor and conveyor at one mean speed, run until it is steady."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

import cosim
from cosim import Result
from cosim.system import Value

from .. import fmus
from ..orders import last_revolutions, mean_speed, order
from ..theory import Machine

SETTLED = 1e-7
WINDOW = 4
STEADY = 1e-4
RECORD = ("motor.tau", "conveyor.phi")


class Setup(NamedTuple):
    """How machines are run: start values that they do not know, algorithm, steps, processes."""

    start: Mapping[str, Value]
    algorithm: str
    steps_per_rev: int
    jobs: int


class Case(NamedTuple):
    """A machine at its nominal mean speed [rad/s], run with `coarser` times fewer steps."""

    machine: Machine
    nu: float
    setup: Setup
    coarser: int = 1


class Orbit(NamedTuple):
    """Order 2 of the motor torque [N.m], the mean speed [rad/s], how far from steady they are.

    `change` is how far the order 2 moved, relative to itself, between the last two windows of
    WINDOW revolutions; where the crank does not turn all the way it is inf, the rest nan.
    """

    torque: complex
    speed: float
    change: float


def settling(machine: Machine, nu: float) -> int:
    """Revolutions until first-order theory leaves SETTLED of the deviation from the orbit."""
    return math.ceil(math.log(1 / SETTLED) / machine.decay_rate * nu / (2 * math.pi))


def run(case: Case, record: Sequence[str]) -> Result:
    """Couple motor and conveyor from near the orbit until two windows after it is steady."""
    machine, nu, setup, coarser = case
    steps_per_rev = setup.steps_per_rev // coarser
    h = 2 * math.pi / (nu * steps_per_rev)
    steps = (settling(machine, nu) + 2 * WINDOW) * steps_per_rev
    return cosim.run(
        fmus.conveyor_drive({**machine.start(nu), **setup.start}),
        stop=steps * h,
        step=h,
        algorithm=setup.algorithm,
        record=record,
    )


def simulate(case: Case) -> Orbit:
    """What the last two windows of a run tell."""
    t, tau, phi = run(case, RECORD).data.T
    late = last_revolutions(phi, 2 * WINDOW)
    if not (np.diff(phi[late]) > 0.0).all() or phi[-1] < 4 * math.pi * WINDOW:
        return Orbit(complex(math.nan, math.nan), math.nan, math.inf)
    last = last_revolutions(phi, WINDOW)
    before = late & ~last
    torque = order(phi[last], tau[last], 2)
    change = abs(order(phi[before], tau[before], 2) / torque - 1.0)
    return Orbit(torque, mean_speed(t, phi, WINDOW), change)
