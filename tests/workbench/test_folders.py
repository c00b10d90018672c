"""A folder of results belongs to one run: the second is refused, and the first one's files stay whole."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import scenarios
from cosim import SetupError
from scenarios.project import PROJECT
from tests.conftest import ROOT, until
from workbench.answer import Answer, Show, Table
from workbench.charts.model import Chart, Curve, Panel
from workbench.charts.motion import Motion, Shape, line
from workbench.cli import main
from workbench.export import write
from workbench.files import UNFINISHED, replacement, stream

ROWS = 2000
QUESTION = '''
"""How much is in the rows?"""
import time
from dataclasses import dataclass
from pathlib import Path
import cosim
from cosim import System
import workbench
from workbench import Figure, Findings, option, Question, Show, Table
class Rows(Question):
    parts = {"motor": "DriveMotor"}

    kind: str = option("kept", "what makes the rows", choices=("run", "kept", "sweep"))
    scale: float = option(1.0, "scale of the rows")
    gate: str = option("", "file for which the picture waits")

    def solve(self, context):
        if self.kind == "run":
            path = context.out / "rows.csv"
            run = cosim.run(System(context.fmus, [], {"motor.w": self.scale}), stop=ROWS * 1e-3, step=1e-3, csv=path)
            table = Table.of(run)
        else:
            tasks = [(self.scale, float(k)) for k in range(ROWS if self.kind == "kept" else 20)]
            numbers = map(scaled, tasks) if self.kind == "kept" else context.each(scaled, tasks, "rows")
            table = context.record_rows("rows.csv", {"x": "1"}, ([x] for x in numbers))
        return Findings({"scale": Figure(self.scale, "1", 0.0)}, self, tables={"rows.csv": table})

    def show(self, f, r):
        if self.gate:
            Path(self.gate + ".reached").touch()
            while not Path(self.gate).exists():
                time.sleep(0.01)
        return Show()
def scaled(task): return task[0] * task[1]
'''.replace("ROWS", str(ROWS))


@pytest.fixture
def question(tmp_path: Path) -> Path:
    path = tmp_path / "rows_of_mine.py"
    path.write_text(QUESTION)
    return path


def arguments_of(question: Path, kind: str, scale: float, out: Path, *more: str) -> list[str]:
    return ["run", str(question), "--flavour", "native", "--kind", kind, "--scale", f"{scale}",
            "--out", str(out), *more]  # fmt: skip


def at_the_gate(question: Path, kind: str, out: Path, gate: Path) -> subprocess.Popen[str]:
    """A run that has its figures and waits before it writes its last files."""
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "scenarios",
            *arguments_of(question, kind, 1.0, out, "--gate", str(gate)),
        ],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    until(lambda: process.poll() is not None or Path(f"{gate}.reached").exists())
    return process


@pytest.mark.parametrize("kind", ["run", "kept", "sweep"])
def test_a_second_run_into_a_folder_is_refused_until_the_last_file_is_written(
    kind: str, question: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, undisturbed, gate = tmp_path / "out", tmp_path / "alone", tmp_path / "gate"
    assert main(arguments_of(question, kind, 1.0, undisturbed), PROJECT, "scenarios") == 0
    first = at_the_gate(question, kind, out, gate)
    capsys.readouterr()
    try:
        assert main(arguments_of(question, kind, 2.0, out), PROJECT, "scenarios") == 2
        assert capsys.readouterr().err == (
            f"error: {out}: another process is using this folder; wait until it ends, or choose "
            "another folder with --out\n"
        )
        with pytest.raises(SetupError, match="another process is using this folder"):
            scenarios.ask(str(question), kind=kind, flavour="native", out=out)
        with (
            pytest.raises(SetupError, match="another process is using this folder"),
            stream(out / "rows.csv", ["x"]),
        ):
            pass
    finally:
        gate.touch()
        output = first.communicate(timeout=100)[0]
    assert first.returncode == 0, output
    assert (out / "rows.csv").read_bytes() == (undisturbed / "rows.csv").read_bytes()
    assert json.loads((out / "rows_of_mine.json").read_text())["options"]["scale"]["value"] == 1.0
    assert {path.name for path in out.iterdir()} == {path.name for path in undisturbed.iterdir()}


def test_a_killed_run_leaves_its_folder_to_the_next(question: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = at_the_gate(question, "kept", out, tmp_path / "gate")
    os.kill(first.pid, signal.SIGKILL)
    first.communicate()
    assert main(arguments_of(question, "kept", 2.0, out), PROJECT, "scenarios") == 0
    rows = (out / "rows.csv").read_text().split()
    assert rows == ["x", *(f"{2.0 * k}" for k in range(ROWS))]
    assert not [path.name for path in out.iterdir() if path.name.startswith(".")]


def test_a_folder_that_nothing_was_written_to_is_not_left(tmp_path: Path) -> None:
    from workbench.runs.folder import reservation

    with pytest.raises(SetupError), reservation(tmp_path / "some" / "folder"):
        with reservation(tmp_path / "some" / "folder"):
            assert (tmp_path / "some" / "folder").is_dir()
        raise SetupError
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    with pytest.raises(SetupError, match=r"file cannot be written: .*[Ee]xists"):
        reservation(tmp_path / "file").__enter__()


def test_a_table_has_no_rows_of_the_run_whose_file_blocks_it(tmp_path: Path) -> None:
    """Another program has NAME.partial.csv open; a link there leads to somebody's file."""
    precious = tmp_path / "precious"
    precious.write_text("mine\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "rows.partial.csv").symlink_to(precious)
    frame = Table.of_rows([(1.0,)], {"x": "1"})
    bare = {"parts": {}, "versions": {}, "flavour": "native"}
    write(
        Answer({}, tables={"rows.csv": frame}, provenance=bare, scenario="a", question="?",
               verdict=""),
        tmp_path / "out",
    )  # fmt: skip
    assert precious.read_text() == "mine\n"
    assert (tmp_path / "out" / "rows.csv").read_text() == "x\n1.0\n"


DRAWN = {
    "rows.csv",
    "a.json",
    "a.png",
    "a.gif",
    "a_2.gif",
    "rows.parquet",
    "report.html",
    "study.toml",
}


def drawn_answer() -> Answer:
    """An answer that writes a file of each kind."""
    table = Table.of_rows([(1.0,), (2.0,)], {"x": "1"})
    arm = Shape("arm", line((0.0, 0.0), np.exp(1j * np.arange(3.0))), "blue")
    turning = Motion("turns", np.arange(3.0), 1.0, ["", "", ""], [arm])
    chart = Chart("x", "x [1]", [Panel("y", "1", [Curve("y", [0.0, 1.0], [1.0, 2.0], "blue")])])
    bare = {"parts": {}, "versions": {}, "flavour": "native"}
    return Answer(
        {}, tables={"rows.csv": table}, provenance=bare, scenario="a", question="?", verdict="",
        files={"rows.parquet": table.frame.to_parquet},
        show=lambda: Show([chart], motions=[turning, turning]),
    )  # fmt: skip


def test_links_at_the_names_of_results_are_replaced(tmp_path: Path) -> None:
    """What they lead to stays; so it is with a folder of links that a killed run may have left."""
    precious, out = tmp_path / "precious", tmp_path / "out"
    precious.mkdir()
    out.mkdir()
    for name in DRAWN:
        (precious / name).write_text("mine")
        (out / name).symlink_to(precious / name)
    (out / UNFINISHED).symlink_to(precious)
    written = set(write(drawn_answer(), out, animate=True))
    assert written == DRAWN - {"study.toml"}
    assert {path.name for path in out.iterdir()} == DRAWN
    for name in written:
        assert not (out / name).is_symlink() and (out / name).stat().st_size > 5
    assert {path.name: path.read_text() for path in precious.iterdir()} == dict.fromkeys(
        DRAWN, "mine"
    )


def test_a_file_that_is_not_complete_takes_no_place(tmp_path: Path) -> None:
    """The write ends half-way: the old file is whole, and nothing lies beside it."""
    name = "a.png"
    write(drawn_answer(), tmp_path, animate=True)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(KeyboardInterrupt), replacement(tmp_path / name) as fresh:
        assert fresh.name == name
        fresh.write_bytes(b"half")
        raise KeyboardInterrupt
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    (tmp_path / UNFINISHED).mkdir()
    (tmp_path / UNFINISHED / name).write_bytes(b"half")  # as after SIGKILL
    write(drawn_answer(), tmp_path, animate=True)
    assert {path.name for path in tmp_path.iterdir()} == set(before)


def test_an_answer_to_other_values_is_not_replaced_without_a_word(
    question: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    for scale, said in ((1.0, False), (1.0, False), (2.0, True)):
        assert main(arguments_of(question, "kept", scale, out), PROJECT, "scenarios") == 0
        words = capsys.readouterr().err
        assert ("this replaces the answer of" in words) == said
    assert "to other values: scale was 1.0 and is 2.0; to keep both, choose another" in words
    (out / "rows_of_mine.json").write_text("[1")
    assert main(arguments_of(question, "kept", 1.0, out), PROJECT, "scenarios") == 0
    assert "replaces" not in capsys.readouterr().err
