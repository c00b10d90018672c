r"""Drive motor whose torque follows its static characteristic with a lag.

$$ \tau + T\,\dot\tau = \tau_{\mathrm{static}}(\omega) $$

The linear characteristic is exact for a direct-current machine with constant excitation and for a
speed controller with droop:

$$ \tau_{\mathrm{static}} = A - B\,\omega $$

The Kloss characteristic describes an induction machine with the slip $s = 1 - \omega/\omega_s$. It
is zero at $s = 0$, and beyond the synchronous speed the machine brakes:

$$ \tau_{\mathrm{static}} = \frac{2\,\tau_b}{s/s_b + s_b/s} = \frac{2\,\tau_b\,s\,s_b}{s^2 + s_b^2} $$

With the linear characteristic a step of any length is exact. For a speed that changes linearly
from $\omega_0$ to $\omega_1$ over $h$,

$$ \tau(h) = \tau_{\mathrm{static}}(\omega_1)
   + [\tau(0) - \tau_{\mathrm{static}}(\omega_0)]\,e^{-z}
   + B\,(\omega_1 - \omega_0)\,\frac{1 - e^{-z}}{z}, \quad z = h/T $$

Assumptions: one lag represents all electrical transients; no current limit, no saturation, no
backlash. The linear characteristic is used at any speed, even far from the operating point.

The defaults of `A`, `B` and `T` describe a stiff speed-droop drive that turns the default crank
conveyor at 40 rad/s, its electromechanical resonance. The defaults of the Kloss characteristic
describe a 5.5 kW four-pole induction machine behind a 2.4:1 belt. It starts the loaded conveyor
from rest.
"""

from __future__ import annotations

from enum import IntEnum
from math import expm1

from fmukit import Experiment, discrete, real, record
from fmukit.si import AngularVelocity, Power, Ratio, RotationalDamping, Time, Torque

EXPERIMENT = Experiment(stop=1.0, step=1e-3)
FLANGES = {"flange": ("tau", "w")}


class Characteristic(IntEnum):
    """Static speed-torque characteristic of the motor."""

    linear = 0
    kloss = 1


@record
class Kloss:
    tau_b: Torque = real(190.0, "Breakdown torque", positive=True, tunable=True)
    s_b: Ratio = real(0.16, "Breakdown slip", positive=True, tunable=True)
    w_s: AngularVelocity = real(65.4, "Synchronous speed", positive=True, tunable=True)


@record
class Parameters:
    characteristic: Characteristic = discrete(
        Characteristic.linear, "Static characteristic: linear (0) or Kloss (1)"
    )
    A: Torque = real(8000.0, "Torque of the linear characteristic at standstill", tunable=True)
    B: RotationalDamping = real(199.8, "Slope of the linear characteristic", min=0.0, tunable=True)
    T: Time = real(0.0625, "Time constant of the torque", positive=True, tunable=True)
    kloss: Kloss


@record
class Inputs:
    w: AngularVelocity = real(40.0, "Speed of the shaft")


@record
class State:
    tau: Torque = real(8.0, "Torque on the shaft, in the sense of +w", nominal=100.0)


@record
class Outputs:
    tau_static: Torque = real(0.0, "Torque of the static characteristic", feedthrough=("w",))
    P: Power = real(0.0, "Mechanical power given to the shaft", feedthrough=("w",))


def static_torque(p: Parameters, w: float) -> float:
    """Torque of the static characteristic at shaft speed w."""
    if p.characteristic == Characteristic.linear:
        return p.A - p.B * w
    s, s_b = 1.0 - w / p.kloss.w_s, p.kloss.s_b
    return 2.0 * p.kloss.tau_b * s * s_b / (s * s + s_b * s_b)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(tau=(static_torque(p, u.w) - x.tau) / p.T)


def exact(p: Parameters, x: State, u0: Inputs, u1: Inputs, h: float) -> State | None:
    """Exact update with the linear characteristic; None with any other."""
    if p.characteristic != Characteristic.linear:
        return None
    z = h / p.T
    start, end = static_torque(p, u0.w), static_torque(p, u1.w)
    decay = expm1(-z)
    slip = p.B * (u0.w - u1.w) * decay / z
    return State(tau=end + (x.tau - start) * (1.0 + decay) + slip)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    return Outputs(tau_static=static_torque(p, u.w), P=x.tau * u.w)
