"""Many runs with a progress bar, in this process or on several; results come in order."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from rich.console import Console
from rich.progress import track

Task = TypeVar("Task")
Answer = TypeVar("Answer")


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def each(
    function: Callable[[Task], Answer], tasks: Sequence[Task], jobs: int, title: str
) -> Iterator[Answer]:
    """function(task) for every task, in the order of the tasks."""
    if jobs == 1:
        yield from _shown(map(function, tasks), len(tasks), title)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_leave_ctrl_c) as pool:
        try:
            yield from _shown(pool.map(function, tasks), len(tasks), title)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _shown(answers: Iterator[Answer], count: int, title: str) -> Iterator[Answer]:
    """With a progress bar on a terminal, silently elsewhere."""
    console = Console(stderr=True)
    quiet = not console.is_terminal
    return iter(track(answers, description=title, total=count, console=console, disable=quiet))


def _leave_ctrl_c() -> None:
    """Ctrl-C stops the parent, which then ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
