r"""Prey of Lotka and Volterra.

$$ \dot x = x\,(a - b\,y) $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import Rate, Ratio

EXPERIMENT = Experiment(stop=100.0, step=0.1)


@record
class Parameters:
    a: Rate = real(0.1, "Rate at which prey multiplies")
    b: Rate = real(0.02, "Rate at which one predator kills")


@record
class Inputs:
    y: Ratio = real(10.0, "Number of predators")


@record
class State:
    x: Ratio = real(10.0, "Number of prey", nominal=10.0)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(x=x.x * (p.a - p.b * u.y))
