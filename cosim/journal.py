"""What is done of a sweep, in a file of numbers: figures and one text of each run, which any kill leaves readable.

The file begins with a line of JSON, which says to which sweep it belongs. A record has the number of the run, its
figures, the length of its text, the text, and a checksum of all that. Reading a file executes nothing of it; what
follows a damaged record is dropped and done again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .engine.recorder import lock_file
from .errors import SetupError
from .result import open_unlinked

Array = NDArray[np.float64]
#: Bytes of the checksum of a record. Chosen: of 2^64 damaged ones, one is taken for sound.
CHECK_BYTES = 8
#: What a file begins with, its form.
FORM = "cosim sweep 1"


class Journal:
    """The runs that are done, by number: figures, shape (figures,), and a text."""

    def __init__(self, file: Any, figures: int) -> None:
        self._file, self._figures = file, figures
        self.rows: dict[int, tuple[Array, str]] = {}

    def add(self, numbers: Sequence[int], figures: Array, texts: Sequence[str]) -> None:
        """Keep runs: figures has the shape (runs, figures)."""
        content = b""
        for number, row, text in zip(numbers, figures, texts):
            self.rows[number] = row, text
            content += _record(number, row, text)
        while content:
            content = content[self._file.write(content) :]

    def read(self, content: bytes) -> int:
        """Take the records of a file; how many of its bytes are sound."""
        head, begin = 8 * (2 + self._figures), 0
        while begin + head <= len(content):
            number, length = np.frombuffer(content, "<i8", 2, begin).tolist()
            row = np.frombuffer(content, "<f8", self._figures, begin + 16)
            end = begin + head + length
            if length < 0 or end + CHECK_BYTES > len(content):
                break
            text = content[begin + head : end].decode("utf-8", "replace")
            if _record(number, row, text) != content[begin : end + CHECK_BYTES]:
                break
            self.rows[number] = row.copy(), text
            begin = end + CHECK_BYTES
        return begin


def _record(number: int, figures: Array, text: str) -> bytes:
    """The bytes of a run, with their checksum."""
    encoded = text.encode("utf-8", "replace")
    head = np.array([number, len(encoded)], "<i8").tobytes()
    content = head + np.asarray(figures, "<f8").tobytes() + encoded
    return content + hashlib.sha256(content).digest()[:CHECK_BYTES]


@contextmanager
def open_journal(path: Path | None, identity: Mapping[str, Any], figures: int) -> Iterator[Journal]:
    """The journal at a path, begun or gone on with; without one, what is done is only in memory.

    It goes when the context ends well.

    Raises
    ------
    SetupError
        If another process writes it, if it cannot be written, and if it belongs to another sweep.
    """
    if path is None:
        yield Journal(_Nowhere(), figures)
        return
    first = (json.dumps({"form": FORM, **identity}, sort_keys=True) + "\n").encode()
    try:
        with open_unlinked(path, "a+b") as file:
            if not lock_file(file.fileno()):
                raise SetupError(f"another sweep is writing {path}")
            file.seek(0)
            content = file.readall()
            journal = Journal(file, figures)
            if content and not content.startswith(first):
                raise SetupError(_other(path, content, identity))
            if content:
                file.truncate(len(first) + journal.read(content[len(first) :]))
            else:
                file.write(first)
            yield journal
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error.strerror or error}") from error
    path.unlink(missing_ok=True)


class _Nowhere:
    """A file that keeps nothing."""

    def write(self, content: bytes) -> int:
        return len(content)


def _other(path: Path, content: bytes, identity: Mapping[str, Any]) -> str:
    """Why a journal is not gone on with: what of it is another."""
    remedy = f"remove {path}, or choose another file with --out"
    before: Any = None
    with suppress(ValueError):
        before = json.loads(content.partition(b"\n")[0])
    if not isinstance(before, dict) or before.get("form") != FORM:
        return f"{path} is no journal of a sweep: {remedy}"
    changed = [k for k in identity if before.get(k) != json.loads(json.dumps(identity[k]))]
    return f"{path} belongs to another sweep, whose {', '.join(changed) or 'form'} differ: {remedy}"


def digest(path: Path) -> str:
    """A checksum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
