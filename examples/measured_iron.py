"""Make a record as a logger on a sealing iron's drive would, for identifying the drive.

    python -m examples.measured_iron [FILE.csv [SEED]]

No FMU is involved. The mechanism is drawn in the complex plane, with the rocker's axis at 0. The
inertia J and potential energy U of everything but the iron, the hanging length H of the chain, and
their derivatives with respect to the cam angle phi, ' = d/dphi, come from splines through drawings
of 1440 positions. With an iron of mass m, a spring of stiffness c and mass m_s, and friction K,

    (J + (1 + K) m H'^2) dw/dt + (J'/2 + (1 + K) m H' H'') w^2 = i M - U' + ((1 + K) F + K m_s g / 2) H'
    F = m g + c (e_0 + H(0) - H),   K = K_down where H' > 0, else K_up
    T dM/dt + M = A - B i w

SciPy integrates these equations. The drive is at rest in the middle of its bottom dwell. At t = 0
the motor is switched on, and 0.1 s later the logger starts.

Every 2 ms the logger records:

* `n [rpm]`: the mean speed of the motor's shaft over these 2 ms, from the counts of an encoder with
  16384 per turn, in steps of 1.8 rpm; `t [ms]` is the middle of the interval;
* `M`: the motor torque at that time, in percent of 2 N.m, with noise of 2 %, resolved to 0.1 %.

The seed determines the noise; nothing else is random. Identifying the drive should give `TRUTH`,
whose names are those of a system of DriveMotor and IronDrive. All other values are the defaults of
these FMUs.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from math import pi, sin

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from examples.logger import Samples, mean_speed, percent, row_ends_and_middles, write

TRUTH = {
    "motor.A": 3.7,  # [N.m]
    "motor.B": 0.0235,  # [N.m.s/rad]
    "motor.T": 0.0135,  # [s]
    "iron.iron.m": 4.4,  # [kg]
    "iron.spring.c": 345.0,  # [N/m]
    "iron.friction.K_up": 0.105,
    "iron.friction.K_down": -0.0868,
}
STATES = {"iron.phi": -pi / 3, "iron.w_cam": 0.0, "motor.tau": 0.0}
#: Gear ratio, speed of the motor over that of the cam. Convention of the FMU's default.
GEAR = 36.0
#: Gravity [m/s2]. Convention: its standard value.
G = 9.80665
#: Stretch of the spring with the iron down [m]. Convention of the FMU's default.
STRETCH = 0.080
#: Mass of the spring [kg]. Convention of the FMU's default.
SPRING = 0.15
#: Rated torque of the motor [N.m]. Chosen: a data sheet of its size.
RATED = 2.0
#: Standard deviation of the logged torque [%]. Chosen: an inverter's estimate.
NOISE = 2.0
#: Time of the first row after the motor is switched on [s]. Chosen: a logger that is started by hand comes later.
FIRST = 0.1
#: Time of the last row [s]. Chosen: a few turns of the cam.
STOP = 2.5


@cache
def mechanism_curves() -> CubicSpline:
    """J [kg.m2], U [J] and H [m] over the cam angle [rad], without iron and spring force."""
    phi = np.linspace(0.0, 2 * pi, 1441)
    up, top, down = np.radians([100.0, 60.0, 80.0])
    back = (phi - up - top) / down
    x = np.clip(np.where(back < 0, phi / up, 1 - back), 0, 1)
    R = 0.100 + 0.020 * x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
    a = 2.38 - np.arccos((0.150**2 + 0.090**2 - R**2) / (2 * 0.150 * 0.090))
    wheel = 0.0127 / (2 * sin(pi / 20))
    end, over = 0.280 * np.exp(1j * a), complex(-0.400, 0.280 + wheel)
    n = abs(over - end)
    along = (over - end) / n
    run, H = n - 0.200, 0.700 - (n - 0.200) - wheel * pi / 2

    def rate(x: Samples) -> Samples:
        return np.asarray(CubicSpline(phi, x)(phi, 1))

    ends, turns, hangs = rate(end), rate(along), rate(H)
    middle, s = 0.200 + run / 2, 0.200 / 2
    inertia = 0.025 * rate(a) ** 2 + 0.25 * abs(ends + s * turns) ** 2
    inertia += 0.25 * 0.200**2 / 12 * abs(turns) ** 2
    inertia += 0.70 * run * (abs(ends + middle * turns) ** 2 + run**2 / 12 * abs(turns) ** 2)
    carried = 6.0e-4 / wheel**2 + 0.70 * (wheel * pi / 2 + H) + SPRING / 3
    inertia += carried * hangs**2 + 3.0e-4 * GEAR**2 + 0.0125
    height = 2.5 * 0.008 * np.sin(phi + 0.6) + 1.2 * 0.090 * np.sin(a + 0.10)
    height += 0.25 * (end + s * along).imag + 0.70 * run * (end + middle * along).imag
    height += 0.70 * wheel * (pi / 2 * 0.280 + wheel) + 0.70 * H * (0.280 - H / 2) - SPRING * H / 2
    return CubicSpline(phi, np.stack([inertia, G * height, H], axis=1))


def rates(p: Mapping[str, float], t: float, y: Samples) -> list[float]:
    """Derivatives of the cam's angle and speed, and of the motor torque."""
    phi, w, M = y
    at = phi % (2 * pi)
    (J, _, H), (J1, U1, H1), (_, _, H2) = (mechanism_curves()(at, k) for k in range(3))
    K = p["iron.friction.K_down"] if H1 > 0 else p["iron.friction.K_up"]
    m, load = p["iron.iron.m"], (1 + K) * p["iron.iron.m"]
    F = m * G + p["iron.spring.c"] * (STRETCH + mechanism_curves().c[-1, 0, 2] - H)
    torque = GEAR * M - U1 + ((1 + K) * F + K * SPRING * G / 2) * H1
    a = (torque - (J1 / 2 + load * H1 * H2) * w * w) / (J + load * H1**2)
    static = p["motor.A"] - p["motor.B"] * GEAR * w
    return [w, a, (static - M) / p["motor.T"]]


def angle_speed_torque(p: Mapping[str, float], t: Samples) -> Samples:
    """Angle and speed of the cam and motor torque at times t after the start, shape (3, n)."""
    start = list(STATES.values())
    run = solve_ivp(
        lambda t, y: rates(p, t, y), (0.0, t[-1]), start, "DOP853", t,
        rtol=1e-9, atol=1e-9, max_step=1e-2,
    )  # fmt: skip
    return np.asarray(run.y)


def record(seed: int = 1, truth: Mapping[str, float] = TRUTH) -> pd.DataFrame:
    """The rows of the logger."""
    t = row_ends_and_middles(FIRST, STOP)
    phi, _, M = angle_speed_torque(truth, t)
    return pd.DataFrame(
        {
            "t [ms]": 1e3 * t[1::2],
            "n [rpm]": mean_speed(GEAR * (phi - STATES["iron.phi"])),
            "M": percent(M, RATED, NOISE, seed),
        }
    ).round(3)


if __name__ == "__main__":
    write(record, __doc__, "results/measured_iron.csv")
