"""How one stage of the orientation becomes the next: four plastic impacts, and what jams.

EVENTS has the guards of each stage and their consequences. *Paper* and the names of sections are those of `page.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi

from fmukit import replace
from fmukit.runtime.jet import cos, sin

from .declarations import Parameters, Reason, Stage, State
from .loads import distance_of_bottom
from .stages import (
    MECHANICS,
    flush_angle,
    friction_less_weight,
    joint_geometry,
    landing_height,
    pressing_force,
    sliding_speed,
    solve_2_by_2,
    turning_geometry,
)

Guard = Callable[[Parameters, State, float], float]
Consequence = Callable[[Parameters, float, State], State]


def complete_state(p: Parameters, x: State) -> State:
    """The state with the dependent coordinates of its stage: paper (6b), (10c) and (10j)."""
    e, centre = p.cup.h - p.cup.l, distance_of_bottom(p)
    match x.stage:
        case Stage.waiting:
            return with_catcher_at_stop(p, replace(x, yc=landing_height(p) - p.chute.H, vyc=0.0))
        case Stage.falling:
            return with_catcher_at_stop(p, x)
        case Stage.joint:
            phi2, xc, yc, *_ = joint_geometry(p, x.phi1)
            x = replace(x, phi2=phi2.value, w2=phi2.first * x.w1, xc=xc.value, yc=yc.value)
            return replace(x, vxc=xc.first * x.w1, vyc=yc.first * x.w1)
        case Stage.turning:
            k, xc = turning_geometry(p, x.phi1, x.phi2), centre - e * cos(x.phi2)
            return replace(x, xc=xc, yc=k.yc, vxc=k.x2 * x.w2, vyc=k.z1 * x.w1 + k.z2 * x.w2)
        case Stage.released if x.contact:
            return replace(x, xc=centre - e * cos(x.phi2), vxc=e * sin(x.phi2) * x.w2)
    return x


def with_catcher_at_stop(p: Parameters, x: State) -> State:
    """The state with the catcher at its stop and the product upright at the wall: see *Falling*."""
    return replace(
        x, phi1=p.catcher.phi, w1=0.0, phi2=1.5 * pi, w2=0.0, xc=distance_of_bottom(p), vxc=0.0
    )


#: The state that holds the duration of each stage.
DURATIONS = {stage: f"t_{Stage(stage).name}" for stage in MECHANICS}


def with_next_stage(x: State, t: float, stage: Stage, **changes: float) -> State:
    """The state x at the end of its stage and the beginning of the next; durations add up to paper (10o)."""
    duration = {DURATIONS[x.stage]: t - x.since}
    return replace(x, stage=stage, since=t, **duration, **changes)


def jam(reason: Reason) -> Consequence:
    """A consequence that makes the product stay where it is, for this reason: see *End*."""

    def jammed(p: Parameters, t: float, x: State) -> State:
        x = replace(x, w1=0.0, w2=0.0, vxc=0.0, vyc=0.0, orientation_time=0.0)
        return with_next_stage(x, t, Stage.jammed, reason=reason, jammed=x.jammed + 1)

    return jammed


def hold_or_fall_on(p: Parameters, t: float, x: State) -> State:
    """The product comes to rest in the chute, or falls on: see *Falling*."""
    held = x.reason == Reason.none
    return replace(x, vyc=0.0, reason=Reason.held_in_chute if held else Reason.none)


def land(p: Parameters, t: float, x: State) -> State:
    """Plastic impact of the rim in the corner of the catcher: paper (2) to (6), with erratum 1 corrected."""
    l1, phi1, m, at = p.catcher.l, p.catcher.phi, p.cup.m, joint_geometry(p, p.catcher.phi)
    w1 = m * x.vyc * at.y.first / at.J
    S_y = m * (x.vyc - at.y.first * w1)
    S_x = (l1 * cos(phi1) * S_y - p.catcher.J * w1) / (l1 * sin(phi1))
    S_k = -m * at.x.first * w1 - S_x
    return complete_state(
        p, with_next_stage(x, t, Stage.joint, phi1=phi1, w1=w1, S_x=S_x, S_y=S_y, S_k=S_k)
    )


def lie_on_hook(p: Parameters, t: float, x: State) -> State:
    """Plastic impact of the cup's wall on the tip of the hook: the momenta at the end of *Joint*.

    Paper (10h) carries the velocities over instead, which is erratum 10.
    """
    m, c2, s2, at = p.cup.m, cos(x.phi2), sin(x.phi2), turning_geometry(p, x.phi1, x.phi2)
    momentum = p.cup.J * x.w2 + m * (at.x2 * x.vxc + at.z2 * x.vyc)
    w1, w2 = solve_2_by_2(at, p.catcher.J * x.w1 + m * at.z1 * x.vyc, momentum)
    new = complete_state(p, with_next_stage(x, t, Stage.turning, w1=w1, w2=w2))
    P_B = -m * (new.vyc - x.vyc) / c2
    new = replace(new, P_B=P_B, P_K=P_B * s2 - m * (new.vxc - x.vxc))
    By = p.catcher.l * sin(x.phi1) - p.catcher.h * cos(x.phi1)
    slips = By * w1 + (p.cup.d / 2 * c2 + at.x1 * s2) * w2 > 0.0
    return new if slips and w2 > w1 else jam(Reason.rim_stayed_at_hook_contact)(p, t, new)


def release(p: Parameters, t: float, x: State) -> State:
    """The tip leaves the end of the cup: paper (10d)."""
    return with_next_stage(x, t, Stage.released)


def leave_or_touch(p: Parameters, t: float, x: State) -> State:
    """The product flies off the wall, or meets it again in a plastic impact: the end of *Released*."""
    if x.contact:
        return replace(x, contact=False)
    m, x2 = p.cup.m, (p.cup.h - p.cup.l) * sin(x.phi2)
    w2 = (p.cup.J * x.w2 + m * x2 * x.vxc) / (p.cup.J + m * x2 * x2)
    return complete_state(p, replace(x, contact=True, w2=w2))


def stop_catcher(p: Parameters, t: float, x: State) -> State:
    """The catcher is back at its stop, without the product: see *Released*."""
    return replace(x, phi1=p.catcher.phi, w1=0.0)


def finish(p: Parameters, t: float, x: State) -> State:
    """The product stands open end up: the orientation time is paper (10o)."""
    time = x.t_falling + x.t_joint + x.t_turning + (t - x.since)
    return with_next_stage(x, t, Stage.oriented, oriented=x.oriented + 1, orientation_time=time)


def guard_of_holding(p: Parameters, x: State, w: float) -> float:
    """Friction less weight of a product at rest, speed of a falling one: see *Falling*."""
    return friction_less_weight(p, w) if x.reason == Reason.held_in_chute else x.vyc


def guard_of_contact(p: Parameters, x: State, w: float) -> float:
    """Force that presses a released product to the wall; in flight the gap, 0 while it opens.

    The end of *Released*; the paper lets the wall pull, which is erratum 11.
    """
    if x.contact:
        return pressing_force(p, x, w)
    e = p.cup.h - p.cup.l
    parting = e * sin(x.phi2) * x.w2 >= x.vxc
    return 0.0 if parting else distance_of_bottom(p) - e * cos(x.phi2) - x.xc


#: For each stage the guards that fall below zero, each with its consequence; the ends of the stages are paper (7c),
#: (10d), and those of *End*.
EVENTS: dict[int, tuple[tuple[Guard, Consequence], ...]] = {
    Stage.falling: (
        (lambda p, x, w: landing_height(p) - x.yc, land),
        (guard_of_holding, hold_or_fall_on),
    ),
    Stage.joint: (
        (lambda p, x, w: flush_angle(p) - x.phi1, lie_on_hook),
        (lambda p, x, w: x.w1, jam(Reason.catcher_stopped)),
    ),
    Stage.turning: (
        (lambda p, x, w: p.cup.h - turning_geometry(p, x.phi1, x.phi2).x1, release),
        (sliding_speed, jam(Reason.sliding_stopped_in_turning)),
        (lambda p, x, w: x.w2, jam(Reason.turning_stopped)),
        (lambda p, x, w: x.phi1 - p.catcher.phi, jam(Reason.catcher_back_at_stop)),
    ),
    Stage.released: (
        (lambda p, x, w: 2.5 * pi - x.phi2, finish),
        (lambda p, x, w: x.w2, jam(Reason.rotation_stopped_after_release)),
        (
            lambda p, x, w: sliding_speed(p, x) if x.contact else 0.0,
            jam(Reason.sliding_stopped_after_release),
        ),
        (guard_of_contact, leave_or_touch),
        (lambda p, x, w: x.phi1 - p.catcher.phi, stop_catcher),
    ),
}
