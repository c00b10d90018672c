"""Outcomes of runs as they are done, in a journal of `cosim`: kept whatever happens, never mixed with others.

The numbers of a row are its wall time and its answer's, which the question's side takes apart and puts together; its
text has the rest as JSON. Nothing of a file is executed, and a row is believed if all of it is what a run can say.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import cosim.journal
from cosim.errors import pluralize

from .worker import OK, STATUSES, Outcome

NAME = "journal.runs"
Key = int


class Form(NamedTuple):
    """How an answer is kept: `apart` gives its numbers and the rest for JSON, `together` the answer from these.

    Both raise ValueError, TypeError, KeyError or AttributeError for what they do not know.
    """

    apart: Callable[[Any], tuple[list[float], Any]]
    together: Callable[[list[float], Any], Any]


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


def _apart(answer: Any) -> tuple[list[float], Any]:
    numbers: list[float] = []
    tree = _plain(answer, numbers)
    return numbers, tree


#: Answers of numbers, texts, arrays of numbers, lists and tuples; others are not kept.
PLAIN = Form(_apart, lambda numbers, tree: _again(tree, iter(numbers)))


class OutcomeJournal:
    """Outcomes of runs by number, of this session and of those before, in the order in which they came."""

    def __init__(self, path: Path, file: cosim.journal.Journal, form: Form) -> None:
        self.path, self._file, self._form = path, file, form
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
        try:
            numbers, rest = self._form.apart(answer) if status == OK else ([], None)
        except (ValueError, TypeError, LookupError, AttributeError):
            return
        self._rows[key] = outcome
        values = np.array([[seconds, *numbers]])
        self._file.add([key], values, [json.dumps([status, message, trace, rest])])

    def _outcome(self, values: list[float], text: str) -> Outcome:
        """The outcome that a row tells; raises what `Form` says for one that it cannot be."""
        status, message, trace, rest = json.loads(text)
        if status not in STATUSES or not isinstance(message, str) or not isinstance(trace, str):
            raise ValueError(text)
        answer = self._form.together(values[1:], rest) if status == OK else None
        return Outcome(status, answer, message, values[0], trace)

    def numbers(self, count: int) -> range:
        """The numbers of the next runs of a session whose runs come in the same sequence each time."""
        self._asked += count
        return range(self._asked - count, self._asked)

    def items(self) -> list[tuple[Key, Outcome]]:
        """Return the outcomes by number, in the order in which they came."""
        return list(self._rows.items())

    def interrupt(self) -> KeyboardInterrupt:
        """An interruption that says what is kept."""
        rows = pluralize(len(self), "row")
        return KeyboardInterrupt(f"{rows} in {self.path}; the same command continues")

    def forget(self, keys: Iterable[Key]) -> None:
        """Let runs be done again; their rows count until then, if this session ends before."""
        for key in keys:
            del self._rows[key]


@contextmanager
def open_journal(
    folder: Path, identity: Mapping[str, Any], form: Form = PLAIN, *, passing: bool = False
) -> Iterator[OutcomeJournal]:
    """The journal in this folder, begun or gone on with; it raises what `cosim.journal.open_journal` does.

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
        journal = OutcomeJournal(path, file, form)
        if passing and len(journal):
            print(f"{folder}: {pluralize(len(journal), 'row')} already there", file=sys.stderr)
        yield journal


def figures_apart(row: Any) -> tuple[list[float], Any]:
    """The figures of a row as numbers: value and error of each, nan without an error; and the rest of it."""
    figures = row["figures"]
    numbers = [x for value, _, error, _ in figures.values()
               for x in (value, math.nan if error is None else error)]  # fmt: skip
    texts = [[name, unit, reason] for name, (_, unit, _, reason) in figures.items()]
    return numbers, [texts, row["warnings"]]


def figures_together(numbers: list[float], rest: Any) -> dict[str, Any]:
    """The row that `figures_apart` took apart."""
    texts, warnings = rest
    words = [word for words in (*texts, warnings) for word in words]
    if not all(isinstance(word, str) for word in words) or len(numbers) != 2 * len(texts):
        raise ValueError(rest)
    figures = {
        name: (value, unit, None if math.isnan(error) else error, reason)
        for (name, unit, reason), value, error in zip(texts, numbers[::2], numbers[1::2])
    }
    return {"figures": figures, "warnings": warnings}


#: The rows of a study, what `workbench.run.row` returns.
FIGURES = Form(figures_apart, figures_together)
