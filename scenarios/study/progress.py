"""A progress bar of runs on a terminal: done, failed, rate, time left; nothing anywhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, Task, TextColumn, TimeRemainingColumn
from rich.text import Text


class Count(TextColumn):
    """Runs that are done and that failed, and runs per second of this session."""

    def __init__(self, before: int) -> None:
        super().__init__("")
        self._before = before

    def render(self, task: Task) -> Text:
        """Of a task whose progress is runs."""
        rate = (task.completed - self._before) / task.elapsed if task.elapsed else 0.0
        failed = task.fields["failed"]
        text = f"{task.completed:.0f} of {task.total:.0f}, {failed} failed, {rate:.3g}/s"
        return Text(text, style="red" if failed else "")


@contextmanager
def bar(title: str, total: int, done: int, failed: int) -> Iterator[Callable[[bool], None]]:
    """A function to call after each run with whether it failed; some may be done already."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), Count(done), TimeRemainingColumn())
    with Progress(
        *columns, console=console, redirect_stdout=False, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(title, total=total, completed=done, failed=failed)

        def tell(fails: bool) -> None:
            nonlocal failed
            failed += fails
            progress.update(task, advance=1, failed=failed)

        yield tell
