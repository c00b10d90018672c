"""Second-order theory of the crank conveyor: what the ripple makes of the means, and how a mean settles."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .first_order import Machine


class Means(NamedTuple):
    """Means of the steady orbit to second order, in time but for `angle`: speed, its mean over the
    crank angle [rad/s], torque [N.m], and power from the supply, into trough and motor [W].

    The supply turns the field at the speed without load, A / B; what motor and shaft do not share,
    tau (A / B - w) = tau^2 / B, heats the motor. Without ripple they are those of (18) and (24).
    """

    speed: Any
    angle: Any
    torque: Any
    supply: Any
    trough: Any
    motor: Any


def means(machine: Machine, nu: Any, *, ripple: bool = True) -> Means:
    """What ripple makes of the means at the nominal mean speed nu [rad/s], to second order."""
    W, M = (ripple * x(nu) for x in (machine.speed_ripple, machine.torque_ripple))
    lag, a = 2 * machine.T * nu, machine.load_slope
    back = machine.B * lag**2 * abs(W) ** 2 / (2 * nu * (1 + lag**2))
    angle = nu + (back - a * W.imag / 2) / machine.slope
    speed = angle - abs(W) ** 2 / (2 * nu)
    torque = machine.A(nu) - machine.B * speed
    trough = a * (angle + W.imag / 2) * speed
    supply = machine.A(nu) / machine.B * torque
    return Means(speed, angle, torque, supply, trough, (torque**2 + abs(M) ** 2 / 2) / machine.B)


def settling_rates(machine: Machine) -> Any:
    """The two rates of theta0 T nu'' + J nu' + B* nu = A, complex, shape (2,) [1/s]."""
    return np.roots([machine.theta0 * machine.T, machine.J, machine.slope]).astype(complex)


def deviation_left(machine: Machine, t: Any) -> tuple[Any, Any]:
    """What is left of a deviation of the mean speed, at rest at first, after t seconds: by (16), and
    with the term theta0 T nu'' that (16) leaves out.
    """
    rates = settling_rates(machine)
    full = (rates[1] * np.exp(rates[0] * t) - rates[0] * np.exp(rates[1] * t)) / np.diff(rates)[0]
    return np.exp(-t * machine.slope / machine.J), full.real
