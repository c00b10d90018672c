"""Variables of the orientator: what its parameters, inputs, states and outputs are."""

from __future__ import annotations

from enum import IntEnum
from math import pi

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
    Mass,
    Ratio,
    Time,
    TranslationalStiffness,
    Velocity,
)


class Stage(IntEnum):
    """Stage of the orientation."""

    falling = 0
    joint = 1
    turning = 2
    released = 3
    oriented = 4
    jammed = 5
    waiting = 6


class Reason(IntEnum):
    """Why the product does not move."""

    none = 0
    held_in_chute = 1
    catcher_stopped = 2
    rim_stayed_at_hook_contact = 3
    sliding_stopped_in_turning = 4
    turning_stopped = 5
    catcher_back_at_stop = 6
    rotation_stopped_after_release = 7
    sliding_stopped_after_release = 8


@record
class Cup:
    d: Length = real(0.040, "Diameter of the cup", positive=True)
    h: Length = real(0.048, "Height of the cup's cylindrical part", positive=True)
    l: Length = real(0.043, "Distance of the cup's centre of mass from its rim", positive=True)
    m: Mass = real(0.040, "Mass of the cup", positive=True)
    J: Inertia = real(
        2.4e-5, "Moment of inertia of the cup about its centre of mass", positive=True
    )


@record
class Catcher:
    l: Length = real(0.180, "Length of the catcher's arm, pivot to inner corner", positive=True)
    h: Length = real(0.010, "Length of the catcher's hook", positive=True)
    m: Mass = real(0.016, "Mass of the catcher", positive=True)
    J: Inertia = real(2.2e-4, "Moment of inertia of the catcher about its pivot", positive=True)
    phi: Angle = real(pi / 6, "Angle of the catcher at its stop", positive=True, max=pi / 2)


@record
class Spring:
    c: TranslationalStiffness = real(
        14.0, "Stiffness of the catcher's spring, which acts at mid-arm", min=0.0
    )


@record
class Chute:
    R: Length = real(0.270, "Distance of the chute's wall from the rotor's axis", positive=True)
    H: Length = real(0.040, "Height of the fall in the chute", positive=True)
    mu: Ratio = real(0.35, "Friction coefficient between cup and wall", min=0.0, tunable=True)


@record
class Neglected:
    mu_side: Ratio = real(
        0.0, "Friction coefficient between cup and side walls", min=0.0, tunable=True
    )
    J_a: Inertia = real(
        1.3e-5,
        "Moment of inertia of the cup about its axis, for friction at the side walls",
        positive=True,
    )
    mu_catcher: Ratio = real(
        0.0, "Friction coefficient between cup and catcher", min=0.0, max=1.0, tunable=True
    )
    rim: Length = real(
        0.0, "Radius of the rim's edge, on which the cup turns in the catcher's corner", min=0.0
    )
    creep: Velocity = real(
        1e-3,
        "Speed far above which friction at side walls and catcher is Coulomb friction",
        positive=True,
    )
    anchored: bool = discrete(False, "The spring pulls towards a fixed point instead of vertically")
    length: Length = real(
        0.1, "Length of the anchored spring with the catcher at its stop", positive=True
    )


@record
class Parameters:
    cup: Cup
    catcher: Catcher
    spring: Spring
    chute: Chute
    neglected: Neglected
    g: Acceleration = real(9.81, "Gravity", positive=True)


@record
class Inputs:
    w: AngularVelocity = real(40 * pi / 30, "Speed of the rotor, in either sense")
    release: bool = discrete(True, "A rising edge, or true at the start, drops a product")


@record
class State:
    phi1: Angle = real(pi / 6, "Angle of the catcher", nominal=1.0)
    w1: AngularVelocity = real(0.0, "Speed of the catcher", nominal=10.0)
    phi2: Angle = real(1.5 * pi, "Angle of the product, from 3 pi/2 to 5 pi/2", nominal=1.0)
    w2: AngularVelocity = real(0.0, "Speed of the product", nominal=10.0)
    xc: Length = real(
        0.0,
        "Position of the product's centre of mass, outwards from the pivot",
        nominal=0.1,
        follows=True,
    )
    yc: Length = real(
        0.007, "Position of the product's centre of mass, down from the pivot", nominal=0.1
    )
    vxc: Velocity = real(
        0.0, "Velocity of the product's centre of mass, outwards", nominal=1.0, follows=True
    )
    vyc: Velocity = real(0.0, "Velocity of the product's centre of mass, down", nominal=1.0)
    stage: Stage = discrete(Stage.waiting, "Stage of the orientation")
    reason: Reason = discrete(Reason.none, "Why the product does not move")
    contact: bool = discrete(True, "The product slides on the wall")
    oriented: int = discrete(0, "Number of products oriented")
    jammed: int = discrete(0, "Number of products jammed")
    missed: int = discrete(0, "Number of rising edges of release with a product still under way")
    since: Time = real(0.0, "Time at which the present stage began", held=True)
    t_falling: Time = real(0.0, "Duration of stage falling, 0 until it is over", held=True)
    t_joint: Time = real(0.0, "Duration of stage joint, 0 until it is over", held=True)
    t_turning: Time = real(0.0, "Duration of stage turning, 0 until it is over", held=True)
    t_released: Time = real(0.0, "Duration of stage released, 0 until it is over", held=True)
    orientation_time: Time = real(
        0.0, "Orientation time of the last product, 0 if it jammed", held=True
    )
    S_x: Impulse = real(
        0.0, "Impulse on the catcher's corner as the product lands, outwards", held=True
    )
    S_y: Impulse = real(
        0.0, "Impulse on the catcher's corner as the product lands, down", held=True
    )
    S_k: Impulse = real(0.0, "Impulse on the wall as the product lands", held=True)
    P_B: Impulse = real(0.0, "Impulse on the hook as the product lies down on it", held=True)
    P_K: Impulse = real(0.0, "Impulse on the wall as the product lies down on the hook", held=True)


@record
class Outputs:
    v_s: Velocity = real(0.0, "Sliding speed of the product on the wall, down")
    N_K: Force = real(0.0, "Force of the wall on the product, a pull if < 0", feedthrough=("w",))
    N_B: Force = real(0.0, "Force of the hook on the product, a pull if < 0", feedthrough=("w",))
    E_kin: Energy = real(0.0, "Kinetic energy of catcher and product relative to the rotor")
    E_pot: Energy = real(0.0, "Potential energy of the product's weight and the spring")
    u_phi2: Ratio = real(0.0, "Transfer function d(phi2)/d(phi1) in stage joint, else 0")
    u_xc1: Length = real(0.0, "Transfer function d(xc)/d(phi1) in stages joint and turning, else 0")
    u_xc2: Length = real(0.0, "Transfer function d(xc)/d(phi2) in stage turning, else 0")
    u_yc1: Length = real(0.0, "Transfer function d(yc)/d(phi1) in stages joint and turning, else 0")
    u_yc2: Length = real(0.0, "Transfer function d(yc)/d(phi2) in stage turning, else 0")
    u_yK1: Length = real(
        0.0, "Derivative by phi1 of the wall contact's height in stages joint and turning, else 0"
    )
    u_yK2: Length = real(
        0.0, "Derivative by phi2 of the wall contact's height in stage turning, else 0"
    )
