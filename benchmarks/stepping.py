"""What a stepping rule costs and gives inside an FMU: python benchmarks/stepping.py.

The conveyor alone, its torque held over every communication step, by classical Runge-Kutta steps of
a fixed length and by the pair of Dormand and Prince that the FMUs use. Shown are evaluations of the
right-hand side per communication step and the largest error of the crank's speed, against DOP853.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from components.crank_conveyor import model as conveyor
from fmukit.declare.record import start
from fmukit.runtime import hybrid as motion
from fmukit.runtime import ode

#: Length of a communication step [s]. Chosen: that of the FMU's default experiment.
LENGTH = 1e-3
#: Duration of the motion [s]. Chosen: a few revolutions.
SPAN = 0.5
#: Share of a step that may be left over without one more. Derived: the quotient of two decimals is rounded by
#: 3 * 2^-53 of it, which for the most steps in SPAN is 2e-13.
LEFT_OVER = 1e-9
#: Relative tolerance of the exact motion. Chosen: near the least that SciPy takes, 2e-14.
RELATIVE_TOLERANCE = 1e-13
#: Absolute tolerance of the exact motion [rad, rad/s]. Chosen: a tenth of the relative one, since an angle starts at 0.
ABSOLUTE_TOLERANCE = 1e-14
Slope = Callable[[float, Sequence[float]], Sequence[float]]
Rule = Callable[[Slope, Sequence[float], float], Sequence[float]]


def fixed(slope: Slope, x: Sequence[float], h: float) -> Sequence[float]:
    """Runge-Kutta of order 4 in the fewest equal steps of LENGTH at most."""
    count = math.ceil(h / LENGTH - LEFT_OVER)
    size = h / count
    for _ in range(count):
        k1 = slope(0.0, x)
        k2 = slope(0.0, [y + size / 2 * a for y, a in zip(x, k1)])
        k3 = slope(0.0, [y + size / 2 * a for y, a in zip(x, k2)])
        k4 = slope(0.0, [y + size * a for y, a in zip(x, k3)])
        x = [y + size / 6 * (a + 2 * b + 2 * c + d) for y, a, b, c, d in zip(x, k1, k2, k3, k4)]
    return x


def adaptive(slope: Slope, x: Sequence[float], h: float) -> Sequence[float]:
    """The rule of the FMUs."""
    return ode.integrate(slope, x, h, motion.tolerances(conveyor.State))


def exact(slope: Slope, x: Sequence[float], h: float) -> Sequence[float]:
    """As precise as doubles allow."""
    done = solve_ivp(
        slope, (0.0, h), x, method="DOP853", rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE
    )
    return [float(y) for y in done.y[:, -1]]


def travel(rule: Rule, nu: float, h: float) -> tuple[float, np.ndarray]:
    """Evaluations per communication step, and the speeds at the communication points."""
    p = start(conveyor.Parameters)
    x: Sequence[float] = [0.0, nu]
    steps = round(SPAN / h)
    calls, speeds = 0, []
    for n in range(steps):
        torque = p.trough.d * p.crank.r**2 / 2 * nu + 100.0 * math.cos(2 * nu * n * h)

        def slope(_: float, y: Sequence[float], torque: float = torque) -> Sequence[float]:
            nonlocal calls
            calls += 1
            return conveyor.derivatives(p, 0.0, conveyor.State(*y), conveyor.Inputs(torque))

        x = rule(slope, x, h)
        speeds.append(x[1])
    return calls / steps, np.array(speeds)


def main() -> None:
    print(
        f"{'speed':>6} {'step':>8} {'fixed: calls':>13} {'error':>8} {'pair: calls':>12} {'error':>8}"
    )
    for nu in (20.0, 40.0, 66.0):
        for h in (2.5e-4, 1e-3, 5e-3):
            _, true = travel(exact, nu, h)
            line = f"{nu:>6g} {1e3 * h:>5g} ms"
            for rule, width in ((fixed, 13), (adaptive, 12)):
                calls, speeds = travel(rule, nu, h)
                line += f" {calls:>{width}.1f} {abs(speeds - true).max():>8.1e}"
            print(line)


if __name__ == "__main__":
    main()
