"""The command `drive-fmus`: every other command under its name, and one line for what is no command."""

import subprocess
import sys

import pytest

from cosim import __version__
from scenarios.overview import COMMANDS, main

LIGHT = (
    "import sys; from scenarios.overview import main; main([]); sys.exit('numpy' in sys.modules)"
)


def test_a_command_gets_the_arguments_behind_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cosim", "certify"]) == 2
    assert capsys.readouterr().err == "error: there is no command 'certify': use run --certify\n"
    assert main(["scenarios", "list"]) == 0
    assert "resonance " in capsys.readouterr().out
    assert main(["fmukit", "build", "nothing.py"]) == 2
    assert capsys.readouterr().err == "error: there is no file nothing.py\n"


@pytest.mark.parametrize("arguments", [[], ["--help"]])
def test_alone_it_lists_the_commands_and_imports_none(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert all(f"drive-fmus {name}" in text for name in COMMANDS)
    assert subprocess.run([sys.executable, "-c", LIGHT], check=False).returncode == 0


def test_what_is_no_command_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert main(["scenario", "list"]) == 2
    out, error = capsys.readouterr()
    assert out == f"drive-fmus {__version__}\n"
    assert error == (
        "error: drive-fmus has no command 'scenario': only cosim, fmukit, scenarios; "
        "did you mean scenarios?\n"
    )
