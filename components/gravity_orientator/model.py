r"""Gravity orientator: an L-shaped catcher on a rotor turns a falling cup over.

A rotor turns about a vertical axis at the speed $\omega$. On it a cup with a hemispherical bottom
falls, open end down, along the outer wall of a chute. Its rim lands in the inner corner of an L-shaped
catcher, which swings down and turns the cup while its bottom slides on the wall. The cup then lies on
the tip of the catcher's hook, slips off, and turns on until it stands open end up. Each stage follows
from Lagrange's equations, in the radial plane and relative to the rotor. The impacts between the
stages are plastic.
"""
# This file has what can be refused, the slopes, the outputs and the events of the machine. Its variables are in
# `declarations.py`, forces in `loads.py`, the four stages in `stages.py`, and what ends them in `transitions.py`.

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, tan

from fmukit import Experiment, replace, start
from fmukit.runtime.jet import cos, sin, sqrt

from .declarations import Inputs, Outputs, Parameters, Reason, Stage, State
from .loads import anchored_spring, distance_of_bottom
from .stages import (
    MECHANICS,
    flush_angle,
    friction_less_weight,
    landing_height,
    sliding_speed,
    transfer_functions,
)
from .transitions import EVENTS, complete_state, land

EXPERIMENT = Experiment(stop=0.3, step=1e-3)
#: Longest sub-step in s: the shortest stage of the default machine, turning, lasts 69 of them (t_turning = 0.0344 s).
LONGEST_STEP = 5e-4
#: What the next product sets back.
AFRESH = dict.fromkeys(
    ("t_falling", "t_joint", "t_turning", "t_released", "S_x", "S_y", "S_k", "P_B", "P_K"), 0.0
)
#: The slopes of a machine at rest.
REST: State = start(State, phi1=0.0, phi2=0.0, xc=0.0, yc=0.0)


def check(p: Parameters) -> Iterator[str]:
    """Refuse what cannot be assembled or cannot turn over; warn of a landing that would need a pull."""
    cup, catcher, phi, r, e = p.cup, p.catcher, p.catcher.phi, p.cup.d / 2, p.cup.h - p.cup.l
    for name, value, limit, most in (
        ("cup.l", cup.l, "cup.h + cup.d/2", cup.h + r),
        ("catcher.h", catcher.h, "cup.h", cup.h),
        ("catcher.h", catcher.h, "cup.d / sin(catcher.phi)", cup.d / sin(phi)),
    ):
        if value >= most:
            raise ValueError(f"{name} = {value!r} m must be below {limit} = {most!r} m")
    for name, value, limit, least in (
        ("chute.R", p.chute.R, "catcher.l cos(catcher.phi) + cup.d", distance_of_bottom(p) + r),
        ("cup.h", cup.h, "cup.d/2 tan(catcher.phi/2)", r * tan(phi / 2)),
    ):
        if value <= least:
            raise ValueError(f"{name} = {value!r} m must be above {limit} = {least!r} m")
    if flush_angle(p) >= atan2(cup.h, r):
        raise ValueError(
            f"catcher.l = {catcher.l!r} m must be longer, or cup.h = {cup.h!r} m greater: the cup "
            f"would lie on the hook at phi1 = {flush_angle(p)!r} rad, which must be below its dead centre "
            f"at {atan2(cup.h, r)!r} rad"
        )
    if p.neglected.mu_side > 0.0 and p.neglected.J_a >= 2 * cup.J:
        raise ValueError(
            f"neglected.J_a = {p.neglected.J_a!r} kg.m2 must be below 2 cup.J = {2 * cup.J!r} kg.m2"
        )
    mu = p.chute.mu
    least = cup.m * e * (mu * r + e / 2 * (sqrt(1 + mu * mu) - 1))
    if e > 0.0 and least >= cup.J:
        raise ValueError(
            f"cup.J = {cup.J!r} kg.m2 must be above {least!r} kg.m2, or the wall with its friction "
            f"chute.mu = {mu!r} could lock the cup after its release"
        )
    x = land(p, 0.0, start(State, stage=Stage.falling, vyc=1.0))
    arm, tip = x.S_y * cos(phi) - x.S_x * sin(phi), x.S_x * cos(phi) + x.S_y * sin(phi)
    for part, push in (("wall", x.S_k), ("arm", arm), ("hook", tip)):
        if push < 0.0:
            yield f"when the product lands, the {part} would have to pull it"


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    """The accelerations of the stage, which MECHANICS gives; nothing moves outside the four stages."""
    if x.stage not in MECHANICS:
        return REST
    a1, a2, ax, ay, *_ = MECHANICS[x.stage](p, x, u.w)
    return replace(x, phi1=x.w1, w1=a1, phi2=x.w2, w2=a2, xc=x.vxc, yc=x.vyc, vxc=ax, vyc=ay)


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    """Reactions, energies of paper (9) and (10f), and the transfer functions of (7d) and (10e)."""
    phi10, half = p.catcher.phi, p.catcher.l / 2
    N_K, N_B = reactions(p, x, u.w)
    J_1, J_2, m, square = p.catcher.J, p.cup.J, p.cup.m, x.vxc * x.vxc + x.vyc * x.vyc
    spring = (x.phi1 - phi10) * sin(x.phi1) + cos(x.phi1) - cos(phi10)
    plain = p.spring.c * half * half * spring
    stored = anchored_spring(p, x.phi1)[1] if p.neglected.anchored else plain
    return Outputs(
        v_s=sliding_speed(p, x),
        N_K=N_K,
        N_B=N_B,
        E_kin=(J_1 * x.w1 * x.w1 + J_2 * x.w2 * x.w2 + m * square) / 2,
        E_pot=m * p.g * (landing_height(p) - x.yc) + stored,
        **transfer_functions(p, x)._asdict(),
    )


def reactions(p: Parameters, x: State, w: float) -> tuple[float, float]:
    """Forces of wall and hook on the product; none outside the four stages."""
    if x.stage not in MECHANICS:
        return 0.0, 0.0
    *_, N_K, N_B = MECHANICS[x.stage](p, x, w)
    return N_K, N_B


def exact(p: Parameters, x: State, u0: Inputs, u1: Inputs, h: float) -> State | None:
    """Nothing moves while no product is under way."""
    return None if is_moving(x) else x


def is_moving(x: State) -> bool:
    """Whether a product moves, or is held in the chute."""
    return x.stage in MECHANICS


def event_indicators(p: Parameters, t: float, x: State, u: Inputs) -> tuple[float, ...]:
    """The guards of the stage, each below zero where its event occurs."""
    return tuple([falls(p, x, u.w) for falls, _ in EVENTS.get(x.stage, ())])


def event_update(p: Parameters, t: float, x: State, u: Inputs, which: int) -> State:
    """The consequence of the guard that fell below zero: the next stage, an impact or a jam."""
    x = complete_state(p, x)
    *events, (_, last) = EVENTS[x.stage]
    for index, (_, consequence) in enumerate(events):
        if which == index:
            return consequence(p, t, x)
    return last(p, t, x)


def sample(p: Parameters, t: float, x: State, before: Inputs | None, now: Inputs) -> State:
    """Drop the next product on a rising edge of `release`."""
    if not now.release or (before is not None and before.release):
        return x
    if x.stage in MECHANICS:
        return replace(x, missed=x.missed + 1)
    x = complete_state(p, replace(x, stage=Stage.waiting, contact=True, since=t, **AFRESH))
    held = friction_less_weight(p, now.w) >= 0.0
    return replace(x, stage=Stage.falling, reason=Reason.held_in_chute if held else Reason.none)


def notes(p: Parameters, t: float, old: State, new: State, u: Inputs) -> Iterator[str]:
    if new.missed > old.missed == 0:
        yield f"release at t = {t!r} s found a product under way; further ones are only counted"
    if new.jammed > old.jammed == 0:
        yield f"product jammed at t = {t!r} s, {Reason(new.reason).name}; further jams are only counted"
