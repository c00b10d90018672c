"""The journal of many runs: what it holds is the same to the last bit, runs nothing, and is checked."""

from __future__ import annotations

import json
import pickle
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import SetupError, journal
from cosim.journal import record
from tests.conftest import ROOT
from workbench import study
from workbench.catalog import load_module
from workbench.question import read
from workbench.run import answer
from workbench.runs.runner import Runner

SWEEP = """
'What do the runs of many types return?'
import workbench
from workbench import Figure, Findings, Question
class Answers(Question):

    def solve(self, context):
        results = []
        for k, one in enumerate(context.each(work, range(6), "answers")):
            if k == STOP:
                raise KeyboardInterrupt
            results.append(one)
        answers[:] = results
        return Findings({"n": Figure(5.0, "1", 0.0)})
ANSWERS = [0.1 + 0.2, (-0.0, [1, True, None, "grün"]), [float("inf")], "no orbit", {1}, ((2.5,),)]
def work(k):
    with open(LEDGER, "a") as file:
        file.write(f"{k}\\n")
    return ANSWERS[k]
answers, STOP = [], -1
"""


class Sweep:
    """A question whose runs leave a line each in a ledger, and its folder."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.ledger, self.path = folder / "out", folder / "ledger", folder / "swept.py"
        self.path.write_text(f"{SWEEP}\nLEDGER = {str(self.ledger)!r}\n")
        self.page: Any = load_module(str(self.path))

    def ask(self, stop: int = -1) -> list[Any]:
        """The answers of its runs, none if it is interrupted after `stop` of them."""
        self.page.STOP = stop
        with suppress(KeyboardInterrupt):
            answer(read(self.page), self.page.Answers(), {}, runner=Runner(1), out=self.folder)
        return list(self.page.answers)

    def runs(self) -> list[str]:
        """What was run since the last call."""
        done = self.ledger.read_text().split() if self.ledger.exists() else []
        self.ledger.unlink(missing_ok=True)
        return done


def test_a_sweep_goes_on_with_the_bits_of_the_rows_before(tmp_path: Path) -> None:
    """An answer of another type than numbers, texts, lists and tuples is computed again."""
    sweep = Sweep(tmp_path)
    assert sweep.ask(stop=5) == []
    assert sweep.runs() == ["0", "1", "2", "3", "4", "5"]
    answers = sweep.ask()
    assert sweep.runs() == ["4"]
    assert repr(answers) == repr(sweep.page.ANSWERS)
    assert not (sweep.folder / journal.OUTCOMES).exists()


class Evil:
    """A pickle that makes a file when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def told(*outcome: Any) -> str:
    """The text of a row."""
    return json.dumps({"tuple": outcome})


ANSWER = {"tuple": [[["y", "m", ""]], {"array": [1.0, 0.0], "shape": [1, 2]}, []]}
GOOD = told("ok", ANSWER, "", 0.1, "")
#: Texts of rows with a right checksum that no run can have written.
FORGED = {
    "no JSON": "x",
    "nothing": "null",
    "deep": "[" * 20_000,
    "an unknown status": told("well", None, "", 0.1, ""),
    "a message that is none": told("failed", None, 3, 0.1, ""),
    "no time": told("failed", None, "", None, ""),
    "no answer": told("ok", None, "", 0.1, ""),
    "a piece too few": told("ok", ANSWER, ""),
    "a number too many": GOOD.replace("0.0]", "0.0, 2.0]"),
    "a number as unit": GOOD.replace('"m"', "3"),
    "an object": told("ok", {"texts": "y"}, "", 0.1, ""),
}
GRID = """
scenario = "plane.py"
[fixed]
ledger = "LEDGER"
[grid]
x = { from = 0.0, to = NUMBER, number = RUNS }
"""


def test_forged_rows_of_a_study_are_done_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every second row is another text, those around it count; nothing is executed."""
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", tmp_path)
    file, out, ledger = tmp_path / "some.toml", tmp_path / "out", tmp_path / "ledger"
    owned = tmp_path / "owned"
    evil = {"code": pickle.dumps(Evil(owned)).decode("latin-1")}
    kinds = [*FORGED, *evil]
    text = GRID.replace("LEDGER", str(ledger)).replace("NUMBER", f"{2 * len(kinds)}.0")
    file.write_text(text.replace("RUNS", f"{2 * len(kinds) + 1}"))
    study.run(study.load(file), out=out, jobs=1)
    table = (out / "table.csv").read_bytes()
    ledger.unlink()
    path = out / journal.OUTCOMES
    head, _, content = path.read_bytes().partition(b"\n")
    changed = [head, b"\n"]
    while content:
        number, figures, length = np.frombuffer(content, "<i8", 3).tolist()
        size = 24 + 8 * figures + length + 8
        row, content = content[:size], content[size:]
        if number % 2:
            row = record(number, np.empty(0), {**FORGED, **evil}[kinds[number // 2]])
        changed.append(row)
    path.write_bytes(b"".join(changed))
    capsys.readouterr()
    result = study.run(study.load(file), out=out, jobs=1)
    again = [float(line) for line in ledger.read_text().split()]
    assert again == [float(key) for key in range(1, 2 * len(kinds), 2)]
    assert f"{2 * len(kinds) + 1} runs, {len(kinds)} of them now" in result.verdict
    assert (out / "table.csv").read_bytes() == table
    assert (
        f"{path}: {len(kinds)} rows are damaged; they are done again\n" in capsys.readouterr().err
    )
    assert not owned.exists()
    study.run(study.load(file), out=out, jobs=1)
    assert len(ledger.read_text().split()) == len(kinds)


def test_a_file_that_is_no_journal_is_refused(tmp_path: Path) -> None:
    path = tmp_path / journal.OUTCOMES
    path.write_bytes(b"x,y\n1,2\n" * 1000)
    for passing in (False, True):
        with (
            pytest.raises(SetupError, match=f"{path} is no journal of runs; remove it, or choose"),
            journal.open_outcomes(tmp_path, {}, passing=passing),
        ):
            pass
    assert path.read_bytes() == b"x,y\n1,2\n" * 1000
    path.write_bytes(b'{"form": "ru')  # killed while it began
    with journal.open_outcomes(tmp_path, {}) as rows:
        assert len(rows) == 0
