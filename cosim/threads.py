"""Members of an ensemble in this process, by one worker or by several in threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
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


def in_order(batch: Batch, worker: Worker) -> Iterator[Ensemble]:
    """The blocks of a worker until nothing waits, the user interrupts, or it may call its FMUs no more."""
    done = 0

    def progress(n: int) -> None:
        batch.report((done + n) / batch.members)

    while batch.waiting and not batch.interrupts and not worker.abandoned:
        chunk = batch.waiting.pop(0)
        block = batch.evaluate(worker, batch.cases, chunk, progress)
        batch.return_undone(chunk, block)
        yield block
        done += len(block)


def in_threads(batch: Batch, workers: list[Worker]) -> Iterator[Ensemble]:
    """The blocks of several workers, each in a thread; it ends as `in_order` does."""
    lock, ends, blocks = threading.Lock(), threading.Event(), SimpleQueue[Ensemble]()
    done = [0] * len(workers)

    def work(k: int, worker: Worker) -> None:
        finished = 0

        def progress(n: int) -> None:
            done[k] = finished + n

        while not (ends.is_set() or batch.interrupts or worker.abandoned):
            with lock:
                if not batch.waiting:
                    return
                chunk = batch.waiting.pop(0)
            try:
                block = batch.evaluate(worker, batch.cases, chunk, progress)
            except BaseException:
                ends.set()
                raise
            finished += len(block)
            with lock:
                batch.return_undone(chunk, block)
            blocks.put(block)

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
