"""Runs of one system with the steps h, 2 h and 4 h, or with steps that adapt to tolerances which differ by ten."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..engine.control import Adaptive
from ..engine.row_file import stored_column
from ..result import Interrupted, Result, SimulationError
from ..scratch import scratch
from ..system import System
from .limit import RUNS, STEP_RATIO

#: Ratio of two tolerances of adaptive steps: the steps then differ by sqrt(10) or more, as they do by 2 where they are fixed.
TOLERANCE_RATIO = 10.0
#: Least ratio of the steps of two runs that shows an error (Celik et al., J. Fluids Eng. 130, 2008, step 2).
LEAST_RATIO = 1.3
#: Share by which a step may exceed a run that is as long: rounding of their quotient.
STEP_ROUNDING = 1e-9
TOO_LONG = "the run is shorter than a step of {:g} s, so that no error can be estimated"
LOST = "the run with a {} fails, so that no error can be estimated: {}"


@dataclass(frozen=True)
class NestedRuns:
    """The results of up to three runs, the finest first, whose steps differ by `ratio`.

    `dense` is the finest one with all its rows. `lost` says why coarser runs are missing.
    """

    results: Sequence[Result]
    dense: Result
    ratio: float
    lost: str = ""

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
    def steps_differ_enough(self) -> bool:
        """Whether the steps of the runs differ by so much that differences show an error."""
        return self.ratio >= LEAST_RATIO

    @property
    def have_jumps_within_steps(self) -> bool:
        """Whether an input jumps inside a step of one of them; where in the step differs from run to run."""
        return any(bool((r.breaks[:, 1] > r.breaks[:, 0]).any()) for r in self.results)


def longer_step(step: float | Adaptive, times: int) -> float | Adaptive:
    """The step so many ratios longer."""
    if isinstance(step, Adaptive):
        return replace(step, tolerance=step.tolerance * TOLERANCE_RATIO**times)
    return step * STEP_RATIO**times


@contextmanager
def nested_runs(
    system: System,
    step: float | Adaptive,
    runner: Callable[..., Result],
    settings: Mapping[str, Any],
    *,
    known: Mapping[int, Result] | None = None,
) -> Iterator[NestedRuns]:
    """Run with the step, twice and four times it; or with the tolerance, ten and a hundred times it.

    The finest run comes first and gets `csv`; it stands even if a coarser one fails. Where rows are wanted
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
    """
    with TemporaryDirectory(dir=scratch(), ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "rows"
        results, lost = _results(
            system, step, runner, {**settings}, known={**(known or {})}, all_rows=path
        )
        finest = dense = results[0]
        if path.exists():
            dense = finest.with_columns_from(partial(stored_column, path, len(finest.columns)))
        yield NestedRuns(results, dense, ratio_of_steps(results, step), lost)


def _results(
    system: System,
    step: float | Adaptive,
    runner: Callable[..., Result],
    settings: dict[str, Any],
    *,
    known: dict[int, Result],
    all_rows: Path,
) -> tuple[list[Result], str]:
    """The results of the runs, the finest first, and why coarser ones are missing."""
    report = settings.pop("progress", None) or (lambda _: None)
    finest_only = {"csv": csv} if (csv := settings.pop("csv", None)) is not None else {}
    if settings.get("output_step") is not None:
        finest_only["all_rows"] = all_rows
    span = settings.get("stop", math.inf) - settings.get("start", 0.0)
    ends = np.cumsum([0.0, *(_ratio(step) ** -float(k) for k in range(RUNS))])
    for k in range(RUNS):
        if k in known:
            continue
        progress = partial(report_share, report, *(ends[k : k + 2] / ends[-1]).tolist())
        longer = longer_step(step, k)
        if k and not isinstance(longer, Adaptive) and longer > span * (1.0 + STEP_ROUNDING):
            return [known[n] for n in range(k)], TOO_LONG.format(longer)
        try:
            with without_log() if k else nullcontext():
                known[k] = runner(
                    system, step=longer, **settings, progress=progress, **({} if k else finest_only)
                )
        except Interrupted as interrupt:
            interrupt.result = known.get(0, interrupt.result)
            raise
        except SimulationError as error:
            if k == 0:
                raise
            size = (
                f"tolerance of {longer.tolerance:g}"
                if isinstance(longer, Adaptive)
                else f"step of {longer:g} s"
            )
            return [known[n] for n in range(k)], LOST.format(size, error)
    return [known[k] for k in range(RUNS)], ""


def _ratio(step: float | Adaptive) -> float:
    """That of the steps or tolerances of two runs."""
    return TOLERANCE_RATIO if isinstance(step, Adaptive) else STEP_RATIO


def ratio_of_steps(results: Sequence[Result], step: float | Adaptive) -> float:
    """By what the steps of runs differ that were asked for with this step or tolerance.

    Of fixed steps, and without wires, it is what was asked for. That of adaptive steps is seen in their numbers: jumps and a longest step leave control only a part of them, and
    by what power of the tolerance it changes them depends on the system. Of two ratios the smaller one counts. Where no
    wire couples parts, control has nothing to control, and there is no error that steps could show.
    """
    facts = [result.provenance for result in results]
    if not isinstance(step, Adaptive) or not facts[0].get("wires"):
        return _ratio(step)
    return min((a["steps"] / b["steps"] for a, b in pairwise(facts)), default=TOLERANCE_RATIO)


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
