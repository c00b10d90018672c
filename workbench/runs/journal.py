"""Rows as they are done, in a file of SQLite: kept whatever happens, never mixed with others."""

from __future__ import annotations

import json
import pickle
import sqlite3
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from cosim import SetupError
from cosim.errors import counted

from .identity import differences
from .worker import Outcome

NAME = "journal.sqlite"
BETWEEN = 1.0
OPEN = """
PRAGMA locking_mode = EXCLUSIVE; PRAGMA journal_mode = WAL; PRAGMA synchronous = NORMAL;
BEGIN EXCLUSIVE;
CREATE TABLE IF NOT EXISTS identity (content TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS rows (key PRIMARY KEY NOT NULL, row NOT NULL);
COMMIT;
"""
Key = Any  # a number or a text


class Journal:
    """Outcomes of runs by key, of this session and of those before, in the order in which they came;
    `form`, json or pickle, writes them.

    A row reaches the operating system at once, so that no end of this process loses it, and the
    disk with the next row a second later.
    """

    def __init__(self, path: Path, base: sqlite3.Connection, form: Any) -> None:
        self.path, self._base, self._form = path, base, form
        self._rows: dict[Key, Any] = dict(base.execute("SELECT key, row FROM rows ORDER BY rowid"))
        self._synced = time.monotonic()

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, key: Key) -> bool:
        return key in self._rows

    def __getitem__(self, key: Key) -> Outcome:
        return Outcome(**self._form.loads(self._rows[key]))

    def __setitem__(self, key: Key, outcome: Outcome) -> None:
        self._rows[key] = self._form.dumps(outcome._asdict())
        self._base.execute("INSERT INTO rows VALUES (?, ?)", (key, self._rows[key]))
        if time.monotonic() > self._synced + BETWEEN:
            self._base.execute("PRAGMA wal_checkpoint")
            self._synced = time.monotonic()


@contextmanager
def opened(
    folder: Path, identity: Mapping[str, Any], *, passing: bool = False
) -> Iterator[Journal]:
    """The journal in this folder, begun or gone on with.

    That of a sweep is `passing`: it holds any Python objects, drops rows of another identity, says on
    stderr what becomes of rows that are there, and goes when the sweep ends well. Raises SetupError
    if another process is at work in the folder, if the file is damaged, and for another identity.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    try:
        with closing(sqlite3.connect(path, timeout=0.0, isolation_level=None)) as base:
            base.executescript(OPEN)
            _same(base, folder, json.loads(json.dumps(identity)), passing)
            journal = Journal(path, base, pickle if passing else json)
            if passing and len(journal):
                print(f"{folder}: {counted(len(journal), 'run')} already done", file=sys.stderr)
            yield journal
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorname", "") == "SQLITE_BUSY":
            raise SetupError(f"{folder}: another process is using this folder") from None
        raise SetupError(f"{path} cannot be read or written: {error}") from None
    if passing:
        path.unlink()


def _same(base: sqlite3.Connection, folder: Path, identity: dict[str, Any], drop: bool) -> None:
    """Refuse to mix rows, or drop those that are there."""
    found = base.execute("SELECT content FROM identity").fetchone()
    try:
        before = json.loads(found[0]) if found else identity
    except ValueError:
        text = f"{folder / NAME} is damaged: it does not say to which runs its rows belong"
        raise SetupError(text) from None
    if before != identity:
        other = f"{folder} contains the rows of other runs: {differences(before, identity)}"
        if not drop:
            raise SetupError(f"{other}; choose another folder with --out, or remove this one")
        if base.execute("SELECT 1 FROM rows LIMIT 1").fetchone():
            print(f"{other}; they are dropped", file=sys.stderr)
    if not found or before != identity:
        base.executescript("BEGIN; DELETE FROM identity; DELETE FROM rows;")
        base.execute("INSERT INTO identity VALUES (?)", (json.dumps(identity),))
        base.execute("COMMIT")
