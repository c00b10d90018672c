"""The one way to many runs: tasks in, outcomes out, here or on a cluster, kept in a journal."""

from __future__ import annotations

import hashlib
import os
import re
import reprlib
import signal
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from cosim import Result, SetupError, SimulationError
from cosim.errors import pluralize
from cosim.signals import handle_stop_signals

from ..options import at_least
from .journal import Journal, Key
from .transport import Call, pickled_call
from .worker import MACHINE, OK, Outcome, Worker, await_one

ADDRESS = re.compile(r"(\w+://)?\S+:\d+")
Task = TypeVar("Task")
Answer = TypeVar("Answer")
Outcomes = Generator[tuple[Key, Outcome]]


class RunFailed(SimulationError):
    """A task that did not come to its end."""

    def __init__(self, message: str) -> None:
        super().__init__(message, Result([], {}, {}, lambda: np.empty((0, 0))))


@dataclass(frozen=True)
class Runner:
    """Who does runs: so many processes of this machine, all cores for None, or the workers of a Dask
    scheduler, "tcp://host:8786", whose code of `packages` must be that of this process.

    The page of a question, by module or file, is loaded where its functions are called; `files`, a
    page that is one among them, are there. Raises SetupError for what cannot be.
    """

    jobs: int | None = None
    scheduler: str | None = None
    packages: Sequence[str] = ()
    page: str = ""
    files: Sequence[Path] = ()

    def __post_init__(self) -> None:
        if self.jobs is not None and self.scheduler is not None:
            raise SetupError(
                "jobs are processes of this machine; the scheduler has its own workers"
            )
        if self.jobs is not None:
            at_least("jobs", self.jobs, 1)
        if self.scheduler is not None and not ADDRESS.fullmatch(self.scheduler):
            raise SetupError(f"scheduler = {self.scheduler!r} must read tcp://HOST:PORT")

    def outcomes(
        self,
        function: Callable[[Any], Any],
        tasks: Mapping[Key, Any],
        title: str,
        journal: Journal | None = None,
        *,
        timeout: float | None = None,
        failures: bool = True,
    ) -> Outcomes:
        """Key and outcome of function(task) for each task: what the journal has, then the others as
        they are done, each in a process that may crash or take longer than `timeout` [s].

        A journal keeps failures, too, and they count as done; without `failures` it does not, and one
        job is done in this process, where what the function raises comes through. What is a fault of
        the machine is never kept: a file of the runs is gone, or room, memory or open files ran out.
        With `failures` it raises SimulationError. Raises SetupError if no process can be started or the
        cluster is another one, KeyboardInterrupt for Ctrl-C, SIGTERM and SIGHUP.
        """
        known = {} if journal is None else {key: journal[key] for key in tasks if key in journal}
        yield from known.items()
        missing = {key: task for key, task in tasks.items() if key not in known}
        if self.scheduler is not None and missing:
            from . import cluster

            done = cluster.outcomes(self, function, missing, timeout)
        elif self.jobs == 1 and not failures:
            done = ((key, Outcome(OK, function(task))) for key, task in missing.items())
        else:
            done = self._processes(function, missing, timeout)
        failed = sum(outcome.status != OK for outcome in known.values())
        with handle_stop_signals(signal.default_int_handler), closing(done), _progress() as shown:
            bar = shown.add_task(title, total=len(tasks), completed=len(known), failed=failed)
            try:
                for key, outcome in done:
                    failed += outcome.status != OK
                    if failures:
                        self._check_machine(title, key, outcome)
                    if journal is not None and (failures or outcome.status == OK):
                        journal[key] = outcome
                    shown.update(bar, advance=1, failed=failed)
                    yield key, outcome
            except KeyboardInterrupt:
                if journal is None:
                    raise
                kept = f"{pluralize(len(journal), 'run')} in {journal.path}; the same command continues"
                raise KeyboardInterrupt(kept) from None

    def _check_machine(self, title: str, key: Key, outcome: Outcome) -> None:
        """Raise SimulationError for a run that the machine made fail."""
        if outcome.status == OK:
            return
        for path in self.files:
            if not path.exists():
                raise RunFailed(
                    f"{title}: run {key}: {path} is gone; what was computed is in the study's journal, "
                    "and the same command continues once the file is back"
                )
        if outcome.status == MACHINE:
            raise RunFailed(
                f"{title}: run {key}: {outcome.message}; this is a fault of the machine, so the run "
                "does not count; once it is mended, the same command continues"
            )

    def each(
        self,
        function: Callable[[Task], Answer],
        tasks: Sequence[Task],
        title: str,
        journal: Journal | None = None,
    ) -> Iterator[Answer]:
        """function(task) for every task, in the order of the tasks; a journal keeps answers by
        function and task.

        Raises what the function raises in this process; elsewhere SetupError if it does, and
        SimulationError that names the task for every other way to end.
        """
        keys: Sequence[Key] = range(len(tasks))
        if journal is not None:
            calls = (pickled_call(function, task, self.files) for task in tasks)
            keys = [hashlib.sha256(call).hexdigest() for call in calls]
        named, found = dict(zip(keys, tasks)), {}
        with closing(self.outcomes(function, named, title, journal, failures=False)) as done:
            for wanted in keys:
                while wanted not in found:
                    key, outcome = next(done)
                    if outcome.status != OK:
                        place = f"{title}, {keys.index(key) + 1} of {len(keys)}"
                        raise _broken(place, named[key], outcome)
                    found[key] = outcome.answer
                yield found[wanted]

    def _processes(
        self, function: Callable[[Any], Any], tasks: Mapping[Key, Any], timeout: float | None
    ) -> Outcomes:
        """Key and outcome of each task as they are done in child processes."""
        waiting = iter(tasks.items())
        workers = [Worker() for _ in range(min(self.jobs or available_cores(), len(tasks)))]
        busy: dict[Worker, Key] = {}

        def give(worker: Worker) -> None:
            for key, task in islice(waiting, 1):
                busy[worker] = key
                worker.give(Call(pickled_call(function, task), self.page), timeout)

        try:
            for worker in workers:
                give(worker)
            while busy:
                await_one(list(busy))
                for worker in list(busy):
                    if (outcome := worker.step()) is not None:
                        key = busy.pop(worker)
                        give(worker)
                        yield key, outcome
        finally:
            for worker in workers:
                worker.close()


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _broken(place: str, task: object, outcome: Outcome) -> Exception:
    """The error for a call that has no answer."""
    if outcome.status == "refused":
        return SetupError(outcome.message)
    name = reprlib.repr(task)
    if isinstance(task, tuple) and hasattr(task, "_asdict"):
        name = ", ".join(f"{key} = {reprlib.repr(x)}" for key, x in task._asdict().items())
    trace = f"\n{outcome.trace}" if outcome.status == "failed" and outcome.trace else ""
    return RunFailed(f"{place} ({name}): {outcome.message}{trace}")


def _progress() -> Progress:
    """A bar of runs on a terminal, done, failed, time left; nothing anywhere else."""
    console = Console(stderr=True)
    return Progress(
        "{task.description}",
        BarColumn(),
        MofNCompleteColumn(),
        "{task.fields[failed]} failed",
        TimeRemainingColumn(),
        console=console,
        redirect_stdout=False,
        disable=not console.is_terminal,
    )
