"""What goes wrong without any coupling step: Euler's method over a whole system, inputs that are late.

The model-exchange sides of all parts are stepped as one differential equation, with steps of a fixed size;
a master of that kind notices an event at the end of its step, and so does this one.
"""

from __future__ import annotations

import math
import time as clock
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ...errors import FmuError, SetupError
from ...fmu.messages import quiet
from ...system import Network, Wire, connect
from ..coupled_ode import CoupledOde
from .solution import Array, Request

Slopes = Callable[[float, Array], Array]
#: A step of a method: the states at t + h from those at t.
Method = Callable[[Slopes, float, Array, float], Array]
#: What is left of the equation of an implicit step, relative to 1 + |state|, when it is solved: far below what a
#: result that is printed with six digits shows.
SOLVED = 1e-9
#: Most steps: limits the time, since each takes a millisecond or so.
MOST_WHOLE_STEPS = 20_000
#: Steps of an integration within a communication step that holds its inputs.
STEPS_WITHIN = 4
#: Share of a step by which two times may differ and be one: the rounding of times that are added up.
ROUNDING = 1e-6
#: Rows through which a cubic is laid.
CUBIC = 4
#: Rows of the matrices and weights of explicit methods of Runge and Kutta: Euler's; Heun's of order 3, which evaluates
#: nothing at the end of a step, where held inputs jump; the classical one of order 4.
EULER = [[1.0]]
HEUN = [[1 / 3], [0.0, 2 / 3], [1 / 4, 0.0, 3 / 4]]
CLASSICAL = [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]]


def explicit(
    rows: Sequence[Sequence[float]], slopes: Slopes, t: float, x: Array, h: float
) -> Array:
    """A step of an explicit method of Runge and Kutta."""
    at, y, found = t, x, list[Array]()
    for row in rows:
        found.append(slopes(at, y))
        at, y = t + h * sum(row), x + h * sum(a * k for a, k in zip(row, found))
    return y


def implicit_euler(slopes: Slopes, t: float, x: Array, h: float) -> Array:
    """A step of the implicit Euler method; NaN if its equation cannot be solved."""
    from scipy.optimize import root

    def left(y: Array) -> Array:
        return y - x - h * slopes(t + h, y)

    y = root(left, x + h * slopes(t, x), tol=0.1 * SOLVED).x
    is_solved = (np.abs(left(y)) <= SOLVED * (1.0 + np.abs(y))).all()
    return y if is_solved else np.full(len(x), math.nan)


#: Euler's methods, as a cause names them.
EULERS: Mapping[str, Method] = {
    "Euler's method": partial(explicit, EULER),
    "the implicit Euler method": implicit_euler,
}


class History:
    """Outputs of a run so far by their names, for inputs that follow them a time later; values until it begins."""

    def __init__(self, names: Sequence[str] = (), values: Sequence[float] = ()) -> None:
        self.names, self.rows = names, [values]
        self.times: list[float] = []

    def add(self, t: float, values: Sequence[float]) -> None:
        """Append a row, at the start time in place of the first values."""
        if not self.times:
            self.rows.clear()
        self.rows.append(values)
        self.times.append(t)

    def at(self, k: int, t: float) -> float:
        """Column k at a time [s], by the cubic through the four rows around it; before the first row, its value."""
        if not self.times or t <= self.times[0]:
            return self.rows[0][k]
        begin = max(0, min(bisect_right(self.times, t) - 2, len(self.times) - CUBIC))
        x = self.times[begin : begin + CUBIC]
        return sum(
            row[k] * math.prod((t - other) / (at - other) for other in x if other != at)
            for at, row in zip(x, self.rows[begin:])
        )


def wires_with_total_factors(network: Network) -> list[Wire]:
    """The checked wires with their total factors and offsets."""
    sums = network.sums()
    return [
        Wire(a.name, b.name, factor, offset, converts=False, adds=b.name in sums)
        for a, b, factor, offset in network.wires
    ]


def by_method(network: Network, request: Request, method: Method, step: float) -> Array | None:
    """The wanted columns if the whole system is stepped by a method, shape (columns, rows); None if it cannot be."""
    try:
        return _columns(network, request, method, step, History())
    except (SetupError, FmuError):
        return None


def late(
    network: Network, request: Request, wires: Sequence[Wire], delay: float, *, held: bool = False
) -> Array | None:
    """The wanted columns if what these wires bring arrives a time [s] later; None if that cannot be computed.

    If it is `held`, the delay is a communication step, over each of which inputs hold what their sources were at the
    start of the one before.
    """
    step = delay / (STEPS_WITHIN if held else math.ceil(delay / min(request.output_step(), delay)))
    sources = list(dict.fromkeys(str(wire.source) for wire in wires))
    start = request.start

    def delayed(wire: Wire) -> Callable[[float], float]:
        k = sources.index(str(wire.source))

        def seen(t: float) -> float:
            if held:
                t = start + delay * math.floor((t - start) / delay + ROUNDING)
            return wire.factor * history.at(k, t - delay) + wire.offset

        return seen

    system = network.system
    inputs = {**system.inputs, **{str(wire.target): delayed(wire) for wire in wires}}
    kept = [wire for wire in wires_with_total_factors(network) if wire not in wires]
    try:
        with quiet(), CoupledOde.open(network, start, request.stop) as ode:
            history = History(sources, ode.reader([network.port(name) for name in sources])())
        changed = connect(replace(system, wires=kept, bonds=(), inputs=inputs))
        method = partial(explicit, HEUN if held else CLASSICAL)
        return _columns(changed, request, method, step, history)
    except (SetupError, FmuError):
        return None


def _columns(
    network: Network, request: Request, method: Method, step: float, history: History
) -> Array | None:
    """The columns; None for too many steps and for states that are no longer finite. Raises SetupError, FmuError."""
    if (request.stop - request.start) / step > MOST_WHOLE_STEPS:
        return None
    times: list[float] = []
    rows: list[list[float]] = []
    with quiet(), CoupledOde.open(network, request.start, request.stop) as ode:
        ode.deadline = clock.monotonic() + request.timeout
        read = ode.reader([network.port(name) for name in request.names])
        sent = ode.reader([network.port(name) for name in history.names])
        for t in _steps(ode, request, method, step):
            times.append(t)
            rows.append(read())
            history.add(t, sent())
    columns = np.array(rows)
    return request.interpolated(np.array(times), columns) if np.isfinite(columns).all() else None


def _steps(ode: CoupledOde, request: Request, method: Method, step: float) -> Iterator[float]:
    """Step to the stop time: the time [s] of each row."""
    x, signs, number = ode.x, ode.signs(), 1
    yield ode.t
    while ode.t < request.stop:
        ode.until = ode.next_stop(request.stop)
        end = request.start + number * step
        number += end <= ode.until + ROUNDING * step
        if end >= ode.until - ROUNDING * step:
            end = ode.until
        x = method(ode.slopes, ode.t, x, end - ode.t)
        if not np.isfinite(x).all():
            raise FmuError(f"the states are no longer finite at t = {end!r} s")
        ode.at(end, x)
        is_planned = end == ode.until and (end < request.stop or end in ode.stops)
        if ode.wants_event_after_step() or is_planned or ode.signs() != signs:
            ode.until = math.inf
            ode.jump(end)
            x, signs = ode.x, ode.signs()
        yield end
