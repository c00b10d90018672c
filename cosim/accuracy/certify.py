"""Certify: run a system with several steps, and give every number with an estimate of its error."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ..describe import table
from ..engine.control import Adaptive
from ..engine.settings import RunSettings
from ..master import run
from ..metrics import Largest, Last, Mean, Metric, Smallest
from ..result import Interrupted, Result, SimulationError
from ..rounding import unit_suffix
from ..system import System, connect
from .estimate import Estimate
from .judge import (
    OTHER_ROWS,
    RUNS_DISAGREE,
    Function,
    estimates_of_rows,
    judge_function,
    judge_metrics,
    numbers_of,
)
from .limit import LOWEST_ORDER, RUNS, STEP_RATIO
from .nested import NestedRuns, nested_runs, report_share, shorter_step, without_log
from .trajectories import Divergence, find_divergence

#: The metrics of `summary`, by what follows the name of a column.
SUMMARY: dict[str, Callable[[str], Metric]] = {
    " at the end": Last,
    ", smallest": Smallest,
    ", largest": Largest,
    ", mean": Mean,
}
#: What `certify` takes: metrics or functions of a result by name, or one function to several numbers.
Metrics = Mapping[str, Metric | Callable[[Result], float] | Function] | Function
#: Share of the tolerance of the FMUs in one more run. Derived: an error in proportion to it is the difference over nine tenths.
SHARPER = 0.1
#: Most times that a step is halved for the sake of an error: the run then has a thousand times as many steps.
MOST_HALVINGS = 10
#: Halvings after which the error of a figure must have fallen for another one.
PATIENCE = 2
#: What the errors cover, and what they do not.
COVERS = (
    "errors cover coupling, steps and rows; those of the solvers inside the FMUs, of the models and of their "
    "parameters are not in them"
)
#: The same where a run with a tenth of the tolerance of the FMUs differs.
COVERS_SOLVERS = (
    "errors cover coupling, steps, rows, and what a tenth of their tolerance changes inside the FMUs; those of the "
    "models and of their parameters are not in them"
)
LOST_BY_SOLVERS = "it has no value with a tenth of the tolerance of the FMUs"


@dataclass(frozen=True)
class Certified:
    """A run, and every number with its error.

    Attributes
    ----------
    result
        The run with `step`.
    figures
        The estimates by name.
    step
        Its step or tolerance: that asked for, or a shorter one that the wanted errors needed.
    unmet
        Why figures do not have the error that was wanted, by name.
    covers
        What the errors cover, and what they do not.
    """

    result: Result
    figures: dict[str, Estimate]
    step: float | Adaptive
    unmet: dict[str, str] = field(default_factory=dict)
    covers: str = COVERS

    def __str__(self) -> str:
        """A line for each number with its unit, what the errors cover, and what the run warns of."""
        lines = list(table([(name, str(figure)) for name, figure in self.figures.items()]))
        lines += [f"{name}: {reason}" for name, reason in self.unmet.items()]
        return "\n".join([*lines, self.covers, *(f"warning: {x}" for x in self.result.warnings)])

    def _repr_html_(self) -> str:
        """The numbers as a table, for notebooks."""
        rows = "".join(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(str(figure))}</td></tr>"
            for name, figure in self.figures.items()
        )
        texts = [*(f"{n}: {x}" for n, x in self.unmet.items()), self.covers, *self.result.warnings]
        below = "".join(f"<p>{html.escape(text)}</p>" for text in texts)
        return f"<table><tr><th>figure</th><th>value and error</th></tr>{rows}</table>{below}"


def certify(
    system: System,
    metrics: Metrics | None = None,
    *,
    step: float | Adaptive,
    error: float | Mapping[str, float] | None = None,
    derive: Callable[[Result], Result] | None = None,
    runner: Callable[..., Result] = run,
    **settings: Any,
) -> Certified:
    """Run with the step, and with others, which show the errors; or with the tolerance, and along other shares of its steps.

    Parameters
    ----------
    system : System
        What is run.
    metrics : mapping or function, optional
        By name, metrics such as `cosim.metrics.Largest("motor.tau")`, or functions from a result to a number, or to
        several by their own names; or one such function. By default the last, smallest, largest and
        mean value of every column. A function is called several times: with the rows of each run, with
        fewer rows, and with other values. It must therefore select rows by
        their time, never by their index. A function may return an `Estimate` that has the error of the rows
        already; only that of the coupling is then added.
    step : float or Adaptive
        The communication step of the result [s], or adaptive steps with its tolerance. Where no part may have events that
        it does not tell, the steps behind the start, jumps and changes are shorter, see `NestedRuns`.
    error : float or mapping of str to float, optional
        The error wanted of every figure, over its value; or for some of them by name, in their units. The step is
        halved, or the tolerance divided by ten, until the figures have it; two of three runs are used again.
    derive : callable, optional
        Returns the result of a run with further columns, see `Result.with_columns`, of which there may be metrics.
    runner : callable
        Runs a system, as `run` does.
    **settings
        Those of `run`.

    Returns
    -------
    Certified
        The result with the step, and estimates by name; a number whose error cannot be estimated has the
        error None and a reason. Errors are those of the coupling and of the spacing of rows. Where FMUs have a
        tolerance, one more run with a tenth of it shows what their solvers add; adaptive steps change it with theirs.

    Raises
    ------
    SetupError
        Before the first run, for metrics of columns that it does not have or of times outside it; also what
        `runner` raises.
    SimulationError, Interrupted
        Whatever `runner` raises with the step; a run with a longer one may fail. Also what a function raises on
        the rows of a run.

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
    if derive is None:
        _check(system, metrics, settings)
    else:
        runner = partial(_derived, derive, runner)
    lacks = partial(_lacks, error)
    tolerance = _sharper_tolerance(system, step, settings)
    report = settings.pop("progress", None) or (lambda _: None)
    cost = sum(STEP_RATIO**-k for k in range(RUNS))
    share = cost / (cost + (tolerance is not None))
    three = settings | {"progress": partial(report_share, report, 0.0, share)}
    one = {k: x for k, x in settings.items() if k != "csv"}
    one |= {"progress": partial(report_share, report, share, 1.0), "tolerance": tolerance}
    known: dict[int, Result] = {}
    errors: list[dict[str, float]] = []
    while True:
        with nested_runs(system, step, runner, three, known=known, halvings=len(errors)) as runs:
            every = metrics or summary_metrics(column.name for column in runs.finest.columns[1:])
            figures = estimates_of(every, runs)
        covers = COVERS
        if tolerance is not None:
            sharper = _beside(runs.finest, partial(runner, system, step=runs.step, **one))
            covers, figures = _with_solvers(every, figures, runs.finest, sharper)
        unmet = {name: reason for name, x in figures.items() if (reason := lacks(name, x))}
        errors.append({n: math.inf if (e := figures[n].error) is None else e for n in unmet})
        if not unmet or not _is_worth_halving(errors):
            return Certified(runs.finest, figures, step, unmet, covers)
        if not runs.follows:
            known = {k + 1: result for k, result in enumerate(runs.results[: RUNS - 1])}
        step = shorter_step(step)


def _derived(
    derive: Callable[[Result], Result], runner: Callable[..., Result], *args: Any, **settings: Any
) -> Result:
    """The result of a run with its further columns."""
    return derive(runner(*args, **settings))


def _sharper_tolerance(
    system: System, step: float | Adaptive, settings: Mapping[str, Any]
) -> float | None:
    """A tenth of the smallest tolerance of the FMUs; None where none is known, and where steps adapt."""
    if isinstance(step, Adaptive) or not system.parts:
        return None
    known = [d.defaultExperiment.tolerance for d in connect(system).descriptions.values()]
    tolerance = settings.get("tolerance") or min(filter(None, known), default=None)
    return SHARPER * float(tolerance) if tolerance else None


def _beside(finest: Result, again: Callable[[], Result]) -> Result | None:
    """The result of one more run, None if it fails; Ctrl-C in it leaves the rows of the finest run."""
    try:
        with without_log():
            return again()
    except SimulationError:
        return None
    except Interrupted as interrupt:
        interrupt.result = finest
        raise


def _with_solvers(
    metrics: Metrics, figures: Mapping[str, Estimate], finest: Result, sharper: Result | None
) -> tuple[str, dict[str, Estimate]]:
    """What errors cover, and figures whose errors have what the solvers add, which a sharper run shows.

    FMUs that ignore their tolerance give the same rows, which say nothing of their solvers.
    """
    if sharper is None or all(np.array_equal(finest[n], sharper[n]) for n in finest.names):
        return COVERS, dict(figures)
    named = metrics if isinstance(metrics, Mapping) else {}
    plain = {name: metric for name, metric in named.items() if isinstance(metric, Metric)}
    functions = [{n: m} for n, m in named.items() if n not in plain] if named else [metrics]
    changes: dict[str, float] = {}
    reason = LOST_BY_SOLVERS
    for some in (plain, *functions):
        try:
            before, after = evaluate(some, finest), evaluate(some, sharper)
        except Exception as error:  # noqa: BLE001 - whatever the function of a person raises
            reason = OTHER_ROWS.format(error)
        else:
            changes |= {n: abs(after.get(n, math.nan) - x) for n, x in before.items()}
    every = {}
    for name, x in figures.items():
        change = changes.get(name, math.inf)
        if x.error is None:
            every[name] = x
        elif not math.isfinite(change):
            why = LOST_BY_SOLVERS if name in changes else reason
            every[name] = x._replace(error=None, reason=why)
        elif change > 0.0 and name in plain and plain[name].is_count:
            every[name] = x._replace(error=None, reason=RUNS_DISAGREE)
        else:
            every[name] = x._replace(error=x.error + change / (1.0 - SHARPER))
    return COVERS_SOLVERS, every


def _check(system: System, metrics: Metrics | None, settings: Mapping[str, Any]) -> None:
    """Refuse metrics of columns that the run will not have; raises SetupError."""
    named = (
        [m for m in metrics.values() if isinstance(m, Metric)]
        if isinstance(metrics, Mapping)
        else []
    )
    if not named or not system.parts:
        return
    start, stop = settings.get("start", 0.0), settings.get("stop", math.inf)
    network = connect(system)
    ports = RunSettings(stop, stop, start, record=settings.get("record")).ports(network)
    columns = {column.name: column for column in (port.column for port in ports)}
    for metric in named:
        for name in metric.columns:
            network.port(name)
        metric.check(columns, start, stop)


def _lacks(error: float | Mapping[str, float] | None, name: str, x: Estimate) -> str:
    """Why a figure does not have the error wanted of it; "" if it has."""
    if error is None or (isinstance(error, Mapping) and name not in error):
        return ""
    most = error[name] if isinstance(error, Mapping) else error * abs(x.value)
    if x.error is None:
        return f"it has no error: {x.reason}"
    return "" if x.error <= most else f"its error is still above {most:.2g}{unit_suffix(x.unit)}"


def _is_worth_halving(errors: Sequence[Mapping[str, float]]) -> bool:
    """Whether figures that lack an error came closer to it in one of the last two halvings, and few were made."""
    if len(errors) > MOST_HALVINGS:
        return False
    if len(errors) <= PATIENCE:
        return True
    now, before = errors[-1], errors[-1 - PATIENCE]
    fall = STEP_RATIO**LOWEST_ORDER
    return any(
        math.isfinite(e) and e * fall <= before.get(name, math.inf) for name, e in now.items()
    )


def estimates_of(metrics: Metrics, runs: NestedRuns) -> dict[str, Estimate]:
    """The estimates of metrics and functions from the runs of a system."""
    diverged = (
        find_divergence(runs.results, runs.ratio) if len(runs.results) == RUNS else Divergence()
    )
    estimates: dict[str, Estimate] = {}
    if isinstance(metrics, Mapping):
        named = {name: m for name, m in metrics.items() if isinstance(m, Metric)}
        estimates = judge_metrics(named, runs, diverged)
        for name, function in metrics.items():
            if not isinstance(function, Metric):
                of_result = partial(_by_name, name, function)
                estimates |= judge_function(of_result, runs, diverged)
        first = [name for name in metrics if name in estimates]
        estimates = {name: estimates[name] for name in dict.fromkeys([*first, *estimates])}
    else:
        estimates = judge_function(metrics, runs, diverged)
    return estimates


def _by_name(
    name: str, function: Callable[[Result], Any], result: Result
) -> Mapping[str, float | Estimate]:
    """The number that a function makes of a result, by its name, or several by their own."""
    x = function(result)
    return x if isinstance(x, Mapping) else {name: x}


def summary_metrics(columns: Iterable[str]) -> dict[str, Metric]:
    """The last, smallest, largest and mean value of columns, by name."""
    return {f"{c}{what}": metric(c) for c in columns for what, metric in SUMMARY.items()}


def evaluate(metrics: Metrics, result: Result) -> dict[str, float]:
    """The numbers that metrics and functions make of one result."""
    if not isinstance(metrics, Mapping):
        numbers = metrics(result)
        return dict(zip(numbers, numbers_of(numbers, [*numbers]).tolist()))
    curves = {
        c: result.solution(c) for m in metrics.values() if isinstance(m, Metric) for c in m.columns
    }
    values: dict[str, float] = {}
    for name, metric in metrics.items():
        if isinstance(metric, Metric):
            values[name] = float(metric(*(curves[column] for column in metric.columns))[0])
        else:
            values |= evaluate(partial(_by_name, name, metric), result)
    return values


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


def summary_of_rows(result: Result, errors: Mapping[str, float]) -> dict[str, Estimate]:
    """The numbers of `summary` with the errors of the spacing of the rows, and those of the columns by name added."""
    return estimates_of_rows(summary_metrics(result.names[1:]), result, errors)
