r"""Predator of Lotka and Volterra.

$$ \dot y = y\,(d\,x - c) $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import Rate, Ratio

EXPERIMENT = Experiment(stop=100.0, step=0.1)


@record
class Parameters:
    c: Rate = real(0.4, "Rate at which predators starve")
    d: Rate = real(0.02, "Rate at which one prey lets them multiply")


@record
class Inputs:
    x: Ratio = real(10.0, "Number of prey")


@record
class State:
    y: Ratio = real(10.0, "Number of predators", nominal=10.0)


def derivatives(p: Parameters, t: float, x: State, u: Inputs) -> State:
    return State(y=x.y * (p.d * u.x - p.c))
