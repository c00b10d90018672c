"""What a command refuses: exit status and the one line it says, as a table that is read where words change.

`refusals.toml` has a row for each: the command, its exit status, its line on stderr. Whoever changes one writes the table
again, `python tests/test_refusals.py`, and reads the difference. FMUS stands for the folder of native FMUs, ROOT for
the project, DRIVE for motor and conveyor as an .ssp of one second, HERE for the current folder. It is empty, and a command
leaves it so; a row with a `file` of `tests/refused` or `examples` has it there, its `old` text replaced by a `new` one. What fails
behind a run `leaves` its folder with the rows.
"""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import pytest

from tests.conftest import ROOT

TABLE = Path(__file__).with_name("refusals.toml")
ROWS: list[dict[str, Any]] = tomllib.loads(TABLE.read_text(encoding="utf-8"))["refusal"]
NATIVE = ROOT / "fmus" / "native"
ASKED = ("command", "file", "old", "new")


@contextlib.contextmanager
def places() -> Iterator[dict[str, str]]:
    """What the words of a command stand for, by word; an empty folder is the current one."""
    from cosim import write_ssp
    from tests.cosim.test_cosim import pair

    before = Path.cwd()
    with tempfile.TemporaryDirectory() as outside, tempfile.TemporaryDirectory() as empty:
        drive = Path(outside) / "drive.ssp"
        write_ssp(pair(NATIVE), drive, stop=1.0)
        os.chdir(empty)
        try:
            yield {
                "FMUS": str(NATIVE), "DRIVE": str(drive), "ROOT": str(ROOT), "HERE": str(Path.cwd()),
            }  # fmt: skip
        finally:
            os.chdir(before)


@contextlib.contextmanager
def given_files(row: dict[str, Any]) -> Iterator[None]:
    """The file of a row in the current folder, beside the question that studies ask."""
    if "file" not in row:
        yield
        return
    (source,) = (
        path
        for folder in ("tests/refused", "examples")
        if (path := ROOT / folder / row["file"]).is_file()
    )
    text = source.read_text(encoding="utf-8")
    assert row["old"] in text
    Path(row["file"]).write_text(text.replace(row["old"], row["new"], 1), encoding="utf-8")
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", "plane.py")
    try:
        yield
    finally:
        for name in (row["file"], "plane.py"):
            Path(name).unlink()
        shutil.rmtree("__pycache__", ignore_errors=True)


def outcome(row: dict[str, Any], words: dict[str, str]) -> tuple[int, str, str]:
    """Exit status and stderr of a command, with the words of the table for places, and a folder that it left."""
    from cosim.cli.main import main as cosim
    from fmukit.__main__ import main as fmukit
    from scenarios.project import PROJECT
    from workbench.cli import main as scenarios

    command = row["command"]
    for word, place in words.items():
        command = command.replace(word, place)
    program, *arguments = shlex.split(command)
    if program == "scenarios" and arguments[:1] in (["run"], ["study"]):
        arguments += ["--flavour", "native", "--out", "out"]
    error = io.StringIO()
    with (
        contextlib.redirect_stderr(error),
        contextlib.redirect_stdout(io.StringIO()),
        given_files(row),
    ):
        try:
            if program == "scenarios":
                status = scenarios(arguments, PROJECT, "scenarios")
            else:
                status = {"cosim": cosim, "fmukit": fmukit}[program](arguments)
        except SystemExit as end:
            status = int(end.code or 0)
    text = error.getvalue()
    for word, place in sorted(words.items(), key=lambda entry: -len(entry[1])):
        text = text.replace(place, word)
    left = " ".join(path.name for path in Path.cwd().iterdir())
    shutil.rmtree("out", ignore_errors=True)
    return status, text.removesuffix("\n"), left


@pytest.fixture(scope="module")
def words() -> Iterator[dict[str, str]]:
    with places() as found:
        yield found


@pytest.mark.parametrize(
    "row", ROWS, ids=lambda row: f"{row['command'][:60]} {row.get('new', '')[:30]}"
)
def test_a_command_is_refused_in_these_words_and_leaves_nothing(
    row: dict[str, Any], words: dict[str, str]
) -> None:
    status, error, left = outcome(row, words)
    assert (status, error, left) == (row["status"], row["stderr"], row.get("leaves", ""))
    assert error.startswith("error: ")
    assert "\n" not in error


def quoted(text: str) -> str:
    """A string of TOML, without escapes where there need be none."""
    if "'" not in text and "\n" not in text:
        return f"'{text}'"
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + escaped.replace("\n", "\\n") + '"'


def renew() -> None:
    """Write the table again, sorted by command."""
    asked = {tuple(row.get(key, "") for key in ASKED): row for row in ROWS}
    with places() as found:
        rows = []
        for row in (asked[key] for key in sorted(asked)):
            status, error, left = outcome(row, found)
            lines = [f"{key} = {quoted(row[key])}" for key in ASKED if key in row]
            lines += [f"status = {status}", f"stderr = {quoted(error)}"]
            if left:
                lines.append(f"leaves = {quoted(left)}")
            rows.append("\n".join(["[[refusal]]", *lines, ""]))
    TABLE.write_text("\n".join(rows), encoding="utf-8")
    print(f"{len(rows)} rows written to {TABLE.name}")


if __name__ == "__main__":
    renew()
