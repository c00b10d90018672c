r"""Frame on springs, from which a hammer hangs on a spring with a damper.

$$ f = c\,(Z - z) + d\,(\dot Z - \dot z), \qquad M\,\ddot Z = -c_0\,Z - d_0\,\dot Z - f $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import Force, Length, Mass, TranslationalDamping, TranslationalStiffness, Velocity

EXPERIMENT = Experiment(stop=0.3, step=1e-3)


@record
class Parameters:
    m: Mass = real(20.0, "Mass of the frame", positive=True)
    c_0: TranslationalStiffness = real(8e4, "Stiffness of its springs to the ground", min=0.0)
    d_0: TranslationalDamping = real(50.0, "Damping of these springs", min=0.0)
    c: TranslationalStiffness = real(500.0, "Stiffness of the spring of the hammer", min=0.0)
    d: TranslationalDamping = real(5.0, "Damping of the spring of the hammer", min=0.0)


@record
class Inputs:
    z: Length = real(0.05, "Height of the hammer")
    v: Velocity = real(0.0, "Speed of the hammer, upwards")


@record
class State:
    z_frame: Length = real(0.0, "Height of the frame above its rest", nominal=0.01)
    v_frame: Velocity = real(0.0, "Speed of the frame, upwards", nominal=0.1)


@record
class Outputs:
    f: Force = real(0.0, "Force of the spring on the hammer, upwards", feedthrough=("z", "v"))


def force(p: Parameters, x: State, u: Inputs) -> float:
    """The force of spring and damper on the hammer."""
    return p.c * (x.z_frame - u.z) + p.d * (x.v_frame - u.v)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    ground = p.c_0 * x.z_frame + p.d_0 * x.v_frame
    return State(z_frame=x.v_frame, v_frame=-(ground + force(p, x, u)) / p.m)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    return Outputs(f=force(p, x, u))
