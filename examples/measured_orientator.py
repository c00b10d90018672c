"""Make a record as a high-speed camera at a gravity orientator would, for identification.

    python -m examples.measured_orientator [FILE.csv [SEED]]

No FMU is involved. Catcher and cup are two bodies with four coordinates: the angles phi1 and phi2
and the position x, y of the cup's centre (outwards and down from the pivot). Every contact is a
constraint g(q) = 0 with the gradient G:

    M dv/dt - G' s = Q,   G dv/dt = -dG/dt v;   at an impact   M (v+ - v-) = G' S,   G v+ = 0

* the bottom of the cup slides on the wall;
* the rim is in the inner corner of the catcher, in stage joint;
* the inner wall of the cup lies on the tip of the hook, in stage turning.

Friction on the wall is mu times the centrifugal force. After the release, when the bottom may leave
the wall, it is mu times the actual contact force. SciPy integrates the stages from event to event.

The camera records a row for each product: the speed of the rotor in rpm and the durations of the
four stages in ms, each off by about 0.5 ms, in steps of 0.1 ms. The seed determines this noise;
nothing else is random. Identifying the machine should give `TRUTH`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from examples.logger import write

Vector = NDArray[np.float64]
TRUTH = {"orientator.chute.mu": 0.31, "orientator.chute.H": 0.0405}
SPEEDS = (20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 72)  # [rpm]
STAGES = ("falling", "joint", "turning", "released")
#: Standard deviation of the times [ms]. Chosen: half the spacing of 1000 frames a second.
NOISE = 0.5
#: Resolution of the times [ms]. Chosen: a decimal.
GRID = 0.1
#: Diameter of the cup [m]. Convention of the FMU's default, as all values of the machine below.
D = 0.040
#: Height of the cup's cylindrical part [m]. Convention of the FMU's default.
H = 0.048
#: Distance of the cup's centre of mass from its rim [m]. Convention of the FMU's default.
L2 = 0.043
#: Mass of the cup [kg]. Convention of the FMU's default.
M2 = 0.040
#: Moment of inertia of the cup [kg.m2]. Convention of the FMU's default.
J2 = 2.4e-5
#: Length of the catcher's arm [m]. Convention of the FMU's default.
L1 = 0.180
#: Length of the catcher's hook [m]. Convention of the FMU's default.
H1 = 0.010
#: Mass of the catcher [kg]. Convention of the FMU's default.
M1 = 0.016
#: Moment of inertia of the catcher about its pivot [kg.m2]. Convention of the FMU's default.
J1 = 2.2e-4
#: Angle of the catcher at its stop [rad]. Convention of the FMU's default.
PHI = pi / 6
#: Stiffness of the catcher's spring [N/m]. Convention of the FMU's default.
C = 14.0
#: Distance of the chute's wall from the rotor's axis [m]. Convention of the FMU's default.
WALL = 0.270
#: Gravity [m/s2]. Convention of the FMU's default.
G = 9.81
R = D / 2  # radius of the cup [m]
E = H - L2  # distance of its centre of mass from its bottom [m]
X = L1 * cos(PHI) + D  # distance of the wall from the pivot [m]
MASSES = np.array([J1, J2, M2, M2])


def tip(q: Vector) -> tuple[float, float]:
    """The tip of the hook from the cup's centre: along its axis, and towards its inner wall."""
    c1, s1, c2, s2 = cos(q[0]), sin(q[0]), cos(q[1]), sin(q[1])
    a, b = L1 * c1 + H1 * s1 - q[2], L1 * s1 - H1 * c1 - q[3]
    return a * c2 + b * s2, -a * s2 + b * c2


def gradient(q: Vector, touching: Sequence[str]) -> Vector:
    """Gradient of the constraints, shape (n, 4)."""
    c1, s1, c2, s2 = cos(q[0]), sin(q[0]), cos(q[1]), sin(q[1])
    along, _ = tip(q)
    rows = {
        "wall": [[0, -E * s2, 1, 0]],
        "corner": [[L1 * s1, L2 * s2 + R * c2, 1, 0], [-L1 * c1, -L2 * c2 + R * s2, 0, 1]],
        "hook": [[s2 * (L1 * s1 - H1 * c1) + c2 * (L1 * c1 + H1 * s1), -along, s2, -c2]],
    }
    return np.array([row for name in touching for row in rows[name]], float).reshape(-1, 4)


def accelerations_and_wall_force(
    q: Vector, v: Vector, W: float, mu: float, touching: Sequence[str]
) -> tuple[Vector, float]:
    """Accelerations, and the force of the wall; W is the squared speed of the rotor."""
    F1, F2 = M1 * W * (WALL - D - L1 / 2 * cos(PHI)), M2 * W * (WALL - R)
    drag = np.array([0.0, -(E * cos(q[1]) + R), 0.0, -1.0])  # of an upward force on the wall
    spring = C * L1 / 2 * (q[0] - PHI) * cos(q[0])
    Q = np.array([-L1 / 2 * (F1 * sin(q[0]) + spring), 0.0, F2, M2 * G])
    A = gradient(q, touching)
    push, n = A.T.copy(), len(A)
    if "corner" in touching or "hook" in touching:
        Q += mu * F2 * drag
    elif n:
        push[:, 0] -= mu * drag
    step = 1e-6
    turn = (gradient(q + step * v, touching) - gradient(q - step * v, touching)) @ v / (2 * step)
    matrix = np.block([[np.diag(MASSES), -push], [A, np.zeros((n, n))]])
    stage_times = np.linalg.solve(matrix, np.concatenate([Q, -turn]))
    return stage_times[:4], -float(stage_times[4]) if n else 0.0


def hit(q: Vector, v: Vector, touching: Sequence[str]) -> Vector:
    """Velocities after a plastic impact."""
    A = gradient(q, touching)
    share = np.linalg.solve(A / MASSES @ A.T, A @ v)
    return np.asarray(v - A.T @ share / MASSES)


def stage_durations(rpm: float, mu: float, fall: float) -> list[float]:
    """Durations of the stages [s] at a rotor speed [rpm], a friction and a height of fall [m]; nan
    for stages that a jammed product does not reach.
    """
    W = (rpm * pi / 30) ** 2
    down = G - mu * W * (WALL - R)
    if down <= 0.0:
        return [np.nan] * 4
    q = np.array([PHI, 1.5 * pi, X - R, L1 * sin(PHI) - L2])
    v = np.array([0.0, 0.0, 0.0, sqrt(2 * fall * down)])
    stage_times = [sqrt(2 * fall / down)]

    def until(touching: Sequence[str], *ends: Any) -> int:
        """Integrate to the first event that falls below zero, and return its number."""
        nonlocal q, v

        def rates(t: float, y: Vector) -> Vector:
            return np.concatenate(
                [y[4:], accelerations_and_wall_force(y[:4], y[4:], W, mu, touching)[0]]
            )

        events = [lambda t, y, end=end: end(y[:4], y[4:]) for end in ends]
        for event in events:
            event.terminal, event.direction = True, -1
        run = solve_ivp(
            rates, (0.0, 2.0), np.concatenate([q, v]), "DOP853", rtol=1e-8, atol=1e-10,
            max_step=1e-2, events=events,
        )  # fmt: skip
        q, v = run.y[:4, -1], run.y[4:, -1]
        stage_times[-1] += run.t[-1]
        return next((k for k, at in enumerate(run.t_events) if len(at)), -1)

    def turns(q: Vector, v: Vector) -> float:
        return float(v[1])

    def slides(q: Vector, v: Vector) -> float:
        return float(v[3] + v[1] * (E * cos(q[1]) + R))

    v = hit(q, v, ("corner", "wall"))
    stage_times.append(0.0)
    if until(("corner", "wall"), lambda q, v: tip(q)[1] + R, lambda q, v: v[0]):
        return [*stage_times[:-1], *[np.nan] * 3]
    v = hit(q, v, ("hook", "wall"))
    stage_times.append(0.0)
    if until(("hook", "wall"), lambda q, v: tip(q)[0] + L2, slides, turns, lambda q, v: q[0] - PHI):
        return [*stage_times[:-1], *[np.nan] * 2]
    stage_times.append(0.0)
    on = accelerations_and_wall_force(q, v, W, mu, ["wall"])[1] > 0.0
    while True:
        stands = lambda q, v: 2.5 * pi - q[1]
        if on:
            end = until(
                ["wall"],
                stands,
                turns,
                slides,
                lambda q, v: accelerations_and_wall_force(q, v, W, mu, ["wall"])[1],
            )
        else:
            end = until([], stands, turns, lambda q, v: X - R - E * cos(q[1]) - q[2])
        if end == 0:
            return stage_times
        if end in ((-1, 1, 2) if on else (-1, 1)):
            return [*stage_times[:-1], np.nan]
        v = v if on else hit(q, v, ["wall"])
        on = not on


def record(
    seed: int = 1, truth: Mapping[str, float] = TRUTH, speeds: Sequence[float] = SPEEDS
) -> pd.DataFrame:
    """The rows of the camera."""
    rng = np.random.default_rng(seed)
    rows = np.array([stage_durations(n, *truth.values()) for n in speeds])
    measured = np.round((1e3 * rows + rng.normal(0.0, NOISE, rows.shape)) / GRID) * GRID
    table = {"n [rpm]": speeds} | {f"{x} [ms]": measured[:, k] for k, x in enumerate(STAGES)}
    return pd.DataFrame(table).round(3)


if __name__ == "__main__":
    write(record, __doc__, "results/measured_orientator.csv")
