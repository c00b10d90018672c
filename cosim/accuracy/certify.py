"""Certify: run a system with three steps, and give every number with an estimate of its error."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from ..dense import DenseSolution
from ..describe import table
from ..engine.control import Adaptive
from ..master import run
from ..metrics import Largest, Last, Mean, Metric, Smallest
from ..result import Result
from ..system import System
from .estimate import Estimate
from .extrapolation import DIVERGED, after_widened, divergence
from .function_error import Function, function_errors
from .metric_error import metric_error, rows_error
from .three_runs import ThreeRuns, not_converged, three_runs

#: The metrics of `summary`, by what follows the name of a column.
SUMMARY: dict[str, Callable[[str], Metric]] = {
    " at the end": Last,
    ", smallest": Smallest,
    ", largest": Largest,
    ", mean": Mean,
}
#: What `certify` takes: metrics or functions of a result by name, or one function to several numbers.
Metrics = Mapping[str, Metric | Callable[[Result], float]] | Function


class Certified(NamedTuple):
    """The finest of three runs, and every metric with its error."""

    result: Result
    figures: dict[str, Estimate]

    def __str__(self) -> str:
        """A line for each metric, and what the run warns of."""
        lines = list(table([(name, str(figure)) for name, figure in self.figures.items()]))
        return "\n".join([*lines, *(f"warning: {text}" for text in self.result.warnings)])

    def _repr_html_(self) -> str:
        """The metrics as a table, for notebooks."""
        rows = "".join(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(str(figure))}</td></tr>"
            for name, figure in self.figures.items()
        )
        warnings = "".join(f"<p>{html.escape(text)}</p>" for text in self.result.warnings)
        return f"<table><tr><th>figure</th><th>value and error</th></tr>{rows}</table>{warnings}"


def certify(
    system: System,
    metrics: Metrics | None = None,
    *,
    step: float | Adaptive,
    runner: Callable[..., Result] = run,
    **settings: Any,
) -> Certified:
    """Run with the step, a half and a quarter of it, or the tolerance, a tenth and a hundredth.

    Parameters
    ----------
    system : System
        What is run.
    metrics : mapping or function, optional
        By name, metrics such as `cosim.metrics.Largest("motor.tau")`, or functions from a result to a number; or
        one function from a result to several numbers by name. By default the last, smallest, largest and
        mean value of every column. A function is called several times: with the rows of each run, with
        fewer rows, and with values changed by their estimated errors. It must therefore select rows by
        their time, never by their index.
    step : float or Adaptive
        The longest communication step [s], or adaptive steps with the largest tolerance.
    runner : callable
        Runs a system, as `run` does.
    **settings
        Those of `run`. With fixed steps the rows of all three results are `step` apart unless `output_step` is given.

    Returns
    -------
    Certified
        The result of the finest run, and estimates by name; a number whose error cannot be estimated has the
        error None and a reason. Errors are those of the coupling and of the spacing of rows; the error of the
        solver inside an FMU is the same in all runs and is not included.

    Raises
    ------
    SetupError, SimulationError, Interrupted
        Whatever `runner` raises; also what a function raises on the rows of a run.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cosim import System, certify
    >>> from cosim.metrics import Largest
    >>> motor = System({"motor": Path("fmus/DriveMotor.fmu")})
    >>> answer = certify(motor, {"torque": Largest("motor.tau")}, stop=0.1, step=0.01)
    >>> list(answer.figures)
    ['torque']
    """
    with three_runs(system, step, runner, settings) as runs:
        if metrics is None:
            metrics = summary_metrics(runs.finest.names[1:])
        return Certified(runs.finest, estimates_of(metrics, runs))


def estimates_of(metrics: Metrics, runs: ThreeRuns) -> dict[str, Estimate]:
    """The estimates of metrics and functions from three runs."""
    if not isinstance(metrics, Mapping):
        return function_errors(metrics, runs)
    estimates: dict[str, Estimate] = {}
    by_column: dict[str, dict[str, Metric]] = {}
    for name, metric in metrics.items():
        if isinstance(metric, Metric):
            by_column.setdefault(metric.column, {})[name] = metric
        else:
            function = metric
            estimates |= function_errors(lambda r, n=name, f=function: {n: f(r)}, runs)  # type: ignore[misc]
    held = [k for k, each in enumerate(runs.finest.columns) if each.kind.is_held]
    begin, diverged = divergence([result.data for result in runs.results], runs.ratio, held)
    for column, group in by_column.items():
        has_diverged = bool(diverged[runs.finest.names.index(column)])
        estimates |= _estimates_of_column(column, group, runs, begin if has_diverged else math.inf)
    return {name: estimates[name] for name in metrics}


def _estimates_of_column(
    column: str, metrics: Mapping[str, Metric], runs: ThreeRuns, diverged: float
) -> dict[str, Estimate]:
    """The estimates of metrics of one column, whose rows are in memory meanwhile.

    From the time `diverged` [s] on its runs have diverged.
    """
    columns = runs.column(column)
    slow = not_converged(runs, [column])
    estimates = {}
    for name, metric in metrics.items():
        is_affected = diverged < math.inf and not _is_over(metric, columns.finest, diverged)
        if slow or is_affected:
            reason = slow or f"{DIVERGED} from {diverged:.4g} s on"
            value = metric.value(columns.finest)
            estimates[name] = Estimate(value, None, math.nan, reason=reason)
        else:
            estimates[name] = metric_error(metric, columns)
    return estimates


def _is_over(metric: Metric, solution: DenseSolution, begin: float) -> bool:
    """Whether a metric depends only on the rows before a time [s].

    That is so if it has the same value without the later rows, and with later values spread further from
    their middle, as those of another chaotic trajectory might be.
    """
    if begin <= solution.t[1]:
        return False
    value = metric.value(solution)
    widened = solution.with_values(after_widened(solution.t, solution.x, begin))
    return metric.value(solution.between(-math.inf, begin)) == value == metric.value(widened)


def summary_metrics(columns: Iterable[str]) -> dict[str, Metric]:
    """The last, smallest, largest and mean value of columns, by name."""
    return {f"{c}{what}": metric(c) for c in columns for what, metric in SUMMARY.items()}


def evaluate(metrics: Metrics, result: Result) -> dict[str, float]:
    """The numbers that metrics and functions make of one result."""
    if not isinstance(metrics, Mapping):
        return dict(metrics(result))
    return {
        name: metric.value(result.solution(metric.column))
        if isinstance(metric, Metric)
        else metric(result)
        for name, metric in metrics.items()
    }


def summary(result: Result) -> dict[str, float]:
    """The last, smallest, largest and mean value of every column over time.

    Parameters
    ----------
    result : Result
        The rows of a run.

    Returns
    -------
    dict
        The values, in the unit of their column, by names such as "motor.tau at the end".
    """
    return evaluate(summary_metrics(result.names[1:]), result)


def summary_rows_errors(result: Result) -> dict[str, float | None]:
    """The errors of `summary` that are due to the spacing of the rows; None where there is none."""
    errors = {}
    for name, metric in summary_metrics(result.names[1:]).items():
        solution = result.solution(metric.column)
        errors[name] = rows_error(metric, solution, metric.value(solution))
    return errors
