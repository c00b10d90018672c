"""A progress bar of runs on a terminal: done, failed, time left; nothing anywhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def bar(title: str, total: int, done: int = 0, failed: int = 0) -> Iterator[Callable[[bool], None]]:
    """A function to call after each run with whether it failed; some may be done already."""
    console = Console(stderr=True)
    failures = TextColumn("{task.fields[failed]} failed")
    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), failures)
    with Progress(
        *columns,
        TimeRemainingColumn(),
        console=console,
        redirect_stdout=False,
        disable=not console.is_terminal,
    ) as progress:
        task = progress.add_task(title, total=total, completed=done, failed=failed)

        def step(fails: bool) -> None:
            nonlocal failed
            failed += fails
            progress.update(task, advance=1, failed=failed)

        yield step
