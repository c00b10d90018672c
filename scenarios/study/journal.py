"""The rows of a study as they are done: one JSON line each, kept whatever happens."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from cosim import SetupError

from .identity import differences

NAME = "journal.jsonl"
BETWEEN = 1.0


class Journal:
    """Appends finished runs; `done` has those of this session and of sessions before, by number.

    A line reaches the operating system at once, so that no end of this process loses it, and the
    disk within a second.
    """

    def __init__(self, file: IO[bytes], done: dict[int, dict[str, Any]]) -> None:
        self.done = done
        self._file = file
        self._synced = time.monotonic()

    def add(self, run: int, row: Mapping[str, Any]) -> None:
        """Keep the row of a run."""
        self.done[run] = dict(row)
        self._file.write(_line({"run": run, **row}))
        self._file.flush()
        if time.monotonic() > self._synced + BETWEEN:
            self.sync()

    def sync(self) -> None:
        """Bring all lines to the disk."""
        os.fsync(self._file.fileno())
        self._synced = time.monotonic()


@contextmanager
def opened(folder: Path, identity: Mapping[str, Any]) -> Iterator[Journal]:
    """The journal of a study in this folder, begun or gone on with.

    Raises SetupError if the folder holds another study, or one that is at work, or a journal that
    is damaged other than by a last line cut short, which is dropped.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    with path.open("a+b") as file:
        _lock(file, path)
        file.seek(0)
        whole = _whole_lines(file)
        told = json.loads(json.dumps(identity))
        if not whole:
            file.write(_line({"study": told}))
            file.flush()
        else:
            _same(path, whole[0], told)
        journal = Journal(file, _rows(path, whole))
        try:
            yield journal
        finally:
            journal.sync()


def _line(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content).encode() + b"\n"


def _whole_lines(file: IO[bytes]) -> list[bytes]:
    """The lines of a file; what follows the last line end is cut off."""
    lines = file.read().split(b"\n")
    if lines.pop():
        file.truncate(sum(len(line) + 1 for line in lines))
    return lines


def _same(path: Path, first: bytes, identity: Mapping[str, Any]) -> None:
    """Refuse to mix the rows of two studies."""
    try:
        before = json.loads(first)["study"]
    except (ValueError, KeyError, TypeError):
        raise SetupError(f"{path}: line 1 does not tell the study; it is no journal") from None
    if before != identity:
        raise SetupError(
            f"{path.parent} holds the rows of another study: {differences(before, identity)}; "
            "choose another folder with --out, or remove this one"
        )


def _rows(path: Path, lines: list[bytes]) -> dict[int, dict[str, Any]]:
    done: dict[int, dict[str, Any]] = {}
    for number, line in enumerate(lines[1:], start=2):
        try:
            row = json.loads(line)
            run = row.pop("run")
        except (ValueError, KeyError, AttributeError):
            raise SetupError(f"{path}: line {number} is damaged, no row can be read") from None
        if run in done:
            raise SetupError(f"{path}: line {number} tells run {run} a second time")
        done[run] = row
    return done


def _lock(file: IO[bytes], path: Path) -> None:
    """Hold the file until it is closed or this process ends; refuse if another one holds it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(0)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        raise SetupError(f"{path.parent}: another process is at work on this study") from None
