"""Members of an ensemble in this process, by one worker or by several in threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from queue import Empty, SimpleQueue

from .ensemble import Ensemble
from .worker import Batch, Worker

#: Longest wait for a block before signals and progress are looked at [s].
PATIENCE = 0.05


def available_cores() -> int:
    """How many processor cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_order(
    batch: Batch,
    worker: Worker,
    report: Callable[[int], object] | None = None,
    lock: threading.Lock | None = None,
) -> Iterator[Ensemble]:
    """The blocks of a worker until nothing waits, the user interrupts, or it may call its FMUs no more.

    It reports how many members are done; what waits is touched under the lock.
    """
    done, lock = 0, lock or threading.Lock()

    def progress(n: int) -> None:
        if report:
            report(done + n)
        else:
            batch.report((done + n) / batch.members)

    while not (batch.interrupts or worker.abandoned):
        with lock:
            if not batch.waiting:
                return
            chunk = batch.waiting.pop(0)
        block = batch.evaluate(worker, batch.cases, chunk, progress)
        with lock:
            batch.return_undone(chunk, block)
        done += len(block)
        yield block


def in_threads(batch: Batch, workers: list[Worker]) -> Iterator[Ensemble]:
    """The blocks of several workers, each in a thread; it ends as `in_order` does."""
    lock, ends, blocks = threading.Lock(), threading.Event(), SimpleQueue[Ensemble]()
    done = [0] * len(workers)

    def work(k: int, worker: Worker) -> None:
        try:
            for block in in_order(batch, worker, partial(done.__setitem__, k), lock):
                blocks.put(block)
                if ends.is_set():
                    return
        except BaseException:
            ends.set()
            raise

    with ThreadPoolExecutor(len(workers)) as pool:
        running = [pool.submit(work, k, worker) for k, worker in enumerate(workers)]
        try:
            while not (all(future.done() for future in running) and blocks.empty()):
                try:
                    yield blocks.get(timeout=PATIENCE)
                except Empty:
                    batch.report(sum(done) / batch.members)
            for future in running:
                future.result()
        finally:
            ends.set()
