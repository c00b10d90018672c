"""Rows as they are done, in a file of SQLite: kept whatever happens, never mixed with others.

The file may come from anywhere: reading it executes nothing, and a row is believed if its checksum is
that of its key and text.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from cosim import SetupError
from cosim.errors import pluralize

from ..figure import listed
from . import codec
from .codec import Records
from .fingerprint import differences
from .worker import STATUSES, Outcome

NAME = "journal.sqlite"
#: Time between two writes of rows to the disk [s]; chosen: a loss of power costs no more than that.
SYNC_INTERVAL = 1.0
#: Damaged rows that a message names before it only counts them; a convention of this project.
NAMED = 8
OPEN = """
PRAGMA trusted_schema = OFF;
PRAGMA locking_mode = EXCLUSIVE; PRAGMA journal_mode = WAL; PRAGMA synchronous = NORMAL;
BEGIN EXCLUSIVE;
"""
TABLES = {
    "identity": "CREATE TABLE identity (content TEXT NOT NULL)",
    "rows": "CREATE TABLE rows (key PRIMARY KEY NOT NULL, row TEXT NOT NULL, checksum TEXT NOT NULL)",
}
Key = Any  # a number or a text


class Journal:
    """Outcomes of runs by key, of this session and of those before, in the order in which they came.

    A row reaches the operating system at once, so that no end of this process loses it, and the
    disk with the next row a second later. An answer of a type that `codec` does not write is not kept,
    which is said once on stderr.
    """

    def __init__(self, path: Path, base: sqlite3.Connection, records: Records) -> None:
        self.path, self._base, self._records = path, base, records
        self._rows: dict[Key, Outcome] = {}
        self._synced = time.monotonic()
        self._complained = False

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, key: Key) -> bool:
        return key in self._rows

    def __getitem__(self, key: Key) -> Outcome:
        return self._rows[key]

    def __setitem__(self, key: Key, outcome: Outcome) -> None:
        try:
            row = codec.dumps(outcome._asdict(), self._records)
        except TypeError as error:
            if not self._complained:
                print(
                    f"{self.path}: {error} cannot be kept, so these runs are done again after an "
                    "interruption; return numbers, texts, arrays, tuples and dataclasses",
                    file=sys.stderr,
                )
            self._complained = True
            return
        self._rows[key] = outcome
        self._base.execute("INSERT INTO rows VALUES (?, ?, ?)", (key, row, checksum(key, row)))
        if time.monotonic() > self._synced + SYNC_INTERVAL:
            self._base.execute("PRAGMA wal_checkpoint")
            self._synced = time.monotonic()

    def items(self) -> list[tuple[Key, Outcome]]:
        """Return the outcomes by key, in the order in which they came."""
        return list(self._rows.items())

    def interrupt(self) -> KeyboardInterrupt:
        """An interruption that says what is kept."""
        runs = pluralize(len(self), "run")
        return KeyboardInterrupt(f"{runs} in {self.path}; the same command continues")

    def forget(self, keys: Iterable[Key]) -> None:
        """Remove outcomes, whose runs are then done again."""
        for key in keys:
            del self._rows[key]
            self._base.execute("DELETE FROM rows WHERE key = ?", (key,))

    def read(self, sound: Callable[[Outcome], bool]) -> None:
        """Take the rows of sessions before; those that are damaged or not `sound` are removed and named."""
        damaged = []
        lines = self._base.execute("SELECT rowid, key, row, checksum FROM rows ORDER BY rowid")
        for number, key, row, written_checksum in lines.fetchall():
            outcome = self._outcome(row) if written_checksum == checksum(key, row) else None
            if outcome is None or not sound(outcome):
                damaged.append(key)
                self._base.execute("DELETE FROM rows WHERE rowid = ?", (number,))
            else:
                self._rows[key] = outcome
        if damaged:
            print(f"{self.path}: {_damage(damaged)} again", file=sys.stderr)

    def _outcome(self, row: Any) -> Outcome | None:
        """The outcome that a row tells; None if it tells none."""
        try:
            outcome = Outcome(**codec.loads(row, self._records))
        except (TypeError, ValueError):
            return None
        texts = outcome.status, outcome.message, outcome.trace
        sound = all(isinstance(text, str) for text in texts) and isinstance(
            outcome.seconds, float | int
        )
        return outcome if sound and outcome.status in STATUSES else None


def checksum(key: Key, row: Any) -> str:
    """What a row of this key and text has beside it."""
    return hashlib.sha256(f"{key!r}\n{row}".encode("utf-8", "surrogatepass")).hexdigest()


def _damage(keys: list[Key]) -> str:
    """Which rows are damaged, "the rows of runs 3 and 5 are damaged; they are done"."""
    single = len(keys) == 1
    rows = pluralize(len(keys), "row")
    if all(isinstance(key, int) for key in keys):
        more = [f"{len(keys) - NAMED} more"] * (len(keys) > NAMED)
        names = listed([*map(str, keys[:NAMED]), *more])
        rows = f"the row of run {names}" if single else f"the rows of runs {names}"
    return f"{rows} {'is damaged; it is done' if single else 'are damaged; they are done'}"


def _any(_outcome: Outcome) -> bool:
    return True


@contextmanager
def open_journal(
    folder: Path,
    identity: Mapping[str, Any],
    *,
    passing: bool = False,
    records: Records = codec.NONE,
    sound: Callable[[Outcome], bool] = _any,
) -> Iterator[Journal]:
    """The journal in this folder, begun or gone on with.

    That of a sweep is `passing`: it drops rows of another identity, says on stderr what becomes of rows
    that are there, and goes when the sweep ends well. `records` are the classes that answers may be
    made of. Rows that are damaged, or whose outcome is not `sound`, are done again, which is said on
    stderr.

    Raises
    ------
    SetupError
        If another process is at work in the folder, if the file is damaged or has the form of an earlier
        version, and for another identity.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    try:
        with closing(sqlite3.connect(path, timeout=0.0, isolation_level=None)) as base:
            base.executescript(OPEN)
            _tables(base, path)
            _same(base, folder, json.loads(json.dumps(identity)), drop=passing)
            journal = Journal(path, base, records)
            journal.read(sound)
            if passing and len(journal):
                print(f"{folder}: {pluralize(len(journal), 'run')} already done", file=sys.stderr)
            yield journal
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorname", "") == "SQLITE_BUSY":
            raise SetupError(f"{folder}: another process is using this folder") from None
        raise SetupError(f"{path} cannot be read or written: {error}") from None
    if passing:
        path.unlink(missing_ok=True)


def _tables(base: sqlite3.Connection, path: Path) -> None:
    """Make the tables of a new file, or refuse a file that has others; the transaction ends."""
    tables = dict(base.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"))
    if not tables:
        for command in TABLES.values():
            base.execute(command)
    elif tables != TABLES:
        if set(tables) == set(TABLES) and "checksum" not in tables["rows"]:
            raise SetupError(
                f"{path} is a journal of an earlier version, whose rows may contain code; they are not "
                "read. Remove the file, or choose another folder with --out"
            )
        raise SetupError(f"{path} is damaged: it does not have the tables of a journal")
    base.execute("COMMIT")


def _same(base: sqlite3.Connection, folder: Path, identity: dict[str, Any], *, drop: bool) -> None:
    """Refuse to mix rows, or drop those that are there."""
    row = base.execute("SELECT content FROM identity").fetchone()
    try:
        before = json.loads(row[0]) if row else identity
        if not isinstance(before, dict):
            raise TypeError
    except (ValueError, TypeError, RecursionError):
        text = f"{folder / NAME} is damaged: it does not say to which runs its rows belong"
        raise SetupError(text) from None
    if before != identity:
        other = f"{folder} contains the rows of other runs: {differences(before, identity)}"
        if not drop:
            raise SetupError(f"{other}; choose another folder with --out, or remove this one")
        if base.execute("SELECT 1 FROM rows LIMIT 1").fetchone():
            print(f"{other}; they are dropped", file=sys.stderr)
    if not row or before != identity:
        base.executescript("BEGIN; DELETE FROM identity; DELETE FROM rows;")
        base.execute("INSERT INTO identity VALUES (?)", (json.dumps(identity),))
        base.execute("COMMIT")
