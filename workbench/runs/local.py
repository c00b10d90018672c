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
from dataclasses import dataclass
from functools import partial
from importlib.machinery import PathFinder
from importlib.util import module_from_spec, spec_from_file_location
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
Engine = Callable[[Callable[[Any], Any], Mapping[Key, Any]], Outcomes]


class Broken(SimulationError):
    """A task of a sweep that did not come to its end in its process."""

    def __init__(self, message: str) -> None:
        super().__init__(message, Result([], {}, {}, lambda: np.empty((0, 0))))


@dataclass(frozen=True)
class FromFile:
    """A function of a module that is loaded from a file; so it is where this is unpickled."""

    module: str
    path: str
    name: str

    def __call__(self, task: Any) -> Any:
        """What the function does."""
        return getattr(sys.modules[self.module], self.name)(task)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        known = getattr(sys.modules.get(self.module), "__file__", None)
        spec = spec_from_file_location(self.module, self.path)
        if known != self.path and spec and spec.loader:
            sys.modules[self.module] = module_from_spec(spec)
            spec.loader.exec_module(sys.modules[self.module])


def portable(function: Callable[[Task], Answer]) -> Callable[[Task], Answer]:
    """The function as another process can have it, also if its file is not where modules are found."""
    name = getattr(function, "__module__", "")
    path = getattr(sys.modules.get(name), "__file__", None)
    if path is None or name == "__main__" or "." in name:
        return function
    found = PathFinder.find_spec(name)
    if found and found.origin == path:
        return function
    return FromFile(name, path, function.__name__)


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
                    outcome = worker.step()
                    if outcome is not None:
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
    engine: Engine | None = None,
) -> Iterator[Answer]:
    """function(task) for every task, in the order of the tasks.

    One job is done in this process, more in processes of their own, or wherever `engine` does them.
    A journal keeps answers by function and task: those that it has are not computed again.
    Raises what the function raises with one job; with more SetupError if it does, SimulationError
    that names the task for every other way to end.
    """
    if jobs > 1 or engine:
        function = portable(function)
    keys = [n if journal is None else _key(function, task) for n, task in enumerate(tasks)]
    known = {} if journal is None else journal.done
    found: dict[Key, Any] = {key: pickle.loads(known[key]) for key in keys if key in known}
    missing = {key: task for key, task in zip(keys, tasks) if key not in found}
    done = engine or (here if jobs == 1 else partial(rows, jobs=jobs))
    with (
        nullcontext() if journal is None else journal.kept(),
        closing(done(function, missing)) as outcomes,
        bar(title, len(set(keys)), len(found)) as tell,
    ):
        for wanted in keys:
            while wanted not in found:
                key, outcome = next(outcomes)
                if outcome.status != OK:
                    raise _broken(title, keys.index(key) + 1, len(keys), missing[key], outcome)
                found[key] = outcome.answer
                if journal is not None:
                    journal.add(key, pickle.dumps(outcome.answer))
                tell(False)
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
