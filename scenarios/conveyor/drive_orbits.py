"""Steady orbits of the coupled drive: where they begin by theory, and with which steps they are sought.

At a speed nu the motor's line is set for the mean speed nu, and motor and conveyor are coupled until their orbit is steady.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import SetupError
from workbench.orbits import STEP_MULTIPLES, Orbit
from workbench.steady import TURN

from .first_order import Machine, longest_step

ORBIT_ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
ORBIT_STATES = ("conveyor.w", "motor.tau")
CRANK_TURN = Orbit("conveyor.phi", rate="conveyor.w", states=ORBIT_STATES, worst="tau2")
#: The longest stable step of a machine, which is the same at all speeds of a sweep.
LONGEST_STEP = lru_cache(4096)(longest_step)
#: Fewest steps per revolution: rows for orders up to 6, so that order 2 is not aliased by the next ones.
FEWEST_STEPS = 18


def near(machine: Machine, nu: Any) -> NDArray[np.float64]:
    """Return the states at the crank angle 0 of the orbits of first-order theory, shape (..., 2)."""
    speed = nu + machine.speed_ripple(nu).imag
    torque = machine.load_slope * nu + machine.torque_ripple(nu).imag
    return np.stack(np.broadcast_arrays(speed, torque), axis=-1)


def require_enough_steps_per_rev(
    o: Any, machine: Machine, mean_speed: float, coarsening: int = 1
) -> None:
    """Raise SetupError for too few steps per revolution to fit orders or to stay stable at a mean speed [rad/s].

    The longest steps are `coarsening` times as long as those that `o` has by its options.
    """
    setting, most = f"{o.steps_per_rev} steps per revolution", STEP_MULTIPLES[-1]
    longest = LONGEST_STEP(machine, o.algorithm)
    fewest = coarsening * TURN / (mean_speed * longest)
    why = f", because runs with {coarsening} times fewer give the errors" if coarsening > 1 else ""
    if o.steps_per_rev // coarsening < FEWEST_STEPS:
        raise SetupError(f"{setting} must be at least {coarsening * FEWEST_STEPS}{why}")
    if o.steps_per_rev <= fewest:
        slowest = mean_speed * fewest / o.steps_per_rev
        raise SetupError(
            f"{setting} are unstable with {o.algorithm} at {mean_speed:g} rad/s: the step must stay below "
            f"{longest / coarsening:.3g} s, and a revolution takes {TURN / mean_speed:.4g} s{why}. Take "
            f"{most * math.ceil((math.floor(fewest) + 1) / most)} or more steps per revolution, or a speed above "
            f"{slowest:.3g} rad/s"
        )
    if o.steps_per_rev % most:
        raise SetupError(
            f"{setting} must be a multiple of {most}: steps that are exactly 2 and {most} times longer give the "
            f"errors. Take {most * math.ceil(o.steps_per_rev / most)}"
        )
