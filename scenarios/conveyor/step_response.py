"""How the mean speed of the conveyor drive settles after a step of the supply, beside formula (16)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cosim import CONVERGENCE_ORDERS, SimulationError
from cosim.dense import Array as Samples
from cosim.engine.settings import RunSettings
from cosim.metrics import largest, smallest
from cosim.prepared import Prepared
from workbench import Figure, Table
from workbench.figure import figure_of_columns
from workbench.orbits import STEP_MULTIPLES, at_zero_step, figure_of
from workbench.steady import TURN

from .first_order import Machine
from .machine import conveyor_drive
from .orbit import Drive
from .second_order import deviation_left, settling_rates

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


def drifts(machine: Machine, drive: Drive, nu: float) -> tuple[Table, dict[str, Figure]]:
    """How the mean speed comes to nu from the orbit of a speed SLOWER, and what it makes of (16).

    The mean is that of STARTS at crank angles evenly spaced over a turn, which leaves out the ripple;
    how far it is from others is told in % of the way.
    """
    slow = (1.0 - SLOWER) * nu
    step_size, multiples = nu - slow, STEP_MULTIPLES
    stop = duration_of_drift(machine)
    longest = multiples[-1] * TURN / (nu * drive.steps_per_rev)
    count = multiples[-1] * math.ceil(stop / longest)
    h = stop / count
    speeds = speeds_after_supply_step(machine, drive, nu, [k * h for k in multiples], count * h)
    deviations = np.full((2, len(multiples), len(DRIFT)), math.nan)
    for k, each in zip(multiples, speeds):
        t = np.linspace(0.0, count * h, count // k + 1)
        mean = each.mean(axis=0)
        plain, second_order = (nu - step_size * left for left in deviation_left(machine, t))
        for j, x in enumerate((nu, plain, second_order)):
            share = (mean - x) / step_size
            above = figure_of_columns(largest, t, share, unit="1")
            top = max(
                above, figure_of_columns(smallest, t, share, unit="1"), key=lambda x: abs(x.value)
            )
            if DRIFT[j] == "overshoot":  # none where the mean stays below that of the new supply
                top = above._replace(value=max(above.value, 0.0))
            deviations[:, multiples.index(k), j] = 100 * abs(top.value), 100 * (top.error or 0.0)
        if k == 1:
            cells = np.stack([t, mean, plain, second_order, each[0]], axis=1)
    meant = (
        "overshoot of the mean speed after a step of the supply",
        "largest deviation of formula (16) from the mean speed in that step",
        "the same with the term that (16) neglects",
    )
    limits = at_zero_step(deviations[0], CONVERGENCE_ORDERS[drive.algorithm], deviations[1])
    figures = {name: figure_of(limits, j, "%", meant[j]) for j, name in enumerate(DRIFT)}
    slowest = float(-1 / settling_rates(machine).real.max())
    by_16 = "time constant of settling by formula (16)"
    figures["settling_16"] = Figure(machine.J / machine.slope, "s", 0.0, by_16)
    figures["settling"] = Figure(slowest, "s", 0.0, "the same with the term that (16) neglects")
    units = dict.fromkeys(("time", "mean", "mean_16", "mean_whole", "w"), "rad/s") | {"time": "s"}
    return Table.of_rows(cells.tolist(), units), figures


def speeds_after_supply_step(
    machine: Machine, drive: Drive, nu: float, steps: Sequence[float], stop: float
) -> list[Samples]:
    """The crank speed after every step, shape (STARTS, rows), for each step size [s].

    The starts are on the orbit of a speed SLOWER, at crank angles evenly over a turn; the supply is that of nu.
    """
    slow = (1.0 - SLOWER) * nu
    phi = TURN / STARTS * np.arange(STARTS)
    turned = np.exp(2j * phi)
    states = {
        "conveyor.phi": phi,
        "conveyor.w": slow + (machine.speed_ripple(slow) * turned).imag,
        "motor.tau": machine.load_slope * slow + (machine.torque_ripple(slow) * turned).imag,
    }
    cases = {name: np.tile(x, len(steps)) for name, x in states.items()}
    system = conveyor_drive(drive.context.fmus, machine.start(nu))
    settings = RunSettings(stop, steps[0], algorithm=drive.algorithm, record=("conveyor.w",))
    with Prepared.open(system, settings) as prepared:
        ensemble = prepared.map(cases, steps=np.repeat(steps, STARTS).tolist())
    if reason := next(filter(None, ensemble.reasons), ""):
        raise SimulationError(reason, ensemble.result(0))
    first = range(0, len(ensemble), STARTS)
    return [ensemble["conveyor.w"][k : k + STARTS, : ensemble.counts[k]] for k in first]


def duration_of_drift(machine: Machine) -> float:
    """How long the drift of the mean speed is followed [s]: until it has settled and overshot.

    A damped oscillation exp(-a t) cos(b t) overshoots most at t = pi / b, by exp(-pi a / b).
    """
    rate = settling_rates(machine)[0]
    damping, frequency = -float(rate.real), abs(float(rate.imag))
    decayed = float(LASTS * 2 * machine.theta0 * machine.T / machine.J)
    if frequency == 0.0 or math.exp(-math.pi * damping / frequency) < NO_OVERSHOOT:
        return decayed
    return max(decayed, PAST_OVERSHOOT * math.pi / frequency)
