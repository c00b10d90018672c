"""The equations of the reference systems, written once more from the pages in `pages`, and integrated by SciPy.

Neither an FMU nor a master nor a component takes part. A system is one differential equation, which DOP853 integrates
piece by piece from one switch to the next: a switch is a function of time and states that changes its sign where
the right-hand side has a kink or the states jump.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
Values = Mapping[str, float]
#: Relative tolerances of the two integrations. The first is near the limit of double precision, the second gives the
#: error: it is about a hundred times as far off.
TOLERANCES = (1e-13, 1e-11)
#: Absolute tolerance as a share of the relative one: the smallest state, a twist, is about 1e-3 rad.
ABSOLUTE = 1e-3
#: Longest steps of the two [s], apart by 2, so that they differ also where the tolerance does not limit them. No switch
#: changes its sign twice within such a step.
LONGEST_STEPS = (1e-3, 2e-3)


class Equations(NamedTuple):
    """A system of equations: states at the start, their slopes, and the signals that they give.

    `switches` are functions of (t, y); `jump` gives the states after switch number k. A switch in `falls` only acts
    where it falls.
    """

    start: Sequence[float]
    slopes: Callable[[float, Array], Sequence[float]]
    signals: Callable[[float, Array], Mapping[str, float]]
    switches: Sequence[Callable[[float, Array], float]] = ()
    jump: Callable[[int, Array], Array] = lambda _, y: y
    falls: Sequence[int] = ()


class Solution(NamedTuple):
    """Signals at times, the error of each value, and when a switch acted [s]."""

    values: dict[str, Array]
    errors: dict[str, Array]
    events: list[float]


def solve(equations: Equations, times: Array) -> Solution:
    """Integrate a system from 0 to the last time [s].

    The error of a value is the largest difference of the two integrations up to its time.
    """
    (tight, events), (loose, _) = (
        _integrate(equations, times, tolerance, longest)
        for tolerance, longest in zip(TOLERANCES, LONGEST_STEPS)
    )
    errors = {name: np.maximum.accumulate(np.abs(x - loose[name])) for name, x in tight.items()}
    return Solution(tight, errors, events)


def _integrate(
    equations: Equations, times: Array, tolerance: float, longest: float
) -> tuple[dict[str, Array], list[float]]:
    t, y = 0.0, np.array(equations.start, float)
    signs = [math.copysign(1.0, switch(t, y)) for switch in equations.switches]
    rows: list[Mapping[str, float]] = []
    events: list[float] = []
    while t < times[-1]:
        watched = [_watched(switch, -sign) for switch, sign in zip(equations.switches, signs)]
        piece = solve_ivp(
            equations.slopes, (t, times[-1]), y, "DOP853", rtol=tolerance, atol=ABSOLUTE * tolerance,
            max_step=longest, dense_output=True, events=watched or None,
        )  # fmt: skip
        assert piece.sol is not None
        end = float(piece.t[-1])
        due = times[(times >= t if t == 0.0 else times > t) & (times <= end)]
        rows += [equations.signals(at, piece.sol(at)) for at in due]
        t, y = end, piece.y[:, -1]
        if piece.status == 1:
            k = next(k for k, found in enumerate(piece.t_events or ()) if len(found))
            events.append(t)
            y = equations.jump(k, y)
            signs[k] *= 1.0 if k in equations.falls else -1.0
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}, events


def _watched(switch: Callable[[float, Array], float], direction: float) -> Any:
    """A switch as SciPy watches it: it ends the piece where its sign changes in this direction."""

    def watched(t: float, y: Array) -> float:
        return switch(t, y)

    watched.terminal, watched.direction = True, direction  # type: ignore[attr-defined]
    return watched


def crank_inertia_and_load(p: Values, phi: float, w: float) -> tuple[float, float]:
    """Inertia of a conveyor at its crank, and its load torque."""
    r, m = p["conveyor.crank.r"], p["conveyor.trough.m"]
    x, x1, x2 = r * math.sin(phi), r * math.cos(phi), -r * math.sin(phi)
    load = p["conveyor.spring.c"] * x * x1 + p["conveyor.trough.d"] * x1 * x1 * w
    return p["conveyor.rotor.J"] + m * x1 * x1, load + m * x1 * x2 * w * w


def conveyor_drive(p: Values) -> Equations:
    """A motor with a lag, and a conveyor."""

    def slopes(_: float, y: Array) -> Sequence[float]:
        tau, phi, w = y
        theta, load = crank_inertia_and_load(p, phi, w)
        return (p["motor.A"] - p["motor.B"] * w - tau) / p["motor.T"], w, (tau - load) / theta

    start = p["motor.tau"], p["conveyor.phi"], p["conveyor.w"]
    return Equations(start, slopes, lambda _, y: {"motor.tau": y[0], "conveyor.w": y[2]})


def two_masses(p: Values) -> Equations:
    """Two masses without losses on a shaft without backlash."""

    def torque(y: Array) -> float:
        return float(p["shaft.c"] * y[2] + p["shaft.d"] * (y[0] - y[1]))

    def slopes(_: float, y: Array) -> Sequence[float]:
        T = torque(y)
        first = (p["first.tau_a"] - T) / p["first.J"]
        return first, (p["second.tau_b"] + T) / p["second.J"], y[0] - y[1]

    def signals(_: float, y: Array) -> Mapping[str, float]:
        T = torque(y)
        return {"first.w_b": y[0], "shaft.tau_a": -T, "second.w_a": y[1], "shaft.tau_b": T}

    return Equations((p["first.w_a"], p["second.w_a"], p["shaft.twist"]), slopes, signals)


def controlled_drive(p: Values) -> Equations:
    """Controller with a limit, motor, gearbox with losses, shaft, conveyor: states tau_i, i, w_a, twist, phi, w."""
    limit, ratio, eta, w_0 = p["controller.tau_max"], p["gear.i"], p["gear.eta"], p["gear.w_0"]

    def free(y: Array) -> float:
        return float(p["controller.K"] * (p["controller.w_ref"] - y[2]) + y[0])

    def shaft(y: Array) -> float:
        return float(p["shaft.c"] * y[3] + p["shaft.d"] * (y[2] / ratio - y[5]))

    def slopes(_: float, y: Array) -> Sequence[float]:
        wanted, T, w_a = free(y), shaft(y), y[2]
        voltage = min(max(wanted, -limit), limit)
        e, tau = p["controller.w_ref"] - w_a, -T / ratio
        share = 1.0 / eta - 1.0 if tau * w_a < 0.0 else 1.0 - eta
        lost = share * abs(tau) * min(max(w_a / w_0, -1.0), 1.0)
        theta, load = crank_inertia_and_load(p, y[4], y[5])
        return (
            p["controller.K"] / p["controller.T_i"] * e + (voltage - wanted) / p["controller.T_t"],
            (voltage - p["motor.k"] * w_a - p["motor.R"] * y[1]) / p["motor.L"],
            (p["motor.k"] * y[1] + tau - lost) / p["gear.J"],
            w_a / ratio - y[5],
            y[5],
            (T - load) / theta,
        )

    def signals(_: float, y: Array) -> Mapping[str, float]:
        T = shaft(y)
        return {
            "controller.tau": min(max(free(y), -limit), limit), "gear.w_a": y[2], "motor.tau": p["motor.k"] * y[1],
            "shaft.tau_a": -T, "gear.w_b": y[2] / ratio, "conveyor.w": y[5], "shaft.tau_b": T,
        }  # fmt: skip

    start = [
        p[name]
        for name in ("controller.tau_i", "motor.i", "gear.w_a", "shaft.twist", "conveyor.phi", "conveyor.w")
    ]  # fmt: skip
    switches = (
        lambda _, y: free(y) - limit, lambda _, y: free(y) + limit, lambda _, y: shaft(y),
        lambda _, y: y[2] - w_0, lambda _, y: y[2] + w_0,
    )  # fmt: skip
    return Equations(start, slopes, signals, switches)


def quarter_car(p: Values) -> Equations:
    """Wheel and chassis; each has its own spring and damper, of the same size."""

    def slopes(_: float, y: Array) -> Sequence[float]:
        z, v, Z, V = y
        wheel = p["wheel.k"] * (p["wheel.h"] - z) + p["wheel.c"] * (Z - z) + p["wheel.d"] * (V - v)
        chassis = p["chassis.c"] * (z - Z) + p["chassis.d"] * (v - V)
        return v, wheel / p["wheel.m"], V, chassis / p["chassis.m"]

    names = ("wheel.z", "wheel.v", "chassis.z", "chassis.v")
    return Equations([p[name] for name in names], slopes, lambda _, y: dict(zip(names, y)))


def event_within_step(p: Values) -> Equations:
    """A hammer that bounces, and the frame from which it hangs: states z, v, Z, V."""

    def force(y: Array) -> float:
        return float(p["frame.c"] * (y[2] - y[0]) + p["frame.d"] * (y[3] - y[1]))

    def slopes(_: float, y: Array) -> Sequence[float]:
        f = force(y)
        ground = p["frame.c_0"] * y[2] + p["frame.d_0"] * y[3]
        return y[1], f / p["hammer.m"] - p["hammer.g"], y[3], -(ground + f) / p["frame.m"]

    def signals(_: float, y: Array) -> Mapping[str, float]:
        return {"hammer.z": y[0], "hammer.v": y[1], "frame.f": force(y)}

    def bounce(_: int, y: Array) -> Array:
        return np.array([0.0, -p["hammer.e"] * y[1], y[2], y[3]])

    start = p["hammer.z"], p["hammer.v"], p["frame.z_frame"], p["frame.v_frame"]
    return Equations(start, slopes, signals, [lambda _, y: y[0]], bounce, falls=[0])


def input_jump(p: Values) -> Equations:
    """A motor and its rotor; the voltage is there between two times."""

    def voltage(y: Array) -> float:
        return p["source.V"] if y[2] == 1.0 else 0.0

    def slopes(_: float, y: Array) -> Sequence[float]:
        current, w, _ = y
        induced = p["motor.k"] * w + p["motor.R"] * current
        return (voltage(y) - induced) / p["motor.L"], p["motor.k"] * current / p["rotor.J"], 0.0

    def signals(_: float, y: Array) -> Mapping[str, float]:
        return {"source.v": voltage(y), "rotor.w_a": y[1], "motor.tau": p["motor.k"] * y[0]}

    switches = (lambda t, _: t - p["source.t_1"], lambda t, _: t - p["source.t_2"])
    start = p["motor.i"], p["rotor.w_a"], 0.0
    return Equations(start, slopes, signals, switches, lambda _, y: y + np.array([0.0, 0.0, 1.0]))


#: By system, its equations as a function of its values.
EQUATIONS: Mapping[str, Callable[[Values], Equations]] = {
    "conveyor_drive_a": conveyor_drive, "conveyor_drive_b": conveyor_drive, "two_masses": two_masses,
    "controlled_drive": controlled_drive, "quarter_car": quarter_car, "event_within_step": event_within_step,
    "input_jump": input_jump, "stiff_bond": two_masses,
}  # fmt: skip
