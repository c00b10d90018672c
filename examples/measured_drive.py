"""Make a record as a logger on a vibrating conveyor would, for identifying the drive.

    python -m examples.measured_drive [FILE.csv [SEED]]

No FMU is involved. SciPy integrates the equations of a motor with a belt and of an exact
slider-crank, for the angle phi and speed w of the crank, the torque M on it and the angle phi_m of
the motor's shaft:

    (J + m x'^2) dw/dt = M - c x x' - d x'^2 w - m x' x'' w^2
    x = r sin phi + sqrt(l^2 - r^2 cos^2 phi) - l,   ' = d/dphi
    T dM/dt + M = i (A - B dphi_m/dt)
    dphi_m/dt = i w (1 + s)

The belt, of ratio i, slips once, on a drop of water: the motor runs ahead by s, up to 3 %. The
conveyor is at rest at mid-stroke, where its spring is relaxed. At t = 0 the 11 kW motor is switched
on with its full setpoint of 950 rpm, which is A / B.

Every 2 ms the logger records:

* `speed [rpm]`: the mean speed of the motor's shaft over these 2 ms, from the counts of an encoder
  with 4096 per turn, in steps of 7.3 rpm; `time [s]` is the middle of the interval;
* `torque [%]`: the inverter's estimate of the motor torque at that time, in percent of the rated
  73 N.m, with noise of 1 % and a resolution of 0.1 %.

The logger loses rows twice, for 20 ms and for 100 ms. The seed determines the noise; nothing else
is random. Identifying the drive should give `TRUTH`. Its names are those of a system of DriveMotor
and CrankConveyor, with the ratio on both wires; there `rod.finite` must be true, and `w` and `tau`
are 0 at t = 0, before the first row. These values are not the defaults of the FMUs, and no belt
slips in their equations, so only the rows before 1.15 s are those of such a drive.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from examples.logger import mean_speed, percent, row_ends_and_middles, write

RPM = 2 * pi / 60
TRUTH = {
    "motor.A": 950 * RPM * 3.1,  # at the motor's shaft, like all values of the motor [N.m]
    "motor.B": 3.1,  # [N.m.s/rad]
    "motor.T": 0.035,  # [s]
    "conveyor.rotor.J": 0.54,  # [kg.m2]
    "conveyor.crank.r": 0.010,  # [m]
    "conveyor.rod.l": 0.4,  # [m]
    "conveyor.trough.m": 188.0,  # [kg]
    "conveyor.trough.d": 3650.0,  # [N.s/m]
    "conveyor.spring.c": 7.6e5,  # [N/m]
}
#: Ratio of the belt, speed of the motor over that of the crank. Chosen: a usual one.
RATIO = 2.4
#: Rated torque of the motor [N.m]. Chosen: that of 11 kW at 1440 rpm.
RATED = 73.0
#: Largest slip of the belt. Chosen: a drop of water.
SLIP = 0.03
#: Time at which the belt begins to slip [s]. Chosen: after the run-up.
SLIP_BEGIN = 1.15
#: Duration of the slip [s]. Chosen: fifty rows.
SLIP_DURATION = 0.1
#: Duration of the record [s]. Chosen: run-up and steady running.
STOP = 2.0
#: Counts of the encoder per turn. Convention: a power of 2.
COUNTS = 4096
GAPS = ((0.54, 0.56), (1.5, 1.6))  # times without rows [s]
#: Standard deviation of the logged torque [%]. Chosen: an inverter's estimate.
NOISE = 1.0


def angles_speed_torque(times: NDArray[np.float64], slip: float = 1.0) -> NDArray[np.float64]:
    """Angle of the crank [rad], its speed [rad/s], torque on it [N.m], angle of the motor [rad].

    At increasing times from t = 0 [s], shape (4, times). With `slip = 0` the belt does not slip.
    """
    A, B, T, J, r, l, m, d, c = TRUTH.values()

    def ahead(t: float) -> float:
        into = (t - SLIP_BEGIN) / SLIP_DURATION
        return SLIP * sin(pi * into) ** 2 if 0 < into < 1 else 0.0

    def rates(t: float, y: list[float]) -> list[float]:
        phi, w, M, _ = y
        R = sqrt(l**2 - (r * cos(phi)) ** 2)
        x = r * sin(phi) + R - l
        x1 = r * cos(phi) * (1 + r * sin(phi) / R)
        x2 = -r * sin(phi) + r**2 * cos(2 * phi) / R - (r**2 * sin(phi) * cos(phi)) ** 2 / R**3
        load = c * x * x1 + d * x1**2 * w + m * x1 * x2 * w**2
        motor = RATIO * w * (1 + slip * ahead(t))
        return [w, (M - load) / (J + m * x1**2), (RATIO * (A - B * motor) - M) / T, motor]

    return solve_ivp(
        rates, (0.0, times[-1]), [0.0] * 4, "DOP853", times, rtol=1e-10, atol=1e-10, max_step=0.01
    ).y


def record(seed: int = 1) -> pd.DataFrame:
    """The rows of the logger."""
    t = row_ends_and_middles(0.0, STOP)
    _, _, M, angle = angles_speed_torque(t)
    rows = pd.DataFrame(
        {
            "time [s]": t[1::2],
            "speed [rpm]": mean_speed(angle, COUNTS),
            "torque [%]": percent(M / RATIO, RATED, NOISE, seed),
        }
    ).round(4)
    for begin, end in GAPS:
        rows = rows[~rows["time [s]"].between(begin, end)]
    return rows


if __name__ == "__main__":
    write(record, __doc__, "results/measured_drive.csv")
