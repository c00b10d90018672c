"""Variables of the iron drive: what its parameters, inputs, states and outputs are."""

from __future__ import annotations

from enum import IntEnum
from math import pi, radians, sin

from fmukit import discrete, real, record
from fmukit.si import (
    Acceleration,
    Angle,
    AngularVelocity,
    Energy,
    Force,
    Impulse,
    Inertia,
    Length,
    LinearDensity,
    Mass,
    Ratio,
    RotationalDamping,
    Time,
    Torque,
    TranslationalStiffness,
    Velocity,
)

TAU = ("tau",)


class Wrap(IntEnum):
    """Where the run of the chain meets the sprocket."""

    top = 0
    tangent = 1


class Side(IntEnum):
    """Side of the iron on which the spring pulls."""

    below = 1
    above = -1


class OnInvalid(IntEnum):
    """What to do where the follower lifts off or the chain goes slack."""

    stop = 0
    warn = 1


class Motion(IntEnum):
    """Motion of the iron."""

    dwell = 0
    up = 1
    down = 2
    stuck = 3


@record
class Cam:
    R_b: Length = real(
        0.100, "Distance from the cam's axis to the roller, iron down", positive=True
    )
    h: Length = real(
        0.020, "Increase of the distance from the cam's axis to the roller, iron up", min=0.0
    )
    rise: Angle = real(radians(100.0), "Cam angle of the rise, iron going up", positive=True)
    top: Angle = real(radians(60.0), "Cam angle of the top dwell", min=0.0)
    ret: Angle = real(radians(80.0), "Cam angle of the return, iron going down", positive=True)
    J: Inertia = real(0.0125, "Moment of inertia of the cam", positive=True)
    m: Mass = real(2.5, "Mass of the cam", positive=True)
    r: Length = real(0.008, "Distance of the cam's centre of mass from its axis", min=0.0)
    gamma: Angle = real(0.6, "Angle of the cam's centre of mass at phi = 0")


@record
class Rocker:
    L: Length = real(0.150, "Distance between the axes of cam and rocker", positive=True)
    l: Length = real(0.090, "Length of the rocker's small arm, to the roller", positive=True)
    l_K: Length = real(0.280, "Length of the rocker's large arm, to the link", positive=True)
    alpha0: Angle = real(2.38, "Angle of the large arm with the small arm towards the cam's axis")
    J: Inertia = real(0.025, "Moment of inertia of the rocker about its axis", positive=True)
    m: Mass = real(1.2, "Mass of the rocker", positive=True)
    r: Length = real(0.090, "Distance of the rocker's centre of mass from its axis", min=0.0)
    gamma: Angle = real(0.10, "Angle of the rocker's centre of mass from the large arm")


@record
class Link:
    l: Length = real(0.200, "Length of the link", positive=True)
    m: Mass = real(0.25, "Mass of the link", positive=True)
    J: Inertia = real(
        0.25 * 0.2**2 / 12, "Moment of inertia of the link about its centre", positive=True
    )


@record
class Chain:
    l: Length = real(0.700, "Length of the chain", positive=True)
    rho: LinearDensity = real(0.70, "Mass of the chain per unit length", positive=True)


@record
class Sprocket:
    A: Length = real(0.280, "Height of the sprocket's axis above the rocker's", positive=True)
    C: Length = real(0.400, "Distance of the sprocket's axis left of the rocker's", positive=True)
    R: Length = real(0.0127 / (2 * sin(pi / 20)), "Pitch radius of the sprocket", positive=True)
    J: Inertia = real(6.0e-4, "Moment of inertia of the sprocket", positive=True)


@record
class Iron:
    m: Mass = real(4.0, "Mass of the iron", positive=True)


@record
class Spring:
    c: TranslationalStiffness = real(300.0, "Stiffness of the spring", min=0.0)
    e_0: Length = real(0.080, "Stretch of the spring with the iron down")
    m: Mass = real(0.15, "Mass of the spring", min=0.0)
    side: Side = discrete(Side.below, "Spring below (1) or above the iron (-1)")


@record
class Friction:
    K_down: Ratio = real(
        -0.0747, "Ratio of friction to load with the iron going down", tunable=True
    )
    K_up: Ratio = real(0.089, "Ratio of friction to load with the iron going up", tunable=True)


@record
class Reducer:
    i_g: Ratio = real(36.0, "Gear ratio, speed of the motor over speed of the cam", positive=True)
    J: Inertia = real(
        3.0e-4, "Moment of inertia of rotor and reducer, at the motor's shaft", positive=True
    )


@record
class Follower:
    lifts: bool = discrete(False, "The follower may lift off the cam, fly and land on it")
    e: Ratio = real(
        0.3,
        "Restitution of a landing: impulse of rebound over impulse of approach",
        min=0.0,
        max=1.0,
        tunable=True,
    )
    v: Velocity = real(
        1e-3,
        "Rebound speed below which the follower stays on the cam",
        positive=True,
        tunable=True,
    )


@record
class Joints:
    cam: RotationalDamping = real(0.0, "Viscous friction of the cam's shaft", min=0.0, tunable=True)
    rocker: RotationalDamping = real(
        0.0, "Viscous friction of the rocker's axis", min=0.0, tunable=True
    )
    link: RotationalDamping = real(
        0.0, "Viscous friction between rocker and link", min=0.0, tunable=True
    )
    sprocket: RotationalDamping = real(
        0.0, "Viscous friction of the sprocket's axis", min=0.0, tunable=True
    )


@record
class Parameters:
    wrap: Wrap = discrete(
        Wrap.top, "The chain meets the sprocket at its top (0) or tangentially (1)"
    )
    on_invalid: OnInvalid = discrete(
        OnInvalid.stop,
        "If the follower would have to pull or the chain to push: stop (0) or warn (1)",
        tunable=True,
    )
    g: Acceleration = real(9.80665, "Gravity", positive=True)
    reducer: Reducer
    cam: Cam
    rocker: Rocker
    link: Link
    chain: Chain
    sprocket: Sprocket
    iron: Iron
    spring: Spring
    friction: Friction
    follower: Follower
    joints: Joints


@record
class Inputs:
    tau: Torque = real(0.1, "Torque of the motor at its shaft, in the sense of +phi")


@record
class State:
    phi: Angle = real(-pi / 3, "Angle of the cam, 0 where the rise begins", nominal=1.0)
    w_cam: AngularVelocity = real(0.0, "Speed of the cam", nominal=1.0)
    E_friction: Energy = real(0.0, "Energy dissipated by friction in the guide", nominal=1.0)
    direction: int = discrete(
        0,
        "Sense of motion of the cam, in flight of the rocker: 1 along its angle, -1 against it, 0 stuck",
    )
    valid: bool = discrete(True, "Follower and chain are loaded, so the equations hold")
    gap: Angle = real(0.0, "Angle by which the rocker is off the cam", min=0.0, nominal=0.1)
    w_gap: AngularVelocity = real(
        0.0, "Rate of the angle by which the rocker is off the cam", nominal=1.0
    )
    E_joints: Energy = real(0.0, "Energy dissipated by friction in the joints", nominal=1.0)
    t_flight: Time = real(0.0, "Total time that the follower has been off the cam", nominal=1.0)
    E_landing: Energy = real(0.0, "Energy lost between cam and follower in landings", held=True)
    v_landing: Velocity = real(
        0.0, "Speed of the last landing, along the contact's normal", held=True
    )
    S_landing: Impulse = real(
        0.0, "Impulse of the cam on the follower at the last landing", held=True
    )
    landings: int = discrete(0, "Number of landings")
    flying: bool = discrete(False, "The follower is off the cam")


@record
class Outputs:
    w: AngularVelocity = real(0.0, "Speed of the motor's shaft")
    alpha: Angle = real(0.0, "Angle of the rocker's large arm")
    beta: Angle = real(0.0, "Angle of the link and of the chain's run to the sprocket")
    H: Length = real(0.0, "Hanging length of the chain")
    lift: Length = real(0.0, "Lift of the iron")
    v: Velocity = real(0.0, "Velocity of the iron, upwards")
    a: Acceleration = real(0.0, "Acceleration of the iron, upwards", feedthrough=TAU)
    tau_cam: Torque = real(
        0.0,
        "Torque at the cam: geared motor torque less the inertia torque of rotor and reducer",
        feedthrough=TAU,
    )
    T_iron: Force = real(0.0, "Pull of the chain on the iron", feedthrough=TAU)
    T_hang: Force = real(
        0.0, "Pull of the chain on the sprocket, on the iron's side", feedthrough=TAU
    )
    T_span: Force = real(
        0.0, "Pull of the chain on the sprocket, on the link's side", feedthrough=TAU
    )
    M_rocker: Torque = real(
        0.0, "Torque of the cam on the rocker, negative while they touch", feedthrough=TAU
    )
    N: Force = real(0.0, "Force between cam and follower", feedthrough=TAU)
    pressure: Angle = real(0.0, "Pressure angle between cam and follower, signed")
    E_kin: Energy = real(0.0, "Kinetic energy of the drive")
    E_pot: Energy = real(0.0, "Potential energy of the drive's weights and spring")
    motion: Motion = discrete(Motion.dwell, "Motion of the iron")
    top_dwell: bool = discrete(False, "The cam is in its top dwell")
    alpha_1: Ratio = real(0.0, "First derivative of alpha by phi, with the follower on the cam")
    alpha_2: Ratio = real(0.0, "Second derivative of alpha by phi, with the follower on the cam")
    beta_1: Ratio = real(0.0, "First derivative of beta by phi, with the follower on the cam")
    beta_2: Ratio = real(0.0, "Second derivative of beta by phi, with the follower on the cam")
    H_1: Length = real(
        0.0, "First derivative of H by phi, per radian, with the follower on the cam"
    )
    H_2: Length = real(
        0.0, "Second derivative of H by phi, per radian squared, with the follower on the cam"
    )
    A_1: Inertia = real(0.0, "Coefficient of the cam's acceleration in the equation of motion")
    B_1: Inertia = real(0.0, "Coefficient of the cam's squared speed in the equation of motion")
    C_1: Torque = real(0.0, "Torque of weights, spring and friction in the equation of motion")
