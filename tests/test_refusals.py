"""What a command refuses: exit status and the one line it says, as a table that is read where words change.

`refusals.toml` has a row for each: the command, its exit status, its line on stderr. Whoever changes one writes the table
again, `python tests/test_refusals.py`, and reads the difference. FMUS stands for the folder of native FMUs, ROOT for
the project, DRIVE for motor and conveyor as an .ssp of one second. A command runs in an empty folder, and leaves it so.
"""

from __future__ import annotations

import contextlib
import io
import os
import shlex
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
            yield {"FMUS": str(NATIVE), "DRIVE": str(drive), "ROOT": str(ROOT)}
        finally:
            os.chdir(before)


def outcome(command: str, words: dict[str, str]) -> tuple[int, str]:
    """Exit status and stderr of a command, with the words of the table for places."""
    from cosim.cli.main import main as cosim
    from scenarios.project import PROJECT
    from workbench.cli import main as scenarios

    for word, place in words.items():
        command = command.replace(word, place)
    program, *arguments = shlex.split(command)
    if arguments[:1] == ["run"] and program == "scenarios":
        arguments += ["--flavour", "native", "--out", "out"]
    error = io.StringIO()
    with contextlib.redirect_stderr(error), contextlib.redirect_stdout(io.StringIO()):
        try:
            status = (
                cosim(arguments)
                if program == "cosim"
                else scenarios(arguments, PROJECT, "scenarios")
            )
        except SystemExit as end:
            status = int(end.code or 0)
    text = error.getvalue()
    for word, place in sorted(words.items(), key=lambda entry: -len(entry[1])):
        text = text.replace(place, word)
    return status, text.removesuffix("\n")


@pytest.fixture(scope="module")
def words() -> Iterator[dict[str, str]]:
    with places() as found:
        yield found


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["command"][:60])
def test_a_command_is_refused_in_these_words_and_leaves_nothing(
    row: dict[str, Any], words: dict[str, str]
) -> None:
    status, error = outcome(row["command"], words)
    assert (status, error) == (row["status"], row["stderr"])
    assert error.startswith("error: ")
    assert "\n" not in error
    assert [*Path.cwd().iterdir()] == []


def renew() -> None:
    """Write the table again, sorted by command."""

    def quoted(text: str) -> str:
        return (
            f"'{text}'"
            if "'" not in text
            else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
        )

    rows = []
    with places() as found:
        for command in sorted({row["command"] for row in ROWS}):
            status, error = outcome(command, found)
            rows.append(
                f"[[refusal]]\ncommand = {quoted(command)}\nstatus = {status}\nstderr = {quoted(error)}\n"
            )
    TABLE.write_text("\n".join(rows), encoding="utf-8")
    print(f"{len(rows)} rows written to {TABLE.name}")


if __name__ == "__main__":
    renew()
