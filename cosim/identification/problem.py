"""The first step: a system, a record of it and what is known of it, as one problem of least squares."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import NamedTuple, TypedDict, Unpack
from weakref import finalize

import numpy as np

from ..engine.settings import RunSettings
from ..engine.snapshot import Case
from ..errors import SetupError
from ..fmu.messages import quiet
from ..prepared import Prepared
from ..result import Result, SimulationError
from ..system import Network, System
from .parameters import (
    SENSOR,
    Array,
    FreeParameter,
    Prior,
    is_sensor_parameter,
)
from .record import Measurement

DerivedFunction = Callable[[Mapping[str, float], Result], float]
#: Step of the forward differences of the search, over the size of a value. Chosen between the square root of the
#: precision of doubles, 1.5e-8, and the nonlinearity, so that the rounding of an FMU's own integration does not show.
FORWARD_STEP = 1e-5
#: The residual of a run that the FMUs refuse, and the largest of any run, in standard deviations. Chosen: far above
#: any that fits, and its square still sums up without loss.
FAILED_RESIDUAL = 1e6
#: Times that differ by less than this share of a step are the same. Chosen: above rounding of sums of steps.
SAME_TIME = 1e-9


class SimulationSettings(TypedDict, total=False):
    """Settings of `run` that a fit may have, see there."""

    algorithm: str
    order: Sequence[str] | None
    input_order: int
    substeps: Mapping[str, int] | None
    tolerance: float | None
    output_step: float | None
    stop_time_defined: bool


class DerivedQuantity(NamedTuple):
    """What follows from all values and the fitted run, such as a resonance, and its unit."""

    name: str
    function: DerivedFunction
    unit: str


class Evaluation(NamedTuple):
    """What a run gives: residuals, shape (m,), and derived quantities, shape (k,)."""

    residuals: Array
    derived: Array


@dataclass(frozen=True)
class Problem:
    """A system with free parameters, the columns that measure it, and what is known of the parameters.

    Runs cover the `span`, two times [s], in steps of `step` [s]. Residuals are in standard deviations of the noise,
    those of the prior last. Values p of the free parameters have shape (n,).
    """

    system: System
    columns: Sequence[Measurement]
    parameters: Sequence[FreeParameter]
    prior: Prior
    step: float
    span: tuple[float, float]
    settings: SimulationSettings
    derived: Sequence[DerivedQuantity] = ()

    @property
    def names(self) -> list[str]:
        """The names of the free parameters."""
        return [parameter.name for parameter in self.parameters]

    @property
    def guess(self) -> Array:
        """The first values of the free parameters, shape (n,)."""
        return np.array([parameter.guess for parameter in self.parameters])

    @property
    def sizes(self) -> Array:
        """The sizes of the free parameters, shape (n,)."""
        return np.array([parameter.size for parameter in self.parameters])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The least and the largest values of the free parameters, each of shape (n,)."""
        low, high = np.array([(f.low, f.high) for f in self.parameters]).reshape(-1, 2).T
        return low, high

    @property
    def rows(self) -> int:
        """How many rows there are in all columns."""
        return sum(len(column.times) for column in self.columns)

    def start_values(self, p: Array) -> dict[str, float]:
        """All start values of the system that are numbers, with the free ones among them."""
        start = {k: float(v) for k, v in self.system.start.items() if isinstance(v, int | float)}
        return start | dict(zip(self.names, p.tolist()))

    def predict(self, p: Array, result: Result) -> list[Array]:
        """What the sensors of the columns show of a run, at the times of their rows."""
        values = dict(zip(self.names, p.tolist()))
        predictions = []
        for column in self.columns:
            gain, delay, zero = (
                values.get(f"{kind}({column.port.name})", ideal)
                for kind, (ideal, _) in SENSOR.items()
            )
            t, x = result["time"], result[column.port.name]
            times = column.times - delay
            same = len(t) == len(times) and np.abs(t - times).max() < SAME_TIME * (t[1] - t[0])
            predictions.append(
                gain * (x if same else shown(result, column.port.name, times)) + zero
            )
        return predictions

    def residual_vector(self, p: Array, predictions: Sequence[Array]) -> Array:
        """Predictions less measurements over the noise, by column, then the residuals of the prior, shape (m,)."""
        indices = [self.names.index(name) for name in self.prior.names]
        by_column = [
            (x - column.values) / column.noise.sigma for column, x in zip(self.columns, predictions)
        ]
        vector = np.concatenate([*by_column, self.prior.residuals(p[indices])])
        clipped = np.clip(vector, -FAILED_RESIDUAL, FAILED_RESIDUAL)
        return np.where(np.isfinite(vector), clipped, FAILED_RESIDUAL)


def shown(result: Result, name: str, times: Array) -> Array:
    """A column of a run at times [s], between its jumps where it has any: a jump has a row before and one after."""
    t = result["time"]
    return np.asarray(result.solution(name)(np.clip(times, t[0], t[-1]))[0])


class Evaluator:
    """Runs a problem with values of its free parameters; counts the runs and remembers the residuals of the last.

    The system is made ready once for all of them, and freed with this.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.runs = 0
        self._last: tuple[bytes, Array] | None = None
        self._stack = ExitStack()
        self._ready: dict[tuple[float, bool], Prepared] = {}
        finalize(self, self._stack.close)

    def _prepared(self, step: float, *, all_outputs: bool) -> Prepared:
        """The system, ready for runs over the record, of the measured columns or of all outputs; raises SetupError."""
        key = step, all_outputs
        if key not in self._ready:
            problem = self.problem
            measured = list(dict.fromkeys(column.port.name for column in problem.columns))
            first, last = problem.span
            record = None if all_outputs else measured
            settings = {k: v for k, v in problem.settings.items() if v is not None}
            plan = RunSettings(last, step, first, record=record, **settings)  # type: ignore[arg-type]
            opened = Prepared.open(problem.system, plan)
            self._ready[key] = self._stack.enter_context(opened)
        return self._ready[key]

    def _start(self, p: Array) -> dict[str, float]:
        """The start values among the free parameters."""
        pairs = zip(self.problem.names, p.tolist())
        return {name: value for name, value in pairs if not is_sensor_parameter(name)}

    def simulate(self, p: Array, *, step: float | None = None, all_outputs: bool = False) -> Result:
        """A run over the record, of the measured columns or of all outputs; raises what `run` does."""
        self.runs += 1
        with quiet():
            prepared = self._prepared(step or self.problem.step, all_outputs=all_outputs)
            return prepared.run(Case(self._start(p)))

    def _results(
        self, points: Sequence[Array], *, all_outputs: bool = False
    ) -> list[Result | None]:
        """Runs with many values p; None where the FMUs refuse them."""
        names = [name for name in self.problem.names if not is_sensor_parameter(name)]
        if not names:  # all differ in what sensors show
            return [self._result(points[0], all_outputs=all_outputs)] * len(points)
        self.runs += len(points)
        starts = [self._start(p) for p in points]
        try:
            prepared = self._prepared(self.problem.step, all_outputs=all_outputs)
            ensemble = prepared.map({name: [start[name] for start in starts] for name in names})
        except SetupError:
            return [None] * len(points)
        return [None if reason else ensemble.result(k) for k, reason in enumerate(ensemble.reasons)]

    def _result(self, p: Array, *, all_outputs: bool) -> Result | None:
        """A run; None where the FMUs refuse it."""
        try:
            return self.simulate(p, all_outputs=all_outputs)
        except (SimulationError, SetupError):
            return None

    def evaluate(self, p: Array) -> Evaluation:
        """Residuals and derived quantities; raises what `run` does."""
        evaluation = self.evaluations([p])[0]
        if evaluation is None:
            self.simulate(p)
            raise SetupError("a run that the FMUs had refused went well the second time")
        return evaluation

    def evaluations(self, points: Sequence[Array]) -> list[Evaluation | None]:
        """Residuals and derived quantities for many values p; None where the FMUs refuse them."""
        problem = self.problem
        evaluations: list[Evaluation | None] = []
        for p, result in zip(points, self._results(points, all_outputs=bool(problem.derived))):
            if result is None:
                evaluations.append(None)
                continue
            values = problem.start_values(p)
            derived = [float(quantity.function(values, result)) for quantity in problem.derived]
            residuals = problem.residual_vector(p, problem.predict(p, result))
            evaluations.append(Evaluation(residuals, np.array(derived)))
        return evaluations

    def residuals_of(self, points: Sequence[Array]) -> list[Array]:
        """The residuals for many values p, shape (m,) each; FAILED_RESIDUAL in all rows where the FMUs refuse them."""
        problem = self.problem
        failed = [np.full(len(column.times), FAILED_RESIDUAL) for column in problem.columns]
        return [
            problem.residual_vector(p, failed if result is None else problem.predict(p, result))
            for p, result in zip(points, self._results(points))
        ]

    def residuals(self, p: Array) -> Array:
        """The residuals of values p, shape (m,)."""
        key = p.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.residuals_of([p])[0]
        return self._last[1]

    def chi2(self, p: Array) -> float:
        """The sum of squared residuals."""
        return float(np.sum(self.residuals(p) ** 2))

    def best(self, points: Sequence[Array]) -> Array:
        """Of many values p, those with the least sum of squared residuals."""
        sums = [float(np.sum(residuals**2)) for residuals in self.residuals_of(points)]
        return points[int(np.argmin(sums))]

    def jacobian(self, p: Array, indices: Sequence[int] | None = None) -> Array:
        """The derivatives of the residuals by the free parameters of these indices, or by all, shape (m, n).

        They are forward differences, or backward ones at an upper bound.
        """
        base, points = self.residuals(p), []
        chosen = range(len(p)) if indices is None else indices
        for k in chosen:
            parameter = self.problem.parameters[k]
            step = FORWARD_STEP * parameter.size
            displaced = p.copy()
            displaced[k] += step * (1.0 if parameter.high - p[k] > step else -1.0)
            points.append(displaced)
        columns = [
            (residuals - base) / (displaced[k] - p[k])
            for k, displaced, residuals in zip(chosen, points, self.residuals_of(points))
        ]
        return np.stack(columns, axis=1)


def prepare(
    network: Network,
    columns: Sequence[Measurement],
    parameters: Sequence[FreeParameter],
    prior: Prior,
    derived: Sequence[DerivedQuantity] = (),
    *,
    begin: float | None = None,
    step: float | None = None,
    **settings: Unpack[SimulationSettings],
) -> Problem:
    """The problem of fitting a checked system to columns.

    Runs begin with the first row of all columns or at the time `begin` [s] before it. Their `step` [s] is by default
    the least median spacing of the rows of a column. Rows of a delayed column that may show what was before the
    beginning or after the last row are left out. Raises SetupError for a `begin` after the first row.
    """
    first = min(float(column.times[0]) for column in columns)
    last = max(float(column.times[-1]) for column in columns)
    if begin is not None and not begin <= first:
        raise SetupError(f"begin = {begin!r} s must not be after the first row, at {first!r} s")
    span = first if begin is None else begin, last
    delays = {parameter.name: (parameter.low, parameter.high) for parameter in parameters}
    covered = []
    for column in columns:
        low, high = delays.get(f"delay({column.port.name})", (0.0, 0.0))
        inside = (column.times - high >= span[0]) & (column.times - low <= span[1])
        covered.append(replace(column, times=column.times[inside], values=column.values[inside]))
    spacing = min(float(np.median(np.diff(column.times))) for column in columns)
    return Problem(
        network.system, covered, parameters, prior, step or spacing, span, settings, derived
    )


def require_runnable_guess(problem: Problem) -> None:
    """Run the guess once, so that a refusal by the FMUs or the master is reported unchanged.

    Raises SetupError if it cannot be run, and for fewer rows than free parameters.
    """
    try:
        Evaluator(problem).simulate(problem.guess)
    except SimulationError as error:
        raise SetupError(f"the first guess cannot be run: {error}") from error
    rows, parameters = problem.rows, len(problem.parameters)
    if rows <= parameters:
        raise SetupError(
            f"the record has {rows} rows, fewer than are needed for {parameters} free values"
        )
