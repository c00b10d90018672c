"""Make conveyor_record.csv as a logger on a conveyor near its resonance would.

    python -m examples.measured_conveyor [FILE.csv [SEED]]

No FMU is involved. A motor drives, through a belt, a crank that is far shorter than its rod. SciPy
integrates the angle phi and speed w of the crank and the torque M on it:

    (J + m x'^2) dw/dt = M - c x x' - d x'^2 w - m x' x'' w^2,   x = r sin phi,   ' = d/dphi
    T dM/dt + M = A - B w (1 + s M)

The belt creeps: under the torque M the motor runs ahead of the crank by the fraction s M, which is
0.1 % at the rated 80 N.m. No FMU here models this. To first order, motor and belt are a motor whose
A, B and T are divided by 1 + B s w. A record therefore shows this equivalent drive, which `equivalent_drive`
returns.

Every 2 ms the logger records:

* `n [rpm]`: the mean speed of the crank over these 2 ms, from the counts of an encoder with 16384
  per turn, in steps of 1.8 rpm; `t [ms]` is the middle of the interval;
* `M`: the inverter's estimate of the torque at that time, in percent of 80 N.m, with noise of 0.8 %
  and a resolution of 0.1 %.

The seed determines the noise; nothing else is random.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sin

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from examples.logger import Samples, mean_speed, percent, row_ends_and_middles, write

TRUTH = {
    "motor.A": 38.0 * 180.215,  # [N.m]
    "motor.B": 180.0,  # [N.m.s/rad]
    "motor.T": 0.066,  # [s]
    "conveyor.rotor.J": 0.52,  # [kg.m2]
    "conveyor.trough.m": 196.0,  # [kg]
    "conveyor.trough.d": 4300.0,  # [N.s/m]
    "conveyor.spring.c": 7.1e5,  # [N/m]
    "conveyor.crank.r": 0.01,  # [m]
    "conveyor.phi": 1.0,  # these three are values at t = 0
    "conveyor.w": 38.0,
    "motor.tau": 30.0,
}
#: Rated torque of the motor [N.m]. Chosen: a data sheet of its size.
RATED = 80.0
#: Creep of the belt at the rated torque, as a fraction of the speed. Chosen: that of a new belt.
CREEP = 0.001
#: Standard deviation of the logged torque [%]. Chosen: an inverter's estimate.
NOISE = 0.8
#: Duration of the record [s]. Chosen: a few revolutions.
STOP = 1.2


def angle_speed_torque(p: Mapping[str, float], t: Samples, creep: float = 0.0) -> Samples:
    """Angle, speed and torque at times t, starting at the first of them, shape (3, n)."""
    m, c, d, r = (p[f"conveyor.{x}"] for x in ("trough.m", "spring.c", "trough.d", "crank.r"))

    def rates(_: float, y: Samples) -> list[float]:
        phi, w, M = y
        x, dx = r * sin(phi), r * cos(phi)
        load = c * x * dx + d * dx**2 * w - m * dx * x * w**2
        ahead = 1.0 + creep * M / RATED
        a = (M - load) / (p["conveyor.rotor.J"] + m * dx**2)
        return [w, a, (p["motor.A"] - p["motor.B"] * w * ahead - M) / p["motor.T"]]

    start = [p["conveyor.phi"], p["conveyor.w"], p["motor.tau"]]
    run = solve_ivp(rates, (t[0], t[-1]), start, "DOP853", t, rtol=1e-9, atol=1e-9)
    return np.asarray(run.y)


def equivalent_drive(p: Mapping[str, float] = TRUTH) -> dict[str, float]:
    """The equivalent drive, without belt creep, that a record shows."""
    speed = p["motor.A"] / (p["motor.B"] + p["conveyor.trough.d"] * p["conveyor.crank.r"] ** 2 / 2)
    less = 1.0 + p["motor.B"] * CREEP / RATED * speed
    return {**p, **{f"motor.{x}": p[f"motor.{x}"] / less for x in "ABT"}}


def record(seed: int = 1, drift: float = 0.0) -> pd.DataFrame:
    """The logger's rows; with a drift, the measured speed grows by that fraction per second."""
    t = row_ends_and_middles(0.0, STOP)
    phi, _, M = angle_speed_torque(TRUTH, t, CREEP)
    return pd.DataFrame(
        {
            "t [ms]": 1e3 * t[1::2],
            "n [rpm]": mean_speed(phi) * (1.0 + drift * t[1::2]),
            "M": percent(M, RATED, NOISE, seed),
        }
    ).round(3)


if __name__ == "__main__":
    write(record, __doc__, "examples/conveyor_record.csv")
