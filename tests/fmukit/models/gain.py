r"""Gain without a state and without a parameter

$$ y = 2\,u $$
"""

from __future__ import annotations

from fmukit import Experiment, real, record
from fmukit.si import Ratio

EXPERIMENT = Experiment(stop=1.0, step=0.1)


@record
class Inputs:
    u: Ratio = real(1.5, "Input")


@record
class Outputs:
    y: Ratio = real(0.0, "Twice the input", feedthrough=("u",))


def outputs(p: tuple[()], t: float, x: tuple[()], u: Inputs) -> Outputs:
    return Outputs(y=2.0 * u.u)
