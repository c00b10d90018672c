"""The runs that show the error of one: with steps twice and four times as long, and one whose steps lie elsewhere.

Three runs whose steps end at the same times share what happens within them: a layer behind the start or a jump that is
over within a step, an event that a part tells nobody of. So the steps of a *graded* run grow from h / 1024 behind the
start and each known jump and change, and the runs beside it take every second and every fourth end of that mesh. Where
parts may have events that they do not tell, a *witness* has steps of h / phi, whose ends no step of h has.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..engine.control import Adaptive, Mesh
from ..errors import SetupError
from ..result import Interrupted, Result, Rows, SimulationError
from ..scratch import scratch
from ..system import VARIABLE_STEP, ModelDescription, System, connect, parts_without
from .limit import RUNS, STEP_RATIO

#: The step behind the start and jumps, over the others. Chosen: of a layer that is shorter, up to this share is left in an integral.
FIRST_STEP = 2.0**-10
#: By what steps of a graded run grow. Chosen: 40 of them to h; coarser ones share more of a layer between the runs.
GROWTH = 2.0**0.25
#: The ratio of the steps of a run and its witness, whose multiples are furthest from whole numbers: the golden one.
GOLDEN = 0.5 * (1.0 + math.sqrt(5.0))
#: By what a tolerance is divided where an error is to be smaller.
TOLERANCE_RATIO = 10.0
#: How many times as large as that of the next finer run the values of one are that is unstable. Chosen: an error of that size has no digit.
UNSTABLE = 1e3
#: Rows that are read at a time, which bounds the memory: derived, 2^15 rows of 20 columns are 5 MB.
ROWS_AT_A_TIME = 1 << 15
#: Share by which a step may exceed a run that is as long: rounding of their quotient.
STEP_ROUNDING = 1e-9
TOO_LONG = "the run is shorter than a step of {:g} s, so that no error can be estimated"
LOST = "the run with {} fails, so that no error can be estimated: {}"
OTHER_STEPS = "errors come from runs with other steps as well, which must fit the run"
BLOWN_UP = "the comparison run with {:g} times the step is unstable: take a step of {:g} s or less"


@dataclass(frozen=True)
class NestedRuns:
    """The results of up to three runs, the finest first, whose steps differ by `ratio`.

    Attributes
    ----------
    results
        The finest run, and those that take its steps two and four at a time.
    dense
        The finest one with all its rows.
    step
        With what it was run.
    lost
        Why coarser runs are missing.
    witness
        A run whose steps end at other times; None where the others are enough.
    tells_events
        Whether no part may have events that it does not tell.
    confirms
        Whether an observed order may be that of the algorithm; if not, errors have the factor of one that is not confirmed.
    follows
        Whether the others follow the steps that the finest one has chosen, so that no order is expected.
    """

    results: Sequence[Result]
    dense: Result
    ratio: float = STEP_RATIO
    step: float | Adaptive = math.nan
    lost: str = ""
    witness: Result | None = None
    tells_events: bool = True
    confirms: bool = True
    follows: bool = False

    @property
    def finest(self) -> Result:
        """The result of the finest run."""
        return self.results[0]

    def nominal_order(self, column: str) -> float:
        """The convergence order of a column in the step; nan where the result is that of no coupled run."""
        provenance = self.finest.provenance
        if column in provenance.get("first_order", ()):
            return 1.0
        return float(provenance.get("convergence_order", math.nan))

    @property
    def have_jumps_within_steps(self) -> bool:
        """Whether an input jumps inside a step of one of them; where in the step differs from run to run."""
        return any(bool((r.breaks[:, 1] > r.breaks[:, 0]).any()) for r in self.results)


def may_have_events(description: ModelDescription) -> bool:
    """Whether an FMU may change at once without telling: with event indicators, with values that change at events, and
    where it offers no model exchange, which would name them.
    """
    return (
        description.modelExchange is None
        or description.numberOfEventIndicators > 0
        or any(
            v.variability == "discrete" and v.causality in ("output", "local")
            for v in description.modelVariables
        )
    )


def tells_events(descriptions: Mapping[str, ModelDescription]) -> bool:
    """Whether no part may change at once without telling."""
    return not any(map(may_have_events, descriptions.values()))


def compared_steps(
    descriptions: Mapping[str, ModelDescription], step: float, halvings: int = 0
) -> tuple[Sequence[float | Mesh], Mesh | None]:
    """With which steps parts are run for the sake of one [s], which has been halved so often, and those of a witness."""
    plain = [step * STEP_RATIO**k for k in range(RUNS)]
    if not descriptions or parts_without(descriptions, VARIABLE_STEP):
        return plain, None
    if not tells_events(descriptions):
        return plain, graded_steps(step / GOLDEN)
    first = graded_steps(step * STEP_RATIO**halvings)
    return [replace(first, every=STEP_RATIO ** (k - halvings)) for k in range(RUNS)], None


def graded_steps(step: float) -> Mesh:
    """Steps that grow behind each time that must be met to one [s]."""
    return Mesh(first=step * FIRST_STEP, longest=step, growth=GROWTH)


def steps_along(result: Result, step: Adaptive) -> list[Mesh]:
    """Steps along those that a run with this control has taken, one and two at a time, and by another ratio.

    Step doubling takes each of its steps in two halves, which are those that it goes on with.
    """
    own = 0.5 if result.provenance.get("control") == "doubling" else 1.0
    along = tuple(np.unique(result["time"]).tolist())
    ratios = (STEP_RATIO, STEP_RATIO**2, 1.0 / GOLDEN)
    return [Mesh(step.tolerance, along=along, ratio=own * times) for times in ratios]


@contextmanager
def nested_runs(
    system: System,
    step: float | Adaptive,
    runner: Callable[..., Result],
    settings: Mapping[str, Any],
    *,
    known: Mapping[int, Result] | None = None,
    halvings: int = 0,
) -> Iterator[NestedRuns]:
    """Run a system, and with other steps for the sake of its errors.

    The finest run comes first and gets `csv`; it stands even if another one fails. Where rows are wanted
    further apart than steps, its rows at all communication points are in a file until the context ends.

    Parameters
    ----------
    system : System
        What is run.
    step : float or Adaptive
        That of the finest run.
    runner : callable
        Runs a system, as `run` does.
    settings : mapping
        Those of `run`.
    known : mapping of int to Result, optional
        Runs that are there already, by how many ratios their step is longer.
    halvings : int
        How often the step was halved since they were made.
    """
    with TemporaryDirectory(dir=scratch(), ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "rows"
        runs = _Nested(system, runner, dict(settings), path)
        found = (
            runs.along(step)
            if isinstance(step, Adaptive)
            else runs.fixed(step, known or {}, halvings)
        )
        if path.exists():
            finest = found.finest
            rows = finest.with_columns_from(partial(stored_column, path, len(finest.columns)))
            found = replace(found, dense=rows)
        yield found


def stored_column(path: Path, width: int, k: int) -> Rows:
    """Column number k of a file of rows with so many numbers, shape (rows,); no other one is in memory."""
    values = np.empty(path.stat().st_size // (width * np.dtype(float).itemsize))
    with path.open("rb") as file:
        for begin in range(0, len(values), ROWS_AT_A_TIME):
            rows = np.fromfile(file, count=ROWS_AT_A_TIME * width).reshape(-1, width)
            values[begin : begin + len(rows)] = rows[:, k]
    return values


class _Nested:
    """The runs of a system one after the other, with one progress of all."""

    def __init__(
        self,
        system: System,
        runner: Callable[..., Result],
        settings: dict[str, Any],
        all_rows: Path,
    ) -> None:
        self.system, self.runner, self.settings = system, runner, settings
        self.descriptions = connect(system).descriptions if system.parts else {}
        self.report = settings.pop("progress", None) or (lambda _: None)
        csv = settings.pop("csv", None)
        self.of_finest: dict[str, Any] = {} if csv is None else {"csv": csv}
        if settings.get("output_step") is not None:
            self.of_finest["all_rows"] = all_rows
        self.finest: Result | None = None
        self.done, self.all = 0.0, 1.0

    def run(self, step: float | Adaptive, cost: float, **more: Any) -> Result:
        """One of them, which costs so much of them `all`; raises what the runner does, Ctrl-C with the finest result."""
        ends = (self.done / self.all, (self.done + cost) / self.all)
        self.done += cost
        try:
            with nullcontext() if self.finest is None else without_log():
                return self.runner(
                    self.system, step=step, **self.settings, **more,
                    progress=partial(report_share, self.report, *ends),
                )  # fmt: skip
        except Interrupted as interrupt:
            interrupt.result = self.finest or interrupt.result
            raise
        except SetupError as error:
            if self.finest is None:
                raise
            raise SetupError(f"{OTHER_STEPS}: {error}") from error

    def fixed(self, step: float, known: Mapping[int, Result], halvings: int) -> NestedRuns:
        """The runs for a step [s]."""
        steps, beside = compared_steps(self.descriptions, step, halvings)
        span = self.settings.get("stop", math.inf) - self.settings.get("start", 0.0)
        results: list[Result] = []
        lost = ""
        costs = [STEP_RATIO**-k for k in range(RUNS)]
        self.all = sum(c for k, c in enumerate(costs) if k not in known)
        self.all += GOLDEN * (beside is not None)
        for k, each in enumerate(steps):
            if k in known:
                results.append(known[k])
                continue
            if k and not isinstance(each, Mesh) and each > span * (1.0 + STEP_ROUNDING):
                lost = TOO_LONG.format(each)
                break
            try:
                results.append(self.run(each, costs[k], **({} if k else self.of_finest)))
            except SimulationError as error:
                if k == 0:
                    raise
                lost = LOST.format(f"a step of {step * STEP_RATIO**k:g} s", error)
                break
            self.finest = results[0]
            if k and is_unstable(results[-1], results[-2]):
                lost = BLOWN_UP.format(STEP_RATIO**k, step / STEP_RATIO ** (RUNS - k))
                results.pop()
                break
        witness = None
        if beside is not None:
            try:
                witness = self.run(beside, GOLDEN)
            except SimulationError as error:
                lost, results = LOST.format("other steps", error), results[:1]
        return NestedRuns(
            results, results[0], STEP_RATIO, steps[0], lost, witness, tells_events(self.descriptions),
            confirms=not isinstance(steps[0], Mesh),
        )  # fmt: skip

    def along(self, step: Adaptive) -> NestedRuns:
        """The runs for a tolerance."""
        self.all = 2.5
        finest = self.finest = self.run(step, 1.0, **self.of_finest)
        try:
            costs = zip(steps_along(finest, step), (0.5, 0.25, 1.0))
            *others, witness = [self.run(each, cost) for each, cost in costs]
            found = NestedRuns([finest, *others], finest, witness=witness)
        except SimulationError as error:
            found = NestedRuns([finest], finest, lost=LOST.format("longer steps", error))
        tells = tells_events(self.descriptions)
        return replace(found, step=step, tells_events=tells, confirms=False, follows=True)


def is_unstable(result: Result, finer: Result) -> bool:
    """Whether a column of a run has grown beyond all that it has in a run with shorter steps."""
    for name in result.names[1:]:
        largest, other = (float(np.abs(r[name]).max(initial=0.0)) for r in (result, finer))
        if largest > UNSTABLE * max(other, np.finfo(float).tiny) and largest > 1.0 / UNSTABLE:
            return True
    return False


def shorter_step(step: float | Adaptive) -> float | Adaptive:
    """The step or the tolerance that follows where an error is to be smaller."""
    if isinstance(step, Adaptive):
        return replace(step, tolerance=step.tolerance / TOLERANCE_RATIO)
    return step / STEP_RATIO


@contextmanager
def without_log() -> Iterator[None]:
    """Nothing is logged: what a run with longer steps warns of is not said of the finest one."""
    log = logging.getLogger("cosim")
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


def report_share(
    progress: Callable[[float], None], begin: float, end: float, fraction: float
) -> None:
    """Report the progress of all runs from that of one, which is the share from `begin` to `end` of them."""
    progress(begin + fraction * (end - begin))
