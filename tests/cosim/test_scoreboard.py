"""A scoreboard says of each master what is true, and of what is no result, in a line, why."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cosim import SetupError, read_ssp, run, scoreboard
from cosim.cli.main import main
from cosim.standings import Scoreboard, Standing
from reference_systems.make import SPACING, ReferenceAnswer, exact_answer, write_system
from reference_systems.systems import SYSTEMS, build_fmus

KEY = "conveyor_drive_b"
SIGNALS = SYSTEMS[KEY].signals


@pytest.fixture(scope="module")
def answer() -> ReferenceAnswer:
    return exact_answer(KEY)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one system and the results of a master that steps all parts at once."""
    assert not build_fmus()
    folder = tmp_path_factory.mktemp("board")
    write_system(KEY, SYSTEMS[KEY], folder / KEY)
    held = folder / "results" / "held"
    held.mkdir(parents=True)
    system = read_ssp(folder / KEY / f"{KEY}.ssp", folder / "unpacked").system
    for step in (2e-3, 1e-3):
        result = run(system, stop=0.5, step=step, algorithm="jacobi", record=SIGNALS)
        result.frame.to_csv(held / f"{KEY}_{1e3 * step:g}ms.csv", index=False)
    (held / "master.json").write_text(json.dumps({"title": "Held", "calls": 1}))
    return folder


@pytest.fixture
def board(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "board"))


def test_a_master_is_off_by_what_it_is_off(
    board: Path, answer: ReferenceAnswer, tmp_path: Path
) -> None:
    found = scoreboard(board)
    (standing,) = found.standings
    expected = []
    for step in (2e-3, 1e-3):
        frame = pd.read_csv(board / "results/held" / f"{KEY}_{1e3 * step:g}ms.csv")
        rows = np.rint(frame["time"] / SPACING).astype(int)
        off = [
            np.abs(frame[n] - answer.values[n][rows]).max() / np.ptp(answer.values[n])
            for n in SIGNALS
        ]
        expected.append(max(off))
    assert standing.master == "Held" and standing.steps == (2e-3, 1e-3)
    assert standing.differences == pytest.approx(expected, rel=1e-6)
    assert standing.order == pytest.approx(math.log2(expected[0] / expected[1]), rel=1e-6)
    assert standing.verdict == "differs" and "steps of 0.001 s" in standing.cause
    assert [cost for cost, _, _ in found.best(KEY)] == [500.0, 1000.0]
    found.write(tmp_path / "board.html")
    found.write(tmp_path / "board.json")
    page = (tmp_path / "board.html").read_text()
    assert "Held" in page and 'src="data:image/png;base64,' in page and "http" not in page
    assert (
        json.loads((tmp_path / "board.json").read_text())["standings"][0]["order"] == standing.order
    )


def test_the_exact_answer_agrees_and_wins(board: Path, answer: ReferenceAnswer) -> None:
    folder = board / "results" / "exact"
    folder.mkdir()
    pd.DataFrame({"time": answer.time, **answer.values}).to_csv(
        folder / f"{KEY}_1ms.csv", index=False
    )
    (folder / "master.json").write_text('{"calls": 1}')
    found = scoreboard(board, cause_seconds=0.0)
    standing = next(s for s in found.standings if s.master == "exact")
    assert standing.verdict == "agrees" and standing.differences[0] < 1e-10
    assert found.best(KEY)[-1][1].master == "exact"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("conveyor_drive_b.csv", "time,motor.tau\n0,1\n1,2\n", "its name must read SYSTEM_STEP.csv"),
        ("conveyor_drive_c_1ms.csv", "time,motor.tau\n0,1\n1,2\n", "is of no system here: conveyor_drive_b"),
        ("conveyor_drive_b_1ms.csv", "time,motor.tau [m]\n0,1\n0.1,2\n", "m cannot be converted to N.m"),
        ("conveyor_drive_b_1ms.csv", "time,torque\n0,1\n0.1,2\n", "has no column of the system"),
        ("conveyor_drive_b_1ms.csv", "Dear reader,\nthis is no table.\n", "conveyor_drive_b_1ms.csv"),
        ("conveyor_drive_b_1ms.csv", "time,motor.tau\n0,1\n0.7,2\n", "goes from 0 s to 0.5 s"),
        ("master.json", '{"calls": "two"}', "calls = 'two' must be a number"),
        ("master.json", "[1]", "master.json is ignored"),
        ("master.json", "[" * 100_000, "master.json is ignored"),
        ("master.json", '{"title": null}', "title must be a text of at most 300 letters"),
    ],
)  # fmt: skip
def test_what_is_no_result_gets_one_line(
    board: Path, capsys: pytest.CaptureFixture[str], name: str, text: str, said: str
) -> None:
    shutil.rmtree(board / "results" / "held")
    folder = board / "results" / "mine"
    folder.mkdir()
    (folder / name).write_text(text)
    assert main(["referee", "--scoreboard", str(board)]) == 1
    lines = [line for line in capsys.readouterr().out.splitlines() if name in line or said in line]
    assert len(lines) == 1 and said in lines[0]


@pytest.mark.parametrize("name", ["motor.tau", "conveyor.w"])
def test_a_cell_that_is_no_number_is_named(board: Path, answer: ReferenceAnswer, name: str) -> None:
    """Also where everything else is exact, so that nothing but the cell is wrong."""
    frame = pd.DataFrame({"time": answer.time, **answer.values}).astype(object)
    frame.loc[40, name] = "two"
    frame.to_csv(board / "results/held" / f"{KEY}_1ms.csv", index=False)
    (standing,) = scoreboard(board).standings
    assert (
        standing.verdict == "differs" and f"{name} has no finite number in 1 row" in standing.cause
    )


def changed(answer: ReferenceAnswer, change: str) -> pd.DataFrame:
    """Rows of the exact answer that are no whole result."""
    frame = pd.DataFrame({"time": answer.time, **answer.values})
    match change:
        case "a column":
            return frame.rename(columns={"conveyor.w": "conveyor.omega"})
        case "the end":
            return frame[frame["time"] < 0.4]
        case "rows":
            return frame[::8]
    frame = frame.astype(object)
    frame.loc[40, "time"] = "abc"
    return frame


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("a column", "has no column conveyor.w"),
        ("the end", "not at 0.5 s"),
        ("rows", "has rows 0.002 s apart, and a step of 0.001 s in its name"),
        ("a time", "row 41 below the heading has no time"),
    ],
)
def test_a_result_that_is_not_whole_is_none(
    board: Path, answer: ReferenceAnswer, change: str, said: str
) -> None:
    """It would agree, and a missing column would make it the better."""
    changed(answer, change).to_csv(board / "results/held" / f"{KEY}_1ms.csv", index=False)
    found = scoreboard(board, cause_seconds=0.0)
    (standing,) = found.standings
    assert standing.verdict == "cannot be read" and said in standing.reason
    assert not found.best(KEY)


def test_an_empty_folder_and_one_without_results_are_refused(board: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(SetupError, match="has no reference system"):
        scoreboard(empty)
    shutil.rmtree(board / "results")
    (board / "results" / "mine").mkdir(parents=True)
    with pytest.raises(SetupError, match=r"write .*results/MASTER/conveyor_drive_b_1ms.csv"):
        scoreboard(board)


def test_a_system_without_any_result_has_a_row(board: Path) -> None:
    shutil.copytree(board / KEY, board / "copy")
    for path in (board / "copy").glob(f"{KEY}*"):
        path.rename(path.with_name(path.name.replace(KEY, "copy")))
    found = scoreboard(board, cause_seconds=0.0)
    (row,) = [standing for standing in found.standings if standing.system == "copy"]
    assert row.verdict == "no result" and "results/MASTER/copy_1ms.csv" in row.reason
    assert found.systems == [KEY] and "no result" in found.text()


def test_a_master_that_was_not_run_has_its_reason(board: Path) -> None:
    for name, facts in (("a", {"not_run": "no wheel"}), ("b", {"failed": {KEY: "1 ms: refused"}})):
        (board / "results" / name).mkdir()
        (board / "results" / name / "master.json").write_text(json.dumps(facts))
    found = {
        s.master: (s.verdict, s.reason) for s in scoreboard(board, cause_seconds=0.0).standings
    }
    assert found["a"] == ("not run", "no wheel") and found["b"] == ("fails", "1 ms: refused")


def test_a_mistake_in_the_toy_master_of_the_page_is_named(board: Path, tmp_path: Path) -> None:
    """A torque of which a wire brings kN.m."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "test_your_master.md").read_text()
    toy = page.partition("```python results/toy_master.py\n")[2].partition("```")[0]
    right = "[values[source]]"
    assert toy.count(right) == 1
    program = tmp_path / "toy.py"
    wrong = "[values[source] / (1e3 if source == 'motor.tau' else 1.0)]"
    program.write_text(toy.replace(right, wrong))
    shutil.rmtree(board / "results")
    (board / "results" / "toy").mkdir(parents=True)
    result = board / "results" / "toy" / f"{KEY}_1ms.csv"
    subprocess.run(
        [sys.executable, program, board / KEY / f"{KEY}.ssp", "1e-3", result], check=True
    )
    (standing,) = scoreboard(board).standings
    assert standing.verdict == "differs" and "not certain" not in standing.cause
    said = "the wire from motor.tau to conveyor.tau brings 0.001 times its source: kN.m for N.m?"
    assert said in standing.cause


def test_a_picture_without_a_difference_above_zero_is_drawn_without_a_warning(
    tmp_path: Path,
) -> None:
    exact = Standing("mine", "pair", (1e-3, 5e-4), (0.0, 0.0), verdict="agrees")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Scoreboard((exact,)).plot(tmp_path / "board.png")
