"""Runs on a Dask cluster: FMUs travel with them, a lost worker's runs are done again.

A worker does its runs in child processes, so that it outlives them. What kills a worker comes from
outside; Dask gives up on a run after some lost workers, and then it is submitted anew.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from cosim import SetupError

from .fingerprint import differences, facts
from .journal import Key
from .runner import Outcomes, RunFailed, Runner
from .transport import Bundle, Call, pickled_call
from .worker import MAX_DEATHS, Outcome, Worker

CONNECT = 10.0
WORKERS = 30.0
GRACE = 60.0
LOOK = 1.0
TLS = "tls://"
_idle: SimpleQueue[Worker] = SimpleQueue()


class Shipped(NamedTuple):
    """What all runs need: files, how the calls are to be opened, and what workers must be."""

    cargo: Bundle
    runner: Runner
    facts: Mapping[str, Any]


def outcomes(
    runner: Runner, function: Callable[[Any], Any], tasks: Mapping[Key, Any], timeout: float | None
) -> Outcomes:
    """Key and outcome of function(task) for each task as they are done on the runner's cluster.

    Raises SetupError for a scheduler that cannot be reached, has no workers, or workers whose code or
    versions are not those of this process, and SimulationError if all workers are gone for a minute.
    """
    scheduler = str(runner.scheduler)
    try:
        from distributed import Client, KilledWorker, Security
    except ImportError:
        raise SetupError("--scheduler needs the package distributed, the extra `dask`") from None
    if scheduler.startswith(TLS) and not Security().get_connection_args("client")["ssl_context"]:
        raise SetupError(
            f"scheduler = {scheduler!r} needs the certificates of this side; Dask reads their files "
            "from DASK_DISTRIBUTED__COMM__TLS__CA_FILE, __CLIENT__CERT and __CLIENT__KEY"
        )
    try:
        client = Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SetupError(f"no Dask scheduler answers at {scheduler}: {error}") from None
    needed = Shipped(Bundle.of(runner.files), runner, facts(*runner.packages))
    lost: Counter[Key] = Counter()
    submitted: dict[Any, Key] = {}
    done: SimpleQueue[Any] = SimpleQueue()
    with client:
        _check(client, runner)
        shipped = client.submit(_ship, needed, pure=False)

        def submit(key: Key) -> None:
            nonlocal shipped
            if shipped.status == "error":
                shipped = client.submit(_ship, needed, pure=False)
            call = pickled_call(function, tasks[key], runner.files)
            future = client.submit(_run, call, shipped, timeout, pure=False)
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
                            f"the scheduler at {scheduler} is gone or has ended the runs"
                        )
                    outcome = future.result(timeout=LOOK)
                except (Empty, TimeoutError):
                    if future is not None:  # its worker was lost before the answer was fetched
                        done.put(future)
                    seen = _seen(client, scheduler, seen)
                    continue
                except KilledWorker as killed:
                    key = submitted[future]
                    lost[key] += 1
                    if lost[key] < MAX_DEATHS:
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


def _check(client: Any, runner: Runner) -> None:
    """Refuse workers that would compute something else; one without our code would die of a run."""
    try:
        client.wait_for_workers(1, timeout=WORKERS)
    except TimeoutError:
        raise SetupError(f"the scheduler at {runner.scheduler} has no workers") from None
    here = facts(*runner.packages)
    for worker, there in client.run(facts, *runner.packages, on_error="return").items():
        if isinstance(there, BaseException):
            raise SetupError(
                f"worker {worker} cannot do runs: {there}; start it in the project's folder"
            )
        _same(worker, there, here)


def _same(worker: str, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    if there != here:
        raise SetupError(f"worker {worker} differs: {differences(there, here)} on this side")


def _seen(client: Any, scheduler: str, before: float) -> float:
    """When there were workers last; gives up when there have been none for a while."""
    with contextlib.suppress(OSError, TimeoutError):
        if client.nthreads():
            return time.monotonic()
    if time.monotonic() < before + GRACE:
        return before
    raise RunFailed(
        f"the scheduler at {scheduler} has had no workers for {GRACE:g} s; what was computed is kept, "
        "and the same command continues"
    )


def _ship(shipped: Shipped) -> Shipped:
    """A task of its own, which Dask computes again when the workers that hold its result die."""
    return shipped


def _run(pickled_call: bytes, shipped: Shipped, timeout: float | None) -> Outcome:
    """What becomes of a call, on a worker; raises SetupError on one whose code is another."""
    from distributed import get_worker

    worker, runner = get_worker(), shipped.runner
    _same(worker.address, facts(*runner.packages), shipped.facts)
    folder = shipped.cargo.unpacked(Path(worker.local_directory) / "runs")
    own = folder / Path(runner.page).name
    call = Call(pickled_call, str(own) if own.is_file() else runner.page, folder)
    multiprocessing.current_process().daemon = False  # a nanny's worker may have no children else
    try:
        child = _idle.get_nowait()
    except Empty:
        child = Worker()
    outcome = child.do(call, timeout)
    _idle.put(child)
    return outcome


def _release() -> None:
    """End the child processes of this worker that have nothing to do."""
    while not _idle.empty():
        _idle.get_nowait().close()
