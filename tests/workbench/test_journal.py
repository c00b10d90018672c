"""The journal of many runs: what it holds is the same to the last bit, runs nothing, and is checked."""

from __future__ import annotations

import pickle
import shutil
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import SetupError
from tests.conftest import ROOT
from workbench import study
from workbench.catalog import load_module
from workbench.question import read
from workbench.run import answer
from workbench.runs import journal
from workbench.runs.local import LocalRunner
from workbench.runs.worker import Outcome

SWEEP = """
'What do the runs of many types return?'
import os
from dataclasses import dataclass
from typing import NamedTuple
import numpy as np
import workbench
from workbench import Figure, Findings
from workbench.measure import Measured
class Options(workbench.Options): pass
class Point(NamedTuple):
    x: float
    torque: complex
    course: object
@dataclass(frozen=True)
class Machine:
    points: tuple
ANSWERS = {
    0: 0.1 + 0.2, 1: Point(-0.0, complex(float("nan"), -0.0), np.linspace(0.0, 1.0, 7)),
    2: [Machine((Point(1.0, 1j, np.float64(0.1)),)), {3: Measured(1.0, float("inf"))}, None],
    3: ({"a": np.asfortranarray(np.arange(6.0).reshape(2, 3))}, "no orbit"), 4: np.arange(3) * 1j,
}
def work(k):
    with open(LEDGER, "a") as file:
        file.write(f"{k}\\n")
    return ANSWERS[k]
def solve(o, context):
    results = []
    for k, one in enumerate(context.each(work, [*ANSWERS], "answers")):
        if k == STOP:
            raise KeyboardInterrupt
        results.append(one)
    return Findings({"n": Figure(5.0, "1", 0.0)}, results)
def judgements(o, f, r):
    answers[:] = r
    return ()
answers, STOP = [], -1
"""


class Sweep:
    """A question whose runs leave a line each in a ledger, and its folder."""

    def __init__(self, folder: Path, text: str = SWEEP) -> None:
        self.folder, self.ledger, self.path = folder / "out", folder / "ledger", folder / "swept.py"
        self.path.write_text(f"{text}\nLEDGER = {str(self.ledger)!r}\n")
        self.page: Any = load_module(str(self.path))

    def ask(self, stop: int = -1) -> list[Any]:
        """The answers of its runs, none if it is interrupted after `stop` of them."""
        self.page.STOP = stop
        with suppress(KeyboardInterrupt):
            answer(read(self.page), self.page.Options(), {}, runner=LocalRunner(1), out=self.folder)
        return list(self.page.answers)

    def runs(self) -> list[str]:
        """What was run since the last call."""
        done = self.ledger.read_text().split() if self.ledger.exists() else []
        self.ledger.unlink(missing_ok=True)
        return done

    def rows(self) -> sqlite3.Connection:
        return sqlite3.connect(self.folder / journal.NAME, isolation_level=None)


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    """A sweep that was interrupted after three answers."""
    sweep = Sweep(tmp_path)
    assert sweep.ask(stop=3) == []
    assert sweep.runs() == ["0", "1", "2", "3"]
    return sweep


def test_a_sweep_goes_on_with_the_bits_of_the_rows_before(sweep: Sweep) -> None:
    answers = sweep.ask()
    assert sweep.runs() == ["4"]
    assert repr(answers) == repr([*sweep.page.ANSWERS.values()])
    for again, value in zip(answers, sweep.page.ANSWERS.values()):
        assert type(again) is type(value)
        assert pickle.dumps(again) == pickle.dumps(value) or not isinstance(value, np.ndarray)
    assert not (sweep.folder / journal.NAME).exists()


class Evil:
    """A pickle that makes a file when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def test_a_row_that_is_code_is_not_executed(
    sweep: Sweep, capsys: pytest.CaptureFixture[str]
) -> None:
    owned = sweep.folder.parent / "owned"
    with closing(sweep.rows()) as base:
        base.execute("UPDATE rows SET row = ? WHERE rowid = 1", (pickle.dumps(Evil(owned)),))
    assert repr(sweep.ask()) == repr([*sweep.page.ANSWERS.values()])
    assert not owned.exists()
    assert sweep.runs() == ["0", "4"]
    assert "journal.sqlite: 1 row is damaged; it is done again\n" in capsys.readouterr().err


@pytest.mark.parametrize("passing", [True, False])
def test_a_journal_of_an_earlier_version_is_refused_and_not_read(
    passing: bool, tmp_path: Path
) -> None:
    path, owned = tmp_path / journal.NAME, tmp_path / "owned"
    with closing(sqlite3.connect(path, isolation_level=None)) as base:
        base.execute("CREATE TABLE identity (content TEXT NOT NULL)")
        base.execute("CREATE TABLE rows (key PRIMARY KEY NOT NULL, row NOT NULL)")
        base.execute("INSERT INTO identity VALUES ('{}')")
        base.execute("INSERT INTO rows VALUES (0, ?)", (pickle.dumps(Evil(owned)),))
    before = path.read_bytes()
    with (
        pytest.raises(SetupError, match="is a journal of an earlier version, whose rows may") as no,
        journal.open_journal(tmp_path, {}, passing=passing) as rows,
    ):
        rows[0]
    assert "\n" not in str(no.value)
    assert not owned.exists()
    with closing(sqlite3.connect(path)) as base:
        assert base.execute("SELECT count(*) FROM rows").fetchone() == (1,)
    assert before[:16] == path.read_bytes()[:16]


def test_a_journal_with_other_tables_views_or_triggers_is_refused(tmp_path: Path) -> None:
    for number, command in enumerate((
        "CREATE TRIGGER t AFTER INSERT ON rows BEGIN DELETE FROM rows WHERE key < 5; END",
        "CREATE VIEW v AS SELECT * FROM rows",
        "DROP TABLE rows",
    )):  # fmt: skip
        folder = tmp_path / str(number)
        with journal.open_journal(folder, {}):
            pass
        with closing(sqlite3.connect(folder / journal.NAME)) as base:
            base.execute(command)
            base.commit()
        with (
            pytest.raises(SetupError, match="is damaged: it does not have the tables of a journal"),
            journal.open_journal(folder, {}),
        ):
            pass


def test_what_cannot_be_stored_is_reported_once_and_the_sweep_is_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = Sweep(tmp_path, SWEEP.replace("return ANSWERS[k]", "return {k}"))
    assert sweep.ask() == [{k} for k in range(5)]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(
        f"{sweep.folder / journal.NAME}: a value of type builtins.set cannot be kept"
    )


ROW = '{"status":"ok","answer":ANSWER,"message":"","seconds":0.1,"trace":""}'
FIGURES = '{"figures":{"y":{"!tuple":FIGURE}},"warnings":[]}'


def figure(text: str) -> str:
    return ROW.replace("ANSWER", FIGURES.replace("FIGURE", text))


DAMAGE: dict[str, Callable[[int, str], tuple[Any, Any]]] = {
    "a digit": lambda key, row: (key, row.replace('"seconds":0.', '"seconds":1.')),
    "another status": lambda key, row: (key, row.replace('"ok"', '"failed"')),
    "another key": lambda key, row: (key + 1000, row),
    "a key of another type": lambda key, row: (f"{key}", row),
    "bytes": lambda key, row: (key, row.encode()),
}
FORGED = {
    "no JSON": "x", "a list": "[1]", "nothing": "null", "deep": "[" * 20_000,
    "an unknown field": '{"status":"ok","evil":1}', "no answer": '{"status":"ok"}',
    "an unknown status": ROW.replace("ok", "well").replace("ANSWER", "null"),
    "an answer though it failed": figure('[1.0,"m",0.0,""]').replace("ok", "failed"),
    "a message that is none": ROW.replace('"message":""', '"message":3').replace("ANSWER", "null"),
    "a text as value": figure('["1.0","m",0.0,""]'), "three parts": figure('[1.0,"m",0.0]'),
    "a number as unit": figure('[1.0,3,0.0,""]'), "no list": ROW.replace("ANSWER", "[1,2]"),
    "NaN": figure('[NaN,"m",0.0,""]'), "an object": ROW.replace("ANSWER", '{"!record":["os:x",{}]}'),
}  # fmt: skip
GRID = """
scenario = "plane.py"
[fixed]
ledger = "LEDGER"
[grid]
x = { from = 0.0, to = NUMBER, number = RUNS }
"""


def test_damaged_rows_of_a_study_are_done_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each row but the first is damaged in another way; what is forged has the right checksum."""
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", tmp_path)
    file, out, ledger = tmp_path / "some.toml", tmp_path / "out", tmp_path / "ledger"
    kinds = [*DAMAGE, *FORGED]
    text = GRID.replace("LEDGER", str(ledger)).replace("NUMBER", f"{len(kinds)}.0")
    file.write_text(text.replace("RUNS", f"{len(kinds) + 1}"))
    study.run(study.load(file), out=out, jobs=1)
    table = (out / "table.csv").read_bytes()
    ledger.unlink()
    with closing(sqlite3.connect(out / journal.NAME, isolation_level=None)) as base:
        for key, name in enumerate(kinds, 1):
            (row,) = base.execute("SELECT row FROM rows WHERE key = ?", (key,)).fetchone()
            if name in FORGED:
                new = key, FORGED[name], journal.checksum(key, FORGED[name])
            else:
                new = *DAMAGE[name](key, row), journal.checksum(key, row)
            assert new[:2] != (key, row)
            base.execute(
                "UPDATE rows SET key = ?, row = ?, checksum = ? WHERE key = ?", (*new, key)
            )
    capsys.readouterr()
    answer = study.run(study.load(file), out=out, jobs=1)
    again = [float(line) for line in ledger.read_text().split()]
    assert again == [float(key) for key in range(1, len(kinds) + 1)]
    assert f"{len(kinds) + 1} runs, {len(kinds)} of them now" in answer.verdict
    assert (out / "table.csv").read_bytes() == table
    message = f"{out / journal.NAME}: {len(kinds)} rows are damaged; they are done again\n"
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ([4], "the row of run 4 is damaged; it is"),
        ([0, 3, 5], "the rows of runs 0, 3 and 5 are damaged; they are"),
        (range(11), "the rows of runs 0, 1, 2, 3, 4, 5, 6, 7 and 3 more are damaged; they are"),
    ],
)
def test_damaged_rows_are_named(
    keys: Sequence[int], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with journal.open_journal(tmp_path, {}) as rows:
        for key in range(20):
            rows[key] = Outcome("ok", key / 3)
    with closing(sqlite3.connect(tmp_path / journal.NAME, isolation_level=None)) as base:
        base.executemany("UPDATE rows SET row = row || ' ' WHERE key = ?", [(key,) for key in keys])
    with journal.open_journal(tmp_path, {}) as rows:
        assert {key: rows[key].answer for key in range(20) if key in rows} == {
            key: key / 3 for key in range(20) if key not in keys
        }
    assert capsys.readouterr().err == f"{tmp_path / journal.NAME}: {message} done again\n"
    with journal.open_journal(tmp_path, {}) as rows:
        assert len(rows) == 20 - len(keys)
    assert capsys.readouterr().err == ""
