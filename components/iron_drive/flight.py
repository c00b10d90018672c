"""How the follower of the iron drive flies and lands: the rocker without the cam, and the impact.

None of it is in the paper: the equations are derived in *Flight and landing* of `page.md`.
"""

from __future__ import annotations

from collections import namedtuple

from fmukit import replace
from fmukit.runtime.jet import Jet, sqrt

from .declarations import Parameters, State
from .dynamics import Dynamics
from .geometry import Position, cam_weight, position, slip_per_cam_speed

#: Position, speed and torque along the angle that the iron follows.
IronMotion = namedtuple("IronMotion", "position w M")


def shaft_inertia(p: Parameters) -> float:
    """Moment of inertia J_0 of cam, reducer and rotor at the cam's shaft: see *Flight*."""
    return p.reducer.J * p.reducer.i_g * p.reducer.i_g + p.cam.J


def cam_acceleration(p: Parameters, x: State, d: Dynamics, M: float) -> float:
    """Acceleration of the cam, which in flight is coupled only to the motor: first equation of *Flight*."""
    if not x.flying:
        return d.eps
    return (M - cam_weight(p, x.phi) - p.joints.cam * x.w_cam) / shaft_inertia(p)


def along_followed_angle(p: Parameters, x: State, at: Position, M: float) -> IronMotion:
    """Position, speed and torque along the angle that the iron follows: the cam's, in flight the rocker's.

    With them the equation of motion becomes the second equation of *Flight*.
    """
    if not x.flying:
        return IronMotion(at, x.w_cam, M)
    along_rocker = at._replace(
        slope=-1, touch=0.0, alpha=Jet(at.alpha.value, 1.0, 0.0),
        H=Jet(at.H.value, at.H_a, at.H_aa), J=at.J_a, J_1=at.J_aa, Pi_1=at.Pi_a, D=at.D_a,
    )  # fmt: skip
    return IronMotion(along_rocker, at.alpha.first * x.w_cam - x.w_gap, 0 * M)


def contact_lever(p: Parameters, alpha: Jet) -> float:
    """Lever arm b of the contact's normal about the rocker's axis: see *Landing*."""
    across, along = slip_per_cam_speed(p, alpha)
    lever: float = p.rocker.l * across / sqrt(across * across + along * along)
    return lever


def after_landing(p: Parameters, x: State) -> State:
    """The state after the follower has met the cam: the impact of *Landing*, with Poisson's restitution.

    The impulse acts on the rocker against alpha and, times alpha', on the cam's shaft. The friction of
    the guide takes its share, with K_down until the iron stands still and with K_up from then on.
    """
    at, J_c, K, approach = position(p, x.phi), shaft_inertia(p), p.friction, x.w_gap
    a_1, arm, load = at.alpha.first, contact_lever(p, at.alpha), p.iron.m * at.H_a * at.H_a
    down, up = at.J_a + K.K_down * load, at.J_a + K.K_up * load
    yields_down, yields_up = a_1 * a_1 / J_c + 1 / down, a_1 * a_1 / J_c + 1 / up

    first = a_1 * x.w_cam - approach
    until_it_stands = max(first, 0 * first) * down
    first_impulse = min(-approach / yields_down, until_it_stands)
    stopping_impulse = first_impulse - (approach + first_impulse * yields_down) / yields_up
    total_impulse = stopping_impulse * (1 + p.follower.e)
    P_down = min(total_impulse, until_it_stands)
    parting = approach + P_down * yields_down + (total_impulse - P_down) * yields_up
    leaves = parting * arm >= p.follower.v
    P = total_impulse if leaves else stopping_impulse
    P_down, parting = min(P, until_it_stands), parting if leaves else 0 * parting
    between, P_up = approach + P_down * yields_down, P - P_down
    stands = first - P_down / down
    last = stands - P_up / up
    rubbed = K.K_up * (last * last - stands * stands) - K.K_down * (first * first - stands * stands)
    return replace(
        x,
        w_cam=x.w_cam + a_1 * P / J_c,
        gap=0 * x.gap,
        w_gap=parting,
        flying=leaves,
        landings=x.landings + 1,
        v_landing=-approach * arm,
        S_landing=P / arm,
        E_landing=x.E_landing - (P_down * (approach + between) + P_up * (between + parting)) / 2,
        E_friction=x.E_friction + load * rubbed / 2,
    )
