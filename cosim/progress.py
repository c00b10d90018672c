"""A progress bar of simulated time on a terminal; nothing anywhere else."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

#: Least time between two changes of the bar [s]: a convention of this project, which limits the time that it takes.
REFRESH_INTERVAL = 0.1


class Pace(ProgressColumn):
    """Simulated time, and how many times faster it passes than real time."""

    def render(self, task: Task) -> Text:
        """Of a task whose progress is simulated time in s."""
        pace = task.completed / task.elapsed if task.elapsed else 0.0
        return Text(f"{task.completed:.4g} of {task.total:.4g} s, {pace:.3g} x real time")


@contextmanager
def bar(title: str, start: float, stop: float) -> Iterator[Callable[[float], None]]:
    """A function to call with the share of a run from `start` to `stop` [s] that is done."""
    with _bar(title, Pace(), stop - start) as show:
        yield show


@contextmanager
def bar_of_runs(title: str, runs: int) -> Iterator[Callable[..., None]]:
    """A function to call with the share of so many runs that is done, and with how many have failed."""
    with _bar(title, MofNCompleteColumn(), runs) as show:
        yield show


@contextmanager
def _bar(title: str, column: ProgressColumn, total: float) -> Iterator[Callable[..., None]]:
    """A function to call with the share of the total that is done, which a column shows."""
    columns = (TextColumn("{task.description}"), BarColumn(), column, TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, redirect_stdout=False, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(title, total=total)
        last_update = 0.0

        def show(fraction: float, failed: int = 0) -> None:
            nonlocal last_update
            now = time.monotonic()
            if now - last_update > REFRESH_INTERVAL or fraction >= 1.0:
                last_update = now
                words = f"{title}, {failed} failed" if failed else title
                progress.update(task, completed=type(total)(fraction * total), description=words)

        yield show
