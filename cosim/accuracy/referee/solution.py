"""The reference solution at the times of a table, each value with its error."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...dense import Curves
from ...engine.settings import RunSettings
from ...errors import SetupError
from ...fmu.messages import quiet
from ...fmu.reference_rows import ReferenceRows
from ...prepared import Prepared
from ...result import Result, SimulationError
from ...system import Network
from ...system.graph import algebraic_loops
from ..limit import limit
from ..reference import oracle

Array = NDArray[np.float64]
Columns = Mapping[str, Array]
#: Relative tolerance of the integration: a convention, 1e-4 of the smallest tolerance that a user is likely to ask
#: for (1e-6). The second integration, ten times looser, measures what is left of it.
INTEGRATION_TOLERANCE = 1e-10
#: How much the rows of a table may deviate from equal spacing and count as equally spaced, as a share of the
#: spacing: the rounding of times that are printed with six digits.
SPACING_TOLERANCE = 1e-3
#: Share of the rows of a table that must be equally spaced: a convention; masters add rows at events.
ON_GRID = 0.8
#: Fewest rows of a run whose columns are interpolated: a convention, that of `oracle`.
FEWEST_ROWS = 1000
#: How many times denser than the table those rows are.
DENSITY = 4
#: Differences of two runs that are rounding, as a share of the largest value: a thousand units of double precision
#: (2.2e-16), and of several operations in each step.
RELATIVE_ROUNDING = 1e-12
#: Most times that the step of runs is halved: each doubles the time; 2^8 steps in place of one.
MOST_STEP_HALVINGS = 8
#: Share of a run over which an error is the largest nearby: differences of two runs cross zero, errors do not.
ENVELOPE = 0.01


@dataclass(frozen=True)
class ReferenceSolution:
    """The solution of a coupled system at given times.

    Attributes
    ----------
    time : array of shape (rows,)
        Times [s].
    values, errors : mapping of str to array of shape (rows,)
        By dotted name, in the unit of the variable. An error is infinite where none can be stated.
    method : str
        How it was computed, as a clause.
    events : tuple of float
        Times [s] at which it may jump.
    """

    time: Array
    values: Columns
    errors: Columns
    method: str
    events: tuple[float, ...] = ()


@dataclass(frozen=True)
class Request:
    """What of a system is wanted: columns at times, how exactly, and for how long to try.

    `precision` is the error that runs aim at, as a share of the range of each column. `step` [s] is where they begin.
    `timeout` [s] is the longest time that an integration may take. `jumps` are those of the times that stand for the
    moment after a jump [s].
    """

    names: list[str]
    times: Array
    start: float
    precision: float
    step: float | None = None
    timeout: float = 120.0
    jumps: Array = field(default_factory=lambda: np.empty(0))

    @property
    def stop(self) -> float:
        """The last time [s]."""
        return float(self.times[-1])

    @property
    def spacing(self) -> float:
        """The median time between rows [s]."""
        return float(np.median(np.diff(self.times)))

    def output_step(self) -> float:
        """The time between rows of a run [s]: that of the table where most rows are equally spaced from the start."""
        steps = (self.times - self.start) / self.spacing
        on_grid = np.abs(steps - np.round(steps)) <= SPACING_TOLERANCE
        if np.mean(on_grid) >= ON_GRID:
            last = float(self.times[on_grid][-1]) - self.start
            return last / max(1, round(last / self.spacing))
        return (self.stop - self.start) / max(FEWEST_ROWS, DENSITY * len(self.times))

    def nearest(self, times: Array) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """The rows nearest to the wanted times, and whether they are at them but for rounding."""
        k = np.clip(np.searchsorted(times, self.times), 1, len(times) - 1)
        k = k - (self.times - times[k - 1] < times[k] - self.times)
        return k, np.abs(times[k] - self.times) <= SPACING_TOLERANCE * self.spacing

    def interpolated(self, times: Array, rows: Array, *, held: bool = False) -> Array:
        """Rows of shape (times, columns) at the wanted times, shape (columns, wanted): held, or by cubics where they are between."""
        wanted = self.times * (1.0 + RELATIVE_ROUNDING) if held else self.times
        if not held:
            last = np.append(np.diff(times) > 0.0, True)
            nearest, exact = self.nearest(times[last])
            if exact.all():
                kept: Array = rows[last]
                return kept[nearest].T
        curves = Curves.of_rows(times, rows.T, is_held=held)
        values: Array = curves(np.clip(wanted, times[0], times[-1]))
        return values

    def with_jumps_at(self, events: Array) -> Request:
        """The request with each jump at the event [s] that it is but for rounding: a time that is printed may lie before it."""
        if not len(events):
            return self
        k, is_jump = self.nearest(events)
        is_jump &= np.isin(self.times, self.jumps)
        return replace(self, times=np.where(is_jump, events[k], self.times))

    def read_columns(self, result: Result) -> tuple[dict[str, Array], dict[str, Array]]:
        """The columns of a result at the wanted times, and how far off what is between its rows may be.

        That is the distance from what every second row gives.
        """
        wanted = self.with_jumps_at(result.t[1:][np.diff(result.t) == 0.0])
        times = np.clip(wanted.times, result.t[0], result.t[-1])
        rows = np.append(np.diff(result.t) > 0.0, True)
        nearest, exact = wanted.nearest(result.t[rows])
        values, errors = {}, {}
        for name in self.names:
            column = result.solution(name)
            (fine,), (coarse,) = column(times), column.thinned(2, 0)(times)
            values[name] = np.where(exact, result[name][rows][nearest], fine)
            errors[name] = np.where(exact, 0.0, np.abs(fine - coarse))
        return values, errors


def solve_reference(network: Network, request: Request) -> ReferenceSolution:
    """Compute the reference solution of a system.

    A single FMU in its default experiment may carry it. Otherwise the model-exchange sides of the parts are
    integrated as one differential equation (`oracle`). Where that is impossible, runs with ever smaller
    communication steps are compared instead.

    Raises
    ------
    SetupError
        If the system can neither be integrated nor run; the message has both reasons.
    """
    carried = _carried(network, request)
    if carried is not None:
        return carried
    try:
        return integrate(network, request, INTEGRATION_TOLERANCE)
    except (SetupError, SimulationError) as error:
        refusal = str(error)
    try:
        return _refine(network, request, refusal)
    except SetupError as error:
        raise SetupError(f"there is no reference solution: {refusal}; and {error}") from error


def exact_rows(path: Path | str, request: Request) -> ReferenceSolution:
    """The rows of NAME.csv with the errors in NAME_error.csv at the wanted times; raises SetupError for times outside."""
    values, errors = ReferenceRows.read(path)
    t, wanted = values.t, request.times
    slack = SPACING_TOLERANCE * request.spacing
    if wanted[0] < t[0] - slack or wanted[-1] > t[-1] + slack:
        raise SetupError(
            f"{Path(path).name} goes from {t[0]:g} s to {t[-1]:g} s, the result from {wanted[0]:g} s to {wanted[-1]:g} s"
        )
    rows = Result(
        values.columns, {}, lambda k: values.numbers(values.names[k]), breaks=values.breaks
    )
    columns, gaps = request.read_columns(rows)
    nearest, _ = request.nearest(t)
    events = tuple(values.breaks.mean(axis=1).tolist())
    of_rows = {name: errors.numbers(name)[nearest] + gaps[name] for name in request.names}
    return ReferenceSolution(wanted, columns, of_rows, Path(path).name, events)


def _carried(network: Network, request: Request) -> ReferenceSolution | None:
    """The results that a single FMU carries, if the system is its default experiment and has rows at these times.

    They come from the equations of the FMU and not from its binary, which is thus checked as well.
    """
    system = network.system
    if len(system.parts) != 1 or system.start or system.changes or network.wires or network.inputs:
        return None
    ((part, path),) = system.parts.items()
    rows = ReferenceRows.of_fmu(path)
    if rows is None or request.start != (network.descriptions[part].defaultExperiment.start or 0.0):
        return None
    nearest, exact = request.nearest(rows.values.t)
    names = {name: name.removeprefix(f"{part}.") for name in request.names}
    if not exact.all() or not set(names.values()) <= set(rows.values.names):
        return None
    values, errors = (
        {name: series.numbers(variable)[nearest] for name, variable in names.items()}
        for series in (rows.values, rows.errors)
    )
    method = f"the results of the default experiment that {Path(path).name} carries"
    return ReferenceSolution(request.times, values, errors, method)


def integrate(network: Network, request: Request, tolerance: float) -> ReferenceSolution:
    """The solution by model exchange; raises SetupError, SimulationError."""
    with quiet():
        result = oracle(
            network.system, start=request.start, stop=request.stop, times=request.times,
            record=request.names, tolerance=tolerance, timeout=request.timeout,
        )  # fmt: skip
    values, gaps = request.read_columns(result)
    errors = {name: gap + result.provenance["errors"][name] for name, gap in gaps.items()}
    events = tuple(sorted(set(result.provenance["events"]) - {request.start}))
    method = "model exchange, integrated as one system"
    return ReferenceSolution(request.times, values, errors, method, events)


def _refine(network: Network, request: Request, refusal: str) -> ReferenceSolution:
    """Compare runs whose steps are halved until their errors are as small as wanted; raises SetupError."""
    algorithm = "iterated" if algebraic_loops(network) else "strang"
    spacing, deadline = request.output_step(), clock.monotonic() + request.timeout
    step = 0.25 * spacing / max(1, round(spacing / (request.step or spacing)))
    settings = RunSettings(
        request.stop, step, request.start, algorithm, record=request.names, output_step=spacing
    )
    solution, reason = None, ""
    with quiet(), Prepared.open(network.system, settings) as prepared:
        for halvings in range(MOST_STEP_HALVINGS):
            if halvings and clock.monotonic() > deadline:
                break
            steps = step / 2.0**halvings * np.array([1.0, 2.0, 4.0])
            runs = prepared.map(len(steps), steps=steps.tolist())
            reason = runs.reasons[0]
            if reason:
                continue
            finest = runs.result(0)
            values, errors = request.read_columns(finest)
            nearest, _ = request.nearest(finest.t)
            is_met = True
            for name in request.names:
                x = runs[name][:, : len(finest.t)]
                extent = float(np.ptp(x[0]))
                noise = RELATIVE_ROUNDING * max(1.0, float(np.abs(x[0]).max()))
                found = limit(x, finest.column(name).order or 1.0, noise=noise, scale=extent)
                envelope = _envelope(np.where(found.is_stated, found.error, math.inf))
                is_met = is_met and envelope.max() <= request.precision * extent
                errors[name] += envelope[nearest]
            method = f"runs by {algorithm} with steps down to {steps[0]:g} s, since {refusal}"
            solution = ReferenceSolution(request.times, values, errors, method)
            if is_met:
                break
    if solution is None:
        raise SetupError(reason)
    return solution


def _envelope(values: Array) -> Array:
    """The largest value within half of ENVELOPE of the run to either side."""
    from scipy.ndimage import maximum_filter1d

    width = max(3, round(ENVELOPE * len(values)) | 1)
    return np.asarray(maximum_filter1d(values, width, mode="nearest"))
