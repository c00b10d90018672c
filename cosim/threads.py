"""Members of an ensemble in this process, by one worker or by several in threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from queue import Empty, SimpleQueue

from .ensemble import Ensemble
from .worker import Batch, Chunk, Worker

#: Longest wait for a block before signals and progress are looked at [s].
PATIENCE = 0.05


def in_order(batch: Batch, worker: Worker) -> Iterator[Ensemble]:
    """The blocks of a worker until nothing waits, the user interrupts, or it may call its FMUs no more."""
    done = 0

    def progress(n: int) -> None:
        batch.report((done + n) / batch.members)

    while batch.waiting and not batch.interrupts and not worker.abandoned:
        chunk = batch.waiting.pop(0)
        block = (batch.evaluate or Worker.run)(worker, batch.cases, chunk, progress)
        batch.give_back(chunk, block)
        yield block
        done += len(block)


def in_threads(batch: Batch, workers: list[Worker]) -> Iterator[Ensemble]:
    """The blocks of several workers, each in a thread; it ends as `in_order` does."""
    crew = _Crew(batch)
    threads = [threading.Thread(target=crew.work, args=(k, w)) for k, w in enumerate(workers)]
    for thread in threads:
        thread.start()
    try:
        while any(thread.is_alive() for thread in threads) or not crew.blocks.empty():
            try:
                block = crew.blocks.get(timeout=PATIENCE)
            except Empty:
                batch.report(sum(crew.done.values()) / batch.members)
                continue
            if isinstance(block, BaseException):
                raise block
            yield block
    finally:
        crew.ends = True
        for thread in threads:
            thread.join()


class _Crew:
    """What threads share: the chunks that wait, the blocks that are done, and how many members each has."""

    def __init__(self, batch: Batch) -> None:
        self._batch, self._lock = batch, threading.Lock()
        self.blocks = SimpleQueue[Ensemble | BaseException]()
        self.done: dict[int, int] = {}
        self.ends = False

    def work(self, k: int, worker: Worker) -> None:
        """Let worker number k run chunks until none waits."""
        finished = 0
        try:
            while (chunk := self._next(worker)) is not None:
                run = self._batch.evaluate or Worker.run
                block = run(worker, self._batch.cases, chunk, self._progress(k, finished))
                finished += len(block)
                self.done[k] = finished
                with self._lock:
                    self._batch.give_back(chunk, block)
                self.blocks.put(block)
        except BaseException as error:  # noqa: BLE001
            self.ends = True
            self.blocks.put(error)

    def _progress(self, k: int, finished: int) -> Callable[[int], None]:
        def show(n: int) -> None:
            self.done[k] = finished + n

        return show

    def _next(self, worker: Worker) -> Chunk | None:
        """A chunk that waits, if the work goes on."""
        with self._lock:
            waiting = self._batch.waiting
            goes_on = waiting and not (self.ends or self._batch.interrupts or worker.abandoned)
            return waiting.pop(0) if goes_on else None
