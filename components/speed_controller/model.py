r"""Speed controller with a torque limit: PI with back-calculation against windup.

With the deviation $e = \omega_s - \omega$ of the speed from its setpoint,

$$ \tau_{\mathrm{free}} = K\,e + \tau_i, \qquad
   \tau = \min\left(\max(\tau_{\mathrm{free}}, -\tau_{\max}), \tau_{\max}\right) $$

$$ \dot\tau_i = \frac{K}{T_i}\,e + \frac{\tau - \tau_{\mathrm{free}}}{T_t} $$

The last term acts only at the limit. With the time constant $T_t$ it drives the integral part back
until $\tau_{\mathrm{free}}$ exceeds the limit by no more than $K e\,T_t/T_i$. The torque therefore
leaves its limit as soon as the deviation has nearly vanished, however long it was there. Without
this term (`antiwindup = false`) the integral part keeps growing.

With an inertia $J$ and no limit, the loop is a second-order system,

$$ J\,\ddot\omega + K\,\dot\omega + \frac{K}{T_i}\,\omega = K\,\dot\omega_s + \frac{K}{T_i}\,\omega_s,
   \qquad \omega_0 = \sqrt{\frac{K}{T_i J}}, \quad D = \frac12\sqrt{\frac{K\,T_i}{J}} $$

Assumptions: continuous in time, without sampling or delay; a measured speed without noise or
filter; an actuator that delivers the requested torque.

With the defaults the shaft stays 5 rad/s below its setpoint, so the torque grows to its limit.
"""

from __future__ import annotations

from fmukit import Experiment, discrete, real, record
from fmukit.si import AngularVelocity, RotationalDamping, Time, Torque

EXPERIMENT = Experiment(stop=2.0, step=1e-2)
FLANGES = {"flange": ("tau", "w")}


@record
class Parameters:
    K: RotationalDamping = real(
        2.0, "Gain: torque per deviation of the speed", positive=True, tunable=True
    )
    T_i: Time = real(0.5, "Integral time", positive=True, tunable=True)
    tau_max: Torque = real(
        30.0, "Limit of the torque in both directions", positive=True, tunable=True
    )
    T_t: Time = real(0.1, "Time constant of the back-calculation", positive=True, tunable=True)
    antiwindup: bool = discrete(
        True, "Back-calculation of the integral part at the torque limit", tunable=True
    )


@record
class Inputs:
    w_ref: AngularVelocity = real(40.0, "Setpoint of the speed")
    w: AngularVelocity = real(35.0, "Measured speed")


@record
class State:
    tau_i: Torque = real(0.0, "Integral part of the torque", nominal=10.0)


@record
class Outputs:
    tau: Torque = real(
        0.0, "Setpoint of the torque on the shaft, in the sense of +w", feedthrough=("w_ref", "w")
    )
    tau_free: Torque = real(
        0.0, "Setpoint of the torque without the limit", feedthrough=("w_ref", "w")
    )
    e: AngularVelocity = real(
        0.0, "Deviation: setpoint minus measured speed", feedthrough=("w_ref", "w")
    )


def limited_and_free_torque(p: Parameters, x: State, u: Inputs) -> tuple[float, float]:
    """The torque with its limit, and without it."""
    free = p.K * (u.w_ref - u.w) + x.tau_i
    return min(max(free, -p.tau_max), p.tau_max), free


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    tau, free = limited_and_free_torque(p, x, u)
    rise = p.K / p.T_i * (u.w_ref - u.w)
    return State(tau_i=rise + (tau - free) / p.T_t if p.antiwindup else rise)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    tau, free = limited_and_free_torque(p, x, u)
    return Outputs(tau=tau, tau_free=free, e=u.w_ref - u.w)
