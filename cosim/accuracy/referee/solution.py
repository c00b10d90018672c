"""The reference solution at the times of a table, each value with its error."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SetupError
from ...fmu.messages import quiet
from ...fmu.reference_rows import ERRORS, read_reference_rows
from ...master import run
from ...result import Result, SimulationError
from ...series import Series
from ...system import Network, System, connect
from ..limit import limit
from ..reference import oracle

Array = NDArray[np.float64]
#: Relative tolerance of the integration: a convention, 1e-4 of the smallest tolerance that a user is likely to ask
#: for (1e-6). The second integration, ten times looser, measures what is left of it.
INTEGRATION_TOLERANCE = 1e-10
#: How much the rows of a table may deviate from equal spacing and count as equally spaced, as a share of the
#: spacing: the rounding of times that are printed with six digits.
SPACING_TOLERANCE = 1e-3
#: Share of the rows of a table that must be equally spaced: a convention; masters add rows at events.
ON_GRID = 0.8
#: Fewest rows of a solution that is interpolated between: a convention, that of `oracle`.
FEWEST_ROWS = 1000
#: Fewest rows of a cubic spline: derived from its four coefficients.
FEWEST_OF_A_SPLINE = 4
#: How many times denser than the table those rows are. Linear interpolation then misses a curve by less than
#: 1/16 of what it misses between the rows of the table, since that falls with the square of the spacing.
DENSITY = 4
#: Most rows of a solution: limits memory; 20 000 rows of 100 columns are 16 MB.
MOST_ROWS = 20_000
#: Differences of two runs that are rounding, as a share of the largest value: a thousand units of double precision
#: (2.2e-16), and of several operations in each step.
RELATIVE_ROUNDING = 1e-12
#: Runs of which `limit` makes errors.
THREE = 3
#: Most times that the step of certified runs is halved: each doubles the time; 2^8 steps in place of one.
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
    values: Mapping[str, Array]
    errors: Mapping[str, Array]
    method: str
    events: tuple[float, ...]


@dataclass(frozen=True)
class SolutionRequest:
    """What of a system is wanted: columns at times, how exactly, and for how long to try.

    `precision` is the error that certified runs aim at, as a share of the range of each column. `step` [s] is where
    they begin. `timeout` [s] is the longest time that an integration may take.
    """

    names: Sequence[str]
    times: Array
    start: float
    precision: float
    step: float | None = None
    timeout: float = 120.0

    @property
    def stop(self) -> float:
        """The last time [s]."""
        return float(self.times[-1])

    @property
    def spacing(self) -> float:
        """The median time between rows [s]."""
        return float(np.median(np.diff(self.times)))

    def output_step(self) -> float:
        """The time between rows of a solution [s]: that of the table where most rows are equally spaced from the start."""
        spacing = self.spacing
        steps = (self.times - self.start) / spacing
        on_grid = np.abs(steps - np.round(steps)) <= SPACING_TOLERANCE
        if np.mean(on_grid) >= ON_GRID and (self.stop - self.start) / spacing <= MOST_ROWS:
            exact = self.times[on_grid]
            number = round((exact[-1] - self.start) / spacing)
            return float((exact[-1] - self.start) / number) if number else spacing
        rows = min(MOST_ROWS, max(FEWEST_ROWS, DENSITY * len(self.times)))
        return (self.stop - self.start) / rows


def solve_reference(system: System, request: SolutionRequest) -> ReferenceSolution:
    """Compute the reference solution of a system.

    A single FMU in its default experiment may carry it. Otherwise the model-exchange sides of the parts are
    integrated as one differential equation (`oracle`). Where that is impossible, runs with ever smaller
    communication steps are compared instead.

    Raises
    ------
    SetupError
        If the system can neither be integrated nor run; the message has both reasons.
    """
    carried = _carried(connect(system), request)
    if carried is not None:
        return carried
    try:
        return _integrate(system, request)
    except (SetupError, SimulationError) as error:
        refusal = str(error)
    try:
        return _refine(system, request, refusal)
    except (SetupError, SimulationError) as error:
        raise SetupError(f"there is no reference solution: {refusal}; and {error}") from error


@dataclass(frozen=True)
class ExactRows:
    """Rows that are known to be right, and their errors; the label says where they come from."""

    values: Series
    errors: Series
    label: str

    def at(self, request: SolutionRequest) -> ReferenceSolution:
        """The columns at the wanted times; raises SetupError for times outside the rows."""
        time = self.values.t
        slack = SPACING_TOLERANCE * request.spacing
        if request.times[0] < time[0] - slack or request.times[-1] > time[-1] + slack:
            raise SetupError(
                f"{self.label} goes from {time[0]:g} s to {time[-1]:g} s, the result from "
                f"{request.times[0]:g} s to {request.times[-1]:g} s"
            )
        events = tuple(self.values.breaks.mean(axis=1).tolist())
        values, gaps = interpolate(self.values, request, events)
        nearest = _nearest(time, request.times)
        errors = {name: self.errors.numbers(name)[nearest] + gaps[name] for name in request.names}
        return ReferenceSolution(request.times, values, errors, self.label, events)


def read_exact(path: Path) -> ExactRows:
    """Read NAME.csv and the errors in NAME_error.csv beside it; raises SetupError if they do not belong together."""
    errors = path.with_name(f"{path.stem}{ERRORS}")
    rows = ExactRows(Series.read(path), Series.read(errors), path.name)
    if rows.values.names != rows.errors.names or not np.array_equal(rows.values.t, rows.errors.t):
        raise SetupError(f"{path} and {errors} must have the same columns and times")
    return rows


def _carried(network: Network, request: SolutionRequest) -> ReferenceSolution | None:
    """The results that a single FMU carries, if the system is its default experiment and has rows at these times.

    They come from the equations of the FMU and not from its binary, which is thus checked as well.
    """
    system = network.system
    if len(system.parts) != 1 or system.start or system.changes or network.wires or network.inputs:
        return None
    ((part, path),) = system.parts.items()
    rows = read_reference_rows(Path(path))
    if rows is None or request.start != (network.descriptions[part].defaultExperiment.start or 0.0):
        return None
    time = rows.values.t
    nearest = _nearest(time, request.times)
    names = {name: name.removeprefix(f"{part}.") for name in request.names}
    if not (
        set(names.values()) <= set(rows.values.names)
        and np.all(np.abs(time[nearest] - request.times) <= SPACING_TOLERANCE * request.spacing)
    ):
        return None
    return ReferenceSolution(
        request.times,
        {name: rows.values.numbers(variable)[nearest] for name, variable in names.items()},
        {name: rows.errors.numbers(variable)[nearest] for name, variable in names.items()},
        f"the results of the default experiment that {Path(path).name} carries",
        (),
    )


def _nearest(time: Array, wanted: Array) -> NDArray[np.intp]:
    """The indices of the times nearest to the wanted ones."""
    nearest = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    return nearest - (wanted - time[nearest - 1] < time[nearest] - wanted)


def _integrate(
    system: System, request: SolutionRequest, tolerance: float = INTEGRATION_TOLERANCE
) -> ReferenceSolution:
    with quiet():
        result = oracle(
            system, start=request.start, stop=request.stop, output_step=request.output_step(),
            record=request.names, tolerance=tolerance, timeout=request.timeout,
        )  # fmt: skip
    events = tuple(sorted(set(result.provenance["events"]) - {request.start}))
    values, gaps = interpolate(result, request, events)
    errors = {name: result.provenance["errors"][name] + gaps[name] for name in request.names}
    return ReferenceSolution(
        request.times, values, errors, "model exchange, integrated as one system", events
    )


def interpolate(
    result: Series, request: SolutionRequest, events: Sequence[float] = ()
) -> tuple[dict[str, Array], dict[str, Array]]:
    """The columns of a result at the wanted times, and the errors of interpolation.

    Between two events, a column is interpolated by a cubic spline through the rows there. The error is its distance
    from linear interpolation, which is far larger than that of the spline where a column is smooth. At times that
    the result has, it vanishes.
    """
    last = np.append(np.diff(result.t) > 0.0, True)
    time = result.t[last]
    nearest = _nearest(time, request.times)
    exact = np.abs(time[nearest] - request.times) <= SPACING_TOLERANCE * request.spacing
    inner = [event for event in events if time[0] < event < time[-1]]
    values, gaps = {}, {}
    for name in request.names:
        column = result[name][last]
        held = result.column(name).kind.is_held
        smooth, linear = _interpolate_pieces(time, column, request.times, inner, held=held)
        values[name] = np.where(exact, column[nearest], smooth)
        gaps[name] = np.where(exact, 0.0, np.abs(smooth - linear))
    return values, gaps


def _interpolate_pieces(
    time: Array, column: Array, wanted: Array, events: Sequence[float], *, held: bool
) -> tuple[Array, Array]:
    """A column at the wanted times by cubic splines and by straight lines, both within the pieces between events."""
    from scipy.interpolate import CubicSpline, make_interp_spline

    smooth, linear = np.empty(len(wanted)), np.empty(len(wanted))
    borders = [-math.inf, *events, math.inf]
    for begin, end in pairwise(borders):
        rows, inside = (time >= begin) & (time < end), (wanted >= begin) & (wanted < end)
        if not inside.any():
            continue
        t, x = time[rows], column[rows]
        if len(t) <= 1:
            # Nothing is known between two events so close: the rows around them bound it.
            smooth[inside] = np.interp(wanted[inside], time, column)
            linear[inside] = smooth[inside] + np.ptp(column)
            continue
        line = make_interp_spline(t, x, k=1)
        linear[inside] = line(wanted[inside])
        curve = line if held or len(t) < FEWEST_OF_A_SPLINE else CubicSpline(t, x)
        smooth[inside] = curve(wanted[inside])
    return smooth, linear


def _refine(system: System, request: SolutionRequest, refusal: str) -> ReferenceSolution:
    """Compare runs whose steps are halved until their errors are as small as wanted."""
    spacing = request.output_step()
    step = spacing / max(1, round(spacing / (request.step or spacing)))
    algorithm, first = _first_run(system, request, step, spacing)
    runs = [interpolate(first, request)]
    deadline = clock.monotonic() + request.timeout
    method = f"runs by {algorithm} with steps down to {step:g} s, since {refusal}"
    errors: dict[str, Array] = {
        name: np.full(len(request.times), math.inf) for name in request.names
    }
    for _ in range(MOST_STEP_HALVINGS):
        step *= 0.5
        result = _run(system, request, algorithm, step, spacing)
        order = float(result.provenance["convergence_order"])
        first_order = result.provenance.get("first_order", ())
        runs.append(interpolate(result, request))
        method = f"runs by {algorithm} with steps down to {step:g} s, since {refusal}"
        if len(runs) < THREE:
            continue
        errors = {
            name: _row_errors(name, runs[-THREE:], 1.0 if name in first_order else order, request)
            for name in request.names
        }
        if clock.monotonic() > deadline or all(
            np.max(errors[name]) <= request.precision * np.ptp(runs[-1][0][name])
            for name in request.names
        ):
            break
    values, gaps = runs[-1]
    errors = {name: errors[name] + gaps[name] for name in request.names}
    return ReferenceSolution(request.times, values, errors, method, ())


def _first_run(
    system: System, request: SolutionRequest, step: float, spacing: float
) -> tuple[str, Result]:
    """The first algorithm that can run the system: one step forth and back, else iterated."""
    try:
        return "strang", _run(system, request, "strang", step, spacing)
    except SetupError as error:
        if "algebraic loop" not in str(error):
            raise
    return "iterated", _run(system, request, "iterated", step, spacing)


def _run(
    system: System, request: SolutionRequest, algorithm: str, step: float, spacing: float
) -> Result:
    with quiet():
        return run(
            system, start=request.start, stop=request.stop, step=step, output_step=spacing,
            algorithm=algorithm, record=request.names,
        )  # fmt: skip


def _row_errors(
    name: str,
    runs: Sequence[tuple[dict[str, Array], dict[str, Array]]],
    order: float,
    request: SolutionRequest,
) -> Array:
    """The errors of a column in the finest of three runs: the largest nearby, since differences cross zero."""
    values = np.array([values[name] for values, _ in reversed(runs)])
    rounding = RELATIVE_ROUNDING * max(1.0, float(np.abs(values[0]).max()))
    of_runs = limit(values, order, noise=rounding, scale=float(np.ptp(values[0])))
    return _envelope(of_runs.error, request.times)


def _envelope(values: Array, time: Array) -> Array:
    """The largest value within half of ENVELOPE of the run to either side."""
    from scipy.ndimage import maximum_filter1d

    width = max(3, round(ENVELOPE * len(time)) | 1)
    return np.asarray(maximum_filter1d(values, width, mode="nearest"))


class OutOfTimeError(Exception):
    """A run takes longer than it may."""


def reproduce(
    system: System, request: SolutionRequest, *, seconds: float = math.inf, **settings: Any
) -> dict[str, Array] | None:
    """The columns of a run with these settings at the wanted times; None if it cannot be run.

    `seconds` limits the time of the processor [s]: a system that a lost wire makes unstable may take forever.
    """
    deadline = clock.process_time() + seconds

    def require_time(progress: float) -> None:
        if clock.process_time() > deadline:
            raise OutOfTimeError(
                f"not finished within {seconds:g} s, only {progress:.0%} of the run"
            )

    spacing = request.output_step()
    step = settings.pop("step", spacing)
    held = step > spacing * (1.0 + SPACING_TOLERANCE)
    try:
        with quiet():
            result = run(
                system, start=request.start, stop=request.stop, record=request.names, step=step,
                output_step=None if held else spacing, progress=require_time, **settings,
            )  # fmt: skip
    except (SetupError, SimulationError, OutOfTimeError):
        return None
    if not held:
        return interpolate(result, request)[0]
    row = np.searchsorted(result["time"], request.times * (1.0 + RELATIVE_ROUNDING), "right") - 1
    return {name: result[name][np.maximum(row, 0)] for name in request.names}


def integrate_variant(system: System, request: SolutionRequest) -> dict[str, Array] | None:
    """The columns of another system by model exchange at the wanted times; None if it cannot be integrated."""
    try:
        return dict(_integrate(system, request, 100.0 * INTEGRATION_TOLERANCE).values)
    except (SetupError, SimulationError):
        return None
