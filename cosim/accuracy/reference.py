"""The solution of a coupled system without any coupling error, and how far a run is from it.

The model-exchange sides of all parts form one ordinary differential equation, which SciPy integrates
with tight tolerances and events located to the last digits.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ..engine.changes import known_jumps, source_jumps
from ..engine.settings import RunSettings
from ..errors import FmuError, SetupError
from ..fmu.exchange import Array
from ..result import Result, SimulationError
from ..series import TIME
from ..simulation import versions
from ..system import Port, System, connect, require_cosimulation
from .certify import Metrics, certify, evaluate, summary_metrics
from .coupled_ode import CoupledOde
from .estimate import Estimate

METHODS = ("DOP853", "Radau", "LSODA")
#: Relative tolerance of the integration. A convention: somewhat above the least that SciPy takes, which is
#: 100 times the machine precision, 2e-14, and leaves no room for the rounding of the rates.
DEFAULT_TOLERANCE = 1e-12
#: Least tolerance that may be asked for: a convention of this project, five times what SciPy takes at least.
LEAST_TOLERANCE = 1e-13
#: Largest tolerance that may be asked for: a convention of this project, which limits how rough a reference may be.
LARGEST_TOLERANCE = 1e-3
#: Ratio of the tolerances of the two integrations. Derived: where errors are in proportion to the tolerance, the
#: distance of the two results is nine times the error of the better one.
TOLERANCE_RATIO = 10.0
#: Intervals between rows unless their distance is set. A convention: about one for each point across a chart.
ROW_INTERVALS = 1000
#: Events at one time after which the system makes no progress. A convention: cascades of a few are real.
MOST_AT_ONCE = 100


class SolutionPiece(NamedTuple):
    """The states over time from `begin` to `end` [s]; no curve at an event, just before it and once more just after."""

    begin: float
    end: float
    curve: Callable[[float], Array] | None


class Compared(NamedTuple):
    """A figure as certified by runs of the master, and its value by the oracle."""

    certified: Estimate
    true: float

    @property
    def error(self) -> float:
        """The true error of the certified value."""
        return abs(self.certified.value - self.true)


class Judged(NamedTuple):
    """The oracle's result, and every figure next to the certified one."""

    result: Result
    figures: dict[str, Compared]


def oracle(
    system: System,
    *,
    stop: float,
    start: float = 0.0,
    output_step: float | None = None,
    times: Array | None = None,
    record: Sequence[str] | None = None,
    method: str = "DOP853",
    tolerance: float = DEFAULT_TOLERANCE,
    timeout: float = math.inf,
) -> Result:
    """Integrate the coupled system as one ordinary differential equation.

    Where an input jumps or a parameter changes, and at each event at which a column jumps, there are two more rows,
    with equal times: before and after.

    The system is integrated twice. `provenance["errors"]` gives, by column, the largest distance of the
    rows from those with a tolerance TOLERANCE_RATIO times as large, but for a single row between the two times of an
    event; `provenance["events"]` gives the times [s] of all events. Inputs over time act continuously, as do the
    wires. An event that begins and ends within half a step of the integrator may be missed.

    Parameters
    ----------
    system : System
        What is integrated; each part needs a model-exchange side.
    stop : float
        When the run ends [s].
    start : float
        When it begins [s].
    output_step : float, optional
        The distance of the rows [s], by default a thousandth of the time.
    times : array of shape (rows,), optional
        The times of the rows after the first [s], which rise, in place of equally distant ones.
    record : sequence of str, optional
        The columns, by default all outputs.
    method : str
        DOP853 of `scipy.integrate`, or Radau or LSODA for stiff systems.
    tolerance : float
        The tolerance relative to each state, or to its nominal value where that is larger.
    timeout : float
        The most real time for each integration [s].

    Raises
    ------
    SetupError
        For a part without model exchange and for settings that cannot be run.
    SimulationError
        If a part or the integrator fails, or if an integration takes longer than `timeout` of real time.
    """
    if not timeout > 0.0:
        raise SetupError(f"timeout = {timeout!r} s must be above 0")
    network = connect(system)
    spacing = (stop - start) / ROW_INTERVALS if output_step is None else output_step
    RunSettings(stop, 1.0, start, output_step=output_step).check()
    plan = RunSettings(stop, spacing, start, record=record)
    ports = plan.ports(network)
    equal = np.append(start + np.arange(1, plan.number()) * spacing, stop)
    wanted = equal if times is None else times
    if method not in METHODS:
        raise SetupError(f"method {method!r} must be one of {', '.join(METHODS)}")
    if not LEAST_TOLERANCE <= tolerance <= LARGEST_TOLERANCE:
        raise SetupError(
            f"tolerance = {tolerance!r} must be at least {LEAST_TOLERANCE} and at most {LARGEST_TOLERANCE}"
        )
    for port, profile in network.inputs:
        if lack := profile.lacks(start, stop):
            raise SetupError(f"{port.name}: its table {lack}")
    began = clock.perf_counter()
    provenance: dict[str, Any] = {
        "algorithm": "oracle", "communication": f"{method}, tolerance {tolerance:g}",
        "start": start, "stop": stop, "wires": [str(wire) for wire in system.wires],
        "start_values": dict(system.start), "versions": versions(), "bonds": {}, "warnings": [],
    }  # fmt: skip

    def once(allowed: float) -> Result:
        with CoupledOde.open(network, start, stop) as ode:
            ode.deadline = clock.monotonic() + timeout
            rows: list[list[float]] = []
            events: list[float] = []
            outcome = {"status": "complete", "reason": "", "reached": stop, "events": events}
            try:
                pieces = travel(ode, stop, method, allowed)
                rows.extend(_rows(ode, ports, wanted, pieces, events))
            except FmuError as failure:
                outcome |= {"status": "failed", "reason": str(failure), "reached": ode.t}
            outcome["warnings"] = [
                f"{part.name}: {text}" for part in ode.parts for text in part.messages.warnings
            ]
        columns = [TIME, *(port.column for port in ports)]
        times = [row[0] for row in rows]
        jumps = [(a, a) for a, b in pairwise(times) if a == b]
        result = Result(
            columns,
            provenance | outcome,
            np.array(rows).reshape(-1, len(columns)).T.__getitem__,
            breaks=np.array(jumps).reshape(-1, 2),
        )
        if outcome["status"] == "failed":
            raise SimulationError(
                f"{outcome['reason']}; stopped at t = {outcome['reached']!r} s", result
            )
        return result

    try:
        loose, result = once(TOLERANCE_RATIO * tolerance), once(tolerance)
    except FmuError as failure:
        raise SetupError(str(failure)) from failure
    distances = _distances(result, loose)
    result.provenance["errors"] = dict(zip(result.names[1:], distances[1:].tolist()))
    result.provenance["wall_time"] = clock.perf_counter() - began
    return result


def _distances(tight: Result, loose: Result) -> Array:
    """The largest distance of two results in each column, at the times that both have.

    A single row between the two times of an event, before it in one of them only, does not count. Two rows tell that it
    is another event, or that its time is in doubt; and events of different number do not belong together.
    """
    common, *rows = np.intersect1d(tight.data[:, 0], loose.data[:, 0], return_indices=True)
    distances = np.abs(tight.data[rows[0]] - loose.data[rows[1]])
    events = [result.provenance["events"] for result in (tight, loose)]
    if len(events[0]) == len(events[1]):
        for both in zip(*events):
            between = (common >= min(both)) & (common <= max(both))
            if between.sum() == 1:
                distances[between] = 0.0
    return np.asarray(distances.max(axis=0))


def true_errors(
    system: System,
    metrics: Metrics | None = None,
    *,
    method: str = "DOP853",
    timeout: float = math.inf,
    **settings: Any,
) -> Judged:
    """Certify metrics of runs with a communication step [s], and compare them with the oracle's.

    The oracle's rows are as far apart as those of the runs, and each of its two integrations may take
    `timeout` [s] of real time. `settings` are those of `run`. Raises what
    `oracle` and `certify` raise; parts for model exchange only are refused, since they cannot be run.

    Parameters
    ----------
    system : System
        What is run and integrated.
    metrics : mapping or function, optional
        Those of `certify`.
    method : str
        The oracle's method of integration.
    timeout : float
        The most real time for each integration [s].
    **settings
        Those of `run`.
    """
    require_cosimulation(connect(system).descriptions, system.parts)
    own = {name: settings[name] for name in ("stop", "start", "record") if name in settings}
    rows = settings.get("output_step", settings["step"])
    exact = oracle(system, **own, output_step=rows, method=method, timeout=timeout)
    if metrics is None:
        metrics = summary_metrics(exact.names[1:])
    truth = evaluate(metrics, exact)
    certified = certify(system, metrics, **settings).figures
    return Judged(exact, {name: Compared(e, float(truth[name])) for name, e in certified.items()})


def travel(ode: CoupledOde, stop: float, method: str, tolerance: float) -> Iterator[SolutionPiece]:
    """Integrate to `stop` [s], piece by piece; after an event, the state that it left."""
    from scipy import integrate

    at_once = 0
    floor = tolerance * ode.nominals
    while ode.t < stop:
        begin, x = ode.t, ode.x
        ode.until = end = ode.next_stop(stop)
        if not len(x):
            raise FmuError("no part has a continuous state")
        solver = getattr(integrate, method)(ode.slopes, begin, x, end, rtol=tolerance, atol=floor)
        ode.at(begin, x)
        signs, event_time = ode.signs(), None
        while solver.status == "running" and event_time is None:
            message = solver.step()
            if solver.status == "failed":
                raise FmuError(f"{method} stopped at t = {solver.t!r} s: {message}")
            curve = solver.dense_output()
            event_time = _crossing(ode, signs, curve, float(solver.t_old), float(solver.t))
            last = float(solver.t) if event_time is None else event_time
            yield SolutionPiece(float(solver.t_old), last, curve)
            ode.at(last, solver.y if event_time is None else curve(last))
            if event_time is None and ode.wants_event_after_step():
                event_time = last
        if event_time is not None or end < stop or end in ode.stops:
            at_once = at_once + 1 if ode.t - begin <= 64 * math.ulp(ode.t) else 0
            if at_once > MOST_AT_ONCE:
                raise FmuError(f"events follow each other without end at t = {ode.t!r} s")
            yield SolutionPiece(ode.t, ode.t, None)
            ode.until = math.inf
            ode.jump(ode.t)
            yield SolutionPiece(ode.t, ode.t, None)


def _crossing(
    ode: CoupledOde, signs: list[float], curve: Callable[[float], Array], a: float, b: float
) -> float | None:
    """The first time [s] after `a`, to the last digits, at which an indicator has changed its sign."""

    def changed(t: float) -> bool:
        ode.at(t, curve(t))
        return ode.signs() != signs

    if not signs:
        return None
    for end in (0.5 * (a + b), b):
        if changed(end):
            while end - a > 2 * math.ulp(end):
                middle = 0.5 * (a + end)
                a, end = (a, middle) if changed(middle) else (middle, end)
            return end
        a = end
    return None


def _rows(
    ode: CoupledOde,
    ports: Sequence[Port],
    times: Array,
    pieces: Iterable[SolutionPiece],
    events: list[float],
) -> Iterator[list[float]]:
    """The rows at the start and at times [s], and those before and after a jump."""
    read = ode.reader(ports)
    start, stop = ode.t, ode.stop
    last = [start, *read()]
    yield last
    known = {jump.time for jump in known_jumps(ode.changes, source_jumps(ode.feeds, start, stop))}
    waiting = iter(times[(times > start) & (times <= stop)].tolist())
    due = next(waiting, math.inf)
    before: list[float] = []
    for _, end, curve in pieces:
        if curve is not None:
            while due <= end:
                ode.at(due, curve(due))
                last = [due, *read()]
                yield last
                due = next(waiting, math.inf)
        elif not before:
            before = [end, *read()]
        else:
            events.append(end)
            after = [end, *read()]
            if after != before or end in known:
                yield from (after,) if last[0] == end else (before, after)
                last = after
            before = []
