"""Runs on a Dask cluster: FMUs travel with them, a lost worker's runs are done again.

A worker does its runs in child processes, so that it outlives them. What kills a worker comes from
outside; Dask gives up on a run after some lost workers, and then it is submitted anew.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from cosim import SetupError

from .bundle import Bundle
from .identity import code, differences, versions
from .journal import Key
from .local import Broken, Outcomes
from .worker import LOST, Outcome, Worker

CONNECT = 10.0
WORKERS = 30.0
GRACE = 60.0
LOOK = 1.0
_idle: SimpleQueue[Worker] = SimpleQueue()
Function = Callable[[Any], Any]
Facts = Mapping[str, Mapping[str, str]]


class Shipped(NamedTuple):
    """What all runs need: files, what makes the function where they lie, what workers must be."""

    bundle: Bundle
    function: Callable[[Path], Function]
    facts: Facts


def facts() -> dict[str, dict[str, str]]:
    """What must be the same on client and workers: versions and source files."""
    return {"versions": versions(), "code": code()}


def _same(worker: str, there: Facts, here: Facts) -> None:
    """Refuse a worker that would compute something else."""
    if there != here:
        raise SetupError(f"worker {worker} differs: {differences(there, here)} on this side")


def rows(
    function: Callable[[Path], Function],
    tasks: Mapping[Key, Any],
    *,
    bundle: Bundle,
    timeout: float | None,
    scheduler: str,
) -> Outcomes:
    """Key and outcome of each task as they are done on the workers of a scheduler.

    What is called there is what `function` makes of the folder with the bundle's files. Raises
    SetupError for a scheduler that cannot be reached, has no workers, or workers whose code or versions
    are not those of this process, and SimulationError if all workers are gone for a minute.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise SetupError("--scheduler needs the package distributed, the extra `dask`") from None
    try:
        client = Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SetupError(f"no Dask scheduler answers at {scheduler}: {error}") from None
    with client:
        _check(client, scheduler)
        needed = Shipped(bundle, function, facts())
        shipped = client.submit(_ship, needed, pure=False)
        lost: dict[Key, int] = {}
        submitted: dict[Any, Key] = {}
        done: SimpleQueue[Any] = SimpleQueue()

        def submit(key: Key) -> None:
            nonlocal shipped
            if shipped.status == "error":
                shipped = client.submit(_ship, needed, pure=False)
            future = client.submit(_run, tasks[key], shipped, timeout, pure=False)
            submitted[future] = key
            future.add_done_callback(done.put)

        try:
            for key in tasks:
                submit(key)
            seen = time.monotonic()
            while submitted:
                future = None
                try:
                    future = done.get(timeout=LOOK)
                    if future.status == "cancelled":
                        raise SetupError(
                            f"the scheduler at {scheduler} is gone or cancelled the runs"
                        )
                    outcome = future.result(timeout=LOOK)
                except (Empty, TimeoutError):
                    if future is not None:  # its worker was lost before the answer was fetched
                        done.put(future)
                    seen = _seen(client, scheduler, seen)
                    continue
                except KilledWorker as killed:
                    key = submitted[future]
                    lost[key] = lost.get(key, 0) + 1
                    if lost[key] < LOST:
                        del submitted[future]
                        submit(key)
                        continue
                    text = "its workers were lost again and again"
                    outcome = Outcome("crashed", None, text, 0.0, str(killed))
                seen = time.monotonic()
                yield submitted.pop(future), outcome
        finally:
            with contextlib.suppress(OSError, TimeoutError):
                client.cancel(list(submitted))
                client.run(_release, on_error="ignore")


def _seen(client: Any, scheduler: str, before: float) -> float:
    """When there were workers last; gives up when there have been none for a while."""
    with contextlib.suppress(OSError, TimeoutError):
        if client.nthreads():
            return time.monotonic()
    if time.monotonic() < before + GRACE:
        return before
    raise Broken(
        f"the scheduler at {scheduler} has had no workers for {GRACE:g} s; what was computed is kept, "
        "the same command goes on"
    )


def _ship(shipped: Shipped) -> Shipped:
    """A task of its own, which Dask computes again when the workers that hold its result die."""
    return shipped


def _run(task: Any, shipped: Shipped, timeout: float | None) -> Outcome:
    """What becomes of a task, on a worker; raises SetupError on one that joined with other code."""
    from distributed import get_worker

    worker = get_worker()
    _same(worker.address, facts(), shipped.facts)
    folder = shipped.bundle.unpack(Path(worker.local_directory) / "studies")
    multiprocessing.current_process().daemon = False  # a nanny's worker may have no children else
    try:
        child = _idle.get_nowait()
    except Empty:
        child = Worker()
    outcome = child.call(shipped.function(folder), task, timeout)
    _idle.put(child)
    return outcome


def _release() -> None:
    """End the child processes of this worker that have nothing to do."""
    with contextlib.suppress(Empty):
        while True:
            _idle.get_nowait().close()


def _check(client: Any, scheduler: str) -> None:
    """Refuse workers that would compute something else."""
    try:
        client.wait_for_workers(1, timeout=WORKERS)
    except TimeoutError:
        raise SetupError(f"the scheduler at {scheduler} has no workers") from None
    for worker, told in client.run(facts, on_error="return").items():
        if isinstance(told, BaseException):
            raise SetupError(
                f"worker {worker} cannot do runs: {told}; start it in the project's folder"
            )
        _same(worker, told, facts())
