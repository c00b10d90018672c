"""Files that are written as they are computed, or replaced when they are complete."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from math import isnan
from pathlib import Path
from shutil import rmtree
from typing import TextIO

from cosim.result import partial

from .runs.folder import reservation

#: Where files are until they are complete.
UNFINISHED = ".unfinished"

Rows = Callable[[Iterable[Sequence[float]]], None]


def new_file(path: Path) -> TextIO:
    """Open a text file that nobody else has open, in place of an old one; a link is not followed."""
    path.unlink(missing_ok=True)
    return path.open("x", newline="", encoding="utf-8")


@contextmanager
def replacement(path: Path) -> Iterator[Path]:
    """Give a path for a file that takes the place of another when it is complete; a link is not followed.

    The new file has the same name, in the folder UNFINISHED beside it. What a killed run left there is removed:
    nobody else may write to the folder of `path` meanwhile.
    """
    folder = path.parent / UNFINISHED
    remove(folder)
    folder.mkdir(parents=True)
    try:
        yield folder / path.name
        (folder / path.name).replace(path)
    finally:
        remove(folder)


def remove(path: Path) -> None:
    """Remove a folder with all that is in it, a file or a link, but not what the link leads to."""
    if path.is_dir() and not path.is_symlink():
        rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def stream(path: Path | None, columns: Sequence[str]) -> Iterator[Rows]:
    """Give a function that appends rows to NAME.partial.csv, nan as nothing; without a path it writes none.

    Raises
    ------
    SetupError
        If another run uses the folder.
    """
    if path is None:
        yield lambda _: None
        return
    with reservation(path.parent), new_file(partial(path)) as file:
        writer = csv.writer(file)
        writer.writerow(columns)

        def append(rows: Iterable[Sequence[float]]) -> None:
            writer.writerows(
                ["" if isinstance(x, float) and isnan(x) else x for x in row] for row in rows
            )
            file.flush()

        yield append
