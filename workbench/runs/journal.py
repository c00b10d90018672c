"""Outcomes of runs as they are done, in a journal of `cosim`: kept whatever happens, never mixed with others.

The numbers of a row are its wall time and those of the arrays of its answer; its text has the rest as JSON. Nothing of a file is executed, and a row is believed if all of it is what a run can say.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

import cosim.journal
from cosim import Result, SimulationError
from cosim.errors import pluralize

from .worker import OK, STATUSES, Outcome

NAME = "journal.runs"
Key = int
Outcomes = Generator[tuple[Key, Outcome]]


class RunFailedError(SimulationError):
    """A task that did not come to its end."""

    def __init__(self, message: str) -> None:
        super().__init__(message, Result([], {}, np.empty((0, 0)).__getitem__))


def _plain(value: Any, numbers: list[float]) -> Any:
    """A value for JSON, without its arrays of numbers, which go to `numbers`; raises TypeError for one of other types."""
    if isinstance(value, np.ndarray) and value.dtype == float:
        numbers.extend(value.ravel().tolist())
        return {"array": list(value.shape)}
    if type(value) in (list, tuple):
        items = [_plain(item, numbers) for item in value]
        return {"tuple": items} if isinstance(value, tuple) else items
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(type(value))


def _again(tree: Any, numbers: Iterator[float]) -> Any:
    """The value that `_plain` made a tree of."""
    if isinstance(tree, dict) and "array" in tree:
        values = list(islice(numbers, math.prod(tree["array"])))
        return np.array(values, float).reshape(tree["array"])
    if isinstance(tree, dict):
        return tuple(_again(item, numbers) for item in tree["tuple"])
    return [_again(item, numbers) for item in tree] if isinstance(tree, list) else tree


class OutcomeJournal:
    """Outcomes of runs by number, of this session and of those before, in the order in which they came."""

    def __init__(
        self, path: Path, file: cosim.journal.Journal, is_sound: Callable[[Any], bool]
    ) -> None:
        self.path, self._file, self._is_sound = path, file, is_sound
        self._rows: dict[Key, Outcome] = {}
        self._asked = 0
        for number, (values, text) in file.rows.items():
            try:
                self._rows[number] = self._outcome(values.tolist(), text)
            except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
                file.damaged.append(number)
        if file.damaged:
            rows = pluralize(len(file.damaged), "row")
            ends = "is damaged; it is" if len(file.damaged) == 1 else "are damaged; they are"
            print(f"{path}: {rows} {ends} done again", file=sys.stderr)

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, key: Key) -> bool:
        return key in self._rows

    def __getitem__(self, key: Key) -> Outcome:
        return self._rows[key]

    def __setitem__(self, key: Key, outcome: Outcome) -> None:
        status, answer, message, seconds, trace = outcome
        numbers = [seconds]
        try:
            tree = _plain(answer, numbers)
        except TypeError:
            return
        self._rows[key] = outcome
        text = json.dumps([status, message, trace, tree])
        self._file.add([key], np.array([numbers]), [text])

    def _outcome(self, values: list[float], text: str) -> Outcome:
        """The outcome that a row tells; raises ValueError, TypeError, LookupError or AttributeError for none."""
        status, message, trace, tree = json.loads(text)
        if status not in STATUSES or not isinstance(message, str) or not isinstance(trace, str):
            raise ValueError(text)
        numbers = iter(values[1:])
        answer = _again(tree, numbers) if status == OK else None
        if any(True for _ in numbers) or (status == OK and not self._is_sound(answer)):
            raise ValueError(text)
        return Outcome(status, answer, message, values[0], trace)

    def numbers(self, count: int) -> range:
        """The numbers of the next runs of a session whose runs come in the same sequence each time."""
        self._asked += count
        return range(self._asked - count, self._asked)

    def items(self) -> list[tuple[Key, Outcome]]:
        """Return the outcomes by number, in the order in which they came."""
        return list(self._rows.items())

    def interruption(self) -> KeyboardInterrupt:
        """An interruption that says what is kept."""
        rows = pluralize(len(self), "row")
        return KeyboardInterrupt(f"{rows} in {self.path}; the same command continues")

    def forget(self, keys: Iterable[Key]) -> None:
        """Let runs be done again; their rows count until then, if this session ends before."""
        for key in keys:
            del self._rows[key]


@contextmanager
def open_journal(
    folder: Path,
    identity: Mapping[str, Any],
    is_sound: Callable[[Any], bool] = lambda _: True,
    *,
    passing: bool = False,
) -> Iterator[OutcomeJournal]:
    """The journal in this folder of answers that are sound, begun or gone on with; it raises what `cosim.journal.open_journal` does.

    That of a sweep is `passing`: it drops rows of another identity, says on stderr what becomes of rows that are
    there, and goes when the sweep ends well. Rows that are damaged are done again, which is said on stderr.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME

    def dropped(reason: str) -> None:
        print(f"{reason}; they are dropped", file=sys.stderr)

    with cosim.journal.open_journal(
        path, identity, keep=not passing, drop=dropped if passing else None
    ) as file:
        journal = OutcomeJournal(path, file, is_sound)
        if passing and len(journal):
            print(f"{folder}: {pluralize(len(journal), 'row')} already there", file=sys.stderr)
        yield journal
