r"""Source of a voltage that is switched on and off.

$$ v = V \text{ for } t_1 \le t < t_2, \quad \text{else } 0 $$
"""

from __future__ import annotations

from fmukit import Experiment, discrete, real, record, replace
from fmukit.si import Time, Voltage

EXPERIMENT = Experiment(stop=0.5, step=1e-3)


@record
class Parameters:
    V: Voltage = real(48.0, "Voltage while it is on")
    t_1: Time = real(0.10037, "When it is switched on")
    t_2: Time = real(0.30121, "When it is switched off")


@record
class State:
    switched: int = discrete(0, "How many times it has been switched")


@record
class Outputs:
    v: Voltage = real(0.0, "Voltage")


def derivatives(p: Parameters, t: float, x: State, u: tuple[()]) -> State:
    return x


def event_indicators(p: Parameters, t: float, x: State, u: tuple[()]) -> tuple[float]:
    """Below zero where it is time to switch."""
    return (p.t_1 - t if x.switched == 0 else p.t_2 - t if x.switched == 1 else 1.0,)


def event_update(p: Parameters, t: float, x: State, u: tuple[()], which: int) -> State:
    return replace(x, switched=x.switched + 1)


def outputs(p: Parameters, t: float, x: State, u: tuple[()]) -> Outputs:
    return Outputs(v=p.V if x.switched == 1 else 0.0)
