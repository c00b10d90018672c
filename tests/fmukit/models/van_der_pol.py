r"""Oscillator of van der Pol

$$ \dot x_0 = x_1, \qquad \dot x_1 = \mu\,(1 - x_0^2)\,x_1 - x_0 $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import Ratio

EXPERIMENT = Experiment(stop=20.0, step=0.01)


@record
class Parameters:
    mu: Ratio = real(1.0, "Damping")


@record
class State:
    x0: Ratio = real(2.0, "First state")
    x1: Ratio = real(0.0, "Second state")


def derivatives(p: Parameters, t: float, x: State, u: tuple[()]) -> State:
    return State(x0=x.x1, x1=p.mu * (1.0 - x.x0**2) * x.x1 - x.x0)
