r"""Direct-current motor with constant excitation, fed by a voltage.

$$ L\,\dot i + R\,i = v - k\,\omega, \qquad \tau = k\,i $$

The same constant $k$ relates torque to current and induced voltage to speed. The motor therefore
delivers to its shaft the power that it takes from the source, less the heat of the winding and the
power stored in the field of the armature:

$$ v\,i = \tau\,\omega + R\,i^2 + \frac{\mathrm d}{\mathrm dt}\,\tfrac12 L\,i^2 $$

A step of any length is exact. For a voltage and a speed that change linearly from $v_0$, $\omega_0$
to $v_1$, $\omega_1$ over $h$, with the steady current $i_s = (v - k\,\omega)/R$ at constant $v$ and
$\omega$,

$$ i(h) = i_{s1} + (i(0) - i_{s0})\,e^{-z} - (i_{s1} - i_{s0})\,\frac{1 - e^{-z}}{z},
   \quad z = \frac{h\,R}{L} $$

Assumptions: constant flux, so no field weakening and no armature reaction; a winding whose
resistance does not change with temperature and whose iron does not saturate; no friction, no iron
or brush losses, no commutator ripple. The inertia of the rotor is counted with the driven machine.

The defaults describe a 48 V, 0.5 kW motor that is switched on at 200 rad/s.
"""

from __future__ import annotations

from math import expm1

from fmukit import Experiment, real, record
from fmukit.si import (
    AngularVelocity,
    Current,
    ElectricalTorqueConstant,
    Energy,
    Inductance,
    Power,
    Resistance,
    Torque,
    Voltage,
)

EXPERIMENT = Experiment(stop=0.05, step=1e-4)
FLANGES = {"flange": ("tau", "w")}


@record
class Parameters:
    R: Resistance = real(0.5, "Armature resistance", positive=True, tunable=True)
    L: Inductance = real(0.002, "Armature inductance", positive=True)
    k: ElectricalTorqueConstant = real(
        0.2,
        "Torque per current, and induced voltage per speed",
        min=0.0,
        tunable=True,
    )


@record
class Inputs:
    v: Voltage = real(48.0, "Voltage of the source")
    w: AngularVelocity = real(200.0, "Speed of the shaft")


@record
class State:
    i: Current = real(0.0, "Armature current", nominal=10.0)


@record
class Outputs:
    tau: Torque = real(0.0, "Torque on the shaft, in the sense of +w")
    P: Power = real(0.0, "Mechanical power given to the shaft", feedthrough=("w",))
    P_el: Power = real(0.0, "Electrical power taken from the source", feedthrough=("v",))
    P_loss: Power = real(0.0, "Power lost as heat in the winding")
    E_mag: Energy = real(0.0, "Magnetic energy of the armature")


def settled_current(p: Parameters, u: Inputs) -> float:
    """The current that settles at a constant voltage and speed."""
    return (u.v - p.k * u.w) / p.R


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(i=(u.v - p.k * u.w - p.R * x.i) / p.L)


def exact(p: Parameters, x: State, u0: Inputs, u1: Inputs, h: float) -> State:
    """Exact update for a voltage and a speed that change linearly."""
    z = h * p.R / p.L
    start, end = settled_current(p, u0), settled_current(p, u1)
    decay = expm1(-z)
    return State(i=end + (x.i - start) * (1.0 + decay) + (end - start) * decay / z)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    tau = p.k * x.i
    return Outputs(
        tau=tau,
        P=tau * u.w,
        P_el=u.v * x.i,
        P_loss=p.R * x.i * x.i,
        E_mag=p.L * x.i * x.i / 2,
    )
