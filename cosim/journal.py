"""What is done of many runs, in a file: figures and one text of each run, or outcomes of calls, which any kill leaves readable.

The file begins with a line of JSON, which says to which runs it belongs. A record has the number of the run, how many
figures and how many bytes of text follow, these, and a checksum of all that. Reading a file executes nothing of it; a
run whose record is damaged is done again.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from filelock import lock_descriptor
from numpy.typing import NDArray

from .calls import OK, STATUSES, Outcome
from .errors import SetupError, pluralize
from .result import Result, SimulationError, open_unlinked

Array = NDArray[np.float64]
#: Bytes of the checksum of a record. Chosen: of 2^64 damaged ones, one is taken for sound.
CHECK_BYTES = 8
#: Bytes before the figures of a record. Derived: its number and two lengths.
HEAD_BYTES = 24
#: Time between two writes to the disk [s]; chosen: a loss of power costs no more than that.
SYNC_INTERVAL = 1.0
#: What a file begins with, its form.
FORM = "runs 1"
#: Differences that a message lists; chosen: they fit a line.
MAX_DIFFERENCES = 4
#: Longest value that a message shows; chosen: several fit a line.
MAX_SHOWN = 40
#: Whether a run has this number, and may have these figures and this text.
IsSound = Callable[[int, Array, str], bool]
DIGEST = re.compile(r"\{?[0-9a-f-]{16,}\}?")
#: The journal of outcomes in a folder.
OUTCOMES = "journal.runs"


class Journal:
    """The runs that are done, by number: figures, shape (figures,), and a text; and which were damaged."""

    def __init__(self, path: Path | None = None, file: Any = None) -> None:
        self._path, self._file, self._synced = path, file, time.monotonic()
        self.rows: dict[int, tuple[Array, str]] = {}
        self.damaged: list[int] = []

    def add(self, numbers: Sequence[int], figures: Array, texts: Sequence[str]) -> None:
        """Keep runs: figures has the shape (runs, figures). Raises SetupError for a file that cannot be written."""
        content = b""
        for number, row, text in zip(numbers, figures, texts):
            self.rows[number] = row, text
            content += record(number, row, text)
        self.write(content)

    def write(self, content: bytes) -> None:
        """Append to the file; it reaches the operating system at once, and the disk a second later."""
        try:
            while content and self._file is not None:
                content = content[self._file.write(content) :]
            if self._file is not None and time.monotonic() > self._synced + SYNC_INTERVAL:
                os.fsync(self._file.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            raise SetupError(
                f"{self._path} cannot be written: {error.strerror or error}"
            ) from error

    def close(self) -> None:
        """Keep what is added from now on in memory alone."""
        self._file = None

    def read(self, content: bytes, is_sound: IsSound = lambda *_: True) -> int:
        """Take the records of a file that are sound; how many of its bytes are up to the end of the last one."""
        begin, sound = 0, 0
        while begin + HEAD_BYTES <= len(content):
            number, figures, length = np.frombuffer(content, "<i8", 3, begin).tolist()
            end = begin + HEAD_BYTES + 8 * figures + length + CHECK_BYTES
            if min(figures, length) < 0 or end > len(content):
                break
            row = np.frombuffer(content, "<f8", figures, begin + HEAD_BYTES).copy()
            text = content[end - CHECK_BYTES - length : end - CHECK_BYTES].decode(
                "utf-8", "replace"
            )
            if record(number, row, text) == content[begin:end] and is_sound(number, row, text):
                self.rows[number] = row, text
                sound = end
            else:
                self.damaged.append(number)
            begin = end
        self.damaged = [number for number in self.damaged if number not in self.rows]
        return sound


def record(number: int, figures: Array, text: str) -> bytes:
    """The bytes of a run, with their checksum."""
    encoded = text.encode("utf-8", "replace")
    head = np.array([number, len(figures), len(encoded)], "<i8").tobytes()
    content = head + np.asarray(figures, "<f8").tobytes() + encoded
    return content + hashlib.sha256(content).digest()[:CHECK_BYTES]


@contextmanager
def open_journal(
    path: Path | None,
    identity: Mapping[str, Any],
    is_sound: IsSound = lambda *_: True,
    *,
    keep: bool = False,
    drop: Callable[[str], object] | None = None,
) -> Iterator[Journal]:
    """The journal at a path, begun or gone on with; without a path, what is done is only in memory.

    Parameters
    ----------
    path : Path or None
        The file. It goes when the context ends well, unless it is to `keep`.
    identity : mapping
        On what its rows depend.
    is_sound : callable
        Whether a row may be one of these runs; others count as damaged.
    keep : bool
        Whether the file stays.
    drop : callable, optional
        What is told if the rows of other runs are dropped; without it they are refused.

    Raises
    ------
    SetupError
        If another process writes it, if it cannot be written, and if it belongs to other runs.
    """
    if path is None:
        yield Journal()
        return
    now = json.loads(json.dumps({"form": FORM, **identity}))
    first = (json.dumps(now) + "\n").encode()
    with _opened(path) as file:
        if not lock_descriptor(file.fileno(), blocking=False):
            raise SetupError(f"another process is writing {path}")
        content, journal = file.readall(), Journal(path, file)
        head, newline, records = content.partition(b"\n")
        before = _identity(head)
        if newline and before == now:
            file.truncate(len(head) + 1 + journal.read(records, is_sound))
        else:
            if not first.startswith(content):  # else it was killed when it began
                other = f"{path} is no journal of runs"
                if before:
                    other = f"{path} contains the rows of other runs: {differences(before, now)}"
                if drop is None or not before:
                    raise SetupError(f"{other}; remove it, or choose another place with --out")
                if records:
                    drop(other)
            file.truncate(0)
            journal.write(first)
        try:
            yield journal
        finally:
            journal.close()
    if not keep:
        path.unlink(missing_ok=True)


def _opened(path: Path) -> Any:
    """The file of a journal, at its begin; raises SetupError for what can neither be written nor read again."""
    try:
        file = open_unlinked(path, "a+b")
        file.seek(0)
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error.strerror or error}") from error
    return file


def _identity(head: bytes) -> dict[str, Any]:
    """To which runs a file belongs that begins so; nothing if it is no journal."""
    try:
        content = json.loads(head)
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) and content.get("form") == FORM else {}


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What is not the same, key by key, in one line; of hashes and long texts only that they are not."""
    changes = list(_differences(before, now, ()))
    more = f" and {len(changes) - MAX_DIFFERENCES} more" if len(changes) > MAX_DIFFERENCES else ""
    return "; ".join(changes[:MAX_DIFFERENCES]) + more


def _differences(before: Any, now: Any, keys: Sequence[str]) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys([*before, *now]):
            yield from _differences(before.get(key), now.get(key), [*keys, key])
    elif before != now:
        name = ".".join(f'"{key}"' if "." in key else key for key in keys)
        if all(map(_is_digest, (before, now))) or len(f"{before!r}{now!r}") > 2 * MAX_SHOWN:
            yield f"{name} has changed"
        else:
            yield f"{name} was {_text(before)} and is {_text(now)}"


def _is_digest(value: object) -> bool:
    return isinstance(value, str) and DIGEST.fullmatch(value) is not None


def _text(value: object) -> str:
    if value is None:
        return "not there"
    return "there" if _is_digest(value) else repr(value)


def digest(content: bytes) -> str:
    """A checksum of a content."""
    return hashlib.sha256(content).hexdigest()


@cache
def code(*packages: str) -> dict[str, str]:
    """A checksum of each source file of these packages."""
    return {
        f"{package}/{path.relative_to(folder).as_posix()}": digest(path.read_bytes())
        for package in packages
        if (spec := find_spec(package))
        for folder in map(Path, spec.submodule_search_locations or ())
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".py", ".c")
    }


class RunFailedError(SimulationError):
    """A task that did not come to its end."""

    def __init__(self, message: str) -> None:
        super().__init__(message, Result([], {}, np.empty((0, 0)).__getitem__))


class OutcomeJournal(dict[int, Outcome]):
    """Outcomes of calls by number, of this session and of those before, in the order in which they came.

    An outcome whose answer has other types than lists, tuples, arrays of numbers, and what JSON knows is not kept.
    """

    def __init__(self, path: Path, file: Journal, is_sound: Callable[[Any], bool]) -> None:
        super().__init__()
        self.path, self._file, self._asked = path, file, 0
        for number, (_, text) in file.rows.items():
            try:
                super().__setitem__(number, _outcome(text, is_sound))
            except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
                file.damaged.append(number)
        if file.damaged:
            rows = pluralize(len(file.damaged), "row")
            ends = "is damaged; it is" if len(file.damaged) == 1 else "are damaged; they are"
            print(f"{path}: {rows} {ends} done again", file=sys.stderr)

    def __setitem__(self, number: int, outcome: Outcome) -> None:
        try:
            text = json.dumps(_tree(tuple(outcome)))
        except TypeError:
            return
        super().__setitem__(number, outcome)
        self._file.add([number], np.empty((1, 0)), [text])

    def numbers(self, count: int) -> range:
        """The numbers of the next runs of a session whose runs come in the same sequence each time."""
        self._asked += count
        return range(self._asked - count, self._asked)

    def interruption(self) -> KeyboardInterrupt:
        """An interruption that says what is kept."""
        rows = pluralize(len(self), "row")
        return KeyboardInterrupt(f"{rows} in {self.path}; the same command continues")


def _tree(value: Any) -> Any:
    """A value for JSON; raises TypeError for one of other types."""
    if isinstance(value, np.ndarray) and value.dtype == float:
        return {"array": value.ravel().tolist(), "shape": value.shape}
    if type(value) in (list, tuple):
        items = [_tree(item) for item in value]
        return {"tuple": items} if isinstance(value, tuple) else items
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(type(value))


def _value(tree: dict[str, Any]) -> Any:
    """The array or the tuple that `_tree` made this of."""
    if "tuple" in tree:
        return tuple(tree["tuple"])
    return np.array(tree["array"], float).reshape(tree["shape"])


def _outcome(text: str, is_sound: Callable[[Any], bool]) -> Outcome:
    """The outcome that a row tells; raises ValueError, TypeError, LookupError or AttributeError for none."""
    outcome = Outcome._make(json.loads(text, object_hook=_value))
    texts = outcome.message, outcome.trace
    if outcome.status not in STATUSES or not all(isinstance(x, str) for x in texts):
        raise ValueError(text)
    if math.isnan(outcome.seconds) or (outcome.status == OK and not is_sound(outcome.answer)):
        raise ValueError(text)
    return outcome


@contextmanager
def open_outcomes(
    folder: Path,
    identity: Mapping[str, Any],
    is_sound: Callable[[Any], bool] = lambda _: True,
    *,
    passing: bool = False,
) -> Iterator[OutcomeJournal]:
    """The journal in this folder of answers that are sound, begun or gone on with; it raises what `open_journal` does.

    That of a sweep is `passing`: it drops rows of another identity, says on stderr what becomes of rows that are
    there, and goes when the sweep ends well. Rows that are damaged are done again, which is said on stderr.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / OUTCOMES

    def dropped(reason: str) -> None:
        print(f"{reason}; they are dropped", file=sys.stderr)

    with open_journal(path, identity, keep=not passing, drop=dropped if passing else None) as file:
        journal = OutcomeJournal(path, file, is_sound)
        if passing and journal:
            print(f"{folder}: {pluralize(len(journal), 'row')} already there", file=sys.stderr)
        yield journal
