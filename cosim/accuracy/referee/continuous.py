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

import numpy as np

from ...engine.driver import RowReader
from ...errors import FmuError, SetupError
from ...fmu.messages import quiet
from ...system import Network, Port, System, Wire, connect
from ...system.wires import dotted
from ..coupled_ode import CoupledOde, opened
from .connections import plain_wires
from .solution import MOST_ROWS, SolutionRequest
from .table import Array

Slopes = Callable[[float, Array], Array]
#: A step of a method: the states at t + h from those at t.
Method = Callable[[Slopes, float, Array, float], Array]
#: Newton iterations of an implicit step. Each doubles the right digits, once it is close at all.
MOST_ITERATIONS = 8
#: Change of a state in such an iteration, relative to 1 + |state|, below which it has converged: far below what a
#: result that is printed with six digits shows.
CONVERGED = 1e-9
#: Steps of an integration within a communication step that holds its inputs.
STEPS_WITHIN = 4
#: Share of a step by which two times may differ and be one: the rounding of times that are added up.
ROUNDING = 1e-6


def euler(slopes: Slopes, t: float, x: Array, h: float) -> Array:
    """Explicit Euler."""
    return x + h * slopes(t, x)


def implicit_euler(slopes: Slopes, t: float, x: Array, h: float) -> Array:
    """Implicit Euler by Newton's method with a Jacobian of differences; NaN if it does not converge."""
    y = x + h * slopes(t, x)
    at_y = slopes(t + h, y)
    jacobian = np.empty((len(x), len(x)))
    for k in range(len(x)):
        moved = y.copy()
        moved[k] += 1e-7 * (1.0 + abs(y[k]))
        jacobian[:, k] = (slopes(t + h, moved) - at_y) / (moved[k] - y[k])
    matrix = np.eye(len(x)) - h * jacobian
    for _ in range(MOST_ITERATIONS):
        if not (np.isfinite(y).all() and np.isfinite(matrix).all()):
            break
        step = np.linalg.solve(matrix, x + h * at_y - y)
        y = y + step
        if (np.abs(step) <= CONVERGED * (1.0 + np.abs(y))).all():
            return y
        at_y = slopes(t + h, y)
    return np.full(len(x), math.nan)


def runge_kutta(slopes: Slopes, t: float, x: Array, h: float) -> Array:
    """The classical method of order 4, whose error is far below that of Euler's and of a late input."""
    a = slopes(t, x)
    b = slopes(t + 0.5 * h, x + 0.5 * h * a)
    c = slopes(t + 0.5 * h, x + 0.5 * h * b)
    return x + h / 6.0 * (a + 2.0 * b + 2.0 * c + slopes(t + h, x + h * c))


def heun(slopes: Slopes, t: float, x: Array, h: float) -> Array:
    """Heun's method of order 3, which evaluates nothing at the end of a step, where held inputs jump."""
    a = slopes(t, x)
    b = slopes(t + h / 3.0, x + h / 3.0 * a)
    return x + h / 4.0 * (a + 3.0 * slopes(t + 2.0 * h / 3.0, x + 2.0 * h / 3.0 * b))


#: Euler's methods, as a cause names them.
EULER: Mapping[str, Method] = {
    "Euler's method": euler,
    "the implicit Euler method": implicit_euler,
}


class History:
    """The outputs of a run so far, for inputs that follow them a time later."""

    def __init__(self, initial: Mapping[str, float]) -> None:
        self.times: list[float] = []
        self.values = {name: [value] for name, value in initial.items()}

    def add(self, t: float, values: Mapping[str, float]) -> None:
        """Append a row, at the start time in place of the initial values."""
        for name, column in self.values.items():
            if not self.times:
                column.clear()
            column.append(values[name])
        self.times.append(t)

    def at(self, name: str, t: float) -> float:
        """The cubic through the four rows around a time [s]; before the first row, its value."""
        times, column = self.times, self.values[name]
        if not times or t <= times[0]:
            return column[0]
        last = bisect_right(times, t)
        begin = max(0, min(last - 2, len(times) - 4))
        x, y = times[begin : begin + 4], column[begin : begin + 4]
        total = 0.0
        for i, xi in enumerate(x):
            weight = y[i]
            for j, xj in enumerate(x):
                weight *= (t - xj) / (xi - xj) if i != j else 1.0
            total += weight
        return total


def integrated(
    system: System, request: SolutionRequest, method: Method, step: float
) -> dict[str, Array] | None:
    """The wanted columns if the whole system is stepped by a method; None if that cannot be done.

    Parameters
    ----------
    system : System
        Parts with model exchange.
    request : SolutionRequest
        Columns and times.
    method : Method
        Euler's, or another.
    step : float
        Its step [s].
    """
    if (request.stop - request.start) / step > MOST_ROWS:
        return None
    try:
        network = connect(system)
        return _columns(network, request, method, step, History({}))
    except (SetupError, FmuError):
        return None


def initial_outputs(network: Network, request: SolutionRequest) -> dict[str, float] | None:
    """The Real outputs on wires at the start; None if a part has no model exchange."""
    sources = {wire.source.name: wire.source for wire in network.wires}
    ports = [port for port in sources.values() if port.type == "Real"]
    try:
        with quiet(), opened(network, request.start, request.stop) as ode:
            return dict(zip([port.name for port in ports], _reader(ode, ports)(request.start)))
    except (SetupError, FmuError):
        return None


def late(
    network: Network,
    request: SolutionRequest,
    wires: Sequence[Wire],
    delay: float,
    initial: Mapping[str, float],
    *,
    held: bool = False,
) -> dict[str, Array] | None:
    """The wanted columns if what these wires bring arrives a time later; None if that cannot be computed.

    Parameters
    ----------
    network : Network
        The system.
    request : SolutionRequest
        Columns and times.
    wires : sequence of Wire
        Those of `plain_wires` that are late.
    delay : float
        By how much [s].
    initial : mapping of str to float
        What they bring until then: the outputs at the start.
    held : bool
        Whether the delay is a communication step, over each of which the inputs hold what their sources were at the
        begin of the one before.
    """
    step = delay / math.ceil(delay / min(request.output_step(), delay))
    if held:
        step = delay / STEPS_WITHIN
    if (request.stop - request.start) / step > MOST_ROWS:
        return None
    history = History(
        {source: initial[source] for source in (dotted(wire.source) for wire in wires)}
    )

    def delayed(wire: Wire) -> Callable[[float], float]:
        source, start = dotted(wire.source), request.start

        def seen(t: float) -> float:
            if held:
                t = start + delay * math.floor((t - start) / delay + ROUNDING)
            return wire.factor * history.at(source, t - delay) + wire.offset

        return seen

    kept = [wire for wire in plain_wires(network) if wire not in wires]
    inputs = {**network.system.inputs, **{dotted(wire.target): delayed(wire) for wire in wires}}
    system = replace(network.system, wires=kept, bonds=(), inputs=inputs)
    try:
        method = heun if held else runge_kutta
        return _columns(connect(system), request, method, step, history)
    except (SetupError, FmuError):
        return None


def _columns(
    network: Network, request: SolutionRequest, method: Method, step: float, history: History
) -> dict[str, Array] | None:
    """The columns at the wanted times; None for states that are no longer finite. Raises SetupError, FmuError."""
    ports = [network.port(name) for name in {*request.names, *history.values}]
    names = [port.name for port in ports]
    times: list[float] = []
    rows: list[list[float]] = []
    with quiet(), opened(network, request.start, request.stop) as ode:
        ode.deadline = clock.monotonic() + request.timeout
        read = _reader(ode, ports)
        history.add(ode.t, dict(zip(names, read(ode.t))))
        for t, finite in _steps(ode, request, method, step):
            if not finite:
                return None
            row = read(t)
            times.append(t)
            rows.append(row)
            if t > request.start:
                history.add(t, dict(zip(names, row)))
    columns = dict(zip(names, np.array(rows).T))
    return {name: _at(request.times, np.array(times), columns[name]) for name in request.names}


def _steps(
    ode: CoupledOde, request: SolutionRequest, method: Method, step: float
) -> Iterator[tuple[float, bool]]:
    """Step to the stop time: the time [s] of each row, and whether all states are finite."""
    x, signs, number = ode.x, ode.signs(), 1
    yield ode.t, True
    while ode.t < request.stop:
        t = ode.t
        ode.until = ode.next_stop(request.stop)
        end = request.start + number * step
        number += end <= ode.until + ROUNDING * step
        if end >= ode.until - ROUNDING * step:
            end = ode.until
        x = method(ode.slopes, t, x, end - t)
        if not np.isfinite(x).all():
            yield end, False
            return
        ode.at(end, x)
        is_planned = end == ode.until and (end < request.stop or end in ode.stops)
        if ode.completed() or is_planned or ode.signs() != signs:
            ode.until = math.inf
            ode.jump(end)
            x, signs = ode.x, ode.signs()
        yield end, True


def _reader(ode: CoupledOde, ports: Sequence[Port]) -> Callable[[float], list[float]]:
    """Reads variables of a system."""
    row = RowReader(ode.parts, ports)

    def read(t: float) -> list[float]:
        for part in ode.parts:
            for block in part.outputs:
                block.move()
        return row(t)[1:]

    return read


def _at(wanted: Array, times: Array, column: Array) -> Array:
    """A column at other times: where a row is, its value, and between rows a cubic spline."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(times, column)(wanted)) if len(times) > 1 else column
