"""Runs on this machine: in child processes that may crash, hang or be killed, or in this process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import islice
from types import MappingProxyType
from typing import Any

from cosim.threads import available_cores

from ..options import at_least
from .journal import Key
from .runner import Outcomes, Runner
from .worker import OK, CallWorker, Outcome, wait_for_any


@dataclass(frozen=True)
class LocalRunner(Runner):
    """Does runs in so many processes of this machine; None are all cores.

    Raises
    ------
    SetupError
        For fewer than one.
    """

    jobs: int | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None:
            at_least("jobs", self.jobs, 1)

    @property
    def width(self) -> int:
        """How many processes it has."""
        return self.jobs or available_cores()

    def stream(
        self,
        function: Callable[[Any], Any],
        tasks: Mapping[Key, Any],
        limits: Mapping[Key, float] = MappingProxyType({}),
        *,
        is_isolated: bool = True,
    ) -> Outcomes:
        """Give key and outcome of each task; one job that need not be isolated is done in this process."""
        if self.jobs == 1 and not is_isolated:
            for key, task in tasks.items():
                yield key, Outcome(OK, function(task))
            return
        waiting = iter(tasks.items())
        workers = [CallWorker() for _ in range(min(self.width, len(tasks)))]
        key_of: dict[CallWorker, Key] = {}

        def start_next(worker: CallWorker) -> None:
            for key, task in islice(waiting, 1):
                key_of[worker] = key
                worker.give(function, task, limits.get(key), self.page)

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
