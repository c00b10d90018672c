"""A progress bar of runs on a terminal: done, failed, rate, time left; nothing anywhere else."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def bar(title: str, total: int, done: int, failed: int = 0) -> Iterator[Callable[[bool], None]]:
    """A function to call after each run with whether it failed; some may be done already."""
    console, began, before = Console(stderr=True), time.monotonic(), done
    words = (TextColumn("{task.description}"), TextColumn("{task.fields[told]}"))
    columns = (words[0], BarColumn(), words[1], TimeRemainingColumn())
    with Progress(
        *columns, console=console, redirect_stdout=False, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(title, total=total, completed=done, told=f"{done} of {total}")

        def tell(fails: bool) -> None:
            nonlocal done, failed
            done, failed = done + 1, failed + fails
            rate = (done - before) / (time.monotonic() - began)
            told = f"{done} of {total}, {failed} failed, {rate:.3g}/s"
            progress.update(task, completed=done, told=told)

        yield tell
