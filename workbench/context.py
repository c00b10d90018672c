"""The context of a question: its FMUs, runs with the errors of their figures, sweeps, tables on disk."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any, TypeVar

import cosim
from cosim import Estimate, Result, SetupError, System
from cosim.errors import pluralize
from cosim.journal import OutcomeJournal
from cosim.metrics import Metric
from cosim.progress import bar
from cosim.result import partial as partial_file

from .answer import Table
from .figure import Figure
from .files import stream
from .options import RunOptions
from .runs.runner import Runner

#: Does every run in this process.
IN_PROCESS = Runner(jobs=1)
#: Fewest communication steps of a certified run, so that the coarsest of the three still has four.
MIN_STEPS = 16
Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


@dataclass(frozen=True)
class Context:
    """The context in which a question is answered.

    Attributes
    ----------
    fmus : mapping of str to Path
        Its FMUs by part.
    runner : Runner
        Does the runs of sweeps.
    out : Path, optional
        The folder for rows as they are computed.
    journal : function
        Returns the journal of its sweeps, or None.
    certifies : bool
        Whether runs are repeated with other steps for the errors of their figures. Searches do without: then these are 0.
    """

    fmus: Mapping[str, Path]
    runner: Runner = IN_PROCESS
    out: Path | None = None
    journal: Callable[[], OutcomeJournal | None] = lambda: None
    certifies: bool = True

    @property
    def jobs(self) -> int | None:
        """How many runs at a time members of an ensemble may be in this process, None: what is best for their FMUs.

        Raises
        ------
        SetupError
            On a cluster, which has nothing to do then.
        """
        if not self.runner.scheduler:
            return self.runner.jobs
        raise SetupError(
            "scheduler: this question does its runs together in one process; leave the scheduler out, "
            "or write --jobs N for N at a time"
        )

    def certify(
        self,
        system: System,
        numbers: Mapping[str, Metric | Callable[[Result], Mapping[str, Figure]]],
        o: RunOptions,
        record: Sequence[str] | None,
        csv: str = "",
        *,
        derive: Callable[[Result], Result] | None = None,
    ) -> tuple[Result, dict[str, Figure]]:
        """Run a system with steps of `o.step`, and return its result and its figures.

        It is one call of `cosim.certify`. Rows go to the CSV file of that name as they are computed.

        Raises
        ------
        SetupError
            What `cosim.certify` raises, and for a step that is too long to determine errors.
        SimulationError
            What `cosim.certify` raises.

        Parameters
        ----------
        system : System
            What is run.
        numbers : mapping
            By name, metrics, which become figures without a meaning, or functions from a result to figures by their
            own names. Of those the error of the coupling is added, from runs with two and four times the step; that of
            `Figure.measured` is determined.
        o : RunOptions
            The options of the question, with its step and its stop [s].
        record : sequence of str or None
            The columns; None for all outputs.
        csv : str
            The name of the CSV file; "" for none.
        derive : callable, optional
            Gives results further columns, as in `cosim.certify`.
        """
        if not self.certifies:
            result = cosim.run(
                system, stop=o.stop, step=o.step, algorithm=o.algorithm, record=record
            )
            result = derive(result) if derive else result
            return result, dict(_figures_of_run(numbers, result))
        if o.step > o.stop / MIN_STEPS:
            raise SetupError(
                f"step = {o.step:g} s must be at most {o.stop / MIN_STEPS:g} s, a {MIN_STEPS}th of stop = "
                f"{o.stop:g} s: three runs with up to four times the step give the errors"
            )
        made: dict[str, Figure] = {}

        def of_result(
            function: Callable[[Result], Mapping[str, Figure]], result: Result
        ) -> dict[str, float | Estimate]:
            """The figures with the errors that they have themselves; the first are those of the finest run."""
            with captured_log_warnings() if made else nullcontext():
                now = function(result)
            made.update({name: x for name, x in now.items() if name not in made})
            return {
                name: x.value
                if x.awaits_error
                else Estimate(x.value, x.error, reason=x.reason, unit=x.unit)
                for name, x in now.items()
            }

        with (
            bar(csv.removesuffix(".csv") or "run", 0.0, o.stop) as progress_bar,
            self._rows(csv) as path,
        ):
            certified = cosim.certify(
                system,
                {
                    name: x if isinstance(x, Metric) else partial(of_result, x)
                    for name, x in numbers.items()
                },
                derive=derive,
                stop=o.stop,
                step=o.step,
                algorithm=o.algorithm,
                record=record,
                csv=path,
                progress=progress_bar,
            )
        for name, x in certified.figures.items():
            figure = made.get(name, Figure.measured(x.value, x.unit or "1"))
            is_lost = x.error is None and figure.error is not None
            made[name] = (
                Figure.undetermined(figure.unit, x.reason, figure.meaning)
                if is_lost
                else figure._replace(error=x.error)
            )
        return certified.result, {name: made[name] for name in certified.figures}

    @contextmanager
    def _rows(self, csv: str) -> Iterator[Path | None]:
        """The file of the rows of a run, None for none; a run that a question refuses to read leaves none behind."""
        path = self.out / csv if self.out and csv else None
        try:
            yield path
        except SetupError:
            if path:
                path.unlink(missing_ok=True)
                path.with_suffix(".json").unlink(missing_ok=True)
                with suppress(OSError):
                    path.parent.rmdir()
            raise

    def each(
        self,
        function: Callable[[Task], Outcome],
        tasks: Sequence[Task],
        title: str,
        *,
        probes: bool = False,
        here: bool = False,
    ) -> Iterator[Outcome]:
        """Give function(task) for every task, in their sequence, wherever the runner does its runs.

        Warnings become those of the question, except for `probes`, which look for what FMUs warn of.

        Parameters
        ----------
        function : callable
            Does one task, in whatever process.
        tasks : sequence
            What the function is called with.
        title : str
            What the progress bar shows.
        probes : bool
            Whether the tasks look for what FMUs warn of.
        here : bool
            Whether they are done in this process, each on all `jobs`.
        """
        call, runner = partial(_with_warnings, function), IN_PROCESS if here else self.runner
        for outcome, warnings in runner.map(call, tasks, title, self.journal()):
            for warning in () if probes else warnings:
                logging.getLogger("cosim").warning(warning)
            yield outcome

    def record_rows(
        self, csv: str, units: Mapping[str, str], rows: Iterable[Sequence[Any]]
    ) -> Table:
        """Return the table of rows, which go to NAME.partial.csv as they are computed.

        Parameters
        ----------
        csv : str
            The name of the file, without a suffix.
        units : mapping
            The unit of each column, by its name.
        rows : iterable of sequences
            The values, row by row.
        """
        path = self.out and self.out / csv

        def written() -> Iterator[Sequence[Any]]:
            for row in rows:
                append([row])
                yield row

        try:
            with stream(path, list(units)) as append:
                return Table.of_rows(written(), units)
        except KeyboardInterrupt as interrupt:
            if path and not interrupt.args:
                kept = partial_file(path)
                done = pluralize(len(kept.read_text(encoding="utf-8").splitlines()) - 1, "row")
                raise KeyboardInterrupt(f"{done} in {kept}") from None
            raise


def _figures_of_run(
    numbers: Mapping[str, Metric | Callable[[Result], Mapping[str, Figure]]], result: Result
) -> Iterator[tuple[str, Figure]]:
    """Give the figures of one run, whose errors are taken as 0."""
    for name, x in numbers.items():
        if isinstance(x, Metric):
            unit = x.unit(result.units.get(x.columns[0], "")) or "1"
            figures: Mapping[str, Figure] = {name: Figure.measured(metric_of(result, x), unit)}
        else:
            figures = x(result)
        for key, y in figures.items():
            if y.awaits_error and not math.isfinite(y.value):
                yield key, Figure.undetermined(y.unit, "the run does not have it", y.meaning)
            else:
                yield key, y._replace(error=0.0) if y.awaits_error else y


def metric_of(result: Result, metric: Metric) -> float:
    """Return a metric of one run."""
    return float(metric(*map(result.solution, metric.columns))[0])


def _with_warnings(function: Callable[[Task], Outcome], task: Task) -> tuple[Outcome, list[str]]:
    """Return function(task) and the warnings of its runs."""
    with captured_log_warnings() as warnings:
        return function(task), warnings()


@contextmanager
def captured_log_warnings() -> Iterator[Callable[[], list[str]]]:
    """Collect the warnings of the runs in this process, each once, and show them to no other handler."""
    log, handler = logging.getLogger("cosim"), BufferingHandler(sys.maxsize)
    handler.setLevel(logging.WARNING)
    saved = log.handlers, log.propagate
    log.handlers, log.propagate = [handler], False
    try:
        yield lambda: list(dict.fromkeys(record.getMessage() for record in handler.buffer))
    finally:
        log.handlers, log.propagate = saved
