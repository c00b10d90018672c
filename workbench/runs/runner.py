"""Many runs, in processes of this machine or on a cluster. Tasks go in, outcomes come out, a journal keeps them.

A run may end its process, hang or be killed: that is an outcome like any other.
"""

from __future__ import annotations

import math
import re
import reprlib
import signal
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from cosim import SetupError
from cosim.calls import MACHINE, OK, TIMEOUT, Caller, Outcome, wait_for_any
from cosim.journal import OutcomeJournal, RunFailedError
from cosim.progress import bar_of_runs
from cosim.signals import handle_stop_signals
from cosim.threads import available_cores

from ..catalog import load_cached
from ..options import at_least

Task = TypeVar("Task")
Answer = TypeVar("Answer")
Key = int
Outcomes = Generator[tuple[Key, Outcome]]
ADDRESS = re.compile(r"(\w+://)?\S+:\d+")

#: Calls of a study at least, where each may take several cases. Chosen: as many as an ordinary machine has cores.
LEAST_CALLS = 8


@dataclass(frozen=True)
class Runner:
    """Does runs in so many processes of this machine, by default as many as cores, or on a Dask cluster.

    Attributes
    ----------
    jobs : int, optional
        Processes of this machine.
    scheduler : str
        The address of a Dask scheduler, "tcp://host:8786"; "" for none.
    packages : sequence of str
        Packages whose code must be that of this process.
    page : str
        The question, by module or file; it is loaded where its functions are called.
    files : sequence of Path
        Files that the tasks name, among them a question that is a file.

    Raises
    ------
    SetupError
        For fewer processes than one, for what is no address, and for both.
    """

    jobs: int | None = None
    scheduler: str = ""
    packages: Sequence[str] = ()
    page: str = ""
    files: Sequence[Path] = ()

    def __post_init__(self) -> None:
        if self.jobs is not None and self.scheduler:
            raise SetupError(
                "jobs are processes of this machine; the scheduler has its own workers"
            )
        if self.jobs is not None:
            at_least("jobs", self.jobs, 1)
        if self.scheduler and not ADDRESS.fullmatch(self.scheduler):
            raise SetupError(f"scheduler = {self.scheduler!r} must read tcp://HOST:PORT")

    def stream(
        self,
        function: Callable[[Any], Any],
        tasks: Mapping[Key, Any],
        limits: Mapping[Key, float] = MappingProxyType({}),
    ) -> Outcomes:
        """Give key and outcome of each task as they are done in other processes, each within its wall time [s], if it has one."""
        if self.scheduler:
            try:
                from . import cluster
            except ImportError:
                raise SetupError(
                    '--scheduler needs the package distributed: write pip install "drive-fmus[cluster]"'
                ) from None
            calls = {key: (function, task, limits.get(key)) for key, task in tasks.items()}
            yield from cluster.stream(self.scheduler, calls, self.page, self.files, self.packages)
            return
        waiting = iter(tasks.items())
        prepare = partial(load_cached, self.page) if self.page else None
        workers = [Caller() for _ in range(min(self.jobs or available_cores(), len(tasks)))]
        key_of: dict[Caller, Key] = {}

        def start_next(worker: Caller) -> None:
            for key, task in islice(waiting, 1):
                key_of[worker] = key
                worker.give(function, task, limits.get(key), prepare)

        try:
            for worker in workers:
                start_next(worker)
            while key_of:
                wait_for_any(list(key_of))
                for worker in list(key_of):
                    if (outcome := worker.step()) is not None:
                        key = key_of.pop(worker)
                        start_next(worker)
                        yield key, outcome
        finally:
            for worker in workers:
                worker.close()

    def outcomes(
        self,
        function: Callable[[Any], Any],
        tasks: Mapping[Key, Any],
        title: str,
        journal: OutcomeJournal | None = None,
        *,
        timeout: float | None = None,
        at_once: int = 0,
    ) -> Outcomes:
        """Give key and outcome of each task: first what the journal has, then the others as they are done.

        With `at_once` the function takes a list of at most so many tasks, in another process, and gives their outcomes;
        then a journal keeps failures, too, and they count as done. Else it takes one, and what it raises may come
        through. What is a fault of the machine is never kept: a file of the runs is gone, or room, memory or open files
        ran out.

        Raises
        ------
        SimulationError
            With `at_once`, for a fault of the machine.
        SetupError
            If no process can be started, or the cluster is another one.
        KeyboardInterrupt
            For Ctrl-C, SIGTERM and SIGHUP.
        """
        done = {} if journal is None else {key: journal[key] for key in tasks if key in journal}
        yield from done.items()
        missing = {key: task for key, task in tasks.items() if key not in done}
        if at_once:
            fresh = self._together(function, tasks, missing.keys(), timeout, at_once)
        elif self.jobs == 1:
            fresh = ((key, Outcome(OK, function(task))) for key, task in missing.items())
        else:
            fresh = self.stream(function, missing)
        failed = sum(outcome.status != OK for outcome in done.values())
        with (
            handle_stop_signals(signal.default_int_handler),
            closing(fresh),
            bar_of_runs(title, len(tasks)) as show,
        ):
            try:
                for number, (key, outcome) in enumerate(fresh, len(done) + 1):
                    failed += outcome.status != OK
                    if at_once:
                        _refuse_machine_faults(self.files, title, key, outcome)
                    if journal is not None and (at_once or outcome.status == OK):
                        journal[key] = outcome
                    show(number / len(tasks), failed)
                    yield key, outcome
            except KeyboardInterrupt:
                if journal is None:
                    raise
                raise journal.interruption() from None

    def _together(
        self,
        function: Callable[[list[Any]], list[Outcome]],
        tasks: Mapping[Key, Any],
        missing: AbstractSet[Key],
        timeout: float | None,
        at_once: int,
    ) -> Outcomes:
        """Give key and outcome of those tasks that are missing, in calls of several.

        Which are in one call does not depend on what is missing, nor on how many are done at a time, so that the last bits do
        not either. Each case has its `timeout`, a call that of all its cases; one that is late is done again in halves, and the
        cases of one that ends its process have a call each.
        """
        keys, size = list(tasks), min(at_once, math.ceil(len(tasks) / LEAST_CALLS) or 1)
        waiting = [keys[k : k + size] for k in range(0, len(keys), size)]
        while waiting:
            calls = {
                k: [tasks[key] for key in block]
                for k, block in enumerate(waiting)
                if not missing.isdisjoint(block)
            }
            limits = {k: timeout * len(call) for k, call in calls.items()} if timeout else {}
            again: list[list[Key]] = []
            with closing(self.stream(function, calls, limits)) as stream:
                for k, outcome in stream:
                    block = waiting[k]
                    if outcome.status == OK:
                        yield from (x for x in zip(block, outcome.answer) if x[0] in missing)
                    elif len(block) == 1:
                        yield block[0], outcome
                    else:
                        size = math.ceil(len(block) / 2) if outcome.status == TIMEOUT else 1
                        again += [block[k : k + size] for k in range(0, len(block), size)]
            waiting = again

    def map(
        self,
        function: Callable[[Task], Answer],
        tasks: Sequence[Task],
        title: str,
        journal: OutcomeJournal | None = None,
    ) -> Iterator[Answer]:
        """Give function(task) for every task, in their sequence; a journal keeps answers by their place in it.

        Raises
        ------
        SetupError, SimulationError
            What the function raises in this process. Elsewhere SetupError if it does, and SimulationError
            that names the task for every other way to end.
        """
        keys = range(len(tasks)) if journal is None else journal.numbers(len(tasks))
        task_of, answers = dict(zip(keys, tasks)), {}
        with closing(self.outcomes(function, task_of, title, journal)) as outcomes:
            for wanted in keys:
                while wanted not in answers:
                    key, outcome = next(outcomes)
                    if outcome.status != OK:
                        number = f"{title}, {keys.index(key) + 1} of {len(keys)}"
                        raise _failure(number, task_of[key], outcome)
                    answers[key] = outcome.answer
                yield answers[wanted]


def _refuse_machine_faults(files: Sequence[Path], title: str, key: Key, outcome: Outcome) -> None:
    """Raise SimulationError for a run that the machine made fail."""
    if outcome.status == OK:
        return
    for path in files:
        if not path.exists():
            raise RunFailedError(
                f"{title}: run {key}: {path} is gone; what was computed is in the study's journal, "
                "and the same command continues once the file is back"
            )
    if outcome.status == MACHINE:
        raise RunFailedError(
            f"{title}: run {key}: {outcome.message}; this is a fault of the machine, so the run "
            "does not count; once it is mended, the same command continues"
        )


def _failure(number: str, task: object, outcome: Outcome) -> Exception:
    """Return the error for a call that has no answer."""
    if outcome.status == "refused":
        return SetupError(outcome.message)
    name = reprlib.repr(task)
    if isinstance(task, tuple) and (fields := vars(type(task)).get("_fields")):  # a named tuple
        name = ", ".join(f"{key} = {reprlib.repr(x)}" for key, x in zip(fields, task))
    trace = f"\n{outcome.trace}" if outcome.status == "failed" and outcome.trace else ""
    return RunFailedError(f"{number} ({name}): {outcome.message}{trace}")
