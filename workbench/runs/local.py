"""Many calls of one function, on the processes of this machine or others; a sweep of them in order."""

from __future__ import annotations

import hashlib
import os
import pickle
import reprlib
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from itertools import islice
from typing import Any, TypeVar

import numpy as np

from cosim import Result, SetupError, SimulationError

from .journal import Journal, Key
from .progress import bar
from .worker import OK, Outcome, Worker, await_one

Task = TypeVar("Task")
Answer = TypeVar("Answer")
Outcomes = Generator[tuple[Key, Outcome]]


class Broken(SimulationError):
    """A task of a sweep that did not come to its end in its process."""

    def __init__(self, message: str) -> None:
        super().__init__(message, Result([], {}, {}, lambda: np.empty((0, 0))))


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def rows(
    function: Callable[[Any], Any],
    tasks: Mapping[Key, Any],
    *,
    jobs: int,
    timeout: float | None = None,
) -> Outcomes:
    """Key and outcome of function(task) for each task as they are done, in so many child processes.

    Raises SetupError if no process can be started, KeyboardInterrupt for Ctrl-C, SIGTERM and SIGHUP.
    """
    waiting = iter(tasks.items())
    workers = [Worker() for _ in range(min(jobs, len(tasks)))]
    busy: dict[Worker, Key] = {}

    def give(worker: Worker) -> None:
        for key, task in islice(waiting, 1):
            busy[worker] = key
            worker.give(function, task, timeout)

    with ended_by_signals():
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


def here(function: Callable[[Any], Any], tasks: Mapping[Key, Any]) -> Outcomes:
    """Key and outcome of function(task) for each task, in this process; what it raises comes through."""
    with ended_by_signals():
        for key, task in tasks.items():
            yield key, Outcome(OK, function(task))


def each(
    function: Callable[[Task], Answer],
    tasks: Sequence[Task],
    jobs: int,
    title: str,
    *,
    journal: Journal | None = None,
) -> Iterator[Answer]:
    """function(task) for every task, in the order of the tasks.

    One job is done in this process, more in processes of their own. A journal keeps answers by
    function and task: those that it has are not computed again. Raises what the function raises with
    one job; with more SetupError if it does, SimulationError that names the task for every other way
    to end.
    """
    keys = [n if journal is None else _key(function, task) for n, task in enumerate(tasks)]
    known = {} if journal is None else journal.done
    found: dict[Key, Any] = {key: pickle.loads(known[key]) for key in keys if key in known}
    missing = {key: task for key, task in zip(keys, tasks) if key not in found}
    done = here(function, missing) if jobs == 1 else rows(function, missing, jobs=jobs)
    with (
        nullcontext() if journal is None else journal.kept(),
        closing(done) as outcomes,
        bar(title, len(set(keys)), len(found)) as step,
    ):
        for wanted in keys:
            while wanted not in found:
                key, outcome = next(outcomes)
                if outcome.status != OK:
                    raise _broken(title, keys.index(key) + 1, len(keys), missing[key], outcome)
                found[key] = outcome.answer
                if journal is not None:
                    journal.add(key, pickle.dumps(outcome.answer))
                step(False)
            yield found[wanted]


def _key(function: Callable[[Any], Any], task: object) -> Key:
    """A name for a call; equal names are equal calls."""
    return hashlib.sha256(pickle.dumps((function, task))).hexdigest()


def _broken(title: str, number: int, count: int, task: object, outcome: Outcome) -> Exception:
    """The error for a call that has no answer."""
    if outcome.status == "refused":
        return SetupError(outcome.message)
    name = reprlib.repr(task)
    if isinstance(task, tuple) and hasattr(task, "_asdict"):
        name = ", ".join(f"{key} = {reprlib.repr(x)}" for key, x in task._asdict().items())
    trace = f"\n{outcome.trace}" if outcome.status == "failed" and outcome.trace else ""
    return Broken(f"{title}, {number} of {count} ({name}): {outcome.message}{trace}")


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP end what is done here as Ctrl-C does, unless they are ignored."""
    before = {}
    if threading.current_thread() is threading.main_thread() and sys.platform != "win32":
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
