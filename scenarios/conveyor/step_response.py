"""How the mean speed of the conveyor drive settles after a step of the supply, beside formula (16)."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from functools import partial
from itertools import islice

import numpy as np

import cosim
from cosim import System
from workbench import Figure, Table
from workbench.measure import Measured, Samples, largest, smallest
from workbench.periodic import TURN

from .features import converged
from .first_order import Machine
from .machine import WIRES
from .orbits import OrbitRunner
from .second_order import drift, settling

DRIFT = ("overshoot", "off_16", "off_whole")
#: Starts at even crank angles whose mean leaves out the ripple of the orders 1 to 7; a convention.
STARTS = 8
#: Share by which the speed is lower before the step of the supply; a convention, small for a linear response.
SLOWER = 0.05
#: Time constants of the envelope for which the drift is followed; exp(-3) = 5 % of it are left.
LASTS = 3.0
#: Length of the drift over the time at which its overshoot is largest; a convention, so that it lies inside.
PAST_OVERSHOOT = 1.1
#: Overshoot, as a share of the step, that is too small to make the drift longer; below all stated errors.
NO_OVERSHOOT = 1e-6


def drifts(
    machine: Machine, runner: OrbitRunner, multiples: Sequence[int], nu: float
) -> tuple[Table, dict[str, Figure]]:
    """How the mean speed comes to nu from the orbit of a speed SLOWER, and what it makes of (16).

    The mean is that of STARTS at crank angles evenly spaced over a turn, which leaves out the ripple;
    how far it is from others is told in % of the way.
    """
    slow = (1.0 - SLOWER) * nu
    W, M, step_size = machine.speed_ripple(slow), machine.torque_ripple(slow), nu - slow
    stop = drift_time(machine)
    longest = multiples[-1] * TURN / (nu * runner.steps_per_rev)
    count = multiples[-1] * math.ceil(stop / longest)
    h = stop / count
    systems = []
    for phi in TURN / STARTS * np.arange(STARTS):
        turned = cmath.exp(2j * phi)
        state = {
            "conveyor.phi": phi,
            "conveyor.w": slow + (W * turned).imag,
            "motor.tau": machine.load_slope * slow + (M * turned).imag,
        }
        start = {**machine.start(nu), **runner.start, **state}
        systems.append(System(runner.context.fmus, WIRES, start))
    tasks = [(system, k * h, count // k) for k in multiples for system in systems]
    runs = runner.context.each(partial(speeds, runner.algorithm), tasks, "drift")
    deviations: dict[str, list[Measured | str]] = {name: [] for name in DRIFT}
    for k in multiples:
        each = list(islice(runs, STARTS))
        t = np.linspace(0.0, count * h, count // k + 1)
        mean = np.mean(each, axis=0)
        plain, second_order = (nu - step_size * left for left in drift(machine, t))
        for name, x in zip(deviations, (nu, plain, second_order)):
            share = (mean - x) / step_size
            above, below = largest(t, share), smallest(t, share)
            top = max(above, below, key=lambda it: abs(it.value))
            if name == "overshoot":  # none where the mean speed stays below that of the new supply
                top = above._replace(value=max(above.value, 0.0))
            deviations[name].append(Measured(100 * abs(top.value), 100 * top.error))
        if k == 1:
            cells = np.stack([t, mean, plain, second_order, each[0]], axis=1)
    meant = {
        "overshoot": "overshoot of the mean speed after a step of the supply",
        "off_16": "largest deviation of formula (16) from the mean speed in that step",
        "off_whole": "the same with the term that (16) neglects",
    }
    order = cosim.CONVERGENCE_ORDERS[runner.algorithm]
    all_figures = {
        name: converged(runs, order, "%", meant[name]) for name, runs in deviations.items()
    }
    all_figures["settling_16"] = Figure(
        machine.J / machine.slope, "s", 0.0, "time constant of settling by formula (16)"
    )
    all_figures["settling"] = Figure(
        float(-1 / settling(machine).real.max()),
        "s",
        0.0,
        "the same with the term that (16) neglects",
    )
    units = dict.fromkeys(("time", "mean", "mean_16", "mean_whole", "w"), "rad/s") | {"time": "s"}
    return Table.of_rows(cells.tolist(), units), all_figures


def drift_time(machine: Machine) -> float:
    """How long the drift of the mean speed is followed [s]: until it has settled and overshot.

    A damped oscillation exp(-a t) cos(b t) overshoots most at t = pi / b, by exp(-pi a / b).
    """
    rate = settling(machine)[0]
    damping, frequency = -float(rate.real), abs(float(rate.imag))
    decayed = LASTS * 2 * machine.theta0 * machine.T / machine.J
    if frequency == 0.0 or math.exp(-math.pi * damping / frequency) < NO_OVERSHOOT:
        return decayed
    return max(decayed, PAST_OVERSHOOT * math.pi / frequency)


def speeds(algorithm: str, task: tuple[System, float, int]) -> Samples:
    """The crank speed after every step of a run."""
    system, h, count = task
    run = cosim.run(system, stop=count * h, step=h, algorithm=algorithm, record=("conveyor.w",))
    return run["conveyor.w"]
