r"""Cam drive of a sealing iron: cam, rocker, link, chain and the iron it lifts against dry friction.

A motor turns a cam through a reducer ($\omega_m = i_g\,\omega$, $M = i_g\,\tau$). The cam moves the
small arm of a rocker. The end of its large arm pulls, through a link and a chain over a sprocket, an
iron that hangs in a vertical guide and is loaded by its weight and by a spring. The friction of the
guide is $K$ times the load $W_0 - m_y\ddot H$. The energies give the equation of motion

$$ (J + K m_y H'^2)\,\dot\omega + \left(\tfrac12 J' + K m_y H'H''\right)\omega^2
   = M - \Pi' + K W_0 H' $$

With `follower.lifts` the follower leaves a cam that turns too fast, flies, and lands on it again.
"""
# This file has what can be refused, the slopes, the outputs and the events of the machine. Its variables are in
# `declarations.py`, and the three stories of its physics in `geometry.py`, `dynamics.py` and `flight.py`.

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator
from functools import lru_cache
from math import atan, pi, radians

from fmukit import Experiment, repeat, replace
from fmukit.runtime.jet import cos, sin, sqrt

from .declarations import Inputs, Motion, OnInvalid, Outputs, Parameters, State, Wrap
from .dynamics import (
    Forces,
    direction_of_motion,
    dynamics,
    forces,
    friction_coefficient,
    reduced_inertia,
    torques_to_start,
)
from .flight import after_landing, along_followed_angle, cam_acceleration, shaft_inertia
from .geometry import (
    Position,
    cam_at,
    lowered_length,
    position,
    position_with_gap,
    rocker_angle,
    slip_per_cam_speed,
)

EXPERIMENT = Experiment(stop=1.0, step=1e-3)
FLANGES = {"flange": ("tau", "w")}
#: Longest sub-step in s: at 10 rad/s the cam turns by 1/175 of its rise (100 degrees) in it.
LONGEST_STEP = 1e-3
#: Position along the cam; position, speed, torque and dynamics along the angle that the iron follows.
Mechanics = namedtuple("Mechanics", "at iron_position w M d")


def check(p: Parameters) -> Iterator[str]:
    """Refuse a mechanism that cannot close or turn; warn of a run too steep for `wrap = top`."""
    c, r, K = p.cam, p.rocker, p.friction
    if (turn := c.rise + c.top + c.ret) > 2 * pi * (1 + 1e-12):
        raise ValueError(
            f"cam angles exceed one revolution: cam.rise + cam.top + cam.ret = {turn!r} rad"
        )
    low, high = abs(r.L - r.l), r.L + r.l
    if not low < c.R_b <= c.R_b + c.h < high:
        raise ValueError(
            f"cam triangle cannot close: cam.R_b = {c.R_b!r} m must be > {low!r} m and, with "
            f"cam.h = {c.h!r} m added, < {high!r} m: difference and sum of rocker.L and rocker.l"
        )
    if not -1.0 < K.K_down <= 0.0 <= K.K_up:
        raise ValueError(
            "friction: -1 < K_down <= 0 <= K_up violated: "
            f"friction.K_down = {K.K_down!r}, friction.K_up = {K.K_up!r}"
        )
    require_full_turn(p)
    slope = pi - min(position(p, phi).beta.value for phi in (0.0, c.rise))
    if p.wrap == Wrap.top and slope > 0.25:
        yield f"the run to the sprocket rises by {slope!r} rad: wrap = top (0) is a poor assumption"


@lru_cache(maxsize=16)
def require_full_turn(p: Parameters) -> bool:
    """True; raises ValueError at the first obstacle in a turn in steps of half a degree."""

    def passed(step: int) -> tuple[bool, int]:
        require_free(p, radians(step / 2))
        return step >= 719, step + 1

    repeat(passed, 0)
    return True


def require_free(p: Parameters, phi: float) -> bool:
    """True; raises ValueError if something is in the way at this cam angle."""
    for free, otherwise in conditions(p, phi):
        if not free:
            raise ValueError(f"{otherwise} at phi = {phi!r} rad")
    return True


def conditions(p: Parameters, phi: float) -> Iterator[tuple[bool, str]]:
    """Conditions at this cam angle, each with what is in the way if it is false.

    The geometry of *Run* must exist, and the chain must pull at standstill: *Assumptions*.
    """
    alpha, R = rocker_angle(p, cam_at(p, phi).R.value), p.sprocket.R
    X, Y = p.sprocket.C + p.rocker.l_K * cos(alpha), p.sprocket.A - p.rocker.l_K * sin(alpha)
    yield (
        X > 0.0,
        (
            "rocker end must stay on the far side of the sprocket: "
            f"sprocket.C + rocker.l_K cos(alpha) = {X!r} m"
        ),
    )
    if p.wrap == Wrap.tangent:
        free = sqrt(X * X + Y * Y) > R
        yield free, f"link reaches the sprocket: its end is within sprocket.R = {R!r} m of the axis"
    at = position(p, phi)
    n, l, H, e = at.n, p.link.l, at.H.value, at.e
    yield n > l, f"link reaches the sprocket: link.l = {l!r} m of a run of {n!r} m"
    yield (
        H > 0.0,
        f"chain too short: hanging part vanishes: H = {H!r} m with chain.l = {p.chain.l!r} m",
    )
    yield at.H_a > 0.0, f"dead centre: beta - alpha = {at.beta.value - alpha!r} rad"
    yield e >= 0.0, f"spring slack: stretch = {e!r} m with spring.e_0 = {p.spring.e_0!r} m"
    d = forces(p, at, 0.0, dynamics(p, at, 0.0, 0, at.Pi_1))
    pull = (1 + p.friction.K_down) * at.W_0
    taut = min(pull, pull + d.T_span - d.T_iron) > 0.0
    yield taut, f"chain slack at standstill: T_iron = {pull!r} N"


def step_constants(p: Parameters, x: State) -> float:
    """What all evaluations within a step have in common."""
    return lowered_length(p)


def mechanics(p: Parameters, x: State, u: Inputs, H_b: float) -> Mechanics:
    """The motion of a state, whose hanging length with the iron down is H_b."""
    at = position_with_gap(p, x.phi, x.gap, H_b)
    iron_position, w, M = along_followed_angle(p, x, at, p.reducer.i_g * u.tau)
    return Mechanics(at, iron_position, w, M, dynamics(p, iron_position, w, x.direction, M))


def derivatives(p: Parameters, t: float, x: State, u: Inputs, H_b: float | None = None) -> State:
    """The equations of motion of cam and rocker, the power of friction in guide and joints.

    Paper (48a) with the follower on the cam; else *Flight*. Friction is that of paper (48) and of D in *Motion*.
    """
    at, iron_position, w, _, d = mechanics(p, x, u, lowered_length(p) if H_b is None else H_b)
    eps = cam_acceleration(p, x, d, p.reducer.i_g * u.tau)
    rocker_acceleration = iron_position.alpha.first * d.eps + iron_position.alpha.second * w * w
    gap_acceleration = (
        at.alpha.first * eps + at.alpha.second * x.w_cam * x.w_cam - rocker_acceleration
    )
    rate = iron_position.alpha.first * w
    heat = p.joints.cam * x.w_cam * x.w_cam + at.D_a * rate * rate
    loss = -d.K * d.W * iron_position.H.first * w
    return replace(
        x, phi=x.w_cam, w_cam=eps, E_friction=loss, gap=x.w_gap, w_gap=gap_acceleration, E_joints=heat,
        t_flight=1.0 if x.flying else 0.0,
    )  # fmt: skip


def outputs(p: Parameters, t: float, x: State, u: Inputs) -> Outputs:
    """Positions, speeds, energies and forces: the numbers of the paper's formulas are those of `page.md`.

    E_kin is paper (28) to (38), E_pot (41) to (46), C_1 (48d).
    """
    i_g, tau, H_b = p.reducer.i_g, p.reducer.i_g * u.tau, lowered_length(p)
    on, at = position_with_gap(p, x.phi, 0 * x.gap, H_b), position_with_gap(p, x.phi, x.gap, H_b)
    iron_position, w, M = along_followed_angle(p, x, at, tau)
    forward = x.direction if w == 0 else 1 if w > 0 else -1
    d = dynamics(p, iron_position, w, forward, M)
    up = iron_position.slope * forward
    moving = Motion.up if up > 0 else Motion.down if up < 0 else Motion.stuck
    eps = cam_acceleration(p, x, d, tau)
    across, along = slip_per_cam_speed(p, on.alpha)
    K = friction_coefficient(p, on, x.direction if x.w_cam == 0 else 1 if x.w_cam > 0 else -1)
    H, (A_1, B_1) = on.H, reduced_inertia(p, on, K)
    shaft_energy = shaft_inertia(p) * x.w_cam * x.w_cam / 2 if x.flying else 0 * on.J * w * w
    return Outputs(
        w=i_g * x.w_cam,
        alpha=at.alpha.value,
        beta=at.beta.value,
        H=at.H.value,
        lift=at.lift,
        v=-iron_position.H.first * w,
        a=-d.H_tt,
        tau_cam=tau - i_g * i_g * p.reducer.J * eps,
        **forces(p, iron_position, w, d)._asdict(),
        pressure=atan(along / across),
        E_kin=iron_position.J * w * w / 2 + shaft_energy,
        E_pot=at.Pi + p.g * p.cam.m * p.cam.r * sin(x.phi + p.cam.gamma),
        motion=moving if iron_position.slope else Motion.dwell,
        top_dwell=at.top,
        alpha_1=on.alpha.first,
        alpha_2=on.alpha.second,
        beta_1=on.beta.first,
        beta_2=on.beta.second,
        H_1=H.first,
        H_2=H.second,
        A_1=A_1,
        B_1=B_1,
        C_1=K * on.W_0 * H.first - on.Pi_1,
    )


def event_indicators(p: Parameters, t: float, x: State, u: Inputs) -> tuple[float, float, float]:
    """Below zero where the motion of the iron, the validity of the model or the contact changes.

    The first is that of what drives the iron, which leaves its direction or its rest; the second that
    of the model, which loses or regains validity; the third that of the follower, which leaves or
    meets the cam.
    """
    _, iron_position, w, M, d = mechanics(p, x, u, lowered_length(p))
    f = forces(p, iron_position, w, d)
    forwards, backwards = torques_to_start(p, iron_position, M)
    held = x.direction * w if x.direction else min(-forwards, backwards)
    margin = min(f.T_span, f.T_iron, d.W)
    separation, margin = (
        (x.gap if x.flying else f.N, min(margin, iron_position.H.value, iron_position.H_a))
        if p.follower.lifts
        else (1.0, min(margin, f.N))
    )
    return held, margin if x.valid else -margin, separation


def event_update(p: Parameters, t: float, x: State, u: Inputs, which: int) -> State:
    """Validity gained or lost, take-off or landing, a start or a stop: see *Motion* and *Flight and landing*."""
    if which == 1:
        return with_validity(p, x, u)
    if which == 2:
        return with_direction(p, after_landing(p, x) if x.flying else replace(x, flying=True), u)
    return with_direction(p, at_rest(p, x), u)


def with_direction(p: Parameters, x: State, u: Inputs) -> State:
    """The state with the direction in which the cam, in flight the rocker, moves or starts: see *Motion*."""
    at = position_with_gap(p, x.phi, x.gap, lowered_length(p))
    return replace(
        x, direction=direction_of_motion(p, *along_followed_angle(p, x, at, p.reducer.i_g * u.tau))
    )


def at_rest(p: Parameters, x: State) -> State:
    """The state with the cam, in flight the rocker, at rest."""
    if not x.flying:
        return replace(x, w_cam=0.0)
    return replace(
        x, w_gap=position_with_gap(p, x.phi, x.gap, lowered_length(p)).alpha.first * x.w_cam
    )


def with_validity(p: Parameters, x: State, u: Inputs) -> State:
    """The state with `valid` set from the forces; raises ValueError if the run is to stop."""
    reason = invalidity(p, x, u)
    if reason and p.on_invalid == OnInvalid.stop:
        raise ValueError(reason)
    return replace(x, valid=not reason)


def invalidity(p: Parameters, x: State, u: Inputs) -> str:
    """A message on what makes this state invalid; empty if nothing does: see *Assumptions*."""
    _, iron_position, w, _, d = mechanics(p, x, u, lowered_length(p))
    return invalid_reason(p, x, iron_position, d.W, forces(p, iron_position, w, d))


def invalid_reason(p: Parameters, x: State, at: Position, W: float, f: Forces) -> str:
    """A message on what has lost its load or its place, by the conditions of *Assumptions*."""
    where = f"at phi = {x.phi!r} rad, omega = {x.w_cam!r} rad/s"
    if f.N < 0.0 and not p.follower.lifts:
        return f"cam follower lifts off {where}: N = {f.N!r} N"
    if min(at.H.value, at.H_a) < 0.0:
        far = f"H = {at.H.value!r} m, beta - alpha = {at.beta.value - at.alpha.value!r} rad"
        return f"the follower flies too far {where}: {far}"
    slack = ", ".join(
        f"{name} = {pull!r} N"
        for name, pull in (("W", W), ("T_iron", f.T_iron), ("T_span", f.T_span))
        if pull < 0.0
    )
    return f"chain slack {where}: {slack}" if slack else ""


def sample(p: Parameters, t: float, x: State, before: Inputs | None, now: Inputs) -> State:
    """Set the direction of a start from rest; at the beginning also flight and validity."""
    if before is None:
        flying = x.gap > 0.0 or x.w_gap != 0.0
        if flying and not (p.follower.lifts and (x.gap > 0.0 or x.w_gap > 0.0)):
            raise ValueError(
                f"gap = {x.gap!r} rad, w_gap = {x.w_gap!r} rad/s: the follower can be off the cam "
                "only with follower.lifts, and cannot move into the cam"
            )
        x = replace(x, flying=flying)
        return with_validity(p, with_direction(p, x, now), now)
    return with_direction(p, x, now) if x.w_cam == 0.0 else x


def notes(p: Parameters, t: float, old: State, new: State, u: Inputs) -> Iterator[str]:
    if old.valid and not new.valid:
        reason = invalidity(p, new, u)
        yield f"{reason}, t = {t!r} s; the results are not valid until all is loaded again"
